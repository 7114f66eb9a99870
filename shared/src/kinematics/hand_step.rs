//! One step of Newton's method for a [`Hand`](super::Hand): see [`super::hand_inverse`].

use heapless::Vec;
use nalgebra::{SMatrix, SVector, Vector3};

use super::hand::{Angles, HandFinger, MAX_FINGERS};
use super::hand_inverse::{FingertipTarget, Point, Problem, Terms};
use super::posture::Posture;
use crate::model::MAX_CHAIN_JOINTS;

/// Weight `μ` of the secondary objective over the squared length of the finger. Position errors that it
/// causes are removed by the last iterations.
const SECONDARY: f32 = 1e-5;
/// Weight of the middle of the ranges where a direction is the secondary objective, over that of the
/// direction.
pub(super) const TERTIARY: f32 = 1e-3;
/// Damping of joints that neither position nor direction decides, over the weight of the direction.
const DIRECTION_DAMPING: f32 = 0.05;
/// Damping of the last iterations over `μ`.
const FINAL_DAMPING: f32 = 0.1;
/// Largest change of an angle in one iteration [rad].
const MAX_STEP: f32 = 0.5;

/// Negative gradient and Hessian of one finger's cost over its variables; lower triangle only.
struct Block {
    gradient: SVector<f32, MAX_CHAIN_JOINTS>,
    hessian: SMatrix<f32, MAX_CHAIN_JOINTS, MAX_CHAIN_JOINTS>,
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
        let mut moves: Vec<Move, MAX_FINGERS> = Vec::new();
        for ((index, finger, target), posture) in self.fingers().zip(&here.postures) {
            let error = here.errors.get(index).copied().unwrap_or_default();
            let mut block = finger.block(posture, &error, irreducible);
            let weight = self.emphasis * finger.secondary_weight();
            let mut floor = weight * FINAL_DAMPING;
            if terms == Terms::All {
                let center = weight * finger.add_secondary(&mut block, posture, target, weight);
                floor = center.max(DIRECTION_DAMPING * weight);
                for (slot, &joint) in finger.variables.iter().enumerate() {
                    let (lower, upper) = self.limits(joint);
                    let away = here.angles[usize::from(joint)] - 0.5 * (lower + upper);
                    let is_own = slot + usize::from(finger.shares) < finger.variables.len();
                    block.gradient[slot] -= if is_own { center * away } else { 0.0 };
                }
            }
            let diagonal = floor + damping * finger.length * finger.length;
            for slot in 0..finger.variables.len() {
                block.hessian[(slot, slot)] += diagonal;
            }
            let own = finger.variables.len() - usize::from(finger.shares);
            for (slot, &joint) in finger.variables.iter().enumerate().take(own) {
                if self.is_held(joint, here.angles[usize::from(joint)], block.gradient[slot]) {
                    block.fix(slot, finger.variables.len());
                }
            }
            let solution = block.solve(own)?;
            if finger.shares && shared.is_some() {
                let (mut pull, mut stiffness) = (block.gradient[own], block.hessian[(own, own)]);
                gradient += target.weight * pull;
                for slot in 0..own {
                    pull -= block.hessian[(own, slot)] * solution.step[slot];
                    stiffness -= block.hessian[(own, slot)] * solution.follow[slot];
                }
                reduced += target.weight * pull;
                curvature += target.weight * stiffness;
            }
            let _ = moves.push(solution);
        }
        let mut step = Angles::zeros();
        let mut shared_step = 0.0;
        if let Some(shared) = shared.filter(|_| curvature != 0.0) {
            // Also when it is not a number.
            if curvature.is_nan() || curvature <= 0.0 {
                return None;
            }
            if !self.is_held(shared, here.angles[usize::from(shared)], gradient) {
                shared_step = reduced / curvature;
            }
            step[usize::from(shared)] = shared_step;
        }
        for ((_, finger, _), solution) in self.fingers().zip(&moves) {
            let own = finger.variables.len() - usize::from(finger.shares);
            for (slot, &joint) in finger.variables.iter().enumerate().take(own) {
                step[usize::from(joint)] = solution.step[slot] - solution.follow[slot] * shared_step;
            }
        }
        let largest = step.amax();
        Some(if largest > MAX_STEP { step * (MAX_STEP / largest) } else { step })
    }

    /// Whether a joint stands at a limit beyond which the cost falls.
    fn is_held(&self, joint: u8, angle: f32, gradient: f32) -> bool {
        let (lower, upper) = self.limits(joint);
        angle <= lower && gradient < 0.0 || angle >= upper && gradient > 0.0
    }
}

