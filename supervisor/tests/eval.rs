//! `tesaki eval` against other libraries' numbers, and what it says about tables and robots that do not fit.
#![cfg(all(unix, feature = "cli"))]
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use std::path::{Path, PathBuf};

use common::{columns, tesaki};

const ROBOTS: [(&str, &[&str]); 5] = [
    ("allegro_right", &[]),
    ("franka_panda", &["panda_hand_tcp"]),
    ("inspire_right", &[]),
    ("kinova_gen3", &[]),
    ("robotiq_2f85", &[]),
];

fn tests() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests")
}

fn robot(name: &str) -> String {
    tests().join(format!("robots/{name}.urdf")).display().to_string()
}

fn data(robot: &str, kind: &str) -> PathBuf {
    tests().join(format!("oracles/data/eval/{robot}_{kind}.csv"))
}

#[track_caller]
fn eval(what: &str, robot: &str, tips: &[&str], input: &str) -> (String, String) {
    let mut arguments = vec!["eval", what, "--robot", robot, "--in", "-"];
    arguments.extend(tips.iter().flat_map(|tip| ["--tip", tip]));
    let (code, out, err) = tesaki(&arguments, input);
    assert_eq!(code, 0, "{arguments:?}: {err}");
    (out, err)
}

fn numbers(column: &[String]) -> Vec<f64> {
    column.iter().map(|value| value.parse().unwrap()).collect()
}

/// The largest difference between what was computed and what another library says.
fn compare(what: &str) -> f64 {
    let mut worst = 0.0_f64;
    for (name, tips) in ROBOTS {
        let states = std::fs::read_to_string(data(name, "states")).unwrap();
        let expected = columns(&std::fs::read_to_string(data(name, what)).unwrap());
        let got = columns(&eval(what, &robot(name), tips, &states).0);
        for (column, expected) in &expected {
            let got = numbers(got.get(column).unwrap_or_else(|| panic!("{name}: no column {column}")));
            let expected = numbers(expected);
            assert_eq!(got.len(), expected.len());
            for (row, (got, expected)) in got.iter().zip(&expected).enumerate() {
                let difference = (got - expected).abs();
                assert!(difference < 1e-5, "{name}: {column}, row {row}: {got} instead of {expected}");
                worst = worst.max(difference);
            }
        }
        assert_eq!(got.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "{name}");
    }
    worst
}

#[test]
fn poses_are_those_of_pinocchio() {
    let worst = compare("fk");
    println!("largest difference {worst:.2e}");
}

#[test]
fn jacobians_are_those_of_pinocchio_mimic_joints_included() {
    let worst = compare("jacobian");
    println!("largest difference {worst:.2e}");
}

/// The largest difference in any row, as a share of the row's largest value for the tip.
fn compare_dynamics(what: &str) -> f64 {
    let mut worst = 0.0_f64;
    for name in ["kinova_gen3", "ur5e", "ufactory_xarm7", "kinova_j2s6s200", "abb_irb140", "inspire_right"] {
        let motions = std::fs::read_to_string(data(name, "motions")).unwrap();
        let expected = columns(&std::fs::read_to_string(data(name, what)).unwrap());
        let got = columns(&eval(what, &robot(name), &[], &motions).0);
        assert_eq!(got.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "{name}");
        for tip in robot_tips(expected.keys()) {
            let of_tip = |column: &&String| column.starts_with(&format!("{tip}."));
            for row in 0..10 {
                let value = |table: &std::collections::BTreeMap<String, Vec<String>>, column| {
                    numbers(&table[column])[row]
                };
                let columns = || expected.keys().filter(of_tip);
                let scale = columns().map(|column| value(&expected, column).abs()).fold(0.0, f64::max);
                for column in columns() {
                    let (got, expected) = (value(&got, column), value(&expected, column));
                    let difference = (got - expected).abs() / scale.max(1e-9);
                    assert!(difference < 1e-5, "{name}: {column}, row {row}: {got} instead of {expected}");
                    worst = worst.max(difference);
                }
            }
        }
    }
    worst
}

/// What is before the first dot: no link of these robots has one in its name.
fn robot_tips<'a>(columns: impl Iterator<Item = &'a String>) -> std::collections::BTreeSet<&'a str> {
    columns.filter_map(|column| column.split('.').next()).collect()
}

#[test]
fn torques_under_a_wrench_with_rotors_on_tilted_bases_are_those_of_pinocchio() {
    println!("largest share {:.2e}", compare_dynamics("rnea"));
}

