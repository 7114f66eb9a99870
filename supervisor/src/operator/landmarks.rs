//! The 21 landmarks of a hand that webcam trackers find, in the order of MediaPipe: 0 is the wrist; 1–4 are
//! the thumb from its root to its tip, 5–8 the index finger, 9–12 the middle finger, 13–16 the ring finger,
//! 17–20 the little finger, each from the knuckle to the tip.

use nalgebra::Vector3;
use tesaki::teleop::{HUMAN_FINGERS, HumanFinger};
use tesaki_description::retargeting::Side;

use super::error::FrameError;
use super::fingertips::{Tip, check_order, check_size};
use super::palm::{PalmFrame, thumbward};

/// Number of landmarks.
pub const LANDMARKS: usize = 21;

/// Mean distances between successive landmarks of each finger [m] (Buryanov and Kotiuk 2010, as in
/// `tesaki::teleop`).
const BONES: [[f32; 3]; HUMAN_FINGERS] = [
    [0.0462, 0.0316, 0.0273],
    [0.0398, 0.0224, 0.0197],
    [0.0446, 0.0263, 0.0214],
    [0.0414, 0.0257, 0.0213],
    [0.0327, 0.0181, 0.0197],
];
/// Limits of a bone's length relative to the mean in a hand of this size. MediaPipe shortens bones that point
/// to the camera to as little as 0.4 of their length.
const BONE_RATIO: [f32; 2] = [0.2, 2.5];
/// Largest distance by which a knuckle may be on the thumb's side of the previous one [m].
const KNUCKLE_ORDER: f32 = 0.0;
/// Sum of the sines of the bending angles of the four fingers' outer joints, eight in all, above which they
/// determine the side: fingers hardly bend backwards.
const CLEAR_BEND: f32 = 1.0;

/// A frame of a webcam tracker, in any right-handed coordinates in metres. (MediaPipe's world landmarks have
/// x to the right of the picture, y down, and z away from the camera.)
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmarks {
    /// Positions [m].
    pub points: [[f32; 3]; LANDMARKS],
    /// The side of the hand, if the source states it.
    pub handedness: Option<Side>,
}

impl Landmarks {
    /// Returns the fingertips in the frame of the hand, which is on this `side`.
    pub(super) fn fingertips(&self, side: Side) -> Result<[Option<Tip>; HUMAN_FINGERS], FrameError> {
        if let Some(index) = self.points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
            return Err(FrameError::NotFinite(format!("landmark {index}")));
        }
        let within = |x: &f32| *x > 0.0 && *x < 1.0;
        if self.points.iter().all(|[x, y, _]| within(x) && within(y)) && self.points[0][2].abs() < 1e-4 {
            return Err(FrameError::Normalised);
        }
        let point = |index: usize| Vector3::from(self.points[index]);
        let palm = [Some(0), None, Some(5), Some(9), Some(13), Some(17)].map(|index| index.map(point));
        let palm = PalmFrame::fit(side, &palm).ok_or(FrameError::Flat)?;
        check_size(palm.size)?;
        // The fit determines the side of each knuckle as long as no two of them are swapped.
        let knuckles = [None, Some(5), Some(9), Some(13), Some(17)]
            .map(|index| index.map(|index: usize| thumbward(side, palm.position(&point(index)).y)));
        check_order(&knuckles, "knuckle", KNUCKLE_ORDER)?;
        for (finger, lengths) in BONES.iter().enumerate() {
            for (bone, mean) in lengths.iter().enumerate() {
                let from = 1 + 4 * finger + bone;
                let length = (point(from + 1) - point(from)).norm();
                let [min, max] = BONE_RATIO.map(|ratio| ratio * palm.size * mean);
                if !(min..=max).contains(&length) {
                    return Err(FrameError::Bone { from, to: from + 1, length, min, max });
                }
            }
        }
        let seen = self.bends_like();
        match (seen, self.handedness) {
            (_, Some(label)) if label != side => {
                return Err(FrameError::Label { label, bends_otherwise: seen == Some(side) });
            }
            (Some(seen), _) if seen != side => return Err(FrameError::OtherHand(seen)),
            _ => {}
        }
        Ok(HumanFinger::ALL.map(|finger| {
            let tip = point(4 + 4 * finger as usize);
            let last = palm.vector(&(tip - point(3 + 4 * finger as usize)));
            Some(Tip { position: palm.position(&tip), direction: Some(last.normalize()) })
        }))
    }

    /// Returns the side of the hand whose fingers bend this way, if they bend clearly. A joint that bends
    /// towards the palm turns its bone about an axis that points to the thumb on a right hand, and to the
    /// little finger on a left one.
    fn bends_like(&self) -> Option<Side> {
        let point = |index: usize| Vector3::from(self.points[index]);
        let bone = |from: usize| (point(from + 1) - point(from)).normalize();
        let thumbward = (point(5) - point(17)).normalize();
        let knuckles = [5, 9, 13, 17].into_iter();
        let joints = knuckles.flat_map(|knuckle| [(knuckle, knuckle + 1), (knuckle + 1, knuckle + 2)]);
        let bend: f32 = joints.map(|(one, next)| bone(one).cross(&bone(next)).dot(&thumbward)).sum();
        match bend {
            bend if bend > CLEAR_BEND => Some(Side::Right),
            bend if bend < -CLEAR_BEND => Some(Side::Left),
            _ => None,
        }
    }
}
