//! The commands `enable`, `move`, `home` and `tare`, and the control loop of all commands that move.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::math::abs;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{Mode, Request, TaskReport, Telemetry};
use tesaki::task::grasping::{GraspCommand, GraspTelemetry};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig, TaskTelemetry};
use tesaki_supervisor::{Board, BoardError};

use crate::args::{Enable, Home, Move, Options};
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::output;

/// Period of the set-points: well below the command timeout, so that a few may be lost.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Period of the requests for the task's telemetry.
const ASK: Duration = Duration::from_millis(50);
/// Period of the lines of JSON.
const REPORT: Duration = Duration::from_millis(100);
/// A board that is silent for longer is considered lost.
const GONE: Duration = Duration::from_secs(5);
/// Telemetries in a row within the tolerance that count as arrival.
const ARRIVED: u32 = 10;

pub fn enable(options: &Options, args: &Enable) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let goal = motion.positions()?;
    output::confirm(
        options,
        &format!("The joints of {} will be powered and hold their angles. Continue?", motion.model.name),
    )?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    output::notice(options, "enabled: the joints hold; Ctrl-C disables");
    let until = args.duration.map(|duration| Instant::now() + duration);
    let hold = goal_request(&goal)?;
    let end = motion.drive(KEEP_ALIVE, |_| hold.clone(), |_, now| until.is_some_and(|until| now >= until))?;
    motion.end(end == End::Interrupted)
}

/// How near the joints are to their goals.
#[derive(Default)]
struct Progress {
    /// Telemetries in a row within the tolerance.
    within_tolerance: u32,
    /// The joint with the largest error [rad].
    worst: (usize, f32),
}

impl Progress {
    fn update(&mut self, telemetry: &Telemetry, goal: &[f32], tolerance: f32) {
        let errors = telemetry.joints.iter().zip(goal).map(|(joint, goal)| abs(goal - joint.position));
        self.worst = errors.enumerate().fold(
            (0, 0.0),
            |worst, (index, error)| {
                if error > worst.1 { (index, error) } else { worst }
            },
        );
        self.within_tolerance = if self.worst.1 <= tolerance { self.within_tolerance + 1 } else { 0 };
    }

    const fn arrived(&self) -> bool {
        self.within_tolerance >= ARRIVED
    }
}

pub fn move_joints(options: &Options, args: &Move) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let mut goal = motion.positions()?;
    set_goals(&mut goal, &motion.model, args)?;
    let count = output::counted(args.joints.len(), "joint");
    output::confirm(options, &format!("{count} of {} will move. Continue?", motion.model.name))?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    let deadline = Instant::now() + args.within;
    let mut progress = Progress::default();
    let set_point = goal_request(&goal)?;
    let done = |news: &News, now| {
        if let Some(telemetry) = &news.telemetry {
            progress.update(telemetry, &goal, args.tolerance);
        }
        progress.arrived() || now >= deadline
    };
    if motion.drive(KEEP_ALIVE, |_| set_point.clone(), done)? == End::Interrupted {
        return motion.end(true);
    }
    let (joint, error) = progress.worst;
    if !progress.arrived() {
        let joint = motion.model.joint_name(joint).to_owned();
        motion.end(false)?;
        return Err(Failure::Late(format!(
            "{joint} is still {error:.4} rad from its target after {} s (tolerance {} rad); the board is disabled. Is the \
             joint blocked, or --within too short?",
            args.within.as_secs_f64(),
            args.tolerance
        )));
    }
    output::result(options, &json!({ "arrived": true, "largest_error": output::exact(&error) }), || {
        format!("arrived: the largest error is {error:.4} rad")
    })?;
    if args.hold {
        output::notice(options, "holding; Ctrl-C disables");
        motion.drive(KEEP_ALIVE, |_| set_point.clone(), |_, _| false)?;
    }
    motion.end(false)
}

/// Replaces the angles of the joints that are named.
fn set_goals(goal: &mut [f32], model: &RobotModel, args: &Move) -> Result<(), Failure> {
    let unit = if args.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    for (name, angle) in &args.joints {
        let (index, joint) = find(model, name)?;
        let base = if args.relative { goal[index] } else { 0.0 };
        goal[index] = base + angle * unit;
        check(joint, goal[index])?;
    }
    Ok(())
}

