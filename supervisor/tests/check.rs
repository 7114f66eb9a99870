//! `tesaki model check`: all that is wrong in a folder at once, by file and line.
#![cfg(all(unix, feature = "cli"))]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::{Path, PathBuf};
use std::process::Command;

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Exit code and all that was printed.
fn check(arguments: &[&str], robot: &Path) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tesaki"));
    let output = command.args(arguments).args(["model", "check"]).arg(robot).output().unwrap();
    let text = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    (output.status.code().unwrap(), text)
}

fn contains(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
}

/// hand3 with changes: file, from, to.
fn changed(changes: &[(&str, &str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["robot.urdf", "controller.toml"] {
        let mut text = std::fs::read_to_string(workspace().join("robots/hand3").join(name)).unwrap();
        for (_, from, to) in changes.iter().filter(|(file, ..)| *file == name) {
            assert!(text.contains(from), "{from}");
            text = text.replacen(from, to, 1);
        }
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

#[test]
fn what_a_hand_grasps_and_its_camera_are_checked_too() {
    let folder = changed(&[]);
    for (robot, file, from, to) in [
        ("hand3", "grasps/box.toml", "touch_force = 0.1", "touch_force = 1000.0"),
        ("hand3", "grasps/wedge.toml", "[[contact]]", "[[contacts]]"),
        ("hand3", "objects/box.toml", "mass = 0.023", "mass = -0.023"),
        ("knob-arm", "camera.toml", "focal = 140.0", "focal = 0.0"),
        ("knob-arm", "approach.toml", "", ""),
    ] {
        let text = std::fs::read_to_string(workspace().join("robots").join(robot).join(file)).unwrap();
        assert!(text.contains(from), "{from}");
        let file = folder.path().join(file);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text.replacen(from, to, 1)).unwrap();
    }
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "grasps/box.toml:3: the touch force is 1000 N",
            "grasps/wedge.toml:",
            "unknown field `contacts`",
            "objects/box.toml:4: mass is -0.023: it must be above 0 [kg]",
            "camera.toml:5: focal is 0: it must be above 0 [px]",
            "approach.toml: not checked: there is no hand_eye.toml",
            "4 problems found",
        ],
    );
}

#[test]
fn a_file_that_cannot_be_read_does_not_hide_what_is_wrong_in_the_others() {
    let folder = changed(&[]);
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("grasps")).unwrap();
    std::fs::write(at("grasps/first.toml"), b"\xff\xfe").unwrap();
    std::fs::write(at("grasps/second.toml"), "touch_farce = 0.1\n").unwrap();
    std::fs::create_dir(at("camera.toml")).unwrap();
    std::fs::write(at("plant.toml"), "nonsense = 1\n").unwrap();
    std::os::unix::fs::symlink(at("nowhere"), at("impedances")).unwrap();
    let told = [
        "grasps/first.toml: it cannot be read: stream did not contain valid UTF-8",
        "→ nothing in it is checked: make it a text file, or a folder of such, that you may read",
        "grasps/second.toml:1: ",
        "camera.toml: it cannot be read: Is a directory",
        "plant.toml",
        "nonsense",
        "impedances: it cannot be read: No such file",
    ];
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(&text, &told);
    // The robot, too.
    std::fs::remove_file(at("robot.urdf")).unwrap();
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(&text, &told);
    contains(
        &text,
        &["robot.urdf: it cannot be read: No such file", "controller.toml: not checked: it needs"],
    );
    let (code, text) = check(&["--json"], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(&text, &["\"finding\":\"it cannot be read: Is a directory"]);
}

#[test]
fn an_unreadable_urdf_says_what_to_do_about_it() {
    let folder = changed(&[]);
    let urdf = folder.path().join("robot.urdf");
    std::fs::write(&urdf, b"\xff\xfe<robot name=\"hand\"/>").unwrap();
    let (_, text) = check(&[], folder.path());
    contains(
        &text,
        &["robot.urdf: it cannot be read: stream did not contain valid UTF-8", "→ save it as UTF-8"],
    );
    assert!(!text.contains("a robot folder holds"), "{text}");
    std::fs::remove_file(&urdf).unwrap();
    std::fs::create_dir(&urdf).unwrap();
    let (_, text) = check(&[], folder.path());
    contains(
        &text,
        &["robot.urdf: it cannot be read: Is a directory", "→ it is a folder: name a file, or put"],
    );
}

#[test]
fn a_urdf_without_joints_does_not_hide_that_settings_and_laws_are_not_checked() {
    let folder = changed(&[]);
    std::fs::create_dir(folder.path().join("laws")).unwrap();
    std::fs::write(folder.path().join("laws/mine.toml"), "nonsense = 1\n").unwrap();
    for urdf in ["", "<robot", "<robot name=\"hand\"/>"] {
        std::fs::write(folder.path().join("robot.urdf"), urdf).unwrap();
        let (code, text) = check(&[], folder.path());
        assert_eq!(code, 1, "{text}");
        contains(
            &text,
            &[
                "robot.urdf:1: ",
                "controller.toml: its joints are not checked: no joint of robot.urdf can be read",
                "laws: not checked: it needs the robot's model",
            ],
        );
    }
}

#[test]
fn a_folder_without_settings_is_checked_as_far_as_possible() {
    let folder = changed_plant(&[("plant.toml", "voltage = 24.0", "voltage = -24.0")]);
    std::fs::remove_file(folder.path().join("controller.toml")).unwrap();
    for name in ["laws", "grasps"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
        std::fs::write(folder.path().join(name).join("mine.toml"), "nonsense = [\n").unwrap();
    }
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "tip finger1_tip: base palm",
            "plant.toml:",
            "supply.voltage is -24",
            "grasps/mine.toml:1: ",
            "laws: not checked: it needs the robot's model",
            "→ `tesaki model init",
            "2 problems found",
        ],
    );
}

