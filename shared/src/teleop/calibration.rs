//! Link calibration of the operator's fingers (Hand5 eq. 2).
//!
//! A pose gives three equations `A x = p`, `A = [I, R1, R1R2, R1R2R3]`, for the twelve components of a finger's
//! links. They are added one after another to a triangular factor ([`IncrementalQr`]), so calibration goes on
//! in use, with forgetting where wanted.
//!
//! A finger's joints are hinges. A component of link `k − 1` along the axis of hinge `k` moves the tip exactly as
//! the same component of link `k` does, so `A` has rank 10, without spreading 9, whatever the poses. Noise hides
//! that: see [`CalibrationSettings::orientation_noise`]. The solution of minimum norm without the directions that
//! noise alone made predicts the tip all the same.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::anatomy::infer_links;
use super::calibration_error::{CalibrationError, FingerMotion, Movement};
use super::human_hand::{FINGERS, Finger, FingerLinks, FingerRotations, GloveSample};
use crate::math::{self, IncrementalQr, Svd};

/// Poses for twelve unknowns.
const MIN_POSES: u32 = 4;
/// Poses from which residuals tell whether markers are swapped: as many equations again as unknowns.
const MIN_POSES_OF_SWAP: u32 = 8;
/// Maximum standard deviation of the predicted tip over the joints' range [m].
pub const MAX_TIP_DEVIATION: f32 = 2e-3;
/// Prior standard deviation of what the poses leave undetermined [m]: a component of a link along a hinge is
/// shorter than a phalanx.
const UNKNOWN_LINK: f32 = 0.03;
/// Noise may be larger than stated.
const NOISE_MARGIN: f32 = 1.5;
/// Residuals above this many standard deviations are not noise.
const MAX_RESIDUAL_RATIO: f32 = 4.0;
/// A finger's residual that is this much larger than with another finger's marker means that they are swapped.
const SWAP_RATIO: f32 = 2.0;
/// Links of a typical finger, for the noise of an equation before the links are known.
const TYPICAL_LINKS: FingerLinks =
    FingerLinks([[0.0; 3], [0.045, 0.0, 0.0], [0.025, 0.0, 0.0], [0.02, 0.0, 0.0]]);
/// Rotations of a joint below this standard deviation [rad] are no movement: 2°.
const MIN_MOVEMENT: f32 = 0.035;

/// What a calibration assumes about its measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSettings {
    /// Noise of one sensor's orientation in one pose: root mean square of the rotation angle [rad], 0 to 0.2.
    /// Less than that of a sample if a pose is the mean over a time.
    ///
    /// With standard deviation `σ = noise/√3` about each axis, a unit vector `v` has `E|δA v|² = 2σ²` a pose:
    /// a rotation error `e` displaces `v` by `e × v`, and the error of the back of the hand acts on `−v0`
    /// where `A v = 0`. So in `N` poses noise alone makes singular values of about `σ_n = noise √(2N/3)`, and
    /// random matrix theory (Marchenko and Pastur 1967) spreads them up to `σ_n (1 + 2/√N)` for 12 columns of
    /// 3N rows. Singular values below 1.5 times that are truncated.
    pub orientation_noise: f32,
    /// Standard deviation of a marker along each axis [m], 10⁻⁶ to 0.01.
    pub marker_noise: f32,
    /// Factor on the weight of all earlier poses with each new one, 0.5 to 1; 1 forgets nothing.
    pub forgetting: f32,
}

impl CalibrationSettings {
    /// One and a half degree, 0.3 mm, nothing forgotten.
    pub const DEFAULT: Self = Self { orientation_noise: 0.0262, marker_noise: 3e-4, forgetting: 1.0 };

    fn check(&self) -> Result<(), CalibrationError> {
        let settings = [
            ("orientation noise", self.orientation_noise, [0.0, 0.2]),
            ("marker noise", self.marker_noise, [1e-6, 0.01]),
            ("forgetting", self.forgetting, [0.5, 1.0]),
        ];
        for (field, value, [min, max]) in settings {
            if !(min..=max).contains(&value) {
                return Err(CalibrationError::Setting { field, value, min, max });
            }
        }
        Ok(())
    }

