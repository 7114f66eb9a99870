//! The firmware image in QEMU. `cargo xtask test` builds the images and runs these tests; plain `cargo test`
//! skips them, because they need a compiler for the microcontroller and QEMU.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use rayon::iter::{IntoParallelIterator, ParallelIterator};
use tesaki::control::ServoMode;
use tesaki::fault::FaultCause;
use tesaki::model::MAX_JOINTS;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{
    FromBoard, Identity, LogRecord, Request, RequestFrame, ResetCause, SensorFrame, Status,
};
use tesaki::task::TaskConfig;
use tesaki_sim::controller::{Controller, Watched};
use tesaki_sim::law::LawFile;
use tesaki_sim::qemu::{Machine, Qemu};
use tesaki_sim::scenario::{Outcome, SCENARIOS, Scenario, Setting, encode_record};
use tesaki_supervisor::fault_injector::{Damage, LinkFaults};
use tesaki_supervisor::{Board, ByteLink};
use tesaki_tests::{robot, robot_folder};

/// Maximum number of instructions of a tick with an object in the hand, and of one with an arm under
/// impedance control.
const GRASP_TICK: u32 = 42_000;
const ARM_TICK: u32 = 23_000;
/// The same for the tick in which a contact that is estimated begins, with the mass matrix and its factors:
/// that of arm7-wall has 25 440 instructions.
const ESTIMATING_ARM_TICK: u32 = 27_000;
/// The same with coupled matrices, which are discretised by a power series; and of arm7-contact, whose
/// longest tick had 30 958 instructions.
const COUPLED_ARM_TICK: u32 = 31_000;
/// Maximum number of instructions of a tick of telexistence: a tenth of the control period at 168 MHz.
const TELEXISTENCE_TICK: u32 = 130_000;

/// A file or folder that `cargo xtask test` names.
fn given(variable: &str) -> PathBuf {
    std::env::var_os(variable)
        .unwrap_or_else(|| panic!("{variable} is not set: run `cargo xtask test`"))
        .into()
}

fn run(scenario: &Scenario, controller: &mut Watched<'_>, seed: u64) -> Outcome {
    let robot = robot_folder(scenario.robot);
    let laws = LawFile::find(scenario, &robot, &[]).unwrap();
    let plain = Setting::plain(&robot, controller, seed, scenario.duration);
    scenario.run(&mut Setting { laws: &laws, ..plain }).unwrap()
}

/// Returns the child processes of another process, from `/proc`.
#[cfg(target_os = "linux")]
fn children(parent: u32) -> Vec<u32> {
    let numbers = std::fs::read_dir("/proc").unwrap().flatten();
    let numbers = numbers.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let is_child = |number: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{number}/stat")).unwrap_or_default();
        // After the name, which is in parentheses, follow the state and the parent.
        let parents = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(1));
        parents.is_some_and(|number| *number == parent.to_string())
    };
    numbers.filter(is_child).collect()
}

#[cfg(target_os = "linux")]
#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn a_signal_ends_a_run_with_its_emulated_board() {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;
    let temporary = tempfile::tempdir().unwrap();
    let (out, folders) = (temporary.path().join("out"), temporary.path().join("tmp"));
    std::fs::create_dir(&folders).unwrap();
    let mut run = tesaki_tests::program("host-sim");
    run.args(["run", "hand3-servo", "--controller", "qemu", "--out"]).arg(&out).arg("--elf");
    run.arg(given("TESAKI_ELF")).env("TMPDIR", &folders).stderr(std::process::Stdio::piped());
    let run = run.spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(60);
    let qemu = loop {
        if let [qemu] = *children(run.id()) {
            break qemu;
        }
        assert!(Instant::now() < deadline, "QEMU was not started");
        std::thread::sleep(Duration::from_millis(10));
    };
    kill(Pid::from_raw(run.id().try_into().unwrap()), Signal::SIGINT).unwrap();
    let ended = run.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert_eq!((ended.status.code(), errors.trim()), (Some(2), "host-sim: interrupted"));
    assert!(!Path::new(&format!("/proc/{qemu}")).exists(), "QEMU goes on");
    assert_eq!(std::fs::read_dir(&folders).unwrap().count(), 0, "its folder is left");
}

