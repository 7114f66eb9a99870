use core::fmt;

use nalgebra::Vector6;

use crate::control::{Impedance, ImpedanceAxes, axis_name};

/// Bilateral control with matched impedances (Arm7 section 4, which mentions the idea without equations):
/// master and slave both have the target impedance (Arm7 eq. 2) towards each other's pose, and the measured
/// wrenches of operator `F_op` and environment `F_ext` act on both:
///
/// ```text
/// M Ẍ_m + B Ẋ_m + K (X_m − X_s) = F_op + F_ext      M Ẍ_s + B Ẋ_s + K (X_s − X_m) = F_op + F_ext
/// ```
///
/// Without delay the difference of the poses follows `M Δ̈ + B Δ̇ + 2 K Δ = 0`, whatever the wrenches: it
/// decays. At rest `F_op = −F_ext`, so the operator feels exactly the force on the slave, and `X_m = X_s`. In
/// motion the operator feels `M` and `B` of both ends. The law itself does not limit the energy that a
/// delayed link generates ([`super::PowerPort`] does).
///
/// Wrenches and errors along and about the axes of the base: translation, then rotation [N, N·m; m, rad].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedImpedance {
    damping: Vector6<f32>,
    stiffness: Vector6<f32>,
}

/// Why an impedance does not suit [`MatchedImpedance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UnsuitableImpedance {
    /// It is not in the axes of the base.
    Axes,
    /// Its axes are coupled.
    Coupled,
    /// An axis has no spring, or a negative one.
    Stiffness {
        /// The axis: 0 to 2 along x, y, z; 3 to 5 about them.
        axis: u8,
        /// Its stiffness [N/m, N·m/rad].
        value: f32,
    },
}

impl fmt::Display for UnsuitableImpedance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Axes => f.write_str("the impedance must be in the axes of the base"),
            Self::Coupled => f.write_str("the axes of the impedance must not be coupled"),
            Self::Stiffness { axis, value } => {
                let relation = if axis < 3 { "along" } else { "about" };
                let name = axis_name(axis);
                write!(f, "the stiffness {relation} {name} is {value}; it must be above 0")
            }
        }
    }
}

impl core::error::Error for UnsuitableImpedance {}

impl MatchedImpedance {
    /// The law for this impedance of both ends, one that [`Impedance::validate`] accepts.
    ///
    /// # Errors
    /// The impedance is not in the axes of the base, couples them, or lacks a positive stiffness along or
    /// about one of them.
    pub fn try_new(impedance: &Impedance) -> Result<Self, UnsuitableImpedance> {
        let Impedance { damping, stiffness, axes, coupling, .. } = *impedance;
        if axes != ImpedanceAxes::Base {
            return Err(UnsuitableImpedance::Axes);
        }
        if coupling.is_some() {
            return Err(UnsuitableImpedance::Coupled);
        }
        for (axis, value) in (0..).zip(stiffness) {
            if value.is_nan() || value <= 0.0 {
                return Err(UnsuitableImpedance::Stiffness { axis, value });
            }
        }
        Ok(Self { damping: damping.into(), stiffness: stiffness.into() })
    }

    /// Wrench of the motors of a master whose own mass is that of the impedance: `F_ext − B Ẋ_m − K (X_m −
    /// X_s)`, for its displacement from the slave `error`, its `velocity`, and the wrench on the slave's
    /// tool, as received.
    pub fn master_wrench(
        &self,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        tool_wrench: &Vector6<f32>,
    ) -> Vector6<f32> {
        tool_wrench - self.damping.component_mul(velocity) - self.stiffness.component_mul(error)
    }

