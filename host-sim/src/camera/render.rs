use rapier3d::na::{Isometry3, Point3, Vector3};

use super::cast::{Hit, Obstacle, Ray, Surface, obstacles};
use super::geometry::Camera;
use super::scene::Scene;
use super::view::Finger;

/// Rays through a pixel at an edge. They form a square lattice that is turned by atan(1/6): it has 37
/// different columns, rows and diagonals, so that edges along those directions are as accurate as others.
const RAYS: u32 = 37;
/// Rows between successive rays.
const STRIDE: u32 = 6;

/// Rays of a camera in the door frame.
pub(super) struct Rays {
    origin: Point3<f64>,
    /// Direction = `corner` + u · `right` + v · `down`.
    corner: Vector3<f64>,
    right: Vector3<f64>,
    down: Vector3<f64>,
}

impl Rays {
    pub fn new(camera: &Camera, pose: &Isometry3<f64>) -> Self {
        Self {
            origin: pose * Point3::origin(),
            corner: pose * camera.ray([0.0, 0.0]),
            right: pose * Vector3::x() / camera.focal,
            down: pose * Vector3::y() / camera.focal,
        }
    }

    pub fn through(&self, u: f64, v: f64) -> Ray {
        Ray { origin: self.origin, direction: self.corner + self.right * u + self.down * v }
    }
}

impl Scene {
    /// Computes the mean radiance of each pixel, row by row, for a camera with a pose in the door frame. The
    /// camera must be in front of the knob and look towards the door.
    pub fn radiances(&self, camera: &Camera, pose: &Isometry3<f64>, fingers: &[Finger]) -> Vec<f32> {
        let rays = Rays::new(camera, pose);
        let boxes = obstacles(fingers, &rays.origin);
        let corners = |row: usize| -> Vec<Surface> {
            let v = row as f64 - 0.5;
            let columns = 0..=camera.width;
            columns.map(|column| self.cast(&rays.through(column as f64 - 0.5, v), &boxes).surface).collect()
        };
        let mut radiances = Vec::with_capacity(camera.width * camera.height);
        let mut above = corners(0);
        for row in 0..camera.height {
            let below = corners(row + 1);
            for column in 0..camera.width {
                let (u, v) = (column as f64, row as f64);
                let ray = rays.through(u, v);
                let hit = self.cast(&ray, &boxes);
                let around = [above[column], above[column + 1], below[column], below[column + 1]];
                let radiance = if self.has_fine_edge(&ray, &hit) {
                    self.mean_radiance(&rays, (u, v), (fingers, &boxes), true)
                } else if around == [hit.surface; 4] {
                    self.radiance(&ray, &hit, fingers)
                } else {
                    self.mean_radiance(&rays, (u, v), (fingers, &boxes), false)
                };
                radiances.push(radiance as f32);
            }
            above = below;
        }
        radiances
    }

    /// Mean radiance of a pixel. Surfaces change little within a pixel: unless `each` is set, one ray
    /// determines the radiance of each surface, and the others only its area fraction.
    fn mean_radiance(
        &self,
        rays: &Rays,
        (u, v): (f64, f64),
        (fingers, boxes): (&[Finger], &[Obstacle]),
        each: bool,
    ) -> f64 {
        let offset = |index: u32| (f64::from(index) + 0.5) / f64::from(RAYS) - 0.5;
        let mut known: Vec<(Surface, f64)> = Vec::new();
        let mut sum = 0.0;
        for index in 0..RAYS {
            let ray = rays.through(u + offset(index), v + offset(index * STRIDE % RAYS));
            let hit = self.cast(&ray, boxes);
            let before = known.iter().find(|(surface, _)| *surface == hit.surface && !each);
            sum += match before {
                Some((_, radiance)) => *radiance,
                None => {
                    known.push((hit.surface, self.radiance(&ray, &hit, fingers)));
                    known.last().map_or(0.0, |(_, radiance)| *radiance)
                }
            };
        }
        sum / f64::from(RAYS)
    }

    /// Returns whether the groove around the button is near.
    fn has_fine_edge(&self, ray: &Ray, hit: &Hit) -> bool {
        if hit.surface != Surface::KnobFace || self.knob.button <= 0.0 {
            return false;
        }
        let point = ray.at(hit.distance);
        let distance = (point.x * point.x + point.y * point.y).sqrt();
        (distance - self.knob.button).abs() < 0.0025
    }
}
