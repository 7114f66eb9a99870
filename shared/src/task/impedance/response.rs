//! Response of the target impedance in its axes.

use nalgebra::{IsometryMatrix3, Matrix3, Vector6};

use super::Law;
use crate::control::{Impedance, ImpedanceAxes};
use crate::math;

/// Acceleration of the `tool` for its displacement, velocity error and external force, all in base axes, as
/// the discretisation of `law` requires (Arm7 step 3).
#[inline]
pub(super) fn respond(
    impedance: &Impedance,
    law: Law,
    tool: &IsometryMatrix3<f32>,
    error: &Vector6<f32>,
    velocity: &Vector6<f32>,
    force: &Vector6<f32>,
) -> Vector6<f32> {
    match impedance.axes {
        ImpedanceAxes::Base => discretized(impedance, law, error, velocity, force),
        ImpedanceAxes::Tool => {
            let to_base = tool.rotation.matrix();
            let to_tool = to_base.transpose();
            let [error, velocity, force] = [error, velocity, force].map(|value| rotated(&to_tool, value));
            rotated(to_base, &discretized(impedance, law, &error, &velocity, &force))
        }
    }
}

/// The same in the axes of the impedance.
#[inline]
pub(super) fn discretized(
    impedance: &Impedance,
    law: Law,
    error: &Vector6<f32>,
    velocity: &Vector6<f32>,
    force: &Vector6<f32>,
) -> Vector6<f32> {
    match law {
        Law::Direct(_) => impedance.acceleration(error, velocity, force),
        Law::ModelFollowing => impedance.held_acceleration(error, velocity, force),
    }
}

/// Transforms an impedance to other `axes`, so that a new one in these axes can be blended in.
#[inline(never)]
pub(super) fn in_axes(impedance: &Impedance, axes: ImpedanceAxes, tool: &IsometryMatrix3<f32>) -> Impedance {
    let to_base = tool.rotation.matrix();
    match axes {
        ImpedanceAxes::Base => impedance.in_axes(axes, to_base),
        ImpedanceAxes::Tool => impedance.in_axes(axes, &to_base.transpose()),
    }
}

/// Applies `rotation` to the translational and the rotational part of `value`.
fn rotated(rotation: &Matrix3<f32>, value: &Vector6<f32>) -> Vector6<f32> {
    math::stack(math::halves(value).map(|half| rotation * half))
}
