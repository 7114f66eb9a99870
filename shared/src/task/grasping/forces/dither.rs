//! Dither: decaying oscillations of the internal forces that remove the hysteresis of dry friction.
//!
//! While open-loop forces rise, the joints' dry friction absorbs up to its full magnitude of them. A decaying
//! oscillation takes it through ever smaller hysteresis loops, so that it ends near zero: the mechanical
//! counterpart of demagnetisation by a decaying alternating field. First all internal forces oscillate
//! together, then two tangential directions, which involve other joints. The amplitude is smaller where a
//! finger would exceed its limit or slide.

use core::f32::consts::TAU;

use nalgebra::Vector3;

use super::{Forces, limit_scale};
use crate::grasp::Contact;
use crate::math::{self, abs};
use crate::task::grasping::PerFinger;
use crate::task::grasping::tuning::{
    DITHER_FRICTION_FRACTION, DITHER_TIME, NORMAL_DITHER, NORMAL_DITHER_PERIOD, TANGENTIAL_DITHER,
    TANGENTIAL_DITHER_PERIODS,
};
use crate::zip::zip;

impl Forces {
    /// Dither forces at `time` [s] after its start [N]; `None` before and after.
    pub fn dither(&self, contacts: &[Contact], time: f32) -> Option<PerFinger<Vector3<f32>>> {
        if (0.0..DITHER_TIME).contains(&time) {
            let amplitude = self.max_normal_dither(contacts, NORMAL_DITHER);
            Some(self.scaled_base(amplitude * decaying_sine(time, NORMAL_DITHER_PERIOD)))
        } else if (DITHER_TIME..2.0 * DITHER_TIME).contains(&time) {
            let directions = tangential_directions(contacts);
            let max = TANGENTIAL_DITHER * self.min_internal_force();
            let amplitude = self.max_tangential_dither(contacts, &directions, max);
            let [first, second] =
                TANGENTIAL_DITHER_PERIODS.map(|period| amplitude * decaying_sine(time - DITHER_TIME, period));
            Some(directions.map(|[one, other]| one * first + other * second))
        } else {
            None
        }
    }

    /// The smallest of the internal forces of the last solution [N].
    fn min_internal_force(&self) -> f32 {
        let squares = self.base.iter().map(|force| Vector3::from(*force).norm_squared());
        math::sqrt(squares.fold(f32::INFINITY, |min, square| if square < min { square } else { min }))
    }

    /// The internal forces of the last solution, scaled by `fraction` [N].
    pub(super) fn scaled_base(&self, fraction: f32) -> PerFinger<Vector3<f32>> {
        self.base.map(|force| Vector3::from(force) * fraction)
    }

    /// Largest amplitude, at most `max` and as a fraction of the internal forces, with which no finger
    /// exceeds its limit.
    pub(super) fn max_normal_dither(&self, contacts: &[Contact], mut max: f32) -> f32 {
        for (contact, force) in contacts.iter().zip(&self.base) {
            let normal = contact.normal().dot(&Vector3::from(*force));
            max = limit_scale(max, normal, contact.limit() - normal);
        }
        max
    }

    /// Largest amplitude [N], at most `max`, of two independent oscillations along `directions` with which no
    /// finger exceeds its limit or comes near to sliding.
    pub(super) fn max_tangential_dither(
        &self,
        contacts: &[Contact],
        directions: &PerFinger<[Vector3<f32>; 2]>,
        mut max: f32,
    ) -> f32 {
        let friction = DITHER_FRICTION_FRACTION * self.friction;
        for (contact, force, directions) in zip((contacts, &self.base, directions)) {
            let (normal, tangential) = contact.components(&Vector3::from(*force));
            let [one, other] = directions.each_ref().map(|force| contact.components(force));
            // The worst case: both at their peaks, and all tangential parts aligned.
            let (normal_rate, tangential_rate) = (abs(one.0) + abs(other.0), one.1 + other.1);
            max = limit_scale(max, normal_rate, contact.limit() - normal);
            max = limit_scale(max, tangential_rate + friction * normal_rate, friction * normal - tangential);
        }
        max
    }
}

/// Sine of this period [s] whose amplitude falls linearly from 1 at `time` 0 to 0 at [`DITHER_TIME`]; 0
/// outside.
pub(super) fn decaying_sine(time: f32, period: f32) -> f32 {
    if !(0.0..DITHER_TIME).contains(&time) {
        return 0.0;
    }
    let (sine, _) = math::sin_cos(time * (TAU / period));
    (1.0 - time / DITHER_TIME) * sine
}

/// Two directions of internal forces with tangential components: fingers 1 and 2 press towards each other;
/// finger 1 presses more and finger 2 less towards finger 3. Each with 1 N along the lines between the
/// contacts.
pub(super) fn tangential_directions(contacts: &[Contact]) -> PerFinger<[Vector3<f32>; 2]> {
    let [one, two, three] = contacts else { return [[Vector3::zeros(); 2]; 3] };
    let unit = |from: &Contact, to: &Contact| {
        let difference = to.position() - from.position();
        difference / math::norm(&difference)
    };
    let (e12, e13, e23) = (unit(one, two), unit(one, three), unit(two, three));
    [[e12, e13], [-e12, -e23], [Vector3::zeros(), e23 - e13]]
}
