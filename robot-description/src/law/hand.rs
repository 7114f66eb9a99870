//! Laws of a hand: its joint servo, how it holds an object, and the experiments of the Hand3 paper.
//!
//! ```toml
//! title = "my law"                # in figures
//!
//! [servo]                         # Hand3 section 4, figure 6: every joint steps
//! mode = "bare_pid"               # or "pid", "observer"
//! pid = { proportional = 400.0, integral = 4000.0, derivative = 75.0, cutoff = 30.0 } # else that of controller.toml
//! knows_friction = true           # whether the controller is told the friction of the machine's joints, to compensate it
//! following_error = 1.0           # rad, at which a joint is too far from its target; else that of controller.toml
//! rest_error = 7e-4               # rad, dead band at rest of "pid" and "observer"; else that of controller.toml
//! step = 0.3                      # rad
//! duration = 3.0                  # s
//! evaluated = 0.5                 # s, at its end, that count as rest
//!
//! [grasp]                         # what holds for all experiments with an object, unless they say otherwise
//! control = "observer"            # as in grasp files, and so for the next five
//! object_frame = "rolling"
//! load = "measured"
//! joint_targets = "closed_form"
//! internal = { normal = { strength = 4.0 } }
//! feedback = true
//!
//! [force]                         # section 6.1, figure 11: the box is held
//! hold = 4.0                      # s
//! evaluated = 2.0                 # s, at its end
//! coulomb = [0.0, 0.04, 0.08]     # N·m, of the joints, for the curve of the force over the friction
//! efficiency = [1.0, 0.8, 0.6]    # of the transmissions, for the curve of the force over it; may be left out
//!
//! [weights]                       # section 6.2, figure 12: weights are put on
//! masses = [0.05, 0.1, 0.2, 0.3]  # kg
//! cumulative = false              # else one in place of the other
//! ramp = 0.3                      # s
//! interval = 2.0                  # s
//! evaluated = 0.5                 # s, at its end
//! rest = 1.0                      # s, before the first
//! point = [0.0, 0.0, 0.03]        # m, where they act, in the object's frame
//!
//! [motion]                        # section 7, figures 14 and 15: the box is turned about y, then shifted along x
//! turns = [0.1, -0.1, -0.1, 0.1]  # rad
//! shifts = [0.01, -0.01]          # m
//! duration = 1.0                  # s, of each motion
//! rest = 2.5                      # s, after each
//! initial_rest = 1.5              # s, before the first
//! evaluated = 2.0                 # s, from the end of a motion until its error is evaluated
//! integral = [1000.0, 4000.0]     # N/(m·s), K_i of the position, for the curve of the errors over it; may be left out
//!
//! [joint_control]                 # section 5.5: the same by joint angles
//! # as [motion]
//! ```
//!
//! `evaluated` (but that of `[force]`), `point`, `initial_rest`, and the `rest` of `[weights]` may be left
//! out; then they have the values above.

mod file;

use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::model::{Field, ModelError, PidGains, RobotModel};
use tesaki::task::grasping::{
    FINGERS, GraspPlan, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl, ObjectFrame,
    PlanField, PlannedContact,
};

use super::Wrong;
use crate::file::FileError;
use crate::finding::Finding;
use crate::robot::{invalid_setting, invalid_value};
use file::File;

/// What to do about a key that cannot be read.
const ADVICE: &str = "correct it; robots/hand3/laws/paper.toml is an example";
/// Longest time of a part of an experiment [s].
const MAX_TIME: f64 = 60.0;

/// A law of a hand, and the experiments with it.
#[derive(Clone, Debug, PartialEq)]
pub struct HandLaw {
    /// What it is called in figures.
    pub title: String,
    /// The joint servo, and the step that its joints make.
    pub servo: ServoExperiment,
    /// The object is held with a given force.
    pub force: ForceExperiment,
    /// Weights are put on the object.
    pub weights: WeightsExperiment,
    /// The object is turned and shifted.
    pub motion: MotionExperiment,
    /// The same by joint angles.
    pub joint_control: MotionExperiment,
}