#[test]
fn mass_matrices_with_rotors_are_those_of_pinocchio() {
    println!("largest share {:.2e}", compare_dynamics("mass"));
}

#[test]
fn bias_accelerations_are_those_of_pinocchio() {
    println!("largest share {:.2e}", compare_dynamics("bias"));
}

#[test]
fn torques_need_angles_alone() {
    let (ur5e, joints) = (
        robot("ur5e"),
        "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint",
    );
    let (still, _) = eval("rnea", &ur5e, &[], &format!("{joints}\n0,-1,1,0,0,0\n"));
    let (also, _) = eval("rnea", &ur5e, &[], &format!("{joints},gz,gx,gy\n0,-1,1,0,0,0,-9.81,0,0\n"));
    assert_eq!(still, also);
    let torques = columns(&still);
    assert!(numbers(&torques["tool0.tau.shoulder_lift_joint"])[0].abs() > 20.0, "{still}");
    let (weightless, _) = eval("rnea", &ur5e, &[], &format!("{joints},gx,gy,gz\n0,-1,1,0,0,0,0,0,0\n"));
    assert!(columns(&weightless).values().all(|torque| numbers(torque) == [0.0]), "{weightless}");
}

#[test]
fn what_has_no_mass_or_is_not_carried_is_told() {
    let states = |name| std::fs::read_to_string(data(name, "motions")).unwrap();
    let (_, err) = eval("mass", &robot("abb_irb140"), &[], &states("abb_irb140"));
    assert!(err.contains("tool0: no link on the way to it has a mass"), "{err}");
    let panda = std::fs::read_to_string(data("franka_panda", "states")).unwrap();
    let (_, err) = eval("rnea", &robot("franka_panda"), &["panda_hand_tcp"], &panda);
    let words = "panda_hand_tcp: without what is behind panda_finger_joint1, panda_finger_joint2";
    assert!(err.contains(words), "{err}");
}

#[test]
fn masses_that_no_body_has_are_refused_by_name_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("robot.urdf");
    let text = std::fs::read_to_string(robot("ur5e")).unwrap();
    let states = std::fs::read_to_string(data("ur5e", "motions")).unwrap();
    for (from, to, words) in [
        ("<mass value=\"3.7\"", "<mass value=\"-3.7\"", ["link shoulder_link", "mass = -3.7 kg is below 0"]),
        ("ixx=\"0.010267", "ixx=\"-0.010267", ["link shoulder_link", "one is negative"]),
        ("ixx=\"0.010267", "ixx=\"0.90267", ["link shoulder_link", "exceeds the sum of the others"]),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&urdf, text.replacen(from, to, 1)).unwrap();
        for what in ["rnea", "mass"] {
            let arguments = ["eval", what, "--robot", folder.path().to_str().unwrap(), "--in", "-"];
            let (code, _, err) = tesaki(&arguments, &states);
            assert_eq!(code, 1, "{err}");
            assert!(err.contains("robot.urdf:") && words.iter().all(|word| err.contains(word)), "{err}");
        }
    }
}

#[test]
fn the_inverse_brings_the_tips_back_to_where_they_were() {
    let (mut targets, mut reached) = (0, 0);
    for (name, tips) in ROBOTS {
        let states = std::fs::read_to_string(data(name, "states")).unwrap();
        let poses = eval("fk", &robot(name), tips, &states).0;
        // From where they were, not far off, every joint comes back; without a start, the tip does.
        let (out, _) = eval("ik", &robot(name), &separate(name, tips), &poses);
        let solved = columns(&out);
        let again = columns(&eval("fk", &robot(name), &separate(name, tips), &out).0);
        let poses = columns(&poses);
        for tip in solved.keys().filter_map(|column| column.strip_suffix(".status")) {
            for (row, status) in solved[&format!("{tip}.status")].iter().enumerate() {
                targets += 1;
                if status != "reached" {
                    continue;
                }
                reached += 1;
                for part in ["x", "y", "z", "qx", "qy", "qz", "qw"] {
                    let column = format!("{tip}.{part}");
                    let (got, expected) = (numbers(&again[&column])[row], numbers(&poses[&column])[row]);
                    // A quaternion and its negative are the same orientation.
                    let difference = (got - expected).abs().min((got + expected).abs());
                    assert!(difference < 3e-5, "{name}: {column}, row {row}: {got} instead of {expected}");
                }
            }
        }
    }
    assert!(targets > 80, "{targets}");
    assert!(reached == targets, "{reached} of {targets} reached");
}

