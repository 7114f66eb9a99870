//! Recordings and their interruptions.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

use mcap::{MessageStream, Summary};
use tesaki::protocol::LogRecord;

use super::server::{Server, finish, hand3, said, signal};

#[test]
fn a_recording_that_was_cut_at_any_byte_is_told() {
    let server = Server::ready();
    let log = server.folder.path().join("run.log");
    let replay = ["replay", log.to_str().unwrap()];
    let name = server.folder.path().join("run");
    server.succeeds(&["record", name.to_str().unwrap(), "--duration", "0.3"]);
    server.succeeds(&replay);
    let whole = std::fs::read(&log).unwrap();
    let mut records = decode(&whole);
    let Some(LogRecord::End { ticks }) = records.pop() else { panic!("no end record") };
    let outputs = records.iter().filter(|record| matches!(record, LogRecord::Actuators(_)));
    assert_eq!(outputs.count(), usize::try_from(ticks).unwrap());

    let told =
        ["the recording ends without its end record", "killed, or the file was cut", "ticks were read"];
    // Cut within the end record, between two records, and within another record, but after the first one.
    let end = whole.len() - encode(&[LogRecord::End { ticks }]).len();
    let starts_last = end - encode(&records[records.len() - 1..]).len();
    let first = encode(&records[..1]).len();
    for length in [whole.len() - 1, end + 1, end, end - 1, starts_last, end / 2, first + 1, first] {
        std::fs::write(&log, &whole[..length]).unwrap();
        server.fails(&replay, 1, &told);
    }
    std::fs::write(&log, &whole[..end]).unwrap();
    server.fails(&replay, 1, &[&format!("{ticks} ticks were read, {ticks} of them are identical")]);
    // An empty file, or one that ends within the first record.
    for length in [0, first - 1] {
        std::fs::write(&log, &whole[..length]).unwrap();
        server.fails(&replay, 1, &["no tick could be compared"]);
    }
    // A recording that ended before its first tick.
    std::fs::write(&log, encode(&[records[0].clone(), LogRecord::End { ticks: 0 }])).unwrap();
    server.fails(&replay, 1, &["no tick was recorded"]);
    // A pipe has no place to put a file.
    let pipe = server.folder.path().join("pipe.log");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let onto = ["record", pipe.to_str().unwrap().trim_end_matches(".log"), "--force", "--duration", "0.3"];
    server.fails(&onto, 2, &["pipe.log is no file"]);
    // Additional bytes after the end.
    std::fs::write(&log, [&whole[..], b"more"].concat()).unwrap();
    server.fails(&replay, 1, &told);
    records.push(LogRecord::End { ticks: ticks + 1 });
    std::fs::write(&log, encode(&records)).unwrap();
    server.fails(&replay, 1, &[&format!("counts {} ticks, but it has {ticks}", ticks + 1)]);
}

/// Returns the recording of a recorder that was killed after three seconds.
fn killed_recording(server: &Server) -> PathBuf {
    let name = server.folder.path().join("killed");
    let mcap = name.with_extension("mcap");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_secs(2));
    // Not while it is writing.
    let length = || std::fs::metadata(&mcap).unwrap().len();
    let before = length();
    while length() == before {
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(300));
    recorder.kill().unwrap();
    recorder.wait().unwrap();
    name
}

#[test]
fn a_recorder_that_is_killed_leaves_files_that_lack_a_second_at_most() {
    let server = Server::ready();
    let name = killed_recording(&server);
    let log = name.with_extension("log");
    server.fails(&["replay", log.to_str().unwrap()], 1, &["without its end record", "identical"]);
    let outputs = decode(&std::fs::read(&log).unwrap());
    let outputs = outputs.iter().filter(|record| matches!(record, LogRecord::Actuators(_)));
    let ticks = outputs.count();
    // More than two seconds were recorded, but a busy machine is late.
    assert!(ticks >= 100, "{ticks} ticks in the log");

    // An MCAP file without an index.
    let mcap = std::fs::read(name.with_extension("mcap")).unwrap();
    assert!(Summary::read(&mcap).unwrap().is_none_or(|summary| summary.chunk_indexes.is_empty()));
    let messages = MessageStream::new(&mcap).unwrap().map(Result::unwrap);
    let states = messages.filter(|message| message.channel.topic == "/joint_states").count();
    assert!(states >= 100, "{states} states in the MCAP file");
}

