//! Transitions between the phases of a grasp, and monitoring of the object.

use nalgebra::{IsometryMatrix3, Vector3};

use super::forces::ForceInputs;
use super::plan::{GraspPlan, ObjectControl};
use super::pose::PoseTrajectory;
use super::state::Fingers;
use super::tuning::{
    ASSUMED_FRICTION, CONTACT_LOSS_FRACTION, CONTACT_LOSS_TICKS, CONVERGED_TICKS, FORCE_NOISE, LIFT_HEIGHT,
    LOWER_SPEED, LOWER_START_TIME, MAX_DEFORMATION, MAX_DISPLACEMENT, MAX_FRICTION, MAX_LOWERING,
    MIN_FRICTION, OPEN_TIME, PROBE_RATE, PROBE_RELEASE_RATE, PROBE_SLIP_DISTANCE, PROBE_STOP_FRACTION,
    PROBE_TIMEOUT, SQUEEZE_TIME, SQUEEZE_TIMEOUT, SUPPORTED_FRACTION, SUPPORTED_TICKS, YIELD_DELAY,
    YIELD_RATE,
};
use super::{Failure, GraspFault, GraspHand, GraspState, PerFinger, Phase};
use crate::TICK;
use crate::grasp::WrenchInverse;
use crate::math;

impl GraspState {
    /// Checks that the object is in the hand and at its target.
    pub(super) fn check_object(
        &mut self,
        plan: &GraspPlan,
        inputs: &ForceInputs<'_>,
        fingers: &Fingers<'_>,
        object: &IsometryMatrix3<f32>,
    ) -> Result<(), GraspFault> {
        if !matches!(self.phase, Phase::ProbeFriction | Phase::Hold | Phase::Move | Phase::Lower) {
            return Ok(());
        }
        let limit = CONTACT_LOSS_FRACTION * plan.touch_force;
        let (finger, force) = inputs.min_normal_force();
        self.ticks_without_contact =
            if force < limit { self.ticks_without_contact.saturating_add(1) } else { 0 };
        if self.ticks_without_contact >= CONTACT_LOSS_TICKS {
            return Err(GraspFault::ContactLost { finger, force, limit });
        }
        let distance = self.tracker.deformation(&fingers.tips);
        if distance > MAX_DEFORMATION {
            return Err(GraspFault::Deformed { distance, limit: MAX_DEFORMATION });
        }
        let error = object.translation.vector - self.trajectory.point().frame.translation.vector;
        let distance = math::norm(&error);
        if distance > MAX_DISPLACEMENT {
            return Err(GraspFault::Displaced { distance, limit: MAX_DISPLACEMENT });
        }
        Ok(())
    }

    /// Advances the phases. Returns internal forces to superpose on the grip [N].
    pub(super) fn advance_phase(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        fingers: &Fingers<'_>,
    ) -> PerFinger<Vector3<f32>> {
        match self.phase {
            Phase::Squeeze => return self.squeeze(plan, inputs, inverse, fingers),
            Phase::ProbeFriction => return self.probe_friction(fingers),
            Phase::Move if self.trajectory.is_done() => self.enter(Phase::Hold),
            Phase::Lower => self.lower(hand),
            Phase::Open => {
                // All internal forces fall: those of the grip, of the feedback, and of the probe.
                let left = math::clamp(1.0 - TICK / (OPEN_TIME * self.grip_fraction), 0.0, 1.0);
                (self.grip_fraction, self.probe_force) = (self.grip_fraction * left, self.probe_force * left);
                self.forces.reduce_correction(left);
                return self.probe_forces(fingers);
            }
            _ => {}
        }
        [Vector3::zeros(); 3]
    }

    /// Raises the internal forces until they have converged. Returns the dither of open-loop forces.
    fn squeeze(
        &mut self,
        plan: &GraspPlan,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        fingers: &Fingers<'_>,
    ) -> PerFinger<Vector3<f32>> {
        if self.begins_anew(plan) {
            // Dry friction has moved the object while the forces rose. If the servos pushed it back, the
            // forces would change.
            self.origin = self.tracker.object;
            self.trajectory = PoseTrajectory::resting(self.origin);
        }
        let dither = if plan.only_feeds_forward() {
            self.forces.dither(inputs.map.contacts(), self.elapsed() - SQUEEZE_TIME)
        } else {
            None
        };
        self.grip_fraction = if dither.is_some() {
            1.0
        } else {
            math::clamp(self.grip_fraction + TICK / SQUEEZE_TIME, 0.0, 1.0)
        };
        let converged = self.grip_fraction >= 1.0
            && dither.is_none()
            && (!plan.feedback || self.forces.have_converged(inputs, inverse));
        self.step = if converged { self.step.saturating_add(1) } else { 0 };
        if self.step >= CONVERGED_TICKS {
            // Without feedback the probe force is not exact enough.
            let probes = plan.friction.is_none() && plan.feedback;
            (self.probe_force, self.initial_width) = (0.0, fingers.width());
            self.enter(if probes { Phase::ProbeFriction } else { Phase::Hold });
        } else if self.elapsed() > SQUEEZE_TIMEOUT {
            let (_, force) = inputs.min_normal_force();
            self.fail(Failure::NoGrip { force, limit: SQUEEZE_TIMEOUT }, Phase::Open);
        }
        dither.unwrap_or([Vector3::zeros(); 3])
    }

