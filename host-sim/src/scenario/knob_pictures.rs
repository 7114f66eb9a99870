//! Pictures of a door knob, and what an arm knows before it looks for the rose in them.

use rapier3d::na::Vector3;
use tesaki::vision::{CircleSearch, Window};
use tesaki_rng::Rng;

use crate::camera::{Camera, CameraValues, CircleTruth, Image, Optics, Scene, View};
use crate::purpose::Purpose;

/// Of the pictures of a machine, the last ones that show no knob.
pub(super) const EMPTY: usize = 5;
/// Radii of roses [m], and how well the arm knows its distance from the door [m].
const ROSES: [f64; 2] = [0.035, 0.045];
const DISTANCE_ERROR: f64 = 0.03;
/// How far the hand is turned from the axis of the knob about each of its axes, at most [rad].
const AXIS_ERROR: f64 = 0.052;
/// When the last picture is known: the error of what it predicts, and the window about it [px].
const PREDICTION_ERROR: f64 = 6.0;
const REACH: f32 = 12.0;
/// Angle of the open fingers of the gripper [rad].
const OPEN: f64 = 0.22;

/// A picture of a door.
pub struct KnobPicture {
    /// Of the lens from the door [m].
    pub distance: f64,
    /// What the camera saw.
    pub image: Image,
    /// The outline of the rose; None if there is no knob, or if a part of it is behind the camera.
    pub truth: Option<CircleTruth>,
    /// What is looked for in the whole picture.
    pub search: CircleSearch,
    /// Where the last picture lets the rose be expected; None if there is none, or outside the picture.
    pub window: Option<Window>,
}

/// The pictures of a machine of the scenario `knob-find`, one after the other; the last five show no knob.
pub struct KnobPictures {
    camera: Camera,
    values: CameraValues,
    scene: Scene,
    rng: Rng,
    seed: u64,
    number: usize,
    count: usize,
}

impl KnobPictures {
    /// Of a seed, `count` pictures.
    pub fn new(values: CameraValues, seed: u64, count: usize) -> Self {
        let rng = Purpose::CircleSearch.rng(seed);
        Self { camera: Camera::of(&values), values, scene: Scene::draw(seed), rng, seed, number: 0, count }
    }
}

impl Iterator for KnobPictures {
    type Item = KnobPicture;

    fn next(&mut self) -> Option<KnobPicture> {
        if self.number >= self.count {
            return None;
        }
        let is_empty = self.number + EMPTY >= self.count;
        let own = self.seed.wrapping_add((self.number as u64 + 1) << 32);
        self.number += 1;
        let Self { camera, values, scene, rng, .. } = self;
        let mut view = View::draw(own);
        if is_empty {
            // Along the door, away from its edge.
            view.hand.translation.y -= 0.4 * scene.door.side;
        }
        let fingers = view.fingers(OPEN);
        let pose = view.hand * values.mount();
        let image = scene.photograph(camera, &Optics::draw(own), &pose, &fingers, (own, 0));
        let truth = if is_empty { None } else { scene.truth(camera, &pose, &fingers).rose };
        let distance = -pose.translation.z;
        let known = distance + DISTANCE_ERROR * rng.symmetric();
        let radius = [
            camera.focal * ROSES[0] / (known + DISTANCE_ERROR),
            camera.focal * ROSES[1] / (known - DISTANCE_ERROR),
        ];
        // The knob stands along the approach of the hand.
        let approach = values.mount().inverse_transform_vector(&Vector3::z());
        let axis = camera.project(&approach.into()).map(|place| Window {
            center: place.map(|value| value as f32),
            reach: (camera.focal * AXIS_ERROR) as f32,
        });
        let search = CircleSearch { radius: radius.map(|radius| radius as f32), window: None, axis };
        let window = truth
            .map(|truth| {
                let center = truth.center.map(|center| (center + PREDICTION_ERROR * rng.symmetric()) as f32);
                Window { center, reach: REACH }
            })
            .filter(|window| camera.contains(window.center.map(f64::from)));
        Some(KnobPicture { distance, image, truth, search, window })
    }
}
