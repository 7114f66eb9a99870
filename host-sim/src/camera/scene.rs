use super::geometry::Circle;

/// The scene in front of the camera. Lengths in m; brightness is relative, because the camera sets its
/// exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Seed of the surface patterns.
    pub pattern: u32,
    /// The knob.
    pub knob: Knob,
    /// The plate behind it.
    pub rose: Rose,
    /// The door.
    pub door: Door,
    /// The surroundings of the door.
    pub frame: Frame,
    /// The lamps: two near ones that cast shadows.
    pub lamps: [Lamp; 2],
    /// Directions to bright windows, and their brightness.
    pub windows: [([f64; 3], f64); 3],
    /// Uniform ambient light.
    pub ambient: f64,
}

/// A cylinder that stands on the door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knob {
    /// Radius.
    pub radius: f64,
    /// Distance of its tip from the door.
    pub length: f64,
    /// Chamfer of the edge of its tip.
    pub chamfer: f64,
    /// Radius of the button or lock in its tip; 0 for none.
    pub button: f64,
    /// Its surface.
    pub finish: Finish,
}

/// A round plate on the door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rose {
    /// Radius.
    pub radius: f64,
    /// Distance of its face from the door.
    pub thickness: f64,
    /// Chamfer of the edge of its face.
    pub chamfer: f64,
    /// Its surface.
    pub finish: Finish,
}

/// A surface that was turned on a lathe, or moulded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finish {
    /// Fraction of the light that is scattered.
    pub diffuse: f64,
    /// Fraction of the light that is reflected.
    pub specular: f64,
    /// Width of reflections along the grooves of the lathe.
    pub along: f64,
    /// Width across the grooves: if larger than `along`, lamps appear as radial streaks.
    pub across: f64,
    /// Contrast of grooves and stains.
    pub stains: f64,
}

/// The surface of the door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Door {
    /// Fraction of the light that is scattered.
    pub diffuse: f64,
    /// Fraction of the light that is reflected.
    pub specular: f64,
    /// Its pattern.
    pub texture: Texture,
    /// Contrast of the pattern.
    pub contrast: f64,
    /// Distance from the axis of the knob to the edge.
    pub edge: f64,
    /// Side of the edge: 1 right, −1 left.
    pub side: f64,
}

/// Pattern of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texture {
    /// Vertical grain.
    Wood,
    /// Brush strokes and dirt.
    Paint,
}

/// The door frame, behind a dark gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Width of the gap.
    pub gap: f64,
    /// Width of the frame; beyond it is the wall.
    pub width: f64,
    /// Its depth behind the surface of the door.
    pub depth: f64,
    /// Fractions of the light that frame and wall scatter.
    pub diffuse: [f64; 2],
}

/// A lamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Position in the door frame.
    pub position: [f64; 3],
    /// Its brightness at the knob.
    pub brightness: f64,
    /// Its radius, which softens shadows.
    pub radius: f64,
}

impl Scene {
    /// The outer rim of the rose, where its chamfer begins, in the door frame.
    pub fn rose_rim(&self) -> Circle {
        Circle::about_z(self.rose.chamfer - self.rose.thickness, self.rose.radius)
    }

    /// Replaces knob and rose by a black disc of 40 mm radius on white paper: a target that anybody can
    /// print.
    #[must_use]
    pub const fn with_disc(mut self) -> Self {
        const THICKNESS: f64 = 1e-4;
        self.rose.radius = 0.04;
        self.rose.thickness = THICKNESS;
        self.rose.chamfer = 0.0;
        self.rose.finish = Finish { diffuse: 0.04, specular: 0.0, stains: 0.0, ..self.rose.finish };
        self.knob = Knob { radius: 1e-6, length: THICKNESS + 1e-6, chamfer: 0.0, button: 0.0, ..self.knob };
        self.door = Door { diffuse: 0.8, specular: 0.0, texture: Texture::Paint, edge: 0.2, ..self.door };
        self
    }

    /// The outer rim of the knob's tip, where its chamfer begins, in the door frame.
    pub fn knob_rim(&self) -> Circle {
        Circle::about_z(self.knob.chamfer - self.knob.length, self.knob.radius)
    }
}
