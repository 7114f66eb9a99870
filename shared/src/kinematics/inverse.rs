use core::fmt;

use heapless::Vec;
use nalgebra::{IsometryMatrix3, SMatrix, SVector, Vector3};

use super::{Chain, Jacobian, Posture};
use crate::math::{self, Ldlt, abs};
use crate::model::MAX_CHAIN_JOINTS;

/// Share of the squared error [rad²] that is added to the squared singular values: far from the target it keeps steps
/// sensible, near it nothing of it is left.
const DAMPING_FACTOR: f32 = 0.5;
/// What is left of it at the target [rad²], for postures in which the smallest singular value is 0.
const MIN_DAMPING: f32 = 1e-7;
/// Largest change of an angle in one iteration [rad].
const MAX_STEP: f32 = 1.0;
/// A start is given up when this many iterations in a row have not brought the squared error down by a tenth.
const MAX_STALLS: u8 = 4;

/// Targets beyond this [m] are none: their squares would be infinite.
pub(super) const MAX_DISTANCE: f32 = 1e6;

/// Where the tip should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// At this place [m, base frame], with any orientation.
    Position(Vector3<f32>),
    /// With its frame there.
    Pose(IsometryMatrix3<f32>),
}

/// Inverse kinematics by iteration, for any chain: Levenberg–Marquardt with a damping that follows the squared error
/// (Sugihara 2011), joint limits by an active set, and new starts when it is stuck.
///
/// Configuration of one chain; nothing is kept from one call to the next. Never more than
/// `iterations` · (`restarts` + 3) iterations: on the tick path choose [`SolverOptions`] accordingly.
#[derive(Clone, Debug)]
pub struct InverseKinematics {
    joints: Vec<Joint, MAX_CHAIN_JOINTS>,
    options: SolverOptions,
}

/// When [`InverseKinematics`] has reached its target, and when it gives up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Largest distance from the target [m]. Tolerances end the search; they are no weights.
    pub position_tolerance: f32,
    /// Largest angle from the target's orientation [rad].
    pub rotation_tolerance: f32,
    /// A metre of distance counts as much as this angle [rad/m]; some 1 to 2 over the chain's length is good.
    pub radians_per_metre: f32,
    /// Iterations from one start.
    pub iterations: u16,
    /// New starts after the first.
    pub restarts: u16,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self {
            position_tolerance: 1e-5,
            rotation_tolerance: 1e-5,
            radians_per_metre: 2.0,
            iterations: 40,
            restarts: 100,
        }
    }
}

/// A joint's limits [rad] and, when it has no drive of its own, the joint that it follows.
#[derive(Clone, Copy, Debug)]
struct Joint {
    lower: f32,
    upper: f32,
    mimic: Option<Mimic>,
}

/// Angle = `multiplier` · angle of joint `of` + `offset`.
#[derive(Clone, Copy, Debug)]
struct Mimic {
    of: usize,
    multiplier: f32,
    offset: f32,
}

/// What is wrong with the joints of an [`InverseKinematics`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidJoint {
    /// More joints than a chain can have.
    TooMany,
    /// A limit is NaN or infinite, or the lower one is above the upper one.
    Limits {
        /// The joint.
        joint: usize,
    },
    /// The joint follows itself, one that follows another itself, one that is not there, or already another; or by a
    /// factor that is no number.
    Mimic {
        /// The joint.
        joint: usize,
    },
    /// The limits of the joint, and of the one that it follows, leave no angle for both.
    MimicLimits {
        /// The joint.
        joint: usize,
    },
}

/// A target that was reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveReport {
    /// Distance from the target [m].
    pub position_error: f32,
    /// Angle from the target's orientation [rad]; 0 when it had none.
    pub rotation_error: f32,
    /// Iterations in all.
    pub iterations: u32,
}

/// Why a target was not reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InverseKinematicsError {
    /// The target is NaN, infinite or more than 1e6 m away, or the start is NaN or infinite.
    NotFinite,
    /// The chain, the limits and the start have different numbers of joints.
    Joints,
    /// Out of reach, or not found in the iterations allowed. The angles are the nearest that were found.
    NotReached(SolveReport),
}

