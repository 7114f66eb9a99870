//! Inverse kinematics of a [`Hand`]: the weighted least squares of all fingertips under joint limits.
//!
//! The cost is `Σ wᵢ (½‖eᵢ‖² + μᵢ sᵢ)` with the position errors `e` and the secondary objective `s`: the
//! distance from the middle of the joints' ranges, or the deviation of the fingertip's direction. Its weight
//! `μ` is so small that it only resolves the redundancy. The minimum is found by Newton's method with the
//! exact Hessian, which for a serial chain costs one cross product per pair of joints:
//! `∂²p/∂qᵢ∂qⱼ = aᵢ × (aⱼ × (p − oⱼ))`, `i ≤ j`. It converges quadratically even for targets out of reach,
//! where Gauss–Newton does not. Joints at a limit beyond which the cost falls are fixed (projected Newton
//! method, Bertsekas 1982), and a step that raises the cost is repeated with Levenberg's damping.
//!
//! With one joint that several fingers share, the Hessian is an arrow matrix: each finger has its own block,
//! and only the last row couples them. The Schur complement of that row is a scalar, so the cost of a step
//! grows linearly with the number of fingers.

use heapless::Vec;
use nalgebra::Vector3;

use super::hand::{Angles, FingerPosture, Hand, HandFinger, MAX_FINGERS, angle, set_angle};
use super::hand_step::TERTIARY;
use super::inverse::MAX_DISTANCE;
use crate::OutOfRange;
use crate::math::{self, abs};

/// Factor of `μ` in the first iterations for directions.
const EMPHASIS: f32 = 1e3;
/// An undamped step below this ends the iterations [rad]: the remaining error is of the order of its square.
const CONVERGED: f32 = 1e-2;
/// Damping below this counts as none, over the squared length of the finger.
const MIN_DAMPING: f32 = 1e-3;
/// First damping after a step that raised the cost, over the squared length of the finger.
const FIRST_DAMPING: f32 = 3e-3;
/// The same in the last iterations, which follow a narrow valley where the finger is nearly stretched.
const FIRST_FINAL_DAMPING: f32 = 1e-5;
/// Iterations end after one that changes the cost by a smaller fraction.
const STALLED: f32 = 1e-3;
/// The last iterations ignore errors above this [m]: the tip is out of reach.
const FINAL_RANGE: f32 = 2e-3;
/// Maximum number of the last iterations.
const FINAL_ITERATIONS: usize = 10;
/// A first solution is computed without the secondary objective if no tip is farther than this from its
/// target, over the length of its finger.
const NEARBY: f32 = 0.3;
/// Maximum number of these iterations.
const NEARBY_ITERATIONS: usize = 4;
/// The exact Hessian is used if the squared cosine between the error and its reducible part is below this.
const IRREDUCIBLE: f32 = 0.1;
/// A search ends when the direction error is below this [rad²/2].
const DIRECTION_TOLERANCE: f32 = 6e-6;

/// Target of a fingertip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingertipTarget {
    /// Position [m], in the frame of the hand.
    pub position: Vector3<f32>,
    /// Weight of the square of its error, above 0.
    pub weight: f32,
    /// Direction of the fingertip, a unit vector, followed as far as the position leaves it free. Without it
    /// the joints tend to the middle of their ranges.
    pub direction: Option<Vector3<f32>>,
}

/// Targets of the fingers of a [`Hand`], in its order. A finger without target keeps its own joints.
pub type FingertipTargets = [Option<FingertipTarget>; MAX_FINGERS];

/// Tolerance and iteration limits of the inverse kinematics of a [`Hand`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandOptions {
    /// A fingertip within this distance of its target has reached it [m].
    pub(crate) tolerance: f32,
    pub(crate) iterations: u8,
    pub(crate) restarts: u8,
    pub(crate) evaluations: u16,
}

