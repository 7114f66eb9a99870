//! What is wrong in a file that people write, where, and what to do about it.

use std::fmt;
use std::path::{Path, PathBuf};

/// How a finding weighs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// Works, but look at it.
    Warning,
    /// Does not work.
    Error,
}

/// What a finding spoils.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matter {
    /// Where things are: nothing can be computed.
    Kinematics,
    /// Where joints may go: the inverse cannot be computed.
    Limits,
    /// Masses, limits of torque, settings: places can be computed all the same.
    Dynamics,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How it weighs.
    pub weight: Weight,
    /// What it spoils.
    pub matter: Matter,
    /// The file, or the folder when it is none of its files alone.
    pub path: PathBuf,
    /// The line, counted from 1, where one is to blame.
    pub line: Option<usize>,
    /// What is wrong, with the name and the value.
    pub message: String,
    /// What to do.
    pub advice: String,
}

impl Finding {
    /// `path` or `path:line`, as editors and terminals understand it.
    pub fn place(&self) -> String {
        match self.line {
            Some(line) => format!("{}:{line}", self.path.display()),
            None => self.path.display().to_string(),
        }
    }

    /// Whether it is an error.
    pub fn is_error(&self) -> bool {
        self.weight == Weight::Error
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place(), self.message)?;
        if self.advice.is_empty() { Ok(()) } else { write!(f, "; {}", self.advice) }
    }
}

/// Collects the findings of one file.
#[derive(Debug)]
pub(crate) struct Report {
    path: PathBuf,
    pub findings: Vec<Finding>,
}

impl Report {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), findings: Vec::new() }
    }

    /// A finding about where things are.
    pub fn kinematics(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Weight::Error, Matter::Kinematics, line, message.into(), advice.into());
    }

    /// A finding about where joints may go.
    pub fn limits(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Weight::Error, Matter::Limits, line, message.into(), advice.into());
    }

    /// A finding about masses, torques or settings.
    pub fn dynamics(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Weight::Error, Matter::Dynamics, line, message.into(), advice.into());
    }

    /// Something that works, but is worth a look.
    pub fn warning(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Weight::Warning, Matter::Dynamics, line, message.into(), advice.into());
    }

    /// In the order of the file.
    pub fn sort(&mut self) {
        self.findings.sort_by_key(|finding| finding.line);
    }

    fn push(&mut self, weight: Weight, matter: Matter, line: Option<usize>, message: String, advice: String) {
        let path = self.path.clone();
        self.findings.push(Finding { weight, matter, path, line, message, advice });
    }
}
