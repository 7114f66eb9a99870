//! Fingers without an object: their paths to it, the search for its surface, and the return.

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::plan::GraspPlan;
use super::pose::PoseTrajectory;
use super::state::Fingers;
use super::tracker::Tracker;
use super::tuning::{APPROACH_SPEED, OBSTACLE_FACTOR, REST_TIME, TOUCH_SPEED, TOUCH_TICKS};
use super::{Failure, GraspFault, GraspHand, GraspState, HandOutput, PerFinger, Phase};
use crate::control::JointPoint;
use crate::kinematics::TipPoint;
use crate::math;
use crate::signal::{MINIMUM_JERK_PEAK, minimum_jerk};
use crate::zip::zip;

/// Straight path of a fingertip.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct TipPath {
    /// Start of the tip's centre [m].
    pub start: [f32; 3],
    /// End of the tip's centre [m].
    pub end: [f32; 3],
    /// Consecutive ticks with contact.
    contact_ticks: u8,
    in_contact: bool,
}

/// Set-point of a tip's centre: position [m], velocity [m/s] and acceleration [m/s²].
pub(super) type TipSetpoint = [Vector3<f32>; 3];

impl TipPath {
    /// No path.
    pub const NONE: Self = Self { start: [0.0; 3], end: [0.0; 3], contact_ticks: 0, in_contact: false };

    /// The path from `start` to `end`.
    pub fn between(start: Vector3<f32>, end: Vector3<f32>) -> Self {
        Self { start: start.into(), end: end.into(), ..Self::NONE }
    }

    /// Set-point at `time` [s] of a motion with minimum jerk that takes `duration` [s].
    pub fn setpoint(&self, time: f32, duration: f32) -> TipSetpoint {
        let inverse = 1.0 / duration;
        let [value, first, second] = minimum_jerk(time * inverse);
        let start = Vector3::from(self.start);
        let displacement = Vector3::from(self.end) - start;
        [
            start + displacement * value,
            displacement * (first * inverse),
            displacement * (second * inverse * inverse),
        ]
    }
}

impl GraspState {
    /// Moves the fingertips to their positions in front of the contacts. An obstacle stops them.
    pub(super) fn approach(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        fingers: &Fingers<'_>,
    ) -> HandOutput {
        let obstacle = (0..).zip(&fingers.forces).find_map(|(finger, force)| {
            let force = math::norm(force);
            (force > OBSTACLE_FACTOR * plan.touch_force).then_some(Failure::Obstructed { finger, force })
        });
        if let Some(failure) = obstacle {
            self.reference = self.angles;
            self.fail(failure, Phase::Ready);
            return self.stand();
        }
        let setpoints = self.tip_setpoints();
        if self.elapsed() >= self.path_duration + REST_TIME {
            self.enter(Phase::Touch);
            self.tip_paths.iter_mut().for_each(|path| path.start = path.end);
        }
        self.follow_tips(hand, &setpoints).unwrap_or_else(|finger| {
            self.fail(Failure::OutOfReach { finger }, Phase::Ready);
            self.stand()
        })
    }

