//! Detection of a motion's arrival at its goal.

use tesaki::math::abs;
use tesaki::protocol::Telemetry;

/// Number of successive telemetries within the tolerance that count as arrival.
const ENOUGH: u32 = 10;

/// Detects an arrival: the error is within the tolerance in ten successive telemetries.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrival {
    /// Number of successive telemetries within the tolerance.
    near: u32,
}

impl Arrival {
    /// Updates with the error in the latest telemetry, and the tolerance in the same unit.
    pub fn update(&mut self, error: f32, tolerance: f32) {
        self.near = if error <= tolerance { self.near.saturating_add(1) } else { 0 };
    }

    /// Returns whether the motion has arrived.
    pub const fn has_come(&self) -> bool {
        self.near >= ENOUGH
    }
}

/// Returns the joint that is farthest from its goal, and its distance [rad]; goals in rad.
pub fn farthest_joint(telemetry: &Telemetry, goals: &[f32]) -> (usize, f32) {
    let errors = telemetry.joints.iter().zip(goals).map(|(joint, goal)| abs(goal - joint.position));
    errors.enumerate().fold((0, 0.0), |farthest, error| if error.1 > farthest.1 { error } else { farthest })
}

#[cfg(test)]
mod tests {
    use tesaki::protocol::{JointTelemetry, Mode};

    use super::*;

    #[test]
    fn ten_telemetries_in_a_row_are_an_arrival() {
        let mut arrival = Arrival::default();
        let mut has_come = |errors: &[f32]| {
            errors.iter().for_each(|&error| arrival.update(error, 0.02));
            arrival.has_come()
        };
        assert!(!has_come(&[0.0; 9]));
        assert!(!has_come(&[0.021]));
        assert!(!has_come(&[0.02; 9]));
        assert!(has_come(&[0.02]));
        assert!(has_come(&[0.01]));
        assert!(!has_come(&[f32::NAN]));
    }

    #[test]
    fn the_farthest_joint_is_found_on_either_side_of_its_goal() {
        let joint = |position| JointTelemetry { position, ..JointTelemetry::default() };
        let joints = [1.0, -0.5, 0.25].map(joint).into_iter().collect();
        let telemetry = Telemetry { tick: 1, mode: Mode::Disabled, faults: 0, joints };
        assert_eq!(farthest_joint(&telemetry, &[1.25, -0.5, 0.0]), (0, 0.25));
        assert_eq!(farthest_joint(&telemetry, &[1.25, 0.25, 0.0]), (1, 0.75));
        assert_eq!(farthest_joint(&telemetry, &[1.0, -0.5, 0.25]), (0, 0.0));
    }
}
