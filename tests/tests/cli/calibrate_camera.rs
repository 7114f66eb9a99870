//! `tesaki calibrate camera`, from poses and joint angles, circles and pictures.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tesaki::kinematics::Chain;
use tesaki_description::robot::RobotFolder;
use tesaki_rng::Rng;
use tesaki_sim::camera::{Camera, CameraValues, Circle};

fn robot() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm")
}

/// Runs the command; returns exit code, standard output and standard error.
fn run(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let output = tesaki_tests::tesaki()
        .args(["calibrate", "camera", "--robot", robot().to_str().unwrap()])
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

const JOINTS: [(&str, f32, f32); 6] = [
    ("base_yaw", 0.0, 0.06),
    ("base_pitch", -0.529_777, 0.08),
    ("base_roll", 0.0, 0.15),
    ("elbow", 1.891_18, 0.15),
    ("wrist_pitch", -1.361_402, 0.2),
    ("wrist_yaw", 0.0, 0.2),
];

/// Returns the arm camera's circles of a rose 0.15 m in front of its start posture.
fn circles_by_joints() -> String {
    let model = RobotFolder::load(&robot()).unwrap().model;
    let chain = Chain::new(&model.joints, &model.chains[0].tip);
    let values = CameraValues::load(&robot()).unwrap();
    // Position and columns of the hand frame, with the gripper at 0.
    let hand = |angles: &[f32]| -> [[f64; 3]; 4] {
        let posture = chain.posture(&[angles, &[0.0]].concat());
        let tip = posture.tip();
        let column = |column| [0, 1, 2].map(|row| f64::from(tip.rotation[(row, column)]));
        let place = [0, 1, 2].map(|row| f64::from(tip.translation.vector[row]));
        [place, column(0), column(1), column(2)]
    };
    let [place, x, y, z] = hand(&JOINTS.map(|(_, start, _)| start));
    let center = [0, 1, 2].map(|axis| place[axis] + 0.15 * z[axis]);
    let mut rng = Rng::new(1, 0);
    let mut text = JOINTS.map(|(name, ..)| name).join(",") + ",u,v,radius\n";
    for _ in 0..30 {
        #[expect(clippy::cast_possible_truncation, reason = "angles")]
        let angles = JOINTS.map(|(_, start, reach)| start + reach * rng.symmetric() as f32);
        let [place, axes @ ..] = hand(&angles);
        let turned = |vector: [f64; 3]| -> [f64; 3] {
            axes.map(|axis| (0..3).map(|part| axis[part] * vector[part]).sum())
        };
        let rose = Circle {
            center: turned([0, 1, 2].map(|axis| center[axis] - place[axis])).into(),
            axes: [turned(x).into(), turned(y).into()],
            radius: 0.04,
        };
        let seen = rose.transformed(&values.mount().inverse()).image(&Camera::of(&values)).unwrap();
        let numbers = angles.map(|angle| angle.to_string()).join(",");
        let [u, v] = seen.center;
        let _ = writeln!(text, "{numbers},{u},{v},{}", seen.radius());
    }
    text
}

/// The oracle's rows; the other fields are for the library.
type Oracle = (&'static [[f64; 10]], [(f64, f64); 7], [(f64, f64); 3], &'static [usize], [f64; 2]);
const ORACLE: Oracle = include!("../../oracles/data/hand_eye.in");
const HEADER: &str = "x,y,z,qx,qy,qz,qw,u,v,radius";

fn circles_by_poses() -> Vec<String> {
    let row = |row: &[f64; 10]| row.map(|number| number.to_string()).join(",");
    std::iter::once(HEADER.to_owned()).chain(ORACLE.0.iter().map(row)).collect()
}

const CIRCLES: [&str; 6] = ["--in", "circles.csv", "--rose", "0.04", "--size", "256x240"];

#[test]
fn circles_and_poses_become_a_table_of_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("circles.csv"), circles_by_poses().join("\n")).unwrap();
    let (code, out, error) = run(folder, &[&CIRCLES[..], &["--out", "hand_eye.toml"]].concat());
    assert_eq!(code, 0, "{out}{error}");
    for words in [
        "camera: position (0.0521 ±0.0005",
        "30 circles fit",
        "line 7: ",
        "line 22: ",
        "written to hand_eye.toml",
    ] {
        assert!(out.contains(words), "{words}: {out}");
    }
    tesaki_description::hand_eye::load(folder).unwrap();
    // Who has the old file has it whole.
    std::fs::write(folder.join("hand_eye.toml"), "old").unwrap();
    std::fs::hard_link(folder.join("hand_eye.toml"), folder.join("old")).unwrap();
    let (_, out, _) = run(folder, &[&CIRCLES[..], &["--json", "--out", "hand_eye.toml"]].concat());
    let value: Value = serde_json::from_str(&out).unwrap();
    assert!((value["camera"]["focal"].as_f64().unwrap() - ORACLE.1[6].0).abs() < 0.01, "{out}");
    assert_eq!((&value["circles"], &value["rejected"][1]["line"]), (&30.into(), &22.into()));
    tesaki_description::hand_eye::load(folder).unwrap();
    assert_eq!(std::fs::read_to_string(folder.join("old")).unwrap(), "old");
    // The robot's table is not lost by the default, nor is the input.
    let (code, _, error) = run(folder, &CIRCLES);
    assert!(
        code == 2
            && error.contains("hand_eye.toml exists: choose another file with --out FILE, or give --out "),
        "{error}"
    );
    let (code, _, error) = run(folder, &[&CIRCLES[..], &["--out", "circles.csv"]].concat());
    assert!(code == 2 && error.contains("--in and --out are both circles.csv"), "{error}");
}

