//! Stability of the sampled loop in contact: the largest surface stiffness for an impedance.

use nalgebra::{Vector3, Vector6};

use super::response::discretized;
use super::settings::{ImpedanceSettings, InvalidImpedanceSettings};
use super::tuning::{MAX_MASS_RATIO, MAX_OWN_MASS_RATIO, OWN_MASS_MARGIN};
use crate::TICK;
use crate::control::ImpedanceAxes;
use crate::kinematics::Chain;
use crate::math::{self, Ldlt};
use crate::model::{JointModel, MAX_CHAIN_JOINTS};

/// Steps of the bisection for the limit: relative error 2⁻²⁴.
const STEPS: usize = 24;
/// Smallest pivot of the mass matrix [kg·m²].
const MIN_INERTIA: f32 = 1e-9;
/// Smallest mobility that is distinguished from 0 [1/kg].
const MIN_MOBILITY: f32 = 1e-6;

/// Own mass of an arm at its tool along x, y and z of `axes` [kg] at joint `angles` [rad]:
/// `1 / (J M⁻¹ Jᵀ)ᵢᵢ`, the force along an axis per acceleration along it while the tool is free in all other
/// directions (Khatib 1995). It grows without bound towards singular postures; the result is limited to five
/// times the harmonic mean of the three.
///
/// `chain` without the rotors, which are those of the `joints`.
pub fn own_mass(chain: &Chain, joints: &[JointModel], angles: &[f32], axes: ImpedanceAxes) -> [f32; 3] {
    let inertia = joint_inertia(chain, joints, angles);
    let posture = chain.posture(angles);
    let mut jacobian = posture.jacobian().fixed_rows::<3>(0).into_owned();
    if axes == ImpedanceAxes::Tool {
        jacobian = posture.tip().rotation.matrix().tr_mul(&jacobian);
    }
    let mobility = Vector3::from_fn(|axis, _| {
        let row = jacobian.row(axis).transpose();
        row.dot(&inertia.solve(&row))
    });
    let min = (mobility.sum() / (3.0 * MAX_OWN_MASS_RATIO)).max(MIN_MOBILITY);
    mobility.map(|mobility| 1.0 / mobility.max(min)).into()
}

/// The mass matrix at joint `angles` [rad] with the rotors of the `joints`, factored.
pub(super) fn joint_inertia(chain: &Chain, joints: &[JointModel], angles: &[f32]) -> Ldlt<MAX_CHAIN_JOINTS> {
    let mut inertia = chain.mass_matrix(angles);
    for (index, joint) in joints.iter().enumerate().take(chain.len()) {
        if let Some(diagonal) = inertia.get_mut((index, index)) {
            *diagonal += joint.motor.rotor_inertia;
        }
    }
    Ldlt::new(&inertia, MIN_INERTIA)
}

impl ImpedanceSettings {
    /// Checks the masses of the impedance against the arm's [own](own_mass) along its axes [kg]. With a mass
    /// far below it, contact with a stiff surface cannot be stabilised, not even by derating.
    ///
    /// # Errors
    /// The first axis whose mass is too small.
    pub fn check_mass(&self, own_mass: &[f32; 3]) -> Result<(), InvalidImpedanceSettings> {
        for ((axis, value), own) in (0..).zip(self.impedance.free_mass()).zip(own_mass) {
            let limit = own / MAX_MASS_RATIO;
            if value < limit {
                return Err(InvalidImpedanceSettings::MassInContact { axis, value, own: *own, limit });
            }
        }
        Ok(())
    }

    /// Largest stiffness [N/m] of a surface normal to `axis` (0 to 2) on which the sampled loop is guaranteed
    /// to be stable, for an arm whose own mass along the axis is `own_mass` [kg]; 0 if there is none. Beyond
    /// it the impedance is derated. The coupling between axes is neglected. docs/equations.md derives the
    /// condition.
    pub fn max_contact_stiffness(&self, axis: usize, own_mass: f32) -> f32 {
        let impedance = &self.impedance;
        let (e, v, f) = match axis {
            0 => (Vector6::x(), Vector6::x(), Vector6::x()),
            1 => (Vector6::y(), Vector6::y(), Vector6::y()),
            _ => (Vector6::z(), Vector6::z(), Vector6::z()),
        };
        let zero = Vector6::zeros();
        let law = |error: &_, velocity: &_, force: &_| {
            let acceleration = discretized(impedance, self.law, error, velocity, force);
            acceleration.get(axis).copied().unwrap_or(0.0)
        };
        let loop_gains = ContactLoop {
            error: -law(&e, &zero, &zero),
            velocity: -law(&zero, &v, &zero),
            force: law(&zero, &zero, &f),
        };
        // A larger own mass has a higher loop gain; a smaller one moves too far in a period.
        let [heavy, light] = [OWN_MASS_MARGIN, 1.0 / OWN_MASS_MARGIN]
            .map(|factor| loop_gains.max_stiffness(factor * own_mass));
        if heavy < light { heavy } else { light }
    }
}

