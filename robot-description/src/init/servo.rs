//! Limits and gains of a joint that fit each other.

use core::f32::consts::{E, TAU};

use tesaki::TICK;
use tesaki::control::ErrorObserver;
use tesaki::math::sqrt;
use tesaki::model::ObserverGains;

use super::motor::MotorPreset;
use crate::load::JointLoad;
use crate::robot::tree::SerialJoint;
use crate::robot::{following_errors, least_torque_rate};

/// Bandwidths of position loop and observer [rad/s], and the largest ratio of largest to smallest inertia for
/// which they are stable, the slowest first. The gains are for the geometric mean `J` of both. The
/// eigenvalues of the sampled loop stay within 0.99 for inertias of 0.22, 0.27, 0.35, 0.44 and 0.55 `J` and
/// more, and up to 3.4 `J`; half as much is kept in reserve, for errors of torque constant and masses.
const FINE: [(f32, f32, f32); 5] = [
    (5.0, 60.0, f32::INFINITY),
    (10.0, 80.0, 6.0),
    (20.0, 80.0, 3.6),
    (30.0, 120.0, 2.2),
    (45.0, 160.0, 1.4),
];
/// The same for encoders whose steps the derivative would amplify.
const COARSE: [(f32, f32, f32); 4] =
    [(5.0, 50.0, f32::INFINITY), (10.0, 50.0, 5.0), (15.0, 50.0, 4.2), (20.0, 80.0, 3.6)];
/// No faster than this [rad/s] unless friction demands it: real links are flexible, coarse encoders noisy.
const CALM: f32 = 20.0;
const CALM_COARSE: f32 = 15.0;
/// Distance by which the spring of the position loop should overcome Coulomb friction [rad]. Where it takes
/// much more, integral action needs seconds to turn the torque round, and the joint hunts about its target.
const FRICTION_DISTANCE: f32 = 0.05;
/// Encoders with fewer counts for a turn of the joint are coarse.
const COARSE_COUNTS: f32 = 16384.0;
/// Fraction of the velocity limit that a move over the whole range may reach.
const SPEED: f32 = 0.8;
/// Fraction of the torque left by gravity and friction that a move may need.
const ACCELERATION: f32 = 0.5;
/// Error of the model that following has to bear: masses a fifth too small, torque constant a fifth too
/// large.
const MODEL_ERROR: f32 = 0.5;
/// Time in which the torque may reach its limit [s].
const TORQUE_RISE: f32 = 0.02;
/// The least of it [s]: a gear bears a full torque within about this time.
const FASTEST_RISE: f32 = 0.01;
/// Largest velocity limit [rad/s]: a faster joint moves by more than 0.16 rad in a tick, which no servo
/// follows.
const FASTEST: f32 = 16.0;
/// Bounds of the following error [rad]; a joint of a small range gets no more than it can reach.
const FOLLOWING_ERRORS: (f32, f32) = (0.15, 0.5);
/// Friction above this fraction of the motor's torque is not believed.
const MOST_COULOMB: f32 = 0.3;
const MOST_VISCOUS: f32 = 0.5;
/// Distance of the start posture from the limits, as a fraction of the range.
const MARGIN: f32 = 0.1;

/// Of the current loop [Hz], and the time from sampling to torque [s]: assumed.
pub const CURRENT_BANDWIDTH: f32 = 300.0;
pub const CURRENT_DELAY: f32 = 3e-4;

/// Friction of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrictionChoice {
    /// That of the URDF.
    Urdf,
    /// The URDF has none.
    Missing,
    /// That of the URDF would take too much of the motor's torque.
    TooLarge,
}

