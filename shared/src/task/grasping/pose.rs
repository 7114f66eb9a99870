use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::TICK;
use crate::math;
use crate::signal::minimum_jerk;

/// A frame in the base frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Frame {
    /// Where its origin is [m].
    pub translation: [f32; 3],
    /// Its axes x, y, z: the columns of the rotation matrix.
    pub axes: [[f32; 3]; 3],
}

impl Frame {
    /// The base frame itself.
    pub const BASE: Self =
        Self { translation: [0.0; 3], axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// The same as a transformation from this frame to the base frame.
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

/// A frame on its way: a minimum-jerk motion along a straight line, turning about one axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct PoseMotion {
    start: Frame,
    /// From start to end, in base axes [m, rad].
    translation: [f32; 3],
    rotation: [f32; 3],
    duration: f32,
    time: f32,
}

/// A point of a [`PoseMotion`].
pub(super) struct PosePoint {
    pub frame: IsometryMatrix3<f32>,
    /// `[v; ω]` of its origin, in base axes [m/s, rad/s].
    pub twist: Vector6<f32>,
    /// Their derivatives.
    pub acceleration: Vector6<f32>,
}

impl PoseMotion {
    /// Rests at `frame`.
    pub const fn resting(frame: Frame) -> Self {
        Self { start: frame, translation: [0.0; 3], rotation: [0.0; 3], duration: 0.0, time: 0.0 }
    }

    /// From one frame to the other, turning the shorter way round, within `duration` [s].
    pub fn between(from: &IsometryMatrix3<f32>, to: &IsometryMatrix3<f32>, duration: f32) -> Self {
        let turn = to.rotation.matrix() * from.rotation.matrix().transpose();
        Self {
            start: from.into(),
            translation: (to.translation.vector - from.translation.vector).into(),
            rotation: math::rotation_vector(&turn).into(),
            duration,
            time: 0.0,
        }
    }

    /// Whether it has come to its end.
    pub fn is_done(&self) -> bool {
        self.time >= self.duration
    }

    /// Ends here and now, at rest.
    pub fn stop(&mut self) {
        *self = Self::resting((&self.point().frame).into());
    }

    /// Goes on by one tick.
    pub fn advance(&mut self) -> PosePoint {
        let time = self.time + TICK;
        self.time = if time < self.duration { time } else { self.duration };
        self.point()
    }

    /// Where it is.
    pub fn point(&self) -> PosePoint {
        let (translation, rotation) = (Vector3::from(self.translation), Vector3::from(self.rotation));
        let start = self.start.isometry();
        let (value, first, second) = if self.is_done() {
            (1.0, 0.0, 0.0)
        } else {
            let inverse = 1.0 / self.duration;
            let [value, first, second] = minimum_jerk(self.time * inverse);
            (value, first * inverse, second * inverse * inverse)
        };
        let turned = math::rotation_matrix(&(rotation * value)) * start.rotation.matrix();
        let origin = start.translation.vector + translation * value;
        let both = |scale: f32| {
            let (v, w) = (translation * scale, rotation * scale);
            Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
        };
        PosePoint {
            frame: IsometryMatrix3::from_parts(
                Translation3::from(origin),
                Rotation3::from_matrix_unchecked(turned),
            ),
            twist: both(first),
            acceleration: both(second),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goes_from_one_frame_to_the_other_with_the_velocity_that_it_says() {
        let start = IsometryMatrix3::from_parts(
            Translation3::new(0.1, 0.0, 0.2),
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&Vector3::new(0.3, -0.2, 0.5))),
        );
        let turn = Vector3::new(0.0, 0.1, -0.05);
        let mut end = start;
        end.translation.vector += Vector3::new(0.01, -0.02, 0.0);
        end.rotation =
            Rotation3::from_matrix_unchecked(math::rotation_matrix(&turn) * start.rotation.matrix());
        let mut motion = PoseMotion::between(&start, &end, 1.0);
        let mut before = motion.point();
        for _ in 0..100 {
            let point = motion.advance();
            let step = (point.frame.translation.vector - before.frame.translation.vector) / TICK;
            let turned = point.frame.rotation.matrix() * before.frame.rotation.matrix().transpose();
            let spin = math::rotation_vector(&turned) / TICK;
            // The mean of both ends' velocities, but for the third derivative: jerk · T²/12 and rounding.
            let mean = (point.twist + before.twist) * 0.5;
            assert!(
                (step - mean.fixed_rows::<3>(0)).norm() < 1e-4
                    && (spin - mean.fixed_rows::<3>(3)).norm() < 2e-4
            );
            before = point;
        }
        // A hundred times 0.01 is not quite 1.
        motion.advance();
        assert!(motion.is_done());
        assert!((motion.point().frame.to_homogeneous() - end.to_homogeneous()).norm() < 1e-6);
        motion.stop();
        assert!(motion.is_done() && motion.advance().twist.norm() == 0.0);
    }
}
