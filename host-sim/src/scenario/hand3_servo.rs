//! Joint servos of the three-finger hand (Hand3, section 4): all nine joints step by ±0.3 rad at once,
//! through the trajectory filter, on a machine that differs from the controller's model.

use std::ops::Range;

use tesaki::control::ServoMode;
use tesaki::model::{JointModel, RobotModel};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::Board;

use super::common::{T, capitalized, fault_error, largest, prepare, request_error};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::controller::{Controller, Watched};
use crate::motion::Motion;
use crate::plant::{Plant, PlantOptions, PlantValues, SharedIntervention, Truth};
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-servo",
    title: "Joint servo of the three-finger hand",
    about: "nine joints of the three-finger hand step by ±0.3 rad under PID and under the observer",
    robot: "hand3",
    kind: Kind::Any,
    files: &[],
    results: "docs/measurements.md#joint-servo",
    duration: 42.0,
    shortest: Some(4.0 * (INITIAL_REST + INTERVAL * (FIRST_STEPS + 1) as f64)),
    laws: None,
    lead: &[
        "All nine joints of the three-finger hand step by ±0.3 rad at the same time. The trajectory filter \
         1/(T_f s + 1)² with T_f = 0.2 s shapes the steps, and the control period is 10 ms. Masses, \
         inertias, friction and torque constants of the simulated machine differ from the controller's model \
         by up to 20 %, each by its own factor; encoder and current readings are quantised.",
        "Two servos are compared: the PID of the Hand3 paper with its pseudo-differentiator (cut-off 30 rad/s), \
         and state feedback with an observer of velocity and disturbance. Both use the same feed-forward of \
         gravity, inertia and friction. Each machine steps up and down twice: at first the servo only has \
         the model's friction, the second time it has adapted to the true one. The last two figures repeat \
         both with four times the friction, which is what the paper's loss of fingertip force implies.",
    ],
    run,
};

/// Time from the start to the first step [s].
pub(super) const INITIAL_REST: f64 = 0.5;
/// Time from one step to the next [s].
pub(super) const INTERVAL: f64 = 2.5;
/// Size of the steps [rad].
const STEP: f64 = 0.3;
/// Time after a step from which the error is counted as settled [s].
const SETTLING_TIME: f64 = 1.0;
/// The first step in each direction meets unknown friction; from then on the servo has adapted to it.
pub(super) const FIRST_STEPS: usize = 2;
/// Ticks from one command to the next; commands are idempotent.
const COMMAND_EVERY: u32 = 5;
pub(super) const TRIALS: [Trial; 4] = [
    Trial {
        name: "pid",
        label: "PID",
        mode: ServoMode::Pid,
        paper_friction: false,
        limits: Some((12.0, 2.5)),
    },
    Trial {
        name: "observer",
        label: "observer",
        mode: ServoMode::Observer,
        paper_friction: false,
        limits: Some((5.0, 1.0)),
    },
    Trial {
        name: "pid_paper_friction",
        label: "PID, paper-size friction",
        mode: ServoMode::Pid,
        paper_friction: true,
        limits: None,
    },
    Trial {
        name: "observer_paper_friction",
        label: "observer, paper-size friction",
        mode: ServoMode::Observer,
        paper_friction: true,
        limits: None,
    },
];

/// A combination of plant and servo.
pub(super) struct Trial {
    pub name: &'static str,
    pub label: &'static str,
    pub mode: ServoMode,
    pub paper_friction: bool,
    /// Limits of peak and settled error [mrad].
    pub limits: Option<(f64, f64)>,
}

/// Signals of a trial: one list per joint, one value per tick.
pub(super) struct ServoLog {
    pub time: Vec<f64>,
    pub reference: Vec<Vec<f64>>,
    pub position: Vec<Vec<f64>>,
    pub torque: Vec<Vec<f64>>,
    pub homing_errors: Vec<f64>,
    /// Ticks at which the goal steps.
    pub steps: Vec<usize>,
}

impl ServoLog {
    /// Nothing yet, of so many joints.
    pub fn new(homing_errors: Vec<f64>) -> Self {
        let joints = homing_errors.len();
        let empty = || vec![Vec::new(); joints];
        Self {
            time: Vec::new(),
            reference: empty(),
            position: empty(),
            torque: empty(),
            homing_errors,
            steps: Vec::new(),
        }
    }

    /// Adds a control period: time, and for each joint its reference, its angle and its torque.
    pub fn push(&mut self, time: f64, references: &[f64], truth: &Truth) {
        self.time.push(time);
        for (joint, &reference) in references.iter().enumerate() {
            self.reference[joint].push(reference);
            self.position[joint].push(truth.positions[joint]);
            self.torque[joint].push(truth.torques[joint]);
        }
    }