#[test]
fn joint_angles_do_in_place_of_poses() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("circles.csv"), circles_by_joints()).unwrap();
    let (code, out, error) = run(folder, &[&CIRCLES[..], &["--out", "hand_eye.toml"]].concat());
    assert_eq!(code, 0, "{out}{error}");
    assert!(error.contains("Without a column, taken to be at 0 rad: gripper."), "{error}");
    assert!(out.contains("position (0.0500 ±") && out.contains("focal length 140.00 ±"), "{out}");
}

#[test]
fn the_plate_is_found_in_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut sim = tesaki_tests::program("host-sim");
    let output =
        sim.args(["render-knob", "--disc", "--seed", "2", "--views", "25", "--out"]).arg(folder).output();
    assert!(output.unwrap().status.success());
    let arguments = ["--in", "knob-2.csv", "--rose", "0.04", "--out", "hand_eye.toml"];
    let (code, out, error) = run(folder, &arguments);
    assert!(code == 0 && out.contains("focal length 1") && out.contains("circles fit"), "{out}{error}");
    // A picture without a circle is named, with its row.
    let good = std::fs::read_to_string(folder.join("knob-2.csv")).unwrap();
    let grey = [b"P5 256 240 255\n".to_vec(), vec![128; 256 * 240]].concat();
    std::fs::write(folder.join("grey.pgm"), grey).unwrap();
    std::fs::write(folder.join("knob-2.csv"), good.replace("knob-2-03.png", "grey.pgm")).unwrap();
    let (code, _, error) = run(folder, &arguments);
    assert!(code == 0 && error.contains("line 4, grey.pgm: no circle found; skipped"), "{error}");
    let all: Vec<String> = (0..30).map(|number| format!("knob-2-{number:02}.png")).collect();
    let none = all.iter().fold(good.clone(), |table, name| table.replace(name, "grey.pgm"));
    std::fs::write(folder.join("knob-2.csv"), none).unwrap();
    let (code, _, error) = run(folder, &arguments);
    let told = ["not calibrated", "no circle found in these pictures: line 2, grey.pgm; line 3, grey.pgm"];
    assert!(code == 1 && told.iter().all(|words| error.contains(words)), "{error}");
    // Pictures that are missing, invalid, or of another size.
    std::fs::write(folder.join("text.png"), "hello").unwrap();
    std::fs::write(folder.join("small.pgm"), [b"P5 64 64 255\n".to_vec(), vec![0; 4096]].concat()).unwrap();
    for (to, words) in [
        ("none.png", "knob-2.csv:4: column image: none.png: "),
        ("text.png", "knob-2.csv:4: column image: text.png: neither a PNG nor a PGM picture"),
        ("small.pgm", "knob-2.csv:4: column image: small.pgm has 64 × 64 pixels, not 256 × 240"),
        ("", "knob-2.csv:4: column image: empty"),
    ] {
        std::fs::write(folder.join("knob-2.csv"), good.replace("knob-2-03.png", to)).unwrap();
        let (code, _, error) = run(folder, &arguments);
        assert!(code == 1 && error.contains(words), "{words}: {error}");
    }
}

