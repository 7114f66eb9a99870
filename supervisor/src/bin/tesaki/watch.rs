//! `monitor`: the joints live.

use std::time::{Duration, Instant};

use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Request, Status, Stream, Telemetry};
use tesaki_description::plant::CONTROL_PERIOD;
use tesaki_supervisor::faults::{self, describe};
use tesaki_supervisor::monitor::{JointView, Key, LinkView, Overlay, Screen, State, View};
use tesaki_supervisor::timing::{SILENCE, STOP_PATIENCE};
use tesaki_supervisor::{Board, BoardError, troubleshooting, words};

use crate::args::Options;
use crate::board_session::{BoardSession, shows_stop, version};
use crate::failure::Failure;
use crate::output;

/// Ticks from one telemetry to the next.
const EVERY: u16 = 4;
/// Ticks from one status to the next.
const STATUS_EVERY: u16 = 100;
/// The streams that the view needs.
const STREAMS: &[(Stream, u16)] = &[(Stream::Telemetry, EVERY), (Stream::Status, STATUS_EVERY)];
/// How often it is looked whether the board still has the same model.
const MODEL: Duration = Duration::from_secs(1);
/// How long a request to disable is repeated at least.
const DISABLE_TIME: Duration = Duration::from_millis(300);

pub fn run(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let model = session.model()?;
    if options.json {
        return stream(options, &mut session, model);
    }
    let mut watch = Watch::new(&mut session, model)?;
    let mut screen =
        Screen::enter().map_err(|error| Failure::Other(format!("{error}; `--json` prints lines instead")))?;
    let (mut selected, mut overlay) = (None, None);
    loop {
        watch.listen(&mut session, Instant::now() + Duration::from_millis(40))?;
        watch.insist(&mut session)?;
        screen.draw(&watch.view, selected, overlay).map_err(Failure::file("terminal"))?;
        match screen.key(Duration::from_millis(1)).map_err(Failure::file("terminal"))? {
            None => {}
            Some(Key::Quit) if overlay.is_some() => overlay = None,
            Some(Key::Quit) => break,
            Some(Key::Stop) => watch.ask(&mut session, Request::Stop)?,
            Some(Key::Disable) => watch.ask(&mut session, Request::Disable)?,
            Some(Key::ReadFaults) => {
                watch.read_faults(&mut session)?;
                overlay = if overlay == Some(Overlay::Faults) { None } else { Some(Overlay::Faults) };
            }
            Some(Key::Help) => {
                overlay = if overlay == Some(Overlay::Help) { None } else { Some(Overlay::Help) }
            }
            Some(key) => selected = key.select(selected, watch.view.joints.len()),
        }
    }
    Ok(())
}

/// One JSON object per line, until the reader closes the output. What is wrong with the board is told on
/// standard error.
fn stream(options: &Options, session: &mut BoardSession, model: RobotModel) -> Result<(), Failure> {
    session.board.set_rate(Stream::Telemetry, EVERY)?;
    let mut model = Some((model, session.board.status()?.node.model_checksum));
    let mut last = None::<u32>;
    let (mut heard, mut silent) = (Instant::now(), false);
    let mut checked = None::<Instant>;
    loop {
        // Another program may have pushed another model.
        if !silent && checked.is_none_or(|checked| checked.elapsed() > MODEL) {
            checked = Some(Instant::now());
            if let Ok(status) = session.board.status() {
                session.board.update_model(&mut model, &status)?;
            }
        }
        match session.telemetry(Duration::from_secs(1)) {
            // Another program may need a higher rate.
            Ok(telemetry)
                if last
                    .is_some_and(|last| (1..EVERY.into()).contains(&telemetry.tick.wrapping_sub(last))) => {}
            Ok(telemetry) => {
                last = Some(telemetry.tick);
                heard = Instant::now();
                if std::mem::take(&mut silent) {
                    output::complain("the board is heard again");
                }
                if telemetry.joints.is_empty() {
                    if model.take().is_some() {
                        output::complain(&format!("the board was reset: {}", Failure::NoModel));
                    }
                } else if model.is_none() {
                    checked = None;
                }
                let model = model.as_ref().map(|(model, _)| model);
                // A joint may have lost its zero since the last line.
                let homed = session.board.status().map_or(0, |status| status.node.homed);
                output::line(&output::telemetry(&telemetry, model, homed).to_string())?;
            }
            Err(Failure::Late(_)) => {
                if heard.elapsed() >= options.timeout && !silent {
                    silent = true;
                    output::complain(words::silence(session.is_open()));
                }
                session.board.reconnect(&[(Stream::Telemetry, EVERY)])?;
            }
            Err(failure) => return Err(failure),
        }
    }
}

