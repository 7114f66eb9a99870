//! The oracle of safety: knows the plant and the protocol, not the control core.
//!
//! `docs/fault-schedules.md` gives each rule with its reason.

use std::collections::{BTreeSet, VecDeque};

use tesaki::fault::{Fault, FaultCause};
use tesaki::model::Reaction;
use tesaki::protocol::{Mode, Reply, Request};

use super::rules::{Rule, Violation};
use super::sample::{Machine, REDUCED_SPEED, Sample};

/// Control period [s].
const T: f64 = 0.01;
/// A robot whose kinetic energy is that of all its mass at this speed or less is at rest [m/s].
const REST_SPEED: f64 = 0.02;
/// The time in which a held robot comes to rest [ticks].
const REST_TIME: u32 = 100;
/// Fraction of weight and friction by which the model may be wrong.
const WEIGHT_ERROR: f64 = 0.25;
/// How far a joint may press into its stop [rad].
const STOP_COMPLIANCE: f64 = 0.02;
/// By how much a contact force may rise after a fault.
const FORCE_RISE: f64 = 1.05;
/// The contact force before a fault is the largest in this time [ticks].
const BEFORE: usize = 20;
/// Above this force there is a contact [N].
const CONTACT: f64 = 1.0;
/// Ticks in which a joint with a dead encoder may be pushed. An encoder that lies otherwise, or a drive that
/// does not what it is told, is found by the motion that follows, in twice this time.
const STUCK_TICKS: u32 = 3;
/// The acceleration at a fault goes on for so long: the torques fade, and the drives lag [ticks].
const FADING_TICKS: u32 = 2;
const FADING: f64 = FADING_TICKS as f64;

/// Whether outputs may be on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Permission {
    /// No.
    None,
    /// For the task that the commander enabled.
    Run,
    /// To stop the robot after a fault.
    Stop,
}

/// What was so when the robot stopped with a fault.
struct Stop {
    /// When the first fault was recorded; number of faults before it.
    tick: u32,
    cause: Option<FaultCause>,
    total: u32,
    /// Number of faults when the energy was counted anew.
    found: u32,
    /// Largest contact force before [N], and energy and speed of the tool at that time; or when the board
    /// ticks again after missed ticks.
    contact: f64,
    energy: f64,
    speed: f64,
    /// How the force rises on while torques fade [N].
    rising: f64,
    /// Work of the drives beyond the weight, and its allowance, since [J].
    work: f64,
    allowance: f64,
    /// Torques beyond the weight at the beginning [N·m].
    pressed: Vec<f64>,
    /// What the rate limits leave of each torque beyond the weight [N·m], and since when they act.
    fading: Vec<f64>,
    fades_from: Vec<u32>,
    /// The last disturbance.
    disturbed: u32,
    /// Whether anything but the board decides on the contact force.
    excused: bool,
    /// Whether an encoder has drifted: no robot with one encoder for each joint can tell that from motion.
    drifted: bool,
    /// Ticks in which a joint has been too fast or has got too much energy, while a sensor or a drive was
    /// wrong.
    unnoticed: u32,
}

/// Judges a run.
pub struct Oracle {
    machine: Machine,
    permission: Permission,
    commander: Option<u32>,
    /// Commands that were answered: a second answer is to a repetition.
    answered: BTreeSet<(u32, u16)>,
    /// The newest `Disable` or `Stop` of each client, by its number.
    overruled: Vec<(u32, u16)>,
    before: VecDeque<Sample>,
    stop: Option<Stop>,
    /// A sensor or a drive is wrong, or was so shortly before this tick; in how many ticks the board must
    /// find it.
    wrong_until: u32,
    patience: u32,
    /// Faults in the log, of every tick.
    total: u32,
    latest: Option<Fault>,
    /// Ticks since each joint's count stood still although it should move.
    stuck: Vec<u32>,
    broken: Vec<Violation>,
}

impl Oracle {
    /// An oracle for a machine whose board has just been switched on.
    pub fn new(machine: Machine) -> Self {
        let stuck = vec![0; machine.model.joints.len()];
        Self {
            machine,
            permission: Permission::None,
            commander: None,
            answered: BTreeSet::new(),
            overruled: Vec::new(),
            before: VecDeque::new(),
            stop: None,
            wrong_until: 0,
            patience: 0,
            total: 0,
            latest: None,
            stuck,
            broken: Vec::new(),
        }
    }

    /// The broken rules, each with its first violation.
    pub fn violations(&self) -> &[Violation] {
        &self.broken
    }

    /// The work of the drives in the present stop, and how much of it is allowed [J].
    pub fn work(&self) -> Option<[f64; 2]> {
        self.stop.as_ref().map(|stop| [stop.work, stop.allowance])
    }

