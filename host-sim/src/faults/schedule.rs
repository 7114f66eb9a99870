//! Schedules: the scenario to run, and the times at which faults begin.

use std::fmt;

use serde::{Deserialize, Serialize};
use tesaki::model::RobotModel;
use tesaki_rng::Rng;

/// Random number stream that draws a schedule.
const SCHEDULE: u64 = 100;
/// Seed of the machine in schedule 0.
const FIRST_MACHINE: u64 = 1_000_000;
/// Largest number of faults in a schedule.
const MAX_FAULTS: u32 = 4;
/// All faults begin within this time of the first one [ticks].
const SPREAD: u32 = 60;
/// The run continues for this time after the last fault has begun [ticks].
const AFTERMATH: u32 = 150;

/// A scenario in which schedules run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its name, or `served`.
    pub scenario: &'static str,
    /// Folder of its robot.
    pub robot: &'static str,
    /// Number of trials to choose from; those before the chosen one are skipped.
    trials: u32,
    /// First and last tick of a trial in which a fault may begin.
    ticks: [u32; 2],
}

/// Name of the place without a scenario: a client enables a served board again after each fault.
pub const SERVED: &str = "served";

const fn place(scenario: &'static str, robot: &'static str, trials: u32, ticks: [u32; 2]) -> Place {
    Place { scenario, robot, trials, ticks }
}

/// Largest number of ticks, or trial, in a schedule.
const MAX_NUMBER: u32 = 1_000_000;

/// All places; consecutive seeds take them in turn.
pub const PLACES: &[Place] = &[
    place("hand3-servo", "hand3", 4, [5, 500]),
    place("hand3-reach", "hand3", 2, [5, 600]),
    place("arm7-release", "arm7", 4, [60, 240]),
    place("arm7-wall", "arm7", 6, [60, 340]),
    place("hand3-grasp", "hand3", 1, [60, 440]),
    place("arm7-elbow", "arm7", 2, [60, 440]),
    place(SERVED, "arm7", 1, [10, 300]),
    place("arm7-straight", "arm7", 2, [60, 500]),
    place("hand3-force", "hand3", 1, [60, 440]),
    place("arm7-bilateral", "arm7", 3, [60, 370]),
    place("hand3-weights", "hand3", 1, [60, 440]),
    place("arm7-follow", "arm7", 1, [60, 700]),
    place("hand3-turn", "hand3", 1, [60, 440]),
    place(SERVED, "hand3", 1, [10, 300]),
    place("arm7-wall", "arm7", 6, [120, 300]),
    place("hand5-teleop", "hand5", 3, [5, 1400]),
    place("arm7-elbow", "arm7", 2, [60, 440]),
    place(SERVED, "hand5", 1, [10, 300]),
    place("arm7-bilateral", "arm7", 3, [60, 370]),
    place("hand3-shift", "hand3", 1, [60, 440]),
];

/// Families of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Family {
    /// Between commander and board.
    Link,
    /// Encoders and force sensors.
    Sensors,
    /// Supply voltage.
    Supply,
    /// Drives.
    Drive,
    /// The commanding program.
    Commander,
    /// The board itself.
    Board,
    /// Things that the robot touches.
    Environment,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 7] = [
        Self::Link,
        Self::Sensors,
        Self::Supply,
        Self::Drive,
        Self::Commander,
        Self::Board,
        Self::Environment,
    ];
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Link => "link",
            Self::Sensors => "sensors",
            Self::Supply => "supply",
            Self::Drive => "drive",
            Self::Commander => "commander",
            Self::Board => "board",
            Self::Environment => "environment",
        })
    }
}

