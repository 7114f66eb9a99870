use core::f32::consts::{PI, TAU};
use core::fmt;

use heapless::Vec;
use nalgebra::{IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, Vector3};

use super::Chain;
use super::inverse::MAX_DISTANCE;
use crate::math::{self, abs};

/// By how much of its size a chain may miss the shape of a finger; solutions then miss their point by as much.
const SHAPE_TOLERANCE: f32 = 1e-4;
/// Nearer to the first axis than this share of the finger's length the first joint has no say in where the tip is.
const ON_AXIS: f32 = 1e-6;
/// A point this much beyond reach, as a share of the finger's length, counts as the straight finger's.
const REACH_TOLERANCE: f32 = 1e-6;
/// An angle may be this much outside its limit, and is then the limit [rad].
const LIMIT_TOLERANCE: f32 = 1e-5;

/// A three-joint finger: one joint that turns it about its root's axis, and two with parallel axes across that one, which
/// bend it. Its inverse kinematics has a closed form (Hand3, section 2).
///
/// The shape is found in the chain, whatever its frames, zero angles and directions. The bending joints' first axis may
/// pass the root's axis at a distance; the tip lies in the plane of bending.
#[derive(Clone, Debug)]
pub struct Finger {
    /// Place of the finger's frame in the base frame: z along the first axis, y along the second at angle 0, origin on
    /// the first axis at the height of the second.
    root: IsometryMatrix3<f32>,
    /// Distance of the second axis from the first, along x [m].
    offset: f32,
    /// Lengths of the two links that bend [m].
    lengths: [f32; 2],
    /// Squared distances of the tip from the second joint when the finger is straight and when it is folded [m²].
    straight: f32,
    folded: f32,
    /// Sum and difference of the lengths' squares [m²].
    sum: f32,
    difference: f32,
    /// Direction of the first link at angle 0, from z towards x, and by how much the second is turned from it [rad].
    direction: f32,
    bent: f32,
    /// Whether the third joint turns against the second.
    opposed: bool,
    /// Lower and upper limit of each joint [rad].
    limits: [(f32, f32); 3],
}

/// Joint angles [rad] that bring a fingertip to a place, the nearest first.
pub type FingerSolutions = Vec<[f32; 3], 4>;

/// Why a chain is no [`Finger`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FingerShapeError {
    /// It has another number of joints than three.
    Joints(usize),
    /// The second axis is not at right angles to the first.
    NotAcross,
    /// The third axis is not parallel to the second.
    NotParallel,
    /// Second joint, third joint or tip stand beside the plane through the first axis in which the finger bends.
    NotPlanar,
    /// A link without length.
    NoLength,
    /// A limit is NaN or infinite, or the lower one is above the upper one.
    Limits,
}

/// Why no joint angles bring a fingertip to a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FingerError {
    /// The place is NaN, infinite or more than 1e6 m away, or an angle of where the finger is is NaN or infinite.
    NotFinite,
    /// Too far from the second joint, or too near to it.
    OutOfReach {
        /// The nearest place that would be within reach without limits [m, base frame].
        nearest: Vector3<f32>,
    },
    /// Within reach, but only with this angle of the joint (0 to 2); of all ways to reach it the nearest.
    OutsideLimits {
        /// The joint.
        joint: u8,
        /// Its angle [rad].
        value: f32,
        /// Its limits [rad].
        lower: f32,
        /// See `lower`.
        upper: f32,
    },
}