#[test]
fn a_good_folder_lists_its_joints() {
    let (code, text) = check(&[], &workspace().join("robots/hand3"));
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &["chain to finger1_tip", "finger3_curl", "hand3: 9 joints in 3 chains", "no problems found"],
    );
}

#[test]
fn mimic_joints_are_listed_with_what_they_follow() {
    let (code, text) = check(&[], &workspace().join("robots/inspire"));
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &[
            "R_thumb_intermediate_joint = 1.6 R_thumb_proximal_pitch_joint, link 3.8 g",
            "R_thumb_distal_joint = 2.4 R_thumb_proximal_pitch_joint, link 3.3 g",
            "R_pinky_intermediate_joint = 1 R_pinky_proximal_joint, link 3.6 g",
            "inspire_right_hand: 6 joints and 6 mimic joints in 5 chains",
        ],
    );
    // The motor of one finger moves joints of three others.
    let (_, text) = check(&[], &workspace().join("robots/hand5"));
    contains(&text, &["chain to ring_tip", "ring_spread          = -0.4 spread, link 12.0 g"]);
}

#[test]
fn every_mistake_of_both_files_is_told_in_one_go() {
    let folder = changed(&[
        ("robot.urdf", "<mass value=\"0.04\"/>", "<mass value=\"4000\"/>"),
        ("robot.urdf", "lower=\"-1.2\" upper=\"1.7\"", "lower=\"-70\" upper=\"97\""),
        ("robot.urdf", "<origin xyz=\"0 0 0.046\"/>", "<origin xyz=\"0 0 46\"/>"),
        (
            "controller.toml",
            "[joint.servo]",
            "[joints.thumb.motor]\ndelay = 1e-4\n\n[joints.finger2_bend.motor]\ntorqe = 1\n\n[joint.servo]",
        ),
        ("controller.toml", "torque_rate = 60.0", "torque_rate = \"fast\""),
        ("controller.toml", "supply_min = 20.0", "supply_minimum = 20.0"),
    ]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "robot.urdf:45: link finger1_knuckle: mass = 4000 kg",
            "robot.urdf:59: joint finger1_bend: limits -70 to 97 rad",
            "robot.urdf:75: joint finger1_curl: 46 m",
            "controller.toml:10: ",
            "supply_minimum",
            "controller.toml:41: [joints.thumb]: the URDF has no such joint",
            "controller.toml:45: joint finger2_bend: unknown key motor.torqe",
            "controller.toml:38: joints finger1_swing, finger1_bend",
            "invalid type: string \"fast\", expected a number",
            "7 problems found",
        ],
    );
}

#[test]
fn values_that_make_no_sense_are_told_for_every_joint_with_the_line_of_their_file() {
    let folder = changed(&[
        ("robot.urdf", "effort=\"0.6\" velocity=\"6\"", "effort=\"0.6\" velocity=\"0\""),
        (
            "controller.toml",
            "[joint.servo]",
            "[joints.finger2_bend.motor]\ntorque_constant = -0.5\n\n[joint.servo]",
        ),
    ]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "robot.urdf:34: joint finger1_swing: limits.velocity = 0 rad/s must be above 0 rad/s",
            "<limit velocity",
            "controller.toml:42: joint finger2_bend: motor.torque_constant = -0.5 N·m/A must be above 0 N·m/A",
            "2 problems found",
        ],
    );
}

