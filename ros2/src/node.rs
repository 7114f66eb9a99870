//! The node: publishes what the board sends, and passes requests of clients to the board.

use std::slice;
use std::time::{Duration, Instant};

use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, Request, SCHEMA_KEY, Status, Telemetry};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskKind};
use tesaki_recording::{Live, LogLevel, Publisher, Topic};
use tesaki_supervisor::faults::{self, FaultFollower, FaultsBefore};
use tesaki_supervisor::publication::{Publication, STREAMS, require_own};
use tesaki_supervisor::timing::{BLIND, FRESH, KEEP_ALIVE, LAST_WORD, LATE, SILENCE};
use tesaki_supervisor::{Board as _, BoardError, words};

use crate::action::ActionServer;
use crate::args::Options;
use crate::controller::Controller;
use crate::dds::{Dds, Writer, dds_type, qos};
use crate::messages::{Uuid, nanoseconds_since_1970};
use crate::requests::Services;
use crate::session::{Failure, Session, describe, robot_folder, say, untold};

/// How long the board is listened to before clients are served.
const TURN: Duration = Duration::from_millis(2);
/// Number of posted requests whose refusals are awaited: those of more than half a second.
const POSTED: usize = 64;
/// Period in which DDS is checked.
const CHECK: Duration = Duration::from_millis(100);
/// Maximum time at the end for joints to brake, and for answers to clients.
const FAREWELL: Duration = Duration::from_secs(1);
/// Time at the end in which clients may still ask for results, and lost messages may be repeated.
const LINGER: Duration = Duration::from_millis(400);
/// Minimum number of messages of a topic that are kept for slow readers: a second of telemetry.
const MIN_DEPTH: u32 = 100;
/// More missing ticks than this mean that the board was reset.
const MAX_MISSING: u32 = 10_000;
/// Length of the encapsulation header [bytes], which a DDS payload does not include.
const ENCAPSULATION: usize = 4;
/// The topic whose messages are counted.
const JOINT_STATES: &str = "/joint_states";
/// Topics outside of the namespace, as is usual in ROS 2.
const GLOBAL: &[&str] = &["/tf", "/tf_static", "/diagnostics", "/rosout"];

/// A board that this node has enabled.
pub struct Enabled {
    pub controller: Controller,
    /// When the board confirmed it.
    pub since: Instant,
    /// Whether the telemetry has shown it.
    pub seen: bool,
    /// Its faults before it was enabled.
    pub faults: FaultsBefore,
    /// Whether this node has asked to disable it, without an answer.
    pub asked_to_disable: bool,
    /// Numbers of the last requests that were posted to it.
    pub posted: heapless::Deque<u16, POSTED>,
    /// When a refused point was last told.
    pub complained: Option<Instant>,
    /// The goal that is carried out, or cancelled.
    pub goal: Option<Uuid>,
    /// When feedback on the goal was last sent.
    pub told: Instant,
    /// When the board was last kept enabled.
    pub kept: Instant,
}

impl Enabled {
    /// Creates a board that was enabled now, with `faults` before.
    pub fn new(controller: Controller, faults: FaultsBefore) -> Self {
        let now = Instant::now();
        Self {
            controller,
            since: now,
            seen: false,
            faults,
            asked_to_disable: false,
            posted: heapless::Deque::new(),
            complained: None,
            goal: None,
            told: now,
            kept: now,
        }
    }

    /// Posts a request that keeps the board enabled.
    fn post(&mut self, session: &mut Session, request: Request) -> Result<(), BoardError> {
        self.kept = Instant::now();
        let number = session.board.post(request)?;
        if self.posted.is_full() {
            self.posted.pop_front();
        }
        let _ = self.posted.push_back(number);
        Ok(())
    }

    /// Returns whether telemetry with this mode and number of faults shows that the board is no longer
    /// enabled, or was enabled by another client.
    fn is_over(&mut self, mode: Mode, faults: u32) -> bool {
        self.seen |= mode == Mode::Enabled(TaskKind::JointServo);
        // Telemetry from before the board was enabled may still arrive.
        let is_current = self.seen || self.since.elapsed() > LATE;
        match mode {
            Mode::Enabled(TaskKind::JointServo) => false,
            Mode::Fault => is_current || faults != self.faults.total,
            Mode::Disabled | Mode::Enabled(_) => is_current,
        }
    }
}