#[test]
fn what_is_wrong_with_a_table_is_said_by_row() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let refused = |change: &dyn Fn(&mut Vec<String>), words: &str| {
        let mut rows = circles_by_poses();
        change(&mut rows);
        std::fs::write(folder.join("circles.csv"), rows.join("\n")).unwrap();
        let (code, _, error) = run(folder, &[&CIRCLES[..], &["--out", "hand_eye.toml"]].concat());
        assert!(code == 1 && error.contains(words), "{words}: {code} {error}");
        assert!(!folder.join("hand_eye.toml").exists(), "nothing is written");
    };
    let set = |row: &mut String, column: usize, text: &str| {
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[column] = text;
        *row = cells.join(",");
    };
    refused(&|rows| set(&mut rows[0], 4, "other"), "circles.csv:1: no column qy (pose of the hand)");
    refused(
        &|rows| set(&mut rows[0], 8, "other"),
        "circles.csv:1: no column v (the plate in the picture [px])",
    );
    refused(
        &|rows| rows[0] = HEADER.replace("u,v,radius", "a,b,c"),
        "circles.csv:1: no circles: add columns",
    );
    refused(
        &|rows| rows[0] = "a,b,c,d,e,f,g,u,v,radius".to_owned(),
        "or angles [rad] of the joints base_yaw, ",
    );
    refused(&|rows| set(&mut rows[3], 2, "NaN"), "circles.csv:4: column z: NaN is not a finite number");
    refused(&|rows| set(&mut rows[3], 9, ""), "circles.csv:4: column radius is empty");
    refused(&|rows| set(&mut rows[5], 6, "1.5"), "circles.csv:6: a quaternion of norm 1.");
    refused(&|rows| set(&mut rows[5], 0, "700"), "circles.csv:6: a position of 700 m: is it in metres?");
    refused(&|rows| rows.truncate(6), "not calibrated: 5 circles: at least 6 are needed");
    refused(
        &|rows| {
            let turned: Vec<String> = rows[1].split(',').skip(3).take(4).map(str::to_owned).collect();
            for row in &mut rows[1..] {
                (0..4).for_each(|part| set(row, 3 + part, &turned[part]));
            }
        },
        "not calibrated: the circles do not fit one rose that stands still",
    );
    let copies = |rows: &mut Vec<String>| (2..rows.len()).for_each(|row| rows[row] = rows[1].clone());
    refused(&copies, "add pictures with the hand ");
    let (code, _, error) = run(folder, &[&CIRCLES[..4], &["--out", "x.toml"]].concat());
    assert!(code == 2 && error.contains("give --size"), "{error}");
    for (option, value, words) in [
        ("--rose", "40", "the radius of the rose [m] is 40"),
        ("--distances", "0.3..0.1", "the largest distance [m] is 0.1"),
        ("--size", "256", "expected WIDTHxHEIGHT"),
    ] {
        let mut arguments = vec!["--in", "circles.csv", "--out", "x.toml", option, value];
        arguments.extend(CIRCLES.chunks(2).skip(1).filter(|pair| pair[0] != option).flatten());
        let (code, _, error) = run(folder, &arguments);
        assert!(code == 2 && error.contains(words), "{error}");
    }
}
