//! A robot as users lay it out: a folder with `robot.urdf` (kinematics, inertias, limits, friction) and
//! `controller.toml` (motors, encoders, gains, safety, keyed by the URDF's joint names).

mod build;
mod chain;
mod doubtful;
mod limits;
mod of_joints;
mod plausible;
pub(crate) mod settings;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod shipped;
pub(crate) mod tree;
mod unit;

use std::io;
use std::path::{Path, PathBuf};

use tesaki::model::RobotModel;

pub use chain::{chain_length, chain_model, named};
pub use doubtful::doubtful_values;
pub use limits::{ImplausibleValue, implausible_values};
pub(crate) use limits::{at_least, following_errors, least_torque_rate};
pub(crate) use plausible::LEAD;
pub use plausible::{Overload, overloaded};
pub use settings::{FrictionSettings, JointSettings, Settings};
pub(crate) use unit::invalid_setting;
pub use unit::{invalid_value, unit};

use crate::file::{FileError, read_text, unreadable};
use crate::finding::{Finding, Report};
use crate::plant::PlantValues;
use crate::urdf::{self, Urdf};

/// What to do about a file that cannot be read for the reason `error`.
fn advice(path: &Path, error: &io::Error) -> String {
    if let Some(advice) = unreadable(error) {
        return advice.to_owned();
    }
    let folder = path.parent().unwrap_or(path);
    if folder.is_file() {
        let around = folder.parent().filter(|around| !around.as_os_str().is_empty());
        return format!("give the folder, {}", around.unwrap_or(Path::new(".")).display());
    }
    let lacks_settings = !path.exists() && folder.join("robot.urdf").is_file();
    if lacks_settings {
        format!("`tesaki model init {}` writes it, for the robot.urdf there", folder.display())
    } else {
        "a robot folder holds robot.urdf and controller.toml".to_owned()
    }
}

/// A robot folder, read and checked.
#[derive(Clone, Debug)]
pub struct RobotFolder {
    /// Where it lies.
    pub path: PathBuf,
    /// The URDF, with what `controller.toml` corrects: friction, limits, accepted inertias.
    pub urdf: Urdf,
    /// The model for the controller, validated.
    pub model: RobotModel,
}

impl RobotFolder {
    /// Reads the folder at `path`.
    ///
    /// # Errors
    /// What is missing or wrong, where, and what to do.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        let (urdf, settings) = Self::read(path)?;
        Self::parse(path, &urdf, &settings)
    }

    /// Reads the folder at `path` for a machine, or for a plant with the text of its `plant.toml`: what
    /// [`check_all`](Self::check_all) calls an error is one. Returns its warnings as well.
    ///
    /// # Errors
    /// What is missing, wrong or not plausible, where, and what to do.
    pub fn load_plausible(path: &Path, plant: Option<&str>) -> Result<(Self, Vec<Finding>), FileError> {
        let (urdf, settings) = Self::read(path)?;
        let (folder, findings) = Self::check_all(path, &urdf, &settings, plant);
        let (errors, warnings) = findings.into_iter().partition(Finding::is_error);
        Ok((folder.ok_or(FileError::Wrong(errors))?, warnings))
    }

    /// The texts of `robot.urdf` and `controller.toml` in the folder at `path`.
    ///
    /// # Errors
    /// One cannot be read.
    pub fn read(path: &Path) -> Result<(String, String), FileError> {
        Ok((Self::read_file(path, "robot.urdf")?, Self::read_file(path, "controller.toml")?))
    }

    /// The text of one of these two files.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn read_file(path: &Path, name: &str) -> Result<String, FileError> {
        let path = path.join(name);
        read_text(&path).map_err(|error| FileError::unread(&path, &advice(&path, &error))(error))
    }

    /// Makes a robot of the texts of both files; `path` is named in errors.
    ///
    /// # Errors
    /// As [`RobotFolder::load`].
    pub fn parse(path: &Path, urdf: &str, settings: &str) -> Result<Self, FileError> {
        let (folder, mut findings) = Self::check(path, urdf, settings);
        findings.retain(Finding::is_error);
        folder.ok_or(FileError::Wrong(findings))
    }

    /// Everything that is wrong with the texts of both files, and the robot when nothing but warnings is.
    pub fn check(path: &Path, urdf: &str, settings: &str) -> (Option<Self>, Vec<Finding>) {
        let (folder, findings) = Self::read_texts(path, urdf, settings);
        (folder.filter(|_| !findings.iter().any(Finding::is_error)), findings)
    }

    /// Everything that is wrong or not plausible in the texts of the three files, and the robot when nothing
    /// but warnings is. A robot that is not simulated has no `plant.toml`.
    pub fn check_all(
        path: &Path,
        urdf: &str,
        settings: &str,
        plant: Option<&str>,
    ) -> (Option<Self>, Vec<Finding>) {
        let (folder, mut findings) = Self::read_texts(path, urdf, settings);
        match (folder.as_ref().filter(|folder| plausible::is_checkable(&folder.model)), plant) {
            (Some(folder), _) => {
                let more = plausible::check(folder, settings, plant, &findings);
                findings.extend(more);
            }
            // What else is wrong can be told without the robot.
            (None, Some(plant)) => findings.extend(PlantValues::check(&path.join("plant.toml"), plant).1),
            (None, None) => {}
        }
        (folder.filter(|_| !findings.iter().any(Finding::is_error)), findings)
    }

    /// The robot, which may be wrong, and everything that is.
    fn read_texts(path: &Path, urdf: &str, settings: &str) -> (Option<Self>, Vec<Finding>) {
        let mut of_urdf = Report::new(&path.join("robot.urdf"));
        let mut of_settings = Report::of_toml(&path.join("controller.toml"), settings);
        let accepted = settings::accepted_inertias(settings);
        let checked = Urdf::check_accepting(&path.join("robot.urdf"), urdf, &accepted);
        let mut tree = checked.0;
        of_urdf.findings = checked.1;
        for link in accepted.iter().filter(|name| tree.as_ref().is_some_and(|tree| !tree.has_link(name))) {
            let line = of_settings.line_of("accept_inertia");
            of_settings.dynamics(line, format!("accept_inertia: the URDF has no link {link}"), "remove it");
        }
        let chains = tree.as_ref().map(|tree| tree::serial_chains(tree, &mut of_urdf));
        // Without a tree there are names all the same.
        let names = match &chains {
            Some(chains) => {
                chains.iter().flat_map(|chain| &chain.joints).map(|joint| joint.name.clone()).collect()
            }
            None => urdf::names_of_moving_joints(urdf),
        };
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        if names.is_empty() {
            let message = "its joints are not checked: no joint of robot.urdf can be read";
            of_settings.warning(None, message, "correct robot.urdf first");
        }
        let parsed = Settings::parse(settings, &names, &mut of_settings);
        let mut model = None;
        if let (Some(tree), Some(chains), Some(parsed)) = (&tree, &chains, &parsed) {
            model = build::model(tree, chains, parsed);
            if let Some(model) = &model {
                build::validate(model, tree, &mut of_urdf, &mut of_settings);
            }
        }
        if let (Some(tree), Some(parsed)) = (&mut tree, &parsed) {
            build::correct(tree, parsed);
        }
        of_urdf.sort();
        of_settings.sort();
        let findings: Vec<Finding> = of_urdf.findings.into_iter().chain(of_settings.findings).collect();
        let folder = match (tree, model) {
            (Some(urdf), Some(model)) => Some(Self { path: path.to_owned(), urdf, model }),
            _ => None,
        };
        (folder, findings)
    }
}
