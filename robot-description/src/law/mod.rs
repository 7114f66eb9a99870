//! Files in `laws/` of a robot folder: a control law with its settings, and the experiments of a paper that
//! are run with it.

pub mod arm;
pub mod hand;

use std::path::Path;

use serde::de::DeserializeOwned;
use tesaki::model::RobotModel;

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "laws";

/// Largest number of characters in a title.
const MAX_TITLE: usize = 60;

/// What is wrong with a law of a robot: of an arm, or of a hand.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> Vec<Finding> {
    if hand::is_for(model) {
        hand::check(path, text, model).1
    } else if arm::is_for(model) {
        arm::check(path, text, model).1
    } else {
        let mut report = Report::new(path);
        let message = "not checked: laws are for a hand of three fingers with force sensors, or for an arm";
        report.warning(None, message, "remove it, or put it into the folder of the robot that it is for");
        report.findings
    }
}

/// Fails unless the robot `fits` the law in `path`, which needs what is `needed`.
fn check_robot(path: &Path, model: &RobotModel, fits: bool, needed: &'static str) -> Result<(), FileError> {
    let mut report = Report::new(path);
    if !fits {
        let chains = model.chains.len();
        let message =
            format!("a law of {needed}; the robot has {chains} chain(s): run it with a robot that it is for");
        report.dynamics(None, message, "");
    }
    if fits { Ok(()) } else { Err(FileError::Wrong(report.findings)) }
}

/// A key that cannot be used.
struct Wrong {
    /// Where it may be, first choice first; with the sections.
    keys: Vec<String>,
    /// What is wrong there.
    message: String,
}

impl Wrong {
    fn new(key: impl Into<String>, message: impl Into<String>) -> Self {
        Self { keys: vec![key.into()], message: message.into() }
    }

    /// That a title is of no use in figures, if it is not.
    fn title(title: &str) -> Option<Self> {
        let length = title.trim().chars().count();
        (!(1..=MAX_TITLE).contains(&length)).then(|| {
            Self::new(
                "title",
                format!("title has {length} characters; possible are 1 to {MAX_TITLE}, as in figures"),
            )
        })
    }

    /// That one of the values is outside their range, if one is.
    fn any_outside<'a>(
        key: &str,
        values: impl IntoIterator<Item = &'a f64>,
        range: [f64; 2],
        unit: &str,
    ) -> Option<Self> {
        values.into_iter().find_map(|&value| Self::outside(key, value, range, unit))
    }

    /// That a value is outside its range, if it is.
    fn outside(key: &str, value: f64, [min, max]: [f64; 2], unit: &str) -> Option<Self> {
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        (!(min..=max).contains(&value))
            .then(|| Self::new(key, format!("{key} is {value}{unit}; the range is {min} to {max}{unit}")))
    }
}

/// Reads `text`, the content of `path`, as a `File`, of which `law` makes the law or says what is wrong;
/// `advice` is what to do about that.
fn read<File: DeserializeOwned, L>(
    path: &Path,
    text: &str,
    advice: &str,
    law: impl FnOnce(File) -> Result<L, Vec<Wrong>>,
) -> (Option<L>, Vec<Finding>) {
    let mut report = Report::of_toml(path, text);
    let law = file::parse(text, advice, &mut report).and_then(|file| {
        let wrong = match law(file) {
            Ok(law) => return Some(law),
            Err(wrong) => wrong,
        };
        for Wrong { keys, message } in wrong {
            let line = keys.iter().find_map(|key| report.line_of(key));
            // A default has the line of its table.
            let table = || report.line_of(keys.first()?.rsplit_once('.')?.0);
            report.dynamics(line.or_else(table), message, advice);
        }
        None
    });
    (law, report.findings)
}