/// Scenarios without a board, and one that repeats the runs of two others on other machines.
const NOT_REPLAYED: [&str; 3] = ["hand5-calibrate", "knob-find", "hand3-paper-curves"];

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn the_image_answers_every_tick_of_a_run_with_the_bytes_of_the_native_core() {
    // `cargo xtask firmware` does so with an arm. The others are tested by replaying recordings, which is as
    // strict and much faster.
    let scenario = Scenario::find("hand3-reach").unwrap();
    let mut qemu = Qemu::boot(&given("TESAKI_ELF"), &Machine::default()).unwrap();
    let mut watched = Watched::new(&mut qemu, true);
    let outcome = run(scenario, &mut watched, 1);
    assert_eq!(watched.identical(), Some(true), "{:?}", watched.difference);
    assert_eq!(watched.alike, outcome.summary.ticks);
    assert!(outcome.summary.pass());
}

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn recordings_of_other_seeds_replay_on_the_emulated_board_bit_for_bit() {
    let replayed: Vec<_> =
        SCENARIOS.iter().filter(|scenario| !NOT_REPLAYED.contains(&scenario.name)).collect();
    replayed.into_par_iter().for_each(replays);
}

/// Replays the recording of a scenario on the native core, which `cargo xtask test` has compared with its
/// recorded sweep, and a corrupted copy of it.
fn replays(scenario: &Scenario) {
    let log = given("TESAKI_RECORDINGS").join(format!("{}.log", scenario.name));
    let limit = match scenario.robot {
        "hand5" => TELEXISTENCE_TICK,
        "arm7" if ["arm7-contact", "arm7-paper-matrices"].contains(&scenario.name) => COUPLED_ARM_TICK,
        "arm7" if scenario.name == "arm7-wall" => ESTIMATING_ARM_TICK,
        "arm7" => ARM_TICK,
        _ => GRASP_TICK,
    };
    let bytes = std::fs::read(&log).unwrap_or_else(|error| panic!("{}: {error}", log.display()));
    let ticks = records(&bytes).iter().filter(|record| matches!(record, LogRecord::Actuators(_))).count();
    let (same, said) = replay(&log);
    let (counted, longest) = said.split_once(", the longest ").unwrap_or((&said, ""));
    assert!(same && counted == format!("replay: {ticks} ticks identical"), "{said}");
    let longest: u32 = longest.trim_end_matches(" instructions\n").parse().unwrap();
    assert!(longest <= limit, "{}: a tick of {longest} instructions", scenario.name);
    println!("{}: {ticks} ticks, the longest {longest} instructions", scenario.name);
    // One flipped bit in a torque must be found, to show that the test can fail.
    let spoiled = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&spoiled, spoilt(&bytes)).unwrap();
    let (same, said) = replay(spoiled.path());
    assert!(!same && said.contains("torque of joint "), "{said}");
}

fn records(bytes: &[u8]) -> Vec<LogRecord> {
    let mut decoder = Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).map(Result::unwrap).collect()
}

/// Returns the recording with a valid checksum, but with the last bit of one torque flipped in its first
/// second.
fn spoilt(bytes: &[u8]) -> Vec<u8> {
    let mut records = records(bytes);
    let mut torques = records.iter_mut().filter_map(|record| match record {
        LogRecord::Actuators(frame) => Some(&mut frame.torques),
        _ => None,
    });
    let torque = torques.nth(99).unwrap().last_mut().unwrap();
    *torque = f32::from_bits(torque.to_bits() ^ 1);
    encode_record(&records).unwrap()
}

fn replay(log: &Path) -> (bool, String) {
    let output = Command::new("qemu-system-arm")
        .args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "null"])
        .args(["-icount", "shift=0,sleep=off", "-semihosting-config"])
        .arg(format!("enable=on,target=native,arg={}", log.display()))
        .arg("-kernel")
        .arg(given("TESAKI_REPLAY_ELF"))
        .output()
        .unwrap();
    (output.status.success(), String::from_utf8(output.stdout).unwrap())
}

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn faults_are_named_by_the_image_and_still_there_after_a_reset() {
    let model = robot("hand3").model;
    let mut board = Qemu::boot(&given("TESAKI_ELF"), &Machine::default()).unwrap();
    board.take_command(false).unwrap();
    board.push_model(&model).unwrap();
    let mut sensors = SensorFrame {
        sequence: 1,
        supply: 24_000,
        encoders: std::iter::repeat_n(5, 9).collect(),
        currents: std::iter::repeat_n(0, 9).collect(),
        forces: [[0; 6]; 3].into_iter().collect(),
        ..SensorFrame::default()
    };
    board.tick(&sensors).unwrap();
    board.home(&[0.2; 9]).unwrap();
    let too_many = vec![0.0; MAX_JOINTS + 1];
    assert!(board.home(&too_many).unwrap_err().to_string().contains("17 joints"));
    board.enable(TaskConfig::JointServo(ServoMode::Observer)).unwrap();
    let refused = board.set_goal(&[0.2, 0.2, 9.0, 0.2, 0.2, 0.2, 0.2, 0.2, 0.2]).unwrap_err();
    assert!(refused.to_string().contains("joint 2: 9 rad is outside its limits"), "{refused}");
    sensors.sequence += 1;
    assert!(board.tick(&sensors).unwrap().enabled);
    sensors.sequence += 1;
    sensors.encoders[4] += 5000;
    assert!(!board.tick(&sensors).unwrap().enabled);

    let named = |board: &mut Qemu| {
        let log = board.faults().unwrap();
        let fault = *log.faults.iter().find(|fault| fault.cause == FaultCause::EncoderJump).unwrap();
        assert_eq!((fault.joint, fault.tick), (Some(4), 3));
        // 5000 of 65 536 counts per turn are 0.479 37 rad; the limit is twice 6 rad/s · 10 ms plus two
        // counts.
        assert!((fault.value - 0.479_37).abs() < 1e-5 && (fault.limit - 0.120_19).abs() < 1e-5, "{fault}");
        log.total
    };
    let total = named(&mut board);
    board.reset().unwrap();
    assert_eq!(named(&mut board), total);
    let Status { node, board: status } = board.status().unwrap();
    assert_eq!((node.model.as_str(), status.reset), ("", ResetCause::PowerOn));
    assert_eq!(status.identity.capabilities, Identity::PLANT_LINK | Identity::TASKS);
    assert_ne!(status.identity.image, [0; 8], "the image knows its build id");
    board.take_command(false).unwrap();
    let refused = board.enable(TaskConfig::JointServo(ServoMode::Pid)).unwrap_err();
    assert!(refused.to_string().contains("no robot model"), "{refused}");
    // The log can only be cleared after it has been read.
    assert!(board.ask("clear", Request::ClearFaults { total: total + 1 }).is_err());
    board.ask("clear", Request::ClearFaults { total }).unwrap();
}

