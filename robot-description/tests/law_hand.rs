//! Laws of a hand: those of the three-finger hand, and what is wrong with others.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::task::grasping::{InternalForce, JointTargets, LoadSource, ObjectControl, ObjectFrame};
use tesaki_description::law::{self, hand};
use tesaki_description::robot::RobotFolder;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3")
}

fn model() -> RobotModel {
    RobotFolder::load(&folder()).unwrap().model
}

/// What is said about the paper's law with a text in place of another.
fn said(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(folder().join("laws/paper.toml")).unwrap();
    assert!(text.contains(from), "{from}");
    let (law, findings) = hand::check(Path::new("own.toml"), &text.replacen(from, to, 1), &model());
    assert!(law.is_none(), "{to} is accepted");
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_laws_of_the_hand_are_read() {
    let read = |name: &str| {
        let file = folder().join(law::FOLDER).join(name).with_extension("toml");
        hand::load(&file, &model()).unwrap()
    };
    let [paper, _, ours] = ["paper", "paper-corrected", "tesaki"].map(read);
    assert_eq!((paper.servo.mode, ours.servo.mode), (ServoMode::BarePid, ServoMode::Observer));
    assert_eq!(paper.joint_control.law.control, ObjectControl::Differential(ServoMode::BarePid));
    assert_eq!(paper.joint_control.law.joint_targets, JointTargets::Accumulated);
    assert_eq!(paper.motion.law.object_frame, ObjectFrame::Triangle);
    assert_eq!(paper.force.law.load, LoadSource::Constant { mass: 0.023 });
    assert_eq!(paper.weights.law.load, LoadSource::Measured);
    let ObjectControl::Wrench(gains) = paper.force.law.control else { panic!() };
    assert_eq!((gains.position, gains.orientation, gains.damping), ([0.0; 2], [0.0; 2], 0.0));
    assert_eq!(paper.motion.law.internal, InternalForce::Normal { strength: 4.0 });
    assert_eq!(ours.force.law.internal, InternalForce::Normal { strength: 4.0 });
    assert_eq!(ours.motion.turns, [0.1, -0.1, -0.1, 0.1]);
    // Both do the same experiments.
    assert_eq!((&paper.motion.turns, &paper.motion.shifts), (&ours.motion.turns, &ours.motion.shifts));
    assert_eq!(paper.weights.masses, ours.weights.masses);
}

#[test]
fn gains_are_those_per_inertia_times_the_inertia_of_the_joint() {
    let mut model = model();
    let law = hand::load(&folder().join("laws/paper.toml"), &model).unwrap();
    let inertia = model.joints[4].servo.observer.inertia;
    law.servo.apply(&mut model);
    let expected = law.servo.pid.unwrap().proportional * inertia;
    assert!((model.joints[4].servo.pid.proportional / expected - 1.0).abs() < 1e-6);
    assert!((model.joints[4].limits.following_error - 1.0).abs() < 1e-6);
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let text = std::fs::read_to_string(folder().join("laws/paper.toml")).unwrap();
    let line = |from: &str| 1 + text.lines().position(|line| line.contains(from)).unwrap();
    for (from, to, word) in [
        ("mode = \"bare_pid\"", "mode = \"bare\"", "unknown variant"),
        ("following_error = 1.0", "following_error = 9.0", "the range is 0.01 to 3 rad"),
        (
            "following_error = 1.0",
            "following_error = 0.009",
            "servo.following_error is 0.009 rad; the range is",
        ),
        (
            "proportional = ",
            "proportional = -",
            "joint finger1_swing: servo.pid.proportional = -3000 1/s² is below 0 1/s²",
        ),
        ("{ constant = 0.023 }", "{ constant = 23.0 }", "mass of the object is 23 kg"),
        ("strength = 4.0", "strength = 40.0", "internal force is 40 N"),
        ("evaluated = 2.0", "evaluated = 5.0", "force.evaluated is 5 s; the range is 0.01 to 4 s"),
        (
            "evaluated = 2.0                  # s, from",
            "evaluated = 2.6                  # s, from",
            "motion.evaluated is 2.6 s; the range is 0.01 to 2.5 s",
        ),
        ("title = \"the paper's law\"", "title = \" \"", "title has 0 characters; possible are 1 to 60"),
        ("[0.05, 0.1", "[0.0, 0.1", "weights.masses is 0 kg"),
        ("turns = [0.1", "turns = [1.1", "motion.turns is 1.1 rad"),
        ("efficiency = [1.0,", "efficiency = [0.1,", "force.efficiency is 0.1; the range is 0.3 to 1"),
        ("integral = [500.0,", "integral = [-5.0,", "motion.integral is -5 N/(m·s)"),
        ("integral = [500.0,", "integral = [nan,", "motion.integral is NaN N/(m·s)"),
    ] {
        let said = said(from, to);
        assert!(said.contains(&format!("own.toml:{}:", line(from))) && said.contains(word), "{to}: {said}");
    }
    // A gain of the control, with the line of the table in which it stands.
    let said_of_gain = said("position = [1000.0", "position = [-1.0");
    assert!(said_of_gain.contains("the gain is -1"), "{said_of_gain}");
    assert!(said("cumulative = false", "cumulativ = false").contains("cumulativ"));
}

#[test]
fn bounds_of_the_servo_are_within_its_range() {
    let text = std::fs::read_to_string(folder().join("laws/paper.toml")).unwrap();
    let ends = "following_error = 0.01\nrest_error = 0.1";
    let (law, said) =
        hand::check(Path::new("own.toml"), &text.replacen("following_error = 1.0", ends, 1), &model());
    let servo = law.unwrap_or_else(|| panic!("{said:?}")).servo;
    assert_eq!((servo.following_error, servo.rest_error), (Some(0.01), Some(0.1)));
}

#[test]
fn a_curve_over_a_gain_needs_the_control_that_has_it() {
    let text = std::fs::read_to_string(folder().join("laws/tesaki.toml")).unwrap();
    let changed = text.replacen("rest = 2.5 ", "integral = [500.0]\nrest = 2.5 ", 1);
    assert_ne!(text, changed);
    let (law, findings) = hand::check(Path::new("own.toml"), &changed, &model());
    let line = 1 + changed.lines().position(|line| line.starts_with("integral")).unwrap();
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert!(law.is_none() && said.len() == 1, "{said:?}");
    let expected =
        format!("own.toml:{line}: motion.integral: only control = {{ wrench = … }} has such a gain");
    assert!(said[0].starts_with(&expected), "{said:?}");
    // With that control, the gain is the second one of the position.
    let paper = hand::load(&folder().join("laws/paper.toml"), &model()).unwrap();
    assert_eq!(paper.force.efficiency, [1.0, 0.9, 0.8, 0.7, 0.6]);
    let ObjectControl::Wrench(gains) = paper.motion.law.with_integral(500.0).unwrap().control else {
        panic!()
    };
    assert_eq!((gains.position, gains.damping), ([1000.0, 500.0], 0.05));
}

#[test]
fn times_and_places_that_are_left_out_are_those_of_the_experiments() {
    let text = std::fs::read_to_string(folder().join("laws/paper.toml")).unwrap();
    let law = |text: &str| hand::check(Path::new("own.toml"), text, &model()).0.unwrap();
    let paper = law(&text);
    assert_eq!((paper.servo.evaluated, paper.servo.rest_error), (0.5, None));
    assert_eq!(
        (paper.weights.evaluated, paper.weights.rest, paper.weights.point),
        (0.5, 1.0, [0.0, 0.0, 0.03])
    );
    assert_eq!((paper.motion.initial_rest, paper.motion.evaluated), (1.5, 2.0));
    let short = hand::load(&folder().join("laws/paper-corrected.toml"), &model()).unwrap();
    assert_eq!(
        (short.servo.evaluated, short.weights.rest, short.weights.point),
        (0.5, 1.0, [0.0, 0.0, 0.03])
    );
    assert_eq!((short.motion.initial_rest, short.motion.evaluated), (1.5, 2.0));
    let own = text
        .replacen("step = 0.3 ", "rest_error = 0.001\nstep = 0.3 ", 1)
        .replacen("evaluated = 0.5 ", "evaluated = 0.2 ", 1)
        .replacen("[0.0, 0.0, 0.03]", "[0.0, 0.05, 0.03]", 1)
        .replacen("initial_rest = 1.5", "initial_rest = 0.7", 1);
    let own = law(&own);
    assert_eq!(
        (own.servo.evaluated, own.weights.point, own.motion.initial_rest),
        (0.2, [0.0, 0.05, 0.03], 0.7)
    );
    let mut model = model();
    own.servo.apply(&mut model);
    assert!(model.joints.iter().all(|joint| joint.servo.rest_error.to_bits() == 0.001_f32.to_bits()));
}

#[test]
fn a_law_of_a_robot_that_laws_are_not_for_is_warned_of() {
    let model = RobotFolder::load(&folder().join("../allegro")).unwrap().model;
    let said = law::check(Path::new("own.toml"), "", &model);
    let said: Vec<String> = said.iter().map(ToString::to_string).collect();
    assert!(said.len() == 1 && said[0].starts_with("own.toml: not checked: laws are for"), "{said:?}");
}

#[test]
fn a_law_of_a_hand_is_none_of_an_arm() {
    let arm = RobotFolder::load(&folder().join("../arm7")).unwrap().model;
    let said = hand::load(&folder().join("laws/paper.toml"), &arm).unwrap_err().to_string();
    assert!(
        said.ends_with(
            "laws/paper.toml: a law of a hand of three fingers with force sensors; the robot has 1 chain(s): run it with a \
             robot that it is for"
        ),
        "{said}"
    );
}
