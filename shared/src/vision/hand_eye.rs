use core::fmt;

use heapless::Vec;

use super::Circle;
use crate::{OutOfRange, math};

/// Maximum number of rows of a [`HandEyeTable`].
pub const MAX_HAND_EYE_ROWS: usize = 16;

/// Appearance of a rose straight in front of the hand at one distance.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HandEyeRow {
    /// Radius of its front rim in the image [px], see [`Circle::radius`].
    pub radius: f32,
    /// Centre of the rim in the image [px], see [`Circle::center`].
    pub center: [f32; 2],
    /// Distance of the rim's plane from the origin of the hand frame, along the approach direction [m].
    pub distance: f32,
}

/// Appearance of a rose straight in front of the hand in the hand-eye camera: a table from the radius in the
/// image to the position of its centre (Knob §4.5) and to its distance.
///
/// The approach direction is the hand frame's z, the image's right nearly its y, the image's up nearly its x.
/// Between rows the centre is interpolated linearly in the radius, and the distance in the inverse radius.
/// This is exact for a pinhole camera, for which two rows suffice.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEyeTable {
    rose: f32,
    tilt: f32,
    pan: f32,
    turn: f32,
    rows: Vec<HandEyeRow, MAX_HAND_EYE_ROWS>,
}

/// Why a [`HandEyeTable`] is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HandEyeError {
    /// Wrong number of rows.
    Rows {
        /// Their number.
        got: usize,
    },
    /// A value that is out of its range.
    Value(OutOfRange),
    /// The radius does not increase from row to row, or the distance does not decrease.
    Order {
        /// Index of the row.
        row: usize,
    },
}

impl fmt::Display for HandEyeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Rows { got } => {
                write!(f, "the hand-eye table has {got} rows: it must have 2 to {MAX_HAND_EYE_ROWS}")
            }
            Self::Value(value) => write!(f, "hand-eye table: {value}"),
            Self::Order { row } => write!(
                f,
                "row {row} of the hand-eye table: from row to row the radius must grow and the distance shrink"
            ),
        }
    }
}

impl core::error::Error for HandEyeError {}

impl HandEyeTable {
    /// The table for a rose of radius `rose` [m] and a camera with this tilt, pan and turn [rad]. The tilt is
    /// the rotation of the optical axis from the approach, about the hand's y towards the hand's axis; the
    /// pan that about the image's y, towards the image's right; the turn the direction in the image in which
    /// the rose moves when it moves along the hand's y, from the image's x towards its y.
    ///
    /// # Errors
    /// The first value that is out of its range.
    pub fn try_new(
        rose: f32,
        [tilt, pan, turn]: [f32; 3],
        rows: &[HandEyeRow],
    ) -> Result<Self, HandEyeError> {
        let check = |name, value, range| OutOfRange::check(name, value, range).map_err(HandEyeError::Value);
        check("the radius of the rose [m]", rose, [0.005, 0.5])?;
        check("the tilt [rad]", tilt, [-1.2, 1.2])?;
        check("the pan [rad]", pan, [-1.2, 1.2])?;
        check("the turn [rad]", turn, [-3.2, 3.2])?;
        if rows.len() < 2 {
            return Err(HandEyeError::Rows { got: rows.len() });
        }
        for row in rows {
            check("a radius [px]", row.radius, [1.0, 4096.0])?;
            check("a distance [m]", row.distance, [-1.0, 10.0])?;
            row.center.into_iter().try_for_each(|place| check("a centre [px]", place, [-4096.0, 8192.0]))?;
        }
        let grows = |pair: &[HandEyeRow]| matches!(pair, [one, next] if next.radius > one.radius && next.distance < one.distance);
        if let Some(row) = rows.windows(2).position(|pair| !grows(pair)) {
            return Err(HandEyeError::Order { row: row + 1 });
        }
        let rows = Vec::from_slice(rows).map_err(|_| HandEyeError::Rows { got: rows.len() })?;
        Ok(Self { rose, tilt, pan, turn, rows })
    }

