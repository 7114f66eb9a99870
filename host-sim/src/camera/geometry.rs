use rapier3d::na::{Isometry3, Matrix2, Matrix3, Point3, SymmetricEigen, Vector3};
use tesaki_description::camera::CameraValues;

/// A pinhole camera with square pixels and without distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length [px].
    pub focal: f64,
    /// Where the optical axis meets the image [px].
    pub principal: [f64; 2],
}

impl Camera {
    /// The camera of these values without its mount.
    pub const fn of(values: &CameraValues) -> Self {
        let [width, height] = values.size;
        Self { width, height, focal: values.focal, principal: values.principal }
    }

    /// Image of a point in the camera frame [px]; `None` behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        let [u, v] = self.principal;
        let scale = self.focal / point.z;
        (point.z > 0.0).then(|| [u + scale * point.x, v + scale * point.y])
    }

    /// Direction of the ray through a point of the image, in the camera frame; its z is 1.
    pub fn ray(&self, [u, v]: [f64; 2]) -> Vector3<f64> {
        let [u0, v0] = self.principal;
        Vector3::new((u - u0) / self.focal, (v - v0) / self.focal, 1.0)
    }

    /// Whether a point is in the image.
    pub const fn contains(&self, [u, v]: [f64; 2]) -> bool {
        u >= -0.5 && v >= -0.5 && u < self.width as f64 - 0.5 && v < self.height as f64 - 0.5
    }
}

/// A circle in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Its centre [m].
    pub center: Point3<f64>,
    /// Two orthogonal unit vectors in its plane.
    pub axes: [Vector3<f64>; 2],
    /// Its radius [m].
    pub radius: f64,
}

impl Circle {
    /// A circle about the z axis.
    pub fn about_z(z: f64, radius: f64) -> Self {
        Self { center: Point3::new(0.0, 0.0, z), axes: [Vector3::x(), Vector3::y()], radius }
    }

    /// The same circle in another frame.
    #[must_use]
    pub fn transformed(&self, pose: &Isometry3<f64>) -> Self {
        Self { center: pose * self.center, axes: self.axes.map(|axis| pose * axis), radius: self.radius }
    }

    /// The point at an angle from the first axis [rad].
    pub fn point(&self, angle: f64) -> Point3<f64> {
        let [first, second] = self.axes;
        self.center + (first * libm::cos(angle) + second * libm::sin(angle)) * self.radius
    }

    /// Image of the circle, which is given in the camera frame. `None` unless all of it is before the camera.
    ///
    /// The image of the unit circle of the plane under the homography `H = K [r·a  r·b  c]` has the dual
    /// conic `H diag(1, 1, −1) Hᵀ` (Hartley and Zisserman, *Multiple View Geometry*, section 8.2.2): an
    /// ellipse with centre `m` and semi-axes in `A` has `[[AAᵀ − mmᵀ, −m], [−mᵀ, −1]]`.
    pub fn image(&self, camera: &Camera) -> Option<Ellipse> {
        let [first, second] = self.axes.map(|axis| axis * self.radius);
        let nearest = self.center.z - libm::hypot(first.z, second.z);
        if nearest <= 1e-6 {
            return None;
        }
        let [u, v] = camera.principal;
        let intrinsic = Matrix3::new(camera.focal, 0.0, u, 0.0, camera.focal, v, 0.0, 0.0, 1.0);
        let homography = intrinsic * Matrix3::from_columns(&[first, second, self.center.coords]);
        let unit = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        let dual = homography * unit * homography.transpose();
        let dual = dual / -dual.m33;
        let [x, y] = [-dual.m13, -dual.m23];
        let shape = Matrix2::new(dual.m11 + x * x, dual.m12 + x * y, dual.m12 + x * y, dual.m22 + y * y);
        let eigen = SymmetricEigen::new(shape);
        let (major, minor) = if eigen.eigenvalues.x >= eigen.eigenvalues.y { (0, 1) } else { (1, 0) };
        let direction = eigen.eigenvectors.column(major);
        let semi_axes = [major, minor].map(|index| libm::sqrt(eigen.eigenvalues[index].max(0.0)));
        Some(Ellipse { center: [x, y], semi_axes, angle: libm::atan(direction.y / direction.x) })
    }
}

/// An ellipse in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Its centre [px].
    pub center: [f64; 2],
    /// The larger and the smaller semi-axis [px].
    pub semi_axes: [f64; 2],
    /// Direction of the larger one from the image's x to its y, −π/2 to π/2 [rad].
    pub angle: f64,
}

impl Ellipse {
    /// Radius of the circle with the same area [px].
    pub fn radius(&self) -> f64 {
        let [major, minor] = self.semi_axes;
        libm::sqrt(major * minor)
    }
}
