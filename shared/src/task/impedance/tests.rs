//! The parts of the control by themselves, and a tick without a node around it.

use core::f32::consts::{FRAC_PI_2, PI};

use heapless::Vec;
use nalgebra::{SVector, UnitQuaternion, Vector3, Vector6};

use super::momentum::MomentumObserver;
use super::redundancy::{Joints, Resolver};
use super::*;
use crate::TICK;
use crate::control::{ErrorObserver, Impedance};
use crate::kinematics::{Chain, Jacobian};
use crate::model::{
    ChainModel, MAX_CHAIN_JOINTS, ObserverGains, Pose, Reaction, RobotModel, Safety, test_joint,
};

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
        safety: Safety {
            command_timeout: 0.1,
            reaction: Reaction::Hold,
            damping: 0.3,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}

/// 1.5 kg, 30 N·s/m, 300 N/m; the arm angle stays.
pub const SOFT: ImpedanceSettings = ImpedanceSettings {
    impedance: Impedance {
        mass: [1.5, 1.5, 1.5, 0.05, 0.05, 0.05],
        damping: [30.0, 30.0, 30.0, 1.0, 1.0, 1.0],
        stiffness: [300.0, 300.0, 300.0, 10.0, 10.0, 10.0],
    },
    law: Law::ModelFollowing,
    redundancy: Redundancy::ArmAngle,
    elbow_bandwidth: 12.0,
    force: ForceSource::Sensor,
    contact_force: 1.5,
    reach: [0.1, 1.0],
};

/// Elbow 90°; a raised arm; one turned inwards with a bent wrist; the elbow swung out.
const POSTURES: [[f32; MAX_CHAIN_JOINTS]; 4] = [
    [0.0, 0.0, 0.0, FRAC_PI_2, 0.0, 0.0, 0.0],
    [0.9, 0.3, -0.4, 1.2, 0.3, 0.4, -0.2],
    [0.3, 0.6, 0.8, 1.9, -0.9, -0.5, 0.6],
    [-0.4, 1.3, 0.5, 0.8, 1.1, 0.7, -0.8],
];

const DOWN: Vector3<f32> = Vector3::new(0.0, 0.0, -9.81);

/// What an arm of seven joints is, for [`Arm`].
struct Machine {
    model: RobotModel,
    chain: Chain,
    observer: ErrorObserver,
}

impl Machine {
    fn new() -> Self {
        let model = arm7();
        let gains = ObserverGains { inertia: 1.0, bandwidth: 40.0, observer_bandwidth: 160.0 };
        Self {
            chain: Chain::new(&model.joints, &model.chains[0].tip),
            observer: ErrorObserver::with_lag(&gains, 0.0),
            model,
        }
    }

    fn arm(&self) -> Arm<'_> {
        Arm { chain: &self.chain, joints: &self.model.joints, gravity: &DOWN, observer: &self.observer }
    }

    fn jacobian(&self, angles: &[f32]) -> Jacobian {
        self.chain.posture(angles).jacobian()
    }

    fn state(&self, settings: &ImpedanceSettings, angles: &[f32; MAX_CHAIN_JOINTS]) -> ImpedanceState {
        let mut state = ImpedanceState::NONE;
        state.configure(&self.arm(), settings).unwrap();
        state.begin(&self.arm(), angles).unwrap();
        state
    }

    /// The set-point where a tool at these angles is.
    fn point(&self, angles: &[f32]) -> PosePoint {
        let posture = self.chain.posture(angles);
        let turn = UnitQuaternion::from_rotation_matrix(&posture.tip().rotation);
        PosePoint {
            position: posture.tip().translation.vector.into(),
            rotation: turn.coords.into(),
            velocity: [0.0; 6],
            acceleration: [0.0; 6],
        }
    }
}

/// One that feels nothing, its joints at the angles of `command`'s points a tick later.
fn follow(command: &ArmOutput) -> ArmSense {
    let mut sense = ArmSense::default();
    let all = sense.angles.iter_mut().zip(&mut sense.velocities).zip(&command.points);
    all.for_each(|((angle, velocity), point)| {
        *angle = point.position + TICK * (point.velocity + 0.5 * TICK * point.acceleration);
        *velocity = point.velocity + TICK * point.acceleration;
    });
    sense
}

