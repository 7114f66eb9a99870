#![allow(clippy::unwrap_used, reason = "tests")]

use tesaki::protocol::JointTelemetry;

use super::*;
use crate::messages::{JointTolerance, JointTrajectory};
use crate::trajectory::tests::{hand, message, point};

const DEFAULTS: Defaults = Defaults { tolerance: 0.01, time: 2.0 };
const NOW: u64 = 1_700_000_000_000_000_000;

fn goal(trajectory: JointTrajectory) -> Goal {
    Goal { trajectory, ..Goal::default() }
}

/// Returns a goal that swings the first finger to `position` within `time`.
fn swing(time: f64, position: f64) -> Goal {
    goal(message(&["finger1_swing"], &[point(time, &[position], &[0.0], &[])]))
}

/// A board whose joints follow, the first one `behind` its reference [rad].
struct Board {
    controller: Controller,
    tick: u32,
    behind: f32,
}

impl Board {
    fn new() -> Self {
        Self { controller: Controller::hold(hand(), &[0.0; 9]), tick: 7, behind: 0.0 }
    }

    fn state(&self) -> Vec<JointTelemetry> {
        let joint = |point: &JointPoint| JointTelemetry {
            position: point.position,
            velocity: point.velocity,
            reference: point.position,
            torque: 0.0,
        };
        let mut joints: Vec<_> = self.controller.references().iter().map(joint).collect();
        joints[0].position -= self.behind;
        joints
    }

    fn step(&mut self) -> Option<Outcome> {
        self.tick += 1;
        let state = self.state();
        self.controller.step(self.tick, NOW, &state)
    }

    /// Runs until the goal ends. Returns the outcome and the number of ticks.
    fn run(&mut self) -> (Outcome, u32) {
        (1..2000).find_map(|ticks| Some((self.step()?, ticks))).unwrap()
    }

    fn swing(&self) -> JointPoint {
        self.controller.references()[0]
    }

    /// Returns where the joint comes to rest if it brakes from now on [rad].
    fn swing_at_rest(&self) -> f64 {
        f64::from(self.controller.braked(u64::MAX)[0].position)
    }
}

#[test]
fn a_goal_succeeds_when_its_joints_have_arrived() {
    let mut board = Board::new();
    board.controller.follow(&swing(0.5, 0.2), NOW, &DEFAULTS).unwrap();
    assert_eq!(board.run(), (Outcome::Succeeded, 51));
    assert_eq!(board.swing(), rest(0.2));
}

#[test]
fn a_joint_that_does_not_arrive_fails_the_goal_after_its_time() {
    let mut board = Board { behind: 0.02, ..Board::new() };
    board.controller.follow(&swing(0.5, 0.2), NOW, &DEFAULTS).unwrap();
    let (Outcome::Failed(refused), ticks) = board.run() else { panic!() };
    assert_eq!(refused.code, ErrorCode::GoalToleranceViolated);
    assert!(refused.reason.contains("finger1_swing is 0.0200 rad from its goal"), "{refused}");
    assert!((250..=252).contains(&ticks), "{ticks}");
    // A goal with a larger tolerance is reached.
    let tolerance =
        JointTolerance { name: "finger1_swing".into(), position: 0.03, ..JointTolerance::default() };
    let goal = Goal { goal_tolerance: vec![tolerance], ..swing(0.5, 0.0) };
    board.controller.follow(&goal, NOW, &DEFAULTS).unwrap();
    assert_eq!(board.run().0, Outcome::Succeeded);
}

#[test]
fn a_goal_may_take_any_time_to_arrive() {
    let mut board = Board { behind: 0.02, ..Board::new() };
    let goal = Goal { goal_time_tolerance: Time { sec: -1, nanosec: 0 }, ..swing(0.5, 0.2) };
    board.controller.follow(&goal, NOW, &DEFAULTS).unwrap();
    (0..1000).for_each(|_| assert_eq!(board.step(), None));
    board.behind = 0.0;
    assert_eq!(board.step(), Some(Outcome::Succeeded));
}

