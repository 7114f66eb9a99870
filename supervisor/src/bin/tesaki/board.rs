//! The short commands: list, info, disable, stop, faults.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use serde_json::json;
use tesaki::fault::Fault;
use tesaki::protocol::{ClockSource, Identity, Mode, Refusal, Request, ResetCause, Status};
use tesaki::task::TaskKind;
use tesaki::task::grasping::Phase;
use tesaki_supervisor::faults::describe;
use tesaki_supervisor::gravity::Load;
use tesaki_supervisor::port;
use tesaki_supervisor::troubleshooting;
use tesaki_supervisor::{Board, BoardError, words};

use crate::args::Options;
use crate::board_session::{BoardSession, dial, hex, version};
use crate::failure::Failure;
use crate::output;

/// How often a request to stop or disable is sent while another program enables the board.
const ATTEMPTS: u32 = 5;

pub fn list(options: &Options) -> Result<(), Failure> {
    let found = port::list();
    let value: Vec<_> = found
        .iter()
        .map(|port| {
            json!({ "port": port.address.to_string(), "description": port.description, "simulated": port.simulated })
        })
        .collect();
    output::result(options, &value, || {
        if found.is_empty() {
            return "no ports found: connect a board, or start a simulated one with `cargo sim serve`"
                .to_owned();
        }
        let mut text = String::new();
        for port in &found {
            let _ = writeln!(text, "{:<34} {}", port.address.to_string(), port.description);
        }
        text
    })
}

/// The names of the capabilities.
fn capabilities(bits: u32) -> String {
    let board = [(Identity::PLANT_LINK, "plant link"), (Identity::POWER_STAGES, "power stages")]
        .map(|(bit, name)| (bit, name.to_owned()));
    let tasks = TaskKind::ALL.iter().map(|&task| (Identity::task(task), task.to_string()));
    let known = board.into_iter().chain(tasks);
    let names: Vec<String> = known.filter(|(bit, _)| bits & bit != 0).map(|(_, name)| name).collect();
    names.join(", ")
}

pub fn info(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let status = session.board.status()?;
    let outputs = session.outputs_in(status.node.mode);
    let value = json!({
        "port": session.port,
        "identity": session.identity,
        "status": output::exact(&status),
        "outputs": outputs,
    });
    output::result(options, &value, || {
        let Status { node, board } = &status;
        let Identity { firmware, image, board: number, capabilities: bits } = session.identity;
        let mut text = String::new();
        let mut line = |name: &str, value: &str| {
            let _ = writeln!(text, "{name:<14} {value}");
        };
        line("port", &session.port);
        line("firmware", &version(firmware));
        line("image", &hex(&image, "none: the control core runs in a PC program"));
        line("board", &hex(&number, "none: simulated"));
        line("capabilities", &capabilities(bits));
        let robot =
            if node.model.is_empty() { "none: push one with `tesaki model push`" } else { &node.model };
        line("robot", robot);
        if !node.model.is_empty() {
            line("model", &format!("{:08x}", node.model_checksum));
            line("homed", &output::counted(node.homed.count_ones() as usize, "joint"));
        }
        line("mode", &words::mode(node.mode, outputs));
        let read = if node.faults_read { "" } else { ", some unread" };
        line("faults", &format!("{}{read}", node.faults));
        let commander = match node.commander {
            None => "nobody".to_owned(),
            Some(client) if client == session.board.client() => "this program".to_owned(),
            Some(client) => format!("client {client:08x}"),
        };
        line("commanded by", &commander);
        line("supply", &format!("{:.1} V", node.supply));
        line("last tick", &node.tick.to_string());
        line("clock", clock(board.clock));
        line("last reset", reset(board.reset));
        if board.reset != ResetCause::PowerOn && !board.last_words.is_empty() {
            line("last words", &board.last_words);
        }
        if board.stack_size > 0 {
            line("stack", &format!("peak use {} of {} bytes", board.stack_used, board.stack_size));
        }
        let frames = board.supervisor_link.frames;
        let damaged = frames.damaged();
        line("link", &format!("{} good and {damaged} damaged frames received by the board", frames.good));
        text
    })
}

/// A clock source, in words.
pub const fn clock(source: ClockSource) -> &'static str {
    match source {
        ClockSource::Crystal => "crystal, 168 MHz",
        ClockSource::InternalPll => "internal oscillator, 168 MHz within 1 %",
        ClockSource::Internal => "internal oscillator, 16 MHz",
    }
}

/// The cause of a reset, in words.
pub const fn reset(cause: ResetCause) -> &'static str {
    match cause {
        ResetCause::PowerOn => "power-on or reset button",
        ResetCause::Watchdog => "watchdog",
        ResetCause::Panic => "panic of the firmware",
        ResetCause::HardFault => "fault of the processor",
        ResetCause::Software => "software or debugger",
        ResetCause::CrystalStopped => "the crystal stopped",
        ResetCause::BrownOut => "the 3.3 V of the microcontroller fell",
    }
}

