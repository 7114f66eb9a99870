//! docs/bring-your-own-hand.md: its files make up a robot, and its commands print what it shows.

use std::path::Path;

pub const PAGE: &str = include_str!("../../../docs/bring-your-own-hand.md");

/// The page's command that writes the settings.
pub const INIT: &str = "tesaki model init my_finger/robot.urdf --motor maxon-16mm";

/// Creates the folder with the page's files, and one with the mistakes that it mentions.
pub fn folder() -> tempfile::TempDir {
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

/// Runs a command of the page; returns its output.
pub fn run(folder: &Path, command: &str) -> String {
    let mut words = command.split(' ');
    if words.next() == Some("cat") {
        return std::fs::read_to_string(folder.join(words.next().unwrap())).unwrap_or_default();
    }
    let output = tesaki_tests::tesaki().current_dir(folder).args(words).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

/// Returns whether two words are equivalent: numbers may differ in their last digits, and iteration counts
/// slightly.
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
