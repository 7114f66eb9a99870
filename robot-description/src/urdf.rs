//! URDF files: what is wrong with them, all of it and by line, and the serial paths from a base to the tips.
//!
//! - [`Urdf::check`] reads a text and tells every [`Finding`];
//! - [`Urdf::path`] is the chain of rotary joints from the base to any link, through fixed and mimic joints.
//!
//! `urdf-rs` makes the values and `roxmltree` knows the lines.

mod fold;
mod inertia;
mod joints;
mod nearest;
mod numbers;
mod path;
mod source;
mod spelling;
mod structure;
mod unread;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::file::{read_text, unreadable};
use crate::finding::{Finding, Matter, Report};
use crate::robot::settings::accepted_inertias;
use source::Source;

pub use fold::{MassProperties, RigidBody, axis, isometry, point_inertia, rotated_inertia};
pub(crate) use fold::{narrow, pose, single};
pub(crate) use joints::LARGEST_ANGLE;
pub use path::{Drive, NoLeader, PathJoint, SerialPath, followed};

/// A URDF whose links form a tree.
#[derive(Clone, Debug)]
pub struct Urdf {
    /// The file.
    pub path: PathBuf,
    /// Its content.
    pub robot: urdf_rs::Robot,
    base: String,
    line: usize,
    link_lines: BTreeMap<String, usize>,
    joint_lines: BTreeMap<String, usize>,
}

impl Urdf {
    /// Reads the URDF at `path`: the file itself, or `robot.urdf` in a folder. Also returns the other errors:
    /// those about a single joint matter to the paths through it, the rest does not matter.
    ///
    /// # Errors
    /// The file cannot be read, or what is wrong in the `matters` given.
    pub fn load(path: &Path, matters: &[Matter]) -> Result<(Self, Vec<Finding>), UrdfError> {
        let accepted = match read_text(&path.join("controller.toml")) {
            Ok(settings) => accepted_inertias(&settings),
            Err(_) => Vec::new(),
        };
        let path = Self::locate(path);
        let text = Self::read_text(&path)?;
        let (urdf, mut findings) = Self::check_accepting(&path, &text, &accepted);
        findings.retain(Finding::is_error);
        let matters = |finding: &Finding| match finding.matter {
            Matter::Kinematics => finding.joint().is_none(),
            matter => matters.contains(&matter),
        };
        match urdf {
            Some(urdf) if !findings.iter().any(matters) => Ok((urdf, findings)),
            Some(_) => {
                findings.retain(matters);
                Err(UrdfError::Wrong(findings))
            }
            None => {
                findings.retain(|finding| finding.matter == Matter::Kinematics);
                Err(UrdfError::Wrong(findings))
            }
        }
    }

    /// The file meant by `path`, which may be a folder.
    pub fn locate(path: &Path) -> PathBuf {
        if path.is_dir() { path.join("robot.urdf") } else { path.to_owned() }
    }

    /// The content of the file `path`.
    ///
    /// # Errors
    /// It cannot be read; what may have been meant.
    pub fn read_text(path: &Path) -> Result<String, UrdfError> {
        let read = read_text(path);
        read.map_err(|source| UrdfError::Read { path: path.to_owned(), hint: hint(path, &source), source })
    }

    /// Reads `text`, the content of `path`. There is a URDF when its links form a tree; other things may be
    /// wrong.
    pub fn check(path: &Path, text: &str) -> (Option<Self>, Vec<Finding>) {
        Self::check_accepting(path, text, &[])
    }

    /// [`Urdf::check`], where the links in `accepted` may have an inertia that no body can have: it is
    /// replaced by the nearest possible one.
    pub fn check_accepting(path: &Path, text: &str, accepted: &[String]) -> (Option<Self>, Vec<Finding>) {
        let mut report = Report::new(path);
        let urdf = Self::read(path, text, accepted, &mut report);
        report.sort();
        (urdf, report.findings)
    }

