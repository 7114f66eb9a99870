//! The commands that move joints: arm, move, home; what they share with `reach`.

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

use crate::args::{Arm, Home, Move, Options};
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::output;

/// From one set-point to the next: well inside the command timeout, so that a few may be lost.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// From one question after the object in the hand, or the arm, to the next.
const ASK: Duration = Duration::from_millis(50);
/// From one line of JSON to the next.
const REPORT: Duration = Duration::from_millis(100);
/// A board that is silent for longer has gone.
const GONE: Duration = Duration::from_secs(5);
/// Telemetries in a row within the tolerance that count as arrived.
const ARRIVED: u32 = 10;

pub fn arm(options: &Options, arm: &Arm) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let goal = motion.positions()?;
    output::confirm(
        options,
        &format!("The joints of {} will be powered and hold. Go on?", motion.model.name),
    )?;
    motion.enable(TaskConfig::JointServo(arm.servo.into()))?;
    output::notice(options, "armed: the joints hold; Ctrl-C disarms");
    let until = arm.duration.map(|duration| Instant::now() + duration);
    let hold = goal_request(&goal)?;
    let end = motion.drive(KEEP_ALIVE, |_| hold.clone(), |_, now| until.is_some_and(|until| now >= until))?;
    motion.end(end == End::Interrupted)
}

pub fn go(options: &Options, aim: &Move) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let unit = if aim.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    let mut goal = motion.positions()?;
    for (name, angle) in &aim.joints {
        let (index, joint) = find(&motion.model, name)?;
        let base = if aim.relative { goal[index] } else { 0.0 };
        goal[index] = base + angle * unit;
        check(joint, goal[index])?;
    }
    let goal = goal;
    let named = &aim.joints;
    output::confirm(
        options,
        &format!("{} of {} will move. Go on?", output::counted(named.len(), "joint"), motion.model.name),
    )?;
    motion.enable(TaskConfig::JointServo(aim.servo.into()))?;
    let deadline = Instant::now() + aim.within;
    let (mut near, mut farthest) = (0, (0, 0.0_f32));
    let set_point = goal_request(&goal)?;
    let end =
        motion.drive(
            KEEP_ALIVE,
            |_| set_point.clone(),
            |news, now| {
                if let Some(telemetry) = &news.telemetry {
                    let errors =
                        telemetry.joints.iter().zip(&goal).map(|(joint, goal)| abs(goal - joint.position));
                    farthest = errors.enumerate().fold((0, 0.0), |worst, (index, error)| {
                        if error > worst.1 { (index, error) } else { worst }
                    });
                    near = if farthest.1 <= aim.tolerance { near + 1 } else { 0 };
                }
                near >= ARRIVED || now >= deadline
            },
        )?;
    if end == End::Interrupted {
        return motion.end(true);
    }
    if near < ARRIVED {
        let joint = motion.model.joint_name(farthest.0).to_owned();
        motion.end(false)?;
        return Err(Failure::Late(format!(
            "{joint} is still {:.4} rad from its goal after {} s (tolerance {} rad): the board is disarmed. Is the joint \
             blocked, or --within too short?",
            farthest.1,
            aim.within.as_secs_f64(),
            aim.tolerance
        )));
    }
    output::result(
        options,
        &json!({ "arrived": true, "largest_error": output::exact(&farthest.1) }),
        || format!("arrived: the largest error is {:.4} rad", farthest.1),
    )?;
    if aim.hold {
        output::notice(options, "holding; Ctrl-C disarms");
        motion.drive(KEEP_ALIVE, |_| set_point.clone(), |_, _| false)?;
    }
    motion.end(false)
}

pub fn home(options: &Options, home: &Home) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let unit = if home.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    let mut angles: Vec<Option<f32>> = vec![home.others.map(|angle| angle * unit); model.joints.len()];
    for (name, angle) in &home.joints {
        let (index, _) = find(&model, name)?;
        angles[index] = Some(angle * unit);
    }
    let mut positions = Vec::new();
    for (joint, angle) in model.joints.iter().zip(angles) {
        let angle = angle.ok_or_else(|| {
            Failure::Usage(format!(
                "{} has no angle: name every joint, or give the rest with --others",
                joint.name
            ))
        })?;
        check(joint, angle)?;
        positions.push(angle);
    }
    output::confirm(options, "The joints will be taken to stand at these angles. Is that so?")?;
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
    output::confirm(options, "What the tips feel now will be taken for nothing. Does nothing touch them?")?;
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

/// The board checks this, too, but knows no names.
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

/// Why a motion ended without a failure.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// What was asked for is done.
    Done,
    /// Ctrl-C.
    Interrupted,
}

/// What came from the board since the last set-point.
#[derive(Default)]
pub struct News {
    pub telemetry: Option<Telemetry>,
    /// What the running task says of itself.
    pub task: Option<TaskReport>,
}