#[test]
fn the_inverse_finds_the_drive_that_joints_of_another_branch_mimic() {
    let gripper = robot("robotiq_2f85");
    let states = std::fs::read_to_string(data("robotiq_2f85", "states")).unwrap();
    for tip in ["right_inner_finger_pad", "right_inner_knuckle"] {
        let poses = eval("fk", &gripper, &[tip], &states).0;
        let solved = columns(&eval("ik", &gripper, &[tip], &poses).0);
        assert!(solved[&format!("{tip}.status")].iter().all(|status| status == "reached"), "{solved:?}");
        let expected = numbers(&columns(&states)["finger_joint"]);
        for (got, expected) in numbers(&solved["finger_joint"]).iter().zip(expected) {
            assert!((got - expected).abs() < 1e-3, "{tip}: {got} instead of {expected}");
        }
    }
}

/// Tips whose joints are all their own.
fn separate<'a>(name: &str, tips: &[&'a str]) -> Vec<&'a str> {
    if name == "robotiq_2f85" { vec!["left_inner_finger_pad"] } else { tips.to_vec() }
}

#[test]
fn columns_in_any_order_further_columns_and_angles_outside_are_told_and_computed() {
    let ur5e = robot("ur5e");
    let input = "time,load,wrist_3_joint,wrist_2_joint,wrist_1_joint,elbow_joint,shoulder_lift_joint,shoulder_pan_joint\n\
        0,9,0.6,0.5,0.4,0.3,-0.2,0.1\n\
        0,9,0.6,0.5,0.4,3.5,-0.2,0.1\n";
    let (out, err) = eval("fk", &ur5e, &[], input);
    let ordered = "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint\n\
        0.1,-0.2,0.3,0.4,0.5,0.6\n\
        0.1,-0.2,3.5,0.4,0.5,0.6\n";
    assert_eq!(out, eval("fk", &ur5e, &[], ordered).0);
    for words in [
        "unused columns: load",
        "elbow_joint: 1 of 2 angles outside its limits -3.1415927 to 3.1415927 rad, first in line 3",
        "2 rows, tips tool0",
    ] {
        assert!(err.contains(words), "no {words:?} in: {err}");
    }
}

#[test]
fn numbers_read_back_as_the_same_single_precision_number() {
    let (out, _) = eval(
        "jacobian",
        &robot("inspire_right"),
        &[],
        &std::fs::read_to_string(data("inspire_right", "states")).unwrap(),
    );
    for word in out.lines().skip(1).flat_map(|line| line.split(',')) {
        let value: f32 = word.parse().unwrap();
        assert_eq!(format!("{value:?}"), word);
    }
}

#[test]
fn a_base_in_between_starts_there_and_uses_its_frame() {
    let robot = robot("ur5e");
    let (code, out, err) = tesaki(
        &[
            "eval",
            "fk",
            "--robot",
            &robot,
            "--in",
            "-",
            "--base",
            "forearm_link",
            "--tip",
            "wrist_3_link",
            "--tip",
            "wrist_1_link",
        ],
        "wrist_1_joint,wrist_2_joint,wrist_3_joint\n0,0,0\n",
    );
    assert_eq!(code, 0, "{err}");
    assert!(out.starts_with("wrist_3_link.x,") && out.contains("wrist_1_link.qw\n"), "{out}");
}

#[test]
fn the_inverse_takes_positions_alone_starts_and_targets_out_of_reach() {
    let robot = robot("ur5e");
    let (out, err) =
        eval("ik", &robot, &[], "tool0.x,tool0.y,tool0.z,elbow_joint\n0.3,0.2,0.4,1.5\n3,0,0,1.5\n");
    let columns = columns(&out);
    assert_eq!(columns["tool0.status"], ["reached", "not reached"], "{out}");
    assert!(numbers(&columns["tool0.position_error"])[0] < 1e-4, "{out}");
    assert!(numbers(&columns["tool0.position_error"])[1] > 1.5, "{out}");
    assert!(err.contains("tool0: 1 of 2 targets not reached"), "{err}");
}

#[test]
fn results_go_to_a_file_and_json_tells_what_was_done() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("fk.csv");
    let states = data("kinova_gen3", "states");
    let arguments =
        ["--json", "eval", "fk", "--robot", &robot("kinova_gen3"), "--in", states.to_str().unwrap()];
    let (code, text, err) = tesaki(&[&arguments[..], &["--out", out.to_str().unwrap()]].concat(), "");
    assert_eq!((code, err.as_str()), (0, ""));
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["rows"], 10);
    assert_eq!(value["tips"][0], "end_effector_link");
    assert_eq!(std::fs::read_to_string(out).unwrap().lines().count(), 11);
}