/// The nearest so far.
struct Best {
    /// Squared error [rad²].
    cost: f32,
    angles: [f32; MAX_CHAIN_JOINTS],
    /// Squared distance [m²] and angle [rad²] from the target.
    linear: f32,
    angular: f32,
}

impl InverseKinematics {
    /// Of a chain with these lower and upper limits of its joints [rad].
    ///
    /// # Errors
    /// When they are no limits.
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

    /// With other tolerances and bounds.
    #[must_use]
    pub const fn with_options(mut self, options: SolverOptions) -> Self {
        self.options = options;
        self
    }

    /// Joint `joint` has no drive: its angle is `multiplier` · angle of joint `of` + `offset`.
    ///
    /// # Errors
    /// When that cannot be.
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
        let followed = self.joints.iter().any(|other| other.mimic.is_some_and(|mimic| mimic.of == joint));
        let finite = multiplier.is_finite() && offset.is_finite();
        if joint == of || own.mimic.is_some() || other.mimic.is_some() || followed || !finite {
            return Err(InvalidJoint::Mimic { joint });
        }
        // The joint that is followed may go only where both stay within their limits.
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
            own.mimic = Some(Mimic { of, multiplier, offset });
        }
        Ok(self)
    }

    /// Looks for joint angles that bring the tip of `chain` to `target`. `q` [rad] has the start, and gets the result, or
    /// the nearest that was found. A start outside the limits is moved inside.
    ///
    /// # Errors
    /// When the target is not reached.
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
                    (linear * self.options.radians_per_metre, linear.norm_squared(), 0.0)
                })
            }
            Target::Pose(pose) => self.search::<6>(chain, q, |posture| {
                let linear = pose.translation.vector - posture.tip.translation.vector;
                let away = pose.rotation.matrix() * posture.tip.rotation.matrix().transpose();
                let angular = math::rotation_vector(&away);
                let scaled = linear * self.options.radians_per_metre;
                let error =
                    SVector::<f32, 6>::from([scaled.x, scaled.y, scaled.z, angular.x, angular.y, angular.z]);
                (error, linear.norm_squared(), angular.norm_squared())
            }),
        }
    }

    /// `error`: what is missing to the target [rad], and the squares of its two parts [m², rad²].
    fn search<const M: usize>(
        &self,
        chain: &Chain,
        q: &mut [f32],
        error: impl Fn(&Posture) -> (SVector<f32, M>, f32, f32),
    ) -> Result<SolveReport, InverseKinematicsError> {
        let options = &self.options;
        let square = |x: f32| x * x;
        let tolerances = (square(options.position_tolerance), square(options.rotation_tolerance));
        let mut angles = [0.0; MAX_CHAIN_JOINTS];
        angles.iter_mut().zip(q.iter()).for_each(|(angle, &q)| *angle = q);
        self.limit(&mut angles);
        let mut best = Best { cost: f32::INFINITY, angles, linear: f32::INFINITY, angular: f32::INFINITY };
        let mut iterations = 0_u32;
        let mut look = |angles: &[f32; MAX_CHAIN_JOINTS], best: &mut Best| {
            let posture = chain.posture(angles.get(..chain.len()).unwrap_or_default());
            let (error, linear, angular) = error(&posture);
            iterations += 1;
            let cost = error.norm_squared();
            let there = linear <= tolerances.0 && angular <= tolerances.1;
            if there || cost < best.cost {
                *best = Best { cost, angles: *angles, linear, angular };
            }
            (posture, error, cost, there)
        };

        let mut reached = false;
        let mut random = 1_u32;
        'starts: for _ in 0..=options.restarts {
            self.limit(&mut angles);
            let (mut stalls, mut before) = (0, f32::INFINITY);
            for _ in 0..options.iterations {
                let (posture, error, cost, there) = look(&angles, &mut best);
                if there {
                    reached = true;
                    break 'starts;
                }
                stalls = if cost > 0.9 * before { stalls + 1 } else { 0 };
                if stalls == MAX_STALLS {
                    break;
                }
                before = cost;
                self.step(&posture, &error, DAMPING_FACTOR * cost, &mut angles);
            }
            for (angle, joint) in angles.iter_mut().zip(&self.joints) {
                // The generator of Numerical Recipes; its upper bits are good enough to begin anew somewhere else.
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                #[expect(clippy::cast_precision_loss, reason = "24 bits")]
                let share = (random >> 8) as f32 / 16_777_216.0;
                *angle = joint.lower + share * (joint.upper - joint.lower);
            }
        }
        if !reached {
            // What remains is to come as near as can be: steps that lead away are taken back.
            let mut damping = DAMPING_FACTOR * best.cost;
            for _ in 0..options.iterations {
                angles = best.angles;
                let (posture, error, cost, _) = look(&angles, &mut best);
                self.step(&posture, &error, damping, &mut angles);
                let (.., nearer, there) = look(&angles, &mut best);
                if there {
                    reached = true;
                    break;
                }
                damping *= if nearer < cost { 0.1 } else { 10.0 };
            }
        }
        q.iter_mut().zip(&best.angles).for_each(|(q, &angle)| *q = angle);
        let solved = SolveReport {
            position_error: math::sqrt(best.linear),
            rotation_error: math::sqrt(best.angular),
            iterations,
        };
        if reached { Ok(solved) } else { Err(InverseKinematicsError::NotReached(solved)) }
    }

    /// One step of Levenberg–Marquardt.
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

    /// The Jacobian with its linear rows scaled like the error, the columns of joints that follow others added to those,
    /// and without the joints that stand at a limit beyond which the error pulls them.
    fn jacobian<const M: usize>(
        &self,
        posture: &Posture,
        error: &SVector<f32, M>,
        angles: &[f32; MAX_CHAIN_JOINTS],
    ) -> SMatrix<f32, M, MAX_CHAIN_JOINTS> {
        let full: Jacobian = posture.jacobian();
        let mut jacobian = full.fixed_rows::<M>(0).into_owned();
        jacobian.fixed_rows_mut::<3>(0).scale_mut(self.options.radians_per_metre);
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mimic) = joint.mimic {
                let own = jacobian.column(index).into_owned();
                jacobian.column_mut(mimic.of).axpy(mimic.multiplier, &own, 1.0);
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

    /// Moves angles into their limits, and those that follow others to where they belong.
    fn limit(&self, angles: &mut [f32; MAX_CHAIN_JOINTS]) {
        for (angle, joint) in angles.iter_mut().zip(&self.joints) {
            *angle = math::clamp(*angle, joint.lower, joint.upper);
        }
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(mimic) = joint.mimic {
                let followed = angles.get(mimic.of).copied().unwrap_or(0.0);
                if let Some(angle) = angles.get_mut(index) {
                    *angle = mimic.multiplier * followed + mimic.offset;
                }
            }
        }
    }
}

