//! Inverse kinematics of a [`Hand`]: the weighted least squares of all fingertips under joint limits.
//!
//! The cost is `Σ wᵢ (½‖eᵢ‖² + μᵢ sᵢ)` with the position errors `e` and, at a weight `μ` so small that it
//! decides only what the positions leave free, the secondary objective `s`: the distance from the middle of
//! the joints' ranges or the deviation of the fingertip's direction. The minimum is found by Newton's method
//! with the exact Hessian, which for a serial chain costs one cross product a joint: `∂²p/∂qᵢ∂qⱼ = aᵢ × (aⱼ ×
//! (p − oⱼ))`, `i ≤ j`. It converges quadratically also for targets out of reach, where Gauss–Newton does
//! not. Joints at a limit beyond which the cost falls are fixed (projected Newton method, Bertsekas 1982),
//! and a step that raises the cost is repeated with Levenberg's damping.
//!
//! One joint that several fingers share makes the Hessian an arrow: each finger has a block of its own, and
//! only the last row couples them. The Schur complement of that row is one number, so the cost of a step
//! grows linearly with the fingers.

use heapless::Vec;
use nalgebra::Vector3;

use super::hand::{Angles, Hand, HandFinger, MAX_FINGERS};
use super::hand_step::TERTIARY;
use super::inverse::MAX_DISTANCE;
use super::posture::Posture;
use crate::math::{self, abs};

/// Factor of `μ` in the first iterations for directions.
const EMPHASIS: f32 = 1e3;
/// An undamped step below this ends the iterations [rad]: the error that it leaves is of the order of its
/// square.
const CONVERGED: f32 = 1e-2;
/// First damping after a step that raised the cost, over the squared length of the finger.
const FIRST_DAMPING: f32 = 3e-3;
/// The same in the last iterations, which follow a narrow valley where the finger is nearly stretched.
const FIRST_FINAL_DAMPING: f32 = 1e-5;
/// Errors above this are not worked on by the last iterations [m]: the tip is out of reach.
const FINAL_RANGE: f32 = 2e-3;
/// Maximum number of last iterations.
const FINAL_ITERATIONS: usize = 10;
/// The same where a search found no start from which a tip is reached.
const MAX_FINAL_ITERATIONS: usize = 60;
/// Square of the cosine between the error and what the joints can reduce, below which the exact Hessian
/// serves.
const IRREDUCIBLE: f32 = 0.03;
/// Values of the shared joint from which a search starts.
const GRID: u8 = 7;
/// Starts for each finger at each of these values.
const FINGER_STARTS: u8 = 3;
/// A search ends when the direction is that near [rad²/2].
const DIRECTION_TOLERANCE: f32 = 6e-6;

/// Where a fingertip shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingertipTarget {
    /// Position [m], in the frame of the hand.
    pub position: Vector3<f32>,
    /// Weight of the square of its error, above 0.
    pub weight: f32,
    /// Direction of the fingertip, a unit vector: approached as far as the position leaves it free. Without
    /// it the joints tend to the middle of their ranges.
    pub direction: Option<Vector3<f32>>,
}

/// Targets of the fingers of a [`Hand`], in its order. A finger without target keeps its own joints.
pub type FingertipTargets = [Option<FingertipTarget>; MAX_FINGERS];

/// Tolerance and iteration limits of the inverse kinematics of a [`Hand`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandOptions {
    /// A fingertip that near its target is there [m].
    pub tolerance: f32,
    /// Maximum iterations for each start, twice for directions; at most ten more remove what the secondary
    /// objective left.
    pub iterations: u8,
    /// Maximum number of random starts of a search, after those on the grid of the shared joint.
    pub restarts: u8,
}

impl Default for HandOptions {
    fn default() -> Self {
        Self { tolerance: 1e-5, iterations: 12, restarts: 30 }
    }
}

/// Result of the inverse kinematics of a [`Hand`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandReport {
    /// Target minus tip of each finger [m]; 0 for a finger without target.
    pub errors: [Vector3<f32>; MAX_FINGERS],
    /// `Σ wᵢ ‖eᵢ‖²` [m²].
    pub weighted: f32,
    /// Number of evaluations of the cost.
    pub evaluations: u16,
}

