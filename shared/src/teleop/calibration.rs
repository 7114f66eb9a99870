//! Link calibration of the operator's fingers (Hand5 eq. 2).
//!
//! A posture gives three equations `A x = p`, `A = [I, R1, R1R2, R1R2R3]`, for the twelve components of a
//! finger's links. They are added one after another to a triangular factor ([`IncrementalQr`]), so
//! calibration can continue during use, optionally with forgetting.
//!
//! A finger's joints are hinges. A component of link `k − 1` along the axis of hinge `k` moves the tip
//! exactly as the same component of link `k` does, so `A` has rank 10, or 9 without spreading, whatever the
//! postures. Noise hides that: see [`CalibrationSettings::orientation_noise`]. The minimum-norm solution
//! without the directions that are due to noise still predicts the tip.

use nalgebra::{SMatrix, SVector, Vector3};

use super::calibration_error::{CalibrationError, FingerMovement, Movement};
use super::human_hand::{FingerLinks, FingerRotations, HumanFinger};
use super::joint_movements::{JointMovements, JointRange};
use crate::OutOfRange;
use crate::math::{self, IncrementalQr};

/// Permitted standard deviations of contacts and priors [m].
const DEVIATIONS: [f32; 2] = [1e-4, 0.1];
/// Minimum number of postures for twelve unknowns.
const MIN_POSTURES: u32 = 4;
/// Maximum standard deviation of the predicted tip over the joints' range [m].
pub const MAX_TIP_DEVIATION: f32 = 2e-3;
/// Prior standard deviation of components that the postures leave undetermined [m]: a component of a link
/// along a hinge is shorter than a phalanx.
const UNKNOWN_LINK: f32 = 0.03;
/// Root of 3, the number of equations of a posture.
const ROOT_OF_3: f32 = 1.732;
/// Margin for noise that is larger than stated.
const NOISE_MARGIN: f32 = 1.5;
/// Residuals above this many standard deviations are not noise.
const MAX_RESIDUAL_RATIO: f32 = 4.0;
/// Links of a typical finger, for the noise of an equation before the links are known.
pub(super) const TYPICAL_LINKS: FingerLinks =
    FingerLinks([[0.0; 3], [0.045, 0.0, 0.0], [0.025, 0.0, 0.0], [0.02, 0.0, 0.0]]);
/// Rotations of a joint with a smaller standard deviation [rad] do not count as movement: 2°.
const MIN_MOVEMENT: f32 = 0.035;

/// Assumptions about the measurements of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSettings {
    /// Noise of one sensor's orientation in one posture: root mean square of the rotation angle [rad], 0 to
    /// 0.2. It is smaller than that of a single sample if a posture is a mean over time.
    ///
    /// With standard deviation `σ = noise/√3` about each axis, a unit vector `v` has `E|δA v|² = 2σ²` per
    /// posture: a rotation error `e` displaces `v` by `e × v`, and the error of the back of the hand acts on
    /// `−v0` where `A v = 0`. Noise alone therefore causes singular values in `N` postures of about
    /// `σ_n = noise √(2N/3)`, and random matrix theory (Marchenko and Pastur 1967) spreads them up to
    /// `σ_n (1 + 2/√N)` for 12 columns of 3N rows. Singular values below 1.5 times that are truncated.
    pub orientation_noise: f32,
    /// Standard deviation of a marker along each axis [m], 10⁻⁶ to 0.01.
    pub marker_noise: f32,
    /// Forgetting factor of all earlier postures with each new one, 0.5 to 1; 1: no forgetting.
    pub forgetting: f32,
}

impl CalibrationSettings {
    /// 1.5°, 0.3 mm, no forgetting.
    pub const DEFAULT: Self = Self { orientation_noise: 0.0262, marker_noise: 3e-4, forgetting: 1.0 };

