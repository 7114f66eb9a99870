//! Serial paths: from a base through the joints to a tip.

use nalgebra::Isometry3;
use tesaki::kinematics::Chain;
use tesaki::model::{Coupling, Inertial, MAX_CHAIN_JOINTS, Pose};
use urdf_rs::{Joint, JointType};

use super::{RigidBody, Urdf, UrdfError, axis, isometry, narrow, pose, single};
use crate::finding::{Finding, Matter, Severity};

/// The rotary joints in series from a base to a tip; what is fixed is folded in.
#[derive(Clone, Debug)]
pub struct SerialPath {
    /// The link where it starts.
    pub base: String,
    /// The link where it ends.
    pub tip: String,
    /// From base to tip.
    pub joints: Vec<PathJoint>,
    /// The tip's frame in that of the last joint.
    pub pose: Pose,
    /// What moves them: fewer than joints where joints mimic others.
    pub drives: Vec<Drive>,
    /// Joints that move and lead elsewhere from the links on the way: the mass behind them is not that of the
    /// path.
    pub branches: Vec<String>,
    /// All joints from base to tip, the fixed ones too.
    pub way: Vec<String>,
}

/// One joint of a path: at angle `multiplier` · angle of its drive + `offset`.
#[derive(Clone, Debug)]
pub struct PathJoint {
    /// Name in the URDF.
    pub name: String,
    /// Frame in that of the joint before it (of the base, for the first) at angle 0.
    pub origin: Pose,
    /// Unit vector.
    pub axis: [f32; 3],
    /// The body behind it.
    pub link: Inertial,
    /// Smallest and largest angle [rad]; none for a continuous joint.
    pub limits: Option<(f32, f32)>,
    /// Index of its drive.
    pub drive: usize,
    /// 1 for a joint that mimics none.
    pub multiplier: f32,
    /// [rad]; 0 for a joint that mimics none.
    pub offset: f32,
}

/// An independent joint, on the path or mimicked by joints on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Name in the URDF.
    pub name: String,
    /// Smallest and largest angle [rad]; none for a continuous joint.
    pub limits: Option<(f32, f32)>,
}

impl PathJoint {
    /// Its angle when its drive is at `angle` [rad].
    pub fn angle(&self, angle: f32) -> f32 {
        let (multiplier, offset) = (self.multiplier, self.offset);
        Coupling { actuated: 0, multiplier, offset }.angle(angle)
    }
}

impl SerialPath {
    /// The joints' angles when the drives are at `angles` [rad].
    pub fn angles(&self, angles: &[f32]) -> Vec<f32> {
        let angle = |joint: &PathJoint| angles.get(joint.drive).copied().unwrap_or(0.0);
        self.joints.iter().map(|joint| joint.angle(angle(joint))).collect()
    }

    /// The path joint from which the angle of a drive can be told: itself, or else the first that follows it.
    pub fn leader(&self, drive: usize) -> Option<usize> {
        let name = self.drives.get(drive).map(|drive| &drive.name);
        let itself = self.joints.iter().position(|joint| Some(&joint.name) == name);
        let follows = |joint: &PathJoint| joint.drive == drive && joint.multiplier != 0.0;
        itself.or_else(|| self.joints.iter().position(follows))
    }

    /// The control core's chain.
    ///
    /// # Panics
    /// The path was changed, and no longer is a valid chain.
    pub fn chain(&self) -> Chain {
        let links = self.joints.iter().map(|joint| (&joint.origin, &joint.axis, &joint.link));
        Chain::from_links(links, &self.pose).expect("a path is a valid chain")
    }
}

impl Urdf {
    /// The leaf links that at least one joint behind `base`, or else the base of all, moves; in the order of
    /// the file.
    pub fn tips(&self, base: Option<&str>) -> Vec<&str> {
        let robot = &self.robot;
        let is_leaf = |name: &str| !robot.joints.iter().any(|joint| joint.parent.link == name);
        let moves = |name: &str| {
            self.way(base, name).is_some_and(|way| way.iter().any(|j| j.joint_type != JointType::Fixed))
        };
        let names = robot.links.iter().map(|link| link.name.as_str());
        names.filter(|name| is_leaf(name) && moves(name)).collect()
    }

    /// The links to which a path can be computed: the [`Urdf::tips`], or the last link before what is in the
    /// way.
    pub fn reachable_tips(&self, base: Option<&str>) -> Vec<&str> {
        let mut reachable = Vec::new();
        for tip in self.tips(base) {
            let way = self.way(base, tip).unwrap_or_default();
            let parents = way.iter().rev().map(|joint| joint.parent.link.as_str());
            let last = std::iter::once(tip).chain(parents).find(|link| self.serial(base, link).is_ok());
            reachable.extend(last.filter(|link| !reachable.contains(link)));
        }
        reachable
    }

