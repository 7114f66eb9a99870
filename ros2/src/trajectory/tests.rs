#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki_description::robot::RobotFolder;

use super::*;

/// Returns hand3, whose joints are limited to ±1 rad (swing) and 6 rad/s.
pub fn hand() -> Box<Robot> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
    let mut robot = Box::new(Robot::NONE);
    robot.configure(&RobotFolder::load(&folder).unwrap().model).unwrap();
    robot
}

pub fn point(time: f64, positions: &[f64], velocities: &[f64], accelerations: &[f64]) -> Point {
    Point {
        positions: positions.to_vec(),
        velocities: velocities.to_vec(),
        accelerations: accelerations.to_vec(),
        effort: Vec::new(),
        time_from_start: duration(time),
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "split into its digits")]
pub fn duration(seconds: f64) -> Time {
    Time { sec: seconds.floor() as i32, nanosec: (1e9 * (seconds - seconds.floor())).round() as u32 }
}

pub fn message(names: &[&str], points: &[Point]) -> JointTrajectory {
    JointTrajectory {
        joint_names: names.iter().map(|&name| name.to_owned()).collect(),
        points: points.to_vec(),
        ..JointTrajectory::default()
    }
}

const SWING: &[&str] = &["finger1_swing"];

fn at_zero() -> Vec<JointPoint> {
    vec![JointPoint::default(); 9]
}

fn check(message: &JointTrajectory) -> Result<Trajectory, Refused> {
    Trajectory::check(message, &hand(), &at_zero())
}

/// Returns the point of its only joint at that time.
fn swing(trajectory: &Trajectory, time: f64) -> JointPoint {
    trajectory.points(time).next().unwrap().1
}

#[track_caller]
fn refused(message: &JointTrajectory, code: ErrorCode, words: &str) {
    let refused = check(message).unwrap_err();
    assert_eq!(refused.code, code, "{refused}");
    assert!(refused.reason.contains(words), "{refused}");
}

#[track_caller]
fn assert_near(point: JointPoint, [position, velocity, acceleration]: [f64; 3]) {
    let errors = [
        f64::from(point.position) - position,
        f64::from(point.velocity) - velocity,
        f64::from(point.acceleration) - acceleration,
    ];
    assert!(errors.iter().all(|error| error.abs() < 1e-5), "{point:?} {position} {velocity} {acceleration}");
}

#[test]
fn between_points_with_accelerations_lies_the_quintic_that_they_are_of() {
    // q = t³ − t⁴/2 + t⁵/10, which begins at rest; its derivatives by hand.
    let q = |t: f64| {
        let velocity = 3.0 * t.powi(2) - 2.0 * t.powi(3) + 0.5 * t.powi(4);
        let acceleration = 6.0 * t - 6.0 * t.powi(2) + 2.0 * t.powi(3);
        [t.powi(3) - 0.5 * t.powi(4) + 0.1 * t.powi(5), velocity, acceleration]
    };
    let [p, v, a] = q(0.7);
    let message = message(SWING, &[point(0.7, &[p], &[v], &[a]), point(1.7, &[p], &[0.0], &[0.0])]);
    let trajectory = check(&message).unwrap();
    for t in [0.0, 0.1, 0.35, 0.6999] {
        let (joint, point) = trajectory.points(t).next().unwrap();
        assert_eq!(joint, 0);
        assert_near(point, q(t));
    }
}

#[test]
fn between_points_with_velocities_lies_the_cubic_that_they_are_of() {
    // q = t² − t³/2, whose first two knots are at rest and at t = 0.5.
    let q = |t: f64| [t * t - 0.5 * t.powi(3), 2.0 * t - 1.5 * t * t, 2.0 - 3.0 * t];
    let [p, v, _] = q(0.5);
    let trajectory =
        check(&message(SWING, &[point(0.5, &[p], &[v], &[]), point(1.5, &[0.0], &[0.0], &[])])).unwrap();
    for t in [0.05, 0.25, 0.4999] {
        assert_near(swing(&trajectory, t), q(t));
    }
}

#[test]
fn positions_alone_are_joined_by_lines() {
    let trajectory =
        check(&message(SWING, &[point(0.5, &[0.2], &[], &[]), point(1.0, &[-0.1], &[], &[])])).unwrap();
    assert_near(swing(&trajectory, 0.25), [0.1, 0.4, 0.0]);
    assert_near(swing(&trajectory, 0.75), [0.05, -0.6, 0.0]);
    // At the end, and after it, at rest.
    assert_near(swing(&trajectory, 1.0), [-0.1, 0.0, 0.0]);
    assert_near(swing(&trajectory, 9.0), [-0.1, 0.0, 0.0]);
}

#[test]
fn joints_may_be_named_in_any_order() {
    let names = ["finger2_swing", "finger1_curl"];
    let trajectory = check(&message(&names, &[point(1.0, &[0.1, 0.2], &[0.0; 2], &[])])).unwrap();
    let end: Vec<usize> = trajectory.end().map(|(joint, _)| joint).collect();
    assert_eq!(end, [3, 2]);
    assert_near(trajectory.end().nth(1).unwrap().1, [0.2, 0.0, 0.0]);
}

