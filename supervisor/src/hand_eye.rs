//! Calibration of a camera in the hand, from circles: one round plate, such as the rose of a door knob, is
//! seen from many postures of the hand. Knob §4.5 measures a table of how a rose straight in front of the
//! hand appears to the camera; here the camera itself is estimated, and the [`HandEyeTable`] computed from
//! it.
//!
//! Unknown are the camera's position and rotation in the hand, its focal length, the position of the rose and
//! the direction of its axis. Each picture gives three numbers: centre and radius of the ellipse that is the
//! image of the rose's rim. A pinhole camera with square pixels and no distortion is assumed, with a known
//! principal point.
//!
//! The sum of squares is minimised by Levenberg–Marquardt (Moré 1978) from several starts, because nothing
//! need be known about the camera except that it sees the rose; first with Cauchy's weight, narrower in each
//! round, so that wrong circles have little weight; then without the rows that do not fit.

mod solve;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;

use std::fmt::{self, Write as _};

use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use tesaki::vision::{HandEyeError, HandEyeRow, HandEyeTable};

/// Minimum number of rows.
pub const MIN_ROWS: usize = 6;
/// Largest fraction of rows that may not fit.
const MAX_REJECTED: f64 = 0.4;
/// Largest standard deviation of a circle, relative to the focal length: 20 mrad.
const MAX_NOISE: f64 = 0.02;
/// Smallest standard deviation that is assumed for a circle [px].
const LEAST_NOISE: f64 = 0.1;
/// Largest standard deviation of a position computed from the table [m].
pub const MAX_DEVIATION: f64 = 0.005;
/// Number of rows of a table.
const TABLE_ROWS: usize = 8;

/// An observation of a rose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Origin of the hand frame in a frame in which the rose is at rest, such as the robot's base [m].
    pub position: [f64; 3],
    /// Orientation of the hand frame there: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Centre of the ellipse that is the image of the rim [px].
    pub center: [f64; 2],
    /// Square root of the product of its semi-axes [px].
    pub radius: f64,
}

/// Known quantities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeSettings {
    /// Radius of the rose's front rim [m].
    pub rose: f64,
    /// Width and height of the pictures [px].
    pub size: [u32; 2],
    /// Intersection of the optical axis with the picture [px].
    pub principal: [f64; 2],
    /// Focal lengths from which the search starts [px]: the true one must be within a factor of two of one of
    /// them.
    pub focal: [f64; 2],
    /// Smallest and largest distance in the table [m].
    pub distances: [f64; 2],
}

/// A camera in the hand; also used for the standard deviations of its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeCamera {
    /// Optical centre in the hand frame [m].
    pub position: [f64; 3],
    /// Rotation of the optical axis from the approach direction, about the hand's y towards the hand's axis
    /// [rad].
    pub tilt: f64,
    /// Rotation of the optical axis towards the hand's y, after the tilt [rad].
    pub pan: f64,
    /// Direction in which a rose that moves along the hand's y moves in the picture, from the picture's x
    /// towards its y [rad].
    pub turn: f64,
    /// Focal length [px].
    pub focal: f64,
}

/// The rose in the frame of the [`Observation`]s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rose {
    /// Centre of its front rim [m].
    pub center: [f64; 3],
    /// Unit vector along its axis, away from the hand.
    pub normal: [f64; 3],
}

/// Appearance of a rose in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Centre of the ellipse [px].
    pub center: [f64; 2],
    /// Square root of the product of its semi-axes [px].
    pub radius: f64,
    /// Vanishing point of its axis [px].
    pub axis: [f64; 2],
}

/// The result of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEye {
    /// The settings.
    pub settings: HandEyeSettings,
    /// The camera.
    pub camera: HandEyeCamera,
    /// Standard deviations of its values.
    pub deviation: HandEyeCamera,
    /// The rose.
    pub rose: Rose,
    /// Standard deviation of its position along each axis [m].
    pub rose_deviation: [f64; 3],
    /// Root mean square of the errors of the centres, and of the radii [px].
    pub residuals: [f64; 2],
    /// Number of circles that fit.
    pub used: usize,
    /// Indices of the rows that do not fit, and the errors of their circles [px].
    pub rejected: Vec<(usize, f64)>,
    /// Largest standard deviation of a position computed from the table [m].
    pub table_deviation: f64,
    /// The table.
    pub rows: Vec<HandEyeRow>,
}

