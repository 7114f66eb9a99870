use core::ops::{Add, Mul};

use heapless::Vec;
use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::kinematics::{Chain, Link};
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

/// Mass matrix of a chain, `M` in `τ = M(q) q̈ + h(q, q̇)` [kg·m²]. Rows and columns beyond the chain's
/// joints are 0.
pub type MassMatrix = SMatrix<f32, MAX_CHAIN_JOINTS, MAX_CHAIN_JOINTS>;

/// A joint axis and the rigid body that it carries.
#[derive(Clone, Copy)]
struct Body {
    axis: Vector3<f32>,
    origin: Vector3<f32>,
    mass: f32,
    /// First moment of mass about the joint's origin [kg·m].
    moment: Vector3<f32>,
    /// Inertia about the joint's origin [kg·m²].
    inertia: Symmetric,
}

/// A symmetric matrix.
#[derive(Clone, Copy)]
struct Symmetric {
    xx: f32,
    yy: f32,
    zz: f32,
    xy: f32,
    xz: f32,
    yz: f32,
}

impl Chain {
    /// The mass matrix at angles `q` [rad] by the composite-rigid-body algorithm (Featherstone 2008, section
    /// 6.2), with rotor inertia if the chain has it. Exactly symmetric. Missing angles count as 0.
    pub fn mass_matrix(&self, q: &[f32]) -> MassMatrix {
        // Outward pass: links in the axes and from the origin of the first link, because the first angle does
        // not change the matrix. A distant base then costs no significant digits.
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

        // Inward pass: the links beyond joint j form one composite rigid body. The force and moment of a unit
        // acceleration about joint j, projected onto each earlier axis, are column j.
        let mut matrix = MassMatrix::zeros();
        let mut behind: Option<Body> = None;
        let columns = matrix.as_mut_slice().chunks_exact_mut(MAX_CHAIN_JOINTS);
        for ((j, body), column) in bodies.iter().enumerate().zip(columns).rev() {
            let composite = behind.map_or(*body, |behind| body.with(&behind));
            let force = composite.axis.cross(&composite.moment);
            let moment = composite.inertia * composite.axis;
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
            inertia: Symmetric::turned(&link.inertia, rotation)
                + Symmetric::parallel_axis(&center, &(moment * 0.5)),
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
            inertia: self.inertia
                + other.inertia
                + Symmetric::parallel_axis(&arm, &(other.moment + shift * 0.5)),
            ..*self
        }
    }
}

impl Symmetric {
    /// `R I Rᵀ`.
    #[inline]
    fn turned(inertia: &Matrix3<f32>, rotation: &Matrix3<f32>) -> Self {
        let half = math::product(rotation, inertia);
        let element = |row, column| half.row(row).dot(&rotation.row(column));
        Self {
            xx: element(0, 0),
            yy: element(1, 1),
            zz: element(2, 2),
            xy: element(0, 1),
            xz: element(0, 2),
            yz: element(1, 2),
        }
    }

    /// Parallel-axis term for a reference point moved by `−arm`: `2 (a·h) 1 − a hᵀ − h aᵀ`, with the mean `h`
    /// of the first moments about both points.
    #[inline]
    fn parallel_axis(a: &Vector3<f32>, h: &Vector3<f32>) -> Self {
        let (x, y, z) = (a.x * h.x, a.y * h.y, a.z * h.z);
        Self {
            xx: 2.0 * (y + z),
            yy: 2.0 * (x + z),
            zz: 2.0 * (x + y),
            xy: -(a.x * h.y + a.y * h.x),
            xz: -(a.x * h.z + a.z * h.x),
            yz: -(a.y * h.z + a.z * h.y),
        }
    }
}

impl Add for Symmetric {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self {
            xx: self.xx + other.xx,
            yy: self.yy + other.yy,
            zz: self.zz + other.zz,
            xy: self.xy + other.xy,
            xz: self.xz + other.xz,
            yz: self.yz + other.yz,
        }
    }
}

impl Mul<Vector3<f32>> for Symmetric {
    type Output = Vector3<f32>;

    #[inline]
    fn mul(self, v: Vector3<f32>) -> Vector3<f32> {
        Vector3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }
}
