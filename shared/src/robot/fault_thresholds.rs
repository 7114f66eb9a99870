use crate::TICK;
use crate::math::abs;
use crate::model::{CURRENT_MARGIN, JUMP_FACTOR, JointModel};

/// Tolerance of the encoder-jump check for noise [counts].
const COUNT_NOISE: f32 = 2.0;

/// A joint counts as running away only beyond this share of its following-error limit, and above this share
/// of its velocity limit. Smaller shares detect it sooner, but mistake a push for it.
const RUNAWAY_DEVIATION: f32 = 0.25;
const RUNAWAY_SPEED: f32 = 0.1;

/// A torque beyond the weight, or its growth, must move a joint despite the errors of the model when it
/// exceeds twice the Coulomb friction plus this share of the torque limit. Smaller shares detect a dead
/// encoder sooner, but mistake a grip for it: `docs/fault-schedules.md` reports the trade-off.
const EXCESS_SHARE: f32 = 0.08;
const GROWTH_SHARE: f32 = 0.015;
const HELD_GROWTH_SHARE: f32 = 0.05;
/// The same for the effort that overcomes stiction.
const BREAKAWAY_SHARE: f32 = 0.1;
/// `accelerating_growth`: a multiple of the Coulomb friction plus a share of the largest torque.
const ACCELERATING_FRICTION: f32 = 10.0;
const ACCELERATING_SHARE: f32 = 0.01;
/// Share of `accelerating_growth` above which the ticks that showed a dead encoder still count: a hysteresis.
pub(crate) const HYSTERESIS_SHARE: f32 = 0.4;
/// A joint counts as moving from this speed on [rad/s], and from this number of counts per tick, the
/// resolution of a coarse encoder. A slower joint may be coming to rest in a grip.
const MOVING_SPEED: f32 = 0.0767;
const MOVING_COUNTS: f32 = 2.0;
/// The largest change of a dead encoder in a tick [counts].
const FLICKER_COUNTS: f32 = 1.5;
/// Largest Coulomb friction that the check for dead encoders allows, as a multiple of the model's.
const MAX_FRICTION: f32 = 5.0;

/// Thresholds of the checks of a joint's sensors and motion.
#[derive(Clone, Debug)]
pub(crate) struct FaultThresholds {
    /// Larger currents are a fault [counts].
    pub current: f32,
    /// Angles beyond these are a fault: the limits with a margin of the permitted following error [rad].
    pub min_angle: f32,
    pub max_angle: f32,
    /// Larger changes of the angle in one tick are an encoder error [rad].
    pub jump: f32,
    /// Effort that overcomes stiction, with a margin for errors of the feed-forward [N·m].
    pub breakaway: f32,
    /// Thresholds for a dead encoder of a joint that stands still [N·m]: the torque beyond the weight exceeds
    /// `excess`, and the effort has grown by more than `growth` if the joint moved before, by more than
    /// `held_growth` if not; or an effort of an acceleration, without weight and contact, has grown by more
    /// than `accelerating_growth`. In a stop in which no joint has to press, the smaller `stop_excess`
    /// applies.
    pub excess: f32,
    pub stop_excess: f32,
    pub growth: f32,
    pub held_growth: f32,
    pub accelerating_growth: f32,
    /// The smallest growth that has to be checked.
    pub min_growth: f32,
    /// Maximum friction beyond the model's [N·m].
    pub max_friction: f32,
    /// Minimum change of the angle per tick of a joint that moves, and maximum one of a dead encoder, which
    /// may flicker by one count [rad].
    pub moving: f32,
    pub flicker: f32,
    /// Minimum deviation from the reference of a joint that runs away, and its minimum change of the angle
    /// per tick [rad].
    pub deviation: f32,
    pub fast: f32,
}

impl FaultThresholds {
    /// Of a joint whose torques are at most `torque` [N·m].
    pub fn new(joint: &JointModel, torque: f32) -> Self {
        let radians_per_count = abs(joint.encoder.radians_per_count());
        let beyond_friction = |share: f32| 2.0 * joint.friction.coulomb + share * torque;
        let growth = beyond_friction(GROWTH_SHARE);
        let accelerating_growth =
            ACCELERATING_FRICTION * joint.friction.coulomb + ACCELERATING_SHARE * torque;
        Self {
            current: CURRENT_MARGIN * joint.motor.current_limit / joint.motor.current_resolution,
            min_angle: joint.limits.lower - joint.limits.following_error,
            max_angle: joint.limits.upper + joint.limits.following_error,
            jump: JUMP_FACTOR * joint.limits.velocity * TICK + COUNT_NOISE * radians_per_count,
            breakaway: beyond_friction(BREAKAWAY_SHARE),
            excess: beyond_friction(EXCESS_SHARE),
            stop_excess: beyond_friction(0.5 * EXCESS_SHARE),
            growth,
            held_growth: beyond_friction(HELD_GROWTH_SHARE),
            accelerating_growth,
            min_growth: growth.min(HYSTERESIS_SHARE * accelerating_growth),
            max_friction: (MAX_FRICTION - 1.0) * joint.friction.coulomb,
            moving: (MOVING_SPEED * TICK).max(MOVING_COUNTS * radians_per_count),
            flicker: FLICKER_COUNTS * radians_per_count,
            deviation: RUNAWAY_DEVIATION * joint.limits.following_error,
            fast: RUNAWAY_SPEED * joint.limits.velocity * TICK,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::joint;

    /// By hand, of 0.6 N·m: 2 · 0.02 + 0.015 · 0.6 N·m, which is below 0.4 · (10 · 0.02 + 0.01 · 0.6) N·m;
    /// and with less friction the latter, 0.4 · (10 · 0.0006 + 0.01 · 0.6) N·m.
    #[test]
    fn the_first_threshold_of_a_dead_encoder_is_the_least_that_counts() {
        for (coulomb, expected) in [(0.02, 0.049), (6e-4, 4.8e-3)] {
            let mut joint = joint("joint");
            joint.friction.coulomb = coulomb;
            let found = FaultThresholds::new(&joint, 0.6).min_growth;
            assert!((found - expected).abs() < 1e-6, "{coulomb}: {found} N·m");
        }
    }
}
