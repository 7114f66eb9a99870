//! What no hand does, however it is recorded: poses that are too fast or too far away to be followed, as in
//! another unit.

use nalgebra::Vector3;

use super::source::Sample;

/// Fastest motion of a set-point that a hand asks for [m/s].
const FASTEST: f32 = 2.0;
/// What noise of positions and of time stamps may add to a step [m].
const SLACK: f32 = 5e-3;
/// So many fast steps in a row are no stray sample, which makes two.
const IN_A_ROW: u8 = 3;
/// Steps of time stamps in too small a unit are all within the slack; up to so many of them together are not.
const TOGETHER: usize = 50;
/// The set-point goes at most this many lengths of the arm away.
const LENGTHS: f32 = 2.0;

/// Follows the steps from each sample to the next.
#[derive(Default)]
pub struct Pace {
    last: Option<(f64, Vector3<f32>)>,
    fast: u8,
}

/// A step that is too fast.
#[derive(Debug, PartialEq)]
pub struct FastStep {
    pub message: String,
    /// So are those before it.
    pub goes_on: bool,
}

impl Pace {
    /// Refuses a sample, later than those before it, that the hand cannot have reached. `scale`: displacement
    /// of the tool per displacement of the hand.
    pub fn check(&mut self, sample: &Sample, scale: f32) -> Result<(), FastStep> {
        let position = Vector3::from(sample.position);
        let Some((time, before)) = self.last.replace((sample.time, position)) else { return Ok(()) };
        #[expect(clippy::cast_possible_truncation, reason = "a short time")]
        let (step, elapsed) = ((position - before).norm(), (sample.time - time) as f32);
        let Some(message) = too_fast(step, elapsed, scale) else {
            self.fast = 0;
            return Ok(());
        };
        self.fast = self.fast.saturating_add(1);
        Err(FastStep { message, goes_on: self.fast >= IN_A_ROW })
    }

    /// Forgets the sample before.
    pub const fn forget(&mut self) {
        self.last = None;
    }
}

/// Refuses a hand of this estimated velocity [m/s]. Time stamps in too small a unit show here before their
/// steps do, which are within the slack.
pub fn check_velocity(velocity: &Vector3<f32>, scale: f32) -> Result<(), String> {
    let speed = velocity.norm();
    if speed * scale <= FASTEST {
        return Ok(());
    }
    Err(format!(
        "the hand moves at {speed:.1} m/s by its positions and times, limit {} m/s: is `time` in seconds, and does it go \
         on with each sample?",
        FASTEST / scale
    ))
}

/// What is wrong with a hand that moves by a distance [m] in a time [s]; `None` if it can.
fn too_fast(distance: f32, time: f32, scale: f32) -> Option<String> {
    (distance * scale > SLACK + FASTEST * time).then(|| {
        format!(
            "the position moves by {distance:.3} m in {time:.3} s, {:.1} m/s, limit {} m/s: is it in metres and `time` \
             in seconds, or does the hand jump?",
            distance / time,
            FASTEST / scale
        )
    })
}

/// Checks the samples of a recorded hand for an arm of a length [m]. Returns the index of the first one that
/// cannot be followed, and why.
pub fn check(samples: &[Sample], scale: f32, length: f32) -> Result<(), (usize, String)> {
    let (mut pace, limit) = (Pace::default(), LENGTHS * length / scale);
    let mut first = 0;
    for (index, sample) in samples.iter().enumerate() {
        // Behind an open clutch the hand may go anywhere.
        if sample.clutch == Some(false) {
            (pace, first) = (Pace::default(), index + 1);
            continue;
        }
        pace.check(sample, scale).map_err(|step| (index, step.message))?;
        let distance_to =
            |other: &Sample| (Vector3::from(sample.position) - Vector3::from(other.position)).norm();
        let closed = samples.get(first..index).unwrap_or_default();
        if let Some(before) = closed.iter().nth_back(TOGETHER - 1).or(closed.first()) {
            #[expect(clippy::cast_possible_truncation, reason = "a short time")]
            let elapsed = (sample.time - before.time) as f32;
            if let Some(message) = too_fast(distance_to(before), elapsed, scale) {
                return Err((index, message));
            }
        }
        let distance = closed.first().map_or(0.0, distance_to);
        if distance > limit {
            return Err((
                index,
                format!(
                    "the position is {distance:.3} m from the first one, limit {limit:.3} m, which leads the tool by twice \
                     the arm's length: is it in metres?"
                ),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn samples(positions: &[f32]) -> Vec<Sample> {
        let times = (0..).map(|index| 0.02 * f64::from(index));
        let sample = |(time, x): (f64, &f32)| Sample {
            time,
            position: [*x, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
            elbow: None,
            clutch: None,
        };
        times.zip(positions).map(sample).collect()
    }

    #[test]
    fn a_hand_that_is_too_fast_or_too_far_is_told_by_its_sample() {
        // 40 mm in 20 ms are 2 m/s.
        assert_eq!(check(&samples(&[9.0, 9.04, 9.0]), 1.0, 0.5), Ok(()));
        let (index, message) = check(&samples(&[9.0, 9.04, 9.14]), 1.0, 0.5).unwrap_err();
        assert!(index == 2 && message.contains("0.100 m in 0.020 s, 5.0 m/s, limit 2 m/s"), "{message}");
        // The tool moves a tenth of that.
        assert_eq!(check(&samples(&[9.0, 9.04, 9.14]), 0.1, 0.5), Ok(()));
        let steps =
            |length: f32| samples(&(0..60_u8).map(|step| length * f32::from(step)).collect::<Vec<_>>());
        let (index, message) = check(&steps(0.02), 1.0, 0.5).unwrap_err();
        assert!(index == 51 && message.contains("1.020 m from the first one, limit 1.000 m"), "{message}");
        // 50 steps of 0.2 mm, each within the slack, in a thousandth of the time.
        let mut small = steps(2e-4);
        assert_eq!(check(&small, 1.0, 0.5), Ok(()));
        small.iter_mut().for_each(|sample| sample.time *= 1e-3);
        let (index, message) = check(&small, 1.0, 0.5).unwrap_err();
        assert!(index == 32 && message.contains("0.006 m in 0.001 s"), "{message}");
        // Behind an open clutch.
        let mut away = samples(&[0.0, 5.0, 5.0]);
        away[0].clutch = Some(false);
        assert_eq!(check(&away, 1.0, 0.5), Ok(()));
    }

    #[test]
    fn a_stray_sample_is_no_fast_hand() {
        let mut pace = Pace::default();
        let fast: Vec<Option<bool>> = samples(&[0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 4.0])
            .iter()
            .map(|sample| pace.check(sample, 1.0).err().map(|step| step.goes_on))
            .collect();
        let (stray, goes_on) = (Some(false), Some(true));
        assert_eq!(fast, [None, stray, stray, None, stray, None, stray, stray, goes_on]);
    }
}
