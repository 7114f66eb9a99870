//! Files that are written completely or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Reasons why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The output directory does not exist and cannot be created.
    #[error("cannot create the directory {}: {source}; choose one you may write to with --out DIR", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A file cannot be written; its earlier content is unchanged.
    #[error("cannot write {}: {source}; check free space and permissions, or choose another --out DIR", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A name that points outside the directory.
    #[error("{name:?} is not a plain file name; give a name without directories")]
    Name {
        /// The name.
        name: String,
    },
}

/// Writes `files`, pairs of name and content, into `dir`, which is created if necessary; returns their paths.
///
/// Each file is written beside its final place and then renamed, so that neither a reader nor an interrupted
/// run ever sees half a file under its name.
pub fn write(dir: &Path, files: &[(impl AsRef<str>, impl AsRef<str>)]) -> Result<Vec<PathBuf>, WriteError> {
    create(dir)?;
    files.iter().map(|(name, contents)| write_one(dir, name.as_ref(), contents.as_ref())).collect()
}

/// Creates the directory `dir`, unless it exists. Called before a long run, which would otherwise be in vain.
///
/// # Errors
/// It cannot be created.
pub fn create(dir: &Path) -> Result<(), WriteError> {
    fs::create_dir_all(dir).map_err(|source| WriteError::Directory { path: dir.to_owned(), source })
}

fn write_one(dir: &Path, name: &str, contents: &str) -> Result<PathBuf, WriteError> {
    if Path::new(name).file_name() != Some(name.as_ref()) {
        return Err(WriteError::Name { name: name.to_owned() });
    }
    let path = dir.join(name);
    let unfinished = dir.join(format!(".{name}.{}.tmp", std::process::id()));
    let written = fs::write(&unfinished, contents).and_then(|()| fs::rename(&unfinished, &path));
    written.map_err(|source| {
        // Best effort: the first error is the one that matters.
        let _ = fs::remove_file(&unfinished);
        WriteError::File { path: path.clone(), source }
    })?;
    Ok(path)
}
