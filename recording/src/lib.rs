//! Recordings in MCAP with ROS 2 messages, as Foxglove, PlotJuggler, Rerun and `ros2 bag` open them.

mod ended_file;
mod messages;

use std::{
    collections::BTreeMap,
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use ::mcap::{
    WriteOptions, Writer,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};
use byteorder::LittleEndian;
use serde::Serialize;

use ended_file::EndedFile;
use messages::Definition;

/// Recorded time after which data go to the operating system [ns].
const FLUSH_INTERVAL: u64 = 1_000_000_000;

/// In front of every message: CDR, little-endian. Alignment counts from behind it.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// There is no file to write to.
    #[error("cannot create the recording {}: {source}", path.display())]
    Create {
        /// Where it should have been.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file took no more.
    #[error("cannot write the recording: {0}")]
    Write(#[from] ::mcap::McapError),
    /// A message has no encoding.
    #[error("cannot encode a message for the recording: {0}")]
    Encode(#[from] cdr_encoding::Error),
    /// Joint names and values do not belong together.
    #[error("{names} joint names, but {values} values of {quantity}")]
    Lengths {
        /// Position, velocity or effort.
        quantity: &'static str,
        /// How many names there are.
        names: usize,
        /// How many values there are.
        values: usize,
    },
}

/// Severity of a line on `/rosout`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum LogLevel {
    /// For developers.
    Debug = 10,
    /// As expected.
    Info = 20,
    /// Worth a look.
    Warn = 30,
    /// Something failed.
    Error = 40,
    /// Nothing works any more.
    Fatal = 50,
}

/// Where a frame is in another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// The frame it is given in.
    pub parent: String,
    /// The frame it places.
    pub child: String,
    /// Origin of the child [m].
    pub translation: [f64; 3],
    /// Unit quaternion of the child's orientation, its real part last.
    pub rotation_xyzw: [f64; 4],
}

#[derive(Clone, Copy)]
enum Topic {
    RobotDescription,
    JointStates,
    Reference,
    Rosout,
    Tf,
}

impl Topic {
    const COUNT: usize = 5;

    /// Name, type, how many messages a publisher keeps, and whether late subscribers get them.
    const fn properties(self) -> (&'static str, Definition, u32, bool) {
        match self {
            Self::RobotDescription => ("/robot_description", messages::STRING, 1, true),
            Self::JointStates => ("/joint_states", messages::JOINT_STATE, 10, false),
            Self::Reference => ("/tesaki/reference", messages::JOINT_STATE, 10, false),
            Self::Rosout => ("/rosout", messages::LOG, 1000, true),
            Self::Tf => ("/tf", messages::TF_MESSAGE, 100, false),
        }
    }
}

/// What rosbag2 calls `offered_qos_profiles`: one reliable publisher. Policies are numbers, which every
/// rosbag2 reads; those before Jazzy do not know names.
fn quality_of_service(depth: u32, transient_local: bool) -> String {
    let durability = if transient_local { 1 } else { 2 };
    let forever = "\n    sec: 9223372036\n    nsec: 854775807";
    format!(
        "- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n  deadline:{forever}\n  \
         lifespan:{forever}\n  liveliness: 1\n  liveliness_lease_duration:{forever}\n  \
         avoid_ros_namespace_conventions: false"
    )
}

#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    sequence: u32,
}

/// A recording being written. Times are nanoseconds since 1970. When the program dies, at most a second of
/// recorded time is lost, and the file is one without index; dropped without [`finish`](Self::finish), the
/// file is completed but errors go unseen.
pub struct Recording {
    writer: Writer<NoSeek<EndedFile>>,
    channels: [Option<Channel>; Topic::COUNT],
    /// Waits for the first message, whose time it gets.
    urdf: Option<String>,
    flushed: Option<u64>,
    buffer: Vec<u8>,
}

