//! Calibration of simulated hands, and how well it then measures the vectors from the thumb's tip to the
//! other fingertips (Hand5 section 3.1).

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};
use tesaki::teleop::{
    CalibrationAccuracy, CalibrationError, CalibrationSettings, FINGERS, Finger, GloveFilter, GloveFilterState,
    GloveSample, HandCalibration, HumanHand, InvalidLink,
};

use super::glove::{FingersMotion, FingertipMarkers, Glove, GloveValues, OperatorHand};

/// Vectors shorter than this have no direction worth comparing [m].
const MIN_DISTANCE: f64 = 0.025;
/// How long a pose is held [s], and the range of the time to the next.
const HOLD: f64 = 1.0;
const MOVEMENT: [f64; 2] = [0.8, 1.2];
/// Noise of a pose that is the mean of [`HOLD`]: of a Gauss-Markov process with bandwidth `B`, `1/√(π B t)` of that
/// of a sample.
const POSE_NOISE: f64 = 0.178;

/// How a hand is calibrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationPlan {
    /// Number of poses after the flat hand.
    pub poses: usize,
    /// The fingers with a marker.
    pub marked: [bool; FINGERS],
}

impl CalibrationPlan {
    /// A marker on every finger: two minutes.
    pub const FULL: Self = Self { poses: 60, marked: [true; FINGERS] };
    /// Markers on thumb, index and little finger: 80 s. Proportions of the hand give the others.
    pub const QUICK: Self = Self { poses: 40, marked: [true, true, false, false, true] };
}

/// Mean and standard deviation of a vector's errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VectorError {
    /// Number of instants with the tips at least 25 mm apart.
    pub count: u32,
    /// Of its length [m].
    pub length: [f64; 2],
    /// Of the angle between the estimated and the true vector [rad].
    pub direction: [f64; 2],
}

impl VectorError {
    /// Of pairs of an estimated and a true vector.
    pub fn of(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone) -> Self {
        let pairs = pairs.filter(|(_, truth)| truth.norm() >= MIN_DISTANCE);
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
            length: statistics(&mut pairs.clone().map(|(found, truth)| found.norm() - truth.norm())),
            direction: statistics(&mut pairs.map(|(found, truth)| found.angle(&truth))),
        }
    }
}

/// What a trial gave.
#[derive(Clone, Debug)]
pub struct CalibrationTrial {
    /// Time that the poses took [s].
    pub time: f64,
    /// Of each finger.
    pub accuracy: [CalibrationAccuracy; FINGERS],
    /// Estimated and true vectors from the thumb's tip to the tips of index to little finger [m], one of each per
    /// sample.
    pub vectors: [Vec<(Vector3<f64>, Vector3<f64>)>; 4],
    /// Delay that explains the estimated vectors best [s].
    pub delay: f64,
}

/// Why a trial failed.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The calibration was refused.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// Its links are not a hand's.
    #[error(transparent)]
    Link(#[from] InvalidLink),
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
    let mut glove = Glove::new(values, seed);
    let (calibration, flat, time) = calibrate(&hand, &mut glove, plan, seed)?;
    let solved = calibration.solve_with_proportions(&flat)?;
    let human = HumanHand::try_new(solved.map(|(links, _)| links))?;
    // Half-second movements, as in fast finger work.
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
        // A sensor that gave no sample is bridged.
        let _ = filter.update(&mut state, (1.0 / values.rate) as f32, &sample);
        let tips = human.fingertips(&state);
        let Ok(thumb) = tips[0] else { continue };
        let truth = true_vectors(&hand, &motion, time - f64::from(filter.delay));
        let mut complete = true;
        for (number, tip) in tips[1..].iter().enumerate() {
            if let Ok(tip) = tip {
                let found = position(tip.position) - position(thumb.position);
                vectors[number].push((found, truth[number]));
            } else {
                complete = false;
            }
        }
        if complete {
            times.push(time);
        }
    }
    let delay = if times.len() == vectors[0].len() { best_delay(&hand, &motion, &times, &vectors[0]) } else { f64::NAN };
    Ok(CalibrationTrial { time, accuracy: solved.map(|(_, accuracy)| accuracy), vectors, delay })
}

