//! Fixed bodies that the arm with a gripper touches: forces, friction and motion compared with hand
//! calculations.

use std::path::Path;

use rapier3d::na::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{
    Drive, Fixture, FixtureContact, FixtureShape, Plant, PlantError, PlantOptions, PlantValues,
};

use urdf_rs::Geometry;

use crate::hand::{Hand, frame_of, largest, urdf};

const JOINTS: usize = 7;
const FINGERS: [&str; 2] = ["left_finger", "right_finger"];
/// Stiffness of the base's yaw and pitch towards their goals; that of the other joints is lower [N·m/rad].
const STIFF: f64 = 2000.0;
const GRIPPER: usize = 6;
/// Height of the hand [m].
const HEIGHT: f64 = 0.15;
/// Distance from the wrist to the fingertips [m].
const REACH: f64 = 0.3;
/// Length of a finger, and half its thickness [m].
const FINGER: f64 = 0.1;
const HALF: f64 = 0.005;

/// Returns the joint angles with the fingertips at a distance and a height, a level hand, and the gripper at
/// an angle.
fn posture(distance: f64, height: f64, gripper: f64) -> [f64; JOINTS] {
    let (upper, lower) = (0.40_f64, 0.36_f64);
    let (x, z) = (distance - REACH, height);
    let elbow = ((x * x + z * z - upper * upper - lower * lower) / (2.0 * upper * lower)).acos();
    let pitch = z.atan2(x) - (lower * elbow.sin()).atan2(upper + lower * elbow.cos());
    [0.0, pitch, 0.0, elbow, -pitch - elbow, 0.0, gripper]
}

/// An arm in front of fixed bodies.
struct Door {
    plant: Plant,
    goal: [f64; JOINTS],
}

/// All parts of the door's plant, for tests to change.
struct Parts {
    folder: RobotFolder,
    values: PlantValues,
    options: PlantOptions,
    goal: [f64; JOINTS],
}

impl Parts {
    /// Creates the arm with its fingertips at a distance, without dry friction.
    fn new(distance: f64, gripper: f64, fixtures: Vec<Fixture>) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm");
        let goal = posture(distance, HEIGHT, gripper);
        let options = PlantOptions {
            held_at_start: false,
            coulomb: Some(0.0),
            posture: Some(goal.to_vec()),
            fixtures,
            ..PlantOptions::exact()
        };
        let folder = RobotFolder::load(&path).unwrap();
        Self { folder, values: PlantValues::load(&path).unwrap(), options, goal }
    }

    /// The collision element of the palm.
    fn palm(&mut self) -> &mut urdf_rs::Collision {
        let palm = self.folder.urdf.robot.links.iter_mut().find(|link| link.name == "palm").unwrap();
        &mut palm.collision[0]
    }

    fn plant(&self) -> Result<Plant, PlantError> {
        let mut drives: Vec<Drive> = self.folder.model.joints.iter().map(Drive::from).collect();
        // A light rotor comes to rest soon.
        drives[GRIPPER].motor.rotor_inertia = 1e-3;
        Plant::new(&self.folder.urdf, &drives, &self.values, &self.options)
    }

    fn build(&self) -> Door {
        Door { plant: self.plant().unwrap(), goal: self.goal }
    }
}

impl Door {
    fn new(distance: f64, gripper: f64, fixtures: Vec<Fixture>) -> Self {
        Parts::new(distance, gripper, fixtures).build()
    }

    /// Runs one control period with the torques of the weight, of springs and dampers towards the arm's goal
    /// (not the gripper's), and additional ones.
    fn tick(&mut self, stiffness: f64, more: [f64; JOINTS]) {
        let truth = self.plant.truth();
        let weight = self.plant.weight_torques();
        let spring = [1.0, 1.0, 0.4, 0.4, 0.04, 0.04, 0.0];
        let torques: Vec<f32> = (0..JOINTS)
            .map(|joint| {
                let error = self.goal[joint] - truth.positions[joint];
                let damping = if joint == GRIPPER { 0.0 } else { 80.0 * spring[joint] };
                (weight[joint] + stiffness * spring[joint] * error - damping * truth.velocities[joint]
                    + more[joint]) as f32
            })
            .collect();
        self.plant.apply(&frame_of(&torques)).unwrap();
    }

    /// Runs one control period with these torques.
    fn drive(&mut self, torques: [f64; JOINTS]) {
        self.plant.apply(&frame_of(&torques.map(|torque| torque as f32))).unwrap();
    }

