//! Robot folders: what a good one becomes, and what is said about bad ones.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki::kinematics::Chain;

use tesaki_description::init::{InitOptions, MotorChoice, robot_texts};
use tesaki_description::robot::{RobotFolder, chain_model};

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3");

fn text(name: &str) -> String {
    std::fs::read_to_string(Path::new(FOLDER).join(name)).unwrap()
}

/// The error for hand3 with `from` replaced by `to` once in the file `name`.
fn error(name: &str, from: &str, to: &str) -> String {
    let change = |file: &str| {
        let text = text(file);
        if file == name {
            assert!(text.contains(from), "{from:?} is not in {name}");
            text.replacen(from, to, 1)
        } else {
            text
        }
    };
    let folder = RobotFolder::parse(Path::new("my_hand"), &change("robot.urdf"), &change("controller.toml"));
    folder.map(|_| ()).unwrap_err().to_string()
}

#[test]
fn hand3_becomes_nine_joints_in_three_chains() {
    let model = RobotFolder::load(Path::new(FOLDER)).unwrap().model;
    assert_eq!((model.name.as_str(), model.chains.len(), model.joints.len()), ("hand3", 3, 9));
    let names: Vec<&str> = model.joints.iter().take(4).map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["finger1_swing", "finger1_bend", "finger1_curl", "finger2_swing"]);
    // The last link of a finger and its sensor: 10 g and 5 g, fixed together.
    assert!((model.joints[2].link.mass - 0.015).abs() < 1e-7);
    assert!((model.joints[0].limits.torque - 0.6).abs() < 1e-7);
    assert!((model.joints[0].friction.coulomb - 0.02).abs() < 1e-7);
    // Gains are given per inertia; a curl joint feels its rotor and little else.
    let curl = &model.joints[2].servo;
    assert!((2e-4..2.5e-4).contains(&curl.observer.inertia), "{}", curl.observer.inertia);
    assert!((curl.pid.proportional / curl.observer.inertia - 400.0).abs() < 0.1);
}

#[test]
fn nonsense_is_named_by_file_joint_and_field() {
    let cases = [
        (
            "robot.urdf",
            "<mass value=\"0.01\"/>",
            "<mass value=\"-0.02\"/>",
            "link finger1_upper: mass = -0.02 kg is below 0",
        ),
        (
            "robot.urdf",
            "lower=\"-1.0\" upper=\"1.0\"",
            "lower=\"2.0\" upper=\"1.0\"",
            "joint finger1_swing: lower = 2 is not below upper = 1",
        ),
        ("robot.urdf", "<robot name=\"hand3\"", "<robt name=\"hand3\"", "robot.urdf"),
        ("robot.urdf", "type=\"revolute\"", "type=\"prismatic\"", "joint finger1_swing is of type prismatic"),
        (
            "controller.toml",
            "torque_constant = 0.5",
            "torque_constant = -0.5",
            "motor.torque_constant = -0.5",
        ),
        (
            "controller.toml",
            "relative = true",
            "relative = maybe",
            "controller.toml:35: neither a number, true, false nor a text in quotes, for joint.encoder.relative",
        ),
        ("controller.toml", "torque_constant = 0.5", "torque_konstant = 0.5", "torque_constant"),
        (
            "controller.toml",
            "reaction = \"hold\"",
            "reaction = \"pray\"",
            "unknown variant `pray`, expected one of `off`, `damp`, `hold`, for safety.reaction",
        ),
        (
            "controller.toml",
            "command_timeout = 0.1 ",
            "command_timeout = \"0.1\" ",
            "expected a number, for safety.command_timeout",
        ),
        ("controller.toml", "gravity = [", "gravity = ", "controller.toml:4: "),
        (
            "controller.toml",
            "[joint.servo]",
            "[joints.thumb]\nx = 1\n[joint.servo]",
            "[joints.thumb]: the URDF has no such joint",
        ),
        (
            "controller.toml",
            "command_timeout = 0.1 ",
            "command_timeout = 0.0 ",
            "safety.command_timeout = 0 s is below 0.01 s",
        ),
        (
            "controller.toml",
            "proportional = 400.0",
            "proportional = -400.0",
            "finger3_curl: servo.pid.proportional = -400 1/s² is below 0 1/s²",
        ),
        // All gains are multiplied with it.
        (
            "controller.toml",
            "[joint.servo]",
            "[joint.servo]\ninertia = -0.001",
            "controller.toml:42: joints finger1_swing, finger1_bend, finger1_curl, finger2_swing, finger2_bend, \
             finger2_curl, finger3_swing, finger3_bend, finger3_curl: servo.inertia = -0.001 kg·m² must be above 0 \
             kg·m²; mend the value, or leave it out",
        ),
        (
            "controller.toml",
            "[joint.limits]",
            "[joint.limits]\nvelocity = -1.0",
            "finger3_curl: limits.velocity = -1 rad/s must be above 0 rad/s",
        ),
    ];
    for (name, from, to, expected) in cases {
        let message = error(name, from, to);
        assert!(message.contains("my_hand") && message.contains(expected), "{from} → {to}: {message}");
    }
}

