//! Joints that no machine is likely to have.

use tesaki::model::{JointModel, Motor};

use super::super::limits::at_least;
use super::Reports;
use crate::load::JointLoad;

/// The shortest time in which a full torque can bring a bare rotor to the velocity limit [s]. The mechanical
/// time constants of servo motors are 2 to 50 ms; a velocity limit may be a tenth of what the motor reaches.
const FASTEST_ROTOR: f32 = 2e-4;
/// Factor between the torque of the largest current and the torque limit from which one of them has another
/// unit: mA, mN·m/A and N·mm are all off by 1000.
const OTHER_UNIT: f32 = 3.0;
/// Time in which the motor brings its rotor to the velocity limit: above this, its inertia is suspicious [s].
const SLOWEST_ROTOR: f32 = 2.0;
/// Coulomb friction above this fraction of the motor's torque is suspicious.
const MUCH_FRICTION: f32 = 0.5;
/// Distance from its target at which the position loop would overcome Coulomb friction [rad]: above this, the
/// joint hunts about its target for seconds.
const MUCH_STICKING: f32 = 0.5;
/// Velocity of the trajectory filter after a step, per step and filter time: 1/e.
const FILTER_PEAK: f32 = 0.367_879;

/// A rotor that accelerates faster than any.
pub fn rotor(joint: &JointModel, reports: &mut Reports) {
    let (inertia, torque) = (joint.motor.rotor_inertia, joint.torque_limit());
    let least = torque * FASTEST_ROTOR / joint.limits.velocity;
    let line = reports.line(joint, "motor.rotor_inertia");
    if inertia < 0.0 {
        // Told already.
        return;
    }
    if inertia <= 0.0 {
        let message = "motor.rotor_inertia = 0: every motor has a rotor".to_owned();
        let advice = "that of the motor's data sheet times the square of the gear ratio [kg·m²]";
        reports.of_joints.error(joint, line, message, advice);
    } else if inertia < least {
        let message = format!(
            "motor.rotor_inertia = {inertia:e} kg·m²: {torque} N·m would bring the rotor to {} rad/s in \
             {:.3} ms; no motor takes less than 0.2 ms",
            joint.limits.velocity,
            1e3 * inertia * joint.limits.velocity / torque
        );
        let advice =
            format!("at least {least:.1e}: multiply that of the data sheet by the square of the gear ratio");
        reports.of_joints.warning(joint, line, message, advice);
    } else if inertia * joint.limits.velocity > SLOWEST_ROTOR * torque {
        let message = format!(
            "motor.rotor_inertia = {inertia} kg·m²: {torque} N·m need {:.1} s to bring the rotor to {} rad/s",
            inertia * joint.limits.velocity / torque,
            joint.limits.velocity
        );
        reports.of_joints.warning(
            joint,
            line,
            message,
            "check the unit: 1 g·cm² is 1e-7 kg·m², 1 kg·cm² is 1e-4 kg·m²",
        );
    }
}

/// A motor whose largest current makes quite another torque than the limit.
pub fn units(joint: &JointModel, reports: &mut Reports) {
    let Motor { current_limit, torque_constant, .. } = joint.motor;
    let (torque, limit) = (current_limit * torque_constant, joint.limits.torque);
    if torque <= 0.0 || (limit / OTHER_UNIT..=limit * OTHER_UNIT).contains(&torque) {
        return;
    }
    let message = format!(
        "motor.current_limit {current_limit} A times motor.torque_constant {torque_constant} N·m/A is \
         {torque:.4} N·m; the torque limit is {limit} N·m"
    );
    let advice = "check the units: A, N·m/A at the joint (through the gear), N·m in effort of the URDF or in \
        limits.torque";
    reports.of_joints.warning(joint, reports.line(joint, "motor.current_limit"), message, advice);
}

