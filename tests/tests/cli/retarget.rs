//! `tesaki retarget`: an operator's fingertips on the five-finger hand, from files.

use std::fmt::Write as _;
use std::process::Command;

use serde_json::{Value, json};
use tesaki::teleop::HumanFinger;
use tesaki_sim::operator::calibration_trial::CalibrationPlan;
use tesaki_sim::operator::{FingersMotion, Glove, GloveValues, OperatorHand};
use tesaki_sim::plant::{Plant, PlantOptions};

use super::calibrate::{table, text};
use super::feed::feed;

/// Fingertips during a slow motion of the hand, computed by Pinocchio.
pub const TIPS: &str = include_str!("../../oracles/data/hand5_tips.csv");
const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/oracles/data/hand5_tips.csv");
const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/examples/hand_landmarks.py");

/// Runs the command with the frames as standard input; returns exit code, standard output and standard error.
fn run(arguments: &[&str], input: &str) -> (i32, String, String) {
    let hand5 = tesaki_tests::robot_folder("hand5");
    let mut command = tesaki_tests::tesaki();
    feed(command.arg("retarget").arg("--robot").arg(hand5).args(["--in", "-"]).args(arguments), input)
}

/// Returns the numbers of a table, row by row, without the time.
pub fn rows(text: &str) -> Vec<Vec<f64>> {
    let row = |line: &str| line.split(',').skip(1).map(|cell| cell.parse().unwrap()).collect();
    text.lines().skip(1).map(row).collect()
}

/// Returns the vectors from the thumb's tip to the others [m].
fn vectors(tips: &[f64]) -> Vec<f64> {
    (3..15).map(|index| tips[index] - tips[index % 3]).collect()
}

/// Returns the fingertips as lines of JSON.
pub fn json_lines(change: impl Fn(u32, [f64; 3]) -> [f64; 3]) -> String {
    let mut lines = String::new();
    for (index, row) in (0..).zip(&rows(TIPS)) {
        let mut line = json!({ "time": 0.05 * f64::from(index), "tips": {} });
        for (finger, tip) in HumanFinger::ALL.into_iter().zip(row.chunks(3)) {
            line["tips"][finger.name()] = json!(change(index, tip.try_into().unwrap()));
        }
        writeln!(lines, "{line}").unwrap();
    }
    lines
}

/// With the joint angles, the fingertips of rapier's bodies are where Pinocchio has the operator's.
#[test]
fn joint_angles_reproduce_the_fingertips() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("joints.csv");
    let (code, said, error) = run(&["--bandwidth", "20", "--out", out.to_str().unwrap()], TIPS);
    assert_eq!(code, 0, "{error}");
    for words in ["40 frames", "index_tip", "within 1.0 mm", "100.0 %", "computing time of a frame: median"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let joints = std::fs::read_to_string(&out).unwrap();
    let robot = tesaki_tests::robot("hand5");
    let names: Vec<&str> = robot.model.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(joints.lines().next().unwrap(), format!("time,{}", names.join(",")));
    let mut worst = 0.0_f64;
    let (angles, desired) = (rows(&joints), rows(TIPS));
    assert_eq!(angles.len(), desired.len());
    for (angles, desired) in angles.into_iter().zip(desired) {
        let options = PlantOptions { posture: Some(angles), ..PlantOptions::exact() };
        let plant = Plant::of(&robot, &options).unwrap();
        let tips: Vec<f64> = plant.tips().into_iter().flat_map(|tip| tip.position).collect();
        let errors =
            vectors(&tips).into_iter().zip(vectors(&desired)).map(|(found, desired)| found - desired);
        worst = errors.fold(worst, |worst, error| worst.max(error.abs()));
    }
    // The filter lags by less than 0.2 mm.
    assert!(worst < 5e-4, "{worst} m");
    // The same as lines of JSON, with JSON output.
    let (code, said, error) =
        run(&["--bandwidth", "20", "--json", "--out", out.to_str().unwrap()], &json_lines(|_, tip| tip));
    assert_eq!(code, 0, "{error}");
    let value: Value = serde_json::from_str(&said).unwrap();
    assert_eq!((&value["frames"], &value["gaps"]), (&json!(40), &json!(0)));
    assert!(value["fingers"]["little_tip"]["percentile_95"].as_f64().unwrap() < 1e-3, "{said}");
    assert!(value["computing_time"]["percentile_99"].as_f64().unwrap() > 0.0);
    assert_eq!(std::fs::read_to_string(&out).unwrap().lines().count(), 41);
}

