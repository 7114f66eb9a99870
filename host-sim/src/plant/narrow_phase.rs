//! Checked contacts of convex solids.
//!
//! Parry finds contacts with the Gilbert–Johnson–Keerthi algorithm in single precision, starting from the
//! normal of the previous sub-step. If the solids overlap by less than a thousandth of their size, it takes
//! them for touching, with the normal that it has at that moment; at the edge of a knob this may be the
//! normal of another face, and it is kept as long as the points move by less than 1 mm. The finger sinks in
//! by millimetres, and is thrown out with thousands of newtons when another normal is found.
//!
//! Therefore each contact is computed twice, with and without the previous normal, and must be the least
//! overlap along directions near its normal. If that fails, or if the two differ, a search in double
//! precision decides: the distance of convex solids is the largest of their separations along all directions,
//! where an overlap counts as negative (Ericson, Real-Time Collision Detection, section 5.2).

use rapier3d::geometry::TrackedContact;
use rapier3d::math::{Pose, Vector};
use rapier3d::na::{Matrix3, Vector3};
use rapier3d::parry::query::{
    ContactManifold, ContactManifoldsWorkspace, DefaultQueryDispatcher, PersistentQueryDispatcher,
};
use rapier3d::parry::shape::{PackedFeatureId, PolygonalFeature, Shape, ShapeType, SupportMap};
use rapier3d::parry::utils::point_cloud_support_point;

use super::convert::{narrow, vector, wide};

/// Distances that differ by less than this count as equal [m].
const TOLERANCE: f64 = 5e-6;
/// Number of starting directions that the search follows, and the cosine that any two of them may have at
/// most.
const FOLLOWED: usize = 8;
const APART: f64 = 0.95;
/// A normal is right if its cosine with the best direction near it is greater than this.
const ALIKE: f64 = 0.999;
/// Steps of a search: the first from an arbitrary direction, the first from a normal that may be right, and
/// the last [rad].
const FIRST: f64 = 0.2;
const NEAR: f64 = 0.01;
const LAST: f64 = 1e-5;
/// A [`Cap`] contains the support points along unit vectors that differ from its own by less than this.
const CAP: f32 = 0.04;
/// Rounding of single precision that a [`Cap`] allows for [m].
const ROUNDING: f32 = 1e-6;

/// Contacts of two solids, each point with the impulse of the last sub-step [N·s].
pub type Manifold = ContactManifold<(), Vector3<f64>>;

/// A direction from the first solid to the second, and their separation along it [m]; negative if they
/// overlap.
#[derive(Clone, Copy, Debug)]
struct Separation {
    normal: Vector3<f64>,
    distance: f64,
}

impl Separation {
    fn larger(self, other: Self) -> Self {
        if other.distance > self.distance { other } else { self }
    }
}

/// A solid of which, along directions near its axis, only the points that can be support points are
/// compared.
struct Cap<'a> {
    whole: &'a dyn SupportMap,
    axis: Vector,
    /// Empty where the solid has no corners.
    points: Vec<Vector>,
}

impl<'a> Cap<'a> {
    fn new(solid: &dyn Shape, whole: &'a dyn SupportMap, axis: Vector) -> Self {
        let corners = solid.as_convex_polyhedron().map_or(&[][..], |solid| solid.points());
        let top = whole.local_support_point(axis);
        // Along `axis + change` a point is farther than the top only if, along the axis, it is at most
        // |change| · |top − point| below it.
        let can_be_farthest = |point: &Vector| {
            let below = (top - *point).dot(axis) - ROUNDING;
            below <= 0.0 || below * below <= CAP * CAP * top.distance_squared(*point)
        };
        Self { whole, axis, points: corners.iter().copied().filter(can_be_farthest).collect() }
    }
}

impl SupportMap for Cap<'_> {
    fn local_support_point(&self, direction: Vector) -> Vector {
        if self.points.is_empty() || direction.distance_squared(self.axis) > CAP * CAP {
            self.whole.local_support_point(direction)
        } else {
            point_cloud_support_point(direction, &self.points)
        }
    }
}

/// Two solids; all quantities are in the frame of the first.
struct Solids<'a> {
    first: &'a dyn Shape,
    second: &'a dyn Shape,
    maps: [&'a dyn SupportMap; 2],
    pose: &'a Pose,
}

