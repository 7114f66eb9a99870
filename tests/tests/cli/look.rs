//! `tesaki look` without a board: its sources of pictures.

use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixListener;
use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::Signal;
use serde_json::Value;

use super::server::{finish, said, signal};

/// A black disc on white as a binary PGM.
fn disc(age: &str, [x, y]: [f64; 2]) -> Vec<u8> {
    let mut bytes = format!("P5\n{age}256 240\n255\n").into_bytes();
    for row in 0..240 {
        let away = |column: i32| (f64::from(column) - x).hypot(f64::from(row) - y) - 30.0;
        bytes.extend((0..256).map(|column| if away(column) < 0.0 { 40 } else { 200 }));
    }
    bytes
}

fn look(arguments: &[&str], input: &[u8]) -> (i32, String) {
    let mut command: Command = tesaki_tests::tesaki();
    command.arg("--json").arg("look").args(arguments);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_owned();
    let writer = std::thread::spawn(move || drop(stdin.write_all(&input)));
    let end = said(&finish(child));
    writer.join().unwrap();
    end
}

/// Returns the centre of the circle in a line.
fn center(line: &str) -> [f64; 2] {
    let value: Value = serde_json::from_str(line).unwrap();
    [0, 1].map(|axis| value["circle"]["center"][axis].as_f64().unwrap_or(f64::NAN))
}

#[test]
fn the_last_picture_of_a_stream_is_always_looked_at() {
    let stream = [disc("", [90.0, 110.0]), disc("# age 0.2\n", [150.0, 120.0])].concat();
    let (code, text) = look(&[], &stream);
    assert_eq!(code, 0, "{text}");
    let [x, y] = center(text.lines().last().unwrap());
    assert!((x - 150.0).abs() < 0.5 && (y - 120.0).abs() < 0.5, "{text}");
}

#[test]
fn files_are_looked_at_one_by_one_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    for (name, x) in [("p-10.pgm", 150.0), ("p-9.pgm", 90.0), ("p-11.pgm", 120.0)] {
        std::fs::write(folder.path().join(name), disc("", [x, 110.0])).unwrap();
    }
    std::fs::write(folder.path().join("notes.txt"), "no picture").unwrap();
    let source = format!("files:{}", folder.path().display());
    let (code, text) = look(&["--from", &source, "--rate", "100"], b"");
    let places: Vec<f64> = text.lines().map(|line| center(line)[0].round()).collect();
    assert!(code == 0 && places == [90.0, 150.0, 120.0], "{code}: {text}");
}

/// A picture that is too old, because of camera or vision, is not passed on as an invalid line.
#[test]
fn a_picture_that_is_too_old_is_not_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("circles");
    let behaviour = UnixListener::bind(&path).unwrap();
    let heard = std::thread::spawn(move || {
        let (stream, _) = behaviour.accept().unwrap();
        let lines = BufReader::new(stream).lines();
        lines.map_while(Result::ok).collect::<Vec<_>>()
    });
    let stream = [disc("# age 1.2\n", [90.0, 110.0]), disc("# age 0.1\n", [150.0, 120.0])];
    let to = format!("unix://{}", path.display());
    let mut child = tesaki_tests::tesaki()
        .args(["--json", "look", "--to", &to])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    // The first picture has been processed before the second replaces it.
    for picture in stream {
        stdin.write_all(&picture).unwrap();
        std::thread::sleep(Duration::from_millis(500));
    }
    drop(stdin);
    let (code, text) = said(&finish(child));
    assert!(code == 0 && text.contains("\"skipped\":1"), "{code}: {text}");
    let ages: Vec<f64> = { heard.join().unwrap() }
        .iter()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["age"].as_f64().unwrap())
        .collect();
    assert!(!ages.is_empty() && ages.iter().all(|age| *age <= 1.0), "{ages:?}");
}

#[test]
fn a_bad_source_is_named() {
    let good = disc("", [90.0, 110.0]);
    for (arguments, input, words) in [
        (&[][..], &good[..1000], "of 61440 grey levels"),
        (&["--axis", "10,10,5"], b"P5 0 0 255\n", "PGM: 0 × 0 pixels: the picture is empty"),
        (&[], b"\x89PNG\r\n\x1a\n", "not the beginning of a binary PGM picture"),
        (&["--from", "camera:/dev/null"], b"", "/dev/null: it is not a camera"),
        (&["--from", "camera:/dev/no-video"], b"", "/dev/no-video: No such file"),
        (&["--from", "files:/no/such.png"], b"", "/no/such.png: No such file"),
        (&["--from", "/dev"], b"", "is not a source (did you mean files:/dev?): expected -"),
        (&["--from", "/dev/null"], b"", "is not a source (did you mean camera:/dev/null?): expected -"),
        (&["--from", "/dev/video0"], b"", "is not a source: expected -, unix://PATH"),
        (&["--delay", "-1"], b"", "from 0 to 1 s"),
    ] {
        let (code, text) = look(arguments, input);
        assert!((code == 1 || code == 2) && text.contains(words), "{arguments:?}: {code}: {text}");
    }
}

#[test]
fn a_camera_that_is_not_there_yet_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let source = format!("unix://{}", folder.path().join("camera").display());
    let mut command = tesaki_tests::tesaki();
    command.args(["look", "--from", &source]).stdin(Stdio::null());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    signal(&child, Signal::SIGINT);
    let (code, text) = said(&finish(child));
    assert!(
        code == 0 && text.contains("No such file or directory (os error 2); it is tried again"),
        "{text}"
    );
    assert_eq!(text.matches("it is tried again").count(), 1, "{text}");
}