pub fn home(options: &Options, args: &Home) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let unit = if args.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    let mut angles: Vec<Option<f32>> = vec![args.others.map(|angle| angle * unit); model.joints.len()];
    for (name, angle) in &args.joints {
        let (index, _) = find(&model, name)?;
        angles[index] = Some(angle * unit);
    }
    let mut positions = Vec::new();
    for (joint, angle) in model.joints.iter().zip(angles) {
        let angle = angle.ok_or_else(|| {
            Failure::Usage(format!(
                "{} has no angle: name every joint, or give the others with --others",
                joint.name
            ))
        })?;
        check(joint, angle)?;
        positions.push(angle);
    }
    output::confirm(options, "The current joint angles will be set to these values. Continue?")?;
    session.board.home(&positions)?;
    output::result(options, &json!({ "homed": output::exact(&positions) }), || {
        format!("{} homed", output::counted(positions.len(), "joint"))
    })
}

fn goal_request(goal: &[f32]) -> Result<Request, Failure> {
    let positions = heapless::Vec::from_slice(goal).map_err(|_| BoardError::TooManyJoints(goal.len()))?;
    Ok(Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions })))
}

pub fn tare(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    output::confirm(options, "The force sensors will be set to zero. Is nothing touching the tips?")?;
    session.board.tare()?;
    output::result(options, &json!({ "tared": true }), || "force sensors tared".to_owned())
}

/// The joint called `name`.
fn find<'a>(model: &'a RobotModel, name: &str) -> Result<(usize, &'a JointModel), Failure> {
    model.joints.iter().enumerate().find(|(_, joint)| joint.name == name).ok_or_else(|| {
        let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
        Failure::Usage(format!("{} has no joint {name:?}; its joints are {}", model.name, names.join(", ")))
    })
}

/// The board checks this too, but cannot name the joint.
fn check(joint: &JointModel, angle: f32) -> Result<(), Failure> {
    let limits = joint.limits;
    if angle >= limits.lower && angle <= limits.upper {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "{}: {angle} rad is outside its limits {} to {} rad",
        joint.name, limits.lower, limits.upper
    )))
}

/// How a motion ended without a failure.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It is complete.
    Done,
    /// Ctrl-C.
    Interrupted,
}

/// Data received since the last set-point.
#[derive(Default)]
pub struct News {
    pub telemetry: Option<Telemetry>,
    /// Telemetry of the running task.
    pub task: Option<TaskReport>,
}

/// A board that this program commands and may have enabled.
pub struct Motion<'a> {
    session: BoardSession,
    options: &'a Options,
    pub model: RobotModel,
    enabled: bool,
    /// Whether to request the task's own telemetry.
    asks: bool,
}

impl<'a> Motion<'a> {
    pub fn begin(options: &'a Options) -> Result<Self, Failure> {
        let mut session = BoardSession::command(options)?;
        let model = session.model()?;
        let mode = session.board.status()?.node.mode;
        session.require_no_fault(mode, Some(&model))?;
        Ok(Self { session, options, model, enabled: false, asks: false })
    }

    /// The joint angles, clamped to their limits [rad].
    pub fn positions(&mut self) -> Result<Vec<f32>, Failure> {
        let telemetry = self.session.telemetry_now()?;
        let joints = telemetry.joints.iter().zip(&self.model.joints);
        // A joint at its stop may measure slightly outside.
        Ok(joints
            .map(|(state, joint)| state.position.clamp(joint.limits.lower, joint.limits.upper))
            .collect())
    }

    pub fn enable(&mut self, task: TaskConfig) -> Result<(), Failure> {
        // From here on Ctrl-C must not end the process before the outputs are off.
        interrupted()?;
        // The joint servo has no telemetry beyond that of the joints.
        self.asks = !matches!(task, TaskConfig::JointServo(_));
        self.session.board.enable(task).map_err(|error| Failure::from(error).named(&self.model))?;
        self.enabled = true;
        Ok(())
    }

