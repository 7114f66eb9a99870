//! Retargeting of an operator's fingertips to a robot hand (Hand5 sections 2.2 and 2.3).
//!
//! All positions are in the frame of the hand (at the wrist), which is the same for operator and robot; the
//! arm positions the wrist. In this order:
//!
//! 1. the thumb's tip follows the operator's, shifted by `d_ini = p_robot,ini − p_human,ini`, so that a hand
//!    of another size keeps its range;
//! 2. the vectors from the *actual* tip of the thumb to the other fingertips follow the operator's: weighted
//!    least squares within the limits of the joints.
//!
//! **Precision pinch.** Where the operator's thumb and a finger come close, exact vectors have priority.
//! Below the gap `far` the error of the finger is weighted relative to the gap, so that the pinching finger
//! determines the joint that the fingers share. From `far` to `near` the distance between the tips is blended
//! to that of the robot's surfaces, and the thumb yields if the finger cannot reach it. Both use the smooth
//! step `β = 3x² − 2x³` of the gap, so that no target jumps. Where the operator's tips are much nearer to
//! each other than the robot's can be, their direction is noise: that between the robot's tips replaces it.

use core::fmt;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::RetargetSettings;
use crate::kinematics::{Angles, FingertipTarget, FingertipTargets, Hand, HandOptions, MAX_FINGERS};
use crate::math::{self, abs};
use crate::model::MAX_JOINTS;

/// Added to the gap between thumb and finger in the weight of the finger, to bound the weight [m].
const SMALLEST_GAP: f32 = 5e-4;
/// A vector follows the operator's up to this multiple of the scale; beyond it, its direction is held back
/// towards the present one.
const STEEPEST: f32 = 4.0;
/// Maximum number of times that the thumb yields in a step.
const MAX_YIELDS: u8 = 8;
/// Maximum iterations of the inverse kinematics after the thumb has yielded, which is a small step.
const YIELD_ITERATIONS: u8 = 3;
/// [`RetargetState::budget`] with which a step fits into a control period.
const NEARBY_BUDGET: u16 = 28;
/// The thumb yields again only if at least this number of evaluations is left.
const YIELD_EVALUATIONS: u16 = 10;
/// The thumb yields to a pinching finger that misses it by more than this [m].
const YIELD_ERROR: f32 = 5e-5;
/// Maximum coordinate of an operator's fingertip [m].
pub(crate) const MAX_COORDINATE: f32 = 1.0;

/// The operator's fingertips, thumb to little finger, in the frame of the hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OperatorFingertips {
    /// Positions [m]; `None` for a tip that is currently unknown.
    pub positions: [Option<Vector3<f32>>; MAX_FINGERS],
    /// Directions in which the tips point, unit vectors.
    pub directions: [Option<Vector3<f32>>; MAX_FINGERS],
}

/// A fingertip of the operator that is not finite, or a coordinate of which is beyond 1 m, or whose direction
/// is not a unit vector. The state is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidFingertip {
    /// The operator's finger: 0 is the thumb.
    pub finger: u8,
}

/// Result of a step of retargeting.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RetargetReport {
    /// Errors at the output angles [m]: target minus tip for the thumb, target minus vector from the thumb's
    /// tip for each other finger; 0 for fingers without target.
    pub errors: [Vector3<f32>; MAX_FINGERS],
    /// Bit `i`: finger `i` has a target and does not reproduce it within the tolerance.
    pub missed: u8,
    /// Bit `i`: the speed limit holds back actuated joint `i`.
    pub limited: u16,
    /// Number of evaluations of a finger's kinematics.
    pub evaluations: u16,
}

impl RetargetReport {
    /// Distance of a finger from its target [m].
    pub fn distance(&self, finger: usize) -> f32 {
        self.errors.get(finger).map_or(0.0, math::norm)
    }
}

/// State of a [`Retargeting`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RetargetState {
    /// Solution of the last step [rad]: the next search starts there.
    solution: [f32; MAX_JOINTS],
    /// Last output angles [rad].
    output: [f32; MAX_JOINTS],
    /// `d_ini` [m].
    offset: [f32; 3],
    /// Last known position of the operator's thumb [m].
    thumb: Option<[f32; 3]>,
    /// Whether the multi-start search of the first step is done, or is skipped.
    begun: bool,
    /// Maximum number of evaluations of a finger's kinematics in a step; the next step continues the
    /// search.
    budget: u16,
}

