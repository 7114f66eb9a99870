//! One link shared by several programs.
//!
//! To its board a [`Hub`] looks like a single link: it forwards whole frames from every client, and sends the
//! board's frames to all clients. A simulator calls [`Hub::receive`] and [`Hub::broadcast`] itself; for a
//! board behind another link, [`Hub::pump`] carries the bytes. It has no threads: clients are served inside
//! these calls.

mod client;
mod listener;

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

use crate::ByteLink;
use crate::port::{Address, stream};
use client::Client;
use listener::Listener;

/// The longest frame that passes, its zero included. Longer ones are dropped whole.
pub const LONGEST_FRAME: usize = 512;

/// While this many bytes wait for the board, clients are not read: back-pressure instead of losses.
const WAITING: usize = 64 * 1024;

/// Collects a client's bytes into whole frames, so that frames of different clients do not mix.
#[derive(Debug, Default)]
struct Whole {
    partial: Vec<u8>,
    too_long: bool,
}

impl Whole {
    /// Takes bytes and appends the frames that they complete.
    fn push(&mut self, bytes: &[u8], out: &mut VecDeque<u8>) {
        for &byte in bytes {
            if self.partial.len() < LONGEST_FRAME {
                self.partial.push(byte);
            } else {
                self.too_long = true;
            }
            if byte == 0 {
                if !std::mem::take(&mut self.too_long) {
                    out.extend(&self.partial);
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
    listeners: Vec<(Listener, Address)>,
    clients: Vec<Client>,
    /// Whole frames from clients.
    waiting: VecDeque<u8>,
    /// By clients that are gone.
    dropped: u64,
}

impl Hub {
    /// A hub that listens at a Unix socket or a TCP address.
    ///
    /// # Errors
    /// When the address is invalid or in use by another program.
    pub fn listen(address: &Address) -> io::Result<Self> {
        let mut hub =
            Self { listeners: Vec::new(), clients: Vec::new(), waiting: VecDeque::new(), dropped: 0 };
        hub.also_listen(address)?;
        Ok(hub)
    }

    /// Listens at one more address.
    ///
    /// # Errors
    /// As [`Hub::listen`].
    pub fn also_listen(&mut self, address: &Address) -> io::Result<()> {
        self.listeners.push(Listener::new(address)?);
        Ok(())
    }

    /// Adds a pseudo-terminal, which programs open like a serial port, and returns its path. It lives as long
    /// as the hub, however often it is opened and closed.
    ///
    /// # Errors
    /// When the system has none left.
    pub fn add_pty(&mut self) -> io::Result<PathBuf> {
        let pty = nix::pty::openpty(None, None)?;
        // Raw from the start: a terminal's echo would send the board's bytes back to it.
        let mut settings = tcgetattr(&pty.slave)?;
        cfmakeraw(&mut settings);
        tcsetattr(&pty.slave, SetArg::TCSANOW, &settings)?;
        let path = nix::unistd::ttyname(&pty.slave)?;
        fcntl(&pty.master, FcntlArg::F_SETFL(OFlag::O_RDWR | OFlag::O_NONBLOCK))?;
        // A child process that kept it would keep the terminal alive.
        for end in [&pty.master, &pty.slave] {
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
        }
        self.clients.push(Client::new(pty.master.into(), Some(pty.slave)));
        Ok(path)
    }

    /// Where it listens first; with the port that the system chose, if port 0 was asked for.
    pub fn address(&self) -> &Address {
        self.listeners.first().map_or(&Address::Auto, |(_, address)| address)
    }

    /// How many clients there are, pseudo-terminals included.
    pub const fn clients(&self) -> usize {
        self.clients.len()
    }

    /// How many bytes clients were too slow for.
    pub fn dropped(&self) -> u64 {
        self.clients.iter().fold(self.dropped, |sum, client| sum.wrapping_add(client.dropped))
    }

    /// Sends to every client what it takes, without waiting.
    pub fn broadcast(&mut self, bytes: &[u8]) {
        // Includes clients that have connected since the last call.
        self.accept();
        self.clients.iter_mut().for_each(|client| client.write(bytes));
    }

    /// Appends whole frames from clients to `frames`, waiting for the first until `deadline`, and says how
    /// many bytes came.
    ///
    /// # Errors
    /// When the system cannot wait.
    pub fn receive(&mut self, frames: &mut Vec<u8>, deadline: Instant) -> io::Result<usize> {
        self.serve(deadline)?;
        let length = self.waiting.len();
        frames.extend(self.waiting.drain(..));
        Ok(length)
    }

    /// Carries bytes between the clients and a board behind another link until `deadline`. The two sides are
    /// waited for in turn, so that a client's frame may lie here for up to `turn`; 1 ms costs little.
    ///
    /// # Errors
    /// When the board's link is gone.
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

    /// Serves clients until there is a frame for the board.
    fn serve(&mut self, deadline: Instant) -> io::Result<()> {
        loop {
            self.accept();
            let mut waiting = std::mem::take(&mut self.waiting);
            self.keep(|client| {
                client.flush();
                if waiting.len() < WAITING { client.read(&mut waiting) } else { Ok(()) }
            });
            self.waiting = waiting;
            if !self.waiting.is_empty() {
                return Ok(());
            }
            let listeners =
                self.listeners.iter().map(|(listener, _)| PollFd::new(listener.fd(), PollFlags::POLLIN));
            let clients = self.clients.iter().map(|client| PollFd::new(client.fd(), client.events()));
            let mut fds: Vec<_> = listeners.chain(clients).collect();
            if !stream::wait(&mut fds, deadline)? {
                return Ok(());
            }
        }
    }

    fn accept(&mut self) {
        for (listener, _) in &self.listeners {
            // An error means that one client has gone, or that there is none.
            while let Ok(file) = listener.accept() {
                self.clients.push(Client::new(file, None));
            }
        }
    }

    /// Applies an action to every client and removes those that have gone.
    fn keep(&mut self, mut action: impl FnMut(&mut Client) -> io::Result<()>) {
        let dropped = &mut self.dropped;
        self.clients.retain_mut(|client| {
            let stays = action(client).is_ok();
            if !stays {
                *dropped = dropped.wrapping_add(client.dropped);
            }
            stays
        });
    }
}

/// The clients as the board sees them.
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