/// Kinds of fault. A `joint` or `sensor` is an index.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
#[allow(missing_docs, reason = "a variant's line says what its fields are")]
pub enum Kind {
    /// Link: a request is lost with this probability.
    Loss { probability: f64 },
    /// Link: a request arrives up to five ticks late with this probability, behind later ones.
    Reorder { probability: f64 },
    /// Link: a request arrives a second time, up to five ticks later, with this probability.
    Duplicate { probability: f64 },
    /// Link: all requests arrive late [ticks].
    Delay { late: u32 },
    /// Link: bytes are lost, flipped and repeated with this probability each.
    Damage { probability: f64 },
    /// Link: nothing arrives.
    Cut,
    /// Sensors: an encoder's count freezes.
    Stuck { joint: usize },
    /// Sensors: an encoder's count jumps.
    Jump { joint: usize, counts: i32 },
    /// Sensors: an encoder's count drifts [counts/tick].
    Drift { joint: usize, rate: f64 },
    /// Sensors: an encoder is noisy; standard deviation in counts.
    Noise { joint: usize, counts: f64 },
    /// Sensors: a force sensor is saturated.
    Saturation { sensor: usize },
    /// Sensors: two encoders' cables are swapped.
    Swapped { joint: usize, other: usize },
    /// Sensors: all counts of a force sensor are 0.
    ForceLow { sensor: usize },
    /// Supply: the voltage sags to this [V].
    Sag { voltage: f64 },
    /// Supply: the voltage rises to this [V].
    Surge { voltage: f64 },
    /// Drive: the torque is this fraction of the commanded one.
    Weak { joint: usize, factor: f64 },
    /// Drive: the torque has the wrong sign.
    Reversed { joint: usize },
    /// Drive: no torque.
    Dead { joint: usize },
    /// Drive: the torque comes late [ticks].
    Late { joint: usize, late: u32 },
    /// Commander: it stops sending.
    Killed,
    /// Commander: a second program tries to command, and sends a request with this probability each tick.
    Second { probability: f64 },
    /// Commander: it, or a program without command, sends invalid requests with this probability each tick.
    Nonsense { probability: f64 },
    /// Board: it is reset.
    Reset,
    /// Board: it misses ticks.
    Skip,
    /// Environment: something pushes a link; force in the base frame [N].
    Push { joint: usize, force: [f64; 3] },
    /// Environment: a wall appears ahead of the tool [m, N/m].
    Wall { direction: [f64; 3], clearance: f64, stiffness: f64 },
    /// Environment: the object, or the tool, is pulled [N].
    Pull { force: [f64; 3] },
    /// Environment: the object, or the walls, are gone.
    Removed,
}

impl Kind {
    /// The family it belongs to.
    pub const fn family(&self) -> Family {
        match self {
            Self::Loss { .. }
            | Self::Reorder { .. }
            | Self::Duplicate { .. }
            | Self::Delay { .. }
            | Self::Damage { .. }
            | Self::Cut => Family::Link,
            Self::Stuck { .. }
            | Self::Jump { .. }
            | Self::Drift { .. }
            | Self::Noise { .. }
            | Self::Saturation { .. }
            | Self::Swapped { .. }
            | Self::ForceLow { .. } => Family::Sensors,
            Self::Sag { .. } | Self::Surge { .. } => Family::Supply,
            Self::Weak { .. } | Self::Reversed { .. } | Self::Dead { .. } | Self::Late { .. } => {
                Family::Drive
            }
            Self::Killed | Self::Second { .. } | Self::Nonsense { .. } => Family::Commander,
            Self::Reset | Self::Skip => Family::Board,
            Self::Push { .. } | Self::Wall { .. } | Self::Pull { .. } | Self::Removed => Family::Environment,
        }
    }

    /// The joints that it names.
    pub const fn joints(&self) -> [Option<usize>; 2] {
        match *self {
            Self::Swapped { joint, other } => [Some(joint), Some(other)],
            Self::Stuck { joint }
            | Self::Jump { joint, .. }
            | Self::Drift { joint, .. }
            | Self::Noise { joint, .. }
            | Self::Weak { joint, .. }
            | Self::Reversed { joint }
            | Self::Dead { joint }
            | Self::Late { joint, .. }
            | Self::Push { joint, .. } => [Some(joint), None],
            _ => [None; 2],
        }
    }

    /// The force sensor that it names.
    pub const fn sensor(&self) -> Option<usize> {
        match *self {
            Self::Saturation { sensor } | Self::ForceLow { sensor } => Some(sensor),
            _ => None,
        }
    }

    /// The joint whose drive is weak or dead.
    pub const fn weak_drive(&self) -> Option<usize> {
        match *self {
            Self::Weak { joint, .. } | Self::Dead { joint } => Some(joint),
            _ => None,
        }
    }

    /// The joint whose drive is late.
    pub const fn late_drive(&self) -> Option<usize> {
        match *self {
            Self::Late { joint, .. } => Some(joint),
            _ => None,
        }
    }

    /// Delay of the drive [ticks].
    pub const fn lateness(&self) -> u32 {
        match *self {
            Self::Late { late, .. } => late,
            _ => 0,
        }
    }

