use nalgebra::Isometry3;
use serde::Serialize;
use tesaki::model::{ChainJoint, JointModel, MimicJoint, Pose, RobotModel};
use tesaki_description::urdf::{RigidBody, Urdf, followed, isometry};
use urdf_rs::Geometry;

/// A robot to draw: kinematics from the model of the board, and solids if its URDF is known.
///
/// A pose is `[x, y, z, qx, qy, qz, qw]`: position [m] and unit quaternion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scene {
    /// Name of the robot.
    pub name: String,
    /// Acceleration of gravity in the base frame [m/s²]; defines what is down.
    pub gravity: [f32; 3],
    /// The joints of the model in their order, then the mimic joints.
    pub joints: Vec<SceneJoint>,
    /// How many of `joints` have values of their own: all but the mimic joints.
    pub driven: usize,
    /// The tips, in the order of the chains.
    pub tips: Vec<Tip>,
    /// The shapes of the links. Without any, the page draws a rod from joint to joint.
    pub solids: Vec<Solid>,
}

/// A joint and the frame that it moves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneJoint {
    /// Name.
    pub name: String,
    /// The parent joint; `None` for a joint on the base.
    pub parent: Option<usize>,
    /// Its frame at angle 0, in the parent's frame.
    pub origin: [f32; 7],
    /// Axis of rotation, in its frame.
    pub axis: [f32; 3],
    /// Smallest and largest angle [rad].
    pub limits: [f32; 2],
    /// Largest torque [N·m].
    pub torque: f32,
    /// For a mimic joint: the joint that it follows, multiplier and offset [rad].
    pub follows: Option<(usize, f32, f32)>,
}

/// The tip of a chain.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Tip {
    /// Name.
    pub name: String,
    /// The last joint of its chain.
    pub joint: usize,
    /// Its frame in that of the joint.
    pub pose: [f32; 7],
    /// Radius of a spherical tip [m]; 0 for any other shape.
    pub radius: f32,
    /// Whether it has a force sensor.
    pub sensor: bool,
}

/// A solid that is fixed to a link.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Solid {
    /// The joint that moves it; `None` for the base.
    pub joint: Option<usize>,
    /// Its frame in that of the joint.
    pub pose: [f32; 7],
    /// Its shape.
    pub shape: SolidShape,
}

/// Shape of a solid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SolidShape {
    /// A cuboid with these extents [m].
    Box([f32; 3]),
    /// A cylinder along z: radius and length [m].
    Cylinder([f32; 2]),
    /// A sphere with this radius [m].
    Sphere(f32),
}

impl Scene {
    /// Creates the scene of a model, without solids.
    pub fn new(model: &RobotModel) -> Self {
        let own = |joint: &JointModel, parent| SceneJoint {
            name: joint.name.to_string(),
            parent,
            origin: flat(&joint.origin),
            axis: joint.axis,
            limits: [joint.limits.lower, joint.limits.upper],
            torque: joint.torque_limit(),
            follows: None,
        };
        // The model has no names for mimic joints.
        let follower = |mimic: &MimicJoint, parent| SceneJoint {
            name: format!("mimic of {}", model.joint_name(usize::from(mimic.joint))),
            parent,
            origin: flat(&mimic.origin),
            axis: mimic.axis,
            limits: [0.0; 2],
            torque: 0.0,
            follows: Some((usize::from(mimic.joint), mimic.multiplier, mimic.offset)),
        };
        let (mut joints, mut tips, mut mimics) = (Vec::new(), Vec::new(), Vec::new());
        let driven = model.joints.len();
        for (index, chain) in model.chains.iter().enumerate() {
            let mut parent = None;
            for joint in model.joints_of(index) {
                parent = match joint {
                    ChainJoint::Driven(index, joint) => {
                        joints.push(own(joint, parent));
                        Some(index)
                    }
                    ChainJoint::Mimic(mimic) => {
                        mimics.push(follower(mimic, parent));
                        Some(driven + mimics.len() - 1)
                    }
                };
            }
            tips.push(Tip {
                name: chain.name.to_string(),
                joint: parent.unwrap_or(0),
                pose: flat(&chain.tip),
                radius: chain.tip_radius,
                sensor: chain.force_sensor.is_some(),
            });
        }
        joints.extend(mimics);
        Self {
            name: model.name.to_string(),
            gravity: model.gravity,
            joints,
            driven,
            tips,
            solids: Vec::new(),
        }
    }

    /// Adds the solids of the URDF: boxes, cylinders and spheres of `<visual>`. Meshes are left out. Joints
    /// that follow a joint of the model, such as those of a gripper's fingers, are added as well.
    #[must_use]
    pub fn with_solids(mut self, urdf: &Urdf) -> Self {
        self.collect(urdf, urdf.base(), None);
        self
    }