/// Values of `controller.toml` are told with its line, whatever else is wrong with the URDF.
#[test]
fn friction_of_the_settings_is_not_blamed_on_the_urdf() {
    let urdf = text("robot.urdf").replacen("<mass value=\"0.01\"/>", "<mass value=\"-0.02\"/>", 1);
    let settings = text("controller.toml") + "\n[joints.finger2_bend]\nfriction = { coulomb = -0.5 }\n";
    let line = settings.lines().count();
    let findings = RobotFolder::check_all(Path::new("my_hand"), &urdf, &settings, None).1;
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    let place = format!("my_hand/controller.toml:{line}: joint finger2_bend: friction.coulomb = -0.5 N·m");
    assert!(said.iter().any(|text| text.starts_with(&place)), "{said:?}");
    assert!(said.iter().any(|text| text.contains("link finger1_upper: mass = -0.02 kg")), "{said:?}");
}

#[test]
fn a_folder_without_files_says_what_belongs_there() {
    let message = RobotFolder::load(Path::new("/nowhere")).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("/nowhere/robot.urdf") && message.contains("controller.toml"), "{message}");
}

#[test]
fn a_urdf_alone_becomes_a_folder_by_a_command_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("robot.urdf"), text("robot.urdf")).unwrap();
    let message = RobotFolder::load(folder.path()).map(|_| ()).unwrap_err().to_string();
    let command = format!("`tesaki model init {}` writes it", folder.path().display());
    assert!(message.contains("controller.toml") && message.contains(&command), "{message}");
}

#[test]
fn values_that_init_chooses_pass_the_check() {
    // Efforts and velocities of published hands: DClaw's, the Barrett hand's, and a direct drive's.
    for (effort, velocity, upper) in [(10, 100.0, 1.57), (0, 10.0, 0.84), (0, 2.0, 0.84), (1, 0.0, 0.05)] {
        let limit = format!("effort=\"{effort}\" velocity=\"{velocity}\"");
        let urdf = format!(
            "<robot name=\"claw\"><link name=\"palm\"/><joint name=\"bend\" type=\"revolute\">\
             <parent link=\"palm\"/><child link=\"finger\"/><axis xyz=\"0 1 0\"/>\
             <limit lower=\"0\" upper=\"{upper}\" {limit}/></joint><link name=\"finger\"><inertial>\
             <mass value=\"0.1\"/><origin xyz=\"0 0 0.02\"/>\
             <inertia ixx=\"2e-5\" iyy=\"2e-5\" izz=\"1e-5\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>\
             <joint name=\"end\" type=\"fixed\"><parent link=\"finger\"/><child link=\"tip\"/>\
             <origin xyz=\"0 0 0.05\"/></joint><link name=\"tip\"/></robot>"
        );
        for motor in [None, Some("generic"), Some("gl40-kv70"), Some("xl330-m288"), Some("xm430-w350")] {
            let motors = motor.map(|motor| MotorChoice { joint: None, motor: motor.to_owned() });
            let options = InitOptions { motors: motors.into_iter().collect(), ..InitOptions::default() };
            let texts = robot_texts(Path::new("claw.urdf"), &urdf, &options).unwrap();
            let (_, findings) =
                RobotFolder::check_all(Path::new("claw"), &urdf, &texts.controller, Some(&texts.plant));
            let errors: Vec<_> = findings.iter().filter(|finding| finding.is_error()).collect();
            assert!(errors.is_empty(), "{limit} {motor:?}: {errors:?}");
            let note = "velocity 100.0 rad/s of the URDF's <limit>: more than ticks of 10 ms can follow";
            let slow = matches!(motor, Some("xl330-m288" | "xm430-w350"));
            let told = texts.notes.iter().any(|text| text.contains(note));
            assert_eq!(told, velocity > 50.0 && !slow, "{motor:?}: {:?}", texts.notes);
        }
    }
}

