//! `identify --joints`: the self-test after power-on.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;

use serde_json::json;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{Request, Telemetry};
use tesaki::task::TaskCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki_description::calibration::{Calibration, CalibrationFile};
use tesaki_supervisor::faults::FaultsBefore;
use tesaki_supervisor::gravity::Load;
use tesaki_supervisor::identify::{
    Estimate, FreeFit, FreeJoint, IdentifyError, JointSettings, Machine, NotIdentified, Reading, duration,
    identify_joints, update_free, with_head,
};
use tesaki_supervisor::{Board, angles};

use super::{BoardMachine, open, saved};
use crate::args::{Identify, Options};
use crate::board_session::{BoardSession, hex, require_homed};
use crate::failure::Failure;
use crate::output;

pub fn run(options: &Options, args: &Identify) -> Result<(), Failure> {
    let settings = JointSettings { amplitude: args.amplitude, torque: args.torque };
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let node = session.board.status()?.node;
    session.require_no_fault(node.mode, Some(&model))?;
    require_homed(node.homed, &model)?;
    let board = hex(&session.identity.board, "without a number");
    let file = open(&args.out, &model, &board)?;
    let telemetry = session.telemetry_now()?;
    let start: Vec<f64> = within_limits(&telemetry, &model).map(f64::from).collect();
    let time = duration(&model, &start, &settings)?;
    output::confirm(
        options,
        &format!(
            "The joints of {} will be swept by ±{} rad for {time:.0} s. Is nothing in the hand or in the way?",
            model.name, args.amplitude
        ),
    )?;
    let load = Load::measured(&model, &telemetry).filter(|_| !args.no_hold);
    let falls = load.as_ref().map_or_else(String::new, |load| format!("; {load}"));
    output::notice(options, &format!("this takes {time:.0} s; Ctrl-C disables{falls}"));
    let mut machine = BoardMachine::new(session, options, &model, FaultsBefore::from(&node))?;
    let ended = match identify_joints(&mut machine, &model, &settings) {
        Ok(readings) => std::thread::scope(|scope| {
            // The board is commanded while the file is written, however long that takes.
            let keeping = scope.spawn(|| keep(options, args, file, (&model, &board), &readings));
            let held = hold(&mut machine, || keeping.is_finished());
            let kept = keeping.join().expect("it does not panic");
            let held = held.and_then(|()| load.map_or(Ok(()), |_| hold_until_interrupted(&mut machine)));
            held.and(kept)
        }),
        // A robot that would fall, perhaps on something that is in the way.
        Err(Failure::Identify(
            error @ (IdentifyError::Resisted { .. }
            | IdentifyError::Touched { .. }
            | IdentifyError::Late { .. }),
        )) if load.is_some() => {
            output::notice(options, &error.to_string());
            hold_until_interrupted(&mut machine).and(Err(error.into()))
        }
        Err(failure) => Err(failure),
    };
    super::ended(ended.map_err(|failure| failure.named(&model)), machine.end())
}

/// The joint angles, clamped to their limits [rad].
fn within_limits(telemetry: &Telemetry, model: &RobotModel) -> impl Iterator<Item = f32> {
    let joints = telemetry.joints.iter().zip(&model.joints);
    joints.map(|(state, joint)| angles::within(state.position, &joint.limits))
}

/// Fits the readings, writes the file and tells the results.
fn keep(
    options: &Options,
    args: &Identify,
    mut file: CalibrationFile,
    (model, board): (&RobotModel, &str),
    readings: &[Vec<Reading>],
) -> Result<(), Failure> {
    let known = if args.out.exists() { Calibration::load(&args.out)? } else { Calibration::default() };
    let joint = |(joint, readings): (&JointModel, &Vec<Reading>)| {
        let known = known.joints.get(joint.name.as_str()).and_then(|known| known.torque_constant);
        FreeJoint::identify(joint, readings, args.weighed, known)
    };
    let found: Vec<FreeJoint> = model.joints.iter().zip(readings).map(joint).collect();
    update_free(&mut file, model, &found);
    output::save(&args.out, &with_head(&file.to_string(), &model.name, board), |out| {
        output::result(options, &report(model, &found, out), || {
            table(model, &found, args.weighed) + &saved(out)
        })
    })
}

/// Holds the robot where it is until Ctrl-C.
fn hold_until_interrupted(machine: &mut BoardMachine<'_>) -> Result<(), Failure> {
    if machine.interrupted.load(Ordering::Relaxed) {
        return Ok(());
    }
    output::notice(machine.options, "holding, because without power it would fall; Ctrl-C disables");
    hold(machine, || false)
}

