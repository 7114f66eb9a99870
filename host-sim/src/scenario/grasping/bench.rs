//! A hand with open fingers around something that stands nearly where it is thought to be.

use rapier3d::na::{Rotation3, UnitQuaternion, Vector3};
use tesaki::kinematics::{Chain, Finger};
use tesaki::manipulation::GraspPlan;
use tesaki::model::RobotModel;
use tesaki_supervisor::robot::RobotFolder;

use crate::motion::Motion;
use crate::plant::{
    Drive, ObjectValues, Plant, PlantError, PlantOptions, PlantValues, Purpose, Random, Support,
};
use crate::scenario::{ScenarioError, Setting};

/// Where the grasp files have the middle of the object [m], and its pitch [rad].
const MIDDLE: [f64; 3] = [0.090, 0.0, 0.085];
const PITCH: f64 = 0.769;
/// The object stands off that place by at most this much along each axis of its support [m].
const OFFSET: f64 = 0.005;
/// What it stands on [m].
const SUPPORT: [f64; 3] = [0.05, 0.1, 0.02];
/// The surfaces of the open fingertips are this far from where they are to touch [m].
const OPEN: f64 = 0.02;
/// Radius of the fingertips, as the URDF has it [m].
const TIP: f64 = 0.008;
/// Angles near which the start is sought [rad].
const NEAR: [f32; 3] = [0.0, 0.3, 0.7];

/// What is in the hand in a part of a scenario, and how it is held.
pub struct Held<'a> {
    /// For people.
    pub label: &'a str,
    /// The name of its files in `objects/` and `grasps/`.
    pub object: &'a str,
    /// Changes what the grasp file says.
    pub change: &'a dyn Fn(&mut GraspPlan),
    /// Whether the joints have the friction that the paper's losses imply.
    pub paper_friction: bool,
}

/// What all parts of a scenario share.
pub struct Bench {
    pub robot: RobotFolder,
    pub values: PlantValues,
    pub motion: Motion,
    seed: u64,
}

impl Bench {
    /// Reads the robot's folder.
    pub fn load(setting: &Setting<'_, '_>) -> Result<Self, ScenarioError> {
        let robot = RobotFolder::load(setting.robot)?;
        let motion = Motion::new(robot.model.joints.iter().map(|joint| joint.name.as_str()));
        Ok(Self { values: PlantValues::load(setting.robot)?, robot, motion, seed: setting.seed })
    }

    /// The link that carries all others.
    pub fn base(&self) -> &str {
        let carried = |name: &str| self.robot.urdf.joints.iter().any(|joint| joint.child.link == name);
        self.robot.urdf.links.iter().find(|link| !carried(&link.name)).map_or("", |link| link.name.as_str())
    }

    /// The grasp of an object, as its file says.
    pub fn plan(&self, object: &str) -> Result<GraspPlan, ScenarioError> {
        Ok(tesaki_supervisor::grasp::load(&self.robot.path.join(format!("grasps/{object}.toml")))?)
    }

    /// The grasp, and a machine with what is to be grasped.
    pub fn place(&self, held: &Held<'_>) -> Result<(GraspPlan, Plant), ScenarioError> {
        let folder = &self.robot.path;
        let mut plan = self.plan(held.object)?;
        (held.change)(&mut plan);
        let path = folder.join(format!("objects/{}.toml", held.object));
        let text = std::fs::read_to_string(&path)
            .map_err(|error| PlantError::Read { path, reason: error.to_string() })?;
        let mut options = PlantOptions::mismatched(self.seed);
        options.object = Some(standing(ObjectValues::from_toml(&text)?, self.seed));
        options.posture = Some(open(&self.robot.model, &plan)?);
        if held.paper_friction {
            options.coulomb = Some(self.values.friction.paper);
        }
        let drives: Vec<Drive> = self.robot.model.joints.iter().map(Drive::from).collect();
        Ok((plan, Plant::new(&self.robot.urdf, &drives, &self.values, &options)?))
    }
}

/// The object on its support, off the place where it should be.
fn standing(object: ObjectValues, seed: u64) -> ObjectValues {
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), PITCH);
    let mut random = Random::new(seed, Purpose::Placement);
    let offset = turn * Vector3::new(OFFSET * random.symmetric(), OFFSET * random.symmetric(), 0.0);
    let middle = Vector3::from(MIDDLE);
    let [_, _, height] = object.size;
    let below = middle - turn * Vector3::new(0.0, 0.0, (height + SUPPORT[2]) / 2.0);
    let orientation = UnitQuaternion::from_rotation_matrix(&turn).coords.into();
    let support = Support { size: SUPPORT, position: below.into(), orientation };
    object.at((middle + offset).into(), orientation).on(support)
}

/// Joint angles with each fingertip in front of its contact [rad].
fn open(model: &RobotModel, plan: &GraspPlan) -> Result<Vec<f64>, ScenarioError> {
    let mut posture = Vec::new();
    let fingers = model.chains.iter().zip(model.chain_ranges()).zip(&plan.contacts);
    for (finger, ((chain, range), contact)) in (1..).zip(fingers) {
        let error = |error: String| ScenarioError::Start { finger, error };
        let joints = &model.joints[range];
        let limits: Vec<(f32, f32)> =
            joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
        let limits = limits.try_into().map_err(|_| error("it has not three joints".to_owned()))?;
        let chain = Chain::new(joints, &chain.tip);
        let inverse = Finger::try_new(&chain, limits).map_err(|reason| error(reason.to_string()))?;
        let normal = Vector3::from(contact.normal).normalize();
        let place = Vector3::from(contact.position) - normal * (TIP + OPEN) as f32;
        let angles = inverse.nearest(&place, &NEAR).map_err(|reason| error(reason.to_string()))?;
        posture.extend(angles.map(f64::from));
    }
    Ok(posture)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::controller::{Native, Watched};

    /// Each object has a grasp that the hand can wait in front of, and stands clear of the open fingers.
    #[test]
    fn the_open_hand_touches_nothing() {
        let robot = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
        for object in ["box", "cylinder", "wedge"] {
            for seed in 1..=20 {
                let mut native = Native::default();
                let mut controller = Watched::new(&mut native, false);
                let setting =
                    Setting { robot, controller: &mut controller, seed, duration: 0.0, progress: &|_| {} };
                let bench = Bench::load(&setting).unwrap();
                assert_eq!(bench.base(), "palm");
                let held = Held { label: object, object, change: &|_| {}, paper_friction: false };
                let (plan, plant) = bench.place(&held).unwrap();
                assert!(plan.validate().is_ok());
                assert!(plant.contacts().iter().all(|contact| contact.depth <= 0.0), "{object} {seed}");
                let [x, y, z] = plant.object().unwrap().position;
                let off = (Vector3::new(x, y, z) - Vector3::from(MIDDLE)).norm();
                assert!(off > 0.0 && off < OFFSET * 2f64.sqrt() + 1e-6, "{object} {seed}: {off}");
            }
        }
    }
}
