//! Calibration of simulated hands, and the resulting accuracy of the vectors from the thumb's tip to the
//! other fingertips (Hand5 section 3.1).

use rapier3d::na::Vector3;
use tesaki::teleop::{
    CalibrationAccuracy, CalibrationError, CalibrationSettings, GloveFilter, GloveFilterState, GloveSample,
    HUMAN_FINGERS, HumanFinger, HumanHand, InvalidLink,
};
use tesaki_supervisor::operator::{CalibrationGuide, HandPosture, mean_orientations};

use super::glove::{FingersMotion, FingertipMarkers, Glove, GloveValues, OperatorHand};

/// The direction of a vector is evaluated only above this length [m].
pub(crate) const MIN_DISTANCE: f64 = 0.025;
/// Time for which a posture is held [s], and range of the time to the next.
const HOLD: f64 = 1.0;
const MOVEMENT: [f64; 2] = [0.8, 1.2];
/// Noise of a posture that is averaged over [`HOLD`], relative to that of a sample: `1/√(π B t)` for a
/// Gauss-Markov process with bandwidth `B`.
const POSE_NOISE: f64 = 0.178;

/// Plan of a hand's calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationPlan {
    /// Number of postures after the flat hand.
    pub postures: usize,
    /// The fingers with a marker.
    pub marked: [bool; HUMAN_FINGERS],
    /// Number of times that the thumb touches each finger without a marker.
    pub touches: usize,
}

impl CalibrationPlan {
    /// A marker on every finger; takes two minutes.
    pub const FULL: Self = Self { postures: 60, marked: [true; HUMAN_FINGERS], touches: 0 };
    /// Markers on thumb, index and little finger; takes less than two minutes. The others follow from the
    /// proportions of the hand, and from six touches of the thumb with each.
    pub const QUICK: Self = Self { postures: 40, marked: [true, true, false, false, true], touches: 6 };
}

/// Mean and standard deviation of a vector's errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VectorError {
    /// Number of instants with the tips at least 25 mm apart.
    pub count: u32,
    /// Error of its length [m].
    pub length: [f64; 2],
    /// Angle between the estimated and the true vector [rad].
    pub direction: [f64; 2],
}

impl VectorError {
    /// Computes the errors of pairs of an estimated and a true vector.
    pub fn of(pairs: impl Iterator<Item = [Vector3<f64>; 2]> + Clone) -> Self {
        let pairs = pairs.filter(|[_, truth]| truth.norm() >= MIN_DISTANCE);
        let statistics = |values: &mut dyn Iterator<Item = f64>| {
            let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
            for value in values {
                (count, sum, squares) = (count + 1.0, sum + value, squares + value * value);
            }
            let mean = sum / count;
            [mean, libm::sqrt((squares / count - mean * mean).max(0.0))]
        };
        Self {
            count: pairs.clone().count() as u32,
            length: statistics(&mut pairs.clone().map(|[found, truth]| found.norm() - truth.norm())),
            direction: statistics(&mut pairs.map(|[found, truth]| found.angle(&truth))),
        }
    }
}

/// Result of a trial.
#[derive(Clone, Debug)]
pub struct CalibrationTrial {
    /// Duration of the postures [s].
    pub time: f64,
    /// Accuracy of each finger.
    pub accuracy: [CalibrationAccuracy; HUMAN_FINGERS],
    /// Estimated and true vectors from the thumb's tip to the tips of index to little finger [m], one pair
    /// per sample.
    pub vectors: [Vec<[Vector3<f64>; 2]>; 4],
    /// Times at which the index finger's vectors were estimated [s].
    pub times: Vec<f64>,
    /// Delay that best explains the estimated vectors [s].
    pub delay: f64,
}

/// Why a trial failed.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The calibration was refused.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The links do not form a hand.
    #[error(transparent)]
    Link(#[from] InvalidLink),
}

/// A calibrated hand.
#[derive(Clone, Debug)]
pub struct Calibrated {
    /// Its links.
    pub human: HumanHand,
    /// Accuracy of each finger.
    pub accuracy: [CalibrationAccuracy; HUMAN_FINGERS],
    /// Duration of the postures [s].
    pub time: f64,
}

