//! The ROS 2 messages of a recording: their fields in order, as CDR lays them out, and their definitions.

use serde::Serialize;

use crate::MarkerShape;

const NANOSECONDS: u64 = 1_000_000_000;

/// `builtin_interfaces/msg/Time`.
#[derive(Serialize)]
pub(super) struct Time {
    sec: i32,
    nanosec: u32,
}

impl From<u64> for Time {
    /// Converts nanoseconds since 1970; ROS counts seconds up to 2038.
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

/// `geometry_msgs/msg/TransformStamped`; vector and quaternion are structures of numbers, so they are arrays
/// here.
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

/// `geometry_msgs/msg/WrenchStamped`.
#[derive(Serialize)]
pub(super) struct WrenchStamped<'a> {
    pub header: Header<'a>,
    pub force: [f64; 3],
    pub torque: [f64; 3],
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Serialize)]
pub(super) struct PoseStamped<'a> {
    pub header: Header<'a>,
    pub pose: crate::Pose,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`; a `KeyValue` is a pair of texts.
#[derive(Serialize)]
pub(super) struct DiagnosticStatus<'a> {
    pub level: u8,
    pub name: &'a str,
    pub message: &'a str,
    pub hardware_id: &'a str,
    pub values: &'a [(String, String)],
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Serialize)]
pub(super) struct DiagnosticArray<'a> {
    pub header: Header<'a>,
    pub status: Vec<DiagnosticStatus<'a>>,
}

/// `visualization_msgs/msg/Marker`: a solid in one colour.
#[derive(Serialize)]
pub(super) struct Marker<'a> {
    header: Header<'a>,
    ns: &'a str,
    id: i32,
    kind: i32,
    action: i32,
    pose: crate::Pose,
    scale: [f64; 3],
    colour: [f32; 4],
    /// Seconds and nanoseconds; 0 for ever.
    lifetime: (i32, u32),
    frame_locked: bool,
    points: &'a [[f64; 3]],
    /// `colors`, `texture_resource`, `texture`, `uv_coordinates`, `text`, `mesh_resource`, `mesh_file` and
    /// whether its materials are used: all empty.
    colours: &'a [u8],
    texture_resource: &'a str,
    texture: (Header<'a>, &'a str, &'a [u8]),
    uv_coordinates: &'a [u8],
    text: &'a str,
    mesh_resource: &'a str,
    mesh_file: (&'a str, &'a [u8]),
    mesh_use_embedded_materials: bool,
}

impl<'a> Marker<'a> {
    pub(super) fn new(time: u64, marker: &'a crate::Marker) -> Self {
        let none: &[[f64; 3]] = &[];
        let (kind, scale, points) = match &marker.shape {
            MarkerShape::Box(size) => (1, *size, none),
            MarkerShape::Cylinder([radius, length]) => (3, [2.0 * radius, 2.0 * radius, *length], none),
            MarkerShape::Triangles(corners) => (11, [1.0; 3], corners.as_slice()),
        };
        Self {
            header: Header { stamp: time.into(), frame_id: &marker.frame },
            id: marker.id,
            kind,
            action: 0,
            pose: marker.pose,
            scale,
            colour: marker.colour,
            points,
            ..Self::none(time)
        }
    }

    /// Creates the marker that removes all others.
    pub(super) fn none(time: u64) -> Self {
        Self {
            header: Header { stamp: time.into(), frame_id: "" },
            ns: "tesaki",
            id: 0,
            kind: 0,
            action: 3,
            pose: ([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
            scale: [0.0; 3],
            colour: [0.0; 4],
            lifetime: (0, 0),
            frame_locked: true,
            points: &[],
            colours: &[],
            texture_resource: "",
            texture: (Header { stamp: 0.into(), frame_id: "" }, "", &[]),
            uv_coordinates: &[],
            text: "",
            mesh_resource: "",
            mesh_file: ("", &[]),
            mesh_use_embedded_materials: false,
        }
    }
}

/// `visualization_msgs/msg/MarkerArray`.
#[derive(Serialize)]
pub(super) struct MarkerArray<'a> {
    pub markers: Vec<Marker<'a>>,
}

/// The definition of a message type, as stored in the file.
pub(super) struct Definition {
    pub name: &'static str,
    /// Hash over field names and types by which ROS 2 compares types (REP 2016).
    pub hash: &'static str,
    fields: &'static str,
    /// Names and fields of all nested types.
    parts: &'static [(&'static str, &'static str)],
}

impl Definition {
    /// Returns the `.msg` texts: this type's first, then each other one after a line of `=` and its name.
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

const VECTOR: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const POINT: (&str, &str) = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) =
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n");
const POSE: (&str, &str) =
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n");

pub(super) static JOINT_STATE: Definition = Definition {
    name: "sensor_msgs/msg/JointState",
    hash: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    parts: &[HEADER, TIME],
};

pub(super) static STRING: Definition = Definition {
    name: "std_msgs/msg/String",
    hash: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    fields: "string data\n",
    parts: &[],
};

pub(super) static LOG: Definition = Definition {
    name: "rcl_interfaces/msg/Log",
    hash: "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    fields: "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n\
             builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n\
             string function\nuint32 line\n",
    parts: &[TIME],
};

pub(super) static TF_MESSAGE: Definition = Definition {
    name: "tf2_msgs/msg/TFMessage",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    parts: &[
        (
            "geometry_msgs/TransformStamped",
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        ),
        ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
        VECTOR,
        QUATERNION,
        HEADER,
        TIME,
    ],
};

pub(super) static WRENCH_STAMPED: Definition = Definition {
    name: "geometry_msgs/msg/WrenchStamped",
    hash: "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    fields: "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    parts: &[
        ("geometry_msgs/Wrench", "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"),
        VECTOR,
        HEADER,
        TIME,
    ],
};

pub(super) static POSE_STAMPED: Definition = Definition {
    name: "geometry_msgs/msg/PoseStamped",
    hash: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    fields: "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    parts: &[POSE, POINT, QUATERNION, HEADER, TIME],
};

pub(super) static DIAGNOSTIC_ARRAY: Definition = Definition {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    fields: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    parts: &[
        (
            "diagnostic_msgs/DiagnosticStatus",
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
             string hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
        ),
        ("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
        HEADER,
        TIME,
    ],
};

pub(super) static MARKER_ARRAY: Definition = Definition {
    name: "visualization_msgs/msg/MarkerArray",
    hash: "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    fields: "visualization_msgs/Marker[] markers\n",
    parts: &[
        (
            "visualization_msgs/Marker",
            "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n\
             int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n\
             int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\nint32 ARROW_STRIP=12\n\
             int32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\nstd_msgs/Header header\n\
             string ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n\
             geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n\
             bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n\
             string texture_resource\nsensor_msgs/CompressedImage texture\n\
             visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n\
             visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
        ),
        POSE,
        POINT,
        QUATERNION,
        VECTOR,
        ("std_msgs/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"),
        ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
        ("sensor_msgs/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data\n"),
        ("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
        ("visualization_msgs/MeshFile", "string filename\nuint8[] data\n"),
        HEADER,
        TIME,
    ],
};
