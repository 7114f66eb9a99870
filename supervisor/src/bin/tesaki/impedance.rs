//! `impedance`: Cartesian impedance control of an arm.

use std::fmt::Write as _;
use std::time::Instant;

use nalgebra::Vector3;
use serde_json::json;
use tesaki::protocol::{Mode, Request, TaskReport};
use tesaki::task::impedance::{ImpedanceSettings, ImpedanceTelemetry, Redundancy};
use tesaki::task::{TaskConfig, TaskKind, TaskTelemetry};
use tesaki_description::impedance;
use tesaki_supervisor::Board;
use tesaki_supervisor::task_report::SINGULAR;

use crate::args::{Hold, Impedance, Options};
use crate::board_session::BoardSession;
use crate::failure::Failure;
use crate::motion::{End, KEEP_ALIVE, Motion};
use crate::output;

/// A stiffer surface makes no difference: that of the arm itself limits it [N/m].
const MAX_SURFACE: f32 = 100_000.0;

pub fn run(options: &Options, command: &Impedance) -> Result<(), Failure> {
    match command {
        Impedance::Hold(args) => hold(options, args),
        Impedance::Status => status(options),
    }
}

fn hold(options: &Options, args: &Hold) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let settings = impedance::load(&args.file, &motion.model)?;
    output::confirm(
        options,
        &format!(
            "{} will be powered and yield as specified in {}. At the end it is disabled and falls unless it is supported. \
             Continue?",
            motion.model.name,
            args.file.display()
        ),
    )?;
    // Starts the telemetry, which reports faults.
    let angles = motion.positions()?;
    output::notice(
        options,
        &surfaces(&settings, &impedance::own_mass_at(&motion.model, &angles, settings.impedance.axes)),
    );
    motion.enable(TaskConfig::Impedance(settings))?;
    output::notice(options, "enabled: push the tool");
    motion.announce_ctrl_c(motion.load().as_ref());
    let begun = Instant::now();
    let until = args.duration.map(|duration| begun + duration);
    let mut live = output::Live::new(options);
    let has_elbow = settings.redundancy != Redundancy::None;
    let (mut force, mut distance) = (0.0_f32, 0.0_f32);
    let end = motion.drive(
        KEEP_ALIVE,
        |_| Request::Keep,
        |news, now| {
            if let Some(TaskReport { telemetry: TaskTelemetry::Impedance(tool), .. }) = &news.task {
                force = force.max(norm(&tool.wrench));
                distance = distance.max(norm(&tool.error));
                live.show(&one_line(tool, has_elbow));
            }
            until.is_some_and(|until| now >= until)
        },
    );
    live.end();
    let held = begun.elapsed();
    motion.end(end? == End::Interrupted)?;
    let value = json!({
        "held_seconds": held.as_secs_f64(),
        "largest_force": output::exact(&force),
        "largest_distance": output::exact(&distance),
    });
    output::result(options, &value, || {
        format!(
            "done: compliant for {:.1} s, maximum force {force:.1} N, maximum deviation {:.1} mm",
            held.as_secs_f64(),
            1000.0 * distance
        )
    })
}

/// Which surfaces the impedance can bear in this posture, along each axis.
fn surfaces(settings: &ImpedanceSettings, own_mass: &[f32; 3]) -> String {
    let bears = |axis: usize| settings.max_contact_stiffness(axis, own_mass[axis]);
    let [x, y, z] = [0, 1, 2].map(|axis| format!("{:.1}", bears(axis).min(MAX_SURFACE) / 1000.0));
    format!(
        "stable on surfaces of up to {x}, {y} and {z} N/mm across its x, y and z; on stiffer ones mass and damping are raised"
    )
}

