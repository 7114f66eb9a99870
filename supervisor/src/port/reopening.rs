use std::io;
use std::thread;
use std::time::{Duration, Instant};

use super::open::open_within;
use super::{Address, Key, Port, PortError, open};
use crate::ByteLink;

/// Interval between attempts to open a lost port.
const RETRY: Duration = Duration::from_millis(100);
/// Time by which an attempt over the network may exceed the caller's deadline: some round trips, for the
/// connection and the handshake. The board is not connected, so none of its data are delayed.
const NETWORK_LIMIT: Duration = Duration::from_millis(300);

/// A link that survives unplugging and reconnecting, or a simulator's restart.
///
/// While the port is absent, nothing is received, and sent bytes are lost and counted, as on a bad wire. It
/// fails only if the other end requires a key ([`PortError::KeyNeeded`]). An attempt to reopen a TCP port
/// takes up to 0.3 s, even if the caller's deadline is earlier. [`Address::Auto`] is resolved anew each time,
/// because an adapter may return under another number.
#[derive(Debug)]
pub struct Reopening {
    address: Address,
    key: Option<Key>,
    port: Option<Port>,
    next_try: Instant,
    reopened: u32,
    lost: u64,
    /// Whether the last frame was cut: what follows would be taken for its end.
    is_cut: bool,
    error: Option<PortError>,
}

impl Reopening {
    /// Creates a link to `address`, which is opened on the first receive; see [`open`] for `key`.
    pub fn new(address: Address, key: Option<Key>) -> Self {
        Self {
            address,
            key,
            port: None,
            next_try: Instant::now(),
            reopened: 0,
            lost: 0,
            is_cut: false,
            error: None,
        }
    }

    /// Opens a link to `address`, which must be available now.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn open(address: Address, key: Option<Key>) -> Result<Self, PortError> {
        let port = open(&address, key.as_ref())?;
        Ok(Self { port: Some(port), ..Self::new(address, key) })
    }

    /// Number of times that the port was reopened, or opened late.
    pub const fn reopened(&self) -> u32 {
        self.reopened
    }

    /// Returns whether the port is open.
    pub const fn is_open(&self) -> bool {
        self.port.is_some()
    }

    /// The open port.
    pub const fn port(&self) -> Option<&Port> {
        self.port.as_ref()
    }

    /// Number of bytes that were sent while the port was closed, or that the peer did not accept.
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    /// Error of the last attempt to open the port; `None` while it is open.
    pub const fn error(&self) -> Option<&PortError> {
        self.error.as_ref()
    }

    fn close(&mut self) {
        self.port = None;
        // Not immediately, because the device file of an unplugged adapter remains for a moment.
        self.next_try = Instant::now() + RETRY;
    }

    fn reopen(&mut self, deadline: Instant) {
        let limit = deadline.saturating_duration_since(Instant::now());
        let limit = if matches!(self.address, Address::Tcp(_)) { limit.max(NETWORK_LIMIT) } else { limit };
        match open_within(&self.address, self.key.as_ref(), limit) {
            Ok(port) => {
                self.port = Some(port);
                self.error = None;
                self.reopened = self.reopened.wrapping_add(1);
            }
            Err(error) => self.error = Some(error),
        }
        self.next_try = Instant::now() + RETRY;
    }
}

impl ByteLink for Reopening {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let begin: &[u8] = if self.is_cut { &[0] } else { &[] };
        let result = self.port.as_mut().map(|port| port.send(&[begin, bytes].concat()));
        self.is_cut = matches!(result, Some(Err(_)));
        if !matches!(result, Some(Ok(()))) {
            self.lost = self.lost.wrapping_add(u64::try_from(bytes.len()).unwrap_or(u64::MAX));
        }
        // A peer that accepts no bytes is stuck but present, and reopening would not help.
        if matches!(&result, Some(Err(error)) if error.kind() != io::ErrorKind::TimedOut) {
            self.close();
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
        loop {
            if let Some(port) = &mut self.port {
                match port.receive(buffer, deadline) {
                    Ok(length) => return Ok(length),
                    Err(error) if error.kind() == io::ErrorKind::PermissionDenied => return Err(error),
                    Err(_) => self.close(),
                }
            } else if self.next_try <= Instant::now() {
                self.reopen(deadline);
            } else {
                let wake = self.next_try.min(deadline);
                thread::sleep(wake.saturating_duration_since(Instant::now()));
                if wake == deadline {
                    return Ok(0);
                }
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::port::tests::folder;
    use std::fs;
    use std::io::Write as _;
    use std::os::unix::net::UnixListener;

    fn within(milliseconds: u64) -> Instant {
        Instant::now() + Duration::from_millis(milliseconds)
    }

    #[test]
    fn a_socket_that_is_closed_and_listened_to_again_is_opened_again() {
        let folder = folder("reopening");
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("x.sock");
        let listener = UnixListener::bind(&path).unwrap();
        let mut link = Reopening::open(Address::Unix(path.clone()), None).unwrap();
        let (mut peer, _) = listener.accept().unwrap();
        peer.write_all(&[1]).unwrap();
        let mut buffer = [0; 8];
        assert_eq!(link.receive(&mut buffer, within(1000)).unwrap(), 1);

        drop((peer, listener));
        fs::remove_file(&path).unwrap();
        // The deadline holds although the next attempt comes later: at least once in several tries, because
        // the machine may be busy.
        let mut waited = (0..100).map(|_| {
            let start = Instant::now();
            assert_eq!(link.receive(&mut buffer, within(20)).unwrap(), 0);
            start.elapsed().as_millis()
        });
        assert!(waited.any(|waited| (20..60).contains(&waited)));
        assert_eq!(link.receive(&mut buffer, within(150)).unwrap(), 0);
        assert!(!link.is_open());
        assert!(matches!(link.error(), Some(PortError::DoesNotExist { .. })));
        link.send(&[1, 2, 3]).unwrap();
        assert_eq!((link.lost(), link.reopened()), (3, 0));

        let listener = UnixListener::bind(&path).unwrap();
        let server = thread::spawn(move || {
            let (mut peer, _) = listener.accept().unwrap();
            peer.write_all(&[7, 8]).unwrap();
            peer
        });
        assert_eq!(link.receive(&mut buffer, within(2000)).unwrap(), 2);
        assert_eq!(buffer[..2], [7, 8]);
        assert!(link.is_open() && link.error().is_none());
        link.send(&[4]).unwrap();
        assert_eq!((link.lost(), link.reopened()), (3, 1));
        drop(server.join().unwrap());
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_is_not_there_at_all_is_told_at_once() {
        let error = Reopening::open(Address::Path("/dev/ttyNONE9".into()), None).unwrap_err();
        assert!(matches!(error, PortError::DoesNotExist { .. }));
        let mut link = Reopening::new(Address::Path("/dev/ttyNONE9".into()), None);
        assert_eq!(link.receive(&mut [0; 8], within(10)).unwrap(), 0);
    }
}
