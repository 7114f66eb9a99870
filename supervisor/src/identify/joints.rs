//! The self-test after power-on: moves joints to and fro freely, to find the friction of any robot.

use nalgebra::Vector3;
use tesaki::control::ServoMode;
use tesaki::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, RobotModel};
use tesaki::protocol::{Mode, Request, Telemetry};
use tesaki::robot::Robot;
use tesaki::task::TaskConfig;
use tesaki_description::plant::CONTROL_PERIOD;

use super::procedure::{IdentifyError, Machine, Sense};
use super::regression::Reading;
use super::sweep::{Leg, Punctuality, Sweep, ranges, references};

/// Duration of a motion from one end to the other [s], and number of repetitions: two speeds, to separate
/// viscous friction.
const SWEEPS: [(f64, usize); 2] = [(0.8, 1), (0.4, 2)];
/// Duration of the motion back to the start [s].
const BACK: f64 = 0.4;
/// Change of the force on a tip that indicates a contact, as a fraction of its sensor's limit.
const TOUCH: f32 = 0.1;
/// Number of ticks after an irregular set-point in which a joint's torque says nothing about its friction or
/// about an obstacle: the reference stood still, and then leapt.
const UNREST: u32 = 5;
/// Number of ticks with irregular set-points that are permitted: so many, and one in so many of all ticks.
const IRREGULAR: (u32, u32) = (20, 20);

/// Settings for an identification of free joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// Amplitude of each joint's sweep to either side of its position [rad].
    pub amplitude: f64,
    /// Largest torque of a joint beyond the weight of its links according to the model, as a fraction of its
    /// limit.
    pub torque: f64,
}

impl Default for JointSettings {
    fn default() -> Self {
        Self { amplitude: 0.1, torque: 0.25 }
    }
}

/// Joints of different chains that sweep at the same time: the first joints of all chains, then the second,
/// ….
fn groups(model: &RobotModel) -> Vec<Vec<usize>> {
    let longest = model.chain_ranges().map(|range| range.len()).max().unwrap_or(0);
    let group = |place| model.chain_ranges().filter_map(|mut range| range.nth(place)).collect();
    (0..longest).map(group).collect()
}

/// Joints that move at the same time, and their motions.
type Group = (Vec<usize>, Vec<Leg>);

fn all_legs(
    model: &RobotModel,
    start: &[f64],
    settings: &JointSettings,
) -> Result<Vec<Group>, IdentifyError> {
    let ranges = ranges(model, start, settings.amplitude)?;
    // With the other joints held, the inertia may be twice as large; the rest is for friction and contacts.
    let torque = 0.3 * settings.torque;
    let legs = |joints: Vec<usize>| {
        let sweep = Sweep { model, start, ranges: &ranges, joints: &joints, torque };
        let legs = sweep.legs(&SWEEPS, BACK);
        (joints, legs)
    };
    Ok(groups(model).into_iter().map(legs).collect())
}

/// Returns the duration of [`identify_joints`] with the joints at `start` [s].
///
/// # Errors
/// A joint has no room for its sweep.
pub fn duration(model: &RobotModel, start: &[f64], settings: &JointSettings) -> Result<f64, IdentifyError> {
    let legs = all_legs(model, start, settings)?;
    Ok(legs.iter().flat_map(|(_, legs)| legs).map(|leg| f64::from(leg.ticks()) * CONTROL_PERIOD).sum())
}

/// Moves the joints of any robot without an object, and returns the readings of each joint, for
/// [`FreeJoint`](super::FreeJoint). The robot must be homed, and touch nothing.
///
/// The joints sweep to and fro, those at the same place in their chains at the same time, while the others
/// hold still. At the end the robot is at its initial position, and the board is still enabled: the caller
/// decides whether it may fall.
///
/// The readings near a set-point that came late are left out.
///
/// # Errors
/// The machine's error, or what prevents the identification: no room for a sweep, a joint that needs more
/// torque than allowed, a force on a tip, too many set-points that came late. The board may still be enabled
/// then.
pub fn identify_joints<M: Machine>(
    machine: &mut M,
    model: &RobotModel,
    settings: &JointSettings,
) -> Result<Vec<Vec<Reading>>, M::Error> {
    let mut robot = Box::new(Robot::NONE);
    robot.configure(model).map_err(IdentifyError::Model)?;
    machine.ask("enable its outputs", Request::Enable(TaskConfig::JointServo(ServoMode::Observer)))?;
    let first = machine.tick(Request::Keep)?;
    let start = references(model, &first.telemetry);
    let readings = vec![Vec::new(); model.joints.len()];
    let punctuality = Punctuality::new(&start, first.telemetry.tick);
    let mut test =
        SelfTest { model, robot, settings, readings, motion: 0, latest: Vec::new(), punctuality, unrest: 0 };
    for (joints, legs) in all_legs(model, &start, settings)? {
        let names: Vec<&str> = joints.iter().map(|&joint| model.joint_name(joint)).collect();
        machine.progress(&format!("{} sweep", names.join(", ")));
        for leg in legs {
            test.motion += 1;
            for request in leg.requests() {
                let sense = machine.tick(request.clone())?;
                test.watch(&request, &sense.telemetry)?;
                test.check(&first, &sense)?;
                test.take(&joints, sense.telemetry);
            }
        }
    }
    let Punctuality { irregular, ticks, .. } = test.punctuality;
    if irregular > 0 {
        machine.progress(&format!(
            "set-points came late in {irregular} of {ticks} ticks: this computer is busy; the readings near them \
             are left out"
        ));
    }
    Ok(test.readings)
}

