use core::cell::Cell;

use heapless::Vec;
use nalgebra::{Matrix6, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::cone::{Cone, Projection};
use super::{Certificate, GraspMap, MAX_CONTACTS};
use crate::math::{self, Ldlt, abs, halves, stack};
use crate::zip::zip;

/// Maximum number of Newton steps in all calls; then a residual below `MAX_RESIDUAL` is accepted, or the
/// search fails.
const MAX_STEPS: u8 = 39;
/// Step at which a rotation about the line of collinear contacts is tried as a certificate.
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

/// Costs of scaling and cones; of a point; of the direction of a step; of the check whether a twist
/// separates, and whether it is a proof; of the axis of collinear contacts.
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

/// Maximum cost of a step with the certificates that are tried after it. A restart, which never coincides
/// with the trial of the axis, costs less.
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
    pub norm: f32,
    /// Accepted residual over the load.
    pub tolerance: f32,
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
    min_residual: f32,
    /// Newton steps taken.
    pub steps: u8,
    /// Whether the search was warm-started.
    warm_started: bool,
}

/// Result of a search without accepted forces.
pub(super) enum SearchEnd {
    /// Infeasible, with a certificate.
    Infeasible(Certificate),
    /// Not converged, with the smallest residual over the load.
    NotConverged(f32),
    /// Budget used up, with the present residual over the load.
    Unfinished(f32),
}

/// The dual function at a twist.
pub(super) struct DualPoint {
    pub twist: Vector6<f32>,
    /// Projections of the contact velocities onto the cones.
    pub nearest: Vec<Projection, MAX_CONTACTS>,
    /// Residual: load minus wrench of the forces, the gradient of the dual function.
    residual: Vector6<f32>,
    /// Support function of the contacts' forces at the twist.
    support: f32,
    /// Sum of the forces' squares.
    square: f32,
}

impl SearchState {
    /// Initial state at `twist`.
    pub fn at(twist: [f32; 6]) -> Self {
        let warm_started = Vector6::from(twist) != Vector6::zeros();
        Self { twist, damping: INITIAL_DAMPING, min_residual: f32::INFINITY, steps: 0, warm_started }
    }

    /// Whether the stored state is corrupt.
    pub fn is_corrupt(&self) -> bool {
        let sum: f32 = self.twist.iter().sum();
        !(sum.is_finite() && (INITIAL_DAMPING..=MAX_DAMPING).contains(&self.damping))
    }

    /// Restarts at 0 with the remaining steps.
    pub fn restart(&mut self) {
        *self = Self { min_residual: self.min_residual, steps: self.steps, ..Self::at([0.0; 6]) };
    }
}