#[test]
#[ignore = "needs Python with rosbags: cargo xtask test"]
fn rosbags_reads_the_recording_of_a_killed_recorder() {
    let server = Server::ready();
    let name = killed_recording(&server);
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("oracles/read_mcap.py");
    let output = Command::new(python).arg(script).arg(name.with_extension("mcap")).output().unwrap();
    let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert!(output.status.success(), "{said}");
    let topics = said.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let states = topics.into_iter().find(|topic| topic["topic"] == "/joint_states").unwrap();
    assert!(states["count"].as_u64().unwrap() >= 100, "{said}");
}

/// Records one second of a moving joint, of a hand with tared sensors.
fn recording_of_a_move(server: &Server) -> PathBuf {
    server.succeeds(&["tare"]);
    let name = server.folder.path().join("moved");
    let folder = hand3();
    let recorder =
        server.start_command(&["record", name.to_str().unwrap(), "--robot", folder.to_str().unwrap()]);
    while !std::fs::metadata(name.with_extension("mcap")).is_ok_and(|file| file.len() > 0) {
        std::thread::sleep(Duration::from_millis(20));
    }
    server.succeeds(&["move", "finger1_swing=0.2"]);
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    let output = finish(recorder);
    assert!(output.status.success(), "{output:?}");
    name.with_extension("mcap")
}

#[test]
fn a_recording_has_frames_wrenches_phases_and_diagnostics() {
    let server = Server::ready();
    let file = std::fs::read(recording_of_a_move(&server)).unwrap();
    let messages: Vec<_> = MessageStream::new(&file).unwrap().map(Result::unwrap).collect();
    let count = |topic: &str| messages.iter().filter(|message| message.channel.topic == topic).count();
    for topic in ["/robot_description", "/tf_static"] {
        assert_eq!(count(topic), 1, "{topic}");
    }
    let ticks = count("/joint_states");
    assert!(ticks > 30, "{ticks} ticks");
    // A busy machine may lose the last messages.
    for finger in ["finger1_tip", "finger2_tip", "finger3_tip"] {
        assert!(count(&format!("/tesaki/wrench/{finger}")) + 3 > ticks, "{finger}");
    }
    assert_eq!(count("/tf"), ticks);
    assert!(count("/diagnostics") > 1);
    let says = |text: &str| {
        let holds =
            |message: &mcap::Message| message.data.windows(text.len()).any(|part| part == text.as_bytes());
        messages.iter().any(|message| message.channel.topic == "/rosout" && holds(message))
    };
    assert!(says("enabled: joint servo after disabled"));
    // The time stamps are those of the wall clock.
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    // Up to the delay of a busy machine before the first tick and here.
    let difference = now.as_nanos().abs_diff(u128::from(messages.last().unwrap().log_time));
    assert!(difference < 60_000_000_000, "{difference} ns");
    let summary = Summary::read(&file).unwrap().unwrap();
    assert!(summary.chunk_indexes.iter().all(|chunk| chunk.compression == "zstd"));
}

#[test]
#[ignore = "needs Python with rosbags: cargo xtask test"]
fn rosbags_finds_every_link_of_a_recording_where_the_urdf_has_it() {
    let server = Server::ready();
    let path = recording_of_a_move(&server);
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("oracles/read_mcap.py");
    let output = Command::new(python).arg(script).arg(path).arg("--frames").output().unwrap();
    let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert!(output.status.success() && said.contains("12 links"), "{said}");
    let topics: Vec<serde_json::Value> =
        said.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let topic = |name: &str| topics.iter().find(|topic| topic["topic"] == name).unwrap();
    let wrench = topic("/tesaki/wrench/finger2_tip");
    assert_eq!(wrench["type"], "geometry_msgs/msg/WrenchStamped");
    assert_eq!(wrench["first"]["message"]["header"]["frame_id"], "finger2_tip");
    let board = &topic("/diagnostics")["last"]["message"]["status"][0];
    assert_eq!((&board["name"], &board["hardware_id"]), (&"tesaki: board".into(), &"hand3".into()));
}

