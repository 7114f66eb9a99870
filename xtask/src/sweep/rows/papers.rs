//! The tables of the papers' pages.

use super::{Pair, Row, Rows, Table, at_least, magnitude, row};

/// Creates a pair for a quantity with only our law.
const fn ours(paper: Option<&'static str>, row: Row) -> Pair {
    Pair { label: row.label, paper, papers_law: None, ours: Some(row), is_error: false }
}

/// Creates a pair for an error with the paper's law and with ours.
const fn errors(label: &'static str, laws: [Row; 2]) -> Pair {
    Pair { is_error: true, ..both(label, laws) }
}

/// Creates a pair for a quantity with the paper's law and with ours.
const fn both(label: &'static str, [papers_law, ours]: [Row; 2]) -> Pair {
    Pair { label, paper: None, papers_law: Some(papers_law), ours: Some(ours), is_error: false }
}

/// Creates a row for the magnitude of a metric; the label is that of its pair.
const fn size(scenario: &'static str, metric: &'static str) -> Row {
    magnitude(scenario, metric, "")
}

/// The rows of a metric under the paper's law and under ours; its name begins with that of the law.
macro_rules! laws {
    ($scenario:expr, $metric:literal) => {
        laws!($scenario, "paper", "tesaki", $metric)
    };
    ($scenario:expr, $papers:literal, $ours:literal, $metric:literal) => {
        [size($scenario, concat!($papers, "_", $metric)), size($scenario, concat!($ours, "_", $metric))]
    };
}

const HAND3_PAGE: &str = "docs/papers/hand3.md";
const ARM7_PAGE: &str = "docs/papers/arm7.md";
const HAND5_PAGE: &str = "docs/papers/hand5.md";
const KNOB_PAGE: &str = "docs/papers/knob.md";

const HAND3_FORCE: &str = "hand3-paper-force";
const HAND3_CURVES: &str = "hand3-paper-curves";
const HAND3_MOTION: &str = "hand3-paper-motion";
const ARM7: &str = "arm7-paper";
const ARM7_ELBOW: &str = "arm7-paper-elbow";
const ARM7_MATRICES: &str = "arm7-paper-matrices";
const ARM7_SECTION4: &str = "arm7-paper-bilateral";

const HAND3_FIGURE6: &[Pair] = &[
    errors("largest error of a joint", laws!(HAND3_MOTION, "step_error_peak")),
    errors("at rest", laws!(HAND3_MOTION, "step_error_rest")),
];

const HAND3_FIGURE11: &[Pair] = &[
    both("force of finger 1 by its sensor, 2 N commanded", laws!(HAND3_FORCE, "sensed_force")),
    both("along x, 1.48 N commanded", laws!(HAND3_FORCE, "sensed_x")),
    both("magnitude along y, 0 N commanded", laws!(HAND3_FORCE, "sensed_y")),
    both("magnitude along z, 1.34 N commanded", laws!(HAND3_FORCE, "sensed_z")),
    errors("error of the force", laws!(HAND3_FORCE, "force_error")),
];

const HAND3_FRICTION: &[Pair] = &[
    ours(
        Some("0.89 N"),
        row(HAND3_FORCE, "paper_sensed_force_at_20mNm", "force of finger 1, joint friction 20 mN·m"),
    ),
    ours(
        Some("0.89 N"),
        row(HAND3_FORCE, "paper_sensed_force_at_60mNm", "force of finger 1, joint friction 60 mN·m"),
    ),
    ours(
        Some("0.89 N"),
        row(HAND3_FORCE, "paper_sensed_force_at_100mNm", "force of finger 1, joint friction 100 mN·m"),
    ),
];

const HAND3_EFFICIENCY: &[Pair] = &[
    ours(
        Some("0.89 N"),
        row(HAND3_CURVES, "paper_force_at_100", "force of finger 1, all of the torque reaches the joints"),
    ),
    ours(Some("0.89 N"), row(HAND3_CURVES, "paper_force_at_90", "force of finger 1, 90 % of it")),
    ours(Some("0.89 N"), row(HAND3_CURVES, "paper_force_at_80", "force of finger 1, 80 % of it")),
    ours(Some("0.89 N"), row(HAND3_CURVES, "paper_force_at_70", "force of finger 1, 70 % of it")),
];

const HAND3_FIGURE12: &[Pair] = &[
    errors("sensed weight, error", laws!(HAND3_FORCE, "sensed_weight_error")),
    errors("motion of the box", laws!(HAND3_FORCE, "weights_motion")),
    both("box lost (1 if so)", laws!(HAND3_FORCE, "weights_lost")),
];

