//! Which metrics of which scenarios the documents show, under which names.

/// On which side of its limit a metric should be, as its scenario says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// `value ≤ limit`.
    AtMost,
    /// `value ≥ limit`.
    AtLeast,
    /// `|value| ≤ limit`; without a limit, the magnitude is what counts.
    Within,
}

impl Bound {
    /// Whether the value keeps the limit.
    pub fn keeps(self, value: f64, limit: f64) -> bool {
        match self {
            Self::AtMost => value <= limit,
            Self::AtLeast => value >= limit,
            Self::Within => value.abs() <= limit,
        }
    }

    /// The larger, the worse.
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

/// A table of a document.
#[derive(Clone, Copy, Debug)]
pub struct Table {
    pub document: &'static str,
    /// As the markers in the document call it.
    pub name: &'static str,
    pub rows: &'static [Row],
}

const MEASUREMENTS: &str = "docs/measurements.md";

const fn row(scenario: &'static str, metric: &'static str, label: &'static str) -> Row {
    Row { scenario, metric, bound: Bound::AtMost, label }
}

const fn magnitude(scenario: &'static str, metric: &'static str, label: &'static str) -> Row {
    Row { bound: Bound::Within, ..row(scenario, metric, label) }
}

/// All tables.
pub const TABLES: &[Table] = &[
    Table { document: "README.md", name: "readme", rows: README },
    Table { document: MEASUREMENTS, name: "servo", rows: SERVO },
    Table { document: MEASUREMENTS, name: "reach", rows: REACH },
    Table { document: MEASUREMENTS, name: "motion-in-the-hand", rows: MOTION },
    Table { document: MEASUREMENTS, name: "grasp", rows: GRASP },
    Table { document: MEASUREMENTS, name: "weights", rows: WEIGHTS },
    Table { document: MEASUREMENTS, name: "force", rows: FORCE },
    Table { document: MEASUREMENTS, name: "impedance", rows: IMPEDANCE },
    Table { document: MEASUREMENTS, name: "wall", rows: WALL },
    Table { document: MEASUREMENTS, name: "straight", rows: STRAIGHT },
    Table { document: MEASUREMENTS, name: "follow", rows: FOLLOW },
    Table { document: MEASUREMENTS, name: "bilateral", rows: BILATERAL },
];

const README: &[Row] = &[
    row("hand3-servo", "observer_error_peak", "joints step by 0.3 rad, friction learnt: largest error"),
    row("hand3-reach", "observer_circle_rms", "fingertips on a circle of 10 mm radius at 1 Hz: rms distance"),
    row("hand3-grasp", "box_dropped", "a box is grasped, lifted, turned, shifted, put down: dropped"),
    row("arm7-wall", "wall_10000_settled", "an arm meets a wall of 10 000 N/m: force settles"),
    row("arm7-follow", "ours_largest", "an arm follows a hand over a link of 20 ms: largest error"),
];

const SERVO: &[Row] = &[
    row("hand3-servo", "pid_error_peak", "PID, largest error"),
    row("hand3-servo", "pid_error_settled", "PID, from 1 s after the step"),
    row("hand3-servo", "pid_error_first_motions", "PID, first motions after power-on"),
    row("hand3-servo", "observer_error_peak", "observer, largest error"),
    row("hand3-servo", "observer_error_settled", "observer, from 1 s after the step"),
    row("hand3-servo", "observer_error_first_motions", "observer, first motions after power-on"),
    row("hand3-servo", "pid_paper_friction_error_peak", "PID, Coulomb friction 0.08 N·m"),
    row("hand3-servo", "observer_paper_friction_error_peak", "observer, Coulomb friction 0.08 N·m"),
];

const REACH: &[Row] = &[
    row("hand3-reach", "observer_circle_rms", "observer, circle"),
    row("hand3-reach", "observer_square_rms", "observer, square"),
    row("hand3-reach", "observer_circle_rms_without_shift", "observer, circle, without the constant shift"),
    row("hand3-reach", "pid_circle_rms", "PID, circle"),
    row("hand3-reach", "pid_square_rms", "PID, square"),
];

const MOTION: &[Row] = &[
    row("hand3-turn", "turn_error", "turned by ±0.1 rad: error at rest, worst of four turns"),
    row("hand3-shift", "ours_there", "shifted by 1 cm: error at rest, there"),
    row("hand3-shift", "ours_back", "back again"),
    row("hand3-shift", "ours_drift_y", "drift along y"),
    row("hand3-shift", "ours_drift_z", "drift along z"),
    row("hand3-shift", "paper_there", "the paper's law: error at rest, there"),
    row("hand3-shift", "paper_back", "the paper's law: back again"),
    row("hand3-shift", "paper_drift_z", "the paper's law: drift along z"),
    row("hand3-shift", "paper_lost", "the paper's law: box lost (1 if so)"),
];

const GRASP: &[Row] = &[
    row("hand3-grasp", "box_dropped", "box dropped (1 if so)"),
    row("hand3-grasp", "cylinder_dropped", "cylinder dropped"),
    row("hand3-grasp", "wedge_dropped", "wedge dropped"),
    row("hand3-grasp", "box_force_peak", "box: largest contact force"),
    row("hand3-grasp", "cylinder_force_peak", "cylinder: largest contact force"),
    row("hand3-grasp", "wedge_force_peak", "wedge: largest contact force"),
    row("hand3-grasp", "box_depth", "box: largest depth of a tip"),
    row("hand3-grasp", "box_turn_error", "box: error of the turn"),
    row("hand3-grasp", "cylinder_turn_error", "cylinder: error of the turn"),
    row("hand3-grasp", "wedge_turn_error", "wedge: error of the turn"),
    row("hand3-grasp", "box_put_down", "box: distance from where it is put down"),
];

const WEIGHTS: &[Row] = &[
    row("hand3-weights", "single_motion", "50 to 300 g, one at a time: motion of the box"),
    row("hand3-weights", "single_sliding", "sliding of a contact"),
    row("hand3-weights", "single_firmness", "grip a second later, over the least that holds"),
    row("hand3-weights", "all_motion", "650 g together: motion of the box"),
    row("hand3-weights", "all_sliding", "sliding of a contact"),
    row("hand3-weights", "all_firmness", "grip a second later, over the least that holds"),
    row("hand3-weights", "push_motion", "push of 0.3 N from the side: motion of the box"),
    row("hand3-weights", "push_sliding", "sliding of a contact"),
];

const FORCE: &[Row] = &[
    row("hand3-force", "identified_error", "feed-forward after identification"),
    row("hand3-force", "feed_forward_error", "feed-forward, torque constants up to 20 % off"),
    row("hand3-force", "closed_error", "closed on the force sensors"),
    row("hand3-force", "paper_finger1", "the paper's law: force of finger 1, 2 N commanded"),
    magnitude("hand3-force", "paper_finger1_against_paper", "the same less the paper's figure"),
    row("hand3-force", "identified_gain", "error of the identified torque constants"),
    row("hand3-force", "identified_coulomb", "error of the identified Coulomb friction"),
];

const IMPEDANCE: &[Row] = &[
    row("arm7-release", "ours_8", "let go, B 7.5 N·s/m: distance from the exact curve"),
    row("arm7-release", "ours_30", "the same with B 30 N·s/m"),
    row("arm7-release", "true_8", "a machine as the model says, friction below 0.1 N, B 7.5"),
    row("arm7-release", "true_30", "the same with B 30"),
    row("arm7-release", "between_8", "as the model says, let go half a period before a reading, B 7.5"),
    row("arm7-release", "between_30", "the same with B 30"),
    row("arm7-release", "paper_8", "the paper's law, B 7.5"),
    row("arm7-release", "paper_30", "the paper's law, B 30"),
    row("arm7-elbow", "yaw_hand", "elbow led by shoulder yaw: the hand moves"),
    row("arm7-elbow", "arm_angle_hand", "elbow led by arm angle: the hand moves"),
    Row {
        bound: Bound::AtLeast,
        ..row("arm7-elbow", "yaw_elbow", "elbow led by shoulder yaw: the elbow moves")
    },
];

const WALL: &[Row] = &[
    row("arm7-wall", "wall_200_settled", "200 N/m: until the force stays within 1 N"),
    row("arm7-wall", "wall_2000_settled", "2000 N/m"),
    row("arm7-wall", "wall_10000_settled", "10 000 N/m"),
    row("arm7-wall", "wall_50000_settled", "50 000 N/m"),
    magnitude("arm7-wall", "wall_50000_rest", "50 000 N/m: force at rest less that of the springs in series"),
    magnitude(
        "arm7-wall",
        "observed_2000_felt",
        "no force sensor, 2000 N/m: estimated less true force at rest",
    ),
    magnitude("arm7-wall", "observed_10000_felt", "no force sensor, 10 000 N/m: the same"),
    row("arm7-wall", "observed_2000_settled", "no force sensor, 2000 N/m: until the force stays within 1 N"),
    row("arm7-wall", "observed_10000_settled", "no force sensor, 10 000 N/m: the same"),
];

const STRAIGHT: &[Row] = &[
    row("arm7-straight", "arm_angle_speed", "largest speed of a joint, elbow led by arm angle"),
    row("arm7-straight", "yaw_speed", "the same, by shoulder yaw"),
    row("arm7-straight", "arm_angle_torque", "largest torque of a joint, by arm angle"),
    row("arm7-straight", "yaw_torque", "the same, by shoulder yaw"),
    row("arm7-straight", "arm_angle_back", "error of the tool after coming back, by arm angle"),
    row("arm7-straight", "yaw_back", "the same, by shoulder yaw"),
];

const FOLLOW: &[Row] = &[
    row("arm7-follow", "ours_largest", "largest error, sine"),
    row("arm7-follow", "ours_reversals", "the same along x at the reversals"),
    row("arm7-follow", "ours_rest", "error at rest"),
    row("arm7-follow", "strokes_largest", "largest error, strokes of minimum jerk up to 0.25 m/s"),
    row("arm7-follow", "strokes_rest", "error at rest after them"),
    row("arm7-follow", "tremor_largest", "largest error with twice the tremor"),
    row("arm7-follow", "loss_largest", "largest error, 20 % lost in bursts of six, 20 ms of jitter"),
    row("arm7-follow", "clutch_closed", "largest error from 0.5 s after the clutch was closed in motion"),
    row("arm7-follow", "ours_acceleration", "largest acceleration of the set-point, sine"),
    row("arm7-follow", "paper_reversals", "the paper's law: along x at the reversals"),
    row("arm7-follow", "paper_rest_x", "the paper's law: along x at rest"),
];

const BILATERAL: &[Row] = &[
    row("arm7-bilateral", "wall_200_delay_0_settled", "200 N/m, no delay: until the handle rests"),
    row("arm7-bilateral", "wall_200_delay_20_settled", "200 N/m, 20 ms each way"),
    row("arm7-bilateral", "wall_200_delay_50_settled", "200 N/m, 50 ms each way"),
    row("arm7-bilateral", "wall_2000_delay_0_settled", "2000 N/m, no delay"),
    row("arm7-bilateral", "wall_2000_delay_20_settled", "2000 N/m, 20 ms"),
    row("arm7-bilateral", "wall_2000_delay_50_settled", "2000 N/m, 50 ms"),
    row("arm7-bilateral", "wall_50000_delay_0_settled", "50 000 N/m, no delay"),
    row("arm7-bilateral", "wall_50000_delay_20_settled", "50 000 N/m, 20 ms"),
    row("arm7-bilateral", "wall_50000_delay_50_settled", "50 000 N/m, 50 ms"),
    row("arm7-bilateral", "wall_200_delay_50_made", "200 N/m, 50 ms: energy made"),
    row("arm7-bilateral", "wall_2000_delay_50_made", "2000 N/m, 50 ms: energy made"),
    row("arm7-bilateral", "wall_50000_delay_0_made", "50 000 N/m, no delay: energy made"),
    row("arm7-bilateral", "wall_50000_delay_20_made", "50 000 N/m, 20 ms: energy made"),
    row("arm7-bilateral", "wall_50000_delay_50_made", "50 000 N/m, 50 ms: energy made"),
    row(
        "arm7-bilateral",
        "wall_2000_delay_50_unguarded_settled",
        "2000 N/m, 50 ms, no passivity control: until at rest",
    ),
    row("arm7-bilateral", "wall_2000_delay_50_unguarded_made", "the same: energy made"),
];

#[cfg(test)]
pub mod fixtures {
    use super::{Bound, Row};

    /// A row of the sweep in `record::fixtures`.
    pub const fn row(bound: Bound) -> Row {
        Row { scenario: "arm", metric: "error", bound, label: "Error" }
    }
}
