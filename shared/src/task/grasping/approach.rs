//! Fingers that hold nothing: on the way to an object, feeling for it, and going back from it.

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::plan::GraspPlan;
use super::pose::PoseMotion;
use super::state::{Fingers, PEAK, pairs};
use super::tracker::Tracker;
use super::{Failure, GraspFault, GraspState, Hand, HandOutput, PerFinger, Phase};
use crate::control::JointPoint;
use crate::kinematics::TipPoint;
use crate::math;
use crate::signal::minimum_jerk;

/// Speed of the tips on their way to the object, at its largest [m/s].
pub(super) const APPROACH_SPEED: f32 = 0.1;
/// Time for the tips to come to rest [s].
pub(super) const REST_TIME: f32 = 0.3;
/// Speed at which a tip feels for the surface [m/s].
const TOUCH_SPEED: f32 = 0.02;
/// Ticks in a row above the touch force that mean contact.
const TOUCH_TICKS: u8 = 2;
/// Force on a tip that stops the approach, over the touch force.
const OBSTACLE: f32 = 3.0;

/// The straight way of a fingertip.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Line {
    /// From here [m].
    pub start: [f32; 3],
    /// To here [m].
    pub end: [f32; 3],
    /// Ticks in a row with contact.
    touches: u8,
    touched: bool,
}

impl Line {
    /// None.
    pub const NONE: Self = Self { start: [0.0; 3], end: [0.0; 3], touches: 0, touched: false };

    /// From one place to the other.
    pub fn between(start: Vector3<f32>, end: Vector3<f32>) -> Self {
        Self { start: start.into(), end: end.into(), ..Self::NONE }
    }
}

impl GraspState {
    /// On the straight ways to the places in front of the contacts.
    pub(super) fn approach(
        &mut self,
        hand: &Hand<'_>,
        plan: &GraspPlan,
        fingers: &Fingers<'_>,
    ) -> HandOutput {
        let met = (0..).zip(&fingers.forces).find_map(|(finger, force)| {
            let force = math::sqrt(force.norm_squared());
            (force > OBSTACLE * plan.touch_force).then_some(Failure::Obstructed { finger, force })
        });
        if let Some(failure) = met {
            self.reference = self.angles;
            self.fail(failure, Phase::Ready);
            return self.stand();
        }
        let places = self.on_lines();
        if self.elapsed() >= self.line_time + REST_TIME {
            self.enter(Phase::Touch);
            self.lines.iter_mut().for_each(|line| line.start = line.end);
        }
        self.lead(hand, &places).unwrap_or_else(|finger| {
            self.fail(Failure::OutOfReach { finger }, Phase::Ready);
            self.stand()
        })
    }

    /// Along the normals, until each tip feels the surface.
    pub(super) fn touch(
        &mut self,
        hand: &Hand<'_>,
        plan: &GraspPlan,
        fingers: &Fingers<'_>,
    ) -> Result<HandOutput, GraspFault> {
        let felt = self.elapsed() * TOUCH_SPEED;
        let most = 2.0 * plan.clearance;
        let (mut all, mut missed) = (true, None);
        let mut places = fingers.tips.map(|tip| [tip, Vector3::zeros(), Vector3::zeros()]);
        let tips = fingers.tips.iter().zip(&fingers.forces).zip(&plan.contacts).zip(&mut places);
        for (finger, ((((tip, force), contact), [place, speed, _]), line)) in
            (0..).zip(tips.zip(&mut self.lines))
        {
            let normal = Vector3::from(contact.normal);
            if !line.touched {
                line.touches = if normal.dot(force) > plan.touch_force { line.touches + 1 } else { 0 };
                line.touched = line.touches >= TOUCH_TICKS;
                line.end = if line.touched {
                    // It stays where it is, and does not press on.
                    (*tip).into()
                } else {
                    (all, *speed) = (false, normal * TOUCH_SPEED);
                    missed = missed.or((felt > most).then_some(finger));
                    (Vector3::from(line.start) + normal * felt).into()
                };
            }
            *place = line.end.into();
        }
        if let Some(finger) = missed {
            self.fail(Failure::NothingThere { finger, distance: most }, Phase::Open);
        } else if all {
            let normals = plan.contacts.map(|contact| Vector3::from(contact.normal));
            self.tracker = Tracker::begin(&fingers.tips, &normals).map_err(|_| GraspFault::NoFrame)?;
            self.origin = self.tracker.object;
            self.motion = PoseMotion::resting(self.origin);
            self.enter(Phase::Squeeze);
        }
        Ok(self.lead(hand, &places).unwrap_or_else(|finger| {
            self.fail(Failure::OutOfReach { finger }, Phase::Open);
            self.stand()
        }))
    }

    /// Back from the surface, once nothing is held any more.
    pub(super) fn open(&mut self, hand: &Hand<'_>, plan: &GraspPlan, fingers: &Fingers<'_>) -> HandOutput {
        if self.settled == 0 {
            (self.settled, self.ticks) = (1, 1);
            let normals = if self.tracker.is_begun() {
                self.tracker.contacts(&self.motion.point().frame, &fingers.radii).1
            } else {
                plan.contacts.map(|contact| contact.normal.into())
            };
            for (line, (tip, normal)) in self.lines.iter_mut().zip(pairs(&fingers.tips, &normals)) {
                (line.start, line.end) = ((*tip).into(), (tip - normal * plan.clearance).into());
            }
            self.line_time = plan.clearance * (PEAK / APPROACH_SPEED) + REST_TIME;
        }
        let places = self.on_lines();
        let command = self.lead(hand, &places);
        if self.elapsed() >= self.line_time || command.is_err() {
            self.enter(Phase::Ready);
        }
        command.unwrap_or_else(|_| self.stand())
    }

    /// Where the tips are to be on their straight ways, with velocities and accelerations.
    fn on_lines(&self) -> PerFinger<[Vector3<f32>; 3]> {
        let inverse = 1.0 / self.line_time;
        let [value, first, second] = minimum_jerk(self.elapsed() * inverse);
        self.lines.map(|line| {
            let start = Vector3::from(line.start);
            let way = Vector3::from(line.end) - start;
            [start + way * value, way * (first * inverse), way * (second * inverse * inverse)]
        })
    }

    /// The tips at `places`, with these velocities and accelerations.
    ///
    /// # Errors
    /// The finger that does not get there.
    fn lead(&mut self, hand: &Hand<'_>, places: &PerFinger<[Vector3<f32>; 3]>) -> Result<HandOutput, u8> {
        let mut command = self.stand();
        let fingers = hand.fingers.iter().zip(&mut self.reference).zip(&mut command.points);
        for (index, (((finger, reference), points), [place, velocity, acceleration])) in
            (0..).zip(fingers.zip(places))
        {
            let angles = finger.inverse.nearest(place, reference).map_err(|_| index)?;
            let motion = TipPoint {
                position: (*place).into(),
                velocity: (*velocity).into(),
                acceleration: (*acceleration).into(),
            };
            let (velocities, accelerations) =
                finger.chain.posture(&angles).joint_motion(&motion).ok_or(index)?;
            *reference = angles;
            for (point, ((position, velocity), acceleration)) in
                points.iter_mut().zip(angles.into_iter().zip(velocities).zip(accelerations))
            {
                *point = JointPoint { position, velocity, acceleration };
            }
        }
        Ok(command)
    }
}
