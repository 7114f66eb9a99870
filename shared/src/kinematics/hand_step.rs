//! One step of Newton's method for a [`Hand`](super::Hand): see [`super::hand_inverse`].

use nalgebra::Vector3;

use super::hand::{Angles, Coupling, HandFinger};
use super::hand_inverse::{FingertipTarget, Point, Problem, Terms};
use super::posture::Posture;
use crate::model::MAX_CHAIN_JOINTS;

/// Weight `μ` of the secondary objective over the squared length of the finger. Position errors that it
/// causes are removed by the last iterations.
const SECONDARY: f32 = 1e-5;
/// Weight of the middle of the ranges where a direction is the secondary objective, over that of the
/// direction.
pub(super) const TERTIARY: f32 = 1e-4;
/// Damping of joints that neither position nor direction decides, over the weight of the direction.
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

/// How a finger's own joints move: `step` − `follow` · step of the shared joint.
#[derive(Default)]
struct Move {
    step: [f32; MAX_CHAIN_JOINTS],
    follow: [f32; MAX_CHAIN_JOINTS],
}

impl Problem<'_> {
    /// One step of Newton's method; of Gauss and Newton's where the Hessian is not positive definite or not
    /// needed.
    pub(super) fn step(&self, here: &Point, terms: Terms, damping: f32) -> Angles {
        let step = self.try_step(here, terms, damping, self.irreducible);
        step.or_else(|| self.try_step(here, terms, damping, 0.0)).unwrap_or_else(Angles::zeros)
    }

    /// The step; `None` if the Hessian is not positive definite.
    fn try_step(&self, here: &Point, terms: Terms, damping: f32, irreducible: f32) -> Option<Angles> {
        let shared = self.hand.shared.filter(|_| self.moves_shared);
        // Gradient and curvature of the shared joint, and those that remain when the fingers follow it.
        let (mut gradient, mut reduced, mut curvature) = (0.0, 0.0, 0.0);
        let (mut step, mut follow) = (Angles::zeros(), Angles::zeros());
        let (mut block, mut solution) = (Block::default(), Move::default());
        for (place, posture) in self.fingers().zip(&here.postures) {
            let (_, finger, target) = place;
            let own = finger.variables.len() - usize::from(finger.shares);
            self.build(place, posture, here, (terms, damping, irreducible), &mut block);
            if block.solve(own, &mut solution).is_none() {
                self.build(place, posture, here, (terms, damping, 0.0), &mut block);
                block.solve(own, &mut solution)?;
            }
            let values = solution.step.iter().zip(&solution.follow);
            for (&joint, values) in finger.variables.iter().zip(values).take(own) {
                (step[usize::from(joint)], follow[usize::from(joint)]) = (*values.0, *values.1);
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
            // Also when it is not a number.
            if curvature.is_nan() || curvature <= 0.0 {
                return None;
            }
            if !self.is_held(shared, here.angles[usize::from(shared)], gradient) {
                let shared_step = reduced / curvature;
                step -= follow * shared_step;
                step[usize::from(shared)] = shared_step;
            }
        }
        let largest = step.amax();
        Some(if largest > MAX_STEP { step * (MAX_STEP / largest) } else { step })
    }

    /// Gradient and Hessian of one finger's cost, with damping, without the joints that are held at a limit.
    fn build(
        &self,
        (index, finger, target): (usize, &HandFinger, &FingertipTarget),
        posture: &Posture,
        here: &Point,
        (terms, damping, irreducible): (Terms, f32, f32),
        block: &mut Block,
    ) {
        let error = here.errors.get(index).copied().unwrap_or_default();
        finger.block(posture, &error, irreducible, block);
        let weight = self.emphasis * finger.secondary_weight();
        let mut floor = weight * FINAL_DAMPING;
        let own = finger.variables.len() - usize::from(finger.shares);
        if terms == Terms::All {
            let center = weight * finger.add_secondary(block, posture, target, weight);
            floor = center.max(DIRECTION_DAMPING * weight);
            for (gradient, &joint) in block.gradient.iter_mut().zip(&finger.variables).take(own) {
                let (lower, upper) = self.limits(joint);
                *gradient -= center * (here.angles[usize::from(joint)] - 0.5 * (lower + upper));
            }
        }
        let diagonal = floor + damping * finger.length * finger.length;
        for (slot, row) in block.hessian.iter_mut().enumerate().take(finger.variables.len()) {
            row[slot] += diagonal;
        }
        for (slot, &joint) in finger.variables.iter().enumerate().take(own) {
            if self.is_held(joint, here.angles[usize::from(joint)], block.gradient[slot]) {
                block.fix(slot, finger.variables.len());
            }
        }
    }

    /// Whether a joint stands at a limit beyond which the cost falls.
    fn is_held(&self, joint: u8, angle: f32, gradient: f32) -> bool {
        let (lower, upper) = self.limits(joint);
        angle <= lower && gradient < 0.0 || angle >= upper && gradient > 0.0
    }
}

impl HandFinger {
    /// `μ` [m²/rad²].
    pub(super) fn secondary_weight(&self) -> f32 {
        SECONDARY * self.length * self.length
    }

