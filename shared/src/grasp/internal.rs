use core::fmt;

use heapless::Vec;
use nalgebra::{SMatrix, SVector, Vector3};

use super::{ContactForces, GraspMap, MAX_CONTACTS};
use crate::collect::collect;
use crate::math::{self, abs};

/// Maximum dimension of the internal forces: six collinear contacts.
const MAX_INTERNAL: usize = 3 * MAX_CONTACTS - 5;

/// A basis of the internal forces, the null space of the grasp map: orthonormal sets of contact forces whose
/// wrench is 0. There are 3n − 6 of them, or 3n − 5 for collinear contacts.
#[derive(Clone, Debug)]
pub struct InternalForces {
    basis: Vec<ContactForces, MAX_INTERNAL>,
}

/// The pairwise form needs three contacts; the value is the actual number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ContactCountError(pub usize);

/// Internal force along the contacts' normals, with one degree of freedom (Hand3 section 5.3).
#[derive(Clone, Debug, PartialEq)]
pub struct NormalGrip {
    /// Normal forces over the largest.
    fractions: Vec<f32, MAX_CONTACTS>,
    forces: ContactForces,
}

/// Why no internal force along the normals exists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NormalGripError {
    /// Forces along the normals do not balance.
    Unbalanced {
        /// Smallest residual wrench over the norm of the forces, with moments over the length.
        residual: f32,
    },
    /// The balance is not unique.
    Ambiguous,
    /// The balance needs a contact with zero or negative normal force.
    NotPushing {
        /// Its index.
        contact: u8,
        /// Its normal force over the largest.
        fraction: f32,
    },
}

impl GraspMap {
    /// `E` of (Hand3 eq. 18), 9 × 3: unit forces with which contacts 2 and 3, 1 and 3, 1 and 2 press towards
    /// each other.
    ///
    /// # Errors
    /// There are not three contacts.
    pub fn pairwise(&self) -> Result<SMatrix<f32, 9, 3>, ContactCountError> {
        let [one, two, three] = self.levers[..] else {
            return Err(ContactCountError(self.levers.len()));
        };
        let toward = |from: Vector3<f32>, to: Vector3<f32>| {
            let difference = to - from;
            difference / math::norm(&difference)
        };
        let (e12, e13, e23) = (toward(one, two), toward(one, three), toward(two, three));
        let mut matrix = SMatrix::<f32, 9, 3>::zeros();
        matrix.fixed_view_mut::<3, 1>(0, 1).copy_from(&e13);
        matrix.fixed_view_mut::<3, 1>(0, 2).copy_from(&e12);
        matrix.fixed_view_mut::<3, 1>(3, 0).copy_from(&e23);
        matrix.fixed_view_mut::<3, 1>(3, 2).copy_from(&-e12);
        matrix.fixed_view_mut::<3, 1>(6, 0).copy_from(&-e23);
        matrix.fixed_view_mut::<3, 1>(6, 1).copy_from(&-e13);
        Ok(matrix)
    }

    /// An orthonormal basis of the null space of the grasp map.
    pub fn internal_forces(&self) -> InternalForces {
        let inverse = self.inverse();
        let count = self.levers.len();
        let dimension = 3 * count - usize::from(inverse.conditioning().rank);
        // Pivoted Gram–Schmidt on the projections of the unit forces.
        let mut basis = Vec::<ContactForces, MAX_INTERNAL>::new();
        let mut residual: ContactForces = self.levers.iter().map(|_| Vector3::repeat(1.0)).collect();
        for (contact, residual) in residual.iter_mut().enumerate() {
            for axis in 0..3 {
                let mut force = self.unit_force(contact, axis);
                inverse.project_to_null_space(&mut force);
                residual[axis] = force.get(contact).map_or(0.0, |force| force[axis]);
            }
        }
        for _ in 0..dimension {
            let (mut contact, mut axis, mut max_square) = (0, 0, 0.0);
            for (index, residual) in residual.iter().enumerate() {
                for (direction, &square) in residual.iter().enumerate() {
                    if square > max_square {
                        (contact, axis, max_square) = (index, direction, square);
                    }
                }
            }
            let mut force = self.unit_force(contact, axis);
            for _ in 0..2 {
                inverse.project_to_null_space(&mut force);
                for known in &basis {
                    let fraction = dot(known, &force);
                    force.iter_mut().zip(known).for_each(|(force, known)| *force -= known * fraction);
                }
            }
            let length = math::sqrt(dot(&force, &force));
            force.iter_mut().for_each(|force| *force /= length);
            for (residual, force) in residual.iter_mut().zip(&force) {
                *residual -= force.component_mul(force);
            }
            let _ = basis.push(force); // cannot fail: at most `MAX_INTERNAL`
        }
        InternalForces { basis }
    }

