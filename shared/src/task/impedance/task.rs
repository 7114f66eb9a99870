use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    Arm, ArmSense, ForceSource, ImpedanceRefusal, ImpedanceSettings, ImpedanceState, ImpedanceTelemetry,
    SetpointError,
};
use crate::control::{JointPoint, ServoMode};
use crate::fault::FaultCause;
use crate::kinematics::{ElbowSetpoint, PosePoint};
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS};
use crate::robot::{Actuation, JointSetpoint, Measured, Postures, Robot};
use crate::task::{Io, Task, TaskFault};

/// What a supervisor asks of an arm under impedance control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ImpedanceCommand {
    /// 0: where the tool should be, and its elbow. Comes to rest there unless another follows.
    SetTarget {
        /// The tool.
        point: PosePoint,
        /// The elbow.
        elbow: ElbowSetpoint,
    },
    /// 1: other settings; a new impedance is approached within a second.
    Configure(ImpedanceSettings),
}

/// The task: impedance control of the tool of an arm.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct ImpedanceControl {
    state: ImpedanceState,
}

/// Checks that the robot has the source of the force.
fn check_source(robot: &Robot, settings: &ImpedanceSettings) -> Result<(), ImpedanceRefusal> {
    if settings.force == ForceSource::Sensor && robot.force_sensors() == 0 {
        return Err(ImpedanceRefusal::NoForceSensor);
    }
    Ok(())
}

impl Task for ImpedanceControl {
    type Config = ImpedanceSettings;
    type Command = ImpedanceCommand;
    type Telemetry = ImpedanceTelemetry;
    type Refusal = ImpedanceRefusal;
    const IDLE: Self = Self { state: ImpedanceState::NONE };

    fn check(
        robot: &Robot,
        measured: &Measured,
        settings: &ImpedanceSettings,
    ) -> Result<(), ImpedanceRefusal> {
        let arm = Arm::of(robot).ok_or(ImpedanceRefusal::NotAnArm)?;
        check_source(robot, settings)?;
        settings.validate(arm.chain.len()).map_err(ImpedanceRefusal::Settings)?;
        match (settings.force, measured.untared(robot)) {
            (ForceSource::Sensor, Some(chain)) => Err(ImpedanceRefusal::NotTared { chain }),
            _ => Ok(()),
        }
    }

    fn begin(&mut self, io: Io<'_>, settings: &ImpedanceSettings) {
        if let Some(arm) = Arm::of(io.robot) {
            self.state.begin(&arm, settings, &ArmSense::of(io.measured).angles);
            io.targets.servo_mode = ServoMode::Observer;
        }
    }

    fn command(&mut self, io: Io<'_>, command: &ImpedanceCommand) -> Result<(), ImpedanceRefusal> {
        let arm = Arm::of(io.robot).ok_or(ImpedanceRefusal::NotAnArm)?;
        match command {
            ImpedanceCommand::SetTarget { point, elbow } => {
                self.state.set_target(&arm, point, elbow).map_err(ImpedanceRefusal::Setpoint)
            }
            ImpedanceCommand::Configure(settings) => {
                check_source(io.robot, settings)?;
                if self.state.changes_source(settings) {
                    return Err(ImpedanceRefusal::ForceSourceInUse);
                }
                self.state.configure(&arm, settings).map_err(ImpedanceRefusal::Settings)
            }
        }
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // `check` saw an arm.
        let Some(arm) = Arm::of(io.robot) else { return Ok(()) };
        let output = self.state.tick(&arm, &ArmSense::of(io.measured))?;
        let joints = output.points.iter().zip(&output.feedback).zip(&output.torques);
        for (target, ((point, feedback), torque)) in io.targets.joints.iter_mut().zip(joints) {
            let point = JointPoint { acceleration: point.acceleration + feedback, ..*point };
            (target.setpoint, target.feedforward) = (JointSetpoint::Point(point), *torque);
        }
        io.targets.actuation = Actuation::Acceleration { friction: output.friction };
        Ok(())
    }

    fn applied(&mut self, robot: &Robot, torques: &[f32; MAX_JOINTS], added: &[f32; MAX_JOINTS]) {
        let (Some(arm), Some(torques), Some(added)) = (
            Arm::of(robot),
            torques.first_chunk::<MAX_CHAIN_JOINTS>(),
            added.first_chunk::<MAX_CHAIN_JOINTS>(),
        ) else {
            return;
        };
        self.state.applied(&arm, added, torques);
    }

    fn tare(&mut self) -> bool {
        self.state.tare()
    }

    fn acceleration(&self) -> Vector3<f32> {
        self.state.acceleration()
    }

    fn telemetry(&self, robot: &Robot, measured: &Measured, postures: &Postures) -> ImpedanceTelemetry {
        match (Arm::of(robot), postures.of(robot, measured, 0)) {
            (Some(arm), Some(posture)) => self.state.telemetry(&arm, &ArmSense::of(measured), &posture),
            // Another robot since: nothing is left of the arm.
            _ => ImpedanceTelemetry::NONE,
        }
    }
}

impl From<SetpointError> for TaskFault {
    fn from(error: SetpointError) -> Self {
        let (cause, value, limit) = match error {
            SetpointError::Distance { value, limit } => (FaultCause::ToolAway, value, limit),
            SetpointError::Rotation { value, limit } => (FaultCause::ToolTurned, value, limit),
            _ => (FaultCause::NotFinite, f32::NAN, 0.0),
        };
        Self { cause, joint: None, value, limit }
    }
}
