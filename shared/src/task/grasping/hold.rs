//! Holding an object: its pose, the contact forces, and the joints' set-points and torques.

use nalgebra::{IsometryMatrix3, Vector3, Vector6};

use super::forces::{ForceInputs, GripForces, grasp_map, least_forces, superposition_scale};
use super::plan::{GraspPlan, JointTargets, LoadSource, ObjectControl, ObjectFrame};
use super::pose::PoseTrajectoryPoint;
use super::state::Fingers;
use super::tracker::TipMotion;
use super::tuning::{GAIN_FRICTION, LIFT_HEIGHT, LOAD_FEEDFORWARD, TORQUE_FRACTION};
use super::wrench::{integrate, wrench};
use super::{Failure, FingerSense, GraspFault, GraspHand, GraspState, HandOutput, PerFinger, Phase};
use crate::control::JointPoint;
use crate::grasp::{GraspMap, ThreeFingers, WrenchInverse, normal_force_limit};
use crate::kinematics::Jacobian;
use crate::math;
use crate::robot::Actuation;
use crate::zip::zip;

/// Jacobian of a fingertip, and the lever of its contact from the tip's centre [m].
type FingerContact = (Jacobian, Vector3<f32>);

impl GraspState {
    /// Runs all phases with an object in the hand, and its release.
    pub(super) fn hold(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        senses: &PerFinger<FingerSense<'_>>,
        fingers: &Fingers<'_>,
    ) -> Result<HandOutput, GraspFault> {
        let mut contacts: PerFinger<FingerContact> =
            fingers.postures.map(|posture| (posture.jacobian(), Vector3::zeros()));
        let object = self.track_object(plan, &contacts, senses, fingers)?;
        let (levers, normals) = self.tracker.contacts(&object, &fingers.radii);
        for ((_, lever), normal, radius) in zip((&mut contacts, &normals, fingers.radii)) {
            *lever = normal * radius;
        }
        let three = ThreeFingers::new(&contacts);
        let torque_limits =
            hand.fingers.map(|finger| finger.torque_limits.map(|limit| limit * TORQUE_FRACTION));
        let limits = normal_force_limits(plan, &three, &normals, &torque_limits);
        let map = grasp_map(object.translation.vector, &levers, &normals, self.forces.friction, &limits)
            .ok_or(GraspFault::NoFrame)?;
        let inputs = self.force_inputs(hand, plan, fingers, &map, &three, torque_limits);
        self.forces.update_estimates(&inputs);
        self.check_object(plan, &inputs, fingers, &object)?;
        let learns = plan.feedback && matches!(plan.control, ObjectControl::Differential(_));
        if learns {
            self.learn_gains(hand, &three, senses, &fingers.forces);
        }
        let inverse = map.inverse();
        let superposed = self.advance_phase(hand, plan, &inputs, &inverse, fingers);
        let grip = self.forces.solve_grip(&inputs, &inverse, self.grip_fraction, &superposed);
        let previous = match plan.joint_targets {
            JointTargets::ClosedForm => None,
            JointTargets::Accumulated => Some(self.trajectory.point().frame),
        };
        let reached = self.trajectory;
        let yields = self.yield_to_support(hand, plan, &inputs);
        let target = self.trajectory.advance();
        let (forces, actuation) = self.control_object(plan, &inputs, &inverse, grip, &object, &target.frame);
        let torques = three.torques(&forces);
        let torques = if learns { self.torque_gains.commands(&torques) } else { torques.map(Into::into) };
        let mut output = HandOutput { torques, actuation, ..self.stand() };
        let step = previous.map(|previous| math::stack(math::displacement(&previous, &target.frame)));
        if let Err(finger) = self.follow(hand, &three, &levers, &target, step.as_ref(), &mut output) {
            // The motion ends at its last point; the grip stays, unless there was none yet.
            self.trajectory = reached;
            self.trajectory.stop();
            let failure = Failure::OutOfReach { finger };
            match self.phase {
                _ if yields => {}
                Phase::Open => self.failure = Some(failure),
                Phase::Squeeze | Phase::ProbeFriction => self.fail(failure, Phase::Open),
                _ => self.fail(failure, Phase::Hold),
            }
        }
        Ok(output)
    }

