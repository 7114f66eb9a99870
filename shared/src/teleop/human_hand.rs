use core::fmt;

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::{OutOfRange, math};

/// Fingers of a hand, the thumb included.
pub const HUMAN_FINGERS: usize = 5;
/// Orientation sensors of a glove: one on the back of the hand, and three per finger.
pub const SENSORS: usize = 1 + 3 * HUMAN_FINGERS;
/// Maximum length of a link [m]; metacarpals are some 70 mm long.
const MAX_LINK: f32 = 0.3;
/// Shortest length of a finger's last link, which has a direction [m].
const MIN_LAST_LINK: f32 = 1e-3;
/// Deviation of a quaternion's norm and of a rotation matrix's columns from 1.
const UNIT_TOLERANCE: f32 = 0.01;
/// Time in which the estimated velocity of a sensor without samples falls by a factor of e [s].
const VELOCITY_MEMORY: f32 = 0.05;

/// A finger of the operator's hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[serde(rename_all = "snake_case")]
pub enum HumanFinger {
    /// I
    Thumb = 0,
    /// II
    Index = 1,
    /// III
    Middle = 2,
    /// IV
    Ring = 3,
    /// V
    Little = 4,
}

impl HumanFinger {
    /// From thumb to little finger.
    pub const ALL: [Self; HUMAN_FINGERS] = [Self::Thumb, Self::Index, Self::Middle, Self::Ring, Self::Little];

    /// Its name in tables and files.
    pub const fn name(self) -> &'static str {
        ["thumb", "index", "middle", "ring", "little"][self as usize]
    }
}

impl fmt::Display for HumanFinger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            ["thumb", "index finger", "middle finger", "ring finger", "little finger"][*self as usize],
        )
    }
}

/// An orientation sensor of the glove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GloveSensor {
    /// On the back of the hand.
    Back,
    /// On a segment of a finger: 0 next to the palm (for the thumb: the metacarpal), 2 at the tip.
    Segment(HumanFinger, u8),
}

impl GloveSensor {
    /// All of them: the back of the hand, then thumb to little finger, each from palm to tip.
    pub fn all() -> impl Iterator<Item = Self> {
        let segments = |finger| (0..3).map(move |segment| Self::Segment(finger, segment));
        core::iter::once(Self::Back).chain(HumanFinger::ALL.into_iter().flat_map(segments))
    }

    /// Its position in [`GloveSensor::all`].
    const fn index(self) -> usize {
        match self {
            Self::Back => 0,
            Self::Segment(finger, segment) => {
                1 + 3 * finger as usize + if segment < 3 { segment as usize } else { 2 }
            }
        }
    }
}

impl fmt::Display for GloveSensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Back => f.write_str("the back of the hand"),
            Self::Segment(finger, segment) => write!(f, "segment {} of the {finger}", segment + 1),
        }
    }
}

/// Why orientations cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GloveError {
    /// The sensor gave no sample, or has given none for too long.
    Missing(GloveSensor),
    /// A number is not finite.
    NotFinite(GloveSensor),
    /// The orientation is not a unit quaternion.
    NotUnit {
        /// The sensor.
        sensor: GloveSensor,
        /// Norm of its quaternion.
        norm: f32,
    },
    /// The time since the last sample is not within 0 to 1 s [s].
    Period(f32),
}

impl core::error::Error for GloveError {}

impl fmt::Display for GloveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing(sensor) => write!(f, "no orientation of {sensor}: check its connection"),
            Self::NotFinite(sensor) => {
                write!(f, "the orientation of {sensor} holds a number that is not finite")
            }
            Self::NotUnit { sensor, norm } => {
                write!(f, "the orientation of {sensor} is a quaternion of norm {norm}; it must be 1")
            }
            Self::Period(value) => {
                write!(f, "{value} s between samples; it must be above 0 s and at most 1 s")
            }
        }
    }
}

/// Orientations of all sensors at one time: unit quaternions x, y, z, w in one fixed frame. `None` where a
/// sensor gave no sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GloveSample {
    /// Orientation of the back of the hand.
    pub back: Option<[f32; 4]>,
    /// Orientations of the segments, thumb to little finger, each from palm to tip.
    pub segments: [[Option<[f32; 4]>; 3]; HUMAN_FINGERS],
}

