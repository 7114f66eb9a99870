//! What pages may command, and who of them.
//!
//! One page commands at a time, as one program does; this program then holds the board's lease for it. A page
//! that goes away, or does not answer, while the robot is enabled is a reason to stop it.

mod commander;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use tesaki::control::ServoMode;
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::protocol::{Mode, Refusal, Request};
use tesaki::task::grasping::GraspCommand;
use tesaki::task::impedance::ImpedanceRefusal;
use tesaki::task::{TaskConfig, TaskKind, TaskRefusal};
use tesaki_description::impedance;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::task_report::Grasped;
use tesaki_supervisor::timing::{BLIND, FRESH, KEEP_ALIVE, LAST_WORD, STOP_PATIENCE};
use tesaki_supervisor::{Board, BoardError, LinkBoard, angles, words};

use super::View;
use super::message::{Command, Plan};
use crate::board_session::BoardLink;
use crate::failure::Failure;
use crate::grasp::{is_on_support, load_for};
use crate::{joints, motion};
pub use commander::Commander;
use commander::{Enabled, Stopping, ToolPath};

/// From one point of the tool's path to the next.
const POINT: Duration = motion::PERIOD;
/// From one renewal of the lease to the next while disabled; it lasts longer.
const RENEWAL: Duration = Duration::from_millis(300);
/// A page that has enabled the robot and says nothing for so long has gone. It answers to every state, 50
/// times a second.
const SILENT_PAGE: Duration = Duration::from_secs(1);
/// A page that only commands and says nothing for so long has gone: others may command then.
const IDLE_PAGE: Duration = Duration::from_secs(5);
/// Duration of a step of the object or of the tool [s].
const STEP: f32 = 1.0;

/// The files of a robot folder with which a page can enable a task.
pub fn plans(folder: &RobotFolder) -> Vec<Plan> {
    let files = |task: TaskKind, name: &str| {
        let mut plans: Vec<Plan> = std::fs::read_dir(folder.path.join(name))
            .into_iter()
            .flatten()
            .flatten()
            .filter_map(|file| file.file_name().into_string().ok())
            .filter(|name| Path::new(name).extension().is_some_and(|extension| extension == "toml"))
            .map(|name| Plan { task: task.to_string(), name })
            .collect();
        plans.sort_by(|a, b| a.name.cmp(&b.name));
        plans
    };
    [files(TaskKind::Grasping, "grasps"), files(TaskKind::Impedance, "impedances")].concat()
}

impl View {
    /// Carries out what a page says.
    pub fn obey(&mut self, id: u64, said: Result<Command, String>) {
        let command = match said {
            Ok(command) => command,
            Err(error) => return self.answer(id, false, &format!("not understood: {error}")),
        };
        match self.execute(id, command) {
            Ok(done) => self.answer(id, true, &done),
            Err(failure) => {
                let text = self.words(failure);
                self.answer(id, false, &text);
            }
        }
        self.tell_status();
    }

    fn execute(&mut self, id: u64, command: Command) -> Result<String, Failure> {
        match command {
            // Nothing may hold up the repeated stop, but what switches off at once.
            _ if self.commander.stopping.is_some() && !matches!(command, Command::Disable) => {
                return Err(Failure::Refused(
                    "the board does not show yet that it has stopped: nothing was done".to_owned(),
                ));
            }
            Command::Take => return self.take_command(id),
            _ if self.commander.page != Some(id) => {
                let who = if self.commander.page.is_some() {
                    "another page commands"
                } else {
                    "this page does not command"
                };
                return Err(Failure::Refused(format!(
                    "{who} the board: nothing was done. Take command first"
                )));
            }
            _ => {}
        }
        let is_enabled = self.is_enabled();
        let board = &mut self.session.board;
        match command {
            Command::Release => {
                // An enabled board refuses it.
                board.ask("release command", Request::ReleaseCommand)?;
                (self.commander.page, self.board_commander) = (None, None);
                self.commander.ended();
                Ok("command given back".to_owned())
            }
            Command::Disable => {
                board.disable()?;
                self.commander.ended();
                Ok("outputs off".to_owned())
            }
            Command::Clear { .. } if is_enabled => Err(Failure::Refused(
                "the board is enabled, its outputs are on: nothing was done. Disable it first".to_owned(),
            )),
            Command::Clear { total } => {
                // Those that this page has shown. The board refuses if there is another one since: what was
                // read here in the meantime does not count.
                match board.ask("clear the faults", Request::ClearFaults { total }) {
                    Err(BoardError::Refused { refusal: Refusal::FaultsUnread { .. }, .. }) => {
                        // The page gets it with the next state.
                        self.known_faults = None;
                        return Err(Failure::Refused(words::ANOTHER_FAULT.to_owned()));
                    }
                    other => other?,
                };
                Ok("fault cleared: the board is disabled, its outputs are off".to_owned())
            }
            Command::Tare => {
                board.tare()?;
                Ok("force sensors zeroed".to_owned())
            }
            Command::Enable { task, plan } => self.enable(&task, plan.as_deref()),
            Command::Goal { joint, angle } => self.set_goal(joint, angle),
            Command::Object { translation, rotation } => {
                self.move_object(translation.into(), rotation.into())
            }
            Command::PutDown => {
                board.grasp(GraspCommand::PutDown)?;
                Ok("the object is put down".to_owned())
            }
            Command::Open => {
                board.grasp(GraspCommand::Open)?;
                Ok("the hand opens".to_owned())
            }
            Command::Tool { translation } => self.move_tool(translation.into()),
            // Carried out before.
            Command::Seen { .. } | Command::Stop | Command::Take => Ok(String::new()),
        }
    }

