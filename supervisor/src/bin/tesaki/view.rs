//! `view`: the board on a page in a browser.

mod commands;
mod delay;
mod message;
mod pages;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Reply, Request, Status, Stream, Telemetry, Tips};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::faults::describe;
use tesaki_supervisor::gravity::Load;
use tesaki_supervisor::publication::own_model;
use tesaki_supervisor::task_report::{Report, report};
use tesaki_supervisor::timing::SILENCE;
use tesaki_supervisor::{Board, BoardError, troubleshooting, words};
use tesaki_viewer::server::{Server, Site};
use tesaki_viewer::{LIVE_PAGE, SCRIPT, STYLE, Scene};

use crate::args::{Options, View as Arguments};
use crate::board_session::{BoardSession, interrupted, version};
use crate::failure::Failure;
use crate::output;
use commands::Commander;
use delay::Delay;
use message::{Command, FaultText, Plan, State, Tip};
use pages::{PageEvent, Pages};

/// Ticks from one state to the next: 50 a second.
const EVERY: u16 = 2;
/// What the page shows.
const STREAMS: &[(Stream, u16)] =
    &[(Stream::Telemetry, EVERY), (Stream::Tips, EVERY), (Stream::Task, EVERY), (Stream::Status, 20)];
/// How long the board is listened to before what the pages say is looked at.
const TURN: Duration = Duration::from_millis(4);
/// Without pages.
const IDLE: Duration = Duration::from_millis(20);
/// From one status to the next at most.
const STATUS: Duration = Duration::from_millis(500);
/// A page that is so many states behind gets no more until it has answered to all that it got.
const MAX_UNSEEN: u64 = 25;
/// Commands of a page that wait; what comes beyond is refused.
const MAX_WAITING: usize = 32;
/// Faults that the page shows.
const MAX_FAULTS: usize = 4;

static SITE: Site = Site {
    files: &[
        ("/", "text/html; charset=utf-8", LIVE_PAGE),
        ("/viewer.js", "text/javascript; charset=utf-8", SCRIPT),
        ("/viewer.css", "text/css; charset=utf-8", STYLE),
    ],
    socket: "/live",
    protocols: &[],
    origins: &[],
    name: "the page",
    choose: ": another program listens there, perhaps another `tesaki view`; choose another with --listen",
};

pub fn run(options: &Options, arguments: &Arguments) -> Result<(), Failure> {
    let interrupted = interrupted()?;
    let folder = arguments.robot.as_deref().map(RobotFolder::load).transpose()?;
    let server = Server::listen(arguments.listen, &SITE).map_err(|error| match error.kind() {
        std::io::ErrorKind::InvalidInput => Failure::Usage(error.to_string()),
        _ => Failure::Other(error.to_string()),
    })?;
    let session = BoardSession::open(options)?;
    let mut view = View::new(session, Pages::serve(server), folder, options.take_over);
    let url = format!("http://{}", view.server.address());
    output::result(options, &serde_json::json!({ "url": url }), || format!("{url}\nCtrl-C ends the page"))?;
    let result = loop {
        if interrupted.load(Ordering::Relaxed) {
            break Ok(());
        }
        if let Err(failure) = view.turn() {
            break Err(failure);
        }
    };
    view.leave();
    result
}

/// A page.
struct Page {
    /// Number of the last state that it has got, and of the last one that it has answered to.
    sent: u64,
    seen: u64,
    /// When it answered last to a state that it had not answered to before.
    heard: Instant,
    /// What it has requested and has not got yet; nonsense with what is wrong with it.
    waiting: VecDeque<Result<Command, String>>,
}

impl Page {
    /// Whether it answers to a state for the first time.
    const fn takes(&mut self, number: u64) -> bool {
        let is_new = number > self.seen && number <= self.sent;
        if is_new {
            self.seen = number;
        }
        is_new
    }
}