    /// Displacement of the slave's set-point from the master's pose by which the spring of its impedance
    /// exerts the operator's wrench: `K⁻¹ F_op`.
    pub fn setpoint_displacement(&self, operator_wrench: &Vector6<f32>) -> Vector6<f32> {
        operator_wrench.component_div(&self.stiffness)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::TICK;
    use crate::control::{ImpedanceAxes, ImpedanceCoupling};

    /// Poses of master and slave, wrenches of operator and wall, along an axis and about one; from
    /// `tests/oracles/matched_impedance.py` (matrix exponential of the whole system).
    const MOTION: &[[f64; 8]] = include!("../../../tests/oracles/data/matched_impedance.in");

    const IMPEDANCE: Impedance = Impedance::diagonal(
        [1.5, 1.5, 1.5, 0.008, 0.008, 0.008],
        [30.0, 30.0, 30.0, 0.5, 0.5, 0.5],
        [300.0, 300.0, 300.0, 16.0, 16.0, 16.0],
    );
    /// Mass, damping, stiffness of the operator's arm; stiffness and damping of the wall; target of the
    /// operator.
    const ALONG: [f64; 6] = [1.5, 15.0, 300.0, 2000.0, 20.0, 0.05];
    const ABOUT: [f64; 6] = [0.004, 0.1, 3.0, 20.0, 0.1, 0.2];

    /// Simulates both ends in small steps, along z (2) or about it (5). Rows: master, slave, operator, wall.
    #[expect(clippy::cast_possible_truncation, reason = "the law works in single precision")]
    fn simulate(
        axis: usize,
        [mass, damping, stiffness, wall, wall_damping, goal]: [f64; 6],
    ) -> Vec<[f64; 4]> {
        let law = MatchedImpedance::try_new(&IMPEDANCE).unwrap();
        let of = |values: &[f32; 6]| f64::from(values[axis]);
        let (own, b, k) = (of(&IMPEDANCE.mass), of(&IMPEDANCE.damping), of(&IMPEDANCE.stiffness));
        let six = |value: f64| Vector6::from_fn(|row, _| if row == axis { value as f32 } else { 0.0 });
        let ([mut x, mut v], [mut xs, mut vs], mut before, mut motor) = ([0.0; 2], [0.0; 2], 0.0, 0.0);
        let (steps, tick) = (2000, f64::from(TICK));
        let step = tick / f64::from(steps);
        let mut rows = Vec::new();
        for _ in 0..MOTION.len() {
            let operator = own * (v - before) / tick - motor;
            let force = -wall * xs - wall_damping * vs;
            rows.push([x, xs, operator, force]);
            motor = f64::from(law.master_wrench(&six(x - xs), &six(v), &six(force))[axis]);
            let setpoint = x + f64::from(law.setpoint_displacement(&six(operator))[axis]);
            before = v;
            for _ in 0..steps {
                v += step * (motor + stiffness * (goal - x) - damping * v) / (own + mass);
                x += step * v;
                vs += step * (-k * (xs - setpoint) - b * vs - wall * xs - wall_damping * vs) / own;
                xs += step * vs;
            }
        }
        rows
    }

    #[test]
    fn master_and_slave_move_as_the_whole_system_says() {
        for (axis, values, offset) in [(2, ALONG, 0), (5, ABOUT, 4)] {
            for (own, row) in simulate(axis, values).iter().zip(MOTION) {
                let [length, force] = if offset == 0 { [5e-5, 0.02] } else { [2e-4, 2e-3] };
                for (index, (own, other)) in own.iter().zip(&row[offset..]).enumerate() {
                    let tolerance = if index < 2 { length } else { force };
                    assert!((own - other).abs() < tolerance, "{axis} {index}: {own} {other}");
                }
            }
        }
    }

    #[test]
    fn an_impedance_without_a_spring_or_with_other_or_coupled_axes_is_refused() {
        let refused = |impedance: &Impedance| MatchedImpedance::try_new(impedance).unwrap_err();
        assert!(MatchedImpedance::try_new(&IMPEDANCE).is_ok());
        let turned = Impedance { axes: ImpedanceAxes::Tool, ..IMPEDANCE };
        assert_eq!(refused(&turned), UnsuitableImpedance::Axes);
        let coupled = Impedance { coupling: Some(ImpedanceCoupling::NONE), ..IMPEDANCE };
        assert_eq!(refused(&coupled), UnsuitableImpedance::Coupled);
        let mut loose = IMPEDANCE;
        loose.stiffness[4] = 0.0;
        assert_eq!(refused(&loose), UnsuitableImpedance::Stiffness { axis: 4, value: 0.0 });
        assert_eq!(refused(&loose).to_string(), "the stiffness about y is 0; it must be above 0");
    }
}
