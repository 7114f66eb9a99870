use core::f32::consts::{PI, TAU};
use core::fmt;

use heapless::Vec;
use nalgebra::{IsometryMatrix3, Matrix3, Point3, Rotation3, Translation3, Vector3};

use super::Chain;
use super::inverse::MAX_DISTANCE;
use crate::collect::collect;
use crate::math::{self, abs};

/// Tolerance of the geometry check over the finger's length; solutions may have errors of this size.
const SHAPE_TOLERANCE: f32 = 1e-4;
/// Distance from the first axis over the finger's length below which the first joint is singular.
const ON_AXIS: f32 = 1e-6;
/// Points beyond reach by less than this fraction of the finger's length get the solution of the straight
/// finger.
const REACH_TOLERANCE: f32 = 1e-6;
/// Solutions outside a limit by less than this are moved to it [rad].
const LIMIT_TOLERANCE: f32 = 1e-5;

/// A three-joint finger with closed-form inverse kinematics (Hand3 section 2): joint 1 rotates about the root
/// axis, joints 2 and 3 have parallel axes at right angles to it.
///
/// The geometry is recognised from the chain, for any frames, zero angles and directions. The axis of joint 2
/// may have an offset from that of joint 1; the tip lies in the plane of flexion.
#[derive(Clone, Debug)]
pub struct Finger {
    /// The finger's frame in the base frame: z along the first axis, y along the second at angle 0, origin on
    /// the first axis at the height of the second.
    root: IsometryMatrix3<f32>,
    /// Distance of the second axis from the first, along x [m].
    offset: f32,
    /// Lengths of the two links that bend [m].
    lengths: [f32; 2],
    /// Squared distances of the tip from the second joint with the finger straight and folded [m²].
    straight: f32,
    folded: f32,
    /// Sum and difference of the lengths' squares [m²].
    sum: f32,
    difference: f32,
    /// Direction of the first link at angle 0, from z towards x, and angle of the second link from it [rad].
    direction: f32,
    bent: f32,
    /// Whether the third axis is opposite to the second.
    opposed: bool,
    /// Lower and upper limit of each joint [rad].
    limits: [(f32, f32); 3],
}

/// Joint angles [rad] that bring the fingertip to a point, sorted by distance from the given angles.
pub type FingerSolutions = Vec<[f32; 3], 4>;

/// Why a chain has no closed-form inverse as a [`Finger`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FingerShapeError {
    /// The number of joints is not three.
    Joints(usize),
    /// The second axis is not at right angles to the first.
    NotAcross,
    /// The third axis is not parallel to the second.
    NotParallel,
    /// Second joint, third joint or tip are outside the plane of flexion through the first axis.
    NotPlanar,
    /// A link without length.
    NoLength,
    /// A limit is NaN or infinite, or the lower one is above the upper one.
    Limits,
}

