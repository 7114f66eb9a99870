use heapless::Vec;
use nalgebra::Vector3;

use super::joint::JointConfig;
use crate::dynamics::Chain;
use crate::model::{MAX_CHAINS, MAX_JOINTS, ModelError, RobotModel};

/// A validated model, made ready for computing.
#[derive(Clone, Debug)]
pub struct Robot {
    model: RobotModel,
    pub(super) gravity: Vector3<f32>,
    pub(super) chains: Vec<Chain, MAX_CHAINS>,
    pub(super) joints: Vec<JointConfig, MAX_JOINTS>,
}

impl Robot {
    /// Validates `model`.
    ///
    /// # Errors
    /// The first thing that is wrong with the model, by joint and field.
    pub fn try_new(model: RobotModel) -> Result<Self, ModelError> {
        model.validate()?;
        // Neither `collect` can overflow: the capacities are the model's own.
        let chains = model
            .chain_ranges()
            .map(|range| Chain::new(model.joints.get(range).unwrap_or_default()))
            .collect();
        let joints = model.joints.iter().map(JointConfig::new).collect();
        Ok(Self { gravity: Vector3::from(model.gravity), chains, joints, model })
    }

    /// The model.
    pub const fn model(&self) -> &RobotModel {
        &self.model
    }
}
