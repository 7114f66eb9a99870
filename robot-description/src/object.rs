//! Files in `objects/` of a robot folder: what a simulated hand grasps.
//!
//! ```toml
//! shape = "box"                  # or "cylinder", { wedge = { top = 0.75 } }
//! size = [0.098, 0.208, 0.060]   # m
//! mass = 0.023                   # kg
//! friction = 0.6
//! friction_spread = 0.2          # a mismatched plant draws 0.4 to 0.8
//! ```

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use crate::file::{self, FileError};
use crate::finding::{Finding, Report};
use crate::plant::PlantProblem;
use crate::robot::LEAD;
use crate::urdf::four;

/// Name of the folder of such files in a robot folder.
pub const FOLDER: &str = "objects";
/// What to do about a key that cannot be used.
const ADVICE: &str = "correct it; robots/hand3/objects/box.toml is an example";

/// A free rigid body with its friction and support.
///
/// Its frame is in the middle of its extents. Position and orientation are in the frame of the base.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectValues {
    /// Its shape.
    pub shape: Shape,
    /// Extents along its x, y and z [m].
    pub size: [f64; 3],
    /// Mass, spread evenly [kg].
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
    /// Its support, until it is removed.
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

/// A fixed cuboid that carries the object. Fingertips pass through it.
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
    /// Reads a description and checks it.
    ///
    /// # Errors
    /// What is wrong, with line or key.
    pub fn from_toml(text: &str) -> Result<Self, FileError> {
        let (object, findings) = Self::check(Path::new("object"), text);
        object.ok_or(FileError::Wrong(findings))
    }

    /// Reads the file at `path`.
    ///
    /// # Errors
    /// It cannot be read, or what is wrong in it, with line and key.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        file::load(path, "", Self::check)
    }

    /// What is wrong with `text`, the content of `path`; the object when nothing is.
    pub fn check(path: &Path, text: &str) -> (Option<Self>, Vec<Finding>) {
        let mut report = Report::of_toml(path, text);
        let object = file::parse::<Self>(text, ADVICE, &mut report);
        if let Some(PlantProblem { field, value, expected }) = object.as_ref().and_then(|it| it.problem()) {
            let message = format!("{field} is {value}: it must be {expected}");
            let key = field.rsplit(' ').next().unwrap_or(&field);
            report.dynamics(report.line_of(key), message, ADVICE);
        }
        let object = object.filter(|_| report.findings.is_empty());
        if let Some(Self { size: [x, y, z], mass, .. }) =
            object.as_ref().filter(|object| object.density() > LEAD)
        {
            let message = format!("mass = {mass} kg in {x} × {y} × {z} m is denser than lead: grams?");
            let advice = format!("masses are in kg: {mass} g are {}", four(mass / 1000.0));
            report.warning(report.line_of("mass"), message, advice);
        }
        (object, report.findings)
    }

    /// The same object elsewhere: position [m] and orientation `[x, y, z, w]` in the frame of the base.
    #[must_use]
    pub const fn at(mut self, position: [f64; 3], orientation: [f64; 4]) -> Self {
        self.position = position;
        self.orientation = orientation;
        self
    }

    /// The same object on a support.
    #[must_use]
    pub const fn on(mut self, support: Support) -> Self {
        self.support = Some(support);
        self
    }

    /// Its mass by its volume [kg/m³].
    fn density(&self) -> f64 {
        let [x, y, z] = self.size;
        let share = match self.shape {
            Shape::Box => 1.0,
            Shape::Cylinder => core::f64::consts::FRAC_PI_4,
            Shape::Wedge { top } => 0.5 * (1.0 + top),
        };
        self.mass / (share * x * y * z)
    }

    /// Centre of mass [m] and inertia about it [kg·m²], in its own frame.
    pub fn inertia(&self) -> (Vector3<f64>, Matrix3<f64>) {
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

    /// The first value that no object can have, with its key.
    pub fn problem(&self) -> Option<PlantProblem> {
        const LENGTH: &str = "above 0 and below 10 m";
        let length = |value: f64| value > 0.0 && value < 10.0;
        let friction = self.friction;
        first("size", &self.size, length, LENGTH)
            .or_else(|| first("mass", &[self.mass], |mass| mass > 0.0 && mass.is_finite(), "above 0 [kg]"))
            .or_else(|| first("friction", &[friction], |it| it >= 0.0 && it.is_finite(), "at least 0"))
            .or_else(|| {
                let is_good = |spread: f64| (0.0..=friction).contains(&spread);
                first("friction_spread", &[self.friction_spread], is_good, "from 0 to friction")
            })
            .or_else(|| of_pose("", &self.position, &self.orientation))
            .or_else(|| {
                let Shape::Wedge { top } = self.shape else { return None };
                first("shape.wedge.top", &[top], |top| top > 0.0 && top <= 1.0, "above 0, at most 1")
            })
            .or_else(|| {
                let [x, y, _] = self.size;
                let is_good = |y: f64| self.shape != Shape::Cylinder || (y - x).abs() <= 1e-9;
                first("size", &[y], is_good, "the same along x and y for a cylinder")
            })
            .or_else(|| {
                let Support { size, position, orientation } = self.support.as_ref()?;
                first("support.size", size, length, LENGTH)
                    .or_else(|| of_pose("support.", position, orientation))
            })
    }
}

/// The first of the values of a key that is not good.
fn first(
    field: &str,
    values: &[f64],
    is_good: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Option<PlantProblem> {
    let value = values.iter().copied().find(|value| !is_good(*value))?;
    Some(PlantProblem { field: field.to_owned(), value, expected })
}

fn of_pose(table: &str, position: &[f64; 3], orientation: &[f64; 4]) -> Option<PlantProblem> {
    first(&format!("{table}position"), position, f64::is_finite, "finite [m]").or_else(|| {
        let square = orientation.iter().map(|part| part * part).sum::<f64>();
        let is_unit = |_| (square - 1.0).abs() < 1e-3;
        first(&format!("the length of {table}orientation"), &[libm::sqrt(square)], is_unit, "1")
    })
}
