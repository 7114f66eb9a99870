use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

use super::channel::{Channel, Failed, GREETING};
use super::listener::no_socket;
use super::serial::{busy, group, open_serial};
use super::{Address, Found, Key, PortError, list, stream};
use crate::ByteLink;

/// Time for which a peer may accept no bytes before a send is given up: much longer than the longest frame
/// takes.
const SEND_LIMIT: Duration = Duration::from_millis(250);
/// Time limit of an attempt to connect.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);

/// An open link to a board. A serial port is locked by this process as long as this value lives.
#[derive(Debug)]
pub struct Port {
    file: File,
    address: Address,
    encryption: Option<Encryption>,
    /// Whether nothing has been received yet.
    fresh: bool,
}

/// The encryption of a port.
#[derive(Debug)]
struct Encryption {
    channel: Channel,
    /// Encrypted bytes that the peer has not accepted yet: it must get all of them.
    out: VecDeque<u8>,
    /// Decrypted bytes that have not been received by the caller yet.
    content: VecDeque<u8>,
}

impl Port {
    const fn new(file: File, address: Address) -> Self {
        Self { file, address, encryption: None, fresh: true }
    }

    /// The address that was opened; never [`Address::Auto`].
    pub const fn address(&self) -> &Address {
        &self.address
    }
}