impl HandOptions {
    /// A fingertip within `tolerance` [m], 10⁻⁷ to 1, of its target has reached it.
    ///
    /// At most `iterations` are made for each start, twice as many with directions; at most ten more, 60
    /// around a search, remove the position errors that the secondary objective causes. A search has at most
    /// `restarts` random starts after those on the grid of the shared joint. After `evaluations` of a
    /// finger's kinematics no further iteration begins; at least one is made for each finger.
    ///
    /// # Errors
    /// The tolerance is outside its range.
    pub fn try_new(
        tolerance: f32,
        iterations: u8,
        restarts: u8,
        evaluations: u16,
    ) -> Result<Self, OutOfRange> {
        OutOfRange::check("tolerance of the fingertips", tolerance, [1e-7, 1.0])?;
        Ok(Self { tolerance, iterations, restarts, evaluations })
    }
}

impl Default for HandOptions {
    /// 0.01 mm, 12 iterations, 120 random starts, any number of evaluations.
    fn default() -> Self {
        Self { tolerance: 1e-5, iterations: 12, restarts: 120, evaluations: u16::MAX }
    }
}

/// Result of the inverse kinematics of a [`Hand`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandReport {
    /// Target minus tip of each finger [m]; 0 for a finger without target.
    pub errors: [Vector3<f32>; MAX_FINGERS],
    /// `Σ wᵢ ‖eᵢ‖²` [m²].
    pub weighted: f32,
    /// Number of evaluations of a finger's kinematics.
    pub evaluations: u16,
}

impl HandReport {
    /// Distance of a fingertip from its target [m].
    pub fn distance(&self, finger: usize) -> f32 {
        self.errors.get(finger).map_or(0.0, math::norm)
    }
}

/// An iterate of the optimisation: angles, and the resulting postures, errors and costs.
#[derive(Clone, Debug)]
pub(super) struct Iterate {
    pub(super) angles: Angles,
    /// Postures of the fingers with a target, in their order; further entries are unused.
    pub(super) postures: Vec<FingerPosture, MAX_FINGERS>,
    pub(super) errors: [Vector3<f32>; MAX_FINGERS],
    /// The minimised cost: `primary` plus `secondary` times its emphasis.
    pub(super) cost: f32,
    /// `Σ wᵢ ½‖eᵢ‖²`.
    pub(super) primary: f32,
    /// `Σ wᵢ μᵢ sᵢ`.
    pub(super) secondary: f32,
    /// Whether all tips are within the tolerance, and whether all directions are.
    pub(super) reached: bool,
    pub(super) directed: bool,
}

/// The present iterate, and memory for the next: they are too large to be copied in each iteration.
pub(super) struct Iterates<'a> {
    pub(super) here: &'a mut Iterate,
    there: &'a mut Iterate,
}

impl Iterate {
    /// Unlike a derived `Default`, does not initialise the memory of the postures.
    #[inline(always)]
    fn new() -> Self {
        Self {
            angles: Angles::zeros(),
            postures: Vec::new(),
            errors: [Vector3::zeros(); MAX_FINGERS],
            cost: 0.0,
            primary: 0.0,
            secondary: 0.0,
            reached: false,
            directed: false,
        }
    }

    pub(super) fn is_better_than(&self, other: &Self) -> bool {
        match (self.reached, other.reached) {
            (true, true) => self.cost < other.cost,
            (false, false) => self.primary < other.primary,
            (reached, _) => reached,
        }
    }
}

/// The optimisation problem of the inverse kinematics of a hand.
#[derive(Clone, Copy)]
pub(super) struct InverseProblem<'a> {
    pub(super) hand: &'a Hand,
    pub(super) targets: &'a FingertipTargets,
    pub(super) options: &'a HandOptions,
    /// Whether the shared joint may move.
    pub(super) moves_shared: bool,
    /// The exact Hessian is used if the squared cosine between a finger's error and its reducible part is
    /// below this.
    pub(super) irreducible: f32,
    /// Factor of the weight of the secondary objectives.
    pub(super) emphasis: f32,
    /// Whether the joints need not reach the middle of their ranges yet: the solutions after the first move
    /// them there.
    pub(super) is_first: bool,
}