#[test]
fn joints_of_the_plant_that_the_robot_has_not_are_named() {
    let plant = format!("{}\n[elasticity]\nfinger1_bent = 8000.0\n", text("plant.toml"));
    let (_, findings) = RobotFolder::check_all(
        Path::new("hand"),
        &text("robot.urdf"),
        &text("controller.toml"),
        Some(&plant),
    );
    let said: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
    assert!(said.contains("[elasticity]: the URDF has no joint finger1_bent"), "{said}");
    assert!(said.contains("the moving joints are finger1_swing"), "{said}");
}

#[test]
fn masses_in_grams_are_found_by_their_density() {
    let said = |from: &str, to: &str| {
        let urdf = text("robot.urdf");
        assert!(urdf.contains(from), "{from}");
        let (_, findings) = RobotFolder::check_all(
            Path::new("hand"),
            &urdf.replacen(from, to, 1),
            &text("controller.toml"),
            None,
        );
        findings.iter().map(|finding| format!("{finding}\n")).collect::<String>()
    };
    assert!(!said("value=\"0.01\"", "value=\"0.01\"").contains("denser"));
    let grams = said("value=\"0.01\"", "value=\"10\"");
    assert!(grams.contains("denser than lead: grams?") && grams.contains("10 g are 0.01"), "{grams}");
}

/// 2 kg·cm², taken for 2 kg·m²: 17.1 s at the 0.7 N·m of 1.4 A to 6 rad/s.
#[test]
fn a_rotor_in_another_unit_is_warned_of() {
    let settings = text("controller.toml").replacen("rotor_inertia = 2e-4", "rotor_inertia = 2.0", 1);
    let (folder, findings) = RobotFolder::check_all(Path::new("hand"), &text("robot.urdf"), &settings, None);
    let said: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
    assert!(folder.is_some() && said.contains("0.7 N·m need 17.1 s") && said.contains("kg·cm²"), "{said}");
}

#[test]
fn a_folder_that_says_nothing_of_it_has_a_command_timeout_of_100_ms_and_holds() {
    let settings =
        text("controller.toml").replacen("command_timeout = 0.1 ", "# ", 1).replacen("reaction = ", "# ", 1);
    assert!(!settings.contains("command_timeout"));
    let model = RobotFolder::parse(Path::new("my_hand"), &text("robot.urdf"), &settings).unwrap().model;
    assert_eq!(model.safety.reaction, tesaki::model::Reaction::Hold);
    assert!((model.safety.command_timeout - 0.1).abs() < 1e-9);
}

