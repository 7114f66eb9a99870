//! The oracle of safety: knows the plant and the protocol, not the control core.
//!
//! `docs/fault-schedules.md` gives each rule with its reason.

mod fault_stop;

use std::collections::{BTreeSet, VecDeque};

use tesaki::fault::Fault;
use tesaki::protocol::{Mode, Reply, Request};

use super::rules::{Rule, Violation};
use super::sample::{Machine, Sample};
use crate::plant::CONTROL_PERIOD;
use fault_stop::FaultStop;

/// Control period [s].
const T: f64 = CONTROL_PERIOD;
/// Fraction by which the model of weight and friction may be wrong.
const WEIGHT_ERROR: f64 = 0.25;
/// How far a joint may press into its stop [rad].
const STOP_COMPLIANCE: f64 = 0.02;
/// The contact force before a fault is the maximum over this time [ticks].
const BEFORE: usize = 20;
/// Ticks for which a joint with a dead encoder may be driven. Other encoder faults, and a drive that does not
/// follow its command, are detected by the resulting motion, within twice this time.
const STUCK_TICKS: u32 = 3;

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

/// Judges a run.
pub struct Oracle {
    machine: Machine,
    permission: Permission,
    commander: Option<u32>,
    /// Commands that were answered: a second answer belongs to a repeated request.
    answered: BTreeSet<(u32, u16)>,
    /// The newest `Disable` or `Stop` of each client, by its number.
    overruled: Vec<(u32, u16)>,
    before: VecDeque<Sample>,
    stop: Option<FaultStop>,
    /// Tick until which a sensor or drive fault counts as present, and the time in which the board must
    /// detect it [ticks].
    wrong_until: u32,
    patience: u32,
    /// Number of faults logged since power-on, and the latest fault.
    total: u32,
    latest: Option<Fault>,
    /// Number of successive ticks in which each joint's count stood still although it should have changed.
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

    /// The first violation of each broken rule.
    pub fn violations(&self) -> &[Violation] {
        &self.broken
    }

    /// The work of the drives in the present stop, and how much of it is allowed [J].
    pub fn work(&self) -> Option<[f64; 2]> {
        self.stop.as_ref().map(FaultStop::work)
    }

    /// Records a violation, unless its rule is already broken.
    pub fn violate(&mut self, rule: Rule, tick: u32, text: String) {
        if self.broken.iter().all(|violation| violation.rule != rule) {
            self.broken.push(Violation { rule, tick, text });
        }
    }

    /// Handles a reset of the board.
    pub fn reset(&mut self) {
        (self.permission, self.commander, self.stop) = (Permission::None, None, None);
        self.answered.clear();
        self.overruled.clear();
        self.before.clear();
    }

    /// Handles the board's reply to request number `sequence` of `client`, in `tick`.
    pub fn reply(&mut self, client: u32, sequence: u16, request: &Request, reply: &Reply, tick: u32) {
        if *reply != Reply::Done {
            return;
        }
        let first = match request {
            // These are carried out each time they arrive.
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
        self.check_end_stops(&sample);
        self.check_encoders(&sample);
        if sample.acting.encoders || sample.acting.drives {
            // A late drive keeps following its earlier command for this long.
            let patience = 2 * STUCK_TICKS + sample.acting.late;
            let goes_on = sample.tick < self.wrong_until;
            self.patience = if goes_on { self.patience.max(patience) } else { patience };
            self.wrong_until = sample.tick + self.patience;
        }
        self.check_fault_stop(&sample);
        self.before.push_back(sample);
        if self.before.len() > BEFORE {
            self.before.pop_front();
        }
    }

    /// Checks that the log has lost no fault, and that it holds the cause of a stop.
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

    fn check_end_stops(&mut self, sample: &Sample) {
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

    /// Checks for dead encoders. One is detectable when the joint moves and its count does not, under a
    /// torque that moves it. A torque against the motion takes energy out of the joint, so something else
    /// moves it; and a torque that is balanced by a load, such as a grip or a push, moves nothing.
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
            // A load in the direction of the torque does not count as additional torque.
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

    /// Checks the rules for a robot that stopped with a fault.
    fn check_fault_stop(&mut self, sample: &Sample) {
        if sample.mode != Mode::Fault {
            self.stop = None;
            return;
        }
        let Some(before) = self.before.back() else { return };
        let begin = || FaultStop::begin(sample, before, &self.before, &self.machine);
        let stop = self.stop.get_or_insert_with(begin);
        stop.note_what_acts(sample, before);
        if sample.enabled {
            stop.count_work(sample, before, &self.machine);
        }
        if !sample.enabled || !sample.answered {
            return;
        }
        let patience = (sample.tick < self.wrong_until).then_some(self.patience);
        for (rule, text) in stop.judge(sample, patience, &self.machine) {
            self.violate(rule, sample.tick, text);
        }
    }
}
