//! The robot at run time: preprocessed model, measured state, and targets of its joints.

mod fault_thresholds;
mod joint;
mod limit;
mod measured;
mod mimic;
mod targets;

pub(crate) use fault_thresholds::HYSTERESIS_SHARE;
pub use joint::JointConfig;
pub use limit::{Concerns, LimitRefusal};
pub use measured::{Efforts, Measured, Postures};
pub(crate) use mimic::Motion;
pub use targets::{Actuation, JointSetpoint, JointTarget, Targets};

use core::ops::Range;

use heapless::{String, Vec};
use nalgebra::Vector3;

use crate::control::ErrorObserver;
use crate::kinematics::{Chain, Finger, Hand};
use crate::model::{MAX_CHAINS, MAX_JOINTS, ModelError, ObserverGains, Reaction, RobotModel, Safety};

/// Gains of the tracking feedback under [`Actuation::Acceleration`]. It acts on accelerations: inertia 1. A
/// higher bandwidth tracks more closely and amplifies more measurement noise.
const TRACKING: ObserverGains = ObserverGains { inertia: 1.0, bandwidth: 40.0, observer_bandwidth: 160.0 };

/// Pointing direction of the fingertips of a [`Hand`] in their frames.
const POINTING: [f32; 3] = [0.0, 0.0, 1.0];
/// How far computed references stay inside the joints' limits [rad]. Homing may have an error of this size,
/// and a joint that is pressed against its mechanical stop looks blocked.
pub(crate) const STOP_MARGIN: f32 = 5e-3;

/// A validated model, preprocessed for computation; without joints before the first model.
///
/// Its size is about 21 kB, so it is configured in place and never moved.
// `repr(C)` and this order: the fields of every tick are within the immediate offset of a load.
#[repr(C)]
#[derive(Clone, Debug)]
pub struct Robot {
    gravity: Vector3<f32>,
    has_mimics: bool,
    force_sensors: usize,
    tracking: Option<ErrorObserver>,
    chains: Vec<ChainConfig, MAX_CHAINS>,
    joints: Vec<JointConfig, MAX_JOINTS>,
    model: RobotModel,
    /// At most one. (An empty list is all zero, which places a new node in `.bss`; `None` is not.)
    hand: Vec<Hand, 1>,
}

/// A chain, preprocessed for computation.
#[derive(Clone, Debug)]
pub struct ChainConfig {
    /// Kinematics and dynamics of all its joints, those without motor included.
    pub chain: Chain,
    /// Closed-form inverse kinematics, if the chain is a three-joint finger without mimic joints.
    pub finger: Option<Finger>,
    /// Whether some of its joints have no motor.
    pub has_mimics: bool,
    first: usize,
    /// Number of its joints with a motor.
    own: usize,
}

impl ChainConfig {
    /// Its joints with a motor, as indices into those of the robot.
    #[inline]
    pub fn joints(&self) -> Range<usize> {
        self.first..self.first + self.own
    }
}

impl Robot {
    /// No robot.
    pub const NONE: Self = Self {
        model: RobotModel {
            name: String::new(),
            gravity: [0.0; 3],
            chains: Vec::new(),
            joints: Vec::new(),
            mimics: Vec::new(),
            gauges: None,
            safety: Safety {
                command_timeout: 0.0,
                reaction: Reaction::Off,
                damping: 0.0,
                supply_min: 0.0,
                supply_max: 0.0,
            },
        },
        gravity: Vector3::new(0.0, 0.0, 0.0),
        chains: Vec::new(),
        joints: Vec::new(),
        force_sensors: 0,
        has_mimics: false,
        hand: Vec::new(),
        tracking: None,
    };

    /// Takes over `model` if it is valid.
    ///
    /// # Errors
    /// The first invalid field; the robot is unchanged then.
    pub fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError> {
        self.configure_on(model, &mut |_| Ok(()))
    }

