use core::fmt;

use nalgebra::{Matrix3, Matrix6, MatrixView, U1, U3, U6, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::coupling::{self, ImpedanceCoupling};
use crate::math::Ldlt;
use crate::{TICK, math};

/// Minimum mass [kg, kg·m²]; a smaller one is negligible compared with the arm's own inertia.
const MIN_MASS: f32 = 1e-3;
/// Maximum mass [kg, kg·m²]; excludes overflow.
const MAX_MASS: f32 = 1e4;
/// Largest `K/M` [1/s²]: a natural frequency of 50 rad/s, half a radian in a control period.
const MAX_STIFFNESS_TO_MASS: f32 = 2500.0;
/// Largest `B/M` [1/s]: a velocity decays to `1/e` in one control period.
const MAX_DAMPING_TO_MASS: f32 = 100.0;
/// Below this `|z|` the functions of `√z` come from their series.
const SERIES_RANGE: f32 = 0.05;
/// Last power of the period in the power series of coupled axes. Within the limits above, the next term is
/// less than 1e-8 of the first.
const SERIES_ORDER: u8 = 12;
/// Negative damping or stiffness, as a fraction of the largest possible one, that counts as rounding error of
/// a semi-definite matrix.
const ROUNDING: f32 = 1e-5;

/// Target impedance `M ë + B ė + K e = F` of a tool:
/// `e` is its displacement from the set-point, `F` the external force (Arm7 eq. 2). Rows and columns of the
/// symmetric matrices: along x, y, z, then about them. `M` is positive definite; `B` and `K` are positive
/// semi-definite: an axis may have no spring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Impedance {
    /// Diagonal of `M` [kg, kg·m²]; at least 0.001.
    pub mass: [f32; 6],
    /// Diagonal of `B` [N·s/m, N·m·s/rad]; not negative.
    pub damping: [f32; 6],
    /// Diagonal of `K` [N/m, N·m/rad]; not negative.
    pub stiffness: [f32; 6],
    /// Axes of the matrices.
    pub axes: ImpedanceAxes,
    /// Elements off the diagonals; `None`: all are 0.
    pub coupling: Option<ImpedanceCoupling>,
}

/// Axes in which the matrices of an [`Impedance`] are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImpedanceAxes {
    /// 0: of the base.
    Base,
    /// 1: of the tool, in its present orientation.
    Tool,
}

/// A value of an [`Impedance`] outside its limits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InvalidImpedance {
    /// The invalid number.
    pub term: ImpedanceTerm,
    /// The axis: 0 to 2 along x, y, z; 3 to 5 about them.
    pub axis: u8,
    /// The value; for a matrix, the pivot.
    pub value: f32,
    /// Maximum; for a pivot, the minimum.
    pub limit: f32,
}

/// A number of an [`Impedance`], or a pivot of one of its matrices: a diagonal element of `D` in the
/// factorisation `L D Lᵀ`, in the unit of its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ImpedanceTerm {
    /// 0: `M`.
    Mass,
    /// 1: `B`.
    Damping,
    /// 2: `K`.
    Stiffness,
    /// 3: the pivot of the matrix `M`, which is not positive definite.
    MassMatrix,
    /// 4: the pivot of the matrix `B`, which is not positive semi-definite.
    DampingMatrix,
    /// 5: the pivot of the matrix `K`, which is not positive semi-definite.
    StiffnessMatrix,
    /// 6: the pivot of `100 M − B`, which is not positive semi-definite.
    DampingToMass,
    /// 7: the pivot of `2500 M − K`, which is not positive semi-definite.
    StiffnessToMass,
}

/// Name of the axis along (0 to 2) or about (3 to 5) which a component acts.
pub(crate) const fn axis_name(axis: u8) -> &'static str {
    match axis % 3 {
        0 => "x",
        1 => "y",
        _ => "z",
    }
}