    /// Error of a joint's motion [mrad]: true angle minus reference, without the constant homing error, which
    /// the servo cannot observe.
    pub fn error(&self, joint: usize) -> impl Iterator<Item = f64> + '_ {
        let homing = self.homing_errors[joint];
        let pairs = self.position[joint].iter().zip(&self.reference[joint]);
        pairs.map(move |(position, reference)| 1e3 * (position + homing - reference))
    }

    /// Encoder angle of a joint relative to the start [rad].
    fn displacement(&self, joint: usize) -> Vec<f64> {
        let start = self.reference[joint].first().copied().unwrap_or(0.0);
        self.position[joint].iter().map(|angle| angle + self.homing_errors[joint] - start).collect()
    }

    /// Largest error of any joint after the steps numbered `steps` [mrad]: overall, and later than
    /// [`SETTLING_TIME`] after each step.
    pub fn largest_errors(&self, steps: Range<usize>) -> (f64, f64) {
        let (mut all, mut settled) = (Vec::new(), Vec::new());
        for joint in 0..self.position.len() {
            for (tick, error) in self.error(joint).enumerate() {
                let number = self.steps.partition_point(|&step| step <= tick);
                if number == 0 || !steps.contains(&(number - 1)) {
                    continue;
                }
                all.push(error.abs());
                if (tick - self.steps[number - 1]) as f64 * T >= SETTLING_TIME - 1e-9 {
                    settled.push(error.abs());
                }
            }
        }
        (largest(all), largest(settled))
    }

    /// Largest motor torque [N·m].
    pub fn torque_peak(&self) -> f64 {
        largest(self.torque.iter().flatten().map(|torque| torque.abs()))
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let robot = RobotFolder::load(setting.robot)?;
    let paper_friction = PlantValues::load(setting.robot)?.friction.paper;
    let ticks = (setting.duration / 4.0 / T).round() as u32;

    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    let mut motion = setting.motion(&robot.model);
    for (index, trial) in TRIALS.iter().enumerate() {
        let progress = |fraction: f64| (setting.progress)((index as f64 + fraction) / 4.0);
        let machine = (&robot, paper_friction, setting.seed, setting.intervention.clone());
        let mut servo_trial = ServoTrial::begin(trial, machine, setting.controller, &mut motion)?;
        for tick in 0..ticks {
            servo_trial.tick(tick)?;
            progress(f64::from(tick + 1) / f64::from(ticks));
        }
        let recording = servo_trial.end()?;
        add_metrics(&mut summary, trial, &recording);
        figures.push(figure(trial, &recording, &robot.model));
        tables.push((format!("{}.csv", trial.name), table(&recording, &robot.model)));
    }
    Ok(Outcome { summary, figures, tables, motion })
}

/// A running trial: the plant under its servo, and the log.
pub(super) struct ServoTrial<'a, 'b> {
    label: &'static str,
    controller: &'a mut Watched<'b>,
    motion: &'a mut Motion,
    model: RobotModel,
    plant: Plant,
    /// Joint angles at the start [rad].
    start: Vec<f32>,
    /// Time constants of the trajectory filters [s].
    filter_times: Vec<f64>,
    recording: ServoLog,
}

impl<'a, 'b> ServoTrial<'a, 'b> {
    fn begin(
        trial: &Trial,
        (robot, paper_friction, seed, intervention): (&RobotFolder, f64, u64, Option<SharedIntervention>),
        controller: &'a mut Watched<'b>,
        motion: &'a mut Motion,
    ) -> Result<Self, ScenarioError> {
        let mut model = robot.model.clone();
        let mut options = PlantOptions::mismatched(seed);
        if trial.paper_friction {
            options.coulomb = Some(paper_friction);
            for joint in &mut model.joints {
                joint.friction.coulomb = paper_friction as f32;
            }
        }
        let plant = Plant::of(robot, &options)?.under(intervention);
        Self::enable(trial.label, trial.mode, (model, plant), controller, motion)
    }

    /// With this model on the board of this machine.
    pub fn enable(
        label: &'static str,
        mode: ServoMode,
        (model, mut plant): (RobotModel, Plant),
        controller: &'a mut Watched<'b>,
        motion: &'a mut Motion,
    ) -> Result<Self, ScenarioError> {
        let start = prepare(controller, &mut plant, &model, mode, motion)?;
        let filter_times = filter_times(&model);
        let recording = ServoLog::new(plant.truth().homing_errors);
        Ok(Self { label, controller, motion, model, plant, start, filter_times, recording })
    }

