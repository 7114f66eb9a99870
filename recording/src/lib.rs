//! A robot as ROS 2 messages: recorded in MCAP, for Foxglove, PlotJuggler, Rerun and `ros2 bag`, or kept for
//! live viewers.
//!
//! A [`Publisher`] creates the messages for a [`Sink`]: [`McapFile`] (together a [`Recording`]) or [`Live`].

mod ended_file;
mod file;
mod live;
mod messages;

use std::{borrow::Cow, collections::BTreeMap, path::PathBuf};

use byteorder::LittleEndian;
use serde::Serialize;

use messages::Definition;

pub use file::{McapFile, Recording};
pub use live::{Live, LiveMessage};

/// Precedes every message: CDR, little-endian. Alignment is counted from its end.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why a message could not be written.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// The file cannot be created.
    #[error("cannot create the recording {}: {source}", path.display())]
    Create {
        /// Where it should have been.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the recording: {}", reason(.0))]
    Write(#[from] ::mcap::McapError),
    /// A message has no encoding.
    #[error("cannot encode a message for the recording: {0}")]
    Encode(#[from] cdr_encoding::Error),
    /// More than 65 536 topics.
    #[error("more topics than can be numbered")]
    TooManyTopics,
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

/// The system's reason, where it is one.
fn reason(error: &::mcap::McapError) -> String {
    match error {
        ::mcap::McapError::Io(source) => source.to_string(),
        error => error.to_string(),
    }
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
    /// The program cannot continue.
    Fatal = 50,
}

/// The pose of a frame in another frame.
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

/// Position [m] and unit quaternion, its real part last.
pub type Pose = ([f64; 3], [f64; 4]);

/// The health of something, on `/diagnostics`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Health {
    /// As expected.
    Ok = 0,
    /// Worth a look.
    Warn = 1,
    /// It has failed.
    Error = 2,
    /// There is no recent information about it.
    Stale = 3,
}

/// An entry of `/diagnostics`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// Its health.
    pub health: Health,
    /// Name of the component.
    pub name: String,
    /// Its state in words.
    pub message: String,
    /// Names with values.
    pub values: Vec<(String, String)>,
}

/// A body to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// Unique number of the body.
    pub id: i32,
    /// The frame with which it moves.
    pub frame: String,
    /// Where it is in that frame.
    pub pose: Pose,
    /// Its shape.
    pub shape: MarkerShape,
    /// Red, green, blue and opacity, from 0 to 1.
    pub colour: [f32; 4],
}

/// Shape of a [`Marker`].
#[derive(Debug, Clone, PartialEq)]
pub enum MarkerShape {
    /// A cuboid with these extents [m].
    Box([f64; 3]),
    /// A cylinder along z: radius and length [m].
    Cylinder([f64; 2]),
    /// Triangles, three corners each [m].
    Triangles(Vec<[f64; 3]>),
}

/// A topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// The type of its messages, as `sensor_msgs/msg/JointState`.
    pub schema: &'static str,
    /// The definition of that type and of those inside it, as `.msg` files.
    pub definition: String,
    /// Hash by which ROS 2 compares types (REP 2016).
    pub hash: &'static str,
    /// How many messages a publisher keeps.
    pub depth: u32,
    /// Whether late subscribers get the last message.
    pub transient_local: bool,
}

/// A destination of messages.
pub trait Sink {
    /// Takes a new topic. Returns the number by which it is written to.
    ///
    /// # Errors
    /// The sink cannot take more.
    fn open(&mut self, topic: Topic) -> Result<u16, McapError>;

    /// Takes a message of an open topic: in CDR, with its time [ns since 1970].
    ///
    /// # Errors
    /// The sink cannot take more.
    fn write(&mut self, topic: u16, sequence: u32, time: u64, message: &[u8]) -> Result<(), McapError>;
}

/// A topic before it is opened.
struct Kind {
    name: Cow<'static, str>,
    definition: &'static Definition,
    depth: u32,
    transient_local: bool,
}

impl Kind {
    const fn new(
        name: &'static str,
        definition: &'static Definition,
        depth: u32,
        transient_local: bool,
    ) -> Self {
        Self { name: Cow::Borrowed(name), definition, depth, transient_local }
    }

