//! Files in `laws/` of a robot folder: a control law with its settings, and the experiments of a paper that are run
//! with it.

pub mod arm;

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "laws";
