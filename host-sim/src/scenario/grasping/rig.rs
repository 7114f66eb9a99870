//! A hand with open fingers around something that stands nearly where it is thought to be.

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};
use tesaki::task::grasping::{GraspPlan, InternalForce, ObjectControl, WrenchGains};
use tesaki_description::grasp::{PlacedGrasp, load_placed};
use tesaki_description::robot::RobotFolder;

use crate::motion::Motion;
use crate::plant::{Drive, ObjectValues, Plant, PlantError, PlantOptions, PlantValues};
use crate::purpose::Purpose;
use crate::scenario::scene::{on_support, open_posture};
use crate::scenario::{ScenarioError, Setting};

/// The object stands off the place where it is thought to be by at most this much along each axis of its
/// support [m].
const OFFSET: f64 = 0.005;

/// The paper's law. The paper gives no gains; these bring its errors near those that it reports.
const PAPER_GAINS: WrenchGains =
    WrenchGains { position: [2000.0, 1000.0], orientation: [20.0, 10.0], damping: 0.1, compensated: false };
/// Largest of the paper's forces along the normals [N].
pub const PAPER_STRENGTH: f64 = 4.0;

/// What is in the hand in a part of a scenario, and how it is held.
pub struct GraspedObject<'a> {
    /// For people.
    pub label: &'a str,
    /// The name of its files in `objects/` and `grasps/`.
    pub object: &'a str,
    /// Changes what the grasp file says.
    pub change: &'a dyn Fn(&mut PlacedGrasp),
    /// Whether the joints have the friction that the paper's losses imply, and the object is held under the
    /// paper's law.
    pub paper: bool,
}

/// What all parts of a scenario share.
pub struct GraspRig {
    pub robot: RobotFolder,
    /// The machine's motors and encoders, as its maker sold them.
    drives: Vec<Drive>,
    pub values: PlantValues,
    pub motion: Motion,
    seed: u64,
}

impl GraspRig {
    /// Reads the robot's folder.
    pub fn load(setting: &Setting<'_, '_>) -> Result<Self, ScenarioError> {
        let robot = RobotFolder::load(setting.robot)?;
        let motion = Motion::new(robot.model.joints.iter().map(|joint| joint.name.as_str()));
        let drives = robot.model.joints.iter().map(Drive::from).collect();
        Ok(Self { values: PlantValues::load(setting.robot)?, robot, drives, motion, seed: setting.seed })
    }

    /// The link that carries all others.
    pub fn base(&self) -> &str {
        self.robot.urdf.base()
    }

    /// The grasp of an object, as its file says.
    pub fn grasp(&self, object: &str) -> Result<PlacedGrasp, ScenarioError> {
        Ok(load_placed(&self.robot.path.join(format!("grasps/{object}.toml")))?)
    }

    /// The grasp, and a machine with what is to be grasped.
    pub fn set_up(&self, held: &GraspedObject<'_>) -> Result<(GraspPlan, Plant), ScenarioError> {
        let mut grasp = self.grasp(held.object)?;
        if held.paper {
            grasp.plan.control = ObjectControl::Wrench(PAPER_GAINS);
            grasp.plan.internal = InternalForce::Normal { strength: PAPER_STRENGTH as f32 };
            grasp.plan.feedback = false;
        }
        (held.change)(&mut grasp);
        let path = self.robot.path.join(format!("objects/{}.toml", held.object));
        let text = std::fs::read_to_string(&path)
            .map_err(|error| PlantError::Read { path, reason: error.to_string() })?;
        let mut options = PlantOptions::mismatched(self.seed);
        options.object = Some(self.standing(ObjectValues::from_toml(&text)?, &grasp));
        options.posture = Some(open_posture(&self.robot.model, &grasp.plan)?);
        if held.paper {
            options.coulomb = Some(self.values.friction.paper);
        }
        let mut plant = Plant::new(&self.robot.urdf, &self.drives, &self.values, &options)?;
        plant.configure_amplifiers(&self.robot.model);
        Ok((grasp.plan, plant))
    }

    /// The object on its support, off the place where it should be.
    fn standing(&self, object: ObjectValues, grasp: &PlacedGrasp) -> ObjectValues {
        let [x, y, z, w] = grasp.orientation;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        let mut rng = Purpose::Placement.rng(self.seed);
        let offset = turn * Vector3::new(OFFSET * rng.symmetric(), OFFSET * rng.symmetric(), 0.0);
        let object = on_support(object, grasp);
        let place = Vector3::from(object.position) + offset;
        object.at(place.into(), grasp.orientation)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::controller::{Native, Watched};

    /// PerFinger object has a grasp that the hand can wait in front of, and stands clear of the open fingers.
    #[test]
    fn the_open_hand_touches_nothing() {
        let robot = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
        for object in ["box", "cylinder", "wedge"] {
            for seed in 1..=20 {
                let mut native = Native::default();
                let mut controller = Watched::new(&mut native, false);
                let setting =
                    Setting { robot, controller: &mut controller, seed, duration: 0.0, progress: &|_| {} };
                let rig = GraspRig::load(&setting).unwrap();
                assert_eq!(rig.base(), "palm");
                let held = GraspedObject { label: object, object, change: &|_| {}, paper: false };
                let (plan, plant) = rig.set_up(&held).unwrap();
                assert!(plan.validate().is_ok());
                assert!(plant.contacts().iter().all(|contact| contact.depth <= 0.0), "{object} {seed}");
                let [x, y, z] = plant.object().unwrap().position;
                let off = (Vector3::new(x, y, z) - Vector3::new(0.090, 0.0, 0.085)).norm();
                assert!(off > 0.0 && off < OFFSET * 2f64.sqrt() + 1e-6, "{object} {seed}: {off}");
            }
        }
    }
}