    /// Fingers 1 and 2 press towards each other with a rising internal force until one of them slides: its
    /// force ratio is the coefficient of friction.
    fn probe_friction(&mut self, fingers: &Fingers<'_>) -> PerFinger<Vector3<f32>> {
        let rises = self.step == 0;
        if rises {
            self.probe_force += PROBE_RATE * TICK;
            let [first, second, _] = self.forces.force_ratios;
            let ratio = if first > second { first } else { second };
            if self.initial_width - fingers.width() > PROBE_SLIP_DISTANCE || ratio > MAX_FRICTION {
                self.forces.friction = math::clamp(ratio, MIN_FRICTION, MAX_FRICTION);
                self.probe_force *= PROBE_STOP_FRACTION;
                self.step = 1;
            } else if self.elapsed() > PROBE_TIMEOUT {
                self.forces.friction = ASSUMED_FRICTION;
                self.step = 1;
            }
        } else {
            self.probe_force -= PROBE_RELEASE_RATE * TICK;
            if self.probe_force <= 0.0 {
                self.probe_force = 0.0;
                self.tracker.reset_anchors();
                self.enter(Phase::Hold);
            }
        }
        self.probe_forces(fingers)
    }

    /// The internal forces with which fingers 1 and 2 press towards each other [N].
    #[inline(never)]
    fn probe_forces(&self, fingers: &Fingers<'_>) -> PerFinger<Vector3<f32>> {
        let [one, two, _] = fingers.tips;
        let force = (two - one) * (self.probe_force / fingers.width());
        [force, -force, Vector3::zeros()]
    }

    /// Height of the object above the position at which it was grasped [m].
    #[inline(never)]
    pub(super) fn height(&self, hand: &GraspHand<'_>) -> f32 {
        let displacement =
            Vector3::from(self.tracker.object.translation) - Vector3::from(self.origin.translation);
        -down(hand).dot(&displacement)
    }

    /// Raises the target while the fingers press the object onto what it stood on when it was grasped: joint
    /// servos would press ever harder, and the grip would grow with that load. Returns whether it did.
    pub(super) fn yield_to_support(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        inputs: &ForceInputs<'_>,
    ) -> bool {
        let pressing = -weight_on_fingers(hand, &self.forces.weight);
        let yields = self.phase == Phase::Hold
            && self.elapsed() > YIELD_DELAY
            && !inputs.in_motion
            && plan.feedback
            && matches!(plan.control, ObjectControl::Differential(_))
            && pressing > FORCE_NOISE
            && math::abs(self.height(hand)) < LIFT_HEIGHT;
        if yields {
            self.trajectory.shift(&(down(hand) * (-pressing * YIELD_RATE * TICK)));
        }
        yields
    }

    /// Lowers the object until a support carries it.
    fn lower(&mut self, hand: &GraspHand<'_>) {
        if self.ticks == 1 {
            let start = self.trajectory.point().frame;
            let mut end = start;
            end.translation.vector += down(hand) * MAX_LOWERING;
            self.trajectory = PoseTrajectory::between(&start, &end, MAX_LOWERING / LOWER_SPEED);
        }
        let lost = self.initial_weight - weight_on_fingers(hand, &self.forces.load);
        let min_lost = (1.0 - SUPPORTED_FRACTION) * math::abs(self.initial_weight);
        let is_supported = self.elapsed() > LOWER_START_TIME && lost > math::max(min_lost, FORCE_NOISE);
        self.step = if is_supported { self.step.saturating_add(1) } else { 0 };
        if self.step >= SUPPORTED_TICKS {
            self.trajectory.stop();
            self.enter(Phase::Open);
        } else if self.trajectory.is_done() {
            self.fail(Failure::NoSupport { distance: MAX_LOWERING }, Phase::Hold);
        }
    }
}

/// Part of a `load` [N, N·m] against gravity [N].
#[inline(never)]
pub(super) fn weight_on_fingers(hand: &GraspHand<'_>, &[x, y, z, ..]: &[f32; 6]) -> f32 {
    -down(hand).dot(&Vector3::new(x, y, z))
}

/// Unit vector of gravity; 0 without gravity.
#[inline(never)]
fn down(hand: &GraspHand<'_>) -> Vector3<f32> {
    let norm = math::norm(hand.gravity);
    if norm > 0.0 { hand.gravity / norm } else { Vector3::zeros() }
}