/// Targets beyond the hand's reach are not reproduced, and motions that are too fast are slowed down; both
/// are reported.
#[test]
fn what_is_not_reproduced_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("joints.csv");
    let far = json_lines(|_, [x, y, z]| [x, y, 1.25 * z]);
    let (code, said, error) = run(&["--json", "--out", out.to_str().unwrap()], &far);
    assert_eq!(code, 0, "{error}");
    let value: Value = serde_json::from_str(&said).unwrap();
    let middle = &value["fingers"]["middle_tip"];
    assert!(middle["largest"].as_f64().unwrap() > 2e-3 && middle["within_tolerance"] == 0.0, "{said}");
    // To and fro in successive frames.
    let fast =
        json_lines(|index, [x, y, z]| if index % 2 == 0 { [x, y, z] } else { [x + 0.05, y, z - 0.03] });
    let (_, _, error) = run(&["--bandwidth", "20"], &fast);
    assert!(
        error.contains("held back by limits of speed: ") && !error.contains("speed: 0 frames"),
        "{error}"
    );
    // A gap, and a finger that is never visible.
    let rows: Vec<&str> = TIPS.lines().collect();
    let cut = |row: &str| row.split(',').take(13).collect::<Vec<_>>().join(",") + "\n";
    let gap: String = rows[..10].iter().chain(&rows[20..]).map(|row| cut(row)).collect();
    let (code, _, error) = run(&[], &gap);
    assert_eq!(code, 0, "{error}");
    assert!(
        error.contains("1 gap of more than 0.2 s") && error.contains("little_tip      never seen"),
        "{error}"
    );
}

