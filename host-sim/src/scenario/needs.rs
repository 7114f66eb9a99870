//! What a scenario needs of a robot and its folder.

use std::path::Path;

use tesaki::kinematics::Hand;
use tesaki::model::{MAX_CHAIN_JOINTS, RobotModel};
use tesaki::teleop::HUMAN_FINGERS;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::hand::HandModel;

use super::{SCENARIOS, Scenario, ScenarioError, arm};

/// The kind of robot that a scenario is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// None takes part.
    None,
    /// Any.
    Any,
    /// Fingers of three joints each.
    Fingers,
    /// Three such fingers, each with a force sensor.
    GraspingHand,
    /// Five fingers.
    FiveFingers,
    /// An arm with a force sensor, without a set-point of its elbow: six or seven joints.
    Arm,
    /// Such an arm of seven joints.
    SevenJointArm,
    /// An arm with the geometry of robots/arm7.
    Arm7,
    /// An arm of six joints, and a gripper.
    ArmWithGripper,
}

/// Files of a scenario with the box.
pub const BOX: &[&str] = &["grasps/box.toml", "objects/box.toml"];

/// The files of every robot that is simulated.
const FILES: [&str; 3] = ["robot.urdf", "controller.toml", "plant.toml"];

impl Kind {
    /// Why the robot of `model` is of another kind.
    fn unfit(self, model: &RobotModel) -> Option<String> {
        let (chains, joints) = (model.chains.len(), model.joints.len());
        let has_sensor = model.chains.iter().any(|chain| chain.force_sensor.is_some());
        let is_arm = chains == 1 && matches!(joints, 6 | MAX_CHAIN_JOINTS) && has_sensor;
        let name = &model.name;
        let counted =
            |number: usize, what: &str| format!("{number} {what}{}", if number == 1 { "" } else { "s" });
        match self {
            Self::None | Self::Any => None,
            Self::Fingers => {
                let is_finger =
                    model.mimics.is_empty() && model.chain_ranges().all(|joints| joints.len() == 3);
                (!is_finger).then(|| "its paths are for fingers of three joints each".to_owned())
            }
            Self::GraspingHand => HandModel::try_new(model).err().map(|error| error.to_string()),
            Self::FiveFingers if chains != HUMAN_FINGERS => {
                Some(format!("it needs a hand of five fingers, thumb to little finger; {name} has {chains}"))
            }
            Self::FiveFingers => {
                Hand::of_model(model, [0.0, 0.0, 1.0], 0.0).err().map(|error| error.to_string())
            }
            Self::Arm | Self::SevenJointArm | Self::Arm7 if !is_arm => {
                let has = match (chains, joints) {
                    (1, 6 | MAX_CHAIN_JOINTS) => "no force sensor".to_owned(),
                    (1, _) => counted(joints, "joint"),
                    _ => counted(chains, "chain"),
                };
                let needed = "it needs an arm: one chain of six or seven joints with a force sensor";
                Some(format!("{needed}; {name} has {has}"))
            }
            Self::SevenJointArm if joints != MAX_CHAIN_JOINTS => {
                Some(format!("it leads the elbow, for which an arm needs seven joints; {name} has {joints}"))
            }
            Self::Arm7 if !arm::is_arm7(model) => {
                Some("it needs an arm with joints and hand of robots/arm7, in the same places".to_owned())
            }
            Self::ArmWithGripper if chains != 1 || joints != MAX_CHAIN_JOINTS => {
                Some("it needs an arm of six joints with a gripper: one chain of seven joints".to_owned())
            }
            Self::Arm | Self::SevenJointArm | Self::Arm7 | Self::ArmWithGripper => None,
        }
    }
}

impl Scenario {
    /// Refuses a robot of another kind than the scenario is for, and names those that take it; then a folder
    /// without some of the files that the scenario needs, with all of these.
    ///
    /// # Errors
    /// The same, or the folder is wrong.
    pub fn check_robot(&self, folder: &Path) -> Result<(), ScenarioError> {
        if self.kind == Kind::None {
            return Ok(());
        }
        let model = RobotFolder::load(folder)?.model;
        let robot = folder.display().to_string();
        if let Some(mut reason) = self.kind.unfit(&model) {
            let takes = |other: &&Self| {
                other.kind != Kind::None
                    && other.kind.unfit(&model).is_none()
                    && other.missing(folder).is_empty()
            };
            let others: Vec<&str> = SCENARIOS.iter().filter(takes).map(|other| other.name).collect();
            if !others.is_empty() {
                reason += &format!(". Scenarios for such a robot: {}", others.join(", "));
            }
            return Err(ScenarioError::OtherRobot { robot, reason });
        }
        let missing = self.missing(folder);
        if missing.is_empty() {
            return Ok(());
        }
        let (missing, files) = (missing.join(", "), self.needed().collect::<Vec<_>>().join(", "));
        Err(ScenarioError::MissingFiles { robot, missing, scenario: self.name, files, example: self.robot })
    }

    /// The files of a robot's folder that it needs.
    fn needed(&self) -> impl Iterator<Item = &'static str> {
        FILES.iter().chain(self.files).copied()
    }

    /// Those that `folder` lacks.
    fn missing(&self, folder: &Path) -> Vec<&'static str> {
        self.needed().filter(|file| !folder.join(file).exists()).collect()
    }
}
