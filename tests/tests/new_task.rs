//! The worked example of docs/architecture.md: a complete task, run through `Io` on the arm that comes with
//! tesaki.
//!
//! Hand guiding: the weight of the arm is compensated at the measured angles, so that a person can guide it;
//! damping dissipates the energy that errors of the compensation would add.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::error::Error;
use std::f32::consts::FRAC_PI_2;
use std::fmt;

use tesaki::control::JointPoint;
use tesaki::fault::FaultCause;
use tesaki::model::{MAX_CHAIN_JOINTS, MAX_JOINTS};
use tesaki::robot::{
    Actuation, Concerns, Efforts, JointSetpoint, JointTarget, Measured, Postures, Robot, Targets,
};
use tesaki::task::{Io, Task, TaskFault};

// The task, as it would stand in shared/src/task/hand_guiding.rs.

/// Settings of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
struct GuidingSettings {
    /// Damping torque per velocity [N·m·s/rad].
    damping: f32,
    /// Velocity above which a joint causes a fault [rad/s].
    speed_limit: f32,
}

/// Commands while the task runs.
enum GuidingCommand {
    /// 0: sets the damping [N·m·s/rad].
    SetDamping(f32),
}

/// Reasons why settings or a command were refused.
#[derive(Clone, Copy, Debug, PartialEq)]
enum GuidingRefusal {
    /// 0: the damping is negative or not finite.
    Damping { value: f32 },
    /// 1: the speed limit is not positive.
    SpeedLimit { value: f32 },
}

impl Concerns for GuidingRefusal {}

impl Error for GuidingRefusal {}

impl fmt::Display for GuidingRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damping { value } => {
                write!(f, "the damping is {value} N·m·s/rad; it must be finite and ≥ 0")
            }
            Self::SpeedLimit { value } => write!(f, "the speed limit is {value} rad/s; it must be positive"),
        }
    }
}

/// The task. Its whole state consists of its settings and the torques of the last tick.
struct HandGuiding {
    settings: GuidingSettings,
    weight: [f32; MAX_JOINTS],
}

impl Task for HandGuiding {
    type Config = GuidingSettings;
    type Command = GuidingCommand;
    type Telemetry = [f32; MAX_JOINTS];
    type Refusal = GuidingRefusal;
    const IDLE: Self =
        Self { settings: GuidingSettings { damping: 0.0, speed_limit: 0.0 }, weight: [0.0; MAX_JOINTS] };

    fn check(_: &Robot, _: &Measured, settings: &GuidingSettings) -> Result<(), GuidingRefusal> {
        if settings.speed_limit.is_nan() || settings.speed_limit <= 0.0 {
            return Err(GuidingRefusal::SpeedLimit { value: settings.speed_limit });
        }
        check_damping(settings.damping)
    }

    fn begin(&mut self, _: Io<'_>, settings: &GuidingSettings) {
        self.settings = *settings;
    }

    fn command(&mut self, _: Io<'_>, command: &GuidingCommand) -> Result<(), GuidingRefusal> {
        let GuidingCommand::SetDamping(damping) = *command;
        check_damping(damping)?;
        self.settings.damping = damping;
        Ok(())
    }

    fn tick(&mut self, io: Io<'_>) -> Result<(), TaskFault> {
        let GuidingSettings { damping, speed_limit: limit } = self.settings;
        let joints = 0..io.robot.joints().len();
        for (joint, velocity) in (0..).zip(io.measured.velocities(joints)) {
            if velocity.abs() > limit {
                let cause = FaultCause::VelocityLimit;
                return Err(TaskFault { cause, joint: Some(joint), value: velocity.abs(), limit });
            }
        }
        for config in io.robot.chains() {
            let angles = io.measured.angles(config.joints());
            let (still, mut torques) = ([0.0; MAX_CHAIN_JOINTS], [0.0; MAX_CHAIN_JOINTS]);
            config.chain.inverse_dynamics(io.robot.gravity(), angles, &still, &still, &mut torques);
            self.weight.iter_mut().skip(config.joints().start).zip(torques).for_each(|(to, from)| *to = from);
        }
        // The reference follows the joint, so that after a fault the joint stays in place.
        let joints = io.targets.joints.iter_mut().zip(&io.measured.positions).zip(&self.weight);
        for ((target, &angle), &feedforward) in joints {
            *target = JointTarget { feedforward, ..JointTarget::at(angle) };
        }
        io.targets.actuation = Actuation::Torque { damping, compensated: false };
        Ok(())
    }

    fn telemetry(&self, _: &Robot, _: &Measured, _: &Postures) -> [f32; MAX_JOINTS] {
        self.weight
    }
}

fn check_damping(value: f32) -> Result<(), GuidingRefusal> {
    if value.is_finite() && value >= 0.0 { Ok(()) } else { Err(GuidingRefusal::Damping { value }) }
}

// Its tests.

const SETTINGS: GuidingSettings = GuidingSettings { damping: 0.3, speed_limit: 2.0 };

/// The arm, with the memory that a node has around the task.
struct Rig {
    robot: Box<Robot>,
    measured: Measured,
    targets: Targets,
}

/// Drives that match the model.
#[derive(Debug)]
struct NoEfforts;

impl Efforts for NoEfforts {
    fn effort(&self, _: usize) -> f32 {
        0.0
    }
}

