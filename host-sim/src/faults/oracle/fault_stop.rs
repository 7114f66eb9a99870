//! A robot that stopped with a fault: its state at that time, what excuses its later behaviour, and the
//! rules.

use std::collections::VecDeque;

use tesaki::fault::FaultCause;
use tesaki::model::Reaction;

use super::{STUCK_TICKS, T, WEIGHT_ERROR};
use crate::faults::rules::Rule;
use crate::faults::sample::{Machine, REDUCED_SPEED, Sample};

/// A robot is at rest if its kinetic energy is at most that of its whole mass at this speed [m/s].
const REST_SPEED: f64 = 0.02;
/// The time in which a held robot comes to rest [ticks].
const REST_TIME: u32 = 100;
/// Factor by which a contact force may rise after a fault.
const FORCE_RISE: f64 = 1.05;
/// Above this force there is a contact [N].
const CONTACT: f64 = 1.0;
/// The acceleration at a fault continues for this long: the torques fade, and the drives lag [ticks].
const FADING_TICKS: u32 = 2;
const FADING: f64 = FADING_TICKS as f64;
/// Faults of the force sensors, after which an arm is damped and not held.
const WITHOUT_FORCE: [FaultCause; 4] =
    [FaultCause::ForceSaturated, FaultCause::ForceStuck, FaultCause::ForceSilent, FaultCause::ForceMismatch];

/// A fault stop: the state at its start, and its course since.
pub struct FaultStop {
    /// Tick and cause of the first fault, and number of faults after it was recorded.
    tick: u32,
    cause: Option<FaultCause>,
    total: u32,
    /// Number of faults when the energy count was last restarted.
    found: u32,
    /// Largest contact force before the fault [N], and kinetic energy [J] and tool speed [m/s] at the fault,
    /// or when the board ticks again after missed ticks if that is more.
    contact: f64,
    energy: f64,
    speed: f64,
    /// Further rise of the force while the torques fade [N].
    rising: f64,
    /// Work of the drives beyond the weight since the fault, and the allowed work [J].
    work: f64,
    allowance: f64,
    /// Torques beyond the weight at the start [N·m].
    pressed: Vec<f64>,
    /// Part of each torque beyond the weight that has not faded yet under the rate limits [N·m], and the tick
    /// from which it fades.
    fading: Vec<f64>,
    fades_from: Vec<u32>,
    /// The last disturbance.
    disturbed: u32,
    /// Whether something other than the board determines the contact force.
    excused: bool,
    /// Whether an encoder has drifted: with one encoder per joint, a drift cannot be told from motion.
    drifted: bool,
    /// Consecutive ticks in which a rule was broken while a sensor or a drive was wrong.
    unnoticed: u32,
}

impl FaultStop {
    /// The stop begins with `sample`. `before` is the control period before it, the last one of `history`.
    pub fn begin(sample: &Sample, before: &Sample, history: &VecDeque<Sample>, machine: &Machine) -> Self {
        let answered = history.iter().rev().find(|before| before.answered).unwrap_or(before);
        let contact = history.iter().fold(0.0, |force: f64, before| force.max(before.contact));
        Self {
            tick: sample.tick,
            cause: sample.latest.map(|fault| fault.cause),
            total: sample.total,
            contact,
            rising: FADING * rise(history, |sample| sample.contact),
            energy: before.energy,
            speed: reached_speed(history.iter().rev().nth(1), before),
            work: 0.0,
            pressed: excess(answered).collect(),
            fading: torques_to_fade(answered),
            fades_from: begin_to_fade(sample.tick, before),
            allowance: before.energy + machine.tolerated_energy(),
            found: sample.total,
            disturbed: sample.tick,
            excused: false,
            drifted: false,
            unnoticed: 0,
        }
    }

    /// The work of the drives, and how much of it is allowed [J].
    pub const fn work(&self) -> [f64; 2] {
        [self.work, self.allowance]
    }

