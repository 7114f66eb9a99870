use heapless::{String, Vec};
use nalgebra::Vector3;

use super::joint::JointConfig;
use super::tip::TipState;
use crate::arm::Arm;
use crate::control::ErrorObserver;
use crate::kinematics::{Chain, Finger};
use crate::manipulation::{FINGERS, Hand, HandFinger};
use crate::model::{MAX_CHAINS, MAX_JOINTS, ModelError, ObserverGains, Reaction, RobotModel, Safety};

/// How fast the joints of an arm are brought to where they should be, in accelerations: an inertia of 1.
const TRACKING: ObserverGains = ObserverGains { inertia: 1.0, bandwidth: 40.0, observer_bandwidth: 160.0 };

/// A validated model, made ready for computing; without joints until there is one.
///
/// It takes some 16 kB, so it is set up in place and never moved.
#[derive(Clone, Debug)]
pub struct Robot {
    model: RobotModel,
    pub(super) gravity: Vector3<f32>,
    /// With the closed-form inverse of those that have one.
    pub(super) chains: Vec<(Chain, Option<Finger>), MAX_CHAINS>,
    pub(super) joints: Vec<JointConfig, MAX_JOINTS>,
    /// How many chains have one.
    pub(super) force_sensors: usize,
    /// Of the joints of an arm whose dynamics are taken as a whole: it works on accelerations.
    tracking: Option<ErrorObserver>,
}

impl Robot {
    /// No robot yet.
    pub(super) const NONE: Self = Self {
        model: RobotModel {
            name: String::new(),
            gravity: [0.0; 3],
            chains: Vec::new(),
            joints: Vec::new(),
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
        tracking: None,
    };

    /// Becomes the robot of `model`, or stays what it was.
    ///
    /// # Errors
    /// The first thing that is wrong with the model, by joint and field.
    #[inline(never)]
    pub(super) fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError> {
        model.validate()?;
        self.chains.clear();
        self.joints.clear();
        // No list can overflow: the capacities are the model's own.
        for (chain, range) in model.chains.iter().zip(model.chain_ranges()) {
            let joints = model.joints.get(range).unwrap_or_default();
            let chain = Chain::new(joints, &chain.tip);
            let finger = match joints {
                [a, b, c] => {
                    let limits = [a, b, c].map(|joint| (joint.limits.lower, joint.limits.upper));
                    Finger::try_new(&chain, limits).ok()
                }
                _ => None,
            };
            let _ = self.chains.push((chain, finger));
        }
        for joint in &model.joints {
            let _ = self.joints.push(JointConfig::new(joint));
        }
        self.tracking = Some(ErrorObserver::with_lag(&TRACKING, 0.0));
        self.gravity = Vector3::from(model.gravity);
        self.force_sensors = model.chains.iter().filter(|chain| chain.force_sensor.is_some()).count();
        self.model.clone_from(model);
        Ok(())
    }

    /// Itself, once it has a model.
    pub(super) fn loaded(&self) -> Option<&Self> {
        if self.joints.is_empty() { None } else { Some(self) }
    }

    /// The hand that it is, if it has three fingers that feel.
    pub(super) fn hand(&self) -> Option<Hand<'_>> {
        let mut fingers = Vec::<HandFinger<'_>, FINGERS>::new();
        let joints = self.joints.chunks(FINGERS);
        for (((chain, inverse), model), joints) in self.chains.iter().zip(&self.model.chains).zip(joints) {
            model.force_sensor?;
            let [a, b, c] = joints else { return None };
            let finger = HandFinger {
                chain,
                inverse: inverse.as_ref()?,
                torque_limits: [a, b, c].map(|joint| joint.servo.torque_limit()),
                radius: model.tip_radius,
            };
            fingers.push(finger).ok()?;
        }
        let fingers = fingers.into_array().ok()?;
        Some(Hand { fingers, gravity: &self.gravity })
    }

    /// The arm that it is: a single chain of six or seven joints.
    pub(super) fn arm(&self) -> Option<Arm<'_>> {
        let [(chain, _)] = self.chains.as_slice() else { return None };
        if chain.len() < 6 {
            return None;
        }
        Some(Arm {
            chain,
            joints: &self.model.joints,
            gravity: &self.gravity,
            observer: self.tracking.as_ref()?,
        })
    }

    /// The first chain whose force sensor was not tared.
    pub(super) fn untared(&self, tips: &[TipState]) -> Option<u8> {
        let of_chains = (0..).zip(self.model.chains.iter().zip(tips));
        let mut untared = of_chains.filter(|(_, (chain, tip))| chain.force_sensor.is_some() && !tip.tared);
        untared.next().map(|(chain, _)| chain)
    }

    /// The model.
    pub const fn model(&self) -> &RobotModel {
        &self.model
    }
}
