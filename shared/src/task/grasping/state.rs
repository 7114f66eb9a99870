use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::approach::TipPath;
use super::forces::Forces;
use super::gains::TorqueGains;
use super::phases::weight_on_fingers;
use super::plan::JointTargets;
use super::pose::PoseTrajectory;
use super::tracker::Tracker;
use super::tuning::{
    APPROACH_EXTRA_TIME, APPROACH_SPEED, ASSUMED_FRICTION, MAX_ANGULAR_SPEED, MAX_MOVE_TIME, MAX_SPEED,
    PATH_CHECKS, TICKS_TO_DITHER, TICKS_TO_DITHER_END,
};
use super::{
    Failure, FingerSense, Frame, GraspCommand, GraspFault, GraspFinger, GraspHand, GraspPlan, GraspRefusal,
    GraspTelemetry, HandOutput, PerFinger, Phase,
};
use crate::TICK;
use crate::control::JointPoint;
use crate::kinematics::{FingerError, Posture};
use crate::math;
use crate::robot::{Actuation, LimitRefusal};
use crate::signal::MINIMUM_JERK_PEAK;
use crate::zip::zip;

/// State of a grasp.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct GraspState {
    pub(super) phase: Phase,
    pub(super) failure: Option<Failure>,
    pub(super) plan: Option<GraspPlan>,
    /// Ticks in this phase.
    pub(super) ticks: u32,
    /// Step within the phase, from 0; in `Squeeze` the number of consecutive ticks with converged forces.
    pub(super) step: u8,
    /// Consecutive ticks in which a contact was missing.
    pub(super) ticks_without_contact: u8,
    /// Commanded joint angles [rad].
    pub(super) reference: PerFinger<[f32; 3]>,
    /// Measured joint angles of the last tick [rad].
    pub(super) angles: PerFinger<[f32; 3]>,
    /// Paths of the fingertips without an object.
    pub(super) tip_paths: PerFinger<TipPath>,
    /// Duration of these paths [s].
    pub(super) path_duration: f32,
    pub(super) tracker: Tracker,
    pub(super) forces: Forces,
    /// Pose of the object at the grasp.
    pub(super) origin: Frame,
    /// Target of the object's pose.
    pub(super) trajectory: PoseTrajectory,
    /// Integral part of the pose control [N, N·m].
    pub(super) integral: [f32; 6],
    pub(super) torque_gains: TorqueGains,
    /// Fraction of the internal forces that is applied.
    pub(super) grip_fraction: f32,
    /// Force with which fingers 1 and 2 press towards each other to probe the friction [N].
    pub(super) probe_force: f32,
    /// Distance between fingertips 1 and 2 before probing [m].
    pub(super) initial_width: f32,
    /// Weight on the fingers before the object was lowered [N].
    pub(super) initial_weight: f32,
}

/// Measurements of the fingers in a tick.
pub(super) struct Fingers<'a> {
    pub postures: PerFinger<&'a Posture>,
    /// Centres of the fingertips [m].
    pub tips: PerFinger<Vector3<f32>>,
    /// Forces of the fingertips on the object [N].
    pub forces: PerFinger<Vector3<f32>>,
    /// Radii of the fingertips [m].
    pub radii: PerFinger<f32>,
}

impl<'a> Fingers<'a> {
    fn new(hand: &GraspHand<'_>, senses: &PerFinger<FingerSense<'a>>) -> Self {
        let postures = senses.map(|sense| sense.posture);
        Self {
            tips: postures.map(|posture| posture.tip().translation.vector),
            postures,
            forces: senses.each_ref().map(|sense| sense.force.into()),
            radii: hand.fingers.map(|finger| finger.radius),
        }
    }

    /// Distance between fingertips 1 and 2 [m].
    pub fn width(&self) -> f32 {
        let [one, two, _] = self.tips;
        math::norm(&(two - one))
    }
}