/// The line to the image under heavy damage: no damaged frame is answered, and the link recovers at once.
/// `TESAKI_DAMAGED_FRAMES` makes the test longer.
#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn the_image_acts_on_no_damaged_frame() {
    let damaged: u64 = std::env::var("TESAKI_DAMAGED_FRAMES").map_or(20_000, |count| count.parse().unwrap());
    let mut qemu = Qemu::boot(&given("TESAKI_ELF"), &Machine::default()).unwrap();
    // Commands have no effect here, because this client has not taken command.
    let before = qemu.status().unwrap();
    let faults: LinkFaults = "seed=4,flip=3e-2,drop=3e-2,splice=1e-1,duplicate=1e-1".parse().unwrap();
    let mut damage = Damage::new(&faults, 0);
    let mut pc = Decoder::new();
    let (mut sent, mut intact, mut sequence) = (0, 0, 0_u16);
    while sent - intact < damaged {
        let mut wire = Vec::new();
        let mut burst = HashSet::new();
        let mut frame = |request| {
            sequence = sequence.wrapping_add(1);
            burst.insert(sequence);
            let mut bytes = [0; MAX_FRAME];
            let length = encode(&RequestFrame { client: 99, sequence, request }, &mut bytes).unwrap();
            (sequence, bytes[..length].to_vec())
        };
        for index in 0..60 {
            // Short ones, because the emulated UART is slow.
            let request = if index % 2 == 0 { Request::Disable } else { Request::ReadExport { offset: 7 } };
            damage.pass(&frame(request).1, &mut wire);
            sent += 1;
        }
        let good = [frame(Request::Disable), frame(Request::Disable)];
        good.iter().for_each(|(_, bytes)| wire.extend(bytes));
        let mut answered = HashSet::new();
        let deadline = Instant::now() + Duration::from_secs(30);
        // The emulated UART has no baud rate and would continue while the board computes: never send more
        // than its queue holds.
        assert!(wire.len() < 1000);
        qemu.link_mut().send(&wire).unwrap();
        while !answered.contains(&good[1].0) {
            assert!(Instant::now() < deadline, "the second good frame was lost: {:?}", qemu.status());
            let mut buffer = [0; 4096];
            let length = qemu.link_mut().receive(&mut buffer, deadline).unwrap();
            let mut bytes = &buffer[..length];
            while pc.take(&mut bytes) {
                let message = pc.message().expect("the way back is not damaged");
                let FromBoard::Reply(reply) = message else { panic!("{message:?}") };
                assert!(
                    reply.client == 99 && burst.contains(&reply.sequence),
                    "an answer to nothing: {reply:?}"
                );
                answered.insert(reply.sequence);
            }
        }
        intact += answered.len() as u64 - u64::from(answered.contains(&good[0].0)) - 1;
    }
    let after = qemu.status().unwrap();
    assert_eq!(after.node, before.node);
    let link = after.board.supervisor_link;
    let found = [link.frames.framing, link.frames.checksum].map(u64::from);
    assert!(found[0] > damaged / 4 && found[1] > damaged / 8, "{link:?}");
    assert_eq!((link.receive_errors, after.board.reset), (0, before.board.reset));
    println!("{sent} sent, {intact} intact: {link:?}");
}