/// How a hand holds an object: what a law says of a [`GraspPlan`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectLaw {
    /// Control of the object's pose.
    pub control: ObjectControl,
    /// Estimate of the object's pose.
    pub object_frame: ObjectFrame,
    /// What the load is taken to be.
    pub load: LoadSource,
    /// Joint angles.
    pub joint_targets: JointTargets,
    /// Internal forces.
    pub internal: InternalForce,
    /// Whether the force sensors correct them.
    pub feedback: bool,
}

impl ObjectLaw {
    /// Sets `plan` to this law; contacts and limits stay.
    pub const fn apply(&self, plan: &mut GraspPlan) {
        plan.control = self.control;
        plan.object_frame = self.object_frame;
        plan.load = self.load;
        plan.joint_targets = self.joint_targets;
        plan.internal = self.internal;
        plan.feedback = self.feedback;
    }

    /// The same with another integral gain of the position [N/(m·s)]; `None` where there is no such gain.
    pub const fn with_integral(self, gain: f64) -> Option<Self> {
        let ObjectControl::Wrench(mut gains) = self.control else { return None };
        let [proportional, _] = gains.position;
        #[expect(clippy::cast_possible_truncation, reason = "gains are in single precision")]
        let integral = gain as f32;
        gains.position = [proportional, integral];
        Some(Self { control: ObjectControl::Wrench(gains), ..self })
    }
}

/// A step of all joints at once.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoExperiment {
    /// Feedback law.
    pub mode: ServoMode,
    /// Gains per inertia [1/s², 1/s³, 1/s, rad/s]; `None`: those of the robot.
    pub pid: Option<PidGains>,
    /// Whether the controller is told the nominal friction of the machine's joints; else it has that of the
    /// robot.
    pub knows_friction: bool,
    /// Distance from its target at which a joint is at fault [rad]; `None`: that of the robot.
    pub following_error: Option<f64>,
    /// Dead band at rest [rad]; `None`: that of the robot.
    pub rest_error: Option<f64>,
    /// Angle [rad].
    pub step: f64,
    /// Time up to the step back, and after it [s].
    pub duration: f64,
    /// Time at its end that counts as rest [s].
    pub evaluated: f64,
}

impl ServoExperiment {
    /// Sets gains, following error and dead band of the joints to those of the law.
    #[expect(clippy::cast_possible_truncation, reason = "the model is in single precision")]
    pub fn apply(&self, model: &mut RobotModel) {
        if let Some(error) = self.rest_error {
            model.joints.iter_mut().for_each(|joint| joint.servo.rest_error = error as f32);
        }
        if let Some(error) = self.following_error {
            model.joints.iter_mut().for_each(|joint| joint.limits.following_error = error as f32);
        }
        let Some(gains) = self.pid else { return };
        for joint in &mut model.joints {
            let inertia = joint.servo.observer.inertia;
            let PidGains { proportional, integral, derivative, cutoff } = gains;
            joint.servo.pid = PidGains {
                proportional: proportional * inertia,
                integral: integral * inertia,
                derivative: derivative * inertia,
                cutoff,
            };
        }
    }
}

/// The object is held with a given force.
#[derive(Clone, Debug, PartialEq)]
pub struct ForceExperiment {
    /// The law.
    pub law: ObjectLaw,
    /// Time [s].
    pub hold: f64,
    /// Time at its end that is evaluated [s].
    pub evaluated: f64,
    /// Coulomb frictions of the joints for the curve of the force over the friction [N·m].
    pub coulomb: Vec<f64>,
    /// Fractions of the motors' torques that reach the joints, for the curve of the force over them.
    pub efficiency: Vec<f64>,
}

/// Weights are put on the object.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightsExperiment {
    /// The law.
    pub law: ObjectLaw,
    /// The weights [kg].
    pub masses: Vec<f64>,
    /// Whether those before stay on.
    pub cumulative: bool,
    /// Time in which a weight is put on [s].
    pub ramp: f64,
    /// Time from one weight to the next [s].
    pub interval: f64,
    /// Time at its end in which the load is evaluated [s].
    pub evaluated: f64,
    /// Rest before the first weight [s].
    pub rest: f64,
    /// Where they act, in the object's frame [m].
    pub point: [f64; 3],
}

