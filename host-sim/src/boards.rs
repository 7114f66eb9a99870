//! One machine on several boards, with one chain each.

use tesaki::model::RobotModel;
use tesaki::protocol::{ActuatorFrame, SensorFrame};
use tesaki_supervisor::BoardError;

use crate::controller::Controller;
use crate::plant::{Plant, PlantError};

/// Why the boards or the machine stopped.
#[derive(Debug, thiserror::Error)]
pub enum BoardsError {
    /// A board failed.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The plant failed.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

/// Splits a sensor frame into one per chain's board: the readings of its joints and its fingertip.
fn share_sensors(robot: &RobotModel, frame: &SensorFrame) -> Vec<SensorFrame> {
    let mut forces = frame.forces.iter();
    let chains = robot.chains.iter().zip(robot.chain_ranges());
    let of_chain = |(chain, range): (&tesaki::model::ChainModel, std::ops::Range<usize>)| SensorFrame {
        sequence: frame.sequence,
        flags: frame.flags,
        supply: frame.supply,
        encoders: frame.encoders.get(range.clone()).unwrap_or_default().iter().copied().collect(),
        currents: frame.currents.get(range).unwrap_or_default().iter().copied().collect(),
        forces: chain.force_sensor.and_then(|_| forces.next()).into_iter().copied().collect(),
    };
    chains.map(of_chain).collect()
}

/// Joins the boards' frames into one for the whole machine; the joints of a board that is off, or has no
/// model, get no torque.
fn join_actuators(robot: &RobotModel, sequence: u32, frames: &[ActuatorFrame]) -> ActuatorFrame {
    let mut joined = ActuatorFrame { sequence, ..ActuatorFrame::default() };
    for (range, frame) in robot.chain_ranges().zip(frames) {
        let drives = frame.enabled && frame.torques.len() == range.len();
        joined.enabled |= drives;
        for index in 0..range.len() {
            let torque = if drives { frame.torques.get(index).copied().unwrap_or(0.0) } else { 0.0 };
            // Never full, because a robot has no more joints than a frame.
            let _ = joined.torques.push(torque);
        }
    }
    joined
}

/// Runs one control period of a machine whose chains are on these boards, in their order. `spoil` may falsify
/// the readings of a board.
///
/// # Errors
/// A board or the plant fails.
pub fn tick<'a>(
    robot: &RobotModel,
    plant: &mut Plant,
    sequence: u32,
    boards: impl IntoIterator<Item = &'a mut (dyn Controller + 'a)>,
    mut spoil: impl FnMut(usize, &mut SensorFrame),
) -> Result<(), BoardsError> {
    let mut shares = share_sensors(robot, &plant.sensors(sequence));
    let mut frames = Vec::new();
    for (index, (board, fraction)) in boards.into_iter().zip(&mut shares).enumerate() {
        spoil(index, fraction);
        frames.push(board.tick(fraction)?);
    }
    Ok(plant.apply(&join_actuators(robot, sequence, &frames))?)
}