#[test]
fn what_is_wrong_with_a_file_is_said_by_line_and_column() {
    let refused = |input: &str, words: &[&str]| {
        let (code, out, error) = run(&[], input);
        assert!(code == 1 && out.is_empty(), "{code}: {error}");
        words.iter().for_each(|words| assert!(error.contains(words), "{words}: {error}"));
    };
    let table = |change: &dyn Fn(&mut Vec<Vec<String>>)| {
        let cells = |line: &str| line.split(',').map(str::to_owned).collect();
        let mut table = TIPS.lines().map(cells).collect();
        change(&mut table);
        text(&table)
    };
    refused(
        &table(&|table| table[3][2] = "nan".to_owned()),
        &["standard input:4: column thumb_y: nan is not a finite"],
    );
    refused(&table(&|table| table[3][2].clear()), &["standard input:4: column thumb_y is empty"]);
    refused(
        &table(&|table| table.swap(3, 7)),
        &["standard input:5: time 0.15 s does not follow 0.3 s", "sort"],
    );
    refused(&table(&|table| table[0][0] = "t".to_owned()), &["standard input:1: no column time"]);
    refused(
        &table(&|table| table[0][6] = "w".to_owned()),
        &["no column index_z (position of a fingertip [m])"],
    );
    let misspelled = table(&|table| {
        for name in &mut table[0] {
            *name = name.replace("ring_", "rnig_");
        }
    });
    refused(&misspelled, &["standard input:1: unknown column rnig_x: write ring_x, or remove it"]);
    refused("time,a\n0,1\n", &["no positions (thumb_x", "no orientations"]);
    refused(
        "time,thumb_x,thumb_y,thumb_z,back_qx\n0,1,1,1,1\n",
        &["orientations and positions", "--operator"],
    );
    refused(
        &table(&|table| {
            for row in &mut table[1..] {
                (4..7).for_each(|column| row.swap(column, column + 3));
            }
        }),
        &[
            "standard input:2: the tip of the middle finger is 0.021 m beyond that of the index finger",
            "swapped?",
        ],
    );
    refused(
        &json_lines(|_, tip| tip.map(|x| 1e3 * x)),
        &["standard input:1: the median", "send positions in metres; a hand would have this in mm"],
    );
    refused(
        &json_lines(|_, [x, y, z]| [x, -y, z]),
        &["standard input:1: index to little finger", "mirrored?"],
    );
    refused(&json_lines(|_, [x, y, z]| [x, -y, z]), &["a left hand, and the robot follows a right hand"]);
    refused(
        "{\"time\": 1, \"tips\": {\"thumb\": [1, 2]}}",
        &["standard input:1: the tip \"thumb\" must be [x, y, z]"],
    );
    refused(
        "{\"time\": 1, \"tips\": {}, \"landmarks\": null}",
        &["landmarks, tips together: which is meant?"],
    );
    refused("{\"time\": 1}", &["none of \"back\""]);
    refused("{\"tips\": {}}", &["standard input:1: no number \"time\""]);
    refused("{\"time\": 0.5, \"tips\": {\"thumb\": [NaN, 0, 0]}}", &["not valid JSON", "write null"]);
    refused(
        "{\"time\": 1, \"tips\": null}\n\n{\"time\": 2, \"landmarks\": null}",
        &["standard input:3: it is of another kind"],
    );
    refused("{\"time\": 1, \"back\": null}", &["need --operator FILE"]);
    refused("{\"time\": 1, \"landmarks\": [[0, 0, 0]]}", &["must be 21 positions"]);
    refused(
        "{\"time\": 1, \"landmarks\": null, \"handedness\": \"L\"}\n{",
        &["standard input:2: not valid JSON"],
    );
    // Lines of another shape are not taken for fingers that were not measured.
    let nothing = "{\"time\": 1, \"tips\": null}\n";
    for (line, words) in [
        (
            "{\"time\": 2, \"tips\": {\"pinky\": null}}",
            "there is no tip \"pinky\": the fingers are thumb, index",
        ),
        ("{\"time\": 2, \"tips\": [[0, 0, 0]]}", "each tip must be in an object by finger"),
        ("{\"time\": 2, \"tips\": {\"thumb\": [\"1\", 0, 0]}}", "the tip \"thumb\" must be [x, y, z]"),
        ("{\"time\": \"2\", \"tips\": null}", "no number \"time\""),
    ] {
        refused(&(nothing.to_owned() + line), &["standard input:2: ", words]);
    }
    let (code, _, error) =
        run(&["--operator", "Cargo.toml"], "{\"time\": 1, \"back\": null, \"thumb\": null}");
    assert!(code == 1 && error.contains("Cargo.toml"), "{error}");
    refused("[{\"time\": 1, \"tips\": null}]", &["standard input is a JSON array: write one object a line"]);
    // Invalid settings: a folder with an invalid file, and a robot that is not a hand.
    let folder = tempfile::tempdir().unwrap();
    for name in ["robot.urdf", "controller.toml"] {
        std::fs::copy(tesaki_tests::robot_folder("hand5").join(name), folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("retargeting.toml"), "# text\nnear = 0.2\n").unwrap();
    let hand = folder.path().to_str().unwrap().to_owned();
    let tesaki = |arguments: &[&str]| feed(tesaki_tests::tesaki().args(arguments), TIPS);
    let words = "retargeting.toml:2: near is 0.2; it must be 0 to 0.1";
    let (code, _, error) = tesaki(&["retarget", "--robot", &hand, "--in", "-"]);
    assert!(code == 1 && error.contains(words), "{error}");
    let (code, out, _) = tesaki(&["model", "check", &hand]);
    assert!(code == 1 && out.contains(words), "{out}");
    let arm = tesaki_tests::robot_folder("arm7");
    let (code, _, error) = tesaki(&["retarget", "--robot", arm.to_str().unwrap(), "--in", "-"]);
    assert!(code == 1 && error.contains("arm7 is not a hand, which has two to five chains"), "{error}");
    assert!(error.contains("arm7/retargeting.toml: ") && error.contains("the file is not there"), "{error}");
    assert!(error.contains("follows = ["), "{error}");
    let (code, _, error) = tesaki(&["retarget", "--in", "-"]);
    assert!(code == 2 && error.contains("--robot"), "{error}");
}

#[test]
fn what_is_no_calibration_of_an_operator_is_told_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("operator.toml");
    for (text, words) in [
        (
            "a = 1\nhello\n",
            "operator.toml: line 2: key with no value, expected `=`; `tesaki calibrate` writes such a file",
        ),
        ("", "operator.toml: line 1: missing field"),
    ] {
        std::fs::write(&file, text).unwrap();
        let (code, _, error) = run(&["--operator", file.to_str().unwrap()], "");
        assert!(code == 1 && error.contains(words), "{error}");
    }
    let (code, _, error) = run(&["--operator", folder.path().to_str().unwrap()], "");
    assert!(
        code == 1 && error.contains("Is a directory") && error.contains("; name a file in it"),
        "{error}"
    );
}

