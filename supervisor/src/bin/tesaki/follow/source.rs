//! Poses of a hand: lines of JSON, rows of a table, and the tip of another board's robot.

use std::f32::consts::TAU;
use std::io;
use std::path::Path;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use serde_json::Value;
use tesaki::kinematics::Chain;
use tesaki::math;
use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Stream, Telemetry};
use tesaki::task::impedance::{ArmAngle, ImpedanceSettings, Redundancy};
use tesaki_supervisor::Board;
use tesaki_supervisor::port::Address;

use crate::args::{Follow, Options, PoseSource};
use crate::board_session::BoardSession;
use crate::eval::table::{Row, Table};
use crate::failure::Failure;
use crate::feed::{Feed, Inlet};
use crate::glove;
use crate::motion::Motion;

/// Farthest position from the origin [m], as of `tesaki::teleop::Follower`.
const FARTHEST: f32 = 100.0;
/// Tolerance of the norm of a unit quaternion.
const NORM_TOLERANCE: f32 = 1e-3;
/// A master without telemetry for this time is asked again: it may have been reset.
const SILENCE: Duration = Duration::from_millis(300);
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
}

impl Source {
    pub fn open(
        options: &Options,
        args: &Follow,
        motion: &Motion<'_>,
        settings: &ImpedanceSettings,
    ) -> Result<Self, Failure> {
        let of_feed = |feed| Self { feed, start: None, period: None };
        match &args.from {
            PoseSource::StandardInput => Ok(of_feed(Feed::standard_input("sample", args.silence))),
            PoseSource::Udp(address) => Ok(of_feed(Feed::udp(*address, "sample", args.silence)?)),
            PoseSource::File(path) => {
                let samples = table(path)?;
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
                let master = Master::open(options, address, motion, settings)
                    .map_err(|failure| Failure::OtherBoard(place.clone(), Box::new(failure)))?;
                let feed = Feed::spawn(place, "sample", args.silence, move |inlet| master.lead(inlet));
                Ok(Self { period: Some(tesaki::TICK.into()), ..of_feed(feed) })
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

/// The samples of a file, checked.
fn table(path: &Path) -> Result<Vec<Sample>, Failure> {
    let table = Table::read(path)?;
    let time = table.needed("time", "of the sample [s]")?;
    let position = columns(&table, ["x", "y", "z"], "position of the hand [m]")?;
    let rotation = columns(&table, ["qx", "qy", "qz", "qw"], "quaternion of the hand's orientation")?;
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
        if let Some(before) = samples.last()
            && sample.time <= before.time
        {
            let message = format!("time {} s does not follow {} s: sort the rows", sample.time, before.time);
            return Err(table.error(row.line, &message));
        }
        samples.push(sample);
    }
    Ok(samples)
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

/// Another board, whose tip leads the arm.
struct Master {
    session: BoardSession,
    model: RobotModel,
    chain: Chain,
    elbow: Elbow,
    /// The last angle of the elbow [rad].
    angle: Option<f32>,
}

/// What of the master leads the elbow.
enum Elbow {
    Nothing,
    ArmAngle,
    /// Index of a joint.
    Joint(usize),
}

impl Master {
    fn open(
        options: &Options,
        address: &Address,
        motion: &Motion<'_>,
        settings: &ImpedanceSettings,
    ) -> Result<Self, Failure> {
        let mut session = BoardSession::open_at(options, address)?;
        if session.port == motion.port() {
            return Err(Failure::Usage(
                "this is the arm itself: name the arm's board by --port, and another one by --from board:ADDRESS"
                    .to_owned(),
            ));
        }
        let model = session.model()?;
        if model.chains.len() != 1 {
            return Err(Failure::Usage(format!(
                "{} has {} tips: only a robot with one tip can lead an arm",
                model.name,
                model.chains.len()
            )));
        }
        let node = session.board.status()?.node;
        session.require_no_fault(node.mode, Some(&model))?;
        let mut joints = (0..).zip(&model.joints);
        if let Some((_, joint)) = joints.find(|(index, _)| node.homed >> index & 1 == 0) {
            return Err(Failure::Usage(format!(
                "its joint {} is not homed, so its pose is unknown (`tesaki --port {} home …`)",
                joint.name, session.port
            )));
        }
        let elbow = match settings.redundancy {
            Redundancy::None => Elbow::Nothing,
            Redundancy::ArmAngle if model.joints.len() == tesaki::model::MAX_CHAIN_JOINTS => Elbow::ArmAngle,
            Redundancy::ArmAngle => Elbow::Nothing,
            Redundancy::DrivenJoint { joint } => {
                let name = motion.model.joint_name(joint.into());
                let found = model.joints.iter().position(|joint| joint.name == name);
                found.map_or(Elbow::Nothing, Elbow::Joint)
            }
        };
        let chain = Chain::of_model(&model, 0);
        session.board.set_rate(Stream::Telemetry, 1)?;
        Ok(Self { session, model, chain, elbow, angle: None })
    }

    /// Puts in the pose of the tip after each tick of the board.
    fn lead(mut self, inlet: &Inlet<Content>) {
        loop {
            let event = self.session.board.next_event(Instant::now() + SILENCE).map_err(Failure::from);
            let content = match event {
                Ok(Some(FromBoard::Telemetry(telemetry))) => self.sample(&telemetry).map(Content::Sample),
                Ok(Some(_)) => continue,
                Ok(None) => match self.session.reconnect(&[(Stream::Telemetry, 1)]) {
                    Ok(_) => continue,
                    Err(failure) => Err(failure.to_string()),
                },
                Err(failure) => Err(failure.to_string()),
            };
            let ends = content.is_err();
            if !inlet.send(content.map_err(io::Error::other)) || ends {
                break;
            }
        }
    }

    fn sample(&mut self, telemetry: &Telemetry) -> Result<Sample, String> {
        if telemetry.mode == Mode::Fault {
            return Err("its board is in fault (`tesaki faults`)".to_owned());
        }
        let angles: Vec<f32> = telemetry.joints.iter().map(|joint| joint.position).collect();
        if angles.len() != self.model.joints.len() {
            return Err("its board has lost its model: it was reset".to_owned());
        }
        let posture = self.chain.posture(&self.model.chain_angles(0, &angles));
        let tip = posture.tip();
        let elbow = match self.elbow {
            Elbow::Nothing => None,
            Elbow::ArmAngle => {
                ArmAngle::of(&posture, &Vector3::from(self.model.gravity)).map(|elbow| elbow.angle)
            }
            Elbow::Joint(joint) => angles.get(joint).copied(),
        };
        let elbow = elbow.map(|angle| self.angle.map_or(angle, |before| unwrapped(angle, before)));
        self.angle = elbow.or(self.angle);
        Ok(Sample {
            time: f64::from(telemetry.tick) * f64::from(tesaki::TICK),
            position: tip.translation.vector.into(),
            rotation: UnitQuaternion::from_rotation_matrix(&tip.rotation).coords.into(),
            elbow,
            clutch: None,
        })
    }
}

/// The angle within half a turn of the one `before`: the arm angle jumps at half a turn, the elbow does not.
fn unwrapped(angle: f32, before: f32) -> f32 {
    angle - TAU * math::round((angle - before) / TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_elbow_that_turns_on_does_not_jump() {
        for (angle, before, expected) in
            [(-3.1, 3.1, TAU - 3.1), (3.1, -3.1, 3.1 - TAU), (0.5, 0.4, 0.5), (3.1, 9.3, 3.1 + TAU)]
        {
            assert!((unwrapped(angle, before) - expected).abs() < 1e-5, "{angle} after {before}");
        }
    }

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
