//! A connection to a board.

use std::path::Path;
use std::slice;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use tesaki::fault::FaultCause;
use tesaki::model::RobotModel;
use tesaki::protocol::{
    FromBoard, Identity, Mode, Refusal, Reply, ReplyFrame, Request, Stream, TaskReport, Telemetry, Tips,
};
use tesaki::task::TaskRefusal;
use tesaki::task::impedance::ImpedanceRefusal;
use tesaki_supervisor::fault_injector::FaultyLink;
use tesaki_supervisor::faults::{self, FaultsBefore};
use tesaki_supervisor::port::{Address, Key, Reopening};
use tesaki_supervisor::{Board, BoardError, LinkBoard, output_queue, words};

use crate::args::Options;
use crate::failure::Failure;
use crate::output;

/// The link to the board: reopened when it is lost, with injected faults if requested.
pub type BoardLink = FaultyLink<Reopening>;

/// How often a round trip is measured.
const ROUND_TRIPS: usize = 15;

/// A board that has answered the greeting.
pub struct BoardSession {
    pub board: LinkBoard<BoardLink>,
    pub identity: Identity,
    /// The address of its port.
    pub port: String,
    /// The latest telemetry of the task that was requested without waiting.
    pub task: Option<TaskReport>,
    /// Why the task refused a set-point last, which is for who leads the robot to judge.
    pub refused: Option<TaskRefusal>,
    /// Whether this program commands the board.
    commands: bool,
}

/// Releases command, so that the next client does not wait for the lease to expire.
impl Drop for BoardSession {
    fn drop(&mut self) {
        if self.commands {
            self.ignore_interrupts();
            self.board.set_timeout(Duration::from_millis(300));
            // An enabled board refuses this; its command timeout then disables it.
            let _ = self.board.ask("release command", Request::ReleaseCommand);
        }
    }
}

impl BoardSession {
    /// Opens the port and greets the board.
    pub fn open(options: &Options) -> Result<Self, Failure> {
        Self::open_at(options, &options.port)
    }

    /// The same at another port.
    pub fn open_at(options: &Options, port: &Address) -> Result<Self, Failure> {
        Self::greet(dial_at(options, port)?)
    }

    /// Greets the board.
    pub fn greet(mut board: LinkBoard<BoardLink>) -> Result<Self, Failure> {
        let identity = board.hello()?;
        let port = port_address(&board);
        Ok(Self { board, identity, port, task: None, refused: None, commands: false })
    }

    /// Opens the port, greets the board and takes command.
    pub fn command(options: &Options) -> Result<Self, Failure> {
        Self::command_at(options, &options.port)
    }

    /// The same at another port.
    pub fn command_at(options: &Options, port: &Address) -> Result<Self, Failure> {
        let mut session = Self::open_at(options, port)?;
        session.board.await_command(options.take_over).map_err(|error| match error {
            BoardError::Refused { refusal: Refusal::Commanded { .. }, .. } if options.take_over => {
                Failure::Refused(words::NOT_TAKEN_OVER.to_owned())
            }
            error => error.into(),
        })?;
        session.commands = true;
        Ok(session)
    }

    /// The model on the board.
    pub fn model(&mut self) -> Result<RobotModel, Failure> {
        self.board.model().map_err(|error| match error {
            BoardError::Refused { refusal: Refusal::NoModel, .. } => Failure::NoModel,
            error => error.into(),
        })
    }

    /// Description of the [faults to blame](faults::blamed), with the joint's name if the model is known, and
    /// the entries of the document that explain them.
    pub fn fault(&mut self, model: Option<&RobotModel>) -> String {
        match self.board.faults() {
            Ok(log) => faults::explain(faults::blamed(&log), model),
            Err(error) => unread(&error),
        }
    }

    /// As [`fault`](Self::fault), for the first fault after those of `before`: what follows may be a
    /// consequence.
    pub fn fault_after(&mut self, before: FaultsBefore, model: Option<&RobotModel>) -> String {
        let log = match self.board.faults() {
            Ok(log) => log,
            Err(error) => return unread(&error),
        };
        match before.later(&log) {
            [] => faults::explain(faults::blamed(&log), model),
            [cause] => faults::explain(slice::from_ref(cause), model),
            [cause, then @ ..] => format!(
                "{}\nThen {} (`tesaki faults`)",
                faults::explain(slice::from_ref(cause), model),
                output::counted(then.len(), "fault")
            ),
        }
    }

    /// Whether the last fault is that no command came in time. The faults count as read.
    pub fn has_timed_out(&mut self) -> Result<bool, Failure> {
        let log = self.board.faults()?;
        Ok(log.faults.last().is_some_and(|fault| fault.cause == FaultCause::CommandTimeout))
    }

    /// Fails when the board is in fault.
    pub fn require_no_fault(&mut self, mode: Mode, model: Option<&RobotModel>) -> Result<(), Failure> {
        if mode == Mode::Fault { Err(Failure::Fault(self.fault(model))) } else { Ok(()) }
    }

