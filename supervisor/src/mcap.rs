//! Recordings as MCAP files in the ROS 2 profile, which Foxglove, PlotJuggler, Rerun and rosbag tools open.
//!
//! Messages are CDR, little endian; schemas are the texts of the ROS 2 message definitions.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use byteorder::LittleEndian;
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, WriteOptions, Writer};
use serde::Serialize;

/// A chunk is written once it has so many bytes: about a second of a hand at 100 Hz, which is what a crash may cost.
const CHUNK: u64 = 64 * 1024;

/// Why a recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// Its format.
    #[error(transparent)]
    Mcap(#[from] McapError),
    /// A message.
    #[error("a message cannot be encoded: {0}")]
    Message(String),
}

/// A point in time as ROS writes it.
#[derive(Clone, Copy, Debug, Serialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    /// Of nanoseconds since 1970.
    fn new(nanoseconds: u64) -> Self {
        let sec = i32::try_from(nanoseconds / 1_000_000_000).unwrap_or(i32::MAX);
        let nanosec = u32::try_from(nanoseconds % 1_000_000_000).unwrap_or(0);
        Self { sec, nanosec }
    }
}

#[derive(Serialize)]
struct Header<'a> {
    stamp: Time,
    frame_id: &'a str,
}

/// What `sensor_msgs/msg/JointState` holds: a name, an angle [rad], a velocity [rad/s] and a torque [N·m] for each joint.
#[derive(Clone, Copy, Debug)]
pub struct Joints<'a> {
    /// Names.
    pub names: &'a [String],
    /// Angles [rad].
    pub position: &'a [f64],
    /// Velocities [rad/s]; may be empty.
    pub velocity: &'a [f64],
    /// Torques [N·m]; may be empty.
    pub effort: &'a [f64],
}

#[derive(Serialize)]
struct JointState<'a> {
    header: Header<'a>,
    name: &'a [String],
    position: &'a [f64],
    velocity: &'a [f64],
    effort: &'a [f64],
}

#[derive(Serialize)]
struct Text<'a> {
    data: &'a str,
}

#[derive(Serialize)]
struct Log<'a> {
    stamp: Time,
    level: u8,
    name: &'a str,
    msg: &'a str,
    file: &'a str,
    function: &'a str,
    line: u32,
}

/// How serious an entry of the log is, by the numbers of `rcl_interfaces/msg/Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// 20
    Info = 20,
    /// 30
    Warning = 30,
    /// 40
    Error = 40,
}

/// A recording on its way into a file. Dropped without [`finish`](Self::finish), it ends without an index, which
/// readers can do without.
pub struct Recording {
    writer: Writer<BufWriter<File>>,
    channels: BTreeMap<&'static str, (u16, u32)>,
}

impl Recording {
    /// Begins a file. With `urdf`, viewers can draw the robot.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn create(
        path: &Path,
        urdf: Option<&str>,
        about: &BTreeMap<String, String>,
    ) -> Result<Self, RecordingError> {
        let file = BufWriter::new(File::create(path)?);
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("tesaki ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK));
        let mut recording = Self { writer: options.create(file)?, channels: BTreeMap::new() };
        recording.writer.write_metadata(&Metadata { name: "tesaki".to_owned(), metadata: about.clone() })?;
        if let Some(urdf) = urdf {
            recording.write(
                "/robot_description",
                "std_msgs/msg/String",
                STRING,
                LATCHED,
                0,
                &Text { data: urdf },
            )?;
        }
        Ok(recording)
    }

    /// The joints as measured, on `/joint_states`; `time` in ns since 1970.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn joint_states(&mut self, time: u64, joints: Joints<'_>) -> Result<(), RecordingError> {
        self.joints("/joint_states", time, joints)
    }

    /// The joints as they should be, on `/tesaki/reference`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn references(&mut self, time: u64, joints: Joints<'_>) -> Result<(), RecordingError> {
        self.joints("/tesaki/reference", time, joints)
    }

    /// Something worth a line, on `/rosout`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn log(&mut self, time: u64, level: Level, name: &str, text: &str) -> Result<(), RecordingError> {
        let (stamp, level) = (Time::new(time), level as u8);
        let message = Log { stamp, level, name, msg: text, file: "", function: "", line: 0 };
        self.write("/rosout", "rcl_interfaces/msg/Log", LOG, VOLATILE, time, &message)
    }

    /// Writes the index and closes the file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.writer.finish()?;
        self.writer.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
        Ok(())
    }

    fn joints(&mut self, topic: &'static str, time: u64, joints: Joints<'_>) -> Result<(), RecordingError> {
        let Joints { names: name, position, velocity, effort } = joints;
        let header = Header { stamp: Time::new(time), frame_id: "" };
        let message = JointState { header, name, position, velocity, effort };
        self.write(topic, "sensor_msgs/msg/JointState", JOINT_STATE, VOLATILE, time, &message)
    }

    fn write<T: Serialize>(
        &mut self,
        topic: &'static str,
        kind: &str,
        schema: &str,
        qos: &str,
        time: u64,
        message: &T,
    ) -> Result<(), RecordingError> {
        let (channel_id, sequence) = match self.channels.get_mut(topic) {
            Some((channel, sequence)) => {
                *sequence += 1;
                (*channel, *sequence)
            }
            None => {
                let schema = self.writer.add_schema(kind, "ros2msg", schema.as_bytes())?;
                let metadata = [("offered_qos_profiles".to_owned(), qos.to_owned())].into();
                let channel = self.writer.add_channel(schema, topic, "cdr", &metadata)?;
                self.channels.insert(topic, (channel, 0));
                (channel, 0)
            }
        };
        // The encapsulation header: CDR, little endian. Alignment counts from behind it.
        let mut data = vec![0, 1, 0, 0];
        cdr_encoding::to_writer::<_, LittleEndian, _>(&mut data, message)
            .map_err(|error| RecordingError::Message(error.to_string()))?;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        Ok(self.writer.write_to_known_channel(&header, &data)?)
    }
}

const VOLATILE: &str = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false";
const LATCHED: &str = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false";
const STRING: &str = "string data\n";
const JOINT_STATE: &str = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n================================================================================\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n================================================================================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
const LOG: &str = "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\nbuiltin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n================================================================================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