/// Gains of the held acceleration `a = force·F − error·e − velocity·ė` along an axis.
struct ContactLoop {
    error: f32,
    velocity: f32,
    force: f32,
}

impl ContactLoop {
    /// Largest stiffness below which the loop is stable on every surface, for an own mass [kg].
    ///
    /// `ω² (1 − force·own_mass) + velocity·ω cot half − error` is the second condition's margin: with
    /// `x cot x = 1 − x²/3 − x⁴/45 − …` it falls, or rises and then falls. So it has one zero if it is
    /// positive at 0, and the first condition's margin falls.
    fn max_stiffness(&self, own_mass: f32) -> f32 {
        if self.error >= self.velocity * (2.0 / TICK) {
            return 0.0;
        }
        // Frequencies ω T/2 of the own mass on the surface, up to the Nyquist frequency, π/2.
        let [mut stable, mut unstable] = [0.0_f32, core::f32::consts::FRAC_PI_2];
        for _ in 0..STEPS {
            let middle = 0.5 * (stable + unstable);
            *if self.is_stable(own_mass, middle) { &mut stable } else { &mut unstable } = middle;
        }
        let frequency = stable * (2.0 / TICK);
        own_mass * frequency * frequency
    }

    /// Jury's conditions for the surface on which the own mass has the frequency ω, with `half` = ω T/2:
    /// `velocity < ω cot half` and `force·k + error < ω² + velocity·ω cot half`, `k = own_mass·ω²`.
    fn is_stable(&self, own_mass: f32, half: f32) -> bool {
        let (sine, cosine) = math::inlined_sin_cos(half);
        let frequency = half * (2.0 / TICK);
        let square = frequency * frequency;
        let cotangent = if sine > 0.0 { frequency * cosine / sine } else { 2.0 / TICK };
        self.velocity < cotangent
            && self.force * own_mass * square + self.error < square + self.velocity * cotangent
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::control::ImpedanceCoupling;
    use crate::task::impedance::tests::SOFT;
    use crate::task::impedance::{DirectLaw, Law};

    /// Whether the law is direct; mass, damping and stiffness of the impedance, own mass, largest stiffness
    /// of the surface; from `tests/oracles/contact_stability.py` (eigenvalues of the sampled loop).
    const LIMITS: &[(bool, [f64; 4], f64)] = include!("../../../../tests/oracles/data/contact_stability.in");

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "settings are in single precision")]
    fn the_limit_is_where_an_eigenvalue_leaves_the_unit_circle() {
        for &(direct, values, limit) in LIMITS {
            let [mass, damping, stiffness, own] = values.map(|value| value as f32);
            let mut settings = SOFT;
            settings.law = if direct { Law::Direct(DirectLaw::PRINTED) } else { Law::ModelFollowing };
            (settings.impedance.mass[1], settings.impedance.damping[1], settings.impedance.stiffness[1]) =
                (mass, damping, stiffness);
            let found = f64::from(settings.max_contact_stiffness(1, own));
            assert!((found - limit).abs() <= 2e-3 * limit, "{direct} {values:?}: {found} {limit}");
        }
    }

    #[test]
    fn a_mass_far_below_the_arms_own_is_refused_with_the_one_that_would_do() {
        let own = [3.4, 0.6, 6.2];
        let refusal = SOFT.check_mass(&own).unwrap_err();
        assert_eq!(
            refusal,
            InvalidImpedanceSettings::MassInContact { axis: 2, value: 1.5, own: 6.2, limit: 1.55 }
        );
        assert!(
            refusal.to_string().contains("along z is 1.5 kg and the arm's own there 6.2 kg"),
            "{refusal}"
        );
        let mut heavier = SOFT;
        heavier.impedance.mass[2] = 1.56;
        assert_eq!(heavier.check_mass(&own), Ok(()));
        // A force along x moves 1.5 − 1.4²/1.5 kg, as the tool gives way along y.
        let mut coupled = heavier;
        let mut coupling = ImpedanceCoupling::NONE;
        coupling.mass[0] = 1.4;
        coupled.impedance.coupling = Some(coupling);
        let Err(InvalidImpedanceSettings::MassInContact { axis: 0, value, .. }) = coupled.check_mass(&own)
        else {
            panic!()
        };
        assert!((value - 0.193_333).abs() < 1e-5, "{value}");
    }
}