pub fn disable(options: &Options) -> Result<(), Failure> {
    let (action, request) = ("disable its outputs", Request::Disable);
    let mut session = open_after(options, action, &request)?;
    let mode = insist(&mut session.board, action, &request)?;
    output::result(options, &json!({ "mode": mode }), || {
        let falls = falls(&mut session).map_or_else(String::new, |falls| format!("; {falls}"));
        format!("outputs off; the board is {mode}{falls}")
    })
}

pub fn stop(options: &Options) -> Result<(), Failure> {
    let (action, request) = ("stop", Request::Stop);
    let mut session = open_after(options, action, &request)?;
    let mode = insist(&mut session.board, action, &request)?;
    // The stop has succeeded, whether the board tells its outputs or not.
    let outputs = session.outputs_in(mode);
    output::result(options, &json!({ "mode": mode, "outputs": outputs }), || match (mode, outputs) {
        (Mode::Fault, Some(false)) => {
            "the board is in fault, and its outputs are off. `tesaki faults --clear` clears the fault"
                .to_owned()
        }
        (Mode::Fault, _) => "stopped; the board is in fault. `tesaki disable` switches the outputs off, \
                             `tesaki faults --clear` switches them off and clears the fault"
            .to_owned(),
        (mode, _) => format!("nothing to stop: the board is {mode}"),
    })
}

/// Opens the port and sends `request`, which a board takes from every client, before the greeting: a board of
/// another version does nothing else for this one.
fn open_after(options: &Options, action: &'static str, request: &Request) -> Result<BoardSession, Failure> {
    let mut board = dial(options)?;
    let confirmed = match board.ask(action, request.clone()) {
        // Nothing answers, not even in the words of another version.
        Err(error) if board.counts().good + board.counts().malformed == 0 => return Err(error.into()),
        confirmed => confirmed,
    };
    let greeted = BoardSession::greet(board);
    if let Err(Failure::Board(BoardError::SchemaMismatch { .. })) = greeted {
        let answer = if confirmed.is_ok() { "was confirmed" } else { "was sent, but was not confirmed" };
        output::complain(&format!("the request to {action} {answer}"));
        return greeted;
    }
    confirmed?;
    greeted
}

/// Sends `request`, after which the board is not enabled, and returns the mode. If another program has
/// enabled the board by then, it is sent again.
fn insist(board: &mut impl Board, action: &'static str, request: &Request) -> Result<Mode, Failure> {
    for _ in 0..ATTEMPTS {
        board.ask(action, request.clone())?;
        match board.status()?.node.mode {
            Mode::Enabled(_) => {}
            mode => return Ok(mode),
        }
    }
    Err(Failure::Other(format!(
        "THE BOARD IS ENABLED: another program enabled it again after each of {ATTEMPTS} requests to {action}. End \
         that program, or press the emergency stop"
    )))
}

/// What falls without power: the robot, or what its hand holds. What the board does not tell is left out.
fn falls(session: &mut BoardSession) -> Option<String> {
    let holds = session.board.read_grasp().is_ok_and(|grasp| {
        use Phase::{Hold, Lower, Move, ProbeFriction, Squeeze};
        matches!(grasp.phase, Squeeze | ProbeFriction | Hold | Move | Lower)
    });
    if holds {
        // The board keeps the phase of a grasp that has ended, so the hand may be empty.
        return Some("an object that the hand still holds falls".to_owned());
    }
    let model = session.model().ok()?;
    let telemetry = session.telemetry_now().ok()?;
    Load::measured(&model, &telemetry).map(|load| load.to_string())
}

/// Asks before what a board in fault holds loses its power.
fn confirm_fall(options: &Options, session: &mut BoardSession) -> Result<(), Failure> {
    if session.outputs()? == Some(true)
        && let Some(falls) = falls(session)
    {
        output::notice(options, &format!("clearing the faults switches the outputs off; {falls}"));
        output::confirm(options, "The outputs will be switched off. Continue?")?;
    }
    Ok(())
}

