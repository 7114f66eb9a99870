//! `tesaki eval` against other libraries' numbers, and what it says about tables and robots that do not fit.
#![cfg(all(unix, feature = "cli"))]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

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

/// Exit code, standard output, standard error of `tesaki`, which reads `input`.
fn tesaki(arguments: &[&str], input: &str) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tesaki"));
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_owned();
    // A program that ends without reading its input is right to do so.
    let writer = std::thread::spawn(move || drop(stdin.write_all(input.as_bytes())));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

#[track_caller]
fn eval(what: &str, robot: &str, tips: &[&str], input: &str) -> (String, String) {
    let mut arguments = vec!["eval", what, "--robot", robot, "--in", "-"];
    arguments.extend(tips.iter().flat_map(|tip| ["--tip", tip]));
    let (code, out, err) = tesaki(&arguments, input);
    assert_eq!(code, 0, "{arguments:?}: {err}");
    (out, err)
}

/// Columns by name.
fn columns(text: &str) -> BTreeMap<String, Vec<String>> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let column = |index: usize| rows.iter().map(|row: &Vec<&str>| row[index].to_owned()).collect();
    names.iter().enumerate().map(|(index, name)| ((*name).to_owned(), column(index))).collect()
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