    /// Sends a grasp command; returns the tick and the hand's telemetry after it.
    pub fn grasp(&mut self, command: GraspCommand) -> Result<(u32, GraspTelemetry), Failure> {
        self.session.board.grasp(command)?;
        let report = self.session.board.read_task()?;
        match report.telemetry {
            TaskTelemetry::Grasping(grasp) => Ok((report.tick, grasp)),
            _ => Err(Failure::Other("another program has enabled another task".to_owned())),
        }
    }

    /// Sends a set-point in each period `every`, until `done`.
    pub fn drive(
        &mut self,
        every: Duration,
        mut set_point: impl FnMut(Instant) -> Request,
        mut done: impl FnMut(&News, Instant) -> bool,
    ) -> Result<End, Failure> {
        let interrupted = interrupted()?;
        let (mut heard, mut reported, mut asked) = (Instant::now(), None::<Instant>, None::<Instant>);
        // Telemetry sent before the board was enabled may still arrive.
        let mut seen_enabled = false;
        let mut next = Instant::now();
        loop {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(End::Interrupted);
            }
            // Relative to the last deadline, so that delays do not add up.
            let now = Instant::now();
            next = if now > next + every { now + every } else { next + every };
            self.session.board.post(set_point(now))?;
            if self.asks && asked.is_none_or(|last| now - last >= ASK) {
                asked = Some(now);
                self.session.board.post(Request::ReadTask)?;
            }
            let news = self.listen(next)?;
            let now = Instant::now();
            if let Some(telemetry) = &news.telemetry {
                heard = now;
                self.check_mode(telemetry.mode, &mut seen_enabled)?;
            } else if now - heard > GONE {
                return Err(self.abandon(Failure::Late(format!(
                    "no data from the board for {} s; its command timeout has stopped it by now",
                    GONE.as_secs()
                ))));
            }
            if self.options.json
                && reported.is_none_or(|last| now - last >= REPORT)
                && let Some(report) = self.report(&news)
            {
                reported = Some(now);
                output::line(&report)?;
            }
            if done(&news, now) {
                return Ok(End::Done);
            }
        }
    }

    /// Receives until `deadline`.
    fn listen(&mut self, deadline: Instant) -> Result<News, Failure> {
        let mut news = News::default();
        while Instant::now() < deadline {
            match self.session.telemetry(deadline.saturating_duration_since(Instant::now())) {
                Ok(telemetry) => news.telemetry = Some(telemetry),
                Err(Failure::Late(_)) => {}
                Err(failure) => return Err(self.abandon(failure.named(&self.model))),
            }
        }
        news.task = self.session.task.take();
        Ok(news)
    }

    /// Fails when the board is in fault, or was disabled by another program.
    fn check_mode(&mut self, mode: Mode, seen_enabled: &mut bool) -> Result<(), Failure> {
        match mode {
            Mode::Fault => {
                self.enabled = false;
                Err(Failure::Fault(self.session.fault(Some(&self.model))?))
            }
            Mode::Disabled if *seen_enabled => {
                self.enabled = false;
                Err(Failure::Other("another program disabled the board".to_owned()))
            }
            Mode::Disabled => Ok(()),
            Mode::Enabled(_) => {
                *seen_enabled = true;
                Ok(())
            }
        }
    }

    /// The latest telemetry as JSON.
    fn report(&self, news: &News) -> Option<String> {
        match (self.asks, news) {
            (false, News { telemetry: Some(telemetry), .. }) => serde_json::to_string(telemetry).ok(),
            (true, News { task: Some(report), .. }) => Some(output::task(report).to_string()),
            _ => None,
        }
    }

    /// Disables the board after a failure, if that is still possible.
    fn abandon(&mut self, failure: Failure) -> Failure {
        if self.enabled {
            let _ = self.session.board.disable();
        }
        failure
    }

    /// Disables the board and releases command.
    pub fn end(mut self, interrupted: bool) -> Result<(), Failure> {
        self.session.board.disable()?;
        self.enabled = false;
        output::notice(self.options, if interrupted { "\ninterrupted: disabled" } else { "disabled" });
        Ok(())
    }
}
