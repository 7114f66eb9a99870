//! Fault detection and reactions.

use nalgebra::Vector3;

use super::Node;
use super::force_sensor::ForceSensorState;
use super::joint::{JointState, Joints, Situation};
use super::state::{Sensing, State};
use crate::TICK;
use crate::control::ServoMode;
use crate::fault::{Fault, FaultCause, Finding};
use crate::math::abs;
use crate::model::{GAUGE_END, MAX_JOINTS, Reaction};
use crate::protocol::{ForceSensorFault, Mode, SensorFrame};
use crate::robot::{Actuation, JointConfig, Measured, Postures, Robot, count};
use crate::task::Halt;

/// Maximum number of restarts of a stop after missed ticks; then the robot is damped.
const MAX_RESTARTS: u8 = 10;

/// Share of the force limit of a sensor above which it reads a contact.
const CONTACT_SHARE: f32 = 0.02;

/// A finding of the sensors, and the joint that it concerns.
type SensorFault = Option<(u8, Finding)>;

/// What determines whether a further fault changes the present stop, if there is one.
#[derive(Clone, Copy)]
struct PresentStop {
    /// Whether the robot is held after a fault, and whether its task does that.
    holds: bool,
    halting: bool,
    reacts_to: FaultCause,
}

impl PresentStop {
    fn of(state: &State) -> Self {
        let holds = state.mode == Mode::Fault && state.reaction == Reaction::Hold;
        Self { holds, halting: state.halting, reacts_to: state.reacts_to }
    }

    /// Whether a fault while the robot is held shows that holding fails.
    fn fails(self, cause: FaultCause) -> bool {
        match cause {
            FaultCause::FollowingError
            | FaultCause::LateTick
            | FaultCause::EnergyGained
            | FaultCause::ObjectLost
            | FaultCause::ObjectMoved
            | FaultCause::ToolPositionError
            | FaultCause::ToolOrientationError => true,
            // Held joints do not need the force sensors; a task does.
            cause if cause.loses_force() => self.halting,
            // The condition that caused the fault lasts until the robot is at rest and the force is released.
            FaultCause::ForceLimit | FaultCause::VelocityLimit | FaultCause::PositionLimit => {
                self.reacts_to != cause
            }
            _ => false,
        }
    }

    /// What a fault changes: 2 if it switches the outputs off, 1 if it ends the holding. No other must mask
    /// it.
    #[cold]
    #[inline(never)]
    fn urgency(self, cause: FaultCause) -> u8 {
        match cause {
            cause if !cause.leaves_control() => 2,
            cause if self.holds && self.fails(cause) => 1,
            _ => 0,
        }
    }

    /// The more urgent of two findings, else the first.
    #[cold]
    #[inline(never)]
    fn worse(self, first: SensorFault, other: (u8, Finding)) -> SensorFault {
        match first {
            Some((_, found)) if self.urgency(other.1.cause) <= self.urgency(found.cause) => first,
            _ => Some(other),
        }
    }
}

impl Node {
    /// Records a fault and reacts to it with the stop that the task needs, or, if the reaction to an earlier
    /// fault has failed, with a weaker reaction.
    pub(super) fn fail(&mut self, fault: Fault) {
        let strongest = match self.robot.loaded() {
            Some(robot) if fault.cause.leaves_control() => robot.model().safety.reaction,
            _ => Reaction::Off,
        };
        let reaction = match self.state.mode {
            Mode::Disabled => return,
            Mode::Enabled(_) if strongest == Reaction::Hold => self.halt(&fault),
            Mode::Enabled(_) => strongest,
            Mode::Fault => {
                if fault.cause == FaultCause::LateTick
                    && self.is_stopping()
                    && self.state.restarts < MAX_RESTARTS
                {
                    self.state.restarts += 1;
                    // A tick that came twice missed nothing.
                    let missed = fault.value > 1.0;
                    if !missed || self.restart_stop(&fault) == self.state.reaction {
                        return;
                    }
                }
                let failed = PresentStop::of(&self.state).fails(fault.cause);
                let damps = self.state.reaction == Reaction::Damp;
                let reaction = strongest.min(match fault.cause {
                    FaultCause::EnergyGained if damps => Reaction::Off,
                    _ if failed => Reaction::Damp,
                    _ => Reaction::Hold,
                });
                // A lasting condition, such as a low supply, is no further fault.
                if reaction >= self.state.reaction {
                    return;
                }
                reaction
            }
        };
        self.state.reacts_to = fault.cause;
        self.state.faults.record(fault);
        self.state.mode = Mode::Fault;
        self.state.reaction = reaction;
        self.state.damped = false;
        self.state.restarts = 0;
        self.state.reacting_since = self.state.tick;
        if reaction != Reaction::Off {
            self.begin_stop_energy();
        }
    }

