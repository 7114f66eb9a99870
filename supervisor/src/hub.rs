//! One link shared by several programs.
//!
//! To its board, a [`Hub`] looks like a single link: it forwards whole frames from every client, and sends
//! the board's frames to all clients. It arbitrates the resources of which the board has only one: the rates
//! of streams and the copy of an export. Clients over TCP need its [`Key`], if it has one. A simulator calls
//! [`Hub::receive`] and [`Hub::broadcast`] itself; for a board behind another link, [`Hub::pump`] carries the
//! bytes. It has no threads: clients are served inside these calls.

mod arbiter;
mod client;

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

use crate::ByteLink;
use crate::port::listener::{Accepted, Listener};
use crate::port::{Address, Key, stream};
use arbiter::Arbiter;
use client::Client;

/// Length of the longest frame that is forwarded, including its zero. Longer ones are dropped as a whole.
pub const LONGEST_FRAME: usize = 512;

/// While this many bytes wait for the board, clients are not read: back-pressure instead of losses.
const WAITING: usize = 64 * 1024;

/// Maximum number of clients in a handshake: the oldest makes room for another.
const MAX_HANDSHAKES: usize = 16;

/// Maximum number of clients: the one that was silent longest makes room for another.
const MAX_CLIENTS: usize = 64;

/// Within each period the board gets so many frames at most, and of each client no more than its share: one
/// that sends without end takes neither the board's time nor the others' turn. Stops are beside the total,
/// and who commands comes first.
const PERIOD: Duration = Duration::from_millis(10);
const MAX_FRAMES: usize = 128;
const SHARE: usize = 32;

/// Maximum number of messages about dropped clients that wait to be shown.
const MAX_MESSAGES: usize = 16;

/// Collects a client's bytes into whole frames, so that frames of different clients do not mix.
#[derive(Debug, Default)]
struct Whole {
    partial: Vec<u8>,
    too_long: bool,
}

impl Whole {
    /// Takes bytes and forwards the frames that they complete.
    fn push(&mut self, bytes: &[u8], out: &mut impl FnMut(&[u8])) {
        for &byte in bytes {
            if self.partial.len() < LONGEST_FRAME {
                self.partial.push(byte);
            } else {
                self.too_long = true;
            }
            if byte == 0 {
                if !std::mem::take(&mut self.too_long) {
                    out(&self.partial);
                }
                self.partial.clear();
            }
        }
    }
}

/// Shares one board between several clients. A client that does not read loses bytes and never blocks the
/// others.
#[derive(Debug)]
pub struct Hub {
    listener: Listener,
    /// With the port that the system chose for port 0.
    address: Address,
    clients: Vec<Client>,
    /// The number of the next client.
    next_id: u64,
    arbiter: Arbiter,
    /// Begin of the period, number of frames and bytes taken since, and place of the client whose turn is
    /// next.
    period: (Instant, usize, usize),
    turn: usize,
    /// Number of bytes after which no more frames are taken in a period.
    capacity: usize,
    /// Whether the clients have received only a part of a frame.
    in_frame: bool,
    /// Messages about dropped clients.
    messages: Vec<String>,
    /// Whole frames from clients.
    waiting: VecDeque<u8>,
    /// Bytes lost by clients that have left.
    dropped: u64,
}

impl Hub {
    /// A hub that listens at a Unix socket or a TCP address. With a `key`, TCP connections are encrypted, and
    /// admit only clients that have it.
    ///
    /// # Errors
    /// When the address is invalid or in use by another program, or when other machines reach it and there is
    /// no key.
    pub fn listen(address: &Address, key: Option<&Key>) -> io::Result<Self> {
        let (listener, address) = Listener::new(address, key)?;
        Ok(Self {
            listener,
            address,
            clients: Vec::new(),
            next_id: 0,
            arbiter: Arbiter::new(),
            period: (Instant::now(), 0, 0),
            turn: 0,
            capacity: usize::MAX,
            in_frame: false,
            messages: Vec::new(),
            waiting: VecDeque::new(),
            dropped: 0,
        })
    }

    /// Adds a pseudo-terminal, which programs open like a serial port, and returns its path. It lives as long
    /// as the hub, however often it is opened and closed.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left.
    pub fn add_pty(&mut self) -> io::Result<PathBuf> {
        let pty = nix::pty::openpty(None, None)?;
        // Raw from the start, because a terminal's echo would send the board's bytes back to it.
        let mut settings = tcgetattr(&pty.slave)?;
        cfmakeraw(&mut settings);
        tcsetattr(&pty.slave, SetArg::TCSANOW, &settings)?;
        let path = nix::unistd::ttyname(&pty.slave)?;
        fcntl(&pty.master, FcntlArg::F_SETFL(OFlag::O_RDWR | OFlag::O_NONBLOCK))?;
        // A child process that inherited an end would keep the terminal open.
        for end in [&pty.master, &pty.slave] {
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
        }
        self.clients.push(Client::terminal(self.next_id, pty.master.into(), pty.slave));
        self.next_id += 1;
        Ok(path)
    }

