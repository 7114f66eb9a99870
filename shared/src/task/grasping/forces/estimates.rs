use nalgebra::Vector6;

use super::{ForceInputs, Forces};
use crate::TICK;
use crate::math;
use crate::task::grasping::tuning::{
    ANTICIPATION_DECAY_TIME, ANTICIPATION_GAIN, CONTACT_FILTER_GAIN, EARLIER_LOAD_FILTER_GAIN, FORCE_NOISE,
    FRICTION_AFTER_SLIP, INCIPIENT_SLIP_FRACTION, LOAD_FILTER_GAIN, LOAD_GROWTH_THRESHOLD, MAX_SLIP_GRIP,
    MAX_WEIGHT_FORCE, MAX_WEIGHT_MOMENT, MIN_FRICTION, MIN_FRICTION_STEP, MIN_NORMAL_FORCE, SLIP_DISTANCE,
    SLIP_GRIP_DECAY_TIME, SLIP_GRIP_STEP, SLIP_MIN_FRACTION, WEIGHT_FILTER_GAIN,
};
use crate::zip::zip;

impl Forces {
    /// Updates the estimates of load and friction from the force sensors, and detects slips.
    pub fn update_estimates(&mut self, inputs: &ForceInputs<'_>) {
        self.filter_load(inputs);
        self.anticipate_load(inputs.is_lifted);
        self.slip_grip *= 1.0 - TICK / SLIP_GRIP_DECAY_TIME;
        if self.detect_slip(inputs) && inputs.is_held {
            self.slips = self.slips.saturating_add(1);
            self.slip_grip = math::clamp(self.slip_grip + SLIP_GRIP_STEP, 0.0, MAX_SLIP_GRIP);
        }
    }

    fn filter_load(&mut self, inputs: &ForceInputs<'_>) {
        let load = if inputs.is_held { inputs.map.wrench(inputs.measured) } else { Vector6::zeros() };
        for (filtered, gain) in [
            (&mut self.load, LOAD_FILTER_GAIN),
            (&mut self.earlier_load, EARLIER_LOAD_FILTER_GAIN),
            (&mut self.weight, WEIGHT_FILTER_GAIN),
        ] {
            filtered.iter_mut().zip(&load).for_each(|(mean, reading)| *mean += gain * (reading - *mean));
        }
        // The weight is fed forward. If something else holds the object, what its control commands is part of
        // the measured load, which would then grow without bound.
        for (weight, max) in self.weight.chunks_exact_mut(3).zip([MAX_WEIGHT_FORCE, MAX_WEIGHT_MOMENT]) {
            weight.iter_mut().for_each(|weight| *weight = math::clamp(*weight, -max, max));
        }
    }

    /// Anticipates that a load that grows faster than noise continues to grow; otherwise the anticipated
    /// increase decays.
    fn anticipate_load(&mut self, is_lifted: bool) {
        let decay = 1.0 - TICK / ANTICIPATION_DECAY_TIME;
        let (mut growth, mut anticipated_square) = (0.0, 0.0);
        for (load, earlier, anticipated) in
            zip((&self.load, &self.earlier_load, &self.anticipated_load)).take(3)
        {
            growth += (load - earlier) * (load - earlier);
            anticipated_square += anticipated * anticipated;
        }
        let grows = is_lifted
            && growth > LOAD_GROWTH_THRESHOLD * LOAD_GROWTH_THRESHOLD
            && ANTICIPATION_GAIN * ANTICIPATION_GAIN * growth > anticipated_square * decay * decay;
        for (anticipated, load, earlier) in zip((&mut self.anticipated_load, &self.load, &self.earlier_load))
        {
            *anticipated = if grows { ANTICIPATION_GAIN * (load - earlier) } else { *anticipated * decay };
        }
    }

    /// Detects whether a contact slides or is about to. A slip of a held object lowers the friction estimate.
    fn detect_slip(&mut self, inputs: &ForceInputs<'_>) -> bool {
        let mut slip = false;
        let contacts = inputs.map.contacts().iter().zip(inputs.measured);
        let fingers = zip((
            contacts,
            &inputs.anchor_errors,
            &mut self.force_ratios,
            &mut self.excess,
            &mut self.anchor_errors,
        ));
        for ((contact, force), &error, ratio, excess, previous_error) in fingers {
            let (normal, tangential) = contact.components(force);
            let too_weak = normal < MIN_NORMAL_FORCE;
            let reading = if too_weak { 0.0 } else { tangential / normal };
            *ratio += CONTACT_FILTER_GAIN * (reading - *ratio);
            let reading = tangential - self.friction * INCIPIENT_SLIP_FRACTION * normal;
            *excess += CONTACT_FILTER_GAIN * (reading - *excess);
            let slides = error > SLIP_DISTANCE
                && error > *previous_error
                && *ratio > SLIP_MIN_FRACTION * self.friction;
            *previous_error = error;
            if slides && !too_weak && inputs.is_held {
                let friction = self.friction;
                let min = math::clamp(MIN_FRICTION_STEP * friction, MIN_FRICTION.min(friction), friction);
                self.friction = math::clamp(*ratio * FRICTION_AFTER_SLIP, min, friction);
            }
            slip |= slides || *excess > FORCE_NOISE;
        }
        slip
    }
}