    /// A page says stop. What waits is dropped: it was said before.
    pub fn obey_stop(&mut self, id: u64) -> Result<(), Failure> {
        self.stop()?;
        self.answer(id, true, "the board was told to stop");
        let waiting: Vec<u64> = self
            .pages
            .iter_mut()
            .flat_map(|(&id, page)| std::mem::take(&mut page.waiting).into_iter().map(move |_| id))
            .collect();
        for id in waiting {
            self.answer(id, false, "a stop came first: this was not carried out");
        }
        self.tell_status();
        Ok(())
    }

    /// Stops, also where another page or program commands. It is repeated until the telemetry shows it.
    fn stop(&mut self) -> Result<(), Failure> {
        self.session.board.post(Request::Stop)?;
        self.server.stop().store(false, Ordering::Relaxed);
        // Nothing that is sent from here on may keep the robot going.
        self.commander.ended();
        self.catch_up()?;
        let after = self.telemetry.as_ref().map(|telemetry| telemetry.tick);
        let now = Instant::now();
        self.commander.stopping = Some(Stopping { warns: Some(now + STOP_PATIENCE), after });
        self.commander.next = now + KEEP_ALIVE;
        Ok(())
    }

    fn take_command(&mut self, id: u64) -> Result<String, Failure> {
        if self.commander.page.is_some_and(|page| page != id) {
            return Err(Failure::Refused(
                "another page commands the board: give command back there, or close it".to_owned(),
            ));
        }
        self.session.board.take_command(self.commander.take_over)?;
        (self.commander.page, self.commander.releases) = (Some(id), false);
        self.board_commander = Some(self.session.board.client());
        Ok("this page commands the board".to_owned())
    }

    fn enable(&mut self, task: &str, plan: Option<&str>) -> Result<String, Failure> {
        let kind = TaskKind::ALL.iter().copied().find(|kind| kind.to_string() == task);
        self.catch_up()?;
        let (model, _) = self.model.as_ref().ok_or(Failure::NoModel)?;
        // Old angles would be goals to which the joints move, and nobody would see what the robot does.
        let telemetry = self.telemetry.as_ref().filter(|_| self.heard.elapsed() < FRESH);
        let telemetry = telemetry
            .ok_or_else(|| Failure::Late("no telemetry: where the joints are is not known".to_owned()))?;
        self.session.require_quick_link(model)?;
        let board = &mut self.session.board;
        let file = plan_file(self.folder.as_ref(), &self.plans, task, plan);
        // A refused request leaves what runs as it is.
        match kind {
            Some(TaskKind::JointServo) => {
                let joints = telemetry.joints.iter().zip(&model.joints);
                let goal = joints.map(|(now, joint)| angles::within(now.position, &joint.limits)).collect();
                enable(board, TaskConfig::JointServo(ServoMode::Observer))?;
                (self.commander.goal, self.commander.tool) = (goal, None);
            }
            Some(TaskKind::Grasping) => {
                let plan = load_for(&file?, model)?;
                enable(board, TaskConfig::Grasping(()))?;
                (self.commander.grasped, self.commander.tool) = (Some(Grasped::new(plan)), None);
                self.commander.object = (Vector3::zeros(), UnitQuaternion::identity());
                if let Err(error) = board.grasp(GraspCommand::Grasp(plan)) {
                    // Enabled for nothing.
                    let _ = board.disable();
                    return Err(error.into());
                }
            }
            Some(TaskKind::Impedance) => {
                let settings = impedance::load(&file?, model)?;
                enable(board, TaskConfig::Impedance(settings))?;
                self.commander.tool = None;
                let tool = board.read_impedance().inspect_err(|_| {
                    // Enabled for nothing.
                    let _ = board.disable();
                })?;
                let from = PosePoint {
                    position: tool.position,
                    rotation: tool.rotation,
                    velocity: [0.0; 6],
                    acceleration: [0.0; 6],
                };
                let elbow = ElbowSetpoint { angle: tool.elbow, ..ElbowSetpoint::default() };
                let begun = Instant::now();
                self.commander.tool = Some(ToolPath { from, step: Vector3::zeros(), begun, elbow });
            }
            _ => return Err(Failure::Usage(format!("this page cannot enable {task:?}"))),
        }
        self.commander.enabled = kind.map(|task| Enabled { task, since: Instant::now(), seen: false });
        self.commander.next = Instant::now();
        Ok("enabled".to_owned())
    }

