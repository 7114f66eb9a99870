//! Telexistence: a hand reproduces the fingertips of an operator (Hand5).
//!
//! ```text
//! samples ──► fingertips of the operator ──► retargeting ──► limits of motion ──► joint servos
//!             (extrapolated between samples)  (Hand5 §2.2)
//! ```
//!
//! The first sample with a thumb defines the offset `d_ini`, so that the robot's thumb stays where it is.
//! Lost and late samples are bridged: a fingertip is extrapolated with its velocity for
//! [`MAX_EXTRAPOLATION`], then it stays, and after the maximum age in the settings the joints of its finger
//! stay. The references of the joints keep their limits of angle, speed and acceleration whatever samples
//! arrive.

mod fingertips;
mod settings;

use core::fmt;

use nalgebra::Vector1;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::api::{Io, Task, TaskFault};
use crate::TICK;
use crate::control::JointPoint;
use crate::kinematics::{Angles, Hand, MAX_FINGERS};
use crate::math;
use crate::model::MAX_JOINTS;
use crate::robot::{Concerns, JointTarget, Measured, Postures, Robot};
use crate::signal::{MotionLimits, MotionTarget};
use crate::teleop::{RetargetReport, RetargetState, Retargeting};

use fingertips::Fingertips;
pub use fingertips::{FingertipPoint, FingertipSample, MAX_EXTRAPOLATION};
use settings::REVERSING_LAG;
pub use settings::{InvalidTelexistenceSettings, TelexistenceSettings};

/// Pole `e^(−ω·T)` of the filter of the joints' motion, with `ω` = 25 rad/s: it passes the motion of fingers,
/// but not most of a glove's noise, which nearly straight fingers amplify.
const DECAY: f32 = 0.778_801;

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
    /// 0: the robot is not a hand of two to five fingers.
    NotAHand,
    /// 1: a setting is invalid.
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
                "finger {} of the operator: the coordinates of its tip must be within 1 m and slower than 20 m/s, \
                 its direction a unit vector",
                finger + 1
            ),
            Self::Age { value } => write!(f, "the age of the sample is {value} s; it must be 0 to 1 s"),
        }
    }
}

impl core::error::Error for TelexistenceRefusal {}

/// Telemetry of telexistence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct TelexistenceTelemetry {
    /// Samples that were taken over.
    pub samples: u32,
    /// Samples that were repeated, or arrived after a newer one.
    pub ignored: u32,
    /// Ticks since the last sample, or since the task began if there was none, at most 255.
    pub age: u8,
    /// Distance of each fingertip of the hand from its target [m]; for all but the thumb, of the vector from
    /// the thumb's tip.
    pub errors: [f32; MAX_FINGERS],
    /// Bit `i`: finger `i` does not reproduce its target within the tolerance.
    pub missed: u8,
    /// Bit `i`: the operator's finger `i` is not known.
    pub unknown: u8,
    /// Bit `i`: the speed limit holds back joint `i`.
    pub limited: u16,
}

/// The task.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Telexistence {
    settings: TelexistenceSettings,
    fingertips: Fingertips,
    /// `None` until the first sample with a thumb after the start or a release.
    retargeting: Option<RetargetState>,
    /// Smoothed motion of the joints for the fingertips.
    motion: [JointEstimate; MAX_JOINTS],
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
        motion: [JointEstimate { angle: 0.0, velocity: 0.0 }; MAX_JOINTS],
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
        self.settings.limit_speeds(io.robot.joints().iter().map(|joint| joint.limits.velocity));
        let angles = angles(&io);
        self.motion = angles.map(JointEstimate::at_rest);
        io.targets.servo_mode = settings.servo_mode;
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
                let joints = io.references.iter().zip(&mut self.motion);
                for ((reference, estimate), &speed) in joints.zip(&self.settings.retargeting.speeds) {
                    let (limits, next) = (joint_limits(&self.settings, speed), reference.next());
                    let way = limits.way_to_rest(&Vector1::new(next.velocity)).x;
                    *estimate = JointEstimate::at_rest(next.position + way);
                }
            }
        }
        Ok(())
    }

    #[inline(never)]
    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        // Cannot fail: `check` required a hand.
        let Some(hand) = io.robot.hand() else { return Ok(()) };
        self.fingertips.advance(self.settings.max_sample_age);
        let report = self.retarget(hand, &io);
        self.telemetry.limited = report.limited;
        self.telemetry.missed = report.missed;
        self.telemetry.age = self.fingertips.age();
        self.telemetry.unknown = self.fingertips.unknown();
        for (finger, error) in self.telemetry.errors.iter_mut().enumerate() {
            *error = report.distance(finger);
        }
        let limits = hand.limits().iter().zip(&self.settings.retargeting.speeds);
        let joints = io.targets.joints.iter_mut().zip(io.references);
        for ((target, reference), ((&range, &speed), estimate)) in joints.zip(limits.zip(&self.motion)) {
            let limits = joint_limits(&self.settings, speed);
            let point = next(&limits, range, reference, estimate);
            *target = JointTarget::point(point);
        }
        Ok(())
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) -> TelexistenceTelemetry {
        self.telemetry
    }
}

