use core::f64::consts::TAU;

use rapier3d::na::Isometry3;
use serde::Serialize;
use tesaki_rng::Rng;

use super::cast::{Ray, obstacles};
use super::geometry::{Camera, Circle};
use super::optics::{Image, Optics};
use super::scene::Scene;
use super::view::Finger;
use crate::purpose::Purpose;

/// Number of points of a rim that are tested for visibility.
const POINTS: u32 = 360;

/// The image of a circle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CircleTruth {
    /// Centre of its ellipse [px].
    pub center: [f64; 2],
    /// Geometric mean of the semi-axes [px].
    pub radius: f64,
    /// The larger and the smaller semi-axis [px].
    pub semi_axes: [f64; 2],
    /// Direction of the larger one, from the image's x to its y [rad].
    pub angle: f64,
    /// Fraction of the rim that is in the image and not covered.
    pub visible: f64,
}

/// True circles in an image. A circle that is not wholly in front of the camera is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ImageTruth {
    /// The outer rim of the rose's face.
    pub rose: Option<CircleTruth>,
    /// The outer rim of the knob's tip.
    pub knob: Option<CircleTruth>,
}

impl Scene {
    /// Takes the picture of a camera with a pose in the door frame. `number` selects the noise among the
    /// pictures of a seed.
    pub fn photograph(
        &self,
        camera: &Camera,
        optics: &Optics,
        pose: &Isometry3<f64>,
        fingers: &[Finger],
        (seed, number): (u64, u32),
    ) -> Image {
        let mut noise = Purpose::ImageNoise.rng(seed);
        let mut noise = Rng::new(noise.next_u64(), number.into());
        optics.expose(camera, self.radiances(camera, pose, fingers), &mut noise)
    }

    /// Returns the true circles in the image of a camera, given its pose in the door frame.
    pub fn truth(&self, camera: &Camera, pose: &Isometry3<f64>, fingers: &[Finger]) -> ImageTruth {
        let circle = |circle: Circle| {
            let ellipse = circle.transformed(&pose.inverse()).image(camera)?;
            let visible = self.visible_share(&circle, camera, pose, fingers);
            Some(CircleTruth {
                center: ellipse.center,
                radius: ellipse.radius(),
                semi_axes: ellipse.semi_axes,
                angle: ellipse.angle,
                visible,
            })
        };
        ImageTruth { rose: circle(self.rose_rim()), knob: circle(self.knob_rim()) }
    }

    fn visible_share(
        &self,
        circle: &Circle,
        camera: &Camera,
        pose: &Isometry3<f64>,
        fingers: &[Finger],
    ) -> f64 {
        // A point slightly outside the surface, because on the far side the surface hides its own rim.
        let outside = Circle { radius: circle.radius * (1.0 + 1e-6), ..*circle };
        let origin = pose.translation.vector.into();
        let fingers = obstacles(fingers, &origin);
        let visible = |index: &u32| {
            let point = outside.point(TAU * f64::from(*index) / f64::from(POINTS));
            let Some(pixel) = camera.project(&pose.inverse_transform_point(&point)) else { return false };
            let ray = Ray { origin, direction: point - origin };
            camera.contains(pixel) && self.cast(&ray, &fingers).distance > 1.0 - 1e-6
        };
        (0..POINTS).filter(visible).count() as f64 / f64::from(POINTS)
    }
}
