use core::fmt;

use heapless::Vec;
use nalgebra::{IsometryMatrix3, SMatrix, SVector, Vector3};

use super::random_starts::RandomStarts;
use super::{Chain, Jacobian, Posture};
use crate::OutOfRange;
use crate::math::{self, Ldlt, abs};
use crate::model::{Coupling, MAX_CHAIN_JOINTS};

/// Damping over the squared error [rad²]: large far from the target for stable steps, vanishing near it for
/// fast convergence.
const DAMPING_FACTOR: f32 = 0.5;
/// Minimum damping [rad²]: keeps the step finite in singular postures.
const MIN_DAMPING: f32 = 1e-7;
/// Largest change of an angle in one iteration [rad].
const MAX_STEP: f32 = 1.0;
/// Restarts after this many consecutive iterations that reduced the squared error by less than a tenth.
const MAX_STALLS: u8 = 4;

/// Maximum distance of a target [m]; squares of larger values overflow.
pub(super) const MAX_DISTANCE: f32 = 1e6;

/// Target of the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Position of the tip [m, base frame]; any orientation.
    Position(Vector3<f32>),
    /// Pose of the tip in the base frame.
    Pose(IsometryMatrix3<f32>),
}

/// Iterative inverse kinematics of any chain: Levenberg–Marquardt with damping in proportion to the squared
/// error (Sugihara 2011), an active set for joint limits, and random restarts.
///
/// Configuration of one chain, without state. At most `iterations` · (`restarts` + 3) iterations: choose
/// [`SolverOptions`] accordingly on the tick path.
#[derive(Clone, Debug)]
pub struct InverseKinematics {
    joints: Vec<Joint, MAX_CHAIN_JOINTS>,
    options: SolverOptions,
}

/// Tolerances and iteration limits of [`InverseKinematics`], checked by [`InverseKinematics::with_options`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Position tolerance [m], 10⁻⁷ to 1.
    pub position_tolerance: f32,
    /// Orientation tolerance [rad], 10⁻⁷ to π.
    pub rotation_tolerance: f32,
    /// Weight of position relative to orientation [rad/m], 0.001 to 1000; 1 to 2 over the chain's length
    /// works well.
    pub position_weight: f32,
    /// Maximum iterations per start.
    pub iterations: u16,
    /// Maximum number of random restarts.
    pub restarts: u16,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self {
            position_tolerance: 1e-5,
            rotation_tolerance: 1e-5,
            position_weight: 2.0,
            iterations: 40,
            restarts: 100,
        }
    }
}

/// Limits of a joint [rad] and, for a mimic joint, its coupling to another joint of the chain, by index.
#[derive(Clone, Copy, Debug)]
struct Joint {
    lower: f32,
    upper: f32,
    mimic: Option<Coupling>,
}

/// Why the joints of an [`InverseKinematics`] are invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidJoint {
    /// More joints than a chain can have.
    TooMany,
    /// A limit is NaN or infinite, or the lower one is above the upper one.
    Limits {
        /// The joint.
        joint: usize,
    },
    /// A mimic joint must follow another, existing joint that follows none, with finite coefficients; nothing
    /// may follow it.
    Mimic {
        /// The joint.
        joint: usize,
    },
    /// No angle satisfies the limits of the mimic joint and of the joint that it follows.
    MimicLimits {
        /// The joint.
        joint: usize,
    },
}

/// Final error and effort of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveReport {
    /// Distance from the target [m].
    pub position_error: f32,
    /// Angle from the target's orientation [rad]; 0 for a target without one.
    pub rotation_error: f32,
    /// Total number of iterations.
    pub iterations: u32,
}

/// Why [`InverseKinematics::solve`] found no solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InverseKinematicsError {
    /// The target is NaN, infinite or more than 1e6 m away, or the start is NaN or infinite.
    NotFinite,
    /// The chain, the limits and the start have different numbers of joints.
    Joints,
    /// Out of reach, or not found within the iterations. `q` holds the best angles found.
    NotReached(SolveReport),
}

/// The best angles so far.
struct Best {
    /// Squared error [rad²].
    cost: f32,
    angles: [f32; MAX_CHAIN_JOINTS],
    /// Squared distance [m²] and angle [rad²] from the target.
    linear: f32,
    angular: f32,
}