    fn unit_force(&self, contact: usize, axis: usize) -> ContactForces {
        let mut forces: ContactForces = self.levers.iter().map(|_| Vector3::zeros()).collect();
        if let Some(part) = forces.get_mut(contact).and_then(|force| force.get_mut(axis)) {
            *part = 1.0;
        }
        forces
    }

    /// The internal force along the contacts' normals: magnitudes from the null space of `D_oᵀ N`.
    /// `tolerance`: largest accepted residual wrench, with moments over [`GraspMap::length`], over the norm
    /// of the forces: measured contacts never balance exactly. Forces of minimum norm then balance the
    /// residual.
    ///
    /// # Errors
    /// The normals have no unique balance with all contacts pushing.
    pub fn normal_grip(&self, tolerance: f32) -> Result<NormalGrip, NormalGripError> {
        // NᵀDₒDₒᵀN; rows beyond the contacts get an eigenvalue above all others.
        let mut products =
            SMatrix::<f32, MAX_CONTACTS, MAX_CONTACTS>::from_diagonal_element(f32::from(u8::MAX));
        let pairs = || self.contacts.iter().zip(&self.levers).enumerate().take(MAX_CONTACTS);
        for (row, (one, lever)) in pairs() {
            for (column, (other, second)) in pairs() {
                let (moment, other_moment) = (lever.cross(&one.normal), second.cross(&other.normal));
                products[(row, column)] = one.normal.dot(&other.normal) + moment.dot(&other_moment);
            }
        }
        let vectors = math::diagonalize(&mut products);
        let (mut min_value, mut next) = (f32::INFINITY, f32::INFINITY);
        let mut vector = SVector::<f32, MAX_CONTACTS>::zeros();
        for (&value, column) in products.diagonal().iter().zip(vectors.column_iter()) {
            if value < min_value {
                (next, min_value) = (min_value, value);
                vector.copy_from(&column);
            } else if value < next {
                next = value;
            }
        }
        let normal_forces = |scale: f32| -> ContactForces {
            self.contacts
                .iter()
                .zip(vector.iter())
                .map(|(contact, fraction)| contact.normal * (fraction * scale))
                .collect()
        };
        // The eigenvalue itself has no significant digits near 0, by cancellation.
        let (force, moment) = self.scaled_sum(&normal_forces(1.0));
        let residual = math::sqrt(force.norm_squared() + moment.norm_squared());
        if residual > tolerance || (residual + tolerance).is_nan() {
            return Err(NormalGripError::Unbalanced { residual });
        }
        if next <= tolerance * tolerance + f32::EPSILON {
            return Err(NormalGripError::Ambiguous);
        }
        let largest =
            vector.iter().fold(
                0.0,
                |max_norm: f32, &fraction| if abs(fraction) > abs(max_norm) { fraction } else { max_norm },
            );
        let fractions: Vec<f32, MAX_CONTACTS> =
            vector.iter().take(self.contacts.len()).map(|fraction| fraction / largest).collect();
        for (contact, &fraction) in (0..).zip(&fractions) {
            if fraction <= tolerance {
                return Err(NormalGripError::NotPushing { contact, fraction });
            }
        }
        let mut forces = normal_forces(1.0 / largest);
        self.inverse().project_to_null_space(&mut forces);
        Ok(NormalGrip { fractions, forces })
    }
}