    /// Takes over `model` if it is valid and `board` accepts it.
    ///
    /// # Errors
    /// The first invalid field, or the board's reason; the robot is unchanged then.
    #[inline(never)]
    pub fn configure_on(
        &mut self,
        model: &RobotModel,
        board: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> Result<(), ModelError> {
        model.validate()?;
        board(model)?;
        self.configure_chains(model);
        self.tracking = Some(ErrorObserver::with_lag(&TRACKING, 0.0));
        self.gravity = Vector3::from(model.gravity);
        self.force_sensors = model.chains.iter().filter(|chain| chain.force_sensor.is_some()).count();
        self.has_mimics = !model.mimics.is_empty();
        self.configure_hand(model);
        self.model.clone_from(model);
        Ok(())
    }

    /// Mass of all links [kg].
    pub(crate) fn mass(&self) -> f32 {
        self.chains.iter().flat_map(|config| &config.chain.links).map(|link| link.mass).sum()
    }

    /// Not inlined: the memory that it needs on the stack is free when that of the hand is needed.
    #[inline(never)]
    fn configure_chains(&mut self, model: &RobotModel) {
        self.chains.clear();
        self.joints.clear();
        // No list can overflow: the capacities are those of the model.
        for (index, range) in model.chain_ranges().enumerate() {
            let (first, own) = (range.start, range.len());
            let joints = model.joints.get(range).unwrap_or_default();
            let has_mimics = model.mimics_of(index).next().is_some();
            let chain = Chain::of_model(model, index);
            let finger = match joints {
                [a, b, c] if !has_mimics => {
                    let limits = [a, b, c].map(|joint| (joint.limits.lower, joint.limits.upper));
                    Finger::try_new(&chain, limits).ok()
                }
                _ => None,
            };
            let _ = self.chains.push(ChainConfig { chain, finger, has_mimics, first, own });
        }
        for joint in &model.joints {
            let _ = self.joints.push(JointConfig::new(joint, model.safety.damping));
        }
    }

    /// Not inlined: a hand takes 14 KB of the stack here.
    #[inline(never)]
    fn configure_hand(&mut self, model: &RobotModel) {
        self.hand.clear();
        if let Ok(hand) = Hand::of_model(model, POINTING, STOP_MARGIN)
            && hand.len() > 1
        {
            let _ = self.hand.push(hand);
        }
    }

    /// The robot; `None` before the first model.
    pub fn loaded(&self) -> Option<&Self> {
        if self.joints.is_empty() { None } else { Some(self) }
    }

    /// The model.
    pub const fn model(&self) -> &RobotModel {
        &self.model
    }

    /// Acceleration of gravity in the base frame [m/s²].
    pub const fn gravity(&self) -> &Vector3<f32> {
        &self.gravity
    }

    /// Its chains, in the order of the model.
    pub fn chains(&self) -> &[ChainConfig] {
        &self.chains
    }

    /// Its joints, chain after chain.
    pub fn joints(&self) -> &[JointConfig] {
        &self.joints
    }

    /// How many chains have a force sensor.
    pub const fn force_sensors(&self) -> usize {
        self.force_sensors
    }

    /// Whether a chain has a mimic joint.
    pub const fn has_mimics(&self) -> bool {
        self.has_mimics
    }

    /// Its chains as the fingers of a hand; `None` unless there are two to five, with at most one joint that
    /// moves several of them.
    pub fn hand(&self) -> Option<&Hand> {
        self.hand.first()
    }

    /// Tracking feedback of joints under [`Actuation::Acceleration`]; `None` before the first model.
    pub const fn tracking(&self) -> Option<&ErrorObserver> {
        self.tracking.as_ref()
    }

    /// Checks that a list has one entry for each joint.
    ///
    /// # Errors
    /// The list has another length.
    pub fn check_count(&self, got: usize) -> Result<(), LimitRefusal> {
        let expected = self.joints.len();
        if got == expected {
            Ok(())
        } else {
            Err(LimitRefusal::JointCount { got: count(got), expected: count(expected) })
        }
    }
}

/// Converts a number of joints or chains to the type on the wire.
#[expect(clippy::cast_possible_truncation, reason = "lists and robots have at most 16 joints")]
pub(crate) const fn count(number: usize) -> u8 {
    number as u8
}

const _: () = assert!(MAX_JOINTS <= u8::MAX as usize && MAX_CHAINS <= u8::BITS as usize);
