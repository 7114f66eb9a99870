//! Finding and opening the board's end of the link: serial ports, sockets, pseudo-terminals.
//!
//! [`open`] opens an [`Address`] once; [`Reopening`] keeps it open. [`list`] returns the available ports,
//! including simulated boards, which publish an [`Announcement`]. With a [`Key`], a TCP connection is
//! encrypted.
//!
//! [`LocalListener`] and [`connect`] connect programs on this machine by plain streams: pictures, circles.

mod address;
mod announcement;
pub(crate) mod channel;
mod error;
mod key;
mod list;
pub(crate) mod listener;
mod local;
mod open;
mod reopening;
mod serial;
pub(crate) mod stream;

pub use address::{Address, AddressError};
pub use announcement::Announcement;
pub use error::PortError;
pub use key::Key;
pub use list::{Found, latency_timer, list};
pub use listener::SocketFile;
pub use local::{LocalListener, connect};
pub use open::{Port, open};
pub use reopening::Reopening;
pub use serial::BAUD_RATE;

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
pub(crate) mod tests {
    use std::fs::{self, File};
    use std::os::fd::OwnedFd;
    use std::path::PathBuf;

    /// An unused path in the temporary folder for one test.
    pub(crate) fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("tesaki-test-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    /// A pseudo-terminal, as another program creates it.
    pub(crate) struct Pty {
        pub(crate) master: File,
        pub(crate) path: PathBuf,
        _slave: OwnedFd,
    }

    impl Pty {
        pub(crate) fn new() -> Self {
            let pty = nix::pty::openpty(None, None).unwrap();
            let path = nix::unistd::ttyname(&pty.slave).unwrap();
            Self { master: pty.master.into(), path, _slave: pty.slave }
        }
    }
}
