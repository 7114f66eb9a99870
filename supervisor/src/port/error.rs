use std::fmt::Write as _;
use std::io;
use std::path::PathBuf;

use super::{Address, Found};

/// The program that would answer at an address.
const fn who(address: &Address) -> &'static str {
    match address {
        Address::Tcp(_) => "`tesaki share` there, or `cargo sim serve --listen`,",
        _ => "`cargo sim serve`",
    }
}

/// Reasons why a port could not be opened, with advice.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// There is no such port.
    #[error("{address} does not exist{}", what_exists(.found))]
    DoesNotExist {
        /// The requested address.
        address: Address,
        /// Existing ports.
        found: Vec<Found>,
    },
    /// The user has no permission to open the port.
    #[error(
        "no permission to open {}: this requires membership in the group `{group}`. \
         Run `sudo usermod -aG {group} $USER`, then log out and in again",
        path.display()
    )]
    Permission {
        /// The port.
        path: PathBuf,
        /// The group that may open it.
        group: String,
    },
    /// The socket is another user's.
    #[error(
        "no permission to open unix://{}: another user shares it. Run this as that user, or share the board at a TCP \
         port, with a key (`tesaki share --help`)",
        .path.display()
    )]
    OthersSocket {
        /// The socket.
        path: PathBuf,
    },
    /// Another process has opened it.
    #[error("{} is in use by another program{}: end that one, or choose another port with --port",
        path.display(), holder(.pid, .program))]
    Busy {
        /// The port.
        path: PathBuf,
        /// The process that has it open, if known.
        pid: Option<u32>,
        /// That program's name.
        program: Option<String>,
    },
    /// The file is not a terminal.
    #[error("{} is not a serial port: {hint}", path.display())]
    NotSerial {
        /// The file.
        path: PathBuf,
        /// Kind of the file, and advice.
        hint: String,
    },
    /// The file is not a socket.
    #[error(
        "unix://{} is {kind}, not a socket: give the address that `tesaki share` or `cargo sim serve` prints",
        path.display()
    )]
    NotSocket {
        /// The file.
        path: PathBuf,
        /// Its kind, in words.
        kind: &'static str,
    },
    /// No program listens at the address.
    #[error("nobody answers at {address}: is {} running?", who(.address))]
    Refused {
        /// The requested address.
        address: Address,
    },
    /// `auto` was given, and there is no board.
    #[error(
        "no board found: plug one in (its USB serial port then shows as /dev/ttyUSB… or /dev/ttyACM…), \
         start a simulated one with `cargo sim serve`, or name a port with --port{}", also(.others)
    )]
    NoDevice {
        /// Ports that exist, but that `auto` does not try.
        others: Vec<Found>,
    },
    /// `auto` was given, and there is more than one board.
    #[error("{} boards found; choose one with --port, like `--port {}`:{}", found.len(),
        found.first().map(|found| found.address.to_string()).unwrap_or_default(), lines(.found))]
    Several {
        /// All of them.
        found: Vec<Found>,
    },
    /// An encrypted TCP port was opened without a key.
    #[error(
        "{address} is encrypted: copy the key file of the program that shares the board, and give it with \
         --key FILE (or TESAKI_KEY)"
    )]
    KeyNeeded {
        /// The requested address.
        address: Address,
    },
    /// A key was given for a TCP port that is not encrypted.
    #[error(
        "{address} is not encrypted, or does not answer: share the board there with the same --key, or leave \
         --key out (and unset TESAKI_KEY)"
    )]
    NotEncrypted {
        /// The requested address.
        address: Address,
    },
    /// The other end has a different key.
    #[error("{address} refused the key: give both ends the same key file with --key FILE (or TESAKI_KEY)")]
    KeyRefused {
        /// The requested address.
        address: Address,
    },
    /// Any other error.
    #[error("cannot open {address}: {source}")]
    Other {
        /// The requested address.
        address: Address,
        /// The system's error.
        source: io::Error,
    },
}

impl From<PortError> for io::Error {
    fn from(error: PortError) -> Self {
        let kind = match &error {
            PortError::DoesNotExist { .. } | PortError::NoDevice { .. } => io::ErrorKind::NotFound,
            PortError::Permission { .. }
            | PortError::OthersSocket { .. }
            | PortError::KeyNeeded { .. }
            | PortError::NotEncrypted { .. }
            | PortError::KeyRefused { .. } => io::ErrorKind::PermissionDenied,
            PortError::Busy { .. } => io::ErrorKind::ResourceBusy,
            PortError::NotSerial { .. } | PortError::NotSocket { .. } | PortError::Several { .. } => {
                io::ErrorKind::InvalidInput
            }
            PortError::Refused { .. } => io::ErrorKind::ConnectionRefused,
            PortError::Other { source, .. } => source.kind(),
        };
        Self::new(kind, error)
    }
}

fn lines(found: &[Found]) -> String {
    found.iter().fold(String::new(), |mut text, found| {
        // Writing to a string cannot fail.
        let _ = write!(text, "\n  {}  {}", found.address, found.description);
        text
    })
}

fn what_exists(found: &[Found]) -> String {
    if found.is_empty() {
        ", and no other port was found: plug the board in, or start a simulated one with `cargo sim serve`"
            .to_owned()
    } else {
        format!("; there are:{}", lines(found))
    }
}

fn also(others: &[Found]) -> String {
    if others.is_empty() { String::new() } else { format!(", perhaps one of these:{}", lines(others)) }
}

fn holder(pid: &Option<u32>, program: &Option<String>) -> String {
    match (pid, program) {
        (Some(pid), Some(program)) => format!(" ({program}, pid {pid})"),
        (Some(pid), None) => format!(" (pid {pid})"),
        (None, _) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(path: &str) -> Found {
        Found {
            address: Address::Path(path.into()),
            description: "CP2102".to_owned(),
            simulated: false,
            automatic: true,
        }
    }

    #[test]
    fn messages_say_what_to_do() {
        let text =
            PortError::Several { found: vec![found("/dev/ttyUSB0"), found("/dev/ttyUSB1")] }.to_string();
        assert_eq!(
            text,
            "2 boards found; choose one with --port, like `--port /dev/ttyUSB0`:\n  /dev/ttyUSB0  CP2102\n  \
             /dev/ttyUSB1  CP2102"
        );
        let text = PortError::Permission { path: "/dev/ttyUSB0".into(), group: "dialout".into() }.to_string();
        assert!(text.contains("`sudo usermod -aG dialout $USER`"), "{text}");
        let text = PortError::Busy { path: "/dev/ttyUSB0".into(), pid: Some(7), program: None }.to_string();
        assert!(text.starts_with("/dev/ttyUSB0 is in use by another program (pid 7)"), "{text}");
        let nothing = PortError::DoesNotExist { address: Address::Path("/dev/x".into()), found: vec![] };
        assert!(nothing.to_string().contains("plug the board in"), "{nothing}");
        let nothing = PortError::NoDevice { others: vec![found("/dev/ttyS0")] };
        assert!(nothing.to_string().contains("cargo sim serve"), "{nothing}");
        assert!(nothing.to_string().contains("/dev/ttyS0"), "{nothing}");
    }
}
