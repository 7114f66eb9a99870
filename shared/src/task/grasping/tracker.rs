use nalgebra::{IsometryMatrix3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{Frame, PerFinger};
use crate::grasp::{ObjectFrameError, object_frame};
use crate::math;

/// Share of a change between the fingertips that goes into the anchors in a tick.
const LEAK: f32 = 0.1;
/// The same for where the fingers are led: so fast that nothing fights the internal forces, and so slow that a finger that
/// comes free is held back.
const SHAPE_LEAK: f32 = 0.4;

/// Follows an object by the fingertips that hold it.
///
/// The fingertips' triangle gives the object's frame. A round tip rolls: its middle moves along the surface by
/// `(ω_F − ω_o) × r n` without sliding, `ω` of tip and object, `n` the normal out of the object; where the middles belong
/// in the object, the anchors, move accordingly. (0.1 rad of relative rotation are 0.8 mm for a tip of 8 mm radius.)
/// What the triangle changes besides cannot be rolling.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Tracker {
    /// The object.
    pub object: Frame,
    /// Its rotation in the last tick, in base axes [rad].
    spin: [f32; 3],
    /// Middles of the tips in the object frame [m].
    pub anchors: PerFinger<[f32; 3]>,
    /// Normals into the object, in the object frame.
    pub normals: PerFinger<[f32; 3]>,
    /// The middles of the tips as they are, a mean of some ticks [m].
    pub places: PerFinger<[f32; 3]>,
    /// How far each tip is from its anchor along the surface that the others make [m].
    pub shifts: PerFinger<f32>,
    /// Lengths of the triangle's sides at the beginning [m].
    sides: PerFinger<f32>,
}

/// How a finger stands and has moved.
pub(super) struct TipMotion {
    /// Middle of the tip [m].
    pub place: Vector3<f32>,
    /// Rotation since the last tick, as a vector in base axes [rad].
    pub rotation: Vector3<f32>,
}

impl Tracker {
    /// Nothing is held.
    pub const NONE: Self = Self {
        object: Frame::BASE,
        spin: [0.0; 3],
        anchors: [[0.0; 3]; 3],
        normals: [[0.0; 3]; 3],
        places: [[0.0; 3]; 3],
        shifts: [0.0; 3],
        sides: [0.0; 3],
    };

    /// The object that the tips touch now, with these normals [base axes, unit vectors].
    pub fn begin(
        tips: &PerFinger<Vector3<f32>>,
        normals: &PerFinger<Vector3<f32>>,
    ) -> Result<Self, ObjectFrameError> {
        let object = object_frame(tips)?;
        let anchors = tips.map(|tip| object.inverse_transform_point(&tip.into()).coords.into());
        Ok(Self {
            object: (&object).into(),
            spin: [0.0; 3],
            anchors,
            places: anchors,
            normals: normals.map(|normal| object.inverse_transform_vector(&normal).into()),
            shifts: [0.0; 3],
            sides: sides(tips),
        })
    }

    /// Where the object is, now that the tips are here. `radii` of the tips [m].
    pub fn update(
        &mut self,
        tips: &PerFinger<TipMotion>,
        radii: &PerFinger<f32>,
    ) -> Result<IsometryMatrix3<f32>, ObjectFrameError> {
        let before = self.object.isometry();
        let spin = Vector3::from(self.spin);
        let middles = self.anchors.iter_mut().zip(&mut self.places);
        for ((((anchor, place), normal), tip), radius) in middles.zip(&self.normals).zip(tips).zip(radii) {
            let out = before.rotation * Vector3::from(*normal) * -radius;
            let rolled = before.inverse_transform_vector(&(tip.rotation - spin).cross(&out));
            *anchor = (Vector3::from(*anchor) + rolled).into();
            *place = (Vector3::from(*place) + rolled).into();
        }
        let measured = object_frame(&tips.each_ref().map(|tip| tip.place))?;
        let object = measured * object_frame(&self.anchors.map(Vector3::from))?.inverse();
        // Small, so that the sine is the angle.
        let turn = object.rotation.matrix() * before.rotation.matrix().transpose();
        let twice = Vector3::new(turn.m32 - turn.m23, turn.m13 - turn.m31, turn.m21 - turn.m12);
        self.spin = (twice * 0.5).into();
        let all = self.anchors.iter_mut().zip(&mut self.places).zip(&mut self.shifts);
        for (((anchor, place), shift), tip) in all.zip(tips) {
            let at = object.inverse_transform_point(&tip.place.into()).coords;
            let rest = at - Vector3::from(*anchor);
            *place = (Vector3::from(*place) * (1.0 - SHAPE_LEAK) + at * SHAPE_LEAK).into();
            *anchor = (Vector3::from(*anchor) + rest * LEAK).into();
            *shift = math::sqrt(rest.norm_squared());
        }
        self.object = (&object).into();
        Ok(object)
    }

    /// Whether there is an object.
    pub const fn is_begun(&self) -> bool {
        let [side, ..] = self.sides;
        side > 0.0
    }

