//! Files that are whole or not there.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The output directory is not there and cannot be made.
    #[error("cannot create the directory {}: {source}; choose one you may write to with --out DIR", path.display())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file cannot be written; what it held before is untouched.
    #[error("cannot write {}: {source}; check free space and permissions, or choose another --out DIR", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A name that would lead out of the directory.
    #[error("{name:?} is not a plain file name; give a name without directories")]
    Name {
        /// The name.
        name: String,
    },
}

/// Writes `files`, pairs of name and contents, into `dir`, which is made if need be; returns their paths.
///
/// Each file is written beside its final place and then renamed, so that a reader, or a run that is
/// interrupted, never leaves half a file under its name.
pub fn write(dir: &Path, files: &[(impl AsRef<str>, impl AsRef<str>)]) -> Result<Vec<PathBuf>, WriteError> {
    create(dir)?;
    files.iter().map(|(name, contents)| write_one(dir, name.as_ref(), contents.as_ref())).collect()
}

/// Makes the directory `dir`, unless it is there: before a long run, which would be for nothing.
///
/// # Errors
/// It cannot be made.
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
        // Best effort: the first error is the one to tell.
        let _ = fs::remove_file(&unfinished);
        WriteError::File { path: path.clone(), source }
    })?;
    Ok(path)
}