impl InternalForces {
    /// The basis; its length is the dimension of the null space.
    pub fn basis(&self) -> &[ContactForces] {
        &self.basis
    }

    /// Internal forces [N] with these coordinates in the basis [N]; missing ones are 0.
    pub fn forces(&self, parts: &[f32]) -> ContactForces {
        let mut forces = ContactForces::new();
        for (member, part) in self.basis.iter().zip(parts.iter().chain(core::iter::repeat(&0.0))) {
            let _ = forces.resize_default(member.len()); // cannot fail: same capacity
            forces.iter_mut().zip(member).for_each(|(force, member)| *force += member * *part);
        }
        forces
    }
}

impl NormalGrip {
    /// The normal force of each contact over the largest one.
    pub fn fractions(&self) -> &[f32] {
        &self.fractions
    }

    /// Contact forces [N] whose largest normal force is `strength` [N]; their wrench is 0.
    pub fn forces(&self, strength: f32) -> ContactForces {
        collect(self.forces.iter().map(|force| force * strength))
    }
}

fn dot(a: &[Vector3<f32>], b: &[Vector3<f32>]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

impl fmt::Display for ContactCountError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} contacts; the pairwise form is for 3", self.0)
    }
}

impl core::error::Error for ContactCountError {}

impl fmt::Display for NormalGripError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unbalanced { residual } => {
                write!(f, "forces along the normals do not balance: the residual is {residual} of their norm")
            }
            Self::Ambiguous => write!(f, "the balance of forces along the normals is not unique"),
            Self::NotPushing { contact, fraction } => write!(
                f,
                "the balance of forces along the normals needs {fraction} of the largest at contact \
                 {contact}, which can only push"
            ),
        }
    }
}

impl core::error::Error for NormalGripError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_precision_loss, reason = "tests")]
mod tests {
    use super::super::Contact;
    use super::super::tests::{Random, contact, hand3_grasp};
    use super::*;

    fn residual(map: &GraspMap, forces: &[Vector3<f32>]) -> f32 {
        let (force, moment) = map.scaled_sum(forces);
        math::sqrt(force.norm_squared() + moment.norm_squared())
    }

    #[test]
    fn pairs_press_towards_each_other_without_a_wrench() {
        let mut random = Random(4);
        for _ in 0..100 {
            let map = random.ball(3, Vector3::new(0.1, 0.2, 0.3));
            let e = map.pairwise().unwrap();
            assert!((map.matrix().fixed_columns::<9>(0) * e).norm() < 2e-7);
            // Positive strengths press inwards.
            let squeezed = e * Vector3::new(1.0, 1.0, 1.0);
            for (index, lever) in map.levers.iter().enumerate() {
                assert!(squeezed.fixed_rows::<3>(3 * index).dot(lever) < 0.0);
            }
        }
        assert_eq!(random.ball(4, Vector3::zeros()).pairwise(), Err(ContactCountError(4)));
    }

    #[test]
    fn the_basis_is_orthonormal_complete_and_without_a_wrench() {
        let mut random = Random(5);
        let line: std::vec::Vec<Contact> =
            (0..6).map(|x| contact([0.02 * x as f32, 0.01, 0.0], [0.0, 0.0, 1.0], 0.5, 9.0)).collect();
        let line = GraspMap::try_new(&line, Vector3::zeros()).unwrap();
        let mut maps: std::vec::Vec<GraspMap> =
            (0..100).map(|round| random.ball(2 + round % 5, Vector3::zeros())).collect();
        maps.push(line);
        for (round, map) in maps.iter().enumerate() {
            let internal = map.internal_forces();
            let expected = if round == 100 { 13 } else { [1, 3, 6, 9, 12][round % 5] };
            assert_eq!(internal.basis().len(), expected);
            for (index, force) in internal.basis().iter().enumerate() {
                assert!(residual(map, force) < 2e-6, "{round} {}", residual(map, force));
                for (other, second) in internal.basis().iter().enumerate() {
                    let unit = if index == other { 1.0 } else { 0.0 };
                    assert!((dot(force, second) - unit).abs() < 2e-6, "{round} {index} {other}");
                }
            }
            let made = internal.forces(&[2.0, -1.0]);
            assert!((dot(&made, &internal.basis()[0]) - 2.0).abs() < 1e-5);
        }
    }