    /// Standard deviation of an equation along each axis for links like these [m]. Orientation noise acts with
    /// each link as lever, for its own sensor and for that of the back of the hand: `(2/3) σ² Σ 2|l|²`.
    fn equation_deviation(&self, links: &FingerLinks) -> f32 {
        let [_, moving @ ..] = links.0.map(Vector3::from);
        let levers: f32 = moving.iter().map(Vector3::norm_squared).sum();
        let noise = self.orientation_noise * self.orientation_noise * (4.0 / 9.0) * levers;
        math::sqrt(self.marker_noise * self.marker_noise + noise)
    }
}

/// How well a finger is calibrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationAccuracy {
    /// Number of poses.
    pub poses: u32,
    /// Number of singular values above the noise; 9 or 10 for a finger with hinges, 12 with a prior.
    pub rank: u8,
    /// Ratio of the largest to the smallest singular value that is kept.
    pub condition: f32,
    /// Root mean square of the tip's residual [m].
    pub residual: f32,
    /// Standard deviation of the predicted tip [m]: the largest over 81 postures of the joints' range. From the
    /// flat hand, fingers: base 0, 40, 80° bent and −10, 0, 10° spread; middle 0, 45, 90°; end 2/3 of the
    /// middle −10, 0, 10°. Thumb: base 0, 20, 40° and −20, 0, 20°; middle 0, 25, 50°; end 0, 35, 70°.
    pub tip_deviation: f32,
    /// The movement that would improve it most.
    pub weakest: FingerMotion,
}

/// What is known of a finger's links without a marker: mean and standard deviation of each component [m].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkPrior {
    /// Mean.
    pub mean: FingerLinks,
    /// Standard deviation of the components of each link.
    pub deviation: [f32; 4],
}

/// Calibration of one finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerCalibration {
    finger: Finger,
    settings: CalibrationSettings,
    equations: IncrementalQr<12>,
    /// Number of poses, and their sum of weights.
    poses: u32,
    weight: f32,
    joints: JointMovements,
    has_prior: bool,
}

impl FingerCalibration {
    /// No pose yet.
    ///
    /// # Errors
    /// A setting outside its limits.
    pub fn try_new(finger: Finger, settings: &CalibrationSettings) -> Result<Self, CalibrationError> {
        settings.check()?;
        Ok(Self {
            finger,
            settings: *settings,
            equations: IncrementalQr::new(),
            poses: 0,
            weight: 0.0,
            joints: JointMovements::default(),
            has_prior: false,
        })
    }

    /// Adds a pose: orientations, and the marker at the tip in the frame of the back of the hand [m]. The first
    /// pose is the flat hand.
    ///
    /// # Errors
    /// A marker that is not finite or more than 0.4 m from the back of the hand. Nothing is added.
    pub fn add_pose(&mut self, rotations: &FingerRotations, tip: [f32; 3]) -> Result<(), CalibrationError> {
        check_marker(self.finger, tip)?;
        self.joints.add(rotations, self.settings.forgetting);
        self.equations.forget(self.settings.forgetting);
        add_equations(&mut self.equations, rotations, tip, 1.0);
        self.weight = self.settings.forgetting * self.weight + 1.0;
        self.poses = self.poses.saturating_add(1);
        Ok(())
    }

    /// Adds a posture in which the tip touches a place that is known [m], within a standard deviation along each
    /// axis [m]. It helps to tell lengths, and is no pose: a prior must say the rest.
    ///
    /// # Errors
    /// A place that is not finite or more than 0.4 m from the back of the hand, or a standard deviation outside
    /// 0.1 mm to 0.1 m.
    pub fn add_contact(
        &mut self,
        rotations: &FingerRotations,
        place: [f32; 3],
        deviation: f32,
    ) -> Result<(), CalibrationError> {
        check_marker(self.finger, place)?;
        if !(1e-4..=0.1).contains(&deviation) {
            let field = "standard deviation of the contact";
            return Err(CalibrationError::Setting { field, value: deviation, min: 1e-4, max: 0.1 });
        }
        // In the unit of the poses' equations.
        let weight = self.settings.equation_deviation(&TYPICAL_LINKS) / deviation;
        add_equations(&mut self.equations, rotations, place, weight.min(1.0));
        Ok(())
    }

