//! Values that are within what a model may hold, but protect nothing, are faults at once, or hold a joint
//! fast. Each bound is physics: how far a joint goes before a limit acts, what an encoder tells apart, what a
//! motor overcomes.

use std::f32::consts::TAU;

use tesaki::TICK;
use tesaki::control::{JointPoint, JointServo, Pid, PidState};
use tesaki::math;
use tesaki::model::{JointModel, RobotModel};

/// Of its range, that a joint may travel until its torque has turned round.
const TRAVEL: f32 = 0.5;
/// Of its range, beyond which an error is never reached, however far the joint leaves its reference.
const NEVER: f32 = 1.5;
/// Losing so many commands in a row is no rarity on a busy PC or a serial line [ticks].
const LOST_COMMANDS: f32 = 3.0;
/// In which a person reaches the emergency stop [s].
const UNATTENDED: f32 = 2.0;
/// Below this share of the largest voltage a drive has less than half of its speed.
const MIN_VOLTAGE: f32 = 0.5;
/// In which it shows whether an error grows or decays [ticks].
const LONG: usize = 1000;
/// Between two readings of a joint at rest, whose encoder flickers by one to either side.
const COUNT_NOISE: f32 = 2.0;

/// A value that protects nothing, is a fault at once, or holds a joint fast.
#[derive(Clone, Debug, PartialEq)]
pub struct ImplausibleValue {
    /// Index of its joint, of its chain for a force sensor; `None`: of the whole robot.
    pub joint: Option<usize>,
    /// Its name in `controller.toml`, below `joint`.
    pub key: &'static str,
    /// Its value, and why it is not plausible.
    pub message: String,
    /// A value that is.
    pub advice: String,
}

/// The values of a valid model that are not plausible.
pub fn implausible_values(model: &RobotModel) -> Vec<ImplausibleValue> {
    let mut found = Vec::new();
    for (index, joint) in model.joints.iter().enumerate() {
        let mut add = |key, (message, advice)| {
            found.push(ImplausibleValue { joint: Some(index), key, message, advice });
        };
        velocity(joint).into_iter().for_each(|text| add("encoder.counts_per_turn", text));
        friction(joint).into_iter().for_each(|text| add("friction", text));
        rotor(joint).into_iter().for_each(|text| add("motor.rotor_inertia", text));
        rest_error(joint).into_iter().for_each(|text| add("servo.rest_error", text));
        pid(joint).into_iter().for_each(|text| add("servo.pid", text));
        torque_rate(joint).into_iter().for_each(|text| add("limits.torque_rate", text));
        following_error(joint).into_iter().for_each(|text| add("limits.following_error", text));
    }
    let mut add = |key, (message, advice)| {
        found.push(ImplausibleValue { joint: None, key, message, advice });
    };
    timeout(model).into_iter().for_each(|text| add("safety.command_timeout", text));
    let (min, max) = (model.safety.supply_min, model.safety.supply_max);
    if min < MIN_VOLTAGE * max {
        let message = format!(
            "safety.supply_min = {min} V is below half of supply_max, {max} V: with it a drive has less than half of \
             its speed, and no fault"
        );
        add("safety.supply_min", (message, format!("{} V or more", MIN_VOLTAGE * max)));
    }
    for chain in &model.chains {
        let Some(sensor) = &chain.force_sensor else { continue };
        #[expect(clippy::cast_precision_loss, reason = "for a comparison")]
        let largest = sensor.force_resolution * sensor.saturation as f32;
        // What is not above 0 is told of itself.
        if largest > 0.0 && sensor.force_limit > largest {
            let message = format!(
                "force_sensor.force_limit = {} N is beyond what the sensor of {} measures, {largest} N: it is \
                 never reached",
                sensor.force_limit, chain.name
            );
            add("force_sensor.force_limit", (message, format!("below {largest} N")));
            break;
        }
    }
    found
}

pub(super) type Text = Option<(String, String)>;

/// A lower bound in three digits. It keeps the bound itself: rounded up.
pub(crate) fn at_least(bound: f32) -> String {
    rounded(bound, f64::ceil)
}

/// An upper bound in three digits: rounded down.
pub(super) fn at_most(bound: f32) -> String {
    rounded(bound, f64::floor)
}

