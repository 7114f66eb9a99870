use nalgebra::{Matrix3, Vector3};

use super::Contact;
use crate::math;

/// Feasible forces of a contact in units of the load: a friction cone truncated at normal forces of
/// `min_force` and `limit`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cone {
    normal: Vector3<f32>,
    friction: f32,
    /// 1/(1 + μ²).
    flatness: f32,
    min_force: f32,
    limit: f32,
}

/// Euclidean projection onto the cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    pub force: Vector3<f32>,
    /// Support function: maximum power of the cone's forces with the given vector as velocity.
    pub support: f32,
    /// Unit vector across the normal, towards the given force; 0 for one along the normal.
    across: Vector3<f32>,
    /// Elements of the derivative: normal–normal, normal–tangential, tangential–tangential, and orthogonal to
    /// both.
    derivative: [f32; 4],
}

impl Cone {
    /// Cone of a contact with the friction reduced by `margin`; forces in units of `unit` [N].
    pub fn new(contact: &Contact, margin: f32, min_force: f32, unit: f32) -> Self {
        let friction = contact.friction * (1.0 - margin);
        let inverse = 1.0 / unit;
        Self {
            normal: contact.normal,
            friction,
            flatness: 1.0 / (1.0 + friction * friction),
            min_force: min_force * inverse,
            limit: contact.limit * inverse,
        }
    }

    /// Support function at the velocity `v`.
    pub fn support(&self, v: &Vector3<f32>) -> f32 {
        let along = self.normal.dot(v);
        let across = math::norm(&(v - self.normal * along));
        self.power(along, across)
    }

    #[inline]
    fn power(&self, along: f32, across: f32) -> f32 {
        let rate = along + self.friction * across;
        rate * if rate > 0.0 { self.limit } else { self.min_force }
    }

    /// Projection of `v` onto the cone.
    #[inline]
    pub fn nearest(&self, v: &Vector3<f32>) -> Projection {
        let Self { normal, friction, flatness, min_force, limit } = *self;
        let along = normal.dot(v);
        let mut across = v - normal * along;
        let square = across.norm_squared();
        let tangential = math::sqrt(square);
        let support = self.power(along, tangential);
        if tangential <= friction * along && along >= min_force && along <= limit {
            return Projection {
                force: *v,
                support,
                across: Vector3::zeros(),
                derivative: [1.0, 0.0, 1.0, 1.0],
            };
        }
        let inverse = if square > f32::MIN_POSITIVE { 1.0 / tangential } else { 0.0 };
        across *= inverse;
        // Projection onto the lateral surface. It is the result for points outside, unless an end face is
        // nearer.
        let foot = (along + friction * tangential) * flatness;
        let surface = tangential > friction * along;
        let normal_force = if surface { foot } else { along };
        if surface && foot > min_force && foot < limit {
            let tangential = friction * foot;
            let derivative =
                [flatness, friction * flatness, friction * friction * flatness, tangential * inverse];
            return Projection { force: normal * foot + across * tangential, support, across, derivative };
        }
        let normal_force = if normal_force < limit { normal_force } else { limit };
        let normal_force = if normal_force > min_force { normal_force } else { min_force };
        let max_tangential = friction * normal_force;
        if tangential < max_tangential {
            Projection {
                force: normal * normal_force + across * tangential,
                support,
                across,
                derivative: [0.0, 0.0, 1.0, 1.0],
            }
        } else {
            let derivative = [0.0, 0.0, 0.0, max_tangential * inverse];
            Projection { force: normal * normal_force + across * max_tangential, support, across, derivative }
        }
    }

    /// Jacobian of the projection, a symmetric matrix.
    #[inline]
    pub fn derivative(&self, nearest: &Projection) -> Matrix3<f32> {
        let [along, mixed, across, other] = nearest.derivative;
        let (n, t) = (&self.normal, &nearest.across);
        // (along − other) n nᵀ + mixed (n tᵀ + t nᵀ) + (across − other) t tᵀ + other
        let a = n * (along - other) + t * mixed;
        let b = n * mixed + t * (across - other);
        let mut matrix = Matrix3::zeros();
        for row in 0..3 {
            for column in 0..=row {
                let value = a[row] * n[column] + b[row] * t[column] + if row == column { other } else { 0.0 };
                matrix[(row, column)] = value;
                matrix[(column, row)] = value;
            }
        }
        matrix
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Random, contact};
    use super::*;

    fn cones() -> impl Iterator<Item = Cone> {
        [(0.5, 0.0, 3.0), (0.0, 0.0, 2.0), (1.2, 0.3, 2.5), (0.3, 0.5, 0.9)].into_iter().map(
            |(friction, min_force, limit)| {
                Cone::new(
                    &contact([0.0; 3], [1.0, -2.0, 0.5], friction, limit * 2.0),
                    0.1,
                    min_force * 2.0,
                    2.0,
                )
            },
        )
    }

    #[test]
    fn the_nearest_force_is_inside_and_nearer_than_all_others() {
        let mut random = Random(6);
        for cone in cones() {
            for _ in 0..2000 {
                let v = random.vector(4.0);
                let nearest = cone.nearest(&v);
                let along = cone.normal.dot(&nearest.force);
                let across = (nearest.force - cone.normal * along).norm();
                assert!(across <= cone.friction * along + 2e-6 && along < cone.limit + 1e-6);
                assert!(along > cone.min_force - 1e-6);
                // (v − p)·(q − p) ≤ 0 for every q of a convex set; and no q has more power than the support.
                for _ in 0..20 {
                    let push = random.between(cone.min_force, cone.limit);
                    let side = random.vector(1.0);
                    let side = (side - cone.normal * cone.normal.dot(&side)).normalize();
                    let other = cone.normal * push + side * (cone.friction * push * random.between(0.0, 1.0));
                    assert!((v - nearest.force).dot(&(other - nearest.force)) < 2e-5);
                    assert!(v.dot(&other) < nearest.support + 1e-5);
                }
                assert!((cone.support(&v) - nearest.support).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_derivative_is_that_of_small_steps() {
        let mut random = Random(7);
        for cone in cones() {
            let mut far = 0;
            for _ in 0..2000 {
                let (v, step) = (random.vector(4.0), random.vector(1.0));
                let size = 2e-3;
                let (before, after) = (cone.nearest(&(v - step * size)), cone.nearest(&(v + step * size)));
                let slope = (after.force - before.force) / (2.0 * size);
                let matrix = cone.derivative(&cone.nearest(&v));
                // Except for steps across an edge.
                far += u32::from((matrix * step - slope).norm() > 5e-3);
            }
            assert!(far < 40, "{cone:?}: {far}");
        }
    }
}
