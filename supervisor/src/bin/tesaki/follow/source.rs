//! Poses of a hand: lines of JSON, rows of a table, and the tip of another board's robot.

use std::path::Path;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::Value;
use tesaki::math;
use tesaki::task::impedance::ImpedanceSettings;
use tesaki_description::robot::chain_length;

use super::master::Master;
use super::pace;
use super::reflect::Reflection;
use crate::args::{Follow, Options, PoseSource};
use crate::eval::table::{Row, Table};
use crate::failure::Failure;
use crate::feed::{Feed, Inlet};
use crate::glove;
use crate::motion::Motion;

/// Farthest position from the origin [m], as of `tesaki::teleop::Follower`.
const FARTHEST: f32 = 100.0;
/// Tolerance of the norm of a unit quaternion.
const NORM_TOLERANCE: f32 = 1e-3;
/// The keys of a line.
const KEYS: [&str; 5] = ["time", "position", "quaternion", "elbow", "clutch"];

/// A pose of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// By the clock of the source [s].
    pub time: f64,
    pub position: [f32; 3],
    /// As `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// Angle of the elbow [rad].
    pub elbow: Option<f32>,
    /// Whether the pedal asks for a closed clutch.
    pub clutch: Option<bool>,
}

/// What comes from a source.
#[derive(Debug, PartialEq)]
pub enum Entry {
    Sample(Sample),
    /// A request to the clutch alone.
    Clutch(bool),
}

/// The same before it is read.
pub enum Content {
    Line(String),
    Sample(Sample),
}

impl From<String> for Content {
    fn from(line: String) -> Self {
        Self::Line(line)
    }
}

impl Content {
    /// `None` for an empty line.
    pub fn read(&self) -> Option<Result<Entry, String>> {
        match self {
            Self::Sample(sample) => Some(sample.check().map(|()| Entry::Sample(*sample))),
            Self::Line(text) if text.trim().is_empty() => None,
            Self::Line(text) => Some(line(text)),
        }
    }
}

impl Sample {
    /// Refuses what is no pose of a hand.
    fn check(&self) -> Result<(), String> {
        let Self { position, rotation, .. } = self;
        if !position.iter().chain(rotation).chain(&self.elbow).all(|number| number.is_finite()) {
            return Err("a number is not finite".to_owned());
        }
        let norm = math::sqrt(rotation.iter().map(|part| part * part).sum());
        if (norm - 1.0).abs() > NORM_TOLERANCE {
            return Err(format!(
                "the quaternion has norm {norm}; it must be 1 (within {NORM_TOLERANCE}): divide it by its norm"
            ));
        }
        let distance = Vector3::from(*position).norm();
        if distance > FARTHEST {
            return Err(format!(
                "the position is {distance} m from the origin, limit {FARTHEST} m: is it in metres?"
            ));
        }
        Ok(())
    }
}

/// The content of a line of JSON.
fn line(text: &str) -> Result<Entry, String> {
    let value = glove::json(text, "give it by --from file:FILE.csv")?;
    let object = value.as_object().ok_or("no object {…}")?;
    if let Some(key) = object.keys().find(|key| !KEYS.contains(&key.as_str())) {
        return Err(format!("there is no key {key:?}: the keys are {}", KEYS.join(", ")));
    }
    // What was not measured may be null.
    let given = |key: &str| object.get(key).filter(|value| !value.is_null());
    let clutch = given("clutch")
        .map(|value| value.as_bool().ok_or("\"clutch\" must be true (closed) or false (open)"))
        .transpose()?;
    if let (Some(clutch), None, None) = (clutch, given("position"), given("quaternion")) {
        return Ok(Entry::Clutch(clutch));
    }
    let time = given("time").and_then(Value::as_f64).ok_or("no number \"time\" [s]")?;
    let position = given("position").and_then(glove::numbers).ok_or("no \"position\": [x, y, z] in m")?;
    let rotation =
        given("quaternion").and_then(glove::numbers).ok_or("no \"quaternion\": [x, y, z, w] of norm 1")?;
    #[expect(clippy::cast_possible_truncation, reason = "samples are in single precision")]
    let elbow = given("elbow")
        .map(|value| value.as_f64().map(|angle| angle as f32).ok_or("\"elbow\" must be an angle in rad"))
        .transpose()?;
    let sample = Sample { time, position, rotation, elbow, clutch };
    sample.check()?;
    Ok(Entry::Sample(sample))
}

/// A source, not yet followed.
pub struct Source {
    pub feed: Feed<Content>,
    /// Starts what waits for the arm to be enabled.
    start: Option<Sender<()>>,
    /// Period of its time stamps, where they number its samples [s].
    pub period: Option<f64>,
    /// The slave's end of the reflected force, if there is one.
    pub reflection: Option<Reflection>,
}

