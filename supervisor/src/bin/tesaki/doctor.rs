//! `doctor`: diagnosis of everything from the port to the joints.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tesaki::model::{RobotModel, Safety};
use tesaki::protocol::{
    BoardStatus, ClockSource, ForceSensorFault, FromBoard, Identity, LinkStatistics, LogRecord, Mode,
    NodeStatus, ResetCause, SensorFlags, SensorFrame, Status, Stream, Telemetry,
};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::faults;
use tesaki_supervisor::port::{self, Address, Port};
use tesaki_supervisor::publication::own_model;
use tesaki_supervisor::{Board, BoardError, LinkBoard, words};

use crate::args::Options;
use crate::board::{clock, reset};
use crate::board_session::{BoardLink, dial, port_address, version};
use crate::failure::Failure;
use crate::joints::outside;
use crate::model::checksum;
use crate::output;

/// A higher latency timer of a USB serial adapter delays every answer noticeably [ms].
const MAX_LATENCY: u32 = 4;
/// Maximum used fraction of the stack.
const MAX_STACK_USE: f32 = 0.9;

/// Severity of a finding.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Severity {
    Good,
    /// Works, but needs attention.
    Warning,
    /// Does not work.
    Bad,
}

struct Finding {
    severity: Severity,
    text: String,
    /// What to do.
    advice: String,
}

struct Doctor {
    findings: Vec<Finding>,
    /// Exit code of the worst failure.
    failure: Option<u8>,
}

impl Doctor {
    fn good(&mut self, text: impl Into<String>) {
        self.findings.push(Finding { severity: Severity::Good, text: text.into(), advice: String::new() });
    }

    fn warning(&mut self, text: impl Into<String>, advice: impl Into<String>) {
        self.findings.push(Finding { severity: Severity::Warning, text: text.into(), advice: advice.into() });
    }

    fn bad(&mut self, code: u8, text: impl Into<String>, advice: impl Into<String>) {
        self.failure = self.failure.into_iter().chain([code]).max_by_key(|&code| weight(code));
        self.findings.push(Finding { severity: Severity::Bad, text: text.into(), advice: advice.into() });
    }
}

/// How bad a failure is, by its exit code: without a connection nothing else can be known, and a board in
/// fault does nothing else.
const fn weight(code: u8) -> u8 {
    match code {
        3 | 4 | 6 => 2,
        5 => 1,
        _ => 0,
    }
}

pub fn run(options: &Options, robot: Option<&Path>) -> Result<ExitCode, Failure> {
    let mut doctor = Doctor { findings: Vec::new(), failure: None };
    if let Some(board) = check_link(options, &mut doctor)
        && let Err(failure) = check_board(board, robot, &mut doctor)
    {
        doctor.bad(failure.number(), failure.to_string(), "");
    }
    let list: Vec<_> = doctor.findings.iter().map(Finding::json).collect();
    output::result(options, &list, || doctor.report())?;
    Ok(doctor.failure.map_or(ExitCode::SUCCESS, ExitCode::from))
}

impl Finding {
    fn json(&self) -> Value {
        let severity = match self.severity {
            Severity::Good => "good",
            Severity::Warning => "warning",
            Severity::Bad => "bad",
        };
        json!({ "severity": severity, "finding": self.text, "advice": self.advice })
    }
}

impl Doctor {
    fn report(&self) -> String {
        let mut text = String::new();
        for Finding { severity, text: finding, advice } in &self.findings {
            let sign = match severity {
                Severity::Good => "ok  ",
                Severity::Warning => "warn",
                Severity::Bad => "BAD ",
            };
            text += &format!("{sign}  {finding}\n");
            if !advice.is_empty() {
                text += &format!("      → {}\n", advice.replace('\n', "\n        "));
            }
        }
        let count = |severity| self.findings.iter().filter(|finding| finding.severity == severity).count();
        text + &match (count(Severity::Bad), count(Severity::Warning)) {
            (0, 0) => "no problems found".to_owned(),
            (0, warnings) => format!("works; {}", output::counted(warnings, "warning")),
            (bad, _) => format!("{} found", output::counted(bad, "problem")),
        }
    }
}

