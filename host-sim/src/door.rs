//! A door with a knob in front of an arm: the pictures of its hand camera, and the bodies that the hand
//! touches.

use rapier3d::na::{Isometry3, Translation3, UnitQuaternion, Vector3};
use tesaki::model::RobotModel;
use tesaki::task::visual_approach::VisualApproachSettings;

use crate::camera::{Camera, CameraValues, Image, ImageTruth, Optics, Scene, View};
use crate::plant::{Fixture, FixtureShape, Plant, isometry};
use crate::purpose::Purpose;

/// Distance of the fingertips from the door in the start posture, with the base at its nominal pose [m].
const START: f64 = 0.21;
/// Largest displacement of the base along x and y [m], and largest error of its heading and tilt [rad].
const DISPLACEMENT: f64 = 0.05;
const TURN: f64 = 3.0 * core::f64::consts::PI / 180.0;
/// Coefficient of friction between the fingers and everything else.
const FRICTION: f64 = 0.8;
/// Height, width and thickness of the door [m].
const DOOR: [f64; 3] = [2.0, 0.9, 0.05];
/// Ratio of a finger's rotation to the gripper's angle.
const LINKAGE: f64 = -0.25;
/// Index of the knob in [`KnobDoor::fixtures`].
pub const KNOB: usize = 2;

/// A door with its surfaces, light and pose.
#[derive(Clone, Debug)]
pub struct KnobDoor {
    /// Door, rose and knob.
    pub scene: Scene,
    /// Light and camera.
    pub optics: Optics,
    /// Pose of the door in the base frame.
    pub pose: Isometry3<f64>,
    seed: u64,
}

impl KnobDoor {
    /// Draws a random door; the pose of the base in front of it has errors of centimetres and degrees.
    /// `start` is the pose of the hand in the base frame.
    pub fn draw(seed: u64, start: &Isometry3<f64>) -> Self {
        let pose = base_in_door(start, seed).inverse();
        Self { scene: Scene::draw(seed), optics: Optics::draw(seed), pose, seed }
    }

    /// Returns door, rose and knob in the base frame.
    pub fn fixtures(&self) -> Vec<Fixture> {
        let Scene { door, rose, knob, .. } = &self.scene;
        let at = |y: f64, z: f64| self.pose * Isometry3::translation(0.0, y, z);
        let middle = door.side * (door.edge - 0.5 * DOOR[1]);
        // Uses the bevels that the camera sees; that of the rose is limited by its thickness.
        let cylinder = |radius: f64, length: f64, chamfer: f64| {
            let chamfer = chamfer.min(0.4 * length);
            (FixtureShape::BevelledCylinder { radius, length, chamfer }, at(0.0, -0.5 * length))
        };
        let parts = [
            ("door", (FixtureShape::Box { size: DOOR }, at(middle, 0.5 * DOOR[2]))),
            ("rose", cylinder(rose.radius, rose.thickness, rose.chamfer)),
            ("knob", cylinder(knob.radius, knob.length, knob.chamfer)),
        ];
        let fixture =
            |(name, (shape, pose)): (&str, _)| Fixture { name: name.into(), shape, pose, friction: FRICTION };
        parts.map(fixture).into()
    }

    /// Takes picture number `number` from a hand at `hand` in the door frame, with the gripper at the angle
    /// `opening` [rad].
    pub fn photograph(
        &self,
        camera: &CameraValues,
        hand: &Isometry3<f64>,
        opening: f64,
        number: u32,
    ) -> Image {
        let fingers = View { hand: *hand }.fingers(LINKAGE * opening);
        let pose = hand * camera.mount();
        self.scene.photograph(&Camera::of(camera), &self.optics, &pose, &fingers, (self.seed, number))
    }

    /// Returns the true circles in that picture.
    pub fn truth(&self, camera: &CameraValues, hand: &Isometry3<f64>, opening: f64) -> ImageTruth {
        let fingers = View { hand: *hand }.fingers(LINKAGE * opening);
        self.scene.truth(&Camera::of(camera), &(hand * camera.mount()), &fingers)
    }
}

/// Returns the index of the plant's tip that is the hand, and that of the gripper's joint.
pub fn hand_joints(model: &RobotModel, task: &VisualApproachSettings, plant: &Plant) -> [usize; 2] {
    let name = model.chains.get(usize::from(task.chain)).map(|chain| chain.name.as_str());
    let hand = plant.tips().iter().position(|tip| Some(tip.link.as_str()) == name);
    [hand.unwrap_or_default(), usize::from(task.gripper.joint)]
}

/// Returns the true pose of the hand frame in the base frame, as if the gripper were at 0. `hand` is the
/// index of the hand's tip, `gripper` that of the gripper's joint.
pub fn hand_pose(plant: &Plant, hand: usize, gripper: usize) -> Isometry3<f64> {
    let Some(tip) = plant.tips().into_iter().nth(hand) else { return Isometry3::identity() };
    let angle = plant.truth().positions.get(gripper).copied().unwrap_or_default();
    let screw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -angle);
    isometry(tip.position, tip.orientation) * screw
}

/// Returns the pose, in the door frame, of a base with errors of centimetres and degrees. `start` is that of
/// the hand in the base frame.
fn base_in_door(start: &Isometry3<f64>, seed: u64) -> Isometry3<f64> {
    let mut rng = Purpose::BasePlace.rng(seed);
    let right = Isometry3::translation(0.0, 0.0, -START) * start.inverse();
    let [x, y] = core::array::from_fn(|_| DISPLACEMENT * rng.symmetric());
    let [heading, tilt] = core::array::from_fn(|_| TURN * rng.symmetric());
    let direction = core::f64::consts::PI * rng.symmetric();
    let axis = Vector3::new(libm::cos(direction), libm::sin(direction), 0.0);
    let turn = UnitQuaternion::new(Vector3::z() * heading) * UnitQuaternion::new(axis * tilt);
    right * Isometry3::from_parts(Translation3::new(x, y, 0.0), turn)
}
