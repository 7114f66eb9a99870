//! Coverage-guided fuzzing: the targets, and the corpora that come with them.
//!
//! A target is a function that takes any bytes and panics when a property is violated. `cargo xtask fuzz`
//! lets libFuzzer search for such bytes; `tests/corpora.rs` runs the kept inputs in every test, and
//! `tests/random.rs` unguided ones.

mod codec;
pub mod corpus;
mod files;
mod input;
pub mod large;
mod node;
pub mod random;
mod recording;
mod robot;

pub use node::reached;

/// Maximum length of a file's text [bytes].
const MAX_TEXT: usize = 16_384;

/// A fuzz target.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Runs it on an input; panics when a property is violated.
    pub run: fn(&[u8]),
    /// Returns the initial inputs.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Maximum length of an input [bytes].
    pub max_len: usize,
    /// Paths of the modules that it tests, for the covered fraction.
    pub modules: &'static [&'static str],
    /// Words for the fuzzer to insert.
    pub words: &'static [&'static str],
}

/// All targets.
pub const TARGETS: &[Target] = &[
    Target {
        name: "codec",
        modules: &["tesaki::protocol::"],
        run: codec::run,
        seeds: codec::seeds,
        max_len: 2048,
        words: &[],
    },
    Target {
        name: "node",
        modules: &["tesaki::"],
        run: node::run,
        seeds: node::seeds,
        max_len: 1024,
        words: &[],
    },
    Target {
        name: "robot",
        modules: &["tesaki_description::"],
        run: robot::run,
        seeds: robot::seeds,
        max_len: MAX_TEXT,
        words: ROBOT,
    },
    Target {
        name: "files",
        modules: &[
            "tesaki_description::grasp",
            "tesaki_description::impedance",
            "tesaki_description::calibration",
        ],
        run: files::run,
        seeds: files::seeds,
        max_len: 4096,
        words: FILES,
    },
    Target {
        name: "recording",
        modules: &["tesaki::node::"],
        run: recording::run,
        seeds: recording::seeds,
        max_len: 8192,
        words: &[],
    },
];

/// Words of URDF, `controller.toml` and `plant.toml`.
const ROBOT: &[&str] = &[
    "<robot name=\"",
    "<link name=\"",
    "<joint name=\"",
    "</joint>",
    "</link>",
    "</robot>",
    " type=\"revolute\"",
    " type=\"continuous\"",
    " type=\"prismatic\"",
    " type=\"fixed\"",
    " type=\"planar\"",
    " type=\"floating\"",
    "<parent link=\"",
    "<child link=\"",
    "<origin xyz=\"0 0 0\" rpy=\"0 0 0\"/>",
    "<axis xyz=\"1 0 0\"/>",
    "<limit lower=\"",
    " upper=\"",
    " velocity=\"",
    " effort=\"",
    "<dynamics damping=\"",
    " friction=\"",
    "<mimic joint=\"",
    " multiplier=\"",
    " offset=\"",
    "<inertial>",
    "</inertial>",
    "<mass value=\"",
    "<inertia ixx=\"",
    " iyy=\"",
    " izz=\"",
    " ixy=\"",
    "<visual>",
    "<collision>",
    "<geometry>",
    "<sphere radius=\"",
    "<mesh filename=\"",
    "<!DOCTYPE r [<!ENTITY a \"",
    "&a;",
    "<![CDATA[",
    "<!--",
    "-->",
    "<transmission>",
    "<material name=\"",
    "<xacro:",
    "xmlns:xacro=\"",
    "nan",
    "inf",
    "1e308",
    "1e-320",
    "-0",
    "[joint.motor]",
    "[joint.encoder]",
    "[joint.limits]",
    "[joint.servo]",
    "[joint.servo.pid]",
    "[joint.servo.observer]",
    "[joints.a.motor]",
    "[joints.a]",
    "[safety]",
    "[force_sensor]",
    "[chains.",
    "reaction = \"",
    "accept_inertia = [\"",
    "counts_per_turn = ",
    "reversed = true",
    "relative = false",
    "zero = ",
    "torque_rate = ",
    "following_error = ",
    "filter_time = ",
    "inertia = ",
    "cutoff = ",
    "current_limit = ",
    "current_resolution = ",
    "bandwidth = ",
    "delay = ",
    "gravity = [",
    "[mismatch]",
    "[friction]",
    "[inner_loop]",
    "[noise]",
    "[supply]",
    "[integration]",
    "[posture]",
    "step = ",
    "window = ",
    "saturation = ",
    "force_resolution = ",
    "torque_resolution = ",
    "force_limit = ",
];

/// Words of the files of tasks.
const FILES: &[&str] = &[
    "clearance = ",
    "touch_force = ",
    "force_limit = ",
    "friction = ",
    "internal = ",
    "least_grip",
    "margin = ",
    "capacity_at_rest = ",
    "capacity_in_motion = ",
    "normal = ",
    "pairwise = ",
    "strength = ",
    "strengths = ",
    "feedback = false",
    "control = ",
    "\"pid\"",
    "\"observer\"",
    "wrench",
    "compensated = true",
    "[object]",
    "position = [",
    "rpy = [",
    "[[contact]]",
    "law = ",
    "\"direct\"",
    "\"model-following\"",
    "redundancy = ",
    "\"none\"",
    "\"arm-angle\"",
    "driven = \"",
    "elbow_bandwidth = ",
    "force = ",
    "\"sensor\"",
    "observer = ",
    "contact_force = ",
    "max_deviation = ",
    "translation = ",
    "rotation = ",
    "mass = ",
    "damping = ",
    "stiffness = ",
    "[joints.",
    "torque_constant = ",
    "coulomb = ",
    "viscous = ",
    "nan",
    "inf",
    "-inf",
    "1e39",
    "1e-46",
    "{ ",
    " }",
    "'''",
    "\"\"\"",
];
