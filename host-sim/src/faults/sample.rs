//! What the oracle sees.

use std::fmt;

use tesaki::fault::Fault;
use tesaki::model::{Reaction, RobotModel};
use tesaki::protocol::Mode;

/// Reduced speed, at which people may be near (ISO 10218-1) [m/s].
pub const REDUCED_SPEED: f64 = 0.25;

/// What the schedule does in a tick.
#[derive(Clone, Debug, Default)]
pub struct Acting {
    /// A fault begins or ends.
    pub changes: bool,
    /// The environment is disturbed, now or before.
    pub environment: bool,
    /// Something pushes the robot or its object.
    pub pushed: bool,
    /// Something of the scenario holds the tool.
    pub held: bool,
    /// What loaded the robot is gone.
    pub unloads: bool,
    /// An encoder lies.
    pub encoders: bool,
    /// An encoder drifts.
    pub drifts: bool,
    /// A drive does not do what it is told.
    pub drives: bool,
    /// By how much the latest drive is late [ticks].
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
    /// What the outputs do in a stop, and whether the task brings the robot to rest; for a trace.
    pub reaction: (Reaction, bool),
    /// Total of the fault log.
    pub total: u32,
    /// The latest fault.
    pub latest: Option<Fault>,
    /// Joint angles [rad].
    pub positions: Vec<f64>,
    /// Torques of the drives [N·m].
    pub drives: Vec<f64>,
    /// Torques of the weight [N·m].
    pub weight: Vec<f64>,
    /// Torques about the joints of what touches, pushes and pulls the robot [N·m].
    pub load: Vec<f64>,
    /// Kinetic energy [J].
    pub energy: f64,
    /// Velocities of the tips, and the largest speed [m/s].
    pub velocities: Vec<[f64; 3]>,
    pub speed: f64,
    /// Largest contact force on a tip [N].
    pub contact: f64,
    /// Stiffness of the stiffest wall [N/m].
    pub stiffness: f64,
    /// What the schedule does.
    pub acting: Acting,
}

impl fmt::Display for Sample {
    /// A line of a trace.
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

/// What the oracle knows of the machine.
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
    /// Kinetic energy of the robot at a tolerated speed of all its mass [J].
    pub fn tolerated_energy(&self) -> f64 {
        0.5 * self.mass * REDUCED_SPEED * REDUCED_SPEED
    }
}
