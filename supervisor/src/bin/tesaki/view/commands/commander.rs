//! The page that commands, and what keeps its task running.

use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::protocol::{Mode, Request, Telemetry};
use tesaki::task::impedance::ImpedanceCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskKind};
use tesaki_supervisor::task_report::Grasped;
use tesaki_supervisor::timing::LATE;
use tesaki_supervisor::trajectory::minimum_jerk;

use super::STEP;
use crate::board_session::shows_stop;

/// What was sent so long before a refusal comes was accepted.
const REFUSED: Duration = Duration::from_millis(100);

/// The page that commands, and what it has enabled.
pub struct Commander {
    pub(super) page: Option<u64>,
    pub(super) take_over: bool,
    pub(super) enabled: Option<Enabled>,
    /// Goals of the joint servo [rad].
    pub(super) goal: Vec<f32>,
    /// What it grasped.
    pub grasped: Option<Grasped>,
    /// Displacement and rotation of the object since the grasp.
    pub(super) object: (Vector3<f32>, UnitQuaternion<f32>),
    pub(super) tool: Option<ToolPath>,
    /// When the next set-point is due.
    pub(super) next: Instant,
    /// A stop that the telemetry does not show yet.
    pub(super) stopping: Option<Stopping>,
    /// Whether command is to be released once the robot is stopped.
    pub(super) releases: bool,
}

/// What the page has enabled.
#[derive(Clone, Copy)]
pub(super) struct Enabled {
    pub(super) task: TaskKind,
    /// When the board confirmed it.
    pub(super) since: Instant,
    /// Whether the telemetry has shown it.
    pub(super) seen: bool,
}

/// A stop that is repeated.
pub(super) struct Stopping {
    /// When the pages are warned; `None` once they are.
    pub(super) warns: Option<Instant>,
    /// The last tick before it: the mode of older ones says nothing.
    pub(super) after: Option<u32>,
}

/// The way of an arm's tool from one place to the next.
#[derive(Clone, Copy)]
pub(super) struct ToolPath {
    pub(super) from: PosePoint,
    pub(super) step: Vector3<f32>,
    pub(super) begun: Instant,
    pub(super) elbow: ElbowSetpoint,
}

impl ToolPath {
    pub(super) fn at(&self, now: Instant) -> PosePoint {
        let fraction = (now - self.begun).as_secs_f64() / f64::from(STEP);
        #[expect(clippy::cast_possible_truncation, reason = "single precision on the wire")]
        let [s, v, a] = minimum_jerk(fraction).map(|value| value as f32);
        let (position, speed) = (Vector3::from(self.from.position) + self.step * s, self.step * (v / STEP));
        let change = self.step * (a / (STEP * STEP));
        PosePoint {
            position: position.into(),
            velocity: [speed.x, speed.y, speed.z, 0.0, 0.0, 0.0],
            acceleration: [change.x, change.y, change.z, 0.0, 0.0, 0.0],
            ..self.from
        }
    }
}

impl Commander {
    pub fn new(take_over: bool) -> Self {
        Self {
            page: None,
            take_over,
            enabled: None,
            goal: Vec::new(),
            grasped: None,
            object: (Vector3::zeros(), UnitQuaternion::identity()),
            tool: None,
            next: Instant::now(),
            stopping: None,
            releases: false,
        }
    }

    /// The page that commands.
    pub const fn page(&self) -> Option<u64> {
        self.page
    }

    /// Whether a robot whose page has gone is still to be stopped, or command to be released.
    pub const fn is_stopping(&self) -> bool {
        self.stopping.is_some() || self.releases
    }

    /// Notices that the task has ended.
    pub fn follow(&mut self, telemetry: Option<&Telemetry>) {
        let is_enabled = telemetry.is_some_and(|telemetry| matches!(telemetry.mode, Mode::Enabled(_)));
        if let Some(enabled) = &mut self.enabled {
            enabled.seen |= is_enabled;
            // Telemetry from before the board was enabled may still arrive.
            if !is_enabled && (enabled.seen || enabled.since.elapsed() > LATE) {
                self.ended();
            }
        }
        if let (Some(stopping), Some(telemetry)) = (&self.stopping, telemetry)
            && shows_stop(telemetry, stopping.after)
        {
            self.stopping = None;
        }
    }

    /// Nothing is enabled any more.
    pub(super) fn ended(&mut self) {
        (self.enabled, self.grasped, self.tool) = (None, None, None);
    }

    /// The board cannot be enabled: a stop need not be repeated.
    pub fn is_stopped(&mut self) {
        self.stopping = None;
    }

    /// After a set-point that the board refused: the tool rests where it was led a moment before. Repeated,
    /// the refused one would end in a time-out of the commands.
    pub(super) fn rest(&mut self) {
        if let Some(tool) = &mut self.tool {
            let accepted =
                Instant::now().checked_sub(REFUSED).map_or(tool.begun, |then| then.max(tool.begun));
            let from = PosePoint { velocity: [0.0; 6], acceleration: [0.0; 6], ..tool.at(accepted) };
            *tool = ToolPath { from, step: Vector3::zeros(), ..*tool };
        }
    }

    /// What keeps the task running.
    pub(super) fn set_point(&self, task: TaskKind, now: Instant) -> Request {
        match (task, &self.tool) {
            (TaskKind::JointServo, _) => {
                let positions = heapless::Vec::from_slice(&self.goal).unwrap_or_default();
                Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }))
            }
            (TaskKind::Impedance, Some(tool)) => {
                let command = ImpedanceCommand::SetTarget { point: tool.at(now), elbow: tool.elbow };
                Request::Task(TaskCommand::Impedance(command))
            }
            _ => Request::Keep,
        }
    }
}