fn accelerations(command: &ArmOutput) -> Joints {
    Joints::from(command.points.map(|point| point.acceleration))
}

#[test]
fn the_jacobian_of_the_arm_angle_is_how_it_changes() {
    let machine = Machine::new();
    let of = |angles: &[f32]| ArmAngle::of(&machine.chain.posture(angles), &DOWN).unwrap();
    // By the definition: elbow down in the first posture; out to the right is a quarter of a turn.
    assert!(of(&POSTURES[0]).angle.abs() < 1e-6);
    for posture in POSTURES {
        let ArmAngle { jacobian, .. } = of(&posture);
        for joint in 0..MAX_CHAIN_JOINTS {
            let at = |step: f32| {
                let mut angles = posture;
                angles[joint] += step;
                of(&angles).angle
            };
            let step = 2e-3;
            let change = (at(step) - at(-step)) / (2.0 * step);
            assert!((change - jacobian[joint]).abs() < 2e-3, "{posture:?} {joint}: {change} {jacobian}");
        }
    }
}

#[test]
fn there_is_no_arm_angle_below_the_shoulder_and_of_six_joints() {
    let machine = Machine::new();
    let hanging = machine.chain.posture(&[0.0; MAX_CHAIN_JOINTS]);
    assert!(ArmAngle::of(&hanging, &DOWN).is_none());
    let model = arm7();
    let six = Chain::new(&model.joints[..6], &model.chains[0].tip);
    assert!(ArmAngle::of(&six.posture(&POSTURES[1]), &DOWN).is_none());
}

/// Solves for `tool` as often as it takes to know the weakest direction.
fn resolver(jacobian: Jacobian, driven: Option<usize>) -> (Resolver, f32) {
    let (mut direction, mut weakest) = (Vector6::repeat(0.408), 0.0);
    for _ in 0..50 {
        let _ = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
    }
    (Resolver::new(jacobian, driven, &mut direction, &mut weakest), weakest)
}

#[test]
fn away_from_singular_postures_the_tool_moves_exactly_as_told() {
    let machine = Machine::new();
    let tool = Vector6::new(0.3, -0.5, 0.2, 1.0, -2.0, 0.7);
    for posture in &POSTURES[..3] {
        for driven in [None, Some(2)] {
            let jacobian = machine.jacobian(posture);
            let (resolver, weakest) = resolver(jacobian, driven);
            assert!(weakest > 0.06, "{posture:?}: {weakest}");
            let motion = resolver.solve(&tool);
            assert!((jacobian * motion - tool).norm() < 1e-4, "{posture:?} {driven:?}");
            assert!(driven.is_none_or(|driven| motion[driven] == 0.0));
            // The smallest singular value of the columns that are left.
            let mut left = jacobian;
            driven.iter().for_each(|&driven| left.column_mut(driven).fill(0.0));
            let smallest = left.transpose().svd(false, false).singular_values.min();
            assert!((weakest / smallest - 1.0).abs() < 0.02, "{weakest} {smallest}");
        }
    }
}

#[test]
fn a_null_motion_leaves_the_tool_where_it_is() {
    let machine = Machine::new();
    for posture in &POSTURES[..3] {
        let jacobian = machine.jacobian(posture);
        let (resolver, _) = resolver(jacobian, None);
        let any = SVector::from([1.0, -2.0, 0.5, 1.5, -1.0, 2.0, 0.3]);
        let null = resolver.null(&any);
        assert!(null.norm() > 0.1 && (jacobian * null).norm() < 1e-4, "{posture:?}");
    }
}