fn rounded(bound: f32, round: fn(f64) -> f64) -> String {
    let bound = f64::from(bound);
    #[expect(clippy::cast_possible_truncation, reason = "of a single-precision number")]
    let decimals = 2 - bound.abs().log10().floor().clamp(-9.0, 2.0) as i32;
    let unit = 10_f64.powi(-decimals);
    // What is a multiple of the unit but for the last bits stays one.
    let nearest = (bound / unit).round();
    let exact = (bound / unit - nearest).abs() < 1e-4;
    let multiple = if exact { nearest } else { round(bound / unit) };
    format!("{:.*}", decimals.unsigned_abs() as usize, multiple * unit)
}

fn range(joint: &JointModel) -> f32 {
    joint.limits.upper - joint.limits.lower
}

/// The least rate [N·m/s] with which a torque [N·m] is reversed soon enough at a velocity limit [rad/s] in a
/// range [rad].
pub(crate) fn least_torque_rate(torque: f32, velocity: f32, range: f32) -> f32 {
    2.0 * torque * velocity / (TRAVEL * range)
}

/// A following error for a velocity limit [rad/s] in a range [rad]: the least and the largest that do what
/// they are for [rad].
pub(crate) fn following_errors(velocity: f32, range: f32) -> (f32, f32) {
    (3.0 * velocity * TICK, NEVER * range)
}

/// A velocity that the encoder does not tell from its noise.
fn velocity(joint: &JointModel) -> Text {
    let (counts, velocity) = (joint.encoder.counts_per_turn, joint.limits.velocity);
    let noise = COUNT_NOISE * TAU / (counts * TICK);
    (velocity < noise).then(|| {
        let message = format!(
            "limits.velocity = {velocity} rad/s is less than two counts of the encoder in a tick of 10 ms, at {counts} \
             counts a turn: its noise would be a fault"
        );
        (message, format!("{} rad/s or more, or an encoder with more counts a turn of the joint", at_least(noise)))
    })
}

/// Friction that the motor does not overcome.
fn friction(joint: &JointModel) -> Text {
    let (torque, coulomb) = (joint.torque_limit(), joint.friction.coulomb);
    (coulomb >= torque).then(|| {
        let message = format!(
            "Coulomb friction {coulomb} N·m is not below the motor's torque {torque:.3} N·m: it cannot move"
        );
        (message, "the true friction, or check torque_constant, current_limit and effort".to_owned())
    })
}

/// A motor without a rotor.
fn rotor(joint: &JointModel) -> Text {
    (joint.motor.rotor_inertia.abs() < f32::MIN_POSITIVE).then(|| {
        let message = "motor.rotor_inertia = 0: every motor has a rotor".to_owned();
        (message, "that of the motor's data sheet times the square of the gear ratio [kg·m²]".to_owned())
    })
}

/// A servo that corrects no error at rest.
fn rest_error(joint: &JointModel) -> Text {
    let (rest_error, following_error) = (joint.servo.rest_error, joint.limits.following_error);
    (rest_error >= following_error).then(|| {
        let message = format!(
            "servo.rest_error = {rest_error} rad is not below limits.following_error = {following_error} rad: no error \
             at rest is ever corrected"
        );
        (message, "some counts of the encoder [rad]".to_owned())
    })
}

/// Gains whose loop is unstable on the joint's own inertia and friction, from the largest error that is no
/// fault.
fn pid(joint: &JointModel) -> Text {
    let (gains, inertia, friction) = (&joint.servo.pid, joint.servo.observer.inertia, &joint.friction);
    let positive = [inertia, gains.cutoff, joint.limits.following_error];
    let not_negative =
        [gains.proportional, gains.integral, gains.derivative, friction.coulomb, friction.viscous];
    if !(positive.iter().all(|value| *value > 0.0) && not_negative.iter().all(|value| *value >= 0.0)) {
        return None;
    }
    let (pid, lag) = (Pid::new(gains), JointServo::new(joint).delay_fraction());
    let mut state = PidState::at(0.0);
    let reference = JointPoint { position: joint.limits.following_error, ..JointPoint::default() };
    let (mut angle, mut velocity, mut last) = (0.0_f32, 0.0_f32, 0.0_f32);
    let mut errors = [0.0_f32; LONG];
    for error in &mut errors {
        *error = (reference.position - angle).abs();
        let torque = pid.output(&mut state, &reference, angle);
        pid.integrate(&mut state, torque, torque, false);
        let pushed = velocity + TICK * (torque + lag * (last - torque)) / inertia;
        // Implicit, because friction only brakes, however large it is.
        let braked = pushed / (1.0 + TICK * friction.viscous / inertia);
        let coulomb = TICK * friction.coulomb / inertia;
        let next = braked - braked.clamp(-coulomb, coulomb);
        angle += 0.5 * TICK * (velocity + next);
        (velocity, last) = (next, torque);
    }
    // In the first quarter what decays may be larger than what grows.
    let largest = |quarter: usize| {
        let part = errors.chunks(LONG / 4).nth(quarter).unwrap_or_default();
        part.iter().copied().fold(0.0, f32::max)
    };
    let grows = largest(3) > largest(1) || !errors.iter().all(|error| error.is_finite());
    grows.then(|| {
        let [p, i, d] = [gains.proportional, gains.integral, gains.derivative]
            .map(|gain| math::round(10.0 * gain / inertia) / 10.0);
        let message = format!(
            "servo.pid, divided by the inertia that the servo assumes, is {p} 1/s², {i} 1/s³ and {d} 1/s: unstable on \
             that inertia with the joint's friction, an error grows"
        );
        let advice = "ω², ω³/4 and 2 ω for a bandwidth ω of some 20 rad/s: in controller.toml as they stand, on the board \
                      times the inertia";
        (message, advice.to_owned())
    })
}

