//! The self-test after power-on: joints to and fro in free motion, for the friction of any robot.

use nalgebra::Vector3;
use tesaki::control::ServoMode;
use tesaki::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, RobotModel};
use tesaki::protocol::{Mode, Request, Telemetry};
use tesaki::robot::Robot;
use tesaki::task::TaskConfig;

use super::procedure::{IdentifyError, Machine, Sense, TICK};
use super::regression::Reading;
use super::sweep::{Leg, Sweep, ranges, references};

/// Times of a way from one end to the other [s], and how often to and fro: two speeds, so that viscous
/// friction shows.
const SWEEPS: [(f64, usize); 2] = [(0.8, 1), (0.4, 2)];
/// Time of the way back to where the joint stood [s].
const BACK: f64 = 0.4;
/// Change of the force on a tip that is a contact, as a fraction of its sensor's limit.
const TOUCH: f32 = 0.1;

/// What an identification of free joints may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// How far each joint is swept to either side of where it stands [rad].
    pub amplitude: f64,
    /// Largest torque of a joint beyond the weight of its links by the model, as a fraction of its limit.
    pub torque: f64,
}

impl Default for JointSettings {
    fn default() -> Self {
        Self { amplitude: 0.1, torque: 0.25 }
    }
}

/// Joints of different chains that sweep at the same time: the first of each chain, then the second, ….
fn groups(model: &RobotModel) -> Vec<Vec<usize>> {
    let longest = model.chain_ranges().map(|range| range.len()).max().unwrap_or(0);
    let group = |place| model.chain_ranges().filter_map(|mut range| range.nth(place)).collect();
    (0..longest).map(group).collect()
}

/// Joints that move at the same time, and their ways.
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

/// How long [`identify_joints`] takes with the joints at `start` [s].
///
/// # Errors
/// A joint has no room.
pub fn duration(model: &RobotModel, start: &[f64], settings: &JointSettings) -> Result<f64, IdentifyError> {
    let legs = all_legs(model, start, settings)?;
    Ok(legs.iter().flat_map(|(_, legs)| legs).map(|leg| f64::from(leg.ticks()) * TICK).sum())
}

/// Moves the joints of any robot alone: readings of each joint, for [`FreeJoint`](super::FreeJoint). Nothing
/// touches the robot, which is homed.
///
/// The joints sweep to and fro, those at the same place in their chains at the same time, while the others
/// hold still. In the end the robot stands where it stood, and the board is still enabled: the caller decides
/// whether it may fall.
///
/// # Errors
/// The machine's error, or what prevents the identification: no room for a sweep, a joint that needs more
/// torque than it may, a force on a tip. The board may still be enabled then.
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
    let mut test = SelfTest { model, robot, settings, readings, motion: 0, latest: Vec::new() };
    for (joints, legs) in all_legs(model, &start, settings)? {
        let names: Vec<&str> = joints.iter().map(|&joint| model.joint_name(joint)).collect();
        machine.progress(&format!("{} sweep", names.join(", ")));
        for leg in legs {
            test.motion += 1;
            for request in leg.requests() {
                let sense = machine.tick(request)?;
                test.check(&first, &sense)?;
                test.take(&joints, sense.telemetry);
            }
        }
    }
    Ok(test.readings)
}

struct SelfTest<'a> {
    model: &'a RobotModel,
    robot: Box<Robot>,
    settings: &'a JointSettings,
    /// Of each joint.
    readings: Vec<Vec<Reading>>,
    motion: usize,
    /// The latest telemetry, of as many ticks as an acceleration takes.
    latest: Vec<Telemetry>,
}

impl SelfTest<'_> {
    /// Fails when the robot touches something, or is no longer enabled.
    fn check(&self, first: &Sense, sense: &Sense) -> Result<(), IdentifyError> {
        let mode = sense.telemetry.mode;
        if !matches!(mode, Mode::Enabled(_)) {
            return Err(IdentifyError::Stopped(mode));
        }
        let weights = self.weights(&sense.telemetry);
        let joints = sense.telemetry.joints.iter().zip(&self.model.joints).zip(weights);
        for ((state, joint), weight) in joints {
            let torque = f64::from(state.torque) - weight;
            let limit = self.settings.torque * f64::from(joint.limits.torque);
            if torque.abs() > limit {
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

    /// Takes in the telemetry of the next tick: a reading of the period between the second and the third of
    /// four ticks, in which the torques of the second acted.
    fn take(&mut self, joints: &[usize], telemetry: Telemetry) {
        // A frame may have been lost: torques from before it say nothing about what is sensed now.
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
                velocity: (next - at) / TICK,
                acceleration: (after - next - at + before) / (2.0 * TICK * TICK),
                weights: [0.0; MAX_CHAIN_JOINTS],
            };
            reading.weights[0] = weights[joint];
            self.readings[joint].push(reading);
        }
        self.latest.remove(0);
    }

    /// The torques of the links' weight, by the model [N·m].
    fn weights(&self, telemetry: &Telemetry) -> [f64; MAX_JOINTS] {
        let angles: Vec<f32> = telemetry.joints.iter().map(|joint| joint.position).collect();
        self.robot.weight(&angles).map(f64::from)
    }
}

fn difference(first: [f32; 3], second: [f32; 3]) -> f32 {
    (Vector3::from(second) - Vector3::from(first)).norm()
}
