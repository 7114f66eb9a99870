//! Values that work, but that few machines have: of another unit, or without the gear.

use std::f32::consts::TAU;

use tesaki::model::{ForceSensor, JointModel, Motor, Reaction, RobotModel, Safety};

use super::limits::{ImplausibleValue, Text, at_least};
use crate::load::CoupledChains;

/// The shortest time in which a full torque can bring a bare rotor to the velocity limit, or to the velocity
/// at which the lowest supply is induced [s]. The mechanical time constants of servo motors are 2 to 50 ms.
const FASTEST_ROTOR: f32 = 2e-4;
/// The longest such time [s].
const SLOWEST_ROTOR: f32 = 0.5;
/// Factor between the torque of the largest current and the torque limit from which one of them has another
/// unit: mA, mN·m/A and N·mm are all off by 1000.
const OTHER_UNIT: f32 = 3.0;
/// Distance from its target at which the position loop would overcome Coulomb friction [rad]: above this, the
/// joint hunts about its target for seconds.
const MUCH_STICKING: f32 = 0.5;
/// Velocity of the trajectory filter after a step, per step and filter time: 1/e.
const FILTER_PEAK: f32 = 0.367_879;
/// Of the finest encoders at the motor, 20 bit, through a gear of some 256 [counts a turn].
const FINEST_ENCODER: f32 = 2.7e8;
/// A limit of fewer counts of its sensor is hardly measured.
const FEW_COUNTS: f32 = 20.0;
/// Time constants of windings, from coreless motors to large ones with iron [s].
const WINDINGS: [f32; 2] = [1e-5, 0.02];
/// An error at rest above this is seen [rad].
const MUCH_REST_ERROR: f32 = 0.05;
/// Factor between the inertia that a servo assumes and those that its joint feels, from which one is wrong.
const OTHER_INERTIA: f32 = 2.0;
/// Least lever of a contact force about a force sensor [m].
const LEAST_LEVER: f32 = 5e-3;

/// The values of a valid model that are possible, but not likely.
pub fn doubtful_values(model: &RobotModel) -> Vec<ImplausibleValue> {
    let mut found = Vec::new();
    for (index, joint) in model.joints.iter().enumerate() {
        let mut add = |key, (message, advice)| {
            found.push(ImplausibleValue { joint: Some(index), key, message, advice });
        };
        rotor(joint, &model.safety).into_iter().for_each(|text| add("motor.rotor_inertia", text));
        torque(joint).into_iter().for_each(|text| add("motor.current_limit", text));
        winding(joint, &model.safety).into_iter().for_each(|text| add("motor.inductance", text));
        inner_loop(joint).into_iter().for_each(|text| add("motor.bandwidth", text));
        current(joint).into_iter().for_each(|text| add("motor.current_resolution", text));
        encoder(joint).into_iter().for_each(|text| add("encoder.counts_per_turn", text));
        rest_error(joint).into_iter().for_each(|text| add("servo.rest_error", text));
        observer(joint).into_iter().for_each(|text| add("servo.observer.observer_bandwidth", text));
        speed(joint).into_iter().for_each(|text| add("servo.filter_time", text));
        sticking(joint).into_iter().for_each(|text| add("servo.observer.bandwidth", text));
    }
    found.extend(servo_inertias(model));
    let mut add = |key, (message, advice)| {
        let value = ImplausibleValue { joint: None, key, message, advice };
        // Sensors that are alike are told of once.
        if !found.contains(&value) {
            found.push(value);
        }
    };
    if model.safety.damping <= 0.0 && model.safety.reaction != Reaction::Off {
        let message = "safety.damping = 0: a robot that is damped after a fault falls unbraked".to_owned();
        add("safety.damping", (message, "above 0 N·m·s/rad".to_owned()));
    }
    for sensor in model.chains.iter().filter_map(|chain| chain.force_sensor.as_ref()) {
        force(sensor).into_iter().for_each(|text| add("force_sensor.force_resolution", text));
        moment(sensor).into_iter().for_each(|text| add("force_sensor.torque_resolution", text));
    }
    found
}