    /// One control period.
    pub fn tick(&mut self, tick: u32) -> Result<(), ScenarioError> {
        let time = f64::from(tick) * T;
        self.command(tick, time)?;
        let truth = self.plant.truth();
        let actuators = self.controller.tick(&self.plant.sensors(self.motion.tick(&truth)))?;
        if !actuators.enabled {
            return Err(fault_error(self.controller, &self.model, self.label, time));
        }
        let references = references(tick, &self.recording.steps, &self.start, &self.filter_times);
        self.motion.reference(references.clone());
        if tick == 0 {
            self.motion.note(self.label);
        }
        self.recording.push(time, &references, &truth);
        Ok(self.plant.apply(&actuators)?)
    }

    /// Sends the goal when it steps, and repeats it every [`COMMAND_EVERY`] ticks.
    fn command(&mut self, tick: u32, time: f64) -> Result<(), ScenarioError> {
        let Some(goal) = due_goal(tick, &mut self.recording.steps, &self.start) else { return Ok(()) };
        let sent = self.controller.set_goal(&goal);
        sent.map_err(|error| request_error(self.controller, &self.model, self.label, time, error))
    }

    pub fn end(self) -> Result<ServoLog, ScenarioError> {
        self.controller.disable()?;
        Ok(self.recording)
    }
}

/// The goal that is sent in `tick`, if one is [rad]: when it steps, which is noted in `steps`, and every
/// [`COMMAND_EVERY`] ticks.
pub(super) fn due_goal(tick: u32, steps: &mut Vec<usize>, start: &[f32]) -> Option<Vec<f32>> {
    let steps_now = f64::from(tick) * T >= INITIAL_REST + INTERVAL * steps.len() as f64 - 1e-9;
    if steps_now {
        steps.push(tick as usize);
    }
    let offset = if steps.len() % 2 == 1 { STEP } else { 0.0 };
    let goal = || start.iter().map(|angle| angle + offset as f32).collect();
    (steps_now || tick.is_multiple_of(COMMAND_EVERY)).then(goal)
}

/// Time constants of the joints' trajectory filters [s].
pub(super) fn filter_times(model: &RobotModel) -> Vec<f64> {
    model.joints.iter().map(|joint| joint.servo.filter_time.into()).collect()
}

/// The step response of the trajectory filter `1/(T_f s + 1)²` in closed form, `time` [s] after the step.
pub(super) fn step_response(time: f64, filter_time: f64) -> f64 {
    let x = time.max(0.0) / filter_time;
    1.0 - (1.0 + x) * (-x).exp()
}

/// References of the joints at `tick` [rad], one step response per step. A goal received with a tick acts
/// from the tick before it.
pub(super) fn references(tick: u32, steps: &[usize], start: &[f32], filter_times: &[f64]) -> Vec<f64> {
    let reference = |(&start, &filter_time): (&f32, &f64)| {
        let mut displacement = 0.0;
        for (index, &step) in steps.iter().enumerate() {
            let response = STEP * step_response((f64::from(tick) + 1.0 - step as f64) * T, filter_time);
            displacement += if index % 2 == 0 { response } else { -response };
        }
        f64::from(start) + displacement
    };
    start.iter().zip(filter_times).map(reference).collect()
}

pub(super) fn add_metrics(summary: &mut Summary, trial: &Trial, recording: &ServoLog) {
    let (first_peak, _) = recording.largest_errors(0..FIRST_STEPS);
    let (peak, settled) = recording.largest_errors(FIRST_STEPS..usize::MAX);
    let Trial { name, limits, .. } = trial;
    let label = capitalized(trial.label);
    let peak_label = format!("{label}: largest error");
    let settled_label = format!("{label}: largest error later than 1 s after a step");
    let metrics = match *limits {
        Some((peak_limit, settled_limit)) => [
            Metric::at_most(peak_label, peak, peak_limit, "mrad"),
            Metric::at_most(settled_label, settled, settled_limit, "mrad"),
        ],
        None => {
            [Metric::reported(peak_label, peak, "mrad"), Metric::reported(settled_label, settled, "mrad")]
        }
    };
    let [peak, settled] = metrics;
    summary.insert(format!("{name}_error_peak"), peak);
    summary.insert(format!("{name}_error_settled"), settled);
    let first = Metric::reported(format!("{label}: largest error of the first steps"), first_peak, "mrad")
        .note("the first step in each direction, before the servo has adapted to the friction");
    summary.insert(format!("{name}_error_first_steps"), first);
    let torque = Metric::reported(format!("{label}: largest torque"), recording.torque_peak(), "N·m");
    summary.insert(format!("{name}_torque_peak"), torque);
}

