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
fn recorders_do_not_disturb_each_other() {
    let server = Server::ready();
    let path = |name: &str| server.folder.path().join(name).to_str().unwrap().to_owned();
    let names = ["one", "two", "short"].map(path);
    // All at once: they read model and state at the same time.
    let long = [&names[0], &names[1]].map(|name| server.start_command(&["record", name]));
    server.succeeds(&["record", &names[2], "--duration", "0.5"]);
    server.succeeds(&["move", "finger1_swing=0.2"]);
    for mut recorder in long {
        signal(&recorder, nix::sys::signal::Signal::SIGINT);
        assert!(recorder.wait().unwrap().success());
    }
    for name in &names {
        let log = format!("{name}.log");
        // The end of one has not stopped the log of the others.
        assert_eq!(server.json(&["replay", &log])["gaps"], 0, "{name}");
        let records = decode(&std::fs::read(&log).unwrap());
        let enabled = |record: &&LogRecord| matches!(record, LogRecord::Actuators(frame) if frame.enabled);
        let moved = records.iter().filter(enabled).count() > 50;
        assert_eq!(moved, *name != names[2], "{name}");
    }
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
