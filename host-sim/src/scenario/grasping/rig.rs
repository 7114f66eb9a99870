//! A hand with open fingers around an object near its nominal position.

use std::path::Path;

use rapier3d::na::Vector3;
use tesaki::task::grasping::GraspPlan;
use tesaki_description::grasp::{PlacedGrasp, load_placed};
use tesaki_description::law;
use tesaki_description::law::hand::{self, ObjectLaw};
use tesaki_description::object;
use tesaki_description::robot::RobotFolder;

use crate::motion::Motion;
use crate::plant::{
    Drive, ObjectValues, Plant, PlantOptions, PlantValues, SharedIntervention, unit_quaternion,
};
use crate::purpose::Purpose;
use crate::scenario::scene::{down, on_support, open_posture};
use crate::scenario::{ScenarioError, Setting};

/// Largest distance of the object from its nominal position along each axis of its support [m].
const MAX_OFFSET: f64 = 0.005;

/// The object of a trial, and how the hand holds it.
pub struct GraspedObject<'a> {
    /// Name of the trial in the recording.
    pub label: &'a str,
    /// The name of the object's files in `objects/` and `grasps/`.
    pub object: &'a str,
    /// Changes the grasp that was read from the file.
    pub change: &'a dyn Fn(&mut PlacedGrasp),
    /// Coulomb friction of the joints instead of the robot's [N·m].
    pub coulomb: Option<f64>,
    /// Whether the force sensors are recorded.
    pub records_forces: bool,
}

impl<'a> GraspedObject<'a> {
    /// An object of the robot's folder, held as its grasp file says.
    pub const fn new(label: &'a str, object: &'a str) -> Self {
        Self { label, object, change: &|_| {}, coulomb: None, records_forces: false }
    }
}

/// Robot, plant values and recording that all trials of a scenario share.
pub struct GraspRig {
    pub robot: RobotFolder,
    /// The machine's motors and encoders, with nominal values.
    pub drives: Vec<Drive>,
    pub values: PlantValues,
    pub motion: Motion,
    seed: u64,
    intervention: Option<SharedIntervention>,
}

impl GraspRig {
    /// Reads the robot's folder.
    pub fn load(setting: &Setting<'_, '_>) -> Result<Self, ScenarioError> {
        let mut rig = Self::of_machine(setting.robot, setting.seed, setting.intervention.clone())?;
        rig.motion = setting.motion(&rig.robot.model);
        Ok(rig)
    }

    /// Reads the folder of a robot, whose machine the seed decides.
    pub fn of_machine(
        folder: &Path,
        seed: u64,
        intervention: Option<SharedIntervention>,
    ) -> Result<Self, ScenarioError> {
        let robot = RobotFolder::load(folder)?;
        let motion = Motion::new(robot.model.joints.iter().map(|joint| joint.name.as_str()));
        let drives = robot.model.joints.iter().map(Drive::from).collect();
        Ok(Self { values: PlantValues::load(folder)?, robot, drives, motion, seed, intervention })
    }

    /// Name of the base link.
    pub fn base(&self) -> &str {
        self.robot.urdf.base()
    }

    /// The grasp of an object, as its file says.
    pub fn grasp(&self, object: &str) -> Result<PlacedGrasp, ScenarioError> {
        Ok(load_placed(&self.robot.path.join(format!("grasps/{object}.toml")))?)
    }

    /// The paper's control of the object's pose, with our estimates of pose and load.
    pub fn paper_law(&self) -> Result<ObjectLaw, ScenarioError> {
        let path = self.robot.path.join(law::FOLDER).join("paper-corrected.toml");
        Ok(hand::load(&path, &self.robot.model)?.motion.law)
    }

    /// The grasp of an object, and the object on its support.
    pub fn placed(&self, held: &GraspedObject<'_>) -> Result<(PlacedGrasp, ObjectValues), ScenarioError> {
        let mut grasp = self.grasp(held.object)?;
        (held.change)(&mut grasp);
        let path = self.robot.path.join(object::FOLDER).join(format!("{}.toml", held.object));
        let object = self.place_object(ObjectValues::load(&path)?, &grasp);
        Ok((grasp, object))
    }

    /// The grasp plan, and a machine with the object on its support.
    pub fn set_up(&self, held: &GraspedObject<'_>) -> Result<(GraspPlan, Plant), ScenarioError> {
        let (grasp, object) = self.placed(held)?;
        let mut options = PlantOptions::mismatched(self.seed);
        options.object = Some(object);
        options.posture = Some(open_posture(&self.robot.model, &grasp.plan)?);
        options.coulomb = held.coulomb;
        let plant = Plant::new(&self.robot.urdf, &self.drives, &self.values, &options)?;
        let mut plant = plant.under(self.intervention.clone());
        plant.configure_amplifiers(&self.robot.model);
        Ok((grasp.plan, plant))
    }

    /// The object on its support, with a seeded offset from its nominal position.
    fn place_object(&self, object: ObjectValues, grasp: &PlacedGrasp) -> ObjectValues {
        let rotation = unit_quaternion(grasp.orientation);
        let mut rng = Purpose::Placement.rng(self.seed);
        let (vertical, _) = down(grasp, self.robot.model.gravity);
        let offset =
            Vector3::from_fn(|axis, _| if axis == vertical { 0.0 } else { MAX_OFFSET * rng.symmetric() });
        let object = on_support(object, grasp, self.robot.model.gravity);
        let position = Vector3::from(object.position) + rotation * offset;
        object.at(position.into(), grasp.orientation)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::controller::{Native, Watched};

    /// Each object has a reachable open posture, and stands clear of the open fingers.
    #[test]
    fn the_open_hand_touches_nothing() {
        let robot = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
        for object in ["box", "cylinder", "wedge"] {
            for seed in 1..=20 {
                let mut native = Native::default();
                let mut controller = Watched::new(&mut native, false);
                let setting = Setting::plain(robot, &mut controller, seed, 0.0);
                let rig = GraspRig::load(&setting).unwrap();
                assert_eq!(rig.base(), "palm");
                let held = GraspedObject::new(object, object);
                let (plan, plant) = rig.set_up(&held).unwrap();
                assert!(plan.validate().is_ok());
                assert!(plant.contacts().iter().all(|contact| contact.depth <= 0.0), "{object} {seed}");
                let [x, y, z] = plant.object().unwrap().position;
                let off = (Vector3::new(x, y, z) - Vector3::new(0.090, 0.0, 0.085)).norm();
                assert!(off > 0.0 && off < MAX_OFFSET * 2f64.sqrt() + 1e-6, "{object} {seed}: {off}");
            }
        }
    }
}