    /// Returns simpler variants, for shrinking, for example with half the magnitude.
    pub fn simpler(&self) -> Vec<Self> {
        let half = |vector: [f64; 3]| vector.map(|part| (part / 2.0).round());
        let is_large = |vector: [f64; 3]| vector.iter().any(|part| part.abs() >= 2.0);
        let simpler = match *self {
            Self::Loss { probability } if probability < 1.0 => Self::Cut,
            Self::Damage { probability } if probability < 0.5 => Self::Cut,
            Self::Delay { late } if late > 1 => Self::Delay { late: late / 2 },
            Self::Late { joint, late } if late > 1 => Self::Late { joint, late: late / 2 },
            Self::Jump { joint, counts } if counts.abs() > 1 => Self::Jump { joint, counts: counts / 2 },
            Self::Drift { joint, rate } if rate.abs() >= 2.0 => {
                Self::Drift { joint, rate: (rate / 2.0).round() }
            }
            Self::Noise { joint, counts } if counts >= 2.0 => {
                Self::Noise { joint, counts: (counts / 2.0).round() }
            }
            Self::Weak { joint, factor } if factor > 0.0 => Self::Dead { joint },
            Self::Push { joint, force } if is_large(force) => Self::Push { joint, force: half(force) },
            Self::Pull { force } if is_large(force) => Self::Pull { force: half(force) },
            _ => return Vec::new(),
        };
        vec![simpler]
    }
}

/// A fault of a schedule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Its kind.
    #[serde(flatten)]
    pub kind: Kind,
    /// First tick of the trial in which it acts.
    pub begin: u32,
    /// Duration [ticks]; none: to the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ticks: Option<u32>,
}

impl Fault {
    /// Returns whether it acts in a tick.
    pub fn acts(&self, tick: u32) -> bool {
        tick >= self.begin && self.ticks.is_none_or(|ticks| tick - self.begin < ticks)
    }

    /// Returns whether it takes a load off the robot in a tick.
    pub fn unloads(&self, tick: u32) -> bool {
        self.changes(tick)
            && match self.kind {
                Kind::Removed => tick == self.begin,
                Kind::Push { .. } | Kind::Pull { .. } => tick != self.begin,
                _ => false,
            }
    }

    /// Returns whether it begins or ends in a tick.
    pub fn changes(&self, tick: u32) -> bool {
        tick == self.begin || self.ticks.is_some_and(|ticks| tick == self.begin.saturating_add(ticks))
    }
}

/// A run with faults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// Determines the machine and the random parts of the faults.
    pub seed: u64,
    /// Name of the scenario, or `served`.
    pub scenario: String,
    /// Folder of its robot.
    pub robot: String,
    /// Trial of the scenario, from 0.
    pub trial: u32,
    /// Number of ticks of the trial that are run.
    pub end: u32,
    /// The faults.
    pub faults: Vec<Fault>,
}