/// At its velocity limit a joint goes on until its torque has turned round.
fn torque_rate(joint: &JointModel) -> Text {
    let limits = &joint.limits;
    let torque = joint.torque_limit();
    let time = 2.0 * torque / limits.torque_rate;
    let travel = limits.velocity * time;
    (travel > TRAVEL * range(joint)).then(|| {
        let message = format!(
            "limits.torque_rate = {} N·m/s reverses the torque of {torque} N·m in {time:.2} s; at the velocity \
             limit the joint goes {travel:.2} rad meanwhile, of a range of {:.2} rad",
            limits.torque_rate,
            range(joint)
        );
        let least = least_torque_rate(torque, limits.velocity, range(joint));
        (message, format!("{} N·m/s or more: a gear bears a full torque within some 10 ms", at_least(least)))
    })
}

/// An error that every fast motion makes, or none.
fn following_error(joint: &JointModel) -> Text {
    let (error, velocity) = (joint.limits.following_error, joint.limits.velocity);
    let step = velocity * TICK;
    let (least, largest) = following_errors(velocity, range(joint));
    if error < step {
        let message = format!(
            "limits.following_error = {error} rad is less than the joint moves in a tick at its velocity limit, {step:.3} \
             rad: a fault at once"
        );
        return Some((message, format!("at least {} rad, three times that", at_least(least))));
    }
    (error > largest).then(|| {
        let message = format!(
            "limits.following_error = {error} rad is more than the joint can leave its reference in a range of {:.2} \
             rad: never a fault",
            range(joint)
        );
        (message, format!("at most {} rad", at_most(largest)))
    })
}