/// A board that this program commands and may have armed.
pub struct Motion<'a> {
    session: BoardSession,
    options: &'a Options,
    pub model: RobotModel,
    armed: bool,
    /// Whether to ask for the task's own telemetry.
    asks: bool,
}

impl<'a> Motion<'a> {
    pub fn begin(options: &'a Options) -> Result<Self, Failure> {
        let mut session = BoardSession::command(options)?;
        let model = session.model()?;
        let mode = session.board.status()?.node.mode;
        session.require_no_fault(mode, Some(&model))?;
        Ok(Self { session, options, model, armed: false, asks: false })
    }

    /// Where the joints are, within their limits.
    pub fn positions(&mut self) -> Result<Vec<f32>, Failure> {
        let telemetry = self.session.telemetry_now()?;
        let joints = telemetry.joints.iter().zip(&self.model.joints);
        // A joint may rest against its stop, a hair outside.
        Ok(joints
            .map(|(state, joint)| state.position.clamp(joint.limits.lower, joint.limits.upper))
            .collect())
    }

    pub fn enable(&mut self, task: TaskConfig) -> Result<(), Failure> {
        // Caught from here on: Ctrl-C switches the outputs off.
        interrupted()?;
        // What joints do, telemetry tells.
        self.asks = !matches!(task, TaskConfig::JointServo(_));
        self.session.board.enable(task).map_err(|error| Failure::from(error).named(&self.model))?;
        self.armed = true;
        Ok(())
    }

    /// Tells the hand what to do next; returns the tick and what it does then.
    pub fn grasp(&mut self, command: GraspCommand) -> Result<(u32, GraspTelemetry), Failure> {
        self.session.board.grasp(command)?;
        let report = self.session.board.read_task()?;
        match report.telemetry {
            TaskTelemetry::Grasping(grasp) => Ok((report.tick, grasp)),
            _ => Err(Failure::Other("another program has enabled another task".to_owned())),
        }
    }

    /// Sends what `aim` says for each moment, one set-point `every` so long, until `done` says so.
    pub fn drive(
        &mut self,
        every: Duration,
        mut aim: impl FnMut(Instant) -> Request,
        mut done: impl FnMut(&News, Instant) -> bool,
    ) -> Result<End, Failure> {
        let interrupted = interrupted()?;
        let (mut heard, mut reported, mut asked) = (Instant::now(), None::<Instant>, None::<Instant>);
        // What was on its way while the board was being armed still says otherwise.
        let mut seen_armed = false;
        let mut next = Instant::now();
        loop {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(End::Interrupted);
            }
            // Counted from the one before, so that being late does not add up.
            let now = Instant::now();
            next = if now > next + every { now + every } else { next + every };
            self.session.board.post(aim(now))?;
            if self.asks && asked.is_none_or(|last| now - last >= ASK) {
                asked = Some(now);
                self.session.board.post(Request::ReadTask)?;
            }
            let mut news = News::default();
            while Instant::now() < next {
                match self.session.telemetry(next.saturating_duration_since(Instant::now())) {
                    Ok(telemetry) => news.telemetry = Some(telemetry),
                    Err(Failure::Late(_)) => {}
                    Err(failure) => return Err(self.abandon(failure.named(&self.model))),
                }
            }
            let now = Instant::now();
            news.task = self.session.task.take();
            if let Some(telemetry) = &news.telemetry {
                heard = now;
                if telemetry.mode == Mode::Fault {
                    self.armed = false;
                    let fault = self.session.fault(Some(&self.model))?;
                    return Err(Failure::Fault(fault));
                }
                seen_armed |= matches!(telemetry.mode, Mode::Enabled(_));
                if telemetry.mode == Mode::Disabled && seen_armed {
                    self.armed = false;
                    return Err(Failure::Other("another program disarmed the board".to_owned()));
                }
            } else if now - heard > GONE {
                return Err(self.abandon(Failure::Late(format!(
                    "nothing came from the board for {} s: its own command timeout has stopped it",
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

    /// What is new of the task, as JSON.
    fn report(&self, news: &News) -> Option<String> {
        match (self.asks, news) {
            (false, News { telemetry: Some(telemetry), .. }) => serde_json::to_string(telemetry).ok(),
            (true, News { task: Some(report), .. }) => Some(output::task(report).to_string()),
            _ => None,
        }
    }

    /// Switches off on the way out of a failure, if that is still possible.
    fn abandon(&mut self, failure: Failure) -> Failure {
        if self.armed {
            let _ = self.session.board.disable();
        }
        failure
    }

    /// Switches off and hands the command back.
    pub fn end(mut self, interrupted: bool) -> Result<(), Failure> {
        self.session.board.disable()?;
        self.armed = false;
        output::notice(self.options, if interrupted { "\ninterrupted: disarmed" } else { "disarmed" });
        Ok(())
    }
}
