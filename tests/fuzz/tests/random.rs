//! The properties that the targets check hold for any bytes: unguided inputs, the same ones each time.

use std::collections::BTreeMap;
use std::path::Path;

use tesaki_fuzz::random::Inputs;
use tesaki_fuzz::{TARGETS, Target, reached};

fn target(name: &str) -> &'static Target {
    TARGETS.iter().find(|target| target.name == name).unwrap_or_else(|| panic!("no target {name}"))
}

/// Calls `run` with `count` inputs of a target; saves the one that fails.
fn feed(name: &str, count: usize, mut run: impl FnMut(&[u8])) {
    for (index, input) in Inputs::new(target(name)).take(count).enumerate() {
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(&input)));
        if result.is_err() {
            let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{index}"));
            std::fs::write(&file, &input).expect("the folder takes files");
            panic!("{name} panics with input {index}, which is now {}", file.display());
        }
    }
}

fn feed_target(name: &str, count: usize) {
    feed(name, count, target(name).run);
}

#[test]
fn codec() {
    feed_target("codec", 300_000);
}

/// Runs in which everything is refused would show nothing, so they must reach every phase of a grasp, contact
/// and deviation.
#[test]
fn node() {
    let mut seen = BTreeMap::<String, u32>::new();
    feed("node", 10_000, |input| {
        for name in reached(input) {
            *seen.entry(name).or_default() += 1;
        }
    });
    println!("{seen:?}");
    let phases = ["Ready", "Approach", "Touch", "Squeeze", "ProbeFriction", "Hold", "Move", "Lower", "Open"];
    let arm = ["contact", "free", "ToolPositionError", "ToolOrientationError"];
    for name in phases.iter().chain(&arm) {
        assert!(seen.contains_key(*name), "{name} is not in {seen:?}");
    }
}

#[test]
fn robot() {
    feed_target("robot", 10_000);
}

#[test]
fn files() {
    feed_target("files", 30_000);
}

#[test]
fn recording() {
    feed_target("recording", 100_000);
}
