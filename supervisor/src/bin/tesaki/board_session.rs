//! A talk with a board.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use tesaki::fault::Fault;
use tesaki::model::RobotModel;
use tesaki::protocol::{
    FromBoard, Identity, Mode, NodeStatus, Refusal, Reply, ReplyFrame, Request, Stream, TaskReport,
    Telemetry, Tips,
};
use tesaki_supervisor::fault_injector::FaultyLink;
use tesaki_supervisor::port::Reopening;
use tesaki_supervisor::{Board, BoardError, LinkBoard};

use crate::args::Options;
use crate::failure::Failure;

/// The line to the board: opened again when it goes away, and damaged on purpose where that is asked for.
pub type Line = FaultyLink<Reopening>;

/// [`tesaki::protocol::LEASE`] as time.
const LEASE: Duration = Duration::from_millis(10 * tesaki::protocol::LEASE as u64);

/// A board that has said hello.
pub struct BoardSession {
    pub board: LinkBoard<Line>,
    pub identity: Identity,
    /// Where it is.
    pub place: String,
    /// The latest of the task, when it was asked for without waiting.
    pub task: Option<TaskReport>,
    /// Whether this program has the command.
    commands: bool,
}

/// Whoever comes next need not wait until the board notices that we are gone.
impl Drop for BoardSession {
    fn drop(&mut self) {
        if self.commands {
            self.board.set_timeout(Duration::from_millis(300));
            // An armed board refuses, rightly: its command timeout ends that.
            let _ = self.board.ask("release the command", Request::ReleaseCommand);
        }
    }
}

impl BoardSession {
    /// Opens the port and greets the board.
    pub fn open(options: &Options) -> Result<Self, Failure> {
        let mut board = dial(options)?;
        let identity = board.hello()?;
        let place = place(&board);
        Ok(Self { board, identity, place, task: None, commands: false })
    }

