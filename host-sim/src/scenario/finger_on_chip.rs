//! The joint servo of one finger of the three-finger hand (Hand3, section 4) on the image that is flashed:
//! the board drives three simulated motors through the registers of a modelled chip, against the plant of
//! the finger.
//!
//! Steps, reference, limits and the deviations of the machine are those of `hand3-servo`. Beyond them the
//! windings differ from the model by the same spread, the supply sags, and pulses, converters, encoders and
//! the time from sampling to torque are the chip's own.

use std::path::Path;

use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Reply, Request};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_chip_link::{MOTORS, Motor, Terminals};
use tesaki_description::robot::{RobotFolder, chain_model};
use tesaki_description::urdf::Urdf;
use tesaki_supervisor::Board;

use super::ScenarioError;
use super::common::{T, held, largest};
use super::hand3_servo::{self as servo, ServoLog, TRIALS, Trial};
use crate::chip::{ChipBoard, ChipError};
use crate::plant::{Drive, Plant, PlantOptions, PlantValues, Truth};
use crate::purpose::Purpose;
use crate::report::{Metric, Summary};

/// Sub-step of the physics: a share of the one of the folder, as each costs the chip's torque its delay.
const SUB_STEPS: f64 = 4.0;
/// Inner resistance of the supply [Ω]: the drawn current lets its voltage sag.
const SUPPLY_RESISTANCE: f64 = 0.1;
/// The trials with limits: PID and observer.
const LIMITED: usize = 2;

/// The programs.
#[derive(Clone, Copy, Debug)]
pub struct Programs<'a> {
    /// The modelled chip: `tesaki-chip`.
    pub chip: &'a Path,
    /// The image of `board-weact`.
    pub image: &'a Path,
}

/// Runs both servos on the machine of a seed, with the first finger of the robot in the folder `robot`.
///
/// # Errors
/// Why it did not come to its end. Missing a goal is not an error but a failed metric.
pub fn run(robot: &Path, seed: u64, programs: Programs<'_>) -> Result<Summary, ScenarioError> {
    let robot_folder = RobotFolder::load(robot)?;
    let values = PlantValues::load(robot)?;
    let mut summary = Summary::new("finger-on-chip", "chip", seed);
    let (mut ticks, mut instants, mut faults) = (0, Vec::new(), 0);
    for trial in &TRIALS[..LIMITED] {
        let mut finger = Finger::power_on(&robot_folder, &values, seed, programs)?;
        let recording = finger.steps(trial)?;
        servo::add_metrics(&mut summary, trial, &recording);
        ticks += recording.time.len();
        instants.push(finger.board.worst_instant());
        faults += finger.board.faults()?.total;
    }
    let late = Metric::at_most("Faults, late ticks among them", faults.into(), 0.0, "");
    summary.insert("faults", late);
    let instant = Metric::reported("Sampling beside its time, at most", largest(instants), "µs");
    summary.insert("instant_deviation", instant);
    Ok(summary.ticks(ticks as u64))
}

struct Finger {
    board: ChipBoard,
    model: RobotModel,
}

impl Finger {
    fn power_on(
        robot: &RobotFolder,
        values: &PlantValues,
        seed: u64,
        programs: Programs<'_>,
    ) -> Result<Self, ScenarioError> {
        let model = finger_model(&robot.model);
        if model.joints.len() != MOTORS {
            return Err(ChipError::Joints(model.joints.len()).into());
        }
        let drives: Vec<Drive> = model.joints.iter().map(Drive::from).collect();
        let has = |name: &str| drives.iter().any(|drive| drive.joint == name);
        let mut values = values.clone();
        values.posture.retain(|joint, _| has(joint));
        values.integration.step /= SUB_STEPS;
        let urdf = only(&robot.urdf, has);
        let plant = Plant::new(&urdf, &drives, &values, &PlantOptions::mismatched(seed))?;
        let terminals = terminals(&model, &values, &plant, seed);
        let board = ChipBoard::start(programs.chip, programs.image, terminals, plant)?;
        Ok(Self { board, model })
    }

