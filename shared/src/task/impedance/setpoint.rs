//! Checks of set-points, and the pose error.

use core::f32::consts::{PI, TAU};

use nalgebra::{IsometryMatrix3, Translation3, UnitQuaternion, Vector6};

use super::tuning::NORM_TOLERANCE;
use super::{ImpedanceSettings, SetpointError};
use crate::TICK;
use crate::kinematics::{COAST_TIME, ElbowSetpoint, PosePoint};
use crate::math::{self, abs, orientation};

/// The set-point at rest at the origin of the base frame.
pub(super) const ORIGIN: PosePoint = PosePoint {
    position: [0.0; 3],
    rotation: [0.0, 0.0, 0.0, 1.0],
    velocity: [0.0; 6],
    acceleration: [0.0; 6],
};

/// The set-point at rest at the pose of a tool.
#[inline(never)]
pub(super) fn at_rest(tool: &IsometryMatrix3<f32>) -> PosePoint {
    let rotation = UnitQuaternion::from_rotation_matrix(&tool.rotation);
    PosePoint { position: tool.translation.vector.into(), rotation: rotation.coords.into(), ..ORIGIN }
}

/// Checks that all numbers are finite and that the orientation is a unit quaternion.
pub(super) fn check_numbers(point: &PosePoint, elbow: &ElbowSetpoint) -> Result<(), SetpointError> {
    let of_pose =
        point.position.iter().chain(&point.rotation).chain(&point.velocity).chain(&point.acceleration);
    let of_elbow = [elbow.angle, elbow.velocity, elbow.acceleration];
    if !of_pose.chain(&of_elbow).all(|number| number.is_finite()) {
        return Err(SetpointError::NotFinite);
    }
    let norm = math::sqrt(point.rotation.iter().map(|part| part * part).sum());
    if norm.is_nan() || abs(norm - 1.0) > NORM_TOLERANCE {
        return Err(SetpointError::NotUnit { norm });
    }
    Ok(())
}

/// Checks the distance to an elbow set-point, now and where it coasts to, which bounds velocity and
/// acceleration, too. `distance` is that of its angle from the elbow's [rad].
pub(super) fn check_elbow(elbow: &ElbowSetpoint, distance: f32, limit: f32) -> Result<(), SetpointError> {
    let velocity = elbow.velocity + elbow.acceleration * TICK;
    for value in [abs(distance), abs(distance + velocity * COAST_TIME)] {
        if value.is_nan() || value > limit {
            return Err(SetpointError::Elbow { value, limit });
        }
    }
    Ok(())
}

/// The pose error: translation and rotation vector from the set-point to the tool [m, rad].
#[inline]
pub(super) fn pose_error(tool: &IsometryMatrix3<f32>, point: &PosePoint) -> Vector6<f32> {
    let target = IsometryMatrix3::from_parts(
        Translation3::from(point.position),
        orientation(point.rotation).to_rotation_matrix(),
    );
    math::stack(math::displacement(&target, tool))
}

/// Checks a pose error against the maximum deviation of the settings.
///
/// # Errors
/// The error is larger.
#[inline]
pub(super) fn check_deviation(
    error: &Vector6<f32>,
    settings: &ImpedanceSettings,
) -> Result<(), SetpointError> {
    let [max_distance, max_angle] = settings.max_deviation;
    let [distance, angle] = math::halves(error).map(|half| math::norm(&half));
    if distance.is_nan() || distance > max_distance {
        return Err(SetpointError::Distance { value: distance, limit: max_distance });
    }
    if angle.is_nan() || angle > max_angle {
        return Err(SetpointError::Rotation { value: angle, limit: max_angle });
    }
    Ok(())
}

/// Checks the pose error of a set-point against the maximum deviation of the settings.
///
/// # Errors
/// The error is larger.
#[inline(never)]
pub(super) fn check_point(
    tool: &IsometryMatrix3<f32>,
    point: &PosePoint,
    settings: &ImpedanceSettings,
) -> Result<(), SetpointError> {
    check_deviation(&pose_error(tool, point), settings)
}

/// The equivalent angle within ±π [rad].
pub(super) fn wrap_angle(angle: f32) -> f32 {
    if abs(angle) <= PI { angle } else { angle - TAU * math::round(angle / TAU) }
}
