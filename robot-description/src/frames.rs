//! Where the links of a robot are, each in the one that carries it: for recordings and live streams.

use nalgebra::{Isometry3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use tesaki::model::{ChainJoint, Coupling, Pose, RobotModel};
use urdf_rs::{Joint, JointType, Robot};

use crate::urdf::{followed, isometry};

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
    /// At the value 0 [rad, m].
    origin: Placed,
    axis: Unit<Vector3<f64>>,
    slides: bool,
    /// Whose value it takes.
    joint: usize,
    /// Factor and offset: 1 and 0 for a joint that mimics none.
    law: [f64; 2],
}

impl Moved {
    fn at(&self, positions: &[f64]) -> Option<Placed> {
        let [factor, offset] = self.law;
        let value = factor * positions.get(self.joint)? + offset;
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

    /// Whether it moves as a joint of a model, which has single precision.
    fn is(&self, coupling: &Coupling) -> bool {
        let single = [coupling.multiplier, coupling.offset].map(f64::from);
        let near = |(law, single): (&f64, f64)| (law - single).abs() <= 1e-6 * (1.0 + law.abs());
        self.joint == usize::from(coupling.actuated) && self.law.iter().zip(single).all(near)
    }
}

/// The frames of a robot, by the values of its joints.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    fixed: Vec<Placed>,
    moved: Vec<Moved>,
}

impl Frames {
    /// The links of a URDF, for joints whose values come in the order of `names`. Links behind other joints
    /// are left out, unless these mimic one of `names`.
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
            } else if let Some((joint_index, law)) = leader(robot, joint, names) {
                let axis = Vector3::from(joint.axis.xyz.0);
                let axis = Unit::try_new(axis, 1e-9).unwrap_or_else(Vector3::x_axis);
                let slides = joint.joint_type == JointType::Prismatic;
                frames.moved.push(Moved { origin, axis, slides, joint: joint_index, law });
            }
        }
        frames
    }

    /// The frames that a board's model knows: `base`, and one for each joint, by the joint's name.
    pub fn of_model(model: &RobotModel) -> Self {
        let mut frames = Self::default();
        for (index, chain) in model.chains.iter().enumerate() {
            let mut parent = BASE.to_owned();
            for joint in model.joints_of(index) {
                let child = match joint {
                    ChainJoint::Driven(_, joint) => joint.name.to_string(),
                    ChainJoint::Mimic(mimic) => format!("{}/mimic{}", chain.name, mimic.place),
                };
                let (origin, axis, _) = joint.body();
                let Coupling { actuated, multiplier, offset } = joint.coupling();
                frames.moved.push(Moved {
                    origin: Placed { parent, child: child.clone(), pose: wide(origin) },
                    axis: Unit::new_normalize(Vector3::from(axis.map(f64::from))),
                    slides: false,
                    joint: actuated.into(),
                    law: [multiplier, offset].map(f64::from),
                });
                parent = child;
            }
        }
        frames
    }

    /// Adds a frame for the tip of each chain of the model that has none, by the chain's name: in the frame
    /// of the chain's last joint. A URDF has it as a link.
    #[must_use]
    pub fn with_tips(mut self, model: &RobotModel) -> Self {
        for (index, chain) in model.chains.iter().enumerate() {
            let couplings: Vec<Coupling> = model.joints_of(index).map(ChainJoint::coupling).collect();
            // Joints of other chains may move as the last one does: all of the way from the base tell the
            // chain.
            let is_last = |moved: &&Moved| {
                let way = self.way(&moved.origin.child);
                way.len() == couplings.len()
                    && way.iter().rev().zip(&couplings).all(|(one, other)| one.is(other))
            };
            let parent = self.moved.iter().rev().find(is_last).map(|moved| moved.origin.child.clone());
            let child = chain.name.to_string();
            if let Some(parent) = parent.filter(|_| self.placed().all(|placed| placed.child != child)) {
                self.fixed.push(Placed { parent, child, pose: wide(&chain.tip) });
            }
        }
        self
    }

    /// What moves a frame, from it to the base.
    fn way(&self, frame: &str) -> Vec<&Moved> {
        let (mut way, mut frame) = (Vec::new(), frame);
        // Bounded as `in_base`.
        for _ in 0..self.moved.len() + self.fixed.len() {
            let moved = self.moved.iter().find(|moved| moved.origin.child == frame);
            way.extend(moved);
            let fixed = || self.fixed.iter().find(|placed| placed.child == frame);
            let Some(placed) = moved.map(|moved| &moved.origin).or_else(fixed) else { break };
            frame = &placed.parent;
        }
        way
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

    /// Where a frame is in the base, at these values of the joints [rad, m].
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

/// Whose value a joint takes, with factor and offset.
fn leader<S: AsRef<str>>(robot: &Robot, joint: &Joint, names: &[S]) -> Option<(usize, [f64; 2])> {
    let index = |joint: &Joint| names.iter().position(|name| name.as_ref() == joint.name);
    let (leader, factor, offset) = followed(robot, joint, |joint| index(joint).is_some()).ok()?;
    Some((index(leader)?, [factor, offset]))
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
    use tesaki::kinematics::Chain;

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
    fn a_tip_is_behind_the_mimic_joint_of_its_own_chain() {
        // The outer joints of two fingers follow the same motor by the same law.
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/inspire");
        let mut model = RobotFolder::load(&folder).expect("it is a robot folder of this project").model;
        let followed = model.mimics[2].joint;
        model.mimics[3].joint = followed;
        assert_eq!((model.mimics[2].multiplier, model.mimics[3].multiplier), (1.0, 1.0));
        assert_eq!((model.mimics[2].chain, model.mimics[3].chain), (1, 2));
        let frames = Frames::of_model(&model).with_tips(&model);
        let angles = [0.1, 0.2, 0.3, 0.9, 0.5, 0.6];
        for (index, chain) in model.chains.iter().enumerate() {
            let posture = Chain::of_model(&model, index).posture(&model.chain_angles(index, &angles));
            let tip = posture.tip().translation.vector.map(f64::from);
            let place = frames.in_base(&chain.name, &angles.map(f64::from)).translation.vector;
            assert!((place - tip).norm() < 1e-6, "{}: {place} {tip}", chain.name);
        }
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
