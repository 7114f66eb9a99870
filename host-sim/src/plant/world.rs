//! The physics: rapier multibodies, one for each joint that leaves the base and all behind it.

use rapier3d::dynamics::{
    GenericJointBuilder, JointAxesMask, JointAxis, MassProperties, MultibodyJointHandle, RigidBodyBuilder,
    RigidBodyHandle,
};
use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::na::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use rapier3d::pipeline::PhysicsWorld;

use super::factors::JointFactors;
use super::tree::Body;

/// Sweeps over the constraints in a sub-step. Dry friction in the joints of a chain is coupled: with too few sweeps
/// joints that should stand creep.
const SWEEPS: usize = 8;

/// What a joint of the physics is made of.
pub struct JointValues {
    /// Reflected inertia of the rotor [kg·m²].
    pub rotor_inertia: f64,
    /// Coulomb friction [N·m].
    pub coulomb: f64,
    /// Viscous friction [N·m·s/rad].
    pub viscous: f64,
}

/// Moving bodies and their joints.
pub struct World {
    physics: PhysicsWorld,
    joints: Vec<Joint>,
    gravity: Vector,
    started: bool,
}

struct Joint {
    handle: MultibodyJointHandle,
    body: RigidBodyHandle,
    parent: RigidBodyHandle,
    /// In the frame of the body.
    axis: Vector,
}

impl World {
    pub fn new(
        gravity: [f64; 3],
        step: f64,
        bodies: &[Body],
        values: &[JointValues],
        factors: &[JointFactors],
        posture: &[f64],
    ) -> Self {
        let mut physics = PhysicsWorld::default();
        let parameters = &mut physics.integration_parameters;
        parameters.dt = narrow(step);
        parameters.num_solver_iterations = 1;
        parameters.num_internal_pgs_iterations = SWEEPS;
        parameters.num_internal_stabilization_iterations = 0;
        parameters.normalized_max_linear_velocity = f32::MAX;

        let mut joints: Vec<Joint> = Vec::new();
        for (body, factors) in bodies.iter().zip(factors) {
            let parent = match body.parent.and_then(|parent| joints.get(parent)) {
                Some(parent) => parent.body,
                None => physics.insert_body(RigidBodyBuilder::fixed()),
            };
            let handle = physics.insert_body(
                RigidBodyBuilder::dynamic().additional_mass_properties(mass(body, factors)).can_sleep(false),
            );
            // Rapier turns about x of a joint frame of its own.
            let turn = UnitQuaternion::rotation_between(&Vector3::x(), &body.axis).unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::PI)
            });
            let turn = Isometry3::from_parts(Vector3::zeros().into(), turn);
            let mut joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
                .local_frame1(pose(&(body.origin * turn)))
                .local_frame2(pose(&turn))
                .contacts_enabled(false);
            if let Some([lower, upper]) = body.stops {
                joint = joint.limits(JointAxis::AngX, [narrow(lower), narrow(upper)]);
            }
            if let Some(joint) = physics.multibody_joints.insert(parent, handle, joint, true) {
                joints.push(Joint { handle: joint, body: handle, parent, axis: vector(&body.axis) });
            }
        }
        let mut world = Self { physics, joints, gravity: vector(&Vector3::from(gravity)), started: false };
        world.set_posture(posture);
        world.set_values(values, step);
        world
    }

    /// Puts the joints, which stand at 0, where `posture` says.
    fn set_posture(&mut self, posture: &[f64]) {
        for (joint, angle) in self.joints.iter().zip(posture) {
            if let Some((chain, link)) = self.physics.multibody_joints.get_mut(joint.handle) {
                // Once the root is known to be fixed, degrees of freedom count from the first joint.
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
            // Rapier's damping is that of the velocity at the end of the kick; this makes it the mean of both ends.
            chain.armature_mut()[dof] = narrow(values.rotor_inertia - 0.5 * values.viscous * step);
            chain.frictions_mut()[dof] = narrow(values.coulomb);
        }
    }

    /// One sub-step under the given motor torques [N·m].
    pub fn step(&mut self, torques: impl Iterator<Item = f64>) {
        let bodies = &mut self.physics.bodies;
        for joint in &self.joints {
            if let Some(body) = bodies.get_mut(joint.body) {
                body.reset_torques(false);
            }
        }
        for (joint, torque) in self.joints.iter().zip(torques) {
            let Some(body) = bodies.get_mut(joint.body) else { continue };
            let torque = body.rotation() * joint.axis * narrow(torque);
            body.add_torque(torque, true);
            if let Some(parent) = bodies.get_mut(joint.parent) {
                parent.add_torque(-torque, true);
            }
        }
        // From rest, half a sub-step leads to the middle of the first one. (The torques' means know by themselves.)
        self.physics.gravity = if self.started { self.gravity } else { self.gravity * 0.5 };
        self.started = true;
        self.physics.step();
    }

    /// Joint angles [rad].
    pub fn positions(&self) -> impl Iterator<Item = f64> {
        self.joints.iter().map(|joint| {
            let link =
                self.physics.multibody_joints.get(joint.handle).and_then(|(chain, link)| chain.link(link));
            link.map_or(f64::NAN, |link| f64::from(link.joint().coords()[3]))
        })
    }

    /// Joint velocities in the last sub-step [rad/s].
    pub fn velocities(&self) -> impl Iterator<Item = f64> {
        self.joints.iter().map(|joint| {
            let chain = self.physics.multibody_joints.get(joint.handle);
            chain
                .and_then(|(chain, link)| {
                    Some(f64::from(chain.generalized_velocity()[first_dof(chain, link)?]))
                })
                .unwrap_or(f64::NAN)
        })
    }

    /// Where the body behind a joint is, in the frame of the base: position [m] and orientation `[x, y, z, w]`.
    pub fn body_pose(&self, joint: usize) -> Option<([f64; 3], [f64; 4])> {
        let body = self.physics.bodies.get(self.joints.get(joint)?.body)?;
        let (place, turn) = (body.translation(), body.rotation());
        Some((place.to_array().map(f64::from), turn.to_array().map(f64::from)))
    }
}

/// Index of a link's degree of freedom among its multibody's: links come in order and the root has none.
fn first_dof(chain: &rapier3d::dynamics::Multibody, link: usize) -> Option<usize> {
    let dof = link.checked_sub(1)?;
    (dof < chain.ndofs()).then_some(dof)
}

fn mass(body: &Body, factors: &JointFactors) -> MassProperties {
    let eigen = (body.inertia * factors.inertia).symmetric_eigen();
    let mut axes: Matrix3<f64> = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    let frame = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    MassProperties::with_principal_inertia_frame(
        vector(&body.center_of_mass),
        narrow(body.mass * factors.mass),
        vector(&eigen.eigenvalues),
        rotation(&frame),
    )
}

fn pose(pose: &Isometry3<f64>) -> Pose {
    Pose::from_parts(vector(&pose.translation.vector), rotation(&pose.rotation))
}

fn vector(vector: &Vector3<f64>) -> Vector {
    Vector::new(narrow(vector.x), narrow(vector.y), narrow(vector.z))
}

fn rotation(rotation: &UnitQuaternion<f64>) -> Rotation {
    let [x, y, z, w] = rotation.coords.into();
    Rotation::from_xyzw(narrow(x), narrow(y), narrow(z), narrow(w)).normalize()
}

/// Rapier works in single precision.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
const fn narrow(value: f64) -> f32 {
    value as f32
}
