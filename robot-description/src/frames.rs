//! Where the links of a robot are, each in the one that carries it: for recordings and live streams.

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use tesaki::model::{ChainJoint, Pose, RobotModel};
use urdf_rs::{Joint, JointType, Robot};

use crate::urdf::isometry;

/// Where a frame is in another one.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// The frame it is given in.
    pub parent: String,
    /// The frame it places.
    pub child: String,
    /// Pose of the child.
    pub pose: Isometry3<f64>,
}

/// A frame that a joint moves.
#[derive(Clone, Debug)]
struct Moved {
    /// At the value 0.
    origin: Placed,
    axis: Unit<Vector3<f64>>,
    slides: bool,
    /// Whose value it takes.
    joint: usize,
    /// Factor and offset for a joint that mimics that one.
    mimic: Option<[f64; 2]>,
}

impl Moved {
    fn at(&self, positions: &[f64]) -> Option<Placed> {
        let value = *positions.get(self.joint)?;
        let value = self.mimic.map_or(value, |[factor, offset]| factor * value + offset);
        let motion = if self.slides {
            Isometry3::from_parts(Translation3::from(self.axis.scale(value)), UnitQuaternion::identity())
        } else {
            Isometry3::from_parts(
                Translation3::identity(),
                UnitQuaternion::from_axis_angle(&self.axis, value),
            )
        };
        Some(Placed { pose: self.origin.pose * motion, ..self.origin.clone() })
    }
}

/// The frames of a robot, by the values of its joints.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    fixed: Vec<Placed>,
    moved: Vec<Moved>,
}

impl Frames {
    /// The links of a URDF, for joints whose values come in the order of `names`. Links behind other joints are left
    /// out, unless these mimic one of `names`.
    pub fn of_urdf<S: AsRef<str>>(robot: &Robot, names: &[S]) -> Self {
        let mut frames = Self::default();
        for joint in &robot.joints {
            let origin = Placed {
                parent: joint.parent.link.clone(),
                child: joint.child.link.clone(),
                pose: isometry(&joint.origin),
            };
            if joint.joint_type == JointType::Fixed {
                frames.fixed.push(origin);
            } else if let Some((leader, mimic)) = leader(robot, joint, names) {
                let axis = Vector3::from(joint.axis.xyz.0);
                let axis = Unit::try_new(axis, 1e-9).unwrap_or_else(Vector3::x_axis);
                let slides = joint.joint_type == JointType::Prismatic;
                frames.moved.push(Moved { origin, axis, slides, joint: leader, mimic });
            }
        }
        frames
    }

    /// The frames that a board's model knows: `base`, and one for each joint, by the joint's name.
    pub fn of_model(model: &RobotModel) -> Self {
        let mut frames = Self::default();
        let mut add = |origin: Placed, axis: [f32; 3], joint, mimic: Option<[f32; 2]>| {
            let axis = Unit::new_normalize(Vector3::from(axis.map(f64::from)));
            let mimic = mimic.map(|mimic| mimic.map(f64::from));
            frames.moved.push(Moved { origin, axis, slides: false, joint, mimic });
        };
        for (index, chain) in model.chains.iter().enumerate() {
            let mut parent = BASE.to_owned();
            for joint in model.joints_of(index) {
                let (child, pose, axis, leader, mimic) = match joint {
                    ChainJoint::Driven(index, joint) => {
                        (joint.name.to_string(), &joint.origin, joint.axis, index, None)
                    }
                    ChainJoint::Mimic(mimic) => (
                        format!("{}/mimic{}", chain.name, mimic.place),
                        &mimic.origin,
                        mimic.axis,
                        mimic.joint.into(),
                        Some([mimic.multiplier, mimic.offset]),
                    ),
                };
                let origin = Placed { parent, child: child.clone(), pose: wide(pose) };
                add(origin, axis, leader, mimic);
                parent = child;
            }
        }
        frames
    }

