use nalgebra::{IsometryMatrix3, Rotation3, Translation3, Vector3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::approach::{APPROACH_SPEED, Line};
use super::forces::Forces;
use super::plan::ASSUMED_FRICTION;
use super::pose::PoseMotion;
use super::tracker::Tracker;
use super::{
    Failure, FingerSense, Frame, GraspCommand, GraspFault, GraspPlan, GraspRefusal, GraspTelemetry, Hand,
    HandOutput, PerFinger, Phase,
};
use crate::TICK;
use crate::control::JointPoint;
use crate::kinematics::{FingerError, Posture};
use crate::math;
use crate::robot::Actuation;

/// Fastest motion of an object that may be asked for [m/s, rad/s].
const MOST_SPEED: f32 = 0.2;
const MOST_TURN: f32 = 2.0;
/// Peak speed of a minimum-jerk motion over its mean.
pub(super) const PEAK: f32 = 1.875;

/// Everything that a hand remembers between two ticks.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub struct GraspState {
    pub(super) phase: Phase,
    pub(super) failure: Option<Failure>,
    pub(super) plan: Option<GraspPlan>,
    /// Ticks in this phase, and in a row with what ends it.
    pub(super) ticks: u32,
    pub(super) settled: u8,
    /// Ticks in a row without contact.
    pub(super) lost: u8,
    /// Commanded angles, and measured ones of the last tick [rad].
    pub(super) reference: PerFinger<[f32; 3]>,
    pub(super) angles: PerFinger<[f32; 3]>,
    /// The straight ways of the tips, and their time [s].
    pub(super) lines: PerFinger<Line>,
    pub(super) line_time: f32,
    pub(super) tracker: Tracker,
    pub(super) forces: Forces,
    /// Where the object was grasped, and its motion.
    pub(super) origin: Frame,
    pub(super) motion: PoseMotion,
    pub(super) integral: [f32; 6],
    /// Share of the internal forces.
    pub(super) share: f32,
    /// Force by which fingers 1 and 2 press towards each other [N], and their distance before [m].
    pub(super) rub: f32,
    pub(super) distance: f32,
    /// Weight on the fingers before the object was lowered [N].
    pub(super) weight: f32,
}

/// What a tick knows of the fingers.
pub(super) struct Fingers<'a> {
    pub postures: PerFinger<&'a Posture>,
    pub tips: PerFinger<Vector3<f32>>,
    pub forces: PerFinger<Vector3<f32>>,
    pub radii: PerFinger<f32>,
}

impl<'a> Fingers<'a> {
    fn new(hand: &Hand<'_>, senses: &PerFinger<FingerSense<'a>>) -> Self {
        let postures = senses.map(|sense| sense.posture);
        Self {
            tips: postures.map(|posture| posture.tip().translation.vector),
            postures,
            forces: senses.each_ref().map(|sense| sense.force.into()),
            radii: hand.fingers.map(|finger| finger.radius),
        }
    }

    /// Distance of the tips of fingers 1 and 2 [m].
    pub fn width(&self) -> f32 {
        let [one, two, _] = self.tips;
        math::sqrt((two - one).norm_squared())
    }
}

/// Of two lists the pairs.
pub(super) const fn pairs<'a, A, B>(
    first: &'a PerFinger<A>,
    second: &'a PerFinger<B>,
) -> PerFinger<(&'a A, &'a B)> {
    let ([a, b, c], [p, q, r]) = (first, second);
    [(a, p), (b, q), (c, r)]
}

impl GraspState {
    /// Nothing is held, and no finger moves.
    pub const NONE: Self = Self {
        phase: Phase::Ready,
        failure: None,
        plan: None,
        ticks: 0,
        settled: 0,
        lost: 0,
        reference: [[0.0; 3]; 3],
        angles: [[0.0; 3]; 3],
        lines: [Line::NONE; 3],
        line_time: 0.0,
        tracker: Tracker::NONE,
        forces: Forces::NONE,
        origin: Frame::BASE,
        motion: PoseMotion::resting(Frame::BASE),
        integral: [0.0; 6],
        share: 0.0,
        rub: 0.0,
        distance: 0.0,
        weight: 0.0,
    };