#[test]
fn a_joint_that_leaves_its_path_fails_the_goal_and_all_brake() {
    let tolerance =
        JointTolerance { name: "finger1_swing".into(), position: 0.05, ..JointTolerance::default() };
    let goal = Goal { path_tolerance: vec![tolerance], ..swing(0.5, 0.2) };
    let mut board = Board::new();
    board.controller.follow(&goal, NOW, &DEFAULTS).unwrap();
    (0..20).for_each(|_| assert_eq!(board.step(), None));
    board.behind = 0.06;
    let Some(Outcome::Failed(refused)) = board.step() else { panic!() };
    assert_eq!(refused.code, ErrorCode::PathToleranceViolated);
    assert!(board.swing().velocity > 0.1 && board.controller.motion.is_none());
    (0..20).for_each(|_| assert_eq!(board.step(), None));
    assert!(board.controller.is_at_rest());
}

#[test]
fn what_is_cancelled_brakes_within_the_boards_limits_and_ends_at_rest() {
    let mut board = Board::new();
    board.controller.follow(&swing(0.5, 0.9), NOW, &DEFAULTS).unwrap();
    (0..25).for_each(|_| assert_eq!(board.step(), None));
    board.controller.cancel();
    let mut before = board.swing();
    assert!(before.velocity > 2.0);
    let outcome = (0..50).find_map(|_| {
        let outcome = board.step();
        let config = &board.controller.robot().joints()[0];
        config.check_point(0, &board.swing(), &before).unwrap();
        before = board.swing();
        outcome
    });
    assert_eq!(outcome, Some(Outcome::Canceled));
    assert!(before.velocity.abs() < 1e-6 && before.position < 0.9, "{before:?}");
    assert_eq!(board.step(), None);
}

#[test]
fn a_goal_in_motion_goes_on_from_where_the_references_are() {
    let mut board = Board::new();
    board.controller.follow(&swing(1.0, 0.5), NOW, &DEFAULTS).unwrap();
    (0..50).for_each(|_| assert_eq!(board.step(), None));
    let before = board.swing();
    board.controller.follow(&swing(1.0, 0.0), NOW, &DEFAULTS).unwrap();
    assert_eq!(board.step(), None);
    let change = board.swing().velocity - before.velocity;
    assert!(before.velocity > 0.7 && change.abs() < 0.1, "{before:?} {change}");
    assert_eq!(board.run().0, Outcome::Succeeded);
}

#[test]
fn a_stamp_delays_a_goal_and_one_whose_end_is_past_is_refused() {
    let stamped = |nanoseconds| {
        let mut goal = swing(0.5, 0.2);
        goal.trajectory.header.stamp = Time::of_nanoseconds(nanoseconds);
        goal
    };
    let mut board = Board::new();
    // It takes half a second.
    let refused = board.controller.follow(&stamped(NOW - 500_000_001), NOW, &DEFAULTS).unwrap_err();
    assert_eq!(refused.code, ErrorCode::OldHeaderTimestamp);
    board.controller.follow(&stamped(NOW + 1), NOW, &DEFAULTS).unwrap();
    (0..100).for_each(|_| assert_eq!(board.step(), None));
    assert_eq!(board.swing(), rest(0.0));
    let state = board.state();
    assert_eq!(board.controller.step(108, NOW + 1, &state), None);
    assert!(board.swing().velocity > 0.0);
    // A client that stamps its goal with the present time: it takes as long as any.
    let mut board = Board::new();
    board.controller.follow(&stamped(NOW - 20_000_000), NOW, &DEFAULTS).unwrap();
    let (outcome, periods) = board.run();
    assert!(outcome == Outcome::Succeeded && periods >= 50, "{outcome:?} {periods}");
}