/// Servos whose gains are for quite another inertia than their joints feel, with their rotors.
fn servo_inertias(model: &RobotModel) -> Vec<ImplausibleValue> {
    let mut found = Vec::new();
    for chains in CoupledChains::of_model(model) {
        let joints = || chains.motors.iter().filter_map(|&index| Some((index, model.joints.get(index)?)));
        let limits: Vec<(f32, f32)> =
            joints().map(|(_, joint)| (joint.limits.lower, joint.limits.upper)).collect();
        for ((index, joint), [smallest, largest]) in joints().zip(chains.joint_inertias(&limits)) {
            let inertia = joint.servo.observer.inertia;
            let (effect, factor) = if inertia > OTHER_INERTIA * largest {
                ("high: it may be unstable", inertia / largest)
            } else if inertia < smallest / OTHER_INERTIA {
                ("low: it is weak", smallest / inertia)
            } else {
                continue;
            };
            let message = format!(
                "servo.inertia = {inertia} kg·m²; the joint feels {smallest:.2e} to {largest:.2e} kg·m² with its rotor: \
                 all gains of its servo are {factor:.1} times too {effect}"
            );
            let advice = "without servo.inertia in controller.toml it is computed from links and rotor; on the board set \
                          servo.observer.inertia and the gains of servo.pid; or check motor.rotor_inertia and masses";
            let (joint, key) = (Some(index), "servo.inertia");
            found.push(ImplausibleValue { joint, key, message, advice: advice.to_owned() });
        }
    }
    found
}

/// A rotor that accelerates faster, or more slowly, than any.
fn rotor(joint: &JointModel, safety: &Safety) -> Text {
    let Motor { rotor_inertia: inertia, current_limit, torque_constant, .. } = joint.motor;
    let (torque, velocity) = (current_limit * torque_constant, joint.limits.velocity);
    let time = inertia * velocity / torque;
    if inertia <= 0.0 {
        return None;
    }
    // A joint may be limited to a small part of what the supply gives its motor.
    let fastest = velocity.max(safety.supply_min / torque_constant);
    let shortest = inertia * fastest / torque;
    if shortest < FASTEST_ROTOR {
        let message = format!(
            "motor.rotor_inertia = {inertia:e} kg·m²: {torque} N·m would bring the rotor to {fastest:.1} rad/s in \
             {:.3} ms; no motor takes less than 0.2 ms",
            1e3 * shortest
        );
        let least = torque * FASTEST_ROTOR / fastest;
        let advice =
            format!("at least {least:.1e}: multiply that of the data sheet by the square of the gear ratio");
        return Some((message, advice));
    }
    (time > SLOWEST_ROTOR).then(|| {
        let message = format!(
            "motor.rotor_inertia = {inertia} kg·m²: {torque} N·m need {time:.1} s to bring the rotor alone to \
             {velocity} rad/s; those of servo motors need some 0.02 s"
        );
        (message, "check the unit: 1 g·cm² is 1e-7 kg·m², 1 kg·cm² is 1e-4 kg·m²".to_owned())
    })
}

/// A motor whose largest current makes quite another torque than the limit.
fn torque(joint: &JointModel) -> Text {
    let Motor { current_limit, torque_constant, .. } = joint.motor;
    let (torque, limit) = (current_limit * torque_constant, joint.limits.torque);
    let is_alike = (limit / OTHER_UNIT..=limit * OTHER_UNIT).contains(&torque);
    (torque > 0.0 && !is_alike).then(|| {
        let message = format!(
            "motor.current_limit {current_limit} A times motor.torque_constant {torque_constant} N·m/A is \
             {torque:.4} N·m; the torque limit is {limit} N·m"
        );
        let advice = "check the units: A, N·m/A at the joint (through the gear), N·m in effort of the URDF or in \
                      limits.torque";
        (message, advice.to_owned())
    })
}