    /// Adds what is known of the links: regularised least squares.
    ///
    /// # Errors
    /// A mean that is not finite, or a standard deviation outside 0.1 mm to 0.1 m.
    pub fn add_prior(&mut self, prior: &LinkPrior) -> Result<(), CalibrationError> {
        for (link, (mean, deviation)) in prior.mean.0.iter().zip(prior.deviation).enumerate() {
            if !(1e-4..=0.1).contains(&deviation) || !mean.iter().all(|x| x.is_finite()) {
                let field = "standard deviation of the prior";
                return Err(CalibrationError::Setting { field, value: deviation, min: 1e-4, max: 0.1 });
            }
            // In the unit of the poses' equations, whose standard deviation is that of noise.
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

    /// Number of poses.
    pub const fn poses(&self) -> u32 {
        self.poses
    }

    /// The links, and how well they predict the tip, whatever the accuracy.
    ///
    /// # Errors
    /// Too few poses, or poses that are all alike; neither with a prior.
    pub fn estimate(&self) -> Result<(FingerLinks, CalibrationAccuracy), CalibrationError> {
        let Self { finger, poses, .. } = *self;
        if !self.has_prior {
            if poses < MIN_POSES {
                return Err(CalibrationError::TooFewPoses { finger, poses, min: MIN_POSES });
            }
            if self.joints.largest_deviation() < MIN_MOVEMENT {
                return Err(CalibrationError::PosesAlike { finger });
            }
        }
        let noise = self.settings.orientation_noise * math::sqrt(2.0 / 3.0 * self.weight);
        let spread = 1.0 + 2.0 / math::sqrt(self.weight.max(1.0));
        // Rounding of single precision.
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
            poses,
            rank: rank_of(solution.rank),
            condition: solution.values[0] / solution.values[last],
            residual: math::sqrt(solution.residual / self.weight.max(1.0)),
            tip_deviation,
            weakest: FingerMotion { finger, movement: weakest },
        };
        Ok((links, accuracy))
    }

    /// The links, if they predict the tip well enough.
    ///
    /// # Errors
    /// Too few poses; poses that are all alike; residuals that are not noise; a predicted tip whose standard
    /// deviation exceeds 2 mm, with the movement that the poses lack.
    pub fn solve(&self) -> Result<(FingerLinks, CalibrationAccuracy), CalibrationError> {
        let (links, accuracy) = self.estimate()?;
        let limit = MAX_RESIDUAL_RATIO * 1.732 * self.settings.equation_deviation(&links);
        if accuracy.residual > limit {
            return Err(CalibrationError::Residual { finger: self.finger, value: accuracy.residual, limit });
        }
        if accuracy.tip_deviation > MAX_TIP_DEVIATION {
            return Err(CalibrationError::MissingMotion {
                motion: accuracy.weakest,
                deviation: accuracy.tip_deviation,
                limit: MAX_TIP_DEVIATION,
            });
        }
        Ok((links, accuracy))
    }

    /// Largest standard deviation of the tip over the postures, and the movement about which the tip's
    /// displacement is known least. `scaled`: square root of the covariance of the links.
    fn tip_deviation(&self, scaled: &SMatrix<f32, 12, 12>) -> (f32, Movement) {
        let range = JointRange::of(self.finger);
        let mut largest = 0.0_f32;
        for index in 0..81 {
            let level = |power: u32| (index / 3_usize.pow(power)) % 3;
            let posture = self.joints.posture(range.angles([level(0), level(1), level(2), level(3)]));
            largest = largest.max((posture.regressor() * scaled).norm_squared());
        }
        // Each joint alone, over its whole range.
        let [least, middle, most] = [0, 1, 2].map(|level| range.angles([level; 4]));
        let mut weakest = (0.0, Movement::BendBase);
        for (number, movement) in Movement::ALL.into_iter().enumerate() {
            let [low, high] = [least, most].map(|end| {
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
        let finger = FingerCalibration::try_new(Finger::Thumb, settings)?;
        Ok(Self {
            fingers: Finger::ALL.map(|name| FingerCalibration { finger: name, ..finger }),
            crossed: [[IncrementalQr::new(); FINGERS]; FINGERS],
            complete_poses: 0,
        })
    }

    /// Adds a pose: orientations, and the markers that are seen, in the frame of the back of the hand [m]. The
    /// first pose is the flat hand.
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

    /// Adds a posture in which the tip of the thumb, which is calibrated, touches that of a finger, within a standard
    /// deviation along each axis [m]. For fingers without marker.
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

fn check_marker(finger: Finger, tip: [f32; 3]) -> Result<(), CalibrationError> {
    let distance = math::sqrt(Vector3::from(tip).norm_squared());
    if distance <= 0.4 { Ok(()) } else { Err(CalibrationError::Marker { finger, distance }) }
}

fn add_equations(equations: &mut IncrementalQr<12>, rotations: &FingerRotations, tip: [f32; 3], weight: f32) {
    let regressor = rotations.regressor();
    for (axis, value) in tip.into_iter().enumerate() {
        equations.add(regressor.row(axis).transpose() * weight, value * weight);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "at most 12")]
const fn rank_of(rank: usize) -> u8 {
    rank as u8
}

/// How the joints of a finger moved in the poses: rotation vectors from the first pose, their mean and scatter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct JointMovements {
    first: Option<[Matrix3<f32>; 3]>,
    weight: f32,
    sum: [Vector3<f32>; 3],
    squares: [Matrix3<f32>; 3],
}

impl JointMovements {
    fn add(&mut self, rotations: &FingerRotations, forgetting: f32) {
        let joints = rotations.joints();
        let first = *self.first.get_or_insert(joints);
        self.weight = forgetting * self.weight + 1.0;
        for joint in 0..3 {
            let vector = math::rotation_vector(&(first[joint].transpose() * joints[joint]));
            self.sum[joint] = self.sum[joint] * forgetting + vector;
            self.squares[joint] = self.squares[joint] * forgetting + vector * vector.transpose();
        }
    }

    /// Principal axes of a joint's rotations, that of bending first, and standard deviation about that.
    fn axes(&self, joint: usize) -> ([Vector3<f32>; 2], f32) {
        let weight = self.weight.max(1.0);
        let mean = self.sum[joint] / weight;
        let covariance = self.squares[joint] / weight - mean * mean.transpose();
        let svd = Svd::new(&covariance);
        let mut bend: Vector3<f32> = svd.right.column(0).into();
        // From the flat hand a finger bends one way.
        if bend.dot(&mean) < 0.0 {
            bend = -bend;
        }
        ([bend, svd.right.column(1).into()], math::sqrt(svd.values[0]))
    }

    fn largest_deviation(&self) -> f32 {
        (0..3).fold(0.0, |largest, joint| self.axes(joint).1.max(largest))
    }

    /// The posture with angles from the first pose [rad]: base bent, base spread, middle bent, end bent.
    fn posture(&self, [base, spread, middle, end]: [f32; 4]) -> FingerRotations {
        let first = self.first.unwrap_or([Matrix3::identity(); 3]);
        let [([principal, second], _), ([middle_axis, _], _), ([end_axis, _], _)] =
            [0, 1, 2].map(|joint| self.axes(joint));
        // A finger that was spread and not bent at the palm: it would bend there as at the middle joint.
        let parallel = first[1] * middle_axis;
        let [bend_axis, spread_axis] = if math::abs(principal.dot(&parallel)) < 0.3 {
            [parallel, principal]
        } else {
            [principal, second]
        };
        let vectors = [bend_axis * base + spread_axis * spread, middle_axis * middle, end_axis * end];
        let mut joints = first;
        joints.iter_mut().zip(&vectors).for_each(|(joint, vector)| *joint *= math::rotation_matrix(vector));
        FingerRotations::from_joints(joints)
    }
}

/// Angles of a finger from the flat hand [°], least, middle and largest.
struct JointRange {
    base: [f32; 3],
    spread: [f32; 3],
    middle: [f32; 3],
    end: [f32; 3],
    /// Bending of the end joint with each degree of the middle one.
    coupling: f32,
}

impl JointRange {
    const FINGER: Self = Self {
        base: [0.0, 40.0, 80.0],
        spread: [-10.0, 0.0, 10.0],
        middle: [0.0, 45.0, 90.0],
        end: [-10.0, 0.0, 10.0],
        coupling: 2.0 / 3.0,
    };
    const THUMB: Self = Self {
        base: [0.0, 20.0, 40.0],
        spread: [-20.0, 0.0, 20.0],
        middle: [0.0, 25.0, 50.0],
        end: [0.0, 35.0, 70.0],
        coupling: 0.0,
    };

    const fn of(finger: Finger) -> &'static Self {
        match finger {
            Finger::Thumb => &Self::THUMB,
            _ => &Self::FINGER,
        }
    }

    /// Angles [rad] of levels 0 to 2.
    fn angles(&self, [base, spread, middle, end]: [usize; 4]) -> [f32; 4] {
        let (base, spread, middle, end) =
            (self.base[base], self.spread[spread], self.middle[middle], self.end[end]);
        [base, spread, middle, end + self.coupling * middle].map(f32::to_radians)
    }
}