impl InverseKinematics {
    /// Solver for a chain with these lower and upper joint limits [rad].
    ///
    /// # Errors
    /// A limit is not finite, the lower one is above the upper one, or there are too many joints.
    pub fn try_new(limits: &[(f32, f32)]) -> Result<Self, InvalidJoint> {
        let mut joints = Vec::new();
        for (joint, &(lower, upper)) in limits.iter().enumerate() {
            if !(lower.is_finite() && upper.is_finite() && lower <= upper) {
                return Err(InvalidJoint::Limits { joint });
            }
            joints.push(Joint { lower, upper, mimic: None }).map_err(|_| InvalidJoint::TooMany)?;
        }
        Ok(Self { joints, options: SolverOptions::default() })
    }

    /// Replaces tolerances and iteration limits.
    ///
    /// # Errors
    /// The first value outside its range.
    pub fn with_options(self, options: SolverOptions) -> Result<Self, OutOfRange> {
        let SolverOptions { position_tolerance, rotation_tolerance, position_weight, .. } = options;
        OutOfRange::check("position tolerance", position_tolerance, [1e-7, 1.0])?;
        OutOfRange::check("rotation tolerance", rotation_tolerance, [1e-7, core::f32::consts::PI])?;
        OutOfRange::check("weight of the position", position_weight, [1e-3, 1e3])?;
        Ok(Self { options, ..self })
    }

    /// Declares joint `joint` as a mimic joint with the angle `multiplier` · angle of joint `of` + `offset`
    /// [rad].
    ///
    /// # Errors
    /// The joints or coefficients are invalid, or the limits leave no common angle.
    pub fn with_mimic(
        mut self,
        joint: usize,
        of: usize,
        multiplier: f32,
        offset: f32,
    ) -> Result<Self, InvalidJoint> {
        let (Some(own), Some(other)) = (self.joints.get(joint).copied(), self.joints.get(of).copied()) else {
            return Err(InvalidJoint::Mimic { joint });
        };
        let followed = self
            .joints
            .iter()
            .any(|other| other.mimic.is_some_and(|mimic| usize::from(mimic.actuated) == joint));
        let finite = multiplier.is_finite() && offset.is_finite();
        if joint == of || own.mimic.is_some() || other.mimic.is_some() || followed || !finite {
            return Err(InvalidJoint::Mimic { joint });
        }
        // Restrict the leading joint so that both stay within their limits.
        let (mut lower, mut upper) = (other.lower, other.upper);
        if multiplier != 0.0 {
            let ends = [(own.lower - offset) / multiplier, (own.upper - offset) / multiplier];
            lower = lower.max(ends[0].min(ends[1]));
            upper = upper.min(ends[0].max(ends[1]));
        }
        let stands_outside = multiplier == 0.0 && !(own.lower..=own.upper).contains(&offset);
        if lower > upper || stands_outside {
            return Err(InvalidJoint::MimicLimits { joint });
        }
        if let Some(other) = self.joints.get_mut(of) {
            (other.lower, other.upper) = (lower, upper);
        }
        if let Some(own) = self.joints.get_mut(joint) {
            #[expect(clippy::cast_possible_truncation, reason = "at most 7")]
            let actuated = of as u8;
            own.mimic = Some(Coupling { actuated, multiplier, offset });
        }
        Ok(self)
    }

    /// Searches for joint angles that bring the tip of `chain` to `target`. `q` [rad] holds the initial
    /// angles, which are limited first, and receives the solution or the best angles found.
    ///
    /// # Errors
    /// The input is invalid or the target was not reached.
    pub fn solve(
        &self,
        chain: &Chain,
        target: &Target,
        q: &mut [f32],
    ) -> Result<SolveReport, InverseKinematicsError> {
        if q.len() != chain.len() || q.len() != self.joints.len() {
            return Err(InverseKinematicsError::Joints);
        }
        let finite = match target {
            Target::Position(position) => position.iter().all(|value| abs(*value) < MAX_DISTANCE),
            Target::Pose(pose) => {
                pose.translation.vector.iter().all(|value| abs(*value) < MAX_DISTANCE)
                    && pose.rotation.matrix().iter().all(|value| value.is_finite())
            }
        };
        if !finite || !q.iter().all(|value| value.is_finite()) {
            return Err(InverseKinematicsError::NotFinite);
        }
        match target {
            Target::Position(position) => {
                let error = |posture: &Posture| position - posture.tip.translation.vector;
                self.search::<3>(chain, q, |posture| {
                    let linear = error(posture);
                    (linear * self.options.position_weight, linear.norm_squared(), 0.0)
                })
            }
            Target::Pose(pose) => self.search::<6>(chain, q, |posture| {
                let linear = pose.translation.vector - posture.tip.translation.vector;
                let away = pose.rotation.matrix() * posture.tip.rotation.matrix().transpose();
                let angular = math::rotation_vector(&away);
                let error = math::stack([linear * self.options.position_weight, angular]);
                (error, linear.norm_squared(), angular.norm_squared())
            }),
        }
    }