/// The object is turned about y, and then shifted along x.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionExperiment {
    /// The law.
    pub law: ObjectLaw,
    /// Each relative to the one before [rad].
    pub turns: Vec<f64>,
    /// Each relative to the one before [m].
    pub shifts: Vec<f64>,
    /// Time of each [s].
    pub duration: f64,
    /// Rest after each [s].
    pub rest: f64,
    /// Rest before the first [s].
    pub initial_rest: f64,
    /// Time from the end of a motion until its error is evaluated [s].
    pub evaluated: f64,
    /// Integral gains of the position, for the curve of the errors over them [N/(m·s)].
    pub integral: Vec<f64>,
}

/// Whether the robot is a hand that these laws are for: as many chains as a grasp has fingers.
pub fn is_for(model: &RobotModel) -> bool {
    model.chains.len() == FINGERS && model.chains.iter().all(|chain| chain.force_sensor.is_some())
}

/// The law in a file, for the robot of `model`.
///
/// # Errors
/// The file cannot be read, or what is wrong in it, by line and key.
pub fn load(path: &Path, model: &RobotModel) -> Result<HandLaw, FileError> {
    super::check_robot(path, model, is_for(model), "a hand of three fingers with force sensors")?;
    crate::file::load(path, "", |path, text| check(path, text, model))
}

/// What is wrong with `text`, the content of `path`, for the robot of `model`; the law when nothing is.
pub fn check(path: &Path, text: &str, model: &RobotModel) -> (Option<HandLaw>, Vec<Finding>) {
    super::read(path, text, ADVICE, |file: File| {
        let law = file.law();
        let wrong = law.problems(model);
        if wrong.is_empty() { Ok(law) } else { Err(wrong) }
    })
}