struct SelfTest<'a> {
    model: &'a RobotModel,
    robot: Box<Robot>,
    settings: &'a JointSettings,
    /// Readings of each joint.
    readings: Vec<Vec<Reading>>,
    motion: usize,
    /// The latest telemetry, of as many ticks as an acceleration needs.
    latest: Vec<Telemetry>,
    punctuality: Punctuality,
    /// Number of ticks that follow in which the torques still are those after an irregular set-point.
    unrest: u32,
}

impl SelfTest<'_> {
    /// Notes whether the set-point was in time; fails if too many were not.
    fn watch(&mut self, request: &Request, telemetry: &Telemetry) -> Result<(), IdentifyError> {
        self.unrest = self.unrest.saturating_sub(1);
        if !self.punctuality.is_regular(request, telemetry) {
            self.unrest = UNREST;
        }
        let Punctuality { irregular, ticks, .. } = self.punctuality;
        let limit = IRREGULAR.0 + ticks / IRREGULAR.1;
        if irregular > limit { Err(IdentifyError::Late { irregular, ticks, limit }) } else { Ok(()) }
    }

    /// Fails if the robot touches something, or is no longer enabled.
    fn check(&self, first: &Sense, sense: &Sense) -> Result<(), IdentifyError> {
        let mode = sense.telemetry.mode;
        if !matches!(mode, Mode::Enabled(_)) {
            return Err(IdentifyError::Stopped(mode));
        }
        let weights = self.weights(&sense.telemetry);
        let joints = sense.telemetry.joints.iter().zip(&self.model.joints).zip(weights);
        for ((state, joint), weight) in joints {
            let torque = f64::from(state.torque) - weight;
            let limit = self.settings.torque * f64::from(joint.torque_limit());
            if torque.abs() > limit && self.unrest == 0 {
                let (joint, position) = (joint.name.to_string(), state.position.into());
                return Err(IdentifyError::Resisted { joint, position, torque, limit });
            }
        }
        let tips = first.tips.tips.iter().zip(&sense.tips.tips).zip(&self.model.chains);
        for ((first, tip), chain) in tips {
            let Some(sensor) = &chain.force_sensor else { continue };
            let (force, limit) = (difference(first.force, tip.force), TOUCH * sensor.force_limit);
            if force > limit {
                let tip = chain.name.to_string();
                return Err(IdentifyError::Touched { tip, force: force.into(), limit: limit.into() });
            }
        }
        Ok(())
    }

    /// Takes the telemetry of the next tick, and adds a reading for the period between the second and the
    /// third of four ticks, in which the torques of the second acted.
    fn take(&mut self, joints: &[usize], telemetry: Telemetry) {
        if self.unrest > 0 {
            self.latest.clear();
            return;
        }
        // A frame may have been lost: earlier torques do not belong to the present readings.
        if self.latest.last().is_some_and(|last| last.tick.wrapping_add(1) != telemetry.tick) {
            self.latest.clear();
        }
        self.latest.push(telemetry);
        let [before, begin, end, after] = self.latest.as_slice() else { return };
        let weights = self.weights(begin).into_iter().zip(self.weights(end));
        let weights: Vec<f64> = weights.map(|(begin, end)| 0.5 * (begin + end)).collect();
        for &joint in joints {
            let position =
                |telemetry: &Telemetry| telemetry.joints.get(joint).map(|joint| f64::from(joint.position));
            let positions = [before, begin, end, after].map(position);
            let [Some(before), Some(at), Some(next), Some(after)] = positions else { continue };
            let mut reading = Reading {
                motion: self.motion,
                torque: begin.joints[joint].torque.into(),
                load: 0.0,
                velocity: (next - at) / CONTROL_PERIOD,
                acceleration: (after - next - at + before) / (2.0 * CONTROL_PERIOD * CONTROL_PERIOD),
                weights: [0.0; MAX_CHAIN_JOINTS],
            };
            reading.weights[0] = weights[joint];
            self.readings[joint].push(reading);
        }
        self.latest.remove(0);
    }

    /// Computes the torques of the links' weight by the model [N·m].
    fn weights(&self, telemetry: &Telemetry) -> [f64; MAX_JOINTS] {
        let angles: Vec<f32> = telemetry.joints.iter().map(|joint| joint.position).collect();
        self.robot.gravity_torques(&angles).map(f64::from)
    }
}

fn difference(first: [f32; 3], second: [f32; 3]) -> f32 {
    (Vector3::from(second) - Vector3::from(first)).norm()
}
