//! `impedance`: an arm that yields at its tool.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::json;
use tesaki_description::impedance;
use tesaki_supervisor::Board;
use tesaki::protocol::{Request, TaskReport};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::{TaskConfig, TaskTelemetry};

use crate::args::{Hold, Impedance, Options};
use crate::board_session::BoardSession;
use crate::failure::Failure;
use crate::motion::{End, KEEP_ALIVE, Motion};
use crate::output;

/// Below this the Jacobian is nearly singular.
const SINGULAR: f32 = 0.06;

pub fn run(options: &Options, command: &Impedance) -> Result<(), Failure> {
    match command {
        Impedance::Hold(aim) => hold(options, aim),
        Impedance::Status => status(options),
    }
}

fn hold(options: &Options, aim: &Hold) -> Result<(), Failure> {
    let mut motion = Motion::begin(options)?;
    let settings = impedance::load(&aim.file, &motion.model)?;
    output::confirm(
        options,
        &format!(
            "{} will be powered and yield as {} says; at the end it is disarmed, and falls unless something holds it. \
             Go on?",
            motion.model.name,
            aim.file.display()
        ),
    )?;
    // From here on its telemetry comes, which tells of faults.
    motion.positions()?;
    motion.enable(TaskConfig::Impedance(settings))?;
    output::notice(options, "armed: push the tool; Ctrl-C disarms");
    let begun = Instant::now();
    let until = aim.duration.map(|duration| begun + duration);
    let mut live = output::Live::new(options);
    let (mut force, mut distance) = (0.0_f32, 0.0_f32);
    let end = motion.drive(
        KEEP_ALIVE,
        |_| Request::Keep,
        |news, now| {
            if let Some(TaskReport { telemetry: TaskTelemetry::Impedance(arm), .. }) = &news.task {
                force = force.max(size(&arm.wrench));
                distance = distance.max(size(&arm.error));
                live.show(&in_a_line(arm));
            }
            until.is_some_and(|until| now >= until)
        },
    );
    live.end();
    motion.end(end? == End::Interrupted)?;
    let held: Duration = begun.elapsed();
    let value = json!({
        "held_seconds": held.as_secs_f64(),
        "largest_force": output::exact(&force),
        "largest_distance": output::exact(&distance),
    });
    output::result(options, &value, || {
        format!(
            "done: yielded for {:.1} s, pushed by {force:.1} N at most and {:.1} mm away",
            held.as_secs_f64(),
            1000.0 * distance
        )
    })
}

fn status(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let arm = session.board.read_impedance()?;
    output::result(options, &output::exact(&arm), || in_words(&arm))
}

/// Length of the first three [m or N].
fn size(six: &[f32; 6]) -> f32 {
    Vector3::from_column_slice(&six[..3]).norm()
}

fn list(values: &[f32], digits: usize) -> String {
    values.iter().map(|value| format!("{value:.digits$}")).collect::<Vec<_>>().join(", ")
}

fn in_a_line(arm: &ImpedanceTelemetry) -> String {
    let contact = if arm.contact { "contact" } else { "free" };
    let singular = if arm.sigma_min < SINGULAR { "  nearly singular" } else { "" };
    format!(
        "tool {} m, {:.1} mm off  {:.1} N, {contact}  elbow {:.3} rad{singular}",
        list(&arm.position, 4),
        1000.0 * size(&arm.error),
        size(&arm.wrench),
        arm.elbow,
    )
}

fn in_words(arm: &ImpedanceTelemetry) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<14} {value}");
    };
    line("position", format!("{} m", list(&arm.position, 4)));
    line("orientation", format!("{} (x, y, z, w)", list(&arm.rotation, 4)));
    line("off its place", format!("{} m; {} rad", list(&arm.error[..3], 4), list(&arm.error[3..], 4)));
    line("pushed by", format!("{} N; {} N·m", list(&arm.wrench[..3], 2), list(&arm.wrench[3..], 3)));
    line("contact", if arm.contact { "yes" } else { "no" }.to_owned());
    line("elbow", format!("{:.4} rad", arm.elbow));
    let singular = if arm.sigma_min < SINGULAR { ", nearly singular" } else { "" };
    line("sigma_min", format!("{:.3}{singular}", arm.sigma_min));
    text
}