/// What, robot, further arguments, input; exit code and what is said.
type Case<'a> = (&'a str, &'a str, &'a [&'a str], &'a str, i32, &'a [&'a str]);

#[test]
fn what_does_not_fit_is_told_with_file_line_column_and_advice() {
    let (gripper, panda) = (robot("robotiq_2f85"), robot("franka_panda"));
    let pads: &[&str] = &["--tip", "left_inner_finger_pad"];
    let cases: &[Case<'_>] = &[
        ("fk", &gripper, &[], "", 1, &["standard input is empty"]),
        ("fk", &gripper, &[], "finger_joint\n", 1, &["standard input:1", "no rows"]),
        (
            "fk",
            &gripper,
            &[],
            "finger\n0\n",
            1,
            &["standard input:1", "no column finger_joint (angle [rad])", "columns are finger"],
        ),
        (
            "fk",
            &gripper,
            &[],
            "finger_joint\n0.1\nNaN\n",
            1,
            &["standard input:3", "column finger_joint", "NaN is not a finite number"],
        ),
        (
            "fk",
            &gripper,
            &[],
            "finger_joint\n0.1\n30°\n",
            1,
            &["standard input:3", "column finger_joint", "\"30°\" is not a number"],
        ),
        (
            "fk",
            &gripper,
            &[],
            "finger_joint,a\n0.1\n",
            1,
            &["standard input:2", "the row has 1 value, the header 2 columns"],
        ),
        (
            "fk",
            &gripper,
            &["--tip", "thumb"],
            "finger_joint\n0\n",
            1,
            &["no link \"thumb\"", "left_inner_finger_pad"],
        ),
        ("fk", &gripper, &["--base", "thumb"], "finger_joint\n0\n", 1, &["no link \"thumb\""]),
        (
            "fk",
            &panda,
            &[],
            "a\n0\n",
            1,
            &["franka_panda.urdf:175", "panda_finger_joint1", "prismatic", "panda_hand_tcp"],
        ),
        (
            "ik",
            &gripper,
            &[],
            "finger_joint\n0\n",
            1,
            &["standard input:1", "TIP.x", "tips are left_inner_finger_pad"],
        ),
        (
            "ik",
            &gripper,
            pads,
            "finger_joint\n0\n",
            1,
            &["no column left_inner_finger_pad.x (position of the tip [m])"],
        ),
        (
            "ik",
            &panda,
            &[],
            "panda_hand_tcp.x,panda_hand_tcp.y,panda_hand_tcp.z,panda_hand_tcp.qw\n0,0,1,1\n",
            1,
            &["no column panda_hand_tcp.qx", "all four"],
        ),
        (
            "ik",
            &panda,
            &[],
            "panda_hand_tcp.x,panda_hand_tcp.y,panda_hand_tcp.z,panda_hand_tcp.qx,panda_hand_tcp.qy,panda_hand_tcp.qz,panda_hand_tcp.qw\n0,0,1,1,0,0,1\n",
            1,
            &["standard input:2", "quaternion has length 1.41", "order"],
        ),
        (
            "ik",
            &gripper,
            &["--tip", "left_inner_finger_pad", "--tip", "right_inner_finger_pad"],
            "a\n0\n",
            2,
            &["left_inner_finger_pad and right_inner_finger_pad share the joint finger_joint", "--tip"],
        ),
        (
            "rnea",
            &gripper,
            pads,
            "finger_joint,gx,gy\n0,0,0\n",
            1,
            &["standard input:1", "no column gz (gravity [m/s²]: all three, or none)"],
        ),
        (
            "rnea",
            &gripper,
            pads,
            "finger_joint,left_inner_finger_pad.fx\n0,1\n",
            1,
            &["no column left_inner_finger_pad.fy (wrench on the tip [N, N·m]: all six, or none)"],
        ),
        (
            "rnea",
            &gripper,
            pads,
            "finger_joint,finger_joint.velocity\n0,fast\n",
            1,
            &["standard input:2", "column finger_joint.velocity", "\"fast\" is not a number"],
        ),
        (
            "rnea",
            &gripper,
            pads,
            "finger_joint,finger_joint.velocity\n0,1\n0,1e30\n",
            1,
            &["standard input:3", "left_inner_finger_pad", "beyond single precision"],
        ),
        (
            "mass",
            &gripper,
            &["--tip", "left_outer_finger"],
            "finger_joint,finger_joint.rotor_inertia\n0,-0.1\n",
            1,
            &["standard input:2", "finger_joint.rotor_inertia", "-0.1 kg·m² is below 0"],
        ),
        (
            "bias",
            &gripper,
            pads,
            "finger_joint\n0\n",
            1,
            &["standard input:1", "no column finger_joint.velocity (velocity [rad/s])"],
        ),
        ("fk", "/nowhere.urdf", &[], "a\n0\n", 1, &["/nowhere.urdf", "a folder with robot.urdf"]),
        ("dance", &gripper, &[], "a\n0\n", 2, &["dance", "jacobian"]),
    ];
    for (what, robot, more, input, code, words) in cases {
        let (got, _, err) = tesaki(&[&["eval", what, "--robot", robot, "--in", "-"], *more].concat(), input);
        assert_eq!(got, *code, "{what} {more:?}: {err}");
        for word in *words {
            assert!(err.contains(word), "{what} {more:?}: no {word:?} in: {err}");
        }
    }
    let (code, _, err) = tesaki(&["eval", "fk", "--robot", &gripper, "--in", "/nowhere.csv"], "");
    assert!(code == 1 && err.contains("/nowhere.csv"), "{err}");
}