impl Rig {
    fn new(angles: [f32; 7]) -> Self {
        let mut robot = Box::new(Robot::NONE);
        robot.configure(&tesaki_tests::robot("arm7").model).unwrap();
        let mut measured = Measured::NONE;
        measured.positions[..7].copy_from_slice(&angles);
        Self { robot, measured, targets: Targets::NONE }
    }

    fn io(&mut self) -> Io<'_> {
        const REST: [JointPoint; MAX_JOINTS] =
            [JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 }; MAX_JOINTS];
        Io {
            robot: &self.robot,
            measured: &self.measured,
            postures: &Postures::NONE,
            efforts: &NoEfforts,
            references: &REST,
            targets: &mut self.targets,
        }
    }

    /// Returns the task after one tick.
    fn ticked(&mut self) -> HandGuiding {
        let mut task = HandGuiding::IDLE;
        HandGuiding::check(&self.robot, &self.measured, &SETTINGS).unwrap();
        task.begin(self.io(), &SETTINGS);
        task.tick(self.io()).unwrap();
        task
    }
}

/// Masses [kg] and distances of their centres [m], from the shoulder along the upper arm, and from the elbow
/// on.
const UPPER_ARM: [(f32, f32); 1] = [(1.5, 0.150)];
const BEYOND_ELBOW: [(f32, f32); 5] = [(0.9, 0.090), (0.4, 0.220), (0.2, 0.260), (0.5, 0.305), (0.1, 0.3525)];
const GRAVITY: f32 = 9.81;

fn moment(masses: &[(f32, f32)], distance: f32) -> f32 {
    masses.iter().map(|(mass, lever)| mass * (lever + distance) * GRAVITY).sum()
}

#[track_caller]
fn assert_torques(targets: &Targets, expected: [f32; 7]) {
    let torques = targets.joints.iter().map(|target| target.feedforward);
    for (joint, (torque, expected)) in torques.zip(expected).enumerate() {
        assert!((torque - expected).abs() < 1e-4, "joint {joint}: {torque} N·m, expected {expected}");
    }
}

#[test]
fn the_weight_of_a_bent_arm_is_that_worked_by_hand() {
    let mut rig = Rig::new([0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0]);
    let task = rig.ticked();
    // The forearm is horizontal and points forward; the upper arm hangs straight down from the shoulder: 4.01
    // N·m.
    let forearm = moment(&BEYOND_ELBOW, 0.0);
    assert!((forearm - 4.0098).abs() < 1e-3);
    let hand = GRAVITY * (0.5 * 0.045 + 0.1 * 0.0925);
    let expected = [forearm, 0.0, 0.0, forearm, 0.0, hand, 0.0];
    assert_torques(&rig.targets, expected);
    assert_eq!(rig.targets.actuation, Actuation::Torque { damping: 0.3, compensated: false });
    assert_eq!(rig.targets.joints[3].setpoint, JointSetpoint::Goal(FRAC_PI_2));
    let telemetry = task.telemetry(&rig.robot, &rig.measured, &Postures::NONE);
    assert!((telemetry[3] - forearm).abs() < 1e-4);
}

#[test]
fn the_weight_follows_the_measured_angles() {
    let mut rig = Rig::new([FRAC_PI_2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    rig.ticked();
    // Stretched out forward: 12.4 N·m in the shoulder, as in robots/arm7/README.md.
    let forearm = moment(&BEYOND_ELBOW, 0.0);
    let shoulder = moment(&UPPER_ARM, 0.0) + moment(&BEYOND_ELBOW, 0.300);
    assert!((shoulder - 12.397).abs() < 1e-3);
    let hand = GRAVITY * (0.5 * 0.045 + 0.1 * 0.0925);
    assert_torques(&rig.targets, [shoulder, 0.0, 0.0, forearm, 0.0, hand, 0.0]);
}

#[test]
fn a_command_changes_the_damping_and_a_bad_one_nothing() {
    let mut rig = Rig::new([0.0; 7]);
    let mut task = rig.ticked();
    task.command(rig.io(), &GuidingCommand::SetDamping(0.5)).unwrap();
    let refusal = task.command(rig.io(), &GuidingCommand::SetDamping(-1.0)).unwrap_err();
    assert_eq!(refusal.to_string(), "the damping is -1 N·m·s/rad; it must be finite and ≥ 0");
    assert_eq!((refusal.joint(), refusal.chain()), (None, None));
    task.tick(rig.io()).unwrap();
    assert_eq!(rig.targets.actuation, Actuation::Torque { damping: 0.5, compensated: false });
    let check = |settings| HandGuiding::check(&rig.robot, &rig.measured, &settings);
    let refused = check(GuidingSettings { speed_limit: 0.0, ..SETTINGS });
    assert_eq!(refused, Err(GuidingRefusal::SpeedLimit { value: 0.0 }));
    assert!(check(GuidingSettings { damping: f32::INFINITY, ..SETTINGS }).is_err());
}

#[test]
fn a_joint_that_is_too_fast_is_a_fault_with_joint_value_and_limit() {
    let mut rig = Rig::new([0.0; 7]);
    let mut task = rig.ticked();
    rig.measured.velocities[4] = -2.5;
    let cause = FaultCause::VelocityLimit;
    let fault = TaskFault { cause, joint: Some(4), value: 2.5, limit: 2.0 };
    assert_eq!(task.tick(rig.io()), Err(fault));
}
