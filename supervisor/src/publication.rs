//! A board as ROS 2 messages, for recordings and live viewers.

use std::time::{SystemTime, UNIX_EPOCH};

use tesaki::model::RobotModel;
use tesaki::protocol::{JointTelemetry, Mode, Status, Stream, TaskReport, Telemetry, Tips};
use tesaki_description::frames::{Frames, Placed};
use tesaki_description::plant::CONTROL_PERIOD_NS;
use tesaki_description::robot::{RobotFolder, chain_model};
use tesaki_recording::{Diagnostic, Health, LogLevel, McapError, Publisher, Sink, Transform};

use crate::task_report::{Pose, Report, report};

/// A smaller difference of successive ticks means that the board was reset in between [ticks].
const RESET: i32 = -20;

/// The streams that it uses, with their periods [ticks].
pub const STREAMS: &[(Stream, u16)] =
    &[(Stream::Telemetry, 1), (Stream::Tips, 1), (Stream::Task, 2), (Stream::Status, 20)];

/// The given folder belongs to another robot.
#[derive(Debug, thiserror::Error)]
#[error("the board is {board}, and --robot is the folder of {folder}: give the folder of {board}, or none")]
pub struct OtherRobot {
    /// The robot of the model on the board.
    pub board: String,
    /// The robot of the folder.
    pub folder: String,
}

/// Refuses the folder of another robot, whose URDF would not match the board's angles.
///
/// # Errors
/// The folder belongs to another robot.
pub fn require_own(folder: Option<&RobotFolder>, model: &RobotModel) -> Result<(), OtherRobot> {
    match folder.filter(|folder| own_model(folder, &model.name).is_none()) {
        Some(other) => {
            Err(OtherRobot { board: model.name.to_string(), folder: other.model.name.to_string() })
        }
        None => Ok(()),
    }
}

/// The model of the folder, or of one of its chains, that has this name.
pub fn own_model(folder: &RobotFolder, name: &str) -> Option<RobotModel> {
    let chains = (0..folder.model.chains.len()).filter_map(|index| chain_model(&folder.model, index));
    std::iter::once(folder.model.clone()).chain(chains).find(|model| model.name == name)
}

/// Converts the board's messages.
pub struct Publication<S> {
    /// The publisher of the messages.
    pub publisher: Publisher<S>,
    folder: Option<RobotFolder>,
    /// Checksum of the model to which names and frames belong.
    checksum: Option<u32>,
    names: Vec<String>,
    /// Names of the tips, and whether each has a force sensor.
    tips: Vec<(String, bool)>,
    frames: Frames,
    /// Whether the fixed frames have yet to be published.
    frames_are_new: bool,
    /// Time of tick 0 [ns since 1970].
    epoch: Option<u64>,
    last: Option<u32>,
    mode: Option<Mode>,
    positions: Vec<f64>,
    report: Option<Report>,
}

impl<S: Sink> Publication<S> {
    /// Creates a publication. With the folder of the robot, links have their names from its URDF.
    pub fn new(publisher: Publisher<S>, folder: Option<RobotFolder>) -> Self {
        Self {
            publisher,
            folder,
            checksum: None,
            names: Vec::new(),
            tips: Vec::new(),
            frames: Frames::default(),
            frames_are_new: false,
            epoch: None,
            last: None,
            mode: None,
            positions: Vec::new(),
            report: None,
        }
    }

    /// Refuses a model of another robot than that of the folder.
    ///
    /// # Errors
    /// The folder belongs to another robot.
    pub fn require_own(&self, model: &RobotModel) -> Result<(), OtherRobot> {
        require_own(self.folder.as_ref(), model)
    }