/// Terms of the cost.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Terms {
    All,
    Positions,
}

impl Hand {
    /// Moves `angles` [rad], which are limited first, to the nearest minimum of the weighted squared errors
    /// of the fingertips. For targets that move little from call to call: the angles then move continuously.
    /// Bounded by [`HandOptions`]. If angles or targets are not finite, the angles are unchanged.
    pub fn solve(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
    ) -> HandReport {
        self.run(targets, options, angles, false)
    }

    /// As [`Hand::solve`], but also from other starts if a tip does not reach its target, for the global
    /// minimum. For the first target, and for those far from the previous one.
    pub fn search(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
    ) -> HandReport {
        self.run(targets, options, angles, true)
    }

    fn run(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
        global: bool,
    ) -> HandReport {
        let mut report =
            HandReport { errors: [Vector3::zeros(); MAX_FINGERS], weighted: 0.0, evaluations: 0 };
        let valid = |target: &FingertipTarget| {
            target.position.iter().all(|value| abs(*value) < MAX_DISTANCE)
                && target.weight.is_finite()
                && target.weight > 0.0
                && target.direction.is_none_or(|direction| direction.iter().all(|value| abs(*value) <= 1.01))
        };
        if !targets.iter().flatten().all(valid) || !angles.iter().all(|angle| angle.is_finite()) {
            report.errors = [Vector3::repeat(f32::NAN); MAX_FINGERS];
            report.weighted = f32::NAN;
            return report;
        }
        self.limit(angles);
        let (mut here, mut there) = (Iterate::new(), Iterate::new());
        let mut points = Iterates { here: &mut here, there: &mut there };
        // The part of its share that a finger does not use is available to the next.
        #[expect(clippy::cast_possible_truncation, reason = "at most 5")]
        let count = |targets: &FingertipTargets| targets.iter().flatten().count() as u16;
        let (share, mut begun) = (options.evaluations / count(targets).max(1), 0);
        let mut run = |group: &FingertipTargets, report: &mut HandReport| {
            begun += count(group);
            let options = HandOptions { evaluations: share.saturating_mul(begun), ..*options };
            self.run_group(group, &options, angles, global, &mut points, report);
        };
        // Fingers that share no joint are independent of each other.
        for (index, _) in self.fingers.iter().enumerate().filter(|(_, finger)| !finger.shares) {
            let mut own = [None; MAX_FINGERS];
            if let (Some(place), Some(target)) = (own.get_mut(index), targets.get(index)) {
                *place = *target;
            }
            run(&own, &mut report);
        }
        let mut together = *targets;
        for (target, _) in together.iter_mut().zip(&self.fingers).filter(|(_, finger)| !finger.shares) {
            *target = None;
        }
        run(&together, &mut report);
        report
    }

    /// Solves for fingers that depend on each other.
    fn run_group(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
        global: bool,
        points: &mut Iterates<'_>,
        report: &mut HandReport,
    ) {
        let problem = InverseProblem {
            hand: self,
            targets,
            options,
            moves_shared: true,
            irreducible: IRREDUCIBLE,
            emphasis: 1.0,
            is_first: global,
        };
        if problem.fingers().next().is_none() {
            return;
        }
        problem.descend(angles, points, &mut report.evaluations);
        if global && !(points.here.reached && points.here.directed) {
            problem.search(points, &mut report.evaluations);
        }
        let best = &*points.here;
        *angles = best.angles;
        report.weighted += 2.0 * best.primary;
        for (index, ..) in problem.fingers() {
            if let (Some(place), Some(error)) = (report.errors.get_mut(index), best.errors.get(index)) {
                *place = *error;
            }
        }
    }
}

