//! What a joint has to move and to hold, over the postures of its chain.

use nalgebra::Vector3;
use tesaki::kinematics::Chain;
use tesaki::model::MAX_CHAIN_JOINTS;

/// Postures that are looked at, besides those with all joints at their lower or upper limits.
const POSTURES: u32 = 600;
/// Bases of the Halton sequence.
const PRIMES: [u32; MAX_CHAIN_JOINTS] = [2, 3, 5, 7, 11, 13, 17];

/// Gravity torque of a joint over the postures.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointLoad {
    /// Largest gravity torque [N·m].
    pub gravity: f32,
    /// The posture in which gravity is largest [rad].
    pub posture: Vec<f32>,
}

/// The loads of the joints of `chain` under `gravity` [m/s²], with lower and upper limits [rad].
pub(crate) fn joint_loads(chain: &Chain, gravity: &[f32; 3], limits: &[(f32, f32)]) -> Vec<JointLoad> {
    let mut loads = vec![JointLoad { gravity: 0.0, posture: Vec::new() }; limits.len()];
    for posture in postures(limits) {
        for (load, torque) in loads.iter_mut().zip(gravity_torques(chain, gravity, &posture)) {
            if torque.abs() > load.gravity || load.posture.is_empty() {
                load.gravity = torque.abs();
                load.posture.clone_from(&posture);
            }
        }
    }
    loads
}

/// Smallest and largest inertia that each joint of `chain` feels over the postures [kg·m²]. The largest one is
/// felt with the other joints held: the diagonal `M_ii` of the mass matrix. The smallest one is felt with the
/// other joints free, `1/(M⁻¹)_ii` (Featherstone 2008, section 7.3): servos do not hold them against fast motion.
pub(crate) fn joint_inertias(chain: &Chain, limits: &[(f32, f32)]) -> Vec<[f32; 2]> {
    let mut inertias = vec![[f32::INFINITY, 0.0_f32]; limits.len()];
    for posture in postures(limits) {
        let matrix = chain.mass_matrix(&posture);
        let inverse = matrix.view_range(..limits.len(), ..limits.len()).map(f64::from).try_inverse();
        for (index, [smallest, largest]) in inertias.iter_mut().enumerate() {
            let held = matrix.get((index, index)).copied().unwrap_or(0.0);
            let mobility = inverse.as_ref().and_then(|inverse| inverse.get((index, index)).copied());
            #[expect(clippy::cast_possible_truncation, reason = "an inertia")]
            let free = mobility.map_or(held, |mobility| (1.0 / mobility) as f32);
            (*smallest, *largest) = (smallest.min(free), largest.max(held));
        }
    }
    inertias
}

/// All limits, and angles spread between them [rad].
fn postures(limits: &[(f32, f32)]) -> impl Iterator<Item = Vec<f32>> {
    let corners = 1_u32 << limits.len().min(MAX_CHAIN_JOINTS);
    let corner = |number: u32| {
        let angle = move |(index, &(lower, upper))| if number >> index & 1 == 0 { lower } else { upper };
        limits.iter().enumerate().map(angle).collect()
    };
    let between = |number: u32| {
        let angle =
            |(&(lower, upper), &base): (&(f32, f32), &u32)| lower + (upper - lower) * halton(number, base);
        limits.iter().zip(&PRIMES).map(angle).collect()
    };
    (0..corners).map(corner).chain((1..=POSTURES).map(between))
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
        let [inertia] = &*joint_inertias(&chain, &[(-0.2, 1.0)]) else { panic!("one joint") };
        assert!(inertia.iter().all(|inertia| (inertia - 0.5).abs() < 1e-6), "{inertia:?}");
        assert!(
            (load.gravity - 9.81).abs() < 1e-4
                && (load.posture[0] - core::f32::consts::FRAC_PI_2).abs() < 1e-4,
            "{load:?}"
        );
    }

    #[test]
    fn a_joint_is_light_where_the_others_are_free() {
        // 1 kg at the end of two rods of 1 m, the second one at a right angle, with rotors of 1 and 0.1 kg·m².
        // M_22 = 1 + 0.1; the mass is 1 m beyond both axes, along and across: M_11 = 1² + 1² + 1, M_12 = 1.
        // Free: 3 − 1/1.1 and 1.1 − 1/3. Folded to 0: M_11 = 4 + 1, M_12 = 2: 5 − 4/1.1 and 1.1 − 4/5.
        let rod = |mass| Inertial { mass, center_of_mass: [1.0, 0.0, 0.0], inertia: [0.0; 6] };
        let (first, second) = (rod(0.0), rod(1.0));
        let end = Pose { translation: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        let axis = [0.0, 0.0, 1.0];
        let links = [(&Pose::IDENTITY, &axis, &first), (&end, &axis, &second)];
        let chain = Chain::from_links(links, &end).with_rotor_inertia([1.0, 0.1]);
        let right = core::f32::consts::FRAC_PI_2;
        let [one, two] = &*joint_inertias(&chain, &[(0.0, 0.1), (0.0, right)]) else { panic!("two joints") };
        for (got, expected) in
            [(one[0], 5.0 - 4.0 / 1.1), (one[1], 5.0), (two[0], 1.1 - 4.0 / 5.0), (two[1], 1.1)]
        {
            assert!((got - expected).abs() < 1e-5, "{got} instead of {expected}");
        }
    }
}