impl GraspState {
    /// No object, and no motion.
    pub const NONE: Self = Self {
        phase: Phase::Ready,
        failure: None,
        plan: None,
        ticks: 0,
        step: 0,
        ticks_without_contact: 0,
        reference: [[0.0; 3]; 3],
        angles: [[0.0; 3]; 3],
        tip_paths: [TipPath::NONE; 3],
        path_duration: 0.0,
        tracker: Tracker::NONE,
        forces: Forces::NONE,
        origin: Frame::BASE,
        trajectory: PoseTrajectory::resting(Frame::BASE),
        integral: [0.0; 6],
        torque_gains: TorqueGains::NOMINAL,
        grip_fraction: 0.0,
        probe_force: 0.0,
        initial_width: 0.0,
        initial_weight: 0.0,
    };

    /// The state of fingers at rest at these angles [rad].
    pub const fn at(angles: PerFinger<[f32; 3]>) -> Self {
        let mut state = Self::NONE;
        state.stand_at(angles);
        state
    }

    /// Sets the fingers at rest at these angles [rad].
    pub(super) const fn stand_at(&mut self, angles: PerFinger<[f32; 3]>) {
        (self.reference, self.angles) = (angles, angles);
    }

    /// The present phase.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the joint servos restart in this tick: before open-loop internal forces rise, and when the
    /// grasp begins anew. Their disturbance observers have mistaken the touch force, or the object's motion
    /// under dry friction, for a disturbance, and would keep compensating it.
    pub fn restarts_servos(&self) -> bool {
        self.plan.is_some_and(|plan| {
            let begins = self.phase == Phase::Squeeze && self.ticks == 0;
            begins && plan.only_feeds_forward() || self.begins_anew(&plan)
        })
    }

    /// Whether the grasp restarts in this tick from the present pose of the object: when open-loop internal
    /// forces have risen, and when their dither has ended. Accumulated joint targets do not restart.
    pub(super) fn begins_anew(&self, plan: &GraspPlan) -> bool {
        self.phase == Phase::Squeeze
            && matches!(self.ticks, TICKS_TO_DITHER | TICKS_TO_DITHER_END)
            && plan.only_feeds_forward()
            && plan.joint_targets == JointTargets::ClosedForm
    }

    /// The state as a supervisor sees it.
    pub fn telemetry(&self) -> GraspTelemetry {
        let object = self.tracker.object.isometry();
        let quaternion = nalgebra::UnitQuaternion::from_rotation_matrix(&object.rotation);
        GraspTelemetry {
            phase: self.phase,
            failure: self.failure,
            position: object.translation.vector.into(),
            orientation: quaternion.coords.into(),
            load: self.forces.load,
            target_forces: self.forces.target,
            friction: self.forces.friction,
            slips: self.forces.slips,
            overloaded: self.forces.overloaded,
        }
    }

    /// Starts a command. `speeds`: the largest planned ones of the joints [rad/s].
    ///
    /// # Errors
    /// Why it is refused; the state is unchanged.
    pub fn command(
        &mut self,
        hand: &GraspHand<'_>,
        speeds: &PerFinger<[f32; 3]>,
        command: &GraspCommand,
    ) -> Result<(), GraspRefusal> {
        match command {
            GraspCommand::Grasp(plan) => self.begin(hand, speeds, plan),
            GraspCommand::Move { translation, rotation, duration } => {
                self.begin_move(hand, translation, rotation, *duration)
            }
            GraspCommand::PutDown => {
                self.require(&[Phase::Hold])?;
                let weight = weight_on_fingers(hand, &self.forces.earlier_load);
                (self.initial_weight, self.failure) = (weight, None);
                self.enter(Phase::Lower);
                Ok(())
            }
            GraspCommand::Open => {
                if self.phase == Phase::Ready {
                    return Err(GraspRefusal::Busy(self.phase));
                }
                self.failure = None;
                if self.phase != Phase::Open {
                    self.trajectory.stop();
                    self.enter(Phase::Open);
                }
                Ok(())
            }
        }
    }

    fn require(&self, phases: &[Phase]) -> Result<(), GraspRefusal> {
        if !phases.contains(&self.phase) {
            return Err(GraspRefusal::Busy(self.phase));
        }
        Ok(())
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        (self.phase, self.ticks, self.step) = (phase, 0, 0);
    }

    pub(super) fn fail(&mut self, failure: Failure, next: Phase) {
        self.failure = Some(failure);
        self.enter(next);
    }

