use nalgebra::Vector6;

use super::cone::Cone;
use super::{GraspMap, LeastGrip};
use crate::math::{self, halves};

/// Bound of the rounding errors of the sums, over the sum of their terms' norms.
const ROUNDING: f32 = 4e-7;
/// A load within this relative distance of the feasible set is not refused.
const NEAR: f32 = 2e-5;

/// Proof that no contact forces hold a load: a twist `y` with which the load has more power than any forces
/// inside cones and limits, `y·w > max y·(G f)`. If forces held the load, both sides would be equal. The
/// twist is the normal of a hyperplane that separates the load from the feasible wrenches.
///
/// The object accelerates along `−y`.
#[derive(Clone, Debug, PartialEq)]
pub struct Certificate {
    /// The twist, of any length, about the contacts' centroid, where rounding errors are smallest
    /// [m/s; rad/s].
    pub twist: Vector6<f32>,
}

impl Certificate {
    /// Whether it proves that `grip` cannot hold `load` [N; N·m] with the contacts of `map`. The check is
    /// independent of the search, and allows for the rounding errors of its own sums.
    pub fn is_valid(&self, grip: &LeastGrip, map: &GraspMap, load: &Vector6<f32>) -> bool {
        let [linear, angular] = halves(&self.twist);
        let angular = angular * map.length;
        let norm = math::norm(&linear) + math::norm(&angular);
        let (force, moment) = map.scaled(load);
        let mut max_power = 0.0;
        let mut terms = 0.0;
        for (contact, lever) in map.contacts.iter().zip(&map.levers) {
            let cone = Cone::new(contact, grip.margin, grip.min_force, 1.0);
            let velocity = linear + angular.cross(lever);
            max_power += cone.support(&velocity);
            terms += contact.limit * (1.0 + contact.friction);
        }
        linear.dot(&force) + angular.dot(&moment)
            > max_power
                + norm * (NEAR * math::sqrt(force.norm_squared() + moment.norm_squared()) + ROUNDING * terms)
    }
}
