use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::time::{Duration, Instant};

use nix::poll::PollFlags;

use super::{Whole, arbiter};
use crate::port::channel::{Channel, GREETING};
use crate::port::stream;

/// Maximum backlog of a client in bytes: a second of telemetry. Older data would be useless.
const BACKLOG: usize = 64 * 1024;
/// First bytes of requests of web browsers, which can send any page's bytes to the ports of their machine.
const BROWSER: [&[u8]; 7] = [b"GET ", b"POST ", b"HEAD ", b"PUT ", b"PATCH ", b"DELETE ", b"OPTIONS "];
/// Time limit of a handshake.
const HANDSHAKE: Duration = Duration::from_secs(2);

/// A program that is connected to the board's link.
#[derive(Debug)]
pub(super) struct Client {
    /// Its number, which is never reused.
    pub(super) id: u64,
    /// Its address, for messages.
    pub(super) name: String,
    file: File,
    /// Kept open for a pseudo-terminal, because the master fails while the other end is not open.
    slave: Option<OwnedFd>,
    encryption: Option<Channel>,
    since: Instant,
    /// Whether nothing has been read yet.
    fresh: bool,
    frames: Whole,
    /// Whole frames that wait for their turn, each with whether it stops the board.
    pending: VecDeque<(Vec<u8>, bool)>,
    /// Number of frames that were taken from it in this period.
    pub(super) taken: usize,
    /// When it has sent a whole frame last; at first, when it was admitted.
    pub(super) heard: Instant,
    backlog: VecDeque<u8>,
    /// Whether it has closed its reading side. Bytes that it sent before are still read.
    deaf: bool,
    /// Number of bytes dropped because it was too slow.
    pub(super) dropped: u64,
}

impl Client {
    pub(super) fn new(id: u64, name: String, file: File, encryption: Option<Channel>) -> Self {
        let mut client = Self {
            id,
            name,
            file,
            slave: None,
            encryption,
            since: Instant::now(),
            fresh: true,
            frames: Whole::default(),
            pending: VecDeque::new(),
            taken: 0,
            heard: Instant::now(),
            backlog: VecDeque::new(),
            deaf: false,
            dropped: 0,
        };
        if client.encryption.is_some() {
            client.backlog.extend(GREETING);
            client.flush();
        }
        client
    }

    /// Creates a client at a pseudo-terminal.
    pub(super) fn terminal(id: u64, master: File, slave: OwnedFd) -> Self {
        Self { slave: Some(slave), ..Self::new(id, "pseudo-terminal".to_owned(), master, None) }
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }

    /// The events to wait for. While frames wait for their turn, no more are read.
    pub(super) fn events(&self) -> PollFlags {
        let read = if self.is_pending() { PollFlags::empty() } else { PollFlags::POLLIN };
        if self.backlog.is_empty() { read } else { read | PollFlags::POLLOUT }
    }

    /// Returns whether frames wait for their turn.
    pub(super) fn is_pending(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Returns whether it may be dropped for another client. The pseudo-terminal stays for the next program.
    pub(super) fn is_program(&self) -> bool {
        self.slave.is_none() && self.is_admitted()
    }

    /// Takes the next frame.
    pub(super) fn take(&mut self) -> Option<Vec<u8>> {
        let (frame, _) = self.pending.pop_front()?;
        self.taken += 1;
        Some(frame)
    }

    /// Takes the first frame that stops the board, before what was sent earlier: that enables nothing any
    /// more, because the board goes by the numbers of requests.
    pub(super) fn take_stop(&mut self) -> Option<Vec<u8>> {
        let place = self.pending.iter().position(|(_, stops)| *stops)?;
        let (frame, _) = self.pending.remove(place)?;
        self.taken += 1;
        Some(frame)
    }

    /// Returns whether it may talk to the board: it has the key, if one is needed.
    pub(super) fn is_admitted(&self) -> bool {
        self.encryption.as_ref().is_none_or(Channel::is_open)
    }

    /// Reads once, unless frames wait for their turn.
    ///
    /// # Errors
    /// The client has left, or must be dropped.
    pub(super) fn read(&mut self) -> io::Result<()> {
        if self.is_pending() {
            return Ok(());
        }
        let mut buffer = [0; 4096];
        let read = stream::read(&self.file, &mut buffer)?;
        let bytes = buffer.get(..read.unwrap_or(0)).unwrap_or_default();
        let first = read.is_some() && std::mem::take(&mut self.fresh);
        if first && BROWSER.iter().any(|start| bytes.starts_with(start)) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "it is a web browser"));
        }
        let Self { frames, pending, heard, .. } = self;
        let mut out = |frame: &[u8]| {
            *heard = Instant::now();
            pending.push_back((frame.to_vec(), arbiter::stops(frame)));
        };
        let Some(channel) = &mut self.encryption else {
            frames.push(bytes, &mut out);
            return Ok(());
        };
        let was_admitted = channel.is_open();
        let mut content = VecDeque::new();
        channel.open(bytes, &mut self.backlog, &mut content)?;
        frames.push(content.make_contiguous(), &mut out);
        if !was_admitted && channel.is_open() {
            self.heard = Instant::now();
        }
        self.flush();
        if !self.is_admitted() && self.since.elapsed() > HANDSHAKE {
            let why = format!("no handshake within {} s", HANDSHAKE.as_secs());
            return Err(io::Error::new(io::ErrorKind::TimedOut, why));
        }
        Ok(())
    }

    /// Writes what the client accepts, and keeps the rest for later, or drops it if there is too much.
    pub(super) fn write(&mut self, bytes: &[u8]) {
        self.flush();
        if !self.is_admitted() {
            return;
        }
        let taken = if self.slave.is_some() {
            // A pseudo-terminal is closed most of the time, and a program that opens it needs current data:
            // the kernel's few kB are enough backlog. A frame truncated there fails its checksum.
            write_to(&self.file, &mut self.deaf, bytes)
        } else if self.backlog.len() + bytes.len() > BACKLOG {
            0
        } else {
            match &mut self.encryption {
                // Cannot fail: the client is admitted, and fewer than 2^64 messages are sent.
                Some(channel) => drop(channel.seal(bytes, &mut self.backlog)),
                None => self.backlog.extend(bytes),
            }
            self.flush();
            bytes.len()
        };
        let rest = u64::try_from(bytes.len() - taken).unwrap_or(u64::MAX);
        self.dropped = self.dropped.wrapping_add(rest);
    }

    /// Writes the part of the backlog that the client accepts.
    pub(super) fn flush(&mut self) {
        while !self.backlog.is_empty() {
            let written = write_to(&self.file, &mut self.deaf, self.backlog.as_slices().0);
            if written == 0 {
                break;
            }
            self.backlog.drain(..written);
        }
    }
}

/// Writes what the client accepts; returns its length. Data for a client that does not read count as
/// accepted.
fn write_to(file: &File, deaf: &mut bool, bytes: &[u8]) -> usize {
    if !*deaf {
        match stream::write(file, bytes) {
            Ok(written) => return written,
            Err(_) => *deaf = true,
        }
    }
    bytes.len()
}
