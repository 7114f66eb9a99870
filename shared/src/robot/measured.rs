use core::ops::Range;

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::Robot;
use crate::kinematics::{Chain, Posture};
use crate::model::{MAX_CHAINS, MAX_JOINTS};

/// Measured state of the robot in this tick, in SI units.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct Measured {
    /// Joint angles [rad].
    pub positions: [f32; MAX_JOINTS],
    /// Joint velocities [rad/s].
    pub velocities: [f32; MAX_JOINTS],
    /// External wrench on each chain's tip: force and moment about the tip's origin in base axes, without the
    /// weight on the force sensor [N, N·m]; 0 without a sensor.
    pub wrenches: [[f32; 6]; MAX_CHAINS],
    /// Bit `i` is set once the force sensor of chain `i` was tared.
    pub tared: u8,
}

impl Measured {
    /// Before the first measurement.
    pub const NONE: Self = Self {
        positions: [0.0; MAX_JOINTS],
        velocities: [0.0; MAX_JOINTS],
        wrenches: [[0.0; 6]; MAX_CHAINS],
        tared: 0,
    };

    /// Angles of these joints [rad].
    pub fn angles(&self, joints: Range<usize>) -> &[f32] {
        self.positions.get(joints).unwrap_or_default()
    }

    /// Velocities of these joints [rad/s].
    pub fn velocities(&self, joints: Range<usize>) -> &[f32] {
        self.velocities.get(joints).unwrap_or_default()
    }

    /// External force on the tip of a chain, in base axes [N].
    pub fn force(&self, chain: usize) -> Vector3<f32> {
        self.wrenches.get(chain).map_or_else(Vector3::zeros, |&[x, y, z, ..]| Vector3::new(x, y, z))
    }

    /// Whether the force sensor of the chain was tared.
    pub const fn is_tared(&self, chain: usize) -> bool {
        chain < MAX_CHAINS && self.tared >> chain & 1 != 0
    }

    /// The first chain with a force sensor that was not tared.
    pub fn untared(&self, robot: &Robot) -> Option<u8> {
        let mut chains = (0..).zip(&robot.model().chains);
        let found =
            chains.find(|(chain, model)| model.force_sensor.is_some() && !self.is_tared(usize::from(*chain)));
        found.map(|(chain, _)| chain)
    }
}

/// Torques of the drives beyond the model.
pub trait Efforts {
    /// The part of a joint's last torque that is due to feedback [N·m]: friction and weight that the model
    /// lacks, and external forces. 0 of commanded torques.
    fn effort(&self, joint: usize) -> f32;
}

/// Postures, at the measured angles, of the chains with a force sensor, which need them in every tick.
///
/// A cache outside the state: it depends on the angles only, and is cleared when these change between ticks.
#[derive(Clone, Debug)]
pub struct Postures([Option<Posture>; MAX_CHAINS]);

impl Postures {
    /// Empty.
    pub const NONE: Self = Self([const { None }; MAX_CHAINS]);

    /// Computes and stores the posture of `chain`, the robot's chain number `index`, at `angles` [rad].
    pub(crate) fn update(&mut self, index: usize, chain: &Chain, angles: &[f32]) -> Option<&Posture> {
        let entry = self.0.get_mut(index)?;
        let Some(posture) = entry else { return Some(entry.insert(chain.posture(angles))) };
        chain.update_posture(angles, posture);
        Some(posture)
    }

    /// Clears the cache, because the angles have changed.
    pub(crate) fn clear(&mut self) {
        self.0.iter_mut().for_each(|posture| *posture = None);
    }

    /// The cached posture of a chain.
    pub fn kept(&self, chain: usize) -> Option<&Posture> {
        self.0.get(chain)?.as_ref()
    }

    /// The posture of a chain at the measured angles; `None` without such a chain.
    pub fn of(&self, robot: &Robot, measured: &Measured, chain: usize) -> Option<Posture> {
        if let Some(posture) = self.kept(chain) {
            return Some(posture.clone());
        }
        robot.posture(chain, measured.angles(0..robot.joints().len()))
    }
}