    /// Adds the solids of the body of `link`, which `joint` moves, and of all links beyond it.
    fn collect(&mut self, urdf: &Urdf, link: &str, joint: Option<usize>) {
        let body = RigidBody::new(&urdf.robot, link);
        for (link, place) in &body.links {
            for visual in &link.visual {
                let Some(shape) = shape(&visual.geometry) else { continue };
                let pose = of_isometry(&(place * isometry(&visual.origin)));
                self.solids.push(Solid { joint, pose, shape });
            }
        }
        for (behind, place) in &body.joints {
            let index =
                self.index(behind, joint, place).or_else(|| self.add_follower(urdf, behind, joint, place));
            if let Some(index) = index {
                if let Some(joint) = self.joints.get_mut(index) {
                    joint.name.clone_from(&behind.name);
                }
                self.collect(urdf, &behind.child.link, Some(index));
            }
        }
    }

    /// Adds a joint of the URDF that the model leaves out, if it follows one of the model.
    #[expect(clippy::cast_possible_truncation, reason = "a page shows single precision")]
    fn add_follower(
        &mut self,
        urdf: &Urdf,
        joint: &urdf_rs::Joint,
        parent: Option<usize>,
        place: &Isometry3<f64>,
    ) -> Option<usize> {
        let index = |joint: &urdf_rs::Joint| {
            self.joints.iter().take(self.driven).position(|other| other.name == joint.name)
        };
        let (leader, multiplier, offset) =
            followed(&urdf.robot, joint, |joint| index(joint).is_some()).ok()?;
        let leader = index(leader)?;
        self.joints.push(SceneJoint {
            name: joint.name.clone(),
            parent,
            origin: of_isometry(&(place * isometry(&joint.origin))),
            axis: joint.axis.xyz.0.map(|part| part as f32),
            limits: [0.0; 2],
            torque: 0.0,
            follows: Some((leader, multiplier as f32, offset as f32)),
        });
        Some(self.joints.len() - 1)
    }

    /// Returns the joint of the model for a joint of the URDF that follows `parent` at `place`. Mimic joints
    /// have no name in the model and are found by their place.
    fn index(&self, joint: &urdf_rs::Joint, parent: Option<usize>, place: &Isometry3<f64>) -> Option<usize> {
        let origin = of_isometry(&(place * isometry(&joint.origin)));
        let same = |other: &SceneJoint| {
            let near = |(one, other): (&f32, &f32)| (one - other).abs() < 1e-6;
            other.parent == parent && other.origin.iter().zip(&origin).all(near)
        };
        let (driven, mimics) = self.joints.split_at_checked(self.driven)?;
        match &joint.mimic {
            None => driven.iter().position(|other| other.name == joint.name),
            Some(_) => mimics.iter().position(same).map(|index| self.driven + index),
        }
    }
}

fn flat(pose: &Pose) -> [f32; 7] {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.translation, pose.rotation);
    [x, y, z, qx, qy, qz, qw]
}

#[expect(clippy::cast_possible_truncation, reason = "a page shows single precision")]
fn of_isometry(pose: &Isometry3<f64>) -> [f32; 7] {
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(|value| value as f32)
}

#[expect(clippy::cast_possible_truncation, reason = "a page shows single precision")]
fn shape(geometry: &Geometry) -> Option<SolidShape> {
    match geometry {
        Geometry::Box { size } => Some(SolidShape::Box(size.0.map(|extent| extent as f32))),
        Geometry::Cylinder { radius, length } => Some(SolidShape::Cylinder([*radius as f32, *length as f32])),
        Geometry::Sphere { radius } => Some(SolidShape::Sphere(*radius as f32)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use tesaki_description::robot::RobotFolder;

    fn folder(name: &str) -> RobotFolder {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name);
        RobotFolder::load(&path).expect("it is a robot folder of this project")
    }

    #[test]
    fn every_chain_hangs_on_the_base_and_every_solid_on_a_joint() {
        // Joints, mimic joints, tips and <visual>s counted in the URDFs.
        for (name, driven, all, tips, solids) in [
            ("hand3", 9, 9, 3, 16),
            ("arm7", 7, 7, 1, 9),
            ("hand5", 16, 19, 5, 22),
            ("knob-arm", 7, 9, 1, 10),
            ("inspire", 6, 12, 5, 0),
        ] {
            let robot = folder(name);
            let scene = Scene::new(&robot.model).with_solids(&robot.urdf);
            assert_eq!((scene.driven, scene.joints.len()), (driven, all), "{name}");
            assert_eq!((scene.tips.len(), scene.solids.len()), (tips, solids), "{name}");
            let bases = scene.joints.iter().filter(|joint| joint.parent.is_none()).count();
            assert_eq!(bases, tips, "{name}");
            assert_eq!(
                scene.joints.iter().filter(|joint| joint.follows.is_some()).count(),
                all - driven,
                "{name}"
            );
            let named =
                |joint: &SceneJoint| robot.urdf.robot.joints.iter().any(|other| other.name == joint.name);
            assert!(scene.joints.iter().all(named), "{name}");
            for (index, joint) in scene.joints.iter().enumerate() {
                assert!(joint.parent.is_none_or(|parent| parent < index || parent >= driven), "{name}");
                assert!(joint.follows.is_none_or(|(leader, ..)| leader < driven), "{name}");
            }
        }
    }
}
