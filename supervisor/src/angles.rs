//! Measured joint angles.

use tesaki::model::JointLimits;
use tesaki::protocol::Telemetry;

/// Returns the measured angles of the joints [rad].
pub fn measured(telemetry: &Telemetry) -> Vec<f32> {
    telemetry.joints.iter().map(|joint| joint.position).collect()
}

/// Returns the angle within the limits that is nearest to `angle` [rad]. A joint at its stop may measure
/// slightly outside.
pub const fn within(angle: f32, limits: &JointLimits) -> f32 {
    angle.clamp(limits.lower, limits.upper)
}
