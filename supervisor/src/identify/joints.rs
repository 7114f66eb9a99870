//! The self-test after power-on: joints to and fro in free motion, for the friction of any robot.

use nalgebra::Vector3;
use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Request};
use tesaki::task::TaskConfig;

use super::procedure::{IdentifyError, Machine, Sense, TICK};
use super::regression::Reading;
use super::sweep::{Leg, Sweep, ranges, references};
use crate::gravity;

/// Times of a way from one end to the other [s], and how often to and fro: two speeds, so that viscous friction shows.
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

fn all_legs(
    model: &RobotModel,
    start: &[f64],
    amplitude: f64,
) -> Result<Vec<(Vec<usize>, Vec<Leg>)>, IdentifyError> {
    let ranges = ranges(model, start, amplitude)?;
    let legs = |joints: Vec<usize>| {
        let sweep = Sweep { model, start, ranges: &ranges, joints: &joints };
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
    let legs = all_legs(model, start, settings.amplitude)?;
    Ok(legs.iter().flat_map(|(_, legs)| legs).map(|leg| f64::from(leg.ticks()) * TICK).sum())
}

/// Moves the joints of any robot alone: readings of each joint, for [`fit_free`](super::fit_free). Nothing touches the
/// robot, which is homed.
///
/// The joints sweep to and fro, those at the same place in their chains at the same time, while the others hold still.
/// In the end the robot stands where it stood, and the board is still enabled: the caller decides whether it may fall.
///
/// # Errors
/// The machine's error, or what prevents the identification: no room for a sweep, a joint that needs more torque than it
/// may, a force on a tip. The board may still be enabled then.
pub fn identify_joints<M: Machine>(
    machine: &mut M,
    model: &RobotModel,
    settings: &JointSettings,
) -> Result<Vec<Vec<Reading>>, M::Error> {
    machine.ask("enable its outputs", Request::Enable(TaskConfig::JointServo(ServoMode::Observer)))?;
    let first = machine.tick(Request::Keep)?;
    let start = references(model, &first.telemetry);
    let mut test = SelfTest { model, settings, readings: vec![Vec::new(); model.joints.len()], motion: 0 };
    let mut before = first.clone();
    for (joints, legs) in all_legs(model, &start, settings.amplitude)? {
        let names: Vec<&str> = joints.iter().map(|&joint| model.joint_name(joint)).collect();
        machine.progress(&format!("{} sweep", names.join(", ")));
        for leg in legs {
            test.motion += 1;
            for request in leg.requests() {
                let sense = machine.tick(request)?;
                test.check(&first, &sense)?;
                // A frame may have been lost: the torques before the last ones say nothing about what is sensed now.
                if sense.telemetry.tick == before.telemetry.tick.wrapping_add(1) {
                    test.take(&joints, &before, &sense);
                }
                before = sense;
            }
        }
    }
    Ok(test.readings)
}

struct SelfTest<'a> {
    model: &'a RobotModel,
    settings: &'a JointSettings,
    /// Of each joint.
    readings: Vec<Vec<Reading>>,
    motion: usize,
}

impl SelfTest<'_> {
    /// Fails when the robot touches something, or is no longer enabled.
    fn check(&self, first: &Sense, sense: &Sense) -> Result<(), IdentifyError> {
        let mode = sense.telemetry.mode;
        if !matches!(mode, Mode::Enabled(_)) {
            return Err(IdentifyError::Stopped(mode));
        }
        let weights = self.weights(sense);
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

    /// Takes in what was sensed after the torques of `before` had acted.
    fn take(&mut self, joints: &[usize], before: &Sense, sense: &Sense) {
        let weights = self.weights(sense);
        for &joint in joints {
            let Some(told) = before.telemetry.joints.get(joint) else { return };
            let Some(state) = sense.telemetry.joints.get(joint) else { return };
            let mut reading = Reading {
                motion: self.motion,
                torque: told.torque.into(),
                load: 0.0,
                velocity: state.velocity.into(),
                weights: Default::default(),
            };
            reading.weights[0] = weights.get(joint).copied().unwrap_or(0.0);
            self.readings[joint].push(reading);
        }
    }

    /// The torques of the links' weight, by the model [N·m].
    fn weights(&self, sense: &Sense) -> Vec<f64> {
        let angles: Vec<f32> = sense.telemetry.joints.iter().map(|joint| joint.position).collect();
        gravity::torques(self.model, &angles).map(f64::from).to_vec()
    }
}

fn difference(first: [f32; 3], second: [f32; 3]) -> f32 {
    (Vector3::from(second) - Vector3::from(first)).norm()
}