    /// Estimates the object's pose from the motion of the fingertips since the last tick.
    fn track_object(
        &mut self,
        plan: &GraspPlan,
        contacts: &PerFinger<FingerContact>,
        senses: &PerFinger<FingerSense<'_>>,
        fingers: &Fingers<'_>,
    ) -> Result<IsometryMatrix3<f32>, GraspFault> {
        let mut tips = fingers.tips.map(|center| TipMotion { center, rotation: Vector3::zeros() });
        for (tip, (jacobian, _), sense, previous) in zip((&mut tips, contacts, senses, &self.angles)) {
            let change = Vector3::from(sense.angles) - Vector3::from(*previous);
            tip.rotation = jacobian.fixed_view::<3, 3>(3, 0) * change;
        }
        let radii = match plan.object_frame {
            ObjectFrame::Rolling => fingers.radii,
            // Points do not roll.
            ObjectFrame::Triangle => [0.0; 3],
        };
        self.tracker.update(&tips, &radii).map_err(|_| GraspFault::NoFrame)
    }

    fn force_inputs<'a>(
        &self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        fingers: &'a Fingers<'_>,
        map: &'a GraspMap,
        three: &'a ThreeFingers,
        torque_limits: PerFinger<[f32; 3]>,
    ) -> ForceInputs<'a> {
        let is_held = matches!(self.phase, Phase::Hold | Phase::Move | Phase::Lower);
        let at_rest = self.phase == Phase::Hold && self.trajectory.is_done();
        let height = self.height(hand);
        ForceInputs {
            map,
            measured: &fingers.forces,
            anchor_errors: self.tracker.anchor_errors,
            internal: plan.internal,
            // A sliding finger would cause integrator wind-up, and the opening hand is to press less.
            feedback: plan.feedback && !matches!(self.phase, Phase::ProbeFriction | Phase::Open),
            is_held,
            known_load: match plan.load {
                LoadSource::Constant { mass } => {
                    let mass = if is_held { mass } else { 0.0 };
                    Some(math::stack([-hand.gravity * mass, Vector3::zeros()]))
                }
                LoadSource::Measured => None,
            },
            is_lifted: height > LIFT_HEIGHT,
            load_feedforward: LOAD_FEEDFORWARD * math::clamp(height / LIFT_HEIGHT - 1.0, 0.0, 1.0),
            in_motion: !(at_rest || self.phase == Phase::Open),
            three,
            torque_limits,
        }
    }

    /// Learns the torque gains of the joints, if their efforts are known.
    fn learn_gains(
        &mut self,
        hand: &GraspHand<'_>,
        three: &ThreeFingers,
        senses: &PerFinger<FingerSense<'_>>,
        measured: &PerFinger<Vector3<f32>>,
    ) {
        if let [Some(one), Some(two), Some(third)] = senses.each_ref().map(|sense| sense.efforts) {
            let friction = hand.fingers.map(|finger| finger.friction.map(|torque| GAIN_FRICTION * torque));
            self.torque_gains.learn(&three.torques(measured), &[one, two, third], &friction);
        }
    }

    /// Contact forces for the grip and for the object's motion [N], and the actuation that produces them.
    fn control_object(
        &mut self,
        plan: &GraspPlan,
        inputs: &ForceInputs<'_>,
        inverse: &WrenchInverse<'_>,
        grip: GripForces,
        object: &IsometryMatrix3<f32>,
        target: &IsometryMatrix3<f32>,
    ) -> (PerFinger<Vector3<f32>>, Actuation) {
        let mut forces = grip.internal;
        let actuation = match &plan.control {
            // The joint servos control the pose and thereby carry the load; feed-forward of the measured load
            // speeds them up.
            ObjectControl::Differential(_) => {
                let fraction = inputs.load_feedforward;
                forces.iter_mut().zip(&grip.load).for_each(|(force, load)| *force += load * fraction);
                Actuation::Servo
            }
            ObjectControl::Wrench(gains) => {
                let weight = inputs.known_load.unwrap_or_else(|| self.forces.weight.into());
                let load = least_forces(inverse, &weight);
                let (control, integral) = wrench(gains, &self.integral, object, target);
                let control = least_forces(inverse, &control);
                let scale = superposition_scale(inputs.map.contacts(), &grip.internal, &load, &control);
                integrate(&mut self.integral, &integral, scale < 1.0);
                for (force, load, control, contact) in
                    zip((&mut forces, &load, &control, inputs.map.contacts()))
                {
                    *force = contact.limited(&(*force + load + control * scale));
                }
                Actuation::Torque { damping: gains.damping, compensated: gains.compensated }
            }
        };
        (forces, actuation)
    }

    /// Set-points of joints that follow the object (Hand3 eq. 22 to 25). Their angles are the sum of the
    /// changes for each `step` of the object [m, rad], or, without drift, the closed-form inverse kinematics.
    ///
    /// # Errors
    /// The finger that cannot follow.
    fn follow(
        &mut self,
        hand: &GraspHand<'_>,
        three: &ThreeFingers,
        levers: &PerFinger<Vector3<f32>>,
        target: &PoseTrajectoryPoint,
        step: Option<&Vector6<f32>>,
        output: &mut HandOutput,
    ) -> Result<(), u8> {
        let (mut velocities, mut accelerations) = ([Vector3::zeros(); 3], [Vector3::zeros(); 3]);
        if !self.trajectory.is_done() {
            velocities = three.joint_velocities(levers, &target.twist).map_err(|error| error.finger)?;
            accelerations =
                three.joint_velocities(levers, &target.acceleration).map_err(|error| error.finger)?;
        }
        let mut changes = None;
        if let Some(step) = step {
            changes = Some(three.joint_velocities(levers, step).map_err(|error| error.finger)?);
        }
        // With the measured centres in the object frame, force control determines the distances between the
        // fingertips. While probing and opening, the anchors fix these distances.
        let centers = match self.phase {
            Phase::ProbeFriction | Phase::Open => &self.tracker.anchors,
            _ => &self.tracker.centers,
        };
        // Stored only if all fingers reach their set-points.
        let mut angles = self.reference;
        for (index, finger, center, angles) in zip((0.., &hand.fingers, centers, &mut angles)) {
            let change = changes.as_ref().and_then(|changes| changes.get(usize::from(index)));
            *angles = if let Some(change) = change {
                let angles = (Vector3::from(*angles) + change).into();
                finger.inverse.is_within_limits(&angles).then_some(angles)
            } else {
                let center = target.frame.transform_point(&(*center).into()).coords;
                finger.target(&center, angles)
            }
            .ok_or(index)?;
        }
        self.reference = angles;
        for (points, angles, velocities, accelerations) in
            zip((&mut output.points, &angles, &velocities, &accelerations))
        {
            for (point, &position, &velocity, &acceleration) in
                zip((points, angles, velocities, accelerations))
            {
                *point = JointPoint { position, velocity, acceleration };
            }
        }
        Ok(())
    }
}

/// Maximum normal forces from the force limit and the joint torques [N]. They assume forces along the
/// normals; the grip checks tangential forces once they are known.
fn normal_force_limits(
    plan: &GraspPlan,
    three: &ThreeFingers,
    normals: &PerFinger<Vector3<f32>>,
    torque_limits: &PerFinger<[f32; 3]>,
) -> PerFinger<f32> {
    let zero = Vector3::zeros();
    let mut limits = [plan.force_limit; 3];
    for (limit, block, normal, torques) in zip((&mut limits, three.blocks(), normals, torque_limits)) {
        match normal_force_limit(block, normal, 0.0, &zero, &Vector3::from(*torques)) {
            Ok(max) if max < *limit => *limit = max,
            _ => {}
        }
    }
    limits
}
