//! Recordings, read back.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{collections::BTreeMap, path::Path};

use mcap::{Message, MessageStream, Summary, read::Options};
use tesaki_recording::{
    Diagnostic, Health, Live, LogLevel, Marker, MarkerShape, McapError, Publisher, Recording, Sink, Transform,
};

/// Two messages in hexadecimal digits, from `tests/oracles/mcap_joint_state.py` (rosbags).
const JOINT_STATES: &[&str] = include!("../../tests/oracles/data/mcap_joint_state.in");
/// One message of each of four further types, from `tests/oracles/mcap_messages.py` (rosbags).
const MESSAGES: &[&str] = include!("../../tests/oracles/data/mcap_messages.in");
const START: u64 = 1_700_000_000_123_456_789;
const SECOND: u64 = 1_000_000_000;
const URDF: &str = "<robot name=\"手先\"/>";

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn metadata() -> BTreeMap<String, String> {
    BTreeMap::from([("robot".to_owned(), "hand3".to_owned()), ("操作者".to_owned(), String::new())])
}

/// Writes the messages of [`MESSAGES`].
fn write_further<S: Sink>(publisher: &mut Publisher<S>) {
    publisher.wrench(START, "finger1_tip", [1.0, -2.0, 0.5], [0.0, 0.25, -1e-3]).unwrap();
    let pose = ([0.1, 0.2, -0.3], [0.0, 0.6, 0.0, 0.8]);
    publisher.pose(START, "task/frame", "base", pose).unwrap();
    let entry = |health, name: &str, message: &str, values: &[(&str, &str)]| Diagnostic {
        health,
        name: name.to_owned(),
        message: message.to_owned(),
        values: values.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect(),
    };
    let entries = [
        entry(Health::Ok, "tesaki: board", "disabled", &[("supply [V]", "24.00"), ("節", "")]),
        entry(Health::Error, "tesaki: grasping", "", &[]),
    ];
    publisher.diagnostics(START, "hand3", &entries).unwrap();
    let marker =
        |id, frame: &str, pose, shape, colour| Marker { id, frame: frame.to_owned(), pose, shape, colour };
    let still = ([0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, -2.0]];
    let markers = [
        marker(1, "object", pose, MarkerShape::Box([0.06, 0.05, 0.1]), [1.0, 0.5, 0.25, 1.0]),
        marker(2, "base", pose, MarkerShape::Cylinder([0.03, 0.1]), [0.0, 0.0, 0.0, 0.5]),
        marker(3, "b", still, MarkerShape::Triangles(corners), [1.0; 4]),
    ];
    publisher.objects(START, &markers).unwrap();
}

#[test]
fn who_looks_on_gets_each_message_and_who_comes_late_the_last() {
    let mut publisher = Publisher::new(Live::default(), Some(URDF));
    write_further(&mut publisher);
    let messages = publisher.sink_mut().take();
    assert!(publisher.sink_mut().take().is_empty());
    let topics = publisher.sink().topics();
    let names: Vec<&str> =
        messages.iter().map(|message| topics[usize::from(message.topic)].name.as_str()).collect();
    let further = ["/tesaki/wrench/finger1_tip", "/tesaki/task/frame", "/diagnostics", "/tesaki/objects"];
    assert_eq!(names, [&["/robot_description"], &further[..]].concat());
    for (message, expected) in messages[1..].iter().zip(MESSAGES) {
        assert_eq!((message.time, hexadecimal(&message.data)), (START, (*expected).to_owned()));
    }
    // The description and the objects; an earlier pose is not kept.
    let kept: Vec<u16> = (0..5).filter(|&topic| publisher.sink().kept(topic).is_some()).collect();
    assert_eq!(kept, [0, 4]);
    publisher.objects(START + 1, &[]).unwrap();
    assert_eq!(publisher.sink().kept(4).unwrap().time, START + 1);
}