/// A motion of the hand, along or about the axes of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Along z, the approach direction.
    Approach,
    /// Along y.
    Sideways,
    /// Along x.
    Upwards,
    /// About x.
    AboutX,
    /// About y.
    AboutY,
    /// About z.
    AboutZ,
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Approach => "nearer to the rose and farther from it",
            Self::Sideways => "moved sideways along its y",
            Self::Upwards => "moved along its x",
            Self::AboutX => "turned about its x",
            Self::AboutY => "turned about its y",
            Self::AboutZ => "turned about its approach z",
        })
    }
}

/// Reasons why the calibration failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HandEyeFailure {
    /// A setting that is out of its range.
    #[error("{name} is {value}; it must be {least} to {most}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// The value.
        value: f64,
        /// Smallest allowed value.
        least: f64,
        /// Largest allowed value.
        most: f64,
    },
    /// A row that is impossible.
    #[error("{problem}")]
    Row {
        /// Its index.
        row: usize,
        /// The problem.
        problem: String,
    },
    /// Too few rows.
    #[error("{got} circles: at least {MIN_ROWS} are needed, and some 30 are good")]
    TooFew {
        /// Their number.
        got: usize,
    },
    /// The rows contradict each other.
    #[error(
        "the circles do not fit one rose that stands still: {noise:.1} px off (root mean square), and {rejected} of {of} \
         left out; are positions in metres, quaternions x, y, z, w, pixels square, the radius of the rose and the size of the \
         picture right?"
    )]
    NoFit {
        /// Rows that do not fit the others.
        rejected: usize,
        /// Number of all rows.
        of: usize,
        /// Standard deviation of the others [px].
        noise: f64,
    },
    /// The rows can be explained equally well by other cameras.
    #[error(
        "the postures do not determine the camera: the place of a rose would be uncertain by {:.0} mm, the limit is \
         {:.0} mm; add pictures{}",
        1e3 * deviation, 1e3 * MAX_DEVIATION, list(motions)
    )]
    Undetermined {
        /// Standard deviation of a position computed from the table [m].
        deviation: f64,
        /// Missing motions, the most useful one first.
        motions: Vec<Motion>,
    },
    /// The camera does not see the rose at a distance in the table.
    #[error(
        "the camera does not see a rose that is {distance} m straight before the hand: choose other distances"
    )]
    Unseen {
        /// The distance [m].
        distance: f64,
    },
    /// The table cannot be created.
    #[error(transparent)]
    Table(#[from] HandEyeError),
}

fn list(motions: &[Motion]) -> String {
    let motions: Vec<String> = motions.iter().map(ToString::to_string).collect();
    if motions.is_empty() { String::new() } else { format!(" with the hand {}", motions.join(", ")) }
}

/// Estimates camera and rose. The order of the observations does not matter; a few percent of them may show a
/// different circle.
///
/// # Errors
/// [`HandEyeFailure`]: an invalid setting or row, rows that contradict each other, or a lack of motion.
pub fn calibrate(
    observations: &[Observation],
    settings: &HandEyeSettings,
) -> Result<HandEye, HandEyeFailure> {
    settings.check()?;
    let hands = observations
        .iter()
        .enumerate()
        .map(|(row, observation)| observation.hand().map_err(|problem| HandEyeFailure::Row { row, problem }));
    let hands: Vec<Isometry3<f64>> = hands.collect::<Result<_, _>>()?;
    if observations.len() < MIN_ROWS {
        return Err(HandEyeFailure::TooFew { got: observations.len() });
    }
    solve::Problem::new(observations, hands, settings).solve()
}

impl Observation {
    /// Pose of the hand.
    fn hand(&self) -> Result<Isometry3<f64>, String> {
        if let Some(length) = self.position.iter().find(|length| length.is_nan() || length.abs() > 100.0) {
            return Err(format!("a position of {length} m: is it in metres?"));
        }
        let place = self.center.iter().find(|place| !(-1e4..=1e5).contains(*place));
        if let Some(place) = place {
            return Err(format!("a centre at {place} px: it must be -10000 to 100000 px"));
        }
        if !(1.0..=1e4).contains(&self.radius) {
            return Err(format!("a radius of {} px: it must be 1 to 10000 px", self.radius));
        }
        Ok(Isometry3::from_parts(Translation3::from(self.position), unit_quaternion(self.orientation)?))
    }
}

/// Returns the rotation of a quaternion x, y, z, w, or an error if its norm is not 1.
fn unit_quaternion(components: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::from(components);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() < 0.01 {
        Ok(UnitQuaternion::new_normalize(quaternion))
    } else {
        Err(format!("a quaternion of norm {norm:.4}: it must be 1"))
    }
}