    fn frame(&self, joint: usize) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let (place, [x, y, z, w]) = self.plant.link_pose(joint).unwrap();
        (place.into(), UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)))
    }

    /// Returns the point between the fingertips.
    fn tips(&self) -> Vector3<f64> {
        let (palm, turn) = self.frame(5);
        palm + turn * Vector3::new(REACH, 0.0, 0.0)
    }

    /// Returns the torques for a force at the fingertips.
    fn push(&self, force: Vector3<f64>) -> [f64; JOINTS] {
        let axes = [Vector3::z(), -Vector3::y(), Vector3::x(), -Vector3::y(), -Vector3::y(), Vector3::z()];
        let tips = self.tips();
        let mut torques = [0.0; JOINTS];
        for (joint, axis) in axes.into_iter().enumerate() {
            let (place, turn) = self.frame(joint);
            torques[joint] = (turn * axis).dot(&(tips - place).cross(&force));
        }
        torques
    }

    fn forward(&self, force: f64) -> [f64; JOINTS] {
        self.push(Vector3::new(force, 0.0, 0.0))
    }

    /// Closes the gripper, softly at first, to a torque.
    fn grip(&mut self, torque: f64) {
        for period in 0..150 {
            let share = f64::from(period - 50).clamp(0.0, 50.0) / 50.0;
            let mut more = [0.0; JOINTS];
            more[GRIPPER] = 0.03 + (torque - 0.03) * share;
            self.tick(STIFF, more);
        }
    }

    /// Keeps the grip of 1 N·m and pulls the hand back, held only by dampers.
    fn pull(&mut self, force: f64, periods: u32) {
        for _ in 0..periods {
            let mut torques = self.forward(-force);
            torques[GRIPPER] = 1.0;
            self.tick(0.0, torques);
        }
    }

    /// Speed of the fastest joint of the arm [rad/s].
    fn speed(&self) -> f64 {
        largest(self.plant.truth().velocities.into_iter().take(GRIPPER))
    }

    /// Sum of the forces of all links on all fixed bodies.
    fn sum(&self) -> Vector3<f64> {
        self.plant.fixture_contacts().iter().map(|contact| contact.force).sum()
    }

    fn of(&self, link: &str) -> FixtureContact {
        self.plant.fixture_contacts().into_iter().find(|contact| contact.link == link).unwrap()
    }
}

fn fixture(name: &str, shape: FixtureShape, [x, y, z]: [f64; 3], friction: f64) -> Fixture {
    Fixture { name: name.to_owned(), shape, pose: Isometry3::translation(x, y, z), friction }
}

/// A plate across x with its surface at a distance.
fn plate(distance: f64, friction: f64) -> Fixture {
    fixture("door", FixtureShape::Box { size: [0.04, 0.9, 2.0] }, [distance + 0.02, 0.0, 0.15], friction)
}

/// A knob along x with its front at a distance.
fn knob(distance: f64, radius: f64, friction: f64) -> Fixture {
    let length = 0.06;
    let mut knob = fixture(
        "knob",
        FixtureShape::Cylinder { radius, length },
        [distance + length / 2.0, 0.0, HEIGHT],
        friction,
    );
    knob.pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
    knob
}

/// A hand at rest pushes with the force that corresponds to the joint torques.
#[test]
fn fingertips_press_a_door_with_the_force_of_the_torques() {
    for force in [5.0, 30.0, 60.0] {
        let mut door = Door::new(0.72, 0.0, vec![plate(0.72, 0.0)]);
        for _ in 0..200 {
            let forward = door.forward(force);
            door.tick(STIFF, forward);
        }
        let sum = door.sum();
        assert!((sum.x / force - 1.0).abs() < 0.01 && sum.y.abs() < 0.01 * force, "{force}: {sum}");
        for finger in FINGERS {
            let contact = door.of(finger);
            assert!((contact.force.x / (force / 2.0) - 1.0).abs() < 0.1, "{contact:?}");
            assert!(contact.depth < 1e-5, "{contact:?}");
        }
        assert!(door.speed() < 1e-3, "{}", door.speed());
    }
}

