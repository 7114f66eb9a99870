//! Visual approach: the hand goes where a camera on it says, and grips (Knob).
//!
//! ```text
//! latch ──► pose of the hand, when a picture is taken
//! move  ──► straight motion, damped inverse Jacobian ──► limits of motion ──► joint servos
//!                 ▲ stops                                                          │ efforts
//!                 └───────────────── force on the hand ◄───────────────────────────┘
//! grip  ──► gripper
//! ```
//!
//! This is the manipulation module of the paper: it knows nothing of pictures. Who leads it sends a
//! [latch](VisualApproachCommand::Latch) when a picture is taken, finds the rose in it, and sends where the hand shall go,
//! from [`Approach`] or by a rule of its own. Targets are places in the base frame: one that arrives late or twice does
//! no harm.
//!
//! The hand keeps the orientation that it has when the task begins. Its references are found by the inverse of the Jacobian,
//! as in the paper (`dθ = J⁻¹ [mx my mz 0 0 0]ᵀ`, Knob §4.5), damped, within the limits of the joints; the motion
//! is continuous, so that it goes on while a picture is looked at. A contact against the motion ends it.

mod approach;
mod contact;
mod gripper;
mod reference;
mod rose;
mod settings;
#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::math::sqrt;
use crate::model::Pose;
use crate::robot::{Actuation, ChainConfig, JointSetpoint, JointTarget, Measured, Postures, Robot};
use crate::teleop::MotionLimits;

pub use approach::{Approach, ApproachSettings, InvalidApproach, Order, Phase, Reason};
use contact::ContactEstimate;
pub use gripper::GripperState;
use gripper::{Gripper, GripperJoint};
use reference::{Arm, Step, angles, pose};
pub use rose::{KnobExpectation, Rim, RoseEstimate};
pub use settings::{
    ApproachField, GripperSettings, MIN_SPEED, VisualApproachRefusal, VisualApproachSettings,
};

/// The hand has arrived within this distance [m].
const ARRIVED: f32 = 5e-4;
/// A hand that is slower stands, or is held back [m/s].
const SLOWEST: f32 = 1e-3;
/// After a contact the hand goes back by this much from where it was [m].
const RETREAT: f32 = 2e-3;

/// Commands of the visual approach. All but the latch may be repeated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum VisualApproachCommand {
    /// 0: a picture is taken now: keeps the pose of the hand.
    Latch {
        /// Number of the picture.
        number: u16,
    },
    /// 1: moves the hand on a straight line.
    Move {
        /// Where it shall come to rest, in the base frame [m].
        position: [f32; 3],
        /// Largest speed [m/s]: at least [`MIN_SPEED`].
        speed: f32,
    },
    /// 2: brings the hand to rest.
    Stand,
    /// 3: opens the gripper.
    Open,
    /// 4: closes the gripper, and holds what is between the fingers.
    Close,
}

/// Motion of the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HandMotion {
    /// 0: it stands at its target.
    Standing,
    /// 1: it moves.
    Moving,
    /// 2: a contact has ended its motion; it waits for another target.
    Blocked,
    /// 3: limits of the joints hold it back.
    Limited,
}

/// What the hand does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct VisualApproachTelemetry {
    /// Pose of the hand in the base frame, by the measured angles; the gripper counts as at 0.
    pub hand: Pose,
    /// Number of the last latch and the pose of the hand then.
    pub latched: Option<(u16, Pose)>,
    /// Its motion.
    pub motion: HandMotion,
    /// Way to the target [m].
    pub remaining: f32,
    /// Force on the hand as the efforts of the joints show it, in the base frame [N].
    pub force: [f32; 3],
    /// The gripper.
    pub gripper: GripperState,
    /// Its angle [rad].
    pub opening: f32,
}

/// The task.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct VisualApproach {
    settings: VisualApproachSettings,
    /// Where the hand was when the task began.
    begin: Pose,
    latched: Option<(u16, Pose)>,
    /// Where it was sent [m], and how fast at most [m/s].
    commanded: [f32; 3],
    speed: f32,
    /// Where it goes [m].
    target: [f32; 3],
    motion: HandMotion,
    remaining: f32,
    contact: ContactEstimate,
    force: [f32; 3],
    gripper: Gripper,
}

impl Task for VisualApproach {
    type Config = VisualApproachSettings;
    type Command = VisualApproachCommand;
    type Telemetry = VisualApproachTelemetry;
    type Refusal = VisualApproachRefusal;
    const IDLE: Self = Self {
        settings: VisualApproachSettings::DEFAULT,
        begin: Pose::IDENTITY,
        latched: None,
        commanded: [0.0; 3],
        speed: 0.0,
        target: [0.0; 3],
        motion: HandMotion::Standing,
        remaining: 0.0,
        contact: ContactEstimate::NONE,
        force: [0.0; 3],
        gripper: Gripper::STILL,
    };

    fn check(
        robot: &Robot,
        _: &Measured,
        settings: &VisualApproachSettings,
    ) -> Result<(), VisualApproachRefusal> {
        settings.validate(robot)
    }

    fn begin(&mut self, io: Io<'_>, settings: &VisualApproachSettings) {
        self.settings = *settings;
        let angles = angles(io.references);
        io.targets.servo_mode = settings.servo_mode;
        io.targets.actuation = Actuation::Servo;
        io.targets.stand_at(&angles);
        // Cannot fail: `check` required the chain.
        let Some(arm) = self.arm(io.robot) else { return };
        self.begin = to_wire(&pose(&arm.posture(&angles)));
        (self.commanded, self.speed) = (self.begin.translation, settings.speed);
        self.target = self.commanded;
    }

