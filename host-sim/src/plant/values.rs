use tesaki::model::{Encoder, JointModel, Motor};
pub use tesaki_description::plant::{
    CONTROL_PERIOD, ForceSensorValues, FrictionSizes, InnerLoop, Integration, LinkageValues, Mismatch, Noise,
    PlantValues, Supply,
};

use super::fixture::Fixture;
use tesaki_description::object::ObjectValues;

/// Number of sub-steps in a control period.
pub(super) fn steps(values: &PlantValues) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1000, see problems")]
    let steps = libm::round(CONTROL_PERIOD / values.integration.step) as usize;
    steps
}

/// Motor and encoder of a joint, as the controller knows them.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Name of the joint in the URDF.
    pub joint: String,
    /// The motor. Bandwidth and delay are the plant's own, see [`InnerLoop`].
    pub motor: Motor,
    /// The angle sensor.
    pub encoder: Encoder,
}

impl From<&JointModel> for Drive {
    fn from(joint: &JointModel) -> Self {
        Self { joint: joint.name.as_str().to_owned(), motor: joint.motor, encoder: joint.encoder }
    }
}

/// Options that differ between runs on one machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantOptions {
    /// Seed of factors, homing errors, power-on counts and noise.
    pub seed: u64,
    /// Whether masses, inertias, friction and torque constants differ from the model by seeded factors.
    pub mismatch: bool,
    /// Sensors without noise and homing without error. Counts stay whole numbers.
    pub ideal_sensors: bool,
    /// Coulomb friction of every joint instead of the URDF's [N·m].
    pub coulomb: Option<f64>,
    /// Initial joint angles instead of the file's [rad].
    pub posture: Option<Vec<f64>>,
    /// Whether the joints are held in place until the power stages are first switched on.
    pub held_at_start: bool,
    /// An object for the hand to grasp; not together with fixed bodies.
    pub object: Option<ObjectValues>,
    /// Fixed bodies that the links touch with their collision elements.
    pub fixtures: Vec<Fixture>,
}

impl PlantOptions {
    /// A mismatched plant with all sensor errors, held until the drives are on, as in acceptance runs.
    pub const fn mismatched(seed: u64) -> Self {
        Self {
            seed,
            mismatch: true,
            ideal_sensors: false,
            coulomb: None,
            posture: None,
            held_at_start: true,
            object: None,
            fixtures: Vec::new(),
        }
    }

    /// A plant that matches the model, with ideal sensors, held until the drives are on.
    pub const fn exact() -> Self {
        let mut options = Self::mismatched(0);
        options.mismatch = false;
        options.ideal_sensors = true;
        options
    }
}
