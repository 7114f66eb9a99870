//! The pages, served by a thread of its own: a stop is noticed while the board is waited for.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use tesaki_viewer::server::{Event, Server};

use super::message::Command;

/// From one look at the pages to the next.
const TURN: Duration = Duration::from_millis(2);
/// Without pages.
const IDLE: Duration = Duration::from_millis(20);

/// What a page did.
pub enum PageEvent {
    /// It has come.
    Opened(u64),
    /// It requests something, since then. Nonsense comes with what is wrong with it.
    Said(u64, Instant, Result<Command, String>),
    /// It has gone.
    Closed(u64),
}

/// The pages, by their numbers.
pub struct Pages {
    address: SocketAddr,
    outgoing: Sender<(u64, String)>,
    events: Receiver<PageEvent>,
    stop: Arc<AtomicBool>,
    /// Number of the page that commands; 0 for none.
    commander: Arc<AtomicU64>,
}

impl Pages {
    /// Begins to serve.
    pub fn serve(server: Server) -> Self {
        let address = server.address();
        let (outgoing, messages) = channel();
        let (sender, events) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let commander = Arc::new(AtomicU64::new(0));
        let shared = (Arc::clone(&stop), Arc::clone(&commander));
        std::thread::spawn(move || serve(server, &messages, &sender, &shared.0, &shared.1));
        Self { address, outgoing, events, stop, commander }
    }

    /// Names the page that commands: it is not closed for another one.
    pub fn keep(&self, page: Option<u64>) {
        self.commander.store(page.unwrap_or(0), Ordering::Relaxed);
    }

    /// Where they are.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Set once a page requests a stop, until somebody clears it: before the stop is among the events.
    pub const fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    /// Sends a message to a page.
    pub fn send(&self, id: u64, text: String) {
        // Without the thread, no page is left that could miss it.
        let _ = self.outgoing.send((id, text));
    }

    /// What has happened next.
    pub fn next(&self) -> Option<PageEvent> {
        self.events.try_recv().ok()
    }
}

/// Serves until nobody sends or listens any more.
fn serve(
    mut server: Server,
    messages: &Receiver<(u64, String)>,
    events: &Sender<PageEvent>,
    stop: &AtomicBool,
    commander: &AtomicU64,
) {
    loop {
        match messages.recv_timeout(if server.is_idle() { IDLE } else { TURN }) {
            Ok((id, text)) => {
                server.send(id, text);
                messages.try_iter().for_each(|(id, text)| server.send(id, text));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        server.keep(Some(commander.load(Ordering::Relaxed)).filter(|page| *page != 0));
        for event in server.turn() {
            let event = match event {
                Event::Opened(id) => PageEvent::Opened(id),
                Event::Closed(id) => PageEvent::Closed(id),
                Event::Said(id, text) => {
                    let command = serde_json::from_str(&text).map_err(|error| error.to_string());
                    if matches!(command, Ok(Command::Stop)) {
                        stop.store(true, Ordering::Relaxed);
                    }
                    PageEvent::Said(id, Instant::now(), command)
                }
            };
            if events.send(event).is_err() {
                return;
            }
        }
    }
}
