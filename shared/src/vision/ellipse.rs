use nalgebra::{SMatrix, SVector};

use crate::math::{self, Ldlt};

/// Largest flattening `(a² − b²)/(a² + b²)` of semi-axes a, b: a/b = 1.36.
const MAX_FLATTENING: f32 = 0.3;
/// Standard deviation of an edge point of weight 1 [px].
pub(super) const DEVIATION: f32 = 0.4;

/// `u² + v² + p (u² − v²) + 2 q uv = radius² √(1 − p² − q²)` about the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ellipse {
    pub center: [f32; 2],
    /// Root of the product of the semi-axes [px].
    pub radius: f32,
    /// Flattening along x and along the diagonal.
    pub flattening: [f32; 2],
}

impl Ellipse {
    pub const fn circle(center: [f32; 2], radius: f32) -> Self {
        Self { center, radius, flattening: [0.0; 2] }
    }

    /// Root of the determinant; with it `radius²` is the product of the semi-axes.
    pub fn root(&self) -> f32 {
        let [p, q] = self.flattening;
        math::sqrt(1.0 - p * p - q * q)
    }

    /// Distance of the ellipse from its centre in the direction of a unit vector [px]; `root` is
    /// [`Self::root`].
    #[inline]
    pub fn polar_radius(&self, root: f32, [u, v]: [f32; 2]) -> f32 {
        let [p, q] = self.flattening;
        self.radius * math::finite_sqrt(root / (1.0 + p * (u * u - v * v) + 2.0 * q * u * v))
    }

    /// The point at `polar_radius` px from the centre in the direction of a unit vector.
    #[inline]
    pub fn point(&self, [u, v]: [f32; 2], polar_radius: f32) -> [f32; 2] {
        [self.center[0] + polar_radius * u, self.center[1] + polar_radius * v]
    }

    /// Distance of a point from the ellipse, outwards from the centre, to first order in it and in the
    /// squared flattening [px].
    #[inline]
    pub fn distance_to(&self, [x, y]: [f32; 2]) -> f32 {
        let (u, v) = (x - self.center[0], y - self.center[1]);
        let [p, q] = self.flattening;
        let square = (u * u + v * v + p * (u * u - v * v) + 2.0 * q * u * v) * (1.0 + 0.5 * (p * p + q * q));
        0.5 * (square / self.radius - self.radius)
    }

    /// Distance between two ellipses: of the centres plus difference of the radii [px].
    pub fn distance(&self, other: &Self) -> f32 {
        let [dx, dy] = [0, 1].map(|axis| self.center[axis] - other.center[axis]);
        math::sqrt(dx * dx + dy * dy) + math::abs(self.radius - other.radius)
    }

    /// Whether centre and radius differ by less than these limits [px].
    pub fn is_near(&self, other: &Self, [center, radius]: [f32; 2]) -> bool {
        let [dx, dy] = [0, 1].map(|axis| self.center[axis] - other.center[axis]);
        dx * dx + dy * dy < center * center && math::abs(self.radius - other.radius) < radius
    }

    /// Semi-axes, the larger first, and the angle of the larger one from x towards y [rad].
    pub fn axes(&self) -> ([f32; 2], f32) {
        let [p, q] = self.flattening;
        let flattening = math::sqrt(p * p + q * q);
        let ratio = math::sqrt(math::sqrt((1.0 + flattening) / (1.0 - flattening)));
        ([self.radius * ratio, self.radius / ratio], 0.5 * math::atan2(-q, -p))
    }

    /// Weighted least squares of `u² + v² + p (u² − v²) + 2 q uv = a + b u + c v` over edge points (x, y,
    /// weight), in units of this ellipse about its centre. The prior of the flattening has that mean and
    /// standard deviation. `None` if the result is not an ellipse near this one.
    pub fn refit(
        &self,
        points: impl Iterator<Item = ([f32; 2], f32)>,
        (mean, deviation): ([f32; 2], f32),
    ) -> Option<Self> {
        let mut matrix = SMatrix::<f32, 5, 5>::zeros();
        let mut right = SVector::<f32, 5>::zeros();
        let scale = 1.0 / self.radius;
        let mut total = 0.0;
        for ([x, y], weight) in points {
            if weight <= 0.0 {
                continue;
            }
            let (u, v) = ((x - self.center[0]) * scale, (y - self.center[1]) * scale);
            let row = SVector::<f32, 5>::from([1.0, u, v, v * v - u * u, -2.0 * u * v]);
            let value = u * u + v * v;
            for column in 0..5 {
                let weighted = weight * row[column];
                for line in column..5 {
                    matrix[(line, column)] += weighted * row[line];
                }
                right[column] += weighted * value;
            }
            total += weight;
        }
        if total < 5.0 {
            return None;
        }
        let prior = 2.0 * DEVIATION * scale / deviation;
        for (index, mean) in [3, 4].into_iter().zip(mean) {
            matrix[(index, index)] += prior * prior;
            right[index] += prior * prior * mean;
        }
        let [a, b, c, p, q] = Ldlt::new(&matrix, 1e-6).solve(&right).into();
        let determinant = 1.0 - p * p - q * q;
        // NaN fails too.
        let is_ellipse = determinant > 1.0 - MAX_FLATTENING * MAX_FLATTENING;
        if !is_ellipse {
            return None;
        }
        let u = 0.5 * ((1.0 - p) * b - q * c) / determinant;
        let v = 0.5 * ((1.0 + p) * c - q * b) / determinant;
        let square = a + 0.5 * (b * u + c * v);
        if !(square > 0.25 && square < 4.0 && u * u + v * v < 0.5) {
            return None;
        }
        Some(Self {
            center: [self.center[0] + u * self.radius, self.center[1] + v * self.radius],
            radius: self.radius * math::sqrt(square / math::sqrt(determinant)),
            flattening: [p, q],
        })
    }
}