struct View {
    session: BoardSession,
    server: Pages,
    folder: Option<RobotFolder>,
    pages: BTreeMap<u64, Page>,
    commander: Commander,
    /// The model on the board, its checksum, and its scene as JSON.
    model: Option<(RobotModel, u32)>,
    scene: String,
    plans: Vec<Plan>,
    firmware: String,
    supply: f32,
    homed: u16,
    /// Who commands the board by its own account.
    board_commander: Option<u32>,
    telemetry: Option<Telemetry>,
    tips: Option<Tips>,
    report: Option<Report>,
    /// Number of the last state, and its tick.
    sent: (u64, u32),
    /// When the last states were sent, by number.
    departures: BTreeMap<u64, Instant>,
    delay: Delay,
    /// When telemetry came last, and when a status was sent.
    heard: Instant,
    told: Instant,
    /// Whether it said that the board is in fault.
    told_fault: bool,
    known_faults: Option<u32>,
    faults: Vec<FaultText>,
    /// Whether the board has a model, by its last status.
    has_model: bool,
    /// Why there is no telemetry.
    silent: Option<&'static str>,
    /// Whether the streams are requested.
    streams: bool,
}

impl View {
    fn new(mut session: BoardSession, server: Pages, folder: Option<RobotFolder>, take_over: bool) -> Self {
        let now = Instant::now();
        let firmware = version(session.identity.firmware);
        session.board.interrupt_by(Arc::clone(server.stop()));
        Self {
            session,
            server,
            folder,
            pages: BTreeMap::new(),
            commander: Commander::new(take_over),
            model: None,
            scene: String::new(),
            plans: Vec::new(),
            firmware,
            supply: 0.0,
            homed: 0,
            board_commander: None,
            telemetry: None,
            tips: None,
            report: None,
            sent: (0, 0),
            departures: BTreeMap::new(),
            delay: Delay::default(),
            heard: now,
            told: now,
            told_fault: false,
            known_faults: None,
            faults: Vec::new(),
            has_model: true,
            silent: None,
            streams: false,
        }
    }

    /// Listens to the board for a while, then to the pages.
    fn turn(&mut self) -> Result<(), Failure> {
        // Whether the robot has stopped is of interest even after the last page has gone.
        self.request_streams(!self.pages.is_empty() || self.commander.is_stopping())?;
        let wait = if self.pages.is_empty() { IDLE } else { TURN };
        self.listen(Instant::now() + wait)?;
        self.hear()?;
        self.obey_each()?;
        self.drive(Instant::now())?;
        self.server.keep(self.commander.page());
        self.check_silence()?;
        if self.told.elapsed() > STATUS {
            self.tell_status();
        }
        Ok(())
    }