impl Finger {
    /// The finger that `chain` is, with lower and upper limits of its joints [rad].
    ///
    /// # Errors
    /// What of its shape has no closed form.
    pub fn try_new(chain: &Chain, limits: [(f32, f32); 3]) -> Result<Self, FingerShapeError> {
        if !limits.iter().all(|(lower, upper)| lower.is_finite() && upper.is_finite() && lower <= upper) {
            return Err(FingerShapeError::Limits);
        }
        let posture = chain.posture(&[0.0; 3]);
        let [(axis, first), (across, second), (bend, third)] = posture.joints[..] else {
            return Err(FingerShapeError::Joints(chain.len()));
        };
        let tip = posture.reach;
        let base = chain.links.first().map_or(Vector3::zeros(), |link| link.translation);
        if abs(axis.dot(&across)) > SHAPE_TOLERANCE {
            return Err(FingerShapeError::NotAcross);
        }
        if across.cross(&bend).norm() > SHAPE_TOLERANCE {
            return Err(FingerShapeError::NotParallel);
        }
        let links = [third - second, tip - third];
        let lengths = links.map(|link| link.norm());
        let tolerance = SHAPE_TOLERANCE * (lengths[0] + lengths[1]);
        if lengths.iter().any(|&length| length <= tolerance) {
            return Err(FingerShapeError::NoLength);
        }
        // z × x = y: x is where the finger bends to at angle 0 of the first joint.
        let x = across.cross(&axis).normalize();
        let beside = [second - first, links[0], links[1]].map(|step| abs(step.dot(&across)));
        if beside.iter().any(|&distance| distance > tolerance) {
            return Err(FingerShapeError::NotPlanar);
        }
        let [a, b] = lengths;
        let [direction, other] = links.map(|link| math::atan2(link.dot(&x), link.dot(&axis)));
        let height = axis * (second - first).dot(&axis);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, axis.cross(&x), axis]));
        Ok(Self {
            root: IsometryMatrix3::from_parts(Translation3::from(base + first + height), rotation),
            offset: (second - first).dot(&x),
            lengths,
            straight: (a + b) * (a + b),
            folded: (a - b) * (a - b),
            sum: a * a + b * b,
            difference: a * a - b * b,
            direction,
            bent: other - direction,
            opposed: bend.dot(&across) < 0.0,
            limits,
        })
    }

    /// The joint angles within the limits that bring the tip to `point` [m, base frame], of each way to bend the nearest to
    /// `near` [rad], and of these the nearest first. Where the first joint has no say, on its axis, it keeps the angle that it has in `near`.
    ///
    /// # Errors
    /// Why there are none.
    pub fn inverse(&self, point: &Vector3<f32>, near: &[f32; 3]) -> Result<FingerSolutions, FingerError> {
        let mut found = Vec::<([f32; 3], f32), 4>::new();
        let mut failure = Failure::default();
        if !near.iter().all(|angle| angle.is_finite()) {
            return Err(FingerError::NotFinite);
        }
        let mut near = *near;
        for (near, &(lower, upper)) in near.iter_mut().zip(&self.limits) {
            *near = math::clamp(*near, lower, upper);
        }
        let place = self.place(point, &near)?;
        // The finger bends towards the point, or over its axis.
        let sides = if self.is_off_axis(place.radius * place.radius) { 2 } else { 1 };
        for side in [place, place.across()].into_iter().take(sides) {
            let Some(bends) = self.bends(&side) else {
                failure.out_of_reach(self, &side);
                continue;
            };
            for angles in bends {
                if let Some(fit) = self.fit(angles, &near, &mut failure) {
                    let nearer = found.iter().take_while(|other| other.1 <= fit.1).count();
                    // Cannot fail: two sides have two solutions each.
                    let _ = found.insert(nearer, fit);
                }
            }
        }
        if found.is_empty() {
            return Err(self.why(&failure));
        }
        Ok(found.iter().map(|&(angles, _)| angles).collect())
    }

    /// The first of these.
    ///
    /// # Errors
    /// Why there are none.
    pub fn nearest(&self, point: &Vector3<f32>, near: &[f32; 3]) -> Result<[f32; 3], FingerError> {
        // As a rule the finger bends towards the point and needs no turns, and the other side, where the first joint is
        // half a turn away, is farther.
        let place = self.place(point, near)?;
        if let Some([one, other]) = self.bends(&place) {
            let [swing, second, third] = self.limits;
            let swung = Self::distance(one[0], near[0], swing);
            let bent = |angles: &[f32; 3]| {
                swung + Self::distance(angles[1], near[1], second) + Self::distance(angles[2], near[2], third)
            };
            let (to_one, to_other) = (bent(&one), bent(&other));
            let (angles, distance) = if to_other < to_one { (other, to_other) } else { (one, to_one) };
            let least = PI - abs(angles[0] - near[0]);
            if distance <= least * least && !(to_one + to_other).is_nan() {
                return Ok(angles);
            }
        }
        // There is a first one: none at all is an error.
        self.inverse(point, near).map(|found| found.first().copied().unwrap_or(*near))
    }

    /// Where `point` is for the finger that bends towards it.
    #[inline(always)]
    fn place(&self, point: &Vector3<f32>, near: &[f32; 3]) -> Result<Place, FingerError> {
        let at = self.root.inverse_transform_point(&Point3::from(*point));
        let squared = at.x * at.x + at.y * at.y;
        let radius = math::sqrt(squared);
        // False for NaN, too.
        let there = radius + abs(at.z) < MAX_DISTANCE;
        if !there {
            return Err(FingerError::NotFinite);
        }
        let swing = if self.is_off_axis(squared) { math::atan2(at.y, at.x) } else { near[0] };
        Ok(Place { swing, radius, height: at.z })
    }

    /// Whether the first joint moves a tip at this squared distance from its axis.
    #[inline(always)]
    fn is_off_axis(&self, squared: f32) -> bool {
        squared > ON_AXIS * ON_AXIS * self.straight
    }

    /// Both ways to bend to `place`.
    #[inline(always)]
    fn bends(&self, place: &Place) -> Option<[[f32; 3]; 2]> {
        let (along, height) = (place.radius - self.offset, place.height);
        let squared = along * along + height * height;
        // Heron: accurate for the straight and for the folded finger, too, where a cosine's arc would not be.
        let mut area = (self.straight - squared) * (squared - self.folded);
        if area < 0.0 {
            if !self.nearly_reaches(squared) {
                return None;
            }
            area = 0.0;
        }
        // Both angles' tangents: that between the links, and that by which the first link is turned from the direction of
        // the tip.
        let sine = math::sqrt(area);
        let between = math::atan2(sine, squared - self.sum);
        let lead = math::atan2(sine, squared + self.difference);
        let second = math::atan2(along, height) - self.direction;
        let bent = self.bent;
        let (mut one, mut other) = (between - bent, -between - bent);
        if self.opposed {
            (one, other) = (-one, -other);
        }
        Some([[place.swing, second - lead, one], [place.swing, second + lead, other]])
    }

    /// Whether a point at this squared distance from the second joint is within the tolerance of reach.
    #[cold]
    fn nearly_reaches(&self, squared: f32) -> bool {
        let [a, b] = self.lengths;
        let (distance, tolerance) = (math::sqrt(squared), REACH_TOLERANCE * (a + b));
        distance <= a + b + tolerance && distance >= abs(a - b) - tolerance
    }

    /// Squared distance of a joint's angle from `near`; infinite when it is outside the limits, NaN when a whole turn may
    /// bring it inside or nearer.
    #[inline(always)]
    fn distance(angle: f32, near: f32, (lower, upper): (f32, f32)) -> f32 {
        let away = angle - near;
        if abs(away) > PI || angle < lower || angle > upper {
            let turns = abs(away) > PI
                || angle - TAU >= lower - LIMIT_TOLERANCE
                || angle + TAU <= upper + LIMIT_TOLERANCE
                || angle > lower - LIMIT_TOLERANCE && angle < upper + LIMIT_TOLERANCE;
            return if turns { f32::NAN } else { f32::INFINITY };
        }
        away * away
    }

    /// `angles` with whole turns added so that they are nearest to `near` and within the limits, and their squared
    /// distance from `near`.
    fn fit(&self, mut angles: [f32; 3], near: &[f32; 3], failure: &mut Failure) -> Option<Fit> {
        let (mut distance, mut outside) = (0.0, None);
        for (joint, ((angle, &near), &(lower, upper))) in
            (0..).zip(angles.iter_mut().zip(near).zip(&self.limits))
        {
            let mut value = *angle - TAU * math::round((*angle - near) / TAU);
            if value > upper + LIMIT_TOLERANCE && value - TAU >= lower - LIMIT_TOLERANCE {
                value -= TAU;
            } else if value < lower - LIMIT_TOLERANCE && value + TAU <= upper + LIMIT_TOLERANCE {
                value += TAU;
            }
            distance += (value - near) * (value - near);
            *angle = math::clamp(value, lower, upper);
            if outside.is_none() && abs(*angle - value) > LIMIT_TOLERANCE {
                outside = Some(FingerError::OutsideLimits { joint, value, lower, upper });
            }
        }
        let Some(error) = outside else {
            return Some((angles, distance));
        };
        if failure.outside.is_none_or(|(least, _)| distance < least) {
            failure.outside = Some((distance, error));
        }
        None
    }

    /// The reason in the user's terms.
    fn why(&self, failure: &Failure) -> FingerError {
        if let Some((_, error)) = failure.outside {
            return error;
        }
        let (_, place) = failure.beyond.unwrap_or_default();
        let (sine, cosine) = math::sin_cos(place.swing);
        let nearest = self.root * Point3::new(place.radius * cosine, place.radius * sine, place.height);
        FingerError::OutOfReach { nearest: nearest.coords }
    }
}