#[test]
fn joints_without_settings_are_named() {
    let folder = changed(&[]);
    let settings =
        "gravity = [0.0, 0.0, -9.81]\n[safety]\ndamping = 0.01\nsupply_min = 20.0\nsupply_max = 28.0\n";
    std::fs::write(folder.path().join("controller.toml"), settings).unwrap();
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "joints finger1_swing, finger1_bend",
            "finger3_curl: no settings given",
            "[joint…]",
            "1 problem found",
        ],
    );
}

#[test]
fn a_mimic_joint_has_no_motor_but_can_be_evaluated() {
    let limit = "<limit lower=\"-0.1\" upper=\"2.4\" effort=\"0.6\" velocity=\"6\"/>";
    let folder = changed(&[("robot.urdf", limit, &format!("{limit}<mimic joint=\"finger1_bend\"/>"))]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(&text, &["finger1_curl", "force_sensor of a chain with a mimic joint", "remove [force_sensor]"]);
    // Without settings for a controller it is fine.
    std::fs::remove_file(folder.path().join("controller.toml")).unwrap();
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &[
            "checked without a model of the robot: the folder has no controller.toml",
            "finger1_curl (= 1 finger1_bend)",
        ],
    );
}

#[test]
fn warnings_alone_are_no_failure_and_json_is_a_list() {
    let robot = workspace().join("tests/robots/franka_panda.urdf");
    let (code, text) = check(&["--json"], &robot);
    assert_eq!(code, 0, "{text}");
    let list: serde_json::Value = serde_json::from_str(&text).unwrap();
    let warning = list.as_array().unwrap().iter().find(|entry| entry["severity"] == "warning").unwrap();
    assert_eq!(warning["line"], 175);
    assert!(warning["file"].as_str().unwrap().ends_with("franka_panda.urdf"));
    contains(warning["finding"].as_str().unwrap(), &["panda_finger_joint1", "prismatic"]);
    contains(warning["advice"].as_str().unwrap(), &["panda_hand_tcp"]);
    let (_, text) = check(&[], &robot);
    contains(&text, &["warn  ", "works; 2 warnings"]);
}

#[test]
fn published_robots_have_nothing_wrong_with_their_kinematics() {
    for entry in std::fs::read_dir(workspace().join("tests/robots")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "urdf") {
            let (code, text) = check(&[], &path);
            // One of them has inertias that no body can have.
            let expected = i32::from(path.ends_with("allegro_right.urdf"));
            assert_eq!(code, expected, "{}: {text}", path.display());
            assert_eq!(
                text.matches("BAD").count(),
                text.matches("physically impossible inertia").count(),
                "{text}"
            );
            contains(&text, &["tip "]);
        }
    }
}

#[test]
fn a_place_without_a_robot_says_what_is_there() {
    let (code, text) = check(&[], &workspace().join("tests/robots"));
    assert_eq!(code, 1);
    contains(&text, &["robots/robot.urdf", "a folder with robot.urdf", "ur5e.urdf"]);
}

