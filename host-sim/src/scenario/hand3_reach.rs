//! Fingertip trajectories: three fingertips track circles and squares at once (Hand3, sections 2 and 4), on a
//! machine that differs from the controller's model.

use std::f64::consts::TAU;

use rapier3d::na::{Vector2, Vector3};
use tesaki::control::ServoMode;
use tesaki::kinematics::{Chain, TipPoint};
use tesaki::model::{Pose, RobotModel};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::Board;
use tesaki_supervisor::trajectory::minimum_jerk;

use super::common::{T, capitalized, fault_error, largest, prepare, request_error};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::controller::{Controller, Watched};
use crate::motion::Motion;
use crate::plant::{Plant, PlantOptions, isometry};
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-reach",
    title: "Fingertips of the three-finger hand in space",
    about: "three fingertips draw circles at 1 Hz and squares under PID and under the observer",
    robot: "hand3",
    kind: Kind::Fingers,
    files: &[],
    results: "docs/measurements.md#fingertips-in-space",
    duration: 2.0 * TRIAL,
    shortest: None,
    laws: None,
    lead: &[
        "The tips of all three fingers draw a circle of 10 mm radius at one revolution per second, and a square of \
         16 mm whose sides take half a second each, in planes normal to the hand's x axis. Every 10 ms the \
         supervisor sends a point of each path with its velocity and acceleration. The board computes the \
         joint angles in closed form, the joint velocities with the Jacobian and the joint accelerations \
         with J̇q̇, and feeds them forward.",
        "The fingertip's position is the true one of the physics engine, not the controller's estimate. \
         Besides the servo errors it contains the homing error, up to 2 mrad per joint, which no servo can \
         detect. It shifts the whole path; the rows \"without the constant offset\" exclude it.",
    ],
    run,
};

/// Length of a trial [s].
const TRIAL: f64 = 13.5;
/// Joint angles of each finger at the centre of its paths [rad].
const MIDDLE: [f32; 3] = [0.0, 0.1, 1.3];
/// Time for the joints to reach the centre of the paths through their trajectory filters [s].
const APPROACH: f64 = 2.0;
/// Radius of the circle [m].
const RADIUS: f64 = 0.010;
/// Half the side of the square [m].
const HALF_SIDE: f64 = 0.008;
/// Start, ramp time, and end of the circle [s].
const CIRCLE: (f64, f64, f64) = (3.0, 1.0, 8.0);
/// Start, time per side, and end of the square [s].
const SQUARE: (f64, f64, f64) = (8.5, 0.5, 12.5);

struct Trial {
    name: &'static str,
    label: &'static str,
    mode: ServoMode,
    /// Limit of the rms distance of a tip from its path [mm].
    limit: Option<f64>,
}

const TRIALS: [Trial; 2] = [
    Trial { name: "pid", label: "PID", mode: ServoMode::Pid, limit: None },
    Trial { name: "observer", label: "observer", mode: ServoMode::Observer, limit: Some(0.5) },
];

/// Log of a trial.
struct TipLog {
    time: Vec<f64>,
    /// True position and reference of each tip in each tick [m].
    tips: Vec<Vec<(Vector3<f64>, Vector3<f64>)>>,
}

/// Begin and end of a path [s].
type Window = (f64, f64);

const PATHS: [(&str, Window); 2] =
    [("circle", (CIRCLE.0 + CIRCLE.1, CIRCLE.2 - CIRCLE.1)), ("square", (SQUARE.0, SQUARE.2))];

impl TipLog {
    /// Position errors of a tip in a window [mm].
    fn errors(&self, tip: usize, (from, to): Window) -> Vec<Vector3<f64>> {
        let inside = |time: f64| time >= from - 1e-9 && time <= to + 1e-9;
        let all = self.time.iter().zip(&self.tips[tip]);
        all.filter(|(time, _)| inside(**time))
            .map(|(_, (position, reference))| (position - reference) * 1e3)
            .collect()
    }

    /// Components y and z of points [mm]; NaN outside the paths.
    fn components(&self, points: impl Iterator<Item = Vector3<f64>>) -> (Vec<f64>, Vec<f64>) {
        let inside = |time: f64| PATHS.iter().any(|(_, (from, to))| time >= *from && time <= *to);
        let points = self.time.iter().zip(points);
        points
            .map(
                |(&time, point)| {
                    if inside(time) { (1e3 * point.y, 1e3 * point.z) } else { (f64::NAN, f64::NAN) }
                },
            )
            .unzip()
    }

