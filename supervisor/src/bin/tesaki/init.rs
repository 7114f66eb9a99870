//! `model init`: a robot folder for a URDF.

use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};
use std::process::ExitCode;

use serde_json::json;
use tesaki_description::FileError;
use tesaki_description::finding::Finding;
use tesaki_description::init::{InitError, InitOptions, RobotTexts, robot_texts};
use tesaki_description::robot::RobotFolder;
use tesaki_description::urdf::Urdf;

use crate::args::{Init, Options};
use crate::check;
use crate::failure::Failure;
use crate::output;

pub fn run(options: &Options, args: &Init) -> Result<ExitCode, Failure> {
    let path = Urdf::locate(&args.urdf);
    let text = Urdf::read_text(&path)?;
    let choices = InitOptions { motors: args.motors.clone(), accept_inertia: args.accept_inertia.clone() };
    let texts = robot_texts(&path, &text, &choices).map_err(|error| match error {
        InitError::Wrong(findings) => Failure::Description(FileError::Wrong(findings)),
        other => Failure::Usage(other.to_string()),
    })?;
    let folder = folder(args, &path, &texts.name)?;
    let (_, mut findings) = RobotFolder::check_all(&folder, &text, &texts.controller, Some(&texts.plant));
    let own = folder.join("robot.urdf");
    let is_wrong_in_urdf = |finding: &Finding| finding.is_error() && finding.path == own;
    if findings.iter().any(is_wrong_in_urdf) {
        // What else is wrong is in files that are not written, as the copy of the URDF.
        findings.retain(is_wrong_in_urdf);
        findings.iter_mut().for_each(|finding| finding.path.clone_from(&path));
        return Err(Failure::Description(FileError::Wrong(findings)));
    }
    let written = write(&folder, &path, &texts, args.force)?;
    let joints: Vec<_> = texts
        .joints
        .iter()
        .map(|joint| {
            json!({
                "joint": joint.joint,
                "motor": joint.motor,
                "torque": output::exact(&joint.torque),
                "reason": joint.reason,
            })
        })
        .collect();
    let value = json!({
        "robot": texts.name,
        "files": written.iter().map(|file| file.display().to_string()).collect::<Vec<_>>(),
        "joints": joints,
        "notes": texts.notes,
        "findings": findings.iter().map(check::object).collect::<Vec<_>>(),
    });
    output::result(options, &value, || report(&folder, &texts, &written, &findings))?;
    // What this robot needs, and no computation can choose: it is corrected in the files.
    Ok(ExitCode::from(u8::from(findings.iter().any(Finding::is_error))))
}

/// Where to write.
fn folder(args: &Init, urdf: &Path, name: &str) -> Result<PathBuf, Failure> {
    let beside = urdf.parent().filter(|_| urdf.file_name().is_some_and(|name| name == "robot.urdf"));
    Ok(match (&args.out, beside) {
        (Some(out), _) => out.clone(),
        (None, Some(folder)) if folder.as_os_str().is_empty() => PathBuf::from("."),
        (None, Some(folder)) => folder.to_owned(),
        (None, None) if is_plain(name) => PathBuf::from(name),
        (None, None) => {
            return Err(Failure::Usage(format!(
                "the robot's name in the URDF, {name:?}, cannot be the name of a folder: give one with --out DIR"
            )));
        }
    })
}

/// Whether `name` is that of a folder beside, which no command takes for an option.
fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    let is_one =
        matches!(parts.next(), Some(Component::Normal(part)) if part == name) && parts.next().is_none();
    is_one && !name.starts_with('-') && !name.contains(char::is_control)
}

/// Writes the files; returns their paths.
fn write(folder: &Path, urdf: &Path, texts: &RobotTexts, force: bool) -> Result<Vec<PathBuf>, Failure> {
    std::fs::create_dir_all(folder).map_err(Failure::file(folder))?;
    let own = folder.join("robot.urdf");
    let is_own = own.canonicalize().is_ok_and(|own| urdf.canonicalize().is_ok_and(|urdf| urdf == own));
    let mut files =
        vec![(folder.join("controller.toml"), &texts.controller), (folder.join("plant.toml"), &texts.plant)];
    if !is_own {
        files.insert(0, (own, &texts.urdf));
    }
    if let Some((file, _)) = files.iter().find(|(file, _)| file.exists() && !force) {
        let message = format!(
            "{} exists: choose another folder with --out, or overwrite it with --force",
            file.display()
        );
        return Err(Failure::Usage(message));
    }
    for (file, text) in &files {
        output::replace(file, text).map_err(Failure::file(file))?;
    }
    Ok(files.into_iter().map(|(file, _)| file).collect())
}

fn report(folder: &Path, texts: &RobotTexts, written: &[PathBuf], findings: &[Finding]) -> String {
    let mut text = String::new();
    for joint in &texts.joints {
        let _ = writeln!(
            text,
            "{:<20} {:<12} {:>7.3} N·m, {}",
            joint.joint, joint.motor, joint.torque, joint.reason
        );
    }
    for note in &texts.notes {
        let _ = writeln!(text, "note  {note}");
    }
    text += &check::list(findings);
    for file in written {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    let bad = if findings.iter().any(Finding::is_error) { "correct what is BAD, " } else { "" };
    let _ = write!(
        text,
        "next: {bad}replace what the files call assumed; tesaki model check {}",
        folder.display()
    );
    text
}