#[test]
fn a_recording_needs_a_name() {
    for name in ["/", "..", "recordings/"] {
        let output = tesaki_tests::tesaki().args(["record", name]).output().unwrap();
        let (code, text) = said(&output);
        assert!(
            code == 2 && text.contains("it is a folder: give the name of a recording, such as "),
            "{text}"
        );
    }
}

#[test]
fn a_recording_continues_after_a_reset_of_the_board() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let mut recorder = server.start_command(&["record", name.to_str().unwrap()]);
    std::thread::sleep(Duration::from_millis(500));
    server.make_trouble("reset");
    // Its streams are requested again after a second of silence.
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
    // The time stamps continue, although the board's ticks restarted.
    let mcap = std::fs::read(name.with_extension("mcap")).unwrap();
    let messages = MessageStream::new(&mcap).unwrap().map(Result::unwrap);
    let states: Vec<_> = messages.filter(|message| message.channel.topic == "/joint_states").collect();
    let times: Vec<u64> = states.iter().map(|message| message.log_time).collect();
    assert!(times.is_sorted(), "{times:?}");
    // Without a model a state has no joints.
    let name = b"finger1_swing";
    let last = &states.last().unwrap().data;
    assert!(last.windows(name.len()).any(|part| part == name), "no joints after the push of the model");
    let replayed = server.json(&["replay", log.to_str().unwrap()]);
    assert!(replayed["identical_ticks"].as_u64().unwrap() > 150, "{replayed}");
    assert_eq!(replayed["gaps"], 1, "{replayed}");
    assert_eq!(replayed["board_lost"], false, "{replayed}");
}

#[test]
fn recorders_do_not_disturb_each_other() {
    let server = Server::ready();
    let path = |name: &str| server.folder.path().join(name).to_str().unwrap().to_owned();
    let names = ["one", "two", "short"].map(path);
    // Concurrent recordings read model and state at the same time.
    let long = [&names[0], &names[1]].map(|name| server.start_command(&["record", name]));
    server.succeeds(&["record", &names[2], "--duration", "0.5"]);
    server.succeeds(&["move", "finger1_swing=0.2"]);
    for mut recorder in long {
        signal(&recorder, nix::sys::signal::Signal::SIGINT);
        assert!(recorder.wait().unwrap().success());
    }
    for name in &names {
        let log = format!("{name}.log");
        // The end of one has not stopped the logs of the others.
        assert_eq!(server.json(&["replay", &log])["gaps"], 0, "{name}");
        let records = decode(&std::fs::read(&log).unwrap());
        let enabled = |record: &&LogRecord| matches!(record, LogRecord::Actuators(frame) if frame.enabled);
        let moved = records.iter().filter(enabled).count() > 50;
        assert_eq!(moved, *name != names[2], "{name}");
    }
}

