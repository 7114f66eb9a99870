//! `model check`: all problems of a robot folder, by file and line.

use std::cell::Cell;
use std::fmt::Write as _;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde_json::{Value, json};
use tesaki::kinematics::{Chain, Finger, FingerShapeError};
use tesaki::model::{ChainJoint, RobotModel};
use tesaki_description::camera::CameraValues;
use tesaki_description::finding::{Finding, Matter, Severity};
use tesaki_description::object::ObjectValues;
use tesaki_description::plant::PlantValues;
use tesaki_description::retargeting::{self, RetargetingSettings};
use tesaki_description::robot::RobotFolder;
use tesaki_description::urdf::{SerialPath, Urdf, UrdfError};
use tesaki_description::{FileError, approach, camera, grasp, hand_eye, impedance, law, object, read_text};
use tesaki_supervisor::hand::HandModel;

use crate::args::Options;
use crate::failure::Failure;
use crate::grasp::{OTHERS, check_for};
use crate::output;

/// Results of a check.
struct Checked {
    good: Vec<String>,
    findings: Vec<Finding>,
}

pub fn run(options: &Options, robot: &Path) -> Result<ExitCode, Failure> {
    let folder_of =
        robot.parent().filter(|_| robot.extension().is_some_and(|end| end == "toml") && robot.is_file());
    if let Some(parent) = folder_of {
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        return Err(Failure::Usage(format!(
            "{}: a file of a robot folder is checked with the folder: give the folder, {}",
            robot.display(),
            parent.display()
        )));
    }
    let checked = if is_there(&robot.join("controller.toml")) { folder(robot) } else { urdf(robot)? };
    let wrong = checked.findings.iter().any(Finding::is_error);
    let good = checked.good.iter().map(|text| json!({ "severity": "good", "finding": text }));
    let list: Vec<Value> = good.chain(checked.findings.iter().map(object)).collect();
    output::result(options, &list, || listed(&checked))?;
    Ok(ExitCode::from(u8::from(wrong)))
}

/// Whether there is something of this name: what cannot be read is told, not passed over.
fn is_there(path: &Path) -> bool {
    let absent = [ErrorKind::NotFound, ErrorKind::NotADirectory];
    path.symlink_metadata().map_or_else(|error| !absent.contains(&error.kind()), |_| true)
}

/// What to do about a file that cannot be read.
const UNREAD: &str =
    "nothing in it is checked: make it a text file, or a folder of such, that you may read; or remove it";

/// Checks a robot folder with settings for a controller.
fn folder(path: &Path) -> Checked {
    let (folder, mut findings) = robot(path);
    let advice = "correct robot.urdf, controller.toml and plant.toml first";
    findings.extend(beside(path, folder.as_ref().map(|folder| &folder.model), advice));
    Checked { good: folder.as_ref().map(summary).unwrap_or_default(), findings }
}

