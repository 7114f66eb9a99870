//! Fault detection and reactions.

use nalgebra::Vector3;

use super::Node;
use super::force_sensor::ForceSensorState;
use super::handle::joints;
use crate::TICK;
use crate::fault::{Fault, FaultCause};
use crate::math::abs;
use crate::model::Reaction;
use crate::protocol::{Mode, SensorFrame};
use crate::robot::{Actuation, Measured, Postures, Robot, count};

/// A fault of the sensors: joint, cause, value, limit.
type SensorFault = Option<(u8, (FaultCause, f32, f32))>;

impl Node {
    /// Records a fault and reacts to it.
    pub(super) fn fail(&mut self, fault: Fault) {
        let reaction = match self.robot.loaded() {
            Some(robot) if fault.cause.leaves_sensors_valid() => robot.model().safety.reaction,
            _ => Reaction::Off,
        };
        match self.state.mode {
            Mode::Disabled => return,
            // Only the first fault has a reaction, unless a later one switches the outputs off.
            Mode::Fault if reaction != Reaction::Off || self.state.reaction == Reaction::Off => return,
            Mode::Fault => {}
            Mode::Enabled(_) => {
                if reaction == Reaction::Hold {
                    // Without a servo there is no reference to follow to rest.
                    let no_servo = self.state.targets.actuation != Actuation::Servo;
                    let at_once = no_servo || fault.cause.invalidates_reference();
                    self.state.targets.actuation = Actuation::Servo;
                    joints(&self.robot, &mut self.state).each().for_each(|mut joint| joint.hold(at_once));
                }
            }
        }
        self.state.faults.record(fault);
        self.state.mode = Mode::Fault;
        self.state.reaction = reaction;
    }

    /// Reads the sensors and checks them.
    pub(super) fn read_sensors(&mut self, sensors: &SensorFrame) -> Option<Fault> {
        let tick = sensors.sequence;
        let last = core::mem::replace(&mut self.state.tick, tick);
        self.state.supply = sensors.supply;
        let robot = self.robot.loaded()?;
        let fault = |cause, joint, value, limit| Some(Fault { cause, joint, value, limit, tick });
        if let Some((got, expected)) = wrong_count(robot, sensors) {
            #[expect(clippy::cast_precision_loss, reason = "at most 16")]
            return fault(FaultCause::SensorCount, None, got as f32, expected as f32);
        }
        let sensed = core::mem::replace(&mut self.state.sensed, true);
        let mut all = joints(robot, &mut self.state);
        if !sensed {
            all.each().zip(&sensors.encoders).for_each(|(mut joint, &count)| joint.first_read(count));
            self.read_force_sensors(sensors);
            return None;
        }
        let mut joint_fault = None;
        for (index, ((mut joint, &count), &current)) in
            (0..).zip(all.each().zip(&sensors.encoders).zip(&sensors.currents))
        {
            joint.read(count);
            if joint_fault.is_none() {
                joint_fault = joint.check_measurement(current).map(|fault| (index, fault));
            }
        }
        let tip_fault = if robot.force_sensors() == 0 { None } else { self.read_force_sensors(sensors) };
        let robot = self.robot.loaded()?;
        let safety = &robot.model().safety;
        let supply = f32::from(sensors.supply) / 1000.0;
        if sensors.flags.emergency_stop() {
            return fault(FaultCause::EmergencyStop, None, 1.0, 0.0);
        }
        if supply < safety.supply_min {
            return fault(FaultCause::SupplyLow, None, supply, safety.supply_min);
        }
        if supply > safety.supply_max {
            return fault(FaultCause::SupplyHigh, None, supply, safety.supply_max);
        }
        if let Some((index, (cause, value, limit))) = joint_fault.or(tip_fault) {
            return fault(cause, Some(index), value, limit);
        }
        let elapsed = tick.wrapping_sub(last);
        if elapsed != 1 {
            #[expect(clippy::cast_precision_loss, reason = "for display")]
            return fault(FaultCause::LateTick, None, elapsed.cast_signed() as f32, 1.0);
        }
        None
    }

    /// Checks the control and the command timeout, while enabled.
    pub(super) fn check_control(&mut self) -> Option<Fault> {
        let (Mode::Enabled(_), Some(robot)) = (self.state.mode, self.robot.loaded()) else {
            return None;
        };
        let tick = self.state.tick;
        for (index, joint) in (0..).zip(joints(robot, &mut self.state).each()) {
            if let Some((cause, value, limit)) = joint.check_control() {
                return Some(Fault { cause, joint: Some(index), value, limit, tick });
            }
        }
        self.state.silence = self.state.silence.saturating_add(1);
        #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
        let silence = self.state.silence as f32 * TICK;
        let limit = robot.model().safety.command_timeout;
        let late = silence > limit + 0.5 * TICK;
        late.then_some(Fault { cause: FaultCause::CommandTimeout, joint: None, value: silence, limit, tick })
    }

    /// The first joint whose torque is not finite.
    pub(super) fn find_not_finite(&self) -> Option<Fault> {
        let (index, state) = (0..)
            .zip(self.state.joints.iter().take(self.robot.joints().len()))
            .find(|(_, joint)| !joint.torque.is_finite())?;
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
        let state = &mut self.state;
        // The sensor also measures the inertial force of the mass on it.
        let gravity = match state.mode {
            Mode::Enabled(_) => self.robot.gravity() - state.task.acceleration(),
            _ => *self.robot.gravity(),
        };
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

/// A number of sensors that differs from the robot's: that number, and the robot's.
fn wrong_count(robot: &Robot, sensors: &SensorFrame) -> Option<(usize, usize)> {
    let (joints, forces) = (robot.joints().len(), robot.force_sensors());
    let counts =
        [(sensors.encoders.len(), joints), (sensors.currents.len(), joints), (sensors.forces.len(), forces)];
    counts.into_iter().find(|(got, expected)| got != expected)
}

/// Reads all force sensors into `measured` and stores the postures. `gravity` is relative to the acceleration
/// of the sensors [m/s²].
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