/// Holds the robot where it is until `done`, or until Ctrl-C.
fn hold(machine: &mut BoardMachine<'_>, mut done: impl FnMut() -> bool) -> Result<(), Failure> {
    let mut goal = Request::Keep;
    while !done() {
        let sense = match machine.tick(goal.clone()) {
            Err(_) if machine.interrupted.load(Ordering::Relaxed) => return Ok(()),
            Err(_) if machine.is_lost => {
                return Err(Failure::Other(
                    "another program disabled the board: it no longer holds".to_owned(),
                ));
            }
            sense => sense?,
        };
        if goal == Request::Keep {
            let positions = within_limits(&sense.telemetry, machine.model).collect();
            goal = Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }));
        }
    }
    Ok(())
}

/// The results as JSON: `null` where nothing was identified, with the reason.
fn report(model: &RobotModel, found: &[FreeJoint], out: Option<&Path>) -> serde_json::Value {
    let number = |Estimate { value, deviation }| json!({ "value": value, "deviation": deviation });
    let joint = |(joint, found): (&JointModel, &FreeJoint)| {
        let friction = found.friction.ok();
        let value = json!({
            "torque_constant": found.torque_constant.and_then(Result::ok).map(number),
            "coulomb": found.coulomb().ok().map(number),
            "viscous": found.viscous().ok().map(number),
            "offset": friction.map(|fit| number(fit.offset)),
            "inertia": friction.map(|fit| number(fit.inertia)),
            "residual": friction.map(|fit| fit.residual),
            "readings": friction.map(|fit| fit.readings),
            "not_identified": doubts(found).next().map(|(what, doubt)| format!("{what}: {doubt}")),
        });
        (joint.name.to_string(), value)
    };
    let joints: serde_json::Map<String, serde_json::Value> =
        model.joints.iter().zip(found).map(joint).collect();
    json!({ "file": out.map(|out| out.display().to_string()), "joints": joints })
}

/// What was asked for and is not identified, and why.
fn doubts(found: &FreeJoint) -> impl Iterator<Item = (&'static str, NotIdentified)> {
    let part = |part: Result<Estimate, NotIdentified>| part.err().filter(|_| found.friction.is_ok());
    let doubts = [
        ("torque constant", found.torque_constant.and_then(Result::err)),
        ("friction", found.friction.err()),
        ("Coulomb friction", part(found.coulomb())),
        ("viscous friction", part(found.viscous())),
    ];
    doubts.into_iter().filter_map(|(what, doubt)| Some((what, doubt?)))
}

fn table(model: &RobotModel, found: &[FreeJoint], weighed: bool) -> String {
    let constants = |cell: &str| if weighed { format!(" {cell:>19}") } else { String::new() };
    let mut text = format!(
        "{:<18}{} {:>17} {:>19} {:>13} {:>13}\n",
        "joint",
        constants("constant [N·m/A]"),
        "coulomb [mN·m]",
        "viscous [mN·m·s]",
        "forth [mN·m]",
        "back [mN·m]"
    );
    let mut notes = String::new();
    let milli = |value: f64| format!("{:.2}", 1e3 * value);
    let both = |Estimate { value, deviation }| format!("{} ± {}", milli(value), milli(deviation));
    for (joint, found) in model.joints.iter().zip(found) {
        let name = joint.name.as_str();
        let constant = found.torque_constant.and_then(Result::ok).map_or_else(
            || "-".to_owned(),
            |Estimate { value, deviation }| format!("{value:.4} ± {deviation:.4}"),
        );
        let cells = found.friction.map_or_else(
            |_| std::array::from_fn(|_| "-".to_owned()),
            |FreeFit { coulomb, viscous, offset, .. }| {
                let [forth, back] = [1.0, -1.0].map(|way| milli(coulomb.value + way * offset.value));
                [both(coulomb), both(viscous), forth, back]
            },
        );
        let [coulomb, viscous, forth, back] = cells;
        let constant = constants(&constant);
        let _ = writeln!(text, "{name:<18}{constant} {coulomb:>17} {viscous:>19} {forth:>13} {back:>13}");
        for (what, doubt) in doubts(found) {
            let _ = writeln!(notes, "{name}: {what} is not identified: {doubt}");
        }
    }
    text + &notes
}