    fn begin(
        &mut self,
        hand: &GraspHand<'_>,
        speeds: &PerFinger<[f32; 3]>,
        plan: &GraspPlan,
    ) -> Result<(), GraspRefusal> {
        if self.phase != Phase::Ready {
            return Err(GraspRefusal::Busy(self.phase));
        }
        plan.validate().map_err(GraspRefusal::Plan)?;
        let mut plan = *plan;
        let mut tip_paths = self.tip_paths;
        let mut max_length = 0.0_f32;
        for (index, finger, contact, path, reference) in
            zip((0.., &hand.fingers, &mut plan.contacts, &mut tip_paths, &self.reference))
        {
            let normal = Vector3::from(contact.normal);
            let normal = normal / math::norm(&normal);
            contact.normal = normal.into();
            let at_contact = Vector3::from(contact.position) - normal * finger.radius;
            let before = at_contact - normal * plan.clearance;
            // Both ends of the search for the surface.
            for position in [before, at_contact + normal * plan.clearance] {
                reach(index, finger, &position, reference)?;
            }
            let start = finger.chain.posture(reference).tip().translation.vector;
            let length = math::norm(&(before - start));
            max_length = if length > max_length { length } else { max_length };
            *path = TipPath::between(start, before);
        }
        let path_duration = max_length * (MINIMUM_JERK_PEAK / APPROACH_SPEED) + APPROACH_EXTRA_TIME;
        check_paths(hand, speeds, &tip_paths, path_duration, &self.reference)?;
        self.failure = None;
        self.plan = Some(plan);
        (self.tip_paths, self.path_duration) = (tip_paths, path_duration);
        self.tracker = Tracker::NONE;
        self.forces = Forces::new(plan.friction.unwrap_or(ASSUMED_FRICTION));
        (self.integral, self.grip_fraction, self.probe_force) = ([0.0; 6], 0.0, 0.0);
        self.torque_gains = TorqueGains::NOMINAL;
        self.ticks_without_contact = 0;
        self.enter(Phase::Approach);
        Ok(())
    }

    fn begin_move(
        &mut self,
        hand: &GraspHand<'_>,
        translation: &[f32; 3],
        rotation: &[f32; 3],
        duration: f32,
    ) -> Result<(), GraspRefusal> {
        self.require(&[Phase::Hold])?;
        let (translation, rotation) = (Vector3::from(*translation), Vector3::from(*rotation));
        if !(translation.sum() + rotation.sum() + duration).is_finite()
            || !(TICK..=MAX_MOVE_TIME).contains(&duration)
        {
            return Err(GraspRefusal::NotFinite);
        }
        let origin = self.origin.isometry();
        let target = IsometryMatrix3::from_parts(
            Translation3::from(origin.translation.vector + translation),
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&rotation) * origin.rotation.matrix()),
        );
        let start = self.trajectory.point().frame;
        let [distance, angle] = math::displacement(&start, &target).map(|vector| math::norm(&vector));
        for (value, limit) in [(distance, MAX_SPEED), (angle, MAX_ANGULAR_SPEED)] {
            let value = MINIMUM_JERK_PEAK * value / duration;
            if value.is_nan() || value > limit {
                return Err(GraspRefusal::TooFast { value, limit });
            }
        }
        for (index, finger, anchor, reference) in
            zip((0.., &hand.fingers, &self.tracker.anchors, &self.reference))
        {
            let position = target.transform_point(&(*anchor).into()).coords;
            reach(index, finger, &position, reference)?;
        }
        self.trajectory = PoseTrajectory::between(&start, &target, duration);
        self.failure = None;
        self.enter(Phase::Move);
        Ok(())
    }

    /// Time in the phase [s].
    pub(super) const fn elapsed(&self) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
        let ticks = self.ticks as f32;
        ticks * TICK
    }

    /// Runs one control period.
    ///
    /// # Errors
    /// The object is lost.
    pub fn tick(
        &mut self,
        hand: &GraspHand<'_>,
        senses: &PerFinger<FingerSense<'_>>,
    ) -> Result<HandOutput, GraspFault> {
        self.ticks = self.ticks.saturating_add(1);
        let fingers = Fingers::new(hand, senses);
        let output = match (self.phase, self.plan) {
            (Phase::Approach, Some(plan)) => self.approach(hand, &plan, &fingers),
            (Phase::Touch, Some(plan)) => self.touch(hand, &plan, &fingers)?,
            (Phase::Ready, _) | (_, None) => self.stand(),
            (Phase::Open, Some(plan)) if self.grip_fraction <= 0.0 => self.open(hand, &plan, &fingers),
            (_, Some(plan)) => self.hold(hand, &plan, senses, &fingers)?,
        };
        self.angles = senses.each_ref().map(|sense| sense.angles);
        Ok(output)
    }

    /// Output for fingers at rest at their references.
    pub(super) fn stand(&self) -> HandOutput {
        let at_rest = |position| JointPoint { position, velocity: 0.0, acceleration: 0.0 };
        HandOutput {
            points: self.reference.map(|angles| angles.map(at_rest)),
            torques: [[0.0; 3]; 3],
            actuation: Actuation::Servo,
        }
    }
}