    /// Moves the fingertips along the normals until each is in contact.
    pub(super) fn touch(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        fingers: &Fingers<'_>,
    ) -> Result<HandOutput, GraspFault> {
        let distance = self.elapsed() * TOUCH_SPEED;
        let max_distance = 2.0 * plan.clearance;
        let (mut all_in_contact, mut missed) = (true, None);
        let mut setpoints = fingers.tips.map(|tip| [tip, Vector3::zeros(), Vector3::zeros()]);
        let tips = zip((0.., &fingers.tips, &fingers.forces));
        for ((finger, tip, force), contact, [position, velocity, _], path) in
            zip((tips, &plan.contacts, &mut setpoints, &mut self.tip_paths))
        {
            let normal = Vector3::from(contact.normal);
            if !path.in_contact {
                let pushes = normal.dot(force) > plan.touch_force;
                path.contact_ticks = if pushes { path.contact_ticks.saturating_add(1) } else { 0 };
                path.in_contact = path.contact_ticks >= TOUCH_TICKS;
                path.end = if path.in_contact {
                    // It stops here and presses no harder.
                    (*tip).into()
                } else {
                    (all_in_contact, *velocity) = (false, normal * TOUCH_SPEED);
                    missed = missed.or((distance > max_distance).then_some(finger));
                    (Vector3::from(path.start) + normal * distance).into()
                };
            }
            *position = path.end.into();
        }
        if let Some(finger) = missed {
            self.fail(Failure::NoObject { finger, distance: max_distance }, Phase::Open);
        } else if all_in_contact {
            let normals = plan.contacts.map(|contact| Vector3::from(contact.normal));
            self.tracker = Tracker::begin(&fingers.tips, &normals).map_err(|_| GraspFault::NoFrame)?;
            self.origin = self.tracker.object;
            self.trajectory = PoseTrajectory::resting(self.origin);
            self.enter(Phase::Squeeze);
        }
        Ok(self.follow_tips(hand, &setpoints).unwrap_or_else(|finger| {
            self.fail(Failure::OutOfReach { finger }, Phase::Open);
            self.stand()
        }))
    }

    /// Moves the fingertips back from the surface, after the internal forces have fallen to zero.
    pub(super) fn open(
        &mut self,
        hand: &GraspHand<'_>,
        plan: &GraspPlan,
        fingers: &Fingers<'_>,
    ) -> HandOutput {
        let begins = self.step == 0;
        if begins {
            (self.step, self.ticks) = (1, 1);
            let normals = if self.tracker.is_tracking() {
                self.tracker.contacts(&self.trajectory.point().frame, &fingers.radii).1
            } else {
                plan.contacts.map(|contact| contact.normal.into())
            };
            for (path, tip, normal) in zip((&mut self.tip_paths, &fingers.tips, &normals)) {
                (path.start, path.end) = ((*tip).into(), (tip - normal * plan.clearance).into());
            }
            self.path_duration = plan.clearance * (MINIMUM_JERK_PEAK / APPROACH_SPEED) + REST_TIME;
        }
        let setpoints = self.tip_setpoints();
        let output = self.follow_tips(hand, &setpoints);
        if self.elapsed() >= self.path_duration {
            self.enter(Phase::Ready);
        }
        output.unwrap_or_else(|finger| {
            self.fail(Failure::OutOfReach { finger }, Phase::Ready);
            self.stand_at(self.angles);
            self.stand()
        })
    }

    /// Set-points of the fingertips on their paths.
    fn tip_setpoints(&self) -> PerFinger<TipSetpoint> {
        self.tip_paths.each_ref().map(|path| path.setpoint(self.elapsed(), self.path_duration))
    }

    /// Set-points of the joints for those of the fingertips, by inverse kinematics.
    ///
    /// # Errors
    /// The finger whose tip cannot reach its set-point.
    fn follow_tips(
        &mut self,
        hand: &GraspHand<'_>,
        setpoints: &PerFinger<TipSetpoint>,
    ) -> Result<HandOutput, u8> {
        let mut output = self.stand();
        let mut reference = self.reference;
        for (index, finger, reference, points, [position, velocity, acceleration]) in
            zip((0.., &hand.fingers, &mut reference, &mut output.points, setpoints))
        {
            let angles = finger.target(position, reference).ok_or(index)?;
            let motion = TipPoint {
                position: (*position).into(),
                velocity: (*velocity).into(),
                acceleration: (*acceleration).into(),
            };
            let (velocities, accelerations) =
                finger.chain.posture(&angles).joint_motion(&motion).ok_or(index)?;
            *reference = angles;
            for (point, position, velocity, acceleration) in zip((points, angles, velocities, accelerations))
            {
                *point = JointPoint { position, velocity, acceleration };
            }
        }
        // Stored only if all fingers reach their set-points.
        self.reference = reference;
        Ok(output)
    }
}
