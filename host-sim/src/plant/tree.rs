//! The moving bodies of a URDF.

use rapier3d::na::{Isometry3, Matrix3, Vector3};
use tesaki_description::urdf::{self, MassProperties, RigidBody, Urdf};
use urdf_rs::{JointType, Robot};

use super::error::PlantError;

/// A link that a joint moves, with everything that is fixed to it. Its frame is the joint's.
#[derive(Clone, Debug)]
pub struct Body {
    pub joint: String,
    /// The moving body that carries it; `None` for the base.
    pub parent: Option<usize>,
    /// Joint frame in the frame of that body, at angle 0.
    pub origin: Isometry3<f64>,
    pub axis: Vector3<f64>,
    pub mass: f64,
    pub center_of_mass: Vector3<f64>,
    /// About the centre of mass, in the axes of the joint frame.
    pub inertia: Matrix3<f64>,
    /// End stops; `None` for a joint with unlimited rotation.
    pub stops: Option<[f64; 2]>,
    /// The joint that it follows, with multiplier and offset [rad].
    pub mimic: Option<(String, f64, f64)>,
    /// Largest torque [N·m].
    pub effort: f64,
    /// Coulomb [N·m] and viscous friction [N·m·s/rad].
    pub coulomb: f64,
    pub viscous: f64,
}

/// Collects the moving bodies, each after the one that carries it.
pub fn bodies(urdf: &Urdf) -> Result<Vec<Body>, PlantError> {
    let mut bodies = Vec::new();
    add_behind(&urdf.robot, &RigidBody::new(&urdf.robot, urdf.base()), None, &mut bodies)?;
    Ok(bodies)
}

/// Adds everything that the joints of `body` move; `parent` is its index.
fn add_behind(
    robot: &Robot,
    body: &RigidBody<'_>,
    parent: Option<usize>,
    bodies: &mut Vec<Body>,
) -> Result<(), PlantError> {
    for &(joint, place) in &body.joints {
        let behind = RigidBody::new(robot, &joint.child.link);
        let masses = behind.mass_properties();
        let moving = moving_body(joint, parent, place * urdf::isometry(&joint.origin), masses)?;
        check_masses(&moving, &joint.child.link)?;
        bodies.push(moving);
        add_behind(robot, &behind, Some(bodies.len() - 1), bodies)?;
    }
    Ok(())
}

fn moving_body(
    joint: &urdf_rs::Joint,
    parent: Option<usize>,
    origin: Isometry3<f64>,
    masses: MassProperties,
) -> Result<Body, PlantError> {
    let name = || joint.name.clone();
    let axis = urdf::axis(joint).ok_or_else(|| PlantError::Axis { joint: name(), axis: joint.axis.xyz.0 })?;
    let (lower, upper) = (joint.limit.lower, joint.limit.upper);
    let stops = match joint.joint_type {
        JointType::Revolute if lower < upper => Some([lower, upper]),
        JointType::Revolute => return Err(PlantError::Limits { joint: name(), lower, upper }),
        JointType::Continuous => None,
        ref other => {
            return Err(PlantError::JointType { joint: name(), kind: format!("{other:?}").to_lowercase() });
        }
    };
    let dynamics = joint.dynamics.as_ref();
    Ok(Body {
        joint: name(),
        parent,
        origin,
        axis,
        mass: masses.mass,
        center_of_mass: masses.center_of_mass,
        inertia: masses.inertia,
        stops,
        mimic: joint
            .mimic
            .as_ref()
            .map(|of| (of.joint.clone(), of.multiplier.unwrap_or(1.0), of.offset.unwrap_or(0.0))),
        effort: joint.limit.effort,
        coulomb: dynamics.map_or(0.0, |dynamics| dynamics.friction),
        viscous: dynamics.map_or(0.0, |dynamics| dynamics.damping),
    })
}

/// Rejects masses and inertias that no body can have.
fn check_masses(body: &Body, link: &str) -> Result<(), PlantError> {
    let names = || (link.to_owned(), body.joint.clone());
    if !(body.mass.is_finite() && body.mass > 0.0) {
        let (link, joint) = names();
        return Err(PlantError::NoMass { link, joint });
    }
    let moments = body.inertia.symmetric_eigenvalues();
    // Half the trace minus a principal moment is a second moment of mass, which cannot be negative.
    let possible = moments.min() > 0.0 && moments.max() <= 0.5 * body.inertia.trace() * (1.0 + 1e-3);
    if !possible {
        let (link, joint) = names();
        return Err(PlantError::Inertia { link, joint, moments: moments.into() });
    }
    Ok(())
}
