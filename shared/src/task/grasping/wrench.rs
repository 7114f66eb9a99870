use nalgebra::{IsometryMatrix3, Vector3, Vector6};

use super::WrenchGains;
use crate::TICK;
use crate::math;

/// Most of the integral's wrench [N, N·m].
const MOST_FORCE: f32 = 10.0;
const MOST_MOMENT: f32 = 1.0;

/// Proportional and integral control of an object's pose: the wrench of Hand3 (19), `−K_p e − K_i ∫ e`, with
/// `e = [p − p_d; log(R R_dᵀ)]`.
pub(super) fn wrench(
    gains: &WrenchGains,
    integral: &mut [f32; 6],
    object: &IsometryMatrix3<f32>,
    wanted: &IsometryMatrix3<f32>,
) -> Vector6<f32> {
    let away = object.translation.vector - wanted.translation.vector;
    let turned = math::rotation_vector(&(object.rotation.matrix() * wanted.rotation.matrix().transpose()));
    let error = [away, turned];
    let mut parts = [Vector3::zeros(); 2];
    let halves =
        integral.chunks_exact_mut(3).zip([(gains.position, MOST_FORCE), (gains.orientation, MOST_MOMENT)]);
    for ((error, part), (integral, ([proportional, rate], most))) in error.iter().zip(&mut parts).zip(halves)
    {
        for ((error, part), integral) in error.iter().zip(part.iter_mut()).zip(integral) {
            *integral = math::clamp(*integral + rate * TICK * error, -most, most);
            *part = -(proportional * error + *integral);
        }
    }
    let [force, moment] = parts;
    Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
}
