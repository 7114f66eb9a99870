//! The program as a user runs it.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn host_sim(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).args(arguments).output().unwrap()
}

fn says(output: &Output, code: i32, expected: &[&str]) {
    let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{text}");
    for word in expected {
        assert!(text.contains(word), "{word:?} is not in: {text}");
    }
}

#[test]
fn lists_its_scenarios() {
    let names =
        ["servo", "reach", "force", "weights", "turn", "shift", "grasp"].map(|name| format!("hand3-{name}"));
    let names: Vec<&str> = names.iter().map(String::as_str).chain(["cargo sim run"]).collect();
    says(&host_sim(&["list"]), 0, &names);
}

/// As in `host-sim list
/// head`, but the reader has certainly gone.
#[test]
fn a_reader_that_leaves_ends_it_quietly() {
    for arguments in [&["list"][..], &["faults", "--seeds", "2", "--json"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
        let output = command.args(arguments).stdout(writer).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), &*errors), (Some(0), ""), "{arguments:?}");
    }
}

#[test]
fn runs_the_joint_servo_within_its_limits_and_leaves_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let output = host_sim(&["run", "hand3-servo", "--seed", "1-2", "--json", "--out", out]);
    says(&output, 0, &[]);
    let text = String::from_utf8(output.stdout).unwrap();
    let runs: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(runs.len(), 2);
    for (run, seed) in runs.iter().zip(1..) {
        assert_eq!(
            (run["scenario"].as_str(), run["controller"].as_str()),
            (Some("hand3-servo"), Some("native"))
        );
        assert_eq!((run["seed"].as_u64(), run["pass"].as_bool()), (Some(seed), Some(true)));
        let limits = [
            ("pid_error_peak", 12.0),
            ("pid_error_settled", 2.5),
            ("observer_error_peak", 5.0),
            ("observer_error_settled", 1.0),
        ];
        for (name, limit) in limits {
            let metric = &run["metrics"][name];
            assert_eq!((metric["limit"].as_f64(), metric["unit"].as_str()), (Some(limit), Some("mrad")));
            // A servo that tracks better than the encoder's resolution would indicate a plant without
            // friction.
            assert!((0.05..=limit).contains(&metric["value"].as_f64().unwrap()), "{name}: {metric}");
        }
    }
    assert_ne!(runs[0]["metrics"], runs[1]["metrics"], "each seed is a machine of its own");
    let files = folder.path().join("hand3-servo");
    let page = std::fs::read_to_string(files.join("index.html")).unwrap();
    assert!(
        page.contains("<svg") && page.contains("cargo sim run hand3-servo --controller native --seed 1-2")
    );
    for svg in page.split("<svg").skip(1) {
        let svg = format!("<svg{}</svg>", svg.split("</svg>").next().unwrap());
        roxmltree::Document::parse(&svg).unwrap_or_else(|error| panic!("{error}"));
    }
    let csv = std::fs::read_to_string(files.join("observer.csv")).unwrap();
    assert!(csv.starts_with("time [s],finger1_swing reference [rad],finger1_swing true angle [rad]"));
    assert_eq!(csv.lines().count(), 1 + 1050);
    assert!(std::fs::metadata(files.join("frames.log")).unwrap().len() > 100_000);
    assert!(std::fs::metadata(files.join("recording.mcap")).unwrap().len() > 1_000_000);
    assert!(page.contains("href=\"recording.mcap\""));
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str| {
        let out = folder.path().join(name);
        says(
            &host_sim(&["run", "hand3-servo", "--duration", "32", "--json", "--out", out.to_str().unwrap()]),
            0,
            &[],
        );
        ["frames.log", "recording.mcap"]
            .map(|name| std::fs::read(out.join("hand3-servo").join(name)).unwrap())
    };
    assert!(run("first") == run("second"));
}