    /// Whether the port of the board is open.
    pub fn is_open(&self) -> bool {
        self.board.link().get_ref().is_open()
    }

    /// Waits for the next telemetry.
    pub fn telemetry(&mut self, within: Duration) -> Result<Telemetry, Failure> {
        let deadline = Instant::now() + within;
        while let Some(event) = self.board.next_event(deadline)? {
            match event {
                FromBoard::Telemetry(telemetry) => return Ok(telemetry),
                FromBoard::Reply(ReplyFrame { reply: Reply::Task(report), .. }) => self.task = Some(report),
                FromBoard::Reply(ReplyFrame {
                    reply:
                        Reply::Refused(Refusal::Task(
                            refusal @ (TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(_))
                            | TaskRefusal::VisualApproach(_)),
                        )),
                    ..
                }) => self.refused = Some(refusal),
                FromBoard::Reply(reply) => refused(&reply.reply)?,
                _ => {}
            }
        }
        Err(Failure::Late(format!(
            "no telemetry within {} s: the board has no sensor readings, or its control loop does not run (try \
             `tesaki doctor`)",
            within.as_secs_f64()
        )))
    }

    /// The time from a request to its answer, the median of some.
    pub fn round_trip(&mut self) -> Result<Duration, Failure> {
        let mut times = Vec::new();
        for _ in 0..ROUND_TRIPS {
            let begin = Instant::now();
            self.board.status()?;
            times.push(begin.elapsed());
        }
        times.sort_unstable();
        Ok(times[ROUND_TRIPS / 2])
    }

    /// Checks that the link is quick enough for an enabled board: its commands come in time.
    pub fn require_quick_link(&mut self, model: &RobotModel) -> Result<(), Failure> {
        let slow = |time| words::slow_link(time, &model.safety);
        // A single request may have been repeated.
        if self.board.round_trip().and_then(slow).is_none() {
            return Ok(());
        }
        slow(self.round_trip()?).map_or(Ok(()), |slow| {
            Err(Failure::Late(format!("nothing was enabled: {slow}: {}", words::SLOW_LINK)))
        })
    }

    /// The current tips.
    pub fn tips(&mut self) -> Result<Tips, Failure> {
        self.board.set_rate(Stream::Tips, 10)?;
        let deadline = Instant::now() + Duration::from_secs(1);
        while let Some(event) = self.board.next_event(deadline)? {
            if let FromBoard::Tips(tips) = event {
                return Ok(tips);
            }
        }
        Err(no_tips())
    }

    /// The joints and the tips in the same tick.
    pub fn joints_and_tips(&mut self) -> Result<(Telemetry, Tips), Failure> {
        let mut telemetry = self.telemetry_now()?;
        // As often as the joints, and hence in the same ticks.
        self.board.set_rate(Stream::Tips, 2)?;
        let deadline = Instant::now() + Duration::from_secs(1);
        let mut tips = None;
        while let Some(event) = self.board.next_event(deadline)? {
            match event {
                FromBoard::Telemetry(new) => telemetry = new,
                FromBoard::Tips(new) => tips = Some(new),
                _ => {}
            }
            if let Some(tips) = tips.take_if(|tips| tips.tick == telemetry.tick) {
                return Ok((telemetry, tips));
            }
        }
        Err(no_tips())
    }

    /// The tips whose force sensors are tared.
    pub fn tared(&mut self, model: &RobotModel) -> Result<Vec<String>, Failure> {
        if model.chains.iter().all(|chain| chain.force_sensor.is_none()) {
            return Ok(Vec::new());
        }
        let tips = match self.tips() {
            Ok(tips) => tips.tips,
            // A board without sensor readings has tared nothing.
            Err(Failure::Late(_)) => return Ok(Vec::new()),
            Err(failure) => return Err(failure),
        };
        let chains = model.chains.iter().zip(&tips);
        let tared = chains.filter(|(chain, tip)| chain.force_sensor.is_some() && tip.tared);
        Ok(tared.map(|(chain, _)| chain.name.to_string()).collect())
    }

    /// The current telemetry, which goes on.
    pub fn telemetry_now(&mut self) -> Result<Telemetry, Failure> {
        self.board.set_rate(Stream::Telemetry, 2)?;
        // What came before the answer may be old.
        while self.board.next_event(Instant::now())?.is_some() {}
        self.telemetry(Duration::from_secs(1))
    }

    /// Whether the outputs are on; `None` when the control loop does not run.
    pub fn outputs(&mut self) -> Result<Option<bool>, Failure> {
        Ok(self.board.outputs()?)
    }

    /// Whether the outputs are on in this mode; `None` when a board in fault does not tell.
    pub fn outputs_in(&mut self, mode: Mode) -> Option<bool> {
        match mode {
            Mode::Disabled => Some(false),
            Mode::Enabled(_) => Some(true),
            Mode::Fault => self.outputs().unwrap_or(None),
        }
    }

    /// From here on Ctrl-C ends waits for an answer, with [`BoardError::Interrupted`]. Returns its flag.
    pub fn heed_interrupts(&mut self) -> Result<Arc<AtomicBool>, Failure> {
        let flag = interrupted()?;
        self.board.interrupt_by(Arc::clone(&flag));
        Ok(flag)
    }

    /// What is asked from here on is waited for, also after Ctrl-C.
    pub fn ignore_interrupts(&mut self) {
        self.board.interrupt_by(Arc::default());
    }

    /// The board does not answer: it is not asked for anything more.
    pub const fn give_up(&mut self) {
        self.commands = false;
    }
}

