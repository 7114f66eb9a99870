//! The first motion after power-on, without and with the self-test that identifies the joints' friction.

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::Stream;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::Board;
use tesaki_supervisor::identify::{FreeJoint, JointSettings, identified_free, identify_joints};

use super::common::{T, capitalized, home, introduce, largest};
use super::grasping::SimulatedMachine;
use super::hand3_servo::{FIRST_STEPS, INITIAL_REST, INTERVAL, ServoLog, ServoTrial, table};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::motion::Motion;
use crate::plant::{Plant, PlantOptions};
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-first-motion",
    title: "First motion of the three-finger hand after power-on",
    about: "the first steps after power-on under PID and under the observer, without and with the self-test of \
            `tesaki identify --joints`",
    robot: "hand3",
    kind: Kind::Any,
    files: &[],
    results: "docs/measurements.md#first-motion",
    duration: 64.0,
    shortest: None,
    laws: None,
    lead: &[
        "After power-on a servo has the friction of the robot's folder, and learns that of the machine while it \
         moves: its first motion is several times worse than its second. The self-test of `tesaki identify \
         --joints` moves the joints by ±0.1 rad, those at the same place in their fingers together, and \
         identifies Coulomb and viscous friction from torques and velocities; no object, and no force sensor, is \
         needed.",
        "Each servo steps by 0.3 rad and back twice, as in hand3-servo, after power-on without the self-test, and \
         after power-on with the model that the self-test has found.",
    ],
    run,
};

/// Longest time of the self-test of a hand [s].
const MAX_TIME: f64 = 20.0;
/// Time of the steps [s].
const STEPS: f64 = INITIAL_REST + INTERVAL * (2 * FIRST_STEPS) as f64;

struct Trial {
    name: &'static str,
    label: &'static str,
    mode: ServoMode,
    /// Largest error of the first steps with the self-test [mrad].
    limit: f64,
}

const TRIALS: [Trial; 2] = [
    Trial { name: "pid", label: "PID", mode: ServoMode::Pid, limit: 12.0 },
    Trial { name: "observer", label: "observer", mode: ServoMode::Observer, limit: 5.0 },
];

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let robot = RobotFolder::load(setting.robot)?;
    let machine = |setting: &Setting<'_, '_>| {
        let plant = Plant::of(&robot, &PlantOptions::mismatched(setting.seed))?;
        Ok::<_, ScenarioError>(plant.under(setting.intervention.clone()))
    };
    let mut motion = setting.motion(&robot.model);
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    for trial in &TRIALS {
        let Trial { name, limit, .. } = *trial;
        let label = capitalized(trial.label);
        let plant = machine(setting)?;
        let before = steps(setting, trial.label, trial.mode, (robot.model.clone(), plant), &mut motion)?;
        let plant = machine(setting)?;
        let test = self_test(setting, &robot.model, plant, &mut motion)?;
        let after = steps(setting, trial.label, trial.mode, (test.model.clone(), test.plant), &mut motion)?;

        let first = |log: &ServoLog| log.largest_errors(0..FIRST_STEPS).0;
        let told = format!("{label}: largest error of the first steps with the self-test");
        summary.insert(format!("{name}_first_after"), Metric::at_most(told, first(&after), limit, "mrad"));
        let told = format!("{label}: largest error of the first steps without it");
        summary.insert(format!("{name}_first_before"), Metric::reported(told, first(&before), "mrad"));
        let told = format!("{label}: largest error of the next steps with it");
        let next = after.largest_errors(FIRST_STEPS..usize::MAX).0;
        summary.insert(format!("{name}_second_after"), Metric::reported(told, next, "mrad"));
        if trial.mode == ServoMode::Pid {
            let metric = Metric::at_most("Time of the self-test", test.time, MAX_TIME, "s");
            summary.insert("test_time", metric);
            let metric = Metric::reported("Largest torque in the self-test", test.torque, "N·m");
            summary.insert("test_torque_peak", metric);
            let told = "Largest error of a joint's Coulomb friction by the self-test";
            summary.insert("test_friction_error", Metric::reported(told, test.error, "%"));
        }
        figures.push(figure(&label, limit, &[(&before, "without"), (&after, "with")], &robot.model));
        tables.push((format!("{name}_without.csv"), table(&before, &robot.model)));
        tables.push((format!("{name}_with.csv"), table(&after, &robot.model)));
    }
    Ok(Outcome { summary, figures, tables, motion })
}

