//! Radiance of the points of the scene.

use rapier3d::na::{Point3, Vector3};

use super::cast::{Hit, Ray, Surface};
use super::scene::{Finish, Lamp, Scene, Texture};
use super::view::Finger;

impl Scene {
    /// Returns the radiance along a ray that meets the scene.
    pub(super) fn radiance(&self, ray: &Ray, hit: &Hit, fingers: &[Finger]) -> f64 {
        let point = ray.at(hit.distance);
        let view = -ray.direction.normalize();
        let (knob, rose) = (&self.knob, &self.rose);
        let front = -Vector3::z();
        match hit.surface {
            Surface::KnobFace => self.face(&point, &view, &knob.finish, 1),
            Surface::KnobEdge => self.turned(&point, &(front + radial(&point)), &view, &knob.finish, 1),
            Surface::KnobSide => self.turned(&point, &radial(&point), &view, &knob.finish, 2),
            Surface::RoseFace => self.turned(&point, &front, &view, &rose.finish, 3),
            Surface::RoseEdge => self.turned(&point, &(front + radial(&point)), &view, &rose.finish, 3),
            Surface::RoseSide => self.turned(&point, &radial(&point), &view, &rose.finish, 3),
            Surface::Door => self.door_surface(&point, &view),
            Surface::Gap => 0.02 * self.ambient,
            Surface::Frame => self.matt(&point, self.frame.diffuse[0], 4),
            Surface::Wall => self.matt(&point, self.frame.diffuse[1], 5),
            Surface::Finger(index, face) => {
                let Some(finger) = fingers.get(usize::from(index)) else { return 0.0 };
                let mut normal = Vector3::zeros();
                normal[usize::from(face.unsigned_abs()) - 1] = f64::from(face.signum());
                let normal = finger.pose * normal;
                let lamps: f64 = self.lamps.iter().map(|lamp| lamp.on(&point, &normal)).sum();
                finger.diffuse * (self.ambient + lamps)
            }
        }
    }

    /// Returns the light from the face of the knob, with its button.
    fn face(&self, point: &Point3<f64>, view: &Vector3<f64>, finish: &Finish, layer: u32) -> f64 {
        let distance = from_axis(point);
        let groove = distance - self.knob.button;
        if self.knob.button > 0.0 && groove.abs() < 0.0006 {
            return 0.1 * self.ambient * finish.diffuse;
        }
        // The button is slightly convex.
        let dome = if groove < 0.0 { 0.15 * distance / self.knob.button } else { 0.0 };
        self.turned(point, &(radial(point) * dome - Vector3::z()), view, finish, layer)
    }

    /// Returns the light from a turned surface: scattered, and reflected with different widths along and
    /// across the grooves (Ward, SIGGRAPH 1992).
    fn turned(
        &self,
        point: &Point3<f64>,
        normal: &Vector3<f64>,
        view: &Vector3<f64>,
        finish: &Finish,
        layer: u32,
    ) -> f64 {
        let normal = normal.normalize();
        let outward = radial(point);
        let along = Vector3::new(-outward.y, outward.x, 0.0);
        let across = normal.cross(&along);
        let stain = 1.0 + finish.stains * self.stain(point, layer);
        let widths = [1.0 / finish.along, 1.0 / finish.across];
        let gloss = |light: &Vector3<f64>| {
            let half = (light + view).normalize();
            let [a, b] = [half.dot(&along) * widths[0], half.dot(&across) * widths[1]];
            let square = (a * a + b * b) / half.dot(&normal).powi(2).max(1e-3);
            if square > 20.0 { 0.0 } else { libm::exp(-square) }
        };
        let mut light = finish.diffuse * self.ambient + finish.specular * self.surroundings(&normal, view);
        for lamp in &self.lamps {
            let to = Vector3::from(lamp.position) - point.coords;
            let direction = to.normalize();
            let lit = direction.dot(&normal);
            if lit > 0.0 {
                let shadow = if layer == 3 { self.knob_shadow(point, lamp) } else { 1.0 };
                let reflected = 1.5 * finish.specular * gloss(&direction);
                light += shadow * lamp.brightness * (finish.diffuse * lit + reflected);
            }
        }
        for (direction, brightness) in &self.windows {
            let direction = Vector3::from(*direction);
            if direction.dot(&normal) > 0.0 {
                light += finish.specular * brightness * gloss(&direction);
            }
        }
        if layer == 3 {
            // Less light reaches the corner between rose and knob.
            let gap = from_axis(point) - self.knob.radius;
            light *= 1.0 - 0.5 * libm::exp(-gap.max(0.0) / 0.006);
        }
        light * stain
    }

    /// Returns the surroundings that a polished surface mirrors, except lamps: a bright ceiling, a dim room,
    /// a dark floor.
    fn surroundings(&self, normal: &Vector3<f64>, view: &Vector3<f64>) -> f64 {
        let reflected = normal * (2.0 * normal.dot(view)) - view;
        let up = smooth((reflected.x + 0.35) / 0.7);
        self.ambient * (0.15 + 0.75 * up)
    }