/// Counts of what was published.
#[derive(Default)]
struct Tally {
    joint_states: u64,
    /// Control periods without telemetry.
    missing: u64,
    /// Messages that DDS did not accept.
    unsent: u64,
}

/// The node.
pub struct Node<'a> {
    pub options: &'a Options,
    pub session: Session,
    dds: Dds,
    /// When DDS was last checked.
    checked: Instant,
    publication: Publication<Live>,
    /// For each topic of the publication, if it is published.
    writers: Vec<Option<Writer>>,
    pub services: Services,
    pub action: ActionServer,
    /// The model on the board, with its checksum.
    pub model: Option<(RobotModel, u32)>,
    pub telemetry: Option<Telemetry>,
    /// When telemetry last came, and when it was last requested.
    pub heard: Instant,
    asked: Instant,
    is_lost: bool,
    pub enabled: Option<Enabled>,
    faults: Option<FaultFollower>,
    tally: Tally,
}

impl<'a> Node<'a> {
    /// Connects to the board and joins DDS.
    pub fn start(options: &'a Options) -> Result<Self, Failure> {
        if let Some(address) = options.network {
            std::net::UdpSocket::bind((address, 0)).map_err(|error| {
                Failure::Usage(format!("--network {address} is not an address of this machine: {error}"))
            })?;
        }
        let robot = robot_folder(options)?;
        let mut session = Session::open(options)?;
        match session.board.model() {
            Ok(model) => require_own(robot.as_ref().map(|(folder, _)| folder), &model)?,
            Err(BoardError::Refused { refusal: Refusal::NoModel, .. }) => {
                say("the board has no model yet: push one with `tesaki model push ROBOT_FOLDER`");
            }
            Err(error) => return Err(error.into()),
        }
        let dds = Dds::open(options.domain, options.network)?;
        let services = Services::offer(&dds, options)?;
        let action_name = options.full_name(&format!("{}/follow_joint_trajectory", options.controller));
        let action = ActionServer::offer(&dds, &action_name)?;
        let (folder, urdf) = robot.unzip();
        if urdf.is_none() {
            say("without --robot there is no /robot_description, and links have the names of the model");
        }
        let publisher = Publisher::new(Live::default(), urdf.as_deref());
        let now = Instant::now();
        let mut node = Self {
            options,
            session,
            dds,
            checked: now,
            publication: Publication::new(publisher, folder),
            writers: Vec::new(),
            services,
            action,
            model: None,
            telemetry: None,
            heard: now,
            asked: now,
            is_lost: false,
            enabled: None,
            faults: None,
            tally: Tally::default(),
        };
        node.request_streams(true)?;
        // A client that connects at once already finds the model and the joint angles.
        let status = node.session.board.status()?;
        node.read_model(&status)?;
        while node.telemetry.is_none() && now.elapsed() < SILENCE {
            node.listen()?;
        }
        node.announce(&action_name)?;
        Ok(node)
    }

    fn announce(&mut self, action: &str) -> Result<(), Failure> {
        let reach = match self.options.network {
            None => "on this machine's loopback interface only: every program of this machine may command it"
                .to_owned(),
            Some(address) => format!(
                "open to the networks of this machine, announced at {address}: EVERYBODY who reaches this \
                 machine may command it, unencrypted"
            ),
        };
        let text =
            format!("{} as a ROS 2 node, DDS domain {}, {reach}", self.session.port, self.options.domain);
        self.note(LogLevel::Info, &text)?;
        let enable = self.options.full_name("tesaki/enable");
        say(&format!("services {enable}, …/disable, …/tare, …/clear_faults; action {action}; Ctrl-C ends"));
        Ok(())
    }

    /// Prints a line, and publishes it on `/rosout`.
    pub fn note(&mut self, level: LogLevel, text: &str) -> Result<(), Failure> {
        say(text);
        Ok(self.publication.publisher.log(nanoseconds_since_1970(), level, "tesaki", text)?)
    }

    /// Listens to the board for a while, then serves clients.
    pub fn turn(&mut self) -> Result<(), Failure> {
        self.listen()?;
        self.check_dds()?;
        self.serve()?;
        self.send()
    }