/// hand3 with changes, and its plant.toml with others.
fn changed_plant(changes: &[(&str, &str, &str)]) -> tempfile::TempDir {
    let folder = changed(changes);
    let mut text = std::fs::read_to_string(workspace().join("robots/hand3/plant.toml")).unwrap();
    for (_, from, to) in changes.iter().filter(|(file, ..)| *file == "plant.toml") {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    std::fs::write(folder.path().join("plant.toml"), text).unwrap();
    folder
}

#[test]
fn what_no_machine_is_likely_to_have_is_told_all_at_once() {
    let folder = changed_plant(&[
        // 25 kg at 23 mm weigh 5.6 N·m where the motor has 0.6.
        ("robot.urdf", "<mass value=\"0.02\"/>", "<mass value=\"25\"/>"),
        ("robot.urdf", "damping=\"0.002\" friction=\"0.02\"", "damping=\"0.2\" friction=\"0.7\""),
        ("controller.toml", "rotor_inertia = 2e-4", "rotor_inertia = 2e-6"),
        (
            "controller.toml",
            "[joint.servo]",
            "[joints.finger3_curl.motor]\nrotor_inertia = 0.0\n\n[joint.servo]",
        ),
        ("controller.toml", "filter_time = 0.2", "filter_time = 0.05"),
        ("plant.toml", "finger1_bend = 0.3316125578789226", "finger1_bend = 1.9"),
        ("plant.toml", "voltage = 24.0", "voltage = 12.0"),
        ("plant.toml", "finger2_bend =", "finger4_bend ="),
    ]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "joint finger1_swing: Coulomb friction 0.7 N·m is not below the motor's torque 0.600 N·m: it cannot move",
            "joint finger1_swing: viscous friction takes 1.200 N·m at the velocity limit of 6 rad/s",
            "joint finger1_bend: gravity needs up to 5.6",
            "finger3_swing, finger3_bend: motor.rotor_inertia = 2e-6 kg·m²: 0.7 N·m would bring the rotor to 40.0 rad/s in \
             0.114 ms",
            "joint finger3_curl: motor.rotor_inertia = 0: every motor has a rotor",
            "joints finger1_curl, finger2_curl, finger3_curl: a move over half of its range reaches 9.20 rad/s, above its limit of 6 rad/s",
            "plant.toml:51: joint finger1_bend: starts at 1.9 rad, outside its limits -1.2 to 1.7 rad",
            "supply.voltage = 12 V, outside safety.supply_min and supply_max of controller.toml, 20 to 28 V",
            "[posture]: the URDF has no joint finger4_bend",
            "integration.step = 0.001 s is too long for joint finger3_curl",
        ],
    );
}

