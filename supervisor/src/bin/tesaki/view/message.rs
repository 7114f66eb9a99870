//! What goes between `tesaki view` and its pages, as JSON. `viewer/web/src/data.ts` describes the same.

use serde::{Deserialize, Serialize};

use tesaki_supervisor::task_report::Report;

/// A command of a page.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// The page has the state with this number.
    Seen {
        n: u64,
    },
    Take,
    Release,
    Stop,
    Disable,
    /// Clears the faults that the page has shown, so many since power-on.
    Clear {
        total: u32,
    },
    Tare,
    /// Enables a task, with the settings in a file of the robot folder.
    Enable {
        task: String,
        plan: Option<String>,
    },
    /// An angle for a joint [rad].
    Goal {
        joint: usize,
        angle: f32,
    },
    /// A displacement [m] and a rotation vector [rad] of the grasped object, from its last target.
    Object {
        translation: [f32; 3],
        rotation: [f32; 3],
    },
    PutDown,
    Open,
    /// A displacement of an arm's tool [m], from its last target.
    Tool {
        translation: [f32; 3],
    },
}

/// The board after a tick.
#[derive(Debug, Serialize)]
pub struct State {
    pub kind: &'static str,
    /// Its number, which the page sends back.
    pub n: u64,
    pub tick: u32,
    pub mode: &'static str,
    /// The task that runs.
    pub task: Option<String>,
    /// Angle, velocity, reference and torque of each joint.
    pub joints: Vec<[f32; 4]>,
    pub tips: Vec<Tip>,
    pub report: Option<Report>,
    /// From the tick to this program, and from here to the page [ms].
    pub delay: [f32; 2],
}

/// A tip with the force on it, in the base frame.
#[derive(Debug, Serialize)]
pub struct Tip {
    pub position: [f32; 3],
    pub force: [f32; 3],
    pub tared: bool,
}

/// What changes seldom.
#[derive(Debug, Serialize)]
pub struct Status<'a> {
    pub kind: &'static str,
    pub port: &'a str,
    pub firmware: &'a str,
    pub supply: f32,
    pub homed: Vec<bool>,
    /// Who commands: `nobody`, `you`, `page` or `program`.
    pub commander: &'static str,
    /// What falls without power.
    pub falls: Option<String>,
    pub plans: &'a [Plan],
    pub faults: &'a [FaultText],
    /// Number of faults since power-on, with those that the page shows; none while there is nothing to clear.
    pub total: Option<u32>,
    /// Why there is nothing to see.
    pub trouble: Option<&'a str>,
}

/// A file with which a task can be enabled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Plan {
    pub task: String,
    pub name: String,
}

/// A fault in words.
#[derive(Clone, Debug, Serialize)]
pub struct FaultText {
    pub text: String,
    pub title: String,
    pub likely: String,
    pub remedy: String,
}
