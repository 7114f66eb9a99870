//! What a joint has to move and to hold, over the postures of the chains that it moves.

use nalgebra::{DMatrix, Vector3};
use tesaki::kinematics::Chain;
use tesaki::model::{ChainJoint, Coupling, MAX_JOINTS, RobotModel};

/// Postures that are looked at, besides those with all joints at their lower or upper limits.
const POSTURES: u32 = 600;
/// Bases of the Halton sequence.
const PRIMES: [u32; MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];
/// Number of joints of which all combinations of limits are looked at. Of more joints, one is at the same end
/// as the one so many before it.
const CORNER_JOINTS: usize = 11;

/// Gravity torque of a joint over the postures.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointLoad {
    /// Largest gravity torque [N·m].
    pub gravity: f32,
    /// The posture in which gravity is largest [rad].
    pub posture: Vec<f32>,
}

/// A chain, or several that depend on each other as joints of one follow a motor of another. The angles,
/// torques and inertias of its methods are those of the joints with a motor.
pub(crate) struct CoupledChains {
    /// The joints with a motor, as indices into the robot's; rising.
    pub motors: Vec<usize>,
    /// Each with all its joints, those without motor included, and what moves them: by index into `motors`.
    chains: Vec<(Chain, Vec<Coupling>)>,
    /// Reflected inertia of the rotor of each joint with a motor [kg·m²]; empty if not included.
    pub rotors: Vec<f32>,
}

impl CoupledChains {
    /// The chains of a robot in groups that do not depend on each other: `chains` has each with what moves
    /// its joints.
    pub fn groups(chains: impl IntoIterator<Item = (Chain, Vec<Coupling>)>) -> Vec<Self> {
        let mut groups: Vec<Self> = Vec::new();
        for (chain, couplings) in chains {
            let own = || couplings.iter().map(|coupling| usize::from(coupling.actuated));
            let depends = |group: &Self| own().any(|motor| group.motors.contains(&motor));
            let (together, apart): (Vec<Self>, Vec<Self>) = groups.into_iter().partition(depends);
            let mut motors: Vec<usize> = together.iter().flat_map(|group| &group.motors).copied().collect();
            motors.extend(own());
            motors.sort_unstable();
            motors.dedup();
            let mut chains: Vec<_> = together.into_iter().flat_map(|group| group.chains).collect();
            chains.push((chain, couplings));
            groups = apart;
            groups.push(Self { motors, chains, rotors: Vec::new() });
        }
        groups.iter_mut().for_each(Self::renumber);
        groups.sort_by_key(|group| group.motors.first().copied());
        groups
    }

    /// Those of a model, with its rotors.
    pub fn of_model(model: &RobotModel) -> Vec<Self> {
        let couplings = |index| model.joints_of(index).map(ChainJoint::coupling).collect();
        let chains = (0..model.chains.len()).map(|index| (Chain::of_model(model, index), couplings(index)));
        let mut groups = Self::groups(chains);
        for group in &mut groups {
            let joints = group.motors.iter().filter_map(|motor| model.joints.get(*motor));
            group.rotors = joints.map(|joint| joint.motor.rotor_inertia).collect();
        }
        groups
    }

    /// From indices into the robot's joints to those into `motors`.
    fn renumber(&mut self) {
        for coupling in self.chains.iter_mut().flat_map(|(_, couplings)| couplings) {
            let place = self.motors.iter().position(|motor| *motor == usize::from(coupling.actuated));
            #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
            place.into_iter().for_each(|place| coupling.actuated = place as u8);
        }
    }

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

    /// Smallest and largest inertia that each joint feels over the postures [kg·m²]. The largest one is felt
    /// with the other joints held: the diagonal `M_ii` of the mass matrix. The smallest one is felt with the
    /// other joints free, `1/(M⁻¹)_ii` (Featherstone 2008, section 7.3): servos do not hold them against fast
    /// motion.
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

    /// The inverse of the mass matrix in each posture [1/(kg·m²)]: the accelerations by torques.
    pub fn mobilities(&self, limits: &[(f32, f32)]) -> impl Iterator<Item = DMatrix<f32>> {
        let mobility = |posture: Vec<f32>| self.mass_matrix(&posture).map(f64::from).try_inverse();
        #[expect(clippy::cast_possible_truncation, reason = "computed with double precision only")]
        postures(limits).filter_map(mobility).map(|mobility| mobility.map(|value| value as f32))
    }