impl fmt::Display for InvalidImpedance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { term, axis, value, limit } = *self;
        let (name, units) = match term {
            ImpedanceTerm::Mass | ImpedanceTerm::MassMatrix => ("mass", ["kg", "kg·m²"]),
            ImpedanceTerm::Damping | ImpedanceTerm::DampingMatrix | ImpedanceTerm::DampingToMass => {
                ("damping", ["N·s/m", "N·m·s/rad"])
            }
            ImpedanceTerm::Stiffness | ImpedanceTerm::StiffnessMatrix | ImpedanceTerm::StiffnessToMass => {
                ("stiffness", ["N/m", "N·m/rad"])
            }
        };
        let [unit, turn] = units;
        let (unit, relation) = if axis < 3 { (unit, "along") } else { (turn, "about") };
        let axis = axis_name(axis);
        match term {
            ImpedanceTerm::Mass => write!(
                f,
                "the {name} {relation} {axis} is {value} {unit}; possible is {MIN_MASS} to {limit} {unit}"
            ),
            ImpedanceTerm::Damping | ImpedanceTerm::Stiffness => write!(
                f,
                "the {name} {relation} {axis} is {value} {unit}; possible with this mass is 0 to {limit} {unit}"
            ),
            ImpedanceTerm::MassMatrix => write!(
                f,
                "the {name} matrix is not positive definite: its pivot {relation} {axis} is {value} {unit}; it must be \
                 at least {limit} {unit}"
            ),
            ImpedanceTerm::DampingMatrix | ImpedanceTerm::StiffnessMatrix => write!(
                f,
                "the {name} matrix is not positive semi-definite: its pivot {relation} {axis} is {value} {unit}; it \
                 must not be negative"
            ),
            ImpedanceTerm::DampingToMass | ImpedanceTerm::StiffnessToMass => {
                let ratio = if term == ImpedanceTerm::DampingToMass {
                    MAX_DAMPING_TO_MASS
                } else {
                    MAX_STIFFNESS_TO_MASS
                };
                write!(
                    f,
                    "the {name} matrix is too large for this mass: {ratio} times the mass minus the {name} has the \
                     pivot {value} {unit} {relation} {axis}; it must not be negative"
                )
            }
        }
    }
}

impl core::error::Error for InvalidImpedance {}

impl Impedance {
    /// An impedance in the axes of the base, without coupling; in the units of the fields.
    pub const fn diagonal(mass: [f32; 6], damping: [f32; 6], stiffness: [f32; 6]) -> Self {
        Self { mass, damping, stiffness, axes: ImpedanceAxes::Base, coupling: None }
    }

    /// `M`, `B` and `K`.
    fn matrices(&self, coupling: &ImpedanceCoupling) -> [Matrix6<f32>; 3] {
        [
            coupling::symmetric(&self.mass, &coupling.mass),
            coupling::symmetric(&self.damping, &coupling.damping),
            coupling::symmetric(&self.stiffness, &coupling.stiffness),
        ]
    }

