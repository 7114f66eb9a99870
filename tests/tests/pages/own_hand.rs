//! docs/bring-your-own-hand.md: its files make a robot, its commands print what it shows, and a simulated
//! board runs it.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;

use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{Drive, Plant, PlantOptions, PlantValues};
use tesaki_sim::serve::serve;
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::port::Address;

const PAGE: &str = include_str!("../../docs/bring-your-own-hand.md");

/// The page's command that writes the settings.
const INIT: &str = "tesaki model init my_finger/robot.urdf --motor maxon-16mm";

/// The folder with the page's files, and one with the mistakes that it speaks of.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("my_finger")).unwrap();
    let files = ["my_finger/robot.urdf", "states.csv", "targets.csv", "motions.csv", "grasps.csv"];
    for name in files {
        let (_, rest) = PAGE.split_once(&format!("\n`{name}`:\n\n```")).unwrap_or_else(|| panic!("{name}"));
        let (_, rest) = rest.split_once('\n').unwrap();
        let (text, _) = rest.split_once("```").unwrap();
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    assert!(PAGE.contains(&format!("$ {INIT}\n")));
    run(folder.path(), &format!("{INIT} --out bad_finger"));
    for (name, from, to) in [
        ("robot.urdf", "lower=\"0\" upper=\"1.8\"", "lower=\"0\" upper=\"100\""),
        ("robot.urdf", "<mass value=\"0.015\"/>", "<mass value=\"1500\"/>"),
        ("controller.toml", "torque_rate", "torque_rat"),
    ] {
        let file = folder.path().join("bad_finger").join(name);
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.contains(from));
        std::fs::write(file, text.replacen(from, to, 1)).unwrap();
    }
    folder
}

/// Runs a command of the page; what it prints.
fn run(folder: &Path, command: &str) -> String {
    let mut words = command.split(' ');
    if words.next() == Some("cat") {
        return std::fs::read_to_string(folder.join(words.next().unwrap())).unwrap_or_default();
    }
    let output = tesaki_tests::tesaki().current_dir(folder).args(words).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

/// Whether two words mean the same: numbers may differ in their last digits, counts of iterations somewhat.
fn alike(left: &str, right: &str) -> bool {
    match (left.parse::<f64>(), right.parse::<f64>()) {
        _ if left == right => true,
        (Ok(left), Ok(right)) if left.fract() == 0.0 && left > 100.0 => right > 100.0,
        (Ok(left), Ok(right)) if left.fract() == 0.0 && right.fract() == 0.0 => (left - right).abs() <= 5.0,
        (Ok(left), Ok(right)) => (left - right).abs() < 1e-4,
        _ => false,
    }
}

#[test]
fn the_commands_of_the_page_print_what_it_shows() {
    let folder = folder();
    let mut page = PAGE.to_owned();
    let mut differs = false;
    for block in PAGE.split("```console\n").skip(1) {
        let (block, _) = block.split_once("```").unwrap();
        let mut run_now = String::new();
        for command in block.lines().filter_map(|line| line.strip_prefix("$ ")) {
            run_now += &format!("$ {command}\n{}", run(folder.path(), command));
        }
        let separators = |c: char| c.is_whitespace() || c == ',';
        let (shown, got): (Vec<_>, Vec<_>) =
            (block.split(separators).collect(), run_now.split(separators).collect());
        if shown.len() != got.len() || !shown.iter().zip(&got).all(|(shown, got)| alike(shown, got)) {
            differs = true;
            page = page.replacen(block, &run_now, 1);
        }
    }
    if differs {
        let should_be = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bring-your-own-hand.md");
        std::fs::write(&should_be, page).unwrap();
        panic!("docs/bring-your-own-hand.md shows other output than {}", should_be.display());
    }
}

#[test]
fn a_simulated_board_runs_the_finger_of_the_page() {
    let folder = folder();
    run(folder.path(), INIT);
    let path = folder.path().join("my_finger");
    let robot = RobotFolder::load(&path).unwrap();
    let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
    let values = PlantValues::load(&path).unwrap();
    let mut plant = Plant::new(&robot.urdf, &drives, &values, &PlantOptions::mismatched(1)).unwrap();
    let mut hub = Hub::listen(&Address::Unix(folder.path().join("board"))).unwrap();
    let address = hub.address().to_string();
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let (_keep, lines) = channel();
    let server = std::thread::spawn(move || {
        let mut board = VirtualBoard::default();
        let stop = || flag.load(Ordering::Relaxed);
        serve(&mut hub, &mut board, &mut plant, &robot.model, &lines, &stop).unwrap();
    });
    let run = |arguments: &str| {
        let mut command = tesaki_tests::tesaki();
        command.current_dir(folder.path()).args(["--port", &address, "--non-interactive"]);
        command.args(arguments.split(' '));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
    };
    run("model push my_finger");
    run("home bend=0 curl=0.18");
    // A busy machine may be late with its commands.
    run("set safety.command_timeout 1");
    run("move bend=0.6");
    stop.store(true, Ordering::Relaxed);
    server.join().unwrap();
}