    /// The gravity torques at a posture [N·m].
    pub fn gravity_torques(&self, gravity: &[f32; 3], posture: &[f32]) -> Vec<f32> {
        let mut driving = vec![0.0; posture.len()];
        for (chain, couplings) in &self.chains {
            let angles = angles(couplings, posture);
            let (rest, mut torques) = (vec![0.0; angles.len()], vec![0.0; angles.len()]);
            chain.inverse_dynamics(&Vector3::from(*gravity), &angles, &rest, &rest, &mut torques);
            for (coupling, torque) in couplings.iter().zip(torques) {
                if let Some(sum) = driving.get_mut(usize::from(coupling.actuated)) {
                    *sum += coupling.multiplier * torque;
                }
            }
        }
        driving
    }

    /// The sum of `Tᵀ M T` over the chains, with the rotors: `T` takes velocities of the joints with a motor
    /// to those of all.
    fn mass_matrix(&self, posture: &[f32]) -> DMatrix<f32> {
        let mut matrix = DMatrix::zeros(posture.len(), posture.len());
        for (chain, couplings) in &self.chains {
            let all = chain.mass_matrix(&angles(couplings, posture));
            for (row, one) in couplings.iter().enumerate() {
                for (column, other) in couplings.iter().enumerate() {
                    let place = (usize::from(one.actuated), usize::from(other.actuated));
                    matrix[place] += one.multiplier * other.multiplier * all[(row, column)];
                }
            }
        }
        for (index, rotor) in self.rotors.iter().enumerate() {
            matrix[(index, index)] += rotor;
        }
        matrix
    }
}

/// The angles of all joints of a chain [rad].
fn angles(couplings: &[Coupling], posture: &[f32]) -> Vec<f32> {
    let of = |motor: u8| posture.get(usize::from(motor)).copied().unwrap_or(0.0);
    couplings.iter().map(|coupling| coupling.angle(of(coupling.actuated))).collect()
}

