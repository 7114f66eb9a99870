//! The frame of the operator's hand.

use nalgebra::{Matrix3, Vector3};
use tesaki_description::retargeting::Side;

/// Wrist and first joints of a right hand in its frame, thumb to little finger [m]: the mean of adult hands,
/// as in `robots/hand5`.
const MEAN: [[f32; 3]; POINTS] = [
    [0.0, 0.0, 0.0],
    [0.010, 0.022, 0.020],
    [0.0, 0.025, 0.090],
    [0.0, 0.004, 0.092],
    [0.0, -0.016, 0.087],
    [0.0, -0.034, 0.078],
];
/// Number of points of a palm: the wrist and the first joint of each finger.
pub const POINTS: usize = 6;

/// The frame of the operator's hand: origin at the wrist, z along the fingers, x out of the palm, y = z × x.
/// On a right hand y points to the thumb, on a left hand to the little finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PalmFrame {
    /// Rotation into the hand's frame.
    rotation: Matrix3<f32>,
    /// Position of the wrist, measured or derived from the mean hand [m].
    origin: Vector3<f32>,
    /// Size of the hand, relative to the mean one.
    pub size: f32,
}

impl PalmFrame {
    /// Fits the mean hand, scaled, rotated and translated, to the points of a palm [m], wrist first, in any
    /// frame (least squares; Umeyama 1991), and returns its frame. `None` for fewer than three points, or if
    /// they are collinear.
    pub fn fit(side: Side, points: &[Option<Vector3<f32>>; POINTS]) -> Option<Self> {
        let pairs = || {
            let mean = MEAN.iter().map(|&[x, y, z]| Vector3::new(x, thumbward(side, y), z));
            points.iter().zip(mean).filter_map(|(point, mean)| Some(((*point)?, mean)))
        };
        let (mut count, mut centres) = (0.0, [Vector3::zeros(); 2]);
        for (point, mean) in pairs() {
            count += 1.0;
            centres = [centres[0] + point, centres[1] + mean];
        }
        let [centre, mean_centre] = centres.map(|sum| sum / count);
        let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
        for (point, mean) in pairs() {
            covariance += (mean - mean_centre) * (point - centre).transpose();
            variance += (mean - mean_centre).norm_squared();
        }
        let svd = covariance.svd(true, true);
        let (Some(left), Some(right)) = (svd.u, svd.v_t) else { return None };
        // A palm is nearly flat, but collinear points would leave a rotation about their line free.
        let is_flat = svd.singular_values[1] > 1e-3 * svd.singular_values[0];
        if count < 3.0 || !is_flat {
            return None;
        }
        // The sign makes it a rotation instead of a reflection.
        let sign = (left * right).determinant().signum();
        let signs = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign));
        let rotation = left * signs * right;
        let size = (signs * Matrix3::from_diagonal(&svd.singular_values)).trace() / variance;
        let origin = points[0].unwrap_or_else(|| centre - rotation.transpose() * mean_centre * size);
        Some(Self { rotation, origin, size })
    }

    /// Transforms a point into the hand's frame [m].
    pub fn position(&self, point: &Vector3<f32>) -> Vector3<f32> {
        self.rotation * (point - self.origin)
    }

    /// Transforms a direction or a velocity into the hand's frame.
    pub fn vector(&self, vector: &Vector3<f32>) -> Vector3<f32> {
        self.rotation * vector
    }
}

/// Returns the distance of a coordinate y towards the side of the thumb.
pub fn thumbward(side: Side, y: f32) -> f32 {
    match side {
        Side::Right => y,
        Side::Left => -y,
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    /// A hand 20 % larger than the mean, in an arbitrary pose.
    #[test]
    fn the_frame_of_a_turned_moved_and_scaled_palm_is_found_for_either_hand() {
        let rotation = Rotation3::from_euler_angles(0.4, -2.0, 2.9);
        let shift = Vector3::new(0.3, -0.2, 0.7);
        for (side, sign) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
            let all = MEAN.map(|[x, y, z]| Some(rotation * Vector3::new(x, sign * y, z) * 1.2 + shift));
            for missing in [None, Some(0), Some(1)] {
                let mut points = all;
                if let Some(missing) = missing {
                    points[missing] = None;
                }
                let palm = PalmFrame::fit(side, &points).unwrap();
                assert!((palm.size - 1.2).abs() < 1e-4, "{side:?} {missing:?}: {}", palm.size);
                let tip = Vector3::new(0.05, -0.03, 0.1);
                let found = palm.position(&(rotation * tip + shift));
                assert!((found - tip).norm() < 1e-5, "{side:?} {missing:?}: {found}");
                assert!((palm.vector(&(rotation * tip)) - tip).norm() < 1e-5);
            }
            let line = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0].map(|x| Some(Vector3::new(x, 0.0, 0.0)));
            assert_eq!(PalmFrame::fit(side, &line), None);
        }
    }
}