impl<'a> Solids<'a> {
    /// Returns `None` for solids that parry does not treat with the algorithm above.
    fn new(pose: &'a Pose, first: &'a dyn Shape, second: &'a dyn Shape) -> Option<Self> {
        let types = [first.shape_type(), second.shape_type()];
        if types.contains(&ShapeType::Ball) || types == [ShapeType::Cuboid; 2] {
            return None;
        }
        Some(Self { first, second, maps: [first.as_support_map()?, second.as_support_map()?], pose })
    }

    fn along(&self, direction: &Vector3<f64>) -> Separation {
        let axis = vector(direction).normalize_or_zero();
        let [first, second] = self.maps;
        let between = wide(second.support_point(self.pose, -axis)) - wide(first.local_support_point(axis));
        let normal = wide(axis);
        // Without a direction there is no separation.
        let distance = if normal == Vector3::zeros() { f64::NEG_INFINITY } else { between.dot(&normal) };
        Separation { normal, distance }
    }

    /// Returns the largest separation, which is the distance of the solids.
    fn largest(&self, known: [Vector; 2]) -> Separation {
        let turn = self.pose.rotation;
        let turned = Matrix3::from_columns(&[Vector::X, Vector::Y, Vector::Z].map(|axis| wide(turn * axis)));
        let signs = || [-1.0, 0.0, 1.0].into_iter();
        let corners =
            signs().flat_map(|x| signs().flat_map(move |y| signs().map(move |z| Vector3::new(x, y, z))));
        let starts =
            corners.flat_map(|corner| [corner, turned * corner]).filter(|start| *start != Vector3::zeros());
        let mut starts: Vec<_> = starts.map(|start| self.along(&start)).collect();
        starts.sort_by(|one, other| other.distance.total_cmp(&one.distance));
        let mut followed: Vec<_> = known.map(|normal| self.along(&wide(normal))).into();
        for start in starts {
            let is_new = followed.iter().all(|other| other.normal.dot(&start.normal) < APART);
            if followed.len() < FOLLOWED && is_new {
                followed.push(start);
            }
        }
        let none = Separation { normal: Vector3::zeros(), distance: f64::NEG_INFINITY };
        followed.into_iter().map(|start| self.climb(start, FIRST)).fold(none, Separation::larger)
    }

    /// Climbs to the nearest local maximum, with steps across the direction that are halved when none leads
    /// up.
    fn climb(&self, start: Separation, first: f64) -> Separation {
        let (mut best, mut step) = (start, first);
        while step > LAST && best.normal != Vector3::zeros() {
            let aside = best.normal.cross(&Vector3::ith(best.normal.iamin(), 1.0)).normalize();
            let across = [aside, best.normal.cross(&aside)];
            let round = [(1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7)];
            let mut tried = round.iter().flat_map(|(one, other)| {
                let way = (across[0] * *one + across[1] * *other) * step;
                [best.normal + way, best.normal - way].map(|direction| self.along(&direction))
            });
            match tried.find(|next| next.distance > best.distance) {
                Some(next) => best = next,
                None => step /= 2.0,
            }
        }
        best
    }

    /// Returns whether `said` is the largest separation along directions close to a normal.
    fn confirms(&self, normal: Vector, said: f64) -> bool {
        let start = self.along(&wide(normal));
        let normal = vector(&start.normal);
        let back = self.pose.rotation.inverse() * -normal;
        let caps = [Cap::new(self.first, self.maps[0], normal), Cap::new(self.second, self.maps[1], back)];
        let near = Solids { maps: caps.each_ref().map(|cap| cap as &dyn SupportMap), ..*self };
        let best = near.climb(start, NEAR);
        (best.distance - said).abs() < TOLERANCE && best.normal.dot(&start.normal) > ALIKE
    }

