//! The pages whose commands a reader types: every command in them is run as written, with both kinds of
//! board, and must print what the page shows.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

mod board;
mod own_hand;
mod page;
mod reader;
mod understood;

use std::sync::Mutex;

use board::Kind;
use reader::Reader;
use tempfile::TempDir;

const README: &str = include_str!("../../../README.md");
const FIND_CIRCLE: &str = include_str!("../../../docs/find-circle.md");
const HAND_EYE: &str = include_str!("../../../docs/hand-eye.md");
const SUPERVISOR: &str = include_str!("../../../docs/supervisor.md");
const OPERATOR_HAND: &str = include_str!("../../../docs/operator-hand.md");
const TELEOPERATION: &str = include_str!("../../../docs/teleoperation.md");
const VISUAL_APPROACH: &str = include_str!("../../../docs/visual-approach.md");

/// The part of a reader: its page, a function that creates the folder, and the commands.
type Part = (&'static str, fn() -> TempDir, Vec<page::Step>);

/// Creates the folder for bring-your-own-hand, as at the start of its page.
fn own_hand_folder() -> TempDir {
    let folder = own_hand::folder();
    own_hand::run(folder.path(), own_hand::INIT);
    folder
}

/// Sections that start their own board run in parallel with the others, which share the first board.
fn every_command_runs(kind: Kind) {
    // Its commands with shown output have a separate test.
    let of_own_hand = page::steps(own_hand::PAGE).into_iter().filter(|step| step.shown.is_none()).collect();
    let mut parts: Vec<Part> = vec![("docs/bring-your-own-hand.md", own_hand_folder, of_own_hand)];
    for (name, text) in [
        ("README.md", README),
        ("docs/supervisor.md", SUPERVISOR),
        ("docs/operator-hand.md", OPERATOR_HAND),
        ("docs/teleoperation.md", TELEOPERATION),
        ("docs/visual-approach.md", VISUAL_APPROACH),
        ("docs/find-circle.md", FIND_CIRCLE),
        ("docs/hand-eye.md", HAND_EYE),
    ] {
        for steps in reader::split(page::steps(text)) {
            parts.push((name, reader::folder, steps));
        }
    }
    // An emulated board occupies a core.
    let at_once = if kind == Kind::Native { 4 } else { 2 };
    let (parts, failures) = (Mutex::new(parts), Mutex::new(Vec::new()));
    let read = || {
        loop {
            let part = parts.lock().unwrap().pop();
            let Some((name, folder, steps)) = part else { break };
            let read = || Reader::new(name, folder(), steps.clone()).read(kind);
            let mut found = read();
            // In about one of dozens of runs, an emulated board stops answering for seconds, for an unknown
            // reason.
            if kind == Kind::Qemu && found.iter().any(|failure| failure.contains("no answer from the board"))
            {
                println!("once more, with another board:\n{}", found.join("\n"));
                found = read();
            }
            failures.lock().unwrap().extend(found);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(read);
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_command_of_the_pages_runs_on_the_native_board() {
    every_command_runs(Kind::Native);
}

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn every_command_of_the_pages_runs_on_the_image() {
    every_command_runs(Kind::Qemu);
}

/// Otherwise an entry for a command that was removed from the pages would go unnoticed.
#[test]
fn every_exception_is_about_a_command_of_a_page() {
    let steps: Vec<_> =
        [README, SUPERVISOR, OPERATOR_HAND, TELEOPERATION, VISUAL_APPROACH, FIND_CIRCLE, HAND_EYE]
            .into_iter()
            .flat_map(page::steps)
            .collect();
    assert!(steps.len() >= 40, "only {} commands found", steps.len());
    for command in reader::exceptions() {
        assert!(steps.iter().any(|step| step.command == command), "no page has `{command}`");
    }
}