impl fmt::Display for InvalidJoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooMany => write!(f, "a chain has at most {MAX_CHAIN_JOINTS} joints"),
            Self::Limits { joint } => {
                write!(f, "joint {joint}: its limits are not a lower and an upper angle")
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
mod tests {
    use super::*;
    use crate::kinematics::tests::chain_of;

    /// The same numbers everywhere.
    struct Random(u32);

    impl Random {
        fn between(&mut self, lower: f32, upper: f32) -> f32 {
            self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            lower + (upper - lower) * f32::from((self.0 >> 16) as u16) / 65_536.0
        }
    }

    /// How many of 1000 targets are reached from `start` and from nearby, and that none that is said to be is missed.
    fn reached(name: &str, limit: f32, position_only: bool, singular: &[usize]) -> (u32, u32) {
        let chain = chain_of(name);
        let limits = vec![(-limit, limit); chain.len()];
        let solver = InverseKinematics::try_new(&limits).unwrap();
        let mut random = Random(7);
        let (mut fixed, mut near) = (0, 0);
        for _ in 0..1000 {
            let mut goal: std::vec::Vec<f32> =
                (0..chain.len()).map(|_| random.between(-limit, limit)).collect();
            singular.iter().for_each(|&joint| goal[joint] *= 0.003);
            let pose = *chain.posture(&goal).tip();
            let target =
                if position_only { Target::Position(pose.translation.vector) } else { Target::Pose(pose) };
            let beside: std::vec::Vec<f32> = goal.iter().map(|q| q + random.between(-0.1, 0.1)).collect();
            for (count, mut q) in [(&mut fixed, vec![0.3; chain.len()]), (&mut near, beside)] {
                if solver.solve(&chain, &target, &mut q).is_err() {
                    continue;
                }
                *count += 1;
                assert!(q.iter().all(|angle| abs(*angle) <= limit));
                let tip = *chain.posture(&q).tip();
                assert!((tip.translation.vector - pose.translation.vector).norm() < 1.1e-5);
                assert!(position_only || (tip.rotation.matrix() - pose.rotation.matrix()).norm() < 2e-5);
            }
        }
        (fixed, near)
    }

    #[test]
    fn reaches_what_can_be_reached_near_singular_postures_too() {
        for (name, limit, position_only, singular) in [
            ("ur5e", 3.1, false, &[][..]),
            ("ur5e", 3.1, false, &[2, 4]),
            ("franka_panda", 2.8, false, &[]),
            ("kuka_iiwa14", 2.0, false, &[]),
            ("kinova_j2s6s200", 3.1, false, &[]),
            ("allegro_thumb", 1.2, true, &[]),
        ] {
            let (fixed, near) = reached(name, limit, position_only, singular);
            assert!(fixed >= 999 && near == 1000, "{name} {singular:?}: {fixed}, {near} of 1000");
        }
    }

    #[test]
    fn joints_that_follow_others_do() {
        // As in tests/robots/inspire_right.urdf: yaw, pitch, and two joints that follow the pitch.
        let chain = chain_of("inspire_thumb");
        let solver = InverseKinematics::try_new(&[(-0.1, 1.3), (0.0, 0.6), (0.0, 0.8), (0.0, 1.2)]).unwrap();
        let solver = solver.with_mimic(2, 1, 1.6, 0.0).unwrap().with_mimic(3, 1, 2.4, 0.0).unwrap();
        // 0.8 / 1.6 = 1.2 / 2.4 = 0.5: the pitch may not use all of its own range.
        assert_eq!((solver.joints[1].lower, solver.joints[1].upper), (0.0, 0.5));
        let mut random = Random(3);
        for _ in 0..300 {
            let mut goal = [0.0; MAX_CHAIN_JOINTS];
            for (angle, joint) in goal.iter_mut().zip(&solver.joints) {
                *angle = random.between(joint.lower, joint.upper);
            }
            solver.limit(&mut goal);
            let goal = &goal[..4];
            let target = Target::Position(chain.posture(goal).tip().translation.vector);
            let mut q = [0.1; 4];
            solver.solve(&chain, &target, &mut q).unwrap();
            assert!(abs(q[2] - 1.6 * q[1]) < 1e-6 && abs(q[3] - 2.4 * q[1]) < 1e-6, "{q:?}");
        }
    }

    #[test]
    fn out_of_reach_ends_at_the_nearest_place() {
        let chain = chain_of("allegro_index");
        let limits = [(-0.5, 0.5), (-0.2, 1.6), (-0.2, 1.7), (-0.2, 1.6)];
        let solver = InverseKinematics::try_new(&limits).unwrap();
        let far = Vector3::new(0.0, 0.0, 5.0);
        let mut q = [0.3; 4];
        let Err(InverseKinematicsError::NotReached(nearest)) =
            solver.solve(&chain, &Target::Position(far), &mut q)
        else {
            panic!()
        };
        let distance = |q: &[f32]| (chain.posture(q).tip().translation.vector - far).norm();
        assert!(abs(distance(&q) - nearest.position_error) < 1e-5);
        let mut random = Random(5);
        let least = (0..20_000)
            .map(|_| distance(&limits.map(|(lower, upper)| random.between(lower, upper))))
            .fold(f32::INFINITY, f32::min);
        assert!(nearest.position_error < least + 1e-5, "{} {least}", nearest.position_error);
    }

    #[test]
    fn few_iterations_that_reach_the_target_are_enough() {
        let chain = chain_of("hand3_finger1");
        let options = SolverOptions { restarts: 0, ..SolverOptions::default() };
        let solver = InverseKinematics::try_new(&[(-1.0, 1.0), (-1.2, 1.7), (-0.1, 2.4)]).unwrap();
        let solver = solver.with_options(options);
        let mut random = Random(11);
        for _ in 0..1000 {
            let goal = [random.between(-1.0, 1.0), random.between(-1.2, 1.7), random.between(-0.1, 2.4)];
            let target = Target::Position(chain.posture(&goal).tip().translation.vector);
            let result = solver.solve(&chain, &target, &mut [0.0, 0.3, 1.0]);
            let Err(InverseKinematicsError::NotReached(nearest)) = result else { continue };
            assert!(nearest.position_error > options.position_tolerance, "{nearest:?}");
        }
        let nowhere = Target::Position(Vector3::new(1e19, 0.0, 0.0));
        assert_eq!(solver.solve(&chain, &nowhere, &mut [0.0; 3]), Err(InverseKinematicsError::NotFinite));
    }

    #[test]
    fn bad_input_is_refused_by_name() {
        let chain = chain_of("allegro_index");
        let refused = |limits: &[(f32, f32)]| InverseKinematics::try_new(limits).unwrap_err();
        assert_eq!(refused(&[(0.0, 1.0), (1.0, 0.0)]), InvalidJoint::Limits { joint: 1 });
        assert_eq!(refused(&[(f32::NAN, 1.0)]), InvalidJoint::Limits { joint: 0 });
        assert_eq!(refused(&[(0.0, 1.0); 8]), InvalidJoint::TooMany);
        let solver = InverseKinematics::try_new(&[(0.0, 1.0); 4]).unwrap();
        let mimic =
            |joint, of, multiplier| solver.clone().with_mimic(joint, of, multiplier, 0.0).unwrap_err();
        assert_eq!(mimic(1, 1, 1.0), InvalidJoint::Mimic { joint: 1 });
        assert_eq!(mimic(1, 9, 1.0), InvalidJoint::Mimic { joint: 1 });
        assert_eq!(mimic(1, 2, f32::NAN), InvalidJoint::Mimic { joint: 1 });
        let offset = solver.clone().with_mimic(3, 2, 1.0, 5.0).unwrap_err();
        assert_eq!(offset, InvalidJoint::MimicLimits { joint: 3 });
        assert_eq!(
            solver.clone().with_mimic(3, 2, 0.0, 5.0).unwrap_err(),
            InvalidJoint::MimicLimits { joint: 3 }
        );
        let twice = solver.clone().with_mimic(3, 2, 1.0, 0.0).unwrap();
        assert_eq!(twice.with_mimic(3, 1, 1.0, 0.0).unwrap_err(), InvalidJoint::Mimic { joint: 3 });
        let chained = solver.clone().with_mimic(3, 2, 1.0, 0.0).unwrap();
        assert_eq!(chained.with_mimic(2, 1, 1.0, 0.0).unwrap_err(), InvalidJoint::Mimic { joint: 2 });
        let nowhere = Target::Position(Vector3::new(f32::NAN, 0.0, 0.0));
        assert_eq!(solver.solve(&chain, &nowhere, &mut [0.0; 4]), Err(InverseKinematicsError::NotFinite));
        let here = Target::Position(Vector3::zeros());
        assert_eq!(solver.solve(&chain, &here, &mut [0.0; 3]), Err(InverseKinematicsError::Joints));
        assert_eq!(
            solver.solve(&chain, &here, &mut [f32::INFINITY; 4]),
            Err(InverseKinematicsError::NotFinite)
        );
    }
}
