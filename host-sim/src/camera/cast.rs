//! Intersections of rays with the scene.

use rapier3d::na::{Matrix3, Point3, Vector3};

use super::scene::{Rose, Scene};
use super::view::Finger;

/// A finger, prepared for many rays from one point.
pub struct Obstacle {
    origin: Vector3<f64>,
    to_finger: Matrix3<f64>,
    half: [f64; 3],
    /// Direction to its bounding sphere as seen from the origin, and the squared cosine of the sphere's half
    /// angle; 0 if the origin is inside.
    axis: Vector3<f64>,
    cos2: f64,
}

impl Obstacle {
    pub fn new(finger: &Finger, origin: &Point3<f64>) -> Self {
        let axis = finger.pose.translation.vector - origin.coords;
        let radius2 = Vector3::from(finger.half).norm_squared();
        Self {
            origin: finger.pose.inverse_transform_point(origin).coords,
            to_finger: finger.pose.rotation.inverse().to_rotation_matrix().into_inner(),
            half: finger.half,
            axis: axis.normalize(),
            cos2: (1.0 - radius2 / axis.norm_squared()).max(0.0),
        }
    }

    /// Returns the distance to the finger, and the axis of the face's normal with its sign.
    fn meet(&self, ray: &Ray) -> Option<(f64, i8)> {
        let along = self.axis.dot(&ray.direction);
        if self.cos2 > 0.0 && (along < 0.0 || along * along < self.cos2 * ray.direction.norm_squared()) {
            return None;
        }
        let direction = self.to_finger * ray.direction;
        let (mut enter, mut leave, mut face) = (0.0, f64::INFINITY, 0);
        for (axis, half) in self.half.into_iter().enumerate() {
            let inverse = 1.0 / direction[axis];
            let [one, other] = [-half, half].map(|side| (side - self.origin[axis]) * inverse);
            let near = one.min(other);
            if near > enter {
                enter = near;
                let axis = [1, 2, 3][axis];
                face = if inverse > 0.0 { -axis } else { axis };
            }
            leave = leave.min(one.max(other));
        }
        (face != 0 && enter < leave).then_some((enter, face))
    }
}

pub fn obstacles(fingers: &[Finger], origin: &Point3<f64>) -> Vec<Obstacle> {
    fingers.iter().map(|finger| Obstacle::new(finger, origin)).collect()
}

/// A surface that a ray can meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    KnobFace,
    KnobEdge,
    KnobSide,
    RoseFace,
    RoseEdge,
    RoseSide,
    Door,
    Gap,
    Frame,
    Wall,
    /// A finger: its index, and the axis of the face's normal with its sign.
    Finger(u8, i8),
}

#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// The intersection is at origin + `distance` · direction.
    pub distance: f64,
    pub surface: Surface,
}

/// A ray in the door frame, towards the door.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Point3<f64>,
    pub direction: Vector3<f64>,
}

impl Ray {
    pub fn at(&self, distance: f64) -> Point3<f64> {
        self.origin + self.direction * distance
    }

    fn to_plane(self, z: f64) -> f64 {
        (z - self.origin.z) / self.direction.z
    }

    /// Nearest intersection with the surface of revolution `radius = base + slope · z` for z within `range`.
    fn to_cone(self, base: f64, slope: f64, range: [f64; 2]) -> Option<f64> {
        let (o, d) = (self.origin, self.direction);
        let radius = base + slope * o.z;
        let a = d.x * d.x + d.y * d.y - slope * slope * d.z * d.z;
        let b = o.x * d.x + o.y * d.y - slope * d.z * radius;
        let c = o.x * o.x + o.y * o.y - radius * radius;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 || a.abs() < 1e-12 {
            return None;
        }
        let root = discriminant.sqrt();
        let valid = |t: &f64| {
            let z = o.z + t * d.z;
            *t > 0.0 && range[0] <= z && z <= range[1] && base + slope * z > 0.0
        };
        let roots = [(-b - root) / a, (-b + root) / a];
        roots.into_iter().filter(valid).min_by(f64::total_cmp)
    }
}

