//! One step of Newton's method for a [`Hand`](super::Hand): see [`super::hand_inverse`].

use heapless::Vec;
use nalgebra::Vector3;

use super::hand::{Angles, FingerPosture, HandFinger, Range, angle, set_angle};
use super::hand_inverse::{FingertipTarget, InverseProblem, Iterate, Terms};
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

/// Weight `μ` of the secondary objective over the squared length of the finger. Position errors that it
/// causes are removed by the last iterations.
const SECONDARY: f32 = 1e-5;
/// Weight of the middle of the ranges if a direction is the secondary objective, over that of the direction.
pub(super) const TERTIARY: f32 = 1e-4;
/// Damping of joints that neither position nor direction determines, over the weight of the direction.
const DIRECTION_DAMPING: f32 = 0.05;
/// Damping of the last iterations over `μ`.
const FINAL_DAMPING: f32 = 0.1;
/// Largest change of an angle in one iteration [rad].
const MAX_STEP: f32 = 0.5;

/// Negative gradient and Hessian of one finger's cost over its variables; lower triangle only.
#[derive(Default)]
struct Block {
    gradient: [f32; MAX_CHAIN_JOINTS],
    hessian: [[f32; MAX_CHAIN_JOINTS]; MAX_CHAIN_JOINTS],
}

/// Motion of a finger's own joints: `step` − `follow` · step of the shared joint.
#[derive(Default)]
struct Move {
    step: [f32; MAX_CHAIN_JOINTS],
    follow: [f32; MAX_CHAIN_JOINTS],
}

impl InverseProblem<'_> {
    /// One step of Newton's method, or of the Gauss–Newton method where the Hessian is not positive definite
    /// or not needed.
    pub(super) fn step(&self, here: &Iterate, terms: Terms, damping: f32) -> Angles {
        let mut step = Angles::zeros();
        for irreducible in [self.irreducible, 0.0] {
            if self.try_step(here, terms, damping, irreducible, &mut step).is_some() {
                break;
            }
            step = Angles::zeros();
        }
        step
    }

    /// Writes the step to `step`, which is 0; `None` if the Hessian is not positive definite.
    fn try_step(
        &self,
        here: &Iterate,
        terms: Terms,
        damping: f32,
        irreducible: f32,
        step: &mut Angles,
    ) -> Option<()> {
        let shared = self.hand.shared.filter(|_| self.moves_shared);
        // Gradient and curvature of the shared joint, and those that remain when the fingers follow it.
        let (mut gradient, mut reduced, mut curvature) = (0.0, 0.0, 0.0);
        let mut follow = Angles::zeros();
        let (mut block, mut solution) = (Block::default(), Move::default());
        for (place, posture) in self.fingers().zip(&here.postures) {
            let (_, finger, target) = place;
            let own = finger.own();
            self.build(place, posture, here, (terms, damping, irreducible), &mut block);
            if block.solve(own, &mut solution).is_none() {
                self.build(place, posture, here, (terms, damping, 0.0), &mut block);
                block.solve(own, &mut solution)?;
            }
            let values = solution.step.iter().zip(&solution.follow);
            for (&joint, (&own_step, &own_follow)) in finger.variables.iter().zip(values).take(own) {
                set_angle(step, joint, own_step);
                set_angle(&mut follow, joint, own_follow);
            }
            if finger.shares && shared.is_some() {
                let row = block.hessian.get(own)?;
                let (mut pull, mut stiffness) = (*block.gradient.get(own)?, *row.get(own)?);
                gradient += target.weight * pull;
                for (coupling, (step, follow)) in
                    row.iter().zip(solution.step.iter().zip(&solution.follow)).take(own)
                {
                    pull -= coupling * step;
                    stiffness -= coupling * follow;
                }
                reduced += target.weight * pull;
                curvature += target.weight * stiffness;
            }
        }
        if let Some(shared) = shared.filter(|_| curvature != 0.0) {
            // Rejects NaN as well.
            if curvature.is_nan() || curvature <= 0.0 {
                return None;
            }
            let (lower, upper) = self.limits(shared);
            let range = Range { lower, upper, center: 0.0 };
            if !range.holds(angle(&here.angles, shared), gradient) {
                let shared_step = reduced / curvature;
                for (_, finger, _) in self.fingers().filter(|(_, finger, _)| finger.shares) {
                    for &joint in &finger.variables {
                        let followed = angle(step, joint) - angle(&follow, joint) * shared_step;
                        set_angle(step, joint, followed);
                    }
                }
                set_angle(step, shared, shared_step);
            }
        }
        let largest = step.iter().fold(0.0, |largest, value| math::max(largest, math::abs(*value)));
        if largest > MAX_STEP {
            *step *= MAX_STEP / largest;
        }
        Some(())
    }

    /// Computes gradient and Hessian of one finger's cost, with damping, without the joints that are held at
    /// a limit.
    fn build(
        &self,
        (index, finger, target): (usize, &HandFinger, &FingertipTarget),
        posture: &FingerPosture,
        here: &Iterate,
        (terms, damping, irreducible): (Terms, f32, f32),
        block: &mut Block,
    ) {
        let error = here.errors.get(index).copied().unwrap_or_default();
        finger.block(posture, &error, irreducible, block);
        let weight = self.emphasis * finger.secondary_weight();
        let mut floor = weight * FINAL_DAMPING;
        let own = finger.own();
        if terms == Terms::All {
            let center = weight * finger.add_secondary(block, posture, target, weight);
            floor = math::max(center, DIRECTION_DAMPING * weight);
            let places = finger.variables.iter().zip(&finger.ranges);
            for (gradient, (&joint, range)) in block.gradient.iter_mut().zip(places).take(own) {
                *gradient -= center * (angle(&here.angles, joint) - range.center);
            }
        }
        let diagonal = floor + damping * finger.length * finger.length;
        for (slot, row) in block.hessian.iter_mut().enumerate().take(finger.variables.len()) {
            row[slot] += diagonal;
        }
        for (slot, (&joint, range)) in finger.variables.iter().zip(&finger.ranges).enumerate().take(own) {
            let gradient = block.gradient.get(slot).copied().unwrap_or_default();
            if range.holds(angle(&here.angles, joint), gradient) {
                block.fix(slot, finger.variables.len());
            }
        }
    }
}