    fn set_goal(&mut self, joint: usize, angle: f32) -> Result<String, Failure> {
        if !matches!(self.commander.enabled, Some(Enabled { task: TaskKind::JointServo, .. })) {
            return Err(Failure::Refused(
                "the joints are not enabled by this page: nothing was done".to_owned(),
            ));
        }
        let (model, _) = self.model.as_ref().ok_or(Failure::NoModel)?;
        let count = model.joints.len();
        let (Some(goal), Some(joint)) = (self.commander.goal.get_mut(joint), model.joints.get(joint)) else {
            return Err(Failure::Usage(format!(
                "joint {joint}: {} has {count} joints, from 0 on",
                model.name
            )));
        };
        joints::check(joint, angle)?;
        *goal = angle;
        self.commander.next = Instant::now();
        Ok(String::new())
    }

    fn move_object(&mut self, translation: Vector3<f32>, rotation: Vector3<f32>) -> Result<String, Failure> {
        let (place, turn) = self.commander.object;
        let object = (place + translation, UnitQuaternion::from_scaled_axis(rotation) * turn);
        self.session.board.grasp(GraspCommand::Move {
            translation: object.0.into(),
            rotation: object.1.scaled_axis().into(),
            duration: STEP,
        })?;
        self.commander.object = object;
        let model = self.model.as_ref().map(|(model, _)| model);
        if model.is_some_and(|model| is_on_support(model, &[object.0, place])) {
            return Ok(format!("{}; lift it first", words::ON_SUPPORT));
        }
        Ok(String::new())
    }

    fn move_tool(&mut self, step: Vector3<f32>) -> Result<String, Failure> {
        let now = Instant::now();
        let Some(tool) = &mut self.commander.tool else {
            return Err(Failure::Refused("no arm is enabled by this page: nothing was done".to_owned()));
        };
        if now < tool.begun + Duration::from_secs_f32(STEP) && tool.step.norm() > 0.0 {
            return Err(Failure::Refused("the tool still moves: wait until it has arrived".to_owned()));
        }
        if !step.norm().is_finite() || step.norm() > 0.05 {
            return Err(Failure::Usage("a step of the tool is at most 50 mm".to_owned()));
        }
        *tool = ToolPath { from: tool.at(now), step, begun: now, elbow: tool.elbow };
        Ok(String::new())
    }

    /// What is due now: set-points, the lease, a stop that was not seen yet.
    pub fn drive(&mut self, now: Instant) -> Result<(), Failure> {
        if let Some(page) = self.commander.page {
            let is_enabled = self.commander.enabled.is_some();
            if is_enabled && self.is_blind()? {
                self.stop()?;
                let text = "the telemetry has ceased: no set-points are sent any more, and the board is told to stop";
                self.answer(page, false, text);
            } else if is_enabled && self.has_left(page, SILENT_PAGE) {
                self.answer(page, false, "this page did not answer any more: the robot was stopped");
                self.page_gone(page)?;
            } else if self.has_left(page, IDLE_PAGE) {
                self.answer(page, false, "this page did not answer any more: command was given back");
                self.page_gone(page)?;
            }
        }
        if now < self.commander.next {
            return Ok(());
        }
        self.commander.next = now + KEEP_ALIVE;
        if let Some(stopping) = &mut self.commander.stopping {
            self.session.board.post(Request::Stop)?;
            if stopping.warns.is_some_and(|at| now > at) {
                stopping.warns = None;
                self.pages.keys().for_each(|&id| self.answer(id, false, words::NOT_STOPPED));
            }
            return Ok(());
        }
        match (self.commander.enabled, self.commander.page) {
            (Some(Enabled { task, .. }), Some(_)) => {
                let request = self.commander.set_point(task, now);
                self.session.board.post(request)?;
                if self.commander.tool.is_some() {
                    self.commander.next = now + POINT;
                }
            }
            (None, Some(_)) => {
                self.session.board.post(Request::TakeCommand { by_force: false })?;
                self.commander.next = now + RENEWAL;
            }
            (_, None) if self.commander.releases && !self.is_enabled() => {
                self.commander.releases = false;
                self.session.board.post(Request::ReleaseCommand)?;
            }
            (_, None) => {}
        }
        Ok(())
    }