/// Damped by λ² = 0.04² (1 − (σ/0.06)²) below σ = 0.06, a unit motion of the tool takes at most σ/(σ² + λ²) of the joints,
/// which is 16.7 at σ = 0.06 and more nowhere.
#[test]
fn near_a_straight_elbow_and_a_folded_wrist_the_joints_stay_calm() {
    let machine = Machine::new();
    let sweeps: [fn(f32) -> [f32; MAX_CHAIN_JOINTS]; 2] = [
        // The elbow through straight, and the wrist through 90°, where its first axis meets its last.
        |way| [0.9, 0.3, -0.4, 0.5 * way, 0.3, 0.4, -0.2],
        |way| [0.9, 0.3, -0.4, 1.2, 0.3, FRAC_PI_2 + 0.5 * way, -0.2],
    ];
    for posture in sweeps {
        for driven in [None, Some(2)] {
            let (mut direction, mut weakest) = (Vector6::repeat(0.408), 0.0);
            let mut least = f32::INFINITY;
            for step in -1000..=1000 {
                let jacobian = machine.jacobian(&posture(step as f32 / 1000.0));
                // One iteration a step, as in the loop.
                let resolver = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
                least = least.min(weakest);
                for axis in 0..6 {
                    let mut tool = Vector6::zeros();
                    tool[axis] = 1.0;
                    let size = resolver.solve(&tool).norm();
                    assert!(size < 20.0, "{step} {axis}: {size}");
                }
            }
            // With a joint driven by itself both are singular; the seventh joint helps over the wrist.
            assert!(driven.is_none() || least < 0.03, "{least}");
        }
    }
}

#[test]
fn the_orientation_takes_the_shorter_way() {
    let machine = Machine::new();
    let settings = ImpedanceSettings { reach: [0.1, 3.0], ..SOFT };
    let angles = POSTURES[0];
    for angle in [2.99_f32, -2.99] {
        for sign in [1.0, -1.0] {
            let mut state = machine.state(&settings, &angles);
            let mut point = machine.point(&angles);
            // Of both quaternions of an orientation, turned by so much about y.
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle)
                * UnitQuaternion::new_unchecked(nalgebra::Quaternion::from(point.rotation));
            point.rotation = (turn.coords * sign).into();
            state.aim(&machine.arm(), &point, &elbow(&machine, &state)).unwrap();
            let sense = ArmSense { angles, ..ArmSense::default() };
            state.tick(&machine.arm(), &sense).unwrap();
            let error = state.telemetry(&machine.arm(), &sense, 0).error;
            assert!((error[4] + angle).abs() < 1e-4 && error[3].abs() < 1e-3, "{angle} {sign}: {error:?}");
        }
    }
}

/// The elbow where it is.
fn elbow(machine: &Machine, state: &ImpedanceState) -> ElbowSetpoint {
    let sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
    let angle = state.telemetry(&machine.arm(), &sense, 0).elbow;
    ElbowSetpoint { angle, ..ElbowSetpoint::default() }
}

#[test]
fn a_set_point_without_a_successor_comes_to_rest() {
    let mut point = PosePoint {
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
        velocity: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        acceleration: [5.0; 6],
    };
    let mut elbow = ElbowSetpoint { angle: 0.0, velocity: 1.0, acceleration: 5.0 };
    for _ in 0..100 {
        (point, elbow) = (point.coasted(), elbow.coasted());
    }
    // 10 ms · (1 + 0.8 + 0.8² + …) = 50 ms at the first speed.
    assert!(
        (point.position[0] - 0.05).abs() < 1e-6 && (elbow.angle - 0.05).abs() < 1e-6,
        "{point:?} {elbow:?}"
    );
    let turn = UnitQuaternion::new_normalize(nalgebra::Quaternion::from(point.rotation));
    assert!((turn.scaled_axis() - Vector3::new(0.0, 0.0, 0.05)).norm() < 1e-4, "{turn}");
    assert!(point.velocity[0] < 1e-9 && point.acceleration == [0.0; 6] && elbow.acceleration == 0.0);
    let norm = point.rotation.iter().map(|part| part * part).sum::<f32>();
    assert!((norm - 1.0).abs() < 1e-5);
}

