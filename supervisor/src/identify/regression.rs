//! Identification of a joint's torque constant and friction from its torques by linear least squares.

use nalgebra::{SMatrix, SVector, SymmetricEigen};
use tesaki::model::MAX_CHAIN_JOINTS;

/// Torque constant, Coulomb and viscous friction, and the weights of the links behind the joint.
const COLUMNS: usize = 3 + MAX_CHAIN_JOINTS;
/// Column of the first weight, or of the acceleration if the weights are known.
const INERTIA: usize = 3;
/// Directions of the scaled problem with a smaller eigenvalue than this fraction of the largest are
/// discarded.
const RANK: f64 = 1e-8;
/// Below this speed, the direction of a joint's motion is noise [rad/s].
const MOVING: f64 = 0.03;
/// Number of readings needed in each direction.
const MIN_READINGS: usize = 100;
/// Largest accepted standard deviation of the torque constant, relative to its value.
const MAX_DEVIATION: f64 = 0.01;
/// Plausible range of a torque constant, relative to the assumed one.
const BELIEVED: std::ops::Range<f64> = 0.5..2.0;

/// Readings of a joint at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Number of its motion: errors of readings from the same motion are correlated.
    pub motion: usize,
    /// Commanded torque of the drive [N·m].
    pub torque: f64,
    /// Torque that balances the wrench on the tip: `−Jᵀ w` [N·m].
    pub load: f64,
    /// Velocity [rad/s].
    pub velocity: f64,
    /// Acceleration [rad/s²]; not used by [`fit`].
    pub acceleration: f64,
    /// Torques that balance the weight of each link of its chain, by the model [N·m].
    pub weights: [f64; MAX_CHAIN_JOINTS],
}

/// A value and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub deviation: f64,
}

impl Estimate {
    /// Returns the estimate, if it is larger than its standard deviation. `unit` is the name of a thousandth
    /// of its unit.
    pub(super) fn known(self, unit: &'static str) -> Result<Self, NotIdentified> {
        let Self { value, deviation } = self;
        if value > deviation { Ok(self) } else { Err(NotIdentified::Uncertain { unit, value, deviation }) }
    }
}

/// Identified values of a joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// True torque divided by commanded torque; or why it was not identified.
    pub gain: Result<Estimate, NotIdentified>,
    /// Coulomb friction [N·m] and viscous friction [N·m·s/rad], in commanded torque if the gain was not
    /// identified; or why they were not identified.
    pub friction: Result<[Estimate; 2], NotIdentified>,
    /// Largest load minus the smallest [N·m].
    pub load_range: f64,
    /// Root mean square of the residuals, in commanded torque [N·m].
    pub residual: f64,
    /// Number of readings used.
    pub readings: usize,
}

impl Fit {
    /// Coulomb friction [N·m], or why it was not identified.
    ///
    /// # Errors
    /// The friction is not identified, or this part is not larger than its standard deviation.
    pub fn coulomb(&self) -> Result<Estimate, NotIdentified> {
        self.friction?[0].known("mN·m")
    }

    /// Viscous friction [N·m·s/rad], or why it was not identified.
    ///
    /// # Errors
    /// As [`coulomb`](Self::coulomb).
    pub fn viscous(&self) -> Result<Estimate, NotIdentified> {
        self.friction?[1].known("mN·m·s/rad")
    }

    /// What is not identified, and why.
    pub fn doubts(&self) -> impl Iterator<Item = (&'static str, NotIdentified)> {
        let part = |part: Result<Estimate, NotIdentified>| part.err().filter(|_| self.friction.is_ok());
        let doubts = [
            ("torque constant", self.gain.err()),
            ("friction", self.friction.err()),
            ("Coulomb friction", part(self.coulomb())),
            ("viscous friction", part(self.viscous())),
        ];
        doubts.into_iter().filter_map(|(what, doubt)| Some((what, doubt?)))
    }
}