    /// Adds a violation, the first of its rule only.
    pub fn violate(&mut self, rule: Rule, tick: u32, text: String) {
        if self.broken.iter().all(|violation| violation.rule != rule) {
            self.broken.push(Violation { rule, tick, text });
        }
    }

    /// The board was reset.
    pub fn reset(&mut self) {
        (self.permission, self.commander, self.stop) = (Permission::None, None, None);
        self.answered.clear();
        self.overruled.clear();
        self.before.clear();
    }

    /// A reply of the board to request number `sequence` of `client`, in `tick`.
    pub fn reply(&mut self, client: u32, sequence: u16, request: &Request, reply: &Reply, tick: u32) {
        if *reply != Reply::Done {
            return;
        }
        let first = match request {
            // Carried out each time.
            Request::Disable | Request::Stop | Request::TakeCommand { .. } => true,
            _ => self.answered.insert((client, sequence)),
        };
        match request {
            Request::TakeCommand { .. } => {
                if matches!(self.permission, Permission::Run)
                    && self.commander.is_some_and(|old| old != client)
                {
                    let text = format!("client {client} took command of an enabled board");
                    self.violate(Rule::Enabled, tick, text);
                }
                self.commander = Some(client);
            }
            Request::ReleaseCommand if first => self.commander = None,
            Request::Disable => {
                self.permission = Permission::None;
                self.stop = None;
                self.overrule(client, sequence);
            }
            Request::Stop => {
                if self.permission == Permission::Run {
                    self.permission = Permission::Stop;
                }
                self.overrule(client, sequence);
            }
            Request::ClearFaults { .. } if first => {
                if self.permission == Permission::Stop {
                    self.permission = Permission::None;
                }
                self.stop = None;
            }
            Request::Enable(_) if first => {
                if self.commander != Some(client) {
                    let text = format!("client {client} enabled it; commander: {:?}", self.commander);
                    self.violate(Rule::Enabled, tick, text);
                }
                if let Some((_, newer)) = self
                    .overruled
                    .iter()
                    .find(|(other, newer)| *other == client && sequence.wrapping_sub(*newer) > u16::MAX / 2)
                {
                    let text = format!("Enable number {sequence} came after Disable or Stop number {newer}");
                    self.violate(Rule::Enabled, tick, text);
                }
                self.permission = Permission::Run;
                self.stop = None;
            }
            _ => {}
        }
    }

    fn overrule(&mut self, client: u32, sequence: u16) {
        self.overruled.retain(|(other, _)| *other != client);
        self.overruled.push((client, sequence));
    }

    /// Judges a control period.
    pub fn tick(&mut self, sample: Sample) {
        if sample.answered {
            self.check_torques(&sample);
            self.check_permission(&sample);
            self.check_log(&sample);
        }
        self.check_stops(&sample);
        self.check_encoders(&sample);
        if sample.acting.encoders || sample.acting.drives {
            // A late drive goes on for so long with what it was told before.
            let patience = 2 * STUCK_TICKS + sample.acting.late;
            let goes_on = sample.tick < self.wrong_until;
            self.patience = if goes_on { self.patience.max(patience) } else { patience };
            self.wrong_until = sample.tick + self.patience;
        }
        self.check_stop(&sample);
        self.before.push_back(sample);
        if self.before.len() > BEFORE {
            self.before.pop_front();
        }
    }

    /// Checks that the log still holds what was recorded, and the reason of a stop.
    fn check_log(&mut self, sample: &Sample) {
        let (total, tick) = (sample.total, sample.tick);
        if total < self.total {
            self.violate(Rule::Cause, tick, format!("the log held {} faults, now {total}", self.total));
        }
        if self.latest.is_some() && sample.latest.is_none() {
            self.violate(Rule::Cause, tick, "the log is empty".to_owned());
        }
        let stopped = sample.mode == Mode::Fault
            && self.before.back().is_some_and(|before| matches!(before.mode, Mode::Enabled(_)));
        if stopped && total == self.total {
            self.violate(Rule::Cause, tick, "stopped with a fault, and no new entry in the log".to_owned());
        }
        (self.total, self.latest) = (total, sample.latest);
    }

