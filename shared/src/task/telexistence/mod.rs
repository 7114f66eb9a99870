//! Telexistence: a hand reproduces the fingertips of an operator (Hand5).
//!
//! ```text
//! samples ──► fingertips of the operator ──► retargeting ──► limits of motion ──► joint servos
//!             (extrapolated between samples)  (Hand5 §2.2)
//! ```
//!
//! The first sample with a thumb defines the offset `d_ini`, so that the robot's thumb stays where it is. Lost
//! and late samples are bridged: a fingertip goes on with its velocity for [`MAX_EXTRAPOLATION`], then it
//! waits, and after the time of the settings its finger keeps its joints. The references of the joints keep
//! limits of angle, speed and acceleration whatever comes.

mod fingertips;
mod settings;

use core::fmt;

use nalgebra::{Vector1, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::TICK;
use crate::control::JointPoint;
use crate::kinematics::{Angles, Hand, MAX_FINGERS};
use crate::math;
use crate::model::MAX_JOINTS;
use crate::robot::{Actuation, Concerns, JointSetpoint, JointTarget, Measured, Postures, Robot};
use crate::teleop::{MotionLimits, MotionTarget, RetargetReport, RetargetState, Retargeting};

use fingertips::Fingertips;
pub use fingertips::{FingertipPoint, FingertipSample, MAX_EXTRAPOLATION};
pub use settings::{InvalidTelexistenceSettings, TelexistenceSettings};

/// Fraction of a joint's velocity limit that its reference uses. The rest is a margin for tracking.
const SPEED_FRACTION: f32 = 0.8;

/// Commands of telexistence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[expect(clippy::large_enum_variant, reason = "almost every command is a sample")]
pub enum TelexistenceCommand {
    /// 0: the operator's fingertips. May be repeated: a sample that is not newer than the last is counted and
    /// ignored.
    Follow(FingertipSample),
    /// 1: opens the clutch: the hand stays, and the next sample defines a new offset.
    Release,
}

/// Why telexistence refuses its settings or a command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TelexistenceRefusal {
    /// 0: the robot is no hand of two to five fingers.
    NotAHand,
    /// 1: a setting.
    Settings(InvalidTelexistenceSettings),
    /// 2: the tip of one of the operator's fingers is not finite or too far from the wrist, its velocity too
    /// large, or its direction no unit vector.
    Fingertip {
        /// The operator's finger: 0 is the thumb.
        finger: u8,
    },
    /// 3: the age of a sample is negative, not finite, or more than a second [s].
    Age {
        /// The age.
        value: f32,
    },
}

impl Concerns for TelexistenceRefusal {}

impl fmt::Display for TelexistenceRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAHand => f.write_str(
                "the robot is no hand: telexistence needs two to five chains, and at most one joint that moves \
                 several of them",
            ),
            Self::Settings(invalid) => invalid.fmt(f),
            Self::Fingertip { finger } => write!(
                f,
                "finger {finger} of the operator: its tip must be within 1 m of the wrist and slower than 20 m/s, \
                 its direction a unit vector"
            ),
            Self::Age { value } => write!(f, "the age of the sample is {value} s; it must be 0 to 1 s"),
        }
    }
}

/// What became of the operator's fingertips.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct TelexistenceTelemetry {
    /// Samples that were taken over.
    pub samples: u32,
    /// Samples that were repeated, or arrived after a newer one.
    pub ignored: u32,
    /// Ticks since the last sample, at most 255.
    pub age: u8,
    /// How far each finger of the hand is from its target [m]; for all but the thumb, of the vector from the
    /// thumb's tip.
    pub errors: [f32; MAX_FINGERS],
    /// Bit `i`: finger `i` does not reproduce its target within the tolerance.
    pub missed: u8,
    /// Bit `i`: the operator's finger `i` is not known.
    pub unknown: u8,
    /// Bit `i`: the limits of motion hold back joint `i`.
    pub limited: u16,
}

/// The task.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Telexistence {
    settings: TelexistenceSettings,
    fingertips: Fingertips,
    /// `None` until the first sample with a thumb after the begin or a release.
    retargeting: Option<RetargetState>,
    /// Joint angles that the fingertips need, in the last tick [rad].
    solution: [f32; MAX_JOINTS],
    telemetry: TelexistenceTelemetry,
}

impl Task for Telexistence {
    type Config = TelexistenceSettings;
    type Command = TelexistenceCommand;
    type Telemetry = TelexistenceTelemetry;
    type Refusal = TelexistenceRefusal;
    const IDLE: Self = Self {
        settings: TelexistenceSettings::DEFAULT,
        fingertips: Fingertips::NONE,
        retargeting: None,
        solution: [0.0; MAX_JOINTS],
        telemetry: TelexistenceTelemetry {
            samples: 0,
            ignored: 0,
            age: 0,
            errors: [0.0; MAX_FINGERS],
            missed: 0,
            unknown: 0,
            limited: 0,
        },
    };