    /// Records the active faults of a control period, and what they excuse.
    pub fn note_what_acts(&mut self, sample: &Sample, before: &Sample) {
        let acting = &sample.acting;
        self.excused |= acting.environment || !acting.weak_drives.is_empty();
        self.drifted |= acting.drifts;
        if !sample.answered {
            // Without a tick the robot falls: the motion at the next tick counts.
            self.allowance += (sample.energy - before.energy).max(0.0);
            self.energy = self.energy.max(sample.energy);
            self.speed = self.speed.max(reached_speed(Some(before), sample));
        }
        let unloads = acting.unloads || before.acting.held && !acting.held;
        if acting.changes || unloads {
            self.disturbed = sample.tick;
        }
        if unloads {
            // The torque that balanced the load drives the robot until it has faded.
            for (fading, balanced) in self.fading.iter_mut().zip(excess(before)) {
                *fading = if balanced.abs() > fading.abs() { balanced } else { *fading };
            }
            self.fades_from.fill(sample.tick + STUCK_TICKS);
        }
    }

    /// Adds the work of the drives in a control period, and its allowance.
    pub fn count_work(&mut self, sample: &Sample, before: &Sample, machine: &Machine) {
        let moved = sample.positions.iter().zip(&before.positions).map(|(now, before)| now - before);
        let torques = sample.drives.iter().zip(&before.drives).map(|(now, before)| (now + before) / 2.0);
        let fading = self.fading.iter_mut().zip(&self.fades_from).zip(&machine.model.joints);
        for (index, (((moved, torque), weight), ((fading, fades_from), joint))) in
            moved.zip(torques).zip(&sample.weight).zip(fading).enumerate()
        {
            // A weak drive bears only this part of the weight.
            let borne = if sample.acting.weak_drives.contains(&index) {
                torque.clamp(weight.min(0.0), weight.max(0.0))
            } else {
                *weight
            };
            self.work += (torque - borne) * moved;
            let viscous = f64::from(joint.friction.viscous) * moved.abs() / T;
            let modelled = (1.0 + WEIGHT_ERROR) * (f64::from(joint.friction.coulomb) + viscous);
            // Work lost to true friction accelerates nothing.
            let truth = machine.coulomb.get(index).copied().unwrap_or_default() + viscous;
            self.allowance += WEIGHT_ERROR * (weight * moved).abs()
                + modelled.max(truth) * moved.abs()
                + (*fading * moved).max(0.0);
            if sample.tick >= *fades_from {
                let step = f64::from(joint.limits.torque_rate) * T;
                *fading -= fading.clamp(-step, step);
            }
        }
    }