#[test]
fn a_planner_that_begins_where_the_joint_is_measured_is_understood() {
    let begin =
        |position: f64| message(SWING, &[point(0.0, &[position], &[], &[]), point(1.0, &[0.3], &[], &[])]);
    let trajectory = check(&begin(0.015)).unwrap();
    // A line from the present reference.
    assert_near(swing(&trajectory, 0.5), [0.15, 0.3, 0.0]);
    refused(
        &begin(0.03),
        ErrorCode::InvalidGoal,
        "finger1_swing is at 0.0000 rad, and the trajectory begins at 0.03",
    );
}

#[test]
fn a_first_point_at_time_0_does_not_change_how_a_joint_moves() {
    let mut references = at_zero();
    references[0] = JointPoint { position: 0.0, velocity: 2.0, acceleration: 3.0 };
    let begin = |velocities: &[f64], accelerations: &[f64]| {
        let end: &[f64] = &[0.0];
        let points = [
            point(0.0, &[0.01], velocities, accelerations),
            point(1.0, &[0.3], end, end.get(..accelerations.len()).unwrap()),
        ];
        swing(&Trajectory::check(&message(SWING, &points), &hand(), &references).unwrap(), 0.0)
    };
    assert_near(begin(&[0.5], &[0.0]), [0.0, 2.0, 3.0]);
    // A cubic has its own acceleration: 6·0.3 − 4·2 + 0, by hand.
    assert_near(begin(&[0.5], &[]), [0.0, 2.0, -6.2]);
}

#[test]
fn what_cannot_be_followed_is_refused_with_the_reason() {
    let one = |time, position| message(SWING, &[point(time, &[position], &[], &[])]);
    refused(
        &message(&["thumb"], &[point(1.0, &[0.0], &[], &[])]),
        ErrorCode::InvalidJoints,
        "has no joint \"thumb\"",
    );
    refused(&message(&[], &[]), ErrorCode::InvalidJoints, "names no joint");
    let twice = ["finger1_swing", "finger1_swing"];
    refused(&message(&twice, &[point(1.0, &[0.0; 2], &[], &[])]), ErrorCode::InvalidJoints, "named twice");
    refused(&message(SWING, &[]), ErrorCode::InvalidGoal, "no points");
    refused(&one(1.0, 1.2), ErrorCode::InvalidGoal, "finger1_swing: 1.0");
    refused(&one(1.0, 1.2), ErrorCode::InvalidGoal, "outside its limits -1 to 1 rad");
    refused(&one(0.1, 0.9), ErrorCode::InvalidGoal, "beyond its limit of 6 rad/s");
    // Between two control periods: 0.13 rad within the first, and 0.12 rad in the middle of the motion.
    let hop = [point(0.001, &[0.13], &[], &[]), point(1.0, &[0.13], &[], &[])];
    refused(&message(SWING, &hop), ErrorCode::InvalidGoal, "at 0.01 s: finger1_swing: 13");
    let joined = [(0.5, 0.05), (1.0, 0.1), (1.001, -0.02), (2.0, -0.02)];
    let joined = joined.map(|(time, position)| point(time, &[position], &[], &[]));
    refused(&message(SWING, &joined), ErrorCode::InvalidGoal, "beyond its limit of 6 rad/s");
    refused(&one(-1.0, 0.1), ErrorCode::InvalidGoal, "times must increase");
    refused(&one(301.0, 0.1), ErrorCode::InvalidGoal, "longer than 300 s");
    // Within what it may begin with, beside where the joint is.
    refused(&one(0.0, 0.01), ErrorCode::InvalidGoal, "its only point has time_from_start 0");
    refused(&one(1.0, f64::NAN), ErrorCode::InvalidGoal, "positions of finger1_swing is NaN");
    let backwards = [point(1.0, &[0.1], &[], &[]), point(1.0, &[0.2], &[], &[])];
    refused(
        &message(SWING, &backwards),
        ErrorCode::InvalidGoal,
        "point 1: time_from_start is 1 s, not after 1 s",
    );
    refused(
        &message(SWING, &[point(1.0, &[], &[], &[])]),
        ErrorCode::InvalidGoal,
        "point 0 has 0 positions for 1",
    );
    refused(
        &message(SWING, &[point(1.0, &[0.1], &[0.2], &[])]),
        ErrorCode::InvalidGoal,
        "still moves at the last",
    );
    let jerky = [point(0.02, &[0.1], &[0.0], &[0.0])];
    refused(&message(SWING, &jerky), ErrorCode::InvalidGoal, "rad/s");
    let mut pushed = point(1.0, &[0.1], &[], &[]);
    pushed.effort = vec![0.1];
    refused(&message(SWING, &[pushed]), ErrorCode::InvalidGoal, "has efforts");
    let unused = [point(1.0, &[0.1], &[], &[0.5])];
    refused(&message(SWING, &unused), ErrorCode::InvalidGoal, "accelerations without velocities");
}
