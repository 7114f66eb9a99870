//! `tesaki calibrate`: the links of an operator's fingers, from a table and from a stream.

use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::Stdio;

use serde_json::{Value, json};
use tesaki::teleop::{GloveSample, HUMAN_FINGERS, HumanFinger, HumanHand};
use tesaki_sim::operator::calibration_trial::{CalibrationPlan, postures, touches};
use tesaki_sim::operator::{FingersMotion, Glove, GloveValues, OperatorHand};

use super::feed::feed;

/// Runs the command; returns exit code, standard output and standard error.
fn run(folder: &Path, arguments: &[&str], input: &str) -> (i32, String, String) {
    feed(tesaki_tests::tesaki().arg("calibrate").args(arguments).current_dir(folder), input)
}

/// Returns the table of a simulated operator's postures: header and rows of cells.
pub fn table(plan: &CalibrationPlan) -> Vec<Vec<String>> {
    let mut header: Vec<String> = ["qx", "qy", "qz", "qw"].map(|part| format!("back_{part}")).to_vec();
    for finger in HumanFinger::ALL.map(HumanFinger::name) {
        for segment in 1..=3 {
            header.extend(["qx", "qy", "qz", "qw"].map(|part| format!("{finger}{segment}_{part}")));
        }
    }
    header.extend(
        HumanFinger::ALL
            .iter()
            .flat_map(|finger| ["x", "y", "z"].map(|axis| format!("{}_{axis}", finger.name()))),
    );
    header.push("touch".to_owned());
    let mut table = vec![header];
    let values = GloveValues::default();
    let postures =
        postures(plan, values, 1).0.into_iter().map(|posture| (posture.orientations, posture.markers, ""));
    let touches = touches(plan, values, 1).0.into_iter();
    let touches = touches.map(|(finger, orientations)| (orientations, [None; HUMAN_FINGERS], finger.name()));
    for (GloveSample { back, segments }, markers, touch) in postures.chain(touches) {
        let mut row = Vec::new();
        for quaternion in std::iter::once(&back).chain(segments.iter().flatten()) {
            row.extend(quaternion.unwrap().map(|component| component.to_string()));
        }
        for marker in markers {
            row.extend(marker.map_or([const { String::new() }; 3], |marker| marker.map(|x| x.to_string())));
        }
        row.push(touch.to_owned());
        table.push(row);
    }
    table
}

pub fn text(table: &[Vec<String>]) -> String {
    table.iter().fold(String::new(), |text, row| text + &row.join(",") + "\n")
}

#[test]
fn a_table_of_postures_becomes_a_calibration_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    std::fs::write(path.join("postures.csv"), text(&table(&CalibrationPlan::FULL))).unwrap();
    let (code, out, error) = run(path, &["postures.csv", "--name", "Aiko \"A\"", "--out", "aiko.toml"], "");
    assert_eq!(code, 0, "{out}{error}");
    assert!(out.contains("index") && out.contains("written to aiko.toml"), "{out}");
    let file = std::fs::read_to_string(path.join("aiko.toml")).unwrap();
    let file: tesaki_supervisor::operator::OperatorFile = toml::from_str(&file).unwrap();
    assert_eq!(file.operator, "Aiko \"A\"");
    HumanHand::try_new(file.links()).unwrap();
    assert!(file.thumb.postures > 40 && file.thumb.tip_deviation < 2e-3);
    // The same from standard input, with JSON output.
    let (code, out, _) =
        run(path, &["-", "--json", "--out", "aiko.toml"], &text(&table(&CalibrationPlan::FULL)));
    let value: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &value["postures"], &value["fingers"]["index"]["rank"]), (0, &json!(61), &json!(10)));
}

#[test]
fn fingers_without_markers_need_the_proportions() {
    let folder = tempfile::tempdir().unwrap();
    let postures = text(&table(&CalibrationPlan::QUICK));
    let (code, _, error) = run(folder.path(), &["-"], &postures);
    assert_eq!(code, 1);
    assert!(error.contains("0 postures show the marker of the middle finger"), "{error}");
    assert!(error.contains("--proportions"), "{error}");
    assert!(!folder.path().join("operator.toml").exists(), "nothing is written");
    let (code, out, _) = run(folder.path(), &["-", "--proportions"], &postures);
    assert_eq!(code, 0);
    assert!(out.contains("by proportions"), "{out}");
}

