//! Random scenes and optics.

use tesaki_rng::Rng;

use super::optics::Optics;
use super::scene::{Door, Finish, Frame, Knob, Lamp, Rose, Scene, Texture};
use crate::purpose::Purpose;

/// Draws a value uniformly within a range.
pub fn within(rng: &mut Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.uniform()
}

impl Scene {
    /// Draws the door of a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = Purpose::DoorScene.rng(seed);
        let rng = &mut rng;
        let finish = finish(rng);
        let same = rng.chance(0.75);
        let other = self::finish(rng);
        let rose = Rose {
            radius: within(rng, [0.035, 0.045]),
            thickness: within(rng, [0.002, 0.006]),
            chamfer: within(rng, [0.0003, 0.0015]),
            finish: if same { finish } else { other },
        };
        let button = rng.chance(0.6);
        let knob = Knob {
            radius: 0.025,
            length: 0.060,
            chamfer: within(rng, [0.0008, 0.004]),
            button: within(rng, [0.004, 0.009]) * f64::from(u8::from(button)),
            finish,
        };
        let door = door(rng);
        let frame = Frame {
            gap: within(rng, [0.002, 0.005]),
            width: within(rng, [0.04, 0.1]),
            depth: within(rng, [0.0, 0.02]),
            diffuse: [within(rng, [0.1, 0.8]), within(rng, [0.4, 0.85])],
        };
        Self {
            pattern: rng.below(u32::MAX),
            knob,
            rose,
            door,
            frame,
            lamps: [lamp(rng, 1.0), lamp(rng, 0.6)],
            windows: core::array::from_fn(|_| window(rng)),
            ambient: within(rng, [0.15, 0.6]),
        }
    }
}

/// Draws turned metal, polished metal, or plastic.
fn finish(rng: &mut Rng) -> Finish {
    let kind = rng.uniform();
    let (diffuse, specular, widths) = match kind {
        kind if kind < 0.5 => ([0.1, 0.35], [0.4, 1.0], [[0.05, 0.15], [0.3, 0.8]]),
        kind if kind < 0.75 => ([0.05, 0.2], [0.5, 1.1], [[0.03, 0.08], [0.05, 0.15]]),
        _ => ([0.15, 0.8], [0.03, 0.12], [[0.1, 0.3], [0.1, 0.3]]),
    };
    let [along, across] = widths;
    Finish {
        diffuse: within(rng, diffuse),
        specular: within(rng, specular),
        along: within(rng, along),
        across: within(rng, across),
        stains: within(rng, [0.02, 0.15]),
    }
}

fn door(rng: &mut Rng) -> Door {
    let texture = if rng.chance(0.6) { Texture::Wood } else { Texture::Paint };
    let contrast = match texture {
        Texture::Wood => [0.04, 0.22],
        Texture::Paint => [0.02, 0.1],
    };
    Door {
        diffuse: within(rng, [0.12, 0.85]),
        specular: within(rng, [0.0, 0.08]),
        texture,
        contrast: within(rng, contrast),
        edge: 0.05,
        side: if rng.chance(0.5) { 1.0 } else { -1.0 },
    }
}

/// Draws a lamp in front of the door and usually above the knob.
fn lamp(rng: &mut Rng, brightness: f64) -> Lamp {
    let position = [within(rng, [-0.2, 1.4]), within(rng, [-1.2, 1.2]), within(rng, [-2.0, -0.35])];
    let brightness = brightness * within(rng, [0.2, 1.0]);
    Lamp { position, brightness, radius: within(rng, [0.02, 0.2]) }
}

fn window(rng: &mut Rng) -> ([f64; 3], f64) {
    let direction = [within(rng, [-0.4, 1.0]), rng.symmetric(), -within(rng, [0.1, 1.0])];
    let norm = libm::sqrt(direction.iter().map(|part| part * part).sum());
    (direction.map(|part| part / norm), within(rng, [0.0, 0.8]))
}

impl Optics {
    /// Draws the camera's errors for the pictures of a seed.
    pub fn draw(seed: u64) -> Self {
        let mut rng = Purpose::Optics.rng(seed);
        let rng = &mut rng;
        let angle = within(rng, [0.0, core::f64::consts::TAU]);
        let path = within(rng, [0.0, 1.0]);
        let gamma = within(rng, [0.45, 1.0]);
        // The exposure control aims at a medium grey, and errs in both directions.
        let grey = within(rng, [0.27, 0.6]);
        Self {
            blur: within(rng, [0.4, 0.9]),
            motion: [path * libm::cos(angle), path * libm::sin(angle)],
            vignetting: within(rng, [0.2, 1.0]),
            mean: libm::pow(grey, 1.0 / gamma),
            gamma,
            read_noise: within(rng, [0.002, 0.008]),
            full_well: within(rng, [4e3, 2e4]),
        }
    }
}
