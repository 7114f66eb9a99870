//! The control loop of all commands that move.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal, Request, Stream, TaskReport, Telemetry};
use tesaki::task::grasping::{GraspCommand, GraspTelemetry};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::{TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki_description::robot::chain_length;
use tesaki_supervisor::faults::FaultsBefore;
use tesaki_supervisor::gravity::{Load, TooHeavy};
pub use tesaki_supervisor::timing::{KEEP_ALIVE, LAST_WORD};
use tesaki_supervisor::{Board, BoardError, angles};

use crate::args::Options;
use crate::board_session::{BoardSession, interrupted, require_homed};
use crate::failure::Failure;
use crate::output;

/// Period of the board's ticks.
pub const PERIOD: Duration = Duration::from_millis(10);
/// Longest duration of a path [s].
pub const MAX_DURATION: f32 = 600.0;
/// Period of the requests for the task's telemetry, and where a behaviour decides by it.
const ASK: Duration = Duration::from_millis(50);
const ASK_TO_DECIDE: Duration = Duration::from_millis(20);
/// Period of the lines of JSON.
const REPORT: Duration = Duration::from_millis(100);
/// An enabled board knows all angles.
const ALL_HOMED: u16 = u16::MAX;
/// No path is longer than this many lengths of its robot.
const LENGTHS: f32 = 10.0;
/// Without telemetry for this time, the stream is requested again: the board may have been reset.
const SILENCE: Duration = Duration::from_millis(300);
/// How long a board that has not answered that is told again.
const FAREWELL: Duration = Duration::from_secs(2);

/// Refuses a `distance` [m] that is beyond the size of the robot, as it is in another unit.
pub fn check_distance(what: &str, distance: f32, model: &RobotModel) -> Result<(), Failure> {
    let longest = (0..model.chains.len()).map(|chain| chain_length(model, chain)).fold(0.0, f32::max);
    if distance <= LENGTHS * longest {
        return Ok(());
    }
    // The square of a huge number is not finite.
    let away = if distance.is_finite() { format!("{distance:.4} m away") } else { "too far away".to_owned() };
    Err(Failure::Usage(format!(
        "{what}: {away}, more than ten times the length of {}, {longest:.3} m: is it in metres?",
        model.name
    )))
}

/// The board cannot be told to disable.
pub fn gone(seconds: f64, model: &RobotModel) -> Failure {
    Failure::Late(format!(
        "no answer from the board for {seconds:.1} s: check power and cable. If it still runs, it stops by \
         itself {} s after the last command",
        model.safety.command_timeout
    ))
}

/// What became of a board after Ctrl-C.
const DISABLED: &str = "the board is disabled";

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
            self.session.ignore_interrupts();
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

    /// The joint angles, clamped to their limits [rad]. Those of joints that are not homed are unknown.
    pub fn positions(&mut self) -> Result<Vec<f32>, Failure> {
        self.read_positions().map_err(|failure| match failure {
            Failure::Board(BoardError::Interrupted) => nothing_enabled(),
            failure => failure,
        })
    }

    fn read_positions(&mut self) -> Result<Vec<f32>, Failure> {
        require_homed(self.session.board.status()?.node.homed, &self.model)?;
        let telemetry = self.session.telemetry_now()?;
        self.remember(&telemetry);
        if self.angles.len() != self.model.joints.len() {
            return Err(BoardError::Reset.into());
        }
        Ok(self.angles_within_limits())
    }

    fn remember(&mut self, telemetry: &Telemetry) {
        self.angles = angles::measured(telemetry);
    }

    /// The latest angles, clamped to their limits [rad].
    pub fn angles_within_limits(&self) -> Vec<f32> {
        let joints = self.angles.iter().zip(&self.model.joints);
        joints.map(|(angle, joint)| angles::within(*angle, &joint.limits)).collect()
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

    /// Switches the outputs on, unless the motors cannot hold the robot where it is.
    pub fn enable(&mut self, task: TaskConfig) -> Result<(), Failure> {
        let heavy = TooHeavy::at(&self.model, &self.angles).filter(|_| !self.angles.is_empty());
        if let Some(heavy) = heavy {
            return Err(Failure::Refused(format!(
                "nothing was enabled: {heavy}. Put the robot where its motors can hold it, raise limits.torque of {} \
                 if its motor allows it, or check masses and gravity of its model",
                heavy.joint()
            )));
        }
        self.session.require_quick_link(&self.model)?;
        // From here on Ctrl-C must not end the process before the outputs are off.
        if self.session.heed_interrupts()?.load(Ordering::Relaxed) {
            return Err(nothing_enabled());
        }
        // The joint servo has no telemetry beyond that of the joints.
        output::set_controls(true);
        self.asks = match task {
            TaskConfig::JointServo(_) => None,
            TaskConfig::VisualApproach(_) => Some(ASK_TO_DECIDE),
            _ => Some(ASK),
        };
        if std::mem::take(&mut self.resumes) {
            let clear = Request::ClearFaults { total: self.faults.total };
            self.session.board.ask("clear its faults", clear).map_err(|error| match error {
                BoardError::Interrupted => nothing_enabled(),
                error => error.into(),
            })?;
        }
        // If the answer is lost, the board may be enabled: it is disabled in the end.
        self.enabled = true;
        self.session.board.enable(task).map_err(|error| {
            self.enabled = !matches!(error, BoardError::Refused { .. } | BoardError::Reset);
            self.broken_off(error)
        })
    }

    /// Why the board did not do what it was asked. After Ctrl-C it is disabled at once.
    fn broken_off(&mut self, error: BoardError) -> Failure {
        match error {
            BoardError::Interrupted => self
                .switch_off()
                .map_or_else(|failure| failure, |()| Failure::Interrupted(DISABLED.to_owned())),
            error => Failure::from(error).named(&self.model),
        }
    }

    /// From now on asks for the task's telemetry as often as it changes.
    pub const fn ask_in_each_period(&mut self) {
        self.asks = Some(PERIOD);
    }

    /// Sends a grasp command; returns the tick and the hand's telemetry after it. After Ctrl-C the board is
    /// not disabled here: the object may have to be put down.
    pub fn grasp(&mut self, command: GraspCommand) -> Result<(u32, GraspTelemetry), Failure> {
        match self.session.board.grasp(command) {
            // The command was faster than the telemetry that shows the fault.
            Err(BoardError::Refused { refusal: Refusal::WrongMode(Mode::Fault), .. }) => {
                self.check_mode(Mode::Fault, &mut true)?;
            }
            Err(BoardError::Interrupted) => return Err(not_awaited()),
            sent => sent.map_err(|error| Failure::from(error).named(&self.model))?,
        }
        self.read_grasp()
    }

    /// The tick and the hand's telemetry.
    pub fn read_grasp(&mut self) -> Result<(u32, GraspTelemetry), Failure> {
        let report = self.session.board.read_task().map_err(|error| match error {
            BoardError::Interrupted => not_awaited(),
            error => error.into(),
        })?;
        match report.telemetry {
            TaskTelemetry::Grasping(grasp) => Ok((report.tick, grasp)),
            _ => Err(Failure::Other("another program has enabled another task".to_owned())),
        }
    }

    /// Telemetry of impedance control.
    pub fn impedance(&mut self) -> Result<ImpedanceTelemetry, Failure> {
        self.session.board.read_impedance().map_err(|error| self.broken_off(error))
    }

    /// See [`BoardSession::round_trip`].
    pub fn round_trip(&mut self) -> Result<Duration, Failure> {
        self.session.round_trip()
    }

    /// The address of the board's port.
    pub fn port(&self) -> &str {
        &self.session.port
    }

    /// Keeps command of the board until it is to be enabled; after Ctrl-C it is not.
    pub fn wait_until(&mut self, mut ready: impl FnMut() -> Result<bool, Failure>) -> Result<(), Failure> {
        let interrupted = self.session.heed_interrupts()?;
        while !ready()? {
            if interrupted.load(Ordering::Relaxed) {
                return Err(nothing_enabled());
            }
            self.positions()?;
            std::thread::sleep(PERIOD);
        }
        Ok(())
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
                output::line(&report).map_err(|failure| match failure {
                    Failure::Pipe => Failure::Unread,
                    failure => failure,
                })?;
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
        gone(seconds, &self.model)
    }

    /// Disables the board. One that is silent gets some time, but not all that a patient user allows for an
    /// answer.
    fn switch_off(&mut self) -> Result<(), Failure> {
        let begun = Instant::now();
        self.session.ignore_interrupts();
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
                        "another program has taken command and disabled the board. End that program, then run this command again"
                            .to_owned(),
                    ));
                }
                // The refusal of a set-point can be here before the telemetry that shows the mode.
                Err(Failure::Board(BoardError::Refused {
                    refusal: Refusal::WrongMode(Mode::Disabled),
                    ..
                })) => {
                    self.enabled = false;
                    return Err(disabled_by_another());
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
                self.session.ignore_interrupts();
                Err(Failure::Fault(self.session.fault_after(self.faults, Some(&self.model))))
            }
            Mode::Disabled if *seen_enabled => {
                self.enabled = false;
                Err(disabled_by_another())
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
                Some(output::telemetry(telemetry, Some(&self.model), ALL_HOMED).to_string())
            }
            (Some(_), News { task: Some(report), .. }) => Some(output::task(report, &self.model).to_string()),
            _ => None,
        }
    }

    /// Disables the board and releases command.
    pub fn end(self, interrupted: bool) -> Result<(), Failure> {
        let options = self.options;
        let disabled = self.disable()?;
        let what = if interrupted { "\ninterrupted: " } else { "" };
        output::notice(options, &format!("{what}{disabled}"));
        Ok(())
    }

    /// The same where Ctrl-C came before the motion was complete, which is a failure.
    pub fn break_off(self) -> Result<(), Failure> {
        Err(Failure::Interrupted(self.disable()?))
    }

    /// Disables the board and releases command. Returns what becomes of the robot.
    fn disable(mut self) -> Result<String, Failure> {
        self.switch_off()?;
        let load = self.load().map_or_else(String::new, |load| format!("; {load}"));
        Ok(format!("disabled{load}"))
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

/// An answer was not waited for.
fn not_awaited() -> Failure {
    Failure::Interrupted("the board did not answer before".to_owned())
}

fn nothing_enabled() -> Failure {
    Failure::Interrupted("nothing was enabled".to_owned())
}

fn disabled_by_another() -> Failure {
    Failure::Other("another program disabled the board".to_owned())
}