/// Checks the paths of the fingertips, which take `duration` [s]: each of [`PATH_CHECKS`] points can be
/// reached, and no joint moves faster between them than at its largest planned speed [rad/s]. `reference`:
/// the joint angles at their start [rad].
fn check_paths(
    hand: &GraspHand<'_>,
    speeds: &PerFinger<[f32; 3]>,
    paths: &PerFinger<TipPath>,
    duration: f32,
    reference: &PerFinger<[f32; 3]>,
) -> Result<(), GraspRefusal> {
    let interval = duration / f32::from(PATH_CHECKS);
    for (finger, speeds, (index, path, angles)) in
        zip((&hand.fingers, speeds, zip((0_u8.., paths, reference))))
    {
        let (mut last, mut from) = (*angles, Vector3::from(path.start));
        let first_axis = finger.chain.posture(angles).first_axis();
        for check in 1..=PATH_CHECKS {
            let [to, ..] = path.setpoint(f32::from(check) * interval, duration);
            let angles = reach(index, finger, &to, &last)?;
            let mut turned = [0.0; 3];
            for (turned, angle, last) in zip((&mut turned, &angles, &last)) {
                *turned = math::abs(angle - last);
            }
            // The first joint's angle may rise and fall between the points, close to its axis.
            if let Some((axis, origin)) = first_axis {
                turned[0] = largest_turn(&(from - origin), &(to - from), &axis).max(turned[0]);
            }
            for (joint, turned, &limit) in zip((3 * index.., turned, speeds)) {
                let value = turned / interval;
                if value > limit {
                    return Err(GraspRefusal::Limit(LimitRefusal::TooFast { joint, value, limit }));
                }
            }
            (last, from) = (angles, to);
        }
    }
    Ok(())
}

/// Angle by which a point at `from` turns about an axis through the origin on its way by `step` [m], if it
/// went as fast all the way as where it is closest to the axis [rad].
fn largest_turn(from: &Vector3<f32>, step: &Vector3<f32>, axis: &Vector3<f32>) -> f32 {
    let across = |v: &Vector3<f32>| v - axis * axis.dot(v);
    let (from, step) = (across(from), across(step));
    let length = step.norm_squared();
    let nearest = if length > 0.0 { (-from.dot(&step) / length).clamp(0.0, 1.0) } else { 0.0 };
    let distance = (from + step * nearest).norm_squared();
    let turn = math::abs(axis.dot(&from.cross(&step))) / distance;
    // On a line through the axis both are zero.
    if turn.is_finite() { turn } else { 0.0 }
}

/// Returns the joint angles [rad] with which a fingertip is at `position` [m]. `reference`: angles nearby.
fn reach(
    index: u8,
    finger: &GraspFinger<'_>,
    position: &Vector3<f32>,
    reference: &[f32; 3],
) -> Result<[f32; 3], GraspRefusal> {
    finger.inverse.nearest(position, reference).map_err(|error| match error {
        FingerError::NotFinite => GraspRefusal::NotFinite,
        FingerError::OutOfReach { nearest } => {
            GraspRefusal::OutOfReach { finger: index, nearest: nearest.into() }
        }
        FingerError::OutsideLimits { joint, value, lower, upper } => {
            GraspRefusal::Limit(LimitRefusal::OutsideLimits { joint: 3 * index + joint, value, lower, upper })
        }
    })
}