    /// Negative gradient and Hessian of `½‖e‖²`. The Hessian is without the second derivatives of the
    /// position (Gauss and Newton) unless the square of the cosine between the error and what the joints can
    /// reduce is below `irreducible`.
    #[inline]
    fn block(&self, posture: &Posture, error: &Vector3<f32>, irreducible: f32, block: &mut Block) {
        let of_joint = |joint: &Coupling, (axis, origin): &(Vector3<f32>, Vector3<f32>)| {
            axis.cross(&(posture.reach - origin)) * joint.multiplier
        };
        let mut columns = [Vector3::zeros(); MAX_CHAIN_JOINTS];
        let mut size = 0.0;
        for (joint, place) in self.joints.iter().zip(&posture.joints) {
            let column = of_joint(joint, place);
            if let Some(sum) = columns.get_mut(usize::from(joint.actuated)) {
                *sum += column;
            }
            size += column.norm_squared();
        }
        let variables = self.variables.len();
        let mut pull = 0.0;
        for (gradient, column) in block.gradient.iter_mut().zip(&columns).take(variables) {
            *gradient = column.dot(error);
            pull += *gradient * *gradient;
        }
        for (length, (row, column)) in (1..).zip(block.hessian.iter_mut().zip(&columns)).take(variables) {
            for (value, other) in row.iter_mut().zip(&columns).take(length) {
                *value = column.dot(other);
            }
        }
        if pull >= irreducible * size * error.norm_squared() {
            return;
        }
        let mut of_joints = [(0, Vector3::zeros()); MAX_CHAIN_JOINTS];
        for (value, (joint, place)) in of_joints.iter_mut().zip(self.joints.iter().zip(&posture.joints)) {
            *value = (joint.actuated, of_joint(joint, place));
        }
        for (index, (joint, (axis, _))) in self.joints.iter().zip(&posture.joints).enumerate() {
            // (aᵢ × Jⱼ) · e = (e × aᵢ) · Jⱼ for each later j.
            let factor = error.cross(axis) * joint.multiplier;
            for (offset, (other, column)) in of_joints.iter().take(self.joints.len()).skip(index).enumerate()
            {
                // A pair of joints that move as one counts twice.
                let twice = offset > 0 && *other == joint.actuated;
                let value = factor.dot(column);
                block.add(joint.actuated, *other, if twice { -2.0 * value } else { -value });
            }
        }
    }

    /// Adds the secondary objective of direction, times `weight`. Returns the weight of the middle of the
    /// ranges over `weight`.
    fn add_secondary(
        &self,
        block: &mut Block,
        posture: &Posture,
        target: &FingertipTarget,
        weight: f32,
    ) -> f32 {
        let Some(direction) = target.direction else { return 1.0 };
        let pointing = posture.tip.rotation * self.pointing;
        let mut sums = [Vector3::zeros(); MAX_CHAIN_JOINTS];
        for (joint, (axis, _)) in self.joints.iter().zip(&posture.joints) {
            if let Some(sum) = sums.get_mut(usize::from(joint.actuated)) {
                *sum += axis.cross(&pointing) * joint.multiplier;
            }
        }
        // Gauss–Newton: the deviation is small or the target out of reach, where speed does not matter.
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

    /// Takes a variable out.
    fn fix(&mut self, slot: usize, variables: usize) {
        for (index, row) in self.hessian.iter_mut().enumerate().take(variables) {
            if index == slot {
                row.iter_mut().take(slot).for_each(|value| *value = 0.0);
                row[slot] = 1.0;
            } else if index > slot {
                row[slot] = 0.0;
            }
        }
        self.gradient[slot] = 0.0;
    }

    /// Solves for the first `n` variables by LDLᵀ, with the gradient and with row `n` at the right; `None`
    /// if the Hessian is not positive definite.
    #[inline]
    fn solve(&mut self, n: usize, solution: &mut Move) -> Option<()> {
        let mut inverse = [0.0; MAX_CHAIN_JOINTS];
        let coupling = self.hessian.get(n).copied().unwrap_or_default();
        for row in 0..n {
            // The rows before hold L, this one L·D at first.
            let (before, rest) = self.hessian.split_at_mut_checked(row)?;
            let current = rest.first_mut()?;
            for (column, above) in before.iter().enumerate() {
                let (known, value) = current.split_at_mut_checked(column)?;
                let value = value.first_mut()?;
                for (one, other) in known.iter().zip(above) {
                    *value -= one * other;
                }
            }
            let full = *current.get(row)?;
            let (mut pivot, mut values) = (full, (*self.gradient.get(row)?, *coupling.get(row)?));
            let done = solution.step.iter().zip(&solution.follow);
            for ((value, inverse), (step, follow)) in current.iter_mut().zip(&inverse).zip(done).take(row) {
                let scaled = *value * inverse;
                pivot -= *value * scaled;
                *value = scaled;
                values.0 -= scaled * step;
                values.1 -= scaled * follow;
            }
            // Below the rounding of its terms, or not a number.
            if pivot.is_nan() || pivot <= 3e-7 * full {
                return None;
            }
            *inverse.get_mut(row)? = 1.0 / pivot;
            (*solution.step.get_mut(row)?, *solution.follow.get_mut(row)?) = values;
        }
        let unknown = solution.step.iter_mut().zip(&mut solution.follow).zip(&inverse);
        for ((step, follow), inverse) in unknown.take(n) {
            *step *= inverse;
            *follow *= inverse;
        }
        for row in (1..n).rev() {
            let factors = self.hessian.get(row)?;
            let ((step, last_step), (follow, last_follow)) =
                (solution.step.split_at_mut_checked(row)?, solution.follow.split_at_mut_checked(row)?);
            let (last_step, last_follow) = (*last_step.first()?, *last_follow.first()?);
            for ((step, follow), factor) in step.iter_mut().zip(follow).zip(factors) {
                *step -= factor * last_step;
                *follow -= factor * last_follow;
            }
        }
        Some(())
    }
}
