use core::fmt;

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

use crate::math;

/// Minimum sine of the triangle's angle at finger 3; below it the normal is ill-conditioned.
const MIN_SINE: f32 = 1e-3;

/// Why three fingertips define no object frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObjectFrameError {
    /// A position is NaN or infinite.
    NotFinite {
        /// The finger, 0 to 2.
        finger: u8,
    },
    /// The fingertips are collinear.
    InLine {
        /// The triangle's area over half the product of its two sides at finger 3.
        sine: f32,
    },
    /// Finger 3 is at the centroid: tips coincide.
    NoDirection,
}

/// The object's frame from the `tips` [m] of fingers 1 to 3, in the frame of these (Hand3 section 5.1): its
/// origin is the centroid of their triangle, z the triangle's normal (fingers 1, 2, 3 go round it
/// counterclockwise), x points to finger 3, y = z × x.
///
/// # Errors
/// The tips span no triangle.
pub fn object_frame(tips: &[Vector3<f32>; 3]) -> Result<IsometryMatrix3<f32>, ObjectFrameError> {
    for (finger, tip) in (0..).zip(tips) {
        if !(tip.x + tip.y + tip.z).is_finite() {
            return Err(ObjectFrameError::NotFinite { finger });
        }
    }
    let [one, two, three] = tips;
    let centroid = (one + two + three) / 3.0;
    let (to_one, to_two, toward) = (one - three, two - three, three - centroid);
    let normal = to_one.cross(&to_two);
    let product = math::norm(&to_one) * math::norm(&to_two);
    let (area, length) = (math::norm(&normal), math::norm(&toward));
    if !(product > f32::MIN_POSITIVE && length > f32::MIN_POSITIVE) {
        return Err(ObjectFrameError::NoDirection);
    }
    let sine = area / product;
    if sine < MIN_SINE || sine.is_nan() {
        return Err(ObjectFrameError::InLine { sine });
    }
    let (x, z) = (toward / length, normal / area);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Ok(IsometryMatrix3::from_parts(Translation3::from(centroid), rotation))
}

impl fmt::Display for ObjectFrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { finger } => write!(f, "the position of fingertip {} is not finite", finger + 1),
            Self::InLine { sine } => {
                write!(
                    f,
                    "the fingertips are collinear: the sine at finger 3 is {sine}, the minimum {MIN_SINE}"
                )
            }
            Self::NoDirection => write!(f, "fingertips coincide"),
        }
    }
}

impl core::error::Error for ObjectFrameError {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn is_the_frame_of_the_paper() {
        // Fingers 1 and 2 on the left, 3 on the right, seen from above: z is up.
        let tips =
            [Vector3::new(0.0, 0.04, 1.0), Vector3::new(0.0, -0.04, 1.0), Vector3::new(0.09, 0.0, 1.0)];
        let frame = object_frame(&tips).unwrap();
        assert!((frame.translation.vector - Vector3::new(0.03, 0.0, 1.0)).norm() < 1e-7);
        assert!((frame.rotation.matrix() - Matrix3::identity()).norm() < 1e-6, "{frame}");
        // With fingers 1 and 2 exchanged z is down, and y is reversed.
        let [one, two, three] = tips;
        let frame = object_frame(&[two, one, three]).unwrap();
        let reversed = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        assert!((frame.rotation.matrix() - reversed).norm() < 1e-6, "{frame}");
    }

    #[test]
    fn is_right_handed_for_any_triangle() {
        let tips = [Vector3::new(0.3, -0.1, 0.2), Vector3::new(-0.2, 0.5, 0.1), Vector3::new(0.1, 0.1, -0.4)];
        let frame = object_frame(&tips).unwrap();
        let m = frame.rotation.matrix();
        assert!((m * m.transpose() - Matrix3::identity()).norm() < 1e-6 && m.determinant() > 0.99);
        let at = frame.inverse_transform_point(&tips[2].into());
        assert!(at.x > 0.0 && at.y.abs() < 1e-6 && at.z.abs() < 1e-6);
    }

    #[test]
    fn tips_without_a_triangle_are_refused() {
        let at = |x: f32| Vector3::new(x, 2.0 * x, 0.1);
        let (a, b, c) = (at(0.0), at(0.02), at(0.05));
        assert!(matches!(object_frame(&[a, b, c]), Err(ObjectFrameError::InLine { .. })));
        assert_eq!(object_frame(&[a, a, a]), Err(ObjectFrameError::NoDirection));
        assert!(object_frame(&[a, c, c]).is_err() && object_frame(&[a, a, c]).is_err());
        let nan = Vector3::new(f32::NAN, 0.0, 0.0);
        assert_eq!(object_frame(&[a, nan, c]), Err(ObjectFrameError::NotFinite { finger: 1 }));
    }
}