impl ByteLink for Port {
    fn send(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        let deadline = Instant::now() + SEND_LIMIT;
        let Some(Encryption { channel, out, .. }) = &mut self.encryption else {
            return stream::write_until(&self.file, &mut bytes, deadline);
        };
        // The rest of the last message is sent first; only then does the next message begin.
        for content in [None, Some(bytes)] {
            if let Some(content) = content {
                channel.seal(content, out)?;
            }
            let mut rest = &*out.make_contiguous();
            let sent = stream::write_until(&self.file, &mut rest, deadline);
            let rest = rest.len();
            out.drain(..out.len() - rest);
            sent?;
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
        let Some(Encryption { channel, content, .. }) = &mut self.encryption else {
            let length = stream::read_until(&self.file, buffer, deadline)?;
            let begins = |bytes: &[u8]| bytes.len() >= 8 && GREETING.starts_with(bytes);
            if length > 0
                && std::mem::take(&mut self.fresh)
                && begins(buffer.get(..length.min(GREETING.len())).unwrap_or_default())
            {
                return Err(PortError::KeyNeeded { address: self.address.clone() }.into());
            }
            return Ok(length);
        };
        while content.is_empty() {
            let mut received = [0; 4096];
            let length = stream::read_until(&self.file, &mut received, deadline)?;
            if length == 0 {
                return Ok(0);
            }
            channel.open(received.get(..length).unwrap_or_default(), &mut VecDeque::new(), content)?;
        }
        content.read(buffer)
    }
}

/// Opens the link to a board. With a `key`, a TCP connection is encrypted.
///
/// # Errors
/// See [`PortError`], whose texts give advice.
pub fn open(address: &Address, key: Option<&Key>) -> Result<Port, PortError> {
    open_within(address, key, CONNECT_LIMIT)
}

/// Opens like [`open`], but gives up a TCP connection after `limit`. (The look-up of a host name may take
/// longer.)
pub(super) fn open_within(address: &Address, key: Option<&Key>, limit: Duration) -> Result<Port, PortError> {
    let address = match address {
        Address::Auto => choose(list())?,
        address => address.clone(),
    };
    let deadline = Instant::now() + limit;
    let opened = match &address {
        Address::Auto => Err(io::ErrorKind::Unsupported.into()), // cannot be: nobody announces it
        Address::Path(path) => return open_serial(path).map(|file| Port::new(file, address)),
        Address::Unix(path) => connect_unix(path),
        Address::Tcp(host) => connect_tcp(host, limit),
    };
    let file = match opened {
        Ok(file) => file,
        Err(error) => return Err(explain(address, error)),
    };
    let (Address::Tcp(_), Some(key)) = (&address, key) else { return Ok(Port::new(file, address)) };
    match Channel::connect(&file, key, deadline) {
        Ok(channel) => {
            let encryption = Encryption { channel, out: VecDeque::new(), content: VecDeque::new() };
            Ok(Port { encryption: Some(encryption), ..Port::new(file, address) })
        }
        Err(Failed::NoGreeting) => Err(PortError::NotEncrypted { address }),
        Err(Failed::Refused) => Err(PortError::KeyRefused { address }),
        Err(Failed::Link(error)) => Err(explain(address, error)),
    }
}

/// Chooses the board for `auto`.
fn choose(found: Vec<Found>) -> Result<Address, PortError> {
    let (mut boards, others): (Vec<_>, Vec<_>) =
        found.into_iter().partition(|found| found.automatic && found.address != Address::Auto);
    match boards.pop() {
        None => Err(PortError::NoDevice { others }),
        Some(board) if boards.is_empty() => Ok(board.address),
        Some(board) => {
            boards.push(board);
            Err(PortError::Several { found: boards })
        }
    }
}

fn connect_unix(path: &Path) -> io::Result<File> {
    let socket = UnixStream::connect(path)?;
    socket.set_nonblocking(true)?;
    Ok(OwnedFd::from(socket).into())
}

fn connect_tcp(host: &str, limit: Duration) -> io::Result<File> {
    let mut failed = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    for address in host.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, limit.max(Duration::from_millis(1))) {
            Ok(socket) => {
                socket.set_nonblocking(true)?;
                // Requests are short, and their answers are awaited.
                socket.set_nodelay(true)?;
                return Ok(OwnedFd::from(socket).into());
            }
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

/// Turns the system's error into advice.
pub(super) fn explain(address: Address, source: io::Error) -> PortError {
    match (source.kind(), &address) {
        (io::ErrorKind::ResourceBusy, Address::Path(path)) => busy(path),
        (io::ErrorKind::PermissionDenied, Address::Path(path)) => {
            PortError::Permission { group: group(path), path: path.clone() }
        }
        (io::ErrorKind::PermissionDenied, Address::Unix(path)) => {
            PortError::OthersSocket { path: path.clone() }
        }
        (io::ErrorKind::NotFound, Address::Path(_) | Address::Unix(_)) => {
            PortError::DoesNotExist { address, found: list() }
        }
        (io::ErrorKind::ConnectionRefused, Address::Unix(path)) => match no_socket(path) {
            Some(kind) => PortError::NotSocket { path: path.clone(), kind },
            None => PortError::Refused { address },
        },
        (io::ErrorKind::ConnectionRefused, _) => PortError::Refused { address },
        _ => PortError::Other { address, source },
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::port::tests::{Pty, folder};
    use std::fs;
    use std::io::Write as _;
    use std::net::TcpListener;
    use std::os::unix::net::UnixListener;

    fn path(path: impl AsRef<Path>) -> Address {
        Address::Path(path.as_ref().to_owned())
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_millis(20)
    }

    #[test]
    fn a_terminal_carries_every_byte_both_ways_and_is_locked() {
        let mut pty = Pty::new();
        let mut port = open(&path(&pty.path), None).unwrap();
        let every: Vec<u8> = (0..=255).collect();
        port.send(&every).unwrap();
        let mut buffer = [0; 256];
        pty.master.read_exact(&mut buffer).unwrap();
        assert_eq!(buffer[..], every);
        pty.master.write_all(&every).unwrap();
        let mut received: Vec<u8> = Vec::new();
        while received.len() < 256 {
            let length = port.receive(&mut buffer, Instant::now() + Duration::from_secs(2)).unwrap();
            assert!(length > 0, "lost after {received:?}");
            received.extend(&buffer[..length]);
        }
        assert_eq!(received, every);
        assert_eq!(port.receive(&mut buffer, soon()).unwrap(), 0);

        let error = open(&path(&pty.path), None).unwrap_err();
        let PortError::Busy { pid, .. } = &error else { panic!("{error}") };
        assert_eq!(*pid, Some(std::process::id()), "{error}");
        drop(port);
        open(&path(&pty.path), None).unwrap();
    }

    #[test]
    fn a_terminal_that_goes_away_is_an_error_not_silence() {
        let pty = Pty::new();
        let mut port = open(&path(&pty.path), None).unwrap();
        drop(pty);
        assert!(port.receive(&mut [0; 8], soon()).is_err());
        assert!(port.send(&[1, 0]).is_err());
    }

    #[test]
    fn a_socket_that_is_closed_is_an_error_after_its_last_bytes() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let mut port = open(&Address::Tcp(listener.local_addr().unwrap().to_string()), None).unwrap();
        let (mut peer, _) = listener.accept().unwrap();
        peer.write_all(&[5, 0]).unwrap();
        drop(peer);
        let mut buffer = [0; 8];
        assert_eq!(port.receive(&mut buffer, soon()).unwrap(), 2);
        let error = port.receive(&mut buffer, soon()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn each_failure_has_its_own_advice() {
        let folder = folder("failures");
        fs::create_dir_all(&folder).unwrap();
        let socket = folder.join("x.sock");
        let error = open(&path("/dev/ttyNONE9"), None).unwrap_err();
        assert!(matches!(error, PortError::DoesNotExist { .. }), "{error}");
        let error = open(&Address::Unix(socket.clone()), None).unwrap_err();
        assert!(matches!(error, PortError::DoesNotExist { .. }), "{error}");
        let listener = UnixListener::bind(&socket).unwrap();
        let error = open(&path(&socket), None).unwrap_err().to_string();
        assert!(error.contains("write unix:///"), "{error}");
        drop(listener); // leaves its file
        let error = open(&Address::Unix(socket), None).unwrap_err();
        assert!(matches!(error, PortError::Refused { .. }), "{error}");
        for other in [Path::new("/dev/null"), &folder] {
            let error = open(&path(other), None).unwrap_err();
            assert!(matches!(error, PortError::NotSerial { .. }), "{error}");
        }
        let file = folder.join("notes.txt");
        fs::write(&file, "").unwrap();
        for (other, words) in
            [(&*folder, "is a folder, not a socket"), (&*file, "is a regular file, not a socket")]
        {
            let error = open(&Address::Unix(other.to_owned()), None).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("`tesaki share`"), "{error}");
        }
        let denied = explain(path("/dev/null"), io::ErrorKind::PermissionDenied.into());
        assert!(matches!(&denied, PortError::Permission { group, .. } if group == "dialout"), "{denied}");
        let denied = explain(Address::Unix(file), io::ErrorKind::PermissionDenied.into()).to_string();
        assert!(denied.contains("another user") && !denied.contains("dialout"), "{denied}");
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let error = open(&Address::Tcp(port.to_string()), None).unwrap_err();
        assert!(matches!(error, PortError::Refused { .. }), "{error}");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn auto_takes_the_only_board_and_no_built_in_port() {
        let found = |name: &str, automatic| Found {
            address: path(name),
            description: String::new(),
            simulated: false,
            automatic,
        };
        assert_eq!(choose(vec![found("s", false), found("a", true)]).unwrap(), path("a"));
        let none = choose(vec![found("s", false)]);
        assert!(matches!(none, Err(PortError::NoDevice { others }) if others.len() == 1));
        let several = choose(vec![found("a", true), found("b", true)]);
        assert!(matches!(several, Err(PortError::Several { found }) if found.len() == 2));
    }
}