/// Identified values of a joint without load, in the torque of its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeFit {
    /// Coulomb friction, mean of both directions [N·m].
    pub coulomb: Estimate,
    /// Viscous friction [N·m·s/rad].
    pub viscous: Estimate,
    /// Torque beyond the model's weight that does not depend on the direction [N·m]: caused by an error of
    /// the masses, a spring, or friction that is larger in one direction.
    pub offset: Estimate,
    /// Inertia of rotor and links about the joint [kg·m²].
    pub inertia: Estimate,
    /// Root mean square of the residuals [N·m].
    pub residual: f64,
    /// Number of readings used.
    pub readings: usize,
}

/// Reasons why a value was not identified.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotIdentified {
    /// The joint did not move enough.
    #[error(
        "it hardly moved: {forth} readings forth and {back} back faster than {MOVING} rad/s, {MIN_READINGS} of each \
         are needed"
    )]
    Still {
        /// Readings in the positive direction.
        forth: usize,
        /// Readings in the negative direction.
        back: usize,
    },
    /// No force loaded the joint enough.
    #[error(
        "the forces on the tip loaded it by only {load_range:.3} N·m: its standard deviation would be {:.1} %, at most \
         {:.0} % are of use",
        100.0 * deviation,
        100.0 * MAX_DEVIATION
    )]
    Unloaded {
        /// Largest load minus the smallest [N·m].
        load_range: f64,
        /// Standard deviation divided by the value.
        deviation: f64,
    },
    /// Its links are too light.
    #[error(
        "the weight of its links, at most {weight:.3} N·m, is too small to tell it with a standard deviation of {:.0} %",
        100.0 * MAX_DEVIATION
    )]
    Light {
        /// Largest weight [N·m].
        weight: f64,
    },
    /// The value is not larger than its standard deviation.
    #[error(
        "{:.2} ± {:.2} {unit} is not larger than its standard deviation, and is not stored", 1e3 * value, 1e3 * deviation
    )]
    Uncertain {
        /// Name of a thousandth of the value's unit.
        unit: &'static str,
        /// The value.
        value: f64,
        /// Its standard deviation.
        deviation: f64,
    },
    /// The value is impossible.
    #[error("{value:.3} {what} cannot be: are homing, tare, and the masses in the URDF right?")]
    Implausible {
        /// Its unit and quantity.
        what: &'static str,
        /// The value.
        value: f64,
    },
}

/// Solves `torque = (load + coulomb · sign(velocity) + viscous · velocity + Σ fraction · weight) / gain` by
/// least squares, from the readings in which the joint moves: friction changes its sign with the direction, a
/// load does not. Standard deviations are those of a clustered sandwich estimator (Liang and Zeger 1986) with
/// one cluster per motion, because errors of neighbouring readings are correlated.
pub fn fit(readings: &[Reading]) -> Fit {
    let moving = in_motion(readings);
    let range =
        moving.iter().fold((f64::MAX, f64::MIN), |(low, high), r| (low.min(r.load), high.max(r.load)));
    let load_range = (range.1 - range.0).max(0.0);
    if let Err(still) = check_motion(&moving) {
        return Fit {
            gain: Err(still),
            friction: Err(still),
            load_range,
            residual: f64::NAN,
            readings: moving.len(),
        };
    }
    let found = LeastSquares::new(&moving);
    let gain = found.gain(load_range);
    let friction = found.friction(gain.is_ok());
    Fit { gain, friction, load_range, residual: found.residual(&moving), readings: moving.len() }
}

/// Estimates the ratio of true to commanded torque of a joint without load. The links must have the masses of
/// the model, and the friction must be the same in both directions: the weight serves as load.
///
/// # Errors
/// Too little motion or weight, or an impossible result.
pub fn fit_gain(readings: &[Reading]) -> Result<Estimate, NotIdentified> {
    let weighed = |r: &Reading| Reading { load: weight(r), ..with_inertia(r) };
    fit(&readings.iter().map(weighed).collect::<Vec<_>>()).gain.map_err(|error| match error {
        NotIdentified::Unloaded { .. } => NotIdentified::Light {
            weight: readings.iter().map(weight).fold(0.0, |max, weight| max.max(weight.abs())),
        },
        other => other,
    })
}

fn weight(reading: &Reading) -> f64 {
    reading.weights.iter().sum()
}

/// Returns the reading with the acceleration in place of the weights.
fn with_inertia(reading: &Reading) -> Reading {
    let mut weights = [0.0; MAX_CHAIN_JOINTS];
    weights[0] = reading.acceleration;
    Reading { weights, ..*reading }
}