    /// Model, homing, and the steps of a trial.
    fn steps(&mut self, trial: &Trial) -> Result<ServoLog, ScenarioError> {
        let Self { board, model } = self;
        board.hello()?;
        board.take_command(false)?;
        board.push_model(model)?;
        let homed: Vec<f32> = board.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        board.home(&homed)?;
        board.enable(TaskConfig::JointServo(trial.mode))?;
        let start = held(&homed, model);
        let filter_times = servo::filter_times(model);
        let mut recording = ServoLog::new(board.plant.truth().homing_errors);
        let duration = servo::INITIAL_REST + servo::INTERVAL * 2.0 * servo::FIRST_STEPS as f64;
        let ticks = (duration / T).round() as u32;
        for tick in 0..ticks {
            let time = f64::from(tick) * T;
            let goal = servo::due_goal(tick, &mut recording.steps, &start);
            let commands = goal.is_some();
            if let Some(goal) = goal {
                board.post(goal_request(&goal))?;
            }
            board.period()?;
            if commands && board.reply() != Some(Reply::Done) {
                return Err(stopped(board, model, trial.label, time));
            }
            let truth = Truth { torques: board.torques().to_vec(), ..board.plant.truth() };
            let references = servo::references(tick, &recording.steps, &start, &filter_times);
            recording.push(time, &references, &truth);
        }
        match board.status()?.node.mode {
            Mode::Enabled(_) => Ok(recording),
            _ => Err(stopped(board, model, trial.label, f64::from(ticks) * T)),
        }
    }
}

fn goal_request(angles: &[f32]) -> Request {
    let positions = angles.iter().copied().collect();
    Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }))
}

fn stopped(board: &mut ChipBoard, model: &RobotModel, trial: &str, time: f64) -> ScenarioError {
    match board.faults() {
        Ok(log) => {
            let last = log.faults.last();
            let fault = last.map_or_else(|| "no fault".to_owned(), |fault| fault.named(model).to_string());
            ScenarioError::Fault { trial: trial.to_owned(), time, fault }
        }
        Err(error) => error.into(),
    }
}

/// The first finger. Its force sensor has no gauges, which the board would refuse.
fn finger_model(robot: &RobotModel) -> RobotModel {
    let mut model = chain_model(robot, 0).unwrap_or_else(|| robot.clone());
    for chain in &mut model.chains {
        chain.force_sensor = None;
    }
    model
}

/// The robot without the other joints, and what they carry.
fn only(urdf: &Urdf, has: impl Fn(&str) -> bool) -> Urdf {
    let mut urdf = urdf.clone();
    urdf.robot.joints.retain(|joint| joint.joint_type == urdf_rs::JointType::Fixed || has(&joint.name));
    urdf
}

/// The true motors: torque constants as in the plant, windings by the same spread beside the model.
fn terminals(model: &RobotModel, values: &PlantValues, plant: &Plant, seed: u64) -> Terminals {
    let mut rng = Purpose::Windings.rng(seed);
    let mut factor = || 1.0 + values.mismatch.spread * rng.symmetric();
    let motors = std::array::from_fn::<_, MOTORS, _>(|joint| {
        let (joint, factors) = (&model.joints[joint], &plant.factors()[joint]);
        Motor {
            resistance: f64::from(joint.motor.resistance.unwrap_or(f32::NAN)) * factor(),
            inductance: f64::from(joint.motor.inductance.unwrap_or(f32::NAN)) * factor(),
            constant: f64::from(joint.motor.torque_constant) * factors.torque_constant,
            counts: joint.encoder.counts_per_turn.into(),
        }
    });
    let seed = seed as u32;
    Terminals { motors, supply: values.supply.voltage, supply_resistance: SUPPLY_RESISTANCE, seed }
}
