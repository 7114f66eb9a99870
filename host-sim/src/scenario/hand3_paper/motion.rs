//! Figures 14 and 15, and section 5.5: the box is turned and shifted in one grasp.

use rapier3d::na::Vector3;
use tesaki_description::law::hand::MotionExperiment;

use super::{LAWS, Law, Metrics, compare, hold_box, laws, step};
use crate::report::{Figure, Line, Panel, Summary};
use crate::scenario::common::largest;
use crate::scenario::grasping::{GraspLog, GraspRig, GraspSample, table, xyz};
use crate::scenario::{Kind, Outcome, Scenario, ScenarioError, Setting, needs};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-paper-motion",
    title: "Motion of a held box, as the Hand3 paper measured it",
    about: "figures 6, 14 and 15 of the Hand3 paper under its laws and under ours: joint PID, turns, a shift",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: needs::BOX,
    results: "docs/papers/hand3.md",
    duration: 170.0,
    shortest: None,
    laws: Some(LAWS),
    lead: &[
        "The hand grasps the paper's box at (90, 0, 85) mm, the support is removed, and in one grasp the box is turned \
         about the hand's y axis by +0.1, −0.1, −0.1 and +0.1 rad, and then shifted along x by +1 and −1 cm (section \
         7, figures 14 and 15). Each motion takes one second and is followed by two and a half seconds of rest. The \
         same is done by the PID of the joints (section 5.5). Before, all joints step through G(s) without an object \
         (section 4, figure 6). Each experiment runs under each law on the same machine. Its joints have four times the \
         Coulomb friction of our other experiments (`friction.paper` in robots/hand3/plant.toml); a law says whether its \
         controller is told.",
        "The paper's laws as printed: the pose of the box is the frame of the fingertips' triangle, as if tips did not \
         roll; PI control of that pose gives a wrench, which is converted to joint torques with some damping, and \
         weight and friction of the fingers are not compensated (equations 19 and 20); or the joints' targets are \
         the sums of the changes for the box's motion (equations 22 to 25), and each joint has a PID alone.",
        "The paper reads its poses from the fingertips, so its numbers stand beside the pose as the hand estimates it. \
         What the box truly does is given too: the estimate cannot see that the tips roll on the box.",
    ],
    run,
};

/// The paper's pitches after the turns [rad], and x after the shifts [cm].
const PAPER_PITCHES: [f64; 3] = [0.868, 0.769, 0.673];
const PAPER_POSITIONS: [f64; 3] = [8.4, 9.3, 8.1];

/// Least height of the axes of positions [cm].
const MIN_HEIGHT: f64 = 0.5;

/// What happened under a law.
pub(super) struct Record {
    log: GraspLog,
    /// When each turn began, and each shift [s].
    turns: Vec<f64>,
    shifts: Vec<f64>,
    duration: f64,
    rest: f64,
    /// Time from the begin of a motion until its error is evaluated [s].
    evaluated: f64,
}

/// The part of a law that is tried.
type Experiment = fn(&Law) -> &MotionExperiment;

/// Pitch and position of the box [rad, m].
pub(super) type Pose = (f64, Vector3<f64>);
/// The pose in a sample.
pub(super) type PoseOf = fn(&GraspSample) -> Pose;

fn true_pose(sample: &GraspSample) -> Pose {
    (sample.angles()[1], sample.position())
}

