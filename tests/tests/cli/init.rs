//! A robot folder written by `tesaki model init` can be used unchanged: it passes the check, and a simulated
//! board moves every joint with it.

use std::path::{Path, PathBuf};

use super::machine::move_every_joint;
use super::server::{arm7, hand3};

/// A finger with common errors of published URDFs.
const DEFECTS: &str = include_str!("defects.urdf");

/// Runs the command; returns exit code and all output.
fn run(arguments: &[&str]) -> (i32, String) {
    let output = tesaki_tests::tesaki().args(arguments).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
}

/// Writes the folder of a robot; returns the output.
fn init(urdf: &Path, folder: &Path, options: &[&str]) -> String {
    let paths = [urdf.to_str().unwrap(), "--out", folder.to_str().unwrap()];
    let (code, text) = run(&[&["model", "init"], &paths[..], options].concat());
    assert_eq!(code, 0, "{text}");
    text
}

fn check(folder: &Path) -> String {
    let (code, text) = run(&["model", "check", folder.to_str().unwrap()]);
    assert_eq!(code, 0, "{text}");
    text
}

/// What `grasp run` refuses, the check of the folder tells.
#[test]
fn grasps_that_do_not_suit_the_robot_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let grasps = folder.path().join("grasps");
    std::fs::create_dir(&grasps).unwrap();
    for file in ["robot.urdf", "controller.toml"] {
        std::fs::copy(hand3().join(file), folder.path().join(file)).unwrap();
    }
    let text = std::fs::read_to_string(hand3().join("grasps/box.toml")).unwrap();
    for (name, from, to) in [
        ("strong", "force_limit = 9.0", "force_limit = 90.0"),
        ("millimetres", "[0.090, 0.0, 0.085]", "[90, 0.0, 85]"),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(grasps.join(name).with_extension("toml"), text.replace(from, to)).unwrap();
    }
    let (code, said) = run(&["model", "check", folder.path().to_str().unwrap()]);
    assert_eq!(code, 1, "{said}");
    for words in ["strong.toml: force_limit = 90 N", "millimetres.toml: contact 1: ", "is it in metres?"] {
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn a_hand_from_its_urdf_alone_moves_every_joint() {
    let folder = tempfile::tempdir().unwrap();
    let said = init(&hand3().join("robot.urdf"), folder.path(), &[]);
    assert!(
        said.contains("finger1_swing        maxon-16mm     0.600 N·m, for the URDF's effort of 0.6"),
        "{said}"
    );
    assert!(check(folder.path()).contains("no problems found"));
    move_every_joint(folder.path(), 2);
}

#[test]
fn a_path_with_hyphens_ends_no_comment() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("a---b--.urdf");
    std::fs::copy(hand3().join("robot.urdf"), &urdf).unwrap();
    init(&urdf, &folder.path().join("robot"), &[]);
    assert!(check(&folder.path().join("robot")).contains("no problems found"));
}

#[test]
fn an_arm_from_its_urdf_alone_moves_every_joint() {
    let folder = tempfile::tempdir().unwrap();
    let said = init(&arm7().join("robot.urdf"), folder.path(), &["--motor", "wrist_roll=xm430-w350"]);
    assert!(said.contains("shoulder_pitch       ak80-64       60.000 N·m"), "{said}");
    assert!(said.contains("wrist_roll           xm430-w350     4.101 N·m, as chosen"), "{said}");
    assert!(said.contains("[12.0, 24.0, 48.0] V, and a board watches only one"), "{said}");
    let settings = std::fs::read_to_string(folder.path().join("controller.toml")).unwrap();
    let lines: Vec<&str> =
        settings.lines().filter(|line| line.starts_with("following_error = 0.15 ")).collect();
    assert!(!lines.is_empty() && lines.iter().all(|line| line.contains("0.15 to 0.5")), "{lines:?}");
    check(folder.path());
    move_every_joint(folder.path(), 3);
}

/// Returns the paths of the URDF with defects, and of the folder to write.
fn defects(folder: &tempfile::TempDir) -> (PathBuf, PathBuf) {
    let urdf = folder.path().join("defects.urdf");
    std::fs::write(&urdf, DEFECTS).unwrap();
    (urdf, folder.path().join("robot"))
}

