//! Figure 6: all joints step through the trajectory filter.

use tesaki_supervisor::Board;

use super::{Law, ScenarioError, Setting, Summary};
use crate::controller::Controller;
use crate::plant::{Plant, PlantOptions};
use crate::report::{Figure, Line, Metric, Panel};
use crate::scenario::common::{T, largest, prepare, request_error};
use crate::scenario::grasping::GraspRig;
use crate::scenario::hand3_servo::{filter_times, step_response};

/// Ticks between two commands, without which the controller stops.
const COMMAND_EVERY: u32 = 5;

/// All joints step to an angle and back, under each law.
pub(super) fn run(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    laws: &[Law],
    summary: &mut Summary,
) -> Result<Figure, ScenarioError> {
    let caption = "Displacement of joint 2 of finger 1 (true angle) and its reference (dashed), the step through G(s) = \
                   1/(T_f s + 1)², when all nine joints step at once and step back, under the joint servo of each law \
                   on the same machine; below, the errors of all nine joints. Hand3 section 4, figure 6; the paper \
                   shows no measurement of it.";
    let mut figure = Figure::stacked("Hand3 figure 6: joint servo", caption, "time", "s");
    for law in laws {
        let log = trial(setting, rig, law)?;
        let errors = |from: f64| {
            let from = (from / T).round() as usize;
            largest(log.errors.iter().flat_map(|errors| errors.iter().skip(from)).map(|error| error.abs()))
        };
        let mut add = |key: &str, text: &str, value: f64| {
            let metric = Metric::reported(format!("{}: {text}", law.name), value, "mrad");
            summary.insert(format!("{}_{key}", law.key), metric);
        };
        add("step_error_peak", "step of the joints: largest error", errors(0.0));
        let end = 2.0 * law.law.servo.duration - law.law.servo.evaluated;
        add("step_error_rest", "step of the joints: largest error at rest", errors(end));
        let mut angles = Panel::new(format!("{}: joint 2", law.law.title), "angle", "rad");
        angles = angles.line(Line::solid("true", 0, log.time.clone(), log.angle));
        angles = angles.line(Line::dashed("reference", Line::INK, log.time.clone(), log.reference));
        let mut panel = Panel::new(format!("{}: errors", law.law.title), "error", "mrad");
        for (joint, values) in log.errors.into_iter().enumerate() {
            // A colour for the same joint of all fingers.
            let name = match joint {
                0..3 => format!("joints {}, {}, {}", joint + 1, joint + 4, joint + 7),
                _ => String::new(),
            };
            panel = panel.line(Line::solid(name, joint % 3, log.time.clone(), values));
        }
        figure = figure.panel(angles).panel(panel);
    }
    Ok(figure)
}

/// One value a tick.
#[derive(Default)]
struct StepLog {
    time: Vec<f64>,
    /// Displacement of the second joint, and its reference [rad].
    angle: Vec<f64>,
    reference: Vec<f64>,
    /// A list for each joint [mrad].
    errors: Vec<Vec<f64>>,
}

fn trial(setting: &mut Setting<'_, '_>, rig: &mut GraspRig, law: &Law) -> Result<StepLog, ScenarioError> {
    let servo = &law.law.servo;
    let coulomb = rig.values.friction.paper;
    let model = law.model(coulomb);
    let mut options = PlantOptions::mismatched(setting.seed);
    options.coulomb = Some(coulomb);
    let plant = Plant::new(&rig.robot.urdf, &rig.drives, &rig.values, &options)?;
    let mut plant = plant.under(setting.intervention.clone());
    let start = prepare(setting.controller, &mut plant, &model, servo.mode, &mut rig.motion)?;
    rig.motion.note(format!("step, {}", law.name));
    let filter_times = filter_times(&model);
    let homing = plant.truth().homing_errors;
    let mut log = StepLog { errors: vec![Vec::new(); start.len()], ..StepLog::default() };
    let half = (servo.duration / T).round() as u32;
    for tick in 0..2 * half {
        let time = f64::from(tick) * T;
        if tick.is_multiple_of(COMMAND_EVERY) || tick == half {
            let offset = if tick < half { servo.step } else { 0.0 };
            let goal: Vec<f32> = start.iter().map(|angle| angle + offset as f32).collect();
            let sent = setting.controller.set_goal(&goal);
            sent.map_err(|error| request_error(setting.controller, &model, &law.name, time, error))?;
        }
        let truth = plant.truth();
        let actuators = setting.controller.tick(&plant.sensors(rig.motion.tick(&truth)))?;
        log.time.push(time);
        for (joint, (start, filter_time)) in start.iter().zip(&filter_times).enumerate() {
            // The step response in closed form, less that of the step back. A goal received with a tick acts
            // from the tick before it.
            let response = |since: f64| servo.step * step_response(since + T, *filter_time);
            let reference = response(time) - if tick < half { 0.0 } else { response(time - servo.duration) };
            let displacement = truth.positions[joint] + homing[joint] - f64::from(*start);
            log.errors[joint].push(1e3 * (displacement - reference));
            if joint == 1 {
                log.angle.push(displacement);
                log.reference.push(reference);
            }
        }
        plant.apply(&actuators)?;
    }
    setting.controller.disable()?;
    Ok(log)
}