    /// Fingers that stand at these angles [rad].
    pub const fn at(angles: PerFinger<[f32; 3]>) -> Self {
        let mut state = Self::NONE;
        state.stand_at(angles);
        state
    }

    /// The fingers stand at these angles [rad].
    pub(super) const fn stand_at(&mut self, angles: PerFinger<[f32; 3]>) {
        (self.reference, self.angles) = (angles, angles);
    }

    /// What the hand does.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the joint servos begin anew now: when forces that are only fed forward begin to rise. They have learnt the
    /// touch as a disturbance, and would go on pressing with it.
    pub fn restarts_servos(&self) -> bool {
        self.phase == Phase::Squeeze
            && self.ticks == 0
            && self.plan.is_some_and(|plan| plan.only_feeds_forward())
    }

    /// What the supervisor sees.
    pub fn telemetry(&self) -> GraspTelemetry {
        let object = self.tracker.object.isometry();
        let quaternion = nalgebra::UnitQuaternion::from_rotation_matrix(&object.rotation);
        GraspTelemetry {
            phase: self.phase,
            failure: self.failure,
            position: object.translation.vector.into(),
            orientation: quaternion.coords.into(),
            load: self.forces.load,
            wanted: self.forces.wanted,
            friction: self.forces.friction,
            slips: self.forces.slips,
            overloaded: self.forces.overloaded,
        }
    }