#[test]
fn what_is_wrong_with_a_table_is_said_by_row_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let good = table(&CalibrationPlan::FULL);
    let column = |name: &str| good[0].iter().position(|header| header == name).unwrap();
    let refused = |change: &dyn Fn(&mut Vec<Vec<String>>), words: &[&str]| {
        let mut table = good.clone();
        change(&mut table);
        let (code, _, error) = run(folder.path(), &["-"], &text(&table));
        assert_eq!(code, 1, "{error}");
        words.iter().for_each(|words| assert!(error.contains(words), "{words}: {error}"));
    };
    refused(&|table| table[3][column("ring2_qy")] = "x".to_owned(), &["standard input:4: column ring2_qy"]);
    refused(&|table| table[3][column("ring2_qy")] = "nan".to_owned(), &["standard input:4: column ring2_qy"]);
    refused(
        &|table| {
            (column("back_qx")..=column("back_qw")).for_each(|column| table[5][column] = "0.7".to_owned())
        },
        &["standard input:6: the orientation of the back of the hand is a quaternion of norm 1.4", "the row"],
    );
    refused(
        &|table| (column("thumb3_qx")..=column("thumb3_qw")).for_each(|column| table[2][column].clear()),
        &["standard input:3: no orientation of segment 3 of the thumb"],
    );
    refused(
        &|table| table[2][column("thumb_x")] = "90".to_owned(),
        &["standard input:3: the marker of the thumb", "metres"],
    );
    refused(&|table| table[0][column("little1_qw")] = "x".to_owned(), &["no column little1_qw"]);
    refused(
        &|table| table[9][column("touch")] = "pinky".to_owned(),
        &["standard input:10: column touch: \"pinky\""],
    );
    refused(&|table| table.truncate(4), &["postures show the marker", "at least 4"]);
    refused(
        &|table| (2..62).for_each(|row| table[row] = table[1].clone()),
        &["all postures of the thumb are alike"],
    );
    refused(
        &|table| {
            for row in &mut table[1..] {
                (0..3).for_each(|axis| row.swap(column("index_x") + axis, column("ring_x") + axis));
            }
        },
        &["the orientations of the index finger fit the marker of the ring finger", "swapped"],
    );
}