    pub(super) fn check(&self) -> Result<(), CalibrationError> {
        let settings = [
            ("orientation noise", self.orientation_noise, [0.0, 0.2]),
            ("marker noise", self.marker_noise, [1e-6, 0.01]),
            ("forgetting", self.forgetting, [0.5, 1.0]),
        ];
        for (field, value, range) in settings {
            OutOfRange::check(field, value, range).map_err(CalibrationError::Setting)?;
        }
        Ok(())
    }

    /// Standard deviation of an equation along each axis for links like these [m]. Orientation noise acts on
    /// each link as a lever, from its own sensor and from that of the back of the hand, whose errors are
    /// taken for independent in each link: `(2/9) noise² Σ 2|l|²` along each of three axes. They are common
    /// to all links, so that this is a quarter too little for a straight finger, and about right for a fist.
    pub(super) fn equation_deviation(&self, links: &FingerLinks) -> f32 {
        let [_, moving @ ..] = links.0.map(Vector3::from);
        let levers: f32 = moving.iter().map(Vector3::norm_squared).sum();
        let noise = self.orientation_noise * self.orientation_noise * (4.0 / 9.0) * levers;
        math::sqrt(self.marker_noise * self.marker_noise + noise)
    }
}

/// Accuracy of a finger's calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationAccuracy {
    /// Number of postures.
    pub postures: u32,
    /// Number of singular values above the noise; 9 or 10 for a finger with hinges, 12 with a prior.
    pub rank: u8,
    /// Condition number: largest over smallest singular value that is not truncated.
    pub condition: f32,
    /// Root mean square of the tip's residual [m].
    pub residual: f32,
    /// Standard deviation of the predicted tip [m]: the largest over 81 postures of the joints' range, with
    /// angles from the flat hand. Fingers: base bent by 0, 40, 80° and spread by −10, 0, 10°; middle 0, 45,
    /// 90°; end 2/3 of the middle plus −10, 0, 10°. Thumb: base 0, 20, 40° and −20, 0, 20°; middle 0, 25,
    /// 50°; end 0, 35, 70°.
    pub tip_deviation: f32,
    /// The movement that would improve it most.
    pub weakest: FingerMovement,
}

/// Prior of a finger's links, known without a marker: mean and standard deviation of each component [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkPrior {
    /// Mean.
    pub mean: FingerLinks,
    /// Standard deviation of the components of each link [m].
    pub deviation: [f32; 4],
}

/// Calibration of one finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerCalibration {
    pub(super) finger: HumanFinger,
    pub(super) settings: CalibrationSettings,
    equations: IncrementalQr<12>,
    /// Number of postures, and their sum of weights.
    postures: u32,
    weight: f32,
    pub(super) joints: JointMovements,
    has_prior: bool,
}

impl FingerCalibration {
    /// A calibration without postures.
    ///
    /// # Errors
    /// A setting outside its limits.
    pub fn try_new(finger: HumanFinger, settings: &CalibrationSettings) -> Result<Self, CalibrationError> {
        settings.check()?;
        Ok(Self::new(finger, settings))
    }

    /// As `try_new`, with valid settings.
    pub(super) fn new(finger: HumanFinger, settings: &CalibrationSettings) -> Self {
        Self {
            finger,
            settings: *settings,
            equations: IncrementalQr::new(),
            postures: 0,
            weight: 0.0,
            joints: JointMovements::default(),
            has_prior: false,
        }
    }

    /// Adds a posture: orientations, and the marker at the tip in the frame of the back of the hand [m]. The
    /// first posture is the flat hand.
    ///
    /// # Errors
    /// A marker that is not finite or more than 0.4 m from the back of the hand. Nothing is added.
    pub fn add_posture(
        &mut self,
        rotations: &FingerRotations,
        tip: [f32; 3],
    ) -> Result<(), CalibrationError> {
        check_marker(self.finger, tip)?;
        self.joints.add(rotations, self.settings.forgetting);
        self.equations.forget(self.settings.forgetting);
        add_equations(&mut self.equations, rotations, tip, 1.0);
        self.weight = self.settings.forgetting * self.weight + 1.0;
        self.postures = self.postures.saturating_add(1);
        Ok(())
    }

