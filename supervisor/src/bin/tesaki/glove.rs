//! Frames of a glove, as JSON and as rows of a table.

use serde_json::Value;
use tesaki::teleop::{GloveSample, HUMAN_FINGERS, HumanFinger};

use crate::eval::table::{Row, Table};
use crate::failure::Failure;

/// The columns of the orientations in a table.
pub struct GloveColumns {
    back: Vec<usize>,
    /// Thumb to little finger, each from palm to tip.
    segments: Vec<Vec<usize>>,
}

impl GloveColumns {
    /// All must be there.
    pub fn find(table: &Table) -> Result<Self, Failure> {
        let orientation = |sensor: &str| -> Result<Vec<usize>, Failure> {
            let names = ["qx", "qy", "qz", "qw"].map(|part| format!("{sensor}_{part}"));
            names.iter().map(|name| table.needed(name, "quaternion of an orientation")).collect()
        };
        let sensors =
            HumanFinger::ALL.iter().flat_map(|finger| (1..=3).map(|n| format!("{}{n}", finger.name())));
        Ok(Self {
            back: orientation("back")?,
            segments: sensors.map(|sensor| orientation(&sensor)).collect::<Result<_, _>>()?,
        })
    }

    /// The sample of a row.
    pub fn sample(&self, table: &Table, row: &Row) -> Result<GloveSample, Failure> {
        let mut sample = GloveSample { back: cells(table, row, &self.back)?, ..GloveSample::default() };
        for (columns, segment) in self.segments.iter().zip(sample.segments.as_flattened_mut()) {
            *segment = cells(table, row, columns)?;
        }
        Ok(sample)
    }
}

/// The columns of a position for each finger, `thumb_x` to `little_z`.
pub struct PositionColumns([Option<Vec<usize>>; HUMAN_FINGERS]);

impl PositionColumns {
    /// A finger has all three columns or none.
    pub fn find(table: &Table, what: &str) -> Result<Self, Failure> {
        let mut columns = [const { None }; HUMAN_FINGERS];
        for (columns, finger) in columns.iter_mut().zip(HumanFinger::ALL) {
            *columns = table.all_or_none(&Self::names(finger), what)?;
        }
        Ok(Self(columns))
    }

    /// The names of a finger's columns.
    pub fn names(finger: HumanFinger) -> [String; 3] {
        ["x", "y", "z"].map(|axis| format!("{}_{axis}", finger.name()))
    }

    /// Whether no finger has any.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(Option::is_none)
    }

    /// The positions in a row.
    pub fn positions(&self, table: &Table, row: &Row) -> Result<[Option<[f32; 3]>; HUMAN_FINGERS], Failure> {
        let mut positions = [None; HUMAN_FINGERS];
        for (columns, position) in self.0.iter().zip(&mut positions) {
            if let Some(columns) = columns {
                *position = cells(table, row, columns)?;
            }
        }
        Ok(positions)
    }
}

/// The numbers in some columns; `None` if all are empty: not measured.
fn cells<const N: usize>(table: &Table, row: &Row, columns: &[usize]) -> Result<Option<[f32; N]>, Failure> {
    if columns.iter().all(|&column| table.is_empty(row, column)) {
        return Ok(None);
    }
    if let Some(&column) = columns.iter().find(|&&column| table.is_empty(row, column)) {
        let names: Vec<&str> = columns.iter().map(|&column| table.header(column)).collect();
        let message = format!(
            "column {} is empty: fill in a number, or empty all of {} where they were not measured",
            table.header(column),
            names.join(", ")
        );
        return Err(table.error(row.line, &message));
    }
    let numbers: Vec<f32> =
        columns.iter().map(|&column| table.number(row, column)).collect::<Result<_, _>>()?;
    Ok(numbers.try_into().ok())
}

/// What some programs put at the beginning of a text.
const BYTE_ORDER_MARK: char = '\u{feff}';
/// What to do about a list of frames.
pub const ARRAY: &str =
    "a JSON array: write one object a line, without brackets around them and commas between them";