/// Why the inverse kinematics of a [`Finger`] has no solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FingerError {
    /// The point is NaN, infinite or more than 1e6 m away, or a present angle is NaN or infinite.
    NotFinite,
    /// Too far from the second joint, or too near to it.
    OutOfReach {
        /// The nearest point within reach without joint limits [m, base frame].
        nearest: Vector3<f32>,
    },
    /// Within reach, but only with an angle outside the limits of a joint (0 to 2); the solution nearest to
    /// the present angles is reported.
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
    /// Recognises `chain` as a finger, with lower and upper limits of its joints [rad].
    ///
    /// # Errors
    /// The property of the chain that rules out the closed form.
    pub fn try_new(chain: &Chain, limits: [(f32, f32); 3]) -> Result<Self, FingerShapeError> {
        if !limits.iter().all(|(lower, upper)| lower.is_finite() && upper.is_finite() && lower <= upper) {
            return Err(FingerShapeError::Limits);
        }
        let posture = chain.posture(&[0.0; 3]);
        let [(axis, first), (across, second), (bend, third)] = posture.joints[..] else {
            return Err(FingerShapeError::Joints(chain.len()));
        };
        let tip = posture.reach;
        let base = chain.base();
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
        // z × x = y: x is the direction of flexion at angle 0 of the first joint.
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

    /// Whether `angles` [rad] are within the limits of the joints.
    pub fn is_within_limits(&self, angles: &[f32; 3]) -> bool {
        angles.iter().zip(&self.limits).all(|(angle, (lower, upper))| (*lower..=*upper).contains(angle))
    }

    /// All solutions within the limits for the tip at `point` [m, base frame]: of each branch the one nearest
    /// to `near` [rad], sorted by distance. On the axis of joint 1, where it is singular, it keeps its angle
    /// in `near`.
    ///
    /// # Errors
    /// The reason if there is no solution.
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
        // Two sides: flexion towards the point, or over the axis.
        let sides = if self.is_off_axis(place.radius * place.radius) { 2 } else { 1 };
        for side in [place, place.across()].into_iter().take(sides) {
            let Some(bends) = self.bends(&side) else {
                failure.out_of_reach(self, &side);
                continue;
            };
            for angles in bends {
                if let Some(fit) = self.fit(angles, &near, &mut failure) {
                    let nearer = found.iter().take_while(|other| other.1 <= fit.1).count();
                    // There is room: two sides have two solutions each.
                    if nearer <= found.len() {
                        let _ = found.insert(nearer, fit);
                    }
                }
            }
        }
        if found.is_empty() {
            return Err(self.why(&failure));
        }
        Ok(collect(found.iter().map(|&(angles, _)| angles)))
    }

    /// The solution nearest to `near` [rad]: the first of [`Finger::inverse`], usually at a third of its
    /// cost.
    ///
    /// # Errors
    /// The reason if there is no solution.
    pub fn nearest(&self, point: &Vector3<f32>, near: &[f32; 3]) -> Result<[f32; 3], FingerError> {
        // Fast path: usually the finger bends towards the point without whole turns, and the other side, with
        // joint 1 half a turn away, is farther.
        let place = self.place(point, near)?;
        if let Some([one, other]) = self.bends(&place) {
            let [swing, second, third] = self.limits;
            let swung = Self::distance(one[0], near[0], swing);
            let bent = |angles: &[f32; 3]| {
                swung + Self::distance(angles[1], near[1], second) + Self::distance(angles[2], near[2], third)
            };
            let (to_one, to_other) = (bent(&one), bent(&other));
            let (angles, distance) = if to_other < to_one { (other, to_other) } else { (one, to_one) };
            let half_turn_distance = PI - abs(angles[0] - near[0]);
            if distance <= half_turn_distance * half_turn_distance && !(to_one + to_other).is_nan() {
                return Ok(angles);
            }
        }
        // There is a first one: no solution is an error.
        self.inverse(point, near).map(|found| found.first().copied().unwrap_or(*near))
    }

    /// `point` in cylindrical coordinates of the root, on the side towards which the finger bends.
    #[inline(always)]
    fn place(&self, point: &Vector3<f32>, near: &[f32; 3]) -> Result<Place, FingerError> {
        let at = self.root.inverse_transform_point(&Point3::from(*point));
        let squared = at.x * at.x + at.y * at.y;
        let radius = math::inlined_sqrt(squared);
        // False for NaN, too.
        let there = radius + abs(at.z) < MAX_DISTANCE;
        if !there {
            return Err(FingerError::NotFinite);
        }
        let swing = if self.is_off_axis(squared) { math::inlined_atan2(at.y, at.x) } else { near[0] };
        Ok(Place { swing, radius, height: at.z })
    }

    /// Whether the first joint moves a tip at this squared distance from its axis.
    #[inline(always)]
    fn is_off_axis(&self, squared: f32) -> bool {
        squared > ON_AXIS * ON_AXIS * self.straight
    }

    /// Both flexion branches for `place`.
    #[inline(always)]
    fn bends(&self, place: &Place) -> Option<[[f32; 3]; 2]> {
        let (along, height) = (place.radius - self.offset, place.height);
        let squared = along * along + height * height;
        // Heron's formula: accurate also for the straight and the folded finger, unlike the arc cosine.
        let mut area = (self.straight - squared) * (squared - self.folded);
        if area < 0.0 {
            if !self.nearly_reaches(squared) {
                return None;
            }
            area = 0.0;
        }
        // The angle between the links, and that of the first link from the direction of the tip, by their
        // tangents.
        let sine = math::inlined_sqrt(area);
        let between = math::inlined_atan2(sine, squared - self.sum);
        let lead = math::inlined_atan2(sine, squared + self.difference);
        let second = math::inlined_atan2(along, height) - self.direction;
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
        let (distance, tolerance) = (math::inlined_sqrt(squared), REACH_TOLERANCE * (a + b));
        distance <= a + b + tolerance && distance >= abs(a - b) - tolerance
    }

    /// Squared distance of a joint's angle from `near`; infinite if it is outside the limits, NaN if a whole
    /// turn may bring it inside or nearer.
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

    /// `angles` with whole turns added so that they are nearest to `near` and within the limits, and their
    /// squared distance from `near`.
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
        if failure.outside.is_none_or(|(best, _)| distance < best) {
            failure.outside = Some((distance, error));
        }
        None
    }

    /// The error to report when no branch has a solution.
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

