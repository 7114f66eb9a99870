//! Output as text and as JSON.

mod file;

use std::io::{self, IsTerminal, Write as _};
use std::path::Path;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use serde::Serialize;
use tesaki::model::{MAX_CHAIN_JOINTS, RobotModel};
use tesaki::protocol::{TaskReport, Telemetry};
use tesaki::task::TaskTelemetry;
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki_supervisor::output_queue::{self as queue, was_interrupted};

use crate::args::Options;
use crate::failure::Failure;

/// Prints `value` as JSON, or `text`.
pub fn result<T: Serialize>(
    options: &Options,
    value: &T,
    text: impl FnOnce() -> String,
) -> Result<(), Failure> {
    if options.json {
        line(&serde_json::to_string(value).map_err(|error| Failure::Other(error.to_string()))?)
    } else {
        line(text().trim_end())
    }
}

/// Refuses to write over what is read; `outcome` and `source` name the arguments.
pub fn keep_input(output: &Path, outcome: &str, input: &Path, source: &str) -> Result<(), Failure> {
    // `-` is standard input or output, not a file of that name.
    let is_stream = |path: &Path| path == Path::new("-");
    let file = |path: &Path| path.canonicalize().ok().filter(|file| file.is_file() && !is_stream(path));
    match (file(input), file(output)) {
        (Some(one), Some(other)) if one == other => Err(Failure::Usage(format!(
            "{source} and {outcome} are both {}, which would be lost: choose another {outcome}",
            input.display()
        ))),
        _ => Ok(()),
    }
}

/// Refuses to write over the files of the robot, a folder or a URDF: whatever the folder holds as URDF or
/// TOML.
pub fn keep_robot(output: &Path, robot: &Path) -> Result<(), Failure> {
    let is_of_robot = |file: &Path| {
        let is_read = file.extension().is_some_and(|end| end == "urdf" || end == "toml");
        is_read && robot.canonicalize().is_ok_and(|robot| file.starts_with(robot))
    };
    let file = if output.canonicalize().is_ok_and(|file| is_of_robot(&file)) { output } else { robot };
    keep_input(output, "--out", file, "a file of the robot")
}

/// The value for JSON, with the shortest digits that identify its single-precision numbers. (`json!` alone
/// would print them in double precision.)
pub fn exact<T: Serialize>(value: &T) -> serde_json::Value {
    serde_json::to_string(value).and_then(|text| serde_json::from_str(&text)).unwrap_or_default()
}

/// Telemetry of an arm's impedance control for JSON; without what it says of an elbow that is not there.
pub fn tool(tool: &ImpedanceTelemetry, model: Option<&RobotModel>) -> serde_json::Value {
    let mut value = exact(tool);
    if !model.is_none_or(has_elbow) {
        value["elbow"] = serde_json::Value::Null;
    }
    value
}

/// Whether an arm can turn its elbow while its tool stands still.
pub fn has_elbow(model: &RobotModel) -> bool {
    model.joints_of(0).count() == MAX_CHAIN_JOINTS
}

/// A task's telemetry for JSON: its tick, then its own fields.
pub fn task(report: &TaskReport, model: &RobotModel) -> serde_json::Value {
    let mut value = serde_json::Map::new();
    value.insert("tick".to_owned(), report.tick.into());
    // An enumeration is an object whose only key is the name of the variant.
    let fields = match &report.telemetry {
        TaskTelemetry::Impedance(arm) => Some(tool(arm, Some(model))),
        other => match exact(other) {
            serde_json::Value::Object(of_task) => of_task.into_iter().next().map(|(_, fields)| fields),
            _ => None,
        },
    };
    if let Some(serde_json::Value::Object(fields)) = fields {
        value.extend(fields);
    }
    serde_json::Value::Object(value)
}

/// The state of the joints for JSON, each with its name. `homed`: a bit for each joint whose angle is known;
/// what is counted from an unknown zero is no angle.
pub fn telemetry(telemetry: &Telemetry, model: Option<&RobotModel>, homed: u16) -> serde_json::Value {
    let mut value = exact(telemetry);
    let joints = value.get_mut("joints").and_then(serde_json::Value::as_array_mut);
    let names = model.into_iter().flat_map(|model| &model.joints).map(|joint| joint.name.as_str());
    for (index, (state, name)) in joints.into_iter().flatten().zip(names).enumerate() {
        let is_homed = homed >> index & 1 != 0;
        if !is_homed {
            (state["position"], state["reference"]) = (serde_json::Value::Null, serde_json::Value::Null);
        }
        state["homed"] = is_homed.into();
        state["name"] = name.into();
    }
    value
}

pub use file::{replace, require_writable, save, written_to};
pub use tesaki_supervisor::output_queue::set_controls;

/// Prints a line.
pub fn line(text: &str) -> Result<(), Failure> {
    written(queue::send(queue::Stream::Output, format!("{text}\n")))
}

