//! A robot as multibodies of rapier, one for each joint of the base, with all links behind it.

use rapier3d::dynamics::{
    GenericJointBuilder, JointAxesMask, JointAxis, MassProperties, Multibody, MultibodyJointHandle,
    RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d::na::{Isometry3, UnitQuaternion, Vector3};
use rapier3d::pipeline::PhysicsWorld;

use super::convert::{mass_properties, narrow, pose};
use super::factors::JointFactors;
use super::tree::Body;

/// Parameters of a joint in the physics engine.
pub struct JointValues {
    /// Reflected inertia of the rotor [kg·m²].
    pub rotor_inertia: f64,
    /// Coulomb friction [N·m].
    pub coulomb: f64,
    /// Viscous friction [N·m·s/rad].
    pub viscous: f64,
}

/// What a robot is put together from, in the order of its bodies.
pub struct Parts<'a> {
    pub bodies: &'a [Body],
    pub values: &'a [JointValues],
    pub factors: &'a [JointFactors],
    /// Joint angles [rad].
    pub posture: &'a [f64],
}

/// Rapier's multibodies.
pub struct Assembly {
    pub physics: PhysicsWorld,
    pub joints: Vec<Handles>,
}

/// Rapier's names of a joint and of the body behind it.
pub struct Handles {
    pub handle: MultibodyJointHandle,
    pub body: RigidBodyHandle,
}

impl Assembly {
    /// Puts the robot together, for sub-steps of `step` seconds.
    pub fn new(step: f64, Parts { bodies, values, factors, posture }: &Parts<'_>) -> Self {
        let mut physics = PhysicsWorld::default();
        let mut joints: Vec<Handles> = Vec::new();
        for (body, factors) in bodies.iter().zip(*factors) {
            let parent = match body.parent.and_then(|parent| joints.get(parent)) {
                Some(parent) => parent.body,
                None => physics.insert_body(RigidBodyBuilder::fixed()),
            };
            let handle = physics.insert_body(
                RigidBodyBuilder::dynamic().additional_mass_properties(mass(body, factors)).can_sleep(false),
            );
            // Rapier's joints turn about the x axis of their own frame.
            let turn = UnitQuaternion::rotation_between(&Vector3::x(), &body.axis).unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::PI)
            });
            let turn = Isometry3::from_parts(Vector3::zeros().into(), turn);
            let mut joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
                .local_frame1(pose(&(body.origin * turn)))
                .local_frame2(pose(&turn))
                .contacts_enabled(false);
            if let Some(stops) = body.stops {
                joint = joint.limits(JointAxis::AngX, stops.map(narrow));
            }
            if let Some(joint) = physics.multibody_joints.insert(parent, handle, joint, true) {
                joints.push(Handles { handle: joint, body: handle });
            }
        }
        let mut assembly = Self { physics, joints };
        assembly.set_posture(posture);
        assembly.set_values(values, step);
        // Otherwise, in the first step, rapier would use the mass properties with which a body was built.
        for joint in &assembly.joints {
            if let Some(body) = assembly.physics.bodies.get_mut(joint.body) {
                body.recompute_mass_properties_from_colliders(&assembly.physics.colliders);
            }
        }
        assembly
    }

    /// Moves the joints, which are at 0, to `posture`.
    fn set_posture(&mut self, posture: &[f64]) {
        for (joint, angle) in self.joints.iter().zip(posture) {
            if let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) {
                // Once the root is marked as fixed, degrees of freedom count from the first joint.
                chain.forward_kinematics(&self.physics.bodies, true);
                let mut displacements = vec![0.0; chain.ndofs()];
                if let Some(displacement) = first_dof(chain, link).and_then(|dof| displacements.get_mut(dof))
                {
                    *displacement = narrow(*angle);
                }
                chain.apply_displacements(&displacements);
                chain.forward_kinematics(&self.physics.bodies, false);
                chain.update_rigid_bodies(&mut self.physics.bodies, true);
            }
        }
    }

    fn set_values(&mut self, values: &[JointValues], step: f64) {
        for (joint, values) in self.joints.iter().zip(values) {
            let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) else { continue };
            let Some(dof) = first_dof(chain, link) else { continue };
            chain.damping_mut()[dof] = narrow(values.viscous);
            // Rapier computes damping from the velocity at the end of the kick; this makes it the mean of
            // both ends.
            chain.armature_mut()[dof] = narrow(values.rotor_inertia - 0.5 * values.viscous * step);
            chain.frictions_mut()[dof] = narrow(values.coulomb);
        }
    }
}

/// Index of a link's degree of freedom in its multibody: links are in order, and the root has none.
fn first_dof(chain: &Multibody, link: usize) -> Option<usize> {
    let dof = link.checked_sub(1)?;
    (dof < chain.ndofs()).then_some(dof)
}

fn mass(body: &Body, factors: &JointFactors) -> MassProperties {
    mass_properties(body.mass * factors.mass, &body.center_of_mass, body.inertia * factors.inertia)
}