    /// Takes no more from clients than a serial line of this rate carries [baud]: what waits in front of the
    /// line, a stop would wait for. A quarter is left free.
    pub fn limit_to(&mut self, baud_rate: u32) {
        // A byte is ten bits on the line, and a period 10 ms.
        self.capacity = usize::try_from(baud_rate / 10 * 3 / 4 / 100).unwrap_or(usize::MAX);
    }

    /// The address at which it listens, with the port that the system chose for port 0.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// Number of clients, including pseudo-terminals.
    #[cfg(test)]
    const fn clients(&self) -> usize {
        self.clients.len()
    }

    /// Returns messages about clients dropped since the last call: for a missing key, or for damaged data.
    pub fn messages(&mut self) -> Vec<String> {
        std::mem::take(&mut self.messages)
    }

    /// Number of bytes that were dropped because clients were too slow.
    #[cfg(test)]
    fn dropped(&self) -> u64 {
        self.clients.iter().fold(self.dropped, |sum, client| sum.wrapping_add(client.dropped))
    }

    /// Sends to every client as much as it accepts, without waiting.
    pub fn broadcast(&mut self, bytes: &[u8]) {
        // Includes clients that have connected since the last call.
        self.accept();
        self.arbiter.reply(bytes);
        let end = bytes.iter().rposition(|&byte| byte == 0).map_or(0, |zero| zero + 1);
        let (ended, begun) = bytes.split_at(end);
        for part in [ended, begun].into_iter().filter(|part| !part.is_empty()) {
            self.clients.iter_mut().for_each(|client| client.write(part));
            self.in_frame = !part.ends_with(&[0]);
            self.answer();
        }
    }

    /// Sends the arbiter's answers between two frames of the board.
    fn answer(&mut self) {
        if self.in_frame {
            return;
        }
        for (id, bytes) in self.arbiter.answers() {
            self.clients.iter_mut().filter(|client| client.id == id).for_each(|client| client.write(&bytes));
        }
    }

    /// Appends whole frames from clients to `frames`, waiting for the first until `deadline`; returns their
    /// number of bytes.
    ///
    /// # Errors
    /// The system cannot wait.
    pub fn receive(&mut self, frames: &mut Vec<u8>, deadline: Instant) -> io::Result<usize> {
        self.serve(deadline)?;
        let length = self.waiting.len();
        frames.extend(self.waiting.drain(..));
        Ok(length)
    }

    /// Carries bytes between the clients and a board behind another link until `deadline`. The two sides are
    /// polled in turn, so that a client's frame may wait here for up to `turn`; 1 ms costs little.
    ///
    /// # Errors
    /// The board's link is gone.
    pub fn pump<L: ByteLink>(&mut self, board: &mut L, turn: Duration, deadline: Instant) -> io::Result<()> {
        let (mut frames, mut buffer) = (Vec::new(), [0; 4096]);
        loop {
            let now = Instant::now();
            self.receive(&mut frames, now)?;
            if !frames.is_empty() {
                board.send(&frames)?;
                frames.clear();
            }
            let length = board.receive(&mut buffer, deadline.min(now + turn))?;
            self.broadcast(buffer.get(..length).unwrap_or_default());
            if Instant::now() >= deadline {
                return Ok(());
            }
        }
    }

    /// Serves clients until there is a frame for the board, or until `deadline`.
    fn serve(&mut self, deadline: Instant) -> io::Result<()> {
        loop {
            let listens = self.accept();
            self.read();
            self.forward();
            self.arbiter.proceed(Instant::now(), &mut self.waiting);
            self.answer();
            if !self.waiting.is_empty() {
                return Ok(());
            }
            // A listener that cannot accept who waits would end the wait at once.
            let listener = listens.then(|| PollFd::new(self.listener.fd(), PollFlags::POLLIN));
            let waits = |client: &&Client| !client.events().is_empty();
            let clients = self.clients.iter().filter(waits);
            let clients = clients.map(|client| PollFd::new(client.fd(), client.events()));
            let mut fds: Vec<_> = listener.into_iter().chain(clients).collect();
            // What is pending gets its turn in the next period.
            let is_pending = self.clients.iter().any(Client::is_pending);
            let until = if is_pending { deadline.min(self.period.0 + PERIOD) } else { deadline };
            stream::wait(&mut fds, until)?;
            // Clients that send without end do not hold up what is due.
            if Instant::now() >= deadline {
                return Ok(());
            }
        }
    }

