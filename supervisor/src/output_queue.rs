//! Text on its way to standard output and standard error.
//!
//! A thread writes it, so that a reader that pauses does not stop what controls a robot.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Texts that may wait for the reader.
const CAPACITY: usize = 50;

/// Where a text goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// Standard output.
    Output,
    /// Standard error.
    Error,
}

/// Whether this program controls a robot, and must not wait for a reader.
static CONTROLS: AtomicBool = AtomicBool::new(false);

/// From now on this program controls a robot, or does not any more.
pub fn set_controls(controls: bool) {
    CONTROLS.store(controls, Ordering::Relaxed);
}

/// See [`interrupt_by`].
static INTERRUPT: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// From now on `flag` says whether Ctrl-C, or a request to terminate, has come.
pub fn interrupt_by(flag: Arc<AtomicBool>) {
    let _ = INTERRUPT.set(flag);
}

/// Whether Ctrl-C, or a request to terminate, has come, if there is a flag that says so.
pub fn was_interrupted() -> bool {
    INTERRUPT.get().is_some_and(|flag| flag.load(Ordering::Relaxed))
}

#[derive(Default)]
struct State {
    texts: VecDeque<(Stream, String)>,
    /// Whether the thread is writing a text.
    writes: bool,
    /// Why standard output could not be written.
    error: Option<io::Error>,
}

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

/// The queue, whose thread runs.
fn queue() -> &'static Arc<Queue> {
    static QUEUE: OnceLock<Arc<Queue>> = OnceLock::new();
    QUEUE.get_or_init(|| {
        let queue = Arc::<Queue>::default();
        let writer = Arc::clone(&queue);
        std::thread::spawn(move || writer.write());
        queue
    })
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>, limit: Duration) -> MutexGuard<'a, State> {
        self.changed.wait_timeout(state, limit).unwrap_or_else(PoisonError::into_inner).0
    }

    fn write(&self) {
        let mut state = self.lock();
        loop {
            let Some((stream, text)) = state.texts.pop_front() else {
                state = self.wait(state, Duration::from_secs(1));
                continue;
            };
            state.writes = true;
            drop(state);
            let written = match stream {
                Stream::Output => {
                    let mut output = io::stdout();
                    output.write_all(text.as_bytes()).and_then(|()| output.flush())
                }
                Stream::Error => {
                    // That nobody reads it is no reason to end.
                    let _ = io::stderr().write_all(text.as_bytes());
                    Ok(())
                }
            };
            state = self.lock();
            state.writes = false;
            if let Err(error) = written {
                state.error.get_or_insert(error);
            }
            self.changed.notify_all();
        }
    }
}

/// Sends a text on its way. While this program controls a robot, and after Ctrl-C, it waits for no reader:
/// then the error is [`io::ErrorKind::WouldBlock`] when too many texts wait. Errors of standard output may be
/// those of earlier texts.
///
/// # Errors
/// See above.
pub fn send(stream: Stream, text: String) -> io::Result<()> {
    let queue = queue();
    let mut state = queue.lock();
    loop {
        if stream == Stream::Output
            && let Some(error) = state.error.take()
        {
            return Err(error);
        }
        if state.texts.len() < CAPACITY {
            break;
        }
        if CONTROLS.load(Ordering::Relaxed) || was_interrupted() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        state = queue.wait(state, Duration::from_secs(1));
    }
    state.texts.push_back((stream, text));
    queue.changed.notify_all();
    Ok(())
}

/// Waits until all texts are written; after Ctrl-C, or if it `hurries`, for a second more.
///
/// # Errors
/// An error of standard output.
pub fn flush(hurries: bool) -> io::Result<()> {
    let queue = queue();
    let mut state = queue.lock();
    let mut hurried = None;
    while state.writes || !state.texts.is_empty() {
        if (hurries || was_interrupted())
            && hurried.get_or_insert_with(Instant::now).elapsed() > Duration::from_secs(1)
        {
            break;
        }
        state = queue.wait(state, Duration::from_millis(50));
    }
    state.error.take().map_or(Ok(()), Err)
}
