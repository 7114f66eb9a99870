//! The metrics that the tables of the documents show, with their labels.

mod papers;

/// Side of its limit on which a metric must be, as defined by the scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// `value ≤ limit`.
    AtMost,
    /// `value ≥ limit`.
    AtLeast,
    /// `|value| ≤ limit`; without a limit, the magnitude is reported.
    Within,
}

impl Bound {
    /// Returns whether the value meets the limit.
    pub fn keeps(self, value: f64, limit: f64) -> bool {
        match self {
            Self::AtMost => value <= limit,
            Self::AtLeast => value >= limit,
            Self::Within => value.abs() <= limit,
        }
    }

    /// Returns a number that is larger for a worse value.
    pub fn badness(self, value: f64) -> f64 {
        match self {
            Self::AtMost => value,
            Self::AtLeast => -value,
            Self::Within => value.abs(),
        }
    }
}

/// One row of a table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    pub scenario: &'static str,
    pub metric: &'static str,
    pub bound: Bound,
    pub label: &'static str,
}

/// One row of a comparison with a paper: the same quantity with the paper's law and with ours.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    pub label: &'static str,
    /// The paper's printed value, if the scenario does not have it.
    pub paper: Option<&'static str>,
    pub papers_law: Option<Row>,
    pub ours: Option<Row>,
    /// Whether it is an error, for which the ratio shows how much better one law is.
    pub is_error: bool,
}

impl Pair {
    /// Returns its rows in the sweeps.
    pub fn rows(&self) -> impl Iterator<Item = Row> {
        [self.papers_law, self.ours].into_iter().flatten()
    }
}