struct Watch {
    /// With its checksum. `None` when the board was reset, and no model was pushed since.
    model: Option<(RobotModel, u32)>,
    view: View,
    /// When the last telemetry came.
    heard: Instant,
    last_tick: Option<u32>,
    /// Telemetries in the current second.
    frames: u32,
    second: Instant,
    known_faults: Option<u32>,
    /// The entry of the document that explains the last fault.
    entry: String,
    /// A stop that telemetry does not show yet.
    stopping: Option<Stopping>,
}

/// A request to stop, which is repeated.
struct Stopping {
    request: Request,
    begun: Instant,
    /// The last tick before it.
    after: Option<u32>,
    /// Whether telemetry has shown that a [`Request::Stop`] has arrived.
    is_shown: bool,
}

impl Watch {
    fn new(session: &mut BoardSession, model: RobotModel) -> Result<Self, Failure> {
        STREAMS.iter().try_for_each(|&(stream, every)| session.board.set_rate(stream, every))?;
        let status = session.board.status()?;
        let title = title(session, Some(&model));
        let link = LinkView { open: true, expected_rate: 100.0 / f32::from(EVERY), ..LinkView::default() };
        let view = View { title, joints: joint_views(&model), link, ..View::default() };
        let now = Instant::now();
        let mut watch = Self {
            model: Some((model, status.node.model_checksum)),
            view,
            heard: now,
            last_tick: None,
            frames: 0,
            second: now,
            known_faults: None,
            entry: troubleshooting::DOCUMENT.to_owned(),
            stopping: None,
        };
        watch.status(&status);
        Ok(watch)
    }

    /// Receives until `deadline`.
    fn listen(&mut self, session: &mut BoardSession, deadline: Instant) -> Result<(), Failure> {
        while let Some(event) = session.board.next_event(deadline)? {
            match event {
                FromBoard::Telemetry(telemetry) => {
                    // The board was reset: what is shown of its joints is no longer true.
                    if telemetry.joints.is_empty() && self.model.take().is_some() {
                        self.show_model(session);
                    }
                    self.telemetry(&telemetry);
                }
                FromBoard::Status(status) => {
                    // Another program may have pushed another model; faults and joints have its names.
                    if session.board.update_model(&mut self.model, &status)? {
                        self.show_model(session);
                    }
                    self.status(&status);
                }
                _ => {}
            }
        }
        let now = Instant::now();
        let silence = now - self.heard;
        let link = &mut self.view.link;
        link.last_seconds = silence.as_secs_f32();
        link.open = session.is_open();
        let counts = session.board.counts();
        link.damaged = u64::from(counts.damaged());
        link.round_trip_ms = session.board.round_trip().map(|trip| trip.as_secs_f32() * 1e3);
        if now - self.second >= Duration::from_secs(1) {
            #[expect(clippy::cast_precision_loss, reason = "at most a hundred")]
            let frames = self.frames as f32;
            link.rate = Some(frames / (now - self.second).as_secs_f32());
            (self.frames, self.second) = (0, now);
        }
        if silence > SILENCE {
            self.view.state = State::Lost;
            words::silence(session.is_open()).clone_into(&mut self.view.hint);
            session.board.reconnect(STREAMS)?;
        }
        if self.known_faults.is_none() && silence < SILENCE {
            self.read_faults(session)?;
        }
        Ok(())
    }

    /// Sends a request to stop, which is always granted, until telemetry shows that it has arrived.
    fn ask(&mut self, session: &mut BoardSession, request: Request) -> Result<(), Failure> {
        // The mode of telemetry that is on its way may be that of before.
        while let Some(event) = session.board.next_event(Instant::now())? {
            if let FromBoard::Telemetry(telemetry) = event {
                self.telemetry(&telemetry);
            }
        }
        self.stopping =
            Some(Stopping { request, begun: Instant::now(), after: self.last_tick, is_shown: false });
        self.insist(session)
    }