impl GloveSample {
    /// The orientation of a sensor.
    ///
    /// # Errors
    /// No sample, a number that is not finite, or a quaternion whose norm differs from 1 by more than 0.01.
    pub fn orientation(&self, sensor: GloveSensor) -> Result<UnitQuaternion<f32>, GloveError> {
        let given = match sensor {
            GloveSensor::Back => self.back,
            GloveSensor::Segment(finger, segment) => {
                self.segments[finger as usize].get(usize::from(segment)).copied().flatten()
            }
        };
        let quaternion = math::quaternion(given.ok_or(GloveError::Missing(sensor))?);
        let norm = math::sqrt(quaternion.norm_squared());
        if !norm.is_finite() {
            return Err(GloveError::NotFinite(sensor));
        }
        if math::abs(norm - 1.0) > UNIT_TOLERANCE {
            return Err(GloveError::NotUnit { sensor, norm });
        }
        Ok(UnitQuaternion::new_unchecked(quaternion * (1.0 / norm)))
    }
}

/// Orientations of a finger's segments in the frame of the back of the hand: `R1`, `R1R2`, `R1R2R3` (Hand5
/// eq. 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerRotations(pub(super) [Matrix3<f32>; 3]);

impl FingerRotations {
    /// Computes them from the absolute orientations of the back of the hand and of the finger's segments.
    ///
    /// # Errors
    /// An orientation that is missing or cannot be used.
    pub fn of(sample: &GloveSample, finger: HumanFinger) -> Result<Self, GloveError> {
        let back = sample.orientation(GloveSensor::Back)?.inverse();
        let segment = |segment| {
            let absolute = sample.orientation(GloveSensor::Segment(finger, segment))?;
            Ok((back * absolute).to_rotation_matrix().into_inner())
        };
        Ok(Self([segment(0)?, segment(1)?, segment(2)?]))
    }

    /// Rotations of the joints, `R1`, `R2`, `R3`.
    pub(super) fn joints(&self) -> [Matrix3<f32>; 3] {
        let Self([first, second, third]) = self;
        [*first, first.transpose() * second, second.transpose() * third]
    }

    /// Computes them from the rotations of the joints.
    pub(super) fn from_joints([first, second, third]: [Matrix3<f32>; 3]) -> Self {
        let middle = first * second;
        Self([first, middle, middle * third])
    }

    /// `A = [I, R1, R1R2, R1R2R3]`: the tip is `A x`, where `x` holds the four links (Hand5 eq. 2).
    pub(super) fn regressor(&self) -> SMatrix<f32, 3, 12> {
        let mut regressor = SMatrix::<f32, 3, 12>::zeros();
        regressor.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        for (k, rotation) in self.0.iter().enumerate() {
            regressor.fixed_view_mut::<3, 3>(0, 3 * k + 3).copy_from(rotation);
        }
        regressor
    }
}

/// Link vectors `l0` … `l3` of a finger [m] (Hand5 eq. 1): `l0` from the origin to the first joint in the
/// frame of the back of the hand, each other in the frame of the sensor on its segment. They include the
/// mounting orientation of each sensor on its segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FingerLinks(pub [[f32; 3]; 4]);

impl FingerLinks {
    /// The tip `p = l0 + R1 l1 + R1R2 l2 + R1R2R3 l3` in the frame of the back of the hand [m] (Hand5 eq. 1).
    pub fn tip(&self, rotations: &FingerRotations) -> [f32; 3] {
        let [base, links @ ..] = self.0.map(Vector3::from);
        let tip = rotations.0.iter().zip(links).fold(base, |tip, (rotation, link)| tip + rotation * link);
        tip.into()
    }

    pub(super) fn from_vector(x: &nalgebra::SVector<f32, 12>) -> Self {
        Self(core::array::from_fn(|link| core::array::from_fn(|axis| x[3 * link + axis])))
    }
}

/// Shortest length of a link by its number [m].
const fn min_length(link: u8) -> f32 {
    if link == 3 { MIN_LAST_LINK } else { 0.0 }
}

