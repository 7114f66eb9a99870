//! Visual approach: the hand moves to targets from a camera on it, and grips (Knob).
//!
//! ```text
//! latch ──► pose of the hand, when a picture is taken
//! move  ──► straight motion, damped inverse Jacobian ──► limits of motion ──► joint servos
//!                 ▲ stops                                                          │ efforts
//!                 └───────────────── force on the hand ◄───────────────────────────┘
//! grip  ──► gripper
//! ```
//!
//! This is the manipulation module of the paper: it does not process pictures. The leader, the client that
//! guides the hand, sends a [latch](VisualApproachCommand::Latch) when a picture is taken, finds the rose in
//! it, and sends the target of the hand, from [`Approach`](crate::behavior::Approach) or by its own rule.
//! Targets are positions in the base frame: a late or repeated one does no harm.
//!
//! The hand keeps the orientation that it has when the task begins. Its references are computed by the
//! inverse of the Jacobian, as in the paper (`dθ = J⁻¹ [mx my mz 0 0 0]ᵀ`, Knob §4.5), with damping and
//! within the limits of the joints. The motion is continuous: it does not wait for the next picture.
//!
//! A contact that opposes the motion ends it: the reference jumps to the measured position, and the hand
//! retreats by 2 mm. A motion in a direction in which the posture cannot sense forces is ended as well.
//! Targets in the blocked direction are refused until the hand has retreated by 10 mm or the leader
//! [acknowledges](VisualApproachCommand::Acknowledge).

mod contact;
mod gripper;
mod motion;
mod reference;
mod settings;

use nalgebra::{Isometry3, SVector, Translation3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::TICK;
use crate::math::{orientation, sqrt};
use crate::model::{MAX_CHAIN_JOINTS, Pose};
use crate::robot::{ChainConfig, JointTarget, Measured, Postures, Robot};
use crate::signal::MotionLimits;

use contact::{ContactEstimate, Learning, Sense};
pub use gripper::GripperState;
use gripper::{Gripper, GripperJoint};
use motion::{MIN_SHOWN, MotionState};
use reference::{GuidedArm, angles, pose};
pub use settings::{
    GripperSettings, MIN_SPEED, VisualApproachField, VisualApproachRefusal, VisualApproachSettings,
};

/// The hand stands still for at least this time before its first motion, and learns the efforts without
/// contact [s].
const BEFORE_MOTION: f32 = 0.5;

/// Commands of the visual approach. All but the latch may be repeated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum VisualApproachCommand {
    /// 0: a picture is taken now: stores the pose of the hand.
    Latch {
        /// Number of the picture.
        number: u16,
    },
    /// 1: moves the hand on a straight line. After a contact, targets towards it are refused until the hand
    /// has retreated or the contact is acknowledged.
    Move {
        /// Target position, in the base frame [m].
        position: [f32; 3],
        /// Largest speed [m/s]: at least [`MIN_SPEED`].
        speed: f32,
    },
    /// 2: brings the hand to rest. A hand that a contact has stopped completes its retreat.
    Stand,
    /// 3: opens the gripper.
    Open,
    /// 4: closes the gripper and holds an object between the fingers. If there was none, it must open before
    /// it can close again.
    Close,
    /// 5: the leader has noticed the contact that ended a motion: targets towards it are accepted again.
    Acknowledge,
}

/// Motion of the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HandMotion {
    /// 0: it stands at its target: its reference has arrived, and the hand has moved by less than 0.2 mm for
    /// 0.1 s.
    Standing,
    /// 1: it moves.
    Moving,
    /// 2: a contact has ended its motion; the hand waits for another target.
    Blocked,
    /// 3: it stands because limits of the joints hold it back, or because the posture cannot sense a force
    /// against its motion.
    Limited,
}