#[test]
fn a_chain_ends_in_the_farthest_of_the_leaves_that_are_fixed_to_its_last_body() {
    let more = |name: &str, parent: &str, z: &str| {
        format!(
            "<joint name=\"to_{name}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{name}\"/>\
             <origin xyz=\"0 0 {z}\"/></joint><link name=\"{name}\"/></robot>"
        )
    };
    for (name, parent, z, expected) in [
        ("camera", "finger1_upper", "0.001", "finger1_tip"),
        ("nail", "finger1_upper", "0.09", "nail"),
        ("nail", "finger1_tip", "0.002", "nail"),
        // A leaf on another body is no part of the last.
        ("motor", "finger1_lower", "0.5", "finger1_tip"),
    ] {
        let urdf = text("robot.urdf").replace("</robot>", &more(name, parent, z));
        let folder = RobotFolder::parse(Path::new("my_hand"), &urdf, &text("controller.toml")).unwrap();
        let chain = &folder.model.chains[0];
        assert_eq!(chain.name, expected);
        let distance = nalgebra::Vector3::from(chain.tip.translation).norm();
        assert!((0.02..0.1).contains(&distance), "{name}: {distance}");
    }
}

#[test]
fn what_a_controller_cannot_drive_is_told() {
    let branch = "<joint name=\"spread\" type=\"revolute\"><parent link=\"finger1_knuckle\"/><child link=\"flap\"/>\
        <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint><link name=\"flap\"/></robot>";
    let follower = "<joint name=\"last\" type=\"revolute\"><parent link=\"finger1_tip\"/><child link=\"end\"/>\
        <mimic joint=\"spread\"/><axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>\
        </joint><link name=\"end\"/>";
    for (from, to, expected) in [
        (
            "</robot>",
            &*format!("{follower}{branch}"),
            "last mimics spread, which has a motor, but is on a branch that is not on this board",
        ),
        ("</robot>", branch, "branches behind joint finger1_swing into finger1_bend and spread"),
        ("type=\"revolute\"", "type=\"continuous\"", "finger1_swing is of type continuous; a"),
        (
            "name=\"hand3\"",
            "name=\"a_robot_with_a_name_that_is_too_long\"",
            "36 bytes; at most 32 are supported",
        ),
        ("name=\"hand3\"", "name=\"\"", "the robot has no name"),
    ] {
        let said = error("robot.urdf", from, to);
        assert!(said.contains(expected), "{said}");
    }
}

/// The findings about the five-finger hand with a text of its URDF replaced.
fn findings_of_hand5(from: &str, to: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    assert!(urdf.contains(from), "{from}");
    let (_, findings) = RobotFolder::check(&path, &urdf.replacen(from, to, 1), &settings);
    findings.iter().map(|finding| format!("{finding}\n")).collect()
}

#[test]
fn a_urdf_that_is_cut_in_half_is_one_error() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/inspire");
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    let (_, findings) = RobotFolder::check(&path, &urdf[..urdf.len() / 2], &settings);
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert!(said.len() == 2 && said[0].contains("malformed XML"), "{said:?}");
    assert!(findings[0].is_error() && !findings[1].is_error() && said[1].contains("not checked"), "{said:?}");
}

#[test]
fn a_mimic_joint_beyond_what_a_chain_can_have_is_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7");
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    let fixed = "<joint name=\"force_sensor\" type=\"fixed\">";
    let follows = "<joint name=\"force_sensor\" type=\"revolute\"><axis xyz=\"0 1 0\"/><mimic joint=\"elbow\"/>\
                   <limit lower=\"-3\" upper=\"3\" effort=\"1\" velocity=\"1\"/>";
    assert!(urdf.contains(fixed) && urdf.contains("<joint name=\"elbow\""));
    let (_, findings) = RobotFolder::check(&path, &urdf.replacen(fixed, follows, 1), &settings);
    let said: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
    assert!(said.contains("8 joints"), "{said}");
}

