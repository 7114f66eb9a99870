//! A hand's motion from a file.

use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, StringRecord, Trim};
use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::OperatorHandState;

/// The columns, in this order, named in the first line.
const HEADER: &str = "time,x,y,z,qx,qy,qz,qw";

/// A recorded motion: a CSV file with the header `time,x,y,z,qx,qy,qz,qw` and one line per sample: time [s],
/// rising; position [m]; orientation, a quaternion that is normalised. Positions are interpolated by cubic
/// Hermite splines whose velocities are those of the parabolas through three samples; orientations turn at a
/// constant rate from one sample to the next.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    samples: Vec<RecordedSample>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct RecordedSample {
    time: f64,
    pose: Isometry3<f64>,
    velocity: Vector3<f64>,
}

/// Why a recorded motion is invalid.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecordedError {
    /// The file cannot be read.
    #[error("cannot read {}: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The first line is not the header.
    #[error("line 1 is {0:?}: it must be {HEADER}")]
    Header(String),
    /// A line that is not a sample.
    #[error("line {line}: {problem}")]
    Line {
        /// Line number, from 1.
        line: u64,
        /// The error.
        problem: &'static str,
    },
    /// Too few samples.
    #[error("{0} samples: a motion needs at least 2")]
    Short(usize),
}