    /// Creates a topic whose name is composed at run time.
    const fn named(name: String, definition: &'static Definition) -> Self {
        Self { name: Cow::Owned(name), definition, depth: 10, transient_local: false }
    }
}

const ROBOT_DESCRIPTION: Kind = Kind::new("/robot_description", &messages::STRING, 1, true);
const JOINT_STATES: Kind = Kind::new("/joint_states", &messages::JOINT_STATE, 10, false);
const REFERENCE: Kind = Kind::new("/tesaki/reference", &messages::JOINT_STATE, 10, false);
const ROSOUT: Kind = Kind::new("/rosout", &messages::LOG, 1000, true);
const TF: Kind = Kind::new("/tf", &messages::TF_MESSAGE, 100, false);
const TF_STATIC: Kind = Kind::new("/tf_static", &messages::TF_MESSAGE, 1, true);
const DIAGNOSTICS: Kind = Kind::new("/diagnostics", &messages::DIAGNOSTIC_ARRAY, 10, false);
const OBJECTS: Kind = Kind::new("/tesaki/objects", &messages::MARKER_ARRAY, 10, true);

#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    sequence: u32,
}

/// Creates the messages. Times are nanoseconds since 1970.
pub struct Publisher<S> {
    sink: S,
    channels: BTreeMap<Cow<'static, str>, Channel>,
    /// Waits for the first message, to be published with its time.
    urdf: Option<String>,
    buffer: Vec<u8>,
}

impl<S: Sink> Publisher<S> {
    /// Creates a publisher. The robot's URDF is published before all other messages.
    pub fn new(sink: S, urdf: Option<&str>) -> Self {
        Self { sink, channels: BTreeMap::new(), urdf: urdf.map(str::to_owned), buffer: Vec::new() }
    }

    /// Returns the destination of the messages.
    pub const fn sink(&self) -> &S {
        &self.sink
    }

    /// Returns the destination of the messages, to take them from it.
    pub const fn sink_mut(&mut self) -> &mut S {
        &mut self.sink
    }

    /// Publishes the measured joints on `/joint_states`: angles [rad], speeds [rad/s], torques [N·m]. Unknown
    /// quantities are left empty.
    pub fn joint_states(
        &mut self,
        time: u64,
        names: &[String],
        position: &[f64],
        velocity: &[f64],
        effort: &[f64],
    ) -> Result<(), McapError> {
        self.joints(JOINT_STATES, time, names, [position, velocity, effort])
    }

    /// Publishes the references of the joints on `/tesaki/reference`; arguments as for
    /// [`joint_states`](Self::joint_states).
    pub fn references(
        &mut self,
        time: u64,
        names: &[String],
        position: &[f64],
        velocity: &[f64],
        effort: &[f64],
    ) -> Result<(), McapError> {
        self.joints(REFERENCE, time, names, [position, velocity, effort])
    }

    fn joints(
        &mut self,
        topic: Kind,
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

    /// Publishes a line of text on `/rosout`; `name` is its source.
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
        self.write(ROSOUT, time, &message)
    }

    /// Publishes frames on `/tf`, all with the same time.
    pub fn tf(&mut self, time: u64, transforms: &[Transform]) -> Result<(), McapError> {
        self.transforms(TF, time, transforms)
    }

    /// Publishes the fixed frames on `/tf_static`, all of them in one message.
    pub fn tf_static(&mut self, time: u64, transforms: &[Transform]) -> Result<(), McapError> {
        self.transforms(TF_STATIC, time, transforms)
    }

    fn transforms(&mut self, topic: Kind, time: u64, transforms: &[Transform]) -> Result<(), McapError> {
        let transforms = transforms.iter().map(|transform| messages::TransformStamped {
            header: messages::Header { stamp: time.into(), frame_id: &transform.parent },
            child_frame_id: &transform.child,
            translation: transform.translation,
            rotation: transform.rotation_xyzw,
        });
        self.write(topic, time, &messages::Transforms { transforms: transforms.collect() })
    }

