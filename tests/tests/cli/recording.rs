//! Recordings and their interruptions.

use std::time::Duration;

use tesaki::protocol::LogRecord;

use super::server::{Server, hand3, signal};

#[test]
fn a_recording_continues_after_a_reset_of_the_board() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(500));
    server.make_trouble("reset");
    // Its streams are asked for again after a second of silence.
    std::thread::sleep(Duration::from_millis(1700));
    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    server.home();
    server.succeeds(&["move", "finger1_swing=0.2"]);
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    assert!(recorder.wait().unwrap().success());
    let log = name.with_extension("log");
    let records = decode(&std::fs::read(&log).unwrap());
    let enabled =
        records.iter().filter(|record| matches!(record, LogRecord::Actuators(frame) if frame.enabled));
    let enabled = enabled.count();
    assert!(enabled > 50, "the move is missing: {enabled} enabled ticks");
    let replayed = server.json(&["replay", log.to_str().unwrap()]);
    assert!(replayed["identical_ticks"].as_u64().unwrap() > 150, "{replayed}");
    assert_eq!(replayed["gaps"], 1, "{replayed}");
}

#[test]
fn a_recorder_goes_on_when_another_one_ends() {
    let server = Server::ready();
    let name = server.folder.path().join("long");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    // Their exports must not overlap.
    std::thread::sleep(Duration::from_millis(500));
    let short = server.folder.path().join("short");
    server.succeeds(&["record", short.to_str().unwrap(), "--duration", "0.5"]);
    server.succeeds(&["replay", short.with_extension("log").to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(500));
    server.succeeds(&["move", "finger1_swing=0.2"]);
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    assert!(recorder.wait().unwrap().success());
    let log = name.with_extension("log");
    let records = decode(&std::fs::read(&log).unwrap());
    let enabled = |record: &&LogRecord| matches!(record, LogRecord::Actuators(frame) if frame.enabled);
    assert!(records.iter().filter(enabled).count() > 50, "the move is missing");
    // What was lost until the log was asked for again is known.
    assert_eq!(server.json(&["replay", log.to_str().unwrap()])["gaps"], 1);
}

pub fn decode(bytes: &[u8]) -> Vec<LogRecord> {
    let mut decoder = tesaki::protocol::codec::Decoder::new();
    bytes.iter().filter_map(|&byte| decoder.push(byte)).map(Result::unwrap).collect()
}

pub fn encode(records: &[LogRecord]) -> Vec<u8> {
    let mut frame = [0; tesaki::protocol::codec::MAX_FRAME];
    let mut bytes = Vec::new();
    for record in records {
        let length = tesaki::protocol::codec::encode(record, &mut frame).unwrap();
        bytes.extend_from_slice(&frame[..length]);
    }
    bytes
}