/// Power-on with this model, and two steps up and down.
fn steps(
    setting: &mut Setting<'_, '_>,
    label: &'static str,
    mode: ServoMode,
    machine: (RobotModel, Plant),
    motion: &mut Motion,
) -> Result<ServoLog, ScenarioError> {
    let ticks = (STEPS / T).round() as u32;
    let mut trial = ServoTrial::enable(label, mode, machine, setting.controller, motion)?;
    (0..ticks).try_for_each(|tick| trial.tick(tick))?;
    trial.end()
}

/// What a self-test leaves.
struct SelfTest {
    /// With the friction that was found.
    model: RobotModel,
    plant: Plant,
    /// The time that it took [s].
    time: f64,
    /// Largest motor torque of a joint that moves [N·m].
    torque: f64,
    /// Largest error of the Coulomb friction of a joint [%].
    error: f64,
}

/// Power-on, and the self-test; the board is disabled then.
fn self_test(
    setting: &mut Setting<'_, '_>,
    model: &RobotModel,
    plant: Plant,
    motion: &mut Motion,
) -> Result<SelfTest, ScenarioError> {
    let mut model = model.clone();
    introduce(setting.controller, &model)?;
    let mut machine = SimulatedMachine {
        controller: &mut *setting.controller,
        plant,
        motion,
        progress: setting.progress,
        duration: setting.duration,
    };
    machine.advance()?;
    home(machine.controller, &machine.plant)?;
    machine.advance()?;
    for stream in [Stream::Telemetry, Stream::Tips] {
        machine.controller.set_rate(stream, 1)?;
    }
    let begin = machine.motion.ticks();
    let readings = identify_joints(&mut machine, &model, &JointSettings::default())?;
    let time = f64::from(machine.motion.ticks() - begin) * T;
    machine.controller.disable()?;
    for stream in [Stream::Telemetry, Stream::Tips] {
        machine.controller.set_rate(stream, 0)?;
    }
    let plant = machine.plant;
    let torque = largest(readings.iter().flatten().map(|reading| reading.torque.abs()));
    let joints = model.joints.iter().zip(&readings);
    let found: Vec<_> =
        joints.map(|(joint, readings)| FreeJoint::identify(joint, readings, false, None)).collect();
    let errors = found.iter().zip(plant.factors()).zip(&model.joints).map(|((found, factors), joint)| {
        // In commanded torque: what a feed-forward needs.
        let truth = f64::from(joint.friction.coulomb) * factors.coulomb / factors.torque_constant;
        found.friction.map_or(f64::INFINITY, |fit| (fit.coulomb.value / truth - 1.0).abs())
    });
    let error = 100.0 * largest(errors);
    identified_free(&model, &found).apply(&mut model)?;
    Ok(SelfTest { model, plant, time, torque, error })
}

fn figure(label: &str, limit: f64, logs: &[(&ServoLog, &str)], model: &RobotModel) -> Figure {
    let caption =
        "Error of every joint from the filtered reference: power-on, 0.3 rad up, down, up and down.";
    let mut figure = Figure::stacked(label.to_owned(), caption, "time", "s");
    for (log, with) in logs {
        let mut panel = Panel::new(format!("Error {with} the self-test"), "error", "mrad");
        for joint in 0..model.joints.len() {
            let line =
                Line::solid(model.joint_name(joint), joint % 3, log.time.clone(), log.error(joint).collect());
            panel = panel.line(line);
        }
        figure = figure.panel(panel.band(limit, format!("limit ±{limit} mrad")));
    }
    figure
}
