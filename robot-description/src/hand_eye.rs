//! `hand_eye.toml` in a robot folder: what the camera in the hand sees of a rose straight before the hand, as
//! `tesaki calibrate camera` writes it.
//!
//! ```toml
//! rose = 0.04       # m, radius of the rose
//! tilt = 0.1745     # rad, of the optical axis from the approach, about the hand's y towards the hand's axis
//! pan = 0.0         # rad, of the optical axis about the image's y, to the right in the image; 0 if not given
//! turn = 0.0        # rad, from the image's x to where the rose moves when it moves along the hand's y
//! size = [256, 240] # px, width and height of the pictures, if given
//! # Radius, u and v of the centre [px], distance from the hand [m]; 2 to 16 rows, the farthest first.
//! rows = [
//!   [13.2, 127.5, 103.9, 0.30],
//!   [38.1, 127.5, 139.4, 0.02],
//! ]
//! ```

use std::path::Path;

use serde::Deserialize;
use tesaki::vision::{HandEyeError, HandEyeRow, HandEyeTable, MAX_HAND_EYE_ROWS};

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};

/// Name of the file in a robot folder.
pub const FILE: &str = "hand_eye.toml";
/// What to do about a key that cannot be read.
const ADVICE: &str = "correct it, or make the file anew with `tesaki calibrate camera`";

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    rose: f32,
    tilt: f32,
    #[serde(default)]
    pan: f32,
    turn: f32,
    size: Option<[usize; 2]>,
    rows: Vec<Vec<f32>>,
}

/// What the camera sees, and of which pictures that holds.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeFile {
    /// What it sees of a rose straight before the hand.
    pub table: HandEyeTable,
    /// Width and height of its pictures [px], if the file tells them.
    pub size: Option<[usize; 2]>,
}

/// The table in the folder of a robot.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line and key.
pub fn load(robot: &Path) -> Result<HandEyeFile, FileError> {
    file::load(&robot.join(FILE), "`tesaki calibrate camera` makes it", check)
}

/// What is wrong with `text`, the content of `path`; the rest when nothing is.
pub fn check(path: &Path, text: &str) -> (Option<HandEyeFile>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    let Some(file) = file::parse::<File>(text, ADVICE, &mut report) else {
        return (None, report.findings);
    };
    let mut rows = Vec::new();
    for (index, row) in file.rows.iter().enumerate() {
        let [radius, u, v, distance] = **row else {
            let message = format!("rows[{index}] has {} numbers; it must have 4", row.len());
            report.dynamics(report.line_of(&format!("rows.{index}")), message, ADVICE);
            return (None, report.findings);
        };
        rows.push(HandEyeRow { radius, center: [u, v], distance });
    }
    match HandEyeTable::try_new(file.rose, [file.tilt, file.pan, file.turn], &rows) {
        Ok(table) => (Some(HandEyeFile { table, size: file.size }), report.findings),
        Err(error) => {
            let (key, message) = file.problem(&error);
            report.dynamics(report.line_of(&key), message, ADVICE);
            (None, report.findings)
        }
    }
}

impl File {
    /// Key and message.
    fn problem(&self, error: &HandEyeError) -> (String, String) {
        let of_row = |row: usize| format!("rows.{row}");
        let wrong = match error {
            HandEyeError::Rows { got } => {
                let message = format!("rows has {got} entries; it must have 2 to {MAX_HAND_EYE_ROWS}");
                return ("rows".to_owned(), message);
            }
            &HandEyeError::Order { row } => {
                let message = format!(
                    "rows[{row}]: from row to row the radius must grow and the distance shrink, the farthest first"
                );
                return (of_row(row), message);
            }
            HandEyeError::Value(wrong) => wrong,
        };
        match ["rose", "tilt", "pan", "turn"].into_iter().find(|key| wrong.field.contains(key)) {
            Some(key) => (key.to_owned(), format!("{key}: {wrong}")),
            None => {
                let bits = wrong.value.to_bits();
                let row = self.rows.iter().position(|row| row.iter().any(|one| one.to_bits() == bits));
                let row = row.unwrap_or_default();
                (of_row(row), format!("rows[{row}]: {wrong}"))
            }
        }
    }
}
