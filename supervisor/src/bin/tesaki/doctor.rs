//! `doctor`: what is wrong between this PC and the joints, and what to do.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::protocol::{ClockSource, ResetCause, Status, Stream};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::port::{self, Address};
use tesaki_supervisor::{Board, BoardError, LinkBoard};

use crate::args::Options;
use crate::board_session::{Line, dial, place, version};
use crate::failure::Failure;
use crate::model::checksum;
use crate::output;

/// A USB serial adapter that waits longer before it hands bytes over delays every answer by so much [ms].
const LATENCY: u32 = 4;
/// Part of the stack that may be used.
const STACK: f32 = 0.9;

/// How a finding weighs.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Weight {
    Good,
    /// Works, but look at it.
    Warning,
    /// Does not work.
    Bad,
}

struct Finding {
    weight: Weight,
    text: String,
    /// What to do.
    advice: String,
}

struct Doctor {
    findings: Vec<Finding>,
    /// The worst failure, for the exit code.
    failure: Option<u8>,
}

impl Doctor {
    fn good(&mut self, text: impl Into<String>) {
        self.findings.push(Finding { weight: Weight::Good, text: text.into(), advice: String::new() });
    }

    fn warning(&mut self, text: impl Into<String>, advice: impl Into<String>) {
        self.findings.push(Finding { weight: Weight::Warning, text: text.into(), advice: advice.into() });
    }

    fn bad(&mut self, code: u8, text: impl Into<String>, advice: impl Into<String>) {
        self.failure.get_or_insert(code);
        self.findings.push(Finding { weight: Weight::Bad, text: text.into(), advice: advice.into() });
    }
}

pub fn run(options: &Options, robot: Option<&Path>) -> Result<ExitCode, Failure> {
    let mut doctor = Doctor { findings: Vec::new(), failure: None };
    if let Some(board) = line(options, &mut doctor)
        && let Err(failure) = health(board, robot, &mut doctor)
    {
        doctor.bad(failure.number(), failure.to_string(), "");
    }
    let list: Vec<_> = doctor
        .findings
        .iter()
        .map(|Finding { weight, text, advice }| {
            let weight = match weight {
                Weight::Good => "good",
                Weight::Warning => "warning",
                Weight::Bad => "bad",
            };
            json!({ "weight": weight, "finding": text, "advice": advice })
        })
        .collect();
    output::result(options, &list, || {
        let mut text = String::new();
        for Finding { weight, text: finding, advice } in &doctor.findings {
            let sign = match weight {
                Weight::Good => "ok  ",
                Weight::Warning => "look",
                Weight::Bad => "BAD ",
            };
            text += &format!("{sign}  {finding}\n");
            if !advice.is_empty() {
                text += &format!("      → {}\n", advice.replace('\n', "\n        "));
            }
        }
        let count = |weight| doctor.findings.iter().filter(|finding| finding.weight == weight).count();
        text + &match (count(Weight::Bad), count(Weight::Warning)) {
            (0, 0) => "everything is well".to_owned(),
            (0, warnings) => format!("works; {warnings} to look at"),
            (bad, _) => format!("{bad} to mend"),
        }
    })?;
    Ok(doctor.failure.map_or(ExitCode::SUCCESS, ExitCode::from))
}

/// From the ports to a board that speaks our language.
fn line(options: &Options, doctor: &mut Doctor) -> Option<LinkBoard<Line>> {
    let found = port::list();
    if found.is_empty() {
        doctor.warning(
            "no ports are listed",
            "plug a board in, or start a simulated one with `cargo sim serve`",
        );
    } else {
        let names: Vec<String> = found.iter().map(|port| port.address.to_string()).collect();
        doctor.good(format!("ports: {}", names.join(", ")));
    }
    let mut board = match dial(options) {
        Ok(board) => board,
        Err(failure) => {
            doctor.bad(failure.number(), failure.to_string(), "");
            return None;
        }
    };
    let place = place(&board);
    doctor.good(format!("{place} opens"));
    if let Ok(Address::Path(path)) = place.parse()
        && let Some(latency) = port::latency_timer(&path)
    {
        if latency > LATENCY {
            doctor.warning(
                format!("the adapter holds bytes back for up to {latency} ms (latency timer)"),
                format!(
                    "echo 1 | sudo tee /sys/bus/usb-serial/devices/{}/latency_timer",
                    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
                ),
            );
        } else {
            doctor.good(format!("latency timer: {latency} ms"));
        }
    }
    match board.hello() {
        Ok(identity) => {
            let (here, there) = (env!("CARGO_PKG_VERSION"), version(identity.firmware));
            if here == there {
                doctor.good(format!("firmware {there} answers"));
            } else {
                doctor.warning(
                    format!("firmware {there} answers; this program is {here}"),
                    "they understand each other; flash the newer of both when convenient",
                );
            }
            Some(board)
        }
        Err(error @ BoardError::SchemaMismatch { .. }) => {
            doctor.bad(4, error.to_string(), "build and flash with `cargo xtask firmware`");
            None
        }
        Err(BoardError::Timeout { seconds }) => {
            let counts = board.counts();
            let damaged = counts.overlong + counts.framing + counts.checksum + counts.malformed;
            if damaged > 0 {
                doctor.bad(
                    6,
                    format!("bytes come, but no valid frames ({damaged} damaged ones in {seconds} s)"),
                    "the other end runs at another baud rate, or is another program's device: this program uses \
                     921600 baud (a board whose clock fell back to its 16 MHz oscillator uses 115200)",
                );
            } else {
                doctor.bad(
                    6,
                    format!("no answer within {seconds} s"),
                    "is the board powered and flashed? are RX and TX crossed (board PA9 to the adapter's RX, PA10 to \
                     its TX), and the grounds joined?",
                );
            }
            None
        }
        Err(error) => {
            let failure = Failure::from(error);
            doctor.bad(failure.number(), failure.to_string(), "");
            None
        }
    }
}