    /// Restarts a stop after missed ticks, in which the motion continued without control. Returns the
    /// reaction.
    fn restart_stop(&mut self, fault: &Fault) -> Reaction {
        self.begin_stop_energy();
        match (self.state.reaction, self.state.halting) {
            (Reaction::Hold, true) => self.halt(fault),
            (Reaction::Hold, false) => {
                self.hold_joints(fault);
                // The loads are unchanged: the servos start from the torques that balanced them.
                let mut all = Joints::of(&self.robot, &mut self.state);
                let weight = all.weight();
                all.each().zip(weight).for_each(|(joint, weight)| {
                    joint.target.feedforward = joint.state.torque - weight;
                });
                Reaction::Hold
            }
            (reaction, _) => reaction,
        }
    }

    /// Begins the controlled stop of the running task. Returns the reaction.
    fn halt(&mut self, fault: &Fault) -> Reaction {
        let (task, io) = self.task_and_io();
        let halt = task.halt(io, fault);
        self.state.halting = halt == Halt::Task;
        match halt {
            Halt::Task => Reaction::Hold,
            Halt::Damp => Reaction::Damp,
            Halt::Joints => {
                self.hold_joints(fault);
                for joint in Joints::of(&self.robot, &mut self.state).each() {
                    joint.state.grips = joint.target.feedforward != 0.0;
                }
                Reaction::Hold
            }
        }
    }

    /// Brings each joint to rest by its servo.
    fn hold_joints(&mut self, fault: &Fault) {
        // Without a servo there is no reference to follow to rest.
        let no_servo = self.state.targets.actuation != Actuation::Servo;
        let where_it_is = no_servo || fault.cause.invalidates_reference();
        self.state.targets.actuation = Actuation::Servo;
        let lost = fault.cause == FaultCause::ObjectLost;
        // Its integrator is all that carries the weight.
        let is_bare = self.state.targets.servo_mode == ServoMode::BarePid;
        // The servos continue one period after the references: in a tick, from those of a period ago.
        let ago = if fault.cause == FaultCause::Stop { 0.0 } else { TICK };
        let mut all = Joints::of(&self.robot, &mut self.state);
        let weight = if is_bare { all.weight() } else { [0.0; MAX_JOINTS] };
        all.each().zip(weight).for_each(|(mut joint, weight)| {
            joint.hold(where_it_is, weight, ago);
            if lost {
                joint.target.feedforward = 0.0;
            }
        });
    }

