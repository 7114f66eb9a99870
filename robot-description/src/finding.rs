//! Findings about a user's files: problem, location and advice.

use std::fmt;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use crate::line::Lines;

/// Severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Works, but deserves attention.
    Warning,
    /// Does not work.
    Error,
}

/// What a finding prevents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matter {
    /// Kinematics: nothing can be computed.
    Kinematics,
    /// Joint limits: the inverse kinematics cannot be computed.
    Limits,
    /// Masses, torque limits, settings: positions can still be computed.
    Dynamics,
}

/// A problem of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// What it prevents.
    pub matter: Matter,
    /// The file, or the folder if it concerns several files.
    pub path: PathBuf,
    /// The line, counted from 1, if known.
    pub line: Option<usize>,
    /// The problem, with name and value.
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

    /// The name of the joint that it is about, and what follows, when it is about one.
    pub fn joint(&self) -> Option<&str> {
        self.message.strip_prefix("joint ")
    }

    /// Whether it is about the joint `name`.
    pub fn is_about_joint(&self, name: &str) -> bool {
        self.joint().is_some_and(|rest| begins_with_name(rest, name))
    }

    /// Whether it is about the link `name`.
    pub fn is_about_link(&self, name: &str) -> bool {
        self.message.strip_prefix("link ").is_some_and(|rest| begins_with_name(rest, name))
    }

    /// Whether it is an error.
    pub fn is_error(&self) -> bool {
        self.severity == Severity::Error
    }
}

fn begins_with_name(text: &str, name: &str) -> bool {
    text.strip_prefix(name).is_some_and(|rest| rest.starts_with([':', ' ']))
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
    lines: Lines,
    pub findings: Vec<Finding>,
}

impl Report {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), lines: Lines::default(), findings: Vec::new() }
    }

    /// On a TOML file with this text.
    pub fn of_toml(path: &Path, text: &str) -> Self {
        Self { lines: Lines::of(text), ..Self::new(path) }
    }

    /// The line of a key of the TOML file, with its tables.
    pub fn line_of(&self, key: &str) -> Option<usize> {
        self.lines.get(key)
    }

    /// Adds a finding about the kinematics.
    pub fn kinematics(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Severity::Error, Matter::Kinematics, line, message.into(), advice.into());
    }

    /// Adds a finding about joint limits.
    pub fn limits(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Severity::Error, Matter::Limits, line, message.into(), advice.into());
    }

    /// Adds a finding about masses, torques or settings.
    pub fn dynamics(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Severity::Error, Matter::Dynamics, line, message.into(), advice.into());
    }

    /// Adds a warning.
    pub fn warning(&mut self, line: Option<usize>, message: impl Into<String>, advice: impl Into<String>) {
        self.push(Severity::Warning, Matter::Dynamics, line, message.into(), advice.into());
    }

    /// Whether nothing prevents the kinematics.
    pub fn has_no_kinematics(&self) -> bool {
        self.findings.iter().all(|finding| finding.matter != Matter::Kinematics)
    }

    /// Whether something in these lines prevents the kinematics.
    pub fn has_kinematics_in(&self, lines: RangeInclusive<usize>) -> bool {
        let findings = self.findings.iter().filter(|finding| finding.matter == Matter::Kinematics);
        findings.filter_map(|finding| finding.line).any(|line| lines.contains(&line))
    }

    /// In the order of the file.
    pub fn sort(&mut self) {
        self.findings.sort_by_key(|finding| finding.line);
    }

    fn push(
        &mut self,
        severity: Severity,
        matter: Matter,
        line: Option<usize>,
        message: String,
        advice: String,
    ) {
        let path = self.path.clone();
        self.findings.push(Finding { severity, matter, path, line, message, advice });
    }
}
