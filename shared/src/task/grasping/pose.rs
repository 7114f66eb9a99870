use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::TICK;
use crate::math;
use crate::signal::minimum_jerk;

/// Pose of a frame in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Frame {
    /// Position of its origin [m].
    pub translation: [f32; 3],
    /// Its axes x, y, z: the columns of the rotation matrix.
    pub axes: [[f32; 3]; 3],
}

impl Frame {
    /// The base frame itself.
    pub const BASE: Self =
        Self { translation: [0.0; 3], axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// The transformation from this frame to the base frame.
    pub fn isometry(&self) -> IsometryMatrix3<f32> {
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from(self.axes));
        IsometryMatrix3::from_parts(Translation3::from(self.translation), rotation)
    }
}

impl From<&IsometryMatrix3<f32>> for Frame {
    fn from(isometry: &IsometryMatrix3<f32>) -> Self {
        Self { translation: isometry.translation.vector.into(), axes: (*isometry.rotation.matrix()).into() }
    }
}

/// Minimum-jerk trajectory of a frame: translation along a straight line, rotation about a fixed axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct PoseTrajectory {
    start: Frame,
    /// From start to end, in base axes [m].
    translation: [f32; 3],
    /// Rotation vector from start to end, in base axes [rad].
    rotation: [f32; 3],
    /// [s]
    duration: f32,
    /// [s]
    time: f32,
}

/// A point of a [`PoseTrajectory`]. Unlike [`PosePoint`](crate::kinematics::PosePoint), the set-point on the
/// wire, it has the orientation as a rotation matrix: a conversion to a quaternion and back would cost a
/// square root and rounding in each tick.
pub(super) struct PoseTrajectoryPoint {
    pub frame: IsometryMatrix3<f32>,
    /// `[v; ω]` of the frame's origin, in base axes [m/s, rad/s].
    pub twist: Vector6<f32>,
    /// Its derivative [m/s², rad/s²].
    pub acceleration: Vector6<f32>,
}

impl PoseTrajectory {
    /// A trajectory at rest at `frame`.
    pub const fn resting(frame: Frame) -> Self {
        Self { start: frame, translation: [0.0; 3], rotation: [0.0; 3], duration: 0.0, time: 0.0 }
    }

    /// The trajectory from one frame to the other within `duration` [s], with the smaller rotation.
    pub fn between(from: &IsometryMatrix3<f32>, to: &IsometryMatrix3<f32>, duration: f32) -> Self {
        let [translation, rotation] = math::displacement(from, to).map(Into::into);
        Self { start: from.into(), translation, rotation, duration, time: 0.0 }
    }

    /// Whether the end is reached.
    pub fn is_done(&self) -> bool {
        self.time >= self.duration
    }

    /// Moves all of it by a displacement [m].
    pub fn shift(&mut self, displacement: &Vector3<f32>) {
        self.start.translation = (Vector3::from(self.start.translation) + displacement).into();
    }

    /// Stops immediately at the present point.
    pub fn stop(&mut self) {
        *self = Self::resting((&self.point().frame).into());
    }

    /// Advances by one tick.
    pub fn advance(&mut self) -> PoseTrajectoryPoint {
        let time = self.time + TICK;
        self.time = if time < self.duration { time } else { self.duration };
        self.point()
    }

    /// The present point.
    pub fn point(&self) -> PoseTrajectoryPoint {
        let (translation, rotation) = (Vector3::from(self.translation), Vector3::from(self.rotation));
        let start = self.start.isometry();
        let (value, first, second) = if self.is_done() {
            (1.0, 0.0, 0.0)
        } else {
            let inverse = 1.0 / self.duration;
            let [value, first, second] = minimum_jerk(self.time * inverse);
            (value, first * inverse, second * inverse * inverse)
        };
        let rotated = math::rotation_matrix(&(rotation * value)) * start.rotation.matrix();
        let origin = start.translation.vector + translation * value;
        let rates = |scale: f32| math::stack([translation * scale, rotation * scale]);
        PoseTrajectoryPoint {
            frame: IsometryMatrix3::from_parts(
                Translation3::from(origin),
                Rotation3::from_matrix_unchecked(rotated),
            ),
            twist: rates(first),
            acceleration: rates(second),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twist_is_the_derivative_of_the_pose_and_the_trajectory_ends_at_its_target() {
        let start = IsometryMatrix3::from_parts(
            Translation3::new(0.1, 0.0, 0.2),
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&Vector3::new(0.3, -0.2, 0.5))),
        );
        let rotation = Vector3::new(0.0, 0.1, -0.05);
        let mut end = start;
        end.translation.vector += Vector3::new(0.01, -0.02, 0.0);
        end.rotation =
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&rotation) * start.rotation.matrix());
        let mut trajectory = PoseTrajectory::between(&start, &end, 1.0);
        let mut before = trajectory.point();
        for _ in 0..100 {
            let point = trajectory.advance();
            let step = (point.frame.translation.vector - before.frame.translation.vector) / TICK;
            let rotated = point.frame.rotation.matrix() * before.frame.rotation.matrix().transpose();
            let spin = math::rotation_vector(&rotated) / TICK;
            // The mean of the velocities at both ends, up to jerk · T²/12 and rounding.
            let mean = (point.twist + before.twist) * 0.5;
            assert!(
                (step - mean.fixed_rows::<3>(0)).norm() < 1e-4
                    && (spin - mean.fixed_rows::<3>(3)).norm() < 2e-4
            );
            before = point;
        }
        // A hundred times 0.01 is not quite 1.
        trajectory.advance();
        assert!(trajectory.is_done());
        assert!((trajectory.point().frame.to_homogeneous() - end.to_homogeneous()).norm() < 1e-6);
        trajectory.stop();
        assert!(trajectory.is_done() && trajectory.advance().twist.norm() == 0.0);
    }
}