    /// Rms distance from the path, of the worst tip, with and without the constant offset; and the largest
    /// distance of any tip [mm].
    fn worst(&self, window: Window) -> [f64; 3] {
        let of_tip = |tip: usize| {
            let errors = self.errors(tip, window);
            let count = errors.len() as f64;
            let mean = errors.iter().sum::<Vector3<f64>>() / count;
            let rms = |offset: Vector3<f64>| {
                (errors.iter().map(|error| (error - offset).norm_squared()).sum::<f64>() / count).sqrt()
            };
            [rms(Vector3::zeros()), rms(mean), largest(errors.iter().map(Vector3::norm))]
        };
        let tips: Vec<[f64; 3]> = (0..self.tips.len()).map(of_tip).collect();
        [0, 1, 2].map(|value| largest(tips.iter().map(|tip| tip[value])))
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let robot = RobotFolder::load(setting.robot)?;
    let mut summary = Summary::default();
    let (mut figures, mut tables) = (Vec::new(), Vec::new());
    let mut motion = setting.motion(&robot.model);
    for (index, trial) in TRIALS.iter().enumerate() {
        let progress = |fraction: f64| (setting.progress)((index as f64 + fraction) / 2.0);
        let plant = Plant::of(&robot, &PlantOptions::mismatched(setting.seed))?;
        let mut plant = plant.under(setting.intervention.clone());
        let recording =
            run_trial(trial, &robot.model, &mut plant, setting.controller, &mut motion, &progress)?;
        add_metrics(&mut summary, trial, &recording);
        figures.push(paths(trial, &recording, &robot.model));
        figures.push(errors(trial, &recording, &robot.model));
        tables.push((format!("{}.csv", trial.name), table(&recording, &robot.model)));
    }
    Ok(Outcome { summary, figures, tables, motion })
}

fn run_trial(
    trial: &Trial,
    model: &RobotModel,
    plant: &mut Plant,
    controller: &mut Watched<'_>,
    motion: &mut Motion,
    progress: &dyn Fn(f64),
) -> Result<TipLog, ScenarioError> {
    prepare(controller, plant, model, trial.mode, motion)?;
    let middle = MIDDLE.repeat(model.chains.len());
    let mut centers = Vec::new();
    for (chain, range) in model.chains.iter().zip(model.chain_ranges()) {
        let posture = Chain::new(&model.joints[range.clone()], &chain.tip).posture(&middle[range]);
        centers.push(posture.tip().translation.vector.map(f64::from));
    }
    let mut recording = TipLog { time: Vec::new(), tips: vec![Vec::new(); centers.len()] };
    let ticks = (TRIAL / T).round() as u32;
    for tick in 0..ticks {
        let time = f64::from(tick) * T;
        let point = path(time);
        let tips: Vec<TipPoint> = centers.iter().map(|center| point.at(center)).collect();
        let result = if time < APPROACH { controller.set_goal(&middle) } else { controller.reach(&tips) };
        result.map_err(|error| request_error(controller, model, trial.label, time, error))?;
        let sequence = motion.tick(&plant.truth());
        if tick == 0 {
            motion.note(trial.label);
        }
        recording.time.push(time);
        for (tip, (joints, chain)) in model.chain_ranges().zip(&model.chains).enumerate() {
            let position = tip_position(plant, joints.end - 1, &chain.tip);
            let reference = centers[tip] + normal_to_x(point.position);
            recording.tips[tip].push((position, reference));
        }
        let actuators = controller.tick(&plant.sensors(sequence))?;
        if !actuators.enabled {
            return Err(fault_error(controller, model, trial.label, time));
        }
        plant.apply(&actuators)?;
        progress(f64::from(tick + 1) / f64::from(ticks));
    }
    controller.disable()?;
    Ok(recording)
}

/// True position of the tip that is fixed to the link of a joint [m].
fn tip_position(plant: &Plant, joint: usize, tip: &Pose) -> Vector3<f64> {
    let unknown = ([f64::NAN; 3], [0.0, 0.0, 0.0, 1.0]);
    let (position, orientation) = plant.link_pose(joint).unwrap_or(unknown);
    isometry(position, orientation).transform_point(&tip.translation.map(f64::from).into()).coords
}

/// A point of a path in its plane, with derivatives [m, s].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PathPoint {
    position: Vector2<f64>,
    velocity: Vector2<f64>,
    acceleration: Vector2<f64>,
}

