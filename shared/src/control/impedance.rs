use core::fmt;

use nalgebra::Vector6;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{TICK, math};

/// Minimum mass [kg, kg·m²]; a smaller one has no effect beside the arm's own inertia.
const MIN_MASS: f32 = 1e-3;
/// Maximum mass [kg, kg·m²]; excludes overflow.
const MAX_MASS: f32 = 1e4;
/// Largest `K/M` [1/s²]: a natural frequency of 50 rad/s, half a radian in a control period.
const MAX_STIFFNESS_TO_MASS: f32 = 2500.0;
/// Largest `B/M` [1/s]: one control period takes `1/e` of a velocity.
const MAX_DAMPING_TO_MASS: f32 = 100.0;
/// Below this `|z|` the functions of `√z` come from their series.
const SERIES_RANGE: f32 = 0.05;

/// Target impedance `M ë + B ė + K e = F` of a tool on each axis:
/// `e` is its displacement from the set-point, `F` the external force (Arm7 eq. 2). Axes: x, y, z of the
/// base; translations first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Impedance {
    /// `M` [kg, kg·m²]; at least 0.001.
    pub mass: [f32; 6],
    /// `B` [N·s/m, N·m·s/rad]; not negative.
    pub damping: [f32; 6],
    /// `K` [N/m, N·m/rad]; not negative.
    pub stiffness: [f32; 6],
}

/// A value of an [`Impedance`] outside its limits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InvalidImpedance {
    /// Which of its numbers.
    pub term: ImpedanceTerm,
    /// The axis: 0 to 2 along x, y, z; 3 to 5 about them.
    pub axis: u8,
    /// As given.
    pub value: f32,
    /// Largest possible.
    pub limit: f32,
}

/// A number of an [`Impedance`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImpedanceTerm {
    /// 0: `M`.
    Mass,
    /// 1: `B`.
    Damping,
    /// 2: `K`.
    Stiffness,
}

impl fmt::Display for InvalidImpedance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { term, axis, value, limit } = *self;
        let (name, units) = match term {
            ImpedanceTerm::Mass => ("mass", ["kg", "kg·m²"]),
            ImpedanceTerm::Damping => ("damping", ["N·s/m", "N·m·s/rad"]),
            ImpedanceTerm::Stiffness => ("stiffness", ["N/m", "N·m/rad"]),
        };
        let [unit, turn] = units;
        let (unit, relation) = if axis < 3 { (unit, "along") } else { (turn, "about") };
        let axis = match axis % 3 {
            0 => "x",
            1 => "y",
            _ => "z",
        };
        write!(f, "the {name} {relation} {axis} is {value} {unit}; ")?;
        match term {
            ImpedanceTerm::Mass => write!(f, "possible is {MIN_MASS} to {limit} {unit}"),
            _ => write!(f, "possible with this mass is 0 to {limit} {unit}"),
        }
    }
}

impl Impedance {
    /// Checks that the control period is short enough for this impedance.
    ///
    /// # Errors
    /// The first value outside its limits.
    pub fn validate(&self) -> Result<(), InvalidImpedance> {
        let axes = self.mass.iter().zip(&self.damping).zip(&self.stiffness);
        for (axis, ((&mass, &damping), &stiffness)) in (0..).zip(axes) {
            if !(MIN_MASS..=MAX_MASS).contains(&mass) {
                let (term, limit) = (ImpedanceTerm::Mass, MAX_MASS);
                return Err(InvalidImpedance { term, axis, value: mass, limit });
            }
            for (term, value, max_ratio) in [
                (ImpedanceTerm::Damping, damping, MAX_DAMPING_TO_MASS),
                (ImpedanceTerm::Stiffness, stiffness, MAX_STIFFNESS_TO_MASS),
            ] {
                let limit = mass * max_ratio;
                if !(value >= 0.0 && value <= limit) {
                    return Err(InvalidImpedance { term, axis, value, limit });
                }
            }
        }
        Ok(())
    }

    /// The continuous-time acceleration `M⁻¹ (F − B ė − K e)` (Arm7 step 3). The zero-order hold of a control
    /// period reduces its damping.
    pub fn acceleration(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        let mut result = *force;
        let state = error.iter().zip(velocity.iter());
        let terms = self.mass.iter().zip(&self.damping).zip(&self.stiffness);
        for ((result, (e, v)), ((mass, damping), stiffness)) in result.iter_mut().zip(state).zip(terms) {
            *result = (*result - damping * v - stiffness * e) / mass;
        }
        result
    }

    /// Exact discretisation under zero-order hold: after one control period at a constant force, the velocity
    /// is that of the continuous-time impedance.
    pub fn discretized(&self) -> DiscreteImpedance {
        let mut discrete = DiscreteImpedance {
            error: Vector6::zeros(),
            velocity: Vector6::zeros(),
            force: Vector6::zeros(),
        };
        let gains =
            discrete.error.iter_mut().zip(discrete.velocity.iter_mut()).zip(discrete.force.iter_mut());
        let terms = self.mass.iter().zip(&self.damping).zip(&self.stiffness);
        for (((error, velocity), force), ((mass, damping), stiffness)) in gains.zip(terms) {
            let inverse = 1.0 / mass;
            let half = 0.5 * TICK * damping * inverse;
            // e(t) = exp(−half) (… cos √z …), z positive when it oscillates.
            let z = TICK * TICK * stiffness * inverse - half * half;
            let (cosine, sine) = cosine_and_sinc(z);
            let fade = math::exp(-half);
            let s = fade * sine;
            *force = s * inverse;
            *error = -stiffness * inverse * s;
            *velocity = (fade * cosine - half * s - 1.0) / TICK;
        }
        discrete
    }