    /// Sets the model on the board, with its checksum.
    pub fn use_model(&mut self, model: Option<(&RobotModel, u32)>) {
        let checksum = model.map(|(_, checksum)| checksum);
        if self.checksum == checksum {
            return;
        }
        self.checksum = checksum;
        let joints = model.map_or(&[][..], |(model, _)| &model.joints);
        self.names = joints.iter().map(|joint| joint.name.to_string()).collect();
        let chains = model.map_or(&[][..], |(model, _)| &model.chains);
        self.tips =
            chains.iter().map(|chain| (chain.name.to_string(), chain.force_sensor.is_some())).collect();
        self.frames = model.map_or_else(Frames::default, |(model, _)| {
            let own = self.folder.as_ref().filter(|folder| own_model(folder, &model.name).is_some());
            own.map_or_else(
                || Frames::of_model(model),
                |folder| Frames::of_urdf(&folder.urdf.robot, &self.names),
            )
            .with_tips(model)
        });
        self.frames_are_new = !self.frames.fixed().is_empty();
    }

    /// Returns the time of a tick [ns since 1970].
    fn time(&mut self, tick: u32) -> u64 {
        if self.last.is_some_and(|last| tick.wrapping_sub(last).cast_signed() < RESET) {
            // Its ticks restarted.
            self.epoch = None;
        }
        self.last = Some(tick);
        let since_start = u64::from(tick) * CONTROL_PERIOD_NS;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        *self.epoch.get_or_insert(now.saturating_sub(since_start)) + since_start
    }

    /// Publishes joints and links.
    ///
    /// # Errors
    /// An error of the sink; also in all following functions.
    pub fn telemetry(&mut self, telemetry: &Telemetry) -> Result<(), McapError> {
        let time = self.time(telemetry.tick);
        if let Some(before) = self.mode.replace(telemetry.mode).filter(|mode| *mode != telemetry.mode) {
            self.publisher.log(
                time,
                LogLevel::Info,
                "board",
                &format!("{} after {}", words(telemetry.mode), words(before)),
            )?;
        }
        if self.names.len() != telemetry.joints.len() {
            return Ok(()); // the board's model has just changed
        }
        if std::mem::take(&mut self.frames_are_new) {
            let fixed: Vec<Transform> = self.frames.fixed().iter().map(transform).collect();
            self.publisher.tf_static(time, &fixed)?;
        }
        let list = |value: fn(&JointTelemetry) -> f32| -> Vec<f64> {
            telemetry.joints.iter().map(|joint| f64::from(value(joint))).collect()
        };
        self.positions = list(|joint| joint.position);
        let (velocity, effort) = (list(|joint| joint.velocity), list(|joint| joint.torque));
        self.publisher.joint_states(time, &self.names, &self.positions, &velocity, &effort)?;
        self.publisher.references(time, &self.names, &list(|joint| joint.reference), &[], &[])?;
        let moving: Vec<Transform> = self.frames.moving(&self.positions).iter().map(transform).collect();
        self.publisher.tf(time, &moving)
    }

    /// Publishes the wrench on each tip that has a tared sensor, in the tip's axes.
    pub fn tips(&mut self, tips: &Tips) -> Result<(), McapError> {
        if self.tips.len() != tips.tips.len() || self.positions.is_empty() {
            return Ok(());
        }
        let time = self.time(tips.tick);
        for ((name, _), tip) in
            self.tips.iter().zip(&tips.tips).filter(|((_, sensor), tip)| *sensor && tip.tared)
        {
            let to_tip = self.frames.in_base(name, &self.positions).rotation.inverse();
            let [force, torque] = [tip.force, tip.torque]
                .map(|part| (to_tip * nalgebra::Vector3::from(part.map(f64::from))).into());
            self.publisher.wrench(time, name, force, torque)?;
        }
        Ok(())
    }

    /// Publishes the variables of the task, and each of its phases as text.
    pub fn task(&mut self, task: &TaskReport) -> Result<(), McapError> {
        // After the task has ended, the stream continues with its last state.
        let runs = matches!(self.mode, Some(Mode::Enabled(kind)) if kind == task.telemetry.kind());
        let report = runs.then(|| report(&task.telemetry, None));
        let phase = |report: &Option<Report>| report.as_ref().and_then(|report| report.phase.clone());
        let time = self.time(task.tick);
        if let Some(now) = phase(&report).filter(|now| phase(&self.report).as_ref() != Some(now)) {
            self.publisher.log(time, LogLevel::Info, "task", &now)?;
        }
        let (frame, target) = report.as_ref().map_or((None, None), |report| (report.frame, report.target));
        for (name, pose) in [("task/frame", frame), ("task/target", target)] {
            if let Some(pose) = pose {
                self.publisher.pose(time, name, self.frames.base(), wide(pose))?;
            }
        }
        self.report = report;
        Ok(())
    }

