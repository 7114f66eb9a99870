//! Reading of TOML files, with errors by path, line and column.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::finding::Report;

/// Longest URDF [bytes]. Those of whole humanoids have half of it.
pub(crate) const MAX_URDF: usize = 1 << 20;
/// Longest TOML file [bytes]. A board's sixteen joints, each with settings of its own, take a third.
pub(crate) const MAX_TOML: usize = 1 << 16;

/// Why a TOML file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It does not exist, or cannot be opened.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
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
    let problem = |error: toml::de::Error| {
        let start = error.span().map_or(0, |span| span.start);
        let line = text.get(..start).unwrap_or(text).matches('\n').count() + 1;
        report.dynamics(Some(line), error.message(), advice);
    };
    toml::from_str(text).map_err(problem).ok()
}

/// Reads a TOML file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    let toml = |message| FileError::Toml { path: path.to_owned(), message };
    let read = std::fs::read_to_string(path);
    let text = read.map_err(|source| FileError::Read { path: path.to_owned(), source })?;
    match too_long(&text, MAX_TOML) {
        Some(message) => Err(toml(message)),
        None => toml::from_str(&text).map_err(|error| toml(error.to_string())),
    }
}
