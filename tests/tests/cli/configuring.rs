//! The robot model on the board, and its parameters.

use std::path::PathBuf;

use super::server::{Server, arm7, hand3};

/// A copy of hand3 whose URDF and settings are changed, in the server's folder.
fn changed(server: &Server, change: impl Fn(String) -> String) -> PathBuf {
    let robot = server.folder.path().join("robot");
    std::fs::create_dir(&robot).unwrap();
    for file in ["robot.urdf", "controller.toml"] {
        let (text, copy) = (std::fs::read_to_string(hand3().join(file)).unwrap(), robot.join(file));
        std::fs::write(copy, change(text)).unwrap();
    }
    robot
}

#[test]
fn a_board_of_one_finger_gets_its_own_model() {
    let server = Server::start();
    let robot = hand3();
    let robot = robot.to_str().unwrap();
    server.fails(&["model", "push", robot, "--chain", "thumb"], 2, &["no tip \"thumb\"", "finger3_tip"]);
    let pushed = server.succeeds(&["model", "push", robot, "--chain", "finger2_tip"]);
    assert!(pushed.contains("hand3.finger2_tip: 3 joints"), "{pushed}");
    let model = server.json(&["model", "show"]);
    assert_eq!(model["joints"][0]["name"], "finger2_swing");
    assert_eq!(model["chains"].as_array().unwrap().len(), 1);
}

#[test]
fn parameters_are_read_changed_and_refused_by_name() {
    let server = Server::ready();
    assert!(server.succeeds(&["read", "safety.command_timeout"]).contains("safety.command_timeout = 1.0 s"));
    server.succeeds(&["set", "safety.reaction", "off"]);
    assert!(server.succeeds(&["read", "safety"]).contains("safety.reaction = \"off\""));
    server.succeeds(&["set", "joints.*.limits.velocity", "4.5"]);
    assert!(server.succeeds(&["read", "joints.finger3_curl.limits"]).contains("limits.velocity = 4.5"));
    server.fails(&["set", "safety.damping", "-1"], 2, &["safety.damping", "-1"]);
    server.fails(&["set", "safety.reaction", "sleep"], 2, &["`sleep`", "`off`, `damp`, `hold`"]);
    server.fails(
        &["set", "safety.colour", "red"],
        2,
        &["no parameter \"colour\" in safety", "command_timeout"],
    );
    server.fails(&["set", "colour", "red"], 2, &["no parameter \"colour\"; the groups", "safety"]);
    let members = server.succeeds(&["read", "joints."]);
    assert!(members.contains("\njoints.finger3_curl.limits.velocity = 4.5"), "{members}");
    let words = "model is a group of parameters: `tesaki read model` lists them";
    server.fails(&["set", "", "3"], 2, &[words]);
    server.fails(&["read", "joints.finger9_curl"], 2, &["no parameter \"finger9_curl\" in joints"]);
    server.fails(&["set", "safety", "1"], 2, &["is a group"]);
    // 65 536 counts a turn: two of them in 10 ms are 0.0192 rad/s.
    let noise = ["less than two counts of the encoder in a tick", "give 0.0192 rad/s or more"];
    server.fails(&["set", "joints.finger1_swing.limits.velocity", "0.019"], 2, &noise);
    let fast =
        ["Coulomb friction 0.7 N·m is not below the motor's torque 0.600 N·m", "give the true friction"];
    server.fails(&["set", "joints.finger1_bend.friction.coulomb", "0.7"], 2, &fast);
    // The end stops are mechanical.
    let upper = "joints.finger1_swing.limits.upper";
    server.fails(&["set", upper, "1.5"], 2, &[upper, "1.5 is beyond", "-1 to 1 rad"]);
    assert!(!server.succeeds(&["set", upper, "0.9"]).contains("tare"));
    server.succeeds(&["tare"]);
    assert!(server.succeeds(&["set", upper, "0.8"]).contains("finger3_tip must be tared anew"));
    // Homed joints stay homed, because their encoders have not changed.
    server.succeeds(&["move", "finger1_swing=0.02"]);
    assert_eq!(server.json(&["model", "show"])["safety"]["reaction"], "Off");
    let damping = "safety.damping = -1 N·m·s/rad is below 0 N·m·s/rad";
    server.fails(&["set", "safety.damping", "-1"], 2, &[damping]);
    server.fails(
        &["set", "safety.supply_min", "30"],
        2,
        &["safety.supply_min = 30 V must be below safety.supply_max, 28 V"],
    );
    for empty in ["", " ", "\"\""] {
        server.fails(&["set", "name", empty], 2, &["name is empty: give a name"]);
    }
    server.succeeds(&["set", "name", "foo"]);
    assert!(server.succeeds(&["read", "name"]).contains("name = \"foo\""));
    // Another zero: nobody knows where the joint is.
    let set = server.json(&["set", "joints.finger1_swing.encoder.zero", "10"]);
    assert_eq!(set["no_longer_homed"], serde_json::json!(["finger1_swing"]));
    let state = server.succeeds(&["read"]);
    let line = state.lines().find(|line| line.starts_with("finger1_swing")).unwrap();
    assert!(line.contains(" – ") && line.ends_with("not homed"), "{line}");
    // A push says what it undoes, as `set` does, and so does homing.
    server.succeeds(&["home", "--others", "0"]);
    server.succeeds(&["tare"]);
    let pushed = server.json(&["model", "push", hand3().to_str().unwrap()]);
    let tips = serde_json::json!(["finger1_tip", "finger2_tip", "finger3_tip"]);
    assert_eq!(pushed["no_longer_tared"], tips);
    assert_eq!(pushed["no_longer_homed"], serde_json::json!(["finger1_swing"]));
    server.succeeds(&["home", "--others", "0"]);
    server.succeeds(&["tare"]);
    assert_eq!(server.json(&["home", "--others", "0"])["no_longer_tared"], tips);
    // As `read` and the files have it.
    server.succeeds(&["set", "safety.reaction", "\"damp\""]);
    assert_eq!(server.json(&["model", "show"])["safety"]["reaction"], "Damp");
}