    fn check_torques(&mut self, sample: &Sample) {
        let joints = self.machine.model.joints.clone();
        if sample.torques.len() != joints.len() {
            if sample.enabled {
                let text = format!("{} torques for {} joints", sample.torques.len(), joints.len());
                self.violate(Rule::Torque, sample.tick, text);
            }
            return;
        }
        let before = self.before.back().filter(|before| before.enabled).map(|before| before.torques.clone());
        let missed = 1 + self.before.iter().rev().take_while(|before| !before.answered).count();
        for (index, (joint, &torque)) in joints.iter().zip(&sample.torques).enumerate() {
            let (name, limit) = (&joint.name, joint.limits.torque);
            if !torque.is_finite() || torque.abs() > limit || (!sample.enabled && torque != 0.0) {
                let on = if sample.enabled { "on" } else { "off" };
                let text = format!("{name}: {torque} N·m with outputs {on}, limit {limit} N·m");
                self.violate(Rule::Torque, sample.tick, text);
            }
            let last = before.as_ref().and_then(|torques| torques.get(index)).copied().unwrap_or(0.0);
            let rate = f64::from(torque - last).abs() / (T * missed as f64);
            let limit = f64::from(joint.limits.torque_rate);
            if sample.enabled && rate > limit * 1.0001 + 1e-3 {
                let text =
                    format!("{name}: {rate:.1} N·m/s from {last} to {torque} N·m, limit {limit} N·m/s");
                self.violate(Rule::TorqueRate, sample.tick, text);
            }
        }
    }

    fn check_permission(&mut self, sample: &Sample) {
        if sample.mode == Mode::Fault && self.permission == Permission::Run {
            self.permission = Permission::Stop;
        }
        let wrong = match (sample.enabled, sample.mode) {
            (true, Mode::Disabled) => true,
            (_, Mode::Enabled(_)) => self.permission != Permission::Run,
            (true, Mode::Fault) => self.permission == Permission::None,
            (false, _) => false,
        };
        if wrong {
            let (mode, permission) = (sample.mode, self.permission);
            let text = format!("{mode}, outputs on: {}; permitted: {permission:?}", sample.enabled);
            self.violate(Rule::Enabled, sample.tick, text);
        }
    }

    fn check_stops(&mut self, sample: &Sample) {
        let stops = self.machine.stops.clone();
        for (index, (stop, &angle)) in stops.iter().zip(&sample.positions).enumerate() {
            let Some([lower, upper]) = *stop else { continue };
            if !sample.acting.pushed && !(lower - STOP_COMPLIANCE..=upper + STOP_COMPLIANCE).contains(&angle)
            {
                let name = self.machine.model.joint_name(index).to_owned();
                let text = format!("{name}: {angle:.4} rad, stops at {lower:.4} and {upper:.4} rad");
                self.violate(Rule::Stops, sample.tick, text);
            }
        }
    }

    /// A dead encoder is detectable when the joint moves and its count does not, under a torque that moves
    /// it. One against the motion takes energy out of it: something else moves the joint. And one that a load
    /// balances, such as a grip or a push, moves nothing.
    fn check_encoders(&mut self, sample: &Sample) {
        let Some(before) = self.before.back() else { return };
        let mut found = Vec::new();
        for (index, joint) in self.machine.model.joints.iter().enumerate() {
            let [Some(read), Some(truth)] = sample.counts.each_ref().map(|counts| counts.get(index)) else {
                continue;
            };
            let [was_read, was_true] = before.counts.each_ref().map(|counts| counts.get(index));
            let (Some(&torque), Some(&weight), Some(&load)) =
                (sample.torques.get(index), sample.weight.get(index), sample.load.get(index))
            else {
                continue;
            };
            let excess = f64::from(torque) - weight;
            let coulomb = self.machine.coulomb.get(index).copied().unwrap_or_default();
            let breakaway =
                2.0 * coulomb + 0.1 * f64::from(joint.limits.torque) + WEIGHT_ERROR * weight.abs();
            let moved = was_true.is_some_and(|was| truth.wrapping_sub(*was).abs() > 2);
            let ends =
                [sample, before].map(|sample| sample.positions.get(index).copied().unwrap_or_default());
            // A load that helps the torque makes it no larger.
            let unbalanced = excess.abs() + (load * excess.signum()).min(0.0);
            let pushed = unbalanced > breakaway && excess * (ends[0] - ends[1]) > 0.0;
            let dead = was_read == Some(read) && moved && sample.enabled && pushed;
            if let Some(ticks) = self.stuck.get_mut(index) {
                *ticks = if dead { *ticks + 1 } else { 0 };
                if *ticks > STUCK_TICKS {
                    found.push(format!(
                        "{}: {excess:.3} N·m beyond its weight for {ticks} ticks, its count stands at {read}",
                        joint.name
                    ));
                }
            }
        }
        for text in found {
            self.violate(Rule::DeadEncoder, sample.tick, text);
        }
    }

