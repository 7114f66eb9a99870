//! The commands `enable` and `move`, and the control loop of all commands that move.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::math::abs;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{Mode, Refusal, Request, Stream, TaskReport, Telemetry};
use tesaki::task::grasping::{GraspCommand, GraspTelemetry};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki_supervisor::faults::FaultsBefore;
use tesaki_supervisor::gravity::Load;
use tesaki_supervisor::{Board, BoardError};

use crate::args::{Enable, Move, Options};
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::output;

/// Period of the set-points: well below the command timeout, so that a few may be lost.
pub const KEEP_ALIVE: Duration = Duration::from_millis(20);
/// Period of the board's ticks.
pub const PERIOD: Duration = Duration::from_millis(10);
/// Period of the requests for the task's telemetry, and where a behaviour decides by it.
const ASK: Duration = Duration::from_millis(50);
const ASK_TO_DECIDE: Duration = Duration::from_millis(20);
/// Period of the lines of JSON.
const REPORT: Duration = Duration::from_millis(100);
/// Without telemetry for this time, the stream is requested again: the board may have been reset.
const SILENCE: Duration = Duration::from_millis(300);
/// How long a board that may be gone is told to disable.
const LAST_WORD: Duration = Duration::from_millis(500);
/// How long a board that has not answered that is told again.
const FAREWELL: Duration = Duration::from_secs(2);
/// Telemetries in a row within the tolerance that count as arrival.
const ARRIVED: u32 = 10;

pub fn enable(options: &Options, args: &Enable) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    output::confirm(
        options,
        &format!("The joints of {} will be powered and hold their angles. Continue?", motion.model.name),
    )?;
    // The joints may have moved during the question.
    let goal = motion.positions()?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    output::notice(options, "enabled: the joints hold");
    motion.announce_ctrl_c(Load::at(&motion.model, &goal).as_ref());
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
    motion.goal(args)?;
    let count = output::counted(args.joints.len(), "joint");
    output::confirm(options, &format!("{count} of {} will move. Continue?", motion.model.name))?;
    // The joints may have moved during the question.
    let goal = motion.goal(args)?;
    motion.enable(TaskConfig::JointServo(args.servo.into()))?;
    let load = Load::at(&motion.model, &goal);
    motion.announce_ctrl_c(load.as_ref());
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
    let joint = motion.model.joint_name(joint).to_owned();
    if !progress.arrived() {
        let late = format!(
            "{joint} is still {error:.4} rad from its target after {} s (tolerance {} rad)",
            args.within.as_secs_f64(),
            args.tolerance
        );
        // Not at the goal, where something may be in the way.
        let here = goal_request(&motion.angles_within_limits())?;
        if motion.load().is_some() && !args.no_hold {
            output::notice(options, &format!("{late}; it holds where it is until Ctrl-C"));
            motion.drive(KEEP_ALIVE, |_| here.clone(), |_, _| false)?;
        }
        motion.end(false)?;
        return Err(Failure::Late(format!(
            "{late}; the board is disabled. Is the joint blocked, or --within too short?"
        )));
    }
    let value = json!({ "arrived": true, "joint": joint, "largest_error": output::exact(&error) });
    output::result(options, &value, || format!("arrived: the largest error is {error:.4} rad, of {joint}"))?;
    motion.stay(args.hold, args.no_hold, load.as_ref(), KEEP_ALIVE, |_| set_point.clone())?;
    motion.end(false)
}

/// Replaces the angles of the joints that are named.
fn set_goals(goal: &mut [f32], model: &RobotModel, args: &Move) -> Result<(), Failure> {
    let unit = if args.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    each_once(&args.joints, "joint")?;
    for (name, angle) in &args.joints {
        let (index, joint) = find(model, name)?;
        let base = if args.relative { goal[index] } else { 0.0 };
        goal[index] = base + angle * unit;
        check(joint, goal[index])?;
    }
    Ok(())
}

/// Refuses what is named twice.
pub fn each_once<T>(named: &[(String, T)], what: &str) -> Result<(), Failure> {
    for (index, (name, _)) in named.iter().enumerate() {
        if named.iter().take(index).any(|(earlier, _)| earlier == name) {
            return Err(Failure::Usage(format!("the {what} {name} is given twice: which is meant?")));
        }
    }
    Ok(())
}