    /// Begins to carry out a command.
    ///
    /// # Errors
    /// Why it cannot; nothing has changed.
    pub fn command(&mut self, hand: &Hand<'_>, command: &GraspCommand) -> Result<(), GraspRefusal> {
        match command {
            GraspCommand::Grasp(plan) => self.begin(hand, plan),
            GraspCommand::Move { translation, rotation, duration } => {
                self.begin_move(hand, translation, rotation, *duration)
            }
            GraspCommand::PutDown => {
                self.require(&[Phase::Hold])?;
                (self.weight, self.failure) = (self.weight_on(hand), None);
                self.enter(Phase::Lower);
                Ok(())
            }
            GraspCommand::Open => {
                if self.phase == Phase::Ready {
                    return Err(GraspRefusal::Busy(self.phase));
                }
                self.failure = None;
                if self.phase != Phase::Open {
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
        (self.phase, self.ticks, self.settled) = (phase, 0, 0);
    }

    pub(super) fn fail(&mut self, failure: Failure, next: Phase) {
        self.failure = Some(failure);
        self.enter(next);
    }

    fn begin(&mut self, hand: &Hand<'_>, plan: &GraspPlan) -> Result<(), GraspRefusal> {
        if self.phase != Phase::Ready {
            return Err(GraspRefusal::Busy(self.phase));
        }
        plan.validate().map_err(GraspRefusal::Plan)?;
        let mut plan = *plan;
        let mut lines = self.lines;
        let mut longest = 0.0_f32;
        let all = hand.fingers.iter().zip(&mut plan.contacts).zip(&mut lines).zip(&self.reference);
        for (index, (((finger, contact), line), reference)) in (0..).zip(all) {
            let normal = Vector3::from(contact.normal);
            let normal = normal / math::sqrt(normal.norm_squared());
            contact.normal = normal.into();
            let at = Vector3::from(contact.position) - normal * finger.radius;
            let before = at - normal * plan.clearance;
            // Both ends of the way that it feels.
            for place in [before, at + normal * plan.clearance] {
                finger.inverse.nearest(&place, reference).map_err(|error| match error {
                    FingerError::OutOfReach { nearest } => {
                        GraspRefusal::OutOfReach { finger: index, nearest: nearest.into() }
                    }
                    _ => GraspRefusal::OutOfReach { finger: index, nearest: place.into() },
                })?;
            }
            let start = finger.chain.posture(reference).tip().translation.vector;
            let way = math::sqrt((before - start).norm_squared());
            longest = if way > longest { way } else { longest };
            *line = Line::between(start, before);
        }
        self.failure = None;
        self.plan = Some(plan);
        (self.lines, self.line_time) = (lines, longest * (PEAK / APPROACH_SPEED) + 0.2);
        self.tracker = Tracker::NONE;
        self.forces = Forces::new(plan.friction.unwrap_or(ASSUMED_FRICTION));
        (self.integral, self.share, self.rub, self.lost) = ([0.0; 6], 0.0, 0.0, 0);
        self.enter(Phase::Approach);
        Ok(())
    }

    fn begin_move(
        &mut self,
        hand: &Hand<'_>,
        translation: &[f32; 3],
        rotation: &[f32; 3],
        duration: f32,
    ) -> Result<(), GraspRefusal> {
        self.require(&[Phase::Hold, Phase::Move])?;
        let (shift, turn) = (Vector3::from(*translation), Vector3::from(*rotation));
        if !(shift.sum() + turn.sum() + duration).is_finite() || duration < TICK {
            return Err(GraspRefusal::NotFinite);
        }
        let origin = self.origin.isometry();
        let target = IsometryMatrix3::from_parts(
            Translation3::from(origin.translation.vector + shift),
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&turn) * origin.rotation.matrix()),
        );
        let now = self.motion.point().frame;
        let way = math::sqrt((target.translation.vector - now.translation.vector).norm_squared());
        let angle = math::rotation_vector(&(target.rotation.matrix() * now.rotation.matrix().transpose()));
        let angle = math::sqrt(angle.norm_squared());
        for (value, limit) in [(way, MOST_SPEED), (angle, MOST_TURN)] {
            let value = PEAK * value / duration;
            if value > limit {
                return Err(GraspRefusal::TooFast { value, limit });
            }
        }
        for (index, ((finger, anchor), reference)) in
            (0..).zip(hand.fingers.iter().zip(&self.tracker.anchors).zip(&self.reference))
        {
            let place = target.transform_point(&(*anchor).into()).coords;
            finger.inverse.nearest(&place, reference).map_err(|error| {
                let nearest = match error {
                    FingerError::OutOfReach { nearest } => nearest.into(),
                    _ => place.into(),
                };
                GraspRefusal::OutOfReach { finger: index, nearest }
            })?;
        }
        self.motion = PoseMotion::between(&now, &target, duration);
        self.failure = None;
        self.enter(Phase::Move);
        Ok(())
    }

    /// Time in this phase [s].
    pub(super) const fn elapsed(&self) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
        let ticks = self.ticks as f32;
        ticks * TICK
    }

    /// One control period.
    ///
    /// # Errors
    /// The object was lost.
    pub fn tick(
        &mut self,
        hand: &Hand<'_>,
        senses: &PerFinger<FingerSense<'_>>,
    ) -> Result<HandOutput, GraspFault> {
        self.ticks = self.ticks.saturating_add(1);
        let fingers = Fingers::new(hand, senses);
        let command = match (self.phase, self.plan) {
            (Phase::Approach, Some(plan)) => self.approach(hand, &plan, &fingers),
            (Phase::Touch, Some(plan)) => self.touch(hand, &plan, &fingers)?,
            (Phase::Ready, _) | (_, None) => self.stand(),
            (Phase::Open, Some(plan)) if self.share <= 0.0 => self.open(hand, &plan, &fingers),
            (_, Some(plan)) => self.hold(hand, &plan, senses, &fingers)?,
        };
        self.angles = senses.each_ref().map(|sense| sense.angles);
        Ok(command)
    }

    /// The fingers stand where they were told to be.
    pub(super) fn stand(&self) -> HandOutput {
        let rest = |position| JointPoint { position, velocity: 0.0, acceleration: 0.0 };
        HandOutput {
            points: self.reference.map(|angles| angles.map(rest)),
            torques: [[0.0; 3]; 3],
            actuation: Actuation::Servo,
        }
    }
}