    /// The rules of a robot that stopped with a fault.
    fn check_stop(&mut self, sample: &Sample) {
        if sample.mode != Mode::Fault {
            self.stop = None;
            return;
        }
        let Some(before) = self.before.back() else { return };
        let acting = &sample.acting;
        if self.stop.is_none() {
            let answered = self.before.iter().rev().find(|before| before.answered).unwrap_or(before);
            let contact = self.before.iter().fold(0.0, |force: f64, before| force.max(before.contact));
            self.stop = Some(Stop {
                tick: sample.tick,
                cause: sample.latest.map(|fault| fault.cause),
                total: sample.total,
                contact,
                rising: FADING * rise(&self.before, |sample| sample.contact),
                energy: before.energy,
                speed: reached_speed(self.before.iter().rev().nth(1), before),
                work: 0.0,
                pressed: excess(answered).collect(),
                fading: torques_to_fade(answered),
                fades_from: begin_to_fade(sample.tick, before),
                allowance: before.energy + self.machine.tolerated_energy(),
                found: sample.total,
                disturbed: sample.tick,
                excused: false,
                drifted: false,
                unnoticed: 0,
            });
        }
        let Some(stop) = &mut self.stop else { return };
        stop.excused |= acting.environment || !acting.weak_drives.is_empty();
        stop.drifted |= acting.drifts;
        if !sample.answered {
            // Without a tick the robot falls: what counts is the motion at the next one.
            stop.allowance += (sample.energy - before.energy).max(0.0);
            stop.energy = stop.energy.max(sample.energy);
            stop.speed = stop.speed.max(reached_speed(Some(before), sample));
        }
        let unloads = acting.unloads || before.acting.held && !acting.held;
        if acting.changes || unloads {
            stop.disturbed = sample.tick;
        }
        if unloads {
            // What balanced the load drives the robot until it has faded.
            for (fading, balanced) in stop.fading.iter_mut().zip(excess(before)) {
                *fading = if balanced.abs() > fading.abs() { balanced } else { *fading };
            }
            stop.fades_from.fill(sample.tick + STUCK_TICKS);
        }
        let moved = sample.positions.iter().zip(&before.positions).map(|(now, before)| now - before);
        let torques = sample.drives.iter().zip(&before.drives).map(|(now, before)| (now + before) / 2.0);
        let fading = stop.fading.iter_mut().zip(&stop.fades_from).zip(&self.machine.model.joints);
        if sample.enabled {
            for (index, (((moved, torque), weight), ((fading, fades_from), joint))) in
                moved.zip(torques).zip(&sample.weight).zip(fading).enumerate()
            {
                // The part of the weight that a weak drive does not bear is no work of the drive.
                let borne = if acting.weak_drives.contains(&index) {
                    torque.clamp(weight.min(0.0), weight.max(0.0))
                } else {
                    *weight
                };
                stop.work += (torque - borne) * moved;
                let viscous = f64::from(joint.friction.viscous) * moved.abs() / T;
                let modelled = (1.0 + WEIGHT_ERROR) * (f64::from(joint.friction.coulomb) + viscous);
                // What the true friction takes accelerates nothing.
                let truth = self.machine.coulomb.get(index).copied().unwrap_or_default() + viscous;
                stop.allowance += WEIGHT_ERROR * (weight * moved).abs()
                    + modelled.max(truth) * moved.abs()
                    + (*fading * moved).max(0.0);
                if sample.tick >= *fades_from {
                    let step = f64::from(joint.limits.torque_rate) * T;
                    *fading -= fading.clamp(-step, step);
                }
            }
        }
        if !sample.enabled || !sample.answered {
            return;
        }
        let after = sample.tick - stop.tick;
        let mut broken = Vec::new();
        let wrong = sample.tick < self.wrong_until;
        if wrong && sample.total > stop.found {
            // The board has found it: from here on it must not get worse.
            (stop.found, stop.work) = (sample.total, 0.0);
            stop.allowance = sample.energy + self.machine.tolerated_energy();
            stop.fading = torques_to_fade(sample);
            stop.fades_from = begin_to_fade(sample.tick, sample);
            stop.speed = stop.speed.max(sample.speed);
        }
        let too_fast = REDUCED_SPEED.max(FORCE_RISE * stop.speed);
        let in_contact = !stop.excused && stop.contact > CONTACT && after > 0;
        let energy = stop.work > stop.allowance && !stop.drifted;
        // A servo or a damper that uses an encoder that drifts moves the joint at the rate of the drift.
        let speed = in_contact && sample.speed > too_fast && !stop.drifted;
        // The motion goes on until its energy is in the wall's spring.
        let stored = 2.0 * sample.stiffness * stop.energy;
        let reached = stop.contact + if after > FADING_TICKS { 0.0 } else { stop.rising };
        let limit = FORCE_RISE * (reached * reached + stored).sqrt() + self.machine.force_noise;
        let rest = 0.5 * self.machine.mass * REST_SPEED * REST_SPEED;
        // Where friction may take what the drives of a robot at rest do more, it redistributes the forces.
        let mut torques = excess(sample).zip(&stop.pressed).zip(&self.machine.coulomb);
        let presses = sample.energy > rest
            || torques.any(|((now, then), friction)| {
                let as_before = if now * then > 0.0 { FORCE_RISE * then.abs() } else { 0.0 };
                now.abs() > as_before + friction
            });
        let force = in_contact && presses && sample.contact > limit;
        stop.unnoticed = if wrong && (energy || speed || force) { stop.unnoticed + 1 } else { 0 };
        let noticeable = !wrong || stop.unnoticed > self.patience;
        if energy && noticeable {
            let text = format!(
                "the drives brought {:.3} J into the robot within {after} ticks of the fault; \
                 allowed: {:.3} J",
                stop.work, stop.allowance
            );
            broken.push((Rule::Energy, text));
        }
        let holds = self.machine.model.safety.reaction == Reaction::Hold
            && sample.total == stop.total
            && !stop.cause.is_some_and(|cause| cause.loses_force() || cause == FaultCause::ForceMismatch)
            && !acting.encoders
            && !acting.drives;
        if holds && sample.tick - stop.disturbed > REST_TIME && sample.energy > rest {
            let text = format!(
                "{:.2e} J {after} ticks after the fault and {} after the last disturbance; \
                 at rest: {rest:.2e} J",
                sample.energy,
                sample.tick - stop.disturbed
            );
            broken.push((Rule::Rest, text));
        }
        if force && noticeable {
            let text = format!(
                "{:.2} N {after} ticks after the fault, {:.2} N before it, limit {limit:.2} N",
                sample.contact, stop.contact
            );
            broken.push((Rule::ContactForce, text));
        }
        if speed && noticeable {
            let text = format!(
                "{:.3} m/s {after} ticks after a fault in contact, limit {too_fast:.3} m/s",
                sample.speed
            );
            broken.push((Rule::ToolSpeed, text));
        }
        for (rule, text) in broken {
            self.violate(rule, sample.tick, text);
        }
    }
}