#[test]
fn a_stream_is_led_through_the_postures() {
    let hand = OperatorHand::random(1);
    let motion = FingersMotion::random(&hand, 1, 0, 40, [0.8, 1.2], 1.3);
    let mut glove = Glove::new(GloveValues::default(), 1);
    let mut lines = String::new();
    while let (time, sample) = glove.sample(&hand, &motion)
        && time < motion.duration()
    {
        let (_, angles) = motion.at(time);
        let mut line = json!({ "time": time, "back": sample.back, "markers": {} });
        for finger in HumanFinger::ALL {
            let number = finger as usize;
            line[finger.name()] = json!(sample.segments[number]);
            let tip: [f64; 3] = hand.finger(finger, &angles[number]).1.into();
            line["markers"][finger.name()] = json!(tip);
        }
        writeln!(lines, "{line}").unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let (code, out, error) = run(folder.path(), &["--live"], &lines);
    assert_eq!(code, 0, "{out}{error}");
    assert!(error.contains("Posture 1: hold the hand flat"), "{error}");
    assert!(error.contains("Posture 2: spread the fingers"), "{error}");
    assert!(folder.path().join("operator.toml").exists());
    // The default file name does not overwrite a calibration.
    let (code, _, error) = run(folder.path(), &["--live"], &lines);
    assert!(code == 2 && error.contains("operator.toml exists"), "{error}");
    let (code, out, _) = run(folder.path(), &["--live", "--json", "--out", "operator.toml"], &lines);
    assert_eq!(code, 0);
    let events: Vec<Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(events.len() > 12 && events[1]["postures"] == 1, "{out}");
    // A noise in the unit of its option.
    for (arguments, words) in [
        (["--marker-noise", "NaN"], "\"NaN\": expected 0.001 to 10 mm"),
        (["--orientation-noise", "30"], "\"30\": expected 0 to 11 °"),
    ] {
        let (code, _, error) = run(folder.path(), &[&["--live"], &arguments[..]].concat(), "");
        assert!(code == 2 && error.contains(words), "{error}");
    }
    // A stream that stops, and one that is invalid.
    let (code, _, error) = run(
        folder.path(),
        &["--live", "--out", "other.toml"],
        lines[..lines.len() / 50].rsplit_once('\n').unwrap().0,
    );
    assert!(code == 1 && error.contains("not calibrated"), "{error}");
    let (code, _, error) =
        run(folder.path(), &["--live", "--out", "other.toml"], "{\"time\": 1.0, \"back\": [1, 2]}\n");
    assert!(
        code == 1
            && error
                .contains("no valid sample any more; the last error: line 1: \"back\" must be a quaternion"),
        "{error}"
    );
    // Truncated lines and invalid orientations are dropped, so that a person's work is not lost.
    let damaged: String =
        (1..).zip(lines.lines()).fold(String::new(), |text, (number, line)| match number % 50 {
            20 => text + &line[..line.len() / 2] + "\n",
            40 => {
                let mut value: Value = serde_json::from_str(line).unwrap();
                value["back"] = json!([0.9, 0.9, 0.9, 0.9]);
                text + &format!("{value}\n")
            }
            _ => text + line + "\n",
        });
    let (code, out, error) = run(folder.path(), &["--live", "--out", "other.toml"], &damaged);
    assert_eq!(code, 0, "{out}{error}");
    assert!(error.contains("Dropped: line 20: not valid JSON"), "{error}");
    assert!(
        error.contains(
            "Dropped: line 40: the orientation of the back of the hand is a quaternion of norm 1.8"
        )
    );
    // What cannot become a posture is told at once.
    let changed = |step: usize, change: &dyn Fn(&mut Value)| {
        lines.lines().step_by(step).fold(String::new(), |text, line| {
            let mut value: Value = serde_json::from_str(line).unwrap();
            change(&mut value);
            text + &format!("{value}\n")
        })
    };
    let milliseconds = changed(1, &|value| value["time"] = json!(1e3 * value["time"].as_f64().unwrap()));
    let misspelt = changed(1, &|value| value["marker"] = value["markers"].take());
    let without = changed(1, &|value| value["markers"] = Value::Null);
    for (lines, words) in [
        (milliseconds, "No posture can be found: each sample is 10 s after the one before by its time"),
        (changed(14, &|_| {}), "samples came in a second, at least 10 are needed"),
        (misspelt, "there is no key \"marker\": the keys are time, back, markers, thumb"),
        (without, "A posture without a marker: give \"markers\""),
    ] {
        let (code, _, error) = run(folder.path(), &["--live", "--out", "other.toml"], &lines);
        assert!(code == 1 && error.contains(words), "{words}: {error}");
    }
}

/// It waits for a silent glove, and reports that.
#[test]
fn a_silent_glove_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = tesaki_tests::tesaki()
        .args(["calibrate", "--live"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let stdin = child.stdin.take().unwrap();
    let error = BufReader::new(child.stderr.take().unwrap());
    let told =
        error.lines().map(Result::unwrap).any(|line| line.contains("Nothing comes from standard input"));
    assert!(told);
    drop(stdin);
    assert_eq!(child.wait().unwrap().code(), Some(1));
}

#[test]
fn a_file_that_cannot_be_written_is_told_before_the_first_posture() {
    let folder = tempfile::tempdir().unwrap();
    let (code, out, error) = run(folder.path(), &["--live", "--out", "none/operator.toml"], "");
    assert!(code == 1 && out.is_empty(), "{code}: {out}{error}");
    assert!(error.contains("none/operator.toml") && !error.contains("No posture yet"), "{error}");
    std::fs::write(folder.path().join("robot.urdf"), "<robot/>").unwrap();
    let (code, _, error) = run(folder.path(), &["--live", "--out", "robot.urdf"], "");
    assert!(code == 2 && error.contains("robot.urdf exists, and is no calibration"), "{error}");
}