impl HandEyeSettings {
    /// Settings for pictures of `size` pixels and a rose of radius `rose` [m]: principal point in the middle,
    /// any usual lens, distances of 0.02 to 0.3 m.
    #[must_use]
    pub fn for_pictures([width, height]: [u32; 2], rose: f64) -> Self {
        let [columns, rows] = [width, height].map(f64::from);
        Self {
            rose,
            size: [width, height],
            principal: [0.5 * (columns - 1.0), 0.5 * (rows - 1.0)],
            focal: [0.5 * columns, 1.5 * columns],
            distances: [0.02, 0.3],
        }
    }

    fn check(&self) -> Result<(), HandEyeFailure> {
        let [near, far] = self.distances;
        let [u, v] = self.principal;
        for (name, value, least, most) in [
            ("the radius of the rose [m]", self.rose, 0.005, 0.5),
            ("the principal point [px]", u, 0.0, 1e4),
            ("the principal point [px]", v, 0.0, 1e4),
            ("the focal length [px]", self.focal[0], 10.0, 1e5),
            ("the focal length [px]", self.focal[1], 10.0, 1e5),
            ("the smallest distance [m]", near, -1.0, 10.0),
            ("the largest distance [m]", far, near + 0.01, 10.0),
        ] {
            if !(least..=most).contains(&value) {
                return Err(HandEyeFailure::Setting { name, value, least, most });
            }
        }
        Ok(())
    }
}

impl HandEyeCamera {
    /// Pose of the camera frame in the hand frame: x right and y down in the picture, z along the optical
    /// axis. Without rotations, right in the picture is the hand's y, and up in the picture is the hand's x.
    fn mount(&self) -> Isometry3<f64> {
        let level = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
        let about = UnitQuaternion::from_axis_angle;
        let rotation = about(&Vector3::y_axis(), -self.tilt)
            * level
            * about(&Vector3::y_axis(), self.pan)
            * about(&Vector3::z_axis(), -self.turn);
        Isometry3::from_parts(Translation3::from(self.position), rotation)
    }

    /// Computes the appearance of a circle; `None` unless the whole circle is in front of the camera, and its
    /// plane is not seen edge-on. `center` and the unit vector `normal` are in the camera frame.
    ///
    /// The circle is the dual conic `K (r² (I − n nᵀ) − c cᵀ) Kᵀ` (Hartley and Zisserman, *Multiple View
    /// Geometry*, section 8.2.2); of an ellipse with centre `m` and semi-axes in `A` it is
    /// `[[A Aᵀ − m mᵀ, −m], [−mᵀ, −1]]`.
    fn image(
        &self,
        principal: [f64; 2],
        center: &Point3<f64>,
        normal: &Vector3<f64>,
        radius: f64,
    ) -> Option<Appearance> {
        let nearest = center.z - radius * (1.0 - normal.z * normal.z).max(0.0).sqrt();
        if nearest <= 1e-4 || normal.z.abs() < 1e-3 {
            return None;
        }
        let dual = radius * radius * (Matrix3::identity() - normal * normal.transpose())
            - center.coords * center.coords.transpose();
        let dual = dual / -dual.m33;
        let [x, y] = [-dual.m13, -dual.m23];
        let determinant = (dual.m11 + x * x) * (dual.m22 + y * y) - (dual.m12 + x * y).powi(2);
        let place = |x: f64, y: f64| [principal[0] + self.focal * x, principal[1] + self.focal * y];
        Some(Appearance {
            center: place(x, y),
            radius: self.focal * determinant.max(0.0).sqrt().sqrt(),
            axis: place(normal.x / normal.z, normal.y / normal.z),
        })
    }

    /// Creates a table for roses straight in front of the hand, with their axis along the approach direction,
    /// at distances that make the radii evenly spaced, the farthest first.
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "pixels and metres")]
    fn rows(&self, settings: &HandEyeSettings) -> Result<Vec<HandEyeRow>, HandEyeFailure> {
        let seen = |distance: f64| self.ahead(settings, distance).ok_or(HandEyeFailure::Unseen { distance });
        let [near, far] = settings.distances;
        let [least, most] = [seen(far)?.radius, seen(near)?.radius];
        let rows = (0..TABLE_ROWS).map(|row| {
            let radius = least + (most - least) * row as f64 / (TABLE_ROWS - 1) as f64;
            let share = (1.0 / radius - 1.0 / least) / (1.0 / most - 1.0 / least);
            let distance = far + share * (near - far);
            let Appearance { center, radius, .. } = seen(distance)?;
            let center = center.map(|place| place as f32);
            Ok(HandEyeRow { radius: radius as f32, center, distance: distance as f32 })
        });
        rows.collect()
    }

    /// Appearance of a rose straight in front of the hand.
    fn ahead(&self, settings: &HandEyeSettings, distance: f64) -> Option<Appearance> {
        let mount = self.mount();
        let center = mount.inverse_transform_point(&Point3::new(0.0, 0.0, distance));
        let normal = mount.inverse_transform_vector(&Vector3::z());
        self.image(settings.principal, &center, &normal, settings.rose)
    }
}

