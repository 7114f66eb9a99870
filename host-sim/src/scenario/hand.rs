//! Common parts of the scenarios of telexistence: the operator's hand, a trial with the robot's hand, and its
//! log.

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::fault::{Fault, FaultCause};
use tesaki::kinematics::{Angles, Hand};
use tesaki::protocol::Refusal;
use tesaki::task::TaskConfig;
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceSettings, TelexistenceTelemetry,
};
use tesaki::teleop::{HUMAN_FINGERS, HumanFinger};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::{Board, BoardError};

use super::common::{T, during, home, introduce, largest, request_error, tick};
use super::{ScenarioError, Setting};
use crate::controller::Watched;
use crate::motion::Motion;
use crate::operator::{FingersMotion, OperatorHand};
use crate::plant::{Plant, PlantOptions, SharedIntervention, Truth};
use crate::report::{Line, Panel, Table};

/// Positions of five fingertips, thumb to little finger [m].
pub type Fingertips = [Vector3<f64>; HUMAN_FINGERS];

/// A vector of the operator's hand (x distal, y to the thumb, z dorsal) in the frame of the robot's (x
/// palmar, y to the thumb, z distal).
pub fn in_robot_frame(vector: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-vector.z, vector.y, vector.x)
}

/// A person who takes the posture of the robot's hand, and from there moves the fingers half-way to random
/// postures: farther, the tips are out of the robot's reach.
pub fn imitator(hand: &OperatorHand, robot: &Fingertips, motion: FingersMotion) -> FingersMotion {
    motion.around(hand.imitate(&robot.map(|tip| Vector3::new(tip.z, tip.y, -tip.x))), 0.5)
}

/// The fingertips of the robot's hand at these joint angles.
pub fn robot_fingertips(hand: &Hand, angles: &Angles) -> Fingertips {
    std::array::from_fn(|finger| {
        let Some((tip, _)) = hand.tip(finger, angles) else { return Vector3::repeat(f64::NAN) };
        Vector3::from(<[f32; 3]>::from(tip).map(f64::from))
    })
}

/// True fingertips of a person, in the frame of the robot's hand.
pub fn human_fingertips(hand: &OperatorHand, motion: &FingersMotion, time: f64) -> Fingertips {
    let (_, angles) = motion.at(time);
    std::array::from_fn(|finger| in_robot_frame(hand.finger(HumanFinger::ALL[finger], &angles[finger]).1))
}

/// A sample of fingertips whose motion is known exactly.
pub fn exact_sample(number: u16, time: f64, tips: &dyn Fn(f64) -> Fingertips) -> FingertipSample {
    const STEP: f64 = 1e-4;
    let (here, before, after) = (tips(time), tips(time - STEP), tips(time + STEP));
    let point = |finger: usize| FingertipPoint {
        position: single(here[finger]),
        velocity: single((after[finger] - before[finger]) / (2.0 * STEP)),
        direction: None,
    };
    FingertipSample { number, age: 0.0, tips: std::array::from_fn(|finger| Some(point(finger))) }
}

/// In single precision.
pub fn single(vector: Vector3<f64>) -> [f32; 3] {
    vector.map(|value| value as f32).into()
}

/// Whether a board refuses to enable joints because they seem to move.
fn is_too_fast(error: &BoardError) -> bool {
    matches!(
        error,
        BoardError::Refused { refusal: Refusal::Unsafe(Fault { cause: FaultCause::VelocityLimit, .. }), .. }
    )
}

/// Ticks after which the board has no velocity left of a machine that was replaced by one at rest.
const MOTION_FORGOTTEN: u32 = 20;

/// Robot and recording that all trials of a scenario share.
pub struct HandRig {
    pub robot: RobotFolder,
    pub hand: Hand,
    pub motion: Motion,
    seed: u64,
    intervention: Option<SharedIntervention>,
}

impl HandRig {
    /// Reads the robot's folder.
    pub fn load(setting: &Setting<'_, '_>) -> Result<Self, ScenarioError> {
        let robot = RobotFolder::load(setting.robot)?;
        let hand =
            Hand::of_model(&robot.model, [0.0, 0.0, 1.0], 0.0).map_err(|error| setting.other_robot(error))?;
        let motion = setting.motion(&robot.model);
        let (seed, intervention) = (setting.seed, setting.intervention.clone());
        Ok(Self { hand, motion, robot, seed, intervention })
    }
}

/// The state at the start of a control period.
#[derive(Clone, Debug)]
pub struct HandSample {
    /// Time since the task began [s].
    pub time: f64,
    /// True fingertips of the operator.
    pub operator: Fingertips,
    /// True fingertips of the robot.
    pub robot: Fingertips,
    /// What the board says.
    pub board: TelexistenceTelemetry,
    /// True joint angles [rad].
    pub joints: Vec<f64>,
    /// Largest true speed of a joint, relative to its limit.
    pub speed: f64,
}