#[test]
fn one_motor_of_the_five_finger_hand_moves_joints_of_four_chains() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let model = RobotFolder::load(&path).unwrap().model;
    assert_eq!(model.joints.len(), 16);
    let chains: Vec<_> = model.chains.iter().map(|chain| (chain.name.as_str(), chain.joints)).collect();
    let names = ["thumb_tip", "index_tip", "middle_tip", "ring_tip", "little_tip"];
    assert_eq!(chains, names.into_iter().zip([5, 4, 3, 2, 2]).collect::<Vec<_>>());
    let mimics: Vec<_> =
        model.mimics.iter().map(|mimic| (mimic.chain, mimic.place, mimic.joint, mimic.multiplier)).collect();
    assert_eq!(mimics, [(2, 0, 5, 0.3), (3, 0, 5, -0.4), (4, 0, 5, -1.0)]);
    assert_eq!(model.joint_name(5), "spread");
    // The motor overcomes the friction of all: 8 mN·m and 4 mN·m times 0.3 + 0.4 + 1.
    assert!((model.joints[5].friction.coulomb - 0.0148).abs() < 1e-6);
    // Each finger that follows adds to the inertia of the motor with the square of its ratio.
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    let inertia = |ratio: &str| {
        let urdf = urdf.replacen("multiplier=\"0.3\"", &format!("multiplier=\"{ratio}\""), 1);
        RobotFolder::parse(&path, &urdf, &settings).unwrap().model.joints[5].servo.observer.inertia
    };
    let (full, less, least) = (inertia("0.3"), inertia("0.2"), inertia("0.1"));
    assert!(full > less && less > least);
    assert!(((full - least) / (full - less) - 0.08 / 0.05).abs() < 0.01, "{full} {less} {least}");
}

/// `tests/oracles/hand5_spread.py`: inertia held, free; torque of gravity.
const SPREAD: [f64; 3] = include!("../../tests/oracles/data/hand5_spread.in");

#[test]
fn a_motor_is_planned_for_the_fingers_of_other_chains_that_follow_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let (urdf, _) = RobotFolder::read(&path).unwrap();
    let texts = robot_texts(&path.join("robot.urdf"), &urdf, &InitOptions::default()).unwrap();
    let spread = &texts.controller[texts.controller.find("# spread: ").unwrap()..];
    let spread = &spread[..spread.find("# index_bend: ").unwrap()];
    let [held, free, gravity] = SPREAD;
    let told = format!("geometric mean of {free:.6} (other joints free) and {held:.6} (held)");
    assert!(spread.contains(&told), "{told}: {spread}");
    assert!(spread.contains(&format!("Gravity takes up to {gravity:.3} N·m of 0.800 N·m.")), "{spread}");
}

/// The first two joints of a SCARA. Both servos with 20 rad/s have an eigenvalue of 1.024 in the straight
/// posture, with 10 and 20 rad/s of 0.979 (`tests/oracles/coupled_servos.py`).
#[test]
fn servos_of_joints_that_carry_each_other_are_slowed() {
    let bandwidths = |outer_mass: f32| -> Vec<f32> {
        let arm = |index: u8, parent: &str, place: f32, effort: u8, inertial: &str| {
            format!(
                r#"<joint name="j{index}" type="revolute"><parent link="{parent}"/><child link="l{index}"/>
                <origin xyz="{place} 0 0"/><axis xyz="0 0 1"/><dynamics friction="0.05" damping="0.01"/>
                <limit lower="-2.3" upper="2.3" velocity="6" effort="{effort}"/></joint>
                <link name="l{index}"><inertial>{inertial}</inertial></link>"#
            )
        };
        let inertial = |center: f32, mass: f32, inertia: f32| {
            format!(
                r#"<origin xyz="{center} 0 0"/><mass value="{mass}"/>
                <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>"#
            )
        };
        let urdf = format!(
            r#"<robot name="scara"><link name="base"/>{}{}
            <link name="tool"/><joint name="end" type="fixed"><parent link="l2"/><child link="tool"/>
            <origin xyz="0.2 0 0"/></joint></robot>"#,
            arm(1, "base", 0.0, 40, &inertial(0.1, 3.0, 0.02)),
            arm(2, "l1", 0.25, 20, &inertial(0.1231, outer_mass, 0.0157 * outer_mass / 2.6)),
        );
        let texts = robot_texts(Path::new("scara.urdf"), &urdf, &InitOptions::default()).unwrap();
        let (_, rest) = texts.controller.split_once("j1").unwrap();
        let values = rest.lines().filter_map(|line| line.strip_prefix("bandwidth = "));
        values.map(|value| value.split_whitespace().next().unwrap().parse().unwrap()).collect()
    };
    assert_eq!(bandwidths(2.6), [10.0, 20.0]);
    assert_eq!(bandwidths(0.3), [20.0, 20.0]);
}