impl Source {
    pub fn open(
        options: &Options,
        args: &Follow,
        motion: &mut Motion<'_>,
        settings: &ImpedanceSettings,
    ) -> Result<Self, Failure> {
        let of_feed = |feed| Self { feed, start: None, period: None, reflection: None };
        if args.reflect.is_some() && !matches!(args.from, PoseSource::Board(_)) {
            return Err(Failure::Usage(
                "--reflect needs a master that is a board: --from board:ADDRESS".to_owned(),
            ));
        }
        match &args.from {
            PoseSource::StandardInput => Ok(of_feed(Feed::standard_input("sample", args.silence))),
            PoseSource::Udp(address) => Ok(of_feed(Feed::udp(*address, "sample", args.silence)?)),
            PoseSource::File(path) => {
                let samples = table(path, args, chain_length(&motion.model, 0))?;
                let (start, started) = channel();
                let feed = Feed::spawn(path.display().to_string(), "sample", args.silence, move |inlet| {
                    if started.recv().is_ok() {
                        play(&samples, inlet);
                    }
                });
                Ok(Self { start: Some(start), ..of_feed(feed) })
            }
            PoseSource::Board(address) => {
                let place = format!("the master at {address}");
                let (master, reflection) =
                    Master::open(options, address, args, motion, settings).map_err(|failure| {
                        Failure::OtherBoard(place.clone(), Box::new(failure.at_port(&address.to_string())))
                    })?;
                let feed = Feed::spawn(place, "sample", args.silence, move |inlet| master.lead(inlet));
                Ok(Self { period: Some(tesaki::TICK.into()), reflection, ..of_feed(feed) })
            }
        }
    }

    /// Whether it waits for [`Self::start`].
    pub const fn waits(&self) -> bool {
        self.start.is_some()
    }

    /// The arm is enabled.
    pub fn start(&mut self) {
        if let Some(start) = self.start.take() {
            let _ = start.send(());
        }
    }
}

/// The samples of a file, checked for an arm of a length [m].
fn table(path: &Path, args: &Follow, length: f32) -> Result<Vec<Sample>, Failure> {
    let silence = args.silence.as_secs_f64();
    let table = Table::read(path)?;
    let time = table.needed("time", "of the sample [s]")?;
    let position = columns(&table, ["x", "y", "z"], "position of the hand [m]")?;
    let rotation = columns(&table, ["qx", "qy", "qz", "qw"], "quaternion of the hand's orientation")?;
    table.check_spelling(&["elbow", "clutch"])?;
    let (elbow, clutch) = (table.column("elbow"), table.column("clutch"));
    let mut samples: Vec<Sample> = Vec::with_capacity(table.rows.len());
    for row in &table.rows {
        let sample = Sample {
            time: table.precise(row, time)?,
            position: table.numbers(row, Some(&position))?,
            rotation: table.numbers(row, Some(&rotation))?,
            elbow: optional(&table, row, elbow)?,
            clutch: match (optional(&table, row, clutch)?, clutch) {
                (Some(value), Some(column)) => Some(match table.text(row, column) {
                    "0" => false,
                    "1" => true,
                    _ => {
                        let message = format!("clutch {value}: expected 1 (closed) or 0 (open)");
                        return Err(table.error(row.line, &message));
                    }
                }),
                _ => None,
            },
        };
        sample.check().map_err(|error| table.error(row.line, &error))?;
        if let Some(before) = samples.last() {
            check_gap(before.time, sample.time, silence).map_err(|error| table.error(row.line, &error))?;
        }
        samples.push(sample);
    }
    if let Err((index, error)) = pace::check(&samples, args.scale, length) {
        return Err(table.error(table.rows.get(index).map_or(0, |row| row.line), &error));
    }
    Ok(samples)
}

/// Checks that a sample follows the one before, and so soon that the source does not count as silent.
fn check_gap(before: f64, time: f64, silence: f64) -> Result<(), String> {
    let gap = time - before;
    if gap <= 0.0 {
        return Err(format!("time {time} s does not follow {before} s: sort the rows"));
    }
    if gap > silence {
        return Err(format!(
            "time {time} s follows {before} s, and a source that is silent for {silence} s (--silence) ends the program: \
             is `time` in seconds?"
        ));
    }
    Ok(())
}

fn columns<const N: usize>(table: &Table, names: [&str; N], what: &str) -> Result<Vec<usize>, Failure> {
    names.iter().map(|name| table.needed(name, what)).collect()
}

/// The number in a column that there may be; `None` also for an empty cell.
fn optional(table: &Table, row: &Row, column: Option<usize>) -> Result<Option<f32>, Failure> {
    column.filter(|&column| !table.is_empty(row, column)).map(|column| table.number(row, column)).transpose()
}

/// Puts in the samples at their times, the first one now.
fn play(samples: &[Sample], inlet: &Inlet<Content>) {
    let begin = Instant::now();
    let first = samples.first().map_or(0.0, |sample| sample.time);
    for sample in samples {
        let due = Duration::try_from_secs_f64(sample.time - first).unwrap_or(Duration::MAX);
        std::thread::sleep(due.saturating_sub(begin.elapsed()));
        if !inlet.send(Ok(Content::Sample(*sample))) {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_a_sample_or_a_request_to_the_clutch() {
        let pose = Sample {
            time: 1.5,
            position: [0.1, 0.0, -0.2],
            rotation: [0.0, 0.0, 0.0, 1.0],
            elbow: None,
            clutch: None,
        };
        let text = "{\"time\": 1.5, \"position\": [0.1, 0, -0.2], \"quaternion\": [0, 0, 0, 1]";
        assert_eq!(line(&format!("{text}}}")), Ok(Entry::Sample(pose)));
        let all = format!("{text}, \"elbow\": 0.5, \"clutch\": false}}");
        let expected = Sample { elbow: Some(0.5), clutch: Some(false), ..pose };
        assert_eq!(line(&all), Ok(Entry::Sample(expected)));
        assert_eq!(line(&format!("{text}, \"elbow\": null}}")), Ok(Entry::Sample(pose)));
        assert_eq!(line("{\"clutch\": true}"), Ok(Entry::Clutch(true)));
    }
}
