//! Frames of the operator's hand: lines of JSON and rows of tables, told apart by what they contain.

use std::path::Path;

use serde_json::Value;
use tesaki::teleop::HumanFinger;
use tesaki_description::retargeting::{RetargetingSettings, Side};
use tesaki_supervisor::operator::{
    LANDMARKS, Landmarks, Observation, OperatorFile, Tracker, TrackerSettings, Wearer,
};

use crate::args::Retarget;
use crate::eval::table::{MAX_TABLE, Table};
use crate::failure::Failure;
use crate::feed::read_path;
use crate::glove::{self, GloveColumns, PositionColumns};

/// A frame at its time [s].
pub struct Frame {
    pub time: f64,
    pub observation: Observation,
}

/// So many frames of another kind in a row, live, are those of the source; the ones before were stray.
const CHANGE: u32 = 3;

/// Kinds of frames, with the key that tells them.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Glove,
    Landmarks,
    Fingertips,
}

impl Kind {
    const ALL: [(Self, &'static str); 3] =
        [(Self::Glove, "back"), (Self::Landmarks, "landmarks"), (Self::Fingertips, "tips")];
}

/// Reads frames one after the other: all of one kind, which suits `--operator`.
pub struct Source {
    has_operator: bool,
    live: bool,
    kind: Option<Kind>,
    /// Frames of another kind since the last one of this kind.
    others: u32,
    /// Whether the kind has changed with the last frame.
    pub changed: bool,
}

impl Source {
    pub const fn new(args: &Retarget) -> Self {
        Self { has_operator: args.operator.is_some(), live: args.live, kind: None, others: 0, changed: false }
    }

    /// The frame of a line of JSON.
    pub fn line(&mut self, line: &str) -> Result<Frame, String> {
        let (time, value) = glove::object(line)?;
        let present: Vec<(Kind, &str)> =
            Kind::ALL.into_iter().filter(|(_, key)| value.get(key).is_some()).collect();
        let kind = match present.as_slice() {
            [(kind, _)] => *kind,
            [] => {
                return Err(
                    "none of \"back\" (of a glove), \"landmarks\" and \"tips\": see `tesaki retarget --help`"
                        .to_owned(),
                );
            }
            several => {
                let keys: Vec<&str> = several.iter().map(|(_, key)| *key).collect();
                return Err(format!("{} together: which is meant? Leave out the others", keys.join(", ")));
            }
        };
        self.suits(kind)?;
        let observation = match kind {
            Kind::Glove => {
                every_finger(&value)?;
                Observation::Glove(glove::orientations(&value)?)
            }
            Kind::Landmarks => Observation::Landmarks(landmarks(&value)?),
            Kind::Fingertips => Observation::Fingertips(glove::positions(value.get("tips"), "tip")?),
        };
        self.admit(kind)?;
        Ok(Frame { time, observation })
    }

    /// Whether frames of a kind suit `--operator`.
    fn suits(&self, kind: Kind) -> Result<(), String> {
        match (kind, self.has_operator) {
            (Kind::Glove, false) => {
                Err("orientations of a glove need --operator FILE, as written by `tesaki calibrate`"
                    .to_owned())
            }
            (Kind::Landmarks | Kind::Fingertips, true) => {
                Err("--operator is for a glove, and these are positions: leave it out".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Whether a frame is of the kind that is expected.
    fn admit(&mut self, kind: Kind) -> Result<(), String> {
        let expected = *self.kind.get_or_insert(kind);
        self.others = if kind == expected { 0 } else { self.others + 1 };
        self.changed = self.live && self.others >= CHANGE;
        if self.changed {
            (self.kind, self.others) = (Some(kind), 0);
        }
        if self.others == 0 {
            return Ok(());
        }
        Err("it is of another kind than the frames before: give one source at a time".to_owned())
    }

    /// Every frame of a file, with its line, and the name of the file.
    pub fn file(mut self, path: &Path) -> Result<(String, Vec<(u64, Frame)>), Failure> {
        let (name, text) = read_path(path, MAX_TABLE)?;
        let content = text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&text);
        let frames = match content.iter().find(|byte| !byte.is_ascii_whitespace()) {
            Some(b'{') => self.lines(&name, &text)?,
            Some(b'[') => return Err(Failure::Other(format!("{name} is {}", glove::ARRAY))),
            _ => self.rows(&Table::parse(&name, &text)?)?,
        };
        Ok((name, frames))
    }

    fn lines(&mut self, name: &str, text: &[u8]) -> Result<Vec<(u64, Frame)>, Failure> {
        let text = String::from_utf8_lossy(text);
        let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
        let frame = |(number, line)| match self.line(line) {
            Ok(frame) => Ok((number, frame)),
            Err(error) => Err(Failure::Other(format!("{name}:{number}: {error}"))),
        };
        lines.map(frame).collect()
    }

    fn rows(&self, table: &Table) -> Result<Vec<(u64, Frame)>, Failure> {
        let time = table.needed("time", "of the frame [s]")?;
        let positions = PositionColumns::find(table, "position of a fingertip [m]")?;
        let has_glove = table.column("back_qx").is_some();
        let glove = match (has_glove, positions.is_empty(), self.has_operator) {
            (true, false, false) => {
                let message = "orientations and positions: with --operator the orientations count; without, remove \
                    the columns that are not meant";
                return Err(table.error(1, message));
            }
            (true, ..) => Some(GloveColumns::find(table)?),
            (false, true, _) => {
                let message = "no positions (thumb_x … little_z) and no orientations (back_qx … little3_qw): see \
                    `tesaki retarget --help`";
                return Err(table.error(1, message));
            }
            (false, false, _) => {
                let names: Vec<String> =
                    HumanFinger::ALL.into_iter().flat_map(PositionColumns::names).collect();
                table.check_spelling(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
                None
            }
        };
        let kind = if glove.is_some() { Kind::Glove } else { Kind::Fingertips };
        self.suits(kind).map_err(|error| table.error(1, &error))?;
        let mut frames = Vec::new();
        for row in &table.rows {
            let observation = match &glove {
                Some(columns) => Observation::Glove(columns.sample(table, row)?),
                None => Observation::Fingertips(positions.positions(table, row)?),
            };
            frames.push((row.line, Frame { time: table.precise(row, time)?, observation }));
        }
        Ok(frames)
    }
}

/// Whether a line of a glove has a key for each finger: among its other keys a misspelt one would not be
/// noticed.
fn every_finger(value: &Value) -> Result<(), String> {
    let missing = HumanFinger::ALL.iter().find(|finger| value.get(finger.name()).is_none());
    missing.map_or(Ok(()), |finger| {
        Err(format!(
            "the orientations of the {finger} (\"{}\") are missing: write null if they were not measured",
            finger.name()
        ))
    })
}

/// The landmarks in an object; `None` while there is no hand.
fn landmarks(value: &Value) -> Result<Option<Landmarks>, String> {
    let points = match value.get("landmarks") {
        None | Some(Value::Null) => return Ok(None),
        Some(points) => points,
    };
    let wrong =
        || format!("\"landmarks\" must be {LANDMARKS} positions [x, y, z] in m, or null without a hand");
    let points: Vec<[f32; 3]> =
        points.as_array().and_then(|list| list.iter().map(glove::numbers).collect()).ok_or_else(wrong)?;
    let handedness = match value.get("handedness").map(Value::as_str) {
        None => None,
        Some(Some("Right")) => Some(Side::Right),
        Some(Some("Left")) => Some(Side::Left),
        Some(_) => return Err("\"handedness\" must be \"Left\" or \"Right\"".to_owned()),
    };
    Ok(Some(Landmarks { points: points.try_into().map_err(|_| wrong())?, handedness }))
}

/// The tracker for the frames of a source.
pub fn tracker(args: &Retarget, settings: &RetargetingSettings) -> Result<Tracker, Failure> {
    let wearer = args.operator.as_deref().map(|path| wearer(path, settings.operator_hand)).transpose()?;
    let settings = TrackerSettings {
        side: settings.operator_hand,
        rotation: settings.rotation,
        bandwidth: args.bandwidth,
        max_gap: settings.task.max_sample_age,
        wearer,
    };
    Tracker::try_new(settings).map_err(|error| Failure::Usage(format!("--bandwidth: {error}")))
}

/// The person of a calibration file.
fn wearer(path: &Path, side: Side) -> Result<Wearer, Failure> {
    let text = std::fs::read_to_string(path).map_err(Failure::file(path))?;
    let wrong = |error: String| Failure::Other(format!("{}: {error}", path.display()));
    let file: OperatorFile = toml::from_str(&text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start);
        let line = text.get(..start).unwrap_or(&text).matches('\n').count() + 1;
        wrong(format!("line {line}: {}; `tesaki calibrate` writes such a file", error.message()))
    })?;
    let hand = tesaki::teleop::HumanHand::try_new(file.links()).map_err(|error| wrong(error.to_string()))?;
    Wearer::try_new(hand, side)
        .ok_or_else(|| wrong("the first joints of the fingers lie in one line: calibrate anew".to_owned()))
}