    fn door_surface(&self, point: &Point3<f64>, view: &Vector3<f64>) -> f64 {
        let door = &self.door;
        let [up, right] = [point.x, point.y];
        let pattern = match door.texture {
            Texture::Wood => {
                let bend = self.noise([3.0 * up, 14.0 * right], 10);
                let rings = libm::sin(40.0 * (8.0 * right + bend));
                let pores = self.noise([25.0 * up, 900.0 * right], 11);
                0.35 * rings + 0.9 * self.noise([6.0 * up, 120.0 * right], 12) + 0.6 * pores
            }
            Texture::Paint => {
                self.noise([60.0 * up, 60.0 * right], 10) + 0.8 * self.noise([400.0 * up, 900.0 * right], 11)
            }
        };
        let scattered = door.diffuse * (1.0 + door.contrast * pattern).max(0.1);
        let normal = -Vector3::z();
        let mut light = scattered * self.ambient;
        for lamp in &self.lamps {
            let to = (Vector3::from(lamp.position) - point.coords).normalize();
            let lit = to.dot(&normal);
            if lit > 0.0 {
                // Blinn's lobe: `half` is the cosine of the angle between the normal and the bisector.
                let half = (to + view).normalize().dot(&normal);
                let fall = 60.0 * (1.0 - half);
                let gloss = if fall > 12.0 { 0.0 } else { door.specular * 8.0 * libm::exp(-fall) };
                let shadow = self.knob_shadow(point, lamp) * self.rose_shadow(point, lamp);
                light += lamp.brightness * shadow * (scattered * lit + gloss);
            }
        }
        let distance = (from_axis(point) - self.rose.radius).max(0.0) / (0.7 * self.rose.thickness);
        if distance > 8.0 { light } else { light * (1.0 - 0.35 * libm::exp(-distance)) }
    }

    fn matt(&self, point: &Point3<f64>, diffuse: f64, layer: u32) -> f64 {
        let normal = -Vector3::z();
        let lamps: f64 = self.lamps.iter().map(|lamp| lamp.on(point, &normal)).sum();
        let grain = 1.0 + 0.06 * self.noise([300.0 * point.x, 300.0 * point.y], layer);
        diffuse * grain * (self.ambient + lamps)
    }

    fn knob_shadow(&self, point: &Point3<f64>, lamp: &Lamp) -> f64 {
        lamp.shadow_of(point, self.knob.radius, self.knob.length)
    }

    fn rose_shadow(&self, point: &Point3<f64>, lamp: &Lamp) -> f64 {
        lamp.shadow_of(point, self.rose.radius, self.rose.thickness)
    }

    /// Returns the pattern of lathe grooves and stains, −1 to 1.
    fn stain(&self, point: &Point3<f64>, layer: u32) -> f64 {
        let distance = from_axis(point) + 0.3 * point.z;
        let grooves = self.noise([1500.0 * distance, 0.0], layer + 20);
        0.6 * grooves + 0.6 * self.noise([250.0 * point.x, 250.0 * (point.y + point.z)], layer + 30)
    }

    /// Returns smooth random values over a plane, −1 to 1, on a grid of width 1.
    fn noise(&self, [x, y]: [f64; 2], layer: u32) -> f64 {
        let (column, row) = (x.floor(), y.floor());
        let (right, up) = (smooth(x - column), smooth(y - row));
        let at = |dx: i32, dy: i32| {
            let [column, row] = [column as i32, row as i32];
            let mut hash = (column.wrapping_add(dx) as u32).wrapping_mul(0x9E37_79B1);
            hash ^= (row.wrapping_add(dy) as u32).wrapping_mul(0x85EB_CA77);
            hash ^= self.pattern.wrapping_add(layer.wrapping_mul(0xC2B2_AE3D));
            hash = (hash ^ (hash >> 15)).wrapping_mul(0x2C1B_3C6D);
            hash = (hash ^ (hash >> 12)).wrapping_mul(0x297A_2D39);
            f64::from(hash ^ (hash >> 15)) * TO_ONE - 1.0
        };
        let below = at(0, 0) + (at(1, 0) - at(0, 0)) * right;
        let above = at(0, 1) + (at(1, 1) - at(0, 1)) * right;
        below + (above - below) * up
    }
}

impl Lamp {
    /// Returns the light on a point of a surface.
    fn on(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let to = (Vector3::from(self.position) - point.coords).normalize();
        self.brightness * to.dot(normal).max(0.0)
    }

    /// Returns the fraction of the lamp that is visible past a cylinder about the z axis from a point behind
    /// it. The penumbra follows from the distance between the axis and the ray to the lamp's centre.
    fn shadow_of(&self, point: &Point3<f64>, radius: f64, length: f64) -> f64 {
        let to = Vector3::from(self.position) - point.coords;
        // Where the ray leaves the height of the cylinder.
        let end = if to.z < 0.0 { (-length - point.z) / to.z } else { 1.0 };
        if end <= 0.0 {
            return 1.0;
        }
        let nearest = -(point.x * to.x + point.y * to.y) / (to.x * to.x + to.y * to.y).max(1e-12);
        let nearest = nearest.clamp(0.0, end.min(1.0));
        let distance = from_axis(&(point + to * nearest));
        // Half the width of the penumbra.
        let soft = self.radius * nearest + 1e-4;
        smooth(0.5 + (distance - radius) / (2.0 * soft))
    }
}

/// 2⁻³¹.
const TO_ONE: f64 = 1.0 / 2_147_483_648.0;

/// Distance from the axis of knob and rose [m].
fn from_axis(point: &Point3<f64>) -> f64 {
    (point.x * point.x + point.y * point.y).sqrt()
}

/// Unit vector away from the axis of knob and rose.
fn radial(point: &Point3<f64>) -> Vector3<f64> {
    let norm = from_axis(point).max(1e-9);
    Vector3::new(point.x / norm, point.y / norm, 0.0)
}

/// Rises smoothly from 0 to 1, with slopes of 0 at the ends.
fn smooth(value: f64) -> f64 {
    let value = value.clamp(0.0, 1.0);
    value * value * (3.0 - 2.0 * value)
}