#[test]
fn a_goal_with_a_stamp_goes_on_from_where_the_joints_are_when_it_begins() {
    // It begins in motion, or once the joints are at rest, with a first point where they are then.
    for (delay, is_at_rest) in [(0.005, false), (0.02, true), (0.5, true)] {
        let mut board = Board::new();
        board.controller.follow(&swing(1.0, 0.5), NOW, &DEFAULTS).unwrap();
        (0..50).for_each(|_| assert_eq!(board.step(), None));
        assert!(board.swing().velocity > 0.7);
        let first = is_at_rest.then(|| point(0.0, &[board.swing_at_rest()], &[0.0], &[]));
        let points: Vec<Point> = first.into_iter().chain([point(1.0, &[0.1], &[0.0], &[])]).collect();
        let mut delayed = goal(message(&["finger1_swing"], &points));
        let stamp = NOW + nanoseconds(crate::trajectory::tests::duration(delay));
        delayed.trajectory.header.stamp = Time::of_nanoseconds(stamp);
        board.controller.follow(&delayed, NOW, &DEFAULTS).unwrap();
        let torque = board.controller.robot().joints()[0].limits.torque;
        let most = board.controller.robot().joints()[0].servo.acceleration(torque) * TICK;
        let outcome = (1..300).find_map(|period| {
            let (before, state) = (board.swing(), board.state());
            board.tick += 1;
            let outcome = board.controller.step(board.tick, NOW + period * CONTROL_PERIOD_NS, &state);
            let after = board.swing();
            let moved = (after.position - before.position) / TICK;
            let mean = 0.5 * (before.velocity + after.velocity);
            assert!((after.velocity - before.velocity).abs() <= most, "{period} {before:?} {after:?}");
            assert!((moved - mean).abs() < 0.05, "{period} {before:?} {after:?}");
            outcome
        });
        assert_eq!(outcome, Some(Outcome::Succeeded));
    }
}

#[test]
fn a_goal_with_a_stamp_fails_where_it_cannot_begin() {
    let mut board = Board::new();
    board.controller.follow(&swing(0.5, 0.9), NOW, &DEFAULTS).unwrap();
    (0..25).for_each(|_| assert_eq!(board.step(), None));
    // Near enough to where the joint comes to rest, but too far from where it is.
    let first = board.swing_at_rest() + 0.019;
    let mut delayed = swing(0.2, first);
    delayed.trajectory.points.insert(0, point(0.0, &[first], &[0.0], &[]));
    delayed.trajectory.header.stamp = Time::of_nanoseconds(NOW + 1_000_000_000);
    board.controller.follow(&delayed, NOW, &DEFAULTS).unwrap();
    // The clock was set: the joints have not come to rest.
    let (before, state) = (board.swing(), board.state());
    let outcome = board.controller.step(board.tick + 1, NOW + 2_000_000_000, &state);
    let Some(Outcome::Failed(refused)) = outcome else { panic!("{outcome:?}") };
    assert!(refused.reason.contains("the trajectory begins at"), "{refused}");
    let braked = board.controller.robot().joints()[0].brake(&before);
    assert_eq!((board.swing().position, board.swing().velocity), (braked.position, braked.velocity));
}

#[test]
fn tolerances_that_cannot_be_kept_are_refused() {
    let refused = |change: fn(&mut Goal)| {
        let mut goal = swing(0.5, 0.2);
        change(&mut goal);
        Board::new().controller.follow(&goal, NOW, &DEFAULTS).unwrap_err().reason
    };
    let text = refused(|goal| {
        goal.path_tolerance
            .push(JointTolerance { name: "finger2_swing".into(), ..JointTolerance::default() });
    });
    assert!(text.contains("names \"finger2_swing\", which is not in the trajectory"), "{text}");
    let text = refused(|goal| {
        let name = "finger1_swing".into();
        goal.goal_tolerance.push(JointTolerance { name, acceleration: 1.0, ..JointTolerance::default() });
    });
    assert!(text.contains("limits what is not measured here"), "{text}");
    let text = refused(|goal| goal.multi_dof_trajectory.joint_names.push("base".into()));
    assert!(text.contains("several degrees of freedom"), "{text}");
}
