use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};

use nix::poll::PollFlags;

use super::Whole;
use crate::port::stream;

/// Maximum backlog of a client in bytes: a second of telemetry. Older data would be useless.
const BACKLOG: usize = 64 * 1024;

/// One program at the board's link.
#[derive(Debug)]
pub(super) struct Client {
    file: File,
    /// Kept open at a pseudo-terminal, as its master fails while nobody has its other end open.
    slave: Option<OwnedFd>,
    frames: Whole,
    backlog: VecDeque<u8>,
    /// Closed at its side. What it sent before is still read: it may have said its last word and left.
    deaf: bool,
    /// Bytes that it was too slow for.
    pub(super) dropped: u64,
}

impl Client {
    pub(super) fn new(file: File, slave: Option<OwnedFd>) -> Self {
        Self { file, slave, frames: Whole::default(), backlog: VecDeque::new(), deaf: false, dropped: 0 }
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }

    /// What to wait for.
    pub(super) fn events(&self) -> PollFlags {
        if self.backlog.is_empty() { PollFlags::POLLIN } else { PollFlags::POLLIN | PollFlags::POLLOUT }
    }

    /// Reads once and appends whole frames to `out`.
    ///
    /// # Errors
    /// When the client is gone.
    pub(super) fn read(&mut self, out: &mut VecDeque<u8>) -> io::Result<()> {
        let mut buffer = [0; 4096];
        if let Some(length) = stream::read(&self.file, &mut buffer)? {
            self.frames.push(buffer.get(..length).unwrap_or_default(), out);
        }
        Ok(())
    }

    /// Writes what the client takes and keeps the rest for later, or drops it if there is too much of it.
    pub(super) fn write(&mut self, bytes: &[u8]) {
        self.flush();
        let written = if self.backlog.is_empty() { write_to(&self.file, &mut self.deaf, bytes) } else { 0 };
        let rest = bytes.get(written..).unwrap_or_default();
        // A pseudo-terminal is closed most of the time, and a program that opens it needs current data: the
        // kernel's few kB are enough backlog. A frame truncated there fails its checksum.
        let room = if self.slave.is_some() { 0 } else { BACKLOG - self.backlog.len().min(BACKLOG) };
        if rest.len() <= room {
            self.backlog.extend(rest);
        } else {
            self.dropped = self.dropped.wrapping_add(u64::try_from(rest.len()).unwrap_or(u64::MAX));
        }
    }

    /// Writes of the backlog what the client takes.
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

/// Writes what the client accepts. Data for a client that does not listen count as accepted.
fn write_to(file: &File, deaf: &mut bool, bytes: &[u8]) -> usize {
    if !*deaf {
        match stream::write(file, bytes) {
            Ok(written) => return written,
            Err(_) => *deaf = true,
        }
    }
    bytes.len()
}