/// A motor too weak for friction and gravity.
pub fn motor(joint: &JointModel, joints: &[&JointModel], load: &JointLoad, reports: &mut Reports) {
    let (torque, coulomb) = (joint.torque_limit(), joint.friction.coulomb);
    let viscous = joint.friction.viscous * joint.limits.velocity;
    let own = reports
        .settings
        .line_of(&format!("joints.{}.friction", joint.name))
        .or_else(|| reports.settings.line_of("joint.friction"));
    let hint = "give the true friction in [joints.NAME.friction], or check torque_constant, current_limit and \
        effort";
    let line = own.or_else(|| reports.line(joint, "motor.current_limit"));
    if coulomb < torque && coulomb > MUCH_FRICTION * torque {
        let message = format!(
            "Coulomb friction {coulomb} N·m takes {:.0} % of the motor's torque {torque:.3} N·m",
            100.0 * coulomb / torque
        );
        reports.of_joints.warning(joint, line, message, hint);
    }
    if viscous > torque {
        let message = format!(
            "viscous friction takes {viscous:.3} N·m at the velocity limit of {} rad/s; the motor has \
             {torque:.3} N·m",
            joint.limits.velocity
        );
        reports.of_joints.warning(joint, line, message, hint);
    }
    if !reports.has_weights {
        return;
    }
    let line = reports.line(joint, "motor.current_limit");
    if load.gravity > torque {
        let angles: Vec<String> = joints
            .iter()
            .zip(&load.posture)
            .map(|(joint, angle)| format!("{}={angle:.2}", joint.name))
            .collect();
        let message = format!(
            "gravity needs up to {:.3} N·m, at {}; the motor has {torque:.3} N·m",
            load.gravity,
            angles.join(" ")
        );
        let advice = format!(
            "check masses{}, gravity, torque_constant and current_limit; or narrow the limits of the joints",
            reports.heaviest
        );
        reports.of_joints.error(joint, line, message, advice);
    } else if load.gravity + coulomb > torque {
        let message = format!(
            "gravity ({:.3} N·m) and friction ({coulomb} N·m) need more than the motor's {torque:.3} N·m: \
             it cannot lift everywhere",
            load.gravity
        );
        reports.of_joints.warning(
            joint,
            line,
            message,
            "check masses, friction, torque_constant and current_limit",
        );
    }
}

/// A trajectory filter that is faster than the joint.
pub fn speed(joint: &JointModel, reports: &mut Reports) {
    let half = 0.5 * (joint.limits.upper - joint.limits.lower);
    let peak = FILTER_PEAK * half / joint.servo.filter_time;
    if peak > joint.limits.velocity {
        let line = reports.line(joint, "servo.filter_time");
        let message = format!(
            "a move over half of its range reaches {peak:.2} rad/s, above its limit of {} rad/s: a fault",
            joint.limits.velocity
        );
        let least = FILTER_PEAK * half / joint.limits.velocity;
        let advice = format!("servo.filter_time = {} or more", at_least(least));
        reports.of_joints.warning(joint, line, message, advice);
    }
}

/// A position loop that friction overcomes.
pub fn sticking(joint: &JointModel, reports: &mut Reports) {
    let gains = &joint.servo.observer;
    let distance = joint.friction.coulomb / (gains.inertia * gains.bandwidth * gains.bandwidth);
    if distance > MUCH_STICKING && joint.friction.coulomb < joint.torque_limit() {
        let message = format!(
            "Coulomb friction {} N·m is much for a servo of {:.3} N·m/rad ({:.1e} kg·m², {} rad/s): it \
             stops short and hunts about its target for seconds",
            joint.friction.coulomb,
            joint.friction.coulomb / distance,
            gains.inertia,
            gains.bandwidth
        );
        let advice =
            "check friction and motor.rotor_inertia (through the gear); else raise servo.observer.bandwidth";
        reports.of_joints.warning(joint, reports.line(joint, "servo.observer.bandwidth"), message, advice);
    }
}