/// Limits in all combinations, and angles spread between them [rad].
fn postures(limits: &[(f32, f32)]) -> impl Iterator<Item = Vec<f32>> {
    let corners = 1_u32 << limits.len().min(CORNER_JOINTS);
    let corner = |number: u32| {
        let is_lower = move |index| number >> (index % CORNER_JOINTS) & 1 == 0;
        let angle = move |(index, &(lower, upper))| if is_lower(index) { lower } else { upper };
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

    /// A chain with a motor for each joint.
    fn driven(chain: Chain, rotors: &[f32]) -> CoupledChains {
        let couplings = (0..3).map(Coupling::direct).take(chain.len()).collect();
        grouped([(chain, couplings)], rotors)
    }

    fn grouped<const N: usize>(chains: [(Chain, Vec<Coupling>); N], rotors: &[f32]) -> CoupledChains {
        let mut groups = CoupledChains::groups(chains);
        assert_eq!(groups.len(), 1);
        CoupledChains { rotors: rotors.to_vec(), ..groups.remove(0) }
    }

    #[test]
    fn a_motor_feels_the_joint_behind_it_that_follows() {
        // Two rods of 1 m with 1 kg at the end of the second, which bends by −2 times the angle of the first:
        // at 0.5 rad the mass is 2 cos 0.5 from the axis, on the x axis, and falls towards it. Its height
        // changes with the angle q by cos q + (1 − 2) cos(q − 2q) = 0; its place along x by −2 sin q.
        let rod = |mass| Inertial { mass, center_of_mass: [1.0, 0.0, 0.0], inertia: [0.0; 6] };
        let (first, second) = (rod(0.0), rod(1.0));
        let end = Pose { translation: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        let axis = [0.0, 0.0, 1.0];
        let links = [(&Pose::IDENTITY, &axis, &first), (&end, &axis, &second)];
        let follows = Coupling { actuated: 0, multiplier: -2.0, offset: 0.0 };
        let chain = grouped(
            [(Chain::from_links(links, &end).expect("valid"), vec![Coupling::direct(0), follows])],
            &[0.1],
        );
        let matrix = chain.mass_matrix(&[0.5]);
        // sin 0.5 = 0.479 426.
        let by_hand = 0.958_851 * 0.958_851 + 0.1;
        assert!(matrix.len() == 1 && (matrix[(0, 0)] - by_hand).abs() < 1e-5, "{matrix} {by_hand}");
        // A force of 1 N along −x is held by the torque 2 sin q · 1 N, against the motion that shortens it:
        // −2 sin q.
        let torque = chain.gravity_torques(&[-1.0, 0.0, 0.0], &[0.5])[0];
        assert!((torque + 0.958_851).abs() < 1e-5, "{torque}");
    }

    #[test]
    fn a_motor_feels_the_joint_of_another_chain_that_follows() {
        // Rods of 1 m with a mass at their end: one of 1 kg; in another chain one of 2 kg that turns by −2
        // times the angle of the first, with a joint of its own at the same axis behind it, which turns 3 kg.
        // A third chain is apart.
        let rod = |mass| Inertial { mass, center_of_mass: [1.0, 0.0, 0.0], inertia: [0.0; 6] };
        let axis = [0.0, 0.0, 1.0];
        let chain = |links: &[Inertial]| {
            Chain::from_links(links.iter().map(|link| (&Pose::IDENTITY, &axis, link)), &Pose::IDENTITY)
                .expect("valid")
        };
        let follows = Coupling { actuated: 1, multiplier: -2.0, offset: 0.0 };
        let groups = CoupledChains::groups([
            (chain(&[rod(9.0)]), vec![Coupling::direct(0)]),
            (chain(&[rod(1.0)]), vec![Coupling::direct(1)]),
            (chain(&[rod(2.0), rod(3.0)]), vec![follows, Coupling::direct(2)]),
        ]);
        let [apart, together] = &*groups else { panic!("two groups") };
        assert!(apart.motors == [0] && together.motors == [1, 2]);
        // Kinetic energy ½ (1 q̇₁² + 2 (2 q̇₁)² + 3 (q̇₂ − 2 q̇₁)²) at any posture.
        let matrix = together.mass_matrix(&[0.3, 0.7]);
        for (place, by_hand) in [((0, 0), 21.0), ((0, 1), -6.0), ((1, 1), 3.0)] {
            assert!((matrix[place] - by_hand).abs() < 1e-5, "{matrix}");
        }
        let limits = [(-0.1, 0.1), (-0.1, 0.1)];
        let [one, two] = &*together.joint_inertias(&limits) else { panic!("two joints") };
        for (got, by_hand) in
            [(one[0], 21.0 - 36.0 / 3.0), (one[1], 21.0), (two[0], 3.0 - 36.0 / 21.0), (two[1], 3.0)]
        {
            assert!((got - by_hand).abs() < 1e-4, "{got} instead of {by_hand}");
        }
        // 1 m/s² along −y: the motors hold the masses at angle 0 with −m x, times the ratio of the
        // velocities.
        let torques = together.gravity_torques(&[0.0, -1.0, 0.0], &[0.0, 0.0]);
        assert!(
            (torques[0] - (1.0 - 2.0 * 5.0)).abs() < 1e-5 && (torques[1] - 3.0).abs() < 1e-5,
            "{torques:?}"
        );
    }

    #[test]
    fn all_combinations_of_limits_are_looked_at() {
        let corners = |joints: usize| {
            let limits = vec![(-1.0, 1.0); joints];
            let mut corners: Vec<_> = postures(&limits)
                .filter(|q| q.iter().all(|q| q.abs() >= 1.0))
                .map(|q| format!("{q:?}"))
                .collect();
            corners.sort();
            corners.dedup();
            corners.len()
        };
        assert_eq!([corners(1), corners(4), corners(11), corners(16)], [2, 16, 2048, 2048]);
    }

    #[test]
    fn a_pendulum_has_its_inertia_and_its_weight_held_level() {
        // 2 kg at 0.5 m from an axis along y: 2·0.25 kg·m², and 2·9.81·0.5 N·m where it is level.
        let link = Inertial { mass: 2.0, center_of_mass: [0.0, 0.0, -0.5], inertia: [0.0; 6] };
        let chain =
            Chain::from_links([(&Pose::IDENTITY, &[0.0, 1.0, 0.0], &link)], &Pose::IDENTITY).expect("valid");
        let chain = driven(chain, &[]);
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
        // 1 kg at the end of two rods of 1 m, the second one at a right angle, with rotors of 1 and 0.1
        // kg·m². M_22 = 1 + 0.1; the mass is 1 m beyond both axes, along and across: M_11 = 1² + 1² + 1, M_12
        // = 1. Free: 3 − 1/1.1 and 1.1 − 1/3. Folded to 0: M_11 = 4 + 1, M_12 = 2: 5 − 4/1.1 and 1.1 − 4/5.
        let rod = |mass| Inertial { mass, center_of_mass: [1.0, 0.0, 0.0], inertia: [0.0; 6] };
        let (first, second) = (rod(0.0), rod(1.0));
        let end = Pose { translation: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        let axis = [0.0, 0.0, 1.0];
        let links = [(&Pose::IDENTITY, &axis, &first), (&end, &axis, &second)];
        let chain = driven(Chain::from_links(links, &end).expect("valid"), &[1.0, 0.1]);
        let right = core::f32::consts::FRAC_PI_2;
        let [one, two] = &*chain.joint_inertias(&[(0.0, 0.1), (0.0, right)]) else { panic!("two joints") };
        for (got, expected) in
            [(one[0], 5.0 - 4.0 / 1.1), (one[1], 5.0), (two[0], 1.1 - 4.0 / 5.0), (two[1], 1.1)]
        {
            assert!((got - expected).abs() < 1e-5, "{got} instead of {expected}");
        }
    }
}