impl HandEye {
    /// The table that the control core uses.
    ///
    /// # Errors
    /// A value is out of its range.
    #[expect(clippy::cast_possible_truncation, reason = "radians and metres")]
    pub fn table(&self) -> Result<HandEyeTable, HandEyeError> {
        let HandEyeCamera { tilt, pan, turn, .. } = self.camera;
        HandEyeTable::try_new(
            self.settings.rose as f32,
            [tilt, pan, turn].map(|angle| angle as f32),
            &self.rows,
        )
    }

    /// Formats camera, rose and residuals as lines of text, with standard deviations.
    pub fn summary(&self) -> String {
        let line = |name: &str, values: [f64; 3], deviations: [f64; 3]| {
            let one = |(value, deviation): (f64, f64)| format!("{value:.4} ±{deviation:.4}");
            let [x, y, z] = [0, 1, 2].map(|axis| one((values[axis], deviations[axis])));
            format!("{name} ({x}, {y}, {z})")
        };
        let (camera, deviation) = (&self.camera, &self.deviation);
        let mut text = line("camera: position", camera.position, deviation.position) + " m in the hand\n";
        for (name, value, deviation) in [
            ("tilt", camera.tilt, deviation.tilt),
            ("pan", camera.pan, deviation.pan),
            ("turn", camera.turn, deviation.turn),
        ] {
            let _ = writeln!(text, "  {name} {value:.4} ±{deviation:.4} rad");
        }
        let _ = writeln!(text, "  focal length {:.2} ±{:.2} px", camera.focal, deviation.focal);
        text += &line("rose: at", self.rose.center, self.rose_deviation);
        let [center, radius] = self.residuals;
        let _ = writeln!(
            text,
            " m\n{} circles fit: centre {center:.2} px, radius {radius:.2} px off (root mean square); {} do not\n\
             places before the hand: ±{:.1} mm",
            self.used,
            self.rejected.len(),
            1e3 * self.table_deviation
        );
        text
    }

    /// Returns the content of a `hand_eye.toml`, which [`tesaki_description::hand_eye`] reads. `source`
    /// states the origin of the circles in one line.
    pub fn to_toml(&self, source: &str) -> String {
        let mut text =
            String::from("# What the camera in the hand sees of a rose straight before the hand.\n");
        let _ = writeln!(text, "# By `tesaki calibrate camera` from {}:", source.escape_debug());
        for line in self.summary().lines() {
            let _ = writeln!(text, "# {line}");
        }
        let HandEyeCamera { tilt, pan, turn, .. } = self.camera;
        let _ = writeln!(text, "\nrose = {:?} # m", self.settings.rose);
        let _ = writeln!(text, "tilt = {tilt:.6} # rad");
        let _ = writeln!(text, "pan = {pan:.6} # rad");
        let _ = writeln!(text, "turn = {turn:.6} # rad");
        let _ = writeln!(text, "size = {:?} # px", self.settings.size);
        text += "# Radius, u and v of the centre [px], distance from the hand [m].\nrows = [\n";
        for HandEyeRow { radius, center: [u, v], distance } in &self.rows {
            let _ = writeln!(text, "  [{radius:.4}, {u:.4}, {v:.4}, {distance:.6}],");
        }
        text + "]\n"
    }

    /// Returns the appearance of the rose from a pose of the hand, as in [`Observation`]; `None` if the
    /// camera does not see it, or the quaternion is invalid.
    pub fn appearance(&self, position: [f64; 3], orientation: [f64; 4]) -> Option<Appearance> {
        let rotation = unit_quaternion(orientation).ok()?;
        let hand = Isometry3::from_parts(Translation3::from(position), rotation);
        seen(&self.settings, &self.camera, &self.rose, &hand)
    }
}

/// Computes the appearance of the rose from a pose of the hand.
fn seen(
    settings: &HandEyeSettings,
    camera: &HandEyeCamera,
    rose: &Rose,
    hand: &Isometry3<f64>,
) -> Option<Appearance> {
    let pose = hand * camera.mount();
    let center = pose.inverse_transform_point(&Point3::from(rose.center));
    let normal = pose.inverse_transform_vector(&Vector3::from(rose.normal));
    camera.image(settings.principal, &center, &normal, settings.rose)
}