#[test]
fn a_share_of_each_value_is_set_and_what_would_be_a_fault_at_once_is_told() {
    let server = Server::ready();
    let set = server.json(&["set", "joints.*.limits.torque", "30%"]);
    let values = set["values"].as_array().unwrap();
    // Of 0.6 N·m.
    assert!(values.len() == 9 && values.iter().all(|value| value == 0.18), "{set}");
    let text = server.succeeds(&["set", "joints.finger1_bend.limits.torque", "50 %"]);
    assert!(text.contains("joints.finger1_bend.limits.torque = 0.09 N·m (until"), "{text}");
    let fault = ["the supply is 2", " V, outside 20 to 22 V: a fault at once"];
    server.fails(&["set", "safety.supply_max", "22"], 2, &fault);
    // It stands at 0.33 rad; 0.25 rad beyond a limit are no fault yet.
    server.succeeds(&["set", "joints.finger1_bend.limits.upper", "0.2"]);
    server.succeeds(&["doctor"]);
    let set = server.json(&["set", "joints.finger1_bend.limits.upper", "0.05"]);
    let stands = "finger1_bend stands at 0.33";
    assert!(set["warnings"][0].as_str().unwrap().starts_with(stands), "{set}");
    server.fails(&["doctor"], 1, &[stands, "outside its limits -1.2 to 0.05 rad", "1 problem found"]);
}

/// What is counted from an unknown zero is no angle.
#[test]
fn unknown_angles_are_null_in_json() {
    let server = Server::start();
    server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    let state = server.json(&["read"]);
    let (joint, tip) = (&state["joints"][0], &state["tips"]["finger1_tip"]);
    assert!(
        joint["homed"] == false && joint["position"].is_null() && joint["reference"].is_null(),
        "{joint}"
    );
    assert!(tip["position"].is_null() && tip["force"].is_array(), "{tip}");
    server.home();
    let state = server.json(&["read"]);
    let (joint, tip) = (&state["joints"][0], &state["tips"]["finger1_tip"]);
    assert!(joint["homed"] == true && joint["position"].is_number(), "{joint}");
    assert!(tip["position"].is_array(), "{tip}");
}