    /// Takes what the pages say. A stop is carried out before all that waits, and in place of it.
    fn hear(&mut self) -> Result<(), Failure> {
        while let Some(event) = self.server.next() {
            match event {
                PageEvent::Opened(id) => self.open(id),
                PageEvent::Closed(id) => {
                    self.pages.remove(&id);
                    self.delay.forget(id);
                    self.page_gone(id)?;
                }
                PageEvent::Said(id, _, Ok(Command::Stop)) => self.obey_stop(id)?,
                PageEvent::Said(id, at, said) => {
                    let Some(page) = self.pages.get_mut(&id) else { continue };
                    match said {
                        Ok(Command::Seen { n }) => self.seen(id, n, at),
                        said if page.waiting.len() < MAX_WAITING => page.waiting.push_back(said),
                        _ => {
                            self.answer(id, false, "too many commands at once: this one was not carried out")
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// A page has got the state with this number. Only one that it was sent and has not answered to before
    /// says that somebody looks.
    fn seen(&mut self, id: u64, number: u64, at: Instant) {
        let Some(page) = self.pages.get_mut(&id) else { return };
        if !page.takes(number) {
            return;
        }
        page.heard = at;
        if let Some(sent) = self.departures.get(&number) {
            self.delay.page(id, at.saturating_duration_since(*sent));
        }
    }

    /// Carries out a command of each page, so that none waits behind those of another.
    fn obey_each(&mut self) -> Result<(), Failure> {
        let ids: Vec<u64> = self.pages.keys().copied().collect();
        for id in ids {
            if let Some(said) = self.pages.get_mut(&id).and_then(|page| page.waiting.pop_front()) {
                self.obey(id, said);
                // While the board was waited for, a page may have said stop.
                self.hear()?;
            }
        }
        Ok(())
    }

    /// Asks for the streams while somebody looks.
    fn request_streams(&mut self, requested: bool) -> Result<(), Failure> {
        if requested != self.streams {
            for &(stream, every) in STREAMS {
                let every = if requested { every } else { 0 };
                self.session.board.post(Request::SetRate { stream, every })?;
            }
            self.streams = requested;
            self.heard = Instant::now();
        }
        Ok(())
    }

    /// Receives until `deadline`, or until a state is complete.
    fn listen(&mut self, deadline: Instant) -> Result<(), Failure> {
        while let Some(event) = self.session.board.next_event(deadline)? {
            self.take(event)?;
            let ticks =
                (self.telemetry.as_ref().map(|state| state.tick), self.tips.as_ref().map(|tips| tips.tick));
            if ticks.0 == ticks.1 && self.is_due() {
                break;
            }
        }
        if self.is_due() {
            self.send_state();
        }
        Ok(())
    }

    /// Takes all that the board has sent up to now.
    fn catch_up(&mut self) -> Result<(), Failure> {
        while let Some(event) = self.session.board.next_event(Instant::now())? {
            self.take(event)?;
        }
        Ok(())
    }

    fn take(&mut self, event: FromBoard) -> Result<(), Failure> {
        match event {
            FromBoard::Telemetry(telemetry) => {
                (self.heard, self.silent) = (Instant::now(), None);
                self.delay.telemetry(telemetry.tick, self.heard, self.session.board.round_trip());
                self.telemetry = Some(telemetry);
            }
            FromBoard::Tips(tips) => self.tips = Some(tips),
            FromBoard::Task(task) => {
                self.report = Some(report(&task.telemetry, self.commander.grasped.as_mut()));
            }
            FromBoard::Status(status) => self.take_status(&status)?,
            FromBoard::Reply(reply) => {
                if let Reply::Refused(refusal) = reply.reply {
                    self.refused(refusal);
                }
            }
            FromBoard::Log(_) => {}
        }
        Ok(())
    }

    /// Whether the telemetry is new. Other programs may ask for more than the page needs.
    fn is_due(&self) -> bool {
        let step = self.telemetry.as_ref().map(|telemetry| telemetry.tick.wrapping_sub(self.sent.1));
        step.is_some_and(|step| step >= u32::from(EVERY))
    }

    fn send_state(&mut self) {
        let Some(telemetry) = &self.telemetry else { return };
        self.sent = (self.sent.0 + 1, telemetry.tick);
        let task = match telemetry.mode {
            Mode::Enabled(task) => Some(task.to_string()),
            Mode::Disabled | Mode::Fault => None,
        };
        let tips = self.tips.iter().flat_map(|tips| &tips.tips);
        let mut state = State {
            kind: "state",
            n: self.sent.0,
            tick: telemetry.tick,
            mode: match telemetry.mode {
                Mode::Disabled => "disabled",
                Mode::Enabled(_) => "enabled",
                Mode::Fault => "fault",
            },
            // The stream goes on with the last task.
            report: self.report.clone().filter(|report| Some(&report.task) == task.as_ref()),
            task,
            joints: telemetry
                .joints
                .iter()
                .map(|j| [j.position, j.velocity, j.reference, j.torque])
                .collect(),
            tips: tips
                .map(|tip| Tip { position: tip.position, force: tip.force, tared: tip.tared })
                .collect(),
            delay: [0.0; 2],
        };
        self.departures.insert(self.sent.0, Instant::now());
        while self.departures.len() > 100 {
            self.departures.pop_first();
        }
        for (&id, page) in &mut self.pages {
            // The next state comes soon: a slow page gets what it can take.
            if page.seen >= page.sent || self.sent.0 - page.seen <= MAX_UNSEEN {
                page.sent = self.sent.0;
                state.delay = [self.delay.of_board(), self.delay.of_page(id)];
                self.server.send(id, serde_json::to_string(&state).unwrap_or_default());
            }
        }
        if self
            .known_faults
            .is_none_or(|known| Some(known) != self.telemetry.as_ref().map(|state| state.faults))
        {
            // An error comes again with the next telemetry.
            let _ = self.read_faults();
        } else if self.told_fault != self.is_fault() {
            self.tell_status();
        }
        self.commander.follow(self.telemetry.as_ref());
    }

    fn open(&mut self, id: u64) {
        let page = Page { sent: 0, seen: 0, heard: Instant::now(), waiting: VecDeque::new() };
        self.pages.insert(id, page);
        if self.model.is_some() {
            self.server.send(id, self.scene.clone());
        }
        self.tell_status();
    }

    fn take_status(&mut self, status: &Status) -> Result<(), Failure> {
        let node = &status.node;
        (self.supply, self.homed, self.board_commander) = (node.supply, node.homed, node.commander);
        self.has_model = !node.model.is_empty();
        if !self.has_model {
            self.commander.is_stopped();
        }
        if self.session.board.update_model(&mut self.model, status)? {
            self.show_scene();
            self.known_faults = None;
        }
        Ok(())
    }

    /// Gives the pages a robot. With the folder of this very robot they see its solids.
    fn show_scene(&mut self) {
        let model = self.model.as_ref().map(|(model, _)| model);
        let own = |folder: &&RobotFolder| model.is_some_and(|model| own_model(folder, &model.name).is_some());
        let folder = self.folder.as_ref().filter(own);
        if let (Some(model), Some(other), None) = (model, &self.folder, folder) {
            output::complain(&format!(
                "the board is {}, and --robot is the folder of {}: its solids, grasps and impedances are left out",
                model.name, other.model.name
            ));
        }
        let scene = model.map(|model| {
            let scene = Scene::new(model);
            folder.map_or(scene.clone(), |folder| scene.with_solids(&folder.urdf))
        });
        self.plans = folder.map(commands::plans).unwrap_or_default();
        let scene = serde_json::to_string(&scene).unwrap_or_default();
        self.scene = format!(r#"{{"kind":"scene","scene":{scene}}}"#);
        self.pages.keys().for_each(|&id| self.server.send(id, self.scene.clone()));
    }

    fn check_silence(&mut self) -> Result<(), Failure> {
        if self.streams && self.heard.elapsed() > SILENCE {
            self.silent = Some(words::silence(self.session.is_open()));
            self.tell_status();
            self.session.board.reconnect(STREAMS)?;
            // Not at once again.
            self.heard = Instant::now();
        }
        Ok(())
    }

    fn read_faults(&mut self) -> Result<(), BoardError> {
        let log = self.session.board.faults()?;
        self.known_faults = Some(log.total);
        let model = self.model.as_ref().map(|(model, _)| model);
        let text = |fault: &tesaki::fault::Fault| {
            let entry = troubleshooting::explanation(fault.cause);
            FaultText {
                text: describe(fault, model),
                title: entry.what,
                likely: entry.likely,
                remedy: entry.remedy,
            }
        };
        self.faults = log.faults.iter().rev().take(MAX_FAULTS).map(text).collect();
        self.tell_status();
        Ok(())
    }

    fn is_fault(&self) -> bool {
        self.telemetry.as_ref().is_some_and(|telemetry| telemetry.mode == Mode::Fault)
    }

    /// Sends each page its status, as it depends on who it is.
    fn tell_status(&mut self) {
        self.told = Instant::now();
        let is_fault = self.is_fault();
        self.told_fault = is_fault;
        let joints = self.model.as_ref().map_or(0, |(model, _)| model.joints.len());
        let own = self.session.board.client();
        let falls = self.model.as_ref().zip(self.telemetry.as_ref()).and_then(|((model, _), telemetry)| {
            Load::measured(model, telemetry).map(|load| load.to_string())
        });
        let trouble =
            if self.has_model { self.silent.map(str::to_owned) } else { Some(Failure::NoModel.to_string()) };
        for &id in self.pages.keys() {
            let commander = match (self.commander.page(), self.board_commander) {
                (Some(other), _) if other == id => "you",
                (Some(_), _) => "page",
                (None, Some(client)) if client != own => "program",
                (None, _) => "nobody",
            };
            let status = message::Status {
                kind: "status",
                port: &self.session.port,
                firmware: &self.firmware,
                supply: self.supply,
                homed: (0..joints).map(|joint| self.homed >> joint & 1 != 0).collect(),
                commander,
                falls: falls.clone(),
                plans: &self.plans,
                faults: if is_fault { &self.faults } else { &[] },
                total: self.known_faults.filter(|_| is_fault),
                trouble: trouble.as_deref(),
            };
            // Also what is as before: a page that hears nothing takes this program for gone.
            self.server.send(id, serde_json::to_string(&status).unwrap_or_default());
        }
    }

    /// Tells a page whether its command was carried out.
    fn answer(&self, id: u64, ok: bool, text: &str) {
        let answer = serde_json::json!({ "kind": "answer", "ok": ok, "text": text });
        self.server.send(id, answer.to_string());
    }
}