/// The failure to write to standard output.
fn written(result: io::Result<()>) -> Result<(), Failure> {
    result.map_err(|error| match error.kind() {
        io::ErrorKind::BrokenPipe => Failure::Pipe,
        io::ErrorKind::WouldBlock => Failure::Stalled,
        _ => Failure::file("standard output")(error),
    })
}

/// Waits until everything is written; not for long after Ctrl-C, or for a reader that has paused too long.
pub fn flush(has_stalled: bool) -> Result<(), Failure> {
    written(queue::flush(has_stalled))
}

/// Prints progress; silent with `--json`.
pub fn notice(options: &Options, text: &str) {
    if !options.json {
        complain(text);
    }
}

/// Prints to standard error, with `--json` too: what is printed on standard output stays as it is. That
/// nobody reads it is no reason to end.
pub fn complain(text: &str) {
    let _ = queue::send(queue::Stream::Error, format!("{text}\n"));
}

/// A status line, overwritten in place on a terminal and printed once a second elsewhere; silent with
/// `--json`.
pub struct Live {
    every: Option<Duration>,
    overwrites: bool,
    shown: Option<Instant>,
}

impl Live {
    pub fn new(options: &Options) -> Self {
        let overwrites = io::stderr().is_terminal();
        let every = Duration::from_millis(if overwrites { 100 } else { 1000 });
        Self { every: (!options.json).then_some(every), overwrites, shown: None }
    }

    /// Shows `text`, unless the line was updated just before.
    pub fn show(&mut self, text: &str) {
        let Some(every) = self.every else { return };
        if self.shown.is_some_and(|shown| shown.elapsed() < every) {
            return;
        }
        self.shown = Some(Instant::now());
        if self.overwrites {
            // Return to the start, and erase the rest of a longer line.
            let _ = queue::send(queue::Stream::Error, format!("\r{text}\x1b[K"));
        } else {
            complain(text);
        }
    }

    /// Ends the line; the last text stays visible.
    pub fn end(&self) {
        if self.overwrites && self.shown.is_some() {
            complain("");
        }
    }
}

/// Prints why the command failed.
pub fn failure(options: &Options, failure: &Failure) {
    if matches!(failure, Failure::Pipe | Failure::Unread) {
        return;
    }
    if matches!(failure, Failure::Stalled) {
        // Not behind what waits for standard output.
        let text = format!("tesaki: {failure}\n");
        std::thread::spawn(move || io::stderr().write_all(text.as_bytes()));
    } else if options.json {
        json_failure(&failure.to_string(), failure.number().into());
    } else {
        // Not behind the `^C` of the terminal.
        let line = if matches!(failure, Failure::Interrupted(_)) { "\n" } else { "" };
        complain(&format!("{line}tesaki: {failure}"));
    }
}

/// Prints why a command failed with `--json`; on standard error, where standard output cannot be written.
pub fn json_failure(message: &str, exit_code: i32) {
    let json = serde_json::json!({ "error": message, "exit_code": exit_code });
    if line(&json.to_string()).and_then(|()| flush(true)).is_err() {
        complain(&format!("tesaki: {message}"));
    }
}

/// How soon Ctrl-C ends a question.
const INTERRUPTED: Duration = Duration::from_millis(50);

/// Asks for confirmation on a terminal.
pub fn confirm(options: &Options, question: &str) -> Result<(), Failure> {
    if options.non_interactive || !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return Ok(());
    }
    let _ = queue::send(queue::Stream::Error, format!("{question} [y/N] "));
    flush(false)?;
    let (sender, receiver) = mpsc::channel();
    // Where Ctrl-C is handled already, it does not end the reading.
    std::thread::spawn(move || {
        let mut answer = String::new();
        let _ = sender.send(io::stdin().read_line(&mut answer).map(|_| answer));
    });
    let answer = loop {
        if was_interrupted() {
            return Err(Failure::Interrupted("nothing was done".to_owned()));
        }
        if let Ok(answer) = receiver.recv_timeout(INTERRUPTED) {
            break answer.map_err(Failure::file("standard input"))?;
        }
    };
    if matches!(answer.trim().to_lowercase().as_str(), "y" | "yes") {
        Ok(())
    } else {
        Err(Failure::Usage("not confirmed; nothing was done".to_owned()))
    }
}

/// Asks whether to continue after a warning. Where standard input leads the robot it holds no answer: then
/// the warning is only told.
pub fn confirm_lead(options: &Options, warning: &str, leads: bool) -> Result<(), Failure> {
    if !leads {
        return confirm(options, &format!("{warning} Continue?"));
    }
    if !options.non_interactive {
        notice(options, warning);
    }
    Ok(())
}

/// A count with its noun in singular or plural.
pub fn counted(count: usize, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") }
}
