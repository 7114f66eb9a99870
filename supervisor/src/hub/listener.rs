use std::fs::{self, File};
use std::io;
use std::net::TcpListener;
use std::os::fd::{AsFd as _, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use crate::port::Address;

/// A socket that accepts clients.
#[derive(Debug)]
pub(super) enum Listener {
    /// With its file, which goes with it.
    Unix(UnixListener, PathBuf),
    Tcp(TcpListener),
}

impl Listener {
    /// Listens, and says where: with the port that the system chose, if port 0 was asked for.
    pub(super) fn new(address: &Address) -> io::Result<(Self, Address)> {
        match address {
            Address::Unix(path) => Ok((Self::Unix(listen_unix(path)?, path.clone()), address.clone())),
            Address::Tcp(host) => {
                let listener = TcpListener::bind(host).map_err(|error| {
                    io::Error::new(error.kind(), format!("cannot listen at {address}: {error}"))
                })?;
                listener.set_nonblocking(true)?;
                let bound = Address::Tcp(listener.local_addr()?.to_string());
                Ok((Self::Tcp(listener), bound))
            }
            Address::Auto | Address::Path(_) => Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!(
                    "cannot listen at {address}: use a socket such as unix:///run/hand.sock or tcp://localhost:7400"
                ),
            )),
        }
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Unix(listener, _) => listener.as_fd(),
            Self::Tcp(listener) => listener.as_fd(),
        }
    }

    /// The next client, as a non-blocking file.
    pub(super) fn accept(&self) -> io::Result<File> {
        match self {
            Self::Unix(listener, _) => {
                let (socket, _) = listener.accept()?;
                socket.set_nonblocking(true)?;
                Ok(OwnedFd::from(socket).into())
            }
            Self::Tcp(listener) => {
                let (socket, _) = listener.accept()?;
                socket.set_nonblocking(true)?;
                socket.set_nodelay(true)?;
                Ok(OwnedFd::from(socket).into())
            }
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            let _ = fs::remove_file(path);
        }
    }
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
