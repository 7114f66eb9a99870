//! Estimation of camera and rose by nonlinear least squares.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

use super::{
    HandEye, HandEyeCamera, HandEyeFailure, HandEyeSettings, LEAST_NOISE, MAX_DEVIATION, MAX_NOISE,
    MAX_REJECTED, MIN_ROWS, Motion, Observation, Rose, seen,
};

/// Number of unknowns: position [m], tilt, pan and turn [rad] of the camera, logarithm of the focal length,
/// position of the rose [m], and two slopes of its axis.
const UNKNOWNS: usize = 12;
type Vector = SVector<f64, UNKNOWNS>;
type Matrix = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Prior standard deviations of the unknowns about a start. They keep the covariance finite.
const PRIOR: [f64; UNKNOWNS] = [0.3, 0.3, 0.3, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 0.5, 0.5];
/// Cauchy's scale in successive rounds [px].
const SCALES: [f64; 5] = [100.0, 30.0, 10.0, 3.0, 1.0];
/// A row does not fit if the error of its circle exceeds this many standard deviations: one of 15 000 does by
/// chance.
const FARTHEST: f64 = 4.5;
/// Median of the length of three independent numbers of unit variance.
const MEDIAN_OF_THREE: f64 = 1.538;
/// Error that is assumed for a circle that the camera cannot see [px].
const UNSEEN: f64 = 1e3;
const MAX_ITERATIONS: usize = 200;
/// Maximum number of rounds that reject rows.
const MAX_ROUNDS: usize = 20;
/// Step of the difference quotients.
const STEP: f64 = 1e-6;
/// Motions that are tried as missing ones [m], [rad].
const MOVED: f64 = 0.05;
const TURNED: f64 = 0.2;
/// A motion is missing if it would reduce the deviation to less than this fraction.
const USEFUL: f64 = 0.8;
/// Number of distances at which the table is evaluated.
const JUDGED: usize = 4;

pub(super) struct Problem<'a> {
    observations: &'a [Observation],
    hands: Vec<Isometry3<f64>>,
    settings: &'a HandEyeSettings,
    /// Two unit vectors, and the mean approach direction; the slopes of the rose's axis are relative to them.
    frame: [Vector3<f64>; 3],
}

impl<'a> Problem<'a> {
    pub fn new(
        observations: &'a [Observation],
        hands: Vec<Isometry3<f64>>,
        settings: &'a HandEyeSettings,
    ) -> Self {
        let sum: Vector3<f64> = hands.iter().map(|hand| hand * Vector3::z()).sum();
        let mean = sum.try_normalize(1e-3).unwrap_or_else(Vector3::z);
        let across = if mean.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let first = mean.cross(&across).normalize();
        Self { observations, hands, settings, frame: [first, mean.cross(&first), mean] }
    }

    pub fn solve(&self) -> Result<HandEye, HandEyeFailure> {
        let all = vec![true; self.hands.len()];
        let mut best: Option<(Vector, f64)> = None;
        for start in self.starts() {
            let mut found = (start, 0.0);
            for scale in SCALES {
                found = self.minimise(found.0, &all, Some((scale, start)));
            }
            if best.as_ref().is_none_or(|(_, cost)| found.1 < *cost) {
                best = Some(found);
            }
        }
        let (guess, _) = best.unwrap_or_default();
        let (mut values, mut kept) = (guess, all);
        for _ in 0..MAX_ROUNDS {
            let limit =
                FARTHEST * (median(self.offsets(&values).collect()) / MEDIAN_OF_THREE).max(LEAST_NOISE);
            let now: Vec<bool> = self.offsets(&values).map(|offset| offset <= limit).collect();
            values = self.minimise(values, &now, None).0;
            if now == std::mem::replace(&mut kept, now.clone()) {
                break;
            }
        }
        self.judge(&guess, &values, &kept)
    }

