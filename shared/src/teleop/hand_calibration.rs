use nalgebra::Matrix3;

use super::anatomy::infer_links;
use super::calibration::{
    CalibrationAccuracy, CalibrationSettings, FingerCalibration, TYPICAL_LINKS, add_equations, check_marker,
};
use super::calibration_error::CalibrationError;
use super::human_hand::{FINGERS, Finger, FingerLinks, FingerRotations, GloveSample};
use crate::math::{self, IncrementalQr};

/// Poses from which residuals tell whether markers are swapped: as many equations again as unknowns.
const MIN_POSES_OF_SWAP: u32 = 8;
/// A finger's residual that is this much larger than with another finger's marker means that they are
/// swapped.
const SWAP_RATIO: f32 = 2.0;

/// Calibration of a hand: each finger, and whether markers are swapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandCalibration {
    fingers: [FingerCalibration; FINGERS],
    /// Equations of a finger's orientations with each finger's marker, for poses that show all markers.
    crossed: [[IncrementalQr<12>; FINGERS]; FINGERS],
    complete_poses: u32,
}

impl HandCalibration {
    /// No pose yet.
    ///
    /// # Errors
    /// A setting outside its limits.
    pub fn try_new(settings: &CalibrationSettings) -> Result<Self, CalibrationError> {
        settings.check()?;
        Ok(Self {
            fingers: Finger::ALL.map(|finger| FingerCalibration::new(finger, settings)),
            crossed: [[IncrementalQr::new(); FINGERS]; FINGERS],
            complete_poses: 0,
        })
    }

    /// Adds a pose: orientations, and the markers that are seen, in the frame of the back of the hand [m].
    /// The first pose is the flat hand.
    ///
    /// # Errors
    /// An orientation of a finger whose marker is seen, or a marker, that cannot be used. Nothing is added.
    pub fn add_pose(
        &mut self,
        sample: &GloveSample,
        markers: &[Option<[f32; 3]>; FINGERS],
    ) -> Result<(), CalibrationError> {
        let mut rotations = [None; FINGERS];
        for ((finger, marker), rotations) in Finger::ALL.into_iter().zip(markers).zip(&mut rotations) {
            if let Some(tip) = marker {
                check_marker(finger, *tip)?;
                *rotations = Some(FingerRotations::of(sample, finger)?);
            }
        }
        for ((finger, rotations), marker) in self.fingers.iter_mut().zip(&rotations).zip(markers) {
            if let (Some(rotations), Some(tip)) = (rotations, marker) {
                finger.add_pose(rotations, *tip)?;
            }
        }
        if rotations.iter().all(Option::is_some) {
            self.complete_poses = self.complete_poses.saturating_add(1);
            for (crossed, rotations) in self.crossed.iter_mut().zip(rotations.iter().flatten()) {
                for (equations, tip) in crossed.iter_mut().zip(markers.iter().flatten()) {
                    add_equations(equations, rotations, *tip, 1.0);
                }
            }
        }
        Ok(())
    }

    /// Adds a posture in which the tip of the thumb, which is calibrated, touches that of a finger, within a
    /// standard deviation along each axis [m]. For fingers without marker.
    ///
    /// # Errors
    /// A thumb that is not calibrated yet, or orientations that cannot be used. Nothing is added.
    pub fn add_touch(
        &mut self,
        finger: Finger,
        sample: &GloveSample,
        deviation: f32,
    ) -> Result<(), CalibrationError> {
        let (links, _) = self.finger(Finger::Thumb).solve()?;
        let place = links.tip(&FingerRotations::of(sample, Finger::Thumb)?);
        self.finger_mut(finger).add_contact(&FingerRotations::of(sample, finger)?, place, deviation)
    }

    /// One finger.
    pub const fn finger(&self, finger: Finger) -> &FingerCalibration {
        &self.fingers[finger as usize]
    }