/// Some commands may be late; without any for long, nobody leads the robot.
fn timeout(model: &RobotModel) -> Text {
    let time = model.safety.command_timeout;
    if time < LOST_COMMANDS * TICK {
        let message = format!(
            "safety.command_timeout = {time} s: {LOST_COMMANDS} lost commands in a row would be a fault"
        );
        return Some((message, "0.05 to 0.2 s".to_owned()));
    }
    (time > UNATTENDED).then(|| {
        let message = format!(
            "safety.command_timeout = {time} s: a robot goes on pressing or following for longer than {UNATTENDED} s \
             after the program that led it has died"
        );
        (message, format!("{UNATTENDED} s or less; 0.05 to 0.2 s protect a hand that a program leads"))
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    use tesaki::model::{Friction, PidGains};

    use crate::robot::shipped::{Bounds, NAMES, check_bounds, robot};

    #[test]
    fn the_limits_of_our_robots_are_plausible() {
        for name in NAMES {
            assert_eq!(implausible_values(&robot(name)), [], "{name}");
        }
    }

    /// One of hand3: finger1_bend, from −1.2 to 1.7 rad at 6 rad/s with 0.6 N·m; its sensors measure up to 20
    /// N.
    #[test]
    fn each_limit_has_bounds_on_both_sides_of_what_it_protects() {
        let cases: [Bounds; 9] = [
            // 2 counts · 2π / 1000 in 10 ms are 1.26 rad/s.
            (
                "encoder.counts_per_turn",
                |robot, value| {
                    robot.joints[1].encoder.counts_per_turn = 1000.0;
                    robot.joints[1].limits.velocity = value;
                },
                1.25,
                1.26,
            ),
            ("friction", |robot, value| robot.joints[1].friction.coulomb = value, 0.6, 0.59),
            // 6 rad/s · 2 · 0.6 N·m / rate is half of 2.9 rad at 4.966 N·m/s.
            ("limits.torque_rate", |robot, value| robot.joints[1].limits.torque_rate = value, 4.9, 5.0),
            // 6 rad/s · 10 ms.
            (
                "limits.following_error",
                |robot, value| robot.joints[1].limits.following_error = value,
                0.059,
                0.061,
            ),
            // 1.5 times 2 rad of finger1_swing is 3 rad.
            (
                "limits.following_error",
                |robot, value| robot.joints[0].limits.following_error = value,
                3.01,
                2.99,
            ),
            ("safety.command_timeout", |robot, value| robot.safety.command_timeout = value, 2.01, 1.99),
            ("safety.command_timeout", |robot, value| robot.safety.command_timeout = value, 0.02, 0.04),
            ("servo.rest_error", |robot, value| robot.joints[1].servo.rest_error = value, 0.25, 0.049),
            ("safety.supply_min", |robot, value| robot.safety.supply_min = value, 13.9, 14.1),
        ];
        check_bounds(&cases, implausible_values);
        let mut deaf = robot("hand3");
        deaf.chains[1].force_sensor.as_mut().unwrap().force_limit = 20.1;
        let found = implausible_values(&deaf);
        assert_eq!(found.len(), 1);
        assert!(found[0].message.contains("20 N") && found[0].joint.is_none(), "{found:?}");
    }

    /// Integral, derivative, cut-off, and the largest stable proportional gain, all per inertia; from
    /// `tests/oracles/pid_stability.py` (eigenvalues).
    const STABLE: &[[f32; 4]] = include!("../../../tests/oracles/data/pid_stability.in");

    #[test]
    fn a_pid_is_unstable_where_an_eigenvalue_of_its_loop_is_beyond_1() {
        let mut robot = robot("hand3");
        let joint = &mut robot.joints[1];
        joint.friction = Friction { coulomb: 0.0, viscous: 0.0 };
        let inertia = joint.servo.observer.inertia;
        for [integral, derivative, cutoff, limit] in STABLE.iter().copied() {
            for (factor, is_stable) in [(0.99, true), (1.01, false), (3.0, false)] {
                let [proportional, integral, derivative] =
                    [factor * limit, integral, derivative].map(|gain| gain * inertia);
                joint.servo.pid = PidGains { proportional, integral, derivative, cutoff };
                assert_eq!(pid(joint).is_none(), is_stable, "{factor} · {limit} 1/s²");
            }
        }
        // Friction that brakes more than the motor pushes makes nothing unstable.
        joint.servo.pid = PidGains {
            proportional: 400.0 * inertia,
            integral: 2000.0 * inertia,
            derivative: 40.0 * inertia,
            cutoff: 30.0,
        };
        for ratio in [0.0, 30.0, 250.0, 1000.0] {
            joint.friction.viscous = ratio * inertia;
            assert_eq!(pid(joint), None, "{ratio} 1/s");
        }
    }

    /// Whoever follows the advice is not given it again.
    #[test]
    fn what_is_advised_is_on_the_right_side_of_the_bound() {
        for (bound, least, most) in [
            (0.122_6, "0.123", "0.122"),
            (0.18, "0.180", "0.180"),
            (2.996, "3.00", "2.99"),
            (0.003_001, "0.00301", "0.00300"),
            (4.966, "4.97", "4.96"),
            (123.4, "124", "123"),
            (12_345.0, "12345", "12345"),
        ] {
            assert_eq!((at_least(bound).as_str(), at_most(bound).as_str()), (least, most), "{bound}");
        }
        let mut robot = robot("hand3");
        for (torque, velocity) in [(0.03, 1.0), (0.6, 6.0), (0.37, 0.001)] {
            let limits = &mut robot.joints[1].limits;
            (limits.torque, limits.velocity) = (torque, velocity);
            (limits.torque_rate, limits.following_error) = (1e-4, 1e-6);
            robot.joints[1].servo.rest_error = 0.0;
            for _ in 0..3 {
                for limit in implausible_values(&robot).iter().filter(|limit| limit.joint == Some(1)) {
                    let number = |word: &str| word.parse::<f32>().ok();
                    let advised = limit.advice.split(' ').find_map(number).unwrap();
                    let limits = &mut robot.joints[1].limits;
                    match limit.key {
                        "limits.torque_rate" => limits.torque_rate = advised,
                        "encoder.counts_per_turn" => limits.velocity = advised,
                        _ => limits.following_error = advised,
                    }
                }
            }
            assert_eq!(implausible_values(&robot), [], "{torque} N·m, {velocity} rad/s");
        }
    }
}
