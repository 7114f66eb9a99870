//! Six-axis force sensors between the tips and their links.

use rapier3d::na::{Point3, UnitQuaternion, Vector3, Vector6};
use serde::Deserialize;

use super::random::{Purpose, Random};
use super::tips::Tip;
use super::world::World;
use super::{CONTROL_PERIOD, PlantError};

/// The force sensors, all alike. They are read once in a control period.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSensorValues {
    /// Size of a count, forces [N].
    pub force_count: f64,
    /// Size of a count, torques [N·m].
    pub torque_count: f64,
    /// Where the reading saturates [N].
    pub force_range: f64,
    /// Where the reading saturates [N·m].
    pub torque_range: f64,
    /// Each axis multiplies by 1 ± at most this.
    pub gain_error: f64,
    /// Largest reading without load [N].
    pub force_offset: f64,
    /// Largest reading without load [N·m].
    pub torque_offset: f64,
    /// Standard deviation [N].
    pub force_noise: f64,
    /// Standard deviation [N·m].
    pub torque_noise: f64,
    /// They read the mean over so much time before the reading [s]; over the whole control period if it is not given.
    #[serde(default)]
    pub window: Option<f64>,
}

impl ForceSensorValues {
    pub(super) fn validate(&self) -> Result<(), PlantError> {
        let positive = [
            ("force_count", self.force_count),
            ("torque_count", self.torque_count),
            ("force_range", self.force_range),
            ("torque_range", self.torque_range),
        ];
        let others = [
            ("gain_error", self.gain_error),
            ("force_offset", self.force_offset),
            ("torque_offset", self.torque_offset),
            ("force_noise", self.force_noise),
            ("torque_noise", self.torque_noise),
        ];
        if let Some(window) = self.window
            && !(window > 0.0 && window <= CONTROL_PERIOD)
        {
            let (field, expected) = ("force_sensor.window".to_owned(), "above 0 s, at most a control period");
            return Err(PlantError::Value { field, value: window, expected });
        }
        let bad = |(_, value): &(&str, f64)| !(value.is_finite() && *value >= 0.0);
        let zero = |(_, value): &(&str, f64)| *value <= 0.0;
        match positive.into_iter().find(|item| bad(item) || zero(item)).or(others.into_iter().find(bad)) {
            None => Ok(()),
            Some((field, value)) => Err(PlantError::Value {
                field: format!("force_sensor.{field}"),
                value,
                expected: "at least 0; counts and ranges above 0",
            }),
        }
    }

    /// The value for forces on axes 0 to 2, that for torques on the others.
    const fn of_axis(axis: usize, force: f64, torque: f64) -> f64 {
        if axis < 3 { force } else { torque }
    }

    /// What a board multiplies counts by, of each axis [N], [N·m].
    pub fn scales(&self) -> [f64; 6] {
        core::array::from_fn(|axis| Self::of_axis(axis, self.force_count, self.torque_count))
    }
}

/// What the sensor of a tip is subject to: forces [N] and torques [N·m] of the world on the tip, in the frame of its link
/// and about the origin of that.
struct Gauge {
    gain: [f64; 6],
    offset: [f64; 6],
    wrench: Vector6<f64>,
    /// Sum over the sub-steps of the window of what contacts do.
    contacts: Vector6<f64>,
    /// Velocity of the tip's centre of mass and its angular velocity, when the window began.
    before: (Vector3<f64>, Vector3<f64>),
}

/// All force sensors of a plant.
pub struct ForceSensors {
    values: Option<ForceSensorValues>,
    gauges: Vec<Gauge>,
    random: Random,
    ideal: bool,
    steps: f64,
}

impl ForceSensors {
    /// One for each tip; they read what the world does at rest.
    pub fn new(values: Option<ForceSensorValues>, world: &World, seed: u64, ideal: bool) -> Self {
        let mut random = Random::new(seed, Purpose::ForceSensors);
        let mut sensors = Self {
            values,
            gauges: Vec::new(),
            random: Random::new(seed, Purpose::ForceNoise),
            ideal,
            steps: 0.0,
        };
        for _ in world.tips() {
            let (mut gain, mut offset) = ([1.0; 6], [0.0; 6]);
            for axis in 0..6 {
                let (force, torque) = values.map_or((0.0, 0.0), |v| (v.force_offset, v.torque_offset));
                let error = values.map_or(0.0, |v| v.gain_error) * random.symmetric();
                let shift = ForceSensorValues::of_axis(axis, force, torque) * random.symmetric();
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

    /// How much of a control period they look at [s].
    pub fn window(&self) -> f64 {
        self.values.and_then(|values| values.window).unwrap_or(CONTROL_PERIOD)
    }

    /// Forgets what was before.
    pub fn begin_window(&mut self, world: &World) {
        self.steps = 0.0;
        for (index, (gauge, tip)) in self.gauges.iter_mut().zip(world.tips()).enumerate() {
            gauge.contacts = Vector6::zeros();
            if let Some((_, linear, angular)) = motion(world, index, tip) {
                gauge.before = (linear, angular);
            }
        }
    }

    /// Takes in what contacts, walls, holds and pushes did in the last sub-step.
    pub fn add(&mut self, world: &World) {
        self.steps += 1.0;
        for (index, gauge) in self.gauges.iter_mut().enumerate() {
            if let Some(around) = world.environment().of_tip(index) {
                gauge.contacts += stack(&around.felt.force, &around.felt.torque);
            }
        }
        let Some(grasp) = world.grasp() else { return };
        for (index, (gauge, touch)) in self.gauges.iter_mut().zip(grasp.touches()).enumerate() {
            let Some(frame) = world.tip_frame(index) else { continue };
            let force = -touch.force;
            let torque = (touch.point - frame.translation.vector).cross(&force);
            let turn = frame.rotation.inverse();
            gauge.contacts += stack(&(turn * force), &(turn * torque));
        }
    }

    /// Ends the window [s].
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

    /// The true wrenches, a tip each.
    pub fn wrenches(&self) -> Vec<[f64; 6]> {
        self.gauges.iter().map(|gauge| gauge.wrench.into()).collect()
    }

    /// What the board's converters read now. Reading twice draws noise twice.
    pub fn counts(&mut self) -> Vec<[i32; 6]> {
        let Some(values) = self.values else { return Vec::new() };
        let (random, ideal) = (&mut self.random, self.ideal);
        let mut read = |gauge: &Gauge| {
            core::array::from_fn(|axis| {
                let of_axis = |force, torque| ForceSensorValues::of_axis(axis, force, torque);
                let noise = of_axis(values.force_noise, values.torque_noise) * random.normal();
                let range = of_axis(values.force_range, values.torque_range);
                let exact = gauge.gain[axis] * gauge.wrench[axis] + gauge.offset[axis];
                let value = if ideal { exact } else { exact + noise };
                round(value.clamp(-range, range) / of_axis(values.force_count, values.torque_count))
            })
        };
        self.gauges.iter().map(&mut read).collect()
    }
}

/// What turns vectors of the base's frame into a tip's, the velocity of its centre of mass, and its angular velocity.
fn motion(
    world: &World,
    index: usize,
    tip: &Tip,
) -> Option<(UnitQuaternion<f64>, Vector3<f64>, Vector3<f64>)> {
    let frame = world.tip_frame(index)?;
    let motion = world.motion_at(tip.body, &(frame * Point3::from(tip.center_of_mass)).coords);
    Some((frame.rotation.inverse(), motion.linear, motion.angular))
}

/// What a tip's own mass does to its sensor, `fall` being gravity less the acceleration of the centre of mass. All in the
/// frame of the tip's link.
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