/// Values of a joint.
#[derive(Clone, Debug)]
pub struct JointPlan {
    pub name: String,
    pub motor: MotorPreset,
    /// Why this motor.
    pub reason: String,
    pub load: JointLoad,
    /// Limits of the URDF: angles [rad], velocity [rad/s], effort [N·m].
    pub range: (f32, f32),
    pub urdf_velocity: f32,
    pub urdf_effort: f32,
    pub urdf_coulomb: f32,
    pub urdf_viscous: f32,
    pub coulomb_choice: FrictionChoice,
    pub viscous_choice: FrictionChoice,
    pub coulomb: f32,
    pub viscous: f32,
    pub velocity: f32,
    /// The velocity limit of URDF or motor, where ticks cannot follow it in this range [rad/s].
    pub too_fast: Option<f32>,
    pub torque: f32,
    pub torque_rate: f32,
    pub following_error: f32,
    /// Whether the torque, and not the speed, makes the trajectory filter slow.
    pub is_weak: bool,
    /// Smallest, largest and their geometric mean, with rotor [kg·m²].
    pub inertia: [f32; 3],
    pub filter_time: f32,
    /// Velocity of a move over the whole range [rad/s].
    pub peak_velocity: f32,
    pub rest_error: f32,
    pub bandwidth: f32,
    pub observer_bandwidth: f32,
    /// Whether it would swing together with other joints if it were faster.
    pub slowed: bool,
    /// Start angle [rad].
    pub start: f32,
}

impl JointPlan {
    /// For a motor, and why it was chosen, with the smallest and largest inertia that it feels, its rotor
    /// included [kg·m²], and a bandwidth `below` one [rad/s], if there is such a one.
    pub fn new(
        joint: &SerialJoint,
        load: JointLoad,
        [smallest, largest]: [f32; 2],
        (motor, reason): (MotorPreset, String),
        below: f32,
    ) -> Self {
        let limits = &joint.limits;
        let torque = if limits.torque > 0.0 { limits.torque.min(motor.torque()) } else { motor.torque() };
        let range = limits.upper - limits.lower;
        let reached = if limits.velocity > 0.0 { limits.velocity.min(motor.speed) } else { motor.speed };
        // The velocity at which the torque would have to rise in `FASTEST_RISE`.
        let velocity = reached.min(FASTEST).min(1.0 / (FASTEST_RISE * least_torque_rate(1.0, 1.0, range)));
        let choose = |value: f32, most: f32| match value {
            value if value <= 0.0 => FrictionChoice::Missing,
            value if value > most => FrictionChoice::TooLarge,
            _ => FrictionChoice::Urdf,
        };
        let coulomb_choice = choose(joint.friction.coulomb, MOST_COULOMB * torque);
        let viscous_choice = choose(joint.friction.viscous * velocity, MOST_VISCOUS * torque);
        let of = |choice, urdf, preset| if choice == FrictionChoice::Urdf { urdf } else { preset };
        let coulomb = of(coulomb_choice, joint.friction.coulomb, motor.coulomb);
        let viscous = of(viscous_choice, joint.friction.viscous, motor.viscous);

        let inertia = sqrt(smallest * largest);
        let (bandwidth, observer_bandwidth) =
            bandwidths(&motor, largest / smallest, coulomb / inertia, below);

        let spare =
            (0.8 * torque - 1.2 * (load.gravity + coulomb + 0.5 * viscous * velocity)).max(0.1 * torque);
        let by_speed = range / (E * SPEED * velocity);
        let by_torque = sqrt(largest * range / (ACCELERATION * spare));
        let filter_time = up(by_speed.max(by_torque).max(2.0 / bandwidth).max(0.2), 0.05);
        let acceleration = range / (filter_time * filter_time);
        let unknown = MODEL_ERROR * (load.gravity + coulomb) + 0.3 * largest * acceleration;
        let stiffness = inertia * bandwidth * bandwidth;
        let errors = following_errors(velocity, range);
        let wished = (2.0 * unknown / stiffness).max(errors.0).clamp(FOLLOWING_ERRORS.0, FOLLOWING_ERRORS.1);
        // Not on the bounds: the file has four digits.
        let following_error = up(wished, 0.01).min(0.99 * errors.1);
        let torque_rate = (torque / TORQUE_RISE).max(1.01 * least_torque_rate(torque, velocity, range));
        Self {
            name: joint.name.clone(),
            range: (limits.lower, limits.upper),
            urdf_velocity: limits.velocity,
            urdf_effort: limits.torque,
            urdf_coulomb: joint.friction.coulomb,
            urdf_viscous: joint.friction.viscous,
            coulomb_choice,
            viscous_choice,
            coulomb,
            viscous,
            velocity,
            too_fast: (reached > velocity).then_some(reached),
            torque,
            torque_rate,
            following_error,
            is_weak: by_torque > by_speed,
            inertia: [smallest, largest, inertia],
            filter_time,
            peak_velocity: range / (E * filter_time),
            rest_error: (1.2 * TAU / motor.counts_per_turn).max(7e-4),
            bandwidth,
            observer_bandwidth,
            slowed: below.is_finite(),
            start: 0.0_f32.clamp(limits.lower + MARGIN * range, limits.upper - MARGIN * range),
            motor,
            reason,
            load,
        }
    }