    /// Searches from the start and from random restarts, then descends from the best angles found. `error`
    /// gives the weighted error vector [rad] and the squares of its linear and angular parts [m², rad²].
    fn search<const M: usize>(
        &self,
        chain: &Chain,
        q: &mut [f32],
        error: impl Fn(&Posture) -> (SVector<f32, M>, f32, f32),
    ) -> Result<SolveReport, InverseKinematicsError> {
        let mut angles = [0.0; MAX_CHAIN_JOINTS];
        angles.iter_mut().zip(q.iter()).for_each(|(angle, &q)| *angle = q);
        self.limit(&mut angles);
        let best = Best { cost: f32::INFINITY, angles, linear: f32::INFINITY, angular: f32::INFINITY };
        let mut search = Search { solver: self, chain, error, best, iterations: 0 };
        let reached = search.restarts(angles) || search.descend();
        let Search { best, iterations, .. } = search;
        q.iter_mut().zip(&best.angles).for_each(|(q, &angle)| *q = angle);
        let report = SolveReport {
            position_error: math::sqrt(best.linear),
            rotation_error: math::sqrt(best.angular),
            iterations,
        };
        if reached { Ok(report) } else { Err(InverseKinematicsError::NotReached(report)) }
    }

    /// One Levenberg–Marquardt step, limited to `MAX_STEP` and the joint limits.
    fn step<const M: usize>(
        &self,
        posture: &Posture,
        error: &SVector<f32, M>,
        damping: f32,
        angles: &mut [f32; MAX_CHAIN_JOINTS],
    ) {
        let jacobian = self.jacobian::<M>(posture, error, angles);
        let mut damped = jacobian * jacobian.transpose();
        for index in 0..M {
            damped[(index, index)] += damping + MIN_DAMPING;
        }
        let step = jacobian.tr_mul(&Ldlt::new(&damped, MIN_DAMPING).solve(error));
        let largest = step.iter().fold(0.0_f32, |largest, step| largest.max(abs(*step)));
        let scale = if largest > MAX_STEP { MAX_STEP / largest } else { 1.0 };
        for (angle, step) in angles.iter_mut().zip(&step) {
            *angle += scale * step;
        }
        self.limit(angles);
    }

    /// The Jacobian with its linear rows scaled like the error, the columns of mimic joints added to those of
    /// the joints that they follow, and without the joints at a limit beyond which the error pulls them.
    fn jacobian<const M: usize>(
        &self,
        posture: &Posture,
        error: &SVector<f32, M>,
        angles: &[f32; MAX_CHAIN_JOINTS],
    ) -> SMatrix<f32, M, MAX_CHAIN_JOINTS> {
        let full: Jacobian = posture.jacobian();
        let mut jacobian = full.fixed_rows::<M>(0).into_owned();
        jacobian.fixed_rows_mut::<3>(0).scale_mut(self.options.position_weight);
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mimic) = joint.mimic {
                let own = jacobian.column(index).into_owned();
                jacobian.column_mut(mimic.actuated.into()).axpy(mimic.multiplier, &own, 1.0);
                jacobian.column_mut(index).fill(0.0);
            }
        }
        for (mut column, (joint, &angle)) in jacobian.column_iter_mut().zip(self.joints.iter().zip(angles)) {
            let pull = column.dot(error);
            if angle <= joint.lower && pull < 0.0 || angle >= joint.upper && pull > 0.0 {
                column.fill(0.0);
            }
        }
        jacobian
    }

    /// Limits the angles, and sets the mimic joints by their couplings.
    fn limit(&self, angles: &mut [f32; MAX_CHAIN_JOINTS]) {
        for (angle, joint) in angles.iter_mut().zip(&self.joints) {
            *angle = math::clamp(*angle, joint.lower, joint.upper);
        }
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mimic) = joint.mimic {
                let followed = angles.get(usize::from(mimic.actuated)).copied().unwrap_or(0.0);
                if let Some(angle) = angles.get_mut(index) {
                    *angle = mimic.angle(followed);
                }
            }
        }
    }
}