    /// Checks from time to time that requests of clients can arrive.
    pub fn check_dds(&mut self) -> Result<(), Failure> {
        if self.checked.elapsed() < CHECK {
            return Ok(());
        }
        self.checked = Instant::now();
        Ok(self.dds.check()?)
    }

    /// Receives from the board for a while.
    pub fn listen(&mut self) -> Result<(), Failure> {
        let deadline = Instant::now() + TURN;
        while let Some(event) = self.session.board.next_event(deadline)? {
            self.take(event)?;
            if Instant::now() >= deadline {
                break;
            }
        }
        self.check_silence()
    }

    fn take(&mut self, event: FromBoard) -> Result<(), Failure> {
        match event {
            FromBoard::Telemetry(telemetry) => self.take_telemetry(telemetry)?,
            FromBoard::Tips(tips) => self.publication.tips(&tips)?,
            FromBoard::Task(task) => self.publication.task(&task)?,
            FromBoard::Status(status) => {
                self.read_model(&status)?;
                self.publication.status(&status)?;
            }
            FromBoard::Reply(reply) => {
                if let Reply::Refused(refusal) = reply.reply {
                    self.take_refusal(reply.sequence, refusal)?;
                }
            }
            FromBoard::Log(_) => {}
        }
        Ok(())
    }

    fn take_telemetry(&mut self, telemetry: Telemetry) -> Result<(), Failure> {
        self.heard = Instant::now();
        if std::mem::take(&mut self.is_lost) {
            self.note(LogLevel::Info, "the board is back")?;
        }
        let step = self.telemetry.as_ref().map_or(1, |last| telemetry.tick.wrapping_sub(last.tick));
        if (2..MAX_MISSING).contains(&step) {
            self.tally.missing += u64::from(step) - 1;
        }
        self.publication.telemetry(&telemetry)?;
        let tick = telemetry.tick;
        let faults = self.faults.get_or_insert_with(|| FaultFollower::new((&telemetry).into()));
        let texts = if faults.is_due(&telemetry) { self.new_faults(&telemetry) } else { Vec::new() };
        self.telemetry = Some(telemetry);
        for text in texts {
            self.publication.fault(tick, &text)?;
            if self.enabled.is_none() {
                say(&text);
            }
        }
        self.follow_mode()?;
        self.step_controller()
    }

    /// Returns each new fault in words.
    fn new_faults(&mut self, telemetry: &Telemetry) -> Vec<String> {
        let model = self.model.as_ref().map(|(model, _)| model);
        match (self.session.board.faults(), &mut self.faults) {
            (Ok(log), Some(faults)) => {
                let new = faults.take(telemetry, &log).iter();
                new.map(|fault| describe(slice::from_ref(fault), model)).collect()
            }
            (Ok(_), None) => Vec::new(),
            (Err(error), faults) => {
                // Report the error only once.
                *faults = Some(FaultFollower::new(telemetry.into()));
                vec![untold(&error)]
            }
        }
    }

    /// Returns the faults that stopped the board, in words: the first one after `before`, if that is known.
    pub fn fault_text(&mut self, before: Option<FaultsBefore>) -> String {
        let model = self.model.as_ref().map(|(model, _)| model);
        match self.session.board.faults() {
            Ok(log) => {
                describe(before.map_or_else(|| faults::blamed(&log), |before| before.cause(&log)), model)
            }
            Err(error) => untold(&error),
        }
    }

    /// Detects that the board is no longer enabled, or was enabled by another client.
    fn follow_mode(&mut self) -> Result<(), Failure> {
        let (Some(enabled), Some(telemetry)) = (&mut self.enabled, &self.telemetry) else { return Ok(()) };
        if !enabled.is_over(telemetry.mode, telemetry.faults) {
            return Ok(());
        }
        let before = enabled.faults;
        let why = match telemetry.mode {
            Mode::Fault => format!("the board is in fault: {}", self.fault_text(Some(before))),
            Mode::Disabled if enabled.asked_to_disable => "the board was disabled".to_owned(),
            Mode::Disabled => "the board was disabled by another program, or reset".to_owned(),
            Mode::Enabled(task) => format!("another program enabled {task}"),
        };
        self.forget_enabled(&why)
    }