    /// Returns the result, unless it is too uncertain. Unknowns that the rows do not determine may be
    /// anything in `values`; in `guess` they are as at the start.
    fn judge(&self, guess: &Vector, values: &Vector, kept: &[bool]) -> Result<HandEye, HandEyeFailure> {
        let (camera, rose) = self.split(values);
        let number = kept.iter().filter(|kept| **kept).count();
        let rejected = kept.len() - number;
        let offsets: Vec<[f64; 3]> =
            (0..kept.len()).filter(|row| kept[*row]).map(|row| self.offset(values, row)).collect();
        let sum = |axes: std::ops::Range<usize>| -> f64 {
            offsets.iter().flat_map(|offset| &offset[axes.clone()]).map(|offset| offset * offset).sum()
        };
        let noise = (sum(0..3) / count((3 * number).saturating_sub(UNKNOWNS).max(1))).sqrt();
        if number < MIN_ROWS
            || count(rejected) > MAX_REJECTED * count(kept.len())
            || noise > MAX_NOISE * camera.focal
        {
            return Err(HandEyeFailure::NoFit { rejected, of: kept.len(), noise });
        }
        let weight = noise.max(LEAST_NOISE).powi(-2);
        let information = |values: &Vector| -> Matrix {
            let rows = (0..kept.len()).filter(|row| kept[*row]);
            rows.map(|row| self.information(values, &self.hands[row])).sum::<Matrix>() * weight
                + Matrix::from_diagonal(&prior())
        };
        let [table_deviation, _] = self.table_deviation(guess, &information(guess))?;
        if table_deviation > MAX_DEVIATION {
            let motions = self.missing(guess, kept, information(guess), weight)?;
            return Err(HandEyeFailure::Undetermined { deviation: table_deviation, motions });
        }
        let deviation = covariance(&information(values)).diagonal().map(f64::sqrt);
        Ok(HandEye {
            settings: *self.settings,
            camera,
            deviation: HandEyeCamera {
                position: [deviation[0], deviation[1], deviation[2]],
                tilt: deviation[3],
                pan: deviation[4],
                turn: deviation[5],
                focal: camera.focal * deviation[6],
            },
            rose,
            rose_deviation: [deviation[7], deviation[8], deviation[9]],
            residuals: [0..2, 2..3].map(|axes| (sum(axes) / count(number)).sqrt()),
            used: number,
            rejected: (0..kept.len())
                .filter(|row| !kept[*row])
                .map(|row| (row, length(&self.offset(values, row))))
                .collect(),
            table_deviation,
            rows: camera.rows(self.settings)?,
        })
    }

    /// Returns generic cameras that look along the approach direction, with the rose where most rows see it.
    fn starts(&self) -> Vec<Vector> {
        let mut starts = Vec::new();
        for focal in self.settings.focal {
            for turn in [0.0, FRAC_PI_2, -FRAC_PI_2, PI] {
                let camera = HandEyeCamera { position: [0.0; 3], tilt: 0.0, pan: 0.0, turn, focal };
                let mount = camera.mount();
                let places = self.hands.iter().zip(self.observations).map(|(hand, observation)| {
                    let [x, y] =
                        [0, 1].map(|axis| (observation.center[axis] - self.settings.principal[axis]) / focal);
                    let depth = focal * self.settings.rose / observation.radius;
                    hand * (mount * (Vector3::new(x, y, 1.0) * depth)) + hand.translation.vector
                });
                let places: Vec<Vector3<f64>> = places.collect();
                let mut start = Vector::zeros();
                start[5] = turn;
                start[6] = focal.ln();
                for axis in 0..3 {
                    start[7 + axis] = median(places.iter().map(|place| place[axis]).collect());
                }
                starts.push(start);
            }
        }
        starts
    }

    fn split(&self, values: &Vector) -> (HandEyeCamera, Rose) {
        let [first, second, mean] = self.frame;
        let normal = (mean + first * values[10] + second * values[11]).normalize();
        let camera = HandEyeCamera {
            position: [values[0], values[1], values[2]],
            tilt: values[3],
            pan: values[4],
            turn: wrapped(values[5]),
            focal: values[6].exp(),
        };
        (camera, Rose { center: [values[7], values[8], values[9]], normal: normal.into() })
    }

    /// Predicts centre and radius of the rose from a pose of the hand [px].
    fn predict(&self, values: &Vector, hand: &Isometry3<f64>) -> Option<[f64; 3]> {
        let (camera, rose) = self.split(values);
        let seen = seen(self.settings, &camera, &rose, hand)?;
        Some([seen.center[0], seen.center[1], seen.radius])
    }