/// Calibrates the hand of a seed.
///
/// # Errors
/// The calibration was refused.
pub fn calibrate(plan: &CalibrationPlan, values: GloveValues, seed: u64) -> Result<Calibrated, TrialError> {
    let (postures, time) = postures(plan, values, seed);
    let settings = CalibrationSettings {
        orientation_noise: (GloveValues::default().noise * POSE_NOISE) as f32,
        ..CalibrationSettings::DEFAULT
    };
    let mut guide = CalibrationGuide::try_new(&settings)?;
    postures.iter().try_for_each(|posture| guide.add(posture))?;
    let (touches, touch_time) = touches(plan, values, seed);
    touches.iter().try_for_each(|(finger, orientations)| guide.touch(*finger, orientations))?;
    let solved = guide.finish(true)?;
    let human = HumanHand::try_new(solved.map(|(links, _)| links))?;
    Ok(Calibrated { human, accuracy: solved.map(|(_, accuracy)| accuracy), time: time + touch_time })
}

/// Calibrates the hand of a seed and lets it move for `duration` [s].
///
/// # Errors
/// The calibration was refused.
pub fn run(
    plan: &CalibrationPlan,
    values: GloveValues,
    filter: GloveFilter,
    seed: u64,
    duration: f64,
) -> Result<CalibrationTrial, TrialError> {
    let hand = OperatorHand::random(seed);
    let Calibrated { human, accuracy, time } = calibrate(plan, values, seed)?;
    // Movements of about half a second, as in fast finger work.
    let count = libm::ceil(duration / 0.75) as usize;
    let motion = FingersMotion::random(&hand, seed, 1, count, [0.4, 0.9], 0.1);
    let mut glove = Glove::new(values, seed.wrapping_add(1 << 32));
    let mut state = GloveFilterState::default();
    let mut vectors = [const { Vec::new() }; 4];
    let mut times = Vec::new();
    loop {
        let (time, sample) = glove.sample(&hand, &motion);
        if time >= duration {
            break;
        }
        // A missing sample of a sensor is bridged.
        let _ = filter.update(&mut state, (1.0 / values.rate) as f32, &sample);
        let tips = human.fingertips(&state);
        let Ok(thumb) = tips[0] else { continue };
        let truth = true_vectors(&hand, &motion, time - f64::from(filter.delay()));
        for (number, tip) in tips[1..].iter().enumerate() {
            // A tip is missing until all its sensors have given a sample.
            let Ok(tip) = tip else { continue };
            vectors[number].push([position(tip.position) - position(thumb.position), truth[number]]);
            if number == 0 {
                times.push(time);
            }
        }
    }
    let delay = best_delay(&hand, &motion, &times, &vectors[0]);
    Ok(CalibrationTrial { time, accuracy, vectors, times, delay })
}

/// Returns the postures of a calibration, each averaged over the time for which it is held, and their
/// duration [s]. The first one is the flat hand.
pub fn postures(plan: &CalibrationPlan, values: GloveValues, seed: u64) -> (Vec<HandPosture>, f64) {
    let hand = OperatorHand::random(seed);
    let motion = FingersMotion::random(&hand, seed, 0, plan.postures, MOVEMENT, HOLD);
    let mut markers = FingertipMarkers::new(seed);
    let means = held(&hand, &motion, &mut Glove::new(values, seed)).into_iter().zip(motion.holds());
    let postures = means.map(|(orientations, [begin, end])| {
        let mut seen = markers.measure(&hand, &motion.at(0.5 * (begin + end)).1);
        seen.iter_mut().zip(plan.marked).for_each(|(seen, marked)| *seen = seen.filter(|_| marked));
        HandPosture { orientations, markers: seen }
    });
    (postures.collect(), motion.duration())
}

/// Returns the touches of the thumb with fingers without a marker, and their duration [s]. The fingertips
/// miss each other by up to about 2 mm along each axis.
pub fn touches(
    plan: &CalibrationPlan,
    values: GloveValues,
    seed: u64,
) -> (Vec<(HumanFinger, GloveSample)>, f64) {
    let hand = OperatorHand::random(seed);
    let unmarked = HumanFinger::ALL.into_iter().zip(plan.marked).filter(|(_, marked)| !marked);
    let fingers = unmarked.flat_map(|(finger, _)| std::iter::repeat_n(finger, plan.touches));
    let fingers: Vec<HumanFinger> = fingers.collect();
    let motion = FingersMotion::pinches(&hand, seed, &fingers, MOVEMENT[1], HOLD);
    let means = held(&hand, &motion, &mut Glove::new(values, seed.wrapping_add(2 << 32)));
    let time = if fingers.is_empty() { 0.0 } else { motion.duration() };
    (fingers.into_iter().zip(means.into_iter().skip(1)).collect(), time)
}