impl HandLaw {
    fn problems(&self, model: &RobotModel) -> Vec<Wrong> {
        let mut wrong = Vec::from_iter(Wrong::title(&self.title));
        let mut within = |section: &str, key: &str, value: f64, range, unit: &str| {
            wrong.extend(Wrong::outside(&format!("{section}.{key}"), value, range, unit));
        };
        let Self { servo, force, weights, motion, joint_control, .. } = self;
        within("servo", "step", servo.step.abs(), [0.01, 1.0], "rad");
        if let Some(error) = servo.following_error {
            within("servo", "following_error", error, [0.01, 3.0], "rad");
        }
        if let Some(error) = servo.rest_error {
            within("servo", "rest_error", error, [0.0, 0.1], "rad");
        }
        within("servo", "duration", servo.duration, [0.1, MAX_TIME], "s");
        within("servo", "evaluated", servo.evaluated, [0.01, servo.duration], "s");
        within("force", "hold", force.hold, [0.1, MAX_TIME], "s");
        within("force", "evaluated", force.evaluated, [0.01, force.hold], "s");
        within("force", "coulomb", count(&force.coulomb), [0.0, 32.0], "values");
        force.coulomb.iter().for_each(|&value| within("force", "coulomb", value, [0.0, 1.0], "N·m"));
        within("force", "efficiency", count(&force.efficiency), [0.0, 32.0], "values");
        force.efficiency.iter().for_each(|&value| within("force", "efficiency", value, [0.3, 1.0], ""));
        within("weights", "masses", count(&weights.masses), [1.0, 16.0], "values");
        weights.masses.iter().for_each(|&value| within("weights", "masses", value, [0.001, 5.0], "kg"));
        within("weights", "ramp", weights.ramp, [0.01, MAX_TIME], "s");
        within("weights", "interval", weights.interval, [weights.ramp, MAX_TIME], "s");
        within("weights", "evaluated", weights.evaluated, [0.01, weights.interval], "s");
        within("weights", "rest", weights.rest, [weights.evaluated, MAX_TIME], "s");
        weights.point.iter().for_each(|&part| within("weights", "point", part, [-0.2, 0.2], "m"));
        for (section, motion) in [("motion", motion), ("joint_control", joint_control)] {
            within(section, "turns", count(&motion.turns), [0.0, 16.0], "values");
            motion.turns.iter().for_each(|turn| within(section, "turns", turn.abs(), [0.001, 0.5], "rad"));
            within(section, "shifts", count(&motion.shifts), [0.0, 16.0], "values");
            motion.shifts.iter().for_each(|shift| within(section, "shifts", shift.abs(), [1e-4, 0.05], "m"));
            within(section, "duration", motion.duration, [0.1, MAX_TIME], "s");
            within(section, "rest", motion.rest, [0.1, MAX_TIME], "s");
            within(section, "initial_rest", motion.initial_rest, [0.1, MAX_TIME], "s");
            within(section, "evaluated", motion.evaluated, [0.01, motion.rest], "s");
            within(section, "integral", count(&motion.integral), [0.0, 32.0], "values");
            motion.integral.iter().for_each(|&gain| within(section, "integral", gain, [0.0, 1e6], "N/(m·s)"));
        }
        for (section, motion) in [("motion", motion), ("joint_control", joint_control)] {
            let key = format!("{section}.integral");
            if !motion.integral.is_empty() && motion.law.with_integral(0.0).is_none() {
                wrong.push(Wrong::new(
                    &key,
                    format!("{key}: only control = {{ wrench = … }} has such a gain"),
                ));
            }
        }
        let laws = [
            ("force", force.law),
            ("weights", weights.law),
            ("motion", motion.law),
            ("joint_control", joint_control.law),
        ];
        for (section, law) in laws {
            let mut plan = example();
            law.apply(&mut plan);
            if let Err(problem) = plan.validate() {
                let key = key_of(&problem);
                let keys = vec![format!("{section}.{key}"), format!("grasp.{key}")];
                wrong.push(Wrong { keys, message: format!("{section}: {problem}") });
            }
        }
        let mut model = model.clone();
        servo.apply(&mut model);
        if let Err(error) = model.validate() {
            wrong.push(wrong_servo(&error, &model));
        }
        wrong
    }
}

/// What the settings of the servo make wrong with the model.
fn wrong_servo(error: &ModelError, model: &RobotModel) -> Wrong {
    let key = match error.field {
        Field::LimitFollowingError | Field::CountsPerTurn => "servo.following_error",
        Field::RestError => "servo.rest_error",
        _ => "servo.pid",
    };
    let joint = error.joint.and_then(|joint| model.joints.get(usize::from(joint)));
    let message = joint.map_or_else(
        || invalid_value(error),
        |joint| format!("joint {}: {}", joint.name, invalid_setting(error, joint.servo.observer.inertia)),
    );
    Wrong::new(key, message)
}

/// How many there are.
fn count(values: &[f64]) -> f64 {
    u32::try_from(values.len()).map_or(f64::INFINITY, f64::from)
}

/// The key of what is wrong with a plan.
const fn key_of(problem: &InvalidPlan) -> &'static str {
    match problem {
        InvalidPlan::Value { field: PlanField::Gain, .. } => "control",
        InvalidPlan::Value { field: PlanField::Mass, .. } => "load",
        _ => "internal",
    }
}

/// A grasp of the paper's box, to try a law on.
fn example() -> GraspPlan {
    let contact = |x, y, normal| PlannedContact { position: [x, y, 0.0], normal: [normal, 0.0, 0.0] };
    GraspPlan {
        contacts: [contact(-0.049, 0.04, 1.0), contact(-0.049, -0.04, 1.0), contact(0.049, 0.0, -1.0)],
        clearance: 0.01,
        touch_force: 0.1,
        friction: None,
        internal: InternalForce::Normal { strength: 1.0 },
        force_limit: 9.0,
        feedback: true,
        control: ObjectControl::Differential(ServoMode::Observer),
        object_frame: ObjectFrame::Rolling,
        load: LoadSource::Measured,
        joint_targets: JointTargets::ClosedForm,
    }
}