#[test]
fn a_urdf_with_the_usual_defects_is_refused_by_line_or_accepted_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (urdf, out) = defects(&folder);
    let (code, text) = run(&["model", "init", urdf.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(code, 1, "{text}");
    for words in ["defects.urdf:18: link link_0.0: physically impossible", "--accept-inertia"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(!out.exists(), "nothing is written");
    let said = init(&urdf, &out, &["--accept-inertia", "all"]);
    for words in [
        "inertia replaced by the nearest that a body can have: link_0.0, link_2.0",
        "the URDF's friction would take most of the torque, the motor's is used: joint_0.0",
        "the URDF has no effort limit, the motor's torque is used: joint_1.0",
        "link link_1.0: an inertia of 1.0e-3 kg·m² for 0.03 kg is a radius of gyration of 0.183 m",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let checked = check(&out);
    assert!(checked.contains("works; 3 warnings"), "{checked}");
    let plant = std::fs::read_to_string(out.join("plant.toml")).unwrap();
    assert!(plant.contains("\"joint_0.0\" = 0.3763"), "a tenth of the range above 0.263: {plant}");
    move_every_joint(&out, 1);
}

#[test]
fn wrong_names_and_folders_that_exist_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (urdf, out) = defects(&folder);
    let urdf = urdf.to_str().unwrap();
    for (options, words) in [
        (["--motor", "mg996r"], "there is no motor \"mg996r\"; the motors are xl330-m288"),
        (["--motor", "thumb=sts3215"], "no moving joint \"thumb\"; its joints are joint_0.0"),
        (["--accept-inertia", "link_9"], "--accept-inertia link_9: the URDF has no such link"),
    ] {
        let accept = ["--accept-inertia", "all"];
        let (code, text) = run(&[&["model", "init", urdf], &options[..], &accept[..]].concat());
        assert!(code == 2 && text.contains(words), "{code} {text}");
    }
    init(Path::new(urdf), &out, &["--accept-inertia", "all"]);
    let again = ["model", "init", urdf, "--accept-inertia", "all", "--out", out.to_str().unwrap()];
    let (code, text) = run(&again);
    assert!(code == 2 && text.contains("robot.urdf exists") && text.contains("--force"), "{text}");
    // Who has an old file has it whole.
    std::fs::write(out.join("plant.toml"), "old").unwrap();
    std::fs::hard_link(out.join("plant.toml"), folder.path().join("old")).unwrap();
    let (code, text) = run(&[&again[..], &["--force"]].concat());
    assert_eq!(code, 0, "{text}");
    assert_eq!(std::fs::read_to_string(folder.path().join("old")).unwrap(), "old");
    check(&out);
}

/// Writes the URDF of the hand under another name.
fn named(folder: &Path, name: &str) -> PathBuf {
    let text = std::fs::read_to_string(hand3().join("robot.urdf")).unwrap();
    let urdf = folder.join("other.urdf");
    std::fs::write(&urdf, text.replacen("name=\"hand3\"", &format!("name=\"{name}\""), 1)).unwrap();
    urdf
}

#[test]
fn the_name_of_a_robot_is_no_path() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let run_inside = |urdf: &Path, options: &[&str]| {
        let mut command = tesaki_tests::tesaki();
        command.current_dir(&inner).args(["model", "init", urdf.to_str().unwrap()]).args(options);
        let output = command.output().unwrap();
        (output.status.code().unwrap(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
    };
    let absolute = folder.path().join("absolute");
    for name in ["../escape", absolute.to_str().unwrap(), "..", ".", "-rf", "two&#10;lines", "a/b"] {
        let urdf = named(folder.path(), name);
        let (code, text) = run_inside(&urdf, &[]);
        assert!(
            code == 2 && text.contains("cannot be the name of a folder") && text.contains("--out"),
            "{name}: {code} {text}"
        );
        assert_eq!(std::fs::read_dir(&inner).unwrap().count(), 0, "{name}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    let urdf = named(folder.path(), "../escape");
    assert_eq!(run_inside(&urdf, &["--out", "robot"]).0, 0);
    let urdf = named(folder.path(), "my hand");
    assert_eq!(run_inside(&urdf, &[]).0, 0);
    assert!(inner.join("my hand/controller.toml").is_file());
}

#[test]
fn a_urdf_without_masses_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("robot");
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots/abb_irb140.urdf");
    let (code, text) = run(&["model", "init", urdf.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert_eq!(code, 1, "{text}");
    for words in ["abb_irb140.urdf:7: link link_1", "without mass", "--accept-inertia"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(!text.contains("wrote") && !text.contains("next:"), "{text}");
    assert!(!out.exists(), "nothing is written");
}

#[test]
fn a_folder_that_needs_another_motor_is_written_with_what_is_wrong_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = arm7().join("robot.urdf");
    let out = folder.path().to_str().unwrap();
    let (code, text) = run(&["model", "init", urdf.to_str().unwrap(), "--out", out, "--motor", "xl330-m288"]);
    assert_eq!(code, 1, "{text}");
    for words in ["gravity needs up to", "wrote ", "next: correct what is BAD"] {
        assert!(text.contains(words), "{words}: {text}");
    }
    assert!(
        text.contains("the URDF's effort is more than the motor's torque, which is used: all joints"),
        "{text}"
    );
    let (code, again) = run(&["model", "check", out]);
    assert!(
        code == 1 && again.contains("controller.toml:") && again.contains("gravity needs up to"),
        "{again}"
    );
}

#[test]
fn a_file_of_a_folder_is_not_checked_for_a_urdf() {
    let (code, text) = run(&["model", "check", hand3().join("controller.toml").to_str().unwrap()]);
    let folder = hand3();
    assert!(code == 2 && text.contains(&format!("give the folder, {}", folder.display())), "{text}");
}

#[test]
fn a_hand_whose_fingertips_cannot_be_placed_is_told_why() {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots");
    let told = check(&robots.join("allegro"));
    assert!(
        told.contains("no control of the fingertip") && told.contains("joints; a finger has 3"),
        "{told}"
    );
    assert_eq!(told.matches("no control of the fingertip").count(), 4, "{told}");
    assert!(!check(&robots.join("hand3")).contains("no control of the fingertip"));
}

#[test]
fn what_is_no_regular_file_is_not_read() {
    let (code, text) = run(&["model", "check", "/dev/zero"]);
    assert!(code == 1 && text.contains("/dev/zero: ") && text.contains("not a regular file"), "{text}");
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(hand3().join("robot.urdf"), folder.path().join("robot.urdf")).unwrap();
    nix::unistd::mkfifo(&folder.path().join("controller.toml"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    let (code, text) = run(&["model", "check", folder.path().to_str().unwrap()]);
    assert!(code == 1 && text.contains("controller.toml: it cannot be read: not a regular file"), "{text}");
    let huge = folder.path().join("huge.urdf");
    std::fs::File::create(&huge).unwrap().set_len(1 << 30).unwrap();
    let (code, text) = run(&["model", "check", huge.to_str().unwrap()]);
    assert!(code == 1 && text.contains("larger than 16 MiB"), "{text}");
}

#[test]
fn eval_does_not_write_over_its_table() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("table.csv");
    for (text, command) in [
        ("finger1_swing\n0\n", &["eval", "fk", "--robot", hand3().to_str().unwrap()][..]),
        ("x1,y1,z1\n0,0,0\n", &["eval", "grip"]),
    ] {
        std::fs::write(&table, text).unwrap();
        let file = table.to_str().unwrap();
        let (code, said) = run(&[command, &["--in", file, "--out", file]].concat());
        assert!(
            code == 2 && said.contains("--in and --out are both") && said.contains("lost"),
            "{code} {said}"
        );
        assert_eq!(std::fs::read_to_string(&table).unwrap(), text);
    }
    // Nor over its robot.
    std::fs::write(&table, "finger1_swing\n0\n").unwrap();
    let urdf = folder.path().join("robot.urdf");
    std::fs::copy(hand3().join("robot.urdf"), &urdf).unwrap();
    let [robot, file, out] = [folder.path(), &table, &urdf].map(|path| path.to_str().unwrap());
    for robot in [robot, out] {
        let (code, said) = run(&["eval", "fk", "--robot", robot, "--in", file, "--out", out]);
        assert!(code == 2 && said.contains("a file of the robot and --out are both"), "{code} {said}");
    }
    assert_eq!(std::fs::read(&urdf).unwrap(), std::fs::read(hand3().join("robot.urdf")).unwrap());
    // Nor over what else its folder holds.
    let grasps = folder.path().join("grasps");
    std::fs::create_dir(&grasps).unwrap();
    let grasp = grasps.join("box.toml");
    std::fs::write(&grasp, "kept").unwrap();
    let out = grasp.to_str().unwrap();
    let (code, said) = run(&["eval", "fk", "--robot", robot, "--in", file, "--out", out]);
    assert!(code == 2 && said.contains("a file of the robot and --out are both"), "{code} {said}");
    assert_eq!(std::fs::read_to_string(&grasp).unwrap(), "kept");
}