impl PathPoint {
    fn at(&self, center: &Vector3<f64>) -> TipPoint {
        let single = |vector: Vector3<f64>| vector.map(|value| value as f32).into();
        TipPoint {
            position: single(center + normal_to_x(self.position)),
            velocity: single(normal_to_x(self.velocity)),
            acceleration: single(normal_to_x(self.acceleration)),
        }
    }
}

/// A vector of the paths' plane, which is normal to x, in the hand's frame.
fn normal_to_x(point: Vector2<f64>) -> Vector3<f64> {
    Vector3::new(0.0, point.x, point.y)
}

/// A minimum-jerk line from `from` to `to` in `duration`, at `time` after its start.
fn line(from: [f64; 2], to: [f64; 2], time: f64, duration: f64) -> PathPoint {
    let (from, to) = (Vector2::from(from), Vector2::from(to));
    let [value, first, second] = minimum_jerk(time / duration);
    PathPoint {
        position: from + (to - from) * value,
        velocity: (to - from) * (first / duration),
        acceleration: (to - from) * (second / (duration * duration)),
    }
}

/// The circle, at `time` after its start. The speed rises from 0 to one revolution per second and falls
/// again, both as a minimum-jerk polynomial.
fn circle(time: f64) -> PathPoint {
    let (start, ramp, end) = CIRCLE;
    let duration = end - start;
    // Integral of the minimum-jerk polynomial.
    let area = |s: f64| s.powi(4) * (2.5 + s * (-3.0 + s));
    let (up, down) = ((time / ramp).min(1.0), ((duration - time) / ramp).min(1.0));
    let total = duration - ramp;
    let revolutions = if up < 1.0 {
        ramp * area(up)
    } else if down < 1.0 {
        total - ramp * area(down)
    } else {
        time - 0.5 * ramp
    };
    let [rising, steeper, _] = minimum_jerk(up);
    let [falling, flatter, _] = minimum_jerk(down);
    let (phase, speed, gain) = (TAU * revolutions, TAU * rising * falling, TAU * (steeper - flatter) / ramp);
    let (sine, cosine) = phase.sin_cos();
    let (outward, along) = (Vector2::new(cosine, sine), Vector2::new(-sine, cosine));
    PathPoint {
        position: outward * RADIUS,
        velocity: along * (RADIUS * speed),
        acceleration: along * (RADIUS * gain) - outward * (RADIUS * speed * speed),
    }
}

/// The path of the whole trial: to the circle, around it, to the square, twice around it, and back.
fn path(time: f64) -> PathPoint {
    const CORNERS: [[f64; 2]; 4] =
        [[HALF_SIDE, HALF_SIDE], [-HALF_SIDE, HALF_SIDE], [-HALF_SIDE, -HALF_SIDE], [HALF_SIDE, -HALF_SIDE]];
    let (begin, side, end) = SQUARE;
    if time < CIRCLE.0 {
        line([0.0; 2], [RADIUS, 0.0], time - APPROACH, CIRCLE.0 - APPROACH)
    } else if time < CIRCLE.2 {
        circle(time - CIRCLE.0)
    } else if time < begin {
        line([RADIUS, 0.0], CORNERS[0], time - CIRCLE.2, begin - CIRCLE.2)
    } else if time < end {
        let sides = (time - begin) / side + 1e-9;
        let number = sides.floor();
        let corner = |number: usize| CORNERS[number % 4];
        line(corner(number as usize), corner(number as usize + 1), (sides - number) * side, side)
    } else {
        line(CORNERS[0], [0.0; 2], time - end, TRIAL - end)
    }
}

fn add_metrics(summary: &mut Summary, trial: &Trial, recording: &TipLog) {
    let label = capitalized(trial.label);
    for (path, window) in PATHS {
        let [total, without_offset, peak] = recording.worst(window);
        let rms_label = format!("{label}: {path}, rms distance from the path, worst tip");
        let rms = match trial.limit {
            Some(limit) => Metric::at_most(rms_label, total, limit, "mm"),
            None => Metric::reported(rms_label, total, "mm"),
        };
        summary.insert(format!("{}_{path}_rms", trial.name), rms);
        let label = format!("{label}: {path}, rms without the constant offset");
        summary.insert(
            format!("{}_{path}_rms_without_offset", trial.name),
            Metric::reported(label, without_offset, "mm"),
        );
        let label = format!("{}: {path}, largest distance", capitalized(trial.label));
        summary.insert(format!("{}_{path}_error_peak", trial.name), Metric::reported(label, peak, "mm"));
    }
}