    /// Whether the robot moves unseen.
    fn is_blind(&mut self) -> Result<bool, Failure> {
        if self.heard.elapsed() > BLIND {
            // It may have come while the board was waited for.
            self.catch_up()?;
        }
        Ok(self.heard.elapsed() > BLIND)
    }

    /// Whether a page has gone, or has not answered for so long to what it was sent.
    fn has_left(&self, id: u64, patience: Duration) -> bool {
        self.pages.get(&id).is_none_or(|page| {
            let unseen = self.departures.range(page.seen + 1..).next().filter(|_| page.sent > page.seen);
            unseen.is_some_and(|(_, sent)| sent.elapsed() > SILENT_PAGE) && page.heard.elapsed() > patience
        })
    }

    fn is_enabled(&self) -> bool {
        self.telemetry.as_ref().is_some_and(|telemetry| matches!(telemetry.mode, Mode::Enabled(_)))
    }

    /// A page has gone. If it commanded an enabled robot, the robot is stopped.
    pub fn page_gone(&mut self, id: u64) -> Result<(), Failure> {
        if self.commander.page != Some(id) {
            return Ok(());
        }
        if self.commander.enabled.take().is_some() {
            self.stop()?;
        }
        (self.commander.page, self.commander.releases) = (None, true);
        (self.commander.grasped, self.commander.tool) = (None, None);
        self.tell_status();
        Ok(())
    }

    /// The board has refused a set-point.
    pub fn refused(&mut self, refusal: Refusal) {
        let Some(page) = self.commander.page else { return };
        if matches!(
            refusal,
            Refusal::Commanded { .. } | Refusal::NotCommander | Refusal::SchemaMismatch { .. }
        ) {
            // What another program has enabled since is its own.
            (self.commander.page, self.commander.enabled) = (None, None);
        } else if self.commander.enabled.is_none() || refusal == Refusal::WrongMode(Mode::Fault) {
            // A set-point that was on its way when the page disabled the board, or when a fault came.
            return;
        }
        if matches!(refusal, Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(_)))) {
            self.commander.rest();
        }
        let text = self.words(BoardError::refused("go on", refusal).into());
        self.answer(page, false, &text);
    }

    /// A failure with the names of joints, where they are known.
    fn words(&self, failure: Failure) -> String {
        match &self.model {
            Some((model, _)) => failure.named(model).to_string(),
            None => failure.to_string(),
        }
    }

    /// The program ends: what a page has enabled is disabled.
    pub fn leave(mut self) {
        self.session.ignore_interrupts();
        self.session.board.set_timeout(LAST_WORD);
        if self.commander.enabled.is_some() {
            let _ = self.session.board.disable();
        }
        if self.commander.page.is_some() || self.commander.releases {
            let _ = self.session.board.ask("release command", Request::ReleaseCommand);
        }
    }
}

/// Enables the board; one whose answer does not come may be enabled, and is told to disable.
fn enable(board: &mut LinkBoard<BoardLink>, task: TaskConfig) -> Result<(), BoardError> {
    let enabled = board.enable(task);
    // Where a stop has interrupted the wait for the answer, it is sent next.
    if matches!(enabled, Err(BoardError::Timeout { .. } | BoardError::WrongReply { .. })) {
        board.post(Request::Disable)?;
    }
    enabled
}

/// The file of a plan; only those that the page was offered.
fn plan_file(
    folder: Option<&RobotFolder>,
    plans: &[Plan],
    task: &str,
    plan: Option<&str>,
) -> Result<PathBuf, Failure> {
    let unknown = || {
        Failure::Usage(format!(
            "{task} needs a file of the robot folder: start `tesaki view` with --robot DIR"
        ))
    };
    let found = plans.iter().find(|other| other.task == task && Some(other.name.as_str()) == plan);
    let (folder, plan) = folder.zip(found).ok_or_else(unknown)?;
    let kind = if task == TaskKind::Grasping.to_string() { "grasps" } else { "impedances" };
    Ok(folder.path.join(kind).join(&plan.name))
}