fn no_tips() -> Failure {
    Failure::Late(
        "no telemetry of the tips within 1 s: does the board have sensor readings? (try `tesaki doctor`)"
            .to_owned(),
    )
}

/// In place of a fault that cannot be read: that there is one is known.
fn unread(error: &BoardError) -> String {
    format!("its cause is not known, because the faults cannot be read: {error}")
}

/// Telemetry that is older is that of a board before its reset [ticks].
const RECENT: i32 = 100;

/// Whether telemetry shows that the board has obeyed a stop, which was sent after it had told the tick
/// `after`. Disabled is not enough: a lost stop leaves a disabled board to be enabled by what is on its way.
pub fn shows_stop(telemetry: &Telemetry, after: Option<u32>) -> bool {
    let step = after.map_or(1, |after| telemetry.tick.wrapping_sub(after).cast_signed());
    // A board that was reset counts from 0.
    telemetry.mode == Mode::Fault && !(-RECENT..=0).contains(&step)
}

/// Refuses to move joints of which one is not homed.
pub fn require_homed(homed: u16, model: &RobotModel) -> Result<(), Failure> {
    match (0..).take(model.joints.len()).find(|joint| homed >> joint & 1 == 0) {
        Some(joint) => {
            Err(Failure::from(BoardError::refused("move", Refusal::NotHomed { joint })).named(model))
        }
        None => Ok(()),
    }
}

/// Says which joints, that were homed, are so no longer.
pub fn notice_unhomed(options: &Options, unhomed: &[String]) {
    if !unhomed.is_empty() {
        let joints = unhomed.join(", ");
        output::notice(options, &format!("{joints} must be homed again (`tesaki home JOINT=ANGLE …`)"));
    }
}

/// Says which force sensors, that were `tared`, are so no longer, because of what was done.
pub fn notice_untared(options: &Options, done: &str, tared: &[String]) {
    if !tared.is_empty() {
        let text = format!(
            "{done}, which forgets the tare: {} must be tared anew (`tesaki tare`, while nothing touches the tips)",
            tared.join(", ")
        );
        output::notice(options, &text);
    }
}

/// An error if a set-point was refused, unless it was only late, or duplicated by a bad line.
pub fn refused(reply: &Reply) -> Result<(), Failure> {
    match *reply {
        Reply::Refused(Refusal::Stale { .. } | Refusal::WrongMode(Mode::Fault)) => Ok(()),
        Reply::Refused(refusal) => Err(BoardError::refused("move", refusal).into()),
        _ => Ok(()),
    }
}

/// The key, if one of these addresses needs it.
pub fn key_for(options: &Options, addresses: &[&Address]) -> Result<Option<Key>, Failure> {
    let path = options.key.as_deref();
    Key::for_addresses(path, addresses).map_err(Failure::file(path.unwrap_or(Path::new(""))))
}

/// Opens the port.
pub fn dial(options: &Options) -> Result<LinkBoard<BoardLink>, Failure> {
    dial_at(options, &options.port)
}

fn dial_at(options: &Options, port: &Address) -> Result<LinkBoard<BoardLink>, Failure> {
    let faults = options.link_faults.clone().unwrap_or_default();
    let key = key_for(options, &[port])?;
    let link = FaultyLink::new(Reopening::open(port.clone(), key)?, faults);
    Ok(LinkBoard::new(link, options.timeout))
}

/// The address of the board's port.
pub fn port_address(board: &LinkBoard<BoardLink>) -> String {
    let port = board.link().get_ref().port();
    port.map_or_else(String::new, |port| port.address().to_string())
}

/// See [`interrupted`].
static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Set by Ctrl-C and by a request to terminate.
pub fn interrupted() -> Result<Arc<AtomicBool>, Failure> {
    if let Some(flag) = FLAG.get() {
        return Ok(Arc::clone(flag));
    }
    let flag = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&flag);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed))
        .map_err(|error| Failure::Other(format!("cannot handle Ctrl-C: {error}")))?;
    output_queue::interrupt_by(Arc::clone(&flag));
    Ok(Arc::clone(FLAG.get_or_init(|| flag)))
}

/// `major.minor.patch`.
pub fn version([major, minor, patch]: [u8; 3]) -> String {
    format!("{major}.{minor}.{patch}")
}

/// Bytes as hexadecimal digits; `none` if all are zero.
pub fn hex(bytes: &[u8], none: &str) -> String {
    if bytes.iter().all(|&byte| byte == 0) {
        return none.to_owned();
    }
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