#[test]
fn what_model_check_calls_bad_does_not_reach_the_board() {
    let server = Server::start();
    let robot = changed(&server, |text| text.replacen("friction=\"0.02\"", "friction=\"0.7\"", 1));
    let fast = "joint finger1_swing: Coulomb friction 0.7 N·m is not below the motor's torque 0.600 N·m";
    server.fails(&["model", "push", robot.to_str().unwrap()], 1, &[fast]);
    let calibration = server.folder.path().join("calibration.toml");
    std::fs::write(&calibration, "[joints.finger1_swing]\ncoulomb = 0.65\n").unwrap();
    let (hand, calibration) = (hand3(), calibration.to_str().unwrap());
    let arguments = ["model", "push", hand.to_str().unwrap(), "--calibration", calibration];
    server.fails(
        &arguments,
        1,
        &["calibration.toml", "finger1_swing: Coulomb friction 0.65 N·m is not below"],
    );
    server.fails(&["read", "safety"], 7, &["no robot model"]);
    // What may be right is told.
    std::fs::write(calibration, "[joints.finger1_swing]\ntorque_constant = 0.1\n").unwrap();
    let (code, told) = server.run(&arguments);
    assert!(code == 0 && told.contains("finger1_swing: torque_constant = 0.1 N·m/A is far from"), "{told}");
}

/// Not taken for an option that does not exist.
#[test]
fn a_negative_number_is_refused_in_words() {
    let server = Server::start();
    let table = hand3().join("controller.toml");
    let camera =
        ["calibrate", "camera", "--robot", "robots", "--in", table.to_str().unwrap(), "--rose", "-1"];
    let cases: [(&[&str], i32, &str); 6] = [
        (&["identify", "--joints", "--torque", "-1"], 2, "expected a fraction of the torque limit"),
        (&["identify", "--joints", "--amplitude", "-1"], 2, "expected an amplitude from 0.03 to 0.5 rad"),
        (&["calibrate", "postures.csv", "--marker-noise", "-1"], 2, "-1"),
        (&["calibrate", "postures.csv", "--orientation-noise", "-1"], 2, "-1"),
        (&["retarget", "--live", "--bandwidth", "-1"], 2, "-1"),
        (&camera, 1, "robots"),
    ];
    for (arguments, code, words) in cases {
        let (got, text) = server.run(arguments);
        assert!(got == code && text.contains(words) && !text.contains("unexpected argument"), "{got} {text}");
    }
}

#[test]
fn the_model_of_another_machine_is_told_at_its_push() {
    let server = Server::start();
    let arm = arm7().to_str().unwrap().to_owned();
    let text = server.succeeds(&["model", "push", &arm]);
    let mismatch = "the machine has 9 joints and 3 force sensors, its model arm7 has 7 joints and 1 force sensor (fault 8)";
    assert!(text.contains(&format!("warning: {mismatch}: push the model of this machine")), "{text}");
    assert!(!text.contains("replaces"), "{text}");
    let pushed = server.json(&["model", "push", &arm]);
    assert_eq!((&pushed["replaced"], &pushed["mismatch"]), (&serde_json::Value::Null, &mismatch.into()));
    let text = server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
    assert!(text.contains("the board has the model of arm7: that of hand3 replaces it"), "{text}");
    assert!(!text.contains("warning"), "{text}");
}

#[test]
fn a_robot_of_another_kind_need_not_be_homed_to_be_told_so() {
    let server = Server::start();
    let robot = hand3().join("../allegro");
    server.succeeds(&["model", "push", robot.to_str().unwrap()]);
    let tip = server.json(&["model", "show"])["chains"][0]["name"].as_str().unwrap().to_owned();
    let told = ["`tesaki reach` needs fingers of three joints; ", " has 4. Use `tesaki eval ik`"];
    server.fails(&["reach", &format!("{tip}=0,0,0.1")], 2, &told);
    let grasp = hand3().join("grasps/box.toml");
    let told = ["allegro_hand_right is not a hand for grasping", "has 4 joints; `tesaki move` moves"];
    server.fails(&["grasp", "run", grasp.to_str().unwrap()], 2, &told);
}

