//! The reference of the arm: a straight motion of the hand at a constant orientation.

use core::array::from_fn;
use core::ops::Range;

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};

use super::ChainConfig;
use crate::TICK;
use crate::control::JointPoint;
use crate::kinematics::{Jacobian, Posture};
use crate::math::{self, Ldlt, abs};
use crate::model::{JointLimits, MAX_CHAIN_JOINTS, MAX_JOINTS};
use crate::robot::{JointConfig, Robot, STOP_MARGIN};
use crate::signal::{MotionLimits, MotionTarget};

/// Damping of the inverse Jacobian [m, rad].
const DAMPING: f32 = 0.01;
/// Rate at which orientation errors decay [1/s].
const TURNING: f32 = 5.0;
/// Largest acceleration of a joint's reference, over its velocity limit [1/s].
const JOINT_ACCELERATION: f32 = 8.0;

/// The arm of a robot. Its gripper is assumed at 0.
pub struct GuidedArm<'a> {
    pub config: &'a ChainConfig,
    joints: &'a [JointConfig],
    range: Range<usize>,
    gripper: usize,
}

/// Motion of the hand in a period.
pub struct Step {
    /// Its velocity [m/s].
    pub velocity: Vector3<f32>,
    /// Distance to its target [m].
    pub remaining: f32,
    /// Whether angle limits hold joints back.
    pub limited: bool,
}

/// Velocities of the arm's own joints [rad/s].
type Velocities = [f32; MAX_CHAIN_JOINTS];

impl<'a> GuidedArm<'a> {
    /// The arm that is this chain; `None` without it.
    pub fn new(robot: &'a Robot, chain: u8, gripper: u8) -> Option<Self> {
        let config = robot.chains().get(usize::from(chain))?;
        let range = config.joints();
        let joints = robot.joints().get(range.clone())?;
        Some(Self { config, joints, range, gripper: gripper.into() })
    }

    /// The posture at these angles of the robot's joints [rad].
    pub fn posture(&self, angles: &[f32; MAX_JOINTS]) -> Posture {
        let mut angles = *angles;
        if let Some(gripper) = angles.get_mut(self.gripper) {
            *gripper = 0.0;
        }
        self.config.chain.posture(angles.get(self.config.joints()).unwrap_or_default())
    }

    /// The Jacobian over the arm's own joints without the gripper.
    pub fn jacobian(&self, posture: &Posture) -> Jacobian {
        let mut jacobian = posture.jacobian();
        if self.range.contains(&self.gripper)
            && let Some(mut column) = jacobian.column_iter_mut().nth(self.gripper - self.range.start)
        {
            column.fill(0.0);
        }
        jacobian
    }

    /// Indices of its joints without the gripper, in the robot and in the chain; within any list of joints.
    pub fn indices(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let gripper = self.gripper;
        self.range
            .clone()
            .enumerate()
            .map(|(own, index)| (index, own))
            .filter(move |&(index, own)| index != gripper && index < MAX_JOINTS && own < MAX_CHAIN_JOINTS)
    }

    /// Moves the joints' references for one period towards `target`.
    pub fn advance(
        &self,
        points: &mut [JointPoint; MAX_JOINTS],
        target: &Isometry3<f32>,
        limits: &MotionLimits,
    ) -> Step {
        let mut angles = [0.0; MAX_JOINTS];
        let mut now: Velocities = [0.0; MAX_CHAIN_JOINTS];
        for (index, own) in self.indices() {
            let Some(point) = points.get_mut(index) else { continue };
            *point = point.next();
            (angles[index], now[own]) = (point.position, point.velocity);
        }
        let posture = self.posture(&angles);
        let jacobian = self.jacobian(&posture);
        let twist = jacobian * nalgebra::SVector::<f32, MAX_CHAIN_JOINTS>::from(now);
        let desired = desired_twist(&posture, &twist, target, limits);
        let (next, limited) = self.joint_velocities(&jacobian, &desired, points);
        for (index, own) in self.indices() {
            let Some(point) = points.get_mut(index) else { continue };
            point.acceleration = (next[own] - now[own]) / TICK;
        }
        let way = target.translation.vector - posture.tip().translation.vector;
        Step { velocity: twist.fixed_rows::<3>(0).into_owned(), remaining: math::norm(&way), limited }
    }

    /// Sets the references to the measured angles, at rest: the servos brake as hard as they can and stop
    /// pressing.
    pub fn stop(&self, positions: &[f32; MAX_JOINTS], points: &mut [JointPoint; MAX_JOINTS]) {
        for (index, _) in self.indices() {
            if let (Some(point), Some(&position)) = (points.get_mut(index), positions.get(index)) {
                *point = JointPoint { position, velocity: 0.0, acceleration: 0.0 };
            }
        }
    }

