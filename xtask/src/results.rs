//! Files of results, one a line, that are complete or not there: a job that dies leaves no half of one, and
//! one that runs twice, even at once, leaves the same.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

/// A file that gets its name when it is complete. Until then, or for good, it has a name of its own that ends
/// in `.part`.
pub struct ResultsFile {
    path: PathBuf,
    part: PathBuf,
    file: File,
}

impl ResultsFile {
    /// Begins the file `path`, and its folder.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let create = || -> Result<_> {
            let folder = path.parent().context("no folder")?;
            fs::create_dir_all(folder)?;
            let name = path.file_name().context("no name")?.to_string_lossy();
            let part =
                tempfile::Builder::new().prefix(&format!("{name}.")).suffix(".part").tempfile_in(folder)?;
            Ok(part.keep()?)
        };
        let (file, part) = create().with_context(|| path.display().to_string())?;
        Ok(Self { path: path.to_owned(), part, file })
    }

    /// Adds a line.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, result: &impl Serialize) -> Result<()> {
        let line = serde_json::to_string(result)? + "\n";
        self.file.write_all(line.as_bytes()).with_context(|| self.part.display().to_string())
    }

    /// Gives the file its name, in place of one that is there, and returns that.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn finish(self) -> Result<PathBuf> {
        fs::rename(&self.part, &self.path).with_context(|| self.path.display().to_string())?;
        Ok(self.path)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_file_is_complete_or_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("parts").join("1-of-2.jsonl");
        let mut dies = ResultsFile::create(&path).unwrap();
        let mut first = ResultsFile::create(&path).unwrap();
        let mut second = ResultsFile::create(&path).unwrap();
        for file in [&mut dies, &mut first, &mut second] {
            file.add(&1).unwrap();
        }
        drop(dies);
        assert!(!path.exists());
        first.add(&2).unwrap();
        assert_eq!(first.finish().unwrap(), path);
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n2\n");
        second.add(&2).unwrap();
        second.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "1\n2\n");
        let left = path.parent().unwrap().read_dir().unwrap().map(|file| file.unwrap().file_name());
        let left: Vec<String> = left.map(|name| name.into_string().unwrap()).collect();
        assert_eq!(left.len(), 2, "{left:?}");
        assert!(
            left.iter().any(|name| name.starts_with("1-of-2.jsonl.") && name.ends_with(".part")),
            "{left:?}"
        );
    }
}