impl HandReport {
    /// Distance of a fingertip from its target [m].
    pub fn distance(&self, finger: usize) -> f32 {
        self.errors.get(finger).map_or(0.0, |error| math::sqrt(error.norm_squared()))
    }
}

/// Angles and what follows from them.
#[derive(Clone, Debug, Default)]
pub(super) struct Point {
    pub(super) angles: Angles,
    /// Of the fingers with a target.
    pub(super) postures: Vec<Posture, MAX_FINGERS>,
    pub(super) errors: [Vector3<f32>; MAX_FINGERS],
    /// `Σ wᵢ (½‖eᵢ‖² + μᵢ sᵢ)`.
    pub(super) cost: f32,
    /// `Σ wᵢ ½‖eᵢ‖²`.
    pub(super) primary: f32,
    /// Whether all tips are within the tolerance, and whether the directions are, too.
    pub(super) reached: bool,
    pub(super) directed: bool,
}

impl Point {
    fn is_better_than(&self, other: &Self) -> bool {
        match (self.reached, other.reached) {
            (true, true) => self.cost < other.cost,
            (false, false) => self.primary < other.primary,
            (reached, _) => reached,
        }
    }
}

/// What is solved for.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) hand: &'a Hand,
    pub(super) targets: &'a FingertipTargets,
    pub(super) options: &'a HandOptions,
    /// Whether the shared joint may move.
    pub(super) moves_shared: bool,
    /// The exact Hessian serves where the square of the cosine between a finger's error and what its joints
    /// can reduce is below this.
    pub(super) irreducible: f32,
    /// Factor of the weight of the secondary objectives.
    pub(super) emphasis: f32,
}

/// Which terms the cost has.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Terms {
    All,
    Positions,
}

impl Hand {
    /// Moves `angles` [rad] from where they are, limited first, to the nearest minimum of the weighted
    /// squared errors of the fingertips. For targets that move a little from call to call: the angles move
    /// continuously. Bounded by [`HandOptions`]. Angles and targets that are not finite are left as
    /// they are.
    pub fn solve(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
    ) -> HandReport {
        self.run(targets, options, angles, false)
    }

    /// As [`Hand::solve`], and when a tip is not reached also from other starts, for the global minimum. For
    /// the first target, and for those far from the one before.
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
        // Fingers that share no joint are independent of each other.
        for (index, _) in self.fingers.iter().enumerate().filter(|(_, finger)| !finger.shares) {
            let mut own = [None; MAX_FINGERS];
            if let (Some(place), Some(target)) = (own.get_mut(index), targets.get(index)) {
                *place = *target;
            }
            self.run_group(&own, options, angles, global, &mut report);
        }
        let mut together = *targets;
        for (target, _) in together.iter_mut().zip(&self.fingers).filter(|(_, finger)| !finger.shares) {
            *target = None;
        }
        self.run_group(&together, options, angles, global, &mut report);
        report
    }

    /// Solves for fingers that depend on each other.
    fn run_group(
        &self,
        targets: &FingertipTargets,
        options: &HandOptions,
        angles: &mut Angles,
        global: bool,
        report: &mut HandReport,
    ) {
        let problem = Problem {
            hand: self,
            targets,
            options,
            moves_shared: true,
            irreducible: IRREDUCIBLE,
            emphasis: 1.0,
        };
        if problem.fingers().next().is_none() {
            return;
        }
        let mut best = problem.descend(angles, &mut report.evaluations);
        if global && !(best.reached && best.directed) {
            problem.search(&mut best, &mut report.evaluations);
        }
        *angles = best.angles;
        report.weighted += 2.0 * best.primary;
        for (index, ..) in problem.fingers() {
            if let (Some(place), Some(error)) = (report.errors.get_mut(index), best.errors.get(index)) {
                *place = *error;
            }
        }
    }
}

/// Linear congruential generator of Numerical Recipes; the upper 24 bits suffice for a start.
struct Starts(u32);

impl Starts {
    fn between(&mut self, (lower, upper): (f32, f32)) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        #[expect(clippy::cast_precision_loss, reason = "24 bits")]
        let fraction = (self.0 >> 8) as f32 / 16_777_216.0;
        lower + fraction * (upper - lower)
    }
}