    /// Reads the sensors and checks them.
    pub(super) fn read_sensors(&mut self, sensors: &SensorFrame) -> Option<Fault> {
        let tick = sensors.sequence;
        let last = core::mem::replace(&mut self.state.tick, tick);
        if sensors.flags.silent() {
            self.state.sensing.lose(last);
            return self.silent(tick);
        }
        self.state.supply = sensors.supply;
        let robot = self.robot.loaded()?;
        let fault = |cause, joint, value, limit| Some(Fault { cause, joint, value, limit, tick });
        if let Some((got, expected)) = wrong_count(robot, sensors) {
            // It is unknown which joints these counts belong to, so the old counts must not be used for
            // homing.
            self.state.sensing.lose(last);
            #[expect(clippy::cast_precision_loss, reason = "at most 16")]
            return fault(FaultCause::SensorCount, None, got as f32, expected as f32);
        }
        let sensing = core::mem::replace(&mut self.state.sensing, Sensing::Read);
        // No tick precedes the first frame.
        let elapsed = if sensing == Sensing::Read { tick.wrapping_sub(last) } else { 1 };
        let mut all = Joints::of(robot, &mut self.state);
        if sensing != Sensing::Read {
            first_read(&mut all, sensing, sensors);
        } else if elapsed.cast_signed() > 1 {
            #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
            let periods = elapsed as f32;
            // A jump is left in the positions, and detected below.
            let joints = all.each().zip(&sensors.encoders);
            let moved = joints.filter(|(joint, count)| !joint.leaps_to(**count, periods));
            moved.for_each(|(mut joint, &count)| joint.catch_up(count, periods));
        }
        let mut suspect = sensors.flags.dead_encoder().is_some();
        for ((mut joint, &count), &current) in all.each().zip(&sensors.encoders).zip(&sensors.currents) {
            joint.read(count);
            suspect |= joint.gains_speed() || joint.check_measurement(current).is_some();
        }
        let joint_fault = if suspect { check_joints(robot, &mut self.state, sensors) } else { None };
        let tip_fault = match sensors.flags.force_sensor() {
            _ if robot.force_sensors() == 0 => None,
            None => self.read_force_sensors(sensors),
            Some(fault) => {
                self.state.force_sensors.iter_mut().for_each(ForceSensorState::lose);
                // The joints move on, and the cache is updated only with the force sensors.
                self.postures.clear();
                gauge_fault(robot, fault)
            }
        };
        self.rank(sensors, joint_fault, tip_fault, elapsed.cast_signed())
    }

    /// The fault of sensors that could not be read; `None` before the first model.
    #[cold]
    #[inline(never)]
    fn silent(&mut self, tick: u32) -> Option<Fault> {
        self.robot.loaded()?;
        Some(Fault { cause: FaultCause::SensorsSilent, joint: None, value: 1.0, limit: 0.0, tick })
    }

    /// The fault of a sensor frame to react to: a lasting condition, such as a low supply, must not mask a
    /// fault that changes how the robot has to stop.
    fn rank(
        &self,
        sensors: &SensorFrame,
        joint_fault: SensorFault,
        tip_fault: SensorFault,
        elapsed: i32,
    ) -> Option<Fault> {
        let safety = &self.robot.loaded()?.model().safety;
        let fault =
            |cause, joint, value, limit| Some(Fault { cause, joint, value, limit, tick: self.state.tick });
        let of_sensor = |found: SensorFault| {
            let (index, found) = found?;
            Some(found.at(Some(index), self.state.tick))
        };
        let stop = PresentStop::of(&self.state);
        let urgency = |found: &Option<Fault>| found.map_or(0, |found| stop.urgency(found.cause));
        let supply = f32::from(sensors.supply) / 1000.0;
        if sensors.flags.emergency_stop() {
            return fault(FaultCause::EmergencyStop, None, 1.0, 0.0);
        }
        // Before the trip that it causes.
        if supply > safety.supply_max {
            return fault(FaultCause::SupplyHigh, None, supply, safety.supply_max);
        }
        if sensors.flags.power_stage() {
            return fault(FaultCause::PowerStage, None, 1.0, 0.0);
        }
        let is_low = supply < safety.supply_min;
        if joint_fault.is_none() && tip_fault.is_none() && elapsed == 1 && !is_low {
            return None;
        }
        let [joint, tip] = [of_sensor(joint_fault), of_sensor(tip_fault)];
        let found = if urgency(&tip) > urgency(&joint) { tip } else { joint };
        if urgency(&found) > 0 {
            return found;
        }
        #[expect(clippy::cast_precision_loss, reason = "for display")]
        let late = || fault(FaultCause::LateTick, None, elapsed as f32, 1.0).filter(|_| elapsed != 1);
        let low = || fault(FaultCause::SupplyLow, None, supply, safety.supply_min);
        // A stop that begins must know whether the force sensors are valid, and else the references.
        let misleads = |found: &Fault| {
            matches!(self.state.mode, Mode::Enabled(_))
                && (found.cause.loses_force() || found.cause.invalidates_reference())
        };
        late()
            .or(tip.filter(misleads))
            .or(joint.filter(misleads))
            .or_else(|| low().filter(|_| is_low))
            .or(joint.or(tip))
    }