const HAND3_FIGURE14: &[Pair] = &[
    errors(
        "as estimated by the hand: pitch, worst of four turns",
        laws!(HAND3_MOTION, "motion_pitch_error_estimated"),
    ),
    errors("shift by +1 cm", laws!(HAND3_MOTION, "motion_shift1_error_estimated")),
    errors("shift by −1 cm", laws!(HAND3_MOTION, "motion_shift2_error_estimated")),
    errors("drift along z", laws!(HAND3_MOTION, "motion_from_start_z_estimated")),
    errors("true pose: pitch, worst of four turns", laws!(HAND3_MOTION, "motion_pitch_error_true")),
    errors("shift by +1 cm", laws!(HAND3_MOTION, "motion_shift1_error_true")),
    errors("shift by −1 cm", laws!(HAND3_MOTION, "motion_shift2_error_true")),
    both("box lost (1 if so)", laws!(HAND3_MOTION, "motion_lost")),
];

const HAND3_JOINT: &[Pair] = &[
    errors("true pose: pitch, worst of four turns", laws!(HAND3_MOTION, "joint_pitch_error_true")),
    errors("shift by +1 cm", laws!(HAND3_MOTION, "joint_shift1_error_true")),
    errors("shift by −1 cm", laws!(HAND3_MOTION, "joint_shift2_error_true")),
];

const ARM7_FIGURE5: &[Pair] = &[
    both("model's machine, B 7.5: overshoot", laws!(ARM7, "release_matched_b7_5_overshoot")),
    errors("distance from the theory", laws!(ARM7, "release_matched_b7_5_error_peak")),
    both("B 30: overshoot", laws!(ARM7, "release_matched_b30_overshoot")),
    errors("distance from the theory", laws!(ARM7, "release_matched_b30_error_peak")),
    errors(
        "mismatched machine, B 7.5: distance from the theory",
        laws!(ARM7, "release_mismatched_b7_5_error_peak"),
    ),
    errors("B 30: distance from the theory", laws!(ARM7, "release_mismatched_b30_error_peak")),
];

const ARM7_ELBOWS: &[Pair] = &[
    both(
        "mismatched machine, pseudo-inverse: turn of the elbow",
        laws!(ARM7_ELBOW, "pseudo_inverse", "tesaki", "mismatched_elbow_turn"),
    ),
    errors(
        "step 4 as printed, model's machine: motion of the hand",
        laws!(ARM7_ELBOW, "matched_hand_displacement"),
    ),
    errors(
        "model's machine, with the driven joint's term",
        laws!(ARM7_ELBOW, "corrected", "tesaki", "matched_hand_displacement"),
    ),
    errors("mismatched machine, as printed", laws!(ARM7_ELBOW, "mismatched_hand_displacement")),
];

const ARM7_BILATERAL: &[Pair] = &[
    errors(
        "no delay: force felt at rest, minus that on the wall",
        laws!(ARM7_SECTION4, "paper", "matched", "delay_0_force_error"),
    ),
    errors("slave from master at rest", laws!(ARM7_SECTION4, "paper", "matched", "delay_0_distance")),
    errors(
        "rotation of the slave from the master at rest",
        laws!(ARM7_SECTION4, "paper", "matched", "delay_0_rotation"),
    ),
    errors(
        "torque felt under a push, minus that on the tool",
        laws!(ARM7_SECTION4, "paper", "matched", "delay_0_torque_error"),
    ),
    errors(
        "50 ms: force felt at rest, minus that on the wall",
        laws!(ARM7_SECTION4, "paper", "matched", "delay_50_force_error"),
    ),
    both(
        "50 ms: settling time of the handle",
        laws!(ARM7_SECTION4, "paper", "matched", "delay_50_settling_time"),
    ),
    both(
        "no delay: force on the wall, matched impedances and reflected spring",
        laws!(ARM7_SECTION4, "matched", "tesaki", "delay_0_wall_force"),
    ),
];

const ARM7_PUSHES: &[Pair] = &[
    errors(
        "model's machine, coupled: distance from K⁻¹F at rest",
        laws!(ARM7_MATRICES, "paper_coupled", "coupled", "matched_rest_error"),
    ),
    errors("angle to K⁻¹F", laws!(ARM7_MATRICES, "paper_coupled", "coupled", "matched_direction_error")),
    errors(
        "distance from the exact motion",
        laws!(ARM7_MATRICES, "paper_coupled", "coupled", "matched_deviation"),
    ),
    ours(
        None,
        magnitude(ARM7_MATRICES, "tool_axes_matched_rest_error", "in the axes of the tool: distance at rest"),
    ),
    ours(None, magnitude(ARM7_MATRICES, "tool_axes_matched_turn_error", "rotation, of up to 50 mrad")),
    errors(
        "mismatched machine, coupled: distance at rest",
        laws!(ARM7_MATRICES, "paper_coupled", "coupled", "mismatched_rest_error"),
    ),
    ours(
        None,
        magnitude(
            ARM7_MATRICES,
            "tool_axes_mismatched_rest_error",
            "in the axes of the tool: distance at rest",
        ),
    ),
];

const ARM7_FIGURE7: &[Pair] = &[
    errors("without a link: error at the reversals", laws!(ARM7, "follow_direct_reversals")),
    errors("at rest", laws!(ARM7, "follow_direct_rest")),
    errors("over a link of 20 ms: error at the reversals", laws!(ARM7, "follow_link_reversals")),
    errors("at rest", laws!(ARM7, "follow_link_rest")),
    errors(
        "the paper's law without its friction term, without a link: at the reversals",
        laws!(ARM7, "paper_without_friction", "tesaki", "follow_direct_reversals"),
    ),
];