/// Angles [rad] and their squared distance from where the finger is.
type Fit = ([f32; 3], f32);

/// A point in the finger's frame: angle about its axis, distance from the axis (negative on the other side), height.
#[derive(Clone, Copy, Default)]
struct Place {
    swing: f32,
    radius: f32,
    height: f32,
}

impl Place {
    /// The same point, for the finger that bends over its axis.
    fn across(self) -> Self {
        Self { swing: self.swing + PI, radius: -self.radius, ..self }
    }
}

/// What stood in the way.
#[derive(Default)]
struct Failure {
    /// The nearest solution outside the limits.
    outside: Option<(f32, FingerError)>,
    /// The gap to the nearest place within reach, and that place.
    beyond: Option<(f32, Place)>,
}

impl Failure {
    fn out_of_reach(&mut self, finger: &Finger, place: &Place) {
        let ([a, b], offset) = (finger.lengths, finger.offset);
        let (along, height) = (place.radius - offset, place.height);
        let distance = math::sqrt(along * along + height * height);
        let reach = if distance > a.max(b) { a + b } else { abs(a - b) };
        let gap = abs(reach - distance);
        if self.beyond.is_some_and(|(least, _)| gap >= least) {
            return;
        }
        let (along, height) =
            if distance > 0.0 { (along * reach / distance, height * reach / distance) } else { (0.0, reach) };
        self.beyond = Some((gap, Place { swing: place.swing, radius: along + offset, height }));
    }
}