/// Telemetry of the visual approach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct VisualApproachTelemetry {
    /// Pose of the hand in the base frame, by the measured angles, with the gripper at 0.
    pub hand: Pose,
    /// Number of the last latch, and the pose of the hand at that time.
    pub latched: Option<(u16, Pose)>,
    /// Its motion.
    pub motion: HandMotion,
    /// Distance from the measured hand to the target [m].
    pub remaining: f32,
    /// Force on the hand estimated from the efforts of the joints, in the base frame [N].
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
    /// Pose of the hand when the task began.
    begin: Pose,
    latched: Option<(u16, Pose)>,
    /// Largest speed of the present motion [m/s].
    speed: f32,
    /// Time before the first motion [s], and whether it has begun.
    before_motion: f32,
    has_moved: bool,
    motion: MotionState,
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
        speed: 0.0,
        before_motion: 0.0,
        has_moved: false,
        motion: MotionState::NONE,
        contact: ContactEstimate::NONE,
        force: [0.0; 3],
        gripper: Gripper::STILL,
    };

    fn check(
        robot: &Robot,
        measured: &Measured,
        settings: &VisualApproachSettings,
    ) -> Result<(), VisualApproachRefusal> {
        settings.validate(robot)?;
        // Cannot fail after that.
        let Some(arm) = GuidedArm::new(robot, settings.chain, settings.gripper.joint) else { return Ok(()) };
        let sense = Sense::new(&arm, &arm.posture(&measured.positions));
        if sense.shows(MIN_SHOWN) {
            Ok(())
        } else {
            Err(VisualApproachRefusal::Singular { chain: settings.chain })
        }
    }

    fn begin(&mut self, io: Io<'_>, settings: &VisualApproachSettings) {
        self.settings = *settings;
        let angles = angles(io.references);
        io.targets.servo_mode = settings.servo_mode;
        // Cannot fail: `check` required the chain.
        let Some(arm) = self.arm(io.robot) else { return };
        self.begin = Pose::from(&pose(&arm.posture(&angles)));
        (self.motion.target, self.speed) = (self.begin.translation, settings.speed);
    }

    fn command(&mut self, io: Io<'_>, command: &VisualApproachCommand) -> Result<(), VisualApproachRefusal> {
        match *command {
            VisualApproachCommand::Latch { number } => {
                let arm = self.arm(io.robot);
                let hand = arm.map(|arm| Pose::from(&pose(&arm.posture(&io.measured.positions))));
                self.latched = hand.map(|hand| (number, hand));
            }
            VisualApproachCommand::Move { position, speed } => {
                let distance =
                    (Vector3::from(position) - Vector3::from(self.begin.translation)).norm_squared();
                let (distance, reach) = (sqrt(distance), self.settings.reach);
                // Rejects NaN as well.
                if distance.is_nan() || distance > reach {
                    return Err(VisualApproachRefusal::Target { distance, reach });
                }
                let limit = self.settings.speed;
                if !(MIN_SPEED..=limit).contains(&speed) {
                    return Err(VisualApproachRefusal::Speed { value: speed, limit });
                }
                let place = self.reference(&io).translation.vector;
                self.motion.send(&place, &position.into())?;
                self.speed = speed;
            }
            VisualApproachCommand::Stand => self.motion.stand(&self.resting_place(&io)),
            VisualApproachCommand::Acknowledge => self.motion.acknowledge(),
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
        let sense = Sense::new(&arm, &measured);
        let (learning, limit) = (self.learning(), self.settings.contact_force);
        let force = self.contact.update(&arm, &measured, &sense, io.efforts, learning, limit);
        self.force = force.into();
        if !self.has_moved {
            self.before_motion += TICK;
            self.has_moved = self.before_motion > BEFORE_MOTION && self.motion.motion == HandMotion::Moving;
        }
        let place = if self.has_moved { self.motion.target } else { self.begin.translation };
        let target = Isometry3::from_parts(Translation3::from(place), orientation(self.begin.rotation));
        let speed = self.motion.speed(self.speed, &sense);
        let limits = MotionLimits { speed, acceleration: self.settings.acceleration };
        let mut points = *io.references;
        let step = arm.advance(&mut points, &target, &limits);
        let hand = measured.tip().translation.vector;
        self.motion.measure(&hand);
        if self.has_moved && self.motion.supervise(&step, &hand, &force, &sense, limit) {
            arm.stop(&io.measured.positions, &mut points);
        }
        for (index, _) in arm.indices() {
            if let (Some(target), Some(point)) = (io.targets.joints.get_mut(index), points.get(index)) {
                *target = JointTarget::point(*point);
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
        let hand = self.arm(robot).map(|arm| Pose::from(&pose(&arm.posture(&measured.positions))));
        let opening = measured.positions.get(usize::from(self.settings.gripper.joint));
        VisualApproachTelemetry {
            hand: hand.unwrap_or(Pose::IDENTITY),
            latched: self.latched,
            motion: self.motion.motion,
            remaining: self.motion.remaining,
            force: self.force,
            gripper: self.gripper.state,
            opening: opening.copied().unwrap_or(0.0),
        }
    }
}

impl VisualApproach {
    fn arm<'a>(&self, robot: &'a Robot) -> Option<GuidedArm<'a>> {
        GuidedArm::new(robot, self.settings.chain, self.settings.gripper.joint)
    }

    /// Pose of the hand by the references of the joints.
    fn reference(&self, io: &Io<'_>) -> Isometry3<f32> {
        let arm = self.arm(io.robot);
        arm.map_or_else(Isometry3::identity, |arm| pose(&arm.posture(&angles(io.references))))
    }

    /// Where the hand comes to rest if its motion ends now [m].
    fn resting_place(&self, io: &Io<'_>) -> Vector3<f32> {
        let Some(arm) = self.arm(io.robot) else { return Vector3::zeros() };
        let next = io.references.map(|reference| reference.next());
        let posture = arm.posture(&angles(&next));
        let mut rates = SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        for (index, own) in arm.indices() {
            rates[own] = next[index].velocity;
        }
        let velocity = (arm.jacobian(&posture) * rates).fixed_rows::<3>(0).into_owned();
        let limits = MotionLimits { speed: self.speed, acceleration: self.settings.acceleration };
        posture.tip().translation.vector + limits.way_to_rest(&velocity)
    }

    /// What the force estimate learns in this period: after [`BEFORE_MOTION`] nothing while the hand may
    /// carry a load.
    const fn learning(&self) -> Learning {
        let grips = matches!(
            self.gripper.state,
            GripperState::Closing | GripperState::Holding | GripperState::Jammed
        );
        let is_free =
            matches!(self.gripper.state, GripperState::Still | GripperState::Open | GripperState::Empty);
        match self.motion.motion {
            _ if !self.has_moved && (!grips || self.before_motion <= BEFORE_MOTION) => Learning::Unloaded,
            _ if !is_free || self.motion.is_ended() => Learning::Nothing,
            HandMotion::Standing => Learning::Standing,
            _ => Learning::Moving,
        }
    }
}