    /// Sends the points of the next period.
    fn step_controller(&mut self) -> Result<(), Failure> {
        let (Some(enabled), Some(telemetry)) = (&mut self.enabled, &self.telemetry) else { return Ok(()) };
        let outcome = enabled.controller.step(telemetry.tick, nanoseconds_since_1970(), &telemetry.joints);
        let points = heapless::Vec::from_slice(enabled.controller.references()).unwrap_or_default();
        let command = TaskCommand::JointServo(JointCommand::Stream { points });
        enabled.post(&mut self.session, Request::Task(command))?;
        match outcome {
            Some(outcome) => self.end_goal(&outcome),
            None => Ok(()),
        }
    }

    /// Handles the refusal of the request `number`, if it was posted.
    fn take_refusal(&mut self, number: u16, refusal: Refusal) -> Result<(), Failure> {
        // Refusals of other requests are late: nobody waits for them any more.
        if !self.enabled.as_ref().is_some_and(|enabled| enabled.posted.iter().any(|posted| *posted == number))
        {
            return Ok(());
        }
        match refusal {
            // The telemetry will show the reason.
            Refusal::Stale { .. } | Refusal::WrongMode(_) => Ok(()),
            Refusal::SchemaMismatch { board: SCHEMA_KEY, .. } => Ok(()),
            Refusal::NotCommander | Refusal::Commanded { .. } => {
                self.session.lose_command();
                self.forget_enabled("this node has lost command of the board: another program has it")
            }
            refusal => self.hold_after(&refusal),
        }
    }

    fn check_silence(&mut self) -> Result<(), Failure> {
        let silence = self.heard.elapsed();
        if let Some(enabled) = &mut self.enabled {
            if silence > BLIND {
                let text = "no telemetry from the board: nothing is commanded any more, and its own command \
                            timeout stops it, which may leave its outputs on to hold the robot";
                self.session.lose_command();
                return self.forget_enabled(text);
            }
            // The telemetry may only be late.
            if silence > KEEP_ALIVE && enabled.kept.elapsed() > KEEP_ALIVE {
                enabled.post(&mut self.session, Request::Keep)?;
            }
        }
        if silence > SILENCE && self.asked.elapsed() > SILENCE {
            if !std::mem::replace(&mut self.is_lost, true) {
                self.note(LogLevel::Error, words::silence(self.session.board.link().is_open()))?;
            }
            self.session.board.reconnect(STREAMS)?;
            self.asked = Instant::now();
        }
        Ok(())
    }

    fn request_streams(&mut self, requested: bool) -> Result<(), BoardError> {
        STREAMS.iter().try_for_each(|&(stream, every)| {
            self.session.board.set_rate(stream, if requested { every } else { 0 })
        })
    }

    /// Reads the model on the board if it has changed.
    fn read_model(&mut self, status: &Status) -> Result<(), Failure> {
        self.session.board.update_model(&mut self.model, status)?;
        if let Some((model, _)) = &self.model {
            self.publication.require_own(model)?;
        }
        self.publication.use_model(self.model.as_ref().map(|(model, checksum)| (model, *checksum)));
        Ok(())
    }

    /// Publishes the messages that have accumulated.
    pub fn send(&mut self) -> Result<(), Failure> {
        let live = self.publication.publisher.sink_mut();
        let messages = live.take();
        if self.dds.check().is_err() {
            // The next turn ends the node. The library might wait for ever in a call.
            return Ok(());
        }
        let new: Vec<Topic> = live.topics().iter().skip(self.writers.len()).cloned().collect();
        for topic in new {
            let writer = self.writer(&topic)?;
            self.writers.push(writer);
        }
        let live = self.publication.publisher.sink();
        for message in messages {
            let topic = live.topics().get(usize::from(message.topic));
            self.tally.joint_states += u64::from(topic.is_some_and(|topic| topic.name == JOINT_STATES));
            let writer = self.writers.get(usize::from(message.topic)).and_then(Option::as_ref);
            let body = message.data.get(ENCAPSULATION..).unwrap_or_default().to_vec();
            if writer.is_some_and(|writer| writer.write(body, None).is_err()) {
                self.tally.unsent += 1;
            }
        }
        Ok(())
    }

