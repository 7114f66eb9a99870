use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::state::Takeover;
use super::{
    Arm, ArmMeasurement, ForceSource, ImpedanceRefusal, ImpedanceSettings, ImpedanceState,
    ImpedanceTelemetry, SetpointError, own_mass,
};
use crate::control::{JointPoint, ServoMode};
use crate::fault::{Fault, FaultCause};
use crate::kinematics::{ElbowSetpoint, PosePoint};
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS};
use crate::robot::{Actuation, JointSetpoint, Measured, Postures, Robot};
use crate::task::{Halt, Io, Tareable, Task, TaskFault};

/// Commands of impedance control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[expect(clippy::large_enum_variant, reason = "decoded in place, once for each message")]
pub enum ImpedanceCommand {
    /// 0: set-points of tool and elbow. Without a successor they come to rest.
    SetTarget {
        /// Set-point of the tool.
        point: PosePoint,
        /// Set-point of the elbow.
        elbow: ElbowSetpoint,
    },
    /// 1: changes the settings. A new impedance is blended in within a second.
    Configure(ImpedanceSettings),
}

/// The task: Cartesian impedance control of an arm.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct ImpedanceControl {
    state: ImpedanceState,
}

/// Checks that the robot has the force source of the settings.
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
        let (angles, axes) = (ArmMeasurement::of(measured).angles, settings.impedance.axes);
        let own_mass = own_mass(arm.chain, arm.joints, &angles, axes);
        settings.check_mass(&own_mass).map_err(ImpedanceRefusal::Settings)?;
        match (settings.force, measured.untared(robot)) {
            (ForceSource::Sensor, Some(chain)) => Err(ImpedanceRefusal::NotTared { chain }),
            _ => Ok(()),
        }
    }

    fn begin(&mut self, io: Io<'_>, settings: &ImpedanceSettings) {
        if let Some(arm) = Arm::of(io.robot) {
            self.state.begin(&arm, settings, &ArmMeasurement::of(io.measured).angles);
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
                self.state.configure(&arm, settings)
            }
        }
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // Cannot fail: `check` required an arm.
        let Some(arm) = Arm::of(io.robot) else { return Ok(()) };
        let output = self.state.tick(&arm, &ArmMeasurement::of(io.measured))?;
        let points = output.points.iter().zip(&output.feedback);
        for ((target, torque), (point, feedback)) in
            io.targets.joints.iter_mut().zip(&output.torques).zip(points)
        {
            let point = JointPoint { acceleration: point.acceleration + feedback, ..*point };
            (target.setpoint, target.feedforward) = (JointSetpoint::Point(point), *torque);
        }
        io.targets.actuation = Actuation::Acceleration { friction: output.friction };
        // Checked after the targets of this tick are set, so that a stop begins from a consistent state.
        self.state.check_deviation()?;
        self.state.check_disturbance().map_err(|(value, limit)| TaskFault {
            cause: FaultCause::ForceMismatch,
            joint: None,
            value,
            limit,
        })
    }

    fn halt(&mut self, io: Io<'_>, fault: &Fault) -> Halt {
        let force_is_valid = !fault.cause.loses_force() && fault.cause != FaultCause::ForceMismatch;
        match Arm::of(io.robot) {
            Some(arm) if force_is_valid || self.state.estimates_force() => {
                let takeover = match fault.cause {
                    FaultCause::LateTick => Takeover::Disturbances,
                    cause if cause.invalidates_reference() => Takeover::Nothing,
                    _ => Takeover::All,
                };
                self.state.halt(&arm, &ArmMeasurement::of(io.measured), takeover);
                Halt::Task
            }
            // Without a valid force the control would press against a contact.
            _ => Halt::Damp,
        }
    }

    fn applied(&mut self, robot: &Robot, torques: &[f32; MAX_JOINTS], added: &[f32; MAX_JOINTS]) {
        let (Some(arm), Some(torques), Some(added)) = (
            Arm::of(robot),
            torques.first_chunk::<MAX_CHAIN_JOINTS>(),
            added.first_chunk::<MAX_CHAIN_JOINTS>(),
        ) else {
            return;
        };
        self.state.applied(&arm, torques, added);
    }

    fn tareable(&self) -> Tareable {
        // A constant error of the estimate looks like a contact. It may also be real: the sensors keep their
        // tare.
        Tareable { sensors: !self.state.contact, estimate: self.state.estimates_force() }
    }

    fn tare_estimate(&mut self) {
        self.state.tare_estimate();
    }

    fn acceleration(&self) -> Vector3<f32> {
        self.state.acceleration()
    }

    fn telemetry(&self, robot: &Robot, measured: &Measured, postures: &Postures) -> ImpedanceTelemetry {
        match (Arm::of(robot), postures.of(robot, measured, 0)) {
            (Some(arm), Some(posture)) => self.state.telemetry(&arm, &ArmMeasurement::of(measured), &posture),
            // The model was replaced by one that is not an arm.
            _ => ImpedanceTelemetry::NONE,
        }
    }
}

impl From<SetpointError> for TaskFault {
    fn from(error: SetpointError) -> Self {
        let (cause, value, limit) = match error {
            SetpointError::Distance { value, limit } => (FaultCause::ToolPositionError, value, limit),
            SetpointError::Rotation { value, limit } => (FaultCause::ToolOrientationError, value, limit),
            _ => (FaultCause::NotFinite, f32::NAN, 0.0),
        };
        Self { cause, joint: None, value, limit }
    }
}
