//! The rig: the board under test, its surroundings, and the oracle that watches both.

use std::collections::BTreeMap;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

use tesaki::model::RobotModel;
use tesaki::protocol::codec::Decoder;
use tesaki::protocol::{ActuatorFrame, FromBoard, Mode, Reply, Request, RequestFrame, SensorFrame};
use tesaki::robot::Robot;
use tesaki_rng::Rng;
use tesaki_supervisor::BoardError;

use super::link::{Link, frame};
use super::oracle::Oracle;
use super::rules::{Rule, Violation};
use super::sample::{Acting, Sample};
use super::schedule::{Family, Fault, Kind, Schedule};
use super::sensors::PlantLink;
use super::strangers;
use crate::digest::FramesDigest;
use crate::plant::CONTROL_PERIOD;
use crate::plant::{Plant, Push};
use crate::virtual_board::VirtualBoard;

/// The scenario's client, the second commander, and the first client that must not command.
const CLIENT: u32 = 1;
const SECOND: u32 = 2;
const STRANGER: u32 = 3;
/// Streams of random numbers.
const LINK: u64 = 101;
const PLANT: u64 = 102;
const STRANGERS: u64 = 103;
/// Without a frame the drives keep their last torque for this time, then switch off [ticks].
const DRIVE_PATIENCE: u32 = 2;

/// Board, link, plant link and oracle of one run.
pub struct Rig {
    pub(super) schedule: Schedule,
    pub(super) model: RobotModel,
    pub(super) board: VirtualBoard,
    pub(super) decoder: Decoder,
    pub(super) link: Link,
    pub(super) plant_link: PlantLink,
    pub(super) strangers: Rng,
    /// Number of trials begun, and tick of the present one.
    pub(super) trials: u32,
    pub(super) tick: u32,
    /// Last sequence number of each client.
    pub(super) sequences: BTreeMap<u32, u16>,
    /// Requests without a reply.
    pub(super) sent: BTreeMap<(u32, u16), Request>,
    /// Replies received.
    pub(super) replies: Vec<(u32, u16, Reply)>,
    /// The last task report.
    pub(super) report: Option<Reply>,
    /// Last answer of the board, number of ticks since without one, and what the drives apply.
    pub(super) answer: ActuatorFrame,
    pub(super) missed: u32,
    pub(super) driven: ActuatorFrame,
    pub(super) counts: [Vec<i32>; 2],
    pub(super) oracle: Option<Oracle>,
    pub(super) digest: FramesDigest,
    /// Whether a fault has begun.
    pub(super) disturbed: bool,
    /// Whether the environment was disturbed.
    pub(super) touched: bool,
    pub(super) is_over: bool,
    pub(super) panicked: bool,
    /// Why a fault could not act on the plant.
    pub(super) refused: Option<String>,
    /// One line per tick, if requested.
    pub trace: Option<Vec<String>>,
}

impl Rig {
    pub(super) fn new(schedule: &Schedule, model: &RobotModel) -> Self {
        let rng = |stream| Rng::new(schedule.seed, stream);
        Self {
            schedule: schedule.clone(),
            model: model.clone(),
            board: VirtualBoard::default(),
            decoder: Decoder::new(),
            link: Link::new(rng(LINK)),
            plant_link: PlantLink::new(rng(PLANT), &schedule.faults),
            strangers: rng(STRANGERS),
            trials: 0,
            tick: 0,
            sequences: BTreeMap::new(),
            sent: BTreeMap::new(),
            replies: Vec::new(),
            report: None,
            answer: ActuatorFrame::default(),
            missed: 0,
            driven: ActuatorFrame::default(),
            counts: [Vec::new(), Vec::new()],
            oracle: None,
            digest: FramesDigest::default(),
            disturbed: false,
            touched: false,
            is_over: false,
            panicked: false,
            refused: None,
            trace: None,
        }
    }

    /// Whether the run has ended.
    pub const fn is_over(&self) -> bool {
        self.is_over
    }

    /// Ticks of the trial so far.
    pub const fn ticks(&self) -> u32 {
        self.tick
    }

    /// The violations so far.
    pub fn violations(&self) -> Vec<Violation> {
        self.oracle.as_ref().map_or_else(Vec::new, |oracle| oracle.violations().to_vec())
    }

