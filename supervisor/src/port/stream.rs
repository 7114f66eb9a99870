//! Common operations of serial ports, sockets and pseudo-terminals, as non-blocking file descriptors.

use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::os::fd::AsFd as _;
use std::time::Instant;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags};

/// Waits for an event on one of `fds`, or until `deadline`. Returns whether there was one.
pub(crate) fn wait(fds: &mut [PollFd<'_>], deadline: Instant) -> io::Result<bool> {
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        // `poll` has a resolution of milliseconds, too coarse for control cycles.
        #[cfg(target_os = "linux")]
        let result = nix::poll::ppoll(fds, Some(left.into()), None);
        #[cfg(not(target_os = "linux"))]
        let result = nix::poll::poll(
            fds,
            nix::poll::PollTimeout::try_from(left).unwrap_or(nix::poll::PollTimeout::MAX),
        );
        match result {
            Ok(events) => return Ok(events > 0),
            Err(Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

/// Reads the available bytes; `None` if there are none.
///
/// # Errors
/// Also at the end of the stream: a tty that was removed returns 0 bytes or `EIO`; a socket returns 0 bytes.
pub(crate) fn read(mut file: &File, buffer: &mut [u8]) -> io::Result<Option<usize>> {
    loop {
        match file.read(buffer) {
            Ok(0) if !buffer.is_empty() => {
                return Err(io::Error::new(
                    io::ErrorKind::UnexpectedEof,
                    "the other end closed the connection",
                ));
            }
            Ok(length) => return Ok(Some(length)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

/// Writes as much as the other end accepts now, perhaps nothing; returns the length.
pub(crate) fn write(mut file: &File, bytes: &[u8]) -> io::Result<usize> {
    loop {
        match file.write(bytes) {
            Ok(length) => return Ok(length),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(0),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

/// Reads available bytes, waiting for the first one until `deadline`; returns 0 if none came.
pub(crate) fn read_until(file: &File, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
    loop {
        if let Some(length) = read(file, buffer)? {
            return Ok(length);
        }
        if !wait(&mut [PollFd::new(file.as_fd(), PollFlags::POLLIN)], deadline)? {
            return Ok(0);
        }
    }
}

/// Fills the buffer, or fails at `deadline`.
pub(crate) fn read_exact_until(file: &File, mut buffer: &mut [u8], deadline: Instant) -> io::Result<()> {
    while !buffer.is_empty() {
        let length = read_until(file, buffer, deadline)?;
        if length == 0 {
            return Err(io::Error::new(io::ErrorKind::TimedOut, "the other end does not answer"));
        }
        buffer = buffer.get_mut(length..).unwrap_or_default();
    }
    Ok(())
}

/// Writes everything, or as much as possible until `deadline`; leaves the rest in `bytes`.
pub(crate) fn write_until(file: &File, bytes: &mut &[u8], deadline: Instant) -> io::Result<()> {
    loop {
        *bytes = bytes.get(write(file, bytes)?..).unwrap_or_default();
        if bytes.is_empty() {
            return Ok(());
        }
        if !wait(&mut [PollFd::new(file.as_fd(), PollFlags::POLLOUT)], deadline)? {
            return Err(io::Error::new(io::ErrorKind::TimedOut, "the other end takes no bytes"));
        }
    }
}