impl HandSample {
    /// From the thumb's tip to that of a finger, of the robot and of the operator [m].
    pub fn vectors(&self, finger: usize) -> [Vector3<f64>; 2] {
        [&self.robot, &self.operator].map(|tips| tips[finger] - tips[0])
    }

    /// Error of a finger's vector [mm].
    pub fn error(&self, finger: usize) -> f64 {
        let [robot, operator] = self.vectors(finger);
        1e3 * (robot - operator).norm()
    }

    /// How far the board itself says that a finger is from its target [mm].
    pub fn stated_error(&self, finger: usize) -> f64 {
        1e3 * f64::from(self.board.errors[finger])
    }
}

/// One sample a tick.
#[derive(Clone, Debug, Default)]
pub struct HandLog(pub Vec<HandSample>);

impl HandLog {
    /// The samples of a time span [s]; empty if it was not recorded to its end.
    pub fn during(&self, span: &Range<f64>) -> &[HandSample] {
        during(&self.0, span)
    }

    /// Root mean square of a value in a time span.
    pub fn rms(&self, span: &Range<f64>, value: impl Fn(&HandSample) -> f64) -> f64 {
        let samples = self.during(span);
        let sum: f64 = samples.iter().map(|sample| value(sample).powi(2)).sum();
        (sum / samples.len() as f64).sqrt()
    }

    /// Maximum of a value in a time span; NaN if it was not recorded to its end.
    pub fn largest(&self, span: &Range<f64>, value: impl Fn(&HandSample) -> f64) -> f64 {
        largest(self.during(span).iter().map(value))
    }

    /// Share of the samples of a time span [%].
    pub fn share(&self, span: &Range<f64>, of: impl Fn(&HandSample) -> bool) -> f64 {
        let samples = self.during(span);
        100.0 * samples.iter().filter(|sample| of(sample)).count() as f64 / samples.len() as f64
    }

    /// Mean and standard deviation of the errors of a finger's vector: of length [mm] and direction [°].
    pub fn vector_errors(&self, span: &Range<f64>, finger: usize) -> [[f64; 2]; 2] {
        vector_errors(self.during(span).iter().map(|sample| sample.vectors(finger)))
    }

    /// The displacement of the thumb's tip from its place at the start of a time span, robot minus operator
    /// [mm].
    pub fn thumb_error(&self, span: &Range<f64>) -> f64 {
        let Some(first) = self.during(span).first() else { return f64::NAN };
        let offset = first.robot[0] - first.operator[0];
        self.rms(span, |sample| 1e3 * (sample.robot[0] - sample.operator[0] - offset).norm())
    }

    /// As CSV.
    pub fn table(&self) -> String {
        let mut table = Table::new(&self.0);
        table.column("time", "s", |sample| sample.time);
        for (finger, name) in HumanFinger::ALL.iter().map(|finger| finger.name()).enumerate() {
            for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
                table
                    .column(format!("operator {name} {letter}"), "m", |sample| sample.operator[finger][axis])
                    .column(format!("robot {name} {letter}"), "m", |sample| sample.robot[finger][axis]);
            }
        }
        for joint in 0..self.0.first().map_or(0, |sample| sample.joints.len()) {
            table.column(format!("angle {}", joint + 1), "rad", |sample| sample.joints[joint]);
        }
        table.csv()
    }

    /// Errors of the vectors over time.
    pub fn error_panel(&self) -> Panel {
        let time: Vec<f64> = self.0.iter().map(|sample| sample.time).collect();
        (1..HUMAN_FINGERS).fold(Panel::new("Vectors from the thumb's tip", "error", "mm"), |panel, finger| {
            let errors = self.0.iter().map(|sample| sample.error(finger)).collect();
            panel.line(Line::solid(HumanFinger::ALL[finger].to_string(), finger - 1, time.clone(), errors))
        })
    }
}

/// Mean and standard deviation of the errors of vectors, estimated and true, at least 25 mm long: of length
/// [mm] and direction [°].
pub fn vector_errors(pairs: impl Iterator<Item = [Vector3<f64>; 2]> + Clone) -> [[f64; 2]; 2] {
    let error = crate::operator::calibration_trial::VectorError::of(pairs);
    [error.length.map(|value| 1e3 * value), error.direction.map(f64::to_degrees)]
}

