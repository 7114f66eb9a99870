//! The MCAP recording of a run, read by another program: rosbags, in Python.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::process::{Command, Output};

/// Returns the number of rows and the last true angles of a table from the run, as `(joint, angle)`.
fn table(path: &Path) -> (usize, Vec<(String, f64)>) {
    let text = std::fs::read_to_string(path).unwrap();
    let mut rows = text.lines();
    let header = rows.next().unwrap().split(',');
    let last = rows.next_back().unwrap().split(',');
    let joint = |(name, value): (&str, &str)| {
        Some((name.strip_suffix(" true angle [rad]")?.to_owned(), value.parse().unwrap()))
    };
    (text.lines().count() - 1, header.zip(last).filter_map(joint).collect())
}

fn read(recording: &Path, ticks: u64, references: usize, joints: &[(String, f64)]) -> Output {
    let python = std::env::var_os("TESAKI_PYTHON").unwrap_or_else(|| "python3".into());
    let mut script = Command::new(python);
    script.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/oracles/read_mcap.py"));
    script.arg(recording).arg("--frames");
    script.args(["--count", "/robot_description=1", "--count", &format!("/tesaki/reference={references}")]);
    script.args(["--count", &format!("/joint_states={ticks}"), "--count", &format!("/tf={ticks}")]);
    for (name, angle) in joints {
        script.args(["--joint", &format!("{name}={angle:?}")]);
    }
    script.output().unwrap()
}

#[test]
#[ignore = "needs Python with rosbags: cargo xtask test"]
fn rosbags_reads_what_the_tables_say() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let run = ["run", "hand3-servo", "--duration", "32", "--json", "--out", out];
    let run = Command::new(env!("CARGO_BIN_EXE_host-sim")).args(run).output().unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let ticks = summary["ticks"].as_u64().unwrap();
    let files = folder.path().join("hand3-servo");
    let (rows, mut joints) = table(&files.join("observer_paper_friction.csv"));
    assert_eq!((joints.len(), joints[0].0.as_str()), (9, "finger1_swing"));

    let recording = files.join("recording.mcap");
    let output = read(&recording, ticks, 4 * rows, &joints);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("12 links"), "{said}");

    // A wrong value must be detected.
    joints[4].1 += 1e-5;
    let output = read(&recording, ticks + 1, 4 * rows, &joints);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("/tf: ") && said.contains("finger2_bend ends at"), "{said}");
}
