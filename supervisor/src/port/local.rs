//! Streams between programs on one machine, for pictures or lines of text.

use std::io;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags};

use super::listener::{Listener, SocketFile, no_socket};
use super::{Address, stream};

/// How long a program may take to accept a connection.
const CONNECT: Duration = Duration::from_secs(1);

/// A socket for other programs on this machine. The file of a Unix socket is removed with it.
#[derive(Debug)]
pub struct LocalListener {
    listener: Listener,
    address: Address,
}

impl LocalListener {
    /// Listens at a Unix socket or a TCP port of this machine.
    ///
    /// # Errors
    /// When the address is in use, is not that of a socket, or is reachable from other machines.
    pub fn new(address: &Address) -> io::Result<Self> {
        let fail =
            |error: io::Error| io::Error::new(error.kind(), format!("cannot listen at {address}: {error}"));
        if let Address::Tcp(host) = address
            && !host.to_socket_addrs().map_err(fail)?.all(|host| host.ip().to_canonical().is_loopback())
        {
            let error = format!(
                "cannot listen at {address}: other machines reach it. Use tcp://localhost:PORT, and a tunnel such as \
                 `ssh -L` for other machines"
            );
            return Err(io::Error::new(io::ErrorKind::InvalidInput, error));
        }
        let (listener, address) = Listener::new(address, None)?;
        Ok(Self { listener, address })
    }

    /// The address at which it listens, with the port that the system chose for port 0.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// Takes the file of a Unix socket, which is then removed when the returned value is dropped: for a
    /// listener in a thread that runs until the process ends.
    #[must_use]
    pub fn take_file(&mut self) -> SocketFile {
        self.listener.take_file()
    }

    /// Accepts the next program that connects within this time.
    ///
    /// # Errors
    /// When the socket fails.
    pub fn accept(&self, within: Duration) -> io::Result<Option<UnixStream>> {
        let mut fds = [PollFd::new(self.listener.fd(), PollFlags::POLLIN)];
        if !stream::wait(&mut fds, Instant::now() + within)? {
            return Ok(None);
        }
        // A program that has already left does not count.
        let Ok(accepted) = self.listener.accept() else { return Ok(None) };
        blocking(accepted.socket).map(Some)
    }
}

/// Connects to a program that listens at a Unix socket or a TCP port.
///
/// # Errors
/// When no program listens there.
pub fn connect(address: &Address) -> io::Result<UnixStream> {
    match address {
        Address::Unix(path) => UnixStream::connect(path).map_err(|error| match no_socket(path) {
            Some(kind) => io::Error::new(error.kind(), format!("it is {kind}, not a socket")),
            None => error,
        }),
        Address::Tcp(host) => {
            let mut failed = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
            for address in host.to_socket_addrs()? {
                match TcpStream::connect_timeout(&address, CONNECT) {
                    Ok(socket) => {
                        socket.set_nodelay(true)?;
                        return blocking(socket.into());
                    }
                    Err(error) => failed = error,
                }
            }
            Err(failed)
        }
        Address::Auto | Address::Path(_) => {
            let error = format!("{address} is not a socket: use unix:///run/NAME or tcp://localhost:PORT");
            Err(io::Error::new(io::ErrorKind::InvalidInput, error))
        }
    }
}

/// Makes a socket blocking. The methods of [`UnixStream`] work for TCP sockets, too.
fn blocking(socket: OwnedFd) -> io::Result<UnixStream> {
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(false)?;
    Ok(stream)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::io::{Read as _, Write as _};

    use super::*;

    #[test]
    fn both_kinds_of_sockets_carry_bytes_both_ways() {
        let folder = crate::port::tests::folder("local");
        std::fs::create_dir_all(&folder).unwrap();
        for address in [Address::Unix(folder.join("socket")), Address::Tcp("127.0.0.1:0".to_owned())] {
            let listener = LocalListener::new(&address).unwrap();
            assert!(listener.accept(Duration::ZERO).unwrap().is_none());
            let mut client = connect(listener.address()).unwrap();
            let mut server = listener.accept(Duration::from_secs(10)).unwrap().unwrap();
            client.write_all(b"question").unwrap();
            let mut bytes = [0; 8];
            server.read_exact(&mut bytes).unwrap();
            assert_eq!(&bytes, b"question");
            server.write_all(b"answered").unwrap();
            drop(server);
            let mut answer = String::new();
            client.read_to_string(&mut answer).unwrap();
            assert_eq!(answer, "answered");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_file_of_a_socket_goes_with_who_keeps_it() {
        let folder = crate::port::tests::folder("socket-file");
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("socket");
        let listen = || LocalListener::new(&Address::Unix(path.clone())).unwrap();
        drop(listen());
        assert!(!path.exists());
        let mut listener = listen();
        let file = listener.take_file();
        assert!(path.exists());
        drop(file);
        assert!(!path.exists());
        // A file that another program has created there in the meantime is not removed.
        let _again = listen();
        drop(listener);
        assert!(path.exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn other_machines_do_not_get_in() {
        let error = LocalListener::new(&Address::Tcp("0.0.0.0:0".to_owned())).unwrap_err();
        assert!(error.to_string().contains("other machines reach it"), "{error}");
        assert!(connect(&Address::Auto).is_err());
    }
}