    /// Returns predicted minus observed values.
    fn offset(&self, values: &Vector, row: usize) -> [f64; 3] {
        let Observation { center: [u, v], radius, .. } = self.observations[row];
        match self.predict(values, &self.hands[row]) {
            Some(seen) => [seen[0] - u, seen[1] - v, seen[2] - radius],
            None => [UNSEEN, 0.0, 0.0],
        }
    }

    fn offsets(&self, values: &Vector) -> impl Iterator<Item = f64> {
        (0..self.hands.len()).map(|row| length(&self.offset(values, row)))
    }

    /// Computes the derivatives of `function` with respect to the values.
    fn derivatives<const N: usize>(
        values: &Vector,
        function: impl Fn(&Vector) -> Option<[f64; N]>,
    ) -> Option<SMatrix<f64, N, UNKNOWNS>> {
        let mut derivatives = SMatrix::<f64, N, UNKNOWNS>::zeros();
        for index in 0..UNKNOWNS {
            let at = |step: f64| {
                let mut moved = *values;
                moved[index] += step;
                function(&moved).map(SVector::<f64, N>::from)
            };
            derivatives.set_column(index, &((at(STEP)? - at(-STEP)?) / (2.0 * STEP)));
        }
        Some(derivatives)
    }

    /// Computes the information of a picture from a pose of the hand on the values, for circles of unit
    /// variance.
    fn information(&self, values: &Vector, hand: &Isometry3<f64>) -> Matrix {
        Self::derivatives(values, |values| self.predict(values, hand))
            .map_or_else(Matrix::zeros, |derivatives| derivatives.transpose() * derivatives)
    }

    /// Returns the values with the least sum over the kept rows, and the sum: of squares; or, with `robust`,
    /// with Cauchy's weight for a scale and with the prior about some values.
    fn minimise(&self, start: Vector, kept: &[bool], robust: Option<(f64, Vector)>) -> (Vector, f64) {
        let (scale, known) = robust.unzip();
        let square = |values: &Vector, row: usize| length(&self.offset(values, row)).powi(2);
        let pull = |values: &Vector| known.map(|known| (values - known).component_mul(&prior()));
        let rows = || (0..kept.len()).filter(|row| kept[*row]);
        let cost = |values: &Vector| -> f64 {
            let known = known.zip(pull(values)).map_or(0.0, |(known, pull)| (values - known).dot(&pull));
            known
                + rows()
                    .map(|row| match (square(values, row), scale) {
                        (square, Some(scale)) => scale * scale * (square / (scale * scale)).ln_1p(),
                        (square, None) => square,
                    })
                    .sum::<f64>()
        };
        let (mut values, mut least, mut damping) = (start, cost(&start), 1e-3);
        for _ in 0..MAX_ITERATIONS {
            let (mut normal, mut gradient) = (Matrix::zeros(), Vector::zeros());
            for row in rows() {
                let derivatives = Self::derivatives(&values, |values| self.predict(values, &self.hands[row]));
                let Some(derivatives) = derivatives else { continue };
                let weight = scale.map_or(1.0, |scale| 1.0 / (1.0 + square(&values, row) / (scale * scale)));
                normal += derivatives.transpose() * derivatives * weight;
                gradient += derivatives.transpose() * SVector::from(self.offset(&values, row)) * weight;
            }
            if let Some(pull) = pull(&values) {
                normal += Matrix::from_diagonal(&prior());
                gradient += pull;
            }
            let before = least;
            while damping < 1e12 {
                let mut damped = normal;
                for index in 0..UNKNOWNS {
                    damped[(index, index)] += damping * normal[(index, index)] + 1e-12;
                }
                let step = damped.cholesky().map(|damped| damped.solve(&gradient));
                let next = step.map(|step| values - step);
                match next.map(|next| (next, cost(&next))) {
                    Some((next, cost)) if cost < least => {
                        (values, least, damping) = (next, cost, (damping * 0.1).max(1e-12));
                        break;
                    }
                    _ => damping *= 10.0,
                }
            }
            if before - least <= 1e-13 * before {
                break;
            }
        }
        (values, least)
    }