/// What is wrong in the files beside those of the robot. Some are checked with the model; without one,
/// `advice` says how to get it.
fn beside(path: &Path, model: Option<&RobotModel>, advice: &str) -> Vec<Finding> {
    let mut findings = Vec::new();
    // Why the robot grasps nothing, if it does not.
    let no_hand = model.and_then(|model| Some(HandModel::try_new(model).err()?.to_string()));
    findings.extend(of_others(&path.join(grasp::FOLDER), no_hand, OTHERS, |file, text| {
        let (grasp, mut findings) = grasp::check(file, text);
        let unfit = grasp.zip(model).and_then(|(grasp, model)| check_for(&grasp.plan, model).err());
        for message in unfit.iter().flat_map(|unfit| unfit.lines()) {
            let advice = "correct it, or keep the file in another folder";
            let severity = Severity::Error;
            findings.push(Finding { severity, ..unchecked(file.to_owned(), message.to_owned(), advice) });
        }
        findings
    }));
    findings.extend(toml_files(&path.join(object::FOLDER), |file, text| ObjectValues::check(file, text).1));
    let file = path.join(camera::FILE);
    let camera = text(&file, &mut findings);
    findings.extend(camera.into_iter().flat_map(|text| CameraValues::check(&file, &text).1));
    let file = path.join(hand_eye::FILE);
    let table = text(&file, &mut findings).and_then(|text| {
        let (table, wrong) = hand_eye::check(&file, &text);
        findings.extend(wrong);
        table
    });
    let Some(model) = model else {
        let unchecked = |file| unchecked(file, "not checked: it needs the robot's model".to_owned(), advice);
        for file in [retargeting::FILE, approach::FILE].map(|name| path.join(name)) {
            let read = text(&file, &mut findings).is_some();
            findings.extend(read.then(|| unchecked(file)));
        }
        for folder in [impedance::FOLDER, law::FOLDER].map(|name| path.join(name)) {
            let unread = toml_files(&folder, |_, _| Vec::new());
            let read = unread.is_empty() && is_there(&folder);
            findings.extend(unread);
            findings.extend(read.then(|| unchecked(folder)));
        }
        return findings;
    };
    let file = path.join(retargeting::FILE);
    let settings = text(&file, &mut findings);
    findings.extend(settings.iter().flat_map(|text| RetargetingSettings::check(&file, text, model).1));
    let file = path.join(approach::FILE);
    match (text(&file, &mut findings), &table) {
        (Some(text), Some(table)) => findings.extend(approach::check(&file, &text, model, table).1),
        (Some(_), None) if !is_there(&path.join(hand_eye::FILE)) => {
            let message = format!("not checked: there is no {}, which it needs", hand_eye::FILE);
            findings.push(unchecked(file, message, "`tesaki calibrate camera` makes it"));
        }
        _ => {}
    }
    let check = |file: &Path, text: &str| impedance::check(file, text, model).1;
    let (folder, no_arm) = (path.join(impedance::FOLDER), impedance::not_an_arm(model));
    findings.extend(of_others(&folder, no_arm, "only an arm has an impedance: remove the folder", check));
    findings.extend(toml_files(&path.join(law::FOLDER), |file, text| law::check(file, text, model)));
    findings
}

/// The robot, and what is wrong in `robot.urdf`, `controller.toml` and `plant.toml`: also in those that can
/// be read when another one cannot.
fn robot(path: &Path) -> (Option<RobotFolder>, Vec<Finding>) {
    let mut findings = Vec::new();
    let [urdf, settings] = ["robot.urdf", "controller.toml"].map(|name| {
        let text = RobotFolder::read_file(path, name);
        text.map_err(|error| findings.extend(error.findings())).ok()
    });
    match (urdf, settings) {
        (Some(urdf), Some(settings)) => {
            let plant = text(&path.join("plant.toml"), &mut findings);
            let (folder, wrong) = RobotFolder::check_all(path, &urdf, &settings, plant.as_deref());
            findings.extend(wrong);
            return (folder, findings);
        }
        (Some(urdf), None) => findings.extend(Urdf::check(&path.join("robot.urdf"), &urdf).1),
        (None, Some(_)) => {
            let message = "not checked: it needs robot.urdf, whose joints it sets".to_owned();
            findings.push(unchecked(path.join("controller.toml"), message, ""));
        }
        (None, None) => {}
    }
    findings.extend(plant(path));
    (None, findings)
}

/// What is wrong in `plant.toml`, without the robot.
fn plant(path: &Path) -> Vec<Finding> {
    let (file, mut findings) = (path.join("plant.toml"), Vec::new());
    let text = text(&file, &mut findings);
    findings.extend(text.into_iter().flat_map(|text| PlantValues::check(&file, &text).1));
    findings
}

/// That a file is not checked, and what to do.
fn unchecked(path: PathBuf, message: String, advice: &str) -> Finding {
    let (severity, matter) = (Severity::Warning, Matter::Dynamics);
    Finding { severity, matter, path, line: None, message, advice: advice.to_owned() }
}

/// The text of a file, if there is one; what cannot be read is a finding.
fn text(file: &Path, findings: &mut Vec<Finding>) -> Option<String> {
    is_there(file).then(|| unless_unread(read_text(file), file, findings)).flatten()
}