fn goal_request(goal: &[f32]) -> Result<Request, Failure> {
    let positions = heapless::Vec::from_slice(goal).map_err(|_| BoardError::TooManyJoints(goal.len()))?;
    Ok(Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions })))
}

/// The joint called `name`.
pub fn find<'a>(model: &'a RobotModel, name: &str) -> Result<(usize, &'a JointModel), Failure> {
    model.joints.iter().enumerate().find(|(_, joint)| joint.name == name).ok_or_else(|| {
        let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
        Failure::Usage(format!("{} has no joint {name:?}; its joints are {}", model.name, names.join(", ")))
    })
}

/// The board checks this too, but cannot name the joint.
pub fn check(joint: &JointModel, angle: f32) -> Result<(), Failure> {
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
    /// When that came.
    pub arrived: Option<Instant>,
    /// Telemetry of the running task.
    pub task: Option<TaskReport>,
    /// Why the task refused a set-point; the one before remains.
    pub refused: Option<TaskRefusal>,
}

/// A board that this program commands and may have enabled.
pub struct Motion<'a> {
    session: BoardSession,
    options: &'a Options,
    pub model: RobotModel,
    /// The latest joint angles [rad].
    angles: Vec<f32>,
    /// Faults of the board before.
    faults: FaultsBefore,
    /// Whether the board is in fault because the program before has ended, which enabling clears.
    resumes: bool,
    enabled: bool,
    /// Period of the requests for the task's own telemetry, if it has any.
    asks: Option<Duration>,
    /// Whether nobody reads the output any more.
    is_unread: bool,
}

/// However a command ends, the outputs are off.
impl Drop for Motion<'_> {
    fn drop(&mut self) {
        if self.enabled {
            self.session.board.set_timeout(self.options.timeout.min(LAST_WORD));
            let _ = self.session.board.disable();
        }
        output::set_controls(false);
    }
}

impl<'a> Motion<'a> {
    pub fn begin(options: &'a Options) -> Result<Self, Failure> {
        Self::begin_after(options, false)
    }

    /// As [`Motion::begin`]; with `resumes` also where the board reacts to the end of the program before.
    pub fn begin_after(options: &'a Options, resumes: bool) -> Result<Self, Failure> {
        let mut session = BoardSession::command(options)?;
        let model = session.model()?;
        let node = session.board.status()?.node;
        let resumes = resumes && node.mode == Mode::Fault && session.has_timed_out()?;
        if !resumes {
            session.require_no_fault(node.mode, Some(&model))?;
        }
        Ok(Self {
            session,
            options,
            model,
            angles: Vec::new(),
            faults: FaultsBefore::from(&node),
            resumes,
            enabled: false,
            asks: None,
            is_unread: false,
        })
    }

    /// The joint angles, clamped to their limits [rad].
    pub fn positions(&mut self) -> Result<Vec<f32>, Failure> {
        let telemetry = self.session.telemetry_now()?;
        self.remember(&telemetry);
        Ok(self.angles_within_limits())
    }

    /// The present angles, with those of `args` in their place [rad].
    fn goal(&mut self, args: &Move) -> Result<Vec<f32>, Failure> {
        let mut goal = self.positions()?;
        set_goals(&mut goal, &self.model, args)?;
        Ok(goal)
    }

    fn remember(&mut self, telemetry: &Telemetry) {
        self.angles = telemetry.joints.iter().map(|joint| joint.position).collect();
    }

    /// The latest angles. A joint at its stop may measure slightly outside.
    fn angles_within_limits(&self) -> Vec<f32> {
        let joints = self.angles.iter().zip(&self.model.joints);
        joints.map(|(angle, joint)| angle.clamp(joint.limits.lower, joint.limits.upper)).collect()
    }

    /// What pulls at the robot where it is.
    pub fn load(&self) -> Option<Load> {
        Load::at(&self.model, &self.angles)
    }

    /// Says what Ctrl-C does, and what becomes of a robot that gravity pulls.
    pub fn announce_ctrl_c(&self, load: Option<&Load>) {
        let falls = load.map_or_else(String::new, |load| format!("; {load}"));
        output::notice(self.options, &format!("Ctrl-C disables{falls}"));
    }