    /// Publishes the status of board and task.
    pub fn status(&mut self, status: &Status) -> Result<(), McapError> {
        let (node, board) = (&status.node, &status.board);
        let homed = self.names.iter().enumerate().filter(|(joint, _)| node.homed >> joint & 1 != 0).count();
        let [major, minor, patch] = board.identity.firmware;
        let values = [
            ("model", node.model.to_string()),
            ("supply [V]", format!("{:.2}", node.supply)),
            ("homed joints", format!("{homed} of {}", self.names.len())),
            ("faults", node.faults.to_string()),
            (
                "commander",
                node.commander.map_or_else(|| "nobody".to_owned(), |client| format!("{client:08x}")),
            ),
            ("firmware", format!("{major}.{minor}.{patch}")),
            ("stack used [bytes]", format!("{} of {}", board.stack_used, board.stack_size)),
            ("last words", board.last_words.to_string()),
        ];
        let health = match node.mode {
            Mode::Fault => Health::Error,
            _ if node.model.is_empty() => Health::Warn,
            _ => Health::Ok,
        };
        let mut entries = vec![Diagnostic {
            health,
            name: "tesaki: board".to_owned(),
            message: words(node.mode),
            values: values.map(|(name, value)| (name.to_owned(), value)).to_vec(),
        }];
        if let Some(report) = &self.report {
            let value = |(name, value, unit): &(&str, f32, &str)| {
                let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
                (format!("{name}{unit}"), value.to_string())
            };
            entries.push(Diagnostic {
                health: Health::Ok,
                name: format!("tesaki: {}", report.task),
                message: report.phase.clone().unwrap_or_default(),
                values: report.values.iter().map(value).collect(),
            });
        }
        let time = self.time(node.tick);
        self.publisher.diagnostics(time, &node.model, &entries)
    }

    /// Publishes a fault as text.
    pub fn fault(&mut self, tick: u32, text: &str) -> Result<(), McapError> {
        let time = self.time(tick);
        self.publisher.log(time, LogLevel::Error, "board", text)
    }
}

fn words(mode: Mode) -> String {
    match mode {
        Mode::Disabled => "disabled".to_owned(),
        Mode::Enabled(task) => format!("enabled: {task}"),
        Mode::Fault => "in fault".to_owned(),
    }
}

fn transform(placed: &Placed) -> Transform {
    Transform {
        parent: placed.parent.clone(),
        child: placed.child.clone(),
        translation: placed.pose.translation.vector.into(),
        rotation_xyzw: placed.pose.rotation.coords.into(),
    }
}

fn wide(pose: Pose) -> tesaki_recording::Pose {
    let [x, y, z, a, b, c, d] = pose.map(f64::from);
    ([x, y, z], [a, b, c, d])
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use tesaki_recording::Live;

    use super::*;

    fn folder(name: &str) -> RobotFolder {
        RobotFolder::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name)).unwrap()
    }

    #[test]
    fn a_board_of_one_finger_has_the_links_of_the_hands_folder() {
        let (hand, arm) = (folder("hand3"), folder("arm7"));
        let finger = chain_model(&hand.model, 1).unwrap();
        require_own(Some(&hand), &hand.model).unwrap();
        require_own(Some(&hand), &finger).unwrap();
        let refused = require_own(Some(&arm), &finger).unwrap_err().to_string();
        assert!(refused.contains("--robot is the folder of arm7"), "{refused}");

        let links = hand.urdf.robot.links.clone();
        let mut publication = Publication::new(Publisher::new(Live::default(), None), Some(hand));
        publication.use_model(Some((&finger, 1)));
        let moving = publication.frames.moving(&vec![0.0; finger.joints.len()]);
        assert_eq!(moving.len(), 3);
        assert!(moving.iter().all(|placed| links.iter().any(|link| link.name == placed.child)));
    }
}
