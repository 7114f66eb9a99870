//! The ROS 2 messages of a recording: their fields in order, as CDR lays them out, and their definitions.

use serde::Serialize;

const NANOSECONDS: u64 = 1_000_000_000;

/// `builtin_interfaces/msg/Time`.
#[derive(Serialize)]
pub(super) struct Time {
    sec: i32,
    nanosec: u32,
}

impl From<u64> for Time {
    /// From nanoseconds since 1970; ROS counts seconds up to 2038.
    fn from(time: u64) -> Self {
        match (i32::try_from(time / NANOSECONDS), u32::try_from(time % NANOSECONDS)) {
            (Ok(sec), Ok(nanosec)) => Self { sec, nanosec },
            _ => Self { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }
}

/// `std_msgs/msg/Header`.
#[derive(Serialize)]
pub(super) struct Header<'a> {
    pub stamp: Time,
    pub frame_id: &'a str,
}

/// `sensor_msgs/msg/JointState`.
#[derive(Serialize)]
pub(super) struct JointState<'a> {
    pub header: Header<'a>,
    pub name: &'a [String],
    pub position: &'a [f64],
    pub velocity: &'a [f64],
    pub effort: &'a [f64],
}

/// `std_msgs/msg/String`.
#[derive(Serialize)]
pub(super) struct Text<'a> {
    pub data: &'a str,
}

/// `rcl_interfaces/msg/Log`.
#[derive(Serialize)]
pub(super) struct Log<'a> {
    pub stamp: Time,
    pub level: u8,
    pub name: &'a str,
    pub msg: &'a str,
    pub file: &'a str,
    pub function: &'a str,
    pub line: u32,
}

/// `geometry_msgs/msg/TransformStamped`; vector and quaternion are structures of numbers, so arrays here.
#[derive(Serialize)]
pub(super) struct TransformStamped<'a> {
    pub header: Header<'a>,
    pub child_frame_id: &'a str,
    pub translation: [f64; 3],
    pub rotation: [f64; 4],
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Serialize)]
pub(super) struct Transforms<'a> {
    pub transforms: Vec<TransformStamped<'a>>,
}

/// A message type as readers learn it from the file.
pub(super) struct Definition {
    pub name: &'static str,
    /// What ROS 2 compares types by: a hash over field names and types (REP 2016).
    pub hash: &'static str,
    fields: &'static str,
    /// Name and fields of every type used inside.
    parts: &'static [(&'static str, &'static str)],
}

impl Definition {
    /// The `.msg` texts, this type's first, each other one under a line of `=` and its name.
    pub(super) fn text(&self) -> String {
        let mut text = self.fields.to_owned();
        for (name, fields) in self.parts {
            text += &format!("\n{}\nMSG: {name}\n{fields}", "=".repeat(80));
        }
        text
    }
}

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");

pub(super) const JOINT_STATE: Definition = Definition {
    name: "sensor_msgs/msg/JointState",
    hash: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    parts: &[HEADER, TIME],
};

pub(super) const STRING: Definition = Definition {
    name: "std_msgs/msg/String",
    hash: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    fields: "string data\n",
    parts: &[],
};

pub(super) const LOG: Definition = Definition {
    name: "rcl_interfaces/msg/Log",
    hash: "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    fields: "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n\
             builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n\
             string function\nuint32 line\n",
    parts: &[TIME],
};

pub(super) const TF_MESSAGE: Definition = Definition {
    name: "tf2_msgs/msg/TFMessage",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    parts: &[
        (
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        ),
        ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
        ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
        ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
        HEADER,
        TIME,
    ],
};