impl Search<'_> {
    /// Continues Newton's method until it ends or a further step might exceed `max_instructions`
    /// instructions; takes at least one step. `proves` checks whether a twist is a certificate of
    /// infeasibility.
    pub fn run(
        &self,
        state: &mut SearchState,
        max_instructions: u32,
        proves: impl Fn(&Vector6<f32>) -> Option<Certificate>,
    ) -> Result<DualPoint, SearchEnd> {
        self.take(START);
        let mut point = self.at(state.twist.into());
        // A negative dual value at a warm start means a bad start, because the maximum is positive. Later
        // steps may pass through negative values.
        let mut bad_start = state.steps == 0 && point.twist.dot(&point.residual) + 0.5 * point.square < 0.0;
        let (mut ray, first_step) = (None, state.steps);
        let budget = max_instructions.saturating_sub(self.instructions(STEP));
        loop {
            if bad_start || state.steps == RESTART_STEP && state.warm_started {
                state.restart();
                point = self.at(Vector6::zeros());
                (ray, bad_start) = (None, false);
            }
            let residual = self.residual(&point);
            if residual < state.min_residual {
                state.min_residual = residual;
            }
            let accepted = match state.steps {
                0..ACCEPT_STEP => self.is_accurate(&point, residual),
                ACCEPT_STEP..MAX_STEPS => duality_gap(&point) <= MAX_GAP,
                _ => true,
            };
            let tolerated = residual <= self.tolerance && duality_gap(&point) <= 2.0 * self.tolerance;
            if tolerated || accepted && residual <= MAX_RESIDUAL {
                return Ok(point);
            }
            let proof = self.candidates(&point, ray, state.steps).find_map(|twist| {
                self.take(PROOF);
                proves(&twist)
            });
            if let Some(certificate) = proof {
                return Err(SearchEnd::Infeasible(certificate));
            }
            if state.steps >= MAX_STEPS {
                return Err(SearchEnd::NotConverged(state.min_residual));
            }
            if state.steps > first_step && self.work.get() > budget {
                state.twist = point.twist.into();
                return Err(SearchEnd::Unfinished(residual));
            }
            (point, ray) = self.step(&point, &mut state.damping);
            state.steps += 1;
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "a few contacts")]
    fn instructions(&self, Cost(fixed, each): Cost) -> u32 {
        fixed + each * self.cones.len() as u32
    }

    fn take(&self, cost: Cost) {
        self.work.set(self.work.get().saturating_add(self.instructions(cost)));
    }

    /// Norm of the residual over the load.
    pub fn residual(&self, point: &DualPoint) -> f32 {
        math::norm(&point.residual) / self.norm
    }

    fn is_accurate(&self, point: &DualPoint, residual: f32) -> bool {
        let rounding = ROUNDING * math::sqrt(point.square);
        residual * self.norm <= TARGET_RESIDUAL * self.norm + rounding && duality_gap(point) <= TARGET_GAP
    }

    /// Candidate certificates of infeasibility.
    fn candidates(
        &self,
        point: &DualPoint,
        ray: Option<Vector6<f32>>,
        steps: u8,
    ) -> impl Iterator<Item = Vector6<f32>> {
        let current = (point.twist.dot(&self.load) > point.support).then_some(point.twist);
        // The residual tends to the shortest vector from the set of feasible wrenches, which separates.
        let residual = (steps > 0).then_some(point.residual);
        let twist = point.twist;
        let rays = ray.into_iter().flat_map(move |step| RAY_LENGTHS.map(|times| twist + step * times));
        let axis = (steps == AXIS_PROOF_STEP).then(|| {
            self.take(AXIS);
            let axis = self.map.inverse().conditioning().axis;
            stack([Vector3::zeros(), axis * axis.dot(&halves(&self.load)[1])])
        });
        current
            .into_iter()
            .chain(residual.into_iter().chain(rays).chain(axis).filter(|twist| self.separates(twist)))
    }

    /// Whether the twist separates the load from all feasible wrenches.
    fn separates(&self, twist: &Vector6<f32>) -> bool {
        self.take(SEPARATION);
        let [linear, angular] = halves(twist);
        let mut power = twist.dot(&self.load);
        for (cone, lever) in self.cones.iter().zip(&self.map.levers) {
            power -= cone.support(&(linear + angular.cross(lever)));
        }
        power > 0.0
    }

    #[inline(never)]
    fn at(&self, twist: Vector6<f32>) -> DualPoint {
        self.take(EVALUATION);
        let [linear, angular] = halves(&twist);
        let [mut force, mut moment] = halves(&self.load);
        let (mut support, mut square) = (0.0, 0.0);
        let mut all = Vec::new();
        for (cone, lever) in self.cones.iter().zip(&self.map.levers) {
            let nearest = cone.nearest(&(linear + angular.cross(lever)));
            force -= nearest.force;
            moment -= lever.cross(&nearest.force);
            support += nearest.support;
            square += nearest.force.norm_squared();
            let _ = all.push(nearest); // cannot fail: same capacity
        }
        DualPoint { twist, nearest: all, residual: stack([force, moment]), support, square }
    }

    /// A damped Newton step with line search. Also returns its direction if the slope hardly changed along
    /// it.
    fn step(&self, point: &DualPoint, damping: &mut f32) -> (DualPoint, Option<Vector6<f32>>) {
        self.take(DIRECTION);
        let mut hessian = self.hessian(point);
        let added = *damping * math::norm(&point.residual);
        let added = if added > MIN_DAMPING { added } else { MIN_DAMPING };
        for index in 0..6 {
            hessian[(index, index)] += added;
        }
        let direction = Ldlt::new(&hessian, MIN_PIVOT).solve(&point.residual);
        let slope = direction.dot(&point.residual);
        let next = self.at(point.twist + direction);
        let end_slope = direction.dot(&next.residual);
        let (next, factor) = if end_slope < -MAX_SLOPE_RATIO * slope {
            (self.shorter(point, &direction, slope, end_slope), DAMPING_INCREASE)
        } else if end_slope > MAX_SLOPE_RATIO * slope {
            (self.longer(next, &direction), DAMPING_DECREASE)
        } else {
            (next, DAMPING_DECREASE)
        };
        *damping = math::clamp(*damping * factor, INITIAL_DAMPING, MAX_DAMPING);
        let flat = direction.dot(&next.residual) > MAX_SLOPE_RATIO * slope;
        (next, flat.then_some(direction))
    }

    /// Backtracks along a step that went too far: the slope falls from `slope` to `end` < 0.
    fn shorter(&self, point: &DualPoint, direction: &Vector6<f32>, slope: f32, end: f32) -> DualPoint {
        let (mut lower, mut upper) = ((0.0, slope), (1.0, end));
        let mut tries = 1;
        loop {
            // Regula falsi, kept away from the ends of the bracket.
            let fraction = math::clamp(lower.1 / (lower.1 - upper.1), 0.1, 0.9);
            let length = lower.0 + (upper.0 - lower.0) * fraction;
            let next = self.at(point.twist + direction * length);
            let next_slope = direction.dot(&next.residual);
            if abs(next_slope) <= MAX_SLOPE_RATIO * slope || tries == MAX_BACKTRACKS {
                return next;
            }
            if next_slope > 0.0 {
                lower = (length, next_slope);
            } else {
                upper = (length, next_slope);
            }
            tries += 1;
        }
    }

    /// Extends a step along which the slope hardly changed.
    fn longer(&self, mut point: DualPoint, direction: &Vector6<f32>) -> DualPoint {
        let mut length = EXTENSION - 1.0;
        for _ in 0..MAX_EXTENSIONS {
            let next = self.at(point.twist + direction * length);
            // Stop once the residual no longer decreases.
            if next.residual.norm_squared() > 0.98 * point.residual.norm_squared()
                || direction.dot(&next.residual) < 0.0
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
    fn hessian(&self, point: &DualPoint) -> Matrix6<f32> {
        let mut hessian = Matrix6::zeros();
        for (cone, lever, nearest) in zip((&self.cones, &self.map.levers, &point.nearest)) {
            let derivative = cone.derivative(nearest);
            // r^ P, and r^ P (r^)ᵀ, whose columns are r × the rows of r^ P.
            let crossed = [0, 1, 2].map(|index| lever.cross(&derivative.column(index).into_owned()));
            let rows = [0, 1, 2]
                .map(|row| lever.cross(&Vector3::new(crossed[0][row], crossed[1][row], crossed[2][row])));
            for column in 0..3 {
                for row in column..3 {
                    hessian[(row, column)] += derivative[(row, column)];
                    hessian[(3 + row, 3 + column)] += rows[column][row];
                }
                for row in 0..3 {
                    hessian[(3 + row, column)] += crossed[column][row];
                }
            }
        }
        hessian
    }
}

/// Relative duality gap that the residual causes: the twist is the gradient of the sum of squares.
fn duality_gap(point: &DualPoint) -> f32 {
    2.0 * abs(point.twist.dot(&point.residual)) / point.square
}