    fn check(
        robot: &Robot,
        _: &Measured,
        settings: &TelexistenceSettings,
    ) -> Result<(), TelexistenceRefusal> {
        let hand = robot.hand().ok_or(TelexistenceRefusal::NotAHand)?;
        settings.validate(hand).map_err(TelexistenceRefusal::Settings)
    }

    fn begin(&mut self, io: Io<'_>, settings: &TelexistenceSettings) {
        self.settings = *settings;
        for (speed, joint) in self.settings.retargeting.speeds.iter_mut().zip(io.robot.joints()) {
            *speed = speed.min(SPEED_FRACTION * joint.limits.velocity);
        }
        self.solution = angles(&io);
        io.targets.servo_mode = settings.servo_mode;
        io.targets.actuation = Actuation::Servo;
        io.targets.stand_at(&self.solution);
    }

    fn command(&mut self, io: Io<'_>, command: &TelexistenceCommand) -> Result<(), TelexistenceRefusal> {
        match command {
            TelexistenceCommand::Follow(sample) => {
                sample.validate()?;
                if self.fingertips.take(sample) {
                    self.telemetry.samples = self.telemetry.samples.wrapping_add(1);
                } else {
                    self.telemetry.ignored = self.telemetry.ignored.wrapping_add(1);
                }
            }
            TelexistenceCommand::Release => {
                self.fingertips.forget();
                self.retargeting = None;
                self.solution = angles(&io);
            }
        }
        Ok(())
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // Cannot fail: `check` required a hand.
        let Some(hand) = io.robot.hand() else { return Ok(()) };
        self.fingertips.advance(self.settings.max_sample_age);
        let before = self.solution;
        let report = self.retarget(hand, &io);
        self.telemetry.limited = report.limited;
        self.telemetry.missed = report.missed;
        self.telemetry.age = self.fingertips.age();
        self.telemetry.unknown = self.fingertips.unknown();
        for (finger, error) in self.telemetry.errors.iter_mut().enumerate() {
            *error = report.distance(finger);
        }
        let limits = hand.limits().iter().zip(&self.settings.retargeting.speeds);
        let solutions = limits.zip(self.solution.iter().zip(&before));
        let joints = io.targets.joints.iter_mut().zip(io.references);
        for ((target, reference), ((&range, &speed), (&solution, &before))) in joints.zip(solutions) {
            let limits = MotionLimits { speed, acceleration: self.settings.acceleration };
            let point = next(&limits, range, reference, solution, (solution - before) / TICK);
            *target = JointTarget { setpoint: JointSetpoint::Point(point), feedforward: 0.0, restart: false };
        }
        Ok(())
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) -> TelexistenceTelemetry {
        self.telemetry
    }
}

impl Telexistence {
    /// Moves the solution to the operator's fingertips.
    fn retarget(&mut self, hand: &Hand, io: &Io<'_>) -> RetargetReport {
        let operator = self.fingertips.present();
        let retargeting = Retargeting { hand, settings: &self.settings.retargeting };
        if self.retargeting.is_none()
            && let Some(thumb) = &operator.positions[0]
        {
            let angles = Angles::from(angles(io));
            self.retargeting = Some(retargeting.begin(&angles, &retargeting.initial_offset(&angles, thumb)));
        }
        let Some(state) = &mut self.retargeting else { return RetargetReport::default() };
        // Samples are valid, and so is what they are extrapolated to.
        let report = retargeting.update(state, &operator, TICK).unwrap_or_default();
        self.solution = state.angles().into();
        report
    }
}

/// The references of the joints [rad].
fn angles(io: &Io<'_>) -> [f32; MAX_JOINTS] {
    let mut angles = [0.0; MAX_JOINTS];
    for ((angle, reference), _) in angles.iter_mut().zip(io.references).zip(io.robot.joints()) {
        *angle = reference.position;
    }
    angles
}

/// The reference after `reference` on the way to a `target` with a `velocity`, within the limits.
fn next(
    limits: &MotionLimits,
    (lower, upper): (f32, f32),
    reference: &JointPoint,
    target: f32,
    velocity: f32,
) -> JointPoint {
    let target = MotionTarget {
        offset: Vector1::new(target - reference.position),
        velocity: Vector1::new(velocity),
        acceleration: Vector1::zeros(),
    };
    let desired = limits.acceleration(&Vector1::new(reference.velocity), &target).x;
    // The speed `v` from which half of the acceleration `a` brakes before the limit of the angle, after one more
    // period: v T + v²/a = space.
    let lag = 0.5 * limits.acceleration * TICK;
    let room = |space: f32| math::sqrt(lag * lag + limits.acceleration * space.max(0.0)) - lag;
    let (down, up) = (room(reference.position - lower), room(upper - reference.position));
    let velocity = math::clamp(reference.velocity + desired * TICK, -down, up);
    let acceleration = (velocity - reference.velocity) / TICK;
    let position = reference.position + 0.5 * (reference.velocity + velocity) * TICK;
    JointPoint { position: math::clamp(position, lower, upper), velocity, acceleration }
}

/// A vector of the wire.
fn vector(values: &[f32; 3]) -> Vector3<f32> {
    Vector3::from(*values)
}