/// Takes the poses: the calibration, the flat hand's orientations, and the time it took [s].
fn calibrate(
    hand: &OperatorHand,
    glove: &mut Glove,
    plan: &CalibrationPlan,
    seed: u64,
) -> Result<(HandCalibration, GloveSample, f64), TrialError> {
    let motion = FingersMotion::random(hand, seed, 0, plan.poses, MOVEMENT, HOLD);
    let mut markers = FingertipMarkers::new(seed);
    let noise = GloveValues::default().noise * POSE_NOISE;
    let settings = CalibrationSettings { orientation_noise: noise as f32, ..CalibrationSettings::DEFAULT };
    let mut calibration = HandCalibration::try_new(&settings)?;
    let (mut flat, mut held) = (None, Vec::new());
    let mut holds = motion.holds().peekable();
    while let Some([begin, end]) = holds.peek().copied() {
        let (time, sample) = glove.sample(hand, &motion);
        if time >= begin && time < end {
            held.push(sample);
        }
        if time >= end {
            holds.next();
            let pose = mean_sample(&held, plan);
            held.clear();
            let mut seen = markers.measure(hand, &motion.at(0.5 * (begin + end)).1);
            seen.iter_mut().zip(plan.marked).for_each(|(seen, marked)| *seen = seen.filter(|_| marked));
            flat.get_or_insert(pose);
            calibration.add_pose(&pose, &seen)?;
        }
    }
    Ok((calibration, flat.unwrap_or_default(), motion.duration()))
}

/// Mean orientations relative to the back of the hand, which is upright in the mean.
fn mean_sample(samples: &[GloveSample], _plan: &CalibrationPlan) -> GloveSample {
    let mean = |finger: usize, segment: usize| {
        let mut sum = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        for sample in samples {
            let (Some(back), Some(absolute)) = (sample.back, sample.segments[finger][segment]) else { continue };
            let relative = quaternion(back).conjugate() * quaternion(absolute);
            sum += if relative.dot(&sum) < 0.0 { -relative } else { relative };
        }
        let [x, y, z, w] = UnitQuaternion::new_normalize(sum).coords.into();
        Some([x, y, z, w].map(|component: f64| component as f32))
    };
    GloveSample {
        back: Some([0.0, 0.0, 0.0, 1.0]),
        segments: core::array::from_fn(|finger| core::array::from_fn(|segment| mean(finger, segment))),
    }
}

fn quaternion([x, y, z, w]: [f32; 4]) -> Quaternion<f64> {
    Quaternion::new(f64::from(w), f64::from(x), f64::from(y), f64::from(z))
}

fn position(position: [f32; 3]) -> Vector3<f64> {
    Vector3::from(position.map(f64::from))
}

fn true_vectors(hand: &OperatorHand, motion: &FingersMotion, time: f64) -> [Vector3<f64>; 4] {
    let (_, angles) = motion.at(time);
    let tips: [Vector3<f64>; FINGERS] =
        core::array::from_fn(|number| hand.finger(Finger::ALL[number], &angles[number]).1);
    core::array::from_fn(|number| tips[number + 1] - tips[0])
}

/// The delay of the true motion, in steps of a millisecond from −20 to 60 ms, with the least squared error.
fn best_delay(
    hand: &OperatorHand,
    motion: &FingersMotion,
    times: &[f64],
    vectors: &[(Vector3<f64>, Vector3<f64>)],
) -> f64 {
    let cost = |delay: f64| -> f64 {
        let pairs = times.iter().zip(vectors).step_by(7);
        pairs.map(|(time, (found, _))| (found - true_vectors(hand, motion, time - delay)[0]).norm_squared()).sum()
    };
    let delays = (-20..=60).map(|step| 1e-3 * f64::from(step));
    let best = delays.map(|delay| (cost(delay), delay)).min_by(|one, other| one.0.total_cmp(&other.0));
    best.map_or(f64::NAN, |(_, delay)| delay)
}