/// Joint angles [rad] and their squared distance from `near`.
type Fit = ([f32; 3], f32);

/// Cylindrical coordinates in the root frame: azimuth, radius (negative on the other side), height.
#[derive(Clone, Copy, Default)]
struct Place {
    swing: f32,
    radius: f32,
    height: f32,
}

impl Place {
    /// The same point for a finger that bends over its axis.
    fn across(self) -> Self {
        Self { swing: self.swing + PI, radius: -self.radius, ..self }
    }
}

/// Why the branches tried so far have no solution.
#[derive(Default)]
struct Failure {
    /// The nearest solution outside the limits.
    outside: Option<(f32, FingerError)>,
    /// The gap to the nearest point within reach, and that point.
    beyond: Option<(f32, Place)>,
}

impl Failure {
    fn out_of_reach(&mut self, finger: &Finger, place: &Place) {
        let ([a, b], offset) = (finger.lengths, finger.offset);
        let (along, height) = (place.radius - offset, place.height);
        let distance = math::sqrt(along * along + height * height);
        let reach = if distance > a.max(b) { a + b } else { abs(a - b) };
        let gap = abs(reach - distance);
        if self.beyond.is_some_and(|(smallest, _)| gap >= smallest) {
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
            Self::Joints(joints) => write!(f, "the chain has {joints} joints; a finger has 3"),
            Self::NotAcross => write!(f, "the axes of joints 1 and 2 are not at right angles"),
            Self::NotParallel => write!(f, "the axes of joints 2 and 3 are not parallel"),
            Self::NotPlanar => write!(f, "joints and tip are not in one plane with the axis of joint 1"),
            Self::Limits => {
                write!(f, "each joint needs finite limits, the lower one not above the upper one")
            }
            Self::NoLength => {
                write!(f, "a link has no length: two joints, or the last joint and the tip, coincide")
            }
        }
    }
}

impl core::error::Error for FingerShapeError {}

impl fmt::Display for FingerError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "point and angles must be finite, the point within 1e6 m"),
            Self::OutOfReach { nearest } => write!(
                f,
                "it does not reach there; without its joints' limits it would reach ({}, {}, {}) m",
                nearest.x, nearest.y, nearest.z
            ),
            Self::OutsideLimits { joint, value, lower, upper } => write!(
                f,
                "joint {} of the finger would have to be at {value} rad, outside its limits {lower} to {upper} rad",
                joint + 1
            ),
        }
    }
}

impl core::error::Error for FingerError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
#[path = "finger_tests.rs"]
mod tests;