/// The object of a line, and its time [s].
pub fn object(line: &str) -> Result<(f64, Value), String> {
    let value = json(line, "give it by --in FILE, without --live")?;
    let time = value.get("time").and_then(Value::as_f64).ok_or("no number \"time\" [s]")?;
    Ok((time, value))
}

/// The value of a line; `table` says what to do with a table.
pub fn json(line: &str, table: &str) -> Result<Value, String> {
    let line = line.trim_start_matches(BYTE_ORDER_MARK);
    if line.trim_start().starts_with('[') {
        return Err(ARRAY.to_owned());
    }
    serde_json::from_str(line).map_err(|error| {
        let hint = match line {
            _ if line.contains("NaN") => "; write null for what was not measured, not NaN".to_owned(),
            _ if line.contains([',', ';']) && !line.contains('{') => {
                format!("; this looks like CSV, which is read from files alone: {table}")
            }
            _ => String::new(),
        };
        format!("not valid JSON: {error}{hint}")
    })
}

/// The orientations in an object.
pub fn orientations(value: &Value) -> Result<GloveSample, String> {
    let orientation = |name: &str, value: Option<&Value>| {
        optional::<4>(value).map_err(|()| {
            format!("\"{name}\" must be a quaternion [x, y, z, w], or null if it was not measured")
        })
    };
    let mut sample = GloveSample { back: orientation("back", value.get("back"))?, ..GloveSample::default() };
    for (finger, segments) in HumanFinger::ALL.into_iter().zip(&mut sample.segments) {
        let given = match value.get(finger.name()) {
            None | Some(Value::Null) => continue,
            Some(given) => given.as_array().filter(|list| list.len() == segments.len()).ok_or_else(|| {
                format!("\"{}\" must be three quaternions, palm to tip, or null", finger.name())
            })?,
        };
        for (segment, given) in segments.iter_mut().zip(given) {
            *segment = orientation(finger.name(), Some(given))?;
        }
    }
    Ok(sample)
}

/// The positions by finger in an object that holds `what`.
pub fn positions(value: Option<&Value>, what: &str) -> Result<[Option<[f32; 3]>; HUMAN_FINGERS], String> {
    let mut positions = [None; HUMAN_FINGERS];
    let names = HumanFinger::ALL.map(HumanFinger::name);
    match value {
        None | Some(Value::Null) => return Ok(positions),
        Some(Value::Object(given)) => {
            if let Some(name) = given.keys().find(|name| !names.contains(&name.as_str())) {
                return Err(format!("there is no {what} {name:?}: the fingers are {}", names.join(", ")));
            }
        }
        Some(_) => {
            return Err(format!("each {what} must be in an object by finger, {{\"thumb\": [x, y, z], …}}"));
        }
    }
    for (finger, position) in HumanFinger::ALL.into_iter().zip(&mut positions) {
        let given = value.and_then(|value| value.get(finger.name()));
        *position = optional::<3>(given).map_err(|()| {
            format!("the {what} \"{}\" must be [x, y, z] in m, or null if it is hidden", finger.name())
        })?;
    }
    Ok(positions)
}

/// `None` for what is missing or null.
fn optional<const N: usize>(value: Option<&Value>) -> Result<Option<[f32; N]>, ()> {
    match value {
        None | Some(Value::Null) => Ok(None),
        Some(value) => numbers(value).map(Some).ok_or(()),
    }
}

/// A list of so many numbers.
#[expect(clippy::cast_possible_truncation, reason = "samples are in single precision")]
pub fn numbers<const N: usize>(value: &Value) -> Option<[f32; N]> {
    let numbers: Vec<f32> =
        value.as_array()?.iter().map(|x| x.as_f64().map(|x| x as f32)).collect::<Option<_>>()?;
    numbers.try_into().ok()
}