    fn command(&mut self, io: Io<'_>, command: &VisualApproachCommand) -> Result<(), VisualApproachRefusal> {
        match *command {
            VisualApproachCommand::Latch { number } => {
                let arm = self.arm(io.robot);
                let hand = arm.map(|arm| to_wire(&pose(&arm.posture(&io.measured.positions))));
                self.latched = hand.map(|hand| (number, hand));
            }
            VisualApproachCommand::Move { position, speed } => {
                let distance =
                    (Vector3::from(position) - Vector3::from(self.begin.translation)).norm_squared();
                let (distance, reach) = (sqrt(distance), self.settings.reach);
                // Nor a place that is no number.
                if distance.is_nan() || distance > reach {
                    return Err(VisualApproachRefusal::Target { distance, reach });
                }
                let limit = self.settings.speed;
                if !(MIN_SPEED..=limit).contains(&speed) {
                    return Err(VisualApproachRefusal::Speed { value: speed, limit });
                }
                self.speed = speed;
                // A repeated command does not go against a contact again.
                let is_repeated = position.map(f32::to_bits) == self.commanded.map(f32::to_bits);
                if self.motion == HandMotion::Blocked && is_repeated {
                    return Ok(());
                }
                (self.commanded, self.target, self.motion) = (position, position, HandMotion::Moving);
            }
            VisualApproachCommand::Stand => {
                self.target = self.reference(&io).translation.vector.into();
                (self.commanded, self.motion) = (self.target, HandMotion::Moving);
            }
            VisualApproachCommand::Open => self.gripper.open(),
            VisualApproachCommand::Close => self.gripper.close(),
        }
        Ok(())
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // Cannot fail: `check` required the chain.
        let Some(arm) = self.arm(io.robot) else { return Ok(()) };
        let measured = arm.posture(&io.measured.positions);
        let stands = self.motion == HandMotion::Standing;
        let force = self.contact.update(&arm, &measured, io.efforts, stands, self.settings.contact_force);
        self.force = force.into();
        let target = Isometry3::from_parts(Translation3::from(self.target), rotation(&self.begin.rotation));
        let limits = MotionLimits { speed: self.speed, acceleration: self.settings.acceleration };
        let mut points = *io.references;
        let step = arm.advance(io.references, &mut points, &target, &limits);
        self.supervise(&step, &force, &measured.tip().translation.vector);
        for (index, _) in arm.indices() {
            if let (Some(target), Some(point)) = (io.targets.joints.get_mut(index), points.get(index)) {
                *target =
                    JointTarget { setpoint: JointSetpoint::Point(*point), feedforward: 0.0, restart: false };
            }
        }
        let index = usize::from(self.settings.gripper.joint);
        let measured = io.measured.positions.get(index).zip(io.measured.velocities.get(index));
        let commanded = io.targets.joints.get_mut(index).zip(io.references.get(index));
        if let (Some((&position, &velocity)), Some((target, &reference))) = (measured, commanded) {
            let effort = io.efforts.effort(index);
            let inertia = io.robot.joints().get(index).map_or(0.0, |joint| joint.inertia);
            let joint = GripperJoint { position, velocity, effort, inertia, reference, target };
            self.gripper.tick(&self.settings.gripper, joint);
        }
        Ok(())
    }

    fn telemetry(&self, robot: &Robot, measured: &Measured, _: &Postures) -> VisualApproachTelemetry {
        let hand = self.arm(robot).map(|arm| to_wire(&pose(&arm.posture(&measured.positions))));
        let opening = measured.positions.get(usize::from(self.settings.gripper.joint));
        VisualApproachTelemetry {
            hand: hand.unwrap_or(Pose::IDENTITY),
            latched: self.latched,
            motion: self.motion,
            remaining: self.remaining,
            force: self.force,
            gripper: self.gripper.state,
            opening: opening.copied().unwrap_or(0.0),
        }
    }
}

impl VisualApproach {
    fn arm<'a>(&self, robot: &'a Robot) -> Option<Arm<'a>> {
        Arm::new(robot, self.settings.chain, self.settings.gripper.joint)
    }

    /// Pose of the hand by the references of the joints.
    fn reference(&self, io: &Io<'_>) -> Isometry3<f32> {
        let arm = self.arm(io.robot);
        arm.map_or_else(Isometry3::identity, |arm| pose(&arm.posture(&angles(io.references))))
    }

    /// Ends a motion against a contact, and says how the hand moves.
    fn supervise(&mut self, step: &Step, force: &Vector3<f32>, hand: &Vector3<f32>) {
        self.remaining = step.remaining;
        let speed = sqrt(step.velocity.norm_squared());
        if self.motion == HandMotion::Blocked {
            return;
        }
        if speed > SLOWEST && force.dot(&step.velocity) < -self.settings.contact_force * speed {
            self.motion = HandMotion::Blocked;
            self.target = (hand - step.velocity * (RETREAT / speed)).into();
            return;
        }
        self.motion = if step.remaining < ARRIVED {
            HandMotion::Standing
        } else if step.limited && speed < SLOWEST {
            HandMotion::Limited
        } else {
            HandMotion::Moving
        };
    }
}

/// A pose of the wire.
fn to_wire(pose: &Isometry3<f32>) -> Pose {
    let turn = pose.rotation.coords;
    Pose { translation: pose.translation.vector.into(), rotation: [turn.x, turn.y, turn.z, turn.w] }
}

/// A rotation of the wire.
fn rotation(&[x, y, z, w]: &[f32; 4]) -> UnitQuaternion<f32> {
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
}
