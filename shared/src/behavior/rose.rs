//! Estimate of the rose from all pictures so far.

use nalgebra::{Isometry3, Matrix3, Matrix3x4, Matrix4, Point3, Vector3, Vector4};

use crate::math::{abs, sqrt};
use crate::vision::{Circle, CircleSearch, HandEyeTable, Window};

/// Standard deviations of a circle's centre and radius [px], and of the table [m].
const CENTER_ERROR: f32 = 2.0;
const RADIUS_ERROR: f32 = 1.0;
const TABLE_ERROR: f32 = 1e-3;
/// Standard deviation of the length of the knob [m], and of the direction of its axis [rad].
const LENGTH_ERROR: f32 = 4e-3;
const AXIS_ERROR: f32 = 0.04;
/// Process noise per circle that fits: standard deviations of the position of the rose relative to the arm
/// and of its radius [m]. The arm is compliant, and errors of successive pictures are correlated.
const PLACE_CHANGE: f32 = 1e-3;
const RADIUS_CHANGE: f32 = 1e-4;
/// Gate: beyond this many standard deviations a circle is rejected.
const GATE: f32 = 4.0;
/// Forgetting factor per picture of the cost of earlier pictures.
const MEMORY: f32 = 0.98;
/// Minimum reach of the search window [px], and maximum angle between the axis of the knob and the approach
/// direction [rad].
const MIN_REACH: f32 = 12.0;
const AXIS_REACH: f32 = 0.07;

/// Prior knowledge of the knob before the first picture. Distances and lengths are along the approach
/// direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnobExpectation {
    /// Radius of the rose, minimum and maximum [m].
    pub rose: [f32; 2],
    /// Radius of the knob's end [m].
    pub radius: f32,
    /// Length from the rim of the rose to the rim of the knob's end [m].
    pub length: f32,
    /// Distance of the rose from the origin of the hand frame, minimum and maximum [m].
    pub distance: [f32; 2],
    /// Maximum offset of the rose along x and y of the hand frame [m].
    pub aside: f32,
}

/// The circles of a knob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rim {
    /// That of the rose.
    Rose,
    /// That of the knob's end.
    Knob,
}

/// Position and radius of a rose: an extended Kalman filter over the pictures of a moving camera.
///
/// One picture determines the position only for a known radius (Knob §4.5). As the hand approaches, the
/// growth of the radius in the image determines the radius of the rose, which differs from door to door. A
/// circle that fits the end of the knob better than the rose is attributed to that end.
#[derive(Clone, Debug)]
pub struct RoseEstimate {
    /// Centre of its front rim in the base frame, and radius [m].
    mean: Vector4<f32>,
    covariance: Matrix4<f32>,
    /// Sum of the squared deviations of the circles so far, in standard deviations, with forgetting.
    cost: f32,
}

/// A circle as a measurement of the position.
struct Measurement {
    /// Measured minus estimated position [m].
    innovation: Vector3<f32>,
    /// Measurement matrix: Jacobian with respect to the state.
    slope: Matrix3x4<f32>,
    /// Inverse covariance of the innovation.
    weight: Matrix3<f32>,
    /// Square of the innovation, in standard deviations.
    square: f32,
}

