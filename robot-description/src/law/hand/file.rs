//! The keys of a law file of a hand.

use serde::Deserialize;
use tesaki::control::ServoMode;
use tesaki::model::PidGains;

use super::{ForceExperiment, HandLaw, MotionExperiment, ObjectLaw, ServoExperiment, WeightsExperiment};
use crate::grasp::{Control, FrameName, Internal, LoadName, TargetsName};

/// The content of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    title: String,
    servo: Servo,
    grasp: Grasp,
    force: Force,
    weights: Weights,
    motion: Motion,
    joint_control: Motion,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Servo {
    mode: Mode,
    pid: Option<Gains>,
    knows_friction: bool,
    following_error: Option<f64>,
    rest_error: Option<f64>,
    step: f64,
    duration: f64,
    #[serde(default = "half")]
    evaluated: f64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Mode {
    Pid,
    Observer,
    BarePid,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Gains {
    proportional: f32,
    integral: f32,
    derivative: f32,
    cutoff: f32,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Grasp {
    control: Control,
    object_frame: FrameName,
    load: LoadName,
    joint_targets: TargetsName,
    internal: Internal,
    feedback: bool,
}

/// What an experiment says of the grasp otherwise than [`Grasp`]. (Flattened tables cannot refuse unknown
/// keys, so each experiment has its list.)
#[derive(Clone, Copy, Debug)]
struct Own {
    control: Option<Control>,
    object_frame: Option<FrameName>,
    load: Option<LoadName>,
    joint_targets: Option<TargetsName>,
    internal: Option<Internal>,
    feedback: Option<bool>,
}

/// An experiment's table: its own keys, and those of [`Own`].
macro_rules! experiment {
    ($name:ident { $($(#[$attribute:meta])* $key:ident: $ty:ty),* $(,)? }) => {
        #[derive(Clone, Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        struct $name {
            $($(#[$attribute])* $key: $ty,)*
            control: Option<Control>,
            object_frame: Option<FrameName>,
            load: Option<LoadName>,
            joint_targets: Option<TargetsName>,
            internal: Option<Internal>,
            feedback: Option<bool>,
        }

        impl $name {
            const fn own(&self) -> Own {
                let Self { control, object_frame, load, joint_targets, internal, feedback, .. } = *self;
                Own { control, object_frame, load, joint_targets, internal, feedback }
            }
        }
    };
}

experiment!(Force {
    hold: f64,
    evaluated: f64,
    coulomb: Vec<f64>,
    #[serde(default)]
    efficiency: Vec<f64>,
});
experiment!(Weights {
    masses: Vec<f64>,
    cumulative: bool,
    ramp: f64,
    interval: f64,
    #[serde(default = "half")]
    evaluated: f64,
    #[serde(default = "one")]
    rest: f64,
    #[serde(default = "top")]
    point: [f64; 3],
});
experiment!(Motion {
    turns: Vec<f64>,
    shifts: Vec<f64>,
    duration: f64,
    rest: f64,
    #[serde(default = "one_and_a_half")]
    initial_rest: f64,
    #[serde(default = "two")]
    evaluated: f64,
    #[serde(default)]
    integral: Vec<f64>,
});

const fn half() -> f64 {
    0.5
}

const fn one() -> f64 {
    1.0
}

const fn one_and_a_half() -> f64 {
    1.5
}

const fn two() -> f64 {
    2.0
}

/// The middle of the box's top [m].
const fn top() -> [f64; 3] {
    [0.0, 0.0, 0.03]
}

impl File {
    pub(super) fn law(self) -> HandLaw {
        let Self { title, servo, grasp, force, weights, motion, joint_control } = self;
        let moved = |motion: Motion| MotionExperiment {
            law: grasp.with(motion.own()),
            turns: motion.turns,
            shifts: motion.shifts,
            duration: motion.duration,
            rest: motion.rest,
            initial_rest: motion.initial_rest,
            evaluated: motion.evaluated,
            integral: motion.integral,
        };
        HandLaw {
            title,
            servo: ServoExperiment {
                mode: match servo.mode {
                    Mode::Pid => ServoMode::Pid,
                    Mode::Observer => ServoMode::Observer,
                    Mode::BarePid => ServoMode::BarePid,
                },
                pid: servo.pid.map(|Gains { proportional, integral, derivative, cutoff }| PidGains {
                    proportional,
                    integral,
                    derivative,
                    cutoff,
                }),
                knows_friction: servo.knows_friction,
                following_error: servo.following_error,
                rest_error: servo.rest_error,
                step: servo.step,
                duration: servo.duration,
                evaluated: servo.evaluated,
            },
            force: ForceExperiment {
                law: grasp.with(force.own()),
                hold: force.hold,
                evaluated: force.evaluated,
                coulomb: force.coulomb,
                efficiency: force.efficiency,
            },
            weights: WeightsExperiment {
                law: grasp.with(weights.own()),
                masses: weights.masses,
                cumulative: weights.cumulative,
                ramp: weights.ramp,
                interval: weights.interval,
                evaluated: weights.evaluated,
                rest: weights.rest,
                point: weights.point,
            },
            motion: moved(motion),
            joint_control: moved(joint_control),
        }
    }
}

impl Grasp {
    fn with(&self, own: Own) -> ObjectLaw {
        ObjectLaw {
            control: own.control.unwrap_or(self.control).into(),
            object_frame: own.object_frame.unwrap_or(self.object_frame).into(),
            load: own.load.unwrap_or(self.load).into(),
            joint_targets: own.joint_targets.unwrap_or(self.joint_targets).into(),
            internal: own.internal.unwrap_or(self.internal).into(),
            feedback: own.feedback.unwrap_or(self.feedback),
        }
    }
}