    /// The same, and takes command.
    pub fn command(options: &Options) -> Result<Self, Failure> {
        let mut session = Self::open(options)?;
        // A commander that is gone is noticed after the lease; one that is not keeps the command.
        let deadline = Instant::now() + LEASE + Duration::from_millis(200);
        loop {
            match session.board.take_command(options.take_over) {
                Err(BoardError::Refused { refusal: Refusal::Commanded { .. }, .. })
                    if Instant::now() < deadline =>
                {
                    std::thread::sleep(Duration::from_millis(50));
                }
                other => break other?,
            }
        }
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

    /// Sends a model, and waits a moment for the sensors to be read with it, so that the next command finds
    /// them.
    pub fn push(&mut self, model: &RobotModel) -> Result<NodeStatus, Failure> {
        self.board.push_model(model)?;
        let before = self.board.status()?.node.tick;
        let deadline = Instant::now() + Duration::from_millis(300);
        loop {
            let node = self.board.status()?.node;
            if node.tick != before || Instant::now() > deadline {
                return Ok(node);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// The last fault in words; with the joint's name where the model is known.
    pub fn fault(&mut self, model: Option<&RobotModel>) -> Result<String, Failure> {
        let log = self.board.faults()?;
        Ok(log.faults.last().map_or_else(|| "no fault is recorded".to_owned(), |fault| words(fault, model)))
    }

    /// Fails when the board is in fault.
    pub fn require_no_fault(&mut self, mode: Mode, model: Option<&RobotModel>) -> Result<(), Failure> {
        if mode == Mode::Fault { Err(Failure::Fault(self.fault(model)?)) } else { Ok(()) }
    }

    /// Asks a silent board for its streams again: it may have been reset or replaced, and know nothing of us.
    /// Says whether it answered.
    pub fn revive(&mut self, streams: &[(Stream, u16)]) -> Result<bool, Failure> {
        self.board.set_timeout(Duration::from_millis(200));
        let mut ask = || {
            self.board.hello()?;
            streams.iter().try_for_each(|&(stream, every)| self.board.set_rate(stream, every))
        };
        match ask() {
            Ok(()) => Ok(true),
            // It is asked again in a while.
            Err(BoardError::Timeout { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Waits for the next telemetry.
    pub fn telemetry(&mut self, within: Duration) -> Result<Telemetry, Failure> {
        let deadline = Instant::now() + within;
        while let Some(event) = self.board.next_event(deadline)? {
            match event {
                FromBoard::Telemetry(telemetry) => return Ok(telemetry),
                FromBoard::Reply(ReplyFrame { reply: Reply::Task(report), .. }) => self.task = Some(report),
                FromBoard::Reply(reply) => refused(&reply.reply)?,
                _ => {}
            }
        }
        Err(Failure::Late(format!(
            "no telemetry within {} s: the board has no sensor readings, or its control does not run (`tesaki doctor` \
             looks closer)",
            within.as_secs_f64()
        )))
    }

    /// The tips, now; leaves a rate at which others can go on reading them.
    pub fn tips(&mut self) -> Result<Tips, Failure> {
        self.board.set_rate(Stream::Tips, 10)?;
        let deadline = Instant::now() + Duration::from_secs(1);
        while let Some(event) = self.board.next_event(deadline)? {
            if let FromBoard::Tips(tips) = event {
                return Ok(tips);
            }
        }
        Err(Failure::Late(
            "the board told nothing of its tips within 1 s: no sensor readings? (`tesaki doctor` looks closer)".to_owned(),
        ))
    }

    /// One telemetry, now; leaves the rate as a monitor would want it.
    pub fn telemetry_now(&mut self) -> Result<Telemetry, Failure> {
        self.board.set_rate(Stream::Telemetry, 2)?;
        self.telemetry(Duration::from_secs(1))
    }
}

/// An error for a set-point that was refused; one that came late, or twice over a bad line, is none.
pub fn refused(reply: &Reply) -> Result<(), Failure> {
    match *reply {
        Reply::Refused(Refusal::Stale { .. } | Refusal::WrongMode(Mode::Fault)) => Ok(()),
        Reply::Refused(refusal) => Err(BoardError::Refused { action: "move", refusal }.into()),
        _ => Ok(()),
    }
}

/// Opens the port.
pub fn dial(options: &Options) -> Result<LinkBoard<Line>, Failure> {
    let faults = options.link_faults.clone().unwrap_or_default();
    let link = FaultyLink::new(Reopening::open(options.port.clone())?, faults);
    Ok(LinkBoard::new(link, options.timeout))
}

/// Where the board is.
pub fn place(board: &LinkBoard<Line>) -> String {
    let port = board.link().get_ref().port();
    port.map_or_else(String::new, |port| port.address().to_string())
}

/// A fault in words.
pub fn words(fault: &Fault, model: Option<&RobotModel>) -> String {
    model.map_or_else(|| fault.to_string(), |model| fault.named(model).to_string())
}

/// Set by Ctrl-C and by a polite end of the process.
pub fn interrupted() -> Result<Arc<AtomicBool>, Failure> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    if let Some(flag) = FLAG.get() {
        return Ok(Arc::clone(flag));
    }
    let flag = Arc::new(AtomicBool::new(false));
    let signal = Arc::clone(&flag);
    ctrlc::set_handler(move || signal.store(true, Ordering::Relaxed))
        .map_err(|error| Failure::Other(format!("Ctrl-C cannot be caught: {error}")))?;
    Ok(Arc::clone(FLAG.get_or_init(|| flag)))
}

/// Version numbers as people write them.
pub fn version([major, minor, patch]: [u8; 3]) -> String {
    format!("{major}.{minor}.{patch}")
}

/// Bytes as hexadecimal digits; `none` for those that are all zero.
pub fn hex(bytes: &[u8], none: &str) -> String {
    if bytes.iter().all(|&byte| byte == 0) {
        return none.to_owned();
    }
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