    /// Returns whether the listener can accept more clients.
    fn accept(&mut self) -> bool {
        // Limited, so that other clients are served in between.
        for _ in 0..MAX_HANDSHAKES {
            let Accepted { name, socket, encryption } = match self.listener.accept() {
                Ok(accepted) => accepted,
                // Otherwise one client has gone, or there is none.
                Err(error) => return !matches!(Errno::try_from(error), Ok(Errno::EMFILE | Errno::ENFILE)),
            };
            let client = Client::new(self.next_id, name, socket.into(), encryption);
            self.next_id += 1;
            self.clients.push(client);
            self.make_room();
        }
        true
    }

    /// Drops the clients that were silent longest while there are too many, but never who commands the board.
    /// Those in a handshake do not count: without the key, nobody displaces a client.
    fn make_room(&mut self) {
        let Self { clients, arbiter, messages, dropped, .. } = self;
        while clients.iter().filter(|client| client.is_admitted()).count() > MAX_CLIENTS {
            let may_go = |client: &Client| client.is_program() && !arbiter.is_commander(client.id);
            let candidates = clients.iter().enumerate().filter(|(_, client)| may_go(client));
            let Some((place, _)) = candidates.min_by_key(|(_, client)| client.heard) else { return };
            let client = clients.remove(place);
            let why = format!("{MAX_CLIENTS} clients are connected, and it was silent longest");
            note(messages, &client, &why);
            arbiter.left(client.id);
            *dropped = dropped.wrapping_add(client.dropped);
        }
    }

    /// Takes stops, which also overtake what their own clients have sent before, then the frames of who
    /// commands, then those of the others in turn.
    fn forward(&mut self) {
        let Self { clients, arbiter, waiting, period: (begun, frames, bytes), turn, capacity, .. } = self;
        let now = Instant::now();
        if now >= *begun + PERIOD {
            (*begun, *frames, *bytes) = (now, 0, 0);
            clients.iter_mut().for_each(|client| client.taken = 0);
        }
        for client in clients.iter_mut() {
            while client.taken < SHARE
                && let Some(frame) = client.take_stop()
            {
                arbiter.request(client.id, &frame, waiting);
            }
        }
        let count = clients.len();
        let commander = clients.iter().position(|client| arbiter.is_commander(client.id));
        let mut idle = 0;
        while idle < count && *frames < MAX_FRAMES && *bytes < *capacity && waiting.len() < WAITING {
            let has_turn = |client: &Client| client.taken < SHARE && client.is_pending();
            let place = match commander {
                Some(commander) if has_turn(&clients[commander]) => commander,
                _ => {
                    (*turn, idle) = ((*turn + 1) % count, idle + 1);
                    *turn
                }
            };
            let client = &mut clients[place];
            if has_turn(client)
                && let Some(frame) = client.take()
            {
                arbiter.request(client.id, &frame, waiting);
                (*frames, *bytes, idle) = (*frames + 1, *bytes + frame.len(), 0);
            }
        }
    }

    /// Reads from every client, and removes those that have gone.
    fn read(&mut self) {
        let Self { clients, arbiter, waiting, messages, dropped, .. } = self;
        clients.retain_mut(|client| {
            client.flush();
            if waiting.len() >= WAITING {
                return true;
            }
            let id = client.id;
            let Err(error) = client.read() else {
                return true;
            };
            // With any other error the client has left.
            if matches!(error.kind(), io::ErrorKind::InvalidData | io::ErrorKind::TimedOut) {
                note(messages, client, &error.to_string());
            }
            arbiter.left(id);
            *dropped = dropped.wrapping_add(client.dropped);
            false
        });
        // Checked after clients that have finished their handshake are admitted.
        let handshakes = clients.iter().filter(|client| !client.is_admitted()).count();
        let mut excess = handshakes.saturating_sub(MAX_HANDSHAKES);
        clients.retain(|client| {
            let stays = excess == 0 || client.is_admitted();
            if !stays {
                excess -= 1;
                note(messages, client, "too many connections wait for their handshake");
            }
            stays
        });
        self.make_room();
    }
}

/// Records why a client is dropped.
fn note(messages: &mut Vec<String>, client: &Client, why: &str) {
    if messages.len() < MAX_MESSAGES {
        messages.push(format!("dropped the client at {}: {why}", client.name));
    }
}

/// The clients, as a link that the board uses.
impl ByteLink for Hub {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.broadcast(bytes);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
        if self.waiting.is_empty() {
            self.serve(deadline)?;
        }
        let length = self.waiting.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(self.waiting.drain(..length)) {
            *place = byte;
        }
        Ok(length)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;