/// A winding that no motor has, or that the supply cannot drive.
fn winding(joint: &JointModel, safety: &Safety) -> Text {
    let (resistance, inductance) = match (joint.motor.resistance, joint.motor.inductance) {
        (None, None) => return None,
        (Some(resistance), Some(inductance)) => (resistance, inductance),
        (resistance, _) => {
            let (has, lacks) = match resistance {
                Some(_) => ("resistance", "inductance"),
                None => ("inductance", "resistance"),
            };
            let message =
                format!("motor.{has} without motor.{lacks}: boards that control currents need both");
            return Some((message, "give both, or none for a board without current loops".to_owned()));
        }
    };
    let time = inductance / resistance;
    let [shortest, longest] = WINDINGS;
    if !(shortest..=longest).contains(&time) {
        let message = format!(
            "motor.inductance = {inductance:e} H over motor.resistance = {resistance} Ω is a time constant of {:.3e} \
             ms; windings have 0.01 to 20 ms",
            1e3 * time
        );
        return Some((message, "check the units: data sheets give mH".to_owned()));
    }
    let (current, voltage) = (joint.motor.current_limit, safety.supply_min);
    (resistance * current > voltage).then(|| {
        let message = format!(
            "motor.resistance = {resistance} Ω: {voltage} V (safety.supply_min) drive {:.3} A through it, not the \
             current_limit of {current} A",
            voltage / resistance
        );
        (message, "check resistance, in Ω, and current_limit".to_owned())
    })
}

/// A current loop that is slower than the servo needs.
fn inner_loop(joint: &JointModel) -> Text {
    let (bandwidth, servo) = (joint.motor.bandwidth, joint.servo.observer.bandwidth);
    (TAU * bandwidth < 2.0 * servo).then(|| {
        let message = format!(
            "motor.bandwidth = {bandwidth} Hz, of the current loop, is less than twice that of the servo, {servo} rad/s"
        );
        (message, "check the unit: Hz; current loops have some hundred".to_owned())
    })
}

/// A current sense that hardly sees the motor's current.
fn current(joint: &JointModel) -> Text {
    let Motor { current_limit, current_resolution, .. } = joint.motor;
    (current_limit < FEW_COUNTS * current_resolution).then(|| {
        let message = format!(
            "motor.current_resolution = {current_resolution} A a count: current_limit, {current_limit} A, is {:.1} \
             counts",
            current_limit / current_resolution
        );
        (message, "check the unit: A a count; a converter of 12 bit has 2000 counts for its range".to_owned())
    })
}

/// An encoder that nobody builds.
fn encoder(joint: &JointModel) -> Text {
    let counts = joint.encoder.counts_per_turn;
    (counts > FINEST_ENCODER).then(|| {
        let message = format!(
            "encoder.counts_per_turn = {counts:e}: a fine encoder at the motor, 20 bit, has 2.7e8 through a gear of 256"
        );
        (message, "counts in a turn of the joint: those of the encoder times the gear ratio".to_owned())
    })
}

/// A dead band that is seen, or that no encoder shows.
fn rest_error(joint: &JointModel) -> Text {
    let (error, count) = (joint.servo.rest_error, TAU / joint.encoder.counts_per_turn);
    let (message, advice) = if error > MUCH_REST_ERROR {
        let message =
            format!("servo.rest_error = {error} rad: a joint at rest stays that far from its target");
        (message, "check the unit: rad; some counts of the encoder".to_owned())
    } else if error < count {
        let message = format!(
            "servo.rest_error = {error} rad is less than a count of the encoder, {count:.2e} rad: the joint hunts at \
             rest"
        );
        let advice = format!(
            "{} or more; encoder.counts_per_turn is for a turn of the joint: lines at the motor · 4 · gear ratio",
            at_least(1.2 * count)
        );
        (message, advice)
    } else {
        return None;
    };
    Some((message, advice))
}