impl fmt::Display for FingerShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Joints(joints) => write!(f, "it has {joints} joints, a finger has 3"),
            Self::NotAcross => write!(f, "the axes of joints 1 and 2 are not at right angles"),
            Self::NotParallel => write!(f, "the axes of joints 2 and 3 are not parallel"),
            Self::NotPlanar => write!(f, "joints and tip are not in one plane with the axis of joint 1"),
            Self::Limits => write!(f, "a joint's limits are not a lower and an upper angle"),
            Self::NoLength => write!(f, "two joints, or the last joint and the tip, are at the same place"),
        }
    }
}

impl core::error::Error for FingerShapeError {}

impl fmt::Display for FingerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "place and angles must be finite, the place within 1e6 m"),
            Self::OutOfReach { nearest } => write!(
                f,
                "it does not reach there; without its joints' limits it would reach ({}, {}, {}) m",
                nearest.x, nearest.y, nearest.z
            ),
            Self::OutsideLimits { joint, value, lower, upper } => write!(
                f,
                "joint {joint} of the finger would have to be at {value} rad, outside its limits {lower} to {upper} rad"
            ),
        }
    }
}

impl core::error::Error for FingerError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::{JointModel, Pose, test_joint};

    const FREE: [(f32, f32); 3] = [(-PI, PI); 3];

    /// Joints with these origins and axes, and the tip.
    fn chain(joints: [([f32; 3], [f32; 3]); 3], tip: [f32; 3]) -> Chain {
        let joints = joints.map(|(translation, axis)| JointModel {
            origin: Pose { translation, ..Pose::IDENTITY },
            axis,
            ..test_joint("joint")
        });
        Chain::new(&joints, &Pose { translation: tip, ..Pose::IDENTITY })
    }

    /// Finger 1 of the three-finger hand (Hand3, figure 3), in its root's frame.
    fn hand3() -> Chain {
        chain(
            [
                ([0.0; 3], [0.0, 0.0, 1.0]),
                ([0.0, 0.0, 0.039], [0.0, 1.0, 0.0]),
                ([0.0, 0.0, 0.046], [0.0, 1.0, 0.0]),
            ],
            [0.0, 0.0, 0.05178],
        )
    }

    fn finger(chain: &Chain, limits: [(f32, f32); 3]) -> Finger {
        Finger::try_new(chain, limits).unwrap()
    }

    fn close(a: &[f32; 3], b: &[f32; 3], tolerance: f32) -> bool {
        a.iter().zip(b).all(|(a, b)| abs(a - b) <= tolerance)
    }

    #[test]
    fn the_papers_finger_by_hand() {
        // q = (30°, 20°, 40°): r = 46 sin 20° + 51.78 sin 60° = 60.5756 mm, z = 39 + 46 cos 20° + 51.78 cos 60° = 108.1159.
        let point = Vector3::new(0.052_460_0, 0.030_287_8, 0.108_115_9);
        let finger = finger(&hand3(), FREE);
        let [swing, bend, curl] = [30.0_f32, 20.0, 40.0].map(f32::to_radians);
        // The other way to bend the same side: d = √(60.5756² + 69.1159²) = 91.9044, α = 48.7675°, so the first link stands
        // 90° − α + (90° − α − 20°) = 62.4651° off z, and the second bends back by 40°.
        let (other, back) = (62.465_07_f32.to_radians(), -40.0_f32.to_radians());
        let expected = [
            [swing, bend, curl],
            [swing, other, back],
            [swing - PI, -other, -back],
            [swing - PI, -bend, -curl],
        ];
        let near = [swing, bend, curl];
        let found = finger.inverse(&point, &near).unwrap();
        assert_eq!(found.len(), 4);
        for expected in &expected {
            assert!(
                found.iter().any(|angles| close(angles, expected, 2e-5)),
                "{expected:?} not in {found:?}"
            );
        }
        assert!(close(&found[0], &near, 2e-5));
        assert!(close(&finger.nearest(&point, &expected[2]).unwrap(), &expected[2], 2e-5));
    }

    #[test]
    fn limits_choose_the_branch_and_name_the_joint() {
        let chain = hand3();
        let point = chain.posture(&[0.2, 0.5, 0.8]).tip.translation.vector;
        let curls = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (0.0, 2.4)]);
        let found = curls.inverse(&point, &[0.0, 1.5, -0.8]).unwrap();
        assert!(found.len() == 1 && close(&found[0], &[0.2, 0.5, 0.8], 1e-5), "{found:?}");
        let backwards = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (-2.4, 0.0)]);
        assert!(close(&backwards.nearest(&point, &[0.0; 3]).unwrap(), &[0.2, 1.349_97, -0.8], 1e-3));
        let narrow = finger(&chain, [(-1.0, 1.0), (-1.2, 0.4), (0.0, 2.4)]);
        let Err(FingerError::OutsideLimits { joint, value, lower, upper }) =
            narrow.nearest(&point, &[0.2, 0.4, 0.8])
        else {
            panic!()
        };
        assert!(abs(value - 0.5) < 1e-5, "{value} of {joint}");
        assert_eq!((joint, lower, upper), (1, -1.2, 0.4));
    }

    #[test]
    fn what_is_out_of_reach_has_a_nearest_place() {
        let finger = finger(&hand3(), FREE);
        let error = |x, y, z| finger.nearest(&Vector3::new(x, y, z), &[0.0; 3]).unwrap_err();
        // Straight out at the height of the second joint: 46 + 51.78 = 97.78 mm.
        let FingerError::OutOfReach { nearest } = error(0.0, -0.2, 0.039) else { panic!() };
        assert!((nearest - Vector3::new(0.0, -0.097_78, 0.039)).norm() < 1e-7, "{nearest}");
        // Nearer to the second joint than the difference of the links, 5.78 mm.
        let FingerError::OutOfReach { nearest } = error(0.001, 0.0, 0.039) else { panic!() };
        assert!((nearest - Vector3::new(0.005_78, 0.0, 0.039)).norm() < 1e-7, "{nearest}");
        assert_eq!(error(f32::NAN, 0.0, 0.0), FingerError::NotFinite);
        assert_eq!(error(0.0, f32::INFINITY, 0.0), FingerError::NotFinite);
    }

    #[test]
    fn the_straight_finger_and_its_axis_are_within_reach() {
        let chain = hand3();
        let finger = finger(&chain, FREE);
        let up = Vector3::new(0.0, 0.0, 0.136_78);
        let found = finger.nearest(&up, &[0.7, 0.1, 0.1]).unwrap();
        assert!(close(&found, &[0.7, 0.0, 0.0], 1e-3), "{found:?}");
        let on_axis = chain.posture(&[-0.4, -0.5, 0.939_966]).tip.translation.vector;
        assert!(on_axis.xy().norm() < 2e-5);
        let found = finger.nearest(&Vector3::new(0.0, 0.0, on_axis.z), &[-0.4, -0.5, 0.9]).unwrap();
        assert!(close(&found, &[-0.4, -0.5, 0.939_966], 1e-3), "{found:?}");
    }

    #[test]
    fn where_the_finger_is_need_not_be_within_its_limits() {
        let chain = hand3();
        let finger = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (-0.1, 2.4)]);
        let point = chain.posture(&[0.2, 0.5, 0.8]).tip.translation.vector;
        for near in [[1.000_02, 0.5, 0.8], [10.0, 0.0, 0.0], [0.0, 30.0, -7.0]] {
            assert!(close(&finger.nearest(&point, &near).unwrap(), &[0.2, 0.5, 0.8], 1e-5), "{near:?}");
        }
        assert_eq!(finger.nearest(&point, &[f32::NAN, 0.0, 0.0]), Err(FingerError::NotFinite));
        // On its axis any angle of the first joint will do, so its limit is no obstacle.
        let on_axis = Vector3::new(0.0, 0.0, 0.1);
        let found = finger.inverse(&on_axis, &[1.000_02, -0.5, 0.9]).unwrap();
        assert!(found.iter().all(|angles| abs(angles[0] - 1.0) < 1e-9), "{found:?}");
        assert_eq!(Finger::try_new(&chain, [(1.0, -1.0); 3]).unwrap_err(), FingerShapeError::Limits);
    }

    #[test]
    fn nearly_equal_links_do_not_reach_where_they_fold() {
        let z = [0.0, 0.0, 1.0];
        let y = [0.0, 1.0, 0.0];
        let chain = chain([([0.0; 3], z), ([0.0; 3], y), ([0.0, 0.0, 0.500_4], y)], [0.0, 0.0, 0.499_6]);
        let Err(FingerError::OutOfReach { nearest }) =
            finger(&chain, FREE).nearest(&Vector3::new(0.0, 0.0, 1e-5), &[0.0, 0.0, 3.0])
        else {
            panic!()
        };
        assert!((nearest - Vector3::new(0.0, 0.0, 8e-4)).norm() < 1e-6, "{nearest}");
    }

    #[test]
    fn other_shapes_are_told_what_is_wrong_with_them() {
        let z = [0.0, 0.0, 1.0];
        let y = [0.0, 1.0, 0.0];
        let up = [0.0, 0.0, 0.04];
        let refused = |joints, tip| Finger::try_new(&chain(joints, tip), FREE).unwrap_err();
        assert_eq!(refused([(up, z), (up, [0.0, 0.6, 0.8]), (up, y)], up), FingerShapeError::NotAcross);
        assert_eq!(refused([(up, z), (up, y), (up, [1.0, 0.0, 0.0])], up), FingerShapeError::NotParallel);
        assert_eq!(refused([(up, z), (up, y), (up, y)], [0.0, 0.001, 0.04]), FingerShapeError::NotPlanar);
        assert_eq!(refused([(up, z), ([0.0, 0.01, 0.0], y), (up, y)], up), FingerShapeError::NotPlanar);
        assert_eq!(refused([(up, z), (up, y), ([0.0; 3], y)], up), FingerShapeError::NoLength);
        let short = Chain::new(&[test_joint("joint")], &Pose::IDENTITY);
        assert_eq!(Finger::try_new(&short, FREE).unwrap_err(), FingerShapeError::Joints(1));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        /// Any shape with a closed form, whatever its size, frames, zero angles and directions, anywhere within reach:
        /// the angles that made the point are among the solutions, and every solution leads to the point.
        #[test]
        fn forward_and_inverse_belong_together(
            size in 0.01_f32..2.0,
            height in -0.5_f32..1.0,
            offset in prop_oneof![Just(0.0), -0.4_f32..0.4],
            links in [[-1.0_f32..1.0, -1.0_f32..1.0], [-1.0_f32..1.0, -1.0_f32..1.0]],
            (reversed, opposed) in (any::<bool>(), any::<bool>()),
            q in [-3.1_f32..3.1, -3.1_f32..3.1, -3.1_f32..3.1],
            near in [-3.1_f32..3.1, -3.1_f32..3.1, -3.1_f32..3.1],
        ) {
            let [first, second] = links.map(|[x, z]| [size * x, 0.0, size * z]);
            prop_assume!(links.iter().all(|[x, z]| x * x + z * z > 0.04));
            let across = |reversed: bool| [0.0, if reversed { -1.0 } else { 1.0 }, 0.0];
            let chain = chain(
                [
                    ([size, -0.3 * size, 0.2], [0.0, 0.0, 1.0]),
                    ([offset * size, 0.0, height * size], across(reversed)),
                    (first, across(reversed ^ opposed)),
                ],
                second,
            );
            let finger = finger(&chain, FREE);
            let tip = |q: &[f32]| chain.posture(q).tip.translation.vector;
            let point = tip(&q);
            let found = finger.inverse(&point, &near).unwrap();
            for angles in &found {
                let miss = (tip(angles) - point).norm();
                // Some angles were just outside their limits.
                let tolerance = if angles.iter().any(|&angle| abs(angle) >= PI) { 4e-5 } else { 1e-5 };
                prop_assert!(miss < tolerance * size, "{miss} m at {angles:?}");
            }
            // Near the axis and the straight finger many angles lead to almost the same point.
            let radius = finger.root.inverse_transform_point(&Point3::from(point)).coords.xy().norm();
            let bent = q[2] * if opposed { -1.0 } else { 1.0 } + finger.bent;
            if radius > 0.05 * size && abs(libm::sinf(bent)) > 0.05 {
                prop_assert!(found.iter().any(|angles| close(angles, &q, 1e-3)), "{q:?} not in {found:?}");
                let nearest = finger.nearest(&point, &near).unwrap();
                let distance = |a: &[f32; 3]| a.iter().zip(&near).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
                let least = found.iter().map(distance).fold(f32::INFINITY, f32::min);
                prop_assert!(abs(distance(&nearest) - least) < 1e-3 * (1.0 + least), "{nearest:?} of {found:?}");
            }
        }
    }
}
