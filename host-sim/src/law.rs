//! Selection of the control laws that a run compares: files of the robot or the user.

use std::path::{Path, PathBuf};

use crate::scenario::{SCENARIOS, Scenario};

/// A file that describes a control law and the experiments of a paper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LawFile {
    /// Its name in tables and figures: the file name without the extension.
    pub name: String,
    /// Path of the file.
    pub path: PathBuf,
}

/// Why a law was not found.
#[derive(Debug, thiserror::Error)]
pub enum LawError {
    /// The scenario compares no laws.
    #[error("--law {law}: {scenario} does not compare laws; scenarios that do: {known}")]
    NotCompared {
        /// The requested law.
        law: String,
        /// The scenario.
        scenario: &'static str,
        /// Scenarios that compare laws.
        known: String,
    },
    /// The robot lacks a law that the scenario compares by default.
    #[error(
        "{} has no law {law}, which {scenario} compares; its laws are {known}. Choose others with --law",
        folder.display()
    )]
    Missing {
        /// The default law.
        law: String,
        /// The scenario.
        scenario: &'static str,
        /// Folder of the robot's laws.
        folder: PathBuf,
        /// Their names.
        known: String,
    },
    /// There is no such file.
    #[error("--law {law}: neither a file nor a law of {}; its laws are: {known}", folder.display())]
    Unknown {
        /// The requested law.
        law: String,
        /// Folder of the robot's laws.
        folder: PathBuf,
        /// Their names.
        known: String,
    },
    /// Two laws have the same name, but for punctuation.
    #[error(
        "--law {law}: there is a law called {name:?} already; results are told apart by the letters and digits of the name: give each law once, by a name of its own"
    )]
    SameName {
        /// The requested law.
        law: String,
        /// The name of the other law.
        name: String,
    },
}

impl LawFile {
    /// Finds the laws `asked` for in the folder of the `robot`: names of files in its `laws/`, or paths. If
    /// none are given, returns the scenario's defaults.
    ///
    /// # Errors
    /// A law does not exist or cannot be compared; the error describes the first.
    pub fn find(scenario: &Scenario, robot: &Path, asked: &[String]) -> Result<Vec<Self>, LawError> {
        let Some(default) = scenario.laws else {
            return match asked.first() {
                None => Ok(Vec::new()),
                Some(law) => {
                    let known = SCENARIOS.iter().filter(|other| other.laws.is_some());
                    let known = list(known.map(|other| other.name.to_owned()).collect());
                    Err(LawError::NotCompared { law: law.clone(), scenario: scenario.name, known })
                }
            };
        };
        let folder = robot.join("laws");
        let default: Vec<String> = default.iter().map(|&law| law.to_owned()).collect();
        let mut laws: Vec<Self> = Vec::new();
        for law in if asked.is_empty() { &default } else { asked } {
            let found = Self::locate(&folder, law).map_err(|error| match error {
                LawError::Unknown { law, folder, known } if asked.is_empty() => {
                    LawError::Missing { law, scenario: scenario.name, folder, known }
                }
                other => other,
            })?;
            if let Some(other) = laws.iter().find(|other| other.key() == found.key()) {
                return Err(LawError::SameName { law: law.clone(), name: other.name.clone() });
            }
            laws.push(found);
        }
        Ok(laws)
    }

    /// Its name as a part of the names of metrics and files.
    pub fn key(&self) -> String {
        self.name.chars().map(|letter| if letter.is_alphanumeric() { letter } else { '_' }).collect()
    }

    fn locate(folder: &Path, law: &str) -> Result<Self, LawError> {
        let named = folder.join(format!("{law}.toml"));
        let path = if named.is_file() { named } else { PathBuf::from(law) };
        match path.file_stem().and_then(|stem| stem.to_str()) {
            Some(name) if path.is_file() => Ok(Self { name: name.to_owned(), path }),
            _ => {
                let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
                let files = files
                    .map(|file| file.path())
                    .filter(|file| file.extension().is_some_and(|end| end == "toml"));
                let names = files.filter_map(|file| Some(file.file_stem()?.to_str()?.to_owned())).collect();
                Err(LawError::Unknown { law: law.to_owned(), folder: folder.to_owned(), known: list(names) })
            }
        }
    }
}

/// Makes equal titles of laws distinct by adding the file names; `laws` are names and titles.
pub fn tell_apart<'a>(laws: impl Iterator<Item = (&'a str, &'a mut String)>) {
    let laws: Vec<(&str, &mut String)> = laws.collect();
    let titles: Vec<String> = laws.iter().map(|(_, title)| (*title).clone()).collect();
    for (name, title) in laws {
        if titles.iter().filter(|other| *other == title).count() > 1 {
            *title = format!("{title} ({name})");
        }
    }
}

/// Lists names in sorted order.
fn list(mut names: Vec<String>) -> String {
    names.sort();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// A folder with the laws `a` and `b`, and another file elsewhere that is also called `a`.
    fn robot() -> tempfile::TempDir {
        let robot = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(robot.path().join("laws")).unwrap();
        for file in ["laws/a.toml", "laws/b.toml", "laws/notes.md", "a.toml"] {
            std::fs::write(robot.path().join(file), "").unwrap();
        }
        robot
    }

    fn find(laws: Option<&'static [&'static str]>, asked: &[&str]) -> Result<Vec<String>, String> {
        let robot = robot();
        let scenario = Scenario { laws, ..SCENARIOS[0] };
        let asked: Vec<String> =
            asked.iter().map(|law| law.replace("ROBOT", robot.path().to_str().unwrap())).collect();
        let found = LawFile::find(&scenario, robot.path(), &asked).map_err(|error| error.to_string())?;
        Ok(found.into_iter().map(|law| law.name).collect())
    }

    #[test]
    fn laws_are_names_of_the_robot_or_files() {
        assert_eq!(find(Some(&["a", "b"]), &[]).unwrap(), ["a", "b"]);
        assert_eq!(find(Some(&["a", "b"]), &["b"]).unwrap(), ["b"]);
        assert_eq!(find(Some(&[]), &["ROBOT/a.toml", "b"]).unwrap(), ["a", "b"]);
        assert_eq!(find(None, &[]).unwrap(), [""; 0]);
    }

    #[test]
    fn laws_with_one_title_are_told_apart_by_their_files() {
        let mut titles = ["ours", "the paper's law", "ours"].map(str::to_owned);
        tell_apart(["tesaki", "paper", "fixed"].into_iter().zip(&mut titles));
        assert_eq!(titles, ["ours (tesaki)", "the paper's law", "ours (fixed)"]);
    }

    #[test]
    fn what_cannot_be_compared_is_named() {
        let error = find(Some(&["a"]), &["c"]).unwrap_err();
        assert!(error.starts_with("--law c: neither a file nor a law of "), "{error}");
        assert!(error.ends_with("its laws are: a, b"), "{error}");
        let error = find(Some(&["a", "c"]), &[]).unwrap_err();
        assert!(error.contains(" has no law c, which hand3-servo compares; its laws are a, b."), "{error}");
        let error = find(Some(&["a"]), &["a", "ROBOT/a.toml"]).unwrap_err();
        assert!(error.contains("there is a law called \"a\" already"), "{error}");
        let error = find(None, &["a"]).unwrap_err();
        assert!(error.starts_with("--law a: hand3-servo does not compare laws"), "{error}");
    }
}