#[test]
fn a_recording_whose_board_was_lost_says_so() {
    let mut server = Server::ready();
    let name = server.folder.path().join("run");
    let mut command = server.command(&["--timeout", "1", "record", name.to_str().unwrap()]);
    let mut recorder = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut complaints = BufReader::new(recorder.stderr.take().unwrap()).lines();
    let mut complaint = || complaints.next().unwrap().unwrap();
    assert!(complaint().contains("Ctrl-C stops"));
    std::thread::sleep(Duration::from_millis(500));
    server.stop.store(true, Ordering::Relaxed);
    server.thread.take().unwrap().join().unwrap();
    let silence = complaint();
    assert!(
        silence.contains("no data from the board for 1 s") && silence.contains("silent for 30 s"),
        "{silence}"
    );
    signal(&recorder, nix::sys::signal::Signal::SIGINT);
    let (code, text) = said(&finish(recorder));
    assert!(
        code == 0 && text.contains("0 gaps") && text.contains("; the board was silent at the end"),
        "{text}"
    );
    let log = name.with_extension("log");
    let records = decode(&std::fs::read(&log).unwrap());
    // Older programs can read this, too.
    let [.., LogRecord::Gap { missing: 0 }, LogRecord::End { ticks }] = records[..] else {
        panic!("no gap before the end record")
    };
    let replay = |options: &[&str]| {
        let (code, text) = server.run(&[options, &["replay", log.to_str().unwrap()]].concat());
        assert_eq!(code, 0, "{text}");
        text
    };
    let text = replay(&[]);
    assert!(text.contains(&format!("{ticks} ticks identical")) && !text.contains("gap"), "{text}");
    assert!(text.contains("the board was silent when the recording ended, after tick "), "{text}");
    let value: serde_json::Value = serde_json::from_str(&replay(&["--json"])).unwrap();
    assert!(value["board_lost"] == true && value["gaps"] == 0, "{value}");
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

#[test]
fn a_recording_that_is_being_written_is_not_replaced() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let name = name.to_str().unwrap();
    let first = server.start_command(&["record", name]);
    let log = format!("{name}.log");
    while !std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
        std::thread::sleep(Duration::from_millis(20));
    }
    let again = ["record", name, "--force", "--duration", "0.2"];
    server.fails(&again, 2, &["run.log is being written by another `tesaki record`"]);
    signal(&first, nix::sys::signal::Signal::SIGINT);
    assert!(finish(first).status.success());
    server.succeeds(&["replay", &log]);
    server.succeeds(&again);
}

/// A file that may not grow is like a full disk.
#[test]
fn a_recording_that_the_disk_has_no_room_for_keeps_what_came_before() {
    let server = Server::ready();
    let name = server.folder.path().join("full");
    let script = r#"trap "" XFSZ; ulimit -f 200; exec "$0" record "$1" --duration 20"#;
    let program = tesaki_tests::tesaki().get_program().to_owned();
    let mut command = Command::new("sh");
    command.args(["-c", script]).arg(program).arg(&name).env("TESAKI_PORT", server.address.to_string());
    let output = command.output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("File too large") && told.contains("full."), "{told}");
    let mcap = std::fs::read(name.with_extension("mcap")).unwrap();
    let messages = MessageStream::new(&mcap).unwrap().map(Result::unwrap);
    assert!(messages.filter(|message| message.channel.topic == "/joint_states").count() > 20);
}

#[test]
fn a_name_that_is_no_text_is_shown_as_well_as_it_can_be() {
    use std::os::unix::ffi::OsStrExt as _;
    let server = Server::ready();
    let name = server.folder.path().join(std::ffi::OsStr::from_bytes(b"run\xff"));
    let mut command = server.command(&["--json", "record", "--duration", "0.2"]);
    let output = command.arg(&name).output().unwrap();
    let result: serde_json::Value =
        serde_json::from_slice(output.stdout.trim_ascii().split(|byte| *byte == b'\n').next_back().unwrap())
            .unwrap();
    assert!(
        output.status.success() && result["log"].as_str().unwrap().ends_with("run\u{fffd}.log"),
        "{result}"
    );
    assert!(name.with_extension("log").exists());
}

#[test]
fn a_recording_that_cannot_begin_replaces_none() {
    let server = Server::ready();
    let name = server.folder.path().join("run");
    let [log, mcap] = ["log", "mcap"].map(|extension| name.with_extension(extension));
    let record = ["record", name.to_str().unwrap(), "--force", "--duration", "0.2"];
    let names = || std::fs::read_dir(server.folder.path()).unwrap().count();
    std::fs::create_dir(&mcap).unwrap();
    let before = names();
    // Nothing that looks like a recording is left.
    server.fails(&record, 2, &["run.mcap is no file"]);
    assert_eq!(names(), before);
    std::fs::write(&log, "the old one").unwrap();
    server.fails(&record, 2, &["run.mcap is no file"]);
    assert_eq!(std::fs::read_to_string(&log).unwrap(), "the old one");
    assert_eq!(names(), before + 1);
    std::fs::remove_dir(&mcap).unwrap();
    server.succeeds(&record);
    server.succeeds(&["replay", log.to_str().unwrap()]);
}
