use nalgebra::{IsometryMatrix3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::tuning::{ANCHOR_LEAKAGE, CENTER_FILTER_GAIN};
use super::{Frame, PerFinger};
use crate::grasp::{ObjectFrameError, object_frame};
use crate::math;
use crate::zip::zip;

/// Tracks the pose of an object by the fingertips that hold it.
///
/// The fingertips' triangle gives the object's frame. A round tip rolls: without slip its centre moves along
/// the surface by `(ω_F − ω_o) × r n`, with `ω` of fingertip and object and `n` the normal out of the object.
/// The anchors, the centres' positions in the object frame, move accordingly. (For a tip of 8 mm radius, 0.1
/// rad of relative rotation are 0.8 mm.) A change of the triangle beyond that cannot be rolling.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Tracker {
    /// Estimated pose of the object.
    pub object: Frame,
    /// Rotation of the object in the last tick, in base axes [rad].
    rotation: [f32; 3],
    /// Positions of the tips' centres in the object frame without slip [m].
    pub anchors: PerFinger<[f32; 3]>,
    /// Normals into the object, in the object frame.
    pub normals: PerFinger<[f32; 3]>,
    /// Measured positions of the tips' centres in the object frame, filtered [m].
    pub centers: PerFinger<[f32; 3]>,
    /// Distance of each tip's centre from its anchor [m].
    pub anchor_errors: PerFinger<f32>,
    /// Sides of the triangle at the start [m].
    initial_sides: PerFinger<f32>,
}

/// Position and motion of a fingertip.
pub(super) struct TipMotion {
    /// Centre of the tip [m].
    pub center: Vector3<f32>,
    /// Rotation vector since the last tick, in base axes [rad].
    pub rotation: Vector3<f32>,
}

impl Tracker {
    /// No object.
    pub const NONE: Self = Self {
        object: Frame::BASE,
        rotation: [0.0; 3],
        anchors: [[0.0; 3]; 3],
        normals: [[0.0; 3]; 3],
        centers: [[0.0; 3]; 3],
        anchor_errors: [0.0; 3],
        initial_sides: [0.0; 3],
    };

    /// Begins with an object that touches the `tips` [m] with these normals [base axes, unit vectors].
    pub fn begin(
        tips: &PerFinger<Vector3<f32>>,
        normals: &PerFinger<Vector3<f32>>,
    ) -> Result<Self, ObjectFrameError> {
        let object = object_frame(tips)?;
        let anchors = tips.map(|tip| object.inverse_transform_point(&tip.into()).coords.into());
        Ok(Self {
            object: (&object).into(),
            rotation: [0.0; 3],
            anchors,
            centers: anchors,
            normals: normals.map(|normal| object.inverse_transform_vector(&normal).into()),
            anchor_errors: [0.0; 3],
            initial_sides: sides(tips),
        })
    }

    /// Updates the object's pose from its `tips` with these `radii` [m].
    pub fn update(
        &mut self,
        tips: &PerFinger<TipMotion>,
        radii: &PerFinger<f32>,
    ) -> Result<IsometryMatrix3<f32>, ObjectFrameError> {
        let previous = self.object.isometry();
        self.roll(&previous, tips, radii);
        let measured = object_frame(&tips.each_ref().map(|tip| tip.center))?;
        let object = measured * object_frame(&self.anchors.map(Vector3::from))?.inverse();
        // Small rotation: the sine of the angle is the angle.
        let step = object.rotation.matrix() * previous.rotation.matrix().transpose();
        let twice = Vector3::new(step.m32 - step.m23, step.m13 - step.m31, step.m21 - step.m12);
        self.rotation = (twice * 0.5).into();
        for (anchor, center, distance, tip) in
            zip((&mut self.anchors, &mut self.centers, &mut self.anchor_errors, tips))
        {
            let measured = object.inverse_transform_point(&tip.center.into()).coords;
            let error = measured - Vector3::from(*anchor);
            let gain = CENTER_FILTER_GAIN;
            *center = (Vector3::from(*center) * (1.0 - gain) + measured * gain).into();
            *anchor = (Vector3::from(*anchor) + error * ANCHOR_LEAKAGE).into();
            *distance = math::norm(&error);
        }
        self.object = (&object).into();
        Ok(object)
    }

    /// Moves anchors and centres as for tips that roll without slip.
    fn roll(&mut self, object: &IsometryMatrix3<f32>, tips: &PerFinger<TipMotion>, radii: &PerFinger<f32>) {
        let rotation = Vector3::from(self.rotation);
        for (anchor, center, normal, tip, radius) in
            zip((&mut self.anchors, &mut self.centers, &self.normals, tips, radii))
        {
            let outward = object.rotation * Vector3::from(*normal) * -radius;
            let rolled = object.inverse_transform_vector(&(tip.rotation - rotation).cross(&outward));
            *anchor = (Vector3::from(*anchor) + rolled).into();
            *center = (Vector3::from(*center) + rolled).into();
        }
    }

    /// Whether there is an object.
    pub const fn is_tracking(&self) -> bool {
        let [side, ..] = self.initial_sides;
        side > 0.0
    }

    /// Sets the anchors to the present centres, after slip that was intended.
    pub fn reset_anchors(&mut self) {
        (self.anchors, self.anchor_errors) = (self.centers, [0.0; 3]);
    }