    /// Returns the writer of a topic, if it is to be published.
    fn writer(&self, topic: &Topic) -> Result<Option<Writer>, Failure> {
        if self.options.no_tf && topic.name.starts_with("/tf") {
            return Ok(None);
        }
        let is_global = GLOBAL.contains(&topic.name.as_str());
        let name = if is_global { topic.name.clone() } else { self.options.full_name(&topic.name) };
        let depth = if topic.transient_local { topic.depth } else { topic.depth.max(MIN_DEPTH) };
        let qos = qos(i32::try_from(depth).unwrap_or(i32::MAX), topic.transient_local);
        Ok(Some(self.dds.writer(&format!("rt{name}"), &dds_type(topic.schema), &qos)?))
    }

    /// Ends the board's motion for this node, informs clients, and prints a summary.
    ///
    /// # Errors
    /// The first failure; the steps after it are taken all the same.
    pub fn end(mut self, why: &str) -> Result<(), Failure> {
        let result = self.say_farewell(why);
        let Tally { joint_states, missing, unsent } = self.tally;
        say(&format!(
            "published {joint_states} joint states; {missing} control periods were missing in what the board \
             sent, {unsent} messages were not taken by DDS"
        ));
        result
    }

    fn say_farewell(&mut self, why: &str) -> Result<(), Failure> {
        let braked = self.brake();
        self.session.set_patience(Some(LAST_WORD));
        let disabled = self.switch_off(why);
        self.session.release_command();
        let _ = self.request_streams(false);
        let sent = self.send();
        let begun = Instant::now();
        while begun.elapsed() < LINGER
            || (begun.elapsed() < FAREWELL && !(self.action.is_idle() && self.services.are_idle()))
        {
            self.refuse_goals();
            std::thread::sleep(TURN);
        }
        braked.and(disabled).and(sent)
    }

    /// Brings the joints to rest, as long as the board tells where they are.
    fn brake(&mut self) -> Result<(), Failure> {
        let deadline = Instant::now() + FAREWELL;
        if let Some(enabled) = &mut self.enabled {
            enabled.controller.brake();
        }
        while self.enabled.as_ref().is_some_and(|enabled| !enabled.controller.is_at_rest())
            && self.heard.elapsed() < FRESH
            && Instant::now() < deadline
        {
            self.listen()?;
            self.send()?;
        }
        Ok(())
    }

    /// Disables the board if this node has enabled it, and ends the goal. A board in fault stays as it is.
    fn switch_off(&mut self, why: &str) -> Result<(), Failure> {
        if self.enabled.is_some() {
            return match self.disable(why) {
                Ok(text) => self.note(LogLevel::Warn, &format!("{why}: {text}")),
                Err(error) => {
                    self.forget_enabled(&format!("{why}. {}", words::still_on(&error)))?;
                    Err(error.into())
                }
            };
        }
        let mode = self.telemetry.as_ref().map(|telemetry| telemetry.mode);
        if mode == Some(Mode::Fault) && self.heard.elapsed() < BLIND {
            let mode = words::mode(Mode::Fault, self.session.board.outputs().unwrap_or(None));
            self.note(LogLevel::Warn, &format!("{why}. The board is {mode}; `tesaki disable` disables it"))?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::trajectory::tests::hand;

    /// Returns a board that was enabled `ago`.
    fn enabled(ago: Duration) -> Enabled {
        let mut enabled =
            Enabled::new(Controller::hold(hand(), &[0.0; 9]), FaultsBefore { total: 3, tick: 0 });
        enabled.since = enabled.since.checked_sub(ago).unwrap();
        enabled
    }

    #[test]
    fn a_board_that_is_disabled_right_after_it_was_enabled_is_not_taken_for_enabled() {
        let servo = Mode::Enabled(TaskKind::JointServo);
        // Telemetry from before.
        let mut new = enabled(Duration::ZERO);
        assert!(!new.is_over(Mode::Disabled, 3) && !new.is_over(Mode::Fault, 3));
        assert!(new.is_over(Mode::Fault, 4));
        // The telemetry has shown it as enabled.
        assert!(!new.is_over(servo, 3) && new.is_over(Mode::Disabled, 3));
        // The telemetry has never shown it as enabled.
        assert!(enabled(2 * LATE).is_over(Mode::Disabled, 3));
        assert!(enabled(2 * LATE).is_over(Mode::Enabled(TaskKind::Impedance), 3));
        assert!(!enabled(2 * LATE).is_over(servo, 3));
    }
}