    /// Adds a frame for the tip of each chain of the model that has none, by the chain's name: in the frame of the
    /// chain's last joint. A URDF has it as a link.
    #[must_use]
    pub fn with_tips(mut self, model: &RobotModel) -> Self {
        for (index, chain) in model.chains.iter().enumerate() {
            let last = match model.joints_of(index).last() {
                Some(ChainJoint::Driven(joint, _)) => (joint, None),
                Some(ChainJoint::Mimic(mimic)) => {
                    (mimic.joint.into(), Some([mimic.multiplier, mimic.offset]))
                }
                None => continue,
            };
            let is_last = |moved: &&Moved| moved.joint == last.0 && same(moved.mimic, last.1);
            let parent = self.moved.iter().rev().find(is_last).map(|moved| moved.origin.child.clone());
            let child = chain.name.to_string();
            if let Some(parent) = parent.filter(|_| self.placed().all(|placed| placed.child != child)) {
                self.fixed.push(Placed { parent, child, pose: wide(&chain.tip) });
            }
        }
        self
    }

    /// All frames; those that move at the value 0.
    fn placed(&self) -> impl Iterator<Item = &Placed> {
        self.moved.iter().map(|moved| &moved.origin).chain(&self.fixed)
    }

    /// What does not move.
    pub fn fixed(&self) -> &[Placed] {
        &self.fixed
    }

    /// What moves, at these values of the joints [rad or m].
    pub fn moving(&self, positions: &[f64]) -> Vec<Placed> {
        self.moved.iter().filter_map(|moved| moved.at(positions)).collect()
    }

    /// The frame that carries all others.
    pub fn base(&self) -> &str {
        let carries = |frame: &&str| self.placed().all(|placed| placed.child != **frame);
        self.placed().map(|placed| placed.parent.as_str()).find(carries).unwrap_or(BASE)
    }

    /// Where a frame is in the base, at these values of the joints.
    pub fn in_base(&self, frame: &str, positions: &[f64]) -> Isometry3<f64> {
        let placed = |frame: &str| {
            let moved = self.moved.iter().find(|moved| moved.origin.child == frame);
            moved
                .and_then(|moved| moved.at(positions))
                .or_else(|| self.fixed.iter().find(|placed| placed.child == frame).cloned())
        };
        let (mut pose, mut frame) = (Isometry3::identity(), frame.to_owned());
        // A joint may be called as the base is: the way down ends all the same.
        for _ in 0..self.moved.len() + self.fixed.len() {
            let Some(placed) = placed(&frame) else { break };
            (pose, frame) = (placed.pose * pose, placed.parent);
        }
        pose
    }
}

/// The base of a robot without URDF.
const BASE: &str = "base";

/// Whether two laws of a mimic joint are the same; one has been through single precision.
fn same(law: Option<[f64; 2]>, single: Option<[f32; 2]>) -> bool {
    match (law, single) {
        (Some(law), Some(single)) => {
            law.iter().zip(single).all(|(a, b)| (a - f64::from(b)).abs() <= 1e-6 * (1.0 + a.abs()))
        }
        (law, single) => law.is_none() && single.is_none(),
    }
}

/// Whose value a joint takes, with factor and offset if it mimics that one, be it through other mimic joints.
fn leader<S: AsRef<str>>(robot: &Robot, joint: &Joint, names: &[S]) -> Option<(usize, Option<[f64; 2]>)> {
    let index = |name: &str| names.iter().position(|other| other.as_ref() == name);
    let (mut joint, mut law) = (joint, None);
    for _ in 0..=robot.joints.len() {
        if let Some(own) = index(&joint.name) {
            return Some((own, law));
        }
        let mimic = joint.mimic.as_ref()?;
        let [multiplier, offset] = law.unwrap_or([1.0, 0.0]);
        let (of, shift) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
        law = Some([multiplier * of, multiplier * shift + offset]);
        joint = robot.joints.iter().find(|other| other.name == mimic.joint)?;
    }
    None
}