impl InverseProblem<'_> {
    /// The fingers with their targets.
    pub(super) fn fingers(&self) -> impl Iterator<Item = (usize, &HandFinger, &FingertipTarget)> {
        let pairs = self.hand.fingers.iter().zip(self.targets).enumerate();
        pairs.filter_map(|(index, (finger, target))| Some((index, finger, target.as_ref()?)))
    }

    pub(super) fn limits(&self, joint: u8) -> (f32, f32) {
        self.hand.limits.get(usize::from(joint)).copied().unwrap_or((0.0, 0.0))
    }

    /// Newton's method from `angles`, which are within their limits; then without the secondary objective.
    pub(super) fn descend(&self, angles: &Angles, points: &mut Iterates<'_>, evaluations: &mut u16) {
        points.here.angles = *angles;
        self.evaluate(Terms::All, points.here, evaluations);
        if self.is_first && self.starts_near(points.here) {
            self.iterate_positions(points, NEARBY_ITERATIONS, evaluations);
            if points.here.reached {
                return;
            }
        }
        let iterations = self.options.iterations.into();
        let with_directions = self.targets.iter().flatten().any(|target| target.direction.is_some());
        if with_directions {
            // First with almost equal weights: if both can be reached, this is the solution, and it converges
            // fast. With the small weight alone the joints would move slowly along the set of equal
            // positions.
            let equal = InverseProblem { emphasis: EMPHASIS, ..*self };
            equal.weigh(points.here);
            equal.iterate(points, Terms::All, iterations, evaluations);
            self.weigh(points.here);
        }
        // If both are reached, their weights do not matter.
        if !(with_directions && points.here.reached && points.here.directed) {
            self.iterate(points, Terms::All, iterations, evaluations);
        }
        self.finish(points, FINAL_ITERATIONS, evaluations);
    }

    /// Removes the position errors that the secondary objective causes.
    pub(super) fn finish(&self, points: &mut Iterates<'_>, iterations: usize, evaluations: &mut u16) {
        let here = &mut *points.here;
        let tolerance = self.options.tolerance;
        let mut squares = here.errors.iter().map(Vector3::norm_squared);
        if squares.any(|square| square > tolerance * tolerance && square < FINAL_RANGE * FINAL_RANGE) {
            self.iterate_positions(points, iterations, evaluations);
        }
    }

    /// Iterates for the positions alone. The steps are too small to affect the secondary objective.
    fn iterate_positions(&self, points: &mut Iterates<'_>, iterations: usize, evaluations: &mut u16) {
        let secondary = points.here.secondary;
        points.here.cost = points.here.primary;
        self.iterate(points, Terms::Positions, iterations, evaluations);
        points.here.secondary = secondary;
        self.weigh(points.here);
    }

    /// Updates the cost from both objectives.
    fn weigh(&self, point: &mut Iterate) {
        point.cost = point.primary + self.emphasis * point.secondary;
    }

    fn iterate(&self, points: &mut Iterates<'_>, terms: Terms, iterations: usize, evaluations: &mut u16) {
        let Iterates { here, there } = points;
        let first = if terms == Terms::All { FIRST_DAMPING } else { FIRST_FINAL_DAMPING };
        let mut damping = 0.0;
        // If evaluations are limited, the last ones are reserved for the positions: one step after the
        // secondary objective, and two more after its first iterations.
        #[expect(clippy::cast_possible_truncation, reason = "at most 5")]
        let fingers = self.fingers().count() as u16;
        let steps = match terms {
            Terms::Positions => 0,
            Terms::All if self.emphasis > 1.0 => 3,
            Terms::All => 1,
        };
        let available = self.options.evaluations.saturating_sub(steps * fingers);
        for _ in 0..iterations {
            if terms == Terms::Positions && here.reached || *evaluations >= available {
                break;
            }
            let moved = self.advance(here, &self.step(here, terms, damping), &mut there.angles);
            self.evaluate(terms, there, evaluations);
            let falls = there.cost <= here.cost;
            let stalls = abs(there.cost - here.cost) < STALLED * here.cost && (falls || damping == 0.0);
            if falls {
                core::mem::swap(here, there);
            }
            if stalls || !falls && terms == Terms::All && self.is_first && self.ends_near(here) {
                break;
            }
            if moved < CONVERGED && (damping == 0.0 || moved < 0.003 * CONVERGED) && terms == Terms::All {
                break;
            }
            damping = match (falls, damping) {
                (true, damping) if damping <= MIN_DAMPING => 0.0,
                (true, damping) => 0.1 * damping,
                (false, damping) => (10.0 * damping).max(first),
            };
        }
    }

    /// Whether a few steps for the positions alone are expected to reach all targets from `point`, and there
    /// are no directions to follow.
    fn starts_near(&self, point: &Iterate) -> bool {
        self.fingers().all(|(index, finger, target)| {
            let range = NEARBY * finger.length;
            let error = point.errors.get(index).copied().unwrap_or_default();
            target.direction.is_none() && error.norm_squared() < range * range
        })
    }

    /// Whether the last iterations can reach all targets from `point`, and there are no directions to follow.
    fn ends_near(&self, point: &Iterate) -> bool {
        point.errors.iter().all(|error| error.norm_squared() < FINAL_RANGE * FINAL_RANGE)
            && self.fingers().all(|(_, _, target)| target.direction.is_none())
    }

    /// Adds `step` to the angles of `here` within their limits. Returns the largest change of an angle.
    fn advance(&self, here: &Iterate, step: &Angles, angles: &mut Angles) -> f32 {
        *angles = here.angles;
        let mut largest = 0.0_f32;
        for (_, finger, _) in self.fingers() {
            for (&joint, range) in finger.variables.iter().zip(&finger.ranges) {
                // From `here`, so that a shared joint is not moved twice.
                let before = angle(&here.angles, joint);
                let moved = math::clamp(before + angle(step, joint), range.lower, range.upper);
                let change = abs(moved - before);
                largest = if change > largest { change } else { largest };
                set_angle(angles, joint, moved);
            }
        }
        largest
    }

    /// Computes postures, errors and costs of `point` from its angles.
    fn evaluate(&self, terms: Terms, point: &mut Iterate, evaluations: &mut u16) {
        point.errors = [Vector3::zeros(); MAX_FINGERS];
        (point.primary, point.secondary, point.reached, point.directed) = (0.0, 0.0, true, true);
        let tolerance = self.options.tolerance;
        for (place, (index, finger, target)) in self.fingers().enumerate() {
            if place == point.postures.len() {
                let _ = point.postures.push(FingerPosture::default());
            }
            // There are as many entries as fingers.
            let Some(posture) = point.postures.get_mut(place) else { break };
            finger.update_posture(&point.angles, target.direction.is_some(), posture);
            *evaluations = evaluations.saturating_add(1);
            let error = target.position - (finger.chain.base() + posture.reach);
            let square = error.norm_squared();
            point.primary += 0.5 * target.weight * square;
            point.reached &= square <= tolerance * tolerance;
            let (mut secondary, mut center) = (0.0, 1.0);
            if let Some(direction) = target.direction {
                // 1 − cos of the angle between the directions; exact for small angles.
                let away = posture.pointing - direction;
                secondary = 0.5 * away.norm_squared();
                point.directed &= secondary < DIRECTION_TOLERANCE;
                center = TERTIARY;
            }
            if terms == Terms::All {
                let own = finger.own();
                for (&joint, range) in finger.variables.iter().zip(&finger.ranges).take(own) {
                    let away = angle(&point.angles, joint) - range.center;
                    secondary += 0.5 * center * away * away;
                }
                point.secondary += target.weight * finger.secondary_weight() * secondary;
            }
            if let Some(place) = point.errors.get_mut(index) {
                *place = error;
            }
        }
        match terms {
            Terms::All => self.weigh(point),
            Terms::Positions => point.cost = point.primary,
        }
    }
}