#[test]
fn a_byte_order_mark_does_no_harm_and_the_input_is_kept() {
    let json = json_lines(|_, tip| tip);
    let (_, plain, _) = run(&[], &json);
    for input in [json, TIPS.to_owned()] {
        let (code, out, error) = run(&[], &format!("\u{feff}{input}"));
        assert_eq!(code, 0, "{error}");
        assert!(out.lines().count() == 41 && error.contains("40 frames"), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let (file, linked) = (folder.path().join("tips.csv"), folder.path().join("same.csv"));
    std::fs::write(&file, TIPS).unwrap();
    std::os::unix::fs::symlink(&file, &linked).unwrap();
    for out in [&file, &linked] {
        let mut command = tesaki_tests::tesaki();
        command.arg("retarget").arg("--robot").arg(tesaki_tests::robot_folder("hand5"));
        let (code, _, error) = feed(command.arg("--in").arg(&file).arg("--out").arg(out), "");
        assert!(code == 2 && error.contains("--in and --out are both"), "{error}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), TIPS);
    }
    // `eval fk` reads the output without a warning about its time column.
    let mut command = tesaki_tests::tesaki();
    command.args(["eval", "fk", "--in", "-", "--robot"]).arg(tesaki_tests::robot_folder("hand5"));
    let (code, _, error) = feed(&mut command, &plain);
    assert!(code == 0 && !error.contains("unused"), "{error}");
}

/// A simulated operator, calibrated by markers, moves the fingers: the robot's fingertips have the same
/// distances as the operator's. (Distances do not depend on the orientation of the hand in the glove's
/// frame.)
#[test]
fn a_calibrated_glove_moves_the_hand() {
    let folder = tempfile::tempdir().unwrap();
    let operator = folder.path().join("aiko.toml");
    let path = operator.to_str().unwrap();
    let poses = text(&table(&CalibrationPlan::FULL));
    let calibrated = feed(tesaki_tests::tesaki().args(["calibrate", "-", "--out", path]), &poses);
    assert_eq!(calibrated.0, 0, "{}", calibrated.2);
    let hand = OperatorHand::random(1);
    let motion = FingersMotion::random(&hand, 1, 1, 3, [0.8, 1.2], 1.0);
    let mut glove = Glove::new(GloveValues::default(), 1);
    let (mut lines, mut wide) = (String::new(), Vec::new());
    while let (time, sample) = glove.sample(&hand, &motion)
        && time < motion.duration()
    {
        let mut line = json!({ "time": time, "back": sample.back });
        let (_, angles) = motion.at(time);
        let mut tips = Vec::new();
        for finger in HumanFinger::ALL {
            line[finger.name()] = json!(sample.segments[finger as usize]);
            tips.push(hand.finger(finger, &angles[finger as usize]).1);
        }
        wide.push((tips[1] - tips[0]).norm());
        writeln!(lines, "{line}").unwrap();
    }
    let (code, out, error) = run(&["--operator", path], &lines);
    assert_eq!(code, 0, "{error}");
    let (code, _, wrong) = run(&["--operator", path], TIPS);
    assert!(code == 1 && wrong.contains("--operator is for a glove"), "{wrong}");
    // Forward kinematics of the angles by `eval fk`, at the end, where the operator holds still.
    let robot = tesaki_tests::robot_folder("hand5");
    let mut command = tesaki_tests::tesaki();
    command
        .args(["eval", "fk", "--in", "-", "--tip", "thumb_tip", "--tip", "index_tip", "--robot"])
        .arg(robot);
    let (code, places, evaluated) = feed(&mut command, &out);
    assert_eq!(code, 0, "{evaluated}");
    let names: Vec<&str> = places.lines().next().unwrap().split(',').collect();
    let last: Vec<f64> =
        places.lines().last().unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    let place =
        |tip: &str, axis: &str| last[names.iter().position(|name| *name == format!("{tip}.{axis}")).unwrap()];
    let square: f64 = ["x", "y", "z"]
        .map(|axis| (place("index_tip", axis) - place("thumb_tip", axis)).powi(2))
        .iter()
        .sum();
    let difference = square.sqrt() - wide.last().unwrap();
    assert!(difference.abs() < 5e-3, "{difference} m: {error}");
}

/// Returns the landmarks of a right hand with mean proportions in front of a camera, with each joint bent by
/// `bend` [rad].
fn landmarks(bend: f64) -> Vec<[f64; 3]> {
    let fingers = [
        ([0.010, 0.022, 0.020], [0.0462, 0.0316, 0.0273]),
        ([0.0, 0.025, 0.090], [0.0398, 0.0224, 0.0197]),
        ([0.0, 0.004, 0.092], [0.0446, 0.0263, 0.0214]),
        ([0.0, -0.016, 0.087], [0.0414, 0.0257, 0.0213]),
        ([0.0, -0.034, 0.078], [0.0327, 0.0181, 0.0197]),
    ];
    let mut points = vec![[0.0; 3]];
    for (finger, ([mut x, mut y, mut z], bones)) in fingers.into_iter().enumerate() {
        points.push([x, y, z]);
        for (bone, length) in (1..).zip(bones) {
            let (angle, sideways) =
                if finger == 0 { (0.5 + 0.3 * bend, 0.5) } else { (bend * f64::from(bone), 0.0) };
            let along = length / (1.0_f64 + sideways * sideways).sqrt();
            (x, y, z) = (x + along * angle.sin(), y + along * sideways, z + along * angle.cos());
            points.push([x, y, z]);
        }
    }
    // The palm faces the camera, fingers up: x to the right, y down, z away from the camera.
    points.into_iter().map(|[x, y, z]| [y, 0.08 - z, -x]).collect()
}

#[test]
fn webcam_landmarks_move_the_hand_and_a_mirrored_picture_is_told() {
    let lines = |change: &dyn Fn([f64; 3]) -> [f64; 3], label: &str| {
        let line = |frame: u32| {
            let bend = 0.4 - 0.2 * (0.1 * f64::from(frame)).cos();
            let points: Vec<[f64; 3]> = landmarks(bend).into_iter().map(change).collect();
            json!({ "time": f64::from(frame) / 30.0, "landmarks": points, "handedness": label }).to_string()
                + "\n"
        };
        (0..60).map(line).collect::<String>()
    };
    let (code, out, error) = run(&[], &lines(&|point| point, "Right"));
    assert_eq!(code, 0, "{error}");
    assert!(out.lines().count() == 61 && error.contains("60 frames"), "{error}");
    let refused = |change: &dyn Fn([f64; 3]) -> [f64; 3], label: &str, words: &str| {
        let (code, _, error) = run(&[], &lines(change, label));
        assert!(code == 1 && error.contains(words), "{words}: {error}");
    };
    let flipped = |[x, y, z]: [f64; 3]| [-x, y, z];
    refused(&flipped, "Right", "bend like those of a left hand");
    refused(&flipped, "Left", "the source calls it a left hand");
    refused(&|point| point, "Left", "but it bends like the other one");
    refused(
        &|point| point.map(|x| 100.0 * x),
        "Right",
        "send positions in metres; a hand would have this in cm",
    );
    refused(&|[x, y, z]| [x + 0.5, y + 0.5, z], "Right", "normalised image coordinates");
}

/// A table that is replayed as a live source moves the joints like the table itself.
#[test]
#[ignore = "needs Python: cargo xtask test"]
fn the_example_that_plays_a_table_writes_what_is_read() {
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let docs = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/examples/play_tips.py");
    let written = Command::new(python).args([docs, TABLE]).output().unwrap();
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    let (code, played, error) = run(&[], &String::from_utf8(written.stdout).unwrap());
    assert_eq!((code, played), (0, run(&[], TIPS).1), "{error}");
}

/// The example's line for a result in MediaPipe's format can be read by `tesaki retarget`.
#[test]
#[ignore = "needs Python: cargo xtask test"]
fn the_example_for_mediapipe_writes_what_is_read() {
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let folder = tempfile::tempdir().unwrap();
    let mut compile = Command::new(&python);
    compile.args(["-m", "py_compile", EXAMPLE]).env("PYTHONPYCACHEPREFIX", folder.path());
    assert!(compile.status().unwrap().success());
    let program = "import json, runpy, sys
from types import SimpleNamespace as Of
line = runpy.run_path(sys.argv[1])['line']
points = [Of(x=x, y=y, z=z) for x, y, z in json.loads(sys.argv[2])]
hand = Of(hand_world_landmarks=[points], handedness=[[Of(category_name='Right', score=0.9)]])
for frame in range(20):
    print(line(100.0 + frame / 30, hand if frame != 7 else Of(hand_world_landmarks=[], handedness=[])))
";
    let points = json!(landmarks(0.3)).to_string();
    let written = Command::new(&python).args(["-c", program, EXAMPLE, &points]).output().unwrap();
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    let (code, out, error) = run(&[], &String::from_utf8(written.stdout).unwrap());
    assert!(code == 0 && out.lines().count() == 21 && error.contains("20 frames"), "{error}");
}
