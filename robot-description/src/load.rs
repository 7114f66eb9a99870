//! What a joint has to move and to hold, over the postures of its chain.

use nalgebra::{DMatrix, Vector3};
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

/// A chain, and what moves each of its joints. The angles, torques and inertias of its methods are those of the joints
/// with a motor.
pub(crate) struct CoupledChain {
    /// All joints, those without motor included.
    pub chain: Chain,
    /// For each of them.
    pub drives: Vec<Drive>,
    /// Reflected inertia of the rotor of each joint with a motor [kg·m²]; empty if not included.
    pub rotors: Vec<f32>,
}

/// What moves a joint: angle = `multiplier` · angle of a joint with a motor + `offset`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drive {
    /// Which of the chain's joints with a motor; `None` for one of another chain, which counts as at 0.
    pub joint: Option<usize>,
    pub multiplier: f32,
    /// [rad]
    pub offset: f32,
}

impl Drive {
    /// The joint's own motor.
    pub const fn own(joint: usize) -> Self {
        Self { joint: Some(joint), multiplier: 1.0, offset: 0.0 }
    }
}

impl CoupledChain {
    /// The loads of its joints under `gravity` [m/s²], with lower and upper limits [rad].
    pub fn joint_loads(&self, gravity: &[f32; 3], limits: &[(f32, f32)]) -> Vec<JointLoad> {
        let mut loads = vec![JointLoad { gravity: 0.0, posture: Vec::new() }; limits.len()];
        for posture in postures(limits) {
            for (load, torque) in loads.iter_mut().zip(self.gravity_torques(gravity, &posture)) {
                if torque.abs() > load.gravity || load.posture.is_empty() {
                    load.gravity = torque.abs();
                    load.posture.clone_from(&posture);
                }
            }
        }
        loads
    }

    /// Smallest and largest inertia that each joint feels over the postures [kg·m²]. The largest one is felt with the
    /// other joints held: the diagonal `M_ii` of the mass matrix. The smallest one is felt with the other joints free,
    /// `1/(M⁻¹)_ii` (Featherstone 2008, section 7.3): servos do not hold them against fast motion.
    pub fn joint_inertias(&self, limits: &[(f32, f32)]) -> Vec<[f32; 2]> {
        let mut inertias = vec![[f32::INFINITY, 0.0_f32]; limits.len()];
        for posture in postures(limits) {
            let matrix = self.mass_matrix(&posture);
            let inverse = matrix.map(f64::from).try_inverse();
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

    /// The gravity torques at a posture [N·m].
    pub fn gravity_torques(&self, gravity: &[f32; 3], posture: &[f32]) -> Vec<f32> {
        let angles = self.angles(posture);
        let (rest, mut torques) = (vec![0.0; angles.len()], vec![0.0; angles.len()]);
        self.chain.inverse_dynamics(&Vector3::from(*gravity), &angles, &rest, &rest, &mut torques);
        let mut driving = vec![0.0; posture.len()];
        for (drive, torque) in self.drives.iter().zip(torques) {
            if let Some(sum) = drive.joint.and_then(|joint| driving.get_mut(joint)) {
                *sum += drive.multiplier * torque;
            }
        }
        driving
    }

    /// `Tᵀ M T` with the rotors: `T` takes velocities of the joints with a motor to those of all.
    fn mass_matrix(&self, posture: &[f32]) -> DMatrix<f32> {
        let all = self.chain.mass_matrix(&self.angles(posture));
        let mut matrix = DMatrix::zeros(posture.len(), posture.len());
        for (row, one) in self.drives.iter().enumerate() {
            for (column, other) in self.drives.iter().enumerate() {
                if let (Some(i), Some(j)) = (one.joint, other.joint) {
                    matrix[(i, j)] += one.multiplier * other.multiplier * all[(row, column)];
                }
            }
        }
        for (index, rotor) in self.rotors.iter().enumerate() {
            matrix[(index, index)] += rotor;
        }
        matrix
    }

    /// The angles of all joints [rad].
    fn angles(&self, posture: &[f32]) -> Vec<f32> {
        let of = |joint: Option<usize>| joint.and_then(|joint| posture.get(joint).copied()).unwrap_or(0.0);
        self.drives.iter().map(|drive| drive.multiplier * of(drive.joint) + drive.offset).collect()
    }
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

    fn coupled(chain: Chain, rotors: &[f32]) -> CoupledChain {
        let drives = (0..chain.len()).map(Drive::own).collect();
        CoupledChain { chain, drives, rotors: rotors.to_vec() }
    }

    #[test]
    fn a_motor_feels_the_joint_behind_it_that_follows() {
        // Two rods of 1 m with 1 kg at the end of the second, which bends by −2 times the angle of the first: at 0.5 rad
        // the mass is 2 cos 0.5 from the axis, on the x axis, and falls towards it. Its height changes with the angle q
        // by cos q + (1 − 2) cos(q − 2q) = 0; its place along x by −2 sin q.
        let rod = |mass| Inertial { mass, center_of_mass: [1.0, 0.0, 0.0], inertia: [0.0; 6] };
        let (first, second) = (rod(0.0), rod(1.0));
        let end = Pose { translation: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        let axis = [0.0, 0.0, 1.0];
        let links = [(&Pose::IDENTITY, &axis, &first), (&end, &axis, &second)];
        let follows = Drive { joint: Some(0), multiplier: -2.0, offset: 0.0 };
        let drives = vec![Drive::own(0), follows];
        let chain = CoupledChain { chain: Chain::from_links(links, &end), drives, rotors: vec![0.1] };
        let matrix = chain.mass_matrix(&[0.5]);
        // sin 0.5 = 0.479 426.
        let by_hand = 0.958_851 * 0.958_851 + 0.1;
        assert!(matrix.len() == 1 && (matrix[(0, 0)] - by_hand).abs() < 1e-5, "{matrix} {by_hand}");
        // A force of 1 N along −x is held by the torque 2 sin q · 1 N, against the motion that shortens it: −2 sin q.
        let torque = chain.gravity_torques(&[-1.0, 0.0, 0.0], &[0.5])[0];
        assert!((torque + 0.958_851).abs() < 1e-5, "{torque}");
    }

    #[test]
    fn a_pendulum_has_its_inertia_and_its_weight_held_level() {
        // 2 kg at 0.5 m from an axis along y: 2·0.25 kg·m², and 2·9.81·0.5 N·m where it is level.
        let link = Inertial { mass: 2.0, center_of_mass: [0.0, 0.0, -0.5], inertia: [0.0; 6] };
        let chain = Chain::from_links([(&Pose::IDENTITY, &[0.0, 1.0, 0.0], &link)], &Pose::IDENTITY);
        let chain = coupled(chain, &[]);
        let [load] = &*chain.joint_loads(&[0.0, 0.0, -9.81], &[(-0.2, core::f32::consts::FRAC_PI_2)]) else {
            panic!("one joint")
        };
        let [inertia] = &*chain.joint_inertias(&[(-0.2, 1.0)]) else { panic!("one joint") };
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
        let chain = coupled(Chain::from_links(links, &end), &[1.0, 0.1]);
        let right = core::f32::consts::FRAC_PI_2;
        let [one, two] = &*chain.joint_inertias(&[(0.0, 0.1), (0.0, right)]) else { panic!("two joints") };
        for (got, expected) in
            [(one[0], 5.0 - 4.0 / 1.1), (one[1], 5.0), (two[0], 1.1 - 4.0 / 5.0), (two[1], 1.1)]
        {
            assert!((got - expected).abs() < 1e-5, "{got} instead of {expected}");
        }
    }
}
