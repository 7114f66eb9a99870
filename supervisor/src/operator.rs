//! An operator's hand: calibration of its links (detection of held postures in a glove's stream, guidance of
//! the person, and the calibration file), and its fingertips from the frames of any source ([`Tracker`]).

mod error;
mod fingertips;
mod landmarks;
mod palm;
mod tracker;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "tests")]
mod tests;

use std::collections::VecDeque;
use std::fmt::Write as _;

use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Serialize};
use tesaki::math;
use tesaki::teleop::{
    CalibrationAccuracy, CalibrationError, CalibrationSettings, FingerLinks, FingerRotations, GloveSample,
    HUMAN_FINGERS, HandCalibration, HumanFinger, MAX_TIP_DEVIATION,
};

pub use error::FrameError;
pub use landmarks::{LANDMARKS, Landmarks};
pub use tracker::{Fingertips, Observation, Tracker, TrackerSettings, Wearer, operator_fingertips};

/// Positions of the visible markers, thumb to little finger, in the frame of the back of the hand [m].
pub type Markers = [Option<[f32; 3]>; HUMAN_FINGERS];

/// A posture of the hand, with the visible markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandPosture {
    /// Orientations, relative to the back of the hand.
    pub orientations: GloveSample,
    /// Markers.
    pub markers: Markers,
}

/// Time for which a posture must be held [s].
const HOLD: f64 = 1.0;
/// Minimum number of samples of a held posture.
const MIN_SAMPLES: usize = 10;
/// So many samples in a row that do not follow the one before are no gap.
const BREAKS: u32 = 5;
/// Largest rotation between the means of the two halves of a held posture [rad]: 2°.
const STILL: f64 = 0.035;
/// Rotation of a segment from the previous posture that makes a new posture [rad]: 10°.
const DIFFERENT: f64 = 0.175;
/// Number of postures from which a calibration is offered as complete.
const MIN_POSTURES: u32 = 12;
/// A posture whose tip is this far from the calibrated position must be repeated [m].
const REDO: f32 = 0.015;

/// Standard deviation of the distance of two touching tips, along each axis [m].
const TOUCH: f32 = 2.5e-3;

/// Finds postures in a stream of samples that are held for a second, and averages them.
#[derive(Clone, Debug, Default)]
pub struct PostureDetector {
    window: VecDeque<(f64, HandPosture)>,
    last: Option<GloveSample>,
    /// Consecutive samples whose times do not follow the one before, and the last difference [s].
    breaks: (u32, f64),
}

impl PostureDetector {
    /// Takes a sample at a time [s]; returns the mean of a new held posture.
    pub fn add(&mut self, time: f64, orientations: GloveSample, markers: Markers) -> Option<HandPosture> {
        // Motion during a gap is unknown.
        let goes_on = |before: f64| time > before && time - before < HOLD;
        match self.window.back() {
            Some(&(before, _)) if !goes_on(before) => {
                self.breaks = (self.breaks.0.saturating_add(1), time - before);
                self.window.clear();
            }
            _ => self.breaks.0 = 0,
        }
        self.window.push_back((time, HandPosture { orientations, markers }));
        while self.window.get(1).is_some_and(|(second, _)| time - second >= HOLD) {
            self.window.pop_front();
        }
        let begin = self.window.front().map_or(time, |(begin, _)| *begin);
        if time - begin < HOLD || self.window.len() < MIN_SAMPLES {
            return None;
        }
        let samples: Vec<GloveSample> = self.window.iter().map(|(_, posture)| posture.orientations).collect();
        let (first, second) = samples.split_at(samples.len() / 2);
        if rotation(&mean_orientations(first), &mean_orientations(second)) > STILL {
            return None;
        }
        let mean = mean_orientations(&samples);
        if self.last.is_some_and(|last| rotation(&last, &mean) < DIFFERENT) {
            return None;
        }
        let markers = mean_markers(self.window.iter().map(|(_, posture)| &posture.markers));
        self.window.clear();
        self.last = Some(mean);
        Some(HandPosture { orientations: mean, markers })
    }

    /// Why these samples cannot make a posture, however still the hand is held.
    pub fn hindrance(&self) -> Option<String> {
        let (breaks, step) = self.breaks;
        if breaks >= BREAKS {
            return Some(format!(
                "each sample is {step} s after the one before by its time: is `time` in seconds, and does it rise?"
            ));
        }
        let spans = |(begin, end): (f64, f64)| end - begin >= HOLD;
        let ends = self.window.front().zip(self.window.back()).map(|(first, last)| (first.0, last.0));
        let samples = self.window.len();
        (ends.is_some_and(spans) && samples < MIN_SAMPLES)
            .then(|| format!("{samples} samples came in a second, at least {MIN_SAMPLES} are needed"))
    }

    /// Allows the last posture to be taken again.
    pub fn again(&mut self) {
        self.last = None;
    }
}