    /// Publishes the wrench on a frame on `/tesaki/wrench/FRAME`: force [N] and torque [N·m] about its
    /// origin, in its axes. In the name of the topic, what ROS 2 does not allow there is written as its code.
    pub fn wrench(
        &mut self,
        time: u64,
        frame: &str,
        force: [f64; 3],
        torque: [f64; 3],
    ) -> Result<(), McapError> {
        let topic = Kind::named(format!("/tesaki/wrench/{}", ros_name(frame)), &messages::WRENCH_STAMPED);
        let header = messages::Header { stamp: time.into(), frame_id: frame };
        self.write(topic, time, &messages::WrenchStamped { header, force, torque })
    }

    /// Publishes a pose in a frame on `/tesaki/NAME`.
    pub fn pose(&mut self, time: u64, name: &str, frame: &str, pose: Pose) -> Result<(), McapError> {
        let topic = Kind::named(format!("/tesaki/{name}"), &messages::POSE_STAMPED);
        let header = messages::Header { stamp: time.into(), frame_id: frame };
        self.write(topic, time, &messages::PoseStamped { header, pose })
    }

    /// Publishes the health of all components on `/diagnostics`.
    pub fn diagnostics(
        &mut self,
        time: u64,
        hardware: &str,
        entries: &[Diagnostic],
    ) -> Result<(), McapError> {
        let status = entries.iter().map(|entry| messages::DiagnosticStatus {
            level: entry.health as u8,
            name: &entry.name,
            message: &entry.message,
            hardware_id: hardware,
            values: &entry.values,
        });
        let header = messages::Header { stamp: time.into(), frame_id: "" };
        self.write(DIAGNOSTICS, time, &messages::DiagnosticArray { header, status: status.collect() })
    }

    /// Publishes bodies to be drawn on `/tesaki/objects`, which replace all previous ones.
    pub fn objects(&mut self, time: u64, markers: &[Marker]) -> Result<(), McapError> {
        let shown = markers.iter().map(|marker| messages::Marker::new(time, marker));
        let markers = std::iter::once(messages::Marker::none(time)).chain(shown).collect();
        self.write(OBJECTS, time, &messages::MarkerArray { markers })
    }

    fn write(&mut self, topic: Kind, time: u64, message: &impl Serialize) -> Result<(), McapError> {
        self.write_description(time)?;
        self.append(topic, time, message)
    }

    fn write_description(&mut self, time: u64) -> Result<(), McapError> {
        match self.urdf.take() {
            Some(urdf) => self.append(ROBOT_DESCRIPTION, time, &messages::Text { data: &urdf }),
            None => Ok(()),
        }
    }

    fn append(&mut self, topic: Kind, time: u64, message: &impl Serialize) -> Result<(), McapError> {
        self.buffer.clear();
        self.buffer.extend(ENCAPSULATION);
        cdr_encoding::to_writer::<_, LittleEndian, _>(&mut self.buffer, message)?;
        let Channel { id, sequence } = match self.channels.get(&topic.name) {
            Some(channel) => *channel,
            None => Channel { id: self.open(&topic)?, sequence: 0 },
        };
        self.channels.insert(topic.name, Channel { id, sequence: sequence.wrapping_add(1) });
        self.sink.write(id, sequence, time, &self.buffer)
    }

    fn open(&mut self, topic: &Kind) -> Result<u16, McapError> {
        self.sink.open(Topic {
            name: topic.name.to_string(),
            schema: topic.definition.name,
            definition: topic.definition.text(),
            hash: topic.definition.hash,
            depth: topic.depth,
            transient_local: topic.transient_local,
        })
    }
}

/// Returns `name` as a part of a ROS 2 topic: letters, digits and `_`, and a letter in front, because a digit
/// is invalid there and `_` hides a topic. Every other byte is written as its code: `_x2d` for `-`, `x32` for
/// a 2 in front.
fn ros_name(name: &str) -> String {
    let mut topic = String::new();
    for byte in name.bytes() {
        let is_first = topic.is_empty();
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' => topic.push(char::from(byte)),
            b'0'..=b'9' | b'_' if !is_first => topic.push(char::from(byte)),
            _ if is_first => topic = format!("x{byte:02x}"),
            _ => topic += &format!("_x{byte:02x}"),
        }
    }
    topic
}
