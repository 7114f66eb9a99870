//! Reading of text files, and of TOML with errors by path, line and column.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::finding::{Finding, Matter, Report, Severity};
use crate::line::key_at;
use crate::urdf;

/// Longest URDF [bytes]. Those of whole humanoids have half of it.
pub(crate) const MAX_URDF: usize = 1 << 20;
/// Longest TOML file [bytes]. A board's sixteen joints, each with settings of its own, take a third.
pub(crate) const MAX_TOML: usize = 1 << 16;

/// Longest file that is read at all, whatever is said about it [bytes].
const MAX_TEXT: u64 = 1 << 24;

/// Why a file of a robot cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FileError {
    /// It does not exist, or cannot be read.
    #[error("cannot read {}: {reason}{}{advice}", path.display(), if advice.is_empty() { "" } else { "; " })]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
        /// What to do; may be empty.
        advice: String,
    },
    /// What is wrong in it, or in the files of a folder: every error that can be found.
    #[error("{}", urdf::list(.0))]
    Wrong(Vec<Finding>),
}

impl FileError {
    /// As findings: that a file cannot be read is one.
    pub fn findings(self) -> Vec<Finding> {
        match self {
            Self::Read { path, reason, advice } => vec![Finding {
                severity: Severity::Error,
                matter: Matter::Kinematics,
                path,
                line: None,
                message: format!("it cannot be read: {reason}"),
                advice,
            }],
            Self::Wrong(findings) => findings,
        }
    }

    /// That the file `path` cannot be read, and what to do.
    pub fn unread(path: &Path, advice: &str) -> impl Fn(io::Error) -> Self {
        move |error| Self::Read {
            path: path.to_owned(),
            reason: error.to_string(),
            advice: advice.to_owned(),
        }
    }
}

/// What to do about a text file that exists but cannot be read; `None` if `error` has another reason.
pub(crate) fn unreadable(error: &io::Error) -> Option<&'static str> {
    match error.kind() {
        io::ErrorKind::InvalidData => Some("save it as UTF-8"),
        io::ErrorKind::PermissionDenied => Some("allow reading it"),
        io::ErrorKind::IsADirectory => Some("it is a folder: name a file, or put one in its place"),
        _ => None,
    }
}

/// What `check` makes of the file `path` and its text; `advice` is what to do when it is not there.
pub(crate) fn load<T>(
    path: &Path,
    advice: &str,
    check: impl FnOnce(&Path, &str) -> (Option<T>, Vec<Finding>),
) -> Result<T, FileError> {
    let unread = |error| FileError::unread(path, unreadable(&error).unwrap_or(advice))(error);
    let text = read_text(path).map_err(unread)?;
    let (value, findings) = check(path, &text);
    value.ok_or(FileError::Wrong(findings))
}

/// Whether `text` can be read; else reports that it is too long: the time for it grows with the square of its
/// length.
pub(crate) fn check_length(text: &str, most: usize, report: &mut Report) -> bool {
    let length = text.len();
    if length > most {
        let message = format!("the file has {length} bytes; at most {most} are read");
        report.kinematics(None, message, "remove what does not belong to the robot");
    }
    length <= most
}

/// Reads a TOML text; else reports what is wrong, by line, with an advice.
pub(crate) fn parse<T: DeserializeOwned>(text: &str, advice: &str, report: &mut Report) -> Option<T> {
    if !check_length(text, MAX_TOML, report) {
        return None;
    }
    parse_short(text, advice, report)
}

/// The same for a text that is short enough.
pub(crate) fn parse_short<T: DeserializeOwned>(text: &str, advice: &str, report: &mut Report) -> Option<T> {
    let problem = |error: toml::de::Error| {
        let start = error.span().map_or(0, |span| span.start);
        let line = text.get(..start).unwrap_or(text).matches('\n').count() + 1;
        // A key that is unknown or missing is named by the message, that of a wrong value is not.
        let message = error.message();
        let unquoted = message.starts_with("string values must be quoted");
        let message = if unquoted { "neither a number, true, false nor a text in quotes" } else { message };
        let is_value = unquoted || message.starts_with("invalid") || message.starts_with("unknown variant");
        let key = is_value.then(|| key_at(text, start)).flatten();
        let key = key.map_or_else(String::new, |key| format!(", for {key}"));
        if let Some(key) = error.span().filter(|_| message == "duplicate key").and_then(|key| text.get(key)) {
            let table =
                text.get(..start).unwrap_or_default().lines().rev().find(|line| line.starts_with('['));
            let table = table.and_then(|line| line.split(']').next()).map(|table| format!(" in {table}]"));
            let message = format!("the key {} is there twice{}", key.trim(), table.unwrap_or_default());
            return report.dynamics(Some(line), message, "remove one of the two");
        }
        report.dynamics(Some(line), in_words(message) + &key, advice);
    };
    toml::from_str(text).map_err(problem).ok()
}

/// What serde says of a value, with words instead of Rust's types.
pub fn in_words(problem: &str) -> String {
    let Some((before, expected)) = problem.rsplit_once("expected ") else { return problem.to_owned() };
    let (kind, after) = expected.split_at(expected.find([' ', '\n']).unwrap_or(expected.len()));
    let kind = match kind {
        "f32" | "f64" => "a number",
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" => "a whole number from 0 to 4294967295",
        "i32" => "a whole number",
        "u64" | "usize" => "a whole number that is not negative",
        other => other,
    };
    format!("{before}expected {kind}{after}")
}

/// The text of the file `path`, which may be linked.
///
/// # Errors
/// It cannot be read, is no regular file, such as a device or a pipe that may never end, or is too large.
pub fn read_text(path: &Path) -> io::Result<String> {
    let found = std::fs::metadata(path)?;
    // The error for a folder is that of the operating system.
    if !found.is_file() && !found.is_dir() {
        let message = "not a regular file: save the text in a file first";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
    }
    let mut text = String::new();
    File::open(path)?.take(MAX_TEXT + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_TEXT {
        let message = format!("larger than {} MiB: is it the right file?", MAX_TEXT >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(text)
}