#[test]
fn everything_wrong_with_the_plant_is_told_also_when_the_robot_is_wrong() {
    let folder = changed_plant(&[
        ("controller.toml", "torque_rate = 60.0", "torque_rat = 60.0"),
        ("plant.toml", "spread = 0.2", "spread = 1.2"),
        ("plant.toml", "step = 0.001", "stepp = 0.001"),
        ("plant.toml", "[supply]", "[suply]"),
    ]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(
        &text,
        &[
            "torque_rat",
            "integration: unknown field `stepp`",
            "unknown key suply",
            "supply is missing",
            "4 problems found",
        ],
    );
    let folder = changed_plant(&[
        ("plant.toml", "spread = 0.2", "spread = 1.2"),
        ("plant.toml", "voltage = 24.0", "voltage = -24.0"),
    ]);
    let (_, text) = check(&[], folder.path());
    contains(
        &text,
        &[
            "plant.toml:10: mismatch.spread is 1.2: it must be from 0 to below 1",
            "supply.voltage is -24",
            "2 problems found",
        ],
    );
}

#[test]
fn an_accepted_inertia_and_corrected_limits_and_friction_reach_the_model() {
    let folder = changed(&[
        ("robot.urdf", "izz=\"4.9e-07\"", "izz=\"4.9e-05\""),
        ("controller.toml", "gravity =", "accept_inertia = [\"finger1_lower\"]\ngravity ="),
        (
            "controller.toml",
            "[joint.servo]",
            "[joints.finger1_swing.friction]\ncoulomb = 0.5\n\n[joints.finger1_swing.limits]\nvelocity = 3.5\n\n[joint.servo]",
        ),
    ]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &[
            "finger1_swing         -1.000 to  1.000 rad,   3.50 rad/s",
            "link finger1_lower: accepted: the nearest inertia that a body can have is used",
            "joint finger1_swing: Coulomb friction 0.5 N·m takes 83 % of the motor's torque",
        ],
    );
    let folder = changed(&[("controller.toml", "gravity =", "accept_inertia = [\"thumb\"]\ngravity =")]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    contains(&text, &["controller.toml:4: accept_inertia: the URDF has no link thumb"]);
}

#[test]
fn laws_and_impedances_of_an_arm_are_checked() {
    let (code, text) = check(&[], &workspace().join("robots/arm7"));
    assert_eq!(code, 0, "{text}");
    let folder = tempfile::tempdir().unwrap();
    for name in ["robot.urdf", "controller.toml", "impedances/soft.toml", "laws/paper.toml"] {
        let text = std::fs::read_to_string(workspace().join("robots/arm7").join(name)).unwrap();
        let file = folder.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(
            file,
            text.replace("stiffness = { translation = 300.0", "stiffness = { translation = -3.0"),
        )
        .unwrap();
    }
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 1, "{text}");
    let wrong = "the stiffness along x is -3 N/m; possible with this mass is 0 to 3750 N/m";
    for file in ["impedances/soft.toml", "laws/paper.toml"] {
        let path = folder.path().join(file);
        let text_of_file = std::fs::read_to_string(&path).unwrap();
        let line = text_of_file.lines().position(|line| line.starts_with("stiffness")).unwrap() + 1;
        contains(&text, &[&format!("{}:{line}: {wrong}", path.display())]);
    }
}

/// Exit code and text for hand3 with one change, all of it.
fn check_changed(file: &str, from: &str, to: &str) -> (i32, String) {
    let folder = changed_plant(&[(file, from, to)]);
    check(&[], folder.path())
}

#[test]
fn a_motor_in_milliamperes_or_a_limit_in_newton_millimetres_is_told() {
    // hand3: 1.4 A at 0.5 N·m/A are 0.7 N·m; its limits are 0.6 N·m.
    let cases = [
        (
            "controller.toml",
            "current_limit = 1.4",
            "current_limit = 1400.0",
            "is 700.0000 N·m; the torque limit is 0.6",
        ),
        (
            "controller.toml",
            "torque_constant = 0.5",
            "torque_constant = 500.0",
            "is 700.0000 N·m; the torque limit is 0.6",
        ),
        ("robot.urdf", "effort=\"0.6\"", "effort=\"600\"", "is 0.7000 N·m; the torque limit is 600 N·m"),
        ("controller.toml", "current_limit = 1.4", "current_limit = 0.38", "is 0.1900 N·m"),
    ];
    for (file, from, to, words) in cases {
        let (_, text) = check_changed(file, from, to);
        contains(&text, &[words, "check the units: A, N·m/A at the joint"]);
    }
    // Up to a factor of three they are a matter of taste.
    for current in ["0.42", "3.58"] {
        let (_, text) =
            check_changed("controller.toml", "current_limit = 1.4", &format!("current_limit = {current}"));
        assert!(!text.contains("check the units"), "{text}");
    }
}

#[test]
fn our_robots_have_motors_that_fit_their_limits() {
    for name in ["hand3", "arm7", "hand5", "knob-arm", "allegro", "leap", "inspire"] {
        let (code, text) = check(&[], &workspace().join("robots").join(name));
        assert_eq!(code, 0, "{text}");
        assert!(!text.contains("check the units"), "{name}: {text}");
    }
}

#[test]
fn what_follows_from_a_wrong_value_is_not_told_again() {
    // An inertia and a mass below 0: neither is missing.
    for (from, to) in [("ixx=\"", "ixx=\"-"), ("<mass value=\"", "<mass value=\"-")] {
        let (code, text) = check_changed("robot.urdf", from, to);
        assert_eq!(code, 1, "{text}");
        contains(&text, &["link finger1_knuckle: ", "1 problem found"]);
        assert!(!text.contains("without mass or inertia"), "{text}");
    }
    // Grams: no motor can hold them, of course.
    let (_, text) = check_changed("robot.urdf", "<mass value=\"0.02\"/>", "<mass value=\"2000\"/>");
    contains(&text, &["grams?", "1 problem found"]);
    // A rotor below 0 is there, and has no time constant.
    let (_, text) = check_changed("controller.toml", "rotor_inertia = 2e-4", "rotor_inertia = -2e-4");
    contains(
        &text,
        &[
            "finger3_bend, finger3_curl: motor.rotor_inertia = -0.0002 kg·m² is below 0 kg·m²",
            "1 problem found",
        ],
    );
    // A joint without direction is in the URDF all the same.
    let urdf = std::fs::read_to_string(workspace().join("robots/hand3/robot.urdf")).unwrap();
    let folder = changed_plant(&[]);
    let joints = urdf.matches("<axis xyz=").count();
    let text = urdf.replace("<axis xyz=\"", "<axis xyz=\"0 0 0\" was=\"");
    std::fs::write(folder.path().join("robot.urdf"), text).unwrap();
    let (_, text) = check(&[], folder.path());
    contains(&text, &["joint finger1_bend: its axis", &format!("{joints} problems found")]);
    // The table of a misspelt joint holds what the common one lacks.
    let (_, text) = check_changed("controller.toml", "[joint.servo.pid]", "[joints.finger1_bent.servo.pid]");
    contains(&text, &["[joints.finger1_bent]: the URDF has no such joint", "1 problem found"]);
}

/// All gains of a servo are multiplied by its inertia.
#[test]
fn a_servo_for_another_inertia_is_told() {
    for (inertia, words) in
        [(2e-3, "times too high: it may be unstable"), (2e-5, "times too low: it is weak")]
    {
        let section = format!("[joints.finger1_bend.servo]\ninertia = {inertia}\n\n[joint.servo]");
        let (code, text) = check_changed("controller.toml", "[joint.servo]", &section);
        assert_eq!(code, 0, "{text}");
        contains(&text, &["joint finger1_bend: servo.inertia = ", words, "without servo.inertia"]);
    }
}

#[test]
fn the_wrong_current_loop_of_a_plant_is_told() {
    let (folder, words) =
        (changed_plant(&[("plant.toml", "bandwidth = 300.0", "bandwidth = 3.0")]), "motor.bandwidth");
    let (_, text) = check(&[], folder.path());
    contains(&text, &["inner_loop.bandwidth = 3 Hz; no joint", words]);
}

#[test]
fn a_tip_on_the_axis_of_its_last_joint_is_told_of_a_finger() {
    // The joint turns about y; a tip at y = 2 cm lies on its axis, one beside it does not.
    let from = "<origin xyz=\"0 0 0.05178\"/>";
    for (to, told) in [("0 0 0", true), ("0 0.02 0", true), ("0 0.02 0.001", false)] {
        let (_, text) = check_changed("robot.urdf", from, &format!("<origin xyz=\"{to}\"/>"));
        let words = "joint finger1_curl: the tip finger1_tip lies on its axis";
        assert_eq!(text.contains(words), told, "{to}: {text}");
    }
}

#[test]
fn a_wrong_value_is_named_by_its_key_and_a_weight_by_its_link() {
    for (from, to, words) in [
        ("supply_min = 20.0", "supply_min = \"20\"", "expected a number, for safety.supply_min"),
        ("reaction = \"hold\"", "reaction = \"brake\"", "unknown variant `brake`, expected"),
        ("reaction = \"hold\"", "reaction = \"brake\"", ", for safety.reaction"),
        ("following_error = 0.25", "following_error = 0.01", "at least 0.180 rad, three times that"),
    ] {
        let (_, text) = check_changed("controller.toml", from, to);
        contains(&text, &[words]);
    }
    let (_, text) = check_changed("robot.urdf", "<mass value=\"0.02\"/>", "<mass value=\"30\"/>");
    contains(&text, &["(the heaviest link is finger1_lower with 30 kg, robot.urdf:62)"]);
}

/// The shipped robot `name` in a folder of its own, with the files of others.
fn with_files(name: &str, files: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let own = ["robot.urdf", "controller.toml"].map(|file| format!("{name}/{file}"));
    for file in own.iter().map(String::as_str).chain(files.iter().copied()) {
        let to = folder.path().join(file.split_once('/').unwrap().1);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(workspace().join("robots").join(file), to).unwrap();
    }
    folder
}

#[test]
fn files_that_are_of_no_use_to_a_robot_are_warned_of_once() {
    let folder = with_files("hand3", &["arm7/impedances/soft.toml"]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &["impedances: not checked: hand3: ", "only an arm has an impedance", "works; 1 warning"],
    );
    let folder = with_files("arm7", &["hand3/grasps/box.toml", "hand3/grasps/wedge.toml"]);
    let (code, text) = check(&[], folder.path());
    assert_eq!(code, 0, "{text}");
    contains(
        &text,
        &["grasps: not checked: arm7 is not a hand for grasping: three fingers", "works; 1 warning"],
    );
}

#[test]
fn fingers_reach_the_contacts_of_a_grasp() {
    let folder = with_files("hand3", &["hand3/grasps/box.toml"]);
    let file = folder.path().join("grasps/box.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    assert_eq!(check(&[], folder.path()).0, 0);
    std::fs::write(&file, text.replacen("position = [0.090", "position = [0.290", 1)).unwrap();
    let (code, said) = check(&[], folder.path());
    assert_eq!(code, 1, "{said}");
    contains(&said, &["box.toml: finger1_tip cannot stand at contact 1: ", "is out of reach", "contact 2: "]);
    // The first contact as the last one.
    let (head, contacts) = text.split_once("[[contact]]").unwrap();
    let (first, others) = contacts.split_once("[[contact]]").unwrap();
    std::fs::write(&file, format!("{head}[[contact]]{others}\n[[contact]]{first}")).unwrap();
    let (code, said) = check(&[], folder.path());
    assert_eq!(code, 1, "{said}");
    contains(&said, &["cannot stand at contact ", "is within its reach", "are they in the fingers' order?"]);
}