#[test]
fn what_is_doubtful_is_set_with_a_warning() {
    let server = Server::ready_arm();
    for value in ["0,0,9.81", "-9.81"] {
        let list = ["gravity is a list in m/s²: write it in brackets", "\"[0.0,0.0,-9.81]\""];
        server.fails(&["set", "gravity", value], 2, &list);
    }
    let name = server.json(&["model", "show"])["joints"][3]["name"].as_str().unwrap().to_owned();
    let text = server.succeeds(&["set", &format!("joints.{name}.link.mass"), "40"]);
    assert!(text.contains("warning: ") && text.contains("gravity needs up to"), "{text}");
    let text = server.succeeds(&["set", "gravity", "[0,0,9.81]"]);
    assert!(text.contains("upside down"), "{text}");
    // 6 N·m/A times 11 A.
    let torque = format!(
        "joints.{}.limits.torque",
        server.json(&["model", "show"])["joints"][0]["name"].as_str().unwrap()
    );
    assert!(!server.succeeds(&["set", &torque, "65"]).contains("warning"));
    let text = server.succeeds(&["set", &torque, "67"]);
    assert!(text.contains("limits nothing") && text.contains("at most 66.000 N·m"), "{text}");
    let inertia = torque.replace("limits.torque", "motor.rotor_inertia");
    let text = server.succeeds(&["set", &inertia, "20"]);
    assert!(text.contains("warning: ") && text.contains("s to bring the rotor alone to"), "{text}");
    // Each time that it is set, also to another value; not when something else is.
    for value in ["20", "30"] {
        let text = server.succeeds(&["set", &inertia, value]);
        assert!(text.contains("s to bring the rotor alone to"), "{value}: {text}");
    }
    let text = server.succeeds(&["set", &torque, "67"]);
    assert!(text.contains("limits nothing") && !text.contains("rotor"), "{text}");
    let text = server.succeeds(&["set", &torque, "1000"]);
    assert!(text.contains("limits nothing") && text.matches("warning").count() == 1, "{text}");
    let text = server.succeeds(&["set", "joints.*.limits.torque", "5%"]);
    assert!(text.contains("cannot be held everywhere") && !text.contains("check masses"), "{text}");
    // Under its name in controller.toml, too.
    let inertia = torque.replace("limits.torque", "servo.inertia");
    let read = server.succeeds(&["read", &inertia]);
    assert_eq!(read, server.succeeds(&["read", &inertia.replace("servo.", "servo.observer.")]));
    assert!(read.contains(".servo.observer.inertia = ") && read.trim_end().ends_with(" kg·m²"), "{read}");
    let told = ["is a value of controller.toml", "servo.observer.inertia and those gains"];
    server.fails(&["set", &inertia, "0.1"], 2, &told);
    let told = ["no parameter \"servo.inertia\"; did you mean joints.NAME.servo.observer.inertia?"];
    server.fails(&["read", "servo.inertia"], 2, &told);
    server.fails(&["set", "servo.inertia", "3"], 2, &told);
    let error = torque.replace("limits.torque", "servo.rest_error");
    server.fails(&["set", &error, "0.9"], 2, &["no error at rest is ever corrected; give some counts"]);
}

#[test]
fn angles_of_absolute_encoders_are_not_said_to_be_set() {
    let server = Server::start();
    let absolute = "\n[joints.finger1_swing.encoder]\nrelative = false\n";
    let robot = changed(&server, |text| if text.starts_with("<?xml") { text } else { text + absolute });
    server.succeeds(&["model", "push", robot.to_str().unwrap()]);
    let homed = &server.json(&["home", "finger1_bend=0.25", "--others", "0.5"])["homed"];
    assert_eq!((&homed["finger1_swing"], &homed["finger1_bend"]), (&serde_json::Value::Null, &0.25.into()));
    assert_eq!(homed.as_object().unwrap().len(), 8);
}

#[test]
fn names_with_points_are_addressed() {
    let server = Server::start();
    let robot = changed(&server, |text| text.replace("finger1_swing", "finger1.swing"));
    server.succeeds(&["model", "push", robot.to_str().unwrap()]);
    let limit = "joints.finger1.swing.limits.upper";
    server.succeeds(&["set", limit, "0.75"]);
    assert!(server.succeeds(&["read", limit]).contains("= 0.75"));
    assert!(server.succeeds(&["read", "joints.*.limits.upper"]).contains(&format!("{limit} = 0.75")));
    // The assumption about the other joints is reported.
    let homed = server.succeeds(&["home", "finger1.swing=0", "--others", "0"]);
    let warning = "must stand at 0 rad now";
    assert!(homed.contains("warning: finger1_bend, ") && homed.contains(warning), "{homed}");
}
