//! Common parts of the impedance-control scenarios: rig, trial and log.

use std::ops::Range;

use rapier3d::na::{Isometry3, UnitQuaternion, Vector3};
use tesaki::control::Impedance;
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::model::{JointModel, RobotModel};
use tesaki::task::TaskConfig;
use tesaki::task::impedance::{ForceSource, ImpedanceSettings, ImpedanceTelemetry, Law, Redundancy};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::Board;
use tesaki_supervisor::trajectory::minimum_jerk;

use super::common::{T, during, home, introduce, largest, request_error};
use super::{ScenarioError, Setting};
use crate::controller::{Controller, Watched};
use crate::motion::Motion;
use crate::plant::{
    Drive, Plant, PlantOptions, PlantValues, SharedIntervention, TipTruth, isometry, unit_quaternion,
};
use crate::report::Table;

/// Time from power-on to the tare of the force sensor [s].
const REST: f64 = 0.5;
/// Time from homing until a force sensor can be tared [s].
const HOMED: f64 = 1.0;
/// Lengths of robots/arm7 [m].
pub const UPPER_ARM: f64 = 0.30;
pub const FOREARM: f64 = 0.26;
pub const HAND: f64 = 0.10;
/// The joint that follows the operator's elbow: shoulder yaw.
pub const YAW: u8 = 2;
/// Coulomb friction of runs without mismatch [N·m]: less than 0.1 N at the tool.
const LOW_FRICTION: f64 = 0.02;

/// Impedance control with the paper's translational impedance (Arm7, section 3.1).
pub const fn settings(damping: f32) -> ImpedanceSettings {
    ImpedanceSettings {
        impedance: impedance(1.5, damping, 300.0),
        law: Law::ModelFollowing,
        redundancy: Redundancy::DrivenJoint { joint: YAW },
        elbow_bandwidth: 12.0,
        force: ForceSource::Sensor,
        contact_force: 1.5,
        max_deviation: [0.3, 1.5],
    }
}

/// The same impedance along x, y and z.
pub const fn impedance(mass: f32, damping: f32, stiffness: f32) -> Impedance {
    /// Rotational mass [kg·m²], damping [N·m·s/rad] and stiffness [N·m/rad].
    const ROTATION: [f32; 3] = [0.008, 0.5, 16.0];
    let [m, b, k] = ROTATION;
    Impedance::diagonal(
        [mass, mass, mass, m, m, m],
        [damping, damping, damping, b, b, b],
        [stiffness, stiffness, stiffness, k, k, k],
    )
}

/// A minimum-jerk motion of a value within `duration` [s]: value, rate and acceleration at a time since its
/// begin [s].
pub fn motion([from, to]: [f64; 2], time: f64, duration: f64) -> [f64; 3] {
    let [fraction, rate, curvature] = minimum_jerk(time / duration);
    let change = to - from;
    [from + change * fraction, change * rate / duration, change * curvature / (duration * duration)]
}

/// The pose of a set-point.
pub fn pose(point: &PosePoint) -> Isometry3<f64> {
    isometry(point.position.map(f64::from), point.rotation.map(f64::from))
}

/// Adds such a motion of a coordinate to a set-point.
pub fn shift(point: &mut PosePoint, axis: usize, [value, rate, acceleration]: [f64; 3]) {
    point.position[axis] += value as f32;
    point.velocity[axis] = rate as f32;
    point.acceleration[axis] = acceleration as f32;
}

/// A redundancy resolution under test.
pub struct ElbowTrial {
    pub name: &'static str,
    pub label: &'static str,
    pub redundancy: Redundancy,
}

/// The paper's redundancy resolution, and one by all seven joints.
pub const ELBOW_TRIALS: [ElbowTrial; 2] = [
    ElbowTrial { name: "yaw", label: "shoulder yaw", redundancy: Redundancy::DrivenJoint { joint: YAW } },
    ElbowTrial { name: "arm_angle", label: "arm angle", redundancy: Redundancy::ArmAngle },
];

/// How the machine differs from the controller's model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Machine {
    /// Not at all; low friction, known to the controller.
    Matched,
    /// By seeded factors.
    Mismatched,
    /// By seeded factors, and with the friction that the paper's errors imply.
    PaperFriction,
    /// The same machine; the controller's model has that friction, without the factors.
    KnownPaperFriction,
}