impl Schedule {
    /// Draws the schedule of a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = Rng::new(seed, SCHEDULE);
        let place = &PLACES[usize::try_from(seed % PLACES.len() as u64).unwrap_or(0)];
        let trial = rng.below(place.trials);
        let [first, last] = place.ticks;
        let start = first + rng.below(last - first);
        let count = 1 + rng.below(MAX_FAULTS);
        let mut faults: Vec<Fault> = (0..count)
            .map(|index| {
                let begin = start + if index == 0 { 0 } else { rng.below(SPREAD) };
                let lasting = rng.chance(0.5);
                let ticks = 1 + rng.below(80);
                let kind = draw_kind(&mut rng, Size::of(place.robot));
                // Instantaneous faults act for one tick.
                let ticks = match kind {
                    Kind::Reset | Kind::Removed => Some(1),
                    Kind::Skip => Some(1 + ticks % 12),
                    Kind::Push { .. } | Kind::Pull { .. } => Some(ticks),
                    Kind::Wall { .. } => None,
                    _ => (!lasting).then_some(ticks),
                };
                Fault { kind, begin, ticks }
            })
            .collect();
        faults.sort_by_key(|fault| fault.begin);
        let end = faults.last().map_or(start, |fault| fault.begin) + AFTERMATH;
        Self { seed, scenario: place.scenario.into(), robot: place.robot.into(), trial, end, faults }
    }

    /// Checks a schedule that was not drawn.
    ///
    /// # Errors
    /// A number of ticks or a trial that no run reaches: the text names it.
    pub fn validate(&self) -> Result<(), String> {
        let of_fault = |fault: &Fault| {
            let late = match fault.kind {
                Kind::Late { late, .. } | Kind::Delay { late } => late,
                _ => 0,
            };
            [("begin", fault.begin), ("ticks", fault.ticks.unwrap_or(0)), ("late", late)]
        };
        let mut numbers = [("trial", self.trial), ("end", self.end)]
            .into_iter()
            .chain(self.faults.iter().flat_map(of_fault));
        if let Some((name, value)) = numbers.find(|(_, value)| *value > MAX_NUMBER) {
            return Err(format!("`{name}` is {value}; at most {MAX_NUMBER} is possible"));
        }
        match self.faults.iter().find(|fault| fault.begin >= self.end) {
            Some(Fault { begin, .. }) => {
                Err(format!("a fault begins in tick {begin}, and the run ends in tick {}", self.end))
            }
            None => Ok(()),
        }
    }

    /// Checks that the robot has what the faults name.
    ///
    /// # Errors
    /// What it does not have.
    pub fn check(&self, model: &RobotModel) -> Result<(), String> {
        let sensors = model.chains.iter().filter(|chain| chain.force_sensor.is_some()).count();
        for Fault { kind, .. } in &self.faults {
            let found = [
                ("joint", kind.joints().into_iter().flatten().max(), model.joints.len()),
                ("sensor", kind.sensor(), sensors),
            ];
            for (name, index, count) in found {
                if let Some(index) = index.filter(|index| *index >= count) {
                    return Err(format!("{name} {index} of {}, which has {count}, from 0 on", model.name));
                }
            }
            if matches!(kind, Kind::Wall { direction, .. } if direction.iter().all(|part| *part == 0.0)) {
                return Err("a wall in the direction [0, 0, 0]: give one that is not 0".to_owned());
            }
        }
        Ok(())
    }

    /// Seed of its machine, outside the development and evaluation sets.
    pub const fn machine(&self) -> u64 {
        FIRST_MACHINE.saturating_add(self.seed)
    }

    /// The command that repeats it.
    pub fn command(&self) -> String {
        let text = serde_json::to_string(self).unwrap_or_default();
        format!("cargo sim faults --schedule '{text}'")
    }

    /// The families of its faults, without duplicates.
    pub fn families(&self) -> Vec<Family> {
        Family::ALL
            .into_iter()
            .filter(|family| self.faults.iter().any(|fault| fault.kind.family() == *family))
            .collect()
    }
}

/// Ranges from which the faults of a robot are drawn.
#[derive(Clone, Copy)]
struct Size {
    joints: u32,
    force_sensors: u32,
    /// Counts per turn of an encoder.
    turn: f64,
    /// Supply voltage [V].
    voltage: f64,
    /// Largest external force [N].
    force: f64,
}

impl Size {
    fn of(robot: &str) -> Self {
        let hand = Self { joints: 9, force_sensors: 3, turn: 65_536.0, voltage: 24.0, force: 6.0 };
        match robot {
            "arm7" => Self { joints: 7, force_sensors: 1, turn: 262_144.0, voltage: 48.0, force: 150.0 },
            "hand5" => Self { joints: 16, force_sensors: 0, ..hand },
            _ => hand,
        }
    }
}

