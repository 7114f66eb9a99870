use nalgebra::Matrix3;

use super::anatomy::infer_links;
use super::calibration::{
    CalibrationAccuracy, CalibrationSettings, FingerCalibration, TYPICAL_LINKS, add_equations, check_marker,
};
use super::calibration_error::CalibrationError;
use super::human_hand::{FingerLinks, FingerRotations, GloveSample, HUMAN_FINGERS, HumanFinger};
use crate::math::{self, IncrementalQr};

/// Minimum number of postures for the detection of swapped markers: twice as many equations as unknowns.
const MIN_POSTURES_OF_SWAP: u32 = 8;
/// Markers count as swapped if a finger's residual is larger by this factor than with another finger's
/// marker.
const SWAP_RATIO: f32 = 2.0;

/// Calibration of a hand: all fingers, and the detection of swapped markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandCalibration {
    fingers: [FingerCalibration; HUMAN_FINGERS],
    /// Equations of a finger's orientations with each finger's marker, for postures that show all markers.
    crossed: [[IncrementalQr<12>; HUMAN_FINGERS]; HUMAN_FINGERS],
    complete_postures: u32,
}

impl HandCalibration {
    /// A calibration without postures.
    ///
    /// # Errors
    /// A setting outside its limits.
    pub fn try_new(settings: &CalibrationSettings) -> Result<Self, CalibrationError> {
        settings.check()?;
        Ok(Self {
            fingers: HumanFinger::ALL.map(|finger| FingerCalibration::new(finger, settings)),
            crossed: [[IncrementalQr::new(); HUMAN_FINGERS]; HUMAN_FINGERS],
            complete_postures: 0,
        })
    }

    /// Adds a posture: orientations, and the visible markers in the frame of the back of the hand [m]. The
    /// first posture is the flat hand.
    ///
    /// # Errors
    /// An invalid orientation of a finger with a visible marker, or an invalid marker. Nothing is added.
    pub fn add_posture(
        &mut self,
        sample: &GloveSample,
        markers: &[Option<[f32; 3]>; HUMAN_FINGERS],
    ) -> Result<(), CalibrationError> {
        let mut rotations = [None; HUMAN_FINGERS];
        for ((finger, marker), rotations) in HumanFinger::ALL.into_iter().zip(markers).zip(&mut rotations) {
            if let Some(tip) = marker {
                check_marker(finger, *tip)?;
                *rotations = Some(FingerRotations::of(sample, finger)?);
            }
        }
        for ((finger, rotations), marker) in self.fingers.iter_mut().zip(&rotations).zip(markers) {
            if let (Some(rotations), Some(tip)) = (rotations, marker) {
                finger.add_posture(rotations, *tip)?;
            }
        }
        if rotations.iter().all(Option::is_some) {
            self.complete_postures = self.complete_postures.saturating_add(1);
            for (crossed, rotations) in self.crossed.iter_mut().zip(rotations.iter().flatten()) {
                for (equations, tip) in crossed.iter_mut().zip(markers.iter().flatten()) {
                    add_equations(equations, rotations, *tip, 1.0);
                }
            }
        }
        Ok(())
    }

    /// Adds a posture in which the tip of the calibrated thumb touches that of a finger without marker, with
    /// a standard deviation along each axis [m].
    ///
    /// # Errors
    /// The thumb is not calibrated yet, or orientations are invalid. Nothing is added.
    pub fn add_touch(
        &mut self,
        finger: HumanFinger,
        sample: &GloveSample,
        deviation: f32,
    ) -> Result<(), CalibrationError> {
        let (links, _) = self.finger(HumanFinger::Thumb).solve()?;
        let place = links.tip(&FingerRotations::of(sample, HumanFinger::Thumb)?);
        self.finger_mut(finger).add_contact(&FingerRotations::of(sample, finger)?, place, deviation)
    }

    /// One finger.
    pub const fn finger(&self, finger: HumanFinger) -> &FingerCalibration {
        &self.fingers[finger as usize]
    }

    /// One finger, for adding a prior or a posture.
    pub const fn finger_mut(&mut self, finger: HumanFinger) -> &mut FingerCalibration {
        &mut self.fingers[finger as usize]
    }

    /// Detects markers that are assigned to the wrong fingers.
    ///
    /// # Errors
    /// The residual of a finger's orientations is twice as large with its own marker as with another's, and
    /// larger than noise.
    pub fn check_markers(&self) -> Result<(), CalibrationError> {
        if self.complete_postures < MIN_POSTURES_OF_SWAP {
            return Ok(());
        }
        #[expect(clippy::cast_precision_loss, reason = "a count of postures")]
        let freedom = 3.0 * self.complete_postures as f32 - 12.0;
        for (finger, crossed) in HumanFinger::ALL.into_iter().zip(&self.crossed) {
            let deviation = |equations: &IncrementalQr<12>| math::sqrt(equations.residual() / freedom);
            let own = deviation(&crossed[finger as usize]);
            let noise = self.finger(finger).settings.equation_deviation(&TYPICAL_LINKS);
            let best =
                HumanFinger::ALL.into_iter().zip(crossed).fold((finger, own), |best, (other, equations)| {
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
    /// Swapped markers; else the error of the first finger that is not calibrated.
    pub fn solve(&self) -> Result<[(FingerLinks, CalibrationAccuracy); HUMAN_FINGERS], CalibrationError> {
        self.check_markers()?;
        let [thumb, index, middle, ring, little] = &self.fingers;
        Ok([thumb.solve()?, index.solve()?, middle.solve()?, ring.solve()?, little.solve()?])
    }

    /// Links and accuracy of all fingers. Those without markers, or whose postures lack a movement, are
    /// inferred from the proportions of the hand; their rank is 12, and their deviation may exceed 2 mm. The
    /// thumb and two other fingers must be calibrated by markers. `flat`: the orientations of the flat hand.
    ///
    /// # Errors
    /// Swapped markers; a residual of a marked finger that noise does not explain; too few calibrated
    /// fingers.
    pub fn solve_with_proportions(
        &self,
        flat: &GloveSample,
    ) -> Result<[(FingerLinks, CalibrationAccuracy); HUMAN_FINGERS], CalibrationError> {
        self.check_markers()?;
        let thumb = self.finger(HumanFinger::Thumb).solve()?;
        let (mut solved, mut refused) = ([None; HUMAN_FINGERS], None);
        for (solved, finger) in solved.iter_mut().zip(&self.fingers) {
            *solved = match finger.solve() {
                Ok(calibrated) => Some(calibrated),
                Err(error @ CalibrationError::Residual { .. }) => return Err(error),
                Err(error) => {
                    if finger.postures() > 0 {
                        refused.get_or_insert(error);
                    }
                    None
                }
            };
        }
        let mut rotations = [FingerRotations([Matrix3::identity(); 3]); HUMAN_FINGERS];
        for (rotations, finger) in rotations.iter_mut().zip(HumanFinger::ALL) {
            *rotations = FingerRotations::of(flat, finger)?;
        }
        let priors = infer_links(&solved.map(|solved| solved.map(|(links, _)| links)), &rotations)
            .map_err(|error| refused.unwrap_or(error))?;
        let mut all = [thumb; HUMAN_FINGERS];
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
