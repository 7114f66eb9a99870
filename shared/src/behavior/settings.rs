//! Settings of the behaviour, and their check.

use super::approach::{DEEPER, DEEPER_TRIES};
use super::rose::KnobExpectation;
use crate::OutOfRange;
use crate::math::sqrt;
use crate::task::visual_approach::{MIN_SPEED, VisualApproachSettings};
use crate::vision::HandEyeTable;

/// Settings of the behaviour.
#[derive(Clone, Debug, PartialEq)]
pub struct ApproachSettings {
    /// Appearance of a rose straight in front of the hand in the camera.
    pub table: HandEyeTable,
    /// Prior knowledge of the knob.
    pub expectation: KnobExpectation,
    /// Distance from the hand frame to the rim of the rose at which the gripper closes [m].
    pub grip_distance: f32,
    /// Minimum distance to the rim until the hand is centred [m]: the length of the knob, and a margin.
    pub guard_distance: f32,
    /// Maximum sideways distance of the rose at which the hand counts as centred [m].
    pub tolerance: f32,
    /// Speed of the hand up to the guard distance [m/s].
    pub speed: f32,
    /// Speed of the hand inside the guard distance, while it pulls, and while it withdraws from the knob
    /// [m/s].
    pub near_speed: f32,
    /// Range of the gripper's angle while it holds the knob, minimum and maximum [rad].
    pub opening: [f32; 2],
    /// Distance by which the hand tries to pull the held knob [m]: the knob must stop it before.
    pub pull: f32,
    /// Tries after the first one.
    pub retries: u8,
    /// Maximum time of each part of a try [s]: look, centre and advance, grip, pull, retreat.
    pub patience: f32,
}

impl ApproachSettings {
    /// Checks the settings for a board whose task has the settings `task`.
    ///
    /// # Errors
    /// The first setting that is out of range, by its name here or in [`KnobExpectation`].
    pub fn validate(&self, task: &VisualApproachSettings) -> Result<(), OutOfRange> {
        let KnobExpectation { rose: [small, large], radius, length, distance: [near, far], aside } =
            self.expectation;
        // The farthest knob must be within reach, even if it is aside along both axes and the hand advances
        // after empty grips.
        let reach = task.reach * task.reach - 2.0 * aside * aside;
        let farthest = sqrt(reach.max(0.0)) + self.grip_distance - DEEPER * f32::from(DEEPER_TRIES);
        // Half of the reach along each axis leaves room to the front.
        OutOfRange::check("aside", aside, [0.001, (0.5 * task.reach).min(1.0)])?;
        for (name, value, min, max) in [
            ("rose", small, 0.005, 0.5),
            ("rose", large, small + 1e-4, 0.5),
            ("radius", radius, 0.002, large),
            ("length", length, 0.0, 1.0),
            ("distance", near, 0.01, 5.0),
            ("distance", far, near + 0.001, farthest),
            ("grip_distance", self.grip_distance, 0.0, self.guard_distance),
            ("guard_distance", self.guard_distance, length + self.tolerance, near),
            ("tolerance", self.tolerance, 1e-4, 0.05),
            ("opening", self.opening[0], -100.0, 100.0),
            ("opening", self.opening[1], self.opening[0], 100.0),
            ("speed", self.speed, MIN_SPEED, task.speed),
            ("near_speed", self.near_speed, MIN_SPEED, self.speed),
            ("pull", self.pull, 1e-3, 0.1),
            ("retries", f32::from(self.retries), 0.0, 20.0),
            ("patience", self.patience, 0.5, 600.0),
        ] {
            OutOfRange::check(name, value, [min, max])?;
        }
        Ok(())
    }
}