    /// Checks the control, also while it holds the robot after a fault, and the command timeout while
    /// enabled.
    pub(super) fn check_control(&mut self) -> Option<Fault> {
        let enabled = matches!(self.state.mode, Mode::Enabled(_));
        if !enabled {
            let found = if self.is_stopping() { self.check_stop() } else { None };
            if found.is_some() || !self.is_holding() {
                return found;
            }
        }
        let robot = self.robot.loaded()?;
        let tick = self.state.tick;
        let mut resists = false;
        for (index, mut joint) in (0..).zip(Joints::of(robot, &mut self.state).each()) {
            if let Some(found) = joint.check_control() {
                return Some(found.at(Some(index), tick));
            }
            resists |= joint.resists();
        }
        if resists && let Some(fault) = check_encoders(robot, &mut self.state) {
            return Some(fault);
        }
        if !enabled {
            return None;
        }
        self.state.silence = self.state.silence.saturating_add(1);
        #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
        let silence = self.state.silence as f32 * TICK;
        let limit = robot.model().safety.command_timeout;
        let late = silence > limit + 0.5 * TICK;
        late.then_some(Fault { cause: FaultCause::CommandTimeout, joint: None, value: silence, limit, tick })
    }

    /// Whether the task is ticked: it is enabled, or brings the robot to rest.
    pub(super) fn ticks_task(&self) -> bool {
        matches!(self.state.mode, Mode::Enabled(_)) || self.state.halting && self.is_holding()
    }

    /// Whether the outputs are on after a fault.
    pub(super) fn is_stopping(&self) -> bool {
        self.state.mode == Mode::Fault && self.state.reaction != Reaction::Off
    }

    /// Whether the robot is held after a fault.
    pub(super) fn is_holding(&self) -> bool {
        PresentStop::of(&self.state).holds
    }

    /// The first joint whose torque is not finite.
    #[cold]
    pub(super) fn find_not_finite(&self) -> Option<Fault> {
        let joints = self.state.joints.get(..self.robot.joints().len()).unwrap_or_default();
        let (index, state) = (0..).zip(joints).find(|(_, joint)| !joint.torque.is_finite())?;
        Some(Fault {
            cause: FaultCause::NotFinite,
            joint: Some(index),
            value: abs(state.torque),
            limit: 0.0,
            tick: self.state.tick,
        })
    }

    /// Reads the force sensors of the tips. Returns the first fault, with the last joint of its chain.
    #[inline(never)]
    fn read_force_sensors(&mut self, sensors: &SensorFrame) -> SensorFault {
        // The sensor also measures the inertial force of the mass on it.
        let accelerated = self.ticks_task();
        let state = &mut self.state;
        state.tare_delay = state.tare_delay.saturating_sub(1);
        let mut gravity = *self.robot.gravity();
        if accelerated {
            gravity -= state.task.acceleration();
        }
        read_forces(
            &self.robot,
            &mut state.force_sensors,
            &mut state.measured,
            &mut self.postures,
            sensors,
            &gravity,
        )
    }
}

/// Reads the encoders from the first frame, or from the first one after frames that could not be read. A jump
/// in between is left in the positions, and detected in this tick.
#[cold]
#[inline(never)]
fn first_read(all: &mut Joints<'_>, sensing: Sensing, sensors: &SensorFrame) {
    #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
    let silence = match sensing {
        // A frame that comes twice is as late as its period.
        Sensing::Silent { since } => Some(sensors.sequence.wrapping_sub(since).max(1) as f32),
        Sensing::None | Sensing::Read => None,
    };
    for (mut joint, &count) in all.each().zip(&sensors.encoders) {
        if !silence.is_some_and(|periods| joint.leaps_to(count, periods)) {
            joint.first_read(count, silence);
        }
    }
}