/// Content of a table.
#[derive(Clone, Copy, Debug)]
pub enum Rows {
    /// Metrics against their limits.
    Limits(&'static [Row]),
    /// The paper's printed values, its law on our machines, and our law.
    Comparison(&'static [Pair]),
}

/// A table of a document.
#[derive(Clone, Copy, Debug)]
pub struct Table {
    pub document: &'static str,
    /// The table's name in the markers of the document.
    pub name: &'static str,
    pub rows: Rows,
}

const KNOB: &[Row] = &[
    at_least("knob-find", "whole_right", "whole image: pictures with the right circle"),
    row("knob-find", "whole_wrong", "with a wrong one"),
    row("knob-find", "whole_center", "error of the centre, median"),
    row("knob-find", "whole_radius", "error of the radius, median"),
    at_least("knob-find", "window_right", "window: pictures with the right circle"),
    row("knob-find", "window_wrong", "with a wrong one"),
    row("knob-find", "window_center", "error of the centre, median"),
    row("knob-find", "window_radius", "error of the radius, median"),
    row("knob-find", "empty_found", "doors without a knob: a circle is found"),
];

const KNOB_GRASP: &[Row] = &[
    at_least("knob-grasp", "gripped", "knobs that are gripped, of ten"),
    at_least("knob-grasp", "first_try", "at the first try"),
    row("knob-grasp", "wrong_claims", "the behaviour says that it holds the knob, and does not"),
    row("knob-grasp", "time", "time of an approach, median"),
    row("knob-grasp", "longest", "longest time of an approach that grips"),
    row("knob-grasp", "contact", "largest force on door, rose and knob before the grip"),
    row("knob-grasp", "aside", "fingertips from the axis of the knob when they close, median"),
];

const MEASUREMENTS: &str = "docs/measurements.md";

const fn row(scenario: &'static str, metric: &'static str, label: &'static str) -> Row {
    Row { scenario, metric, bound: Bound::AtMost, label }
}

const fn at_least(scenario: &'static str, metric: &'static str, label: &'static str) -> Row {
    Row { bound: Bound::AtLeast, ..row(scenario, metric, label) }
}

const fn magnitude(scenario: &'static str, metric: &'static str, label: &'static str) -> Row {
    Row { bound: Bound::Within, ..row(scenario, metric, label) }
}

/// Returns all tables.
pub fn tables() -> impl Iterator<Item = &'static Table> {
    MEASURED.iter().chain(papers::TABLES)
}

/// The tables of measured values and limits.
const MEASURED: &[Table] = &[
    Table { document: "README.md", name: "readme", rows: Rows::Limits(README) },
    Table { document: MEASUREMENTS, name: "servo", rows: Rows::Limits(SERVO) },
    Table { document: MEASUREMENTS, name: "first-motion", rows: Rows::Limits(FIRST_MOTION) },
    Table { document: MEASUREMENTS, name: "reach", rows: Rows::Limits(REACH) },
    Table { document: MEASUREMENTS, name: "motion-in-the-hand", rows: Rows::Limits(MOTION) },
    Table { document: MEASUREMENTS, name: "grasp", rows: Rows::Limits(GRASP) },
    Table { document: MEASUREMENTS, name: "weights", rows: Rows::Limits(WEIGHTS) },
    Table { document: MEASUREMENTS, name: "force", rows: Rows::Limits(FORCE) },
    Table { document: MEASUREMENTS, name: "impedance", rows: Rows::Limits(IMPEDANCE) },
    Table { document: MEASUREMENTS, name: "wall", rows: Rows::Limits(WALL) },
    Table { document: MEASUREMENTS, name: "contact", rows: Rows::Limits(CONTACT) },
    Table { document: MEASUREMENTS, name: "straight", rows: Rows::Limits(STRAIGHT) },
    Table { document: MEASUREMENTS, name: "follow", rows: Rows::Limits(FOLLOW) },
    Table { document: MEASUREMENTS, name: "bilateral", rows: Rows::Limits(BILATERAL) },
    Table { document: MEASUREMENTS, name: "calibrate", rows: Rows::Limits(CALIBRATE) },
    Table { document: MEASUREMENTS, name: "fingertips", rows: Rows::Limits(FINGERTIPS) },
    Table { document: MEASUREMENTS, name: "glove", rows: Rows::Limits(GLOVE) },
    Table { document: MEASUREMENTS, name: "knob", rows: Rows::Limits(KNOB) },
    Table { document: MEASUREMENTS, name: "knob-grasp", rows: Rows::Limits(KNOB_GRASP) },
];

const CONTACT: &[Row] = &[
    row("arm7-contact", "derated_within", "contacts within the condition that were derated"),
    row("arm7-contact", "derated_beyond", "contacts beyond it that were derated"),
    row(
        "arm7-contact",
        "derated_unsettled",
        "derated contacts that have not settled, and those that a fault ended",
    ),
    row("arm7-contact", "unsettled", "other contacts that have not settled"),
    row("arm7-contact", "heavy_unsettled", "the same with an impedance over three times as heavy as the arm"),
    row("arm7-contact", "faults", "contacts that a fault ended"),
    row("arm7-contact", "derating", "largest derating"),
];

const CALIBRATE: &[Row] = &[
    row("hand5-calibrate", "full_time", "markers on five fingers: time"),
    row("hand5-calibrate", "full_index_length_mean", "vector to the index finger: mean error of the length"),
    row("hand5-calibrate", "full_index_length_deviation", "its standard deviation"),
    row("hand5-calibrate", "full_index_direction_mean", "mean error of the direction"),
    row("hand5-calibrate", "full_index_direction_deviation", "its standard deviation"),
    row("hand5-calibrate", "full_middle_direction_mean", "to the middle finger: mean error of the direction"),
    row("hand5-calibrate", "full_middle_direction_deviation", "its standard deviation"),
    row("hand5-calibrate", "quick_time", "markers on thumb, index and little finger, touches: time"),
    row(
        "hand5-calibrate",
        "quick_middle_length_mean",
        "vector to the middle finger: mean error of the length",
    ),
    row("hand5-calibrate", "quick_middle_length_deviation", "its standard deviation"),
    row("hand5-calibrate", "quick_ring_length_mean", "vector to the ring finger: mean error of the length"),
    row("hand5-calibrate", "quick_ring_length_deviation", "its standard deviation"),
];

const FINGERTIPS: &[Row] = &[
    row("hand5-reach", "own_stated_error", "the robot's own hand: error of the kinematics"),
    row("hand5-reach", "own_index_rms", "true vector to the index finger, rms error"),
    row("hand5-reach", "own_little_rms", "true vector to the little finger, rms error"),
    row("hand5-reach", "human_index_stated", "a person's hand: index finger, rms error of the kinematics"),
    row("hand5-reach", "human_little_stated", "little finger, the same"),
    row("hand5-reach", "pinch_index_stated", "pinch with the index finger: gap of the kinematics"),
    row("hand5-reach", "pinch_index_rest_gap", "true gap, 2 s after the motion"),
    row("hand5-reach", "pinch_index_gap", "true gap, from 0.3 s after the motion on"),
    row(
        "hand5-reach",
        "pinch_middle_rest_gap",
        "pinch with the middle finger: true gap, 2 s after the motion",
    ),
    row("hand5-reach", "pinch_little_rest_gap", "pinch with the little finger, the same"),
];

const GLOVE: &[Row] = &[
    row("hand5-teleop", "two_delay", "thumb and index finger: delay"),
    magnitude(
        "hand5-teleop",
        "two_index_length_mean",
        "vector to the index finger: mean error of the length",
    ),
    row("hand5-teleop", "two_index_length_deviation", "its standard deviation"),
    row("hand5-teleop", "two_index_direction_mean", "mean error of the direction"),
    row("hand5-teleop", "two_index_direction_deviation", "its standard deviation"),
    magnitude(
        "hand5-teleop",
        "all_index_length_mean",
        "five fingers: index finger, mean error of the length",
    ),
    row("hand5-teleop", "all_index_length_deviation", "its standard deviation"),
    row("hand5-teleop", "two_speed", "thumb and index finger: largest speed of a joint, of its limit"),
    row("hand5-teleop", "all_speed", "five fingers, the same"),
];

const README: &[Row] = &[
    row("hand3-servo", "observer_error_peak", "joints step by 0.3 rad, friction adapted: largest error"),
    row("hand3-reach", "observer_circle_rms", "fingertips on a circle of 10 mm radius at 1 Hz: rms distance"),
    row("hand3-grasp", "box_dropped", "a box is grasped, lifted, turned, shifted, put down: number of drops"),
    row(
        "arm7-wall",
        "wall_10000_settling_time",
        "an arm meets a wall of 10 000 N/m: settling time of the force",
    ),
    row(
        "arm7-follow",
        "ours_error_peak",
        "an arm follows an operator's hand over a link of 20 ms: largest error",
    ),
];

const SERVO: &[Row] = &[
    row("hand3-servo", "pid_error_peak", "PID, largest error"),
    row("hand3-servo", "pid_error_settled", "PID, from 1 s after the step"),
    row("hand3-servo", "pid_error_first_steps", "PID, first steps after power-on"),
    row("hand3-servo", "observer_error_peak", "observer, largest error"),
    row("hand3-servo", "observer_error_settled", "observer, from 1 s after the step"),
    row("hand3-servo", "observer_error_first_steps", "observer, first steps after power-on"),
    row("hand3-servo", "pid_paper_friction_error_peak", "PID, Coulomb friction 0.08 N·m"),
    row("hand3-servo", "observer_paper_friction_error_peak", "observer, Coulomb friction 0.08 N·m"),
];

const FIRST_MOTION: &[Row] = &[
    row("hand3-first-motion", "pid_first_before", "PID, first steps without the self-test"),
    row("hand3-first-motion", "pid_first_after", "PID, first steps with it"),
    row("hand3-first-motion", "observer_first_before", "observer, first steps without the self-test"),
    row("hand3-first-motion", "observer_first_after", "observer, first steps with it"),
    row("hand3-first-motion", "test_friction_error", "Coulomb friction, worst joint: error"),
    row("hand3-first-motion", "test_time", "time of the self-test"),
];

const REACH: &[Row] = &[
    row("hand3-reach", "observer_circle_rms", "observer, circle"),
    row("hand3-reach", "observer_square_rms", "observer, square"),
    row("hand3-reach", "observer_circle_rms_without_offset", "observer, circle, without the constant offset"),
    row("hand3-reach", "pid_circle_rms", "PID, circle"),
    row("hand3-reach", "pid_square_rms", "PID, square"),
];

const MOTION: &[Row] = &[
    row("hand3-turn", "pitch_error", "turned by ±0.1 rad: error at rest, worst of four turns"),
    row("hand3-shift", "ours_error_forward", "shifted by 1 cm: error at rest, forward"),
    row("hand3-shift", "ours_error_back", "the same, back"),
    row("hand3-shift", "ours_drift_y", "drift along y"),
    row("hand3-shift", "ours_drift_z", "drift along z"),
    row("hand3-shift", "paper_error_forward", "the paper's law: error at rest, forward"),
    row("hand3-shift", "paper_error_back", "the paper's law: the same, back"),
    row("hand3-shift", "paper_drift_z", "the paper's law: drift along z"),
    row("hand3-shift", "paper_dropped", "the paper's law: box lost (1 if so)"),
];

const GRASP: &[Row] = &[
    row("hand3-grasp", "box_dropped", "box dropped (1 if so)"),
    row("hand3-grasp", "cylinder_dropped", "cylinder dropped"),
    row("hand3-grasp", "wedge_dropped", "wedge dropped"),
    row("hand3-grasp", "box_force_peak", "box: largest normal force of a contact"),
    row("hand3-grasp", "cylinder_force_peak", "cylinder: largest normal force of a contact"),
    row("hand3-grasp", "wedge_force_peak", "wedge: largest normal force of a contact"),
    row("hand3-grasp", "box_penetration_peak", "box: largest penetration of a tip"),
    row("hand3-grasp", "box_pitch_error", "box: pitch error at rest"),
    row("hand3-grasp", "cylinder_pitch_error", "cylinder: pitch error at rest"),
    row("hand3-grasp", "wedge_pitch_error", "wedge: pitch error at rest"),
    row("hand3-grasp", "box_placement_distance", "box: distance from pick-up to put-down"),
];

const WEIGHTS: &[Row] = &[
    row("hand3-weights", "single_motion", "50 to 300 g, one at a time: motion of the box"),
    row("hand3-weights", "single_sliding", "sliding of a contact"),
    row("hand3-weights", "single_grip_ratio", "grip ratio: normal forces over those of the least grip"),
    row("hand3-weights", "cumulative_motion", "50 to 650 g, cumulative: motion of the box"),
    row("hand3-weights", "cumulative_sliding", "sliding of a contact"),
    row("hand3-weights", "cumulative_grip_ratio", "grip ratio: normal forces over those of the least grip"),
    row("hand3-weights", "push_motion", "push of 0.3 N from the side: motion of the box"),
    row("hand3-weights", "push_sliding", "sliding of a contact"),
];

const FORCE: &[Row] = &[
    row("hand3-force", "identified_force_error", "feed-forward after identification"),
    row("hand3-force", "feed_forward_force_error", "feed-forward without identification"),
    row("hand3-force", "feedback_force_error", "force feedback"),
    row("hand3-force", "paper_finger1_force", "the paper's law: force of finger 1, 2 N commanded"),
    magnitude("hand3-force", "paper_finger1_force_minus_paper", "the same minus the paper's force"),
    at_least(
        "hand3-force",
        "identified_torque_constants",
        "torque constants that can be identified, of nine",
    ),
    row("hand3-force", "identified_torque_constant_error", "error of the identified torque constants"),
    row("hand3-force", "identified_coulomb_friction_error", "error of the identified Coulomb friction"),
];

const IMPEDANCE: &[Row] = &[
    row(
        "arm7-release",
        "mismatched_b8_error_peak",
        "mismatched model, B 7.5 N·s/m: deviation from the exact motion",
    ),
    row("arm7-release", "mismatched_b30_error_peak", "the same with B 30 N·s/m"),
    row("arm7-release", "matched_b8_error_peak", "matched model, friction below 0.1 N, B 7.5"),
    row("arm7-release", "matched_b30_error_peak", "the same with B 30"),
    row(
        "arm7-release",
        "half_period_b8_error_peak",
        "matched model, released half a period before a reading, B 7.5",
    ),
    row("arm7-release", "half_period_b30_error_peak", "the same with B 30"),
    row("arm7-release", "paper_b8_error_peak", "the paper's law, corrected, B 7.5"),
    row("arm7-release", "paper_b30_error_peak", "the paper's law, corrected, B 30"),
    row("arm7-elbow", "yaw_hand_displacement", "elbow driven by shoulder yaw: displacement of the hand"),
    row("arm7-elbow", "arm_angle_hand_displacement", "elbow driven by arm angle: displacement of the hand"),
    at_least(
        "arm7-elbow",
        "yaw_elbow_displacement",
        "elbow driven by shoulder yaw: displacement of the elbow",
    ),
];

const WALL: &[Row] = &[
    row("arm7-wall", "wall_200_settling_time", "200 N/m: settling time of the force, within 1 N"),
    row("arm7-wall", "wall_2000_settling_time", "2000 N/m"),
    row("arm7-wall", "wall_10000_settling_time", "10 000 N/m"),
    row("arm7-wall", "wall_50000_settling_time", "50 000 N/m"),
    magnitude(
        "arm7-wall",
        "wall_50000_force_error_at_rest",
        "50 000 N/m: force at rest minus that of the springs in series",
    ),
    magnitude(
        "arm7-wall",
        "observed_2000_estimation_error",
        "no force sensor, 2000 N/m: estimated minus true force at rest",
    ),
    magnitude("arm7-wall", "observed_10000_estimation_error", "no force sensor, 10 000 N/m: the same"),
    row("arm7-wall", "observed_2000_settling_time", "no force sensor, 2000 N/m: settling time of the force"),
    row("arm7-wall", "observed_10000_settling_time", "no force sensor, 10 000 N/m: the same"),
];

const STRAIGHT: &[Row] = &[
    row("arm7-straight", "arm_angle_joint_speed_peak", "largest joint speed, elbow driven by arm angle"),
    row("arm7-straight", "yaw_joint_speed_peak", "the same, by shoulder yaw"),
    row("arm7-straight", "arm_angle_torque_peak", "largest joint torque, by arm angle"),
    row("arm7-straight", "yaw_torque_peak", "the same, by shoulder yaw"),
    row("arm7-straight", "arm_angle_error_after_return", "position error after the return, by arm angle"),
    row("arm7-straight", "yaw_error_after_return", "the same, by shoulder yaw"),
];

const FOLLOW: &[Row] = &[
    row("arm7-follow", "ours_error_peak", "largest error, sine"),
    row("arm7-follow", "ours_error_at_reversals", "the same along x at the reversals"),
    row("arm7-follow", "ours_error_at_rest", "error at rest"),
    row("arm7-follow", "strokes_error_peak", "largest error, minimum-jerk strokes up to 0.25 m/s"),
    row("arm7-follow", "strokes_error_at_rest", "error at rest after them"),
    row("arm7-follow", "tremor_error_peak", "largest error with twice the tremor"),
    row("arm7-follow", "loss_error_peak", "largest error, 20 % lost in bursts of six, 20 ms of jitter"),
    row(
        "arm7-follow",
        "clutch_error_after_closing",
        "largest error later than 0.5 s after closing the clutch in motion, without that at rest",
    ),
    row("arm7-follow", "ours_acceleration_peak", "largest acceleration of the set-point, sine"),
    row("arm7-follow", "paper_error_at_reversals", "the paper's law, corrected: along x at the reversals"),
    row("arm7-follow", "paper_error_at_rest_x", "the paper's law, corrected: along x at rest"),
];

const BILATERAL: &[Row] = &[
    row("arm7-bilateral", "wall_200_delay_0_settling_time", "200 N/m, no delay: settling time of the handle"),
    row("arm7-bilateral", "wall_200_delay_20_settling_time", "200 N/m, 20 ms in each direction"),
    row("arm7-bilateral", "wall_200_delay_50_settling_time", "200 N/m, 50 ms in each direction"),
    row("arm7-bilateral", "wall_2000_delay_0_settling_time", "2000 N/m, no delay"),
    row("arm7-bilateral", "wall_2000_delay_20_settling_time", "2000 N/m, 20 ms"),
    row("arm7-bilateral", "wall_2000_delay_50_settling_time", "2000 N/m, 50 ms"),
    row("arm7-bilateral", "wall_50000_delay_0_settling_time", "50 000 N/m, no delay"),
    row("arm7-bilateral", "wall_50000_delay_20_settling_time", "50 000 N/m, 20 ms"),
    row("arm7-bilateral", "wall_50000_delay_50_settling_time", "50 000 N/m, 50 ms"),
    row("arm7-bilateral", "wall_200_delay_50_energy_generated", "200 N/m, 50 ms: energy generated"),
    row("arm7-bilateral", "wall_2000_delay_50_energy_generated", "2000 N/m, 50 ms: energy generated"),
    row("arm7-bilateral", "wall_50000_delay_0_energy_generated", "50 000 N/m, no delay: energy generated"),
    row("arm7-bilateral", "wall_50000_delay_20_energy_generated", "50 000 N/m, 20 ms: energy generated"),
    row("arm7-bilateral", "wall_50000_delay_50_energy_generated", "50 000 N/m, 50 ms: energy generated"),
    row(
        "arm7-bilateral",
        "wall_2000_delay_50_without_passivity_control_settling_time",
        "2000 N/m, 50 ms, no passivity control: settling time",
    ),
    row(
        "arm7-bilateral",
        "wall_2000_delay_50_without_passivity_control_energy_generated",
        "the same: energy generated",
    ),
];

#[cfg(test)]
pub mod fixtures {
    use super::{Bound, Row};

    /// A row of the sweep in `record::fixtures`.
    pub const fn row(bound: Bound) -> Row {
        Row { scenario: "arm", metric: "error", bound, label: "Error" }
    }
}