/// A link that is implausible for a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InvalidLink {
    /// Its finger.
    pub finger: HumanFinger,
    /// Its number, 0 to 3.
    pub link: u8,
    /// Its length [m].
    pub length: f32,
}

impl core::error::Error for InvalidLink {}

impl fmt::Display for InvalidLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { finger, link, length } = self;
        let min = min_length(*link);
        write!(f, "link {link} of the {finger} is {length} m long; {min} to {MAX_LINK} m is a hand's")
    }
}

/// A fingertip in the frame of the back of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingertip {
    /// Position [m].
    pub position: [f32; 3],
    /// Unit vector along the last link.
    pub direction: [f32; 3],
    /// Velocity [m/s].
    pub velocity: [f32; 3],
}

/// Links of an operator's hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HumanHand {
    links: [FingerLinks; HUMAN_FINGERS],
}

impl HumanHand {
    /// A hand with these links, thumb to little finger.
    ///
    /// # Errors
    /// A link that is not finite or longer than 0.3 m, or a last link of no length, which has no direction.
    pub fn try_new(links: [FingerLinks; HUMAN_FINGERS]) -> Result<Self, InvalidLink> {
        for (finger, of_finger) in HumanFinger::ALL.into_iter().zip(&links) {
            for (link, number) in of_finger.0.iter().zip(0..) {
                let length = math::norm(&Vector3::from(*link));
                if !(min_length(number)..=MAX_LINK).contains(&length) {
                    return Err(InvalidLink { finger, link: number, length });
                }
            }
        }
        Ok(Self { links })
    }

    /// Links of a finger.
    pub const fn links(&self, finger: HumanFinger) -> &FingerLinks {
        &self.links[finger as usize]
    }

    /// Fingertips, thumb to little finger, from orientations that [`GloveFilter`] has filtered (Hand5 eq. 1).
    ///
    /// # Errors
    /// For each finger: its sensor, or that of the back of the hand, that has given no sample for too long.
    pub fn fingertips(&self, state: &GloveFilterState) -> [Result<Fingertip, GloveError>; HUMAN_FINGERS] {
        HumanFinger::ALL.map(|finger| self.fingertip(state, finger))
    }

    fn fingertip(&self, state: &GloveFilterState, finger: HumanFinger) -> Result<Fingertip, GloveError> {
        let tracked = |sensor: GloveSensor| state.sensors[sensor.index()].ok_or(GloveError::Missing(sensor));
        let back = tracked(GloveSensor::Back)?;
        let [base, links @ ..] = self.links[finger as usize].0.map(Vector3::from);
        let (mut arm, mut velocity, mut last) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for (link, segment) in links.iter().zip(0..) {
            let segment = tracked(GloveSensor::Segment(finger, segment))?;
            last = segment.output * link;
            arm += last;
            velocity += (segment.velocity - back.velocity).cross(&last);
        }
        let into_back = back.output.inverse();
        // `try_new` made the last link at least 1 mm long.
        let direction = into_back * last * (1.0 / math::norm(&last));
        Ok(Fingertip {
            position: (base + into_back * arm).into(),
            direction: direction.into(),
            velocity: (into_back * velocity).into(),
        })
    }
}

/// Low-pass filter of each of the glove's orientations: a critically damped observer of orientation and
/// angular velocity with bandwidth `ω`, whose output is the orientation `d` before the sample,
/// `(2ωs + ω² − dω²s)/(s + ω)²`. A constant angular velocity is delayed by exactly `d`. A longer delay passes
/// less noise: with `d = 1/ω` it is a first-order low-pass filter, with `2/ω` two of them in series. A
/// missing sample is bridged for a limited time with the last angular velocity, which decays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GloveFilter {
    bandwidth: f32,
    delay: f32,
    hold: f32,
}

impl GloveFilter {
    /// 5 Hz without delay; bridges a tenth of a second.
    pub const PROMPT: Self = Self { bandwidth: 5.0 * core::f32::consts::TAU, delay: 0.0, hold: 0.1 };
    /// 5 Hz and a delay of 1/ω, 32 ms; bridges a tenth of a second.
    pub const SMOOTH: Self = Self { delay: 1.0 / Self::PROMPT.bandwidth, ..Self::PROMPT };