/// A search under way.
struct Search<'a, E> {
    solver: &'a InverseKinematics,
    chain: &'a Chain,
    error: E,
    best: Best,
    iterations: u32,
}

/// The posture at some angles, the error there [rad], its square [rad²], and whether both tolerances are met.
type Evaluation<const M: usize> = (Posture, SVector<f32, M>, f32, bool);

impl<E> Search<'_, E> {
    /// Computes the error at `angles` and keeps them if they are the best so far.
    fn evaluate<const M: usize>(&mut self, angles: &[f32; MAX_CHAIN_JOINTS]) -> Evaluation<M>
    where
        E: Fn(&Posture) -> (SVector<f32, M>, f32, f32),
    {
        let SolverOptions { position_tolerance, rotation_tolerance, .. } = self.solver.options;
        let posture = self.chain.posture(angles.get(..self.chain.len()).unwrap_or_default());
        let (error, linear, angular) = (self.error)(&posture);
        self.iterations += 1;
        let cost = error.norm_squared();
        let reached = linear <= position_tolerance * position_tolerance
            && angular <= rotation_tolerance * rotation_tolerance;
        if reached || cost < self.best.cost {
            self.best = Best { cost, angles: *angles, linear, angular };
        }
        (posture, error, cost, reached)
    }

    /// Iterates from `angles`, then from random angles within the limits. Returns whether the target was
    /// reached.
    fn restarts<const M: usize>(&mut self, mut angles: [f32; MAX_CHAIN_JOINTS]) -> bool
    where
        E: Fn(&Posture) -> (SVector<f32, M>, f32, f32),
    {
        let solver = self.solver;
        let mut starts = RandomStarts::new();
        for _ in 0..=solver.options.restarts {
            solver.limit(&mut angles);
            let (mut stalls, mut before) = (0, f32::INFINITY);
            for _ in 0..solver.options.iterations {
                let (posture, error, cost, reached) = self.evaluate(&angles);
                if reached {
                    return true;
                }
                stalls = if cost > 0.9 * before { stalls + 1 } else { 0 };
                if stalls == MAX_STALLS {
                    break;
                }
                before = cost;
                solver.step(&posture, &error, DAMPING_FACTOR * cost, &mut angles);
            }
            for (angle, joint) in angles.iter_mut().zip(&solver.joints) {
                *angle = starts.angle((joint.lower, joint.upper));
            }
        }
        false
    }

    /// Levenberg–Marquardt with step rejection from the best angles: approaches the nearest reachable pose.
    /// Returns whether the target was reached after all.
    fn descend<const M: usize>(&mut self) -> bool
    where
        E: Fn(&Posture) -> (SVector<f32, M>, f32, f32),
    {
        let mut damping = DAMPING_FACTOR * self.best.cost;
        for _ in 0..self.solver.options.iterations {
            let mut angles = self.best.angles;
            let (posture, error, cost, _) = self.evaluate(&angles);
            self.solver.step(&posture, &error, damping, &mut angles);
            let (.., nearer, reached) = self.evaluate(&angles);
            if reached {
                return true;
            }
            damping *= if nearer < cost { 0.1 } else { 10.0 };
        }
        false
    }
}

impl fmt::Display for InvalidJoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooMany => write!(f, "a chain has at most {MAX_CHAIN_JOINTS} joints"),
            Self::Limits { joint } => {
                write!(f, "joint {joint}: limits must be finite, the lower one not above the upper one")
            }
            Self::Mimic { joint } => {
                write!(
                    f,
                    "joint {joint}: it can follow only another joint that follows none, by finite numbers"
                )
            }
            Self::MimicLimits { joint } => {
                write!(f, "joint {joint}: its limits, and those of the joint that it follows, leave no angle")
            }
        }
    }
}

impl core::error::Error for InvalidJoint {}

impl fmt::Display for InverseKinematicsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "target and start must be finite, the target within 1e6 m"),
            Self::Joints => write!(f, "chain, limits and start must have the same number of joints"),
            Self::NotReached(SolveReport { position_error, rotation_error, iterations }) => write!(
                f,
                "not reached in {iterations} iterations: the nearest is {position_error} m and {rotation_error} rad away; \
                 a nearer target, wider limits or more restarts may help"
            ),
        }
    }
}

impl core::error::Error for InverseKinematicsError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_possible_truncation, reason = "tests")]
#[path = "inverse_tests.rs"]
mod tests;
