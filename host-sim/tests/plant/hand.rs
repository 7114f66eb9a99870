use std::path::Path;

use tesaki::model::{Encoder, Motor};
use tesaki::protocol::ActuatorFrame;
use tesaki_description::urdf::Urdf;
use tesaki_sim::plant::{Drive, Plant, PlantOptions, PlantValues};

pub const JOINTS: usize = 9;
pub const URDF: &str = include_str!("../../../robots/hand3/robot.urdf");
pub const VALUES: &str = include_str!("../../../robots/hand3/plant.toml");

/// Reads a URDF whose links form a tree.
pub fn urdf(text: &str) -> Urdf {
    let (urdf, findings) = Urdf::check(Path::new("robot.urdf"), text);
    urdf.unwrap_or_else(|| panic!("{findings:?}"))
}

/// All parts of the hand's plant, for tests to change.
pub struct Hand {
    pub urdf: Urdf,
    pub drives: Vec<Drive>,
    pub values: PlantValues,
    pub options: PlantOptions,
}

impl Hand {
    /// A hand that matches the model, with ideal sensors, not held at the start.
    pub fn exact() -> Self {
        let drives = (1..=3).flat_map(|finger| {
            ["swing", "bend", "curl"].map(|joint| Drive {
                joint: format!("finger{finger}_{joint}"),
                motor: Motor {
                    rotor_inertia: 2e-4,
                    torque_constant: 0.5,
                    current_limit: 1.5,
                    current_resolution: 1e-3,
                    bandwidth: 300.0,
                    delay: 3e-4,
                    resistance: None,
                    inductance: None,
                },
                encoder: Encoder { counts_per_turn: 65536.0, reversed: false, zero: 0, relative: false },
            })
        });
        Self {
            urdf: urdf(URDF),
            drives: drives.collect(),
            values: PlantValues::from_toml(VALUES).unwrap(),
            options: PlantOptions { held_at_start: false, ..PlantOptions::exact() },
        }
    }

    pub fn mismatched(seed: u64) -> Self {
        Self {
            options: PlantOptions { held_at_start: false, ..PlantOptions::mismatched(seed) },
            ..Self::exact()
        }
    }

    pub fn weightless(mut self) -> Self {
        self.values.gravity = [0.0; 3];
        self
    }

    pub fn viscous(mut self, viscous: f64) -> Self {
        for dynamics in self.urdf.robot.joints.iter_mut().filter_map(|joint| joint.dynamics.as_mut()) {
            dynamics.damping = viscous;
        }
        self
    }

    pub fn coulomb(mut self, coulomb: f64) -> Self {
        self.options.coulomb = Some(coulomb);
        self
    }

    pub fn build(&self) -> Plant {
        Plant::new(&self.urdf, &self.drives, &self.values, &self.options).unwrap()
    }
}

pub fn frame(torques: [f32; JOINTS]) -> ActuatorFrame {
    frame_of(&torques)
}

pub fn frame_of(torques: &[f32]) -> ActuatorFrame {
    ActuatorFrame { sequence: 0, enabled: true, torques: torques.iter().copied().collect() }
}

/// Returns the largest absolute value.
pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |largest, value| f64::max(largest, value.abs()))
}
