//! An arm of seven joints, settings, and postures.

use core::f32::consts::FRAC_PI_2;

use heapless::Vec;
use nalgebra::{UnitQuaternion, Vector3};

use crate::TICK;
use crate::control::{ErrorObserver, Impedance};
use crate::kinematics::{Chain, ElbowSetpoint, Jacobian, PosePoint};
use crate::model::{ChainModel, MAX_CHAIN_JOINTS, ObserverGains, Pose, Reaction, RobotModel, Safety};
use crate::task::impedance::redundancy::JointVector;
use crate::task::impedance::{
    Arm, ArmMeasurement, ArmOutput, ForceSource, ImpedanceSettings, ImpedanceState, Law, Redundancy,
};
use crate::test_support::joint as test_joint;

/// The shape of `robots/arm7`, in round numbers.
pub fn arm7() -> RobotModel {
    let shapes = [
        ("shoulder_pitch", [0.0, -1.0, 0.0], 0.0, 0.5),
        ("shoulder_roll", [-1.0, 0.0, 0.0], 0.0, 0.4),
        ("shoulder_yaw", [0.0, 0.0, 1.0], 0.0, 1.5),
        ("elbow", [0.0, -1.0, 0.0], -0.3, 0.9),
        ("wrist_yaw", [0.0, 0.0, 1.0], -0.26, 0.4),
        ("wrist_pitch", [0.0, -1.0, 0.0], 0.0, 0.2),
        ("wrist_roll", [1.0, 0.0, 0.0], 0.0, 0.5),
    ];
    let mut joints = Vec::new();
    for (name, axis, height, mass) in shapes {
        let mut joint = test_joint(name);
        joint.axis = axis;
        joint.origin.translation = [0.0, 0.0, height];
        joint.link.mass = mass;
        joint.link.center_of_mass = [0.0, 0.0, -0.1 * mass];
        joint.link.inertia = [1e-3, 1e-3, 5e-4, 0.0, 0.0, 0.0];
        (joint.motor.rotor_inertia, joint.motor.torque_constant, joint.motor.current_limit) =
            (0.03, 6.0, 11.0);
        (joint.limits.lower, joint.limits.upper) = (-3.0, 3.0);
        (joint.limits.torque, joint.limits.torque_rate) = (60.0, 1500.0);
        joint.servo.observer.inertia = 0.06;
        joints.push(joint).unwrap();
    }
    let hand = ChainModel {
        name: "hand".try_into().unwrap(),
        joints: 7,
        tip: Pose { translation: [0.0, 0.0, -0.1], ..Pose::IDENTITY },
        tip_radius: 0.0,
        force_sensor: None,
    };
    RobotModel {
        name: "arm".try_into().unwrap(),
        gravity: [0.0, 0.0, -9.81],
        chains: Vec::from_slice(&[hand]).unwrap(),
        joints,
        mimics: Vec::new(),
        gauges: None,
        safety: Safety {
            command_timeout: 0.1,
            reaction: Reaction::Hold,
            damping: 3.0,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}

/// 1.5 kg, 30 N·s/m, 300 N/m; control of the arm angle.
pub const SOFT: ImpedanceSettings = ImpedanceSettings {
    impedance: Impedance::diagonal(
        [1.5, 1.5, 1.5, 0.05, 0.05, 0.05],
        [30.0, 30.0, 30.0, 1.0, 1.0, 1.0],
        [300.0, 300.0, 300.0, 10.0, 10.0, 10.0],
    ),
    law: Law::ModelFollowing,
    redundancy: Redundancy::ArmAngle,
    elbow_bandwidth: 12.0,
    force: ForceSource::Sensor,
    contact_force: 1.5,
    max_deviation: [0.1, 1.0],
};

/// Elbow at 90°; raised arm; inward rotation with a bent wrist; raised elbow.
pub const POSTURES: [[f32; MAX_CHAIN_JOINTS]; 4] = [
    [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0],
    [0.9, 0.3, -0.4, 1.2, 0.3, 0.4, -0.2],
    [0.3, 0.6, 0.8, 1.9, -0.9, -0.5, 0.6],
    [-0.4, 1.3, 0.5, 0.8, 1.1, 0.7, -0.8],
];

pub const DOWN: Vector3<f32> = Vector3::new(0.0, 0.0, -9.81);

/// Owns the configuration of an [`Arm`].
pub struct ArmFixture {
    pub model: RobotModel,
    pub chain: Chain,
    pub observer: ErrorObserver,
}

impl ArmFixture {
    pub fn new() -> Self {
        let model = arm7();
        let gains = ObserverGains { inertia: 1.0, bandwidth: 40.0, observer_bandwidth: 160.0 };
        Self {
            chain: Chain::new(&model.joints, &model.chains[0].tip),
            observer: ErrorObserver::with_lag(&gains, 0.0),
            model,
        }
    }

    pub fn arm(&self) -> Arm<'_> {
        Arm { chain: &self.chain, joints: &self.model.joints, gravity: &DOWN, observer: &self.observer }
    }

    pub fn jacobian(&self, angles: &[f32]) -> Jacobian {
        self.chain.posture(angles).jacobian()
    }

    pub fn state(&self, settings: &ImpedanceSettings, angles: &[f32; MAX_CHAIN_JOINTS]) -> ImpedanceState {
        let mut state = ImpedanceState::NONE;
        settings.validate(7).unwrap();
        state.begin(&self.arm(), settings, angles);
        state
    }

    /// Set-point at rest at the tool's pose for these joint angles.
    pub fn point(&self, angles: &[f32]) -> PosePoint {
        let posture = self.chain.posture(angles);
        let rotation = UnitQuaternion::from_rotation_matrix(&posture.tip().rotation);
        PosePoint {
            position: posture.tip().translation.vector.into(),
            rotation: rotation.coords.into(),
            velocity: [0.0; 6],
            acceleration: [0.0; 6],
        }
    }
}

/// The next measurement of an arm that tracks its commands exactly, without external force.
pub fn track(output: &ArmOutput) -> ArmMeasurement {
    let mut measurement = ArmMeasurement::default();
    let states = measurement.angles.iter_mut().zip(&mut measurement.velocities);
    states.zip(&output.points).for_each(|((angle, velocity), point)| {
        *angle = point.position + TICK * (point.velocity + 0.5 * TICK * point.acceleration);
        *velocity = point.velocity + TICK * point.acceleration;
    });
    measurement
}

pub fn accelerations(output: &ArmOutput) -> JointVector {
    JointVector::from(output.points.map(|point| point.acceleration))
}

/// Elbow set-point at rest at the elbow's angle in the first posture.
pub fn elbow_at_rest(fixture: &ArmFixture, state: &ImpedanceState) -> ElbowSetpoint {
    let measurement = ArmMeasurement { angles: POSTURES[0], ..ArmMeasurement::default() };
    let angle =
        state.telemetry(&fixture.arm(), &measurement, &fixture.chain.posture(&measurement.angles)).elbow;
    ElbowSetpoint { angle, ..ElbowSetpoint::default() }
}
