//! Ctrl-C, and the signals that ask a program to end.

use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tesaki::protocol::{ActuatorFrame, Reply, Request, SensorFrame};
use tesaki_sim::controller::Controller;
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError};

static ASKED: AtomicBool = AtomicBool::new(false);

/// From now on a signal does not end the program, but is [`asked`].
///
/// # Errors
/// The system refuses.
pub fn handle() -> Result<(), ctrlc::Error> {
    match ctrlc::set_handler(|| ASKED.store(true, Ordering::Relaxed)) {
        // This one, from before.
        Err(ctrlc::Error::MultipleHandlers) => Ok(()),
        other => other,
    }
}

/// Whether a signal has come.
pub fn asked() -> bool {
    ASKED.load(Ordering::Relaxed)
}

/// What a signal has ended failed for no other reason.
///
/// # Errors
/// Those of `result`.
pub fn told<T>(result: Result<T, Box<dyn Error>>) -> Result<T, Box<dyn Error>> {
    if result.is_err() && asked() { Err("interrupted".into()) } else { result }
}

/// Waits for it.
pub fn wait() {
    while !asked() {
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A controller that fails once a signal has come: so the run ends, and what it has started with it.
pub struct Interruptible<'a>(pub &'a mut dyn Controller);

fn check() -> Result<(), BoardError> {
    if asked() { Err(std::io::Error::other("interrupted").into()) } else { Ok(()) }
}

impl Board for Interruptible<'_> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        check()?;
        self.0.request(request)
    }
}

impl FingerBoard for Interruptible<'_> {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        check()?;
        self.0.post(request)
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        self.0.listen()
    }
}

impl Controller for Interruptible<'_> {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        check()?;
        self.0.tick(sensors)
    }
}
