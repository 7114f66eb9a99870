//! `camera.toml` in a robot folder: the camera in the hand of a simulated robot.
//!
//! ```toml
//! size = [256, 240]             # px, columns and rows
//! focal = 140.0                 # px
//! principal = [127.5, 119.5]    # px, where the optical axis meets the image
//! position = [0.05, 0.0, -0.12] # m, of the optical centre in the hand frame
//! tilt = 0.1745                 # rad, from the approach towards the hand's axis, about the hand's y
//! ```

use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::Deserialize;

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};

/// Name of the file in a robot folder.
pub const FILE: &str = "camera.toml";
/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/knob-arm/camera.toml is an example";
/// What to do when it cannot be read.
const UNREAD: &str = "a robot with a hand-eye camera has a camera.toml in its folder, such as \
                      `--robot robots/knob-arm`";

/// A hand-eye camera as data.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraValues {
    /// Columns and rows of the image.
    pub size: [usize; 2],
    /// Focal length [px].
    pub focal: f64,
    /// Where the optical axis meets the image [px].
    pub principal: [f64; 2],
    /// Optical centre in the hand frame [m].
    pub position: [f64; 3],
    /// Rotation from the approach towards the hand's axis, about the hand's y [rad].
    pub tilt: f64,
}

impl CameraValues {
    /// Reads `camera.toml` in a robot's folder.
    ///
    /// # Errors
    /// It cannot be read, or what is wrong in it.
    pub fn load(robot: &Path) -> Result<Self, FileError> {
        file::load(&robot.join(FILE), UNREAD, Self::check)
    }

    /// What is wrong with `text`, the content of `path`; the values when nothing is.
    pub fn check(path: &Path, text: &str) -> (Option<Self>, Vec<Finding>) {
        let mut report = Report::of_toml(path, text);
        let values = file::parse::<Self>(text, ADVICE, &mut report);
        if let Some((field, value, expected)) = values.as_ref().and_then(Self::problem) {
            report.dynamics(
                report.line_of(field),
                format!("{field} is {value}: it must be {expected}"),
                ADVICE,
            );
        }
        (values.filter(|_| report.findings.is_empty()), report.findings)
    }

    fn problem(&self) -> Option<(&'static str, f64, &'static str)> {
        let outside =
            |values: &[f64], is_good: fn(f64) -> bool| values.iter().copied().find(|value| !is_good(*value));
        #[expect(clippy::cast_precision_loss, reason = "pixels")]
        let sides = self.size.map(|side| side as f64);
        let tilt = |tilt: f64| tilt.abs() < 1.5;
        [
            ("size", outside(&sides, |side| (16.0..=4096.0).contains(&side)), "from 16 to 4096"),
            ("focal", outside(&[self.focal], |focal| focal.is_finite() && focal > 0.0), "above 0 [px]"),
            ("principal", outside(&self.principal, f64::is_finite), "finite"),
            ("position", outside(&self.position, f64::is_finite), "finite"),
            ("tilt", outside(&[self.tilt], tilt), "between −1.5 and 1.5 [rad]"),
        ]
        .into_iter()
        .find_map(|(field, value, expected)| Some((field, value?, expected)))
    }

    /// Pose of the camera frame in the hand frame. Without tilt the image's right is the hand's y and the
    /// image's up the hand's x.
    pub fn mount(&self) -> Isometry3<f64> {
        let (sin, cos) = (libm::sin(self.tilt), libm::cos(self.tilt));
        let axes = Matrix3::new(0.0, -cos, -sin, 1.0, 0.0, 0.0, 0.0, -sin, cos);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Isometry3::from_parts(Translation3::from(self.position), rotation)
    }
}