#[test]
fn weight_in_another_chain_that_a_motor_must_lift_is_told() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand5");
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    // 1 kg at 1 m behind the joint that follows with the ratio −1, in a hand that stands upright: 9.81 sin
    // 0.35 N·m = 3.364 N·m, and 0.011 N·m for the fingers.
    let root = urdf.find("<link name=\"little_root\">").unwrap();
    let (before, behind) = urdf.split_at(root);
    let heavy = "<origin xyz=\"0 0 1\"/><mass value=\"1\"/>";
    let urdf = before.to_owned() + &behind.replacen("<mass value=\"0.012\"/>", heavy, 1);
    let upright = settings.replace("gravity = [9.81, 0.0, 0.0]", "gravity = [0.0, 0.0, -9.81]");
    let said = |settings: &str| {
        let (_, findings) = RobotFolder::check_all(&path, &urdf, settings, None);
        findings.iter().map(|finding| format!("{finding}\n")).collect::<String>()
    };
    let told = said(&upright);
    assert!(told.contains("joint spread: gravity needs up to 3.37"), "{told}");
    assert!(!said(&settings).contains("joint spread: gravity"), "the axis of the joint is vertical");
}

#[test]
fn a_mimic_joint_that_no_motor_can_move_is_told_by_line() {
    let middle = "<mimic joint=\"spread\" multiplier=\"0.3\"/>";
    let said = |to: &str| findings_of_hand5(middle, to);
    let unknown = said("<mimic joint=\"sprad\"/>");
    assert!(unknown.contains("joint middle_spread mimics \"sprad\", which does not exist"), "{unknown}");
    // Through another mimic joint, whose multiplier is −0.4.
    let chained = said("<mimic joint=\"ring_spread\" multiplier=\"2\"/>");
    assert!(chained.contains("joint middle_spread moves from -0.28 to 0.12"), "{chained}");
    // From −0.0453 to 0.1057 rad; its own limits are −0.045 and 0.105 rad.
    let rounded = said("<mimic joint=\"spread\" multiplier=\"0.302\"/>");
    assert!(!rounded.contains("joint middle_spread moves"), "{rounded}");
    let wide = said("<mimic joint=\"spread\" multiplier=\"0.6\"/>");
    assert!(
        wide.contains("joint middle_spread moves from -0.09 to 0.21") && wide.contains("robot.urdf:"),
        "{wide}"
    );
    let alone =
        findings_of_hand5("<axis xyz=\"-1 0 0\"/>", "<axis xyz=\"-1 0 0\"/><mimic joint=\"ring_bend\"/>");
    assert!(alone.contains("moves from -0.2 to 1.6 rad while ring_bend keeps its limits"), "{alone}");
}