impl Range {
    /// Whether a joint at `angle` is at a limit beyond which the cost falls.
    fn holds(&self, angle: f32, gradient: f32) -> bool {
        angle <= self.lower && gradient < 0.0 || angle >= self.upper && gradient > 0.0
    }
}

impl HandFinger {
    /// `μ` [m²/rad²].
    pub(super) fn secondary_weight(&self) -> f32 {
        SECONDARY * self.length * self.length
    }

    /// Computes negative gradient and Hessian of `½‖e‖²`. The Hessian omits the second derivatives of the
    /// position (Gauss–Newton) unless the squared cosine between the error and its reducible part is below
    /// `irreducible`.
    #[inline]
    #[allow(clippy::needless_range_loop, reason = "rows and columns as in the formulae")]
    fn block(&self, posture: &FingerPosture, error: &Vector3<f32>, irreducible: f32, block: &mut Block) {
        let variables = self.variables.len().min(MAX_CHAIN_JOINTS);
        // Velocity of the tip per joint of the chain, and per variable.
        let mut of_joints = Vec::<_, MAX_CHAIN_JOINTS>::new();
        let mut columns = [Vector3::zeros(); MAX_CHAIN_JOINTS];
        let mut size = 0.0;
        for (joint, (axis, origin)) in self.joints.iter().zip(&posture.joints) {
            let of_joint = axis.cross(&(posture.reach - origin)) * joint.multiplier;
            if let Some(column) = columns.get_mut(usize::from(joint.actuated)) {
                *column += of_joint;
            }
            size += of_joint.norm_squared();
            // Cannot fail: a chain has no more joints.
            let _ = of_joints.push(of_joint);
        }
        let mut pull = 0.0;
        for row in 0..variables {
            let gradient = columns[row].dot(error);
            block.gradient[row] = gradient;
            pull += gradient * gradient;
            for column in 0..=row {
                block.hessian[row][column] = columns[row].dot(&columns[column]);
            }
        }
        if pull >= irreducible * size * error.norm_squared() {
            return;
        }
        // (aᵢ × Jⱼ) · e = (e × aᵢ) · Jⱼ for each j from i on.
        for (index, (joint, (axis, _))) in self.joints.iter().zip(&posture.joints).enumerate() {
            let factor = error.cross(axis) * joint.multiplier;
            let later = self.joints.get(index..).unwrap_or_default();
            let mut later = later.iter().zip(of_joints.get(index..).unwrap_or_default());
            if let Some((_, own)) = later.next() {
                block.add(joint.actuated, joint.actuated, -factor.dot(own));
            }
            for (other, of_joint) in later {
                // A pair of joints with the same variable counts twice.
                let value = factor.dot(of_joint);
                let twice = other.actuated == joint.actuated;
                block.add(joint.actuated, other.actuated, if twice { -2.0 * value } else { -value });
            }
        }
    }

