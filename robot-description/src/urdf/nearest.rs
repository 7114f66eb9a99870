//! The inertia that a body can have nearest to one that no body can have.

use nalgebra::Matrix3;
use urdf_rs::Inertial;

/// Mass of a link that has none [kg].
const MASS: f64 = 1e-3;
/// Smallest root mean square distance of the mass from the centre along a principal axis [m].
const RADIUS: f64 = 1e-3;

/// Replaces mass and inertia: in the principal axes, second moments of mass that are negative or too small
/// are raised.
pub fn replace(inertial: &mut Inertial) {
    if inertial.mass.value <= 0.0 {
        inertial.mass.value = MASS;
    }
    let i = &mut inertial.inertia;
    let tensor = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    if tensor.iter().any(|value| !value.is_finite()) {
        return;
    }
    let eigen = tensor.symmetric_eigen();
    // Half the trace less a principal moment is the second moment of mass along its axis.
    let half = 0.5 * eigen.eigenvalues.sum();
    let least = inertial.mass.value * RADIUS * RADIUS;
    let second = eigen.eigenvalues.map(|moment| (half - moment).max(least));
    let moments = second.map(|moment| second.sum() - moment);
    let nearest = eigen.eigenvectors * Matrix3::from_diagonal(&moments) * eigen.eigenvectors.transpose();
    (i.ixx, i.iyy, i.izz) = (nearest.m11, nearest.m22, nearest.m33);
    (i.ixy, i.ixz, i.iyz) = (nearest.m12, nearest.m13, nearest.m23);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The inertial with these moments, without products.
    fn with(mass: f64, [ixx, iyy, izz]: [f64; 3]) -> Inertial {
        let mut inertial = Inertial::default();
        inertial.mass.value = mass;
        (inertial.inertia.ixx, inertial.inertia.iyy, inertial.inertia.izz) = (ixx, iyy, izz);
        replace(&mut inertial);
        inertial
    }

    #[test]
    fn a_moment_beyond_the_sum_of_the_others_is_met_half_way() {
        // Second moments of (2, 3, 9)e-4 are (5, 4, -2)e-4; with (5, 4, 0.001)e-4 the moments are
        // (4.001, 5.001, 9)e-4.
        let inertia = with(0.1, [2e-4, 3e-4, 9e-4]).inertia;
        for (got, expected) in [(inertia.ixx, 4.001e-4), (inertia.iyy, 5.001e-4), (inertia.izz, 9e-4)] {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
    }

    #[test]
    fn a_possible_inertia_stays_and_a_link_of_nothing_becomes_a_gram() {
        let inertia = with(0.1, [3e-4, 3e-4, 4e-4]).inertia;
        assert!((inertia.izz - 4e-4).abs() < 1e-12 && (inertia.ixx - 3e-4).abs() < 1e-12);
        let empty = with(0.0, [0.0; 3]);
        assert!((empty.mass.value - 1e-3).abs() < 1e-12 && (empty.inertia.ixx - 2e-9).abs() < 1e-15);
    }
}