    /// Deviation of the gripper's axis from the z axis of the hand: sine of the angle, and distance from the
    /// origin [m]; 0 if the gripper is not part of the chain.
    pub fn gripper_axis(&self) -> [f32; 2] {
        let posture = self.config.chain.posture(&[]);
        let jacobian = posture.jacobian();
        let own = self.gripper.checked_sub(self.range.start).filter(|_| self.range.contains(&self.gripper));
        let Some(column) = own.and_then(|own| jacobian.column_iter().nth(own)) else { return [0.0; 2] };
        let axis: Vector3<f32> = column.fixed_rows::<3>(3).into_owned();
        let approach = posture.tip().rotation * Vector3::z();
        let offset: Vector3<f32> = column.fixed_rows::<3>(0).into_owned();
        [axis.cross(&approach), offset].map(|error| math::norm(&error))
    }

    /// Computes joint velocities for a `twist` of the hand by the damped inverse of the Jacobian, within the
    /// limits of speed, acceleration and angle. The other joints compensate for a joint that its angle limit
    /// holds back.
    fn joint_velocities(
        &self,
        jacobian: &Jacobian,
        twist: &Vector6<f32>,
        points: &[JointPoint; MAX_JOINTS],
    ) -> (Velocities, bool) {
        let mut free = *jacobian;
        let mut rest = *twist;
        let mut result: Velocities = [0.0; MAX_CHAIN_JOINTS];
        let mut held = [false; MAX_CHAIN_JOINTS];
        let mut limited = false;
        // Each iteration may add a held joint.
        for _ in 0..3 {
            let damped = free * free.transpose() + Matrix6::from_diagonal_element(DAMPING * DAMPING);
            let desired = free.transpose() * Ldlt::new(&damped, 1e-9).solve(&rest);
            // If one joint is too fast, all are slowed down, so that the hand moves straight.
            let mut share = 1.0_f32;
            for (_, own) in self.indices() {
                if let Some(joint) = self.joints.get(own) {
                    let limit = joint.limits.planned_speed();
                    if abs(desired[own]) > limit {
                        share = share.min(limit / abs(desired[own]));
                    }
                }
            }
            let mut holds = false;
            for (index, own) in self.indices() {
                let (Some(joint), Some(point)) = (self.joints.get(own), points.get(index)) else { continue };
                if held[own] {
                    continue;
                }
                let velocity = desired[own] * share;
                let [min, max] = reachable(joint, point);
                result[own] = math::clamp(velocity, min, max);
                if abs(result[own] - velocity) > 1e-4 && is_near_stop(joint, point, velocity) {
                    (held[own], holds, limited) = (true, true, true);
                    rest.axpy(-result[own], &jacobian.column(own), 1.0);
                    free.column_mut(own).fill(0.0);
                }
            }
            if !holds {
                break;
            }
        }
        (result, limited)
    }
}

/// The desired twist of the hand at the end of the period.
fn desired_twist(
    posture: &Posture,
    twist: &Vector6<f32>,
    target: &Isometry3<f32>,
    limits: &MotionLimits,
) -> Vector6<f32> {
    let tip = posture.tip();
    let velocity: Vector3<f32> = twist.fixed_rows::<3>(0).into_owned();
    let motion = MotionTarget {
        offset: target.translation.vector - tip.translation.vector,
        velocity: Vector3::zeros(),
        acceleration: Vector3::zeros(),
    };
    // A speed limit below the present speed is reached by braking.
    let speed = math::norm(&velocity) - limits.acceleration * TICK;
    let limits = MotionLimits { speed: limits.speed.max(speed), ..*limits };
    let linear = velocity + limits.acceleration(&velocity, &motion) * TICK;
    let error = target.rotation.to_rotation_matrix().matrix() * tip.rotation.matrix().transpose();
    math::stack([linear, math::rotation_vector(&error) * TURNING])
}

/// Minimum and maximum velocity of a joint at the end of the period [rad/s].
fn reachable(joint: &JointConfig, point: &JointPoint) -> [f32; 2] {
    let acceleration = JOINT_ACCELERATION * joint.limits.velocity;
    let change = acceleration * TICK;
    let [down, up] = stopping_speeds(joint, point, acceleration);
    [(point.velocity - change).max(-down), (point.velocity + change).min(up)]
}

/// Speeds downwards and upwards at the end of the period from which the joint stops within its limits.
fn stopping_speeds(joint: &JointConfig, point: &JointPoint, acceleration: f32) -> [f32; 2] {
    let JointLimits { lower, upper, .. } = joint.limits;
    point.stopping_speeds([lower + STOP_MARGIN, upper - STOP_MARGIN], acceleration)
}

/// Whether the angle limit prevents `velocity` of a joint [rad/s].
fn is_near_stop(joint: &JointConfig, point: &JointPoint, velocity: f32) -> bool {
    let [down, up] = stopping_speeds(joint, point, JOINT_ACCELERATION * joint.limits.velocity);
    velocity < -down || velocity > up
}

/// The pose of a posture's tip.
pub fn pose(posture: &Posture) -> Isometry3<f32> {
    let tip = posture.tip();
    Isometry3::from_parts(tip.translation, UnitQuaternion::from_rotation_matrix(&tip.rotation))
}

/// Angles of the references [rad].
pub fn angles(references: &[JointPoint; MAX_JOINTS]) -> [f32; MAX_JOINTS] {
    from_fn(|joint| references[joint].position)
}