#[test]
fn a_joint_in_a_finger_follows_the_one_before_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/inspire");
    let (urdf, settings) = RobotFolder::read(&path).unwrap();
    // With the inertias that follow from the masses.
    let computed: Vec<&str> = settings.lines().filter(|line| !line.starts_with("inertia = ")).collect();
    let model = RobotFolder::parse(&path, &urdf, &computed.join("\n")).unwrap().model;
    let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names.len(), 6, "{names:?}");
    let mimics: Vec<_> =
        model.mimics.iter().map(|mimic| (mimic.chain, mimic.place, mimic.joint, mimic.multiplier)).collect();
    let of_fingers = (1..5).map(|chain| (chain, 1, chain + 1, 1.0));
    assert_eq!(mimics, [(0, 2, 1, 1.6), (0, 3, 1, 2.4)].into_iter().chain(of_fingers).collect::<Vec<_>>());
    // What the motor of a finger feels: M₁₁ + 2 M₁₂ + M₂₂ with both joints in the middle of their ranges, and
    // its rotor.
    let (joint, middle) =
        (&model.joints[2], 0.5 * (model.joints[2].limits.lower + model.joints[2].limits.upper));
    let matrix = Chain::of_model(&model, 1).mass_matrix(&[middle, middle]);
    let expected = matrix[(0, 0)] + 2.0 * matrix[(0, 1)] + matrix[(1, 1)] + joint.motor.rotor_inertia;
    let inertia = joint.servo.observer.inertia;
    assert!((inertia / expected - 1.0).abs() < 1e-5, "{inertia} {expected}");
    // A chain for a board of its own keeps its mimic joint.
    let alone = chain_model(&model, 1).unwrap();
    assert_eq!((alone.joints.len(), alone.mimics[0].chain, alone.mimics[0].joint), (1, 0, 0));
    assert!(alone.validate().is_ok());
}

/// The section of docs/bring-your-own-hand.md at an arm, which has one tip, and at a hand.
#[test]
fn the_gauges_of_the_page_become_those_of_the_model_and_wrong_ones_are_named() {
    const PAGE: &str = include_str!("../../docs/bring-your-own-hand.md");
    let section = PAGE.split("### A force sensor with strain gauges").nth(1).unwrap();
    let section = section.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    let with = |robot: &str, section: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(robot);
        let (urdf, settings) = RobotFolder::read(&path).unwrap();
        let begin = settings.find("[force_sensor]").unwrap();
        let length = settings[begin + 1..].find("\n[").unwrap() + 1;
        let settings = settings[..begin].to_owned() + section + &settings[begin + length..];
        RobotFolder::parse(&path, &urdf, &settings)
    };
    let model = with("arm7", section).unwrap().model;
    let gauges = model.gauges.unwrap();
    assert_eq!((gauges.chain, gauges.gains), (0, [128; 6]));
    assert_eq!((gauges.calibration_matrix[0][5], gauges.calibration_matrix[5][0]), (6.93e-6, -3.68e-9));
    assert_eq!(chain_model(&model, 0).unwrap().gauges, model.gauges);
    let error = |robot: &str, from: &str, to: &str| {
        assert!(section.contains(from), "{from}");
        with(robot, &section.replacen(from, to, 1)).map(|_| ()).unwrap_err().to_string()
    };
    for (robot, from, to, expected) in [
        ("hand3", "", "", "force_sensor.gauges: one calibration matrix for 3 tips"),
        ("arm7", "[128, 128", "[100, 128", "force_sensor.gauges.gains = 100 is not supported"),
        ("arm7", "[128, 128", "[128", "invalid length 5"),
        (
            "arm7",
            "[5.32e-7, 6.40e-6, 5.75e-7, -3.53e-6, -7.63e-8, -3.86e-6]",
            "[-1.26e-7, 4.82e-7, -2.52e-7, -5.00e-6, 2.67e-7, 6.93e-6]",
            "does not depend on the others",
        ),
        ("arm7", "force_limit = 10.0", "force_limit = 300.0", "range of force_sensor.gauges"),
        ("arm7", "gains =", "gain =", "gain"),
    ] {
        let told = error(robot, from, to);
        assert!(told.contains(expected) && told.contains("controller.toml"), "{told}");
    }
}