impl Recorded {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read or is invalid; the error names the first invalid line.
    pub fn load(path: &Path) -> Result<Self, RecordedError> {
        let error =
            |error: std::io::Error| RecordedError::Read { path: path.to_owned(), reason: error.to_string() };
        Self::from_csv(&std::fs::read_to_string(path).map_err(error)?)
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// The text is invalid; the error names the first invalid line.
    pub fn from_csv(text: &str) -> Result<Self, RecordedError> {
        let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(text.as_bytes());
        // Reading UTF-8 text with lines of any length cannot fail.
        let header = reader.headers().cloned().unwrap_or_default();
        if !header.iter().eq(HEADER.split(',')) {
            return Err(RecordedError::Header(header.iter().collect::<Vec<_>>().join(",")));
        }
        let mut samples: Vec<RecordedSample> = Vec::new();
        for record in reader.records().flatten() {
            let error = |problem| RecordedError::Line { line: line(text, &record), problem };
            let sample = sample(&record).map_err(error)?;
            if samples.last().is_some_and(|last| last.time >= sample.time) {
                return Err(error("its time is not after that of the line before"));
            }
            samples.push(sample);
        }
        if samples.len() < 2 {
            return Err(RecordedError::Short(samples.len()));
        }
        for index in 1..samples.len() - 1 {
            let [a, b, c] = [index - 1, index, index + 1].map(|index| samples[index]);
            let slope = |a: &RecordedSample, b: &RecordedSample| {
                (b.pose.translation.vector - a.pose.translation.vector) / (b.time - a.time)
            };
            let weight = (b.time - a.time) / (c.time - a.time);
            samples[index].velocity = slope(&a, &b) * (1.0 - weight) + slope(&b, &c) * weight;
        }
        Ok(Self { samples })
    }

    /// Duration from the first sample to the last [s].
    pub fn duration(&self) -> f64 {
        self.samples.last().map_or(0.0, |last| last.time) - self.samples[0].time
    }

    pub(super) fn start(&self) -> Isometry3<f64> {
        self.samples[0].pose
    }

    /// Returns the state at a time since the first sample [s].
    pub(super) fn at(&self, time: f64) -> OperatorHandState {
        let time = self.samples[0].time + time.clamp(0.0, self.duration());
        let after =
            self.samples.partition_point(|sample| sample.time <= time).clamp(1, self.samples.len() - 1);
        let (a, b) = (&self.samples[after - 1], &self.samples[after]);
        let span = b.time - a.time;
        let s = (time - a.time) / span;
        let displacement = b.pose.translation.vector - a.pose.translation.vector;
        let position = a.pose.translation.vector
            + displacement * (s * s * (3.0 - 2.0 * s))
            + (a.velocity * (1.0 - s) - b.velocity * s) * (span * s * (1.0 - s));
        let velocity = displacement * (6.0 * s * (1.0 - s) / span)
            + a.velocity * ((1.0 - s) * (1.0 - 3.0 * s))
            + b.velocity * (s * (3.0 * s - 2.0));
        let turn = (b.pose.rotation * a.pose.rotation.inverse()).scaled_axis();
        let rotation = UnitQuaternion::new(turn * s) * a.pose.rotation;
        OperatorHandState {
            pose: Isometry3::from_parts(Translation3::from(position), rotation),
            velocity,
            angular_velocity: if s < 1.0 { turn / span } else { Vector3::zeros() },
        }
    }
}

/// Returns the line number of a record, from 1; its position is before any empty lines that precede it.
fn line(text: &str, record: &StringRecord) -> u64 {
    let Some(position) = record.position() else { return 0 };
    let rest = usize::try_from(position.byte()).ok().and_then(|byte| text.get(byte..)).unwrap_or_default();
    let empty = rest.chars().take_while(|&c| c == '\n' || c == '\r').filter(|&c| c == '\n');
    position.line() + empty.map(|_| 1).sum::<u64>()
}

/// Parses a line into a sample without velocity.
fn sample(record: &StringRecord) -> Result<RecordedSample, &'static str> {
    let numbers: Vec<f64> = record.iter().map_while(|word| word.parse().ok()).collect();
    let Ok([time, x, y, z, i, j, k, w]) = <[f64; 8]>::try_from(numbers) else {
        return Err("it does not have eight numbers");
    };
    if ![time, x, y, z, i, j, k, w].iter().all(|value| value.is_finite()) {
        return Err("a number is not finite");
    }
    let turn = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-6).ok_or("its quaternion is 0")?;
    let pose = Isometry3::from_parts(Translation3::new(x, y, z), turn);
    Ok(RecordedSample { time, pose, velocity: Vector3::zeros() })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_sampled_motion_comes_back() {
        let motion = |t: f64| (0.1 * libm::sin(3.0 * t), 0.3 * libm::cos(3.0 * t), 0.2 * t);
        let mut text = String::from("time,x,y,z,qx,qy,qz,qw\n");
        for n in 0..=100 {
            let t = f64::from(n) * 0.02;
            let (x, _, turn) = motion(t);
            text += &format!("{},{x},0,1,0,0,{},{}\n", 5.0 + t, libm::sin(turn / 2.0), libm::cos(turn / 2.0));
        }
        let recorded = Recorded::from_csv(&text).unwrap();
        assert!((recorded.duration() - 2.0).abs() < 1e-12);
        for n in 10..190 {
            let t = f64::from(n) * 0.01;
            let (state, (x, velocity, turn)) = (recorded.at(t), motion(t));
            assert!(
                (state.pose.translation.x - x).abs() < 1e-6 && (state.velocity.x - velocity).abs() < 2e-4,
                "{state:?}"
            );
            assert!(
                (state.pose.rotation.angle() - turn).abs() < 1e-9
                    && (state.angular_velocity.z - 0.2).abs() < 1e-9
            );
        }
        assert_eq!(recorded.at(-1.0).pose, recorded.start());
        let end = recorded.at(9.0);
        assert!(
            (end.pose.translation.x - motion(2.0).0).abs() < 1e-12
                && end.velocity.norm() + end.angular_velocity.norm() < 1e-12
        );
    }

    #[test]
    fn errors_name_the_line() {
        let error = |text: &str| Recorded::from_csv(text).unwrap_err().to_string();
        let head = "time,x,y,z,qx,qy,qz,qw\n";
        assert_eq!(error("t,x\n1,2"), "line 1 is \"t,x\": it must be time,x,y,z,qx,qy,qz,qw");
        assert_eq!(error(&format!("{head}0,0,0,0,0,0,0,1\n")), "1 samples: a motion needs at least 2");
        assert_eq!(
            error(&format!("{head}0,0,0,0,0,0,0,1\n0,0,0,0,0,0,1")),
            "line 3: it does not have eight numbers"
        );
        assert_eq!(error(&format!("{head}0,0,0,0,0,0,0,0")), "line 2: its quaternion is 0");
        assert_eq!(error(&format!("{head}\r\n\n0,0,0,0,0,0,0,0")), "line 4: its quaternion is 0");
        let twice = "0,0,0,0,0,0,0,1\n".repeat(2);
        assert_eq!(error(&format!("{head}{twice}")), "line 3: its time is not after that of the line before");
    }
}