#[test]
fn what_an_arm_cannot_follow_is_refused_by_name_and_the_aim_stays() {
    let machine = Machine::new();
    let mut state = machine.state(&SOFT, &POSTURES[0]);
    let (here, elbow) = (machine.point(&POSTURES[0]), elbow(&machine, &state));
    let [x, y, z] = here.position;
    let refused = |point: PosePoint, elbow: ElbowSetpoint, text: &str| {
        let mut state = state;
        let before = postcard::to_stdvec(&state).unwrap();
        let error = state.aim(&machine.arm(), &point, &elbow).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
        assert_eq!(postcard::to_stdvec(&state).unwrap(), before);
    };
    refused(
        PosePoint { position: [x + 1.0, y, z], ..here },
        elbow,
        "m from the tool; at most 0.1 m is allowed",
    );
    let [i, j, k, w] = here.rotation;
    let turned = PosePoint { rotation: [w, k, -j, -i], ..here };
    refused(turned, elbow, "the set-point is turned by 3.14");
    refused(PosePoint { position: [f32::NAN, y, z], ..here }, elbow, "not finite");
    refused(PosePoint { rotation: [i, j, k, w + 0.5], ..here }, elbow, "it must be 1");
    let still = [0.0; 6];
    let fast = |velocity: f32| [velocity, 0.0, 0.0, 0.0, 0.0, 0.0];
    for most in [20.0, 1e30, f32::MAX] {
        refused(PosePoint { velocity: fast(most), ..here }, elbow, "m from the tool");
        refused(PosePoint { acceleration: fast(100.0 * most.min(1e30)), ..here }, elbow, "m from the tool");
        let velocity = [0.0, 0.0, 0.0, 0.0, 0.0, 20.0 * most.min(1e30)];
        refused(PosePoint { velocity, ..here }, elbow, "turned by");
        refused(here, ElbowSetpoint { angle: most, ..elbow }, "rad from the elbow; at most 1 rad is allowed");
        refused(here, ElbowSetpoint { velocity: 10.0 * most, ..elbow }, "");
    }
    let all = PosePoint { velocity: fast(1.0), acceleration: still, ..here };
    state.aim(&machine.arm(), &all, &ElbowSetpoint { angle: elbow.angle + 0.9, ..elbow }).unwrap();
    assert_eq!(
        { ImpedanceState::NONE }.aim(&machine.arm(), &here, &elbow).unwrap_err().to_string(),
        "the arm has no impedance yet: send its settings first"
    );
}

#[test]
fn settings_that_make_no_sense_are_refused_by_name() {
    let refused = |change: fn(&mut ImpedanceSettings), text: &str| {
        let mut settings = SOFT;
        change(&mut settings);
        let error = settings.validate(7).unwrap_err();
        assert!(error.to_string().contains(text), "{error}");
    };
    refused(|s| s.impedance.mass[0] = 0.0, "the mass along x is 0 kg");
    refused(|s| s.impedance.mass[3] = -0.1, "the mass about x is -0.1 kg·m²");
    refused(|s| s.impedance.mass[1] = f32::MIN_POSITIVE / 2.0, "the mass along y");
    refused(|s| s.impedance.mass[1] = f32::MAX, "the mass along y");
    refused(|s| s.impedance.damping[2] = -1.0, "the damping along z is -1 N·s/m");
    refused(|s| s.impedance.stiffness[4] = -1.0, "the stiffness about y is -1 N·m/rad");
    refused(|s| s.impedance.stiffness[4] = f32::NAN, "the stiffness about y is NaN");
    refused(|s| s.redundancy = Redundancy::DrivenJoint { joint: 7 }, "joint 7 is to be driven by itself");
    refused(|s| s.elbow_bandwidth = 0.0, "the bandwidth of the elbow is 0 rad/s");
    refused(|s| s.elbow_bandwidth = f32::INFINITY, "50 rad/s at most");
    refused(|s| s.contact_force = f32::NAN, "the contact force is NaN N");
    refused(|s| s.reach[0] = -1.0, "the reach is -1");
    refused(|s| s.reach[1] = PI, "less than half a turn");
    assert_eq!(SOFT.validate(6).unwrap_err(), InvalidSettings::NoArmAngle);
    assert!(SOFT.validate(7).is_ok());
}

