//! The oracle's observations.

use std::fmt;

use tesaki::fault::Fault;
use tesaki::model::{Reaction, RobotModel};
use tesaki::protocol::Mode;

/// Reduced speed, at which people may be near (ISO 10218-1) [m/s].
pub const REDUCED_SPEED: f64 = 0.25;

/// Effects of the schedule in a tick.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    /// A fault begins or ends.
    pub changes: bool,
    /// The environment is disturbed, or was before.
    pub environment: bool,
    /// Something pushes the robot or its object.
    pub pushed: bool,
    /// Something in the scenario holds the tool.
    pub held: bool,
    /// A load on the robot was removed.
    pub unloads: bool,
    /// An encoder gives wrong counts.
    pub encoders: bool,
    /// An encoder drifts.
    pub drifts: bool,
    /// A drive does not follow its command.
    pub drives: bool,
    /// Largest delay of a drive [ticks].
    pub late: u32,
    /// The joints whose drives are late.
    pub late_drives: Vec<usize>,
    /// The joints whose drives cannot carry the weight.
    pub weak_drives: Vec<usize>,
}

/// One control period: what the board answered at its start, and the truth at its end.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Tick of the trial.
    pub tick: u32,
    /// Whether the board ticked.
    pub answered: bool,
    /// Mode after the tick.
    pub mode: Mode,
    /// Whether the outputs are on.
    pub enabled: bool,
    /// Torques [N·m].
    pub torques: Vec<f32>,
    /// Encoder counts as the board read them, and as they truly are.
    pub counts: [Vec<i32>; 2],
    /// Reaction to a fault, and whether the task brings the robot to rest; for a trace.
    pub reaction: (Reaction, bool),
    /// Number of faults logged since power-on.
    pub total: u32,
    /// The latest fault.
    pub latest: Option<Fault>,
    /// Joint angles [rad].
    pub positions: Vec<f64>,
    /// Torques of the drives [N·m].
    pub drives: Vec<f64>,
    /// Torques that balance the weight [N·m].
    pub weight: Vec<f64>,
    /// Joint torques caused by contacts, pushes and pulls on the robot [N·m].
    pub load: Vec<f64>,
    /// Kinetic energy [J].
    pub energy: f64,
    /// Velocities of the tips, and the largest of their speeds [m/s].
    pub velocities: Vec<[f64; 3]>,
    pub speed: f64,
    /// Largest contact force on a tip [N].
    pub contact: f64,
    /// Stiffness of the stiffest wall [N/m].
    pub stiffness: f64,
    /// Effects of the schedule.
    pub acting: Acting,
}

impl fmt::Display for Sample {
    /// Writes a line of a trace.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tick, mode, total, energy, speed, contact, .. } = self;
        let state = match (self.mode, self.reaction) {
            _ if !self.answered => "no tick",
            _ if !self.enabled => "off",
            (Mode::Fault, (Reaction::Hold, true)) => "brought to rest by the task",
            (Mode::Fault, (Reaction::Hold, false)) => "held",
            (Mode::Fault, _) => "damped",
            _ => "on",
        };
        write!(
            f,
            "{tick:>5} {mode}, {state}, {total} faults, {energy:.4} J, {speed:.3} m/s, {contact:.2} N;"
        )?;
        let values = self.torques.iter().zip(&self.drives).zip(self.weight.iter().zip(&self.positions));
        for ((torque, drive), (weight, angle)) in values {
            write!(f, "  {torque:.2} {drive:.2} ({weight:.2}) N·m {angle:.4} rad")?;
        }
        Ok(())
    }
}

/// The oracle's knowledge of the machine.
#[derive(Clone, Debug)]
pub struct Machine {
    /// The robot's model, for its limits.
    pub model: RobotModel,
    /// True end stops [rad].
    pub stops: Vec<Option<[f64; 2]>>,
    /// True Coulomb friction of the joints [N·m].
    pub coulomb: Vec<f64>,
    /// Mass of all links [kg].
    pub mass: f64,
    /// Noise of a contact force [N].
    pub force_noise: f64,
}

impl Machine {
    /// Kinetic energy of the robot's whole mass at the tolerated speed [J].
    pub fn tolerated_energy(&self) -> f64 {
        0.5 * self.mass * REDUCED_SPEED * REDUCED_SPEED
    }
}
