//! Solids in the physics engine.

use rapier3d::dynamics::CoefficientCombineRule;
use rapier3d::geometry::{Collider, ColliderBuilder};
use rapier3d::math::Vector;
use rapier3d::na::Isometry3;
use rapier3d::pipeline::ActiveHooks;

use super::convert::{narrow, pose};

/// Creates a cuboid of the given extents [m].
pub fn cuboid(size: [f64; 3]) -> ColliderBuilder {
    let [x, y, z] = size.map(|extent| narrow(extent / 2.0));
    ColliderBuilder::cuboid(x, y, z)
}

/// Creates a cylinder along z. (Rapier's is along y.)
pub fn cylinder(radius: f64, length: f64) -> ColliderBuilder {
    ColliderBuilder::cylinder(narrow(length / 2.0), narrow(radius))
        .rotation(Vector::X * core::f32::consts::FRAC_PI_2)
}

/// Creates a prism along z, inside a cylinder by at most a thousandth of its radius, with edges that are
/// bevelled by `chamfer` at 45° [m]. `None` if it has no volume.
pub fn bevelled_cylinder(radius: f64, length: f64, chamfer: f64) -> Option<ColliderBuilder> {
    // 1 − cos(π/72) = 0.00095
    const SIDES: u32 = 72;
    let half = length / 2.0;
    let mut points = Vec::new();
    for side in 0..SIDES {
        let angle = f64::from(side) * core::f64::consts::TAU / f64::from(SIDES);
        for (radius, height) in [(radius - chamfer, half), (radius, half - chamfer)] {
            let [x, y] = [libm::cos(angle), libm::sin(angle)].map(|part| narrow(radius * part));
            points.extend([height, -height].map(|height| Vector::new(x, y, narrow(height))));
        }
    }
    ColliderBuilder::convex_hull(&points)
}

/// Moves the solid to a pose.
pub fn placed(solid: ColliderBuilder, place: &Isometry3<f64>) -> ColliderBuilder {
    let own = solid.position;
    solid.position(pose(place) * own)
}

/// Builds the solid with a coefficient of friction; a contact uses the larger of the two coefficients.
pub fn with_friction(solid: ColliderBuilder, friction: f64) -> Collider {
    let solid = solid.friction(narrow(friction)).friction_combine_rule(CoefficientCombineRule::Max);
    solid.active_hooks(ActiveHooks::MODIFY_SOLVER_CONTACTS).build()
}