/// A path in the x-z plane of the robot's hand, the one in which fingers bend: found, and true [mm].
pub fn path_panel(
    title: &str,
    names: [&str; 2],
    found: impl Iterator<Item = Vector3<f64>>,
    truth: impl Iterator<Item = Vector3<f64>>,
) -> Panel {
    let unzip = |points: &mut dyn Iterator<Item = Vector3<f64>>| -> (Vec<f64>, Vec<f64>) {
        points.map(|point| (1e3 * point.x, 1e3 * point.z)).unzip()
    };
    let mut found = found;
    let mut truth = truth;
    let ((x, z), (true_x, true_z)) = (unzip(&mut found), unzip(&mut truth));
    Panel::new(title, "z", "mm").line(Line::solid(names[0], 0, x, z)).line(Line::dashed(
        names[1],
        Line::INK,
        true_x,
        true_z,
    ))
}

/// A trial with the robot's hand, from power-on to switching off.
pub struct HandTrial<'a, 'b> {
    controller: &'a mut Watched<'b>,
    rig: &'a mut HandRig,
    progress: &'a dyn Fn(f64),
    duration: f64,
    label: String,
    plant: Plant,
    log: HandLog,
}

impl<'a, 'b> HandTrial<'a, 'b> {
    /// Homes the hand on a machine that differs from the model, and enables the task.
    pub fn begin(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut HandRig,
        label: &str,
        settings: &TelexistenceSettings,
    ) -> Result<Self, ScenarioError> {
        let plant = Plant::of(&rig.robot, &PlantOptions::mismatched(rig.seed))?;
        let plant = plant.under(rig.intervention.clone());
        rig.motion.note(label);
        let (controller, progress, duration) = (&mut *setting.controller, setting.progress, setting.duration);
        let label = label.to_owned();
        let mut trial = Self { controller, rig, progress, duration, label, plant, log: HandLog::default() };
        introduce(trial.controller, &trial.rig.robot.model)?;
        trial.step()?;
        home(trial.controller, &trial.plant)?;
        trial.step()?;
        let enable = |trial: &mut Self| trial.controller.enable(TaskConfig::Telexistence(*settings));
        let mut enabled = enable(&mut trial);
        // To the board this is the machine of the trial before, which may have moved at its end.
        for _ in 0..MOTION_FORGOTTEN {
            if !enabled.as_ref().is_err_and(is_too_fast) {
                break;
            }
            trial.step()?;
            enabled = enable(&mut trial);
        }
        enabled?;
        Ok(trial)
    }

    /// The joint angles that homing believes [rad].
    pub fn start(&self) -> Angles {
        let mut angles = Angles::zeros();
        for (angle, homed) in angles.iter_mut().zip(self.plant.homed_positions()) {
            *angle = homed as f32;
        }
        angles
    }

    /// Time since the task began [s].
    pub fn now(&self) -> f64 {
        self.log.0.len() as f64 * T
    }

    /// One control period in which samples arrive, with the operator's true fingertips.
    pub fn tick(
        &mut self,
        samples: impl IntoIterator<Item = FingertipSample>,
        operator: Fingertips,
    ) -> Result<(), ScenarioError> {
        let time = self.now();
        for sample in samples {
            self.in_time(time, |controller| controller.follow_fingertips(sample))?;
        }
        self.in_time(time, Board::keep)?;
        let tips: Vec<Vector3<f64>> = self.plant.tips().iter().map(|tip| tip.position.into()).collect();
        let robot =
            std::array::from_fn(|finger| tips.get(finger).copied().unwrap_or(Vector3::repeat(f64::NAN)));
        let Truth { positions: joints, velocities, .. } = self.plant.truth();
        let limits = self.rig.robot.model.joints.iter().map(|joint| f64::from(joint.limits.velocity));
        let speed = largest(velocities.iter().zip(limits).map(|(speed, limit)| speed.abs() / limit));
        self.step()?;
        let board = self.controller.read_telexistence()?;
        self.log.0.push(HandSample { time, operator, robot, board, joints, speed });
        Ok(())
    }

    /// A request; when it is refused, the fault that is the reason.
    fn in_time(
        &mut self,
        time: f64,
        request: impl FnOnce(&mut Watched<'b>) -> Result<(), BoardError>,
    ) -> Result<(), ScenarioError> {
        request(self.controller)
            .map_err(|error| request_error(self.controller, &self.rig.robot.model, &self.label, time, error))
    }

    fn step(&mut self) -> Result<(), ScenarioError> {
        let sequence = tick(self.controller, &mut self.plant, &mut self.rig.motion)?;
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }

    /// Switches the hand off and returns the log.
    pub fn end(self) -> Result<HandLog, ScenarioError> {
        self.controller.disable()?;
        Ok(self.log)
    }
}
