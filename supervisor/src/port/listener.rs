use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, ToSocketAddrs as _};
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::channel::Channel;
use super::{Address, Key};

/// A socket that accepts clients.
#[derive(Debug)]
pub(crate) enum Listener {
    /// With its address for messages, and its file.
    Unix(UnixListener, String, SocketFile),
    /// With the key that its clients need.
    Tcp(TcpListener, Option<Key>),
}

/// The file of a Unix socket, which is removed when this is dropped.
#[derive(Debug, Default)]
pub struct SocketFile(Option<PathBuf>);

impl Drop for SocketFile {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            let _ = fs::remove_file(path);
        }
    }
}

/// A client that was accepted.
pub(crate) struct Accepted {
    /// Where it is, for messages.
    pub(crate) name: String,
    /// It does not block.
    pub(crate) socket: OwnedFd,
    pub(crate) encryption: Option<Channel>,
}

impl Listener {
    /// Listens, and says where: with the port that the system chose, if port 0 was asked for. A TCP port
    /// needs a key, unless only programs on this machine reach it.
    pub(crate) fn new(address: &Address, key: Option<&Key>) -> io::Result<(Self, Address)> {
        match address {
            Address::Unix(path) => {
                let listener = listen_unix(path)?;
                let file = SocketFile(Some(path.clone()));
                Ok((Self::Unix(listener, address.to_string(), file), address.clone()))
            }
            Address::Tcp(host) => {
                let fail = |error: io::Error| {
                    let hint = if error.kind() == io::ErrorKind::AddrInUse {
                        ": another program listens there, perhaps another simulator; end it, or choose another port"
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

    /// The file of the socket, which then no longer goes with the listener; empty for TCP, and the second
    /// time.
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

    /// The next client.
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

/// Whether only this machine reaches an address.
fn is_loopback(host: IpAddr) -> bool {
    // An IPv4 address may be written as an IPv6 one.
    host.to_canonical().is_loopback()
}

/// Listens at a socket file, replacing one left behind by a crashed program.
fn listen_unix(path: &Path) -> io::Result<UnixListener> {
    let fail = |error: io::Error| {
        io::Error::new(error.kind(), format!("cannot listen at unix://{}: {error}", path.display()))
    };
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
    let listener = UnixListener::bind(path).map_err(fail)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}