    /// Position in the hand frame [m] of the centre of a rose that appears as `circle`; `rose` is its radius
    /// [m].
    ///
    /// The displacement `(mx, my) = rose/R · (MX, MY)` of Knob §4.5 from the rose of the same radius straight
    /// in front of the hand is parallel to the image; it is rotated to the axes of the hand.
    pub fn locate(&self, circle: &Circle, rose: f32) -> [f32; 3] {
        let (center, distance) = self.at_radius(circle.radius * self.rose / rose);
        let scale = rose / circle.radius;
        let [right, down] = [0, 1].map(|axis| (circle.center[axis] - center[axis]) * scale);
        let (sin, cos) = math::sin_cos(self.turn);
        let (right, down) = (right * cos + down * sin, down * cos - right * sin);
        let (sin, cos) = math::sin_cos(self.pan);
        let (y, ahead) = (right * cos, -right * sin);
        let (sin, cos) = math::sin_cos(self.tilt);
        [-down * cos - ahead * sin, y, distance + ahead * cos - down * sin]
    }

    /// Centre and radius [px] in the image of a rose of radius `rose` [m] whose centre is at `place` in the
    /// hand frame [m]. The inverse of [`locate`](Self::locate).
    pub fn appearance(&self, place: &[f32; 3], rose: f32) -> ([f32; 2], f32) {
        let [x, y, z] = *place;
        let ((sin_tilt, cos_tilt), (sin_pan, cos_pan)) = (math::sin_cos(self.tilt), math::sin_cos(self.pan));
        // From the rose of the same depth straight in front of the hand: the way in between is across the
        // optical axis (−cos(pan) sin(tilt), sin(pan), cos(pan) cos(tilt)).
        let ahead = (x * sin_tilt - y * sin_pan / cos_pan) / cos_tilt;
        let (center, radius) = self.at_distance(z - ahead);
        let radius = radius * rose / self.rose;
        let scale = radius / rose;
        let (down, depth) = (-x * cos_tilt - ahead * sin_tilt, ahead * cos_tilt - x * sin_tilt);
        let right = y * cos_pan - depth * sin_pan;
        let (sin, cos) = math::sin_cos(self.turn);
        let [right, down] = [right * cos - down * sin, down * cos + right * sin];
        ([center[0] + right * scale, center[1] + down * scale], radius)
    }

    /// Vanishing point of the approach direction in the image [px]: the limit of a distant rose straight in
    /// front of the hand.
    pub fn vanishing_point(&self) -> [f32; 2] {
        let [one, next] = self.segment(|_| false);
        between(one.center, next.center, -one.radius / (next.radius - one.radius))
    }

    /// Focal length [px], from the outermost rows.
    pub fn focal_length(&self) -> f32 {
        let [one, ..] = self.segment(|_| false);
        let [_, last] = self.segment(|_| true);
        let [tilt, pan] = [self.tilt, self.pan].map(|angle| math::sin_cos(angle).1);
        (one.distance - last.distance) * tilt * pan / (self.rose * (1.0 / one.radius - 1.0 / last.radius))
    }

    /// Centre [px] and distance [m] of a rose of the table's radius that appears with `radius` [px].
    fn at_radius(&self, radius: f32) -> ([f32; 2], f32) {
        let [one, next] = self.segment(|row| row.radius < radius);
        let part = (radius - one.radius) / (next.radius - one.radius);
        // Linear in the inverse radius.
        let share = part * next.radius / radius;
        (between(one.center, next.center, part), one.distance + share * (next.distance - one.distance))
    }

    /// Centre and radius [px] of a rose of the table's radius at `distance` [m].
    fn at_distance(&self, distance: f32) -> ([f32; 2], f32) {
        let [one, next] = self.segment(|row| row.distance > distance);
        let share = (distance - one.distance) / (next.distance - one.distance);
        let inverse = 1.0 / one.radius + share * (1.0 / next.radius - 1.0 / one.radius);
        // Behind the camera nothing is visible.
        let radius = 1.0 / inverse.max(1e-4);
        let part = (radius - one.radius) / (next.radius - one.radius);
        (between(one.center, next.center, part), radius)
    }