impl Problem<'_> {
    /// The fingers with their targets.
    pub(super) fn fingers(&self) -> impl Iterator<Item = (usize, &HandFinger, &FingertipTarget)> {
        let pairs = self.hand.fingers.iter().zip(self.targets).enumerate();
        pairs.filter_map(|(index, (finger, target))| Some((index, finger, target.as_ref()?)))
    }

    pub(super) fn limits(&self, joint: u8) -> (f32, f32) {
        self.hand.limits.get(usize::from(joint)).copied().unwrap_or((0.0, 0.0))
    }

    /// Searches beyond the local minimum `best`. For a given angle of the shared joint the fingers are
    /// independent, so that each can be searched alone: a grid over that angle, then all fingers together
    /// from its two best values; then random starts.
    fn search(&self, best: &mut Point, evaluations: &mut u16) {
        let exact = Problem { irreducible: f32::INFINITY, ..*self };
        let mut starts = Starts(1);
        exact.finish(best, MAX_FINAL_ITERATIONS, evaluations);
        if best.reached && best.directed {
            return;
        }
        let mut try_from = |angles: &Angles, best: &mut Point| {
            let point = exact.descend(angles, evaluations);
            if point.is_better_than(best) {
                *best = point;
            }
            best.reached && best.directed
        };
        let shared = self.hand.shared.filter(|_| self.fingers().any(|(_, finger, _)| finger.shares));
        if let Some(shared) = shared {
            let mut two = [(f32::INFINITY, best.angles); 2];
            let (lower, upper) = self.limits(shared);
            for number in 0..GRID {
                let fraction = (f32::from(number) + 0.5) / f32::from(GRID);
                let mut angles = best.angles;
                angles[usize::from(shared)] = lower + fraction * (upper - lower);
                let cost = self.fingers_alone(&mut angles, &mut starts);
                if cost < two[0].0 {
                    two = [(cost, angles), two[0]];
                } else if cost < two[1].0 {
                    two[1] = (cost, angles);
                }
            }
            if two.iter().any(|(_, angles)| try_from(angles, best)) {
                return;
            }
        }
        for _ in 0..self.options.restarts {
            let mut angles = best.angles;
            for (_, finger, _) in self.fingers() {
                for &joint in &finger.variables {
                    angles[usize::from(joint)] = starts.between(self.limits(joint));
                }
            }
            if try_from(&angles, best) {
                return;
            }
        }
        exact.finish(best, MAX_FINAL_ITERATIONS, evaluations);
    }

    /// Solves each finger alone at the angle of the shared joint in `angles`, from several starts. Returns
    /// the sum of the costs of positions.
    fn fingers_alone(&self, angles: &mut Angles, starts: &mut Starts) -> f32 {
        let mut sum = 0.0;
        let center = self.hand.center();
        for (index, finger, target) in self.fingers() {
            let mut targets = [None; MAX_FINGERS];
            if let Some(place) = targets.get_mut(index) {
                *place = Some(*target);
            }
            let alone = Problem { targets: &targets, moves_shared: false, ..*self };
            let own = finger.variables.len() - usize::from(finger.shares);
            let mut best: Option<Point> = None;
            for start in 0..FINGER_STARTS {
                let mut from = *angles;
                for &joint in finger.variables.iter().take(own) {
                    match start {
                        0 => {}
                        1 => from[usize::from(joint)] = center[usize::from(joint)],
                        _ => from[usize::from(joint)] = starts.between(self.limits(joint)),
                    }
                }
                let point = alone.descend(&from, &mut 0);
                if best.as_ref().is_none_or(|best| point.is_better_than(best)) {
                    best = Some(point);
                }
            }
            if let Some(best) = best {
                sum += best.primary;
                *angles = best.angles;
            }
        }
        sum
    }

    /// Newton's method from `angles`, which are within their limits; then without the secondary objective.
    fn descend(&self, angles: &Angles, evaluations: &mut u16) -> Point {
        let mut here = Point::default();
        self.evaluate(angles, Terms::All, &mut here);
        let mut count = 1;
        let iterations = self.options.iterations.into();
        if self.targets.iter().flatten().any(|target| target.direction.is_some()) {
            // First with almost equal weights: where both can be reached, this is the solution, and the way
            // to it is short. A small weight alone would let the joints creep along the positions.
            let equal = Problem { emphasis: EMPHASIS, ..*self };
            equal.evaluate(angles, Terms::All, &mut here);
            equal.iterate(&mut here, Terms::All, iterations, &mut count);
            let angles = here.angles;
            self.evaluate(&angles, Terms::All, &mut here);
            count += 1;
        }
        self.iterate(&mut here, Terms::All, iterations, &mut count);
        self.finish(&mut here, FINAL_ITERATIONS, &mut count);
        *evaluations = evaluations.saturating_add(count);
        here
    }

    /// Removes the errors that the secondary objective left.
    fn finish(&self, here: &mut Point, iterations: usize, count: &mut u16) {
        let tolerance = self.options.tolerance;
        let mut squares = here.errors.iter().map(Vector3::norm_squared);
        if squares.any(|square| square > tolerance * tolerance && square < FINAL_RANGE * FINAL_RANGE) {
            let secondary = here.cost - here.primary;
            here.cost = here.primary;
            self.iterate(here, Terms::Positions, iterations, count);
            // The last steps are too small to matter to the secondary objective.
            here.cost += secondary;
        }
    }

    fn iterate(&self, result: &mut Point, terms: Terms, iterations: usize, count: &mut u16) {
        // Two points that change places: a point is too large to be copied in each iteration.
        let mut other = Point::default();
        let (mut here, mut there) = (&mut *result, &mut other);
        let mut swapped = false;
        let first = if terms == Terms::All { FIRST_DAMPING } else { FIRST_FINAL_DAMPING };
        let mut damping = 0.0;
        for _ in 0..iterations {
            if terms == Terms::Positions && here.reached {
                break;
            }
            let step = self.step(here, terms, damping);
            let mut angles = here.angles + step;
            self.hand.limit(&mut angles);
            let moved = (angles - here.angles).amax();
            self.evaluate(&angles, terms, there);
            *count += 1;
            let falls = there.cost <= here.cost;
            if falls {
                core::mem::swap(&mut here, &mut there);
                swapped = !swapped;
            }
            if moved < CONVERGED && (damping == 0.0 || moved < 0.003 * CONVERGED) && terms == Terms::All {
                break;
            }
            damping = match (falls, damping) {
                (true, damping) if damping <= first => 0.0,
                (true, damping) => 0.1 * damping,
                (false, damping) => (10.0 * damping).max(first),
            };
        }
        if swapped {
            *result = other;
        }
    }

    /// Writes the cost at `angles` to `point`.
    fn evaluate(&self, angles: &Angles, terms: Terms, point: &mut Point) {
        point.angles = *angles;
        point.postures.clear();
        (point.cost, point.primary, point.reached, point.directed) = (0.0, 0.0, true, true);
        let tolerance = self.options.tolerance;
        for (index, finger, target) in self.fingers() {
            let posture = finger.posture(angles);
            let error = target.position - posture.tip.translation.vector;
            let square = error.norm_squared();
            point.primary += 0.5 * target.weight * square;
            point.reached &= square <= tolerance * tolerance;
            let (mut secondary, mut center) = (0.0, 1.0);
            if let Some(direction) = target.direction {
                // 1 − cos of the angle between the directions; exact for small angles.
                let away = posture.tip.rotation * finger.pointing - direction;
                secondary = 0.5 * away.norm_squared();
                point.directed &= secondary < DIRECTION_TOLERANCE;
                center = TERTIARY;
            }
            if terms == Terms::All {
                let own = finger.variables.len() - usize::from(finger.shares);
                for &joint in finger.variables.iter().take(own) {
                    let (lower, upper) = self.limits(joint);
                    let away = angles[usize::from(joint)] - 0.5 * (lower + upper);
                    secondary += 0.5 * center * away * away;
                }
                point.cost += target.weight * self.emphasis * finger.secondary_weight() * secondary;
            }
            if let Some(place) = point.errors.get_mut(index) {
                *place = error;
            }
            // There are as many places as fingers.
            let _ = point.postures.push(posture);
        }
        point.cost += point.primary;
    }
}