/// The palm, as a box, a ball and a cylinder along the hand, presses sideways on a post 0.53 m from the yaw
/// axis: force = torque / 0.53 m.
#[test]
fn each_shape_of_a_link_presses_a_post() {
    let shapes = [
        Geometry::Box { size: urdf_rs::Vec3([0.16, 0.08, 0.06]) },
        Geometry::Sphere { radius: 0.04 },
        Geometry::Cylinder { radius: 0.04, length: 0.16 },
    ];
    let from_yaw = 0.72 - REACH + 0.11;
    for shape in shapes {
        let post = FixtureShape::Box { size: [0.01, 0.02, 0.3] };
        let mut parts = Parts::new(0.72, 0.0, vec![fixture("post", post, [from_yaw, 0.05, HEIGHT], 0.0)]);
        let palm = parts.palm();
        if matches!(shape, Geometry::Cylinder { .. }) {
            palm.origin.rpy.0[1] = std::f64::consts::FRAC_PI_2;
        }
        palm.geometry = shape;
        let mut door = parts.build();
        for _ in 0..300 {
            door.tick(STIFF, [8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        let (force, torque) = (door.of("palm").force.y, door.plant.truth().torques[0]);
        let arm = torque / force;
        // The post is 10 mm wide.
        assert!(force > 4.0 && (arm - from_yaw).abs() < 0.006, "{force} {arm} {from_yaw}");
    }
}

/// 1 N·m at the screw gives 2 N·m at each finger: the fingers turn a quarter as fast, and share the work.
#[test]
fn a_grip_has_the_force_of_the_linkage() {
    // Radius of the knob, its depth between the fingers, and the range of possible contact distances from the
    // finger's axis: a wide knob touches with its front rim, one as wide as the gripper along its whole
    // length, a narrow one at the finger's end.
    let knobs = [
        (0.026, 0.02, [FINGER - 0.02; 2]),
        (0.025, 0.02, [FINGER - 0.02, FINGER]),
        (0.025, 0.004, [FINGER - 0.004, FINGER]),
        (0.024, 0.02, [FINGER; 2]),
    ];
    for (radius, deep, [near, far]) in knobs {
        let mut door = Door::new(0.72, -0.4, vec![knob(0.72 - deep, radius, 0.8)]);
        door.grip(1.0);
        let [left, right] = FINGERS.map(|finger| door.of(finger));
        assert!(-left.force.y > 2.0 / far * 0.99 && -left.force.y < 2.0 / near * 1.01, "{left:?}");
        assert!((left.force + right.force).norm() < 0.02, "{left:?} {right:?}");
        assert!(left.depth.max(right.depth) < 5e-5, "{left:?} {right:?}");
    }
}

/// Friction acts on a finger at a distance `HALF` from its axis and opens it: a·N + HALF·μ·N = 2 N·m at the
/// limit.
#[test]
fn a_gripped_knob_holds_a_pull_up_to_coulombs_limit() {
    for friction in [0.4, 0.8] {
        // 2 mm of the knob are between the fingers: on average 1 mm from their ends.
        let grip = 2.0 / (FINGER - 0.001 + HALF * friction);
        let limit = 2.0 * friction * grip;
        let gone = |share: f64| {
            let mut door = Door::new(0.72, -0.4, vec![knob(0.718, 0.025, friction)]);
            door.grip(1.0);
            door.pull(share * limit / 2.0, 20);
            let before = door.tips();
            door.pull(share * limit, 50);
            before.x - door.tips().x
        };
        let [held, slips] = [0.995, 1.005].map(gone);
        assert!(held.abs() < 1e-9 && slips > 5e-5, "{held:e} {slips:e}");
    }
}

#[test]
fn a_gripped_knob_does_not_creep() {
    for (coulomb, radius) in [(Some(0.0), 0.024), (Some(0.0), 0.025), (None, 0.025), (None, 0.026)] {
        let mut parts = Parts::new(0.72, -0.4, vec![knob(0.70, radius, 0.8)]);
        parts.options.coulomb = coulomb;
        let mut door = parts.build();
        door.grip(1.0);
        door.pull(20.0, 50);
        let before = door.tips();
        door.pull(20.0, 200);
        let crept = (door.tips() - before).norm();
        assert!(crept < 2e-8, "{radius}: {crept:e}");
    }
}

/// Sliding friction acts along the motion in any direction on the plate, with Coulomb's magnitude. A block
/// instead of the fingers slides.
#[test]
fn a_link_slides_as_coulomb_says() {
    for (along, up) in [(0.05, 0.0), (0.0, 0.05), (0.04, 0.03), (-0.02, 0.04)] {
        let mut parts = Parts::new(0.72, 0.0, vec![plate(0.72, 0.2)]);
        for link in &mut parts.folder.urdf.robot.links {
            if FINGERS.contains(&link.name.as_str()) {
                link.collision.clear();
            }
        }
        let palm = parts.palm();
        palm.geometry = Geometry::Box { size: urdf_rs::Vec3([0.02; 3]) };
        palm.origin.xyz.0[0] = REACH - 0.01;
        let mut door = parts.build();
        let (mut motion, mut force) = (Vector3::zeros(), Vector3::zeros());
        for period in 0..100 {
            let time = 0.01 * f64::from(period - 50).max(0.0);
            door.goal = posture(0.723, HEIGHT + up * time, 0.0);
            door.goal[0] = along * time / 0.72;
            let before = door.tips();
            door.tick(STIFF, [0.0; JOINTS]);
            (motion, force) = (door.tips() - before, door.of("palm").force);
        }
        let push = force.x;
        (motion.x, force.x) = (0.0, 0.0);
        let angle = motion.angle(&force);
        assert!(push > 5.0 && (force.norm() / push / 0.2 - 1.0).abs() < 1e-3, "{push} {force}");
        assert!(angle < 2e-3, "{angle}");
    }
}

/// The arm floats towards the door, with only its inertia and the viscous friction of its joints. Its
/// momentum is twice its energy divided by its velocity.
#[test]
fn a_run_into_the_door_takes_energy() {
    let mut parts = Parts::new(0.72, 0.0, vec![plate(0.726, 0.5)]);
    parts.values.gravity = [0.0; 3];
    let mut door = parts.build();
    for _ in 0..4 {
        let forward = door.forward(16.0);
        door.drive(forward);
    }
    door.drive([0.0; JOINTS]);
    let (mut energy, mut speed) = (door.plant.kinetic_energy(), 0.0);
    let (mut impulse, mut momentum, mut deepest) = (0.0, 0.0, 0.0_f64);
    for _ in 0..300 {
        let (before, last) = (door.tips().x, energy);
        door.drive([0.0; JOINTS]);
        energy = door.plant.kinetic_energy();
        assert!(energy <= last, "{energy:e} after {last:e}");
        let contacts = door.plant.fixture_contacts();
        if impulse == 0.0 && !contacts.is_empty() {
            momentum = 2.0 * last / speed;
        } else if impulse == 0.0 {
            speed = (door.tips().x - before) / 0.01;
        }
        impulse += 0.01 * door.sum().x;
        deepest = contacts.iter().fold(deepest, |deepest, contact| deepest.max(contact.depth));
    }
    assert!(speed > 0.09 && speed < 0.11, "{speed}");
    assert!((impulse / momentum - 1.0).abs() < 0.03, "{impulse} {momentum}");
    assert!(deepest < 1e-4 && door.speed() < 1e-3, "{deepest:e} {}", door.speed());
}

/// Springs move the hand at 0.1 m/s towards a point behind the surface.
#[test]
fn a_hand_that_is_driven_into_the_door_comes_to_rest() {
    let mut door = Door::new(0.70, 0.0, vec![plate(0.72, 0.5)]);
    let (mut fastest, mut deepest) = (0.0_f64, 0.0_f64);
    let mut forces = Vec::new();
    for period in 0..200 {
        door.goal = posture((0.70 + 0.001 * f64::from(period)).min(0.73), HEIGHT, 0.0);
        let before = door.tips().x;
        door.tick(STIFF, [0.0; JOINTS]);
        fastest = fastest.max((door.tips().x - before) / 0.01);
        let contacts = door.plant.fixture_contacts();
        deepest = contacts.iter().fold(deepest, |deepest, contact| deepest.max(contact.depth));
        forces.push(door.sum().x);
    }
    let rest = &forces[150..];
    let (low, high) = rest.iter().fold((f64::MAX, 0.0_f64), |(low, high), &x| (low.min(x), high.max(x)));
    assert!(fastest > 0.095 && deepest < 1e-4, "{fastest} {deepest:e}");
    assert!(low > 20.0 && high / low < 1.01 && door.speed() < 2e-3, "{low} {high} {}", door.speed());
}

#[test]
fn without_fixtures_nothing_stops_the_fingers() {
    let mut door = Door::new(0.72, -0.4, Vec::new());
    door.grip(1.0);
    assert!(door.plant.truth().positions[GRIPPER] > 0.39 && door.plant.fixture_contacts().is_empty());
}

/// The collision elements have no mass: with a fixed body out of reach, the arm moves as without it, also
/// with dry friction and at its stops.
#[test]
fn fixtures_out_of_reach_change_no_bit() {
    let swing = |fixtures, coulomb| {
        let mut parts = Parts::new(0.72, -0.4, fixtures);
        parts.options.coulomb = coulomb;
        let mut door = parts.build();
        for _ in 0..50 {
            door.drive([20.0, 0.0, 5.0, 0.0, 1.0, 1.0, 0.1]);
        }
        assert!(door.plant.fixture_contacts().is_empty());
        door.plant.truth().positions
    };
    for coulomb in [Some(0.0), None] {
        let (without, with) = (swing(Vec::new(), coulomb), swing(vec![plate(3.0, 0.5)], coulomb));
        assert!(without.iter().zip(&with).all(|(one, other)| one.to_bits() == other.to_bits()), "{with:?}");
    }
}

#[test]
fn values_are_checked() {
    let refusal = |change: &dyn Fn(&mut Fixture)| {
        let mut knob = knob(0.7, 0.025, 0.8);
        change(&mut knob);
        match Parts::new(0.72, 0.0, vec![plate(0.8, 0.5), knob]).plant() {
            Ok(_) => panic!("accepted"),
            Err(error) => error.to_string(),
        }
    };
    let says = |message: &str, parts: [&str; 3]| {
        assert!(parts.iter().all(|part| message.contains(part)), "{parts:?}: {message}");
    };
    let radius = |knob: &mut Fixture| knob.shape = FixtureShape::Cylinder { radius: 0.0, length: 0.1 };
    says(&refusal(&radius), ["fixtures[1] (\"knob\"), radius, is 0", "above 0", "10 m"]);
    let size = |knob: &mut Fixture| knob.shape = FixtureShape::Box { size: [0.1, f64::NAN, 0.1] };
    says(&refusal(&size), ["size, is NaN", "above 0", "10 m"]);
    let length = |knob: &mut Fixture| knob.shape = FixtureShape::Cylinder { radius: 0.1, length: 11.0 };
    says(&refusal(&length), ["length, is 11", "above 0", "10 m"]);
    says(&refusal(&|knob| knob.friction = -0.1), ["friction, is -0.1", "from 0", "to 10"]);
    says(&refusal(&|knob| knob.pose.translation.x = 20.0), ["position, is 20", "within", "10 m"]);
    let turn = |knob: &mut Fixture| {
        knob.pose.rotation = UnitQuaternion::new_unchecked(Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
    };
    says(&refusal(&turn), ["orientation", "NaN", "unit quaternion"]);

    let mut parts = Parts::new(0.72, 0.0, vec![plate(0.8, 0.5)]);
    parts.palm().geometry = Geometry::Cylinder { radius: 0.05, length: -0.1 };
    let message = parts.plant().err().unwrap().to_string();
    says(&message, ["\"palm\", <collision>, size, is -0.1", "above 0", "10 m"]);
    parts.folder.urdf.robot.links.iter_mut().for_each(|link| link.collision.clear());
    assert_eq!(parts.plant().err(), Some(PlantError::NoCollision));
}

/// The fingers hold a knob with bevelled edges like one without, and a bevel that does not fit is refused by
/// name.
#[test]
fn a_bevel_changes_the_edges_only() {
    let knob = |chamfer: Option<f64>| {
        let mut knob = knob(0.70, 0.025, 0.5);
        if let Some(chamfer) = chamfer {
            knob.shape = FixtureShape::BevelledCylinder { radius: 0.025, length: 0.06, chamfer };
        }
        knob
    };
    let forces = [None, Some(0.002)].map(|chamfer| {
        let mut door = Door::new(0.72, -0.1, vec![knob(chamfer)]);
        for _ in 0..100 {
            let mut more = [0.0; JOINTS];
            more[GRIPPER] = 0.5;
            door.tick(STIFF, more);
        }
        FINGERS.map(|finger| door.of(finger).force.norm())
    });
    for (bevelled, plain) in forces[1].iter().zip(forces[0]) {
        assert!(plain > 1.0 && (bevelled / plain - 1.0).abs() < 0.05, "{forces:?}");
    }
    let error = Parts::new(0.72, 0.0, vec![knob(Some(0.03))]).plant().err().unwrap().to_string();
    assert!(error.contains("chamfer"), "{error}");
}

/// A finger that closes on the edge of a knob, and is pulled off it, presses with no more than the linkage's
/// force, 2 N·m divided by its distance from the finger's axis, plus the friction across it.
#[test]
fn a_finger_at_the_edge_of_a_knob_is_not_thrown_off() {
    let (radius, friction) = (0.016, 0.8_f64);
    let shape = FixtureShape::BevelledCylinder { radius, length: 0.06, chamfer: 0.002 };
    let places = [
        (0.0, 0.0_f64, 0.008),
        (0.0, -4.0, 0.008),
        (0.0, 4.0, 0.008),
        (0.0, 10.0, 0.008),
        (0.006, -4.0, 0.002),
        (0.0, 0.0, 0.02),
    ];
    let largest = places.map(|(aside, heading, deep)| {
        let mut knob = fixture("knob", shape, [0.75 - deep, aside, HEIGHT + 0.004], friction);
        knob.pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading.to_radians())
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        let mut door = Door::new(0.72, -0.4, vec![knob]);
        let (mut share, mut depth) = (0.0_f64, 0.0_f64);
        for period in 0..200 {
            let (stiffness, pull) = if period > 100 { (0.02, 20.0) } else { (0.1, 0.0) };
            let mut more = door.forward(-pull);
            more[GRIPPER] = if period < 20 { 0.1 } else { 1.0 };
            door.tick(stiffness * STIFF, more);
            for contact in door.plant.fixture_contacts() {
                let grip = 2.0 / (FINGER - deep) * friction.hypot(1.0);
                share = share.max(contact.force.norm() / grip);
                depth = depth.max(contact.depth);
            }
        }
        (share, depth)
    });
    assert!(largest.iter().all(|(share, depth)| *share < 1.0 && *depth < 1e-5), "{largest:?}");
    assert!(largest.iter().all(|(share, _)| *share > 0.1), "{largest:?}");
}

/// A ball on a hinge through the origin touches a floor at a place where the floor's surface contains the
/// hinge's axis, or where the axis is along the normal, also through the ball. Then the hinge can move the
/// ball along the normal only, or across it only, or not at all.
#[test]
fn a_contact_that_a_joint_cannot_move_is_no_reason_to_fly() {
    let hinge = |axis: &str, place: f64, friction: f64| {
        let height = 0.02 - 1e-5;
        let text = format!(
            r#"<robot name="hinge"><link name="base"/>
            <joint name="hinge" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="{axis}"/>
            <limit lower="-1" upper="1" effort="2" velocity="6"/></joint>
            <link name="bar"><inertial><mass value="0.5"/>
            <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
            <collision><origin xyz="0 {place} {height}"/><geometry><sphere radius="0.02"/></geometry></collision>
            </link></robot>"#
        );
        let floor = FixtureShape::Box { size: [1.0, 1.0, 0.1] };
        let fixtures = vec![fixture("floor", floor, [0.0, 0.0, -0.05], friction)];
        let Hand { mut drives, mut values, .. } = Hand::exact();
        drives.truncate(1);
        "hinge".clone_into(&mut drives[0].joint);
        values.gravity = [0.0; 3];
        values.posture.clear();
        let options = PlantOptions { held_at_start: false, fixtures, ..PlantOptions::exact() };
        let mut plant = Plant::new(&urdf(&text), &drives, &values, &options).unwrap();
        (0..20).for_each(|_| plant.apply(&frame_of(&[-0.1])).unwrap());
        let force: Vector3<f64> = plant.fixture_contacts().iter().map(|contact| contact.force).sum();
        (plant.truth().velocities[0], force)
    };
    for friction in [0.0, 0.5] {
        let (speed, force) = hinge("1 0 0", 0.1, friction);
        assert!(speed.abs() < 1e-4 && (force.z + 1.0).abs() < 1e-4, "{speed} {force}");
        let (speed, force) = hinge("0 0 1", 0.0, friction);
        assert!(speed < -0.1 && speed > -21.0 && force.norm() < 1e-9, "{speed} {force}");
        let (speed, force) = hinge("0 0 1", 0.1, friction);
        assert!(speed < -0.1 && speed > -21.0 && force.norm() < 1e-9, "{speed} {force}");
    }
}
