//! Log of a grasp trial.

use std::ops::Range;

use rapier3d::na::{Quaternion, UnitQuaternion, Vector3};

use crate::plant::{ContactTruth, ObjectTruth, unit_quaternion};
use crate::report::Table;
use crate::scenario::common::{T, during, largest};
use tesaki::task::grasping::Phase;

/// What the controller knows of a grasp, as last reported; NaN before the first report.
#[derive(Clone, Copy, Debug)]
pub struct GraspEstimates {
    /// Target force of each finger on the object [N].
    pub target_forces: [Vector3<f64>; 3],
    /// Force of each finger on the object by its tared sensor [N]; NaN where it is not recorded.
    pub sensed_forces: [Vector3<f64>; 3],
    /// Force of all fingers on the object, filtered [N].
    pub load: Vector3<f64>,
    /// Position of the object frame: the centroid of the fingertips' triangle when it was grasped [m].
    pub position: Vector3<f64>,
    /// Its orientation: x towards finger 3, z along the normal of the triangle.
    pub orientation: UnitQuaternion<f64>,
}

impl GraspEstimates {
    /// Before the first report.
    pub const UNKNOWN: Self = {
        let unknown = Vector3::new(f64::NAN, f64::NAN, f64::NAN);
        let [target_forces, sensed_forces] = [[unknown; 3]; 2];
        let orientation =
            UnitQuaternion::new_unchecked(Quaternion::new(f64::NAN, f64::NAN, f64::NAN, f64::NAN));
        Self { target_forces, sensed_forces, load: unknown, position: unknown, orientation }
    };

    /// Pitch of the object frame: how far its x axis points down [rad].
    pub fn pitch(&self) -> f64 {
        (-(self.orientation * Vector3::x()).z).asin()
    }
}

/// The true state at the start of a control period, and the controller's targets.
#[derive(Clone, Debug)]
pub struct GraspSample {
    /// Time since the controller was enabled [s].
    pub time: f64,
    pub object: ObjectTruth,
    /// One per finger.
    pub contacts: Vec<ContactTruth>,
    /// Joint angles [rad].
    pub joints: Vec<f64>,
    /// What the controller says.
    pub estimates: GraspEstimates,
    /// Target displacement [m] and target rotation vector [rad] of the object since it was grasped; NaN where
    /// they are not known.
    pub target: [Vector3<f64>; 2],
}

impl GraspSample {
    pub fn position(&self) -> Vector3<f64> {
        self.object.position.into()
    }

    pub fn orientation(&self) -> UnitQuaternion<f64> {
        unit_quaternion(self.object.orientation)
    }

    /// Roll, pitch and yaw of the object [rad].
    pub fn angles(&self) -> [f64; 3] {
        let (roll, pitch, yaw) = self.orientation().euler_angles();
        [roll, pitch, yaw]
    }

    /// Force of a finger on the object [N]; NaN for a finger that does not exist.
    pub fn force(&self, finger: usize) -> Vector3<f64> {
        self.contacts.get(finger).map_or(Vector3::repeat(f64::NAN), |contact| contact.force.into())
    }
}

/// One sample per tick, and the outcome.
#[derive(Clone, Debug, Default)]
pub struct GraspLog {
    pub samples: Vec<GraspSample>,
    /// When the hand began to hold the object [s]; NaN if it never did.
    pub held: f64,
    /// Why and when the object was lost.
    pub lost: Option<String>,
    /// When the controller was first seen in each phase of the grasp [s].
    pub phases: Vec<(f64, Phase)>,
    /// Coefficient of friction, as last reported by the controller.
    pub friction: f64,
}

impl GraspLog {
    /// Time of the next sample [s].
    pub fn now(&self) -> f64 {
        self.samples.len() as f64 * T
    }

    /// The sample at `time`; the last sample if the log ends at that tick. `None` if it ended earlier.
    pub fn at(&self, time: f64) -> Option<&GraspSample> {
        let index = (time / T).round() as usize;
        self.samples.get(index).or_else(|| (index == self.samples.len()).then(|| self.samples.last())?)
    }

