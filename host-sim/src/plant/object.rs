//! Description of the object to be grasped.

use rapier3d::na::{Matrix3, Vector3};
use serde::Deserialize;

use super::error::{PlantError, check};

/// A free rigid body with its friction and support.
///
/// The origin of its frame is in the middle of its extents. Position and orientation are in the frame of the
/// base.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectValues {
    /// Its shape.
    pub shape: Shape,
    /// Extents along its x, y and z [m].
    pub size: [f64; 3],
    /// Mass, evenly distributed [kg].
    pub mass: f64,
    /// Coefficient of friction with fingertips and support.
    pub friction: f64,
    /// A mismatched plant draws the coefficient from `friction` ± this.
    #[serde(default)]
    pub friction_spread: f64,
    /// Initial position [m].
    #[serde(default)]
    pub position: [f64; 3],
    /// Initial orientation: a unit quaternion `[x, y, z, w]`.
    #[serde(default = "unturned")]
    pub orientation: [f64; 4],
    /// Its support, until [`super::Plant::remove_support`].
    #[serde(default)]
    pub support: Option<Support>,
}

/// Shape of an object.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Shape {
    /// A cuboid.
    Box,
    /// A cylinder along z; x and y extents are the same.
    Cylinder,
    /// A cuboid that is narrower at the top (+z): the faces across x lean inwards.
    Wedge {
        /// Width at the top as a fraction of that at the bottom.
        top: f64,
    },
}

/// A fixed cuboid that supports the object. Fingertips pass through it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Extents along its x, y and z [m].
    pub size: [f64; 3],
    /// Its centre in the base frame [m].
    pub position: [f64; 3],
    /// Its orientation: a unit quaternion `[x, y, z, w]`.
    #[serde(default = "unturned")]
    pub orientation: [f64; 4],
}

const fn unturned() -> [f64; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

impl ObjectValues {
    /// Reads and checks a description.
    ///
    /// # Errors
    /// The description is invalid; the error names the line or key.
    pub fn from_toml(text: &str) -> Result<Self, PlantError> {
        let values: Self = toml::from_str(text).map_err(|error| PlantError::Object(error.to_string()))?;
        values.validate()?;
        Ok(values)
    }

    /// Returns the same object elsewhere: position [m] and orientation `[x, y, z, w]` in the frame of the
    /// base.
    #[must_use]
    pub const fn at(mut self, position: [f64; 3], orientation: [f64; 4]) -> Self {
        self.position = position;
        self.orientation = orientation;
        self
    }

    /// Returns the same object on a support.
    #[must_use]
    pub const fn on(mut self, support: Support) -> Self {
        self.support = Some(support);
        self
    }

    /// Computes the centre of mass [m] and the inertia about it [kg·m²], in the object's frame.
    pub(super) fn inertia(&self) -> (Vector3<f64>, Matrix3<f64>) {
        let [x, y, z] = self.size;
        let (middle, mean) = match self.shape {
            Shape::Box => (0.0, [x * x / 12.0, y * y / 12.0, z * z / 12.0]),
            Shape::Cylinder => (0.0, [x * x / 16.0, x * x / 16.0, z * z / 12.0]),
            Shape::Wedge { top } => {
                // Simpson's rule over the height; exact for cubic polynomials.
                let slices = [(0.0, 1.0), (0.5, 4.0), (1.0, 1.0)];
                let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
                    slices.iter().map(|(up, fraction)| fraction * of(*up, x * (1.0 - (1.0 - top) * up))).sum()
                };
                let area = sum(&|_, width| width);
                let up = sum(&|up, width| up * width) / area;
                let high = sum(&|up, width| up * up * width) / area - up * up;
                let wide = sum(&|_, width| width * width * width / 12.0) / area;
                (z * (up - 0.5), [wide, y * y / 12.0, z * z * high])
            }
        };
        let [x, y, z] = mean.map(|square| self.mass * square);
        (Vector3::new(0.0, 0.0, middle), Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y)))
    }

    pub(super) fn validate(&self) -> Result<(), PlantError> {
        const LENGTH: &str = "above 0 and below 10 m";
        let length = |value: f64| value > 0.0 && value < 10.0;
        check("object.size", &self.size, length, LENGTH)?;
        check("object.mass", &[self.mass], |mass| mass > 0.0 && mass.is_finite(), "above 0 [kg]")?;
        check("object.friction", &[self.friction], |value| value >= 0.0 && value.is_finite(), "at least 0")?;
        let friction = self.friction;
        let spread = |value: f64| (0.0..=friction).contains(&value);
        check("object.friction_spread", &[self.friction_spread], spread, "from 0 to object.friction")?;
        check_pose("object", &self.position, &self.orientation)?;
        if let Shape::Wedge { top } = self.shape {
            check("object.shape.wedge.top", &[top], |top| top > 0.0 && top <= 1.0, "above 0, at most 1")?;
        }
        if self.shape == Shape::Cylinder {
            let [x, y, _] = self.size;
            check("object.size", &[y], |y| (y - x).abs() <= 1e-9, "the same along x and y for a cylinder")?;
        }
        if let Some(support) = &self.support {
            check("object.support.size", &support.size, length, LENGTH)?;
            check_pose("object.support", &support.position, &support.orientation)?;
        }
        Ok(())
    }
}

fn check_pose(item: &str, position: &[f64; 3], orientation: &[f64; 4]) -> Result<(), PlantError> {
    check(&format!("{item}.position"), position, f64::is_finite, "finite [m]")?;
    let norm = orientation.iter().map(|part| part * part).sum::<f64>();
    let unit = |norm: f64| (norm - 1.0).abs() < 1e-3;
    check(&format!("the square of {item}.orientation"), &[norm], unit, "1, as of a unit quaternion")
}
