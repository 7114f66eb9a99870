//! Arbitrary bytes into the codec, arbitrary requests in arbitrary orders into the node. Some seconds in the
//! checks; `TESAKI_FUZZ_SECONDS=1800 cargo test --release -p tesaki-tests --test fuzz -- --nocapture` for
//! longer. The seed of a failure is in its message; `TESAKI_FUZZ_SEED` repeats it.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_precision_loss,
    reason = "tests"
)]

mod arm;
mod codec;
mod files;
mod hand;
mod node;
mod random;
mod requests;
mod rig;

use std::time::{Duration, Instant};

use tesaki::model::RobotModel;
use tesaki::task::grasping::GraspPlan;
use tesaki_tests::{robot, robot_folder};

/// Runs `body` with seed after seed: `runs` of them, the same ones on every machine, or new ones for as long
/// as asked. Returns how many it were.
fn fuzz(name: &str, runs: u64, body: impl Fn(u64)) -> u64 {
    let number = |variable: &str| std::env::var(variable).ok().and_then(|text| text.parse::<u64>().ok());
    if let Some(seed) = number("TESAKI_FUZZ_SEED") {
        body(seed);
        return 1;
    }
    let Some(seconds) = number("TESAKI_FUZZ_SECONDS") else {
        (0..runs).for_each(body);
        return runs;
    };
    let (start, duration) = (Instant::now(), Duration::from_secs(seconds));
    let first = u64::from(std::process::id()) << 32;
    let mut seed = first;
    while start.elapsed() < duration {
        body(seed);
        seed += 1;
    }
    println!("{name}: {} runs from seed {first}", seed - first);
    seed - first
}

fn box_plan() -> GraspPlan {
    tesaki_description::grasp::load(&robot_folder("hand3").join("grasps/box.toml")).unwrap()
}

fn model() -> RobotModel {
    robot("hand3").model
}