#[test]
fn a_topic_has_the_name_of_a_tip_as_far_as_ros_allows() {
    let mut publisher = Publisher::new(Live::default(), None);
    let tips = [
        ("finger-1.tip", "finger_x2d1_x2etip"),
        ("finger_1_tip", "finger_1_tip"),
        ("2nd", "x32nd"),
        ("_hidden", "x5fhidden"),
        ("é1", "xc3_xa91"),
    ];
    for (tip, _) in tips {
        publisher.wrench(START, tip, [0.0; 3], [0.0; 3]).unwrap();
    }
    let names: Vec<&str> = publisher.sink().topics().iter().map(|topic| topic.name.as_str()).collect();
    assert_eq!(names, tips.map(|(_, topic)| format!("/tesaki/wrench/{topic}")));
    let message = &publisher.sink_mut().take()[0];
    assert!(message.data.windows(12).any(|part| part == b"finger-1.tip"));
}

/// Writes all topics, with three seconds of joint states.
fn write(path: &Path) {
    let mut recording = Recording::create(path, Some(URDF)).unwrap();
    recording.metadata("tesaki", metadata()).unwrap();
    let three = names(&["swing", "", "親指"]);
    recording.joint_states(START, &three, &[0.1, -2.5, 3e-300], &[], &[1.0, -0.0, 1e9]).unwrap();
    recording.references(START, &three, &[0.5, 1.5, 2.5], &[0.0; 3], &[f64::NAN, 0.0, 0.25]).unwrap();
    recording.log(START + 1, LogLevel::Warn, "tesaki", "節 3: 42 °C").unwrap();
    recording.log(START + 2, LogLevel::Fatal, "", "").unwrap();
    let frame = |parent: &str, child: &str, x| Transform {
        parent: parent.to_owned(),
        child: child.to_owned(),
        translation: [x, -0.5, 0.25],
        rotation_xyzw: [0.0, 0.6, 0.0, 0.8],
    };
    recording.tf(START, &[frame("palm", "f1", 1.0), frame("f1", "指先", 2.0)]).unwrap();
    recording.tf(START + 3, &[]).unwrap();
    recording.tf_static(START, &[frame("palm", "camera", 3.0)]).unwrap();
    write_further(&mut recording);
    for step in 1..=30_u32 {
        let angle = 0.125 * f64::from(step);
        let time = START + u64::from(step) * SECOND / 10;
        recording.joint_states(time, &three, &[angle; 3], &[angle; 3], &[]).unwrap();
    }
    let time = 1_700_000_001_000_000_001;
    recording.joint_states(time, &names(&["thumb_curl"]), &[0.25], &[-1.5], &[]).unwrap();
    recording.finish().unwrap();
}

fn of_topic<'a>(messages: &'a [Message<'a>], topic: &str) -> Vec<&'a Message<'a>> {
    messages.iter().filter(|message| message.channel.topic == topic).collect()
}

#[test]
fn what_was_written_is_read_back() {
    // The file is kept for another reader: tests/oracles/read_mcap.py.
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("all.mcap");
    write(&path);
    let file = std::fs::read(&path).unwrap();

    let messages: Vec<Message> = MessageStream::new(&file).unwrap().map(Result::unwrap).collect();
    let topics = [
        ("/robot_description", "std_msgs/msg/String", 1, "durability: 1"),
        ("/joint_states", "sensor_msgs/msg/JointState", 32, "durability: 2"),
        ("/tesaki/reference", "sensor_msgs/msg/JointState", 1, "durability: 2"),
        ("/rosout", "rcl_interfaces/msg/Log", 2, "durability: 1"),
        ("/tf", "tf2_msgs/msg/TFMessage", 2, "durability: 2"),
        ("/tf_static", "tf2_msgs/msg/TFMessage", 1, "durability: 1"),
        ("/tesaki/wrench/finger1_tip", "geometry_msgs/msg/WrenchStamped", 1, "durability: 2"),
        ("/tesaki/task/frame", "geometry_msgs/msg/PoseStamped", 1, "durability: 2"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 1, "durability: 2"),
        ("/tesaki/objects", "visualization_msgs/msg/MarkerArray", 1, "durability: 1"),
    ];
    for (topic, kind, count, durability) in topics {
        let messages = of_topic(&messages, topic);
        assert_eq!(messages.len(), count, "{topic}");
        assert!(messages.iter().zip(0..).all(|(message, sequence)| message.sequence == sequence), "{topic}");
        let channel = &messages[0].channel;
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!((channel.message_encoding.as_str(), schema.encoding.as_str()), ("cdr", "ros2msg"));
        assert_eq!(schema.name, kind);
        assert!(channel.metadata["offered_qos_profiles"].contains(durability), "{topic}");
        assert!(channel.metadata["topic_type_hash"].starts_with("RIHS01_"), "{topic}");
    }
    let schema = messages.iter().find_map(|m| m.channel.schema.clone().filter(|s| s.name.contains("Joint")));
    let separator = "=".repeat(80);
    assert_eq!(
        std::str::from_utf8(&schema.unwrap().data).unwrap(),
        format!(
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n\
             \n{separator}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
             \n{separator}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        )
    );

    // The description is the first message, at the time of the next.
    assert_eq!((messages[0].channel.topic.as_str(), messages[0].log_time), ("/robot_description", START));
    let text = [&[0, 1, 0, 0, 23, 0, 0, 0], URDF.as_bytes(), &[0]].concat();
    assert_eq!(messages[0].data.as_ref(), text);

    let joint_states = of_topic(&messages, "/joint_states");
    for (message, expected) in [joint_states[0], joint_states[31]].iter().zip(JOINT_STATES) {
        assert_eq!(hexadecimal(&message.data), **expected);
    }

    let summary = Summary::read(&file).unwrap().unwrap();
    // One at the beginning, three for the seconds, one for the step back in time.
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.chunk_count), (43, 5));
    assert_eq!(summary.chunk_indexes.len(), 5);
    let index = &summary.metadata_indexes[0];
    assert_eq!((index.name.as_str(), summary.metadata_indexes.len()), ("tesaki", 1));
    assert_eq!(mcap::read::metadata(&file, index).unwrap().metadata, metadata());
}