impl RetargetState {
    /// Angles of the actuated joints [rad].
    pub fn angles(&self) -> Angles {
        self.output.into()
    }
}

/// The mapping from an operator's hand to a robot hand of two to five fingers, under settings that
/// [`RetargetSettings::validate`] accepts. The thumb is solved first. If it [shares](Hand::shared) a joint
/// with other fingers, these may move it afterwards, and its reported error is then not the final one.
#[derive(Clone, Copy, Debug)]
pub struct Retargeting<'a> {
    /// The hand. Its first finger is the thumb.
    pub hand: &'a Hand,
    /// The settings.
    pub settings: &'a RetargetSettings,
}

/// A finger's target relative to the thumb.
#[derive(Clone, Copy)]
struct RelativeTarget {
    /// From the thumb's tip to the finger's [m].
    vector: Vector3<f32>,
    /// Degree of pinch, 0 to 1.
    pinch: f32,
    weight: f32,
    direction: Option<Vector3<f32>>,
}

impl Retargeting<'_> {
    /// `d_ini` for the initial postures of robot and operator, by the angles of the actuated joints [rad] and
    /// the position of the operator's thumb [m] (Hand5 section 2.2).
    pub fn initial_offset(&self, robot: &Angles, operator: &Vector3<f32>) -> Vector3<f32> {
        self.hand.tip(0, robot).map_or_else(Vector3::zeros, |(tip, _)| tip - operator * self.settings.scale)
    }

    /// The state of a hand that stands at `angles` [rad], with `d_ini` [m].
    pub fn begin(&self, angles: &Angles, offset: &Vector3<f32>) -> RetargetState {
        let mut angles = *angles;
        for angle in angles.iter_mut().filter(|angle| !angle.is_finite()) {
            *angle = 0.0;
        }
        self.hand.limit(&mut angles);
        let [solution, output] = [angles.into(); 2];
        RetargetState {
            solution,
            output,
            offset: (*offset).into(),
            thumb: None,
            begun: false,
            budget: u16::MAX,
        }
    }

    /// As [`begin`](Self::begin), but for use within a control period: only the nearest solution is searched,
    /// and each step ends after a number of evaluations; the next one continues.
    pub fn begin_nearby(&self, angles: &Angles, offset: &Vector3<f32>) -> RetargetState {
        RetargetState { begun: true, budget: NEARBY_BUDGET, ..self.begin(angles, offset) }
    }

    /// Moves the hand towards the operator's fingertips as far as the limits allow within `period` [s]. A
    /// finger whose tip is unknown keeps the joints that it does not share.
    ///
    /// # Errors
    /// A fingertip is invalid.
    pub fn update(
        &self,
        state: &mut RetargetState,
        operator: &OperatorFingertips,
        period: f32,
    ) -> Result<RetargetReport, InvalidFingertip> {
        check(operator)?;
        let mut report = RetargetReport::default();
        let RetargetSettings { scale, .. } = &self.settings;
        let given = operator.positions[0].is_some();
        state.thumb = operator.positions[0].map(Into::into).or(state.thumb);
        let vectors = self.vectors(state.thumb.map(Vector3::from), operator, &state.output, &mut report);
        let wish = operator.positions[0].map(|thumb| thumb * *scale + Vector3::from(state.offset));
        let mut thumb_target = wish;
        let before = state.output;
        for round in 0..=MAX_YIELDS {
            let mut options = HandOptions::default();
            if round > 0 {
                options.iterations = YIELD_ITERATIONS;
            }
            let left = state.budget.saturating_sub(report.evaluations);
            // The four fingers need more than the thumb, which gets 3/8 of `left` (computed without
            // overflow).
            options.evaluations = left / 8 * 3 + left % 8 * 3 / 8;
            let yielded = self.solve_thumb(state, thumb_target, operator, &options, &mut report);
            // The vectors start at the next position of the thumb.
            state.output = before;
            report.limited = 0;
            self.limit_speed(state, &before, 0..1, period, &mut report);
            let thumb = if report.limited == 0 { yielded } else { self.tip(0, &state.output) };
            report.errors[0] = wish.map_or_else(Vector3::zeros, |wish| wish - thumb);
            options.evaluations = state.budget.saturating_sub(report.evaluations);
            let missed = self.solve_fingers(state, &thumb, &vectors, &options, &mut report);
            state.begun |= given;
            // The thumb yields towards the pinching fingers, while evaluations are left.
            let enough = round == MAX_YIELDS
                || report.limited != 0
                || report.evaluations.saturating_add(YIELD_EVALUATIONS) > state.budget;
            if enough || math::norm(&missed) < YIELD_ERROR {
                break;
            }
            // Accumulated, so that a thumb at the limit of its reach slides along it.
            thumb_target = thumb_target.map(|target| target - missed);
        }
        self.limit_speed(state, &before, 1..self.hand.len(), period, &mut report);
        if report.limited != 0 {
            self.measure(state, &vectors, &mut report);
        }
        for finger in 0..MAX_FINGERS {
            if report.distance(finger) > self.settings.tolerance {
                report.missed |= 1 << finger;
            }
        }
        Ok(report)
    }

    fn tip(&self, finger: usize, angles: &[f32; MAX_JOINTS]) -> Vector3<f32> {
        self.hand.tip(finger, &Angles::from(*angles)).map_or_else(Vector3::zeros, |(tip, _)| tip)
    }

    /// Targets of the robot's fingers, whose joints are at `output` [rad]: vectors from the thumb's tip.
    fn vectors(
        &self,
        thumb: Option<Vector3<f32>>,
        operator: &OperatorFingertips,
        output: &[f32; MAX_JOINTS],
        report: &mut RetargetReport,
    ) -> [Option<RelativeTarget>; MAX_FINGERS] {
        let RetargetSettings { scale, near, far, operator_contact, robot_contact, .. } = *self.settings;
        let mut of_finger = |finger: usize| {
            let follows = usize::from(*self.settings.follows.get(finger)?);
            let weight = *self.settings.weights.get(finger)?;
            let position = (*operator.positions.get(follows)?)?;
            let between = position - thumb?;
            let length = math::norm(&between);
            let gap = math::clamp(length - operator_contact, 0.0, far);
            // Errors are weighted relative to the gap: millimetres matter where the tips are millimetres
            // apart.
            let ratio = (far + SMALLEST_GAP) / (gap + SMALLEST_GAP);
            let x = math::clamp((far - gap) / (far - near), 0.0, 1.0);
            let pinch = x * x * (3.0 - 2.0 * x);
            let distance = (scale * length + pinch * (robot_contact - scale * operator_contact)).max(0.0);
            let held_back = distance / (STEEPEST * scale) - length;
            let toward = if held_back > 0.0 {
                report.evaluations = report.evaluations.saturating_add(2);
                between + direction(&(self.tip(finger, output) - self.tip(0, output))) * held_back
            } else {
                between
            };
            let size = math::norm(&toward);
            let factor = if size > 1e-6 { distance / size } else { scale };
            let pointing = operator.directions.get(follows).copied().flatten();
            Some(RelativeTarget {
                vector: toward * factor,
                pinch,
                weight: weight * ratio * ratio,
                direction: pointing.filter(|_| self.settings.directions),
            })
        };
        core::array::from_fn(
            |finger| {
                if finger == 0 || finger >= self.hand.len() { None } else { of_finger(finger) }
            },
        )
    }

    /// Solves the thumb for its target. Returns the position of its tip [m].
    fn solve_thumb(
        &self,
        state: &mut RetargetState,
        target: Option<Vector3<f32>>,
        operator: &OperatorFingertips,
        options: &HandOptions,
        report: &mut RetargetReport,
    ) -> Vector3<f32> {
        let Some(position) = target else { return self.tip(0, &state.solution) };
        let direction = operator.directions[0].filter(|_| self.settings.directions);
        let mut targets = FingertipTargets::default();
        targets[0] = Some(FingertipTarget { position, weight: 1.0, direction });
        position - self.solve(state, &targets, options, report)[0]
    }

    /// Solves the fingers for their vectors from `thumb` and reports their errors. Returns the weighted mean
    /// error of the pinching ones [m].
    fn solve_fingers(
        &self,
        state: &mut RetargetState,
        thumb: &Vector3<f32>,
        vectors: &[Option<RelativeTarget>; MAX_FINGERS],
        options: &HandOptions,
        report: &mut RetargetReport,
    ) -> Vector3<f32> {
        let targets = vectors.map(|vector| {
            let RelativeTarget { vector, weight, direction, .. } = vector?;
            Some(FingertipTarget { position: thumb + vector, weight, direction })
        });
        let errors = self.solve(state, &targets, options, report);
        let (mut sum, mut total, mut max) = (Vector3::zeros(), 0.0, 0.0_f32);
        for ((vector, error), place) in vectors.iter().zip(&errors).zip(&mut report.errors) {
            let Some(vector) = vector else { continue };
            *place = *error;
            sum += error * (vector.weight * vector.pinch);
            total += vector.weight * vector.pinch;
            max = max.max(vector.pinch);
        }
        if total > 0.0 { sum * (max / total) } else { sum }
    }

    fn solve(
        &self,
        state: &mut RetargetState,
        targets: &FingertipTargets,
        options: &HandOptions,
        report: &mut RetargetReport,
    ) -> [Vector3<f32>; MAX_FINGERS] {
        let mut angles = Angles::from(state.solution);
        let solved = if state.begun {
            self.hand.solve(targets, options, &mut angles)
        } else {
            self.hand.search(targets, options, &mut angles)
        };
        state.solution = angles.into();
        report.evaluations = report.evaluations.saturating_add(solved.evaluations);
        solved.errors
    }

    /// Moves the output of the joints of `fingers` from `before` [rad] towards the solution within their
    /// speed limits.
    fn limit_speed(
        &self,
        state: &mut RetargetState,
        before: &[f32; MAX_JOINTS],
        fingers: core::ops::Range<usize>,
        period: f32,
        report: &mut RetargetReport,
    ) {
        // The shared joint occurs in several fingers, but moves once.
        for &joint in fingers.flat_map(|finger| self.hand.actuated(finger)) {
            let (index, bit) = (usize::from(joint), 1 << joint);
            let largest = self.settings.speeds.get(index).copied().unwrap_or(0.0) * period.max(0.0);
            let (Some(&solution), Some(&before), Some(output)) =
                (state.solution.get(index), before.get(index), state.output.get_mut(index))
            else {
                continue;
            };
            let step = solution - before;
            if abs(step) <= largest {
                *output = solution;
            } else {
                *output = before + math::clamp(step, -largest, largest);
                report.limited |= bit;
            }
        }
    }

    /// Computes the errors of the fingers at output angles that differ from the solution because of speed
    /// limits.
    fn measure(
        &self,
        state: &RetargetState,
        vectors: &[Option<RelativeTarget>; MAX_FINGERS],
        report: &mut RetargetReport,
    ) {
        let thumb = self.tip(0, &state.output);
        for (finger, (error, vector)) in report.errors.iter_mut().zip(vectors).enumerate().skip(1) {
            if let Some(vector) = vector {
                *error = vector.vector - (self.tip(finger, &state.output) - thumb);
            }
        }
    }
}