fn unless_unread<T>(read: io::Result<T>, path: &Path, findings: &mut Vec<Finding>) -> Option<T> {
    let read = read.map_err(FileError::unread(path, UNREAD));
    read.map_err(|error| findings.extend(error.findings())).ok()
}

/// As [`toml_files`]; but if there is a reason why the files are of no use to this robot, only that, once.
fn of_others(
    folder: &Path,
    useless: Option<String>,
    advice: &str,
    check: impl Fn(&Path, &str) -> Vec<Finding>,
) -> Vec<Finding> {
    let Some(reason) = useless else { return toml_files(folder, check) };
    let files = Cell::new(0);
    let mut findings = toml_files(folder, |_, _| {
        files.set(files.get() + 1);
        Vec::new()
    });
    if files.get() > 0 {
        findings.push(unchecked(folder.to_owned(), format!("not checked: {reason}"), advice));
    }
    findings
}

/// What `check` finds in the TOML files of a folder, in the order of their names.
fn toml_files(folder: &Path, check: impl Fn(&Path, &str) -> Vec<Finding>) -> Vec<Finding> {
    let mut findings = Vec::new();
    if !is_there(folder) {
        return findings;
    }
    let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let entries = unless_unread(entries, folder, &mut findings).unwrap_or_default();
    let mut files: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
    files.retain(|file| file.extension().is_some_and(|end| end == "toml"));
    files.sort();
    for file in files {
        let text = text(&file, &mut findings);
        findings.extend(text.into_iter().flat_map(|text| check(&file, &text)));
    }
    findings
}

fn summary(folder: &RobotFolder) -> Vec<String> {
    let (model, mut lines) = (&folder.model, Vec::new());
    for (index, chain) in model.chains.iter().enumerate() {
        lines.push(format!("chain to {}", chain.name));
        // The model has no names of mimic joints.
        let path = folder.urdf.path(None, &chain.name).ok();
        for (place, joint) in model.joints_of(index).enumerate() {
            let joint = match joint {
                ChainJoint::Driven(_, joint) => joint,
                ChainJoint::Mimic(mimic) => {
                    let of_urdf = path.as_ref().and_then(|path| path.joints.get(place));
                    let name = of_urdf.map_or("?", |joint| joint.name.as_str());
                    let follows =
                        follows(mimic.multiplier, model.joint_name(mimic.joint.into()), mimic.offset);
                    lines.push(format!("  {name:<20} = {follows}, link {:.1} g", mimic.link.mass * 1000.0));
                    continue;
                }
            };
            lines.push(format!(
                "  {:<20} {:>7.3} to {:>6.3} rad, {:>6.2} rad/s, {:>6.3} N·m, link {:.1} g",
                joint.name,
                joint.limits.lower,
                joint.limits.upper,
                joint.limits.velocity,
                joint.limits.torque,
                joint.link.mass * 1000.0
            ));
        }
    }
    let mimics = match model.mimics.len() {
        0 => String::new(),
        count => format!(" and {}", output::counted(count, "mimic joint")),
    };
    let joints = output::counted(model.joints.len(), "joint");
    let chains = output::counted(model.chains.len(), "chain");
    lines.push(format!("{}: {joints}{mimics} in {chains}", model.name));
    lines.extend(no_fingertip_control(model));
    lines
}

