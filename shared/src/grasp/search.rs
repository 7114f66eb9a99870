use core::cell::Cell;

use heapless::Vec;
use nalgebra::{Matrix6, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::cone::{Cone, Projection};
use super::map::{halves, stack};
use super::{Certificate, GraspMap, MAX_CONTACTS};
use crate::math::{self, Ldlt, abs};

/// Maximum number of Newton steps in all calls; then a residual below `MAX_RESIDUAL` is accepted, or the
/// search fails.
const MAX_STEPS: u8 = 39;
/// Step at which the line through collinear contacts is tried as a certificate.
const AXIS_PROOF_STEP: u8 = 8;
/// Step at which a warm-started search restarts at 0.
const RESTART_STEP: u8 = 12;
/// Step from which `MAX_GAP` suffices instead of `TARGET_GAP`.
const ACCEPT_STEP: u8 = 16;
/// Residual wrench over the load: the target, and the maximum of an accepted solution.
const TARGET_RESIDUAL: f32 = 1e-5;
const MAX_RESIDUAL: f32 = 9e-5;
/// Rounding error of the residual over the norm of the contact forces.
const ROUNDING: f32 = 6e-7;
/// Relative duality gap that the residual may cause: the target, and the maximum of an accepted solution.
const TARGET_GAP: f32 = 2e-4;
const MAX_GAP: f32 = 8e-4;

/// Levenberg–Marquardt damping over the residual: initial (and minimum) factor, and its multipliers after a
/// step that was too long and after a good one.
const INITIAL_DAMPING: f32 = 1e-3;
const DAMPING_INCREASE: f32 = 8.0;
const DAMPING_DECREASE: f32 = 0.1;
const MAX_DAMPING: f32 = 1.0;
/// Minimum damping: the rounding error of the Hessian in single precision.
const MIN_DAMPING: f32 = 1e-5;
const MIN_PIVOT: f32 = 1e-7;
/// Line search (curvature condition): the slope at its end over the slope at its start. Backtracks below
/// −this, extends above it.
const MAX_SLOPE_RATIO: f32 = 0.5;
/// Maximum numbers of backtracks and extensions of a step, and the factor of an extension.
const MAX_BACKTRACKS: u32 = 4;
const MAX_EXTENSIONS: usize = 3;
const EXTENSION: f32 = 4.0;
/// Bound on the dual variable in units of the load; beyond it single precision has no significant digits.
const MAX_TWIST: f32 = 3e4;
/// Along a recession direction, points at these multiples of the step are tried as certificates.
const RAY_LENGTHS: [f32; 2] = [10.0, 1000.0];

/// Cost in instructions of a Cortex-M4F: fixed, and per contact. Measured and rounded up.
#[derive(Clone, Copy)]
struct Cost(u32, u32);

/// Scaling and cones; a point; the direction of a step; whether a twist separates, and whether it proves; the
/// axis of contacts in line.
const START: Cost = Cost(500, 25);
const EVALUATION: Cost = Cost(390, 180);
const DIRECTION: Cost = Cost(1720, 140);
const SEPARATION: Cost = Cost(110, 55);
const PROOF: Cost = Cost(240, 50);
const AXIS: Cost = Cost(900, 0);

impl Cost {
    const fn times(self, times: u32) -> Self {
        Self(self.0 * times, self.1 * times)
    }

    const fn and(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

/// Maximum cost of a step with the certificates tried after it. A restart, which never coincides with the
/// trial of the axis, costs less.
const STEP: Cost = DIRECTION
    .and(EVALUATION.times(1 + MAX_BACKTRACKS))
    .and(SEPARATION.times(4))
    .and(PROOF.times(5))
    .and(AXIS);

/// The dual problem of the least grip: forces in units of `unit`, moments about the centroid and over the
/// length.
pub(super) struct Search<'a> {
    pub map: &'a GraspMap,
    pub cones: Vec<Cone, MAX_CONTACTS>,
    pub load: Vector6<f32>,
    /// Norm of the load.
    pub size: f32,
    /// Accepted residual over the load.
    pub open: f32,
    /// Instructions used so far.
    pub work: Cell<u32>,
}

/// A search under way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct SearchState {
    /// Dual variable: twist about the centroid, the angular part times the length, over the load.
    pub twist: [f32; 6],
    damping: f32,
    /// Smallest residual so far, over the load.
    best: f32,
    /// Newton steps taken.
    pub steps: u8,
    /// Whether the search was warm-started.
    elsewhere: bool,
}

/// Result of a search without accepted forces.
pub(super) enum SearchEnd {
    /// Infeasible, with a certificate.
    Refused(Certificate),
    /// Not converged, with the smallest residual over the load.
    Open(f32),
    /// Budget used up, with the present residual over the load.
    Unfinished(f32),
}

/// The dual function at a twist.
pub(super) struct Point {
    pub twist: Vector6<f32>,
    /// Projections of the contact velocities onto the cones.
    pub nearest: Vec<Projection, MAX_CONTACTS>,
    /// Residual: load minus wrench of the forces, the gradient of the dual function.
    missing: Vector6<f32>,
    /// Support function of the contacts' forces at the twist.
    support: f32,
    /// Sum of the forces' squares.
    square: f32,
}

impl SearchState {
    /// Initial state at `twist`.
    pub fn at(twist: [f32; 6]) -> Self {
        let elsewhere = Vector6::from(twist) != Vector6::zeros();
        Self { twist, damping: INITIAL_DAMPING, best: f32::INFINITY, steps: 0, elsewhere }
    }

    /// Whether the stored state is corrupt.
    pub fn is_broken(&self) -> bool {
        let sum: f32 = self.twist.iter().sum();
        !(sum.is_finite() && (INITIAL_DAMPING..=MAX_DAMPING).contains(&self.damping))
    }

    /// Restarts at 0 with the remaining steps.
    pub fn restart(&mut self) {
        *self = Self { best: self.best, steps: self.steps, ..Self::at([0.0; 6]) };
    }
}

impl Search<'_> {
    /// Continues Newton's method until it ends or a further step might exceed `max_instructions`
    /// instructions; takes at least one step. `proves` checks a twist as certificate of infeasibility.
    pub fn run(
        &self,
        begun: &mut SearchState,
        max_instructions: u32,
        proves: impl Fn(&Vector6<f32>) -> Option<Certificate>,
    ) -> Result<Point, SearchEnd> {
        self.take(START);
        let mut point = self.at(begun.twist.into());
        // A negative dual value at a warm start means a bad start, because the maximum is positive. Later
        // steps may pass through negative values.
        let mut astray = begun.steps == 0 && point.twist.dot(&point.missing) + 0.5 * point.square < 0.0;
        let (mut ahead, before) = (None, begun.steps);
        let enough = max_instructions.saturating_sub(self.instructions(STEP));
        loop {
            if astray || begun.steps == RESTART_STEP && begun.elsewhere {
                begun.restart();
                point = self.at(Vector6::zeros());
                (ahead, astray) = (None, false);
            }
            let missing = self.residual(&point);
            if missing < begun.best {
                begun.best = missing;
            }
            let accepted = match begun.steps {
                0..ACCEPT_STEP => self.is_good(&point, missing),
                ACCEPT_STEP..MAX_STEPS => changes(&point) <= MAX_GAP,
                _ => true,
            };
            let will_do = missing <= self.open && changes(&point) <= 2.0 * self.open;
            if will_do || accepted && missing <= MAX_RESIDUAL {
                return Ok(point);
            }
            let proof = self.candidates(&point, ahead, begun.steps).find_map(|twist| {
                self.take(PROOF);
                proves(&twist)
            });
            if let Some(certificate) = proof {
                return Err(SearchEnd::Refused(certificate));
            }
            if begun.steps >= MAX_STEPS {
                return Err(SearchEnd::Open(begun.best));
            }
            if begun.steps > before && self.work.get() > enough {
                begun.twist = point.twist.into();
                return Err(SearchEnd::Unfinished(missing));
            }
            (point, ahead) = self.step(&point, &mut begun.damping);
            begun.steps += 1;
        }
    }

    fn instructions(&self, Cost(fixed, each): Cost) -> u32 {
        self.cones.iter().fold(fixed, |sum, _| sum + each)
    }

    fn take(&self, cost: Cost) {
        self.work.set(self.work.get().saturating_add(self.instructions(cost)));
    }

    /// Norm of the residual over the load.
    pub fn residual(&self, point: &Point) -> f32 {
        math::sqrt(point.missing.norm_squared()) / self.size
    }

    fn is_good(&self, point: &Point, missing: f32) -> bool {
        let rounding = ROUNDING * math::sqrt(point.square);
        missing * self.size <= TARGET_RESIDUAL * self.size + rounding && changes(point) <= TARGET_GAP
    }

    /// Candidate certificates of infeasibility.
    fn candidates(
        &self,
        point: &Point,
        ahead: Option<Vector6<f32>>,
        steps: u8,
    ) -> impl Iterator<Item = Vector6<f32>> {
        let own = (point.twist.dot(&self.load) > point.support).then_some(point.twist);
        // The residual tends to the shortest vector from the set of feasible wrenches, which separates.
        let missing = (steps > 0).then_some(point.missing);
        let twist = point.twist;
        let far = ahead.into_iter().flat_map(move |step| RAY_LENGTHS.map(|times| twist + step * times));
        let about = (steps == AXIS_PROOF_STEP).then(|| {
            self.take(AXIS);
            let axis = self.map.inverse().conditioning().axis;
            stack(&Vector3::zeros(), &(axis * axis.dot(&halves(&self.load).1)))
        });
        own.into_iter()
            .chain(missing.into_iter().chain(far).chain(about).filter(|twist| self.separates(twist)))
    }

    /// Whether the twist separates the load from all feasible wrenches.
    fn separates(&self, twist: &Vector6<f32>) -> bool {
        self.take(SEPARATION);
        let (linear, angular) = halves(twist);
        let mut left = twist.dot(&self.load);
        for (cone, lever) in self.cones.iter().zip(&self.map.levers) {
            left -= cone.support(&(linear + angular.cross(lever)));
        }
        left > 0.0
    }

    #[inline(never)]
    fn at(&self, twist: Vector6<f32>) -> Point {
        self.take(EVALUATION);
        let (linear, angular) = halves(&twist);
        let (mut force, mut moment) = halves(&self.load);
        let (mut support, mut square) = (0.0, 0.0);
        let mut all = Vec::new();
        for (cone, lever) in self.cones.iter().zip(&self.map.levers) {
            let nearest = cone.nearest(&(linear + angular.cross(lever)));
            force -= nearest.force;
            moment -= lever.cross(&nearest.force);
            support += nearest.support;
            square += nearest.force.norm_squared();
            let _ = all.push(nearest); // as many places as contacts
        }
        Point { twist, nearest: all, missing: stack(&force, &moment), support, square }
    }

    /// A damped Newton step with line search. Also returns its direction if the slope hardly changed along
    /// it.
    fn step(&self, point: &Point, damping: &mut f32) -> (Point, Option<Vector6<f32>>) {
        self.take(DIRECTION);
        let mut hessian = self.hessian(point);
        let added = *damping * math::sqrt(point.missing.norm_squared());
        let added = if added > MIN_DAMPING { added } else { MIN_DAMPING };
        for index in 0..6 {
            hessian[(index, index)] += added;
        }
        let direction = Ldlt::new(&hessian, MIN_PIVOT).solve(&point.missing);
        let slope = direction.dot(&point.missing);
        let next = self.at(point.twist + direction);
        let left = direction.dot(&next.missing);
        let (next, factor) = if left < -MAX_SLOPE_RATIO * slope {
            (self.shorter(point, &direction, slope, left), DAMPING_INCREASE)
        } else if left > MAX_SLOPE_RATIO * slope {
            (self.longer(next, &direction), DAMPING_DECREASE)
        } else {
            (next, DAMPING_DECREASE)
        };
        *damping = math::clamp(*damping * factor, INITIAL_DAMPING, MAX_DAMPING);
        let flat = direction.dot(&next.missing) > MAX_SLOPE_RATIO * slope;
        (next, flat.then_some(direction))
    }

    /// Backtracks along a step that went too far: the slope falls from `slope` to `end` < 0.
    fn shorter(&self, point: &Point, direction: &Vector6<f32>, slope: f32, end: f32) -> Point {
        let (mut lower, mut upper) = ((0.0, slope), (1.0, end));
        let mut tries = 1;
        loop {
            // Regula falsi, kept away from the ends of the bracket.
            let fraction = math::clamp(lower.1 / (lower.1 - upper.1), 0.1, 0.9);
            let length = lower.0 + (upper.0 - lower.0) * fraction;
            let next = self.at(point.twist + direction * length);
            let left = direction.dot(&next.missing);
            if abs(left) <= MAX_SLOPE_RATIO * slope || tries == MAX_BACKTRACKS {
                return next;
            }
            if left > 0.0 {
                lower = (length, left);
            } else {
                upper = (length, left);
            }
            tries += 1;
        }
    }

    /// Extends a step along which the slope hardly changed.
    fn longer(&self, mut point: Point, direction: &Vector6<f32>) -> Point {
        let mut length = EXTENSION - 1.0;
        for _ in 0..MAX_EXTENSIONS {
            let next = self.at(point.twist + direction * length);
            // Stop once the residual no longer decreases.
            if next.missing.norm_squared() > 0.98 * point.missing.norm_squared()
                || direction.dot(&next.missing) < 0.0
                || next.twist.norm_squared() > MAX_TWIST * MAX_TWIST
            {
                break;
            }
            length *= EXTENSION;
            point = next;
        }
        point
    }

    /// Hessian `Σ Gᵢ Pᵢ Gᵢᵀ`, lower triangle only.
    #[inline(never)]
    fn hessian(&self, point: &Point) -> Matrix6<f32> {
        let mut hessian = Matrix6::zeros();
        for ((cone, lever), nearest) in self.cones.iter().zip(&self.map.levers).zip(&point.nearest) {
            let derivative = cone.derivative(nearest);
            // r^ P, and r^ P (r^)ᵀ, whose columns are r × the rows of r^ P.
            let turned = [0, 1, 2].map(|index| lever.cross(&derivative.column(index).into_owned()));
            let rows = [0, 1, 2]
                .map(|row| lever.cross(&Vector3::new(turned[0][row], turned[1][row], turned[2][row])));
            for column in 0..3 {
                for row in column..3 {
                    hessian[(row, column)] += derivative[(row, column)];
                    hessian[(3 + row, 3 + column)] += rows[column][row];
                }
                for row in 0..3 {
                    hessian[(3 + row, column)] += turned[column][row];
                }
            }
        }
        hessian
    }
}

/// Relative duality gap that the residual causes: the twist is the gradient of the sum of squares.
fn changes(point: &Point) -> f32 {
    2.0 * abs(point.twist.dot(&point.missing)) / point.square
}