    /// The PID with the bandwidth of the state feedback: `(s + ω)²(s + ω/4)` but for the smallest term.
    /// Per inertia: proportional [1/s²], integral [1/s³], derivative [1/s]; cut-off [rad/s].
    pub const fn pid(&self) -> [f32; 4] {
        let w = self.bandwidth;
        [w * w, w * w * w / 4.0, 2.0 * w, 4.0 * w]
    }

    /// The servo's feedback.
    pub fn observer(&self) -> ErrorObserver {
        let [.., inertia] = self.inertia;
        let (bandwidth, observer_bandwidth) = (self.bandwidth, self.observer_bandwidth);
        let gains = ObserverGains { inertia, bandwidth, observer_bandwidth };
        ErrorObserver::with_lag(&gains, CURRENT_DELAY + 1.0 / (TAU * CURRENT_BANDWIDTH))
    }

    /// The largest damping [N·m·s/rad] that is stable in every posture with a sampled velocity, halved twice.
    pub const fn damping(&self) -> f32 {
        0.25 * self.inertia[0] / TICK
    }

    /// The longest sub-step of the physics [s] in which viscous friction stays well below critical.
    pub fn step(&self) -> f32 {
        let longest = 0.25 * self.motor.rotor_inertia / self.viscous.max(1e-9);
        [1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5].into_iter().find(|&step| step <= longest).unwrap_or(2e-5)
    }
}

/// Bandwidths of position loop and observer [rad/s] for a ratio of inertias and Coulomb friction per inertia
/// [rad/s²]: the slowest, or those of a position loop `below` a bandwidth.
fn bandwidths(motor: &MotorPreset, ratio: f32, friction: f32, below: f32) -> (f32, f32) {
    let (ladder, calm): (&[(f32, f32, f32)], f32) =
        if motor.counts_per_turn < COARSE_COUNTS { (&COARSE, CALM_COARSE) } else { (&FINE, CALM) };
    let mut chosen = (ladder[0].0, ladder[0].1);
    let possible = |(bandwidth, _, most): &&(f32, f32, f32)| ratio <= *most && *bandwidth < below;
    for &(bandwidth, observer_bandwidth, _) in ladder.iter().filter(possible) {
        if bandwidth <= calm || friction > FRICTION_DISTANCE * chosen.0 * chosen.0 {
            chosen = (bandwidth, observer_bandwidth);
        }
    }
    chosen
}