    /// The path from `base`, or else the base of all, to the link `tip`.
    ///
    /// # Errors
    /// There is no such path, or a joint on it cannot be computed; which tips can.
    pub fn path(&self, base: Option<&str>, tip: &str) -> Result<SerialPath, UrdfError> {
        self.serial(base, tip).map_err(|Refused { line, message, advice }| {
            let advice = advice.unwrap_or_else(|| {
                let reachable = self.reachable_tips(base);
                if let Some(base) = base.filter(|base| !self.has_link(base)) {
                    let links = self.robot.links.iter().map(|link| link.name.as_str());
                    let bases = links.filter(|link| !self.reachable_tips(Some(link)).is_empty());
                    let bases: Vec<&str> = bases.collect();
                    format!("{base:?} was to be the base; links that can be a base: {}", bases.join(", "))
                } else if reachable.is_empty() {
                    "no other tip can be computed either".to_owned()
                } else {
                    format!("tips that can be computed: {}", reachable.join(", "))
                }
            });
            let (severity, matter, path) = (Severity::Error, Matter::Kinematics, self.path.clone());
            UrdfError::Path(Finding { severity, matter, path, line, message, advice })
        })
    }

    fn serial(&self, base: Option<&str>, tip: &str) -> Result<SerialPath, Refused> {
        let base = base.unwrap_or(self.base());
        for link in [base, tip] {
            if !self.has_link(link) {
                return Err(Refused::new(None, format!("there is no link {link:?}")));
            }
        }
        let way = self.way(Some(base), tip).ok_or_else(|| Refused {
            line: self.line_of_link(tip),
            message: format!(
                "the link {base:?} is not between the base {:?} and the tip {tip:?}",
                self.base()
            ),
            advice: Some("leave --base out, or name a link on the way to the tip".to_owned()),
        })?;
        self.check_way(&way, base, tip)?;
        let (mut joints, mut drives, mut branches) = (Vec::new(), Vec::new(), Vec::new());
        let mut place = Isometry3::identity();
        for joint in &way {
            place *= isometry(&joint.origin);
            if joint.joint_type != JointType::Fixed {
                joints.push(self.path_joint(joint, &place, &mut drives)?);
                let behind = RigidBody::new(&self.robot, &joint.child.link).joints;
                let away =
                    behind.into_iter().filter(|(next, _)| way.iter().all(|on_way| on_way.name != next.name));
                branches.extend(away.map(|(next, _)| next.name.clone()));
                place = Isometry3::identity();
            }
        }
        Ok(SerialPath {
            base: base.to_owned(),
            tip: tip.to_owned(),
            joints,
            pose: pose(&place),
            drives,
            branches,
            way: way.iter().map(|joint| joint.name.clone()).collect(),
        })
    }

    /// The joints from `base` to `tip`; `None` when there is no way.
    fn way(&self, base: Option<&str>, tip: &str) -> Option<Vec<&Joint>> {
        let base = base.unwrap_or(self.base());
        let (mut way, mut here) = (Vec::new(), tip);
        while here != base {
            let joint = self.robot.joints.iter().find(|joint| joint.child.link == here)?;
            way.push(joint);
            here = &joint.parent.link;
        }
        way.reverse();
        Some(way)
    }

    fn check_way(&self, way: &[&Joint], base: &str, tip: &str) -> Result<(), Refused> {
        let rotary = |joint: &Joint| matches!(joint.joint_type, JointType::Revolute | JointType::Continuous);
        let moving: Vec<_> = way.iter().filter(|joint| joint.joint_type != JointType::Fixed).collect();
        if let Some(joint) = moving.iter().find(|joint| !rotary(joint)) {
            let kind = format!("{:?}", joint.joint_type).to_lowercase();
            return Err(Refused::new(
                self.line_of_joint(&joint.name),
                format!(
                    "joint {} on the path to {tip} is {kind}: only revolute, continuous, mimic and fixed joints are supported",
                    joint.name
                ),
            ));
        }
        match moving.len() {
            0 => Err(Refused::new(
                self.line_of_link(tip),
                format!("there is no moving joint between {base} and {tip}"),
            )),
            1..=MAX_CHAIN_JOINTS => Ok(()),
            many => Err(Refused {
                line: self.line_of_link(tip),
                message: format!(
                    "{many} moving joints from {base} to {tip}; at most {MAX_CHAIN_JOINTS} are supported"
                ),
                advice: Some(format!(
                    "choose a later base, for example --base {}; tips that can be reached from {base}: {}",
                    moving[many - MAX_CHAIN_JOINTS].parent.link,
                    moving[MAX_CHAIN_JOINTS].parent.link
                )),
            }),
        }
    }