    /// Computes the standard deviation of positions from the table [m]: the largest, and the root of the sum
    /// of squares.
    fn table_deviation(&self, values: &Vector, information: &Matrix) -> Result<[f64; 2], HandEyeFailure> {
        let covariance = covariance(information);
        let [near, far] = self.settings.distances;
        let mut deviations = Vec::new();
        for index in 0..JUDGED {
            let distance = near + (far - near) * count(index) / count(JUDGED - 1);
            let ahead = |values: &Vector| {
                let seen = self.split(values).0.ahead(self.settings, distance)?;
                Some([seen.center[0], seen.center[1], seen.radius])
            };
            let unseen = || HandEyeFailure::Unseen { distance };
            let [_, _, radius] = ahead(values).ok_or_else(unseen)?;
            let derivatives = Self::derivatives(values, ahead).ok_or_else(unseen)?;
            // Size of a pixel at the rose; the distance is the focal length divided by the radius, in units
            // of this size.
            let pixel = self.settings.rose / radius;
            let depth = pixel * values[6].exp();
            let variance = (derivatives * covariance * derivatives.transpose()).diagonal();
            let scale = [pixel, pixel, depth / radius];
            deviations.extend((0..3).map(|axis| scale[axis] * variance[axis].max(0.0).sqrt()));
        }
        let sum: f64 = deviations.iter().map(|deviation| deviation * deviation).sum();
        Ok([deviations.into_iter().fold(0.0, f64::max), sum.sqrt()])
    }

    /// Returns the motions that would help, until the table would be accurate enough.
    fn missing(
        &self,
        values: &Vector,
        kept: &[bool],
        mut information: Matrix,
        weight: f64,
    ) -> Result<Vec<Motion>, HandEyeFailure> {
        // Starts from the row of medium distance.
        let mut rows: Vec<usize> = (0..kept.len()).filter(|row| kept[*row]).collect();
        rows.sort_by(|one, other| {
            self.observations[*one].radius.total_cmp(&self.observations[*other].radius)
        });
        let hand = rows.get(rows.len() / 2).map_or_else(Isometry3::identity, |row| self.hands[*row]);
        let mut motions = Vec::new();
        let mut candidates = vec![
            (Motion::Approach, moved(0.0, 0.0, MOVED)),
            (Motion::Sideways, moved(0.0, MOVED, 0.0)),
            (Motion::Upwards, moved(MOVED, 0.0, 0.0)),
            (Motion::AboutX, turned(Vector3::x())),
            (Motion::AboutY, turned(Vector3::y())),
            (Motion::AboutZ, turned(Vector3::z())),
        ];
        let [mut largest, mut sum] = self.table_deviation(values, &information)?;
        while largest > MAX_DEVIATION {
            let mut best: Option<(usize, [f64; 2], Matrix)> = None;
            for (index, (_, motion)) in candidates.iter().enumerate() {
                let views =
                    [*motion, motion.inverse()].map(|motion| self.information(values, &(hand * motion)));
                let after = information + (views[0] + views[1]) * weight;
                let deviation = self.table_deviation(values, &after)?;
                if best.as_ref().is_none_or(|(_, [_, least], _)| deviation[1] < *least) {
                    best = Some((index, deviation, after));
                }
            }
            let Some((index, deviation, after)) = best.filter(|(_, [_, after], _)| *after < USEFUL * sum)
            else {
                break;
            };
            motions.push(candidates.remove(index).0);
            ([largest, sum], information) = (deviation, after);
        }
        Ok(motions)
    }
}

fn moved(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::identity())
}

fn turned(axis: Vector3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::identity(), UnitQuaternion::new(axis * TURNED))
}

/// Returns the inverse variances of the prior.
fn prior() -> Vector {
    Vector::from(PRIOR).map(|deviation| deviation.powi(-2))
}

/// The prior makes the information positive definite; if it is not because of rounding, the prior's variances
/// are returned.
fn covariance(information: &Matrix) -> Matrix {
    let unknown = || Matrix::from_diagonal(&prior().map(f64::recip));
    information.cholesky().map_or_else(unknown, |factor| factor.inverse())
}

/// The same angle, from −π to π [rad].
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

fn length(offset: &[f64; 3]) -> f64 {
    offset.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

#[expect(clippy::cast_precision_loss, reason = "small numbers")]
const fn count(number: usize) -> f64 {
    number as f64
}