pub(super) fn estimated_pose(sample: &GraspSample) -> Pose {
    (sample.estimates.pitch(), sample.estimates.position)
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let laws = laws(setting, &rig.robot.model)?;
    let mut summary = Summary::default();
    let mut figures = vec![step::run(setting, &mut rig, &laws, &mut summary)?];
    let mut tables = Vec::new();
    let parts: [(&str, &str, Experiment); 2] = [
        ("motion", "figures 14 and 15", |law| &law.law.motion),
        ("joint", "section 5.5", |law| &law.law.joint_control),
    ];
    for (part, place, experiment) in parts {
        let mut records = Vec::new();
        for law in &laws {
            let record = move_box(setting, &mut rig, law, part, experiment(law))?;
            tables.push((format!("{part}-{}.csv", law.key), table(&record.log)));
            records.push(record);
        }
        add_metrics(&mut summary, &laws, part, experiment, &records);
        figures.push(attitude(&laws, place, &records));
        figures.push(position(&laws, place, &records));
    }
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// The turns, and then the shifts, in one grasp.
pub(super) fn move_box(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    law: &Law,
    part: &str,
    experiment: &MotionExperiment,
) -> Result<Record, ScenarioError> {
    let coulomb = rig.values.friction.paper;
    let label = format!("{part}, {}", law.name);
    let mut trial = hold_box(setting, rig, &label, (law, &experiment.law), coulomb)?;
    let MotionExperiment { duration, rest, initial_rest, evaluated, .. } = *experiment;
    trial.wait(initial_rest)?;
    let (mut pitch, mut x) = (0.0, 0.0);
    let (mut turns, mut shifts) = (Vec::new(), Vec::new());
    for turn in &experiment.turns {
        pitch += turn;
        turns.push(trial.move_object_within(duration, [x, 0.0, 0.0], [0.0, pitch, 0.0])?);
        trial.wait(duration + rest)?;
    }
    for shift in &experiment.shifts {
        x += shift;
        shifts.push(trial.move_object_within(duration, [x, 0.0, 0.0], [0.0, pitch, 0.0])?);
        trial.wait(duration + rest)?;
    }
    let evaluated = duration + evaluated.min(rest);
    Ok(Record { log: trial.end()?, turns, shifts, duration, rest, evaluated })
}

impl Record {
    /// When the first motion began [s].
    fn begin(&self) -> f64 {
        self.turns.first().or(self.shifts.first()).copied().unwrap_or(f64::NAN)
    }

    /// Error of the pitch at rest after a turn that began at `begin`, from that before the first [mrad]. NaN
    /// if the box was lost before.
    fn turn_error(&self, begin: f64, pose: PoseOf) -> f64 {
        let rest = self.log.at(begin + self.evaluated);
        let (Some(start), Some(rest)) = (self.log.at(self.begin()), rest) else { return f64::NAN };
        1e3 * (pose(rest).0 - pose(start).0 - (rest.target[1].y - start.target[1].y)).abs()
    }

    /// Worst error of the pitch after the turns [mrad].
    pub(super) fn pitch_error(&self, pose: PoseOf) -> f64 {
        largest(self.turns.iter().map(|&begin| self.turn_error(begin, pose)))
    }

    /// Displacements of the box by each shift, from rest to rest [mm].
    pub(super) fn displacements(&self, pose: PoseOf) -> Vec<Vector3<f64>> {
        let rest = |time: f64| self.log.at(time).map_or(Vector3::repeat(f64::NAN), |sample| pose(sample).1);
        let Some(&first) = self.shifts.first() else { return Vec::new() };
        let mut before = rest(first);
        let mut displacements = Vec::new();
        for begin in &self.shifts {
            let after = rest(begin + self.evaluated);
            displacements.push(1e3 * (after - before));
            before = after;
        }
        displacements
    }
}

/// Errors of the displacements along x [mm].
pub(super) fn shift_errors(
    experiment: &MotionExperiment,
    moved: &[Vector3<f64>],
) -> impl Iterator<Item = f64> {
    moved.iter().zip(&experiment.shifts).map(|(moved, shift)| (moved.x - 1e3 * shift).abs())
}

fn add_metrics(summary: &mut Summary, laws: &[Law], part: &str, experiment: Experiment, records: &[Record]) {
    let poses: [(&str, &str, PoseOf); 2] =
        [("estimated", "as the hand estimates it", estimated_pose), ("true", "of the true box", true_pose)];
    for (law, record) in laws.iter().zip(records) {
        let mut metrics = Metrics::new(summary, law, part, &record.log);
        for (which, text, pose) in poses {
            // The paper's numbers are of figures 14 and 15, of poses that the hand estimated.
            let paper = |text| if which == "estimated" && part == "motion" { text } else { "" };
            let mut add = |key: &str, what: &str, value: f64, unit: &str, number: &'static str| {
                let key = format!("{part}_{key}_{which}");
                metrics.add(&key, &format!("{part}: {what}, {text}"), value, unit, paper(number));
            };
            let name = "pitch error at rest, worst turn";
            add("pitch_error", name, record.pitch_error(pose), "mrad", "1–4 mrad");
            let moved = record.displacements(pose);
            let numbers = ["9 mm", "−12 mm"].into_iter().chain(std::iter::repeat(""));
            for (number, (moved, paper)) in (1..).zip(moved.iter().zip(numbers)) {
                let name = format!("displacement along x by shift {number}");
                add(&format!("shift{number}"), &name, moved.x, "mm", paper);
            }
            let numbers = ["1 mm", "2 mm"].into_iter().chain(std::iter::repeat(""));
            for (number, (error, paper)) in (1..).zip(shift_errors(experiment(law), &moved).zip(numbers)) {
                let name = format!("error along x of shift {number}");
                add(&format!("shift{number}_error"), &name, error, "mm", paper);
            }
            let total: Vector3<f64> = moved.iter().sum();
            add("from_start_x", "x after the shifts, from the start", total.x, "mm", "−3 mm");
            add("from_start_z", "z after the shifts, from the start", total.z, "mm", "−5 mm");
        }
    }
    for (which, text, pose) in poses {
        let errors: Vec<f64> = records.iter().map(|record| record.pitch_error(pose)).collect();
        let label = format!("{part}: pitch error, {text}");
        compare(summary, laws, &format!("{part}_pitch_error_{which}"), &label, &errors);
        let shifts = |(law, record): (&Law, &Record)| {
            largest(shift_errors(experiment(law), &record.displacements(pose)))
        };
        let errors: Vec<f64> = laws.iter().zip(records).map(shifts).collect();
        let label = format!("{part}: shift error along x, {text}");
        compare(summary, laws, &format!("{part}_shift_error_{which}"), &label, &errors);
    }
}

