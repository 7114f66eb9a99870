//! Arbitrary bytes into the codec, arbitrary requests in arbitrary orders into the node. Five seconds in the
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

/// Runs `body` with seed after seed for as long as asked.
fn fuzz(name: &str, body: impl Fn(u64)) {
    let number = |variable: &str| std::env::var(variable).ok().and_then(|text| text.parse::<u64>().ok());
    if let Some(seed) = number("TESAKI_FUZZ_SEED") {
        return body(seed);
    }
    let duration = Duration::from_secs(number("TESAKI_FUZZ_SECONDS").unwrap_or(5));
    let start = Instant::now();
    // The short run takes the same seeds each time; the long one goes on where no other has been.
    let mut seed =
        if number("TESAKI_FUZZ_SECONDS").is_some() { u64::from(std::process::id()) << 32 } else { 0 };
    let first = seed;
    while start.elapsed() < duration {
        body(seed);
        seed += 1;
    }
    println!("{name}: {} runs from seed {first}", seed - first);
}

fn box_plan() -> GraspPlan {
    tesaki_description::grasp::load(&robot_folder("hand3").join("grasps/box.toml")).unwrap()
}

fn model() -> RobotModel {
    robot("hand3").model
}