    /// Why the run says nothing about the faults of the schedule, if it does not.
    pub fn unjudged(&self) -> Option<String> {
        let Schedule { trial, faults, .. } = &self.schedule;
        if let Some(refused) = &self.refused {
            return Some(refused.clone());
        }
        if self.oracle.is_none() {
            return Some(format!("there is no trial {trial} in which faults can act, from 0 on"));
        }
        (!faults.is_empty() && !self.disturbed)
            .then(|| format!("the trial ended in tick {}, before the first fault", self.tick))
    }

    /// Digest of all the board's answers.
    pub fn digest(&self) -> String {
        self.digest.hex()
    }

    /// The fault log as text.
    pub fn faults(&self) -> Vec<String> {
        let node = self.board.node();
        let Some(model) = node.robot().map(Robot::model) else { return Vec::new() };
        node.faults()
            .faults
            .iter()
            .map(|fault| format!("tick {}: {}", fault.tick, fault.named(model)))
            .collect()
    }

    /// Whether the scheduled trial is running.
    pub(super) const fn runs(&self) -> bool {
        self.trials == self.schedule.trial + 1
    }

    fn acting(&self) -> impl Iterator<Item = &Fault> {
        let (tick, runs) = (self.tick, self.runs());
        self.schedule.faults.iter().filter(move |fault| runs && fault.acts(tick))
    }

    fn acts(&self, family: Family) -> bool {
        self.acting().any(|fault| fault.kind.family() == family)
    }

    /// Runs an action on the board, and catches a panic.
    fn guarded(&mut self, action: impl FnOnce(&mut VirtualBoard)) {
        if self.panicked {
            return;
        }
        let result = catch_unwind(AssertUnwindSafe(|| action(&mut self.board)));
        if let Err(payload) = result {
            self.panicked = true;
            let text = payload.downcast_ref::<String>().cloned();
            let text = text.or(payload.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            let tick = self.tick;
            if let Some(oracle) = &mut self.oracle {
                oracle.violate(Rule::Panic, tick, text.unwrap_or_default());
            }
        }
    }

    /// Passes bytes to the board, and takes its replies.
    fn deliver(&mut self, bytes: &[u8]) {
        let mut out = Vec::new();
        self.guarded(|board| board.receive(bytes, &mut out));
        let mut out = &out[..];
        while self.decoder.take(&mut out) {
            let Ok(FromBoard::Reply(frame)) = self.decoder.message::<FromBoard>() else { continue };
            self.digest.reply(&frame.reply);
            let key = (frame.client, frame.sequence);
            if let (Some(request), Some(oracle)) = (self.sent.get(&key), &mut self.oracle) {
                oracle.reply(frame.client, frame.sequence, request, &frame.reply, self.tick);
            }
            self.replies.push((frame.client, frame.sequence, frame.reply));
        }
    }

    /// Creates the next request frame of a client.
    fn number(&mut self, client: u32, request: Request) -> RequestFrame {
        let sequence = self.sequences.entry(client).or_default();
        *sequence = sequence.wrapping_add(1);
        let sequence = *sequence;
        self.sent.insert((client, sequence), request.clone());
        RequestFrame { client, sequence, request }
    }

    /// Sends a frame over the link.
    pub fn send(&mut self, frame_: &RequestFrame) {
        let Self { schedule, link, tick, trials, .. } = self;
        let runs = *trials == schedule.trial + 1;
        let kinds = schedule.faults.iter().filter(|fault| runs && fault.acts(*tick)).map(|fault| &fault.kind);
        link.send(frame(frame_), *tick, kinds);
        self.receive();
    }

    /// Creates the next frame of the scenario's client.
    pub fn own(&mut self, request: Request) -> RequestFrame {
        self.number(CLIENT, request)
    }

    /// Whether the commanding program is alive.
    pub fn is_commanded(&self) -> bool {
        !self.acting().any(|fault| matches!(fault.kind, Kind::Killed))
    }

    /// Delivers the requests that have arrived.
    fn receive(&mut self) {
        for bytes in self.link.receive(self.tick) {
            self.deliver(&bytes);
        }
    }

    /// Takes the reply to a request of the scenario's client, if it has come.
    pub fn take_reply(&mut self, sequence: u16) -> Option<Reply> {
        let place =
            self.replies.iter().position(|(client, number, _)| (*client, *number) == (CLIENT, sequence))?;
        Some(self.replies.swap_remove(place).2)
    }

    /// Sends a request without link faults, and returns its reply at once.
    fn ask(&mut self, request: Request) -> Option<Reply> {
        let request = self.number(CLIENT, request);
        self.replies.clear();
        self.deliver(&frame(&request));
        self.take_reply(request.sequence)
    }

    pub(super) fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        if self.is_over {
            return Err(over());
        }
        let is_command = matches!(request, Request::Task(_) | Request::Keep);
        if !self.disturbed && self.runs() {
            // Nothing has failed yet: the scenario gets the board's own answers.
            let reply = self.ask(request).ok_or_else(over)?;
            if let Reply::Task(_) = reply {
                self.report = Some(reply.clone());
            }
            return Ok(reply);
        }
        if is_command && self.runs() {
            if self.is_commanded() {
                let frame = self.number(CLIENT, request);
                self.send(&frame);
            }
            return Ok(Reply::Done);
        }
        if matches!(request, Request::Disable) && self.runs() {
            // The scenario has ended or given up.
            self.is_over = true;
            return Err(over());
        }
        let reads = request == Request::ReadTask;
        match self.ask(request) {
            Some(reply @ Reply::Task(_)) => {
                if matches!(self.board.node().mode(), Mode::Enabled(_)) || self.report.is_none() {
                    self.report = Some(reply);
                }
                self.report.clone().ok_or_else(over)
            }
            Some(Reply::Refused(_)) if reads => self.report.clone().ok_or_else(over),
            // The refusal is hidden from the scenario.
            Some(Reply::Refused(_)) => Ok(Reply::Done),
            Some(reply) => Ok(reply),
            None => Err(over()),
        }
    }