/// Checks the ports and the link, up to a board that answers.
fn check_link(options: &Options, doctor: &mut Doctor) -> Option<LinkBoard<BoardLink>> {
    let found = port::list();
    if found.is_empty() {
        doctor.warning("no ports found", "connect a board, or start a simulated one with `cargo sim serve`");
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
    let address = port_address(&board);
    doctor.good(format!("{address} opens"));
    check_latency(&address, doctor);
    let answer = board.hello();
    check_answer(&board, answer, doctor).then_some(board)
}

fn check_latency(address: &str, doctor: &mut Doctor) {
    let Ok(Address::Path(path)) = address.parse() else { return };
    let Some(latency) = port::latency_timer(&path) else { return };
    if latency > MAX_LATENCY {
        doctor.warning(
            format!("the USB adapter delays received bytes by up to {latency} ms (latency timer)"),
            format!(
                "echo 1 | sudo tee /sys/bus/usb-serial/devices/{}/latency_timer",
                path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
            ),
        );
    } else {
        doctor.good(format!("latency timer: {latency} ms"));
    }
}

/// Whether the board has answered in the same version of the protocol.
fn check_answer(
    board: &LinkBoard<BoardLink>,
    answer: Result<Identity, BoardError>,
    doctor: &mut Doctor,
) -> bool {
    match answer {
        Ok(identity) => {
            let (here, there) = (env!("CARGO_PKG_VERSION"), version(identity.firmware));
            if here == there {
                doctor.good(format!("firmware {there} answers"));
            } else {
                doctor.warning(
                    format!("firmware {there} answers; this program is version {here}"),
                    "the two are compatible; update the older one when convenient",
                );
            }
            return true;
        }
        Err(error @ BoardError::SchemaMismatch { .. }) => {
            doctor.bad(
                4,
                error.to_string(),
                "flash the image of your board's feature, built from this checkout: firmware/README.md",
            );
        }
        Err(BoardError::Timeout { seconds }) => {
            let counts = board.counts();
            let damaged = counts.damaged();
            if damaged > 0 {
                doctor.bad(
                    6,
                    format!("bytes arrive, but no valid frames ({damaged} damaged ones in {seconds} s)"),
                    "another baud rate or another kind of device: this program uses 921600 baud (a board whose clock \
                     fell back to its 16 MHz oscillator uses 115200)",
                );
            } else {
                // Behind a socket the wires are those of the program there.
                let through = board.link().get_ref().port().map(Port::address);
                let behind = match through {
                    Some(Address::Unix(_) | Address::Tcp(_)) => {
                        "the program at this socket, such as `tesaki share`, says in its terminal whether the board \
                         is away, and why; at its end: "
                    }
                    _ => "",
                };
                doctor.bad(
                    6,
                    format!("no answer within {seconds} s"),
                    format!(
                        "{behind}is the board powered and flashed? Are RX and TX crossed (the board's PA9 to the \
                         adapter's RX, PA10 to its TX; of an ODrive GPIO1 to RX, GPIO2 to TX), and the grounds \
                         connected?"
                    ),
                );
            }
        }
        Err(error) => {
            let failure = Failure::from(error);
            doctor.bad(failure.number(), failure.to_string(), "");
        }
    }
    false
}

/// Checks the board, its model and its joints.
fn check_board(
    mut board: LinkBoard<BoardLink>,
    robot: Option<&Path>,
    doctor: &mut Doctor,
) -> Result<(), Failure> {
    let Status { node, board: state } = board.status()?;
    let round_trip = board.round_trip();
    check_round_trip(round_trip, doctor);
    check_microcontroller(&state, doctor);
    check_frames(&state.supervisor_link, board.repeats(), doctor);
    if let Some(client) = node.commander {
        // Only the next one that asks for command learns whether the lease has expired.
        let advice = if matches!(node.mode, Mode::Enabled(_)) {
            "watching works; to command, wait until it has finished, or use --take-over"
        } else {
            "watching works; another program gets command 1 s after its last request, also if it was killed"
        };
        doctor.warning(format!("client {client:08x} commands the board, or did last"), advice);
    }
    if node.model.is_empty() {
        doctor.bad(1, "the board has no robot model", "tesaki model push ROBOT_FOLDER");
        return Ok(());
    }
    check_model(&node, robot, doctor);
    let model = board.model()?;
    if let Some(slow) = round_trip.and_then(|time| words::slow_link(time, &model.safety)) {
        doctor.bad(6, slow, words::SLOW_LINK);
    }
    let telemetry = check_control(&mut board, doctor)?;
    check_homing(node.homed, &model, doctor);
    if let Some(telemetry) = telemetry {
        check_supply(node.supply, &model.safety, doctor);
        check_angles(&telemetry, node.homed, &model, doctor);
    }
    if node.mode == Mode::Fault {
        let log = board.faults()?;
        let blamed = faults::blamed(&log);
        let on = board.outputs().unwrap_or(None) == Some(true);
        let on = if on { "; its outputs are on, until then it brakes or holds the robot" } else { "" };
        doctor.bad(
            5,
            format!("the board is in fault: {}", faults::in_words(blamed, Some(&model))),
            format!("see {}; clear it with `tesaki faults --clear`{on}", faults::entries(blamed)),
        );
    } else if !node.faults_read {
        let faults = output::counted(usize::try_from(node.faults).unwrap_or(usize::MAX), "fault");
        doctor.warning(format!("{faults} since power-on, not all of them read"), "tesaki faults");
    } else {
        doctor.good(format!("the board is {}", node.mode));
    }
    check_sensors(&mut board, &model, doctor)
}

/// Checks what only the log of the board shows: a frame of its sensors.
fn check_sensors(
    board: &mut LinkBoard<BoardLink>,
    model: &RobotModel,
    doctor: &mut Doctor,
) -> Result<(), Failure> {
    let Some(sensors) = sensor_frame(board)? else { return Ok(()) };
    if sensors.flags.0 & SensorFlags::EMERGENCY_STOP != 0 {
        doctor.bad(
            1,
            "the emergency stop is pressed",
            "release it; while it is pressed the board cannot be enabled, and in fault it stays off",
        );
    }
    if let Some(fault) = sensors.flags.force_sensor() {
        doctor.bad(
            5,
            format!("the force sensor gives no wrench: {fault}"),
            match fault {
                ForceSensorFault::Stuck(_) | ForceSensorFault::Saturated(_) => {
                    "check this gauge, its wires and its gain"
                }
                ForceSensorFault::Silent | ForceSensorFault::Damaged | ForceSensorFault::Restarted => {
                    "check cable, supply and clock of its converter; after a restart the board sets it up again"
                }
            },
        );
    }
    if let Some(mismatch) = mismatch(&sensors, model) {
        doctor.bad(1, mismatch, "push the model of this machine: tesaki model push ROBOT_FOLDER");
    }
    Ok(())
}

/// A frame of the board's sensors, if it gets any.
pub fn sensor_frame(board: &mut LinkBoard<BoardLink>) -> Result<Option<SensorFrame>, BoardError> {
    board.find_in_log(|record| match record {
        LogRecord::Sensors(sensors) => Some(sensors.clone()),
        _ => None,
    })
}

/// How the machine that sends `sensors` differs from its model.
pub fn mismatch(sensors: &SensorFrame, model: &RobotModel) -> Option<String> {
    let force_sensors = model.chains.iter().filter(|chain| chain.force_sensor.is_some()).count();
    let (has, needs) = ((sensors.encoders.len(), sensors.forces.len()), (model.joints.len(), force_sensors));
    let described = |(joints, forces)| {
        format!("{} and {}", output::counted(joints, "joint"), output::counted(forces, "force sensor"))
    };
    (has != needs).then(|| {
        let (has, needs) = (described(has), described(needs));
        format!("the machine has {has}, its model {} has {needs} (fault 8)", model.name)
    })
}

fn check_round_trip(round_trip: Option<Duration>, doctor: &mut Doctor) {
    match round_trip {
        Some(time) if time > Duration::from_millis(30) => {
            doctor.warning(
                format!("a request takes {:.0} ms", time.as_secs_f64() * 1e3),
                "is the PC or the line busy?",
            );
        }
        Some(time) => doctor.good(format!("a request takes {:.1} ms", time.as_secs_f64() * 1e3)),
        None => {}
    }
}

fn check_microcontroller(state: &BoardStatus, doctor: &mut Doctor) {
    if state.clock != ClockSource::Crystal && !is_emulated(&state.identity.board) {
        doctor.warning(
            format!("the clock is the {} instead of the crystal", clock(state.clock)),
            "check the 8 MHz crystal; angles and torques are correct, times are off by about 1 %",
        );
    }
    if state.reset != ResetCause::PowerOn && state.reset != ResetCause::Software {
        let words =
            if state.last_words.is_empty() { String::new() } else { format!(": {}", state.last_words) };
        let advice = match state.reset {
            ResetCause::BrownOut => "measure the 3.3 V of the microcontroller while the motors move",
            _ => "please report this",
        };
        let cause = reset(state.reset);
        doctor.warning(format!("the last reset was not a power-on; its cause: {cause}{words}"), advice);
    }
    #[expect(clippy::cast_precision_loss, reason = "a fraction")]
    let stack = state.stack_used as f32 / state.stack_size.max(1) as f32;
    if stack > MAX_STACK_USE {
        doctor.warning(format!("peak stack use is {:.0} %", stack * 100.0), "please report this");
    }
}

fn check_frames(link: &LinkStatistics, repeats: u64, doctor: &mut Doctor) {
    let frames = link.frames;
    let damaged = frames.damaged();
    let lost = link.receive_overflow + link.receive_errors;
    if damaged + lost > 0 {
        doctor.warning(
            format!(
                "the board received {damaged} damaged and {} good frames ({} bytes lost to noise or overrun, {} to a \
                 full queue)",
                frames.good, link.receive_errors, link.receive_overflow
            ),
            "a few after power-on or unplugging are normal; many indicate a bad cable, a missing ground or a line that \
             is too long",
        );
    } else {
        doctor.good(format!("no damaged frames: the board received {} frames", frames.good));
    }
    if repeats > 0 {
        doctor.warning(
            format!("{repeats} requests were sent again because no answer came in time"),
            "is the line bad, or the PC very busy?",
        );
    }
}

fn check_model(node: &NodeStatus, robot: Option<&Path>, doctor: &mut Doctor) {
    let Some(folder) = robot else {
        doctor.good(format!("robot model {} ({:08x})", node.model, node.model_checksum));
        return;
    };
    let own = RobotFolder::load(folder).map_err(Failure::from).and_then(|robot| {
        let own = own_model(&robot, &node.model);
        own.map(|own| checksum(&own)).transpose()
    });
    match own {
        Ok(Some(own)) if own == node.model_checksum => {
            doctor.good(format!("robot model {}, the same as in {}", node.model, folder.display()));
        }
        Ok(None) => doctor.bad(
            1,
            format!("the board has the model of another robot, {}, than {}", node.model, folder.display()),
            format!("tesaki model push {}", folder.display()),
        ),
        Ok(Some(_)) => doctor.warning(
            format!("the board's model {} differs from the one in {}", node.model, folder.display()),
            "it does after --calibration and `tesaki set`; if the folder has changed since, push it again as before",
        ),
        // The board can be checked all the same.
        Err(failure) => doctor.bad(failure.number(), failure.to_string(), ""),
    }
}

/// Returns the telemetry of the control loop, if it runs.
fn check_control(
    board: &mut LinkBoard<BoardLink>,
    doctor: &mut Doctor,
) -> Result<Option<Telemetry>, Failure> {
    board.set_rate(Stream::Telemetry, 10)?;
    let deadline = Instant::now() + Duration::from_millis(500);
    while let Some(event) = board.next_event(deadline)? {
        if let FromBoard::Telemetry(telemetry) = event {
            doctor.good("sensor readings arrive and the control loop runs");
            return Ok(Some(telemetry));
        }
    }
    doctor.bad(
        6,
        "the control loop does not run: no sensor readings",
        "a bare board has no sensor drivers; with the plant link, is the simulator running?",
    );
    Ok(None)
}

/// Checks that the joints, as far as they are `homed`, stand within their limits.
fn check_angles(telemetry: &Telemetry, homed: u16, model: &RobotModel, doctor: &mut Doctor) {
    for (index, (joint, state)) in model.joints.iter().zip(&telemetry.joints).enumerate() {
        // Slightly outside, as at a stop, is no fault.
        let found = outside(joint, state.position, joint.limits.following_error);
        if let Some(text) = found.filter(|_| homed >> index & 1 != 0) {
            doctor.bad(
                1,
                format!("{text}: it cannot be enabled there"),
                "turn it by hand, or home it if this is not its angle; or check limits.lower and limits.upper",
            );
        }
    }
}

fn check_supply(supply: f32, safety: &Safety, doctor: &mut Doctor) {
    if supply < safety.supply_min || supply > safety.supply_max {
        doctor.bad(
            1,
            format!("supply {supply:.1} V, outside {} to {} V", safety.supply_min, safety.supply_max),
            "check the power supply, or safety.supply_min and safety.supply_max in controller.toml",
        );
    } else {
        doctor.good(format!("supply {supply:.1} V"));
    }
}

fn check_homing(homed: u16, model: &RobotModel, doctor: &mut Doctor) {
    let missing: Vec<&str> = (0..)
        .zip(&model.joints)
        .filter(|(index, _)| homed >> index & 1 == 0)
        .map(|(_, joint)| joint.name.as_str())
        .collect();
    if missing.is_empty() {
        doctor.good("all joints are homed");
    } else {
        doctor.bad(
            1,
            format!("not homed: {}", missing.join(", ")),
            "move the joints to known angles, then `tesaki home JOINT=ANGLE …`, every joint",
        );
    }
}

/// A board without a unique number is emulated.
fn is_emulated(number: &[u8]) -> bool {
    number.iter().all(|&byte| byte == 0)
}