#[test]
fn a_robot_that_the_check_refuses_is_not_served() {
    let folder = tempfile::tempdir().unwrap();
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7");
    for name in ["robot.urdf", "controller.toml", "plant.toml"] {
        let text = std::fs::read_to_string(robot.join(name)).unwrap();
        let text = text.replacen("elbow = 1.57", "elbow = 9.57", 1);
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let serve = ["serve", "--robot", folder.path().to_str().unwrap()];
    let told = ["plant.toml:", "joint elbow: starts at 9.570796 rad, outside its limits"];
    says(&host_sim(&serve), 2, &told);
    std::fs::remove_file(folder.path().join("plant.toml")).unwrap();
    let told =
        ["cannot read", "plant.toml: No such file", "what is simulated; `tesaki model init` writes one"];
    says(&host_sim(&serve), 2, &told);
}

/// A copy of a robot's folder whose files are changed.
fn changed(robot: &str, folder: &Path, change: impl Fn(&str, String) -> String) {
    std::fs::create_dir_all(folder).unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(robot);
    for name in ["robot.urdf", "controller.toml", "plant.toml"] {
        let text = std::fs::read_to_string(source.join(name)).unwrap();
        std::fs::write(folder.join(name), change(name, text)).unwrap();
    }
}

#[test]
fn doubts_about_a_robot_are_told_when_it_is_served() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot");
    changed("hand3", &robot, |_, text| text.replace("rest_error = 7e-4", "rest_error = 0.06"));
    let listen = format!("unix://{}", folder.path().join("board").display());
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command.args(["serve", "--listen", &listen, "--robot"]).arg(&robot);
    let mut serve =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let told = BufReader::new(serve.stderr.take().unwrap()).lines().next().unwrap().unwrap();
    serve.kill().unwrap();
    serve.wait().unwrap();
    assert!(told.starts_with("warning: ") && told.contains("servo.rest_error = 0.06 rad"), "{told}");
}

#[test]
fn a_robot_of_another_kind_is_told_what_is_needed_and_what_takes_it() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, out) = (folder.path().join("robot"), folder.path().join("out"));
    let run = |scenario: &str| {
        host_sim(&["run", scenario, "--robot", robot.to_str().unwrap(), "--out", out.to_str().unwrap()])
    };
    // Without shoulder yaw.
    changed("arm7", &robot, |name, text| match name {
        "robot.urdf" => {
            let begin = text.find("<joint name=\"shoulder_yaw\"").unwrap();
            let end = begin + text[begin..].find("</joint>").unwrap();
            let fixed = text[begin..end].lines().filter(|line| {
                !["<axis", "<limit", "<dynamics"].iter().any(|element| line.trim().starts_with(element))
            });
            let fixed = fixed.collect::<Vec<_>>().join("\n").replace("revolute", "fixed");
            format!("{}{fixed}\n{}", &text[..begin], &text[end..])
        }
        "controller.toml" => {
            let sections = text.split("\n[").filter(|section| !section.starts_with("joints.shoulder_yaw"));
            sections.collect::<Vec<_>>().join("\n[")
        }
        _ => text,
    });
    let told = [
        "it leads the elbow, for which an arm needs seven joints; arm7 has 6",
        "Scenarios for such a robot: hand3-servo, arm7-paper, arm7-paper-bilateral, arm7-paper-matrices, \
         hand3-first-motion",
    ];
    says(&run("arm7-wall"), 2, &told);
    // Before the files that it lacks.
    says(&run("hand3-grasp"), 2, &["arm7 is not a hand for grasping", "but hand has 6 joints"]);
    says(&run("knob-grasp"), 2, &["it needs an arm of six joints with a gripper"]);
    changed("hand3", &robot, |_, text| text);
    std::fs::create_dir(robot.join("grasps")).unwrap();
    std::fs::write(robot.join("grasps/box.toml"), "").unwrap();
    let told = [
        "has no grasps/cylinder.toml, grasps/wedge.toml, objects/box.toml, objects/cylinder.toml, objects/wedge.toml:",
        "hand3-grasp needs robot.urdf, controller.toml, plant.toml, grasps/box.toml, grasps/cylinder.toml",
        "robots/hand3 has all of them",
    ];
    says(&run("hand3-grasp"), 2, &told);
}