/// The torques of the drives beyond the weight [N·m].
fn excess(sample: &Sample) -> impl Iterator<Item = f64> {
    sample.drives.iter().zip(&sample.weight).map(|(drive, weight)| drive - weight)
}

/// The torques of the drives beyond the weight that fade from a fault on [N·m]. A late drive has still to do
/// what it was told before.
fn torques_to_fade(sample: &Sample) -> Vec<f64> {
    let told = sample.torques.iter().zip(&sample.weight).map(|(torque, weight)| f64::from(*torque) - weight);
    let later = |(joint, (done, told)): (usize, (f64, f64))| {
        let is_late = sample.acting.late_drives.contains(&joint);
        if is_late && told.abs() > done.abs() { told } else { done }
    };
    excess(sample).zip(told).enumerate().map(later).collect()
}

/// When the torques of the joints begin to fade after a fault in `tick`.
fn begin_to_fade(tick: u32, sample: &Sample) -> Vec<u32> {
    let acting = &sample.acting;
    let late = |joint| if acting.late_drives.contains(&joint) { acting.late } else { 0 };
    (0..sample.torques.len()).map(|joint| tick + FADING_TICKS + late(joint)).collect()
}

/// The largest speed of a tool while it goes on for some ticks with the acceleration of the last one [m/s].
fn reached_speed(before: Option<&Sample>, now: &Sample) -> f64 {
    let then = before.map_or(&now.velocities, |before| &before.velocities);
    let after = |ticks: u32| {
        let tools = now.velocities.iter().zip(then);
        let reached = move |now: f64, then: f64| now + f64::from(ticks) * (now - then);
        tools.map(move |(now, then)| {
            let parts = now.iter().zip(then).map(|(now, then)| reached(*now, *then));
            parts.map(|part| part * part).sum::<f64>().sqrt()
        })
    };
    (0..=FADING_TICKS).flat_map(after).fold(now.speed, f64::max)
}

/// By how much a value rose in the last tick.
fn rise(before: &VecDeque<Sample>, value: impl Fn(&Sample) -> f64) -> f64 {
    let mut last = before.iter().rev().map(value);
    let [now, then] = [last.next(), last.next()];
    now.zip(then).map_or(0.0, |(now, then)| (now - then).max(0.0))
}