/// All joints' angles and torques, and the errors chain by chain; the colour is the joint's position in its
/// chain.
fn figure(trial: &Trial, recording: &ServoLog, model: &RobotModel) -> Figure {
    let mut angles = Panel::new("Joint displacement from the start", "angle", "rad");
    let mut errors = Vec::new();
    let mut torques = Panel::new("Motor torque", "torque", "N·m");
    let time = |step: Option<&usize>| step.map(|&step| step as f64 * T);
    let (first, learnt) = (time(recording.steps.first()), time(recording.steps.get(FIRST_STEPS)));
    for joints in model.chain_ranges() {
        let (prefix, names) = split_names(joints.clone().map(|joint| model.joint_name(joint)).collect());
        let title = if prefix.is_empty() { "Error".to_owned() } else { format!("Error, {prefix}") };
        let mut panel = Panel::new(title, "error", "mrad");
        for (position, (joint, name)) in joints.zip(names).enumerate() {
            let line = |values: Vec<f64>| Line::solid(name, position, recording.time.clone(), values);
            angles = angles.line(line(recording.displacement(joint)));
            panel = panel.line(line(recording.error(joint).collect()));
            torques = torques.line(line(recording.torque[joint].clone()));
        }
        errors.push(match (trial.limits, learnt) {
            (Some((peak, _)), Some(from)) => panel.band_from(peak, from, format!("limit ±{peak} mrad")),
            _ => panel,
        });
    }
    // Joints with the same trajectory filter have the same reference.
    let filter_time = |joint: &JointModel| joint.servo.filter_time.to_bits();
    let is_first = |(index, joint): &(usize, &JointModel)| {
        model.joints.iter().position(|other| filter_time(other) == filter_time(joint)) == Some(*index)
    };
    let references: Vec<(usize, &JointModel)> = model.joints.iter().enumerate().filter(is_first).collect();
    for &(index, joint) in &references {
        let name = match references.as_slice() {
            [_] => "reference".to_owned(),
            _ => format!("reference with T_f = {} s", joint.servo.filter_time),
        };
        let start = recording.reference[index].first().copied().unwrap_or(0.0);
        let shape = recording.reference[index].iter().map(|angle| angle - start).collect();
        angles = angles.line(Line::dashed(name, Line::INK, recording.time.clone(), shape));
    }
    let caption = "True joint angles and the filtered reference, the error of each finger's joints, and the \
                   motor torques. During the first step up and down (shaded) the servo meets the machine's \
                   true friction for the first time; afterwards it has adapted to it, and the limit \
                   applies.";
    let mut figure = Figure::stacked(capitalized(trial.label), caption, "time", "s").panel(angles);
    if let (Some(from), Some(to)) = (first, learnt) {
        let end = recording.time.last().map_or(to, |last| last + T);
        figure = figure.phase(from, to, "").phase(to, end, "");
    }
    for (number, &step) in recording.steps.iter().enumerate() {
        let size = if number % 2 == 0 { "+" } else { "−" };
        let adapted = match number {
            0 => ", friction unknown",
            FIRST_STEPS => ", friction learnt",
            _ => "",
        };
        figure = figure.event(step as f64 * T, format!("{size}{STEP} rad{adapted}"));
    }
    errors.into_iter().fold(figure, Figure::panel).panel(torques)
}

/// The common prefix of the joint names of a chain before an underscore, and the rest of each.
fn split_names(names: Vec<&str>) -> (&str, Vec<&str>) {
    let prefix = names.first().and_then(|name| name.rsplit_once('_')).map_or("", |(prefix, _)| prefix);
    let rest = |name: &&str| name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('_'));
    if prefix.is_empty() || !names.iter().all(rest) {
        return ("", names);
    }
    (prefix, names.iter().map(|name| &name[prefix.len() + 1..]).collect())
}

pub(super) fn table(recording: &ServoLog, model: &RobotModel) -> String {
    let mut columns = vec![Column::new("time", "s", &recording.time)];
    for (index, joint) in model.joints.iter().enumerate() {
        let name = joint.name.as_str();
        columns.push(Column::new(format!("{name} reference"), "rad", &recording.reference[index]));
        columns.push(Column::new(format!("{name} true angle"), "rad", &recording.position[index]));
        columns.push(Column::new(format!("{name} torque"), "N·m", &recording.torque[index]));
    }
    csv(&columns)
}