/// From a board that answers to joints that could move.
fn health(mut board: LinkBoard<Line>, robot: Option<&Path>, doctor: &mut Doctor) -> Result<(), Failure> {
    let Status { node, board: state } = board.status()?;
    match board.round_trip() {
        Some(trip) if trip > Duration::from_millis(30) => {
            doctor.warning(
                format!("a request takes {:.0} ms", trip.as_secs_f64() * 1e3),
                "is the PC or the line busy?",
            );
        }
        Some(trip) => doctor.good(format!("a request takes {:.1} ms", trip.as_secs_f64() * 1e3)),
        None => {}
    }
    if state.clock != ClockSource::Crystal && !is_emulated(&state.identity.board) {
        doctor.warning(
            format!("the clock runs from {:?} instead of the crystal", state.clock),
            "check the 8 MHz crystal; angles and torques are right, times are off by about 1 %",
        );
    }
    if state.reset != ResetCause::PowerOn && state.reset != ResetCause::Software {
        let words =
            if state.last_words.is_empty() { String::new() } else { format!(": {}", state.last_words) };
        doctor.warning(
            format!("the last reset was no power-on but {:?}{words}", state.reset),
            "please report it",
        );
    }
    #[expect(clippy::cast_precision_loss, reason = "a share")]
    let stack = state.stack_used as f32 / state.stack_size.max(1) as f32;
    if stack > STACK {
        doctor.warning(format!("{:.0} % of the stack was used", stack * 100.0), "please report it");
    }
    let link = state.supervisor_link;
    let damaged = link.frames.overlong + link.frames.framing + link.frames.checksum + link.frames.malformed;
    let lost = link.receive_overflow + link.receive_errors;
    if damaged + lost > 0 {
        doctor.warning(
            format!(
                "the board received {damaged} damaged frames beside {} good ones ({} bytes lost to noise or overrun, {} \
                 to a full queue)",
                link.frames.good, link.receive_errors, link.receive_overflow
            ),
            "a few at power-on or after unplugging are normal; many mean a bad cable, a missing ground or too long a line",
        );
    } else {
        doctor.good(format!("the line is clean: {} frames received by the board", link.frames.good));
    }
    if board.repeats() > 0 {
        doctor.warning(
            format!("{} requests had to be sent again, as no answer came in time", board.repeats()),
            "is the line bad, or the PC very busy?",
        );
    }
    if let Some(client) = node.commander {
        doctor.warning(
            format!("client {client:08x} commands the board"),
            "watching works; to command, wait for it to end, or use --take-over",
        );
    }
    if node.model.is_empty() {
        doctor.bad(1, "the board has no robot model", "tesaki model push robots/NAME");
        return Ok(());
    }
    match robot {
        None => doctor.good(format!("robot model {} ({:08x})", node.model, node.model_checksum)),
        Some(folder) => {
            let model = RobotFolder::load(folder)?.model;
            if checksum(&model)? == node.model_checksum {
                doctor.good(format!("robot model {}, the same as in {}", node.model, folder.display()));
            } else {
                doctor.warning(
                    format!("the board's model {} is not the one in {}", node.model, folder.display()),
                    format!("tesaki model push {}", folder.display()),
                );
            }
        }
    }
    let model = board.model()?;
    board.set_rate(Stream::Telemetry, 1)?;
    let deadline = Instant::now() + Duration::from_millis(500);
    let mut alive = false;
    while let Some(event) = board.next_event(deadline)? {
        alive |= matches!(event, tesaki::protocol::FromBoard::Telemetry(_));
        if alive {
            break;
        }
    }
    let _ = board.set_rate(Stream::Telemetry, 0);
    if alive {
        doctor.good("sensors are read and the control runs");
    } else {
        doctor.bad(
            6,
            "the control does not run: no sensor readings",
            "a bare board has no drivers for sensors; on the plant link, is the simulator running?",
        );
    }
    let safety = model.safety;
    if node.supply < safety.supply_min || node.supply > safety.supply_max {
        doctor.bad(
            1,
            format!("supply {:.1} V, outside {} to {} V", node.supply, safety.supply_min, safety.supply_max),
            "check the power supply, or safety.supply_min and _max in controller.toml",
        );
    } else {
        doctor.good(format!("supply {:.1} V", node.supply));
    }
    let missing: Vec<&str> = (0..)
        .zip(&model.joints)
        .filter(|(index, _)| node.homed >> index & 1 == 0)
        .map(|(_, joint)| joint.name.as_str())
        .collect();
    if missing.is_empty() {
        doctor.good("all joints are homed");
    } else {
        doctor.bad(
            1,
            format!("not homed: {}", missing.join(", ")),
            "put the joints at known angles, then `tesaki home JOINT=ANGLE … --others 0`",
        );
    }
    if node.mode == tesaki::protocol::Mode::Fault {
        let log = board.faults()?;
        let text = log.faults.last().map_or_else(String::new, |fault| fault.named(&model).to_string());
        doctor.bad(5, format!("the board is in fault: {text}"), "tesaki faults --clear");
    } else if !node.faults_read {
        doctor
            .warning(format!("{} faults since power-on, not all of them read", node.faults), "tesaki faults");
    } else {
        doctor.good(format!("the board is {}", node.mode));
    }
    Ok(())
}

/// A board without a number is none of silicon.
fn is_emulated(number: &[u8]) -> bool {
    number.iter().all(|&byte| byte == 0)
}