const HAND5_FIGURE4: &[Pair] = &[
    ours(None, row("hand5-calibrate", "full_index_length_mean", "length: mean error")),
    ours(None, row("hand5-calibrate", "full_index_length_deviation", "length: standard deviation")),
    ours(None, row("hand5-calibrate", "full_index_direction_mean", "direction: mean error")),
    ours(None, row("hand5-calibrate", "full_index_direction_deviation", "direction: standard deviation")),
];

const HAND5_QUICK: &[Pair] = &[
    ours(Some("5–10 min"), row("hand5-calibrate", "quick_time", "time of the calibration")),
    ours(None, row("hand5-calibrate", "quick_index_length_mean", "index finger, length: mean error")),
    ours(None, row("hand5-calibrate", "quick_index_length_deviation", "its standard deviation")),
    ours(
        None,
        row("hand5-calibrate", "quick_middle_length_mean", "middle finger, without a marker: mean error"),
    ),
    ours(None, row("hand5-calibrate", "quick_middle_length_deviation", "its standard deviation")),
];

const HAND5_FIGURE5: &[Pair] = &[
    ours(
        Some("exact"),
        row("hand5-reach", "own_stated_error", "kinematics, targets within reach: largest error"),
    ),
    ours(None, row("hand5-reach", "own_thumb_rms", "the robot's true thumb: rms error")),
    ours(None, row("hand5-reach", "own_index_rms", "its true vector to the index finger: rms error")),
    ours(
        Some("some deviation"),
        row("hand5-reach", "human_index_stated", "kinematics, another person's index finger: rms error"),
    ),
    ours(None, row("hand5-reach", "human_little_stated", "the same, little finger")),
];

const KNOB_FIGURE7: &[Pair] = &[
    ours(None, at_least("knob-find", "whole_right", "pictures with the right circle")),
    ours(None, row("knob-find", "whole_wrong", "pictures with a wrong one")),
    ours(None, row("knob-find", "whole_center", "error of the centre")),
    ours(None, row("knob-find", "whole_radius", "error of the radius")),
];

const KNOB_FIGURE8: &[Pair] = &[
    ours(Some("about 1 min"), row("knob-grasp", "time", "time of an approach")),
    ours(None, row("knob-grasp", "longest", "the longest of those that grip, of ten")),
    ours(Some("grasped"), at_least("knob-grasp", "gripped", "knobs that are gripped, share of ten")),
];

/// The tables, in the order of the pages.
pub const TABLES: &[Table] = &[
    Table { document: HAND3_PAGE, name: "hand3-figure6", rows: Rows::Comparison(HAND3_FIGURE6) },
    Table { document: HAND3_PAGE, name: "hand3-figure11", rows: Rows::Comparison(HAND3_FIGURE11) },
    Table { document: HAND3_PAGE, name: "hand3-friction", rows: Rows::Comparison(HAND3_FRICTION) },
    Table { document: HAND3_PAGE, name: "hand3-efficiency", rows: Rows::Comparison(HAND3_EFFICIENCY) },
    Table { document: HAND3_PAGE, name: "hand3-figure12", rows: Rows::Comparison(HAND3_FIGURE12) },
    Table { document: HAND3_PAGE, name: "hand3-figure14", rows: Rows::Comparison(HAND3_FIGURE14) },
    Table { document: HAND3_PAGE, name: "hand3-joint", rows: Rows::Comparison(HAND3_JOINT) },
    Table { document: ARM7_PAGE, name: "arm7-figure5", rows: Rows::Comparison(ARM7_FIGURE5) },
    Table { document: ARM7_PAGE, name: "arm7-elbow", rows: Rows::Comparison(ARM7_ELBOWS) },
    Table { document: ARM7_PAGE, name: "arm7-figure7", rows: Rows::Comparison(ARM7_FIGURE7) },
    Table { document: ARM7_PAGE, name: "arm7-bilateral", rows: Rows::Comparison(ARM7_BILATERAL) },
    Table { document: ARM7_PAGE, name: "arm7-matrices", rows: Rows::Comparison(ARM7_PUSHES) },
    Table { document: HAND5_PAGE, name: "hand5-figure4", rows: Rows::Comparison(HAND5_FIGURE4) },
    Table { document: HAND5_PAGE, name: "hand5-quick", rows: Rows::Comparison(HAND5_QUICK) },
    Table { document: HAND5_PAGE, name: "hand5-figure5", rows: Rows::Comparison(HAND5_FIGURE5) },
    Table { document: KNOB_PAGE, name: "knob-figure7", rows: Rows::Comparison(KNOB_FIGURE7) },
    Table { document: KNOB_PAGE, name: "knob-figure8", rows: Rows::Comparison(KNOB_FIGURE8) },
];