fn mark(mut figure: Figure, records: &[Record]) -> Figure {
    let Some(record) = records.first() else { return figure };
    for (begins, what) in [(&record.turns, "turn"), (&record.shifts, "shift")] {
        for (number, begin) in (1..).zip(begins) {
            let from = begin - record.begin();
            let end = from + record.duration;
            figure = figure.phase(from, end, format!("{what} {number}")).phase(end, end + record.rest, "");
        }
    }
    figure
}

/// A line for each of estimate, truth and reference, of the same colours in every panel: those of other pairs
/// are hard to tell apart.
fn lines(
    panel: Panel,
    record: &Record,
    name: &str,
    value: impl Fn(Pose) -> f64,
    reference: impl Fn(&GraspSample) -> f64,
) -> Panel {
    let samples: Vec<&GraspSample> =
        record.log.samples.iter().filter(|sample| sample.time >= record.begin() - 0.5).collect();
    let time: Vec<f64> = samples.iter().map(|sample| sample.time - record.begin()).collect();
    let [mut estimated, mut truth, mut desired] = [const { Vec::new() }; 3];
    let Some(start) = record.log.at(record.begin()) else { return panel };
    // The true box and the frame of the fingertips have different origins: the true motion is drawn from the
    // start of the estimated one.
    let offset = value(estimated_pose(start)) - value(true_pose(start));
    for sample in &samples {
        estimated.push(value(estimated_pose(sample)));
        truth.push(value(true_pose(sample)) + offset);
        desired.push(value(estimated_pose(start)) + reference(sample) - reference(start));
    }
    panel
        .line(Line::solid(format!("{name} estimated"), 0, time.clone(), estimated))
        .line(Line::solid(format!("{name} true"), 3, time.clone(), truth))
        .line(Line::dashed(format!("{name} reference"), Line::INK, time, desired))
}

