//! Every initial, kept or once crashing input of a target runs without a panic.

use tesaki_fuzz::{TARGETS, Target, corpus};

/// Runs all inputs of a target; names the one that fails.
fn replay(name: &str) {
    let target =
        TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| panic!("no target {name}"));
    let kept = corpus::kept(target);
    assert!(!kept.is_empty(), "{name} has no corpus: `cargo xtask fuzz {name} --record`");
    let crashes = corpus::crashes(target);
    for (crash, input) in &crashes {
        run(target, crash, input);
    }
    for (index, input) in (target.seeds)().iter().enumerate() {
        run(target, &format!("input {index} of those to begin with"), input);
    }
    for (index, input) in kept.iter().enumerate() {
        run(target, &format!("input {index} of its corpus"), input);
    }
    println!("{name}: {} inputs, {} of past crashes", kept.len(), crashes.len());
}

fn run(target: &Target, name: &str, input: &[u8]) {
    let result = std::panic::catch_unwind(|| (target.run)(input));
    assert!(result.is_ok(), "{} panics with {name}", target.name);
}

#[test]
fn codec() {
    replay("codec");
}

#[test]
fn node() {
    replay("node");
}

#[test]
fn robot() {
    replay("robot");
}

#[test]
fn files() {
    replay("files");
}

#[test]
fn recording() {
    replay("recording");
}