impl Scene {
    /// Returns the first intersection of a ray towards the door.
    pub(super) fn cast(&self, ray: &Ray, fingers: &[Obstacle]) -> Hit {
        let hit = self.cast_fixed(ray);
        let mut nearest = hit;
        for (index, finger) in (0..).zip(fingers) {
            if let Some((distance, face)) = finger.meet(ray)
                && distance < nearest.distance
            {
                nearest = Hit { distance, surface: Surface::Finger(index, face) };
            }
        }
        nearest
    }

    fn cast_fixed(&self, ray: &Ray) -> Hit {
        if self.passes_near(ray)
            && let Some((distance, surface)) = self.cast_knob(ray).or_else(|| self.cast_rose(ray))
        {
            return Hit { distance, surface };
        }
        let (door, frame) = (&self.door, &self.frame);
        let distance = ray.to_plane(0.0);
        let side = |y: f64| y * door.side;
        if side(ray.at(distance).y) <= door.edge {
            return Hit { distance, surface: Surface::Door };
        }
        let distance = ray.to_plane(frame.depth);
        let beyond = side(ray.at(distance).y) - door.edge - frame.gap;
        let surface = match beyond {
            beyond if beyond < 0.0 => Surface::Gap,
            beyond if beyond < frame.width => Surface::Frame,
            _ => Surface::Wall,
        };
        Hit { distance, surface }
    }

    /// Returns whether a ray enters the smallest cylinder about knob and rose.
    fn passes_near(&self, ray: &Ray) -> bool {
        let [from, to] = [-self.knob.length, 0.0].map(|z| ray.at(ray.to_plane(z)));
        let (x, y) = (to.x - from.x, to.y - from.y);
        let nearest = -(from.x * x + from.y * y) / (x * x + y * y).max(1e-18);
        let nearest = nearest.clamp(0.0, 1.0);
        let (x, y) = (from.x + nearest * x, from.y + nearest * y);
        let radius = self.rose.radius.max(self.knob.radius) + 1e-9;
        x * x + y * y <= radius * radius
    }

    /// Returns the intersection with the knob, which is in front of the rose as seen from the origin of the
    /// rays.
    fn cast_knob(&self, ray: &Ray) -> Option<(f64, Surface)> {
        let knob = Disc {
            radius: self.knob.radius,
            chamfer: self.knob.chamfer,
            z: [-self.knob.length, -self.rose.thickness],
        };
        knob.cast(ray, [Surface::KnobFace, Surface::KnobEdge, Surface::KnobSide])
    }

    fn cast_rose(&self, ray: &Ray) -> Option<(f64, Surface)> {
        let Rose { radius, chamfer, thickness, .. } = self.rose;
        let rose = Disc { radius, chamfer, z: [-thickness, 0.0] };
        rose.cast(ray, [Surface::RoseFace, Surface::RoseEdge, Surface::RoseSide])
    }
}

/// A disc about the z axis from its face to its foot, with a bevelled edge at the face.
struct Disc {
    radius: f64,
    chamfer: f64,
    z: [f64; 2],
}

impl Disc {
    /// Returns where a ray meets it; the given surfaces are those of face, edge and side.
    fn cast(&self, ray: &Ray, [on_face, on_edge, on_side]: [Surface; 3]) -> Option<(f64, Surface)> {
        let [top, foot] = self.z;
        let face = ray.to_plane(top);
        let point = ray.at(face);
        let inner = self.radius - self.chamfer;
        if point.x * point.x + point.y * point.y <= inner * inner {
            return Some((face, on_face));
        }
        let edge = ray.to_cone(inner - top, 1.0, [top, top + self.chamfer]);
        let side = || ray.to_cone(self.radius, 0.0, [top + self.chamfer, foot]);
        edge.map(|t| (t, on_edge)).or_else(|| side().map(|t| (t, on_side)))
    }
}
