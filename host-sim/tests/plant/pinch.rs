//! Two bars that squeeze a box between their tips, so that all forces can be calculated by hand.

use crate::hand::{Hand, frame_of, urdf};
use tesaki_description::urdf::Urdf;
use tesaki_sim::plant::{Drive, ObjectValues, Plant, PlantOptions, Shape};

/// Distance from a hinge to the centre of the tip [m].
pub const ARM: f64 = 0.1;
pub const RADIUS: f64 = 0.008;
/// The paper's box [m], [kg].
pub const SIZE: [f64; 3] = [0.098, 0.208, 0.060];
pub const MASS: f64 = 0.023;

/// Bars that hang down at both ends of x; their hinges turn about y. A positive torque moves a tip towards
/// +x.
fn bars() -> Urdf {
    let bar = |name: &str, x: f64| {
        format!(
            r#"<joint name="{name}" type="revolute"><origin xyz="{x} 0 0"/><parent link="base"/>
            <child link="{name}_bar"/><axis xyz="0 -1 0"/><limit lower="-1" upper="1" effort="2" velocity="6"/></joint>
            <link name="{name}_bar"><inertial><origin xyz="0 0 -0.05"/><mass value="0.03"/>
            <inertia ixx="2.5e-5" iyy="2.5e-5" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="{name}_mount" type="fixed"><origin xyz="0 0 -{ARM}"/><parent link="{name}_bar"/>
            <child link="{name}_tip"/></joint>
            <link name="{name}_tip"><inertial><mass value="0.005"/>
            <inertia ixx="1.28e-7" iyy="1.28e-7" izz="1.28e-7" ixy="0" ixz="0" iyz="0"/></inertial>
            <visual><geometry><sphere radius="{RADIUS}"/></geometry></visual></link>"#
        )
    };
    let x = SIZE[0] / 2.0 + RADIUS;
    let text =
        format!("<robot name=\"pinch\"><link name=\"base\"/>{}{}</robot>", bar("left", -x), bar("right", x));
    urdf(&text)
}

pub struct Pinch {
    pub plant: Plant,
}

impl Pinch {
    /// Creates the same with the centre of the box above the tips [m], and a sub-step [s].
    pub fn shifted(friction: f64, above: f64, step: f64) -> Self {
        Self::build(friction, 9.81, above, step)
    }

    /// Creates the box between the tips, `ARM` below the hinges, with gravity along −z [m/s²].
    pub fn new(friction: f64, gravity: f64) -> Self {
        Self::build(friction, gravity, 0.0, 0.001)
    }

    fn build(friction: f64, gravity: f64, above: f64, step: f64) -> Self {
        let object = ObjectValues {
            shape: Shape::Box,
            size: SIZE,
            mass: MASS,
            friction,
            friction_spread: 0.0,
            position: [0.0, 0.0, above - ARM],
            orientation: [0.0, 0.0, 0.0, 1.0],
            support: None,
        };
        let Hand { drives, mut values, .. } = Hand::exact();
        let drives: Vec<Drive> = ["left", "right"]
            .into_iter()
            .zip(drives)
            .map(|(joint, drive)| Drive { joint: joint.to_owned(), ..drive })
            .collect();
        values.gravity = [0.0, 0.0, -gravity];
        values.integration.step = step;
        values.posture.clear();
        let options = PlantOptions { held_at_start: false, object: Some(object), ..PlantOptions::exact() };
        Self { plant: Plant::new(&bars(), &drives, &values, &options).unwrap() }
    }

    /// Squeezes with the given force of each tip [N] for a number of control periods.
    pub fn squeeze(&mut self, force: f64, periods: u32) {
        let torque = force * ARM;
        for _ in 0..periods {
            self.plant.apply(&frame_of(&[torque as f32, -torque as f32])).unwrap();
        }
    }
}