    /// What the fingers have moved against each other is over: they belong where they are.
    pub fn settle(&mut self) {
        (self.anchors, self.shifts) = (self.places, [0.0; 3]);
    }

    /// By how much the triangle's sides differ from what they were, the most of them [m].
    pub fn deformation(&self, tips: &PerFinger<Vector3<f32>>) -> f32 {
        let now = sides(tips);
        self.sides.iter().zip(now).fold(0.0, |most, (before, now)| {
            let change = math::abs(now - before);
            if change > most { change } else { most }
        })
    }

    /// Contact points for an object at `frame`, from its origin, and normals, in base axes.
    pub fn contacts(
        &self,
        frame: &IsometryMatrix3<f32>,
        radii: &PerFinger<f32>,
    ) -> (PerFinger<Vector3<f32>>, PerFinger<Vector3<f32>>) {
        let normals = self.normals.map(|normal| frame.rotation * Vector3::from(normal));
        let mut arms = self.anchors.map(|anchor| frame.rotation * Vector3::from(anchor));
        arms.iter_mut()
            .zip(normals.iter().zip(radii))
            .for_each(|(arm, (normal, radius))| *arm += normal * *radius);
        (arms, normals)
    }
}

fn sides([one, two, three]: &PerFinger<Vector3<f32>>) -> PerFinger<f32> {
    [two - three, one - three, one - two].map(|side| math::sqrt(side.norm_squared()))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::cast_precision_loss, reason = "tests")]
mod tests {
    use super::*;

    const RADIUS: f32 = 0.008;

    /// Fingers 1 and 2 at x = −57 mm, finger 3 opposite: middles of tips that touch a box of 98 mm.
    fn tips() -> PerFinger<Vector3<f32>> {
        [Vector3::new(-0.057, 0.04, 0.1), Vector3::new(-0.057, -0.04, 0.1), Vector3::new(0.057, 0.0, 0.1)]
    }

    fn normals() -> PerFinger<Vector3<f32>> {
        [Vector3::x(), Vector3::x(), -Vector3::x()]
    }

    /// Balls that turn by 0.2 rad about y roll 0.2 · 8 mm = 1.6 mm along a box that stands still: up on its −x side, down
    /// on the other.
    #[test]
    fn tips_that_roll_leave_the_object_where_it_is() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let steps = 100;
        let turn = Vector3::new(0.0, 0.2 / steps as f32, 0.0);
        let before = tracker.object.isometry();
        for step in 1..=steps {
            let way = 0.0016 * step as f32 / steps as f32;
            let [one, two, three] = tips();
            let places = [one + Vector3::z() * way, two + Vector3::z() * way, three - Vector3::z() * way];
            let motions = places.map(|place| TipMotion { place, rotation: turn });
            let object = tracker.update(&motions, &[RADIUS; 3]).unwrap();
            assert!(
                (object.translation.vector - before.translation.vector).norm() < 2e-6,
                "{step}: {object}"
            );
            assert!((object.rotation.matrix() - before.rotation.matrix()).norm() < 2e-5, "{step}: {object}");
        }
        assert!(tracker.shifts.iter().all(|&shift| shift < 2e-6), "{:?}", tracker.shifts);
    }

    /// The same tips without turning: the whole triangle has pitched by 3.2 mm over 114 mm.
    #[test]
    fn tips_that_move_without_rolling_turn_the_object() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let before = tracker.object.isometry();
        let mut object = before;
        for step in 1..=100 {
            let angle = 0.05 * step as f32 / 100.0;
            let turned = math::rotation_matrix(&Vector3::new(0.0, angle, 0.0));
            let middle = Vector3::new(0.0, 0.0, 0.1);
            // Fixed to the object: they turn with it.
            let rotation = Vector3::new(0.0, 0.05 / 100.0, 0.0);
            let motions = tips().map(|tip| TipMotion { place: middle + turned * (tip - middle), rotation });
            object = tracker.update(&motions, &[RADIUS; 3]).unwrap();
        }
        let turn = math::rotation_vector(&(object.rotation.matrix() * before.rotation.matrix().transpose()));
        assert!((turn - Vector3::new(0.0, 0.05, 0.0)).norm() < 1e-4, "{turn}");
    }

    #[test]
    fn a_tip_that_slides_is_told_from_those_that_do_not() {
        let mut tracker = Tracker::begin(&tips(), &normals()).unwrap();
        let [one, two, three] = tips();
        let slid = [one - Vector3::y() * 1e-4, two, three];
        tracker
            .update(&slid.map(|place| TipMotion { place, rotation: Vector3::zeros() }), &[RADIUS; 3])
            .unwrap();
        assert!(tracker.shifts.iter().any(|&shift| shift > 4e-5), "{:?}", tracker.shifts);
        assert!((tracker.deformation(&slid) - 1e-4).abs() < 1e-6);
        let line = [one, one, three].map(|place| TipMotion { place, rotation: Vector3::zeros() });
        assert!(tracker.update(&line, &[RADIUS; 3]).is_err());
    }
}