    /// Holds after arrival until Ctrl-C, if it was asked for or if the robot would fall; not with `no_hold`.
    pub fn stay(
        &mut self,
        hold: bool,
        no_hold: bool,
        load: Option<&Load>,
        every: Duration,
        set_point: impl FnMut(Instant) -> Request,
    ) -> Result<(), Failure> {
        let why = match load {
            _ if hold => String::new(),
            Some(load) if !no_hold => format!(", because {load}"),
            _ => return Ok(()),
        };
        output::notice(self.options, &format!("holding{why}; Ctrl-C disables"));
        self.drive(every, set_point, |_, _| false)?;
        Ok(())
    }

    pub fn enable(&mut self, task: TaskConfig) -> Result<(), Failure> {
        // From here on Ctrl-C must not end the process before the outputs are off.
        interrupted()?;
        // The joint servo has no telemetry beyond that of the joints.
        output::set_controls(true);
        self.asks = match task {
            TaskConfig::JointServo(_) => None,
            TaskConfig::VisualApproach(_) => Some(ASK_TO_DECIDE),
            _ => Some(ASK),
        };
        if std::mem::take(&mut self.resumes) {
            self.session.board.ask("clear its faults", Request::ClearFaults { total: self.faults.total })?;
        }
        self.session.board.enable(task).map_err(|error| Failure::from(error).named(&self.model))?;
        self.enabled = true;
        Ok(())
    }

    /// From now on asks for the task's telemetry as often as it changes.
    pub const fn ask_in_each_period(&mut self) {
        self.asks = Some(PERIOD);
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

    /// Telemetry of impedance control.
    pub fn impedance(&mut self) -> Result<ImpedanceTelemetry, Failure> {
        Ok(self.session.board.read_impedance()?)
    }

    /// See [`BoardSession::round_trip`].
    pub fn round_trip(&mut self) -> Result<Duration, Failure> {
        self.session.round_trip()
    }

    /// The address of the board's port.
    pub fn port(&self) -> &str {
        &self.session.port
    }

    /// Keeps command of the board until it is to be enabled. Returns whether it is; after Ctrl-C it is not.
    pub fn wait_until(&mut self, mut ready: impl FnMut() -> Result<bool, Failure>) -> Result<bool, Failure> {
        let interrupted = interrupted()?;
        while !ready()? {
            if interrupted.load(Ordering::Relaxed) {
                output::notice(self.options, "\ninterrupted: nothing was enabled");
                return Ok(false);
            }
            self.positions()?;
            std::thread::sleep(PERIOD);
        }
        Ok(true)
    }

    /// Sends a set-point in each period `every`, until `done`.
    pub fn drive(
        &mut self,
        every: Duration,
        mut set_point: impl FnMut(Instant) -> Request,
        mut done: impl FnMut(&News, Instant) -> bool,
    ) -> Result<End, Failure> {
        let interrupted = interrupted()?;
        let mut telemetry = Watchdog::new(&self.session);
        let (mut reported, mut asked) = (None::<Instant>, None::<Instant>);
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
            if self.asks.is_some_and(|period| asked.is_none_or(|last| now - last >= period)) {
                asked = Some(now);
                self.session.board.post(Request::ReadTask)?;
            }
            let news = self.listen(next)?;
            let now = Instant::now();
            if let Some(latest) = &news.telemetry {
                telemetry = Watchdog::new(&self.session);
                self.remember(latest);
                // What was sent before the faults were cleared may still arrive.
                if latest.mode != Mode::Fault || seen_enabled || latest.faults != self.faults.total {
                    self.check_mode(latest.mode, &mut seen_enabled)?;
                }
            } else {
                self.check_silence(&mut telemetry, now)?;
            }
            if self.options.json
                && !self.is_unread
                && reported.is_none_or(|last| now - last >= REPORT)
                && let Some(report) = self.report(&news)
            {
                reported = Some(now);
                self.is_unread = true;
                output::line(&report)?;
                self.is_unread = false;
            }
            if done(&news, now) {
                return Ok(End::Done);
            }
        }
    }

    /// Without telemetry: requests it again, and gives up after the time in which a board must answer.
    fn check_silence(&mut self, telemetry: &mut Watchdog, now: Instant) -> Result<(), Failure> {
        let silence = now - telemetry.heard;
        let frames = self.session.board.counts().good;
        if frames != telemetry.frames {
            (telemetry.frames, telemetry.answered) = (frames, now);
        }
        if silence > self.options.timeout.max(2 * SILENCE) {
            let seconds = silence.as_secs_f64();
            if now - telemetry.answered < SILENCE {
                return Err(Failure::Late(format!(
                    "the board answers, but sends no telemetry for {seconds:.1} s: its control loop does not run \
                     (try `tesaki doctor`)"
                )));
            }
            return Err(self.gone(seconds));
        }
        if silence > SILENCE && now - telemetry.requested > SILENCE {
            telemetry.requested = now;
            self.session.board.post(Request::SetRate { stream: Stream::Telemetry, every: 2 })?;
        }
        Ok(())
    }

