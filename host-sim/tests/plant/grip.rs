//! The three-finger hand around the paper's box, with torques computed by statics.

use crate::hand::{Hand, JOINTS, frame};
use crate::motion::tip;
use rapier3d::na::{Rotation3, UnitQuaternion, Vector3};
use tesaki_sim::plant::{ObjectValues, Plant, Shape, Support};

/// Centre [m] and pitch [rad] of the box.
pub const MIDDLE: [f64; 3] = [0.090, 0.0, 0.085];
pub const PITCH: f64 = 0.769;
pub const SIZE: [f64; 3] = [0.098, 0.208, 0.060];
pub const MASS: f64 = 0.023;
const RADIUS: f64 = 0.008;
/// Masses of knuckle, lower link, upper link and tip [kg], midway between the joints, and the hand's gravity
/// [m/s²].
const MASSES: [f64; 4] = [0.040, 0.020, 0.010, 0.005];
const GRAVITY: f64 = 6.936_718;

pub fn turned() -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), PITCH)
}

/// Returns the centre of a tip at a gap from the box: two tips at its −x side, one opposite.
fn touching(finger: usize, gap: f64) -> Vector3<f64> {
    let out = SIZE[0] / 2.0 + RADIUS + gap;
    let in_box = [[-out, 0.04, 0.0], [-out, -0.04, 0.0], [out, 0.0, 0.0]][finger];
    Vector3::from(MIDDLE) + turned() * Vector3::from(in_box)
}

/// Computes the angles for a tip position, by Newton's method on the paper's formulae.
fn angles(finger: usize, place: &Vector3<f64>) -> [f64; 3] {
    let mut q = [0.0, 0.4, 1.0];
    for _ in 0..50 {
        let error = place - Vector3::from(tip(finger, q));
        let jacobian = jacobian(finger, q);
        let step = jacobian.lu().solve(&error).unwrap();
        for (q, step) in q.iter_mut().zip(&step) {
            *q += step.clamp(-0.2, 0.2);
        }
    }
    q
}

fn jacobian(finger: usize, q: [f64; 3]) -> rapier3d::na::Matrix3<f64> {
    let column = |joint: usize| {
        let (mut low, mut high) = (q, q);
        low[joint] -= 1e-6;
        high[joint] += 1e-6;
        (Vector3::from(tip(finger, high)) - Vector3::from(tip(finger, low))) / 2e-6
    };
    rapier3d::na::Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// Computes the torques that balance a finger's weight from differences of its potential energy.
fn weight(finger: usize, q: [f64; 3]) -> [f64; 3] {
    let energy = |q: [f64; 3]| {
        let place = |length2: f64, length3: f64| {
            let r = length2 * q[1].sin() + length3 * (q[1] + q[2]).sin();
            let z = length2 * q[1].cos() + length3 * (q[1] + q[2]).cos();
            let (x, y) = (r * q[0].cos(), r * q[0].sin());
            if finger == 2 { Vector3::new(z, -y, x) } else { Vector3::new(x, y, z) }
        };
        let places = [place(0.0, 0.0), place(0.023, 0.0), place(0.046, 0.02589), place(0.046, 0.05178)];
        MASSES.iter().zip(places).map(|(mass, place)| mass * GRAVITY * (place.x + place.z)).sum::<f64>()
    };
    core::array::from_fn(|joint| {
        let (mut low, mut high) = (q, q);
        low[joint] -= 1e-6;
        high[joint] += 1e-6;
        (energy(high) - energy(low)) / 2e-6
    })
}

/// A block under the centre of the box, along its bottom.
fn support() -> Support {
    let below = Vector3::from(MIDDLE) - turned() * Vector3::new(0.0, 0.0, SIZE[2] / 2.0 + 0.01);
    let orientation = UnitQuaternion::from_rotation_matrix(&turned()).coords.into();
    Support { size: [0.05, 0.1, 0.02], position: below.into(), orientation }
}

pub struct Grip {
    pub plant: Plant,
    posture: [[f64; 3]; 3],
}

impl Grip {
    /// Creates a grip with joint friction [N·m] and the given time step [s].
    pub fn new(friction: f64, coulomb: f64, step: f64) -> Self {
        Self::build(friction, Hand::exact().coulomb(coulomb), step, 0.0)
    }

    /// Creates a grip with the box on a support and the tips at a gap from it [m].
    pub fn open(gap: f64) -> Self {
        Self::build(0.6, Hand::exact(), 0.001, gap)
    }

    /// Creates a grip without dry friction in the joints; viscous friction in [N·m·s/rad].
    pub fn viscous(friction: f64, viscous: f64, step: f64) -> Self {
        Self::build(friction, Hand::exact().coulomb(0.0).viscous(viscous), step, 0.0)
    }

    fn build(friction: f64, mut hand: Hand, step: f64, gap: f64) -> Self {
        let posture = [0, 1, 2].map(|finger| angles(finger, &touching(finger, gap)));
        hand.options.posture = Some(posture.concat());
        hand.values.integration.step = step;
        let turn = UnitQuaternion::from_rotation_matrix(&turned());
        hand.options.object = Some(ObjectValues {
            shape: Shape::Box,
            size: SIZE,
            mass: MASS,
            friction,
            friction_spread: 0.0,
            position: MIDDLE,
            orientation: turn.coords.into(),
            support: (gap > 0.0).then(support),
        });
        Self { plant: hand.build(), posture }
    }

    /// Computes the torques for forces of the tips on the box, in the frame of the box [N].
    pub fn torques(&self, forces: [[f64; 3]; 3]) -> [f32; JOINTS] {
        let mut torques = [0.0; JOINTS];
        for (finger, force) in forces.iter().enumerate() {
            let q = self.posture[finger];
            // The force acts at the contact of tip and box; its lever arm about the centre of the tip also
            // adds a torque on the last links.
            let at_tip = jacobian(finger, q).transpose() * (turned() * Vector3::from(*force));
            for (joint, weight) in weight(finger, q).into_iter().enumerate() {
                torques[3 * finger + joint] = (at_tip[joint] + weight) as f32;
            }
        }
        torques
    }

    pub fn hold(&mut self, forces: [[f64; 3]; 3], periods: u32) {
        let torques = self.torques(forces);
        for _ in 0..periods {
            self.plant.apply(&frame(torques)).unwrap();
        }
    }
}

/// Returns the forces of a grip of `force` along the box's x, with each tip's share of the weight along z.
pub fn squeeze(force: f64) -> [[f64; 3]; 3] {
    // By moments about y and the balance of forces: the two opposite sides carry half each.
    let weight = MASS * 9.81;
    let tilt = PITCH - core::f64::consts::FRAC_PI_4;
    let (along, up) = (weight * tilt.sin(), weight * tilt.cos());
    [
        [force / 2.0 - along / 2.0, 0.0, up / 4.0],
        [force / 2.0 - along / 2.0, 0.0, up / 4.0],
        [-force, 0.0, up / 2.0],
    ]
}
