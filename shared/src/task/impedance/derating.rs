use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::tuning::{
    DERATED_RESTITUTION, DERATING_END, DERATING_FADE, DERATING_GROWTH, FORCE_FADE, MAX_DERATING,
    MAX_IMPACT_TICKS, MIN_ALTERNATIONS, MIN_DERATING, MIN_IMPACT_SPEED, MIN_JUMP, OSCILLATION_TICKS,
    UNDAMPED,
};
use crate::math::abs;

/// Derating of the impedance on a surface that is too stiff for it.
///
/// Beyond [a stiffness](super::ImpedanceSettings::max_contact_stiffness) that depends on impedance and arm a
/// contact oscillates. The stiffness of the surface is unknown, but the oscillation can be detected. A tool
/// that bounces leaves faster than it came, which no passive surface causes. In lasting contact the force
/// jumps up and down, and the jumps do not get smaller. Either raises mass and damping by the same factor,
/// until the contact is stable. The stiffness of the impedance is unchanged, and so is the force at rest. The
/// factor decays once the tool has been free for a while.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Derating {
    /// Factor of mass and damping: 1 to `MAX_DERATING`.
    factor: f32,
    /// Force of the last tick, and its decaying peak [N].
    force: f32,
    peak: f32,
    /// Last downward and last upward jump [N].
    jumps: [f32; 2],
    /// Whether the last jump was upwards, and ticks since then.
    is_upwards: bool,
    ticks: u8,
    /// Number of undamped jumps of the present oscillation.
    alternations: u8,
    /// Velocity of the tool before the contact [m/s], and ticks since it began; 0 in free space.
    approach: [f32; 3],
    contact_ticks: u8,
}

impl Derating {
    /// No derating.
    pub const NONE: Self = Self {
        factor: 1.0,
        force: 0.0,
        peak: 0.0,
        jumps: [0.0; 2],
        is_upwards: false,
        ticks: u8::MAX,
        alternations: 0,
        approach: [0.0; 3],
        contact_ticks: 0,
    };

    /// Factor of mass and damping.
    pub const fn factor(&self) -> f32 {
        self.factor
    }

    /// Updates the derating with the magnitude of the external force [N]. Changes below `threshold` [N] are
    /// no jumps.
    pub fn update(&mut self, force: f32, contact: bool, threshold: f32) {
        let change = force - core::mem::replace(&mut self.force, force);
        let faded = FORCE_FADE * self.peak;
        self.peak = if force > faded { force } else { faded };
        self.ticks = self.ticks.saturating_add(1);
        let jump = abs(change);
        if jump > threshold && jump > MIN_JUMP * self.peak && (change > 0.0) != self.is_upwards {
            self.add_jump(jump);
        } else if self.factor > 1.0 && !contact && self.ticks > DERATING_END {
            let factor = 1.0 + DERATING_FADE * (self.factor - 1.0);
            // Ends at exactly 1: the impedance as configured.
            self.factor = if factor > MIN_DERATING { factor } else { 1.0 };
        }
    }

    /// Adds a jump [N] in the opposite direction of the last one.
    fn add_jump(&mut self, jump: f32) {
        self.is_upwards = !self.is_upwards;
        let [down, up] = &mut self.jumps;
        let before = core::mem::replace(if self.is_upwards { up } else { down }, jump);
        if self.ticks > OSCILLATION_TICKS {
            self.alternations = 0;
        } else if jump > UNDAMPED * before {
            self.alternations = self.alternations.saturating_add(1);
        }
        self.ticks = 0;
        if self.alternations >= MIN_ALTERNATIONS {
            self.raise(DERATING_GROWTH);
        }
    }

    /// Compares the velocity of the tool after an impact with that before it [m/s]; `last` is that of the
    /// last tick.
    pub fn check_rebound(&mut self, contact: bool, last: &Vector3<f32>, velocity: &Vector3<f32>) {
        if contact {
            if self.contact_ticks == 0 {
                self.approach = (*last).into();
            }
            self.contact_ticks = self.contact_ticks.saturating_add(1);
            return;
        }
        let ticks = core::mem::replace(&mut self.contact_ticks, 0);
        if (1..=MAX_IMPACT_TICKS).contains(&ticks) {
            self.add_impact(&self.approach.into(), velocity);
        }
    }

    /// Adds an impact: velocities of the tool before and after it [m/s].
    #[inline(never)]
    fn add_impact(&mut self, approach: &Vector3<f32>, velocity: &Vector3<f32>) {
        let squared = approach.norm_squared();
        if squared < MIN_IMPACT_SPEED * MIN_IMPACT_SPEED {
            return;
        }
        let restitution = -approach.dot(velocity) / squared;
        if restitution < 1.0 {
            // The bounce decays by itself, however its force has been sampled.
            self.alternations = 0;
        } else {
            // The impact changes the velocity by 1 + restitution, inversely proportional to the factor.
            self.raise((1.0 + restitution) * (1.0 / (1.0 + DERATED_RESTITUTION)));
            self.ticks = 0;
        }
    }

