//! Files in `laws/` of a robot folder: a control law with its settings, and the experiments of a paper that are run
//! with it.

pub mod arm;
pub mod hand;

use std::path::Path;

use tesaki::model::RobotModel;

use crate::finding::Finding;

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "laws";

/// What is wrong with a law of a robot: of an arm, or of a hand.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> Vec<Finding> {
    if hand::is_for(model) {
        hand::check(path, text, model).1
    } else if model.chains.len() == 1 {
        arm::check(path, text, model).1
    } else {
        Vec::new()
    }
}
