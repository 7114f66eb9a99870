//! Solids.

use rapier3d::geometry::{Aabb, ColliderBuilder, SharedShape};
use rapier3d::math::Vector;
use rapier3d::na::{Isometry3, Point3};
use rapier3d::parry::bounding_volume::BoundingSphere;
use rapier3d::parry::query::PointQuery;

use super::convert::{isometry_of, narrow, pose, vector, wide};

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

/// A convex solid, and its pose in the frame of the body that it belongs to.
pub struct Solid {
    pub shape: SharedShape,
    pub place: Isometry3<f64>,
    bounds: Aabb,
    ball: BoundingSphere,
}

impl Solid {
    /// Returns whether the distance to another solid at a pose relative to this one can be below `limit` [m].
    pub fn is_near(&self, other: &Self, between: &Isometry3<f64>, limit: f32) -> bool {
        let center = vector(&(between * Point3::from(wide(other.ball.center))).coords);
        self.bounds.distance_to_local_point(center, true) < limit + other.ball.radius
    }
}

impl From<ColliderBuilder> for Solid {
    fn from(ColliderBuilder { shape, position, .. }: ColliderBuilder) -> Self {
        let (bounds, ball) = (shape.compute_local_aabb(), shape.compute_local_bounding_sphere());
        Self { shape, place: isometry_of(&position), bounds, ball }
    }
}
