//! Trajectories of the operator's hand and of the tool, sample by sample.

use std::ops::Range;

use rapier3d::na::Vector3;
use tesaki::kinematics::PosePoint;

use crate::operator::OperatorHandState;
use crate::report::Table;
use crate::scenario::arm::{ArmLog, ArmSample, YAW};
use crate::scenario::common::{T, during, largest};

/// Below this speed the hand reverses [m/s].
const REVERSAL_SPEED: f64 = 0.01;

/// State of the operator, and acceleration of the arm's set-point.
#[derive(Clone, Debug)]
struct OperatorSample {
    hand: Vector3<f64>,
    velocity: Vector3<f64>,
    elbow: f64,
    acceleration: f64,
}

/// One sample per tick of operator and arm.
pub struct Trace {
    from: f64,
    operator: Vec<OperatorSample>,
    samples: Vec<ArmSample>,
}

/// Operator and arm at the same time.
pub struct Moment<'a> {
    operator: &'a OperatorSample,
    sample: &'a ArmSample,
    /// Acceleration of the set-point [m/s²].
    pub acceleration: f64,
}

impl Moment<'_> {
    /// Position of the tool minus that of the hand [mm].
    pub fn error(&self) -> Vector3<f64> {
        (self.sample.position() - self.operator.hand) * 1e3
    }

    /// Set-point minus position of the hand [mm].
    pub fn prediction_error(&self) -> Vector3<f64> {
        (self.sample.target - self.operator.hand) * 1e3
    }

    /// Position of the tool minus set-point [mm].
    pub fn tracking_error(&self) -> Vector3<f64> {
        (self.sample.position() - self.sample.target) * 1e3
    }

    /// Shoulder yaw minus tilt of the operator's elbow [mrad].
    pub fn elbow_error(&self) -> f64 {
        (self.sample.joints[usize::from(YAW)] - self.operator.elbow) * 1e3
    }
}

impl Trace {
    /// An empty trace that begins at a time of the arm's log [s].
    pub fn new(from: f64) -> Self {
        Self { from, operator: Vec::new(), samples: Vec::new() }
    }

    /// Adds the operator's state and the set-point of a tick.
    pub fn push(&mut self, hand: &OperatorHandState, elbow: &[f64; 3], point: &PosePoint) {
        let [x, y, z, ..] = point.acceleration.map(f64::from);
        self.operator.push(OperatorSample {
            hand: hand.pose.translation.vector,
            velocity: hand.velocity,
            elbow: elbow[0],
            acceleration: Vector3::new(x, y, z).norm(),
        });
    }

    /// Adds the arm's log.
    pub fn add_arm_log(&mut self, mut log: ArmLog) {
        self.samples = log.0.split_off((self.from / T).round() as usize);
    }

    pub fn times(&self) -> Vec<f64> {
        (0..self.operator.len()).map(|tick| tick as f64 * T).collect()
    }

    fn all(&self) -> impl Iterator<Item = Moment<'_>> {
        let both = self.operator.iter().zip(&self.samples);
        both.map(|(operator, sample)| Moment { operator, sample, acceleration: operator.acceleration })
    }

    /// The moments of a time span [s]; none if it was not recorded to its end.
    fn during(&self, span: &Range<f64>) -> impl Iterator<Item = Moment<'_>> {
        let both = during(&self.operator, span).iter().zip(during(&self.samples, span));
        both.map(|(operator, sample)| Moment { operator, sample, acceleration: operator.acceleration })
    }

    /// The maximum of a value in a time span; NaN if it was not recorded to its end.
    pub fn largest(&self, span: &Range<f64>, value: impl Fn(&Moment<'_>) -> f64) -> f64 {
        largest(self.during(span).map(|moment| value(&moment)))
    }

    /// The largest error along x where the hand reverses [mm].
    pub fn reversals(&self, span: &Range<f64>) -> f64 {
        let reversing = self.during(span).filter(|moment| moment.operator.velocity.x.abs() < REVERSAL_SPEED);
        largest(reversing.map(|moment| moment.error().x.abs()))
    }

    /// Mean error in a time span [mm].
    pub fn mean_error(&self, span: &Range<f64>) -> Vector3<f64> {
        let sum: Vector3<f64> = self.during(span).map(|moment| moment.error()).sum();
        sum / self.during(span).count() as f64
    }

    /// The largest error relative to the mean error of another time span [mm].
    pub fn largest_relative_to_mean(&self, span: &Range<f64>, mean: &Range<f64>) -> f64 {
        let mean = self.mean_error(mean);
        self.largest(span, |moment| (moment.error() - mean).norm())
    }

    /// The largest displacement of the tool since the start of a time span [mm].
    pub fn tool_displacement(&self, span: &Range<f64>) -> f64 {
        let position = |moment: &Moment<'_>| moment.sample.position();
        let Some(first) = self.during(span).next().map(|moment| position(&moment)) else { return f64::NAN };
        self.largest(span, |moment| 1e3 * (position(moment) - first).norm())
    }

    /// The largest rate of a motor torque [N·m/s].
    pub fn torque_rate(&self, span: &Range<f64>) -> f64 {
        let torques: Vec<&[f64]> = self.during(span).map(|moment| moment.sample.torques.as_slice()).collect();
        let steps = torques.windows(2).flat_map(|two| two[0].iter().zip(two[1]));
        largest(steps.map(|(before, after)| (after - before).abs() / T))
    }

    /// Error along an axis, tick by tick [mm].
    pub fn errors(&self, axis: usize) -> Vec<f64> {
        self.all().map(|moment| moment.error()[axis]).collect()
    }

    /// As CSV.
    pub fn table(&self) -> String {
        let moments: Vec<(f64, Moment<'_>)> = self.times().into_iter().zip(self.all()).collect();
        let mut table = Table::new(&moments);
        table.column("time", "s", |(time, _)| *time);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            table
                .column(format!("hand {name}"), "m", |(_, moment)| moment.operator.hand[axis])
                .column(format!("set-point {name}"), "m", |(_, moment)| moment.sample.target[axis])
                .column(format!("tool {name}"), "m", |(_, moment)| moment.sample.position()[axis]);
        }
        table.column("elbow", "rad", |(_, moment)| moment.operator.elbow);
        for joint in 0..self.samples.first().map_or(0, |sample| sample.joints.len()) {
            table
                .column(format!("angle {}", joint + 1), "rad", |(_, moment)| moment.sample.joints[joint])
                .column(format!("torque {}", joint + 1), "N·m", |(_, moment)| moment.sample.torques[joint]);
        }
        table.csv()
    }
}

/// Displacements of hand and tool along an axis from the start of the hand [mm].
pub fn displacements(trace: &Trace, axis: usize) -> [Vec<f64>; 2] {
    let start = trace.operator.first().map_or(0.0, |operator| operator.hand[axis]);
    let displacement = |position: f64| 1e3 * (position - start);
    let hand = trace.all().map(|moment| displacement(moment.operator.hand[axis])).collect();
    let tool = trace.all().map(|moment| displacement(moment.sample.position()[axis])).collect();
    [hand, tool]
}