    fn insist(&mut self, session: &mut BoardSession) -> Result<(), Failure> {
        let Some(Stopping { request, begun, is_shown, .. }) = &self.stopping else { return Ok(()) };
        let is_off = self.heard > *begun && !matches!(self.view.state, State::Enabled | State::Lost);
        // Telemetry does not show whether the outputs of a board in fault are off.
        let is_done =
            if *request == Request::Stop { *is_shown } else { is_off && begun.elapsed() > DISABLE_TIME };
        if is_done {
            self.stopping = None;
            return Ok(());
        }
        session.board.post(request.clone())?;
        if begun.elapsed() > STOP_PATIENCE {
            words::NOT_STOPPED.clone_into(&mut self.view.hint);
        }
        Ok(())
    }

    fn model(&self) -> Option<&RobotModel> {
        self.model.as_ref().map(|(model, _)| model)
    }

    fn show_model(&mut self, session: &BoardSession) {
        self.view.joints = self.model().map(joint_views).unwrap_or_default();
        self.view.title = title(session, self.model());
        self.known_faults = None;
    }

    fn telemetry(&mut self, telemetry: &Telemetry) {
        self.heard = Instant::now();
        self.frames += 1;
        let step = self.last_tick.map(|last| telemetry.tick.wrapping_sub(last));
        self.last_tick = Some(telemetry.tick);
        if let Some(stopping) = &mut self.stopping {
            // A board without a model cannot be enabled.
            stopping.is_shown |= self.model.is_none() || shows_stop(telemetry, stopping.after);
        }
        let every = u32::from(EVERY);
        if let Some(step) = step
            && step > every
            && step < 100 * every
        {
            self.view.link.lost += u64::from(step / every - 1);
        }
        self.view.time = f64::from(telemetry.tick) * CONTROL_PERIOD;
        self.view.mode = telemetry.mode.to_string();
        (self.view.state, self.view.hint) = match telemetry.mode {
            Mode::Disabled if self.model.is_none() => (State::Disabled, Failure::NoModel.to_string()),
            Mode::Disabled => (State::Disabled, String::new()),
            Mode::Enabled(_) => (State::Enabled, "space stops the robot".to_owned()),
            Mode::Fault => {
                (State::Fault, format!("see {}; `tesaki faults --clear` clears the fault", self.entry))
            }
        };
        for (view, joint) in self.view.joints.iter_mut().zip(&telemetry.joints) {
            view.remember(joint.position);
            (view.velocity, view.reference, view.torque) = (joint.velocity, joint.reference, joint.torque);
        }
        if self.known_faults.is_some_and(|known| known != telemetry.faults) {
            self.known_faults = None;
        }
    }

    fn status(&mut self, status: &Status) {
        self.view.supply = Some(status.node.supply);
        for (index, view) in self.view.joints.iter_mut().enumerate() {
            view.homed = status.node.homed >> index & 1 != 0;
        }
    }

    fn read_faults(&mut self, session: &mut BoardSession) -> Result<(), Failure> {
        match session.board.faults() {
            Ok(log) => {
                self.view.faults = log.faults.iter().map(|fault| describe(fault, self.model())).collect();
                self.known_faults = Some(log.total);
                self.entry = faults::entries(faults::blamed(&log));
                Ok(())
            }
            Err(BoardError::Refused { .. }) => Ok(()),
            Err(error) if error.passes() => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

fn title(session: &BoardSession, model: Option<&RobotModel>) -> String {
    let robot = model.map_or("no robot", |model| &model.name);
    format!("{robot} on {}, firmware {}", session.port, version(session.identity.firmware))
}

fn joint_views(model: &RobotModel) -> Vec<JointView> {
    let joints = model.joints.iter().map(|joint| JointView {
        name: joint.name.to_string(),
        lower: joint.limits.lower,
        upper: joint.limits.upper,
        torque_limit: joint.torque_limit(),
        ..JointView::default()
    });
    joints.collect()
}
