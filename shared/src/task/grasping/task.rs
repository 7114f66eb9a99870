use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    FingerSense, GraspCommand, GraspFault, GraspHand, GraspPlan, GraspRefusal, GraspState, GraspTelemetry,
    ObjectControl, Phase,
};
use crate::control::ServoMode;
use crate::fault::FaultCause;
use crate::robot::{Actuation, JointSetpoint, JointTarget, Measured, Postures, Robot};
use crate::task::{Io, Tareable, Task, TaskFault};

/// The task for a hand of three fingers on one board.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Grasping {
    state: GraspState,
}

impl Task for Grasping {
    type Config = ();
    type Command = GraspCommand;
    type Telemetry = GraspTelemetry;
    type Refusal = GraspRefusal;
    const IDLE: Self = Self { state: GraspState::NONE };

    fn check(robot: &Robot, measured: &Measured, (): &()) -> Result<(), GraspRefusal> {
        GraspHand::of(robot).ok_or(GraspRefusal::NotAHand)?;
        measured.untared(robot).map_or(Ok(()), |chain| Err(GraspRefusal::NotTared { chain }))
    }

    fn begin(&mut self, io: Io<'_>, (): &()) {
        let mut angles = [[0.0; 3]; 3];
        angles
            .iter_mut()
            .flatten()
            .zip(&io.measured.positions)
            .for_each(|(angle, position)| *angle = *position);
        self.state.stand_at(angles);
        io.targets.servo_mode = ServoMode::Observer;
    }

    fn command(&mut self, io: Io<'_>, command: &GraspCommand) -> Result<(), GraspRefusal> {
        let hand = GraspHand::of(io.robot).ok_or(GraspRefusal::NotAHand)?;
        let had_plan = self.state.plan.is_some();
        let mut speeds = [[0.0; 3]; 3];
        let joints = speeds.iter_mut().flatten().zip(io.robot.joints());
        joints.for_each(|(speed, joint)| *speed = joint.limits.planned_speed());
        self.state.command(&hand, &speeds, command)?;
        if let GraspCommand::Grasp(GraspPlan { control, .. }) = command {
            let mode = match control {
                ObjectControl::Differential(mode) => *mode,
                ObjectControl::Wrench(_) => ServoMode::Observer,
            };
            if core::mem::replace(&mut io.targets.servo_mode, mode) != mode && had_plan {
                // The state of this mode dates from its last tick, of an earlier plan.
                io.targets.joints.iter_mut().for_each(|target| target.restart = true);
            }
        }
        Ok(())
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // Both exist: `check` found a hand, and the sensors are read before the task runs.
        let Some(hand) = GraspHand::of(io.robot) else { return Ok(()) };
        let Some(senses) = FingerSense::of_all(io.measured, io.postures, io.efforts) else { return Ok(()) };
        let output = self.state.tick(&hand, &senses)?;
        let servo = output.actuation == Actuation::Servo;
        // Servos restart after torque control, and when their observers contain the touch force.
        let restart = servo && (io.targets.actuation != Actuation::Servo || self.state.restarts_servos());
        let joints = output.points.iter().flatten().zip(output.torques.iter().flatten());
        for (target, (point, torque)) in io.targets.joints.iter_mut().zip(joints) {
            let restart = restart || target.restart;
            *target = JointTarget { setpoint: JointSetpoint::Point(*point), feedforward: *torque, restart };
        }
        io.targets.actuation = output.actuation;
        Ok(())
    }

    fn tareable(&self) -> Tareable {
        Tareable { sensors: self.state.phase() == Phase::Ready, estimate: false }
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) -> GraspTelemetry {
        self.state.telemetry()
    }
}

impl From<GraspFault> for TaskFault {
    fn from(fault: GraspFault) -> Self {
        let (cause, finger, value, limit) = match fault {
            GraspFault::ContactLost { finger, force, limit } => {
                (FaultCause::ObjectLost, Some(finger), force, limit)
            }
            GraspFault::Deformed { distance, limit } | GraspFault::Displaced { distance, limit } => {
                (FaultCause::ObjectMoved, None, distance, limit)
            }
            GraspFault::NoFrame => (FaultCause::ObjectMoved, None, f32::INFINITY, 0.0),
        };
        Self { cause, joint: finger.map(|finger| 3 * finger + 2), value, limit }
    }
}