fn attitude(laws: &[Law], place: &str, records: &[Record]) -> Figure {
    let caption = "Pitch of the box in the hand's frame as the hand estimates it, of the true box, drawn from the same \
                   start, and its reference (dashed), under each law on the same machine. Horizontal lines: where \
                   figure 14 of the Hand3 paper has it at rest, 0.868, 0.769 and 0.673 rad.";
    let title = format!("Hand3 {place}: attitude of the box");
    let mut figure = mark(Figure::stacked(title, caption, "time", "s"), records);
    for (law, record) in laws.iter().zip(records) {
        let panel = Panel::new(law.law.title.as_str(), "pitch", "rad");
        let mut panel = lines(panel, record, "pitch", |(pitch, _)| pitch, |sample| sample.target[1].y);
        for pitch in PAPER_PITCHES {
            panel = panel.rule(pitch, format!("paper {pitch}"));
        }
        figure = figure.panel(panel);
    }
    figure
}

fn position(laws: &[Law], place: &str, records: &[Record]) -> Figure {
    let caption = "Position of the box in the hand's frame as the hand estimates it (the centroid of the fingertips), of \
                   the true box, drawn from the same start, and its reference (dashed), under each law on the same \
                   machine. Horizontal lines: x at rest in figure 15 of the Hand3 paper, 8.4, 9.3 and 8.1 cm.";
    let title = format!("Hand3 {place}: position of the box");
    let mut figure = mark(Figure::stacked(title, caption, "time", "s"), records);
    for (law, record) in laws.iter().zip(records) {
        for (axis, name) in xyz() {
            let panel =
                Panel::new(format!("{}, {name}", law.law.title), "position", "cm").at_least(MIN_HEIGHT);
            let value = |(_, position): Pose| 1e2 * position[axis];
            let mut panel = lines(panel, record, name, value, |sample| 1e2 * sample.target[0][axis]);
            if axis == 0 {
                for x in PAPER_POSITIONS {
                    panel = panel.rule(x, format!("paper {x}"));
                }
            }
            figure = figure.panel(panel);
        }
    }
    figure
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use rapier3d::na::UnitQuaternion;

    use super::super::tests::log;
    use super::*;
    use crate::scenario::common::tests::with_setting;

    /// A box that does what figures 14 and 15 of the paper show: pitch 0.769, 0.868, then x 8.4, 9.3, 8.1 cm,
    /// z 5 mm down. The errors are those that the paper tells: 1 mrad, 1 mm and 2 mm, −3 mm and −5 mm from
    /// the start.
    #[test]
    fn the_papers_motion_has_the_papers_errors() {
        let log = log(11.0, |sample| {
            let at = |begin: f64| sample.time > begin;
            let (pitch, turned) = if at(1.5) { (0.868, 0.1) } else { (0.769, 0.0) };
            let (x, z) = match sample.time {
                time if time > 7.5 => (0.081, 0.080),
                time if time > 4.5 => (0.093, 0.082),
                _ => (0.084, 0.085),
            };
            sample.target[1].y = turned;
            sample.estimates.position = Vector3::new(x, 0.0, z);
            sample.estimates.orientation = UnitQuaternion::from_scaled_axis(Vector3::y() * pitch);
        });
        let record = Record {
            log,
            turns: vec![1.0],
            shifts: vec![4.0, 7.0],
            duration: 1.0,
            rest: 2.5,
            evaluated: 3.0,
        };
        assert!((record.pitch_error(estimated_pose) - 1.0).abs() < 1e-9);
        let moved = record.displacements(estimated_pose);
        with_setting("hand3", 1, &["paper"], |setting| {
            let rig = GraspRig::load(setting).unwrap();
            let experiment = &laws(setting, &rig.robot.model).unwrap()[0].law.motion;
            assert_eq!(experiment.shifts, [0.01, -0.01]);
            let errors: Vec<f64> = shift_errors(experiment, &moved).collect();
            assert!((errors[0] - 1.0).abs() < 1e-9 && (errors[1] - 2.0).abs() < 1e-9, "{errors:?}");
        });
        let total: Vector3<f64> = moved.iter().sum();
        assert!((total - Vector3::new(-3.0, 0.0, -5.0)).norm() < 1e-9, "{total}");
        // The box was lost before the second shift ended.
        let mut lost = record;
        lost.log.samples.truncate(900);
        assert!(
            lost.displacements(estimated_pose)[1].x.is_nan() && !lost.pitch_error(estimated_pose).is_nan()
        );
    }
}