/// Why the fingertips of a hand cannot be placed, if they cannot: each finger that has no closed form.
fn no_fingertip_control(model: &RobotModel) -> Vec<String> {
    if model.chains.len() < 2 {
        return Vec::new();
    }
    let shape = |index| {
        let own = model.joints_of(index).map(|joint| match joint {
            ChainJoint::Driven(_, joint) => Some((joint.limits.lower, joint.limits.upper)),
            ChainJoint::Mimic(_) => None,
        });
        let limits: Option<Vec<(f32, f32)>> = own.collect();
        let limits = limits.ok_or_else(|| "it has a mimic joint".to_owned())?;
        let count = limits.len();
        let limits = <[(f32, f32); 3]>::try_from(limits);
        let limits = limits.map_err(|_| FingerShapeError::Joints(count).to_string())?;
        Finger::try_new(&Chain::of_model(model, index), limits).map(|_| ()).map_err(|error| error.to_string())
    };
    let chains = model.chains.iter().enumerate();
    let without = chains.filter_map(|(index, chain)| Some((&chain.name, shape(index).err()?)));
    without
        .map(|(name, why)| {
            format!("no control of the fingertip {name} in Cartesian space (reach, grasp): {why}")
        })
        .collect()
}

/// Checks a URDF without settings for a controller, and what else is in its folder.
fn urdf(path: &Path) -> Result<Checked, Failure> {
    let file = Urdf::locate(path);
    let text = Urdf::read_text(&file)?;
    let (urdf, mut findings) = Urdf::check(&file, &text);
    let mut good = vec![if path.is_dir() {
        "checked without a model of the robot: the folder has no controller.toml".to_owned()
    } else {
        "only the URDF is checked: no robot folder was given".to_owned()
    }];
    if let Some(urdf) = urdf {
        let mut missed = Vec::new();
        for tip in urdf.tips(None) {
            match urdf.path(None, tip) {
                Ok(path) => good.push(joints(&path)),
                Err(UrdfError::Path(finding)) => missed.push(finding),
                Err(other) => return Err(other.into()),
            }
        }
        // If some tips cannot be computed, such as those of a gripper with prismatic joints, the others still
        // can.
        if !urdf.reachable_tips(None).is_empty() {
            missed.iter_mut().for_each(|finding| finding.severity = Severity::Warning);
        }
        findings.extend(missed);
    }
    if path.is_dir() {
        findings.extend(plant(path));
        let advice =
            format!("`tesaki model init {}` writes the controller.toml that it needs", path.display());
        findings.extend(beside(path, None, &advice));
    }
    Ok(Checked { good, findings })
}

/// `tip finger_tip: base palm, joints a, b, c (= 0.8 b + 0.1)`
fn joints(path: &SerialPath) -> String {
    let joints = path.joints.iter().map(|joint| match path.drives.get(joint.drive) {
        Some(drive) if drive.name != joint.name => {
            format!("{} (= {})", joint.name, follows(joint.multiplier, &drive.name, joint.offset))
        }
        _ => joint.name.clone(),
    });
    format!("tip {}: base {}, joints {}", path.tip, path.base, joints.collect::<Vec<_>>().join(", "))
}

/// `0.8 b + 0.1`
fn follows(multiplier: f32, name: &str, offset: f32) -> String {
    let offset = if offset == 0.0 { String::new() } else { format!(" {offset:+}") };
    format!("{multiplier} {name}{offset}")
}

/// A finding as JSON.
pub fn object(finding: &Finding) -> Value {
    json!({
        "severity": if finding.is_error() { "bad" } else { "warning" },
        "file": finding.path.display().to_string(),
        "line": finding.line,
        "finding": finding.message,
        "advice": finding.advice,
    })
}

fn listed(checked: &Checked) -> String {
    let mut text = String::new();
    for good in &checked.good {
        let _ = writeln!(text, "ok    {good}");
    }
    text += &list(&checked.findings);
    let errors = checked.findings.iter().filter(|finding| finding.is_error()).count();
    text + &match (errors, checked.findings.len() - errors) {
        (0, 0) => "no problems found".to_owned(),
        (0, warnings) => format!("works; {}", output::counted(warnings, "warning")),
        (errors, _) => format!("{} found", output::counted(errors, "problem")),
    }
}

/// The findings with their advice.
pub fn list(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let sign = if finding.is_error() { "BAD " } else { "warn" };
        let _ = writeln!(text, "{sign}  {}: {}", finding.place(), finding.message);
        if !finding.advice.is_empty() {
            let _ = writeln!(text, "      → {}", finding.advice);
        }
    }
    text
}