/// A disturbance observer that is slower than the loop that it serves.
fn observer(joint: &JointModel) -> Text {
    let gains = &joint.servo.observer;
    (gains.observer_bandwidth < gains.bandwidth).then(|| {
        let message = format!(
            "servo.observer.observer_bandwidth = {} rad/s is below servo.observer.bandwidth, {} rad/s",
            gains.observer_bandwidth, gains.bandwidth
        );
        (message, "twice the bandwidth or more".to_owned())
    })
}

/// A trajectory filter that is faster than the joint.
fn speed(joint: &JointModel) -> Text {
    let half = 0.5 * (joint.limits.upper - joint.limits.lower);
    let peak = FILTER_PEAK * half / joint.servo.filter_time;
    (peak > joint.limits.velocity).then(|| {
        let message = format!(
            "a move over half of its range reaches {peak:.2} rad/s, above its limit of {} rad/s: a fault",
            joint.limits.velocity
        );
        let least = FILTER_PEAK * half / joint.limits.velocity;
        (message, format!("servo.filter_time = {} or more", at_least(least)))
    })
}

/// A position loop that friction overcomes.
fn sticking(joint: &JointModel) -> Text {
    let (gains, coulomb) = (&joint.servo.observer, joint.friction.coulomb);
    let stiffness = gains.inertia * gains.bandwidth * gains.bandwidth;
    (coulomb > MUCH_STICKING * stiffness && coulomb < joint.torque_limit()).then(|| {
        let message = format!(
            "Coulomb friction {coulomb} N·m is much for a servo of {stiffness:.3} N·m/rad ({:.1e} kg·m², {} rad/s): it \
             stops short and hunts about its target for seconds",
            gains.inertia, gains.bandwidth
        );
        let advice = "check friction and motor.rotor_inertia (through the gear); else raise servo.observer.bandwidth";
        (message, advice.to_owned())
    })
}

/// A force sensor that hardly sees the largest force.
fn force(sensor: &ForceSensor) -> Text {
    let ForceSensor { force_limit, force_resolution, .. } = sensor;
    (*force_limit < FEW_COUNTS * force_resolution).then(|| {
        let message = format!(
            "force_sensor.force_resolution = {force_resolution} N a count: force_limit, {force_limit} N, is {:.1} counts",
            force_limit / force_resolution
        );
        (message, "check the unit: N a count, of the order of 0.001 to 0.01".to_owned())
    })
}

