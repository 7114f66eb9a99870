use nalgebra::{IsometryMatrix3, Vector3, Vector6};

use super::WrenchGains;
use super::tuning::{MAX_INTEGRAL_FORCE, MAX_INTEGRAL_MOMENT};
use crate::TICK;
use crate::math;
use crate::zip::zip;

/// Proportional-integral control of an object's pose, the wrench `−K_p e − K_i ∫ e` of (Hand3 eq. 19) with
/// `e = [p − p_d; log(R R_dᵀ)]` [N, N·m].
pub(super) fn wrench(
    gains: &WrenchGains,
    integral: &mut [f32; 6],
    object: &IsometryMatrix3<f32>,
    target: &IsometryMatrix3<f32>,
) -> Vector6<f32> {
    let translation = object.translation.vector - target.translation.vector;
    let rotation = math::rotation_vector(&(object.rotation.matrix() * target.rotation.matrix().transpose()));
    let gains = [(gains.position, MAX_INTEGRAL_FORCE), (gains.orientation, MAX_INTEGRAL_MOMENT)];
    let mut wrench = [Vector3::zeros(); 2];
    for (error, output, integral, ([proportional, rate], max)) in
        zip(([translation, rotation], &mut wrench, integral.chunks_exact_mut(3), gains))
    {
        for (error, output, integral) in zip((&error, output.iter_mut(), integral)) {
            *integral = math::clamp(*integral + rate * TICK * error, -max, max);
            *output = -(proportional * error + *integral);
        }
    }
    let [force, moment] = wrench;
    Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
}