    /// Maximum change of the triangle's sides since the start [m].
    pub fn deformation(&self, tips: &PerFinger<Vector3<f32>>) -> f32 {
        let sides = sides(tips);
        self.initial_sides.iter().zip(sides).fold(0.0, |max, (initial, side)| {
            let change = math::abs(side - initial);
            if change > max { change } else { max }
        })
    }

    /// Levers of the contact points from the origin of an object at `frame` [m], and normals, in base axes.
    pub fn contacts(
        &self,
        frame: &IsometryMatrix3<f32>,
        radii: &PerFinger<f32>,
    ) -> (PerFinger<Vector3<f32>>, PerFinger<Vector3<f32>>) {
        let normals = self.normals.map(|normal| frame.rotation * Vector3::from(normal));
        let mut levers = self.anchors.map(|anchor| frame.rotation * Vector3::from(anchor));
        for (lever, normal, radius) in zip((&mut levers, &normals, radii)) {
            *lever += normal * *radius;
        }
        (levers, normals)
    }
}

/// Sides of the triangle [m]; each opposite its finger.
fn sides([one, two, three]: &PerFinger<Vector3<f32>>) -> PerFinger<f32> {
    [two - three, one - three, one - two].map(|side| math::norm(&side))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::cast_precision_loss, reason = "tests")]
mod tests {
    use super::*;

    const RADIUS: f32 = 0.008;

    /// Centres of tips that touch a box of 98 mm: fingers 1 and 2 at x = −57 mm, finger 3 opposite.
    fn tips() -> PerFinger<Vector3<f32>> {
        [Vector3::new(-0.057, 0.04, 0.1), Vector3::new(-0.057, -0.04, 0.1), Vector3::new(0.057, 0.0, 0.1)]
    }

    fn normals() -> PerFinger<Vector3<f32>> {
        [Vector3::x(), Vector3::x(), -Vector3::x()]
    }

    /// Spheres that rotate by 0.2 rad about y roll 0.2 · 8 mm = 1.6 mm along a box at rest: up on its −x
    /// side, down on the other.
    #[test]
    fn tips_that_roll_leave_the_object_where_it_is() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let steps = 100;
        let rotation = Vector3::new(0.0, 0.2 / steps as f32, 0.0);
        let before = tracker.object.isometry();
        for step in 1..=steps {
            let height = 0.0016 * step as f32 / steps as f32;
            let [one, two, three] = tips();
            let up = Vector3::z() * height;
            let centers = [one + up, two + up, three - up];
            let motions = centers.map(|center| TipMotion { center, rotation });
            let object = tracker.update(&motions, &[RADIUS; 3]).unwrap();
            assert!(
                (object.translation.vector - before.translation.vector).norm() < 2e-6,
                "{step}: {object}"
            );
            assert!((object.rotation.matrix() - before.rotation.matrix()).norm() < 2e-5, "{step}: {object}");
        }
        assert!(tracker.anchor_errors.iter().all(|&error| error < 2e-6), "{:?}", tracker.anchor_errors);
    }

    /// Tips fixed to an object that rotates by 0.05 rad.
    #[test]
    fn tips_that_move_without_rolling_rotate_the_object() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let before = tracker.object.isometry();
        let mut object = before;
        for step in 1..=100 {
            let angle = 0.05 * step as f32 / 100.0;
            let rotated = math::rotation_matrix(&Vector3::new(0.0, angle, 0.0));
            let center_of_rotation = Vector3::new(0.0, 0.0, 0.1);
            // Fixed to the object: they rotate with it.
            let rotation = Vector3::new(0.0, 0.05 / 100.0, 0.0);
            let motions = tips().map(|tip| TipMotion {
                center: center_of_rotation + rotated * (tip - center_of_rotation),
                rotation,
            });
            object = tracker.update(&motions, &[RADIUS; 3]).unwrap();
        }
        let [_, rotation] = math::displacement(&before, &object);
        assert!((rotation - Vector3::new(0.0, 0.05, 0.0)).norm() < 1e-4, "{rotation}");
    }

    /// As points, those tips would rotate the object: their triangle pitches by atan(2·1.6 mm / 114 mm).
    #[test]
    fn the_triangle_of_points_rotates_with_tips_that_roll() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let before = tracker.object.isometry();
        let [one, two, three] = tips();
        let up = Vector3::z() * 0.0016;
        let rotation = Vector3::new(0.0, 0.2, 0.0);
        let motions = [one + up, two + up, three - up].map(|center| TipMotion { center, rotation });
        let object = tracker.update(&motions, &[0.0; 3]).unwrap();
        let [_, turned] = math::displacement(&before, &object);
        assert!((turned - Vector3::new(0.0, 0.028_063, 0.0)).norm() < 1e-5, "{turned}");
    }

    #[test]
    fn a_tip_that_slides_has_an_anchor_error() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let [one, two, three] = tips();
        let slid = [one - Vector3::y() * 1e-4, two, three];
        tracker
            .update(&slid.map(|center| TipMotion { center, rotation: Vector3::zeros() }), &[RADIUS; 3])
            .unwrap();
        assert!(tracker.anchor_errors.iter().any(|&error| error > 4e-5), "{:?}", tracker.anchor_errors);
        assert!((tracker.deformation(&slid) - 1e-4).abs() < 1e-6);
        let line = [one, one, three].map(|center| TipMotion { center, rotation: Vector3::zeros() });
        assert!(tracker.update(&line, &[RADIUS; 3]).is_err());
    }
}