fn draw_kind(rng: &mut Rng, of: Size) -> Kind {
    let Size { joints, force_sensors, turn, voltage, force } = of;
    let index = |rng: &mut Rng, below: u32| usize::try_from(rng.below(below)).unwrap_or(0);
    let family = Family::ALL[index(rng, 7)];
    let joint = index(rng, joints);
    let sensor = index(rng, force_sensors.max(1));
    let variant = rng.below(7);
    // Covers all magnitudes: small ones, which are hard to detect, to large ones.
    let size = rng.uniform() * rng.uniform();
    let sign = if rng.chance(0.5) { 1.0 } else { -1.0 };
    let direction: [f64; 3] = core::array::from_fn(|_| rng.symmetric());
    let round = |value: f64| (value * 1000.0).round() / 1000.0;
    match (family, variant) {
        (Family::Link, 0) => Kind::Loss { probability: round(0.1 + 0.9 * size) },
        (Family::Link, 1) => Kind::Reorder { probability: round(0.1 + 0.9 * size) },
        (Family::Link, 2) => Kind::Duplicate { probability: round(0.1 + 0.9 * size) },
        (Family::Link, 3) => Kind::Delay { late: 1 + rng.below(20) },
        (Family::Link, 4) => Kind::Damage { probability: round(0.001 + 0.02 * size) },
        (Family::Link, _) => Kind::Cut,
        (Family::Sensors, 0) => Kind::Stuck { joint },
        (Family::Sensors, 1) => Kind::Jump { joint, counts: (sign * (1.0 + size * turn / 4.0)) as i32 },
        (Family::Sensors, 2) => Kind::Drift { joint, rate: (sign * (1.0 + size * turn / 300.0)).round() },
        (Family::Sensors, 3) => Kind::Noise { joint, counts: (1.0 + size * turn / 500.0).round() },
        (Family::Sensors, 4) if force_sensors > 0 => Kind::Saturation { sensor },
        (Family::Sensors, 5) => Kind::Swapped { joint, other: (joint + 1) % joints as usize },
        (Family::Sensors, _) if force_sensors > 0 => Kind::ForceLow { sensor },
        (Family::Sensors, _) => Kind::Stuck { joint },
        (Family::Supply, 0..=3) => Kind::Sag { voltage: round((1.0 - size) * 0.93 * voltage) },
        (Family::Supply, _) => Kind::Surge { voltage: round((1.0 + size) * voltage) },
        (Family::Drive, 0 | 1) => Kind::Weak { joint, factor: round(0.9 * rng.uniform()) },
        (Family::Drive, 2 | 3) => Kind::Reversed { joint },
        (Family::Drive, 4) => Kind::Dead { joint },
        (Family::Drive, _) => Kind::Late { joint, late: 1 + rng.below(10) },
        (Family::Commander, 0 | 1) => Kind::Killed,
        (Family::Commander, 2..=4) => Kind::Second { probability: round(0.1 + 0.9 * size) },
        (Family::Commander, _) => Kind::Nonsense { probability: round(0.1 + 0.9 * size) },
        (Family::Board, 0..=2) => Kind::Reset,
        (Family::Board, _) => Kind::Skip,
        (Family::Environment, 0..=2) => {
            let force = size * force;
            Kind::Push { joint, force: direction.map(|part| round(part * force)) }
        }
        (Family::Environment, 3) => {
            // Mostly forward, where the scenarios' walls are.
            let direction = if rng.chance(0.5) { [1.0, 0.0, 0.0] } else { direction.map(round) };
            let (clearance, stiffness) =
                (round(0.002 + 0.02 * size), round(10f64.powf(2.5 + 2.0 * rng.uniform())));
            Kind::Wall { direction, clearance, stiffness }
        }
        (Family::Environment, 4 | 5) => {
            let force = size * force;
            Kind::Pull { force: direction.map(|part| round(part * force)) }
        }
        (Family::Environment, _) => Kind::Removed,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    #[test]
    fn a_seed_draws_the_same_schedule_and_its_text_reads_back() {
        for seed in 1..500 {
            let schedule = Schedule::draw(seed);
            assert_eq!(schedule, Schedule::draw(seed));
            assert!((1..=4).contains(&schedule.faults.len()));
            let text = serde_json::to_string(&schedule).unwrap();
            assert_eq!(serde_json::from_str::<Schedule>(&text).unwrap(), schedule, "{text}");
            assert!(schedule.scenario == SERVED || Scenario::find(&schedule.scenario).is_some());
        }
    }

    #[test]
    fn numbers_that_no_run_reaches_are_refused_by_name() {
        let drawn = Schedule::draw(1);
        assert_eq!(drawn.validate(), Ok(()));
        let late = Fault { kind: Kind::Late { joint: 0, late: u32::MAX }, begin: 0, ticks: None };
        let told = Schedule { faults: vec![late], ..drawn.clone() }.validate().unwrap_err();
        assert_eq!(told, "`late` is 4294967295; at most 1000000 is possible");
        assert!(Schedule { trial: u32::MAX, ..drawn.clone() }.validate().is_err());
        let never = Fault { kind: Kind::Cut, begin: drawn.end, ticks: None };
        assert!(
            Schedule { faults: vec![never], ..drawn }.validate().unwrap_err().contains("the run ends in")
        );
    }

    #[test]
    fn every_place_and_every_family_has_its_turn() {
        let schedules: Vec<_> = (1..=200).map(Schedule::draw).collect();
        for place in PLACES {
            assert!(schedules.iter().any(|schedule| schedule.scenario == place.scenario));
        }
        for family in Family::ALL {
            assert!(schedules.iter().filter(|schedule| schedule.families().contains(&family)).count() > 20);
        }
    }
}
