//! Where the rose is, from all pictures so far.

use nalgebra::{Isometry3, Matrix3, Matrix3x4, Matrix4, Point3, Vector3, Vector4};

use crate::math::{abs, sqrt};
use crate::vision::{Circle, CircleSearch, HandEyeTable, Window};

/// Standard deviation of a circle's centre and of its radius [px], and of what the table makes of them [m].
const CENTER_ERROR: f32 = 2.0;
const RADIUS_ERROR: f32 = 1.0;
const TABLE_ERROR: f32 = 1e-3;
/// Standard deviation of the length of the knob [m], and of the direction of its axis [rad].
const LENGTH_ERROR: f32 = 4e-3;
const AXIS_ERROR: f32 = 0.04;
/// Standard deviation by which the place of the rose, as the arm's angles tell it, and its radius change from
/// picture to picture [m]: the arm gives way, and errors of successive pictures are alike.
const PLACE_CHANGE: f32 = 1e-3;
const RADIUS_CHANGE: f32 = 1e-4;
/// A circle is another one beyond this many standard deviations.
const GATE: f32 = 4.0;
/// Of what earlier pictures cost, this share counts after a further one.
const MEMORY: f32 = 0.98;
/// Of the search: least reach of its window [px], and how far the axis of the knob may be off the approach
/// [rad].
const LEAST_REACH: f32 = 12.0;
const AXIS_REACH: f32 = 0.07;

/// What is known of the knob before the first picture. Distances and lengths are along the approach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnobExpectation {
    /// Radius of the rose, from … to [m].
    pub rose: [f32; 2],
    /// Radius of the knob's end [m].
    pub radius: f32,
    /// From the rim of the rose to the rim of the knob's end [m].
    pub length: f32,
    /// Distance of the rose from the origin of the hand frame, from … to [m].
    pub distance: [f32; 2],
    /// How far it may be aside, along x and y of the hand frame [m].
    pub aside: f32,
}

/// The circles of a knob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rim {
    /// Of the rose.
    Rose,
    /// Of the knob's end.
    Knob,
}

/// Place and radius of a rose: an extended Kalman filter over the pictures of a camera that moves.
///
/// One picture tells the place only for a known radius (Knob §4.5). As the hand comes nearer, the growth of
/// the radius in the image tells the radius of the rose, which differs from door to door. A circle that fits
/// the end of the knob better than the rose is taken for that.
#[derive(Clone, Debug)]
pub struct RoseEstimate {
    /// Centre of its front rim in the base frame, and radius [m].
    mean: Vector4<f32>,
    covariance: Matrix4<f32>,
    /// Squared deviations of the circles so far, in standard deviations.
    cost: f32,
}

/// A circle as a measurement of the place.
struct Measurement {
    /// Measured less estimated place [m].
    innovation: Vector3<f32>,
    /// How the measured place depends on the state.
    slope: Matrix3x4<f32>,
    /// Inverse covariance of the innovation.
    weight: Matrix3<f32>,
    /// Square of the innovation, in standard deviations.
    square: f32,
}

impl RoseEstimate {
    /// As expected before a hand at `hand` in the base frame.
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

    /// How badly the circles of late fit: their squared deviations, in standard deviations.
    pub const fn cost(&self) -> f32 {
        self.cost
    }

    /// Standard deviation of the place along a direction of the base frame [m].
    pub fn deviation(&self, direction: &Vector3<f32>) -> f32 {
        let covariance: Matrix3<f32> = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        sqrt((direction.transpose() * covariance * direction).x.max(0.0))
    }

    /// What to look for in a picture from `hand`.
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
        let reach = (3.0 * scale * x.max(y)).max(LEAST_REACH);
        // The radius in the image follows from radius and distance, whose errors belong together.
        let nearer = [place[0], place[1], place[2] - 3.0 * z];
        let farther = [place[0], place[1], place[2] + 3.0 * z];
        let [small, large] = expectation.rose;
        let least = table.appearance(&farther, self.radius().max(small)).1.min(0.85 * radius);
        let most = table.appearance(&nearer, self.radius().min(large)).1.max(1.15 * radius);
        let axis = table.vanishing_point();
        CircleSearch {
            radius: [least, most],
            window: Some(Window { center, reach }),
            axis: Some(Window { center: axis, reach: AXIS_REACH * table.focal_length() }),
        }
    }

    /// Takes a circle in a picture from `hand` for the rim that it fits better. Returns it; `None` if it fits
    /// neither, and nothing but the cost changes.
    pub fn update(
        &mut self,
        table: &HandEyeTable,
        expectation: &KnobExpectation,
        hand: &Isometry3<f32>,
        circle: &Circle,
    ) -> Option<Rim> {
        let rims =
            [Rim::Rose, Rim::Knob].map(|rim| (rim, self.measure(table, expectation, hand, circle, rim)));
        let [(_, Some(rose)), (_, Some(knob))] = &rims else { return None };
        let (rim, best) = if knob.square < rose.square { (Rim::Knob, knob) } else { (Rim::Rose, rose) };
        // Nor a circle that is no number.
        let fits = best.square < GATE * GATE;
        self.cost = MEMORY * self.cost + if fits { best.square } else { GATE * GATE };
        fits.then(|| {
            self.correct(best);
            rim
        })
    }

    /// Takes a circle for this rim, whether it fits or not.
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
        // How the distance changes with the radius in the image.
        let larger = Circle { radius: circle.radius * 1.02, ..*circle };
        let nearer = table.locate(circle, radius)[2] - table.locate(&larger, radius)[2];
        let mut depth = abs(nearer) / (0.02 * circle.radius) * RADIUS_ERROR + TABLE_ERROR;
        let mut aside = radius / circle.radius * CENTER_ERROR + TABLE_ERROR;
        let located = |radius: f32| hand * Point3::from(table.locate(circle, radius));
        // The located place minus the true one is noise; as a function of the state it is place −
        // located(radius).
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
        Some(Measurement { innovation, slope, weight, square })
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

/// A covariance with these standard deviations along the axes of the hand, in the base frame.
fn in_base(hand: &Isometry3<f32>, deviation: &Vector3<f32>) -> Matrix3<f32> {
    let turn = hand.rotation.to_rotation_matrix();
    turn.matrix() * Matrix3::from_diagonal(&deviation.component_mul(deviation)) * turn.matrix().transpose()
}