impl RoseEstimate {
    /// The prior estimate in front of a hand at `hand` in the base frame.
    pub fn expected(expectation: &KnobExpectation, hand: &Isometry3<f32>) -> Self {
        let [near, far] = expectation.distance;
        let [small, large] = expectation.rose;
        let place = hand * Point3::new(0.0, 0.0, 0.5 * (near + far));
        let deviation = Vector3::new(expectation.aside, expectation.aside, 0.3 * (far - near));
        let mut covariance = Matrix4::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&in_base(hand, &deviation));
        covariance.m44 = 0.09 * (large - small) * (large - small);
        let mean = Vector4::new(place.x, place.y, place.z, 0.5 * (small + large));
        Self { mean, covariance, cost: 0.0 }
    }

    /// Centre of the front rim in the base frame [m].
    pub fn place(&self) -> Point3<f32> {
        Point3::new(self.mean.x, self.mean.y, self.mean.z)
    }

    /// Radius [m].
    pub fn radius(&self) -> f32 {
        self.mean.w
    }

    /// Misfit of the recent circles: sum of their squared deviations, in standard deviations.
    pub const fn cost(&self) -> f32 {
        self.cost
    }

    /// Standard deviation of the position along a direction of the base frame [m].
    pub fn deviation(&self, direction: &Vector3<f32>) -> f32 {
        let covariance: Matrix3<f32> = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        sqrt((direction.transpose() * covariance * direction).x.max(0.0))
    }

    /// The circle to search for in a picture from `hand`.
    pub fn search(
        &self,
        table: &HandEyeTable,
        expectation: &KnobExpectation,
        hand: &Isometry3<f32>,
    ) -> CircleSearch {
        let place: [f32; 3] = hand.inverse_transform_point(&self.place()).coords.into();
        let (center, radius) = table.appearance(&place, self.radius());
        let scale = radius / self.radius();
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| self.deviation(&(hand * axis)));
        let reach = (3.0 * scale * x.max(y)).max(MIN_REACH);
        // The radius in the image depends on radius and distance, whose errors are correlated.
        let nearer = [place[0], place[1], place[2] - 3.0 * z];
        let farther = [place[0], place[1], place[2] + 3.0 * z];
        let [small, large] = expectation.rose;
        let min = table.appearance(&farther, self.radius().max(small)).1.min(0.85 * radius);
        let max = table.appearance(&nearer, self.radius().min(large)).1.max(1.15 * radius);
        let axis = table.vanishing_point();
        CircleSearch {
            radius: [min, max],
            window: Some(Window { center, reach }),
            axis: Some(Window { center: axis, reach: AXIS_REACH * table.focal_length() }),
        }
    }

    /// Corrects the estimate by a circle in a picture from `hand`, as the rim that it fits better. Returns
    /// that rim; `None` if it fits neither: then only the cost changes.
    pub fn update(
        &mut self,
        table: &HandEyeTable,
        expectation: &KnobExpectation,
        hand: &Isometry3<f32>,
        circle: &Circle,
    ) -> Option<Rim> {
        let rims =
            [Rim::Rose, Rim::Knob].map(|rim| (rim, self.measure(table, expectation, hand, circle, rim)));
        let fitting = rims.into_iter().filter_map(|(rim, found)| {
            found.filter(|found| found.square < GATE * GATE).map(|found| (rim, found))
        });
        let best = fitting.reduce(|one, other| if other.1.square < one.1.square { other } else { one });
        self.cost = MEMORY * self.cost + best.as_ref().map_or(GATE * GATE, |(_, found)| found.square);
        best.map(|(rim, found)| {
            self.correct(&found);
            rim
        })
    }

    /// Corrects the estimate by a circle as this rim, whether it fits or not.
    pub fn assume(
        &mut self,
        table: &HandEyeTable,
        expectation: &KnobExpectation,
        hand: &Isometry3<f32>,
        circle: &Circle,
        rim: Rim,
    ) {
        if let Some(measurement) = self.measure(table, expectation, hand, circle, rim) {
            self.cost += measurement.square;
            self.correct(&measurement);
        }
    }

    fn measure(
        &self,
        table: &HandEyeTable,
        expectation: &KnobExpectation,
        hand: &Isometry3<f32>,
        circle: &Circle,
        rim: Rim,
    ) -> Option<Measurement> {
        let radius = if rim == Rim::Rose { self.radius() } else { expectation.radius };
        // Sensitivity of the distance to the radius in the image.
        let larger = Circle { radius: circle.radius * 1.02, ..*circle };
        let nearer = table.locate(circle, radius)[2] - table.locate(&larger, radius)[2];
        let mut depth = abs(nearer) / (0.02 * circle.radius) * RADIUS_ERROR + TABLE_ERROR;
        let mut aside = radius / circle.radius * CENTER_ERROR + TABLE_ERROR;
        let located = |radius: f32| hand * Point3::from(table.locate(circle, radius));
        // Implicit measurement: position − located(radius) is zero but for noise, and `slope` is its
        // Jacobian.
        let mut slope = Matrix3x4::zeros();
        slope.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        let measured = if rim == Rim::Rose {
            let change = 0.02 * radius;
            let sensitivity = (located(radius + change) - located(radius - change)) / (2.0 * change);
            slope.set_column(3, &-sensitivity);
            located(radius)
        } else {
            depth += LENGTH_ERROR;
            aside += AXIS_ERROR * expectation.length;
            located(radius) + hand * Vector3::z() * expectation.length
        };
        let innovation = measured - self.place();
        let noise = in_base(hand, &Vector3::new(aside, aside, depth));
        let predicted = slope * self.covariance * slope.transpose() + noise;
        let weight = predicted.try_inverse()?;
        let square = (innovation.transpose() * weight * innovation).x;
        // A circle of no size would be infinitely far away.
        square.is_finite().then_some(Measurement { innovation, slope, weight, square })
    }

    fn correct(&mut self, measurement: &Measurement) {
        let Measurement { innovation, slope, weight, .. } = measurement;
        let gain = self.covariance * slope.transpose() * weight;
        self.mean += gain * innovation;
        let covariance = (Matrix4::identity() - gain * slope) * self.covariance;
        let change = [PLACE_CHANGE, PLACE_CHANGE, PLACE_CHANGE, RADIUS_CHANGE].map(|change| change * change);
        self.covariance =
            (covariance + covariance.transpose()) * 0.5 + Matrix4::from_diagonal(&Vector4::from(change));
    }
}

/// Covariance in the base frame for standard deviations along the axes of the hand.
fn in_base(hand: &Isometry3<f32>, deviation: &Vector3<f32>) -> Matrix3<f32> {
    let turn = hand.rotation.to_rotation_matrix();
    turn.matrix() * Matrix3::from_diagonal(&deviation.component_mul(deviation)) * turn.matrix().transpose()
}