fn wide(pose: &Pose) -> Isometry3<f64> {
    let [x, y, z, w] = pose.rotation.map(f64::from);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(pose.translation.map(f64::from)), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotFolder;
    use std::path::Path;

    #[test]
    fn links_turn_about_their_axes() {
        let urdf = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
            <link name="f"/><link name="g"/>
            <joint name="turn" type="revolute"><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><parent link="a"/>
            <child link="b"/><axis xyz="0 0 2"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
            <joint name="slide" type="prismatic"><origin xyz="0 0 1"/><parent link="b"/><child link="c"/>
            <axis xyz="0 1 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
            <joint name="free" type="continuous"><parent link="c"/><child link="d"/></joint>
            <joint name="follows" type="prismatic"><parent link="b"/><child link="e"/><axis xyz="0 0 1"/>
            <limit lower="0" upper="1" effort="1" velocity="1"/><mimic joint="slide" multiplier="-2" offset="3"/></joint>
            <joint name="third" type="prismatic"><parent link="f"/><child link="g"/><axis xyz="1 0 0"/>
            <limit lower="0" upper="9" effort="1" velocity="1"/><mimic joint="follows" multiplier="2" offset="1"/></joint>
            <joint name="glued" type="fixed"><origin xyz="0 0 7"/><parent link="e"/><child link="f"/></joint></robot>"#;
        let robot = urdf_rs::read_from_string(urdf).expect("it is a URDF");
        let frames = Frames::of_urdf(&robot, &["slide", "turn"]);
        let links = frames.moving(&[0.5, 0.5]);
        let names: Vec<(&str, &str)> = links.iter().map(|l| (l.parent.as_str(), l.child.as_str())).collect();
        assert_eq!(
            names,
            [("a", "b"), ("b", "c"), ("b", "e"), ("f", "g")],
            "nothing is known of the third joint"
        );
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-15);
        let half = 0.5 * (0.5 + std::f64::consts::FRAC_PI_2);
        let place = |index: usize| -> [f64; 3] { links[index].pose.translation.vector.into() };
        let turn = |index: usize| -> [f64; 4] { links[index].pose.rotation.coords.into() };
        assert!(near(&place(0), &[1.0, 2.0, 3.0]));
        assert!(near(&turn(0), &[0.0, 0.0, half.sin(), half.cos()]));
        assert!(near(&place(1), &[0.0, 0.5, 1.0]) && near(&turn(1), &[0.0, 0.0, 0.0, 1.0]));
        // −2 · 0.5 + 3.
        assert!(near(&place(2), &[0.0, 0.0, 2.0]));
        // It follows a joint that follows: 2 · 2 + 1.
        assert!(near(&place(3), &[5.0, 0.0, 0.0]));
        assert_eq!((frames.base(), frames.fixed().len()), ("a", 1));
        let end: [f64; 3] = frames.in_base("f", &[0.5, 0.5]).translation.vector.into();
        assert!(near(&end, &[1.0, 2.0, 3.0 + 2.0 + 7.0]), "{end:?}");
    }

    #[test]
    fn a_joint_that_is_called_as_the_base_ends_the_way_down() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7");
        let mut model = RobotFolder::load(&folder).expect("it is a robot folder of this project").model;
        model.joints[0].name = "base".try_into().expect("short");
        let frames = Frames::of_model(&model).with_tips(&model);
        let place = frames.in_base("hand", &[0.1; 7]).translation.vector;
        assert!(place.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn urdf_and_model_agree_about_the_tips() {
        for name in ["hand3", "arm7", "hand5", "knob-arm", "inspire"] {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(name);
            let robot = RobotFolder::load(&folder).expect("it is a robot folder of this project");
            let model = &robot.model;
            let names: Vec<String> = model.joints.iter().map(|joint| joint.name.to_string()).collect();
            let angles: Vec<f64> = names.iter().zip(1..).map(|(_, n)| 0.07 * f64::from(n)).collect();
            let by_urdf = Frames::of_urdf(&robot.urdf.robot, &names).with_tips(model);
            let by_model = Frames::of_model(model).with_tips(model);
            for chain in &model.chains {
                let frame = &chain.name;
                let [a, b] = [&by_urdf, &by_model].map(|frames| frames.in_base(frame, &angles));
                // The model has single precision.
                assert!((a.translation.vector - b.translation.vector).norm() < 1e-6, "{name}: {frame}");
                assert!(a.rotation.angle_to(&b.rotation) < 1e-6, "{name}: {frame}");
                assert!(a.translation.vector.norm() > 0.01, "{name}: {frame}");
            }
        }
    }
}