/// Returns the mean orientations of the segments relative to the back of the hand, which is the identity in
/// the result. A segment without samples is missing.
#[expect(clippy::cast_possible_truncation, reason = "samples are in single precision")]
pub fn mean_orientations(samples: &[GloveSample]) -> GloveSample {
    let mean = |finger: usize, segment: usize| {
        let mut sum = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        for sample in samples {
            let (Some(back), Some(absolute)) = (sample.back, sample.segments[finger][segment]) else {
                continue;
            };
            let relative = quaternion(back).conjugate() * quaternion(absolute);
            // q and −q are the same orientation.
            sum += if relative.dot(&sum) < 0.0 { -relative } else { relative };
        }
        let norm = sum.norm();
        (norm > 0.0).then(|| <[f64; 4]>::from((sum / norm).coords).map(|component| component as f32))
    };
    GloveSample {
        back: Some([0.0, 0.0, 0.0, 1.0]),
        segments: std::array::from_fn(|finger| std::array::from_fn(|segment| mean(finger, segment))),
    }
}

fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion<f64> {
    Quaternion::new(f64::from(w), f64::from(x), f64::from(y), f64::from(z))
}

#[expect(clippy::cast_possible_truncation, reason = "samples are in single precision")]
fn mean_markers<'a>(samples: impl Iterator<Item = &'a Markers> + Clone) -> Markers {
    std::array::from_fn(|finger| {
        let (mut count, mut sum) = (0.0, [0.0; 3]);
        for marker in samples.clone().filter_map(|markers| markers[finger]) {
            count += 1.0;
            sum.iter_mut().zip(marker).for_each(|(sum, value)| *sum += f64::from(value));
        }
        (count > 0.0).then(|| sum.map(|sum| (sum / count) as f32))
    })
}

/// Returns the largest rotation of a segment from one sample to another [rad].
fn rotation(one: &GloveSample, other: &GloveSample) -> f64 {
    let pairs = one.segments.iter().flatten().zip(other.segments.iter().flatten());
    let angles = pairs.filter_map(|(one, other)| {
        let unit = |components: [f32; 4]| UnitQuaternion::new_normalize(quaternion(components));
        Some(unit((*one)?).angle_to(&unit((*other)?)))
    });
    angles.fold(0.0, f64::max)
}

/// Instructions for the first postures, in order.
const FIRST_POSTURES: [&str; 8] = [
    "hold the hand flat, all fingers straight and together",
    "spread the fingers and the thumb",
    "bend all fingers at the palm and keep them straight beyond it",
    "make a hook: bend the middle and end joints, straight at the palm",
    "make a loose fist, the thumb outside",
    "lay the thumb across the palm, fingers straight",
    "bend the thumb, and the fingers half way, spread",
    "bend each finger differently, from the index to the little finger more and more",
];

/// Guides a person through the postures and checks each of them.
#[derive(Clone, Debug)]
pub struct CalibrationGuide {
    calibration: HandCalibration,
    flat: Option<GloveSample>,
    postures: u32,
    /// Fingers whose marker was seen.
    marked: [bool; HUMAN_FINGERS],
}

impl CalibrationGuide {
    /// Creates a guide without postures.
    ///
    /// # Errors
    /// A setting is outside its limits.
    pub fn try_new(settings: &CalibrationSettings) -> Result<Self, CalibrationError> {
        let calibration = HandCalibration::try_new(settings)?;
        Ok(Self { calibration, flat: None, postures: 0, marked: [false; HUMAN_FINGERS] })
    }

    /// Adds a posture.
    ///
    /// # Errors
    /// An orientation or a marker cannot be used, or markers are where the calibrated hand cannot have them.
    /// Nothing is added: the posture can be taken again.
    pub fn add(&mut self, posture: &HandPosture) -> Result<(), CalibrationError> {
        self.calibration.add_posture(&posture.orientations, &posture.markers)?;
        self.flat.get_or_insert(posture.orientations);
        self.postures += 1;
        self.marked.iter_mut().zip(posture.markers).for_each(|(marked, marker)| *marked |= marker.is_some());
        Ok(())
    }

    /// As [`Self::add`], but refuses a posture in which the tip of a calibrated finger is more than 15 mm
    /// off: the person did not hold still, or a marker was mistaken for another.
    ///
    /// # Errors
    /// As [`Self::add`], or the posture is refused.
    pub fn add_live(&mut self, posture: &HandPosture) -> Result<(), CalibrationError> {
        for (finger, marker) in HumanFinger::ALL.into_iter().zip(posture.markers) {
            let Some(tip) = marker else { continue };
            let Ok((links, _)) = self.calibration.finger(finger).solve() else { continue };
            let found = links.tip(&FingerRotations::of(&posture.orientations, finger)?);
            let square = found.iter().zip(tip).map(|(a, b)| (a - b) * (a - b)).sum();
            let value = math::sqrt(square);
            if value > REDO {
                return Err(CalibrationError::Residual { finger, value, limit: REDO });
            }
        }
        self.add(posture)
    }