/// The findings for hand3 with `from` replaced by `to` wherever it stands in the file `name`.
fn findings(name: &str, from: &str, to: &str) -> Vec<String> {
    let change = |file: &str| {
        let text = text(file);
        assert!(file != name || text.contains(from), "{from:?} is not in {name}");
        if file == name { text.replace(from, to) } else { text }
    };
    let [urdf, settings, plant] = ["robot.urdf", "controller.toml", "plant.toml"].map(change);
    let (_, findings) = RobotFolder::check_all(Path::new("my_hand"), &urdf, &settings, Some(&plant));
    findings.iter().map(ToString::to_string).collect()
}

#[test]
fn the_sensors_of_plant_and_controller_are_the_same() {
    for (from, to, words) in [
        (
            "force_count = 0.001",
            "force_count = 0.01",
            "force_count = 0.01 N; force_sensor.force_resolution of",
        ),
        (
            "torque_count = 1e-5",
            "torque_count = 1e-3",
            "torque_count = 0.001 N·m; force_sensor.torque_resolution of",
        ),
        ("force_range = 20.0", "force_range = 5.0", "force_range = 5 N is below force_sensor.force_limit of"),
        (
            "gain_error = 0.01",
            "gain_error = 1.0",
            "force_sensor.gain_error is 1: it must be from 0 to below 1",
        ),
        (
            "force_offset = 1.0",
            "force_offset = 50.0",
            "force_sensor.force_offset is 50: it must be below force_range",
        ),
        (
            "torque_offset = 0.01",
            "torque_offset = 0.5",
            "torque_offset is 0.5: it must be below torque_range",
        ),
    ] {
        let [said] = &findings("plant.toml", from, to)[..] else { panic!("{to}") };
        assert!(said.contains(words) && said.contains("plant.toml:"), "{said}");
    }
}

#[test]
fn a_wrong_value_of_the_sensor_is_of_no_joint_and_nothing_follows_from_it() {
    for (from, to, words) in [
        (
            "force_limit = 10.0",
            "force_limit = 0.0",
            "force_sensor.force_limit = 0 N must be above 0 N; mend the value",
        ),
        (
            "force_resolution = 1e-3",
            "force_resolution = 0.0",
            "force_resolution = 0 N must be above 0 N; mend the value",
        ),
        (
            "force_resolution = 1e-3",
            "force_resolution = -1e-3",
            "force_resolution = -0.001 N must be above 0 N",
        ),
        ("counts_per_turn = 65536.0", "counts_per_turn = 0.0", "encoder.counts_per_turn = 0 is below 1"),
        ("torque_rate = 60.0", "torque_rate = 0.0", "limits.torque_rate = 0 N·m/s must be above 0"),
    ] {
        let [said] = &findings("controller.toml", from, to)[..] else {
            panic!("{:?}", findings("controller.toml", from, to))
        };
        assert!(said.contains(words), "{said}");
        let of_sensor = words.contains("force_");
        assert_ne!(of_sensor, said.contains("joint") || said.contains("[joints.NAME]"), "{said}");
    }
}

#[test]
fn a_tip_is_round_in_metres_and_not_below_nothing() {
    let radius = "<sphere radius=\"0.008\"/>";
    let said = findings("robot.urdf", radius, "<sphere radius=\"-0.01\"/>");
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(said[0].contains("link finger1_tip: <sphere> has a radius of -0.01 m, below 0"), "{said:?}");
    let said = findings("robot.urdf", radius, "<sphere radius=\"10\"/>");
    assert_eq!(said.len(), 3, "{said:?}");
    assert!(said[0].contains("link finger1_tip: its <sphere> has a radius of 10 m"), "{said:?}");
    assert!(said[0].contains("millimetres?; lengths are in m: 10 mm are 0.01"), "{said:?}");
}

#[test]
fn a_key_that_is_there_twice_is_named_with_its_table() {
    let said = error("controller.toml", "[joint.motor]", "[joint.motor]\ndelay = 0.001\ndelay = 0.002");
    let words = "the key delay is there twice in [joint.motor]; remove one of the two";
    assert!(said.contains(words) && said.lines().count() == 1, "{said}");
}