/// Checks the encoders of joints that stand still while their efforts grow.
#[cold]
#[inline(never)]
fn check_encoders(robot: &Robot, state: &mut State) -> Option<Fault> {
    let tick = state.tick;
    let accelerates = matches!(state.targets.actuation, Actuation::Acceleration { .. });
    // Servos may keep pressing during a stop: a hand keeps its object.
    let stops = accelerates && state.mode == Mode::Fault;
    let pressing = pressing(robot, &state.measured);
    let mut all = Joints::of(robot, state);
    let weight = all.weight();
    for (index, (mut joint, weight)) in (0..).zip(all.each().zip(weight)) {
        let presses = pressing >> index & 1 != 0;
        let situation = Situation { stops, accelerates, presses };
        if joint.has_resisted()
            && let (effort, excess) = (joint.state.effort, joint.state.torque - weight)
            && let Some(found) = joint.check_encoder(effort, excess, situation)
        {
            return Some(found.at(Some(index), tick));
        }
    }
    None
}

/// The joints of the chains whose force sensors read a contact, one bit each.
#[cold]
fn pressing(robot: &Robot, measured: &Measured) -> u16 {
    let chains = robot.chains().iter().zip(&robot.model().chains).zip(&measured.wrenches);
    let mut joints = 0;
    for (index, ((config, chain), &[x, y, z, ..])) in chains.enumerate() {
        let Some(sensor) = chain.force_sensor.as_ref().filter(|_| measured.is_tared(index)) else { continue };
        let contact = CONTACT_SHARE * sensor.force_limit;
        if x * x + y * y + z * z > contact * contact {
            config.joints().for_each(|joint| joints |= 1 << joint);
        }
    }
    joints
}

/// Checks the measurements of all joints. Returns the worst fault.
#[cold]
#[inline(never)]
fn check_joints(robot: &Robot, state: &mut State, sensors: &SensorFrame) -> SensorFault {
    let (tick, stop) = (state.tick, PresentStop::of(state));
    // The reference takes the measured state when an arm makes contact, and for damped joints.
    let damped = state.mode == Mode::Fault && state.reaction == Reaction::Damp;
    let follows = damped || matches!(state.targets.actuation, Actuation::Acceleration { .. });
    let dead_encoder = sensors.flags.dead_encoder();
    let mut found = None;
    for (index, (mut joint, &current)) in (0..).zip(Joints::of(robot, state).each().zip(&sensors.currents)) {
        if dead_encoder == Some(index) {
            found = stop.worse(found, (index, joint.find_dead()));
        }
        if joint.gains_speed()
            && let Some(fault) = joint.check_speed(follows, tick)
        {
            found = stop.worse(found, (index, fault));
        }
        if let Some(fault) = joint.check_measurement(current) {
            found = stop.worse(found, (index, fault));
        }
    }
    match check_swapped(robot, state) {
        Some(swapped) => stop.worse(found, swapped),
        None => found,
    }
}

/// The first of two encoders whose cables are swapped: each jumps to the previous reading of the other. A
/// stop that used such angles would drive each joint by the motion of the other.
#[cold]
fn check_swapped(robot: &Robot, state: &mut State) -> SensorFault {
    let all = robot.joints().iter().zip(&state.joints);
    for (first, (config, joint)) in (0..).zip(all.clone()) {
        let swapped = |(of_other, other): &(&JointConfig, &JointState)| {
            joint.reads_that_of(config, other, of_other) && other.reads_that_of(of_other, joint, config)
        };
        if let Some(distance) = all.clone().skip(usize::from(first) + 1).position(|other| swapped(&other)) {
            let (value, limit) = (joint.change, config.limits.velocity * TICK);
            for index in [usize::from(first), usize::from(first) + 1 + distance] {
                if let (Some(config), Some(joint)) = (robot.joints().get(index), state.joints.get_mut(index))
                {
                    joint.lose_zero(config);
                }
            }
            return Some((first, Finding { cause: FaultCause::EncoderJump, value, limit }));
        }
    }
    None
}