#[test]
fn an_arm_with_relative_encoders_is_homed() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, out) = (folder.path().join("robot"), folder.path().join("out"));
    changed("arm7", &robot, |_, text| text.replace("relative = false", "relative = true"));
    let output =
        host_sim(&["run", "arm7-elbow", "--robot", robot.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    says(&output, 0, &["limits met"]);
}

#[test]
fn bad_input_is_answered_with_what_to_do() {
    let none = ["<SCENARIO>", "name a scenario, such as hand3-servo; `cargo sim list` shows all"];
    says(&host_sim(&["run"]), 2, &none);
    says(&host_sim(&["limits"]), 2, &none);
    let typo = ["no scenario \"hand3-sevo\"; did you mean hand3-servo? `cargo sim list` shows all"];
    says(&host_sim(&["run", "hand3-sevo"]), 2, &typo);
    says(&host_sim(&["run", "x"]), 2, &["no scenario \"x\". `cargo sim list` shows all"]);
    says(&host_sim(&["run"]), 2, &["Usage: cargo sim run"]);
    says(&host_sim(&["limits", "hand3-servo", "--robot", "/nowhere"]), 2, &["/nowhere/robot.urdf"]);
    says(&host_sim(&["limits", "arm7-wall"]), 0, &["seed 1: not computed for arm7-wall"]);
    let knob_arm = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/knob-arm");
    says(
        &host_sim(&["run", "arm7-straight", "--robot", knob_arm]),
        2,
        &["knob-arm is not a robot for this scenario: it needs an arm"],
    );
    let nowhere = r#"{"seed":1,"scenario":"hand3-sevo","robot":"hand3","trial":0,"end":10,"faults":[]}"#;
    says(&host_sim(&["faults", "--schedule", nowhere]), 2, &["no scenario \"hand3-sevo\": `cargo sim list`"]);
    // What acts on nothing is not safe.
    let schedule = |robot: &str, trial: u32, fault: &str| {
        format!(
            r#"{{"seed":1,"scenario":"hand3-servo","robot":"{robot}","trial":{trial},"end":30,"faults":[{fault}]}}"#
        )
    };
    let cut = r#"{"kind":"cut","begin":10}"#;
    for (text, words) in [
        (schedule("hand3", 50, cut), "nothing was judged in hand3-servo: there is no trial 50"),
        (schedule("arm7", 0, cut), "its robot is hand3, not arm7"),
        (schedule("hand3", 0, r#"{"kind":"stuck","joint":99,"begin":10}"#), "joint 99 of hand3, which has 9"),
        (schedule("hand3", 0, r#"{"kind":"cut","begin":40}"#), "a fault begins in tick 40, and the run ends"),
        (
            schedule(
                "hand3",
                0,
                r#"{"kind":"wall","direction":[0,0,1],"clearance":0.01,"stiffness":1e9,"begin":9}"#,
            ),
            "stiffness",
        ),
    ] {
        says(&host_sim(&["faults", "--no-shrink", "--schedule", &text]), 2, &[words]);
    }
    says(
        &host_sim(&["faults", "--schedule", "file"]),
        2,
        &["--schedule: expected", "give the JSON text itself"],
    );
    says(
        &host_sim(&["render-knob", "--distance", "-1"]),
        2,
        &["--distance is -1 m: it must be from 0.01 to 1 m"],
    );
    says(&host_sim(&["run", "hand3-servo", "--duration", "-5"]), 2, &["--duration -5 is too short"]);
    for (seeds, said) in
        [("x", "is not a seed"), ("-1", "\"-1\" is not a seed"), ("1-99999999999", "at most 100000 seeds")]
    {
        says(&host_sim(&["run", "hand3-servo", "--seed", seeds]), 2, &[said]);
    }
    says(
        &host_sim(&["run", "hand3-servo", "--duration", "3"]),
        2,
        &["--duration 3 is too short", "at least"],
    );
    says(
        &host_sim(&["run", "hand3-servo", "--robot", "/nowhere"]),
        2,
        &["/nowhere/robot.urdf", "a robot folder holds"],
    );
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = format!("--view={}", taken.local_addr().unwrap());
    for (arguments, told) in [
        (&["--view", "--seed", "1-20"][..], "not of the seeds 1-20: give one, as in --seed 1"),
        (&["--view", "--json"], "cannot be used with"),
        (&["--view=0.0.0.0:7481"], "ssh -L 7481:localhost:7481"),
        (&["--view=7481"], "expected HOST:PORT, such as localhost:7481"),
        // Nothing moves, so there is nothing to show.
        (&["--view=localhost:0", "--duration", "3"], "--duration 3 is too short"),
        (&["--duration", "inf"], "--duration inf is too long: hand3-servo runs at most 600 s"),
        (&["--duration", "NaN"], "--duration NaN is too short"),
        (&[taken.as_str()], "choose another port, as in --view="),
    ] {
        says(&host_sim(&[&["run", "hand3-servo"], arguments].concat()), 2, &[told]);
    }
    for duration in ["60", "5", "inf"] {
        let told =
            format!("--duration {duration}: the time of hand3-turn is fixed, 20 s; leave the option out");
        says(&host_sim(&["run", "hand3-turn", "--duration", duration]), 2, &[&told]);
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "mass = -1").unwrap();
    let (below, file) = (file.join("below"), file.to_str().unwrap());
    let grasp = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3/grasps/box.toml");
    says(&host_sim(&["render-knob", "--out", below.to_str().unwrap()]), 2, &[below.to_str().unwrap()]);
    says(&host_sim(&["serve", "--grasp", grasp, "--object", file]), 2, &[file]);
    let far = folder.path().join("far.toml");
    let text = std::fs::read_to_string(grasp).unwrap().replacen("position = [0.090", "position = [0.40", 1);
    std::fs::write(&far, text).unwrap();
    let told = [
        "far.toml: finger1_tip cannot stand 20 mm in front of its contact: 0.3",
        "m is out of reach; the nearest",
    ];
    says(&host_sim(&["serve", "--grasp", far.to_str().unwrap()]), 2, &told);
    for (scenario, robot, told) in [
        ("hand3-reach", "arm7", "its paths are for fingers of three joints each"),
        ("hand3-reach", "inspire", "its paths are for fingers of three joints each"),
        ("hand5-teleop", "hand3", "it needs a hand of five fingers, thumb to little finger; hand3 has 3"),
        (
            "hand5-reach",
            "allegro",
            "it needs a hand of five fingers, thumb to little finger; allegro_hand_right has 4",
        ),
        ("arm7-wall", "hand3", "one chain of six or seven joints with a force sensor; hand3 has 3 chains"),
        ("arm7-follow", "knob-arm", "with a force sensor; knob-arm has no force sensor. Scenarios for such"),
        // It has no approach.toml.
        ("hand3-reach", "arm7", "arm7-paper-matrices, hand3-first-motion\n"),
        ("arm7-wall", "leap", "Scenarios for such a robot: hand3-servo, hand3-first-motion\n"),
        ("knob-find", "hand3", "has no camera.toml: knob-find needs"),
        ("hand5-calibrate", "hand5", "no robot takes part in hand5-calibrate; leave out --robot"),
    ] {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(robot);
        let robot = robot.to_str().unwrap();
        let run = host_sim(&["run", scenario, "--robot", robot, "--out", folder.path().to_str().unwrap()]);
        says(&run, 2, &[told]);
    }
    let told = ["no robot takes part in hand5-calibrate; leave out --robot"];
    says(&host_sim(&["limits", "hand5-calibrate", "--robot", knob_arm]), 2, &told);
    let qemu = |image| host_sim(&["run", "hand3-servo", "--controller", "qemu", "--elf", image]);
    says(&qemu("/nowhere/image"), 2, &["no firmware image at /nowhere/image", "cargo xtask firmware"]);
    says(
        &host_sim(&["chip", "--elf", file, "--chip", file]),
        2,
        &[file, "is not an image of board-weact: it is not an ELF"],
    );
    says(&qemu(file), 2, &[file, "is not a firmware image: it is not an ELF file", "cargo xtask firmware"]);
}

/// QEMU would block if it wrote more than a pipe holds.
#[cfg(unix)]
#[test]
fn what_qemu_says_before_it_ends_is_quoted() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let qemu = folder.path().join("qemu-system-arm");
    let script = "#!/bin/sh\necho no such machine >&2\nhead -c 200000 /dev/zero | tr '\\0' . >&2\nexit 3\n";
    std::fs::write(&qemu, script).unwrap();
    std::fs::set_permissions(&qemu, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    let image = folder.path().join("image");
    // The header of an ELF file of 32 bits, little endian, version 1, for ARM, of 52 bytes: nothing follows.
    let mut header = b"\x7fELF\x01\x01\x01".to_vec();
    header.resize(52, 0);
    (header[18], header[20], header[40]) = (40, 1, 52);
    std::fs::write(&image, header).unwrap();
    command.args(["run", "hand3-servo", "--controller", "qemu", "--elf"]).arg(&image);
    let output = command.arg("--out").arg(folder.path()).env("PATH", path).output().unwrap();
    says(&output, 2, &["did not come up: exit status: 3; qemu-system-arm says: no such machine"]);
}

#[test]
fn a_machine_that_the_servo_cannot_hold_fails_its_metrics() {
    // A tenth of the stiffness and no integral action: the servo cannot overcome friction.
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot");
    std::fs::create_dir(&robot).unwrap();
    let source = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
    for name in ["robot.urdf", "plant.toml", "controller.toml"] {
        std::fs::copy(source.join(name), robot.join(name)).unwrap();
    }
    let settings = std::fs::read_to_string(source.join("controller.toml")).unwrap();
    let weak = settings
        .replace("proportional = 400.0", "proportional = 100.0")
        .replace("integral = 4000.0", "integral = 0.0")
        .replace("following_error = 0.25", "following_error = 1.5");
    assert_ne!(settings, weak);
    std::fs::write(robot.join("controller.toml"), weak).unwrap();
    let (robot, out) = (robot.to_str().unwrap(), folder.path().join("out"));
    let output = host_sim(&["run", "hand3-servo", "--robot", robot, "--out", out.to_str().unwrap()]);
    says(&output, 1, &["FAIL"]);
}

/// The machine's file goes while the seeds are run.
#[test]
fn what_came_to_its_end_is_kept_where_a_later_seed_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, out) = (folder.path().join("robot"), folder.path().join("out"));
    std::fs::create_dir(&robot).unwrap();
    let source = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
    for name in ["robot.urdf", "plant.toml", "controller.toml"] {
        std::fs::copy(source.join(name), robot.join(name)).unwrap();
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    command.args(["run", "hand3-servo", "--seed", "1-20", "--json", "--robot"]).arg(&robot);
    let mut run =
        command.arg("--out").arg(&out).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(run.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    std::fs::remove_file(robot.join("plant.toml")).unwrap();
    let done = 1 + lines.count();
    says(&run.wait_with_output().unwrap(), 2, &[&format!("seed {}: ", done + 1), "plant.toml"]);
    let kept = std::fs::read_to_string(out.join("hand3-servo-robot/summary.json")).unwrap();
    assert_eq!(kept.lines().count(), done);
}

/// Another robot in the scenario of hand3 has neither its limits nor its words, and spoils no report of it.
#[test]
fn a_report_of_ones_own_robot_is_about_it_and_names_the_command_that_made_it() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("my hand");
    std::fs::create_dir(&robot).unwrap();
    let source = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
    for name in ["robot.urdf", "plant.toml", "controller.toml"] {
        let text = std::fs::read_to_string(source.join(name)).unwrap();
        let mut own = text.replace("<robot name=\"hand3\"", "<robot name=\"my_hand\"");
        if name == "controller.toml" {
            own += "\n[joints.finger2_bend.servo]\nfilter_time = 0.3\n";
        }
        std::fs::write(robot.join(name), own).unwrap();
    }
    let out = folder.path().join("out");
    let run = ["run", "hand3-servo", "--duration", "32", "--robot", robot.to_str().unwrap(), "--out"];
    let output = host_sim(&[&run[..], &[out.to_str().unwrap()]].concat());
    let note = "no limit is set for this robot: those of hand3-servo are for hand3";
    says(&output, 0, &["DONE  reported only, no limits", note]);
    assert!(!String::from_utf8_lossy(&output.stdout).contains("PASS"));
    let files = out.join("hand3-servo-my hand");
    let page = std::fs::read_to_string(files.join("index.html")).unwrap();
    let command = format!(
        "cargo sim run hand3-servo --controller native --seed 1 --duration 32 --robot '{}'",
        robot.display()
    );
    for words in [&*command, "hand3-servo with my_hand, 9 joints"] {
        assert!(page.contains(words), "{words:?} is not in the page");
    }
    assert!(!page.contains("three-finger hand") && !page.contains("limit ±"));
    // One of its joints is slower, which has a reference of its own.
    for words in ["reference with T_f = 0.2 s", "reference with T_f = 0.3 s"] {
        assert!(page.contains(words), "{words:?} is not in the page");
    }
    let summary = std::fs::read_to_string(files.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    let metrics = summary["metrics"].as_object().unwrap();
    assert!(!metrics.is_empty() && metrics.values().all(|metric| metric["limit"].is_null()), "{summary}");
    assert!(!out.join("hand3-servo").exists());
}

#[test]
fn views_of_a_door_come_with_a_table_of_poses() {
    let folder = tempfile::tempdir().unwrap();
    let render = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let mut arguments =
            vec!["render-knob", "--seed", "3", "--views", "3", "--out", out.to_str().unwrap()];
        arguments.extend(more);
        says(&host_sim(&arguments), 0, &["knob-3-01.png", "knob-3-03.png"]);
        (
            std::fs::read_to_string(out.join("knob-3.csv")).unwrap(),
            std::fs::read(out.join("knob-3-02.png")).unwrap(),
        )
    };
    let first = render("first", &[]);
    assert!(
        first.0.starts_with("image,x,y,z,qx,qy,qz,qw,distance,true_u,true_v,true_radius\nknob-3-01.png,")
    );
    assert_eq!(first.0.lines().count(), 4);
    assert!(first == render("again", &[]) && first.1 != render("disc", &["--disc"]).1);
    let arguments =
        ["render-knob", "--views", "2", "--distance", "1.0", "--out", folder.path().to_str().unwrap()];
    says(&host_sim(&[&arguments[..], &["--views", "0"]].concat()), 2, &["views"]);
}

#[test]
fn laws_are_compared_side_by_side_and_one_may_be_ones_own() {
    let folder = tempfile::tempdir().unwrap();
    let laws = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7/laws");
    let own = folder.path().join("own.toml");
    let text = std::fs::read_to_string(laws.join("corrected.toml")).unwrap();
    std::fs::write(&own, &text).unwrap();
    let [own, out] = [&own, folder.path()].map(|path| path.to_str().unwrap().to_owned());
    let scenario = ["run", "arm7-paper-elbow", "--json", "--out", &out];
    let laws = ["--law", "pseudo-inverse", "--law", "paper", "--law", &own];
    let output = host_sim(&[&scenario[..], &laws].concat());
    says(&output, 0, &[]);
    let run: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let value = |name: &str| run["metrics"][name]["value"].as_f64().unwrap_or_else(|| panic!("no {name}"));
    // Without its compensation term the driven joint moves the hand; with equation (3) the elbow stays in
    // place.
    assert!(value("paper_matched_hand_displacement") > 2.0 * value("own_matched_hand_displacement"));
    assert!(
        value("paper_mismatched_elbow_turn").abs()
            > 20.0 * value("pseudo_inverse_mismatched_elbow_turn").abs()
    );
    std::fs::write(&own, text.replace("mass = { translation = 1.5", "mass = { translation = -1.5")).unwrap();
    let output = host_sim(&["run", "arm7-paper-elbow", "--law", &own, "--out", &out]);
    let line = text.lines().position(|line| line.starts_with("mass")).unwrap() + 1;
    says(&output, 2, &[&format!("own.toml:{line}: the mass along x is -1.5 kg")]);
}

#[test]
fn a_law_of_ones_own_holds_the_box_and_what_is_wrong_in_it_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let paper = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3/laws/paper.toml");
    let text = std::fs::read_to_string(paper).unwrap();
    // A stronger grip for a short time, and a light weight.
    let changes = [
        ("hold = 4.0 ", "hold = 1.0 "),
        ("evaluated = 2.0", "evaluated = 0.5"),
        ("strength = 4.0", "strength = 6.0"),
        ("masses = [0.05, 0.1, 0.2, 0.3]", "masses = [0.05]"),
        ("interval = 2.0", "interval = 1.0"),
    ];
    let mut own = text.lines().map(|line| if line.starts_with("coulomb") { "coulomb = []" } else { line });
    let mut own = own.by_ref().collect::<Vec<_>>().join("\n");
    for (from, to) in changes {
        assert!(own.contains(from), "{from}");
        own = own.replacen(from, to, 1);
    }
    let [file, out] = [folder.path().join("own.toml"), folder.path().join("out")];
    std::fs::write(&file, &own).unwrap();
    let [law, out] = [&file, &out].map(|path| path.to_str().unwrap().to_owned());
    let output = host_sim(&["run", "hand3-paper-force", "--law", &law, "--json", "--out", &out]);
    says(&output, 0, &[]);
    let run: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let metrics = run["metrics"].as_object().unwrap();
    assert!(metrics.keys().all(|name| name.starts_with("own_")), "{:?}", metrics.keys());
    // 3 N along the x axis of a box with a pitch of 0.769 rad are (2.16, 0, −2.09) N; a third of the weight
    // of 23 g is 0.05 N along x and along z.
    for (axis, expected) in [("x", 2.21), ("z", -2.04)] {
        let name = format!("own_commanded_{axis}");
        let commanded = run["metrics"][&name]["value"].as_f64().unwrap();
        assert!((commanded - expected).abs() < 0.05, "{name}: {commanded} N");
    }
    assert!(run["metrics"]["own_sensed_weight_error"]["value"].as_f64().unwrap() < 0.06);
    std::fs::write(&file, own.replacen("strength = 6.0", "strength = -6.0", 1)).unwrap();
    let line = own.lines().position(|line| line.starts_with("internal")).unwrap() + 1;
    let output = host_sim(&["run", "hand3-paper-force", "--law", &law, "--out", &out]);
    says(&output, 2, &[&format!("own.toml:{line}: "), "-6"]);
    let arm = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7/laws/paper.toml");
    let output = host_sim(&["run", "hand3-paper-force", "--law", arm.to_str().unwrap(), "--out", &out]);
    says(&output, 2, &["paper.toml:"]);
}