/// Whether a robot has the geometry of robots/arm7, which some scenarios know.
pub fn is_arm7(model: &RobotModel) -> bool {
    /// Height of each joint above the one before it [m], and its axis.
    const JOINTS: [(f32, [f32; 3]); 7] = [
        (0.0, [0.0, -1.0, 0.0]),
        (0.0, [-1.0, 0.0, 0.0]),
        (0.0, [0.0, 0.0, 1.0]),
        (-UPPER_ARM as f32, [0.0, -1.0, 0.0]),
        (-FOREARM as f32, [0.0, 0.0, 1.0]),
        (0.0, [0.0, -1.0, 0.0]),
        (0.0, [1.0, 0.0, 0.0]),
    ];
    let is_same = |(joint, (height, axis)): (&JointModel, (f32, [f32; 3]))| {
        let [x, y, z] = joint.origin.translation;
        let values = [x, y, z - height].into_iter().chain(joint.origin.rotation[..3].iter().copied());
        let turns = joint.axis.iter().zip(axis).map(|(one, other)| one - other);
        values.chain(turns).all(|value| value.abs() < 1e-4)
    };
    let [chain] = model.chains.as_slice() else { return false };
    let [x, y, z] = chain.tip.translation;
    let same_hand = [x, y, z + HAND as f32].iter().all(|value| value.abs() < 1e-4);
    same_hand && model.joints.len() == JOINTS.len() && model.joints.iter().zip(JOINTS).all(is_same)
}

/// Robot, plant values and recording that all trials of a scenario share.
pub struct ArmRig {
    pub robot: RobotFolder,
    pub values: PlantValues,
    pub motion: Motion,
    seed: u64,
    intervention: Option<SharedIntervention>,
}

impl ArmRig {
    /// Reads the robot's folder.
    pub fn load(setting: &Setting<'_, '_>) -> Result<Self, ScenarioError> {
        let robot = RobotFolder::load(setting.robot)?;
        let motion = setting.motion(&robot.model);
        let (seed, intervention) = (setting.seed, setting.intervention.clone());
        Ok(Self { values: PlantValues::load(setting.robot)?, robot, motion, seed, intervention })
    }

    /// The controller's model, and the machine.
    fn build(&self, machine: Machine) -> Result<(RobotModel, Plant), ScenarioError> {
        let mut model = self.robot.model.clone();
        let mut values = self.values.clone();
        let mut options = PlantOptions::mismatched(self.seed);
        match machine {
            Machine::Matched => {
                values.mismatch.homing_error = 0.0;
                (options.mismatch, options.coulomb) = (false, Some(LOW_FRICTION));
                model.joints.iter_mut().for_each(|joint| joint.friction.coulomb = LOW_FRICTION as f32);
            }
            Machine::Mismatched => {}
            Machine::PaperFriction => options.coulomb = Some(self.values.friction.paper),
            Machine::KnownPaperFriction => {
                let coulomb = self.values.friction.paper;
                options.coulomb = Some(coulomb);
                model.joints.iter_mut().for_each(|joint| joint.friction.coulomb = coulomb as f32);
            }
        }
        let drives: Vec<Drive> = model.joints.iter().map(Drive::from).collect();
        let plant = Plant::new(&self.robot.urdf, &drives, &values, &options)?;
        Ok((model, plant.under(self.intervention.clone())))
    }
}

/// The true state at the start of a control period, and the controller's targets.
#[derive(Clone, Debug)]
pub struct ArmSample {
    /// Time since the controller was enabled [s].
    pub time: f64,
    pub tool: TipTruth,
    /// Joint angles [rad].
    pub joints: Vec<f64>,
    /// Motor torques [N·m].
    pub torques: Vec<f64>,
    /// Target position of the tool [m].
    pub target: Vector3<f64>,
    /// Target angle of the elbow [rad].
    pub elbow: f64,
}

impl ArmSample {
    pub fn position(&self) -> Vector3<f64> {
        self.tool.position.into()
    }

    pub fn orientation(&self) -> UnitQuaternion<f64> {
        unit_quaternion(self.tool.orientation)
    }
}

/// One sample per tick.
#[derive(Clone, Debug, Default)]
pub struct ArmLog(pub Vec<ArmSample>);

impl ArmLog {
    /// Time of the next sample [s].
    pub fn now(&self) -> f64 {
        self.0.len() as f64 * T
    }

    /// The samples of a time span [s]; empty if it was not recorded to its end.
    pub fn during(&self, span: &Range<f64>) -> &[ArmSample] {
        during(&self.0, span)
    }

    /// The maximum of a value in a time span; NaN if it was not recorded to its end.
    pub fn largest(&self, span: &Range<f64>, value: impl Fn(&ArmSample) -> f64) -> f64 {
        largest(self.during(span).iter().map(value))
    }

    /// As CSV.
    pub fn table(&self) -> String {
        let mut table = Table::new(&self.0);
        table.column("time", "s", |sample| sample.time);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            table
                .column(format!("tool {name}"), "m", |sample| sample.tool.position[axis])
                .column(format!("set-point {name}"), "m", |sample| sample.target[axis])
                .column(format!("force {name}"), "N", |sample| sample.tool.force[axis]);
        }
        table.column("set-point elbow", "rad", |sample| sample.elbow);
        for joint in 0..self.0.first().map_or(0, |sample| sample.joints.len()) {
            table.column(format!("angle {}", joint + 1), "rad", |sample| sample.joints[joint]).column(
                format!("torque {}", joint + 1),
                "N·m",
                |sample| sample.torques[joint],
            );
        }
        table.csv()
    }
}