/// A wrong number of sensors, and that of the robot.
fn wrong_count(robot: &Robot, sensors: &SensorFrame) -> Option<(usize, usize)> {
    let (joints, forces) = (robot.joints().len(), robot.force_sensors());
    let counts =
        [(sensors.encoders.len(), joints), (sensors.currents.len(), joints), (sensors.forces.len(), forces)];
    // A dead-encoder flag with a higher index means that the board has more joints.
    let dead = sensors.flags.dead_encoder().map(|index| (usize::from(index) + 1, joints));
    counts
        .into_iter()
        .find(|(got, expected)| got != expected)
        .or(dead.filter(|(got, expected)| got > expected))
}

/// The board's fault of the gauges of the first force sensor. The last wrench is kept.
#[cold]
#[inline(never)]
fn gauge_fault(robot: &Robot, fault: ForceSensorFault) -> SensorFault {
    let mut chains = robot.chains().iter().zip(&robot.model().chains);
    let (config, _) = chains.find(|(_, chain)| chain.force_sensor.is_some())?;
    let (cause, value, limit) = match fault {
        ForceSensorFault::Silent | ForceSensorFault::Damaged | ForceSensorFault::Restarted => {
            (FaultCause::ForceSilent, f32::from(fault.code()), 0.0)
        }
        ForceSensorFault::Stuck(_) => (FaultCause::ForceStuck, 1.0, 0.0),
        ForceSensorFault::Saturated(_) => (FaultCause::ForceSaturated, GAUGE_END, GAUGE_END),
    };
    Some((count(config.joints().end) - 1, Finding { cause, value, limit }))
}

/// Reads all force sensors into `measured` and stores the postures. `gravity` is gravity minus the
/// acceleration of the sensors [m/s²].
fn read_forces(
    robot: &Robot,
    states: &mut [ForceSensorState],
    measured: &mut Measured,
    postures: &mut Postures,
    sensors: &SensorFrame,
    gravity: &Vector3<f32>,
) -> SensorFault {
    let mut first_fault = None;
    let mut forces = sensors.forces.iter();
    let chains = robot.chains().iter().zip(&robot.model().chains).zip(states);
    for (index, ((config, model), state)) in chains.enumerate() {
        let Some(sensor) = &model.force_sensor else { continue };
        let Some(counts) = forces.next() else { break };
        let joints = config.joints();
        let last = count(joints.end) - 1;
        let Some(posture) = postures.update(index, &config.chain, measured.angles(joints)) else { break };
        let (wrench, fault) = state.read(sensor, counts, posture, gravity, measured.is_tared(index));
        if let Some(entry) = measured.wrenches.get_mut(index) {
            *entry = wrench;
        }
        first_fault = first_fault.or(fault.map(|fault| (last, fault)));
    }
    first_fault
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_condition_that_a_stop_reacts_to_hides_no_worse_one() {
        let stop = PresentStop { holds: true, halting: false, reacts_to: FaultCause::VelocityLimit };
        let of = |cause| Finding { cause, value: 2.0, limit: 1.0 };
        let lasting = (0, of(FaultCause::VelocityLimit));
        let worse = |other| stop.worse(Some(lasting), other).map(|(joint, found)| (joint, found.cause));
        assert_eq!(worse((3, of(FaultCause::PositionLimit))), Some((3, FaultCause::PositionLimit)));
        assert_eq!(worse((3, of(FaultCause::EncoderJump))), Some((3, FaultCause::EncoderJump)));
        assert_eq!(worse((3, of(FaultCause::VelocityLimit))), Some((0, FaultCause::VelocityLimit)));
        // What ends the holding does not hide what switches the outputs off.
        let ends = (1, of(FaultCause::PositionLimit));
        let jumps = (3, of(FaultCause::EncoderJump));
        assert_eq!(stop.worse(Some(ends), jumps).map(|(joint, _)| joint), Some(3));
        assert_eq!(stop.worse(Some(jumps), ends).map(|(joint, _)| joint), Some(3));
    }
}