    fn raise(&mut self, growth: f32) {
        let factor = self.factor * growth;
        self.factor = if factor < MAX_DERATING { factor } else { MAX_DERATING };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(forces: impl IntoIterator<Item = f32>) -> f32 {
        let mut derating = Derating::NONE;
        forces.into_iter().for_each(|force| derating.update(force, force > 1.5, 1.5));
        derating.factor()
    }

    /// A bouncing tool: in contact for one tick in eight.
    fn bounces(peak: f32, kept: f32, count: usize) -> impl Iterator<Item = f32> {
        let peaks = core::iter::successors(Some(peak), move |peak| Some(peak * kept)).take(count);
        peaks.flat_map(|peak| core::iter::once(peak).chain([0.0; 7]))
    }

    #[test]
    fn jumps_that_do_not_fade_raise_the_factor_to_its_limit() {
        // Up and down, up and down: the fifth jump is the fourth that follows another. From then on a factor
        // of 1.3 for each.
        assert!((after(bounces(60.0, 1.0, 3)) - 1.3 * 1.3).abs() < 1e-5);
        assert!((after(bounces(60.0, 1.0, 20)) - MAX_DERATING).abs() < 1e-5);
    }

    #[test]
    fn what_is_no_oscillation_leaves_the_impedance_as_it_is() {
        // A bounce that decays by itself, one push and release, and a person who shakes the tool with 20 N at
        // 3 Hz.
        assert!((after(bounces(60.0, 0.6, 10)) - 1.0).abs() < f32::EPSILON);
        assert!((after(bounces(60.0, 1.0, 1)) - 1.0).abs() < f32::EPSILON);
        let shaken = (0..500_u16).map(|tick| 20.0 * abs(crate::math::sin_cos(f32::from(tick) * 0.188).0));
        assert!((after(shaken) - 1.0).abs() < f32::EPSILON);
    }

    /// The factor after an impact of `ticks` along x, with velocities of the tool before and after it [m/s].
    fn after_impact(derating: &mut Derating, ticks: usize, before: f32, after: f32) -> f32 {
        let [before, after] = [before, after].map(|speed| Vector3::x() * speed);
        derating.check_rebound(false, &before, &before);
        (0..ticks).for_each(|_| derating.check_rebound(true, &before, &before));
        derating.check_rebound(false, &before, &after);
        derating.factor()
    }

    #[test]
    fn a_rebound_faster_than_the_impact_derates_at_once() {
        // The velocity changed by 0.4 m/s; half the impact's speed would have been a change of 0.15 m/s.
        let mut derating = Derating::NONE;
        assert!((after_impact(&mut derating, 2, 0.1, -0.3) - 0.4 / 0.15).abs() < 1e-5);
        // Each further one counts, up to the limit.
        assert!((after_impact(&mut derating, 1, 0.1, -0.1) - 0.4 / 0.15 * 0.2 / 0.15).abs() < 1e-5);
        assert!((after_impact(&mut derating, 1, 0.05, -10.0) - MAX_DERATING).abs() < 1e-5);
    }

    #[test]
    fn a_passive_surface_a_person_and_a_slow_touch_do_not_derate() {
        for (ticks, before, after) in [(2, 0.1, -0.09), (2, 0.1, 0.3), (6, 0.1, -0.3), (1, 0.02, -0.3)] {
            let mut derating = Derating::NONE;
            let factor = after_impact(&mut derating, ticks, before, after);
            assert!((factor - 1.0).abs() < f32::EPSILON, "{ticks} {before} {after}: {factor}");
        }
        // What bounces slower and slower is not derated, even if its force is sampled at its peak only later.
        let mut derating = Derating::NONE;
        for force in bounces(60.0, 1.0, 20) {
            derating.update(force, force > 1.5, 1.5);
            derating.check_rebound(force > 1.5, &Vector3::x(), &(Vector3::x() * -0.9));
        }
        assert!((derating.factor() - 1.0).abs() < f32::EPSILON);
    }

    #[test]
    fn the_factor_fades_exactly_to_one_once_the_tool_is_free() {
        let mut derating = Derating::NONE;
        bounces(60.0, 1.0, 6).for_each(|force| derating.update(force, force > 1.5, 1.5));
        let raised = derating.factor();
        // In contact it keeps the factor.
        (0..500).for_each(|_| derating.update(6.0, true, 1.5));
        assert!(raised > 2.0 && (derating.factor() - raised).abs() < f32::EPSILON);
        (0..600).for_each(|_| derating.update(0.0, false, 1.5));
        assert!((derating.factor() - 1.0).abs() < f32::EPSILON);
    }
}
