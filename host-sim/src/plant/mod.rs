//! The simulated machine: rigid-body dynamics, drives and sensors of a robot.
//!
//! A [`Plant`] is built from a robot's URDF, the motors and encoders that its controller knows, and its
//! `plant.toml` ([`PlantValues`]). It shares no dynamics code with the control core: its equations are
//! rapier's. Masses, inertias, friction and torque constants differ from the model by seeded factors, and the
//! controller receives the sensor readings of a board: whole counts, with noise. While a robot without an
//! object touches nothing, its motion is that of rapier to the last bit. Contacts are found by rapier's
//! geometry and have its springs, but their impulses, and those of joint friction and stops with them, are
//! more accurate.
//!
//! ```text
//!  ActuatorFrame ─► torque / torque constant ─► delay ─► current loop ─► × true torque constant ─┐
//!  SensorFrame ◄─────────────────────────────────────────────────────────────────────── links ◄─┘
//! ```
//!
//! # Time
//! [`Plant::sensors`] reads the state at the start of a control period, and [`Plant::apply`] advances over
//! the period; the commanded torque begins to act [`InnerLoop::delay`] after the reading. The physics'
//! sub-step `h` is a leapfrog: angles belong to the ends of a sub-step, velocities to its middle. The torque
//! of a sub-step is therefore the mean over the time from `h/2` before its start to `h/2` after, which makes
//! smooth motions exact to second order. ([`Truth::velocities`] are accordingly `h/2` old.)
//!
//! # Friction
//! Coulomb friction is a constraint with a bound, not a function of velocity: a joint whose torque is below
//! the bound stays at rest and does not creep.
//!
//! # Elasticity
//! A joint with a stiffness in [`PlantValues::elasticity`] has its encoder at the motor: the encoder reads
//! the angle of the link plus the deflection under the motor's torque. The deflection is quasi-static; the
//! vibration of the link against the rotor is not modelled.
//!
//! # Contact
//! With an object in [`PlantOptions`], each spherical fingertip of the URDF touches it, and so does its
//! support. Coulomb friction is again a constraint: a contact sticks without creep, or slides against its
//! friction.
//!
//! With [`PlantOptions::fixtures`], the boxes, cylinders and spheres among the `<collision>` elements of the
//! moving links touch these fixed bodies, with Coulomb friction at each point of a face or an edge; meshes
//! and capsules touch nothing. [`Plant::fixture_contacts`] returns the forces; force sensors do not feel
//! them.
//!
//! There are no other contacts: links and tips pass through each other and through the object's support. A
//! plant has either an object or fixed bodies.
//!
//! # Walls, holds, pushes
//! [`Wall`]s, [`Hold`]s and [`Push`]es act on the tips by springs, dampers and forces in every sub-step; a
//! force sensor behind the tip measures them. They begin and end between control periods.

mod assembly;
mod constraints;
mod contact;
mod convert;
mod current_loop;
mod drive;
mod end_effector;
mod energy;
mod environment;
mod error;
mod factors;
mod fixture;
mod force;
mod grasp;
mod intervention;
mod kinematics;
mod linkage;
mod links;
mod lu;
mod machine;
mod motion;
mod multibody;
mod narrow_phase;
mod outside_drive;
mod push;
mod rigid_body;
mod shapes;
mod tree;
mod truth;
mod values;
mod world;

pub(crate) use convert::{isometry, unit_quaternion};
pub use environment::{Hold, Wall};
pub use error::PlantError;
pub use factors::JointFactors;
pub use fixture::{Fixture, FixtureContact, FixtureShape};
pub use intervention::{Intervention, SharedIntervention};
pub use machine::Plant;
pub use push::{Load, Push};
pub use tesaki_description::object::{ObjectValues, Shape, Support};
pub use truth::{ContactTruth, ObjectTruth, TipTruth, Truth};
pub use values::{
    CONTROL_PERIOD, Drive, ForceSensorValues, FrictionSizes, InnerLoop, Integration, LinkageValues, Mismatch,
    Noise, PlantOptions, PlantValues, Supply,
};