    /// The two rows around the first that is not `before`; at the ends, the outermost two.
    fn segment(&self, before: impl Fn(&HandEyeRow) -> bool) -> [HandEyeRow; 2] {
        let first = self.rows.iter().position(|row| !before(row)).unwrap_or(self.rows.len());
        let first = first.clamp(1, self.rows.len().max(2) - 1);
        let row = |index: usize| self.rows.get(index).copied().unwrap_or(NO_ROW);
        [row(first - 1), row(first)]
    }
}

/// Placeholder for a missing row. It is never used: a table has at least two rows.
const NO_ROW: HandEyeRow = HandEyeRow { radius: 1.0, center: [0.0; 2], distance: 0.0 };

fn between(one: [f32; 2], next: [f32; 2], part: f32) -> [f32; 2] {
    [0, 1].map(|axis| one[axis] + part * (next[axis] - one[axis]))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, Vector3};

    use super::*;

    /// The camera of robots/knob-arm: f = 140 px, 50 mm above the axis, 120 mm behind the fingertips, tilted
    /// by 10°.
    const TILT: f32 = 0.174_532_93;

    /// Centre and radius of the image of a small circle by that pinhole camera, computed directly.
    fn seen(place: [f32; 3], rose: f32) -> Circle {
        let (sin, cos) = (0.173_648_2, 0.984_807_8);
        let [x, y, z] = place;
        let (down, ahead) = (0.05 - x, z + 0.12);
        let depth = ahead * cos + down * sin;
        let below = down * cos - ahead * sin;
        let center = [127.5 + 140.0 * y / depth, 119.5 + 140.0 * below / depth];
        let radius = 140.0 * rose / depth;
        Circle { center, radius, semi_axes: [radius; 2], angle: 0.0, confidence: 1.0 }
    }

    fn table(rows: usize) -> HandEyeTable {
        let distance = |row: usize| 0.3 - 0.26 * row as f32 / (rows - 1) as f32;
        let rows: Vec<HandEyeRow, MAX_HAND_EYE_ROWS> = (0..rows)
            .map(|row| {
                let circle = seen([0.0, 0.0, distance(row)], 0.04);
                HandEyeRow { radius: circle.radius, center: circle.center, distance: distance(row) }
            })
            .collect();
        HandEyeTable::try_new(0.04, [TILT, 0.0, 0.0], &rows).expect("a valid table")
    }

    #[test]
    fn a_rose_anywhere_is_located_and_predicted() {
        for rows in [2, 9] {
            let table = table(rows);
            for rose in [0.035, 0.045] {
                for place in [[0.0, 0.0, 0.2], [0.05, -0.04, 0.22], [-0.03, 0.02, 0.1], [0.01, 0.0, 0.02]] {
                    let circle = seen(place, rose);
                    let located = table.locate(&circle, rose);
                    for axis in 0..3 {
                        assert!((located[axis] - place[axis]).abs() < 1e-5, "{rose} {place:?} {located:?}");
                    }
                    let (center, radius) = table.appearance(&place, rose);
                    let error = [center[0] - circle.center[0], center[1] - circle.center[1]];
                    assert!(error.iter().all(|error| error.abs() < 0.01), "{place:?}: {error:?} px");
                    assert!((radius - circle.radius).abs() < 0.01);
                }
            }
        }
    }

    #[test]
    fn focal_length_and_vanishing_point_are_those_of_the_camera() {
        for rows in [2, 9] {
            let table = table(rows);
            assert!((table.focal_length() - 140.0).abs() < 0.01, "{}", table.focal_length());
            // 140 tan 10° = 24.686 above the centre.
            let [x, y] = table.vanishing_point();
            assert!((x - 127.5).abs() < 1e-3 && (y - (119.5 - 24.686)).abs() < 0.01, "{x} {y}");
        }
    }

    #[test]
    fn a_turned_camera_is_taken_into_account() {
        let mut table = table(2);
        table.tilt = 0.0;
        let straight = table.locate(&seen([0.01, 0.02, 0.2], 0.04), 0.04);
        // The image rotated by 90° about the position of a rose straight ahead.
        table.turn = core::f32::consts::FRAC_PI_2;
        let mut circle = seen([0.01, 0.02, 0.2], 0.04);
        let (center, _) = table.at_radius(circle.radius);
        let [dx, dy] = [0, 1].map(|axis| circle.center[axis] - center[axis]);
        circle.center = [center[0] - dy, center[1] + dx];
        let turned = table.locate(&circle, 0.04);
        assert!((0..3).all(|axis| (turned[axis] - straight[axis]).abs() < 1e-5), "{turned:?} {straight:?}");
        let (center, _) = table.appearance(&turned, 0.04);
        assert!((0..2).all(|axis| (center[axis] - circle.center[axis]).abs() < 0.01));
    }

    /// A camera that is turned in every way sees small circles, through rotation matrices of nalgebra.
    #[test]
    fn a_camera_turned_in_every_way_locates_a_rose_anywhere() {
        for [tilt, pan, turn] in [[0.2, 0.35, 0.0], [0.2, -0.35, 0.5], [0.0, 0.6, -2.0], [-0.4, 0.2, 3.1]] {
            let about = Rotation3::from_axis_angle;
            let level = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
            let rotation = about(&Vector3::y_axis(), -tilt).matrix()
                * level
                * about(&Vector3::y_axis(), pan).matrix()
                * about(&Vector3::z_axis(), -turn).matrix();
            let seen = |place: [f32; 3], rose: f32| {
                let view = rotation.transpose() * (Vector3::from(place) - Vector3::new(0.05, -0.02, -0.12));
                let center = [127.5 + 140.0 * view.x / view.z, 119.5 + 140.0 * view.y / view.z];
                let radius = 140.0 * rose / view.z;
                Circle { center, radius, semi_axes: [radius; 2], angle: 0.0, confidence: 1.0 }
            };
            let row = |distance: f32| {
                let circle = seen([0.0, 0.0, distance], 0.04);
                HandEyeRow { radius: circle.radius, center: circle.center, distance }
            };
            let rows = [row(0.3), row(0.1), row(0.02)];
            let table = HandEyeTable::try_new(0.04, [tilt, pan, turn], &rows).expect("a valid table");
            assert!((table.focal_length() - 140.0).abs() < 0.01, "{}", table.focal_length());
            for place in [[0.0, 0.0, 0.2], [0.05, -0.04, 0.22], [-0.03, 0.04, 0.1]] {
                let circle = seen(place, 0.035);
                let located = table.locate(&circle, 0.035);
                assert!(
                    (0..3).all(|axis| (located[axis] - place[axis]).abs() < 1e-5),
                    "{place:?} {located:?}"
                );
                let (center, radius) = table.appearance(&place, 0.035);
                assert!((0..2).all(|axis| (center[axis] - circle.center[axis]).abs() < 0.01), "{center:?}");
                assert!((radius - circle.radius).abs() < 0.01, "{radius}");
            }
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let row = |radius, distance| HandEyeRow { radius, center: [0.0; 2], distance };
        let rows = [row(10.0, 0.3), row(20.0, 0.2), row(15.0, 0.1)];
        assert_eq!(HandEyeTable::try_new(0.04, [0.0; 3], &rows), Err(HandEyeError::Order { row: 2 }));
        let error = HandEyeTable::try_new(0.04, [0.0; 3], &rows[..1]);
        assert_eq!(error, Err(HandEyeError::Rows { got: 1 }));
        let error = HandEyeTable::try_new(f32::NAN, [0.0; 3], &rows);
        assert!(matches!(
            error,
            Err(HandEyeError::Value(OutOfRange { field: "the radius of the rose [m]", .. }))
        ));
    }
}