    /// Adds a posture in which the tip touches a known position [m], with a standard deviation along each
    /// axis [m]. It improves the lengths but does not count as a posture: the calibration also needs a prior.
    ///
    /// # Errors
    /// A position that is not finite or more than 0.4 m from the back of the hand, or a standard deviation
    /// outside 0.1 mm to 0.1 m.
    pub fn add_contact(
        &mut self,
        rotations: &FingerRotations,
        place: [f32; 3],
        deviation: f32,
    ) -> Result<(), CalibrationError> {
        check_marker(self.finger, place)?;
        OutOfRange::check("standard deviation of the contact", deviation, DEVIATIONS)
            .map_err(CalibrationError::Setting)?;
        // In units of the standard deviation of the postures' equations.
        let weight = self.settings.equation_deviation(&TYPICAL_LINKS) / deviation;
        add_equations(&mut self.equations, rotations, place, weight.min(1.0));
        Ok(())
    }

    /// Adds a prior of the links: regularised least squares.
    ///
    /// # Errors
    /// A mean that is not finite, or a standard deviation outside 0.1 mm to 0.1 m.
    pub fn add_prior(&mut self, prior: &LinkPrior) -> Result<(), CalibrationError> {
        for (link, (mean, deviation)) in prior.mean.0.iter().zip(prior.deviation).enumerate() {
            OutOfRange::check("standard deviation of the prior", deviation, DEVIATIONS)
                .map_err(CalibrationError::Setting)?;
            for value in mean {
                OutOfRange::check("mean of the prior", *value, [f32::MIN, f32::MAX])
                    .map_err(CalibrationError::Setting)?;
            }
            // In units of the standard deviation of the postures' equations, that of the noise.
            let weight = self.settings.equation_deviation(&prior.mean) / deviation;
            for (axis, mean) in mean.iter().enumerate() {
                let mut row = SVector::zeros();
                row[3 * link + axis] = weight;
                self.equations.add(row, weight * mean);
            }
        }
        self.has_prior = true;
        Ok(())
    }

    /// Number of postures.
    pub const fn postures(&self) -> u32 {
        self.postures
    }

    /// Estimates the links and their accuracy, without requirements on the accuracy.
    ///
    /// # Errors
    /// Without a prior: too few postures, or postures that are all alike.
    pub fn estimate(&self) -> Result<(FingerLinks, CalibrationAccuracy), CalibrationError> {
        let Self { finger, postures, .. } = *self;
        if !self.has_prior {
            if postures < MIN_POSTURES {
                return Err(CalibrationError::TooFewPostures { finger, postures, min: MIN_POSTURES });
            }
            if self.joints.largest_deviation() < MIN_MOVEMENT {
                return Err(CalibrationError::PosturesAlike { finger });
            }
        }
        let noise = self.settings.orientation_noise * math::sqrt(2.0 / 3.0 * self.weight);
        let spread = 1.0 + 2.0 / math::sqrt(self.weight.max(1.0));
        // Rounding errors of single precision.
        let rounding = 1e-4 * math::sqrt(self.weight.max(1.0));
        let threshold = if self.has_prior { 0.0 } else { (NOISE_MARGIN * spread * noise).max(rounding) };
        let solution = self.equations.solve(threshold);
        let links = FingerLinks::from_vector(&solution.x);
        let expected = self.settings.equation_deviation(&links);
        let equations = 3.0 * self.weight + if self.has_prior { 12.0 } else { 0.0 };
        let freedom = equations - f32::from(rank_of(solution.rank));
        let measured = if freedom > 1.0 { math::sqrt(solution.residual / freedom) } else { 0.0 };
        let deviation = measured.max(expected);
        // Covariance of the links in the axes of the singular vectors. Noise of A attenuates a component by
        // 1 − (σ_n/σ)².
        let variances = SVector::<f32, 12>::from_fn(|k, _| {
            if k >= solution.rank {
                return UNKNOWN_LINK * UNKNOWN_LINK;
            }
            let square = solution.values[k] * solution.values[k];
            let attenuation = if self.has_prior { 0.0 } else { noise * noise / square * UNKNOWN_LINK };
            deviation * deviation / square + attenuation * attenuation
        });
        let scaled = SMatrix::<f32, 12, 12>::from_fn(|row, k| {
            solution.directions[(row, k)] * math::sqrt(variances[k])
        });
        let (tip_deviation, weakest) = self.tip_deviation(&scaled);
        let last = solution.rank.saturating_sub(1).min(11);
        let accuracy = CalibrationAccuracy {
            postures,
            rank: rank_of(solution.rank),
            condition: solution.values[0] / solution.values[last],
            residual: math::sqrt(solution.residual / self.weight.max(1.0)),
            tip_deviation,
            weakest: FingerMovement { finger, movement: weakest },
        };
        Ok((links, accuracy))
    }