    /// A filter with the `bandwidth` `ω` [rad/s], 1 to 1000, and the `delay` `d` [s], 0 to 2/ω, which bridges
    /// a sensor for at most the time `hold` [s], 0 to 1.
    ///
    /// # Errors
    /// The first value outside its range.
    pub fn try_new(bandwidth: f32, delay: f32, hold: f32) -> Result<Self, OutOfRange> {
        OutOfRange::check("bandwidth of the glove's filter", bandwidth, [1.0, 1000.0])?;
        OutOfRange::check("delay of the glove's filter", delay, [0.0, 2.0 / bandwidth])?;
        OutOfRange::check("time for which a sensor is bridged", hold, [0.0, 1.0])?;
        Ok(Self { bandwidth, delay, hold })
    }

    /// Its delay `d` [s].
    pub const fn delay(&self) -> f32 {
        self.delay
    }

    /// Longest time between two samples; after a longer one, a new state begins [s].
    pub const MAX_PERIOD: f32 = 1.0;

    /// Updates the state with a sample that comes `period` [s] after the previous one. Returns the error of
    /// the first sensor whose sample could not be used; the sensor is bridged, and all others are filtered.
    ///
    /// # Errors
    /// The error of a sensor, as above, or a period that is not above 0 and at most [`Self::MAX_PERIOD`]; the
    /// state is then unchanged.
    pub fn update(
        &self,
        state: &mut GloveFilterState,
        period: f32,
        sample: &GloveSample,
    ) -> Result<(), GloveError> {
        if !(period > 0.0 && period <= Self::MAX_PERIOD) {
            return Err(GloveError::Period(period));
        }
        let decay = math::exp(-self.bandwidth * period);
        let mut result = Ok(());
        for (sensor, tracked) in GloveSensor::all().zip(&mut state.sensors) {
            match (sample.orientation(sensor), tracked.as_mut()) {
                (Ok(measured), None) => *tracked = Some(Tracked::at(measured)),
                (Ok(measured), Some(tracked)) => tracked.correct(&measured, period, decay),
                (Err(error), present) => {
                    result = result.and(Err(error));
                    if let Some(present) = present
                        && !present.bridge(period, self.hold)
                    {
                        *tracked = None;
                    }
                }
            }
            if let Some(tracked) = tracked {
                tracked.output = math::rotated_by(&tracked.rotation, &(tracked.velocity * -self.delay));
            }
        }
        result
    }
}

/// State of a [`GloveFilter`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GloveFilterState {
    /// In the order of [`GloveSensor::all`]; `None` before the first sample and after too long a gap.
    sensors: [Option<Tracked>; SENSORS],
}

/// Estimate of one sensor's motion, in the fixed frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tracked {
    rotation: UnitQuaternion<f32>,
    /// [rad/s]
    velocity: Vector3<f32>,
    /// Time since the last sample [s].
    gap: f32,
    /// The output: the estimated orientation of `delay` ago.
    output: UnitQuaternion<f32>,
}

impl Tracked {
    fn at(rotation: UnitQuaternion<f32>) -> Self {
        Self { rotation, velocity: Vector3::zeros(), gap: 0.0, output: rotation }
    }

    /// Updates the estimate: alpha-beta filter with a double pole at `decay`.
    fn correct(&mut self, measured: &UnitQuaternion<f32>, period: f32, decay: f32) {
        let predicted = math::rotated_by(&self.rotation, &(self.velocity * period));
        let innovation = math::rotation_between(&predicted, measured);
        self.rotation = math::rotated_by(&predicted, &(innovation * (1.0 - decay * decay)));
        self.velocity += innovation * ((1.0 - decay) * (1.0 - decay) / period);
        self.gap = 0.0;
    }

    /// Extrapolates a missing sample. Returns `false` if there was none for longer than `hold`.
    fn bridge(&mut self, period: f32, hold: f32) -> bool {
        self.gap += period;
        self.rotation = math::rotated_by(&self.rotation, &(self.velocity * period));
        self.velocity *= math::exp(-period / VELOCITY_MEMORY);
        self.gap <= hold
    }
}