#[test]
fn a_force_that_is_no_number_stops_the_arm() {
    let machine = Machine::new();
    for law in [Law::Direct, Law::ModelFollowing] {
        for value in [f32::NAN, f32::INFINITY] {
            let mut state = machine.state(&ImpedanceSettings { law, ..SOFT }, &POSTURES[0]);
            let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
            sense.wrench[4] = value;
            assert_eq!(state.tick(&machine.arm(), &sense).unwrap_err(), ArmError::NotFinite);
        }
    }
}

#[test]
fn a_tool_that_is_pulled_beyond_its_reach_stops_the_arm() {
    let machine = Machine::new();
    let pulled = |axis: usize, size: f32| {
        let mut state = machine.state(&SOFT, &POSTURES[0]);
        let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
        for _ in 0..500 {
            sense.wrench = [0.0; 6];
            // A push, too small to go far, that makes it a contact.
            sense.wrench[1] = 2.0;
            sense.wrench[axis] = size;
            match state.tick(&machine.arm(), &sense) {
                Ok(command) => sense = follow(&command),
                Err(error) => return Some(error),
            }
        }
        None
    };
    // 20 N hold 67 mm of 300 N/m; 40 N would hold 133.
    assert_eq!(pulled(0, 20.0), None);
    let Some(ArmError::Distance { value, limit: 0.1 }) = pulled(0, 40.0) else { panic!() };
    assert!((0.1..0.12).contains(&value), "{value}");
    let Some(ArmError::Turn { value, limit: 1.0 }) = pulled(5, 12.0) else { panic!() };
    assert!((1.0..1.2).contains(&value), "{value}");
}

/// A tick with new settings differs from one without by a twentieth of the way to them: on each axis the tool's
/// acceleration by at most `|Δ(K/M)| e + |Δ(B/M)| v`, and the torques by what the mass matrix makes of that.
#[test]
fn new_settings_do_not_step_the_torque() {
    let machine = Machine::new();
    let arm = machine.arm();
    let mut state = machine.state(&SOFT, &POSTURES[0]);
    let mut point = machine.point(&POSTURES[0]);
    point.position[0] += 0.05;
    let elbow = elbow(&machine, &state);
    state.aim(&arm, &point, &elbow).unwrap();
    let mut sense = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
    for _ in 0..10 {
        sense = follow(&state.tick(&arm, &sense).unwrap());
    }
    let telemetry = state.telemetry(&arm, &sense, 0);
    let speed = machine.jacobian(&sense.angles) * Joints::from(sense.velocities);
    let mut firm = SOFT;
    firm.impedance.mass = [1.0, 1.0, 1.0, 0.05, 0.05, 0.05];
    firm.impedance.damping = [90.0, 90.0, 90.0, 1.0, 1.0, 1.0];
    firm.impedance.stiffness = [2000.0, 2000.0, 2000.0, 10.0, 10.0, 10.0];
    let mut other = state;
    other.configure(&arm, &firm).unwrap();
    let [own, new] = [&mut state, &mut other].map(|state| accelerations(&state.tick(&arm, &sense).unwrap()));
    let share = |goal: f32, own: f32| own + 0.05 * (goal - own);
    let mass = share(1.0, 1.5);
    let of_error = share(2000.0, 300.0) / mass - 300.0 / 1.5;
    let of_speed = share(90.0, 30.0) / mass - 30.0 / 1.5;
    let size = |values: &[f32]| Vector3::from_column_slice(values).norm();
    let tool = of_error * size(&telemetry.error[..3]) + of_speed * size(&speed.as_slice()[..3]);
    // ... which is what the tool sees of it, and less as torques: rotors of 0.03 kg·m² and what the links weigh.
    let change = new - own;
    let of_tool = (machine.jacobian(&sense.angles) * change).norm();
    assert!(of_tool > 0.2 * tool && of_tool <= 1.05 * tool, "{of_tool} {tool}");
    let inertia = machine.chain.clone().with_rotor_inertia([0.03; 7]).mass_matrix(&sense.angles);
    let torque = (inertia * change).norm();
    assert!(torque < 0.6, "{torque} N·m");
    // All at once would be twenty times as much.
    let mut at_once = machine.state(&firm, &POSTURES[0]);
    at_once.aim(&arm, &point, &elbow).unwrap();
    let start = ArmSense { angles: POSTURES[0], ..ArmSense::default() };
    let step = accelerations(&at_once.tick(&arm, &start).unwrap());
    assert!(step.norm() > 5.0 * change.norm(), "{step}");
}