fn tip_name(model: &RobotModel, tip: usize) -> String {
    model.chains.get(tip).map_or_else(String::new, |chain| chain.name.as_str().replace('_', " "))
}

/// The paths and their references.
fn paths(trial: &Trial, recording: &TipLog, model: &RobotModel) -> Figure {
    let caption = "Each fingertip in the y–z plane of the hand, relative to the centre of its paths: three \
                   turns of the circle at full speed, and twice around the square. Dashed: the reference \
                   path.";
    let mut figure = Figure::paths(format!("{}: paths", capitalized(trial.label)), caption, "y", "mm");
    for (tip, samples) in recording.tips.iter().enumerate() {
        let center = samples.first().map_or_else(Vector3::zeros, |(_, reference)| *reference);
        let (y, z) = recording.components(samples.iter().map(|(position, _)| position - center));
        let (reference_y, reference_z) =
            recording.components(samples.iter().map(|(_, reference)| reference - center));
        figure = figure.panel(
            Panel::new(tip_name(model, tip), "z", "mm")
                .line(Line::solid("true path", tip, y, z))
                .line(Line::dashed("reference", Line::INK, reference_y, reference_z)),
        );
    }
    figure
}

/// Distances from the path over time.
fn errors(trial: &Trial, recording: &TipLog, model: &RobotModel) -> Figure {
    let mut panel = Panel::new("Distance from the path", "distance", "mm");
    for tip in 0..recording.tips.len() {
        let samples = recording.time.iter().zip(&recording.tips[tip]);
        let distance = |(&time, (position, reference)): (&f64, &(Vector3<f64>, Vector3<f64>))| {
            if time < APPROACH { f64::NAN } else { (position - reference).norm() * 1e3 }
        };
        let distances = samples.map(distance).collect();
        panel = panel.line(Line::solid(tip_name(model, tip), tip, recording.time.clone(), distances));
    }
    if let Some(limit) = trial.limit {
        panel = panel.rule(limit, format!("limit {limit} mm rms"));
    }
    let caption = "Distance of the true fingertip from its reference at the same time. The metrics are taken \
                   over the circle at full speed and over the square (shaded).";
    let title = format!("{}: distance from the path", capitalized(trial.label));
    let (circle_end, square_begin) = (PATHS[0].1.1, PATHS[1].1.0);
    PATHS
        .into_iter()
        .fold(Figure::stacked(title, caption, "time", "s"), |figure, (name, (from, to))| {
            let figure = figure.phase(from, to, name);
            if to < square_begin { figure.phase(circle_end, square_begin, "") } else { figure }
        })
        .panel(panel)
}

fn table(recording: &TipLog, model: &RobotModel) -> String {
    let mut columns = vec![Column::new("time", "s", &recording.time)];
    for (tip, samples) in recording.tips.iter().enumerate() {
        let name = tip_name(model, tip);
        for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
            let [position, reference]: [Vec<f64>; 2] = [
                samples.iter().map(|(position, _)| position[axis]).collect(),
                samples.iter().map(|(_, reference)| reference[axis]).collect(),
            ];
            columns.push(Column::new(format!("{name} {letter}"), "m", position));
            columns.push(Column::new(format!("{name} {letter} reference"), "m", reference));
        }
    }
    csv(&columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Velocity and acceleration are the derivatives of the position, which is smooth everywhere.
    #[test]
    fn the_path_is_smooth_and_its_derivatives_match() {
        let h = 1e-5;
        let mut time = h;
        while time < TRIAL - h {
            let (before, at, after) = (path(time - h), path(time), path(time + h));
            let velocity = (after.position - before.position) / (2.0 * h);
            let acceleration = (after.velocity - before.velocity) / (2.0 * h);
            assert!((velocity - at.velocity).norm() < 1e-5, "{time}: {velocity} {}", at.velocity);
            assert!(
                (acceleration - at.acceleration).norm() < 2e-3,
                "{time}: {acceleration} {}",
                at.acceleration
            );
            time += 0.000_713;
        }
        assert!((path(5.0).velocity.norm() - TAU * RADIUS).abs() < 1e-9);
        assert!(path(TRIAL).position.norm() < 1e-12);
    }
}
