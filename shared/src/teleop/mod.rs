//! A master and a slave apart from each other: what goes from the operator's hand to the arm, and back.

mod passivity;

pub use passivity::{Port, PortLimits};
