//! What a joint has to move and to hold, over the postures of its chain.

use nalgebra::Vector3;
use tesaki::kinematics::Chain;
use tesaki::model::MAX_CHAIN_JOINTS;

/// Postures that are looked at, besides those with all joints at their lower or upper limits.
const POSTURES: u32 = 600;
/// Bases of the Halton sequence.
const PRIMES: [u32; MAX_CHAIN_JOINTS] = [2, 3, 5, 7, 11, 13, 17];

/// Inertia and gravity torque of a joint over the postures.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointLoad {
    /// Smallest and largest inertia of the links that the joint moves, without its rotor [kg·m²].
    pub inertia: [f32; 2],
    /// Largest gravity torque [N·m].
    pub gravity: f32,
    /// The posture in which gravity is largest [rad].
    pub posture: Vec<f32>,
}

/// The loads of the joints of `chain` under `gravity` [m/s²], with lower and upper limits [rad].
pub(crate) fn joint_loads(chain: &Chain, gravity: &[f32; 3], limits: &[(f32, f32)]) -> Vec<JointLoad> {
    let none = JointLoad { inertia: [f32::INFINITY, 0.0], gravity: 0.0, posture: Vec::new() };
    let mut loads = vec![none; limits.len()];
    let corners = 1_u32 << limits.len().min(MAX_CHAIN_JOINTS);
    let corner = |number: u32| {
        let angle = move |(index, &(lower, upper))| if number >> index & 1 == 0 { lower } else { upper };
        limits.iter().enumerate().map(angle).collect::<Vec<f32>>()
    };
    let between = |number: u32| {
        let angle =
            |(&(lower, upper), &base): (&(f32, f32), &u32)| lower + (upper - lower) * halton(number, base);
        limits.iter().zip(&PRIMES).map(angle).collect::<Vec<f32>>()
    };
    for posture in (0..corners).map(corner).chain((1..=POSTURES).map(between)) {
        let matrix = chain.mass_matrix(&posture);
        let torques = gravity_torques(chain, gravity, &posture);
        for (index, (load, torque)) in loads.iter_mut().zip(torques).enumerate() {
            let inertia = matrix.get((index, index)).copied().unwrap_or(0.0);
            load.inertia = [load.inertia[0].min(inertia), load.inertia[1].max(inertia)];
            if torque.abs() > load.gravity || load.posture.is_empty() {
                load.gravity = torque.abs();
                load.posture.clone_from(&posture);
            }
        }
    }
    loads
}

/// The torques that hold the posture [N·m].
pub(crate) fn gravity_torques(chain: &Chain, gravity: &[f32; 3], posture: &[f32]) -> Vec<f32> {
    let (rest, mut torques) = (vec![0.0; posture.len()], vec![0.0; posture.len()]);
    chain.inverse_dynamics(&Vector3::from(*gravity), posture, &rest, &rest, &mut torques);
    torques
}

/// Member `number` of the van der Corput sequence with a base: evenly spread over 0 to 1.
#[expect(clippy::cast_precision_loss, reason = "small numbers")]
fn halton(mut number: u32, base: u32) -> f32 {
    let (mut value, mut digit) = (0.0, 1.0);
    while number > 0 {
        digit /= base as f32;
        value += digit * (number % base) as f32;
        number /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use tesaki::model::{Inertial, Pose};

    #[test]
    fn a_pendulum_has_its_inertia_and_its_weight_held_level() {
        // 2 kg at 0.5 m from an axis along y: 2·0.25 kg·m², and 2·9.81·0.5 N·m where it is level.
        let link = Inertial { mass: 2.0, center_of_mass: [0.0, 0.0, -0.5], inertia: [0.0; 6] };
        let chain = Chain::from_links([(&Pose::IDENTITY, &[0.0, 1.0, 0.0], &link)], &Pose::IDENTITY);
        let [load] = &*joint_loads(&chain, &[0.0, 0.0, -9.81], &[(-0.2, core::f32::consts::FRAC_PI_2)])
        else {
            panic!("one joint")
        };
        assert!(load.inertia.iter().all(|inertia| (inertia - 0.5).abs() < 1e-6), "{load:?}");
        assert!(
            (load.gravity - 9.81).abs() < 1e-4
                && (load.posture[0] - core::f32::consts::FRAC_PI_2).abs() < 1e-4,
            "{load:?}"
        );
    }
}
