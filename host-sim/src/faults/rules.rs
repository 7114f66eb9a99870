//! The rules of safety, and their violations.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The rules, by number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Rule {
    /// Torques are finite, within the limits, and 0 while the outputs are off.
    Torque,
    /// Torques change no faster than the limits allow.
    TorqueRate,
    /// A held robot comes to rest.
    Rest,
    /// The drives bring no energy into a stopped robot.
    Energy,
    /// No joint passes its stops.
    Stops,
    /// The contact force does not rise.
    ContactForce,
    /// The tool moves slowly in contact.
    ToolSpeed,
    /// The cause is in the fault log.
    Cause,
    /// Outputs are on only if the commander enabled them.
    Enabled,
    /// No panic.
    Panic,
    /// A joint with a dead encoder is no longer driven.
    DeadEncoder,
}

impl Rule {
    /// All rules.
    pub const ALL: [Self; 11] = [
        Self::Torque,
        Self::TorqueRate,
        Self::Rest,
        Self::Energy,
        Self::Stops,
        Self::ContactForce,
        Self::ToolSpeed,
        Self::Cause,
        Self::Enabled,
        Self::Panic,
        Self::DeadEncoder,
    ];

    /// Its number in the documentation.
    pub const fn number(self) -> u8 {
        self as u8 + 1
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Self::Torque => "torque within limits",
            Self::TorqueRate => "torque rate within limits",
            Self::Rest => "a held robot comes to rest",
            Self::Energy => "no energy into a stopped robot",
            Self::Stops => "no joint beyond its stops",
            Self::ContactForce => "the contact force does not rise",
            Self::ToolSpeed => "slow in contact",
            Self::Cause => "the cause is readable",
            Self::Enabled => "enabled by the commander only",
            Self::Panic => "no panic",
            Self::DeadEncoder => "a dead encoder's joint is pushed no more",
        };
        write!(f, "S{} ({text})", self.number())
    }
}

/// A broken rule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// The rule.
    pub rule: Rule,
    /// Tick of the trial in which it was broken.
    pub tick: u32,
    /// The values that broke it.
    pub text: String,
}