    #[test]
    fn three_fingers_grip_like_in_the_paper() {
        // +2, +2 and −4 N along x.
        let grip = hand3_grasp(0.5).normal_grip(1e-4).unwrap();
        let expected = [2.0, 2.0, -4.0].map(|x| Vector3::new(x, 0.0, 0.0));
        for (force, expected) in grip.forces(4.0).iter().zip(&expected) {
            assert!((force - expected).norm() < 4e-6, "{force}");
        }
        // Finger 3 nearer to finger 1, in the plane of the normals: finger 1 carries more. Beside that plane:
        // no balance.
        let aside = |y: f32, z: f32| {
            let mut contacts: std::vec::Vec<Contact> = hand3_grasp(0.5).contacts().to_vec();
            contacts[2].position = Vector3::new(0.06, y, z);
            GraspMap::try_new(&contacts, Vector3::zeros()).unwrap().normal_grip(1e-3)
        };
        let nearer = aside(0.02, 0.0).unwrap();
        for (fraction, expected) in nearer.fractions().iter().zip([0.75, 0.25, 1.0]) {
            assert!((fraction - expected).abs() < 1e-5);
        }
        assert!(matches!(aside(0.0, 0.01), Err(NormalGripError::Unbalanced { residual }) if residual > 0.05));
        assert!(matches!(aside(0.06, 0.0), Err(NormalGripError::NotPushing { contact: 1, .. })));
        // Slightly beside it: tangential forces balance the residual.
        let little = aside(0.0, 2e-5).unwrap().forces(4.0);
        assert!((little[2].x + 4.0).abs() < 1e-2 && (little[0] + little[1] + little[2]).norm() < 1e-5);
    }

    #[test]
    fn normals_that_do_not_balance_are_refused() {
        let one_way: std::vec::Vec<Contact> = [[0.0, 0.0], [0.02, 0.03], [0.06, 0.0]]
            .iter()
            .map(|&[y, z]| contact([0.0, y, z], [1.0, 0.0, 0.0], 0.5, 9.0))
            .collect();
        let map = GraspMap::try_new(&one_way, Vector3::zeros()).unwrap();
        assert!(matches!(map.normal_grip(1e-3), Err(NormalGripError::Unbalanced { .. })));
        // One of the collinear contacts would have to pull.
        let line: std::vec::Vec<Contact> =
            [0.0, 0.02, 0.06].iter().map(|&y| contact([0.0, y, 0.0], [1.0, 0.0, 0.0], 0.5, 9.0)).collect();
        let map = GraspMap::try_new(&line, Vector3::zeros()).unwrap();
        assert!(matches!(map.normal_grip(1e-3), Err(NormalGripError::NotPushing { .. })));
        // Two opposed pairs: each balances.
        let pairs = [[0.03, 0.0], [-0.03, 0.0], [0.0, 0.03], [0.0, -0.03]]
            .map(|[x, y]| contact([x, y, 0.0], [-x, -y, 0.0], 0.5, 9.0));
        let map = GraspMap::try_new(&pairs, Vector3::zeros()).unwrap();
        assert_eq!(map.normal_grip(1e-3), Err(NormalGripError::Ambiguous));
        assert!(map.normal_grip(f32::NAN).is_err());
    }
}