    /// Returns the points where the faces along a normal meet.
    fn points(&self, at: &Separation) -> Vec<TrackedContact<Vector3<f64>>> {
        let normal = vector(&at.normal);
        let back = self.pose.rotation.inverse() * -normal;
        let mut manifold = Manifold::default();
        if let (Some((first, _)), Some((second, _))) =
            (self.first.as_polygonal_feature_map(), self.second.as_polygonal_feature_map())
        {
            let mut features = [PolygonalFeature::default(), PolygonalFeature::default()];
            let [one, two] = &mut features;
            first.local_support_feature(normal, one);
            second.local_support_feature(back, two);
            PolygonalFeature::contacts(
                self.pose,
                &self.pose.inverse(),
                normal,
                back,
                one,
                two,
                &mut manifold,
                false,
            );
        }
        // If the features do not meet, only the deepest point is left, and is added here.
        let deepest = distance(&manifold).is_some_and(|distance| distance < at.distance + TOLERANCE);
        if !deepest {
            let second = self.maps[1].support_point(self.pose, -normal);
            let first = wide(second) - at.normal * at.distance;
            manifold.points.push(TrackedContact::new(
                vector(&first),
                self.pose.inverse_transform_point(second),
                PackedFeatureId::UNKNOWN,
                PackedFeatureId::UNKNOWN,
                narrow(at.distance),
            ));
        }
        manifold.points.to_vec()
    }

    /// Corrects the contact that was carried over from the previous sub-step.
    fn check(&self, carried: &mut Manifold, fresh: &Manifold) {
        let said = [distance(carried), distance(fresh)];
        let normals = [carried.local_n1, fresh.local_n1];
        let agreed = match said {
            [Some(one), Some(other)] => {
                (one - other).abs() < TOLERANCE && normals.iter().any(|normal| self.confirms(*normal, one))
            }
            [Some(one), None] => self.confirms(carried.local_n1, one),
            [None, Some(_)] => false,
            // One direction along which the solids are separated is a proof.
            [None, None] => normals.iter().any(|normal| self.along(&wide(*normal)).distance > 0.0),
        };
        if agreed {
            return;
        }
        let truth = self.largest(normals);
        let is_true = |said: Option<f64>, normal: Vector| match said {
            Some(said) => (said - truth.distance).abs() < TOLERANCE && self.confirms(normal, said),
            None => truth.distance > 0.0,
        };
        if is_true(said[0], normals[0]) {
            return;
        }
        let before = carried.points.clone();
        if is_true(said[1], normals[1]) {
            (carried.local_n1, carried.local_n2) = (fresh.local_n1, fresh.local_n2);
            carried.points.clone_from(&fresh.points);
        } else {
            carried.local_n1 = vector(&truth.normal);
            carried.local_n2 = self.pose.rotation.inverse() * -carried.local_n1;
            carried.points.clear();
            carried.points.extend(self.points(&truth));
        }
        carried.match_contacts(&before);
    }
}

/// Distance at the deepest point [m]; `None` without points.
fn distance(manifold: &Manifold) -> Option<f64> {
    manifold.points.iter().map(|point| f64::from(point.dist)).reduce(f64::min)
}

