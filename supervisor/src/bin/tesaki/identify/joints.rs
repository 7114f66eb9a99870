//! `identify --joints`: the self-test after power-on.

use std::fmt::Write as _;
use std::sync::atomic::Ordering;

use serde_json::json;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{JointTelemetry, Mode, Request};
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_description::calibration::{Calibration, CalibrationFile};
use tesaki_supervisor::Board;
use tesaki_supervisor::identify::{
    Estimate, Fit, FreeFit, IdentifyError, JointSettings, Machine, NotIdentified, Reading, duration,
    fit_free, fit_weighed, identified, identified_free, identify_joints, update, update_free, with_head,
};

use super::{BoardMachine, open, save, saved};
use crate::args::{Identify, Options};
use crate::board_session::{BoardSession, hex};
use crate::failure::Failure;
use crate::gravity::Load;
use crate::output;

pub fn run(options: &Options, args: &Identify) -> Result<(), Failure> {
    let settings = JointSettings { amplitude: args.amplitude, torque: args.torque };
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let mode = session.board.status()?.node.mode;
    session.require_no_fault(mode, Some(&model))?;
    let file = open(&args.out)?;
    let angles: Vec<f32> = session.telemetry_now()?.joints.iter().map(|joint| joint.position).collect();
    let within =
        |(angle, joint): (&f32, &JointModel)| angle.clamp(joint.limits.lower, joint.limits.upper).into();
    let start: Vec<f64> = angles.iter().zip(&model.joints).map(within).collect();
    let time = duration(&model, &start, &settings)?;
    output::confirm(
        options,
        &format!(
            "The joints of {} will be swept by ±{} rad for {time:.0} s. Is nothing in the hand or in the way?",
            model.name, args.amplitude
        ),
    )?;
    let board = hex(&session.identity.board, "without a number");
    let load = Load::at(&model, &angles).filter(|_| !args.no_hold);
    let falls = load.as_ref().map_or_else(String::new, |load| format!("; {load}"));
    output::notice(options, &format!("this takes {time:.0} s; Ctrl-C disables{falls}"));
    let mut machine = BoardMachine::new(session, options, &model)?;
    let ended = match identify_joints(&mut machine, &model, &settings) {
        Ok(readings) => {
            let kept = keep(options, args, file, (&model, &board), &readings);
            load.map_or(Ok(()), |_| hold(&mut machine)).and(kept)
        }
        // Something is in the way of a robot that would fall on it.
        Err(Failure::Identify(error @ (IdentifyError::Resisted { .. } | IdentifyError::Touched { .. })))
            if load.is_some() =>
        {
            output::notice(options, &error.to_string());
            hold(&mut machine).and(Err(error.into()))
        }
        Err(failure) => Err(failure),
    };
    let disabled = machine.end();
    ended.map_err(|failure| failure.named(&model)).and(disabled)
}

/// Fits the readings, writes the file and tells the results.
fn keep(
    options: &Options,
    args: &Identify,
    mut file: CalibrationFile,
    (model, board): (&RobotModel, &str),
    readings: &[Vec<Reading>],
) -> Result<(), Failure> {
    let (mut value, text) = if args.weighed {
        let fits: Vec<Fit> = readings.iter().map(|readings| fit_weighed(readings)).collect();
        update(&mut file, &identified(model, &fits), model, &fits);
        (super::report(model, &fits, &[], None), super::results(model, &fits))
    } else {
        let known = if args.out.exists() { Calibration::load(&args.out)? } else { Calibration::default() };
        let fits: Vec<_> = readings.iter().map(|readings| fit_free(readings)).collect();
        update_free(&mut file, &identified_free(model, &fits, &known), model, &fits);
        (report(model, &fits), table(model, &fits))
    };
    save(options, &args.out, &with_head(&file.to_string(), &model.name, board), |out| {
        value["file"] = json!(out);
        output::result(options, &value, || text + &saved(out))
    })
}

/// Holds the robot where it is until Ctrl-C.
fn hold(machine: &mut BoardMachine<'_>) -> Result<(), Failure> {
    output::notice(machine.options, "holding, because without power it would fall; Ctrl-C disables");
    let mut goal = Request::Keep;
    loop {
        let sense = match machine.tick(goal.clone()) {
            Err(_) if machine.interrupted.load(Ordering::Relaxed) => return Ok(()),
            sense => sense?,
        };
        let mode = sense.telemetry.mode;
        if !matches!(mode, Mode::Enabled(_)) {
            return Err(IdentifyError::Stopped(mode).into());
        }
        if goal == Request::Keep {
            let here = |(state, joint): (&JointTelemetry, &JointModel)| {
                state.position.clamp(joint.limits.lower, joint.limits.upper)
            };
            let positions = sense.telemetry.joints.iter().zip(&machine.model.joints).map(here).collect();
            goal = Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }));
        }
    }
}

/// The results as JSON: `null` where nothing was identified, with the reason.
fn report(model: &RobotModel, fits: &[Result<FreeFit, NotIdentified>]) -> serde_json::Value {
    let number = |Estimate { value, deviation }| json!({ "value": value, "deviation": deviation });
    let joint = |(joint, fit): (&JointModel, &Result<FreeFit, NotIdentified>)| {
        let found = fit.as_ref().ok();
        let value = json!({
            "coulomb": found.map(|fit| number(fit.coulomb)),
            "viscous": found.map(|fit| number(fit.viscous)),
            "offset": found.map(|fit| number(fit.offset)),
            "inertia": found.map(|fit| number(fit.inertia)),
            "residual": found.map(|fit| fit.residual),
            "readings": found.map(|fit| fit.readings),
            "not_identified": fit.as_ref().err().map(ToString::to_string),
        });
        (joint.name.to_string(), value)
    };
    let joints: serde_json::Map<String, serde_json::Value> =
        model.joints.iter().zip(fits).map(joint).collect();
    json!({ "joints": joints })
}

fn table(model: &RobotModel, fits: &[Result<FreeFit, NotIdentified>]) -> String {
    let mut text = format!(
        "{:<18} {:>17} {:>19} {:>13} {:>13}\n",
        "joint", "coulomb [mN·m]", "viscous [mN·m·s]", "forth [mN·m]", "back [mN·m]"
    );
    let mut notes = String::new();
    let milli = |value: f64| format!("{:.2}", 1e3 * value);
    let both = |Estimate { value, deviation }| format!("{} ± {}", milli(value), milli(deviation));
    for (joint, fit) in model.joints.iter().zip(fits) {
        let name = joint.name.as_str();
        let cells = match fit {
            Ok(FreeFit { coulomb, viscous, offset, .. }) => {
                let ways = [1.0, -1.0].map(|way| milli(coulomb.value + way * offset.value));
                let [forth, back] = ways;
                [both(*coulomb), both(*viscous), forth, back]
            }
            Err(doubt) => {
                let _ = writeln!(notes, "{name}: friction not identified: {doubt}");
                [const { String::new() }; 4].map(|_| "-".to_owned())
            }
        };
        let [coulomb, viscous, forth, back] = cells;
        let _ = writeln!(text, "{name:<18} {coulomb:>17} {viscous:>19} {forth:>13} {back:>13}");
    }
    text + &notes
}
