use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, ToSocketAddrs as _};
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::channel::Channel;
use super::{Address, Key};

/// A socket that accepts clients.
#[derive(Debug)]
pub(crate) enum Listener {
    /// A Unix socket with its address for messages, and its file.
    Unix(UnixListener, String, SocketFile),
    /// A TCP socket with the key that its clients need.
    Tcp(TcpListener, Option<Key>),
}

/// The file of a Unix socket, which is removed when this is dropped.
#[derive(Debug, Default)]
pub struct SocketFile(Option<(PathBuf, [u64; 2])>);

impl SocketFile {
    fn new(path: PathBuf) -> Self {
        let number = number(&path);
        Self(number.map(|number| (path, number)))
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if let Some((path, own)) = &self.0
            // Another program may have put its own there since.
            && number(path) == Some(*own)
        {
            let _ = fs::remove_file(path);
        }
    }
}

/// What tells a file from all others that are there: its device, and its number on it.
fn number(path: &Path) -> Option<[u64; 2]> {
    fs::symlink_metadata(path).ok().map(|file| [file.dev(), file.ino()])
}

/// A client that was accepted.
pub(crate) struct Accepted {
    /// Its address, for messages.
    pub(crate) name: String,
    /// Non-blocking socket.
    pub(crate) socket: OwnedFd,
    pub(crate) encryption: Option<Channel>,
}

impl Listener {
    /// Listens, and returns the address with the port that the system chose for port 0. A TCP port needs a
    /// key, unless it is only reachable from this machine.
    pub(crate) fn new(address: &Address, key: Option<&Key>) -> io::Result<(Self, Address)> {
        match address {
            Address::Unix(path) => {
                let listener = listen_unix(path)?;
                let file = SocketFile::new(path.clone());
                Ok((Self::Unix(listener, address.to_string(), file), address.clone()))
            }
            Address::Tcp(host) => {
                let fail = |error: io::Error| {
                    let hint = if error.kind() == io::ErrorKind::AddrInUse {
                        ": another program listens there, perhaps `tesaki share` or `cargo sim serve`; end it, or choose another port"
                    } else {
                        ""
                    };
                    io::Error::new(error.kind(), format!("cannot listen at {address}: {error}{hint}"))
                };
                let hosts: Vec<SocketAddr> = host.to_socket_addrs().map_err(fail)?.collect();
                if key.is_none() && !hosts.iter().all(|host| is_loopback(host.ip())) {
                    return Err(io::Error::new(
                        io::ErrorKind::InvalidInput,
                        format!(
                            "cannot listen at {address} without a key: everybody who reaches this machine \
                             could command the board. Make a key with `tesaki key FILE` and give it with \
                             --key FILE (or TESAKI_KEY), here and to the clients; or listen where only this \
                             machine gets in, at tcp://localhost:7400 or unix:///run/hand.sock"
                        ),
                    ));
                }
                let listener = TcpListener::bind(&hosts[..]).map_err(fail)?;
                listener.set_nonblocking(true)?;
                let bound = Address::Tcp(listener.local_addr()?.to_string());
                Ok((Self::Tcp(listener, key.cloned()), bound))
            }
            Address::Auto | Address::Path(_) => Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!(
                    "cannot listen at {address}: use a socket such as unix:///run/hand.sock or tcp://localhost:7400"
                ),
            )),
        }
    }

    /// Takes the file of the socket, which then no longer belongs to the listener; empty for TCP, and in
    /// later calls.
    pub(crate) fn take_file(&mut self) -> SocketFile {
        match self {
            Self::Unix(_, _, file) => std::mem::take(file),
            Self::Tcp(..) => SocketFile::default(),
        }
    }

    pub(crate) fn fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Unix(listener, ..) => listener.as_fd(),
            Self::Tcp(listener, _) => listener.as_fd(),
        }
    }

    /// Accepts the next client.
    pub(crate) fn accept(&self) -> io::Result<Accepted> {
        match self {
            Self::Unix(listener, name, _) => {
                let (socket, _) = listener.accept()?;
                socket.set_nonblocking(true)?;
                let name = name.clone();
                Ok(Accepted { name, socket: socket.into(), encryption: None })
            }
            Self::Tcp(listener, key) => {
                let (socket, peer) = listener.accept()?;
                socket.set_nonblocking(true)?;
                socket.set_nodelay(true)?;
                let encryption = key.clone().map(Channel::listening);
                Ok(Accepted { name: peer.to_string(), socket: socket.into(), encryption })
            }
        }
    }
}

/// What is at a path, if it is something other than a socket.
pub(super) fn no_socket(path: &Path) -> Option<&'static str> {
    let kind = fs::metadata(path).ok()?.file_type();
    match () {
        () if kind.is_socket() => None,
        () if kind.is_dir() => Some("a folder"),
        () if kind.is_file() => Some("a regular file"),
        () => Some("a device or a pipe"),
    }
}

/// Returns whether an address is only reachable from this machine.
fn is_loopback(host: IpAddr) -> bool {
    // An IPv4 address may be written as an IPv6 address.
    host.to_canonical().is_loopback()
}

/// Listens at a socket file, replacing one left behind by a crashed program.
fn listen_unix(path: &Path) -> io::Result<UnixListener> {
    let fail = |error: io::Error| {
        io::Error::new(error.kind(), format!("cannot listen at unix://{}: {error}", path.display()))
    };
    if let Some(kind) = no_socket(path) {
        let error = format!("{kind} is there: choose a new path for the socket");
        return Err(fail(io::Error::new(io::ErrorKind::InvalidInput, error)));
    }
    if fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket()) {
        match UnixStream::connect(path) {
            Ok(_) => {
                let error = "another program listens there: end it, or choose another path";
                return Err(fail(io::Error::new(io::ErrorKind::AddrInUse, error)));
            }
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                fs::remove_file(path).map_err(fail)?;
            }
            Err(error) => return Err(fail(error)),
        }
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir());
    if let Some(folder) = folder {
        let error = format!("there is no folder {}: make it, or choose another path", folder.display());
        return Err(fail(io::Error::new(io::ErrorKind::InvalidInput, error)));
    }
    let listener = UnixListener::bind(path).map_err(fail)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn what_is_no_socket_is_named_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("notes.txt");
        fs::write(&file, "kept").unwrap();
        for (path, words) in [(&*file, "a regular file is there"), (folder.path(), "a folder is there")] {
            let error = Listener::new(&Address::Unix(path.to_owned()), None).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("choose a new path"), "{error}");
        }
        assert_eq!(fs::read_to_string(&file).unwrap(), "kept");
        let below = Address::Unix(folder.path().join("none/socket"));
        let error = Listener::new(&below, None).unwrap_err().to_string();
        assert!(error.contains("there is no folder") && error.contains("none: make it"), "{error}");
    }

    #[test]
    fn a_socket_of_another_program_is_not_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let listen = || Listener::new(&Address::Unix(path.clone()), None).unwrap().0;
        let (first, held) = (listen(), folder.path().join("held"));
        // Its number is not given to another one.
        fs::rename(&path, &held).unwrap();
        let second = listen();
        drop(first);
        assert!(UnixStream::connect(&path).is_ok());
        drop(second);
        assert!(!path.exists());
    }
}
