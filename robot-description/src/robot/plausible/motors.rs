//! Joints whose motors are too weak for friction and gravity.

use tesaki::model::JointModel;

use super::Reports;
use crate::load::JointLoad;

/// Coulomb friction above this fraction of the motor's torque is suspicious.
const MUCH_FRICTION: f32 = 0.5;

/// A motor too weak for friction and gravity.
pub fn check(joint: &JointModel, joints: &[&JointModel], load: &JointLoad, reports: &mut Reports) {
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
        reports.of_joints.warning(&joint.name, line, message, hint);
    }
    if viscous > torque {
        let message = format!(
            "viscous friction takes {viscous:.3} N·m at the velocity limit of {} rad/s; the motor has \
             {torque:.3} N·m",
            joint.limits.velocity
        );
        reports.of_joints.warning(&joint.name, line, message, hint);
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
        reports.of_joints.error(&joint.name, line, message, advice);
    } else if load.gravity + coulomb > torque {
        let message = format!(
            "gravity ({:.3} N·m) and friction ({coulomb} N·m) need more than the motor's {torque:.3} N·m: \
             it cannot lift everywhere",
            load.gravity
        );
        reports.of_joints.warning(
            &joint.name,
            line,
            message,
            "check masses, friction, torque_constant and current_limit",
        );
    }
}