    /// The samples of a time span [s]; empty if it was not recorded to its end.
    pub fn during(&self, span: &Range<f64>) -> &[GraspSample] {
        during(&self.samples, span)
    }

    /// The maximum of a value in a time span; NaN if it was not recorded to its end.
    pub fn largest(&self, span: &Range<f64>, value: impl Fn(&GraspSample) -> f64) -> f64 {
        largest(self.during(span).iter().map(value))
    }

    /// The largest displacement of the object since the start of a time span [m].
    pub fn motion(&self, span: &Range<f64>) -> f64 {
        let start = self.at(span.start).map_or(Vector3::repeat(f64::NAN), GraspSample::position);
        self.largest(span, |sample| (sample.position() - start).norm())
    }

    /// How far the object was above the place where it was grasped, the least in a time span [m]; NaN if it
    /// was not recorded to its end.
    pub fn least_rise(&self, span: &Range<f64>) -> f64 {
        let stood = self.at(self.held).map_or(f64::NAN, |sample| sample.position().z);
        -self.largest(span, |sample| stood - sample.position().z)
    }

    /// The longest path that a fingertip slid in a time span [m].
    pub fn sliding(&self, span: &Range<f64>) -> f64 {
        let all = self.during(span);
        let (Some(first), Some(last)) = (all.first(), all.last()) else { return f64::NAN };
        let paths = first.contacts.iter().zip(&last.contacts);
        largest(paths.map(|(first, last)| last.slip_path - first.slip_path))
    }

    pub fn times(&self) -> Vec<f64> {
        self.samples.iter().map(|sample| sample.time).collect()
    }

    pub fn series(&self, value: impl Fn(&GraspSample) -> f64) -> Vec<f64> {
        self.samples.iter().map(value).collect()
    }
}

/// The log as CSV: object, weights, contacts.
pub fn table(log: &GraspLog) -> String {
    const AXES: [&str; 3] = ["x", "y", "z"];
    let mut table = Table::new(&log.samples);
    table.column("time", "s", |sample| sample.time);
    for (axis, name) in AXES.into_iter().enumerate() {
        table.column(format!("object {name}"), "m", |sample| sample.object.position[axis]);
    }
    for (axis, name) in ["roll", "pitch", "yaw"].into_iter().enumerate() {
        table.column(format!("object {name}"), "rad", |sample| sample.angles()[axis]);
    }
    for (part, (quantity, unit)) in
        [("target displacement", "m"), ("target rotation", "rad")].into_iter().enumerate()
    {
        for (axis, name) in AXES.into_iter().enumerate() {
            table.column(format!("{quantity} {name}"), unit, |sample| sample.target[part][axis]);
        }
    }
    for (axis, name) in AXES.into_iter().enumerate() {
        table.column(format!("estimated position {name}"), "m", |sample| sample.estimates.position[axis]);
    }
    table.column("estimated pitch", "rad", |sample| sample.estimates.pitch());
    for (axis, name) in AXES.into_iter().enumerate() {
        table.column(format!("sensed load {name}"), "N", |sample| sample.estimates.load[axis]);
    }
    table.column("weights", "kg", |sample| sample.object.load);
    for finger in 0..3 {
        let name = |what: &str| format!("finger {} {what}", finger + 1);
        let contact = |value: fn(&ContactTruth) -> f64| {
            move |sample: &GraspSample| sample.contacts.get(finger).map_or(f64::NAN, value)
        };
        for (axis, letter) in AXES.into_iter().enumerate() {
            table.column(name(&format!("force {letter}")), "N", |sample| sample.force(finger)[axis]);
        }
        for (axis, letter) in AXES.into_iter().enumerate() {
            table.column(name(&format!("target force {letter}")), "N", |sample| {
                sample.estimates.target_forces[finger][axis]
            });
        }
        table
            .column(name("normal force"), "N", contact(ContactTruth::normal_force))
            .column(name("tangential force"), "N", contact(ContactTruth::tangential_force))
            .column(name("sliding"), "m", contact(|contact| contact.slip_path))
            .column(name("depth"), "m", contact(|contact| contact.depth));
    }
    table.csv()
}