    /// The board cannot be told to disable.
    fn gone(&mut self, seconds: f64) -> Failure {
        self.enabled = false;
        self.session.give_up();
        Failure::Late(format!(
            "no answer from the board for {seconds:.1} s: check power and cable. If it still runs, it stops by \
             itself {} s after the last command",
            self.model.safety.command_timeout
        ))
    }

    /// Disables the board. One that is silent gets some time, but not all that a patient user allows for an
    /// answer.
    fn switch_off(&mut self) -> Result<(), Failure> {
        let begun = Instant::now();
        self.session.board.set_timeout(self.options.timeout.min(LAST_WORD));
        let mut answer = self.session.board.disable();
        if matches!(answer, Err(BoardError::Timeout { .. })) && self.options.timeout > LAST_WORD {
            output::notice(self.options, "\nno answer from the board yet: it is told again to disable");
            self.session.board.set_timeout(self.options.timeout.min(FAREWELL));
            answer = self.session.board.disable();
        }
        match answer {
            Ok(()) => {
                self.enabled = false;
                output::set_controls(false);
                Ok(())
            }
            Err(BoardError::Timeout { .. }) => Err(self.gone(begun.elapsed().as_secs_f64())),
            Err(error) => Err(error.into()),
        }
    }

    /// Receives until `deadline`.
    fn listen(&mut self, deadline: Instant) -> Result<News, Failure> {
        let mut news = News::default();
        while Instant::now() < deadline {
            match self.session.telemetry(deadline.saturating_duration_since(Instant::now())) {
                Ok(telemetry) => (news.telemetry, news.arrived) = (Some(telemetry), Some(Instant::now())),
                Err(Failure::Late(_)) => {}
                // What another program has enabled since is its own.
                Err(Failure::Board(BoardError::Refused {
                    refusal: Refusal::NotCommander | Refusal::Commanded { .. },
                    ..
                })) => {
                    self.enabled = false;
                    return Err(Failure::Refused(
                        "this program has lost command of the board: another one has disabled it. End that one, then start again"
                            .to_owned(),
                    ));
                }
                // A board that was reset is disabled; one that has forgotten this program may be another's.
                Err(failure @ Failure::Board(BoardError::Reset)) => {
                    self.enabled = false;
                    return Err(failure);
                }
                Err(failure) => return Err(failure.named(&self.model)),
            }
        }
        news.task = self.session.task.take();
        news.refused = self.session.refused.take();
        Ok(news)
    }

    /// Fails when the board is in fault, or was disabled by another program.
    fn check_mode(&mut self, mode: Mode, seen_enabled: &mut bool) -> Result<(), Failure> {
        match mode {
            Mode::Fault => {
                self.enabled = false;
                Err(Failure::Fault(self.session.fault_after(self.faults, Some(&self.model))?))
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
            (None, News { telemetry: Some(telemetry), .. }) => {
                Some(output::telemetry(telemetry, Some(&self.model)).to_string())
            }
            (Some(_), News { task: Some(report), .. }) => Some(output::task(report).to_string()),
            _ => None,
        }
    }

    /// Disables the board and releases command.
    pub fn end(mut self, interrupted: bool) -> Result<(), Failure> {
        self.switch_off()?;
        let what = if interrupted { "\ninterrupted: disabled" } else { "disabled" };
        let load = self.load().map_or_else(String::new, |load| format!("; {load}"));
        output::notice(self.options, &format!("{what}{load}"));
        Ok(())
    }
}

/// Notices when telemetry fails to come.
struct Watchdog {
    /// When the last telemetry came.
    heard: Instant,
    /// When the last frame of any kind came, and how many had come by then.
    answered: Instant,
    frames: u32,
    /// When telemetry was last requested.
    requested: Instant,
}

impl Watchdog {
    fn new(session: &BoardSession) -> Self {
        let now = Instant::now();
        Self { heard: now, answered: now, frames: session.board.counts().good, requested: now }
    }
}
