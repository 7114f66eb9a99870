//! A robot as users lay it out: a folder with `robot.urdf` (kinematics, inertias, limits, friction) and
//! `controller.toml` (motors, encoders, gains, safety, keyed by the URDF's joint names).

mod build;
mod chain;
mod settings;
mod tree;

use std::path::{Path, PathBuf};

use tesaki::model::RobotModel;

pub use chain::chain_model;
pub use settings::{JointSettings, Settings};

use crate::finding::{Finding, Report};
use crate::urdf::{self, Urdf};

/// What is wrong with a robot folder.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}; a robot folder holds robot.urdf and controller.toml")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// What is wrong in its files: every error that can be found.
    #[error("{}", urdf::list(.0))]
    Wrong(Vec<Finding>),
}

/// A robot folder, read and checked.
#[derive(Clone, Debug)]
pub struct RobotFolder {
    /// Where it lies.
    pub path: PathBuf,
    /// The URDF as it stands there.
    pub urdf: Urdf,
    /// The model for the controller, validated.
    pub model: RobotModel,
}

impl RobotFolder {
    /// Reads the folder at `path`.
    ///
    /// # Errors
    /// What is missing or wrong, where, and what to do.
    pub fn load(path: &Path) -> Result<Self, RobotError> {
        let (urdf, settings) = Self::read(path)?;
        Self::parse(path, &urdf, &settings)
    }

    /// The texts of `robot.urdf` and `controller.toml` in the folder at `path`.
    ///
    /// # Errors
    /// One cannot be read.
    pub fn read(path: &Path) -> Result<(String, String), RobotError> {
        let read = |name: &str| {
            let path = path.join(name);
            std::fs::read_to_string(&path).map_err(|source| RobotError::Read { path, source })
        };
        Ok((read("robot.urdf")?, read("controller.toml")?))
    }

    /// Makes a robot of the texts of both files; `path` is named in errors.
    ///
    /// # Errors
    /// As [`RobotFolder::load`].
    pub fn parse(path: &Path, urdf: &str, settings: &str) -> Result<Self, RobotError> {
        let (folder, mut findings) = Self::check(path, urdf, settings);
        findings.retain(Finding::is_error);
        folder.ok_or(RobotError::Wrong(findings))
    }

    /// Everything that is wrong with the texts of both files, and the robot when nothing but warnings is.
    pub fn check(path: &Path, urdf: &str, settings: &str) -> (Option<Self>, Vec<Finding>) {
        let mut of_urdf = Report::new(&path.join("robot.urdf"));
        let mut of_settings = Report::new(&path.join("controller.toml"));
        let checked = Urdf::check(&path.join("robot.urdf"), urdf);
        let tree = checked.0;
        of_urdf.findings = checked.1;
        let chains = tree.as_ref().map(|tree| tree::serial_chains(tree, &mut of_urdf));
        // Without a tree there are names all the same.
        let names = match &chains {
            Some(chains) => {
                chains.iter().flat_map(|chain| &chain.joints).map(|joint| joint.name.clone()).collect()
            }
            None => urdf::names_of_moving_joints(urdf),
        };
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let parsed = Settings::parse(settings, &names, &mut of_settings);
        let mut model = None;
        if let (Some(tree), Some(chains), Some(parsed)) = (&tree, &chains, &parsed) {
            model = build::model(tree, chains, parsed);
            if let Some(model) = &model {
                build::validate(model, tree, settings, &mut of_urdf, &mut of_settings);
            }
        }
        of_urdf.sort();
        of_settings.sort();
        let findings: Vec<Finding> = of_urdf.findings.into_iter().chain(of_settings.findings).collect();
        let folder = match (tree, model) {
            (Some(tree), Some(model)) if !findings.iter().any(Finding::is_error) => {
                Some(Self { path: path.to_owned(), urdf: tree, model })
            }
            _ => None,
        };
        (folder, findings)
    }
}