    fn read(path: &Path, text: &str, accepted: &[String], report: &mut Report) -> Option<Self> {
        let document = source::parse(text, report)?;
        let starts = source::line_starts(text);
        let source = Source::new(&document, &starts, report)?;
        numbers::check(&source, report);
        spelling::check(&source, report);
        let base = structure::check(&source, report);
        joints::check(&source, report);
        inertia::check(&source, accepted, report);
        let mut robot = unread::read(text, &source, report)?;
        for link in robot.links.iter_mut().filter(|link| accepted.contains(&link.name)) {
            nearest::replace(&mut link.inertial);
        }
        let (link_lines, joint_lines) = (source::lines(&source.links), source::lines(&source.joints));
        let line = source.root.line();
        Some(Self { path: path.to_owned(), robot, base: base?, line, link_lines, joint_lines })
    }

    /// The links of `text`, the content of `path`, whose inertia no body can have; of bodies that move and
    /// have no mass or no inertia, the first link.
    pub fn impossible_inertias(path: &Path, text: &str) -> Vec<String> {
        let mut report = Report::new(path);
        let Some(document) = source::parse(text, &mut report) else { return Vec::new() };
        let starts = source::line_starts(text);
        let Some(source) = Source::new(&document, &starts, &mut report) else { return Vec::new() };
        let mut links = inertia::impossible(&source);
        if let (Some(urdf), _) = Self::check_accepting(path, text, &links) {
            links.extend(urdf.bodies_without_inertia().into_iter().map(|(_, link)| link));
        }
        links
    }

    /// Joint and first link of every body that moves, but has no mass or no inertia.
    pub fn bodies_without_inertia(&self) -> Vec<(String, String)> {
        let moving = self.robot.joints.iter().filter(|joint| joint.joint_type != urdf_rs::JointType::Fixed);
        let empty = moving.filter(|joint| {
            let masses = RigidBody::new(&self.robot, &joint.child.link).mass_properties();
            masses.mass <= 0.0 || masses.inertia.symmetric_eigenvalues().min() <= 0.0
        });
        empty.map(|joint| (joint.name.clone(), joint.child.link.clone())).collect()
    }

    /// The link that hangs on no joint.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// The line of the robot.
    pub fn line(&self) -> usize {
        self.line
    }

    /// Whether there is a link `name`.
    pub fn has_link(&self, name: &str) -> bool {
        self.robot.links.iter().any(|link| link.name == name)
    }

    /// The line of the link `name`.
    pub fn line_of_link(&self, name: &str) -> Option<usize> {
        self.link_lines.get(name).copied()
    }

    /// The line of the joint `name`.
    pub fn line_of_joint(&self, name: &str) -> Option<usize> {
        self.joint_lines.get(name).copied()
    }
}

/// The joints in `text` that move, also when they make no tree.
pub(crate) fn names_of_moving_joints(text: &str) -> Vec<String> {
    let Some(document) = source::parse(text, &mut Report::new(Path::new(""))) else { return Vec::new() };
    let starts = source::line_starts(text);
    let source = Source::new(&document, &starts, &mut Report::new(Path::new("")));
    let moving = source.iter().flat_map(|source| &source.joints).filter(|joint| joint.moves());
    moving.map(|joint| joint.name().to_owned()).collect()
}

/// What to do about a file that cannot be read; the URDF files beside one that is not there may have been
/// meant.
fn hint(path: &Path, error: &std::io::Error) -> String {
    if let Some(advice) = unreadable(error) {
        return advice.to_owned();
    }
    if let std::io::ErrorKind::InvalidInput | std::io::ErrorKind::FileTooLarge = error.kind() {
        return "name a URDF file, or a folder with robot.urdf".to_owned();
    }
    let folder = path.parent().unwrap_or(path);
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|file| file.extension().is_some_and(|extension| extension == "urdf"))
        .map(|file| file.display().to_string())
        .collect();
    names.sort();
    let meant = if names.is_empty() { String::new() } else { format!("; there is {}", names.join(", ")) };
    format!("name a URDF file, or a folder with robot.urdf{meant}")
}

/// Why there is no URDF.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}; {hint}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What to do.
        hint: String,
        /// Why.
        source: std::io::Error,
    },
    /// What is wrong with its kinematics.
    #[error("{}", list(.0))]
    Wrong(Vec<Finding>),
    /// What was asked for is not in it, or cannot be computed.
    #[error("{0}")]
    Path(Finding),
}

/// A number with four digits at most.
pub(crate) fn four(value: f64) -> String {
    format!("{value:.3e}").parse::<f64>().unwrap_or(value).to_string()
}

/// The findings, one a line.
pub(crate) fn list(findings: &[Finding]) -> String {
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}