fn check(operator: &OperatorFingertips) -> Result<(), InvalidFingertip> {
    for (finger, (position, direction)) in (0..).zip(operator.positions.iter().zip(&operator.directions)) {
        if !(position.as_ref().is_none_or(is_near) && direction.as_ref().is_none_or(is_unit)) {
            return Err(InvalidFingertip { finger });
        }
    }
    Ok(())
}

/// The unit vector along `vector`; 0 of 0.
fn direction(vector: &Vector3<f32>) -> Vector3<f32> {
    let length = math::norm(vector);
    if length > 0.0 { vector / length } else { Vector3::zeros() }
}

/// Whether each coordinate of a position [m] is one of a hand's.
pub(crate) fn is_near(position: &Vector3<f32>) -> bool {
    position.iter().all(|value| abs(*value) <= MAX_COORDINATE)
}

/// Whether a direction is a unit vector.
pub(crate) fn is_unit(direction: &Vector3<f32>) -> bool {
    abs(direction.norm_squared() - 1.0) < 1e-2
}

impl fmt::Display for InvalidFingertip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "finger {} of the operator: the coordinates of its tip must be at most {MAX_COORDINATE} m, its direction \
             a unit vector",
            self.finger + 1
        )
    }
}

impl core::error::Error for InvalidFingertip {}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_possible_truncation, reason = "tests")]
#[path = "retarget_tests.rs"]
mod tests;