/// Returns the mean orientations of each held posture.
fn held(hand: &OperatorHand, motion: &FingersMotion, glove: &mut Glove) -> Vec<GloveSample> {
    let mut next = glove.sample(hand, motion);
    let means = motion.holds().map(|[begin, end]| {
        let mut samples = Vec::new();
        while next.0 < end {
            if next.0 >= begin {
                samples.push(next.1);
            }
            next = glove.sample(hand, motion);
        }
        mean_orientations(&samples)
    });
    means.collect()
}

fn position(position: [f32; 3]) -> Vector3<f64> {
    Vector3::from(position.map(f64::from))
}

fn true_vectors(hand: &OperatorHand, motion: &FingersMotion, time: f64) -> [Vector3<f64>; 4] {
    let (_, angles) = motion.at(time);
    let tips: [Vector3<f64>; HUMAN_FINGERS] =
        core::array::from_fn(|number| hand.finger(HumanFinger::ALL[number], &angles[number]).1);
    core::array::from_fn(|number| tips[number + 1] - tips[0])
}

/// Returns the delay of the true motion with the least squared error, in steps of a millisecond from −20 to
/// 60 ms.
fn best_delay(
    hand: &OperatorHand,
    motion: &FingersMotion,
    times: &[f64],
    vectors: &[[Vector3<f64>; 2]],
) -> f64 {
    let cost = |delay: f64| -> f64 {
        let pairs = times.iter().zip(vectors).step_by(7);
        pairs
            .map(|(time, [found, _])| (found - true_vectors(hand, motion, time - delay)[0]).norm_squared())
            .sum()
    };
    let delays = (-20..=60).map(|step| 1e-3 * f64::from(step));
    let best = delays.map(|delay| (cost(delay), delay)).min_by(|one, other| one.0.total_cmp(&other.0));
    best.map_or(f64::NAN, |(_, delay)| delay)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Returns the errors of the vectors from the thumb to the other fingers on the development machines, and
    /// the duration of the calibration [s].
    fn errors(plan: &CalibrationPlan, filter: GloveFilter) -> ([VectorError; 4], f64) {
        let mut all = [const { Vec::new() }; 4];
        let mut time = 0.0_f64;
        for seed in 1..=20 {
            let trial = run(plan, GloveValues::default(), filter, seed, 30.0).unwrap();
            assert!((trial.delay - f64::from(filter.delay())).abs() < 4e-3, "{seed}: {}", trial.delay);
            time = time.max(trial.time);
            all.iter_mut().zip(trial.vectors).for_each(|(all, vectors)| all.extend(vectors));
        }
        (all.map(|vectors| VectorError::of(vectors.into_iter())), time)
    }

    /// Results of the paper: 0.9 ± 3.8 mm, 2.4 ± 1.6° (Hand5 section 3.1).
    #[test]
    fn a_calibrated_hand_measures_the_vectors_between_its_tips_better_than_the_paper() {
        for (error, finger) in errors(&CalibrationPlan::FULL, GloveFilter::SMOOTH).0.iter().zip(1..) {
            println!("{finger}: {error:?}");
            assert!(error.count > 30_000, "{finger}: {error:?}");
            let [mean, deviation] = error.length;
            assert!(mean.abs() < 0.9e-3 && deviation < 2e-3, "{finger}: {error:?}");
            let [mean, deviation] = error.direction.map(f64::to_degrees);
            assert!(mean < 1.4 && deviation < 1.0, "{finger}: {mean} {deviation}");
        }
    }

    #[test]
    fn three_markers_and_two_minutes_are_enough() {
        let (errors, time) = errors(&CalibrationPlan::QUICK, GloveFilter::SMOOTH);
        println!("{time} s {errors:?}");
        assert!(time < 120.0, "{time} s");
        let [index, middle, ring, little] = errors.map(|error| error.length[1]);
        assert!(index < 2e-3 && little < 2e-3, "{index} {little}");
        assert!(middle < 3e-3 && ring < 3e-3, "{middle} {ring}");
    }
}
