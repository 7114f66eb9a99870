//! Fingers that hold an object: its pose, their forces, and what the joints are to do for both.

use nalgebra::Vector3;

use super::forces::{Forces, Grasped, grasp_map};
use super::plan::{GraspPlan, ObjectControl};
use super::pose::PosePoint;
use super::state::{Fingers, pairs};
use super::tracker::TipMotion;
use super::wrench::wrench;
use super::{Failure, FingerSense, GraspFault, GraspState, Hand, HandOutput, PerFinger, Phase};
use crate::control::JointPoint;
use crate::grasp::{ThreeFingers, normal_force_limit};
use crate::robot::Actuation;

/// Share of the joints' torques that forces on the object may take. The rest is for weight, friction and motion.
const TORQUE_SHARE: f32 = 0.9;

impl GraspState {
    /// Everything with an object in the hand, and letting go of it.
    pub(super) fn hold(
        &mut self,
        hand: &Hand<'_>,
        plan: &GraspPlan,
        senses: &PerFinger<FingerSense<'_>>,
        fingers: &Fingers<'_>,
    ) -> Result<HandOutput, GraspFault> {
        // Of each finger the Jacobian, and its contact from the tip.
        let mut blocks = fingers.postures.map(|posture| (posture.jacobian(), Vector3::zeros()));
        let turns = pairs(&blocks, senses);
        let mut tips = fingers.tips.map(|place| TipMotion { place, rotation: Vector3::zeros() });
        for (tip, (((jacobian, _), sense), before)) in tips.iter_mut().zip(turns.iter().zip(&self.angles)) {
            let change = Vector3::from(sense.angles) - Vector3::from(*before);
            tip.rotation = jacobian.fixed_view::<3, 3>(3, 0) * change;
        }
        let object = self.tracker.update(&tips, &fingers.radii).map_err(|_| GraspFault::NoFrame)?;
        let (arms, normals) = self.tracker.contacts(&object, &fingers.radii);
        for ((_, arm), (normal, radius)) in blocks.iter_mut().zip(normals.iter().zip(fingers.radii)) {
            *arm = normal * radius;
        }
        let three = ThreeFingers::new(&blocks);
        let torque_limits = hand.fingers.map(|finger| finger.torque_limits.map(|limit| limit * TORQUE_SHARE));
        let limits = limits(plan, &three, &normals, &torque_limits);
        let map = grasp_map(object.translation.vector, &arms, &normals, self.forces.friction, &limits)
            .ok_or(GraspFault::NoFrame)?;
        let shifts = self.tracker.shifts;
        let grasped = Grasped {
            map: &map,
            measured: &fingers.forces,
            shifts: &shifts,
            internal: plan.internal,
            // A finger that slides would make the correction run away.
            feedback: plan.feedback && self.phase != Phase::ProbeFriction,
            held: matches!(self.phase, Phase::Hold | Phase::Move | Phase::Lower),
            lifted: self.is_lifted(hand),
            firmly: !(self.phase == Phase::Hold && self.motion.is_done()),
            three: &three,
            torque_limits,
        };
        self.forces.feel(&grasped);
        self.watch(plan, &grasped, fingers, &object)?;
        let inverse = map.inverse();
        let extra = self.proceed(hand, plan, &grasped, &inverse, fingers);
        let (mut forces, carried) = self.forces.want(&grasped, &inverse, self.share, &extra);
        if self.phase == Phase::Open {
            forces.iter_mut().for_each(|force| *force *= self.share);
        }
        let wanted = self.motion.advance();
        let actuation = match &plan.control {
            // The joints' servos hold the object where it should be, and so carry its load; what the sensors feel of it
            // helps them to be quick.
            ObjectControl::Differential(_) => {
                let share = Forces::fed_forward(&grasped);
                forces.iter_mut().zip(&carried).for_each(|(force, carried)| *force += carried * share);
                Actuation::Servo
            }
            ObjectControl::Wrench(gains) => {
                let pull = wrench(gains, &mut self.integral, &object, &wanted.frame);
                if let Ok(carry) = inverse.forces(&(self.forces.weight() + pull)) {
                    forces.iter_mut().zip(&carry).for_each(|(force, carry)| *force += carry);
                }
                Actuation::Torque { damping: gains.damping, compensated: gains.compensated }
            }
        };
        let mut command =
            HandOutput { torques: three.torques(&forces).map(Into::into), actuation, ..self.stand() };
        if let Err(finger) = self.follow(hand, &three, &arms, &wanted, &mut command) {
            // It cannot go on; what it holds it keeps holding.
            self.motion.stop();
            self.fail(Failure::OutOfReach { finger }, Phase::Hold);
        }
        Ok(command)
    }

    /// The joints' way with the object, Hand3 (22) to (25) with positions in closed form: nothing drifts.
    ///
    /// # Errors
    /// The finger that cannot follow.
    fn follow(
        &mut self,
        hand: &Hand<'_>,
        three: &ThreeFingers,
        arms: &PerFinger<Vector3<f32>>,
        wanted: &PosePoint,
        command: &mut HandOutput,
    ) -> Result<(), u8> {
        let (mut velocities, mut accelerations) = ([Vector3::zeros(); 3], [Vector3::zeros(); 3]);
        if !self.motion.is_done() {
            velocities = three.joint_velocities(arms, &wanted.twist).map_err(|error| error.finger)?;
            accelerations = three.joint_velocities(arms, &wanted.acceleration).map_err(|error| error.finger)?;
        }
        // Where the tips are in the object, so that their places to each other are left to the forces; while they rub or
        // let go, where they were.
        let shape = match self.phase {
            Phase::ProbeFriction | Phase::Open => &self.tracker.anchors,
            _ => &self.tracker.places,
        };
        let ways = hand.fingers.iter().zip(shape).zip(&mut self.reference).zip(&mut command.points);
        for (index, ((((finger, place), reference), points), (velocities, accelerations))) in
            (0..).zip(ways.zip(velocities.iter().zip(&accelerations)))
        {
            let place = wanted.frame.transform_point(&(*place).into()).coords;
            *reference = finger.inverse.nearest(&place, reference).map_err(|_| index)?;
            let motion = velocities.iter().zip(accelerations);
            for (point, (&position, (&velocity, &acceleration))) in
                points.iter_mut().zip(reference.iter().zip(motion))
            {
                *point = JointPoint { position, velocity, acceleration };
            }
        }
        Ok(())
    }
}

/// The largest normal forces that force limit and joint torques allow [N]; along the normal: what forces across it take
/// besides is seen when they are known.
fn limits(
    plan: &GraspPlan,
    three: &ThreeFingers,
    normals: &PerFinger<Vector3<f32>>,
    torque_limits: &PerFinger<[f32; 3]>,
) -> PerFinger<f32> {
    let zero = Vector3::zeros();
    let mut limits = [plan.force_limit; 3];
    let fingers = three.blocks().iter().zip(normals).zip(torque_limits);
    for (limit, ((block, normal), torques)) in limits.iter_mut().zip(fingers) {
        match normal_force_limit(block, normal, 0.0, &zero, &Vector3::from(*torques)) {
            Ok(push) if push < *limit => *limit = push,
            _ => {}
        }
    }
    limits
}