    /// Returns the rules that are broken in a tick, each with its values. While a sensor or a drive is wrong,
    /// or shortly after, `patience` is the time in which the board must detect it [ticks].
    pub fn judge(
        &mut self,
        sample: &Sample,
        patience: Option<u32>,
        machine: &Machine,
    ) -> Vec<(Rule, String)> {
        let after = sample.tick - self.tick;
        if patience.is_some() && sample.total > self.found {
            self.go_on(sample, machine);
        }
        let too_fast = REDUCED_SPEED.max(FORCE_RISE * self.speed);
        let in_contact = !self.excused && self.contact > CONTACT && after > 0;
        let energy = self.work > self.allowance && !self.drifted;
        // A servo or a damper that uses a drifting encoder moves the joint at the rate of the drift.
        let speed = in_contact && sample.speed > too_fast && !self.drifted;
        let limit = self.force_limit(sample, machine);
        let force = in_contact && self.presses(sample, machine) && sample.contact > limit;
        let wrong = patience.is_some();
        self.unnoticed = if wrong && (energy || speed || force) { self.unnoticed + 1 } else { 0 };
        let noticeable = patience.is_none_or(|patience| self.unnoticed > patience);
        let mut broken = Vec::new();
        if energy && noticeable {
            let text = format!(
                "the drives brought {:.3} J into the robot within {after} ticks of the fault; \
                 allowed: {:.3} J",
                self.work, self.allowance
            );
            broken.push((Rule::Energy, text));
        }
        broken.extend(self.unrest(sample, machine).map(|text| (Rule::Rest, text)));
        if force && noticeable {
            let text = format!(
                "{:.2} N {after} ticks after the fault, {:.2} N before it, limit {limit:.2} N",
                sample.contact, self.contact
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
        broken
    }

    /// Restarts the count after the board has detected the fault: from here on the motion must not get worse.
    fn go_on(&mut self, sample: &Sample, machine: &Machine) {
        (self.found, self.work) = (sample.total, 0.0);
        self.allowance = sample.energy + machine.tolerated_energy();
        self.fading = torques_to_fade(sample);
        self.fades_from = begin_to_fade(sample.tick, sample);
        self.speed = self.speed.max(sample.speed);
    }

    /// Largest contact force that the fault explains [N].
    fn force_limit(&self, sample: &Sample, machine: &Machine) -> f64 {
        // The motion continues until its energy is stored in the wall's spring.
        let stored = 2.0 * sample.stiffness * self.energy;
        let after = sample.tick - self.tick;
        let reached = self.contact + if after > FADING_TICKS { 0.0 } else { self.rising };
        FORCE_RISE * (reached * reached + stored).sqrt() + machine.force_noise
    }

    /// Returns whether the drives can be the cause of a rise of the contact force. If friction can balance
    /// the additional torque of the drives of a robot at rest, it merely redistributes the forces.
    fn presses(&self, sample: &Sample, machine: &Machine) -> bool {
        let mut torques = excess(sample).zip(&self.pressed).zip(&machine.coulomb);
        sample.energy > rest_energy(machine)
            || torques.any(|((now, then), friction)| {
                let as_before = if now * then > 0.0 { FORCE_RISE * then.abs() } else { 0.0 };
                now.abs() > as_before + friction
            })
    }

    /// Describes the motion of a robot that must be at rest.
    fn unrest(&self, sample: &Sample, machine: &Machine) -> Option<String> {
        let holds = machine.model.safety.reaction == Reaction::Hold
            && sample.total == self.total
            && !self.cause.is_some_and(|cause| WITHOUT_FORCE.contains(&cause))
            && !sample.acting.encoders
            && !sample.acting.drives;
        let (rest, undisturbed) = (rest_energy(machine), sample.tick - self.disturbed);
        (holds && undisturbed > REST_TIME && sample.energy > rest).then(|| {
            let (energy, after) = (sample.energy, sample.tick - self.tick);
            format!(
                "{energy:.2e} J {after} ticks after the fault and {undisturbed} after the last disturbance; \
                 at rest: {rest:.2e} J"
            )
        })
    }
}

/// Largest kinetic energy of a robot at rest [J].
fn rest_energy(machine: &Machine) -> f64 {
    0.5 * machine.mass * REST_SPEED * REST_SPEED
}

/// Returns the torques of the drives beyond the weight [N·m].
fn excess(sample: &Sample) -> impl Iterator<Item = f64> {
    sample.drives.iter().zip(&sample.weight).map(|(drive, weight)| drive - weight)
}

/// Returns the torques of the drives beyond the weight that fade after a fault [N·m]. A late drive still has
/// to execute earlier commands.
fn torques_to_fade(sample: &Sample) -> Vec<f64> {
    let told = sample.torques.iter().zip(&sample.weight).map(|(torque, weight)| f64::from(*torque) - weight);
    let later = |(joint, (done, told)): (usize, (f64, f64))| {
        let is_late = sample.acting.late_drives.contains(&joint);
        if is_late && told.abs() > done.abs() { told } else { done }
    };
    excess(sample).zip(told).enumerate().map(later).collect()
}

/// Returns the tick in which each joint's torque begins to fade after a fault in `tick`.
fn begin_to_fade(tick: u32, sample: &Sample) -> Vec<u32> {
    let acting = &sample.acting;
    let late = |joint| if acting.late_drives.contains(&joint) { acting.late } else { 0 };
    (0..sample.torques.len()).map(|joint| tick + FADING_TICKS + late(joint)).collect()
}

/// Returns the largest tool speed if the last acceleration continues for some ticks [m/s].
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

/// Returns the rise of a value in the last tick, at least 0.
fn rise(before: &VecDeque<Sample>, value: impl Fn(&Sample) -> f64) -> f64 {
    let mut last = before.iter().rev().map(value);
    let [now, then] = [last.next(), last.next()];
    now.zip(then).map_or(0.0, |(now, then)| (now - then).max(0.0))
}
