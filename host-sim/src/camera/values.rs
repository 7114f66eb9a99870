use std::path::{Path, PathBuf};

use rapier3d::na::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::Deserialize;

use super::geometry::Camera;

/// A hand-eye camera as data: a robot's `camera.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraValues {
    /// Columns and rows of the image.
    pub size: [usize; 2],
    /// Focal length [px].
    pub focal: f64,
    /// Intersection of the optical axis with the image [px].
    pub principal: [f64; 2],
    /// Optical centre in the hand frame [m].
    pub position: [f64; 3],
    /// Rotation from the approach direction towards the hand's axis, about the hand's y [rad].
    pub tilt: f64,
}

/// Why a `camera.toml` cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CameraFileError {
    /// It cannot be read.
    #[error(
        "cannot read {}: {source}; a robot with a hand-eye camera has a camera.toml in its folder, such as \
         `--robot robots/knob-arm`",
        path.display()
    )]
    Read {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// It is not TOML, or a key is wrong.
    #[error("{}: {source}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// The error, with its line.
        source: Box<toml::de::Error>,
    },
    /// A value that no camera can have.
    #[error("{}: {field} is {value}: it must be {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key.
        field: &'static str,
        /// The value.
        value: f64,
        /// The allowed values.
        expected: &'static str,
    },
}

impl CameraValues {
    /// Reads `camera.toml` in a robot's folder.
    ///
    /// # Errors
    /// The file cannot be read, or its content is invalid.
    pub fn load(robot: &Path) -> Result<Self, CameraFileError> {
        let path = robot.join("camera.toml");
        let text = std::fs::read_to_string(&path)
            .map_err(|source| CameraFileError::Read { path: path.clone(), source })?;
        let values: Self = toml::from_str(&text)
            .map_err(|source| CameraFileError::Syntax { path: path.clone(), source: Box::new(source) })?;
        match values.problem() {
            Some((field, value, expected)) => Err(CameraFileError::Value { path, field, value, expected }),
            None => Ok(values),
        }
    }

    fn problem(&self) -> Option<(&'static str, f64, &'static str)> {
        let lengths = self.principal.iter().chain(&self.position).copied();
        let side = self.size.iter().copied().find(|side| !(16..=4096).contains(side));
        let side = side.map(|side| ("size", side as f64, "from 16 to 4096"));
        side.or_else(|| {
            let good = self.focal.is_finite() && self.focal > 0.0;
            (!good).then_some(("focal", self.focal, "above 0 [px]"))
        })
        .or_else(|| {
            let bad = lengths.into_iter().find(|value| !value.is_finite())?;
            Some(("principal or position", bad, "finite"))
        })
        .or_else(|| {
            (self.tilt.is_nan() || self.tilt.abs() >= 1.5).then_some((
                "tilt",
                self.tilt,
                "between −1.5 and 1.5 [rad]",
            ))
        })
    }

    /// The camera without its mount.
    pub const fn camera(&self) -> Camera {
        let [width, height] = self.size;
        Camera { width, height, focal: self.focal, principal: self.principal }
    }

    /// Pose of the camera frame in the hand frame. Without tilt, right in the image is the hand's y, and up
    /// in the image is the hand's x.
    pub fn mount(&self) -> Isometry3<f64> {
        let (sin, cos) = (libm::sin(self.tilt), libm::cos(self.tilt));
        let axes = Matrix3::new(0.0, -cos, -sin, 1.0, 0.0, 0.0, 0.0, -sin, cos);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Isometry3::from_parts(Translation3::from(self.position), rotation)
    }
}
