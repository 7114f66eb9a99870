//! The operator's fingertips from the frames of any source.

use core::f32::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};
use tesaki::OutOfRange;
use tesaki::kinematics::MAX_FINGERS;
use tesaki::task::telexistence::FingertipPoint;
use tesaki::teleop::{
    GloveError, GloveFilter, GloveFilterState, GloveSample, GloveSensor, HUMAN_FINGERS, HumanFinger,
    HumanHand, OperatorFingertips,
};
use tesaki_description::retargeting::Side;

use super::error::FrameError;
use super::fingertips::{PointFilter, Tip, check};
use super::landmarks::Landmarks;
use super::palm::PalmFrame;

/// A source's observation of the hand at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Observation {
    /// Orientations of a glove's sensors.
    Glove(GloveSample),
    /// Landmarks of a webcam tracker; `None` while it sees no hand.
    Landmarks(Option<Landmarks>),
    /// Fingertips in the frame of the hand [m], thumb to little finger; `None` for one that is not visible.
    Fingertips([Option<[f32; 3]>; HUMAN_FINGERS]),
}

/// The wearer of a glove.
#[derive(Clone, Copy, Debug)]
pub struct Wearer {
    hand: HumanHand,
    palm: PalmFrame,
}

impl Wearer {
    /// Creates the person with these links. Their knuckles determine the orientation of the sensor on the
    /// back of the hand, which is on this `side`. `None` for a hand whose knuckles are collinear.
    pub fn try_new(hand: HumanHand, side: Side) -> Option<Self> {
        let [thumb, index, middle, ring, little] =
            HumanFinger::ALL.map(|finger| Some(Vector3::from(hand.links(finger).0[0])));
        Some(Self { hand, palm: PalmFrame::fit(side, &[None, thumb, index, middle, ring, little])? })
    }
}

/// Settings of a [`Tracker`].
#[derive(Clone, Copy, Debug)]
pub struct TrackerSettings {
    /// The operator's hand.
    pub side: Side,
    /// Rotation from the operator's hand frame to the robot's base frame.
    pub rotation: UnitQuaternion<f32>,
    /// Bandwidth of the filters [Hz].
    pub bandwidth: f32,
    /// A fingertip that is not visible for longer is unknown, and its filter is restarted [s].
    pub max_gap: f32,
    /// The wearer of the glove, for [`Observation::Glove`].
    pub wearer: Option<Wearer>,
}

/// The operator's fingertips in the robot's base frame, thumb to little finger.
pub type Fingertips = [Option<FingertipPoint>; MAX_FINGERS];

/// Shortest time between frames [s].
const MIN_PERIOD: f64 = 1e-6;

/// Checks and filters the frames of a source.
#[derive(Clone, Debug)]
pub struct Tracker {
    settings: TrackerSettings,
    glove_filter: GloveFilter,
    /// Time of the last frame [s].
    time: Option<f64>,
    glove: GloveFilterState,
    points: [Option<PointFilter>; HUMAN_FINGERS],
    gaps: u32,
}

impl Tracker {
    /// Creates a tracker without frames.
    ///
    /// # Errors
    /// The bandwidth is not 0.16 to 159 Hz.
    pub fn try_new(settings: TrackerSettings) -> Result<Self, OutOfRange> {
        Ok(Self {
            settings,
            glove_filter: GloveFilter::try_new(TAU * settings.bandwidth, 0.0, 0.1)?,
            time: None,
            glove: GloveFilterState::default(),
            points: [None; HUMAN_FINGERS],
            gaps: 0,
        })
    }

    /// Begins anew with the next frame: the times of those so far do not count any more.
    pub fn restart(&mut self) {
        (self.time, self.glove, self.points) = (None, GloveFilterState::default(), [None; HUMAN_FINGERS]);
        self.gaps += 1;
    }

    /// Number of gaps between frames that were too long to be bridged.
    pub const fn gaps(&self) -> u32 {
        self.gaps
    }