/// How a finger's own joints move: `step` − `follow` · step of the shared joint.
struct Move {
    step: SVector<f32, MAX_CHAIN_JOINTS>,
    follow: SVector<f32, MAX_CHAIN_JOINTS>,
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
    fn block(&self, posture: &Posture, error: &Vector3<f32>, irreducible: f32) -> Block {
        let mut block = Block { gradient: SVector::zeros(), hessian: SMatrix::zeros() };
        let mut columns: Vec<(usize, Vector3<f32>), MAX_CHAIN_JOINTS> = Vec::new();
        let mut size = 0.0;
        for (joint, (axis, origin)) in self.joints.iter().zip(&posture.joints) {
            let column = axis.cross(&(posture.reach - origin)) * joint.multiplier;
            let slot = usize::from(joint.actuated);
            block.gradient[slot] += column.dot(error);
            size += column.norm_squared();
            let _ = columns.push((slot, column));
        }
        let pull = block.gradient.norm_squared();
        let exact = pull < irreducible * size * error.norm_squared();
        for (index, (slot, column)) in columns.iter().enumerate() {
            // (aᵢ × Jⱼ) · e = (e × aᵢ) · Jⱼ for each later j.
            let factor = match (self.joints.get(index), posture.joints.get(index)) {
                (Some(joint), Some((axis, _))) if exact => column - error.cross(axis) * joint.multiplier,
                _ => *column,
            };
            block.hessian[(*slot, *slot)] += factor.dot(column);
            for (other, later) in columns.iter().skip(index + 1) {
                let value = factor.dot(later);
                if other == slot {
                    // A pair of joints that move as one counts twice.
                    block.hessian[(*slot, *slot)] += 2.0 * value;
                } else {
                    block.add(*slot, *other, value);
                }
            }
        }
        block
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
        let mut columns: Vec<(usize, Vector3<f32>), MAX_CHAIN_JOINTS> = Vec::new();
        for (joint, (axis, _)) in self.joints.iter().zip(&posture.joints) {
            let slot = usize::from(joint.actuated);
            let column = axis.cross(&pointing) * joint.multiplier;
            block.gradient[slot] += weight * column.dot(&direction);
            // Gauss–Newton: the deviation is small or the target out of reach, where speed does not matter.
            let _ = columns.push((slot, column));
            for (other, before) in &columns {
                block.add(slot, *other, weight * before.dot(&column));
            }
            let before = columns.len() - 1;
            for (_, factor) in columns.iter().take(before).filter(|(other, _)| *other == slot) {
                block.hessian[(slot, slot)] += weight * factor.dot(&column);
            }
        }
        TERTIARY
    }
}

impl Block {
    /// Adds to the lower triangle.
    #[inline]
    fn add(&mut self, one: usize, other: usize, value: f32) {
        let place = if one > other { (one, other) } else { (other, one) };
        self.hessian[place] += value;
    }

    /// Takes a variable out.
    fn fix(&mut self, slot: usize, variables: usize) {
        for other in 0..variables {
            let place = if slot > other { (slot, other) } else { (other, slot) };
            self.hessian[place] = 0.0;
        }
        self.hessian[(slot, slot)] = 1.0;
        self.gradient[slot] = 0.0;
    }

    /// Solves for the first `n` variables by LDLᵀ, with the gradient and with row `n` at the right.
    #[inline]
    fn solve(&mut self, n: usize) -> Option<Move> {
        // In place: row `n` is not touched.
        let lower = &mut self.hessian;
        let mut inverse = SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        let (mut step, mut follow) = (SVector::zeros(), SVector::zeros());
        let has_row = n < MAX_CHAIN_JOINTS;
        for column in 0..n {
            let full = lower[(column, column)];
            let mut pivot = full;
            for k in 0..column {
                pivot -= lower[(column, k)] * lower[(column, k)] * inverse[k];
            }
            // Below the rounding of its terms, or not a number.
            if pivot.is_nan() || pivot <= 3e-7 * full {
                return None;
            }
            inverse[column] = 1.0 / pivot;
            for row in column + 1..n {
                for k in 0..column {
                    let product = lower[(row, k)] * lower[(column, k)] * inverse[k];
                    lower[(row, column)] -= product;
                }
            }
        }
        for row in 0..n {
            let mut values = (self.gradient[row], if has_row { lower[(n, row)] } else { 0.0 });
            for k in 0..row {
                let factor = lower[(row, k)] * inverse[k];
                values.0 -= factor * step[k];
                values.1 -= factor * follow[k];
            }
            (step[row], follow[row]) = values;
        }
        for row in (0..n).rev() {
            let mut values = (step[row] * inverse[row], follow[row] * inverse[row]);
            for k in row + 1..n {
                let factor = lower[(k, row)] * inverse[row];
                values.0 -= factor * step[k];
                values.1 -= factor * follow[k];
            }
            (step[row], follow[row]) = values;
        }
        Some(Move { step, follow })
    }
}