impl Telexistence {
    /// Updates the retargeting solution with the operator's fingertips.
    fn retarget(&mut self, hand: &Hand, io: &Io<'_>) -> RetargetReport {
        let operator = self.fingertips.present();
        let retargeting = Retargeting { hand, settings: &self.settings.retargeting };
        if self.retargeting.is_none()
            && let Some(thumb) = &operator.positions[0]
        {
            let angles = Angles::from(angles(io));
            let offset = retargeting.initial_offset(&angles, thumb);
            self.retargeting = Some(retargeting.begin_nearby(&angles, &offset));
        }
        let Some(state) = &mut self.retargeting else { return RetargetReport::default() };
        // Cannot fail: samples are valid, and so are their extrapolations.
        let report = retargeting.update(state, &operator, TICK).unwrap_or_default();
        for (estimate, angle) in self.motion.iter_mut().zip(&state.angles()) {
            estimate.update(*angle);
        }
        report
    }
}

/// Estimate of a joint's motion from the solutions: an alpha-beta filter with a double pole at [`DECAY`],
/// which follows a constant velocity without delay.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
struct JointEstimate {
    /// [rad]
    angle: f32,
    /// [rad/s]
    velocity: f32,
}

impl JointEstimate {
    const fn at_rest(angle: f32) -> Self {
        Self { angle, velocity: 0.0 }
    }

    /// Updates the estimate with the solution of the next tick [rad].
    fn update(&mut self, solution: f32) {
        let predicted = self.angle + self.velocity * TICK;
        let innovation = solution - predicted;
        self.angle = predicted + (1.0 - DECAY * DECAY) * innovation;
        self.velocity += (1.0 - DECAY) * (1.0 - DECAY) / TICK * innovation;
    }
}

/// Limits of the motion of a joint with this maximum `speed` [rad/s].
fn joint_limits(settings: &TelexistenceSettings, speed: f32) -> MotionLimits {
    // `limit_speeds` leaves at least as much margin above the speed.
    MotionLimits { speed, acceleration: settings.acceleration.min(speed / REVERSING_LAG) }
}

/// The references of the joints [rad].
fn angles(io: &Io<'_>) -> [f32; MAX_JOINTS] {
    let mut angles = [0.0; MAX_JOINTS];
    for ((angle, reference), _) in angles.iter_mut().zip(io.references).zip(io.robot.joints()) {
        *angle = reference.position;
    }
    angles
}

/// The reference one period after `reference` that follows the estimated motion: position and velocity at the
/// start of the period, and its acceleration within the limits.
fn next(
    limits: &MotionLimits,
    (lower, upper): (f32, f32),
    reference: &JointPoint,
    estimate: &JointEstimate,
) -> JointPoint {
    let before = reference.position;
    let mut point = reference.next();
    // A joint that begins outside its limits returns without a jump.
    point.position = math::clamp(point.position, lower.min(before), upper.max(before));
    let now = point.velocity;
    let target = MotionTarget {
        offset: Vector1::new(estimate.angle - point.position),
        velocity: Vector1::new(estimate.velocity),
        acceleration: Vector1::zeros(),
    };
    let desired = limits.acceleration(&Vector1::new(now), &target).x;
    let [down, up] = point.stopping_speeds([lower, upper], limits.acceleration);
    point.acceleration = (math::clamp(now + desired * TICK, -down, up) - now) / TICK;
    point
}