    /// Adds the frame of a time [s]; returns the fingertips.
    ///
    /// # Errors
    /// The frame cannot belong to the operator's hand. It is ignored, so that the next one may be valid.
    #[expect(clippy::cast_possible_truncation, reason = "a period")]
    pub fn add(&mut self, time: f64, observation: &Observation) -> Result<Fingertips, FrameError> {
        if !time.is_finite() {
            return Err(FrameError::NotFinite("the time".to_owned()));
        }
        if let Some(before) = self.time
            && time - before < MIN_PERIOD
        {
            return Err(FrameError::Time { time, before });
        }
        let max_gap = match observation {
            Observation::Glove(_) => self.settings.max_gap.min(GloveFilter::MAX_PERIOD),
            _ => self.settings.max_gap,
        };
        let max_gap = f64::from(max_gap);
        let gap = self.time.map(|before| time - before);
        let has_gap = gap.is_some_and(|gap| gap > max_gap);
        let points = match observation {
            Observation::Glove(sample) => {
                let state = if has_gap { GloveFilterState::default() } else { self.glove };
                // The period of the first sample has no effect.
                let period = gap.filter(|_| !has_gap).unwrap_or(0.01) as f32;
                self.of_glove(state, period, sample)?
            }
            Observation::Landmarks(None) => [None; HUMAN_FINGERS],
            Observation::Landmarks(Some(landmarks)) => {
                self.filter(time, &landmarks.fingertips(self.settings.side)?)?
            }
            Observation::Fingertips(tips) => {
                let tip = |tip: [f32; 3]| Tip { position: Vector3::from(tip), direction: None };
                self.filter(time, &tips.map(|given| given.map(tip)))?
            }
        };
        self.time = Some(time);
        self.gaps += u32::from(has_gap);
        let turn = |vector: [f32; 3]| <[f32; 3]>::from(self.settings.rotation * Vector3::from(vector));
        Ok(points.map(|point| {
            point.map(|point| FingertipPoint {
                position: turn(point.position),
                velocity: turn(point.velocity),
                direction: point.direction.map(turn),
            })
        }))
    }

    /// Computes the fingertips of a glove from the model of its wearer's hand.
    fn of_glove(
        &mut self,
        mut state: GloveFilterState,
        period: f32,
        sample: &GloveSample,
    ) -> Result<Fingertips, FrameError> {
        // A missing sample of a sensor is bridged; an invalid one makes the frame invalid.
        for sensor in GloveSensor::all() {
            match sample.orientation(sensor) {
                Ok(_) | Err(GloveError::Missing(_)) => {}
                Err(error) => return Err(error.into()),
            }
        }
        let Some(Wearer { hand, palm }) = self.settings.wearer else { return Ok([None; HUMAN_FINGERS]) };
        match self.glove_filter.update(&mut state, period, sample) {
            Ok(()) | Err(GloveError::Missing(_)) => {}
            Err(error) => return Err(error.into()),
        }
        let in_palm = |[x, y, z]: [f32; 3]| <[f32; 3]>::from(palm.vector(&Vector3::new(x, y, z)));
        let points = hand.fingertips(&state).map(|tip| {
            tip.ok().map(|tip| FingertipPoint {
                position: palm.position(&Vector3::from(tip.position)).into(),
                velocity: in_palm(tip.velocity),
                direction: Some(in_palm(tip.direction)),
            })
        });
        let tip = |point: FingertipPoint| Tip { position: Vector3::from(point.position), direction: None };
        check(self.settings.side, &points.map(|point| point.map(tip)))?;
        self.glove = state;
        Ok(points)
    }

    /// Checks and filters fingertips.
    fn filter(&mut self, time: f64, tips: &[Option<Tip>; HUMAN_FINGERS]) -> Result<Fingertips, FrameError> {
        check(self.settings.side, tips)?;
        let mut points = [None; HUMAN_FINGERS];
        for ((point, tip), filter) in points.iter_mut().zip(tips).zip(&mut self.points) {
            let Some(Tip { position, direction }) = tip else { continue };
            match filter {
                Some(filter) if time - filter.time <= f64::from(self.settings.max_gap) => {
                    filter.correct(time, position, TAU * self.settings.bandwidth);
                }
                _ => *filter = Some(PointFilter::at(time, *position)),
            }
            *point = filter.as_ref().map(|filter| FingertipPoint {
                position: filter.position.into(),
                velocity: filter.velocity.into(),
                direction: direction.map(Into::into),
            });
        }
        Ok(points)
    }
}

/// Converts fingertips for the retargeting.
pub fn operator_fingertips(tips: &Fingertips) -> OperatorFingertips {
    OperatorFingertips {
        positions: tips.map(|tip| tip.map(|tip| Vector3::from(tip.position))),
        directions: tips.map(|tip| tip.and_then(|tip| tip.direction).map(Vector3::from)),
    }
}