fn in_motion(readings: &[Reading]) -> Vec<&Reading> {
    readings.iter().filter(|r| r.velocity.abs() > MOVING).collect()
}

/// Checks that there are enough readings in each direction.
fn check_motion(moving: &[&Reading]) -> Result<(), NotIdentified> {
    let forth = moving.iter().filter(|r| r.velocity > 0.0).count();
    let back = moving.len() - forth;
    if forth < MIN_READINGS || back < MIN_READINGS {
        return Err(NotIdentified::Still { forth, back });
    }
    Ok(())
}

/// Fits a joint without load, with the weights of the model, by least squares: `torque = Σ weight + offset +
/// coulomb · sign(velocity) + viscous · velocity + inertia · acceleration`; deviations as in [`fit`].
///
/// # Errors
/// Too little motion, or an impossible result.
pub fn fit_free(readings: &[Reading]) -> Result<FreeFit, NotIdentified> {
    // The column of the loads holds the offset.
    let beyond_weight = |r: &Reading| Reading { torque: r.torque - weight(r), load: 1.0, ..with_inertia(r) };
    let readings: Vec<Reading> = readings.iter().map(beyond_weight).collect();
    let moving = in_motion(&readings);
    check_motion(&moving)?;
    let found = LeastSquares::new(&moving);
    let [coulomb, viscous] = found.friction(false)?;
    let estimate = |i| Estimate { value: found.value(i), deviation: found.variance(i, i).sqrt() };
    let (offset, inertia) = (estimate(0), estimate(INERTIA));
    let (residual, readings) = (found.residual(&moving), moving.len());
    Ok(FreeFit { coulomb, viscous, offset, inertia, residual, readings })
}

type Square = SMatrix<f64, COLUMNS, COLUMNS>;
type Row = SVector<f64, COLUMNS>;

/// Returns a row of the regressor: load, direction, velocity, weights.
fn row(reading: &Reading) -> Row {
    let mut row = Row::zeros();
    (row[0], row[1], row[2]) = (reading.load, reading.velocity.signum(), reading.velocity);
    row.as_mut_slice()[INERTIA..].copy_from_slice(&reading.weights);
    row
}

/// The solution for 1 / gain, and for Coulomb friction, viscous friction and the fractions of the weights,
/// each divided by the gain.
struct LeastSquares {
    /// Factors that scale the columns of the regressor to equal size, so that units do not matter.
    scale: Row,
    solution: Row,
    covariance: Square,
    /// Sum of the squared residuals.
    squares: f64,
}

impl LeastSquares {
    fn new(moving: &[&Reading]) -> Self {
        let mut scale = Row::zeros();
        for r in moving {
            scale += row(r).map(|value| value * value);
        }
        let scale = scale.map(|sum| if sum > 0.0 { 1.0 / sum.sqrt() } else { 0.0 });
        let (mut gram, mut right) = (Square::zeros(), Row::zeros());
        for r in moving {
            let row = row(r).component_mul(&scale);
            gram += row * row.transpose();
            right += row * r.torque;
        }
        let eigen = SymmetricEigen::new(gram);
        let cutoff = RANK * eigen.eigenvalues.max();
        let inverse = eigen.eigenvalues.map(|value| if value > cutoff { 1.0 / value } else { 0.0 });
        let bread = eigen.eigenvectors * Square::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        let solution = bread * right;
        let (mut meat, mut score, mut squares) = (Square::zeros(), Row::zeros(), 0.0);
        let mut clusters = 0_u32;
        for (index, r) in moving.iter().enumerate() {
            let row = row(r).component_mul(&scale);
            let rest = r.torque - row.dot(&solution);
            squares += rest * rest;
            score += row * rest;
            if moving.get(index + 1).is_none_or(|next| next.motion != r.motion) {
                meat += score * score.transpose();
                score = Row::zeros();
                clusters += 1;
            }
        }
        let clusters = f64::from(clusters);
        let spread = if clusters > 1.0 { clusters / (clusters - 1.0) } else { f64::INFINITY };
        Self { scale, solution, covariance: bread * meat * bread * spread, squares }
    }