pub fn faults(options: &Options, clear: bool) -> Result<(), Failure> {
    let mut session = if clear { BoardSession::command(options)? } else { BoardSession::open(options)? };
    let log = session.board.faults()?;
    // Without a model the faults have joint numbers instead of names.
    let model = session.board.model().ok();
    let before = session.board.status()?.node.mode;
    if clear {
        if before == Mode::Fault {
            confirm_fall(options, &mut session)?;
        }
        // Only what is printed below. Another fault may come after they are read, such as somebody's stop.
        match session.board.ask("clear the faults", Request::ClearFaults { total: log.total }) {
            Err(BoardError::Refused { refusal: Refusal::FaultsUnread { .. }, .. }) => {
                let log = session.board.faults()?;
                let last =
                    log.faults.last().map_or_else(String::new, |fault| describe(fault, model.as_ref()));
                return Err(Failure::Fault(format!("{last}\n{}", words::ANOTHER_FAULT)));
            }
            other => other?,
        };
    }
    let node = session.board.status()?.node;
    let mode = node.mode;
    let outputs = session.outputs_in(mode);
    // A fault in a tick that is still to come happened before a reset, perhaps with another model.
    let named = |fault: &Fault| model.as_ref().filter(|_| fault.tick <= node.tick);
    let list: Vec<_> = log
        .faults
        .iter()
        .map(|fault| {
            let joint = fault.joint.and_then(|joint| Some(named(fault)?.joint_name(joint.into()).to_owned()));
            json!({
                "number": fault.cause.number(),
                "fault": output::exact(fault),
                "joint": joint,
                "text": describe(fault, named(fault)),
            })
        })
        .collect();
    let value = json!({ "total": log.total, "faults": list, "mode": mode, "outputs": outputs });
    output::result(options, &value, || {
        let mut text = String::new();
        match (log.faults.is_empty(), clear, mode) {
            (true, ..) => {}
            (_, true, _) if before == Mode::Fault => {
                text.push_str("the faults are cleared. All faults since power-on, the last one last:\n");
            }
            (_, true, _) => text.push_str("no fault to clear. Past faults:\n"),
            (_, _, Mode::Fault) if log.faults.len() > 1 => {
                text.push_str("all faults since power-on, cleared ones too:\n");
            }
            (_, _, Mode::Fault) => {}
            _ => text.push_str("past faults; none stops the board now:\n"),
        }
        // The board does not tell which ones were cleared; the last one was not.
        for (index, fault) in log.faults.iter().enumerate() {
            if mode == Mode::Fault && index + 1 == log.faults.len() {
                text.push_str(
                    "the board is stopped until this fault is cleared (`tesaki faults --clear`):\n",
                );
            }
            let _ = writeln!(text, "  {}", describe(fault, named(fault)));
        }
        // The board does not tell when its model came; the last fault of a board in fault is younger.
        let certain = usize::from(before == Mode::Fault);
        let older = log.faults.iter().rev().skip(certain);
        if let Some(model) = &model
            && older.filter(|fault| named(fault).is_some()).any(|fault| fault.joint.is_some())
        {
            let _ = writeln!(
                text,
                "joints are named as in {}, the model on the board; a fault before its push may be of another robot",
                model.name
            );
        }
        let dropped = log.total as usize - log.faults.len().min(log.total as usize);
        if dropped > 0 {
            let _ = writeln!(text, "no longer stored: {dropped}, older ones or stops before a further stop");
        }
        let faults = output::counted(log.total as usize, "fault");
        let mode = words::mode(mode, outputs);
        let _ = write!(text, "{faults} since power-on. The board is {mode}.");
        for entry in
            log.faults.iter().map(|fault| troubleshooting::fault(fault.cause)).collect::<BTreeSet<_>>()
        {
            let _ = write!(text, "\nSee {entry}");
        }
        text
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tesaki::protocol::{BoardStatus, NodeStatus, Reply};
    use tesaki_supervisor::BoardError;

    use super::*;

    /// A board that another program enables again after each of the first requests.
    struct Contested {
        enabled_again: u32,
        requests: u32,
    }

    impl Board for Contested {
        fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
            if request != Request::ReadStatus {
                self.requests += 1;
                return Ok(Reply::Done);
            }
            let enabled = self.requests <= self.enabled_again;
            let node = NodeStatus {
                mode: if enabled { Mode::Enabled(TaskKind::JointServo) } else { Mode::Disabled },
                model: heapless::String::new(),
                model_checksum: 0,
                homed: 0,
                faults: 0,
                faults_read: true,
                commander: None,
                tick: 0,
                supply: 0.0,
            };
            Ok(Reply::Status(Status { node, board: BoardStatus::default() }))
        }
    }

    #[test]
    fn a_stop_is_repeated_until_the_board_is_not_enabled_or_fails_loudly() {
        let mut board = Contested { enabled_again: 2, requests: 0 };
        assert_eq!(insist(&mut board, "stop", &Request::Stop).unwrap(), Mode::Disabled);
        assert_eq!(board.requests, 3);
        let mut board = Contested { enabled_again: u32::MAX, requests: 0 };
        let failure = insist(&mut board, "stop", &Request::Stop).unwrap_err();
        assert_ne!(failure.number(), 0);
        assert!(failure.to_string().contains("THE BOARD IS ENABLED"), "{failure}");
    }
}
