//! Reading of TOML files, with errors by path, line and column.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

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

/// Reads a TOML file.
pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    let place = || path.to_path_buf();
    let text = std::fs::read_to_string(path).map_err(|source| FileError::Read { path: place(), source })?;
    toml::from_str(&text).map_err(|error| FileError::Toml { path: place(), message: error.to_string() })
}