    /// Moves all values by `fraction`, 0 to 1, of their difference to `goal`.
    pub fn blend_towards(&mut self, goal: &Self, fraction: f32) {
        let own = self.mass.iter_mut().chain(&mut self.damping).chain(&mut self.stiffness);
        let goal = goal.mass.iter().chain(&goal.damping).chain(&goal.stiffness);
        own.zip(goal).for_each(|(own, goal)| *own += fraction * (goal - *own));
    }
}

/// An [`Impedance`] discretised for the control period: one gain per axis and state.
#[derive(Clone, Copy, Debug)]
pub struct DiscreteImpedance {
    error: Vector6<f32>,
    velocity: Vector6<f32>,
    force: Vector6<f32>,
}

impl DiscreteImpedance {
    /// The acceleration for a displacement, its velocity and an external force, held for one period.
    pub fn acceleration(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        self.error.component_mul(error) + self.velocity.component_mul(velocity) + self.force_response(force)
    }

    /// The part of the acceleration that is due to the force.
    pub fn force_response(&self, force: &Vector6<f32>) -> Vector6<f32> {
        self.force.component_mul(force)
    }
}

/// `cos √z` and `sin √z / √z`, also for negative `z`, where they are those of the hyperbolic functions.
fn cosine_and_sinc(z: f32) -> (f32, f32) {
    if math::abs(z) < SERIES_RANGE {
        let cosine = 1.0 - z * (0.5 - z * (1.0 / 24.0 - z * (1.0 / 720.0)));
        return (cosine, 1.0 - z * (1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0))));
    }
    if z > 0.0 {
        let root = math::sqrt(z);
        let (sine, cosine) = math::sin_cos(root);
        return (cosine, sine / root);
    }
    let root = math::sqrt(-z);
    let (up, down) = (math::exp(root), math::exp(-root));
    (0.5 * (up + down), 0.5 * (up - down) / root)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    const SOFT: Impedance = Impedance { mass: [1.5; 6], damping: [7.5; 6], stiffness: [300.0; 6] };

    /// The acceleration for a displacement and its velocity.
    type Law<'a> = dyn Fn(&Vector6<f32>, &Vector6<f32>) -> Vector6<f32> + 'a;

    /// Positions [m] every 10 ms of a mass that is released 30 mm off, from scipy's matrix exponential
    /// (`tests/oracles/impedance.py`): M 1.5, K 300; B 7.5, 30, 90 (overdamped).
    const RELEASES: &[(f32, &[f64])] = include!("../../../tests/oracles/data/impedance.in");

    #[test]
    #[allow(clippy::cast_possible_truncation, reason = "single precision")]
    fn matched_it_stays_on_the_exact_curve_where_the_printed_law_does_not() {
        for &(damping, exact) in RELEASES {
            let impedance = Impedance { damping: [damping; 6], ..SOFT };
            let discrete = impedance.discretized();
            let run = |law: &Law<'_>| {
                let (mut e, mut v) = (Vector6::repeat(0.03), Vector6::zeros());
                let mut worst = 0.0_f64;
                for exact in exact {
                    worst = worst.max((f64::from(e.x) - exact).abs());
                    let a = law(&e, &v);
                    e += v * TICK + a * (0.5 * TICK * TICK);
                    v += a * TICK;
                }
                worst
            };
            let zero = Vector6::zeros();
            let (ours, printed) = (
                run(&|e, v| discrete.acceleration(e, v, &zero)),
                run(&|e, v| impedance.acceleration(e, v, &zero)),
            );
            assert!(ours < 7e-5, "B {damping}: {ours}");
            assert!(printed > 4e-4, "B {damping}: {printed}");
        }
    }

    #[test]
    fn a_constant_force_is_yielded_to_by_its_size_over_the_stiffness() {
        let discrete = SOFT.discretized();
        let (mut e, mut v) = (Vector6::zeros(), Vector6::zeros());
        let force = Vector6::repeat(3.0);
        for _ in 0..1000 {
            let a = discrete.acceleration(&e, &v, &force);
            e += v * TICK + a * (0.5 * TICK * TICK);
            v += a * TICK;
        }
        assert!((e.x - 0.01).abs() < 1e-6 && v.norm() < 1e-5, "{e} {v}");
    }

    #[test]
    fn bad_numbers_are_named_with_axis_and_limit() {
        let with = |change: fn(&mut Impedance)| {
            let mut impedance = SOFT;
            change(&mut impedance);
            impedance.validate().unwrap_err().to_string()
        };
        assert_eq!(
            with(|i| i.mass[4] = 0.0),
            "the mass about y is 0 kg·m²; possible is 0.001 to 10000 kg·m²"
        );
        assert_eq!(
            with(|i| i.mass[0] = f32::NAN),
            "the mass along x is NaN kg; possible is 0.001 to 10000 kg"
        );
        assert_eq!(
            with(|i| i.damping[1] = -1.0),
            "the damping along y is -1 N·s/m; possible with this mass is 0 to 150 N·s/m"
        );
        assert_eq!(
            with(|i| i.stiffness[5] = 4000.0),
            "the stiffness about z is 4000 N·m/rad; possible with this mass is 0 to 3750 N·m/rad"
        );
        assert!(SOFT.validate().is_ok());
    }
}