impl Recording {
    /// Starts the file `path`, replacing what was there. The robot's URDF goes before all other messages.
    pub fn create(path: impl AsRef<Path>, urdf: Option<&str>) -> Result<Self, McapError> {
        let path = path.as_ref();
        let file =
            File::create(path).map_err(|source| McapError::Create { path: path.to_owned(), source })?;
        // Without seeking, chunks reach the file whole: one cut short is just missing.
        let writer = WriteOptions::new()
            .profile("ros2")
            .library(concat!("tesaki/", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .disable_seeking(true)
            .create(NoSeek::new(EndedFile::new(file)))?;
        Ok(Self {
            writer,
            channels: [None; Topic::COUNT],
            urdf: urdf.map(str::to_owned),
            flushed: None,
            buffer: Vec::new(),
        })
    }

    /// Notes facts about the recording under a name.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), McapError> {
        self.writer.write_metadata(&Metadata { name: name.to_owned(), metadata: entries })?;
        self.flush()
    }

    /// Measured joints on `/joint_states`: angles [rad], speeds [rad/s], torques [N·m]. Unknown quantities
    /// are left empty.
    pub fn joint_states(
        &mut self,
        time: u64,
        names: &[String],
        position: &[f64],
        velocity: &[f64],
        effort: &[f64],
    ) -> Result<(), McapError> {
        self.joints(Topic::JointStates, time, names, [position, velocity, effort])
    }

    /// What the joints should do, on `/tesaki/reference`, given as for [`joint_states`](Self::joint_states).
    pub fn references(
        &mut self,
        time: u64,
        names: &[String],
        position: &[f64],
        velocity: &[f64],
        effort: &[f64],
    ) -> Result<(), McapError> {
        self.joints(Topic::Reference, time, names, [position, velocity, effort])
    }

    fn joints(
        &mut self,
        topic: Topic,
        time: u64,
        names: &[String],
        values: [&[f64]; 3],
    ) -> Result<(), McapError> {
        for (quantity, values) in ["position", "velocity", "effort"].into_iter().zip(values) {
            if !values.is_empty() && values.len() != names.len() {
                return Err(McapError::Lengths { quantity, names: names.len(), values: values.len() });
            }
        }
        let [position, velocity, effort] = values;
        let header = messages::Header { stamp: time.into(), frame_id: "" };
        self.write(topic, time, &messages::JointState { header, name: names, position, velocity, effort })
    }

    /// A line of text on `/rosout`; `name` says who speaks.
    pub fn log(&mut self, time: u64, level: LogLevel, name: &str, text: &str) -> Result<(), McapError> {
        let message = messages::Log {
            stamp: time.into(),
            level: level as u8,
            name,
            msg: text,
            file: "",
            function: "",
            line: 0,
        };
        self.write(Topic::Rosout, time, &message)
    }

    /// Frames on `/tf`, all at one time.
    pub fn tf(&mut self, time: u64, transforms: &[Transform]) -> Result<(), McapError> {
        let transforms = transforms.iter().map(|transform| messages::TransformStamped {
            header: messages::Header { stamp: time.into(), frame_id: &transform.parent },
            child_frame_id: &transform.child,
            translation: transform.translation,
            rotation: transform.rotation_xyzw,
        });
        self.write(Topic::Tf, time, &messages::Transforms { transforms: transforms.collect() })
    }

    /// Hands everything so far to the operating system.
    pub fn flush(&mut self) -> Result<(), McapError> {
        Ok(self.writer.flush()?)
    }

    /// Ends the file with its summary and indexes.
    pub fn finish(mut self) -> Result<(), McapError> {
        self.write_description(0)?;
        self.writer.finish()?;
        Ok(self.writer.into_inner().flush().map_err(::mcap::McapError::from)?)
    }

    fn write(&mut self, topic: Topic, time: u64, message: &impl Serialize) -> Result<(), McapError> {
        self.write_description(time)?;
        self.append(topic, time, message)?;
        // A clock that was set back counts too.
        if self.flushed.is_none_or(|flushed| time.abs_diff(flushed) >= FLUSH_INTERVAL) {
            self.flushed = Some(time);
            self.flush()?;
        }
        Ok(())
    }

    fn write_description(&mut self, time: u64) -> Result<(), McapError> {
        match self.urdf.take() {
            Some(urdf) => self.append(Topic::RobotDescription, time, &messages::Text { data: &urdf }),
            None => Ok(()),
        }
    }

    fn append(&mut self, topic: Topic, time: u64, message: &impl Serialize) -> Result<(), McapError> {
        self.buffer.clear();
        self.buffer.extend(ENCAPSULATION);
        cdr_encoding::to_writer::<_, LittleEndian, _>(&mut self.buffer, message)?;
        let channel = match self.channels[topic as usize] {
            Some(channel) => channel,
            None => Channel { id: self.open(topic)?, sequence: 0 },
        };
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: time,
            publish_time: time,
        };
        self.channels[topic as usize] =
            Some(Channel { sequence: channel.sequence.wrapping_add(1), ..channel });
        Ok(self.writer.write_to_known_channel(&header, &self.buffer)?)
    }

    fn open(&mut self, topic: Topic) -> Result<u16, McapError> {
        let (name, definition, depth, transient_local) = topic.properties();
        let schema = self.writer.add_schema(definition.name, "ros2msg", definition.text().as_bytes())?;
        let metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), quality_of_service(depth, transient_local)),
            ("topic_type_hash".to_owned(), definition.hash.to_owned()),
        ]);
        Ok(self.writer.add_channel(schema, name, "cdr", &metadata)?)
    }
}