/// Finds the contacts of two convex solids that are nearer than `prediction` [m], the second at a pose in the
/// frame of the first. `manifolds` and `workspace` are those of the previous sub-step.
pub fn find(
    pose: &Pose,
    [first, second]: [&dyn Shape; 2],
    prediction: f32,
    manifolds: &mut Vec<Manifold>,
    workspace: &mut Option<ContactManifoldsWorkspace>,
) {
    let parry = DefaultQueryDispatcher;
    // Parry knows the contacts of all convex solids.
    let _ = parry.contact_manifolds(pose, first, second, prediction, manifolds, workspace);
    let solids = Solids::new(pose, first, second);
    if let (Some(solids), [carried]) = (solids, manifolds.as_mut_slice()) {
        let mut fresh = Manifold::default();
        let _ = parry.contact_manifold_convex_convex(pose, first, second, None, None, prediction, &mut fresh);
        solids.check(carried, &fresh);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::f64::consts::{FRAC_PI_4, TAU};

    use rapier3d::na::{Isometry3, Translation3, UnitQuaternion};

    use super::super::convert::pose;
    use super::super::shapes::{bevelled_cylinder, cuboid};
    use super::*;

    /// Radius, length and bevel of a knob, and size of a finger whose thickness is along its x axis [m].
    const KNOB: [f64; 3] = [0.025, 0.06, 0.002];
    const FINGER: [f64; 3] = [0.01, 0.02, 0.1];

    /// Returns the pose of a finger whose face touches the edge between one of the 72 sides of the knob and
    /// the bevel. The inner normal of the face is `lift` above that of the side, and the edge is `depth`
    /// inside the finger. The finger is turned about that normal and moved along its own length.
    fn on_edge(side: u8, lift: f64, turn: f64, along: f64, depth: f64) -> Isometry3<f64> {
        let [radius, length, bevel] = KNOB;
        let edge = Vector3::new(radius * (TAU / 144.0).cos(), 0.0, length / 2.0 - bevel);
        let normal = Vector3::new(lift.cos(), 0.0, lift.sin());
        let about = UnitQuaternion::from_axis_angle;
        let lean = about(&Vector3::y_axis(), -lift);
        let place = edge + normal * (FINGER[0] / 2.0 - depth) + lean * Vector3::new(0.0, 0.0, along);
        let spin = about(&Vector3::x_axis(), turn);
        about(&Vector3::z_axis(), (f64::from(side) + 0.5) * TAU / 72.0)
            * Isometry3::from_parts(Translation3::from(place), lean * spin)
    }

    #[test]
    fn a_cap_has_the_support_points_of_its_solid() {
        let [radius, length, bevel] = KNOB;
        let knob = bevelled_cylinder(radius, length, bevel).unwrap().build();
        let whole = knob.shape().as_support_map().unwrap();
        let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
        let mut fewest = usize::MAX;
        for step in 0..500 {
            let share = f64::from(step);
            let axis = about(Vector3::z(), 0.7 * share) * about(Vector3::y(), 0.3 * share) * Vector3::x();
            let cap = Cap::new(knob.shape(), whole, vector(&axis));
            fewest = fewest.min(cap.points.len());
            for turn in 0..40 {
                let turn = f64::from(turn);
                // Within the cap, and up to twice as far away.
                let aside = about(axis, turn) * axis.cross(&Vector3::new(0.3, 0.5, 0.8)).normalize();
                let direction = vector(&(axis + aside * 0.002 * turn).normalize());
                let [found, expected] =
                    [&cap as &dyn SupportMap, whole].map(|map| map.local_support_point(direction));
                assert_eq!(found, expected, "{axis:?} {direction:?}");
            }
        }
        assert!(fewest < 10, "{fewest} of 288 points");
    }

    /// Slides and rolls a finger over the edge of a knob in small steps, 2 to 62 µm deep, but at some steps
    /// 0.2 mm away. Returns the errors of the distances that `find` returns.
    fn errors(find: impl Fn(&Pose, [&dyn Shape; 2], &mut Vec<Manifold>)) -> Vec<f64> {
        let [radius, length, bevel] = KNOB;
        let (knob, finger) =
            (bevelled_cylinder(radius, length, bevel).unwrap().build(), cuboid(FINGER).build());
        let mut errors = Vec::new();
        for side in 0..12 {
            let mut manifolds = Vec::new();
            for step in 0..200 {
                let share = f64::from(step) / 200.0;
                let depth = if step % 50 < 5 { -2e-4 } else { 2e-6 + 6e-5 * (7.0 * share).fract() };
                let turn = f64::from(side) * 0.05;
                let place = pose(&on_edge(side * 5, share * FRAC_PI_4, turn, 0.01 - 0.02 * share, depth));
                let (one, other) = (knob.shape(), finger.shape());
                find(&place, [one, other], &mut manifolds);
                // Solids that are apart need no contact point.
                let found = manifolds.first().and_then(distance).unwrap_or(f64::INFINITY);
                let is_free = depth < 0.0 && found > 0.0;
                errors.push(if is_free { 0.0 } else { (found + depth).abs() });
            }
        }
        errors
    }

    #[test]
    fn a_finger_at_the_edge_of_a_knob_is_as_deep_as_it_was_put() {
        let checked = |pose: &Pose, solids: [&dyn Shape; 2], manifolds: &mut Vec<Manifold>| {
            find(pose, solids, 2e-5, manifolds, &mut None);
        };
        let largest = errors(checked).into_iter().fold(0.0, f64::max);
        // Tolerance of two comparisons.
        assert!(largest < 2.0 * TOLERANCE, "{largest:e} m");
        let of_parry = errors(|pose, [one, other], manifolds| {
            DefaultQueryDispatcher.contact_manifolds(pose, one, other, 2e-5, manifolds, &mut None).unwrap();
        });
        assert!(of_parry.iter().any(|error| *error > 1e-4), "parry needs no check any more");
    }
}