/// `value` rounded up to a multiple of `unit`.
fn up(value: f32, unit: f32) -> f32 {
    libm::ceilf(value / unit - 1e-3) * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use tesaki::model::{Friction, Inertial, JointLimits, Pose};

    /// A joint of ±1 rad, 2 rad/s and 4 N·m with 0.1 N·m and 0.02 N·m·s/rad of friction, moved by a
    /// XM430-W350; its links weigh 1 N·m.
    fn joint() -> (SerialJoint, JointLoad) {
        let limits = JointLimits {
            lower: -1.0,
            upper: 1.0,
            velocity: 2.0,
            torque: 4.0,
            torque_rate: 0.0,
            following_error: 0.0,
        };
        let joint = SerialJoint {
            name: "joint".to_owned(),
            origin: Pose::IDENTITY,
            axis: [0.0, 0.0, 1.0],
            link: Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] },
            limits,
            friction: Friction { coulomb: 0.1, viscous: 0.02 },
        };
        (joint, JointLoad { gravity: 1.0, posture: vec![0.0] })
    }

    /// With links of 1.5 to 3.5e-3 kg·m², and the rotor's 8.5e-3.
    const INERTIA: [f32; 2] = [0.010, 0.012];

    fn plan(joint: &SerialJoint, load: JointLoad, inertia: [f32; 2]) -> JointPlan {
        let motor = MotorPreset::find("xm430-w350").cloned().unwrap_or_else(|| panic!("a preset"));
        JointPlan::new(joint, load, inertia, (motor, String::new()), f32::INFINITY)
    }

    #[test]
    fn limits_and_gains_are_those_worked_by_hand() {
        let (joint, load) = joint();
        let plan = plan(&joint, load, INERTIA);
        // Mean inertia √(0.010·0.012). Bandwidth 15 rad/s, because
        // 0.1 N·m are overcome at 0.1/(0.010954·15²) = 0.041 rad. Filter by speed: 2/(e·0.8·2) = 0.46 s; by
        // torque, 0.8·4 − 1.2·(1 + 0.1 + 0.02) = 1.856 N·m are spare: √(0.012·2/0.928) = 0.16 s. Following:
        // 0.5·1.1 + 0.3·0.012·2/0.5² = 0.5788 N·m unknown, twice that over 0.010954·15² N·m/rad.
        for (got, expected) in [
            (plan.inertia[0], 0.010),
            (plan.inertia[1], 0.012),
            (plan.inertia[2], 0.010_954),
            (plan.bandwidth, 15.0),
            (plan.observer_bandwidth, 50.0),
            (plan.filter_time, 0.5),
            (plan.peak_velocity, 1.4715),
            (plan.torque, 4.0),
            (plan.torque_rate, 200.0),
            (plan.following_error, 0.47),
            (plan.rest_error, 1.8408e-3),
            (plan.damping(), 0.25),
            (plan.coulomb, 0.1),
        ] {
            assert!((got / expected - 1.0).abs() < 1e-3, "{got} instead of {expected}");
        }
    }

    #[test]
    fn limits_that_ticks_cannot_follow_are_lowered_and_the_others_are_plausible() {
        let (mut joint, load) = joint();
        // Of 2 rad, a torque is reversed within half in 10 ms each way at 50 rad/s; of 0.1 rad at 2.5 rad/s.
        // The rate that this takes is that of 20 ms, and of 10 ms, for 4 N·m.
        for (upper, velocity, lowered, torque_rate, following_error) in [
            (1.0, 100.0, 16.0, 200.0, 0.48),
            (-0.9, 100.0, 2.5, 404.0, 0.1485),
            (-0.9, 2.0, 2.0, 323.2, 0.1485),
        ] {
            (joint.limits.upper, joint.limits.velocity) = (upper, velocity);
            let motor = MotorPreset::generic(4.0, 40.0);
            let plan = JointPlan::new(&joint, load.clone(), INERTIA, (motor, String::new()), f32::INFINITY);
            for (got, expected) in [
                (plan.velocity, lowered),
                (plan.torque_rate, torque_rate),
                (plan.following_error, following_error),
            ] {
                assert!((got / expected - 1.0).abs() < 1e-3, "{got} instead of {expected}");
            }
            assert_eq!(plan.too_fast, (velocity > lowered).then_some(40.0));
        }
    }

    #[test]
    fn friction_is_met_by_a_faster_loop_or_not_believed_and_a_varying_inertia_by_a_slower_one() {
        let (mut joint, load) = joint();
        joint.friction.coulomb = 0.3;
        let much = plan(&joint, load.clone(), INERTIA);
        assert!(much.bandwidth > 15.0 && much.coulomb_choice == FrictionChoice::Urdf, "{much:?}");
        joint.friction = Friction { coulomb: 1.3, viscous: 1.1 };
        let absurd = plan(&joint, load.clone(), INERTIA);
        assert_eq!(
            (absurd.coulomb_choice, absurd.viscous_choice),
            (FrictionChoice::TooLarge, FrictionChoice::TooLarge)
        );
        assert!((absurd.coulomb - 0.1).abs() < 1e-6, "that of the motor");
        joint.friction = Friction { coulomb: 0.0, viscous: 0.0 };
        let varying = plan(&joint, load, [0.010, 0.11]);
        assert!(varying.bandwidth < 15.0 && varying.coulomb_choice == FrictionChoice::Missing, "{varying:?}");
    }

    #[test]
    fn a_joint_starts_away_from_its_limits() {
        let (mut joint, load) = joint();
        (joint.limits.lower, joint.limits.upper) = (0.263, 1.396);
        assert!((plan(&joint, load, INERTIA).start - 0.3763).abs() < 1e-6);
    }
}