    /// Sends the requests of faulty programs in this tick.
    fn disturb_command(&mut self) {
        let kinds: Vec<Kind> = self.acting().map(|fault| fault.kind).collect();
        let joints = self.board.node().robot().map_or(0, |robot| robot.joints().len());
        for kind in kinds {
            let (client, request) = match kind {
                Kind::Second { probability } if self.strangers.chance(probability) => {
                    (SECOND, strangers::second(&mut self.strangers, joints))
                }
                Kind::Nonsense { probability } if self.strangers.chance(probability) => {
                    let client =
                        if self.strangers.chance(0.7) { CLIENT } else { STRANGER + self.strangers.below(5) };
                    match strangers::nonsense(&mut self.strangers, joints) {
                        // From the commander, a Hello would end its command and thereby the schedule.
                        hello @ Request::Hello { .. } if client == CLIENT => (STRANGER, hello),
                        request => (client, request),
                    }
                }
                _ => continue,
            };
            let frame = self.number(client, request);
            self.send(&frame);
        }
    }

    /// Runs a control period of the board.
    pub(super) fn tick(&mut self, sensors: &SensorFrame) {
        let runs = self.runs();
        if runs {
            self.disturbed |= self.schedule.faults.iter().any(|fault| self.tick >= fault.begin);
            self.receive();
            self.disturb_command();
        }
        let faults = if runs { self.schedule.faults.clone() } else { Vec::new() };
        let read = self.plant_link.sense(sensors, &faults, self.tick);
        self.counts = [read.encoders.to_vec(), sensors.encoders.to_vec()];
        let resets = faults.iter().any(|fault| fault.kind == Kind::Reset && fault.begin == self.tick);
        if resets {
            self.guarded(VirtualBoard::reset);
            if let Some(oracle) = &mut self.oracle {
                oracle.reset();
            }
        }
        let skips = self.acting().any(|fault| matches!(fault.kind, Kind::Skip));
        if skips || self.panicked {
            self.missed += 1;
        } else {
            self.missed = 0;
            let (mut answer, mut out) = (ActuatorFrame::default(), Vec::new());
            self.guarded(|board| answer = board.tick(&read, &mut out));
            self.answer = answer;
            self.digest.frame(&self.answer);
        }
        let mut answer = self.answer.clone();
        let is_off = self.missed > DRIVE_PATIENCE || answer.torques.iter().any(|torque| !torque.is_finite());
        if is_off || answer.torques.len() != sensors.encoders.len() {
            answer.enabled = false;
            answer.torques = sensors.encoders.iter().map(|_| 0.0).collect();
        }
        self.driven = self.plant_link.drive(&answer, &faults, self.tick);
    }