    /// Root mean square of the residuals.
    #[expect(clippy::cast_precision_loss, reason = "a number of readings")]
    fn residual(&self, moving: &[&Reading]) -> f64 {
        (self.squares / moving.len() as f64).sqrt()
    }

    fn value(&self, i: usize) -> f64 {
        self.solution[i] * self.scale[i]
    }

    fn variance(&self, i: usize, j: usize) -> f64 {
        self.covariance[(i, j)] * self.scale[i] * self.scale[j]
    }

    fn gain(&self, load_range: f64) -> Result<Estimate, NotIdentified> {
        let inverse_gain = self.value(0);
        let relative =
            if load_range > 0.0 { self.variance(0, 0).sqrt() / inverse_gain.abs() } else { f64::INFINITY };
        if relative.is_nan() || relative > MAX_DEVIATION {
            Err(NotIdentified::Unloaded { load_range, deviation: relative })
        } else if !BELIEVED.contains(&(1.0 / inverse_gain)) {
            Err(NotIdentified::Implausible { what: "times the torque constant", value: 1.0 / inverse_gain })
        } else {
            Ok(Estimate { value: 1.0 / inverse_gain, deviation: relative / inverse_gain })
        }
    }

    /// Friction, in N·m if the gain is known, else in commanded torque.
    fn friction(&self, gain_is_known: bool) -> Result<[Estimate; 2], NotIdentified> {
        let inverse_gain = self.value(0);
        let estimate = |i: usize| {
            if !gain_is_known {
                return Estimate { value: self.value(i), deviation: self.variance(i, i).sqrt() };
            }
            let ratio = self.value(i) / inverse_gain;
            let square =
                self.variance(i, i) - 2.0 * ratio * self.variance(0, i) + ratio * ratio * self.variance(0, 0);
            Estimate { value: ratio, deviation: square.max(0.0).sqrt() / inverse_gain }
        };
        let [coulomb, mut viscous] = [estimate(1), estimate(2)];
        // Not significantly different from 0.
        if viscous.value < 0.0 && viscous.value > -3.0 * viscous.deviation {
            viscous.value = 0.0;
        }
        if coulomb.value < 0.0 {
            Err(NotIdentified::Implausible { what: "N·m of Coulomb friction", value: coulomb.value })
        } else if viscous.value < 0.0 {
            Err(NotIdentified::Implausible { what: "N·m·s/rad of viscous friction", value: viscous.value })
        } else {
            Ok([coulomb, viscous])
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    type Row = (usize, [f64; 5]);

    /// Readings; gain, Coulomb and viscous friction with their deviations; residual; number of readings; from
    /// `tests/oracles/identify.py`.
    const ORACLE: (&[Row], [(f64, f64); 3], f64, usize) = include!("../../../tests/oracles/data/identify.in");

    fn readings() -> Vec<Reading> {
        let reading = |&(motion, [torque, load, velocity, own, next]): &Row| {
            let mut weights = [0.0; MAX_CHAIN_JOINTS];
            (weights[0], weights[1]) = (own, next);
            Reading { motion, torque, load, velocity, acceleration: 0.0, weights }
        };
        ORACLE.0.iter().map(reading).collect()
    }

    fn fit_with(change: impl Fn(&mut Reading)) -> Fit {
        let mut readings = readings();
        readings.iter_mut().for_each(change);
        fit(&readings)
    }

    #[test]
    fn agrees_with_numpy() {
        let (_, expected, residual, count) = ORACLE;
        let fit = fit(&readings());
        let [coulomb, viscous] = fit.friction.unwrap();
        for (found, (value, deviation)) in [fit.gain.unwrap(), coulomb, viscous].iter().zip(expected) {
            assert!((found.value / value - 1.0).abs() < 1e-7, "{found:?} {value}");
            assert!((found.deviation / deviation - 1.0).abs() < 1e-5, "{found:?} {deviation}");
        }
        assert!((fit.residual / residual - 1.0).abs() < 1e-7 && fit.readings == count);
        // True values of the simulated readings.
        let made = [1.13, 0.0217, 0.0016];
        for ((value, deviation), made) in expected.iter().zip(made) {
            assert!((value - made).abs() < 3.0 * deviation, "{value} {made}");
        }
    }

    /// Readings of a joint without load; Coulomb and viscous friction, offset and inertia with their
    /// deviations; residual; gain with its deviation; number of readings.
    type FreeOracle = (&'static [(usize, [f64; 4])], [(f64, f64); 4], f64, (f64, f64), usize);
    const FREE_ORACLE: FreeOracle = include!("../../../tests/oracles/data/identify_free.in");

    fn free_readings() -> Vec<Reading> {
        let reading = |&(motion, [torque, acceleration, velocity, weight]): &(usize, [f64; 4])| {
            let mut weights = [0.0; MAX_CHAIN_JOINTS];
            weights[0] = weight;
            Reading { motion, torque, load: 0.0, velocity, acceleration, weights }
        };
        FREE_ORACLE.0.iter().map(reading).collect()
    }

    #[test]
    fn a_joint_without_load_agrees_with_numpy() {
        let (_, expected, residual, gain, count) = FREE_ORACLE;
        let fit = fit_free(&free_readings()).unwrap();
        let found = [fit.coulomb, fit.viscous, fit.offset, fit.inertia, fit_gain(&free_readings()).unwrap()];
        for (found, (value, deviation)) in found.iter().zip(expected.into_iter().chain([gain])) {
            assert!((found.value / value - 1.0).abs() < 1e-7, "{found:?} {value}");
            assert!((found.deviation / deviation - 1.0).abs() < 1e-5, "{found:?} {deviation}");
        }
        assert!((fit.residual / residual - 1.0).abs() < 1e-7 && fit.readings == count);
        // True values of the simulated readings, in true torque; the offset is the effect of the gain on the
        // weight of 0.4·cos 0.3 N·m.
        let made = [0.0217 / 0.92, 0.0016 / 0.92, 0.4 * 0.3_f64.cos() * (1.0 / 0.92 - 1.0)];
        for ((value, deviation), made) in expected.iter().zip(made) {
            assert!((value - made).abs() < 3.0 * deviation, "{value} {made}");
        }
        assert!((gain.0 - 0.92).abs() < 3.0 * gain.1, "{gain:?}");
    }

    #[test]
    fn links_that_are_too_light_tell_no_torque_constant() {
        let mut readings = free_readings();
        for reading in &mut readings {
            let before = weight(reading);
            reading.weights[0] *= 0.01;
            reading.torque += (weight(reading) - before) / 0.92;
        }
        let said = fit_gain(&readings).unwrap_err().to_string();
        assert_eq!(
            said,
            "the weight of its links, at most 0.004 N·m, is too small to tell it with a standard deviation of 1 %"
        );
        assert!(fit_free(&readings).is_ok());
        assert!(matches!(fit_gain(&[]), Err(NotIdentified::Still { forth: 0, back: 0 })));
    }

    #[test]
    fn what_is_not_loaded_or_does_not_move_is_said_so() {
        // A hundredth of the load: at most 2 mN·m.
        let fit = fit_with(|reading| reading.load *= 0.01 * f64::from(reading.load < 0.1));
        let said = fit.gain.unwrap_err().to_string();
        assert!(said.contains("loaded it by only 0.001 N·m") && said.contains("at most 1 %"), "{said}");
        // Friction is identified nevertheless.
        assert!(fit.friction.is_ok());
        let fit = fit_with(|reading| reading.velocity = reading.velocity.abs());
        let said = fit.friction.unwrap_err().to_string();
        assert!(said.contains("480 readings forth and 0 back"), "{said}");
        assert_eq!(fit.gain.unwrap_err(), fit.friction.unwrap_err());
        assert!(matches!(super::fit(&[]).gain, Err(NotIdentified::Still { forth: 0, back: 0 })));
        // A force sensor with the wrong sign.
        let fit = fit_with(|reading| reading.load = -reading.load);
        assert!(matches!(fit.gain, Err(NotIdentified::Implausible { .. })), "{fit:?}");
        // A drive that brakes instead of pushing.
        let fit = fit_with(|reading| reading.velocity = -reading.velocity);
        assert!(matches!(fit.friction, Err(NotIdentified::Implausible { .. })), "{fit:?}");
    }
}
