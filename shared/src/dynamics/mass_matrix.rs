use heapless::Vec;
use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::kinematics::{Chain, Link};
use crate::model::MAX_CHAIN_JOINTS;

/// Mass matrix of a chain, `M` in `τ = M(q) q̈ + h(q, q̇)` [kg·m²]. Rows and columns beyond the chain's joints are 0.
pub type MassMatrix = SMatrix<f32, MAX_CHAIN_JOINTS, MAX_CHAIN_JOINTS>;

/// A joint's axis and a rigid body behind it.
#[derive(Clone, Copy)]
struct Body {
    axis: Vector3<f32>,
    origin: Vector3<f32>,
    mass: f32,
    /// First moment of mass about the joint's origin [kg·m].
    moment: Vector3<f32>,
    /// Inertia about the joint's origin [kg·m²].
    inertia: Matrix3<f32>,
}

impl Chain {
    /// The mass matrix at angles `q` [rad] by the composite-rigid-body algorithm (Featherstone 2008, section 6.2), with
    /// the inertia of rotors if the chain has it: exactly symmetric. Angles that are missing count as 0.
    pub fn mass_matrix(&self, q: &[f32]) -> MassMatrix {
        // Outwards: the links in axes of the first and from its origin, for how the first joint stands changes nothing.
        // So the distance to the base costs no digits either.
        let mut bodies = Vec::<Body, MAX_CHAIN_JOINTS>::new();
        let (mut rotation, mut origin) = (Matrix3::identity(), Vector3::zeros());
        for (index, link) in self.links.iter().enumerate() {
            if index > 0 {
                origin += rotation * link.translation;
                link.turn(&mut rotation, q.get(index).copied().unwrap_or(0.0));
            }
            // Cannot fail: there are no more links than places.
            let _ = bodies.push(Body::of_link(link, &rotation, origin));
        }

        // Inwards: what lies behind joint j is one rigid body. Accelerating it about the joint takes a force and a
        // moment, whose moment about every axis before is an element of column j.
        let mut matrix = MassMatrix::zeros();
        let mut behind: Option<Body> = None;
        for (j, body) in bodies.iter().enumerate().rev() {
            let composite = behind.map_or(*body, |behind| body.with(&behind));
            let force = composite.axis.cross(&composite.moment);
            let moment = composite.inertia * composite.axis;
            let mut column = matrix.column_mut(j);
            for (element, before) in column.iter_mut().zip(&bodies).take(j) {
                let arm = composite.origin - before.origin;
                *element = before.axis.dot(&(moment + arm.cross(&force)));
            }
            if let Some(diagonal) = column.get_mut(j) {
                *diagonal = composite.axis.dot(&moment) + self.rotor_inertia.get(j).copied().unwrap_or(0.0);
            }
            behind = Some(composite);
        }
        matrix.fill_lower_triangle_with_upper_triangle();
        matrix
    }
}

impl Body {
    #[inline]
    fn of_link(link: &Link, rotation: &Matrix3<f32>, origin: Vector3<f32>) -> Self {
        let center = rotation * link.center_of_mass;
        let moment = center * link.mass;
        Self {
            axis: rotation.column(2).into_owned(),
            origin,
            mass: link.mass,
            moment,
            inertia: rotation * link.inertia * rotation.transpose() + parallel_axis(&center, &(moment * 0.5)),
        }
    }

    /// This body and, rigidly fixed to it, another; about the origin of this one.
    #[inline]
    fn with(&self, other: &Self) -> Self {
        let arm = other.origin - self.origin;
        let shift = arm * other.mass;
        Self {
            mass: self.mass + other.mass,
            moment: self.moment + other.moment + shift,
            inertia: self.inertia + other.inertia + parallel_axis(&arm, &(other.moment + shift * 0.5)),
            ..*self
        }
    }
}

/// What moving the point of reference by `−arm` adds to an inertia: `2 (a·h) 1 − a hᵀ − h aᵀ` with the mean `h` of the
/// first moments about both points.
#[inline]
fn parallel_axis(arm: &Vector3<f32>, mean: &Vector3<f32>) -> Matrix3<f32> {
    let product = arm * mean.transpose();
    Matrix3::from_diagonal_element(2.0 * arm.dot(mean)) - product - product.transpose()
}
