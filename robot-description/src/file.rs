//! Reading of text files, and of TOML with errors by path, line and column.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::finding::Report;

/// Longest URDF [bytes]. Those of whole humanoids have half of it.
pub(crate) const MAX_URDF: usize = 1 << 20;
/// Longest TOML file [bytes]. A board's sixteen joints, each with settings of its own, take a third.
pub(crate) const MAX_TOML: usize = 1 << 16;

/// Longest file that is read at all, whatever is said about it [bytes].
const MAX_TEXT: u64 = 1 << 24;

/// Why a TOML file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It does not exist, or cannot be opened.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Its content is invalid.
    #[error("{}: {message}", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// The problem, with line and column.
        message: String,
    },
}

/// Why a text is too long to be read: the time for it grows with the square of its length.
fn too_long(text: &str, most: usize) -> Option<String> {
    let length = text.len();
    (length > most).then(|| format!("the file has {length} bytes; at most {most} are read"))
}

/// Whether `text` can be read; else reports that it is too long.
pub(crate) fn check_length(text: &str, most: usize, report: &mut Report) -> bool {
    let problem = too_long(text, most);
    let fits = problem.is_none();
    if let Some(message) = problem {
        report.kinematics(None, message, "remove what does not belong to the robot");
    }
    fits
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
        let before = text.get(..start).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        // A key that is unknown or missing is named by the message, that of a wrong value is not.
        let message = error.message();
        let unquoted = message.starts_with("string values must be quoted");
        let message = if unquoted { "neither a number, true, false nor a text in quotes" } else { message };
        let is_value = unquoted || message.starts_with("invalid") || message.starts_with("unknown variant");
        let key = key_of_value(before).filter(|_| is_value);
        let key = key.map_or_else(String::new, |key| format!(", for {key}"));
        report.dynamics(Some(line), message.to_owned() + &key, advice);
    };
    toml::from_str(text).map_err(problem).ok()
}

/// The key, with those of inline tables around it, of the value that begins where `text` ends.
fn key_of_value(text: &str) -> Option<String> {
    // A list may go over many lines; the first has the key.
    let lines = text.rmatch_indices('\n').map(|(end, _)| end + 1).chain([0]);
    let statement = lines.filter_map(|begin| text.get(begin..)).find(|rest| rest.contains('='))?;
    let (before, _) = statement.rsplit_once('=')?;
    let mut path: Vec<&str> = Vec::new();
    let mut depth = 0_usize;
    for part in before.split('=') {
        depth += part.matches('{').count();
        depth = depth.saturating_sub(part.matches('}').count());
        let is_part_of_name = |c: char| c.is_alphanumeric() || "_-.".contains(c);
        path.truncate(depth);
        path.push(part.trim_end().rsplit(|c| !is_part_of_name(c)).next()?);
    }
    Some(path.join("."))
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

/// Reads a TOML file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    let toml = |message| FileError::Toml { path: path.to_owned(), message };
    let read = read_text(path);
    let text = read.map_err(|source| FileError::Read { path: path.to_owned(), source })?;
    match too_long(&text, MAX_TOML) {
        Some(message) => Err(toml(message)),
        None => toml::from_str(&text).map_err(|error| toml(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::key_of_value;

    #[test]
    fn a_value_of_the_wrong_kind_is_named_by_its_key() {
        for (text, key) in [
            ("[grasp]\nmass = ", Some("mass")),
            ("a = 1\ndamping = { translation = 3, rotation = ", Some("damping.rotation")),
            ("pid = { of = { a = 1 }, derivative = ", Some("pid.derivative")),
            ("stiffness = { matrix = [\n  [1.0, 2.0],\n  [", Some("stiffness.matrix")),
            ("[motion]\n", None),
        ] {
            assert_eq!(key_of_value(text).as_deref(), key, "{text}");
        }
    }
}
