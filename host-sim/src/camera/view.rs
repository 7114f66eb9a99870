use rapier3d::na::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::draw::within;
use crate::purpose::Purpose;

/// A box-shaped finger of the gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    /// Pose of its centre in the door frame.
    pub pose: Isometry3<f64>,
    /// Half of its extents [m].
    pub half: [f64; 3],
    /// Fraction of the light that it scatters.
    pub diffuse: f64,
}

/// The place of the hand in front of the door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Pose of the hand frame in the door frame.
    pub hand: Isometry3<f64>,
}

impl View {
    /// Draws a random place on the way to the knob: 6 to 25 cm from the fingertips to the door. At the start,
    /// 21 cm away, the base has errors of ±50 mm sideways and in height, and of ±3° in tilt, heading and
    /// roll; the offset shrinks with the distance, as it does on the way.
    pub fn draw(seed: u64) -> Self {
        const START: f64 = 0.21;
        let mut rng = Purpose::HandView.rng(seed);
        let distance = within(&mut rng, [0.06, 0.25]);
        let offset = 0.05 * (distance / START).min(1.0);
        let [up, right] = core::array::from_fn(|_| offset * rng.symmetric());
        let turn = Vector3::from_fn(|_, _| 3.0_f64.to_radians() * rng.symmetric());
        let place = Translation3::new(up, right, -distance);
        Self { hand: Isometry3::from_parts(place, UnitQuaternion::new(turn)) }
    }

    /// Returns a different place for each `number`, for the calibration of a camera in the hand: 4 to 28 cm
    /// from the door, up to 40 % of the camera's distance to the side, rotated by up to 30° about the
    /// approach direction and up to 14° about the other axes.
    pub fn for_calibration(seed: u64, number: u64) -> Self {
        let mut rng = Purpose::CalibrationViews.rng(seed.wrapping_add(number << 32));
        let distance = within(&mut rng, [0.04, 0.28]);
        let offset = 0.4 * (distance + 0.1);
        let [up, right] = core::array::from_fn(|_| offset * rng.symmetric());
        let [about_x, about_y, about_z] = [0.25, 0.25, 0.52].map(|most| most * rng.symmetric());
        let turn = UnitQuaternion::new(Vector3::new(about_x, about_y, about_z));
        Self { hand: Isometry3::from_parts(Translation3::new(up, right, -distance), turn) }
    }

    /// Returns the fingers of the gripper of `robots/knob-arm`, each turned outwards by `angle` from parallel
    /// pads 50 mm apart [rad].
    pub fn fingers(&self, angle: f64) -> [Finger; 2] {
        const HALF: [f64; 3] = [0.009, 0.005, 0.05];
        [-1.0, 1.0].map(|side| {
            let pivot = Translation3::new(0.0, side * 0.030, -2.0 * HALF[2]);
            let turn = UnitQuaternion::new(Vector3::x() * (-side * angle));
            let pose = self.hand * pivot * turn * Translation3::new(0.0, 0.0, HALF[2]);
            Finger { pose, half: HALF, diffuse: 0.12 }
        })
    }
}