#[test]
fn a_second_at_most_is_lost_without_an_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let mut recording = Recording::create(&path, Some(URDF)).unwrap();
    let joint = names(&["a"]);
    for step in 0..=25 {
        recording.joint_states(START + step * SECOND / 10, &joint, &[0.0], &[], &[]).unwrap();
    }
    // The file is valid, but without index.
    let file = std::fs::read(&path).unwrap();
    assert!(Summary::read(&file).unwrap().is_none_or(|summary| summary.chunk_indexes.is_empty()));
    let messages: Vec<Message> = MessageStream::new(&file).unwrap().map(Result::unwrap).collect();
    assert_eq!(messages.last().unwrap().log_time, START + 2 * SECOND);
    assert_eq!(messages.len(), 22);
    // The writer was killed while it wrote the last chunk: what was flushed before is read.
    for cut in [51, 60, 200] {
        let file = &file[..file.len() - cut];
        assert!(Summary::read(file).is_err());
        let messages = MessageStream::new_with_options(file, Options::IgnoreEndMagic.into()).unwrap();
        let last = messages.map_while(Result::ok).last().unwrap();
        assert!(last.log_time >= START + SECOND, "{}", last.log_time);
    }

    // The clock is set back.
    recording.joint_states(START - 60 * SECOND, &joint, &[0.0], &[], &[]).unwrap();
    let longer = std::fs::read(&path).unwrap();
    assert!(longer.len() > file.len());
    drop(recording);
    let whole = std::fs::read(&path).unwrap();
    assert_eq!(MessageStream::new(&whole).unwrap().count(), 28);
    assert_eq!(Summary::read(&whole).unwrap().unwrap().chunk_indexes.len(), 4);
}

#[test]
fn a_recording_without_messages_has_its_description() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.mcap");
    Recording::create(&path, Some(URDF)).unwrap().finish().unwrap();
    let file = std::fs::read(&path).unwrap();
    assert_eq!(MessageStream::new(&file).unwrap().count(), 1);

    Recording::create(&path, None).unwrap().finish().unwrap();
    let file = std::fs::read(&path).unwrap();
    assert_eq!(MessageStream::new(&file).unwrap().count(), 0);
}

#[test]
fn errors_name_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none/a.mcap");
    let error = Recording::create(&path, None).err().unwrap().to_string();
    assert!(error.starts_with(&format!("cannot create the recording {}: ", path.display())), "{error}");

    let mut recording = Recording::create(folder.path().join("a.mcap"), None).unwrap();
    let error = recording.joint_states(START, &names(&["a", "b"]), &[0.0; 2], &[0.0; 3], &[]).unwrap_err();
    assert!(matches!(error, McapError::Lengths { .. }));
    assert_eq!(error.to_string(), "2 joint names, but 3 values of velocity");
}