/// A force sensor whose moments saturate before its forces.
fn moment(sensor: &ForceSensor) -> Text {
    let ForceSensor { force_limit, torque_resolution, saturation, .. } = sensor;
    #[expect(clippy::cast_precision_loss, reason = "for a comparison")]
    let largest = torque_resolution * *saturation as f32;
    (largest < LEAST_LEVER * force_limit).then(|| {
        let message = format!(
            "force_sensor.torque_resolution = {torque_resolution:e} N·m a count: with saturation = {saturation} moments end \
             at {largest:.1e} N·m, those of force_limit, {force_limit} N, at a lever of 5 mm are {:.1e} N·m",
            LEAST_LEVER * force_limit
        );
        (message, "check the unit: N·m a count; saturation is for all six axes".to_owned())
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::robot::shipped::{Bounds, NAMES, check_bounds, robot};

    #[test]
    fn none_of_our_robots_is_doubtful() {
        for name in NAMES {
            let mut found = doubtful_values(&robot(name));
            // Its filter is for an operator's motion, not for moves.
            found.retain(|value| (name, value.key) != ("hand5", "servo.filter_time"));
            assert_eq!(found, [], "{name}");
        }
    }

    /// With a servo for it.
    fn set_rotor(robot: &mut RobotModel, inertia: f32) {
        let joint = &mut robot.joints[1];
        joint.servo.observer.inertia += inertia - joint.motor.rotor_inertia;
        joint.motor.rotor_inertia = inertia;
    }

    fn winding(robot: &mut RobotModel, resistance: Option<f32>, inductance: Option<f32>) {
        let motor = &mut robot.joints[1].motor;
        (motor.resistance, motor.inductance) = (resistance, inductance);
    }

    #[test]
    fn a_winding_needs_both_values_and_a_sensor_its_moments() {
        let mut changed = robot("hand3");
        winding(&mut changed, Some(4.3), None);
        let [found] = &doubtful_values(&changed)[..] else { panic!() };
        assert!(found.message.contains("motor.resistance without motor.inductance"), "{found:?}");
        let mut changed = robot("hand3");
        for chain in &mut changed.chains {
            chain.force_sensor.as_mut().unwrap().torque_resolution = 1e-9;
        }
        let [found] = &doubtful_values(&changed)[..] else { panic!() };
        assert_eq!(found.key, "force_sensor.torque_resolution");
    }

    /// One of hand3: finger1_bend, a motor of 0.7 N·m, 6 rad/s.
    #[test]
    fn each_value_is_doubtful_beyond_its_bound() {
        let cases: [Bounds; 14] = [
            // 0.7 N·m · 0.2 ms / 40 rad/s, at which 0.5 V·s/rad induce 20 V.
            ("motor.rotor_inertia", set_rotor, 3.4e-6, 3.6e-6),
            // 0.7 N·m · 0.5 s / 6 rad/s.
            ("motor.rotor_inertia", set_rotor, 0.059, 0.058),
            (
                "encoder.counts_per_turn",
                |robot, value| robot.joints[1].encoder.counts_per_turn = value,
                3e8,
                2e8,
            ),
            (
                "motor.current_resolution",
                |robot, value| {
                    let motor = &mut robot.joints[1].motor;
                    motor.current_resolution = motor.current_limit * value;
                },
                0.051,
                0.049,
            ),
            // 4.3 Ω; windings have 0.01 to 20 ms; 20 V drive 4.65 A through them.
            ("motor.inductance", |robot, value| winding(robot, Some(4.3), Some(value)), 0.087, 0.085),
            ("motor.inductance", |robot, value| winding(robot, Some(4.3), Some(value)), 4.2e-5, 4.4e-5),
            (
                "motor.inductance",
                |robot, value| {
                    let current = robot.joints[1].motor.current_limit;
                    winding(robot, Some(value * robot.safety.supply_min / current), Some(1e-3));
                },
                1.01,
                0.99,
            ),
            // 30 rad/s are 4.8 Hz.
            (
                "motor.bandwidth",
                |robot, value| {
                    robot.joints[1].servo.observer.bandwidth = 30.0;
                    robot.joints[1].motor.bandwidth = value;
                },
                9.4,
                9.7,
            ),
            // A count is 2π/65536.
            ("servo.rest_error", |robot, value| robot.joints[1].servo.rest_error = value, 9.5e-5, 9.6e-5),
            ("servo.rest_error", |robot, value| robot.joints[1].servo.rest_error = value, 0.051, 0.049),
            (
                "servo.observer.observer_bandwidth",
                |robot, value| {
                    let gains = &mut robot.joints[1].servo.observer;
                    gains.observer_bandwidth = value * gains.bandwidth;
                },
                0.99,
                1.01,
            ),
            ("safety.damping", |robot, value| robot.safety.damping = value, 0.0, 1e-3),
            // From the middle to a limit at 6 rad/s: 1.45 rad / (e · 6 rad/s) are 89 ms.
            ("servo.filter_time", |robot, value| robot.joints[1].servo.filter_time = value, 0.088, 0.09),
            (
                "force_sensor.force_resolution",
                |robot, value| {
                    for chain in &mut robot.chains {
                        let sensor = chain.force_sensor.as_mut().unwrap();
                        sensor.force_resolution = sensor.force_limit * value;
                    }
                },
                0.051,
                0.049,
            ),
        ];
        check_bounds(&cases, doubtful_values);
    }
}