    /// Applies the environment faults of this tick.
    pub(super) fn disturb_plant(&mut self, plant: &mut Plant) {
        let begins: Vec<Fault> = self.acting().filter(|fault| fault.begin == self.tick).copied().collect();
        for fault in begins {
            let hold = f64::from(fault.ticks.unwrap_or(100)) * CONTROL_PERIOD;
            let push = |force| Push { force, point: [0.0; 3], ramp: 0.02, hold };
            let done = match fault.kind {
                Kind::Push { joint, force } => plant.push_link(joint, push(force)),
                Kind::Pull { force } if plant.object().is_some() => plant.push(push(force)),
                Kind::Pull { force } => plant.push_tip(0, push(force)),
                Kind::Wall { direction, clearance, stiffness } => {
                    plant.insert_wall_ahead(direction, clearance, stiffness)
                }
                Kind::Removed => {
                    plant.remove_object();
                    plant.remove_walls();
                    Ok(())
                }
                _ => Ok(()),
            };
            if let Err(error) = done {
                self.refused.get_or_insert(error.to_string());
            }
        }
        self.touched |= self.acts(Family::Environment);
    }

    pub(super) fn sample(&self, plant: &Plant) -> Sample {
        let node = self.board.node();
        let truth = plant.truth();
        let norm = |vector: &[f64; 3]| vector.iter().map(|part| part * part).sum::<f64>().sqrt();
        let tips = plant.tips();
        let walls = tips.iter().map(|tip| norm(&tip.wall_force));
        let contacts = plant.contacts();
        let contact = walls.chain(contacts.iter().map(|contact| norm(&contact.force))).fold(0.0, f64::max);
        let is = |test: fn(&Kind) -> bool| self.acting().any(|fault| test(&fault.kind));
        let acting = Acting {
            changes: self.schedule.faults.iter().any(|fault| fault.changes(self.tick)),
            environment: self.touched,
            pushed: is(|kind| matches!(kind, Kind::Push { .. } | Kind::Pull { .. })),
            held: plant.is_held(),
            unloads: self.schedule.faults.iter().any(|fault| fault.unloads(self.tick)),
            encoders: is(|kind| {
                matches!(
                    kind,
                    Kind::Stuck { .. }
                        | Kind::Jump { .. }
                        | Kind::Drift { .. }
                        | Kind::Noise { .. }
                        | Kind::Swapped { .. }
                )
            }),
            drifts: is(|kind| matches!(kind, Kind::Drift { .. })),
            drives: self.acts(Family::Drive),
            late: self.acting().map(|fault| fault.kind.lateness()).max().unwrap_or(0),
            late_drives: self.acting().filter_map(|fault| fault.kind.late_drive()).collect(),
            weak_drives: self.acting().filter_map(|fault| fault.kind.weak_drive()).collect(),
        };
        Sample {
            tick: self.tick,
            answered: self.missed == 0,
            mode: node.mode(),
            enabled: self.answer.enabled,
            torques: self.answer.torques.to_vec(),
            counts: self.counts.clone(),
            reaction: node.reaction(),
            total: node.faults().total,
            latest: node.faults().faults.last().copied(),
            positions: truth.positions,
            drives: truth.torques,
            weight: plant.weight_torques(),
            load: plant.load_torques(),
            energy: plant.kinetic_energy(),
            velocities: tips.iter().map(|tip| tip.velocity).collect(),
            speed: tips.iter().map(|tip| norm(&tip.velocity)).fold(0.0, f64::max),
            contact,
            stiffness: plant.wall_stiffness(),
            acting,
        }
    }
}

pub(super) fn over() -> BoardError {
    BoardError::Link(io::Error::other("the run is over"))
}
