//! Fingertips in the frame of the operator's hand: plausibility and velocity.

use nalgebra::Vector3;
use tesaki::teleop::{HUMAN_FINGERS, HumanFinger};
use tesaki_description::retargeting::Side;

use super::error::FrameError;
use super::palm::thumbward;

/// Sizes of hands relative to the mean adult's: from children aged six to the largest adults, including the
/// errors of trackers.
const SIZE: [f32; 2] = [0.55, 1.5];
/// Median distance of the fingertips from the wrist [m]: from a small fist to a large flat hand.
const MEDIAN: [f32; 2] = [0.028, 0.255];
/// Largest distance of a tip from the wrist [m]: thumb, other fingers.
const REACH: [f32; 2] = [0.17, 0.26];
/// Largest distance by which a tip may be on the thumb's side of the previous finger's tip [m]: crossed
/// fingers.
const CROSSED: f32 = 0.015;
/// Distance of the little finger on the thumb's side of the index finger that shows a reversed order [m].
const REVERSED: f32 = 0.01;
/// Mean distance of the tips behind the back of the hand [m]: fingers bent backwards by about 30°.
const BEHIND: f32 = 0.045;

/// A fingertip of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// Position [m].
    pub position: Vector3<f32>,
    /// Unit vector along the last bone.
    pub direction: Option<Vector3<f32>>,
}

/// Units in which positions may be given by mistake, and their length [m].
const UNITS: [(&str, f32); 4] = [("dm", 0.1), ("inches", 0.0254), ("cm", 0.01), ("mm", 0.001)];

/// Checks a length that depends on the size of a hand; the error names the units with which it would be
/// plausible.
fn check_length(what: &'static str, value: f32, [min, max]: [f32; 2]) -> Result<(), FrameError> {
    let fits = |unit: f32| (min..=max).contains(&(unit * value));
    if fits(1.0) {
        return Ok(());
    }
    let units: Vec<&str> = UNITS.iter().filter(|(_, unit)| fits(*unit)).map(|(name, _)| *name).collect();
    let hint = match units.as_slice() {
        [] => "send positions in metres, not in the picture".to_owned(),
        units => format!("send positions in metres; a hand would have this in {}", units.join(" or in ")),
    };
    Err(FrameError::Size { what, value, min, max, hint })
}

/// Checks the size of a palm relative to the mean one.
pub(super) fn check_size(size: f32) -> Result<(), FrameError> {
    check_length("the size of the palm relative to the mean of adults", size, SIZE)
}

/// Checks that fingers lie side by side. `sides` is the distance of each towards the side of the thumb [m].
pub(super) fn check_order(
    sides: &[Option<f32>; HUMAN_FINGERS],
    what: &'static str,
    limit: f32,
) -> Result<(), FrameError> {
    let known = || {
        HumanFinger::ALL.into_iter().zip(sides).skip(1).filter_map(|(finger, side)| Some((finger, (*side)?)))
    };
    for ((neighbour, before), (finger, side)) in known().zip(known().skip(1)) {
        let beyond = side - before;
        if beyond > limit {
            return Err(FrameError::Order { finger, neighbour, what, beyond, limit });
        }
    }
    Ok(())
}

/// Checks that fingertips can belong to a hand of this `side`.
pub(super) fn check(side: Side, tips: &[Option<Tip>; HUMAN_FINGERS]) -> Result<(), FrameError> {
    let known = || {
        HumanFinger::ALL.into_iter().zip(tips).filter_map(|(finger, tip)| Some((finger, (*tip)?.position)))
    };
    if let Some((finger, _)) = known().find(|(_, tip)| !tip.iter().all(|x| x.is_finite())) {
        return Err(FrameError::NotFinite(format!("the tip of the {finger}")));
    }
    let mut distances: Vec<f32> = known().map(|(_, tip)| tip.norm()).collect();
    distances.sort_by(f32::total_cmp);
    let Some(&median) = distances.get(distances.len() / 2) else { return Ok(()) };
    check_length("the median distance of the fingertips from the wrist [m]", median, MEDIAN)?;
    for (finger, tip) in known() {
        let (distance, limit) = (tip.norm(), REACH[usize::from(finger != HumanFinger::Thumb)]);
        if distance > limit {
            return Err(FrameError::Reach { finger, distance, limit });
        }
    }
    let [_, fingers @ ..] = tips;
    let Some(fingers) = fingers.iter().copied().collect::<Option<Vec<Tip>>>() else { return Ok(()) };
    let side_of = |tip: &Tip| thumbward(side, tip.position.y);
    let reversed = side_of(&fingers[3]) - side_of(&fingers[0]) > REVERSED;
    let mean = -0.25 * fingers.iter().map(|tip| tip.position.x).sum::<f32>();
    match (reversed, mean > BEHIND) {
        (true, true) => Err(FrameError::Turned),
        (true, false) => Err(FrameError::Reversed { follows: side }),
        (false, true) => Err(FrameError::Behind { mean, limit: BEHIND }),
        (false, false) => check_order(&tips.map(|tip| tip.as_ref().map(side_of)), "tip", CROSSED),
    }
}

/// Observer of a fingertip's position and velocity with a double pole at the bandwidth `ω` (alpha-beta
/// filter). Position `(2ωs + ω²)/(s + ω)²`: no lag at constant velocity. Velocity `ω²s/(s + ω)²`: a lag of
/// 2/ω.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointFilter {
    /// Time of the last sample [s].
    pub time: f64,
    pub position: Vector3<f32>,
    /// Velocity [m/s].
    pub velocity: Vector3<f32>,
}

impl PointFilter {
    pub fn at(time: f64, position: Vector3<f32>) -> Self {
        Self { time, position, velocity: Vector3::zeros() }
    }

    /// Corrects the estimate by a sample; `bandwidth` in rad/s.
    #[expect(clippy::cast_possible_truncation, reason = "a period")]
    pub fn correct(&mut self, time: f64, position: &Vector3<f32>, bandwidth: f32) {
        let period = (time - self.time) as f32;
        let decay = tesaki::math::exp(-bandwidth * period);
        let predicted = self.position + self.velocity * period;
        let innovation = position - predicted;
        self.position = predicted + innovation * (1.0 - decay * decay);
        self.velocity += innovation * ((1.0 - decay) * (1.0 - decay) / period);
        self.time = time;
    }
}