/// A trial with one arm, from power-on to switching off.
pub struct ArmTrial<'a, 'b> {
    pub controller: &'a mut Watched<'b>,
    rig: &'a mut ArmRig,
    model: RobotModel,
    label: String,
    progress: &'a dyn Fn(f64),
    duration: f64,
    pub plant: Plant,
    pub log: ArmLog,
    target: PosePoint,
    elbow: ElbowSetpoint,
    enabled: bool,
}

impl<'a, 'b> ArmTrial<'a, 'b> {
    /// Tares and enables; the target is the current pose.
    pub fn begin(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut ArmRig,
        label: &str,
        machine: Machine,
        settings: ImpedanceSettings,
    ) -> Result<Self, ScenarioError> {
        let (model, plant) = rig.build(machine)?;
        rig.motion.note(label);
        let target = PosePoint {
            position: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            velocity: [0.0; 6],
            acceleration: [0.0; 6],
        };
        let mut arm_trial = Self {
            controller: &mut *setting.controller,
            rig,
            model,
            label: label.to_owned(),
            progress: setting.progress,
            duration: setting.duration,
            plant,
            log: ArmLog::default(),
            target,
            elbow: ElbowSetpoint::default(),
            enabled: false,
        };
        introduce(arm_trial.controller, &arm_trial.model)?;
        if arm_trial.model.joints.iter().any(|joint| joint.encoder.relative) {
            arm_trial.tick()?;
            home(arm_trial.controller, &arm_trial.plant)?;
            arm_trial.wait(HOMED)?;
        }
        arm_trial.wait(REST)?;
        arm_trial.controller.tare()?;
        arm_trial.controller.enable(TaskConfig::Impedance(settings))?;
        let tool = arm_trial.controller.read_impedance()?;
        (arm_trial.target.position, arm_trial.target.rotation) = (tool.position, tool.rotation);
        arm_trial.elbow.angle = tool.elbow;
        (arm_trial.enabled, arm_trial.log) = (true, ArmLog::default());
        arm_trial.tick()?;
        Ok(arm_trial)
    }

    /// Set-points at the start: the pose of the tool and the elbow angle when the arm was enabled.
    pub fn start(&self) -> (PosePoint, ElbowSetpoint) {
        (self.target, self.elbow)
    }

    /// Reads the controller's telemetry.
    pub fn telemetry(&mut self) -> Result<ImpedanceTelemetry, ScenarioError> {
        Ok(self.controller.read_impedance()?)
    }

    /// One control period with new set-points of tool and elbow.
    pub fn follow(&mut self, point: PosePoint, elbow: ElbowSetpoint) -> Result<(), ScenarioError> {
        self.controller.set_target(point, elbow)?;
        (self.target, self.elbow) = (point, elbow);
        self.tick()
    }

    /// Follows set-points for `duration` [s], which `setpoint` gives for the time since now [s].
    pub fn follow_path(
        &mut self,
        duration: f64,
        setpoint: impl Fn(f64) -> (PosePoint, ElbowSetpoint),
    ) -> Result<(), ScenarioError> {
        for tick in 1..=(duration / T).round() as usize {
            let (point, elbow) = setpoint(tick as f64 * T);
            self.follow(point, elbow)?;
        }
        Ok(())
    }

    /// One control period.
    pub fn tick(&mut self) -> Result<(), ScenarioError> {
        let truth = self.plant.truth();
        let sequence = self.rig.motion.tick(&truth);
        self.rig.motion.forces(&self.plant);
        if let (true, Some(tool)) = (self.enabled, self.plant.tips().into_iter().next()) {
            self.log.0.push(ArmSample {
                time: self.log.now(),
                tool,
                joints: truth.positions,
                torques: truth.torques,
                target: Vector3::from(self.target.position).map(f64::from),
                elbow: f64::from(self.elbow.angle),
            });
        }
        let actuators = self.controller.tick(&self.plant.sensors(sequence))?;
        self.plant.apply(&actuators)?;
        if self.enabled
            && let Err(error) = self.controller.keep()
        {
            let time = self.log.now();
            return Err(request_error(self.controller, &self.model, &self.label, time, error));
        }
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }

    /// Simulates for a time [s].
    pub fn wait(&mut self, time: f64) -> Result<(), ScenarioError> {
        for _ in 0..(time / T).round() as usize {
            self.tick()?;
        }
        Ok(())
    }

    /// As [`end`](Self::end), without the sample at the start: with those at the ends of all control periods
    /// since.
    pub fn end_without_start(self) -> Result<Vec<ArmSample>, ScenarioError> {
        Ok(self.end()?.0.into_iter().skip(1).collect())
    }

    /// Switches the arm off and returns the log.
    pub fn end(self) -> Result<ArmLog, ScenarioError> {
        self.controller.disable()?;
        Ok(self.log)
    }
}