    /// Adds the secondary objective of direction, times `weight`. Returns the weight of the middle of the
    /// ranges over `weight`.
    fn add_secondary(
        &self,
        block: &mut Block,
        posture: &FingerPosture,
        target: &FingertipTarget,
        weight: f32,
    ) -> f32 {
        let Some(direction) = target.direction else { return 1.0 };
        let pointing = &posture.pointing;
        let mut sums = [Vector3::zeros(); MAX_CHAIN_JOINTS];
        for (joint, (axis, _)) in self.joints.iter().zip(&posture.joints) {
            if let Some(sum) = sums.get_mut(usize::from(joint.actuated)) {
                *sum += axis.cross(pointing) * joint.multiplier;
            }
        }
        // Gauss–Newton suffices: either the deviation is small, or the target is out of reach, where
        // convergence speed does not matter.
        let rows = block.gradient.iter_mut().zip(&mut block.hessian).zip(&sums);
        for (length, ((gradient, row), sum)) in (1..).zip(rows).take(self.variables.len()) {
            *gradient += weight * sum.dot(&direction);
            for (value, other) in row.iter_mut().zip(&sums).take(length) {
                *value += weight * sum.dot(other);
            }
        }
        TERTIARY
    }
}

impl Block {
    /// Adds to the lower triangle.
    #[inline]
    fn add(&mut self, one: u8, other: u8, value: f32) {
        let row = self.hessian.get_mut(usize::from(one.max(other)));
        let place = row.and_then(|row| row.get_mut(usize::from(one.min(other))));
        if let Some(place) = place {
            *place += value;
        }
    }

    /// Removes a variable.
    fn fix(&mut self, slot: usize, variables: usize) {
        for (index, row) in self.hessian.iter_mut().enumerate().take(variables) {
            if index == slot {
                row.iter_mut().take(slot).for_each(|value| *value = 0.0);
                row[slot] = 1.0;
            } else if index > slot {
                row[slot] = 0.0;
            }
        }
        if let Some(gradient) = self.gradient.get_mut(slot) {
            *gradient = 0.0;
        }
    }

    /// Solves for the first `n` variables by LDLᵀ, with the gradient and row `n` as right-hand sides; `None`
    /// if the Hessian is not positive definite.
    #[inline]
    #[allow(clippy::needless_range_loop, reason = "rows and columns as in the formulae")]
    fn solve(&mut self, n: usize, solution: &mut Move) -> Option<()> {
        let n = n.min(MAX_CHAIN_JOINTS);
        let mut inverse = [0.0; MAX_CHAIN_JOINTS];
        let coupling = self.hessian.get(n).copied().unwrap_or_default();
        for row in 0..n {
            // The previous rows hold L, this one L·D at first.
            for column in 1..row {
                let mut value = self.hessian[row][column];
                for other in 0..column {
                    value -= self.hessian[row][other] * self.hessian[column][other];
                }
                self.hessian[row][column] = value;
            }
            let full = self.hessian[row][row];
            let (mut pivot, mut values) = (full, (self.gradient[row], coupling[row]));
            for column in 0..row {
                let value = self.hessian[row][column];
                let scaled = value * inverse[column];
                self.hessian[row][column] = scaled;
                pivot -= value * scaled;
                values.0 -= scaled * solution.step[column];
                values.1 -= scaled * solution.follow[column];
            }
            // NaN, or below the rounding error of its terms.
            if pivot.is_nan() || pivot <= 3e-7 * full {
                return None;
            }
            inverse[row] = 1.0 / pivot;
            (solution.step[row], solution.follow[row]) = values;
        }
        for row in (0..n).rev() {
            let (mut step, mut follow) =
                (solution.step[row] * inverse[row], solution.follow[row] * inverse[row]);
            for below in row + 1..n {
                let factor = self.hessian[below][row];
                step -= factor * solution.step[below];
                follow -= factor * solution.follow[below];
            }
            (solution.step[row], solution.follow[row]) = (step, follow);
        }
        Some(())
    }
}