    /// Checks that each mass is 0.001 to 10 000 kg or kg·m², and that `0 ≤ B ≤ 100 M` and `0 ≤ K ≤ 2500 M`,
    /// in 1/s and 1/s²: then the control period is short enough for this impedance. With coupled axes `M`
    /// must be positive definite, and the bounds hold in the order of symmetric matrices.
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
        self.coupling.as_ref().map_or(Ok(()), |coupling| self.validate_matrices(coupling))
    }

    /// Checks that `M` is positive definite and that `0 ≤ B ≤ 100 M` and `0 ≤ K ≤ 2500 M`, in the order of
    /// symmetric matrices.
    fn validate_matrices(&self, coupling: &ImpedanceCoupling) -> Result<(), InvalidImpedance> {
        let [mass, damping, stiffness] = self.matrices(coupling);
        let check = |term, matrix: &Matrix6<f32>, limit| match coupling::small_pivot(matrix, limit) {
            Some((axis, value)) => Err(InvalidImpedance { term, axis, value, limit }),
            None => Ok(()),
        };
        check(ImpedanceTerm::MassMatrix, &mass, MIN_MASS)?;
        let diagonal = Matrix6::from_diagonal(&Vector6::from(self.mass));
        for (matrix, max_ratio, negative, too_large) in [
            (damping, MAX_DAMPING_TO_MASS, ImpedanceTerm::DampingMatrix, ImpedanceTerm::DampingToMass),
            (
                stiffness,
                MAX_STIFFNESS_TO_MASS,
                ImpedanceTerm::StiffnessMatrix,
                ImpedanceTerm::StiffnessToMass,
            ),
        ] {
            let rounding = diagonal * (ROUNDING * max_ratio);
            check(negative, &(matrix + rounding), 0.0)?;
            check(too_large, &(mass * max_ratio - matrix + rounding), 0.0)?;
        }
        Ok(())
    }

    /// The mass along each of x, y and z that a force along it moves while no other acts, `1/(M⁻¹)ᵢᵢ` [kg].
    pub fn free_mass(&self) -> [f32; 3] {
        let [x, y, z, ..] = self.mass;
        self.coupling.as_ref().map_or([x, y, z], |coupling| self.coupled_free_mass(coupling))
    }

    #[inline(never)]
    fn coupled_free_mass(&self, coupling: &ImpedanceCoupling) -> [f32; 3] {
        let mass = Ldlt::new(&coupling::symmetric(&self.mass, &coupling.mass), MIN_MASS);
        [Vector6::x(), Vector6::y(), Vector6::z()].map(|axis| 1.0 / axis.dot(&mass.solve(&axis)))
    }

    /// Raises the [free masses](Self::free_mass) along x, y and z to at least these [kg], and the damping in
    /// the same ratio, so that free motions decay at the same rate; the stiffness is unchanged. Of coupled
    /// axes all masses are raised in the ratio of the axis that lacks most.
    pub fn raise_mass(&mut self, masses: &[f32; 3]) {
        let mut ratios = [1.0; 6];
        let mut largest = 1.0;
        for ((ratio, min), mass) in ratios.iter_mut().zip(masses).zip(self.free_mass()) {
            *ratio = math::max(1.0, min / mass);
            largest = math::max(largest, *ratio);
        }
        if let Some(coupling) = &mut self.coupling {
            ratios = [largest; 6];
            coupling.mass.iter_mut().chain(&mut coupling.damping).for_each(|value| *value *= largest);
        }
        for ((mass, damping), ratio) in self.mass.iter_mut().zip(&mut self.damping).zip(ratios) {
            *mass *= ratio;
            *damping *= ratio;
        }
    }

    /// The continuous-time acceleration `M⁻¹ (F − B ė − K e)` [m/s², rad/s²] (Arm7 step 3) for the
    /// displacement `e` [m, rad], its velocity [m/s, rad/s] and the external wrench `F` [N, N·m], all in
    /// [`axes`](Self::axes). The zero-order hold of a control period reduces its damping.
    pub fn acceleration(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        if let Some(coupling) = &self.coupling {
            let [mass, damping, stiffness] = self.matrices(coupling);
            return Ldlt::new(&mass, MIN_MASS).solve(&(force - damping * velocity - stiffness * error));
        }
        let mut result = *force;
        let state = error.iter().zip(velocity.iter());
        let terms = self.mass.iter().zip(&self.damping).zip(&self.stiffness);
        for ((result, (e, v)), ((mass, damping), stiffness)) in result.iter_mut().zip(state).zip(terms) {
            *result = (*result - damping * v - stiffness * e) / mass;
        }
        result
    }

    /// The acceleration to hold for one control period so that the final velocity is that of the
    /// continuous-time impedance under a constant force. Units and axes as in
    /// [`acceleration`](Self::acceleration).
    #[inline]
    pub fn held_acceleration(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        match &self.coupling {
            None => self.discretized().acceleration(error, velocity, force),
            Some(coupling) => self.coupled_acceleration(coupling, error, velocity, force),
        }
    }

    /// [`Self::held_acceleration`] of coupled axes: the displacement `Σ xₙ (t/T)ⁿ` by its power series.
    #[inline(never)]
    fn coupled_acceleration(
        &self,
        coupling: &ImpedanceCoupling,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        let [mass, damping, stiffness] = self.matrices(coupling);
        let mass = Ldlt::new(&mass, MIN_MASS);
        let [mut before, mut last] = [*error, velocity * TICK];
        let mut forces = *force;
        let mut sum = Vector6::zeros();
        for order in 2..=SERIES_ORDER {
            let order = f32::from(order);
            let of_state = damping * last * (TICK * (order - 1.0)) + stiffness * before * (TICK * TICK);
            // A constant force has a term of order 2 only.
            let right = forces * (TICK * TICK) - of_state;
            let next = mass.solve(&right) * (1.0 / (order * (order - 1.0)));
            sum += next * order;
            (before, last, forces) = (last, next, Vector6::zeros());
        }
        // The sum is the change of the velocity times the period.
        sum * (1.0 / (TICK * TICK))
    }

    /// Exact discretisation under zero-order hold, of axes without coupling: after one control period at a
    /// constant force, the velocity is that of the continuous-time impedance.
    fn discretized(&self) -> DiscreteImpedance {
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
            // e(T) = exp(−half) (… cos √z …); z is positive for an oscillation.
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

    /// Moves all values by `fraction`, 0 to 1, of their difference to `goal`, which has the same axes.
    pub fn blend_towards(&mut self, goal: &Self, fraction: f32) {
        let own = self.mass.iter_mut().chain(&mut self.damping).chain(&mut self.stiffness);
        let goals = goal.mass.iter().chain(&goal.damping).chain(&goal.stiffness);
        own.zip(goals).for_each(|(own, goal)| *own += fraction * (goal - *own));
        if self.coupling.is_some() || goal.coupling.is_some() {
            self.blend_coupling(goal.coupling.as_ref(), fraction);
        }
    }

    /// Moves the coupling towards `goal`. Without a goal it is dropped once it is negligible.
    #[inline(never)]
    fn blend_coupling(&mut self, goal: Option<&ImpedanceCoupling>, fraction: f32) {
        let mut coupling = self.coupling.unwrap_or(ImpedanceCoupling::NONE);
        coupling.blend_towards(goal.unwrap_or(&ImpedanceCoupling::NONE), fraction);
        let [mass, damping, stiffness] = [&self.mass, &self.damping, &self.stiffness];
        let is_negligible = coupling::is_negligible(&coupling.mass, mass)
            && coupling::is_negligible(&coupling.damping, damping)
            && coupling::is_negligible(&coupling.stiffness, stiffness);
        self.coupling = (goal.is_some() || !is_negligible).then_some(coupling);
    }

    /// The same impedance in other axes; `rotation` transforms vectors to these.
    #[inline(never)]
    pub fn in_axes(&self, axes: ImpedanceAxes, rotation: &Matrix3<f32>) -> Self {
        let of_matrix = |matrix: &Matrix6<f32>| {
            // The block above the diagonal is not used.
            let mut rotated = Matrix6::zeros();
            let turned = |block: MatrixView<'_, f32, U3, U3, U1, U6>| rotation * block * rotation.transpose();
            rotated.fixed_view_mut::<3, 3>(0, 0).copy_from(&turned(matrix.fixed_view(0, 0)));
            rotated.fixed_view_mut::<3, 3>(3, 0).copy_from(&turned(matrix.fixed_view(3, 0)));
            rotated.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned(matrix.fixed_view(3, 3)));
            coupling::split(&rotated)
        };
        let matrices = self.matrices(self.coupling.as_ref().unwrap_or(&ImpedanceCoupling::NONE));
        let [(mass, of_mass), (damping, of_damping), (stiffness, of_stiffness)] =
            matrices.each_ref().map(of_matrix);
        let coupling = ImpedanceCoupling { mass: of_mass, damping: of_damping, stiffness: of_stiffness };
        Self { mass, damping, stiffness, axes, coupling: Some(coupling) }
    }
}

/// An [`Impedance`] discretised for the control period: one gain per axis and state.
#[derive(Clone, Copy, Debug)]
struct DiscreteImpedance {
    error: Vector6<f32>,
    velocity: Vector6<f32>,
    force: Vector6<f32>,
}

impl DiscreteImpedance {
    /// The acceleration for a displacement, its velocity and an external force, held for one period. Units as
    /// in [`Impedance::acceleration`].
    fn acceleration(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        self.error.component_mul(error)
            + self.velocity.component_mul(velocity)
            + self.force.component_mul(force)
    }
}

/// `cos √z` and `sin √z / √z`; for negative `z`, the corresponding hyperbolic functions.
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
mod tests;