#[test]
fn wrong_masses_do_not_matter_and_wrong_limits_do_for_the_inverse_alone() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("robot.urdf");
    let text = std::fs::read_to_string(robot("robotiq_2f85")).unwrap();
    let change = |from: &str, to: &str| std::fs::write(&urdf, text.replacen(from, to, 1)).unwrap();
    let robot = folder.path().to_str().unwrap();
    // Of the base, which nothing moves, and of the first link.
    std::fs::write(&urdf, text.replacen("<mass value=\"", "<mass value=\"-", 2)).unwrap();
    let (_, err) = eval("fk", robot, &[], "finger_joint\n0\n");
    assert!(err.contains("1 problem elsewhere in the robot: see `tesaki model check "), "{err}");
    change("upper=\"", "upper=\"100");
    eval("fk", robot, &[], "finger_joint\n0\n");
    let pad = "left_inner_finger_pad.x,left_inner_finger_pad.y,left_inner_finger_pad.z\n0,0.05,0.1\n";
    let inverse = ["eval", "ik", "--robot", robot, "--in", "-"];
    let (code, _, err) = tesaki(&inverse, pad);
    assert!(code == 1 && err.contains("robot.urdf:") && err.contains("degrees?"), "{err}");
    // Those of a joint that is not on the way to the tip matter to nobody.
    change("upper=\"0.81\"", "upper=\"100\"");
    let (code, out, err) = tesaki(&inverse, pad);
    assert!(code == 0 && out.contains("reached") && err.contains("1 problem elsewhere"), "{err}");
    // Nor does their axis; that of a joint on the way does.
    let axis = |joint: &str| {
        change(&format!("<axis xyz=\"1 0 0\"/>{joint}"), &format!("<axis xyz=\"0 0 0\"/>{joint}"))
    };
    axis("\n    <limit effort=\"1000\" lower=\"0\" upper=\"0.81\"");
    let (code, _, err) = tesaki(&inverse, pad);
    assert!(code == 0 && err.contains("1 problem elsewhere"), "{err}");
    axis("\n    <limit effort=\"1000\" lower=\"0\" upper=\"0.8\"");
    let (code, _, err) = tesaki(&inverse, pad);
    assert!(code == 1 && err.contains("joint finger_joint: its axis"), "{err}");
    change("<parent link=\"", "<parent link=\"x");
    let (code, _, err) = tesaki(&["eval", "fk", "--robot", robot, "--in", "-"], "finger_joint\n0\n");
    assert!(code == 1 && err.contains("robot.urdf:") && err.contains("does not exist"), "{err}");
}

#[test]
fn a_table_without_end_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("huge.csv");
    std::fs::File::create(&table).unwrap().set_len(1 << 30).unwrap();
    let arguments = ["eval", "fk", "--robot", &robot(ROBOTS[0].0), "--in", table.to_str().unwrap()];
    let (code, _, error) = tesaki(&arguments, "");
    assert!(code == 1 && error.contains("huge.csv: larger than 128 MiB"), "{error}");
}
