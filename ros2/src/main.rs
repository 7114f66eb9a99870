//! `tesaki-ros2`: a tesaki board as a ROS 2 node over DDS, without ROS installed.

mod action;
mod args;
mod controller;
mod dds;
mod messages;
mod node;
mod requests;
mod service;
mod session;
mod tolerances;
mod trajectory;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Parser as _;
use tesaki_supervisor::output_queue;

use args::Options;
use node::Node;
use session::{Failure, say};

fn main() -> ExitCode {
    let options = Options::parse();
    // A reader of standard error that pauses must not stop what controls a robot.
    output_queue::set_controls(true);
    let code = match run(&options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            say(&format!("tesaki-ros2: {failure}"));
            ExitCode::from(failure.number())
        }
    };
    let _ = output_queue::flush(true);
    code
}

fn run(options: &Options) -> Result<(), Failure> {
    // From here on a signal must not end the process before the outputs are off.
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .map_err(|error| Failure::Other(format!("cannot handle Ctrl-C: {error}")))?;
    let mut node = Node::start(options)?;
    let mut result = Ok(());
    while result.is_ok() && !interrupted.load(Ordering::Relaxed) {
        result = node.turn();
    }
    let why = result.as_ref().map_or_else(ToString::to_string, |()| "tesaki-ros2 was ended".to_owned());
    let ended = node.end(&why);
    if let (Err(_), Err(failure)) = (&result, &ended) {
        say(&format!("tesaki-ros2: {failure}"));
    }
    result.and(ended)
}