    fn path_joint(
        &self,
        joint: &Joint,
        place: &Isometry3<f64>,
        drives: &mut Vec<Drive>,
    ) -> Result<PathJoint, Refused> {
        let axis = axis(joint).ok_or_else(|| {
            Refused::new(
                self.line_of_joint(&joint.name),
                format!("joint {}: its axis is not a direction", joint.name),
            )
        })?;
        let (leader, multiplier, offset) = self.leader(joint)?;
        let drive = Drive { name: leader.name.clone(), limits: limits(leader) };
        let index = drives.iter().position(|known| known.name == drive.name).unwrap_or_else(|| {
            drives.push(drive);
            drives.len() - 1
        });
        Ok(PathJoint {
            name: joint.name.clone(),
            origin: pose(place),
            axis: single(axis),
            link: RigidBody::new(&self.robot, &joint.child.link).mass_properties().inertial(),
            limits: limits(joint),
            drive: index,
            multiplier: narrow(multiplier),
            offset: narrow(offset),
        })
    }

    /// As `leader`; `None` when there is none, which has been told.
    pub(crate) fn mimicked<'a>(&'a self, joint: &'a Joint) -> Option<(&'a Joint, f64, f64)> {
        self.leader(joint).ok()
    }

    /// The joint that `joint` follows in the end, itself when it mimics none, with multiplier and offset.
    fn leader<'a>(&'a self, joint: &'a Joint) -> Result<(&'a Joint, f64, f64), Refused> {
        let refused = |message| Refused::new(self.line_of_joint(&joint.name), message);
        match followed(&self.robot, joint, |joint| joint.mimic.is_none()) {
            Ok((leader, multiplier, offset)) => match leader.joint_type {
                JointType::Revolute | JointType::Continuous => Ok((leader, multiplier, offset)),
                ref other => Err(refused(format!(
                    "joint {} mimics {}, which is {}: only rotary joints can be followed",
                    joint.name,
                    leader.name,
                    format!("{other:?}").to_lowercase()
                ))),
            },
            Err(NoLeader::Unknown { joint, mimicked }) => {
                Err(refused(format!("joint {joint} mimics {mimicked:?}, which does not exist")))
            }
            Err(NoLeader::NotFound) => Err(refused(format!("joint {} mimics itself", joint.name))),
        }
    }
}

/// Why a joint follows no leader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoLeader<'a> {
    /// A joint on the way mimics one that does not exist.
    Unknown {
        /// The joint.
        joint: &'a str,
        /// The name of what it mimics.
        mimicked: &'a str,
    },
    /// None is on the way, which may be a circle.
    NotFound,
}

/// The first of `joint`, the joint that it mimics, the one that this mimics, and so on, that `is_leader`; the
/// angle of `joint` is the returned factor times the leader's plus the returned offset.
///
/// # Errors
/// There is none.
pub fn followed<'a>(
    robot: &'a urdf_rs::Robot,
    joint: &'a Joint,
    is_leader: impl Fn(&Joint) -> bool,
) -> Result<(&'a Joint, f64, f64), NoLeader<'a>> {
    let (mut here, mut multiplier, mut offset) = (joint, 1.0, 0.0);
    for _ in &robot.joints {
        if is_leader(here) {
            return Ok((here, multiplier, offset));
        }
        let mimic = here.mimic.as_ref().ok_or(NoLeader::NotFound)?;
        offset += multiplier * mimic.offset.unwrap_or(0.0);
        multiplier *= mimic.multiplier.unwrap_or(1.0);
        let next = robot.joints.iter().find(|known| known.name == mimic.joint);
        here = next.ok_or(NoLeader::Unknown { joint: &here.name, mimicked: &mimic.joint })?;
    }
    Err(NoLeader::NotFound)
}

fn limits(joint: &Joint) -> Option<(f32, f32)> {
    (joint.joint_type != JointType::Continuous)
        .then(|| (narrow(joint.limit.lower), narrow(joint.limit.upper)))
}

/// Why there is no path; without advice, the tips that work are told.
struct Refused {
    line: Option<usize>,
    message: String,
    advice: Option<String>,
}

impl Refused {
    const fn new(line: Option<usize>, message: String) -> Self {
        Self { line, message, advice: None }
    }
}