#[test]
fn another_law_forgets_what_the_observers_learnt() {
    let machine = Machine::new();
    let arm = machine.arm();
    let angles = POSTURES[0];
    let mut state = machine.state(&SOFT, &angles);
    // Joints that stand still although they are told to move.
    let mut point = machine.point(&angles);
    point.position[2] += 0.05;
    state.aim(&arm, &point, &elbow(&machine, &state)).unwrap();
    let sense = ArmSense { angles, ..ArmSense::default() };
    for _ in 0..10 {
        state.tick(&arm, &sense).unwrap();
        state.settle(&arm, &[0.0; MAX_CHAIN_JOINTS], &[0.0; MAX_CHAIN_JOINTS]);
    }
    let most =
        |command: &ArmOutput| command.feedback.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    let learnt = most(&state.tick(&arm, &sense).unwrap());
    state.configure(&arm, &ImpedanceSettings { law: Law::Direct, ..SOFT }).unwrap();
    assert_eq!(state.tick(&arm, &sense).unwrap().feedback, [0.0; MAX_CHAIN_JOINTS]);
    state.configure(&arm, &SOFT).unwrap();
    // From here on it is a joint that does not move for a tick, not one that has not for ten.
    assert!(most(&state.tick(&arm, &sense).unwrap()) < 0.3 * learnt);
}

/// Of each tick: angles, torques held from then on, and the joint torques of a push behind a filter of 30 rad/s, half a
/// period ago (`tests/oracles/momentum.py`).
type Moved = ([f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS], [f32; MAX_CHAIN_JOINTS]);
#[allow(clippy::excessive_precision, reason = "as the script has them")]
const MOVED: &[Moved] = include!("../../../tests/oracles/data/momentum.in");

#[test]
fn torques_of_the_world_are_found_in_those_of_the_motors() {
    let mut machine = Machine::new();
    machine.model.joints.iter_mut().for_each(|joint| {
        (joint.friction.coulomb, joint.friction.viscous) = (0.0, 0.3);
    });
    let mut observer = MomentumObserver::NONE;
    let (mut worst, mut largest, mut last) = (0.0_f32, 0.0_f32, MOVED[0].0);
    for (tick, (angles, torques, expected)) in MOVED.iter().enumerate() {
        let velocities = core::array::from_fn(|joint| (angles[joint] - last[joint]) / TICK);
        // It counts as resting and tares at the 42nd reading; nothing pushes before the fiftieth.
        observer.update(&machine.arm(), angles, &velocities, 30.0, true);
        // A tare before that changes nothing.
        if tick < 42 {
            observer.tare();
            assert!(tick == 41 || observer.torques() == Joints::zeros(), "none before the tare");
        }
        let error = observer.torques() - Joints::from(*expected);
        worst = worst.max(error.amax());
        largest = largest.max(Joints::from(*expected).amax());
        observer.push(torques);
        last = *angles;
    }
    assert!(largest > 1.5 && worst < 0.02 * largest, "{worst} of {largest} N·m");
}

#[test]
fn a_wrench_is_found_in_its_joint_torques() {
    let machine = Machine::new();
    let wrench = Vector6::new(8.0, -5.0, 6.0, 0.3, 0.4, -0.5);
    for angles in &POSTURES {
        for driven in [None, Some(2)] {
            let jacobian = machine.jacobian(angles);
            let (mut direction, mut weakest) = (Vector6::repeat(0.4), 1.0);
            let resolver = Resolver::new(jacobian, driven, &mut direction, &mut weakest);
            let error = resolver.wrench(&jacobian.tr_mul(&wrench)) - wrench;
            assert!(error.amax() < 1e-3, "{error:?}");
        }
    }
}