fn status(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let tool = session.board.read_impedance()?;
    let mode = session.board.status()?.node.mode;
    let model = session.model().ok();
    // The board keeps what the task said last: at a fault, or when it was disabled.
    let ended = match mode {
        Mode::Enabled(TaskKind::Impedance) => None,
        Mode::Fault => {
            let fault = session.fault(model.as_ref());
            Some(format!("the impedance control ended: the board is in fault: {fault}"))
        }
        mode => Some(format!("no impedance control now: the board is {mode}")),
    };
    let has_elbow = model.as_ref().is_none_or(output::has_elbow);
    let mut value = output::tool(&tool, model.as_ref());
    value["mode"] = output::exact(&mode);
    output::result(options, &value, || match &ended {
        None => table(&tool, has_elbow),
        Some(ended) => {
            format!("{ended}\nthe position is that of now, the rest of before:\n{}", table(&tool, has_elbow))
        }
    })
}

/// Norm of the linear part [m or N].
pub fn norm(six: &[f32; 6]) -> f32 {
    Vector3::from_column_slice(&six[..3]).norm()
}

fn list(values: &[f32], digits: usize) -> String {
    values.iter().map(|value| format!("{value:.digits$}")).collect::<Vec<_>>().join(", ")
}

fn one_line(tool: &ImpedanceTelemetry, has_elbow: bool) -> String {
    let contact = if tool.contact { "contact" } else { "free" };
    let singular = if tool.sigma_min < SINGULAR { "  nearly singular" } else { "" };
    let elbow = if has_elbow { format!("  elbow {:.3} rad", tool.elbow) } else { String::new() };
    let derated =
        if tool.derating > 1.0 { format!("  derated × {:.1}", tool.derating) } else { String::new() };
    format!(
        "tool {} m, deviation {:.1} mm, force {:.1} N, {contact}{elbow}{singular}{derated}",
        list(&tool.position, 4),
        1000.0 * norm(&tool.error),
        norm(&tool.wrench),
    )
}

fn table(tool: &ImpedanceTelemetry, has_elbow: bool) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<14} {value}");
    };
    line("position", format!("{} m", list(&tool.position, 4)));
    line("orientation", format!("{} (x, y, z, w)", list(&tool.rotation, 4)));
    line("deviation", format!("{} m; {} rad", list(&tool.error[..3], 4), list(&tool.error[3..], 4)));
    line("wrench", format!("{} N; {} N·m", list(&tool.wrench[..3], 2), list(&tool.wrench[3..], 3)));
    line("contact", if tool.contact { "yes" } else { "no" }.to_owned());
    if has_elbow {
        line("elbow", format!("{:.4} rad", tool.elbow));
    }
    let singular = if tool.sigma_min < SINGULAR { ", nearly singular" } else { "" };
    line("sigma_min", format!("{:.3}{singular}", tool.sigma_min));
    if tool.derating > 1.0 {
        line("derating", format!("mass and damping × {:.1}: the surface is stiff", tool.derating));
    }
    text
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tesaki_description::robot::RobotFolder;

    use super::*;

    #[test]
    fn an_arm_of_six_joints_has_no_elbow() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7");
        let seven = RobotFolder::load(&folder).unwrap().model;
        let mut six = seven.clone();
        six.joints.pop();
        six.chains[0].joints = 6;
        let tool = ImpedanceTelemetry { elbow: 0.25, ..ImpedanceTelemetry::NONE };
        let report = TaskReport { tick: 1, telemetry: TaskTelemetry::Impedance(tool) };
        for (model, has_elbow) in [(seven, true), (six, false)] {
            assert_eq!(output::has_elbow(&model), has_elbow);
            let json = output::task(&report, &model);
            assert_eq!((&json["tick"], json["elbow"].as_f64()), (&1.into(), has_elbow.then_some(0.25)));
            assert!(json["elbow"].is_null() != has_elbow, "{json}");
            let text = table(&tool, has_elbow) + &one_line(&tool, has_elbow);
            assert_eq!(text.matches("elbow").count(), if has_elbow { 2 } else { 0 }, "{text}");
        }
    }
}
