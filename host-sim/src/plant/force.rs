//! Six-axis force sensors between the tips and their links.

use rapier3d::na::{Point3, UnitQuaternion, Vector3, Vector6};
use tesaki_rng::Rng;

use super::end_effector::Tip;
use super::values::{CONTROL_PERIOD, ForceSensorValues};
use super::world::World;
use crate::purpose::Purpose;

/// Force sensor of a tip. Wrenches act on the tip: forces [N] and torques [N·m] in the frame of its link,
/// about the origin of that frame.
struct Gauge {
    gain: [f64; 6],
    offset: [f64; 6],
    wrench: Vector6<f64>,
    /// Sum of the contact wrenches over the sub-steps of the window.
    contacts: Vector6<f64>,
    /// Velocity of the tip's centre of mass, and angular velocity of the tip, at the start of the window.
    before: (Vector3<f64>, Vector3<f64>),
}

/// All force sensors of a plant.
pub struct ForceSensors {
    values: Option<ForceSensorValues>,
    gauges: Vec<Gauge>,
    rng: Rng,
    ideal: bool,
    steps: f64,
}

impl ForceSensors {
    /// Creates one sensor for each tip; the first reading is that at rest.
    pub fn new(values: Option<ForceSensorValues>, world: &World, seed: u64, ideal: bool) -> Self {
        let mut rng = Purpose::ForceSensors.rng(seed);
        let mut sensors =
            Self { values, gauges: Vec::new(), rng: Purpose::ForceNoise.rng(seed), ideal, steps: 0.0 };
        for _ in world.tips() {
            let (mut gain, mut offset) = ([1.0; 6], [0.0; 6]);
            for axis in 0..6 {
                let (force, torque) = values.map_or((0.0, 0.0), |v| (v.force_offset, v.torque_offset));
                let error = values.map_or(0.0, |v| v.gain_error) * rng.symmetric();
                let shift = ForceSensorValues::of_axis(axis, force, torque) * rng.symmetric();
                if !ideal {
                    gain[axis] += error;
                    offset[axis] = shift;
                }
            }
            let before = (Vector3::zeros(), Vector3::zeros());
            let (wrench, contacts) = (Vector6::zeros(), Vector6::zeros());
            sensors.gauges.push(Gauge { gain, offset, wrench, contacts, before });
        }
        sensors.begin_window(world);
        sensors.finish(world, f64::INFINITY);
        sensors
    }

    /// Averaging window [s].
    pub fn window(&self) -> f64 {
        self.values.and_then(|values| values.window).unwrap_or(CONTROL_PERIOD)
    }

    /// Begins a new averaging window.
    pub fn begin_window(&mut self, world: &World) {
        self.steps = 0.0;
        for (index, (gauge, tip)) in self.gauges.iter_mut().zip(world.tips()).enumerate() {
            gauge.contacts = Vector6::zeros();
            if let Some((_, linear, angular)) = motion(world, index, tip) {
                gauge.before = (linear, angular);
            }
        }
    }

    /// Adds the wrenches of contacts, walls, holds and pushes in the last sub-step.
    pub fn add(&mut self, world: &World) {
        self.steps += 1.0;
        for (index, gauge) in self.gauges.iter_mut().enumerate() {
            if let Some(around) = world.environment().of_tip(index) {
                gauge.contacts += stack(&around.wrench.force, &around.wrench.torque);
            }
        }
        let Some(grasp) = world.grasp() else { return };
        for (index, (gauge, touch)) in self.gauges.iter_mut().zip(grasp.tip_contacts()).enumerate() {
            let Some(frame) = world.tip_frame(index) else { continue };
            let force = -touch.force;
            let torque = (touch.point - frame.translation.vector).cross(&force);
            let turn = frame.rotation.inverse();
            gauge.contacts += stack(&(turn * force), &(turn * torque));
        }
    }

    /// Ends the averaging window, whose duration is `window` [s], and computes the wrenches.
    pub fn finish(&mut self, world: &World, window: f64) {
        let steps = self.steps.max(1.0);
        for (index, (gauge, tip)) in self.gauges.iter_mut().zip(world.tips()).enumerate() {
            let Some((turn, linear, angular)) = motion(world, index, tip) else { continue };
            let acceleration = (linear - gauge.before.0) / window;
            let turning = (angular - gauge.before.1) / window;
            let own = own_weight(
                tip,
                &(turn * (world.gravity() - acceleration)),
                &(turn * angular),
                &(turn * turning),
            );
            gauge.wrench = gauge.contacts / steps + own;
        }
    }

    /// The true wrench of each tip.
    pub fn wrenches(&self) -> Vec<[f64; 6]> {
        self.gauges.iter().map(|gauge| gauge.wrench.into()).collect()
    }

    /// Reads the board's converters. Each reading draws new noise.
    pub fn counts(&mut self) -> Vec<[i32; 6]> {
        let Some(values) = self.values else { return Vec::new() };
        let (rng, ideal) = (&mut self.rng, self.ideal);
        let mut read = |gauge: &Gauge| {
            core::array::from_fn(|axis| {
                let of_axis = |force, torque| ForceSensorValues::of_axis(axis, force, torque);
                let noise = of_axis(values.force_noise, values.torque_noise) * rng.normal();
                let range = of_axis(values.force_range, values.torque_range);
                let exact = gauge.gain[axis] * gauge.wrench[axis] + gauge.offset[axis];
                let value = if ideal { exact } else { exact + noise };
                round(value.clamp(-range, range) / of_axis(values.force_count, values.torque_count))
            })
        };
        self.gauges.iter().map(&mut read).collect()
    }
}

/// Returns the rotation from the base frame to the frame of a tip, the velocity of the tip's centre of mass,
/// and its angular velocity.
fn motion(
    world: &World,
    index: usize,
    tip: &Tip,
) -> Option<(UnitQuaternion<f64>, Vector3<f64>, Vector3<f64>)> {
    let frame = world.tip_frame(index)?;
    let motion = world.motion_at(tip.body, &(frame * Point3::from(tip.center_of_mass)).coords);
    Some((frame.rotation.inverse(), motion.linear, motion.angular))
}

/// Computes the wrench of a tip's weight and inertia on its sensor. `fall` is gravity minus the acceleration
/// of the centre of mass. All in the frame of the tip's link.
fn own_weight(
    tip: &Tip,
    fall: &Vector3<f64>,
    velocity: &Vector3<f64>,
    acceleration: &Vector3<f64>,
) -> Vector6<f64> {
    let force = fall * tip.mass;
    let spin = tip.inertia * acceleration + velocity.cross(&(tip.inertia * velocity));
    stack(&force, &(tip.center_of_mass.cross(&force) - spin))
}

fn stack(force: &Vector3<f64>, torque: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
}

#[expect(clippy::cast_possible_truncation, reason = "saturates, as a converter does")]
fn round(value: f64) -> i32 {
    libm::round(value) as i32
}