    /// Estimates the links, and requires that they predict the tip accurately enough.
    ///
    /// # Errors
    /// Too few postures; postures that are all alike; residuals that are not noise; a predicted tip whose
    /// standard deviation exceeds 2 mm, with the movement that the postures lack.
    pub fn solve(&self) -> Result<(FingerLinks, CalibrationAccuracy), CalibrationError> {
        let (links, accuracy) = self.estimate()?;
        let limit = MAX_RESIDUAL_RATIO * ROOT_OF_3 * self.settings.equation_deviation(&links);
        if accuracy.residual > limit {
            return Err(CalibrationError::Residual { finger: self.finger, value: accuracy.residual, limit });
        }
        if accuracy.tip_deviation > MAX_TIP_DEVIATION {
            return Err(CalibrationError::MissingMovement {
                movement: accuracy.weakest,
                deviation: accuracy.tip_deviation,
                limit: MAX_TIP_DEVIATION,
            });
        }
        Ok((links, accuracy))
    }

    /// Largest standard deviation of the tip over the postures, and the movement with the most uncertain
    /// displacement of the tip. `scaled`: square root of the covariance of the links.
    fn tip_deviation(&self, scaled: &SMatrix<f32, 12, 12>) -> (f32, Movement) {
        let range = JointRange::of(self.finger);
        let mut largest = 0.0_f32;
        for index in 0..81 {
            let level = |power: u32| (index / 3_usize.pow(power)) % 3;
            let posture = self.joints.posture(range.angles([level(0), level(1), level(2), level(3)]));
            largest = largest.max((posture.regressor() * scaled).norm_squared());
        }
        // Each joint alone, over its whole range.
        let [min, middle, max] = [0, 1, 2].map(|level| range.angles([level; 4]));
        let mut weakest = (0.0, Movement::BendBase);
        for (number, movement) in Movement::ALL.into_iter().enumerate() {
            let [low, high] = [min, max].map(|end| {
                let mut angles = middle;
                angles[number] = end[number];
                self.joints.posture(angles).regressor()
            });
            let unknown = ((high - low) * scaled).norm_squared();
            if unknown > weakest.0 {
                weakest = (unknown, movement);
            }
        }
        (math::sqrt(largest), weakest.1)
    }
}

pub(super) fn check_marker(finger: HumanFinger, tip: [f32; 3]) -> Result<(), CalibrationError> {
    let distance = math::norm(&Vector3::from(tip));
    if distance <= 0.4 { Ok(()) } else { Err(CalibrationError::Marker { finger, distance }) }
}

pub(super) fn add_equations(
    equations: &mut IncrementalQr<12>,
    rotations: &FingerRotations,
    tip: [f32; 3],
    weight: f32,
) {
    let regressor = rotations.regressor();
    for (axis, value) in tip.into_iter().enumerate() {
        equations.add(regressor.row(axis).transpose() * weight, value * weight);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 12")]
const fn rank_of(rank: usize) -> u8 {
    rank as u8
}