    /// Number of postures.
    pub const fn postures(&self) -> u32 {
        self.postures
    }

    /// Adds a posture in which the tip of the thumb touches that of a finger without a marker, after the
    /// postures that calibrate the thumb.
    ///
    /// # Errors
    /// The thumb is not calibrated yet, or orientations cannot be used. Nothing is added.
    pub fn touch(&mut self, finger: HumanFinger, orientations: &GloveSample) -> Result<(), CalibrationError> {
        self.calibration.add_touch(finger, orientations, TOUCH)
    }

    /// Returns links and accuracy so far; `None` for a finger with too few postures.
    pub fn estimates(&self) -> [Option<(FingerLinks, CalibrationAccuracy)>; HUMAN_FINGERS] {
        HumanFinger::ALL.map(|finger| self.calibration.finger(finger).estimate().ok())
    }

    /// Returns the next instruction for the person; `None` if all fingers with markers are calibrated.
    pub fn instruction(&self) -> Option<String> {
        if let Some(first) = FIRST_POSTURES.get(self.postures as usize) {
            return Some((*first).to_owned());
        }
        let estimates = self.estimates();
        let marked = self.marked.iter().zip(estimates).filter(|(marked, _)| **marked);
        let weakest = marked
            .filter_map(|(_, estimate)| estimate)
            .max_by(|(_, one), (_, other)| one.tip_deviation.total_cmp(&other.tip_deviation));
        match weakest {
            Some((_, accuracy)) if accuracy.tip_deviation > MAX_TIP_DEVIATION => {
                Some(accuracy.weakest.to_string())
            }
            Some(_) if self.postures >= MIN_POSTURES => None,
            _ => Some("take any posture unlike the others".to_owned()),
        }
    }

    /// Returns the calibration. With `proportions`, fingers without a marker are inferred.
    ///
    /// # Errors
    /// A finger is not calibrated; the error says why.
    pub fn finish(
        &self,
        proportions: bool,
    ) -> Result<[(FingerLinks, CalibrationAccuracy); HUMAN_FINGERS], CalibrationError> {
        match &self.flat {
            Some(flat) if proportions => self.calibration.solve_with_proportions(flat),
            _ => self.calibration.solve(),
        }
    }
}

/// Calibration file of one operator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatorFile {
    /// The person.
    pub operator: String,
    /// The thumb (I).
    pub thumb: FingerEntry,
    /// The index finger (II).
    pub index: FingerEntry,
    /// The middle finger (III).
    pub middle: FingerEntry,
    /// The ring finger (IV).
    pub ring: FingerEntry,
    /// The little finger (V).
    pub little: FingerEntry,
}

/// A finger in a calibration file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerEntry {
    /// `l0` to `l3` [m].
    pub links: FingerLinks,
    /// Number of postures that showed its marker; 0 for a finger that was inferred.
    pub postures: u32,
    /// Standard deviation of the predicted tip [m].
    pub tip_deviation: f32,
}

impl OperatorFile {
    /// Creates the file of a calibration.
    pub fn new(operator: &str, solved: &[(FingerLinks, CalibrationAccuracy); HUMAN_FINGERS]) -> Self {
        let [thumb, index, middle, ring, little] = solved.map(|(links, accuracy)| FingerEntry {
            links,
            postures: accuracy.postures,
            tip_deviation: accuracy.tip_deviation,
        });
        Self { operator: operator.to_owned(), thumb, index, middle, ring, little }
    }

    /// Returns the links, thumb to little finger.
    pub const fn links(&self) -> [FingerLinks; HUMAN_FINGERS] {
        [self.thumb.links, self.index.links, self.middle.links, self.ring.links, self.little.links]
    }

    /// Formats the file as TOML.
    pub fn to_toml(&self) -> String {
        let name = self.operator.replace('\\', "\\\\").replace('"', "\\\"").replace(char::is_control, " ");
        let mut text =
            format!("# Written by `tesaki calibrate`. Links l0 to l3 [m].\noperator = \"{name}\"\n");
        let entries = [&self.thumb, &self.index, &self.middle, &self.ring, &self.little];
        for (finger, FingerEntry { links, postures, tip_deviation }) in
            HumanFinger::ALL.into_iter().zip(entries)
        {
            let _ = write!(text, "\n[{}]\nlinks = [\n", finger.name());
            for [x, y, z] in links.0 {
                let _ = writeln!(text, "    [{x:.6}, {y:.6}, {z:.6}],");
            }
            let _ = write!(text, "]\npostures = {postures}\ntip_deviation = {tip_deviation:.6} # [m]\n");
        }
        text
    }
}