    /// One finger, to add a prior or a pose of its own.
    pub const fn finger_mut(&mut self, finger: Finger) -> &mut FingerCalibration {
        &mut self.fingers[finger as usize]
    }

    /// Refuses markers that are on other fingers than their columns say.
    ///
    /// # Errors
    /// The residual of a finger's orientations is twice as large with its own marker as with another's, and
    /// larger than noise.
    pub fn check_markers(&self) -> Result<(), CalibrationError> {
        if self.complete_poses < MIN_POSES_OF_SWAP {
            return Ok(());
        }
        #[expect(clippy::cast_precision_loss, reason = "a count of poses")]
        let freedom = 3.0 * self.complete_poses as f32 - 12.0;
        for (finger, crossed) in Finger::ALL.into_iter().zip(&self.crossed) {
            let deviation = |equations: &IncrementalQr<12>| math::sqrt(equations.residual() / freedom);
            let own = deviation(&crossed[finger as usize]);
            let noise = self.finger(finger).settings.equation_deviation(&TYPICAL_LINKS);
            let best =
                Finger::ALL.into_iter().zip(crossed).fold((finger, own), |best, (other, equations)| {
                    if deviation(equations) < best.1 { (other, deviation(equations)) } else { best }
                });
            if own > SWAP_RATIO * best.1 && own > SWAP_RATIO * noise {
                return Err(CalibrationError::Swapped { finger, marker_of: best.0, own, other: best.1 });
            }
        }
        Ok(())
    }

    /// Links and accuracy of all fingers.
    ///
    /// # Errors
    /// Swapped markers; else that of the first finger that is not calibrated.
    pub fn solve(&self) -> Result<[(FingerLinks, CalibrationAccuracy); FINGERS], CalibrationError> {
        self.check_markers()?;
        let [thumb, index, middle, ring, little] = &self.fingers;
        Ok([thumb.solve()?, index.solve()?, middle.solve()?, ring.solve()?, little.solve()?])
    }

    /// Links and accuracy of all fingers with the proportions of the hand for those without markers, or whose
    /// poses lack a movement. The accuracy of these is that of the proportions: its rank is 12, and its
    /// deviation may exceed 2 mm. The thumb needs its marker, and two other fingers theirs. `flat`: the
    /// orientations of the flat hand.
    ///
    /// # Errors
    /// Swapped markers; a marked finger whose residual is no noise; fewer calibrated fingers than needed.
    pub fn solve_with_proportions(
        &self,
        flat: &GloveSample,
    ) -> Result<[(FingerLinks, CalibrationAccuracy); FINGERS], CalibrationError> {
        self.check_markers()?;
        let thumb = self.finger(Finger::Thumb).solve()?;
        let (mut solved, mut refused) = ([None; FINGERS], None);
        for (solved, finger) in solved.iter_mut().zip(&self.fingers) {
            *solved = match finger.solve() {
                Ok(calibrated) => Some(calibrated),
                Err(error @ CalibrationError::Residual { .. }) => return Err(error),
                Err(error) => {
                    if finger.poses() > 0 {
                        refused.get_or_insert(error);
                    }
                    None
                }
            };
        }
        let mut rotations = [FingerRotations([Matrix3::identity(); 3]); FINGERS];
        for (rotations, finger) in rotations.iter_mut().zip(Finger::ALL) {
            *rotations = FingerRotations::of(flat, finger)?;
        }
        let priors = infer_links(&solved.map(|solved| solved.map(|(links, _)| links)), &rotations)
            .map_err(|error| refused.unwrap_or(error))?;
        let mut all = [thumb; FINGERS];
        for (number, all) in all.iter_mut().enumerate() {
            let mut finger = self.fingers[number];
            *all = match solved[number] {
                Some(calibrated) => calibrated,
                None => {
                    finger.add_prior(&priors[number])?;
                    finger.joints.first.get_or_insert(rotations[number].joints());
                    finger.estimate()?
                }
            };
        }
        Ok(all)
    }
}
