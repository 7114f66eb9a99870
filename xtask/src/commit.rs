//! The commit that a recorded result belongs to.

use std::process::Command;

use anyhow::{Result, ensure};

use crate::tools;

/// What decides the results of the simulator: the crates that it is built from, and the robots.
pub const SIMULATOR: &[&str] = &[
    "shared",
    "supervisor",
    "host-sim",
    "robot-description",
    "rng",
    "recording",
    "viewer",
    "output",
    "chip-link",
    "robots",
    "Cargo.lock",
    "Cargo.toml",
];

/// What decides what libFuzzer finds. It adds to the corpus itself.
pub const FUZZER: &[&str] = &[
    "shared",
    "robot-description",
    "rng",
    "robots",
    "tests/src",
    "tests/Cargo.toml",
    "tests/fuzz",
    "Cargo.lock",
    "Cargo.toml",
    ":!tests/fuzz/corpus",
];

/// The end of a commit's name when sources differ from it.
const CHANGED: &str = "-dirty";

/// The commit, marked when one of `sources` differs from it.
///
/// # Errors
/// When git cannot be run.
pub fn commit(sources: &[&str]) -> Result<String> {
    let git = |arguments: &[&str]| {
        tools::output(Command::new("git").args(arguments)).map(|text| text.trim().to_owned())
    };
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let changed = git(&[&["status", "--porcelain", "--"], sources].concat())?;
    Ok(if changed.is_empty() { commit } else { commit + CHANGED })
}

/// Checks that a result may be recorded under the name of its commit.
///
/// # Errors
/// When its sources differed from the commit: those of another result with the same name may be others.
pub fn require_committed(commit: &str) -> Result<()> {
    ensure!(
        !commit.ends_with(CHANGED),
        "results of {commit} cannot be recorded, because nobody can get their sources back: commit them, \
         and run again"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::collections::BTreeSet;
    use std::path::{Path, PathBuf};

    use serde_json::Value;

    use super::*;

    /// The folders of a package of the workspace and of all that it is built from, relative to the workspace.
    fn folders(package: &str) -> BTreeSet<PathBuf> {
        let mut cargo = Command::new("cargo");
        cargo.args(["metadata", "--format-version", "1", "--no-deps", "--offline"]);
        let metadata: Value = serde_json::from_str(&tools::output(&mut cargo).unwrap()).unwrap();
        let root = metadata["workspace_root"].as_str().unwrap();
        let packages = metadata["packages"].as_array().unwrap();
        let (mut found, mut open) = (BTreeSet::new(), vec![package]);
        while let Some(name) = open.pop() {
            let package = packages.iter().find(|package| package["name"] == name).unwrap();
            let manifest = Path::new(package["manifest_path"].as_str().unwrap());
            if found.insert(manifest.parent().unwrap().strip_prefix(root).unwrap().to_owned()) {
                let needed = package["dependencies"].as_array().unwrap().iter();
                // Not what only its tests need.
                let needed = needed.filter(|other| !other["path"].is_null() && other["kind"].is_null());
                open.extend(needed.map(|other| other["name"].as_str().unwrap()));
            }
        }
        found
    }

    #[test]
    fn only_results_of_committed_sources_can_be_recorded() {
        require_committed("0123456789ab").unwrap();
        let told = require_committed("0123456789ab-dirty").unwrap_err().to_string();
        assert!(told.starts_with("results of 0123456789ab-dirty cannot be recorded"), "{told}");
    }

    #[test]
    fn the_sources_of_a_result_are_all_crates_that_the_program_is_built_from() {
        for (package, sources) in [("tesaki-sim", SIMULATOR), ("tesaki-fuzz", FUZZER)] {
            let folders = folders(package);
            assert!(folders.contains(Path::new("robot-description")), "{folders:?}");
            for source in folders.iter().map(|folder| folder.join("src")) {
                let is_listed = sources.iter().any(|listed| source.starts_with(listed));
                assert!(is_listed, "{package} is built from {}", source.display());
            }
        }
    }
}
