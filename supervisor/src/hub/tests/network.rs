//! Clients over TCP: which addresses are allowed, and which clients are admitted.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use super::*;
use crate::port::channel::GREETING;
use crate::port::{PortError, Reopening};

fn tcp(text: &str) -> Address {
    Address::Tcp(text.to_owned())
}

fn key(folder: &std::path::Path, name: &str) -> Key {
    fs::create_dir_all(folder).unwrap();
    Key::create(&folder.join(name)).unwrap();
    Key::read(&folder.join(name)).unwrap()
}

/// A hub in a thread that sends back every frame.
struct Echo {
    address: Address,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Hub>,
}

impl Echo {
    fn new(key: Option<&Key>) -> Self {
        let mut hub = Hub::listen(&tcp("127.0.0.1:0"), key).unwrap();
        let (address, stop) = (hub.address().clone(), Arc::new(AtomicBool::new(false)));
        let flag = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let mut frames = Vec::new();
            while !flag.load(Ordering::Relaxed) {
                hub.receive(&mut frames, within(1)).unwrap();
                hub.broadcast(&std::mem::take(&mut frames));
            }
            hub
        });
        Self { address, stop, thread }
    }

    fn host(&self) -> SocketAddr {
        let Address::Tcp(host) = &self.address else { panic!() };
        host.parse().unwrap()
    }

    fn stop(self) -> Hub {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

#[track_caller]
fn echoes(port: &mut Port) {
    port.send(&[5, 6, 0]).unwrap();
    assert_eq!(received(port, 3), [5, 6, 0]);
}

/// Reads until the end of the connection.
fn read_to_end(mut socket: TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    match socket.read_to_end(&mut bytes) {
        Err(error) if error.kind() != io::ErrorKind::ConnectionReset => panic!("still open: {error}"),
        _ => bytes,
    }
}

#[test]
fn only_loopback_is_listened_at_without_a_key() {
    for host in ["127.0.0.1:0", "127.1.2.3:0", "[::1]:0", "localhost:0", "[::ffff:127.0.0.1]:0"] {
        match Hub::listen(&tcp(host), None) {
            Ok(_) => {}
            // A machine without IPv6.
            Err(error) => assert!(host.starts_with('[') && error.raw_os_error().is_none(), "{host}: {error}"),
        }
    }
    let folder = folder("hub-open");
    let key = key(&folder, "key");
    for host in ["0.0.0.0:0", "[::]:0", "[::ffff:0.0.0.0]:0", "192.0.2.1:0", "[2001:db8::1]:0"] {
        let error = Hub::listen(&tcp(host), None).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput, "{host}: {error}");
        for words in [host, "without a key", "tesaki key FILE", "--key FILE", "tcp://localhost:7400"] {
            assert!(error.to_string().contains(words), "{host}: {error}");
        }
    }
    Hub::listen(&tcp("0.0.0.0:0"), Some(&key)).unwrap();
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn who_has_the_key_talks_to_the_board_and_nobody_else() {
    let folder = folder("hub-key");
    let [key, wrong] = ["key", "wrong"].map(|name| key(&folder, name));
    let echo = Echo::new(Some(&key));
    let mut client = open(&echo.address, Some(&key)).unwrap();
    echoes(&mut client);
    // More than one message, and more than the sockets can hold.
    let frame = [[7; LONGEST_FRAME - 1].as_slice(), &[0]].concat();
    let many = frame.repeat(100);
    client.send(&many).unwrap();
    assert!(received(&mut client, many.len()) == many);

    let error = open(&echo.address, Some(&wrong)).unwrap_err();
    assert!(matches!(error, PortError::KeyRefused { .. }), "{error}");
    assert!(error.to_string().contains("the same key file"), "{error}");

    let mut plain = open(&echo.address, None).unwrap();
    plain.send(&[1, 0]).unwrap();
    let error = ByteLink::receive(&mut plain, &mut [0; 4096], within(1000)).unwrap_err();
    assert!(
        error.to_string().contains("is encrypted") && error.to_string().contains("--key FILE"),
        "{error}"
    );
    // A reopening link also reports this, because waiting does not help.
    let mut plain = Reopening::open(echo.address.clone(), None).unwrap();
    ByteLink::receive(&mut plain, &mut [0; 4096], within(1000)).unwrap_err();
    drop(plain);

    let mut garbage = TcpStream::connect(echo.host()).unwrap();
    garbage.write_all(&[GREETING, &[9; 500]].concat()).unwrap();
    assert_eq!(read_to_end(garbage), GREETING);
    echoes(&mut client);
    let mut hub = echo.stop();
    let messages = hub.messages().join("\n");
    for words in ["has another key", "has no key", "127.0.0.1:"] {
        assert!(messages.contains(words), "{messages}");
    }
    assert_eq!(hub.clients(), 1, "only the client with the key: {messages}");
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_key_for_a_port_without_one_is_an_error() {
    let folder = folder("hub-plain");
    let key = key(&folder, "key");
    let mut hub = Hub::listen(&tcp("127.0.0.1:0"), None).unwrap();
    let address = hub.address().clone();
    let open = thread::spawn(move || open(&address, Some(&key)).unwrap_err());
    // It neither waits for ever nor sends anything to the board.
    let mut frames = Vec::new();
    while !open.is_finished() {
        hub.receive(&mut frames, within(10)).unwrap();
        hub.broadcast(&[3, 0]);
    }
    let error = open.join().unwrap();
    assert!(matches!(error, PortError::NotEncrypted { .. }), "{error}");
    assert!(error.to_string().contains("leave --key out"), "{error}");
    assert!(frames.is_empty(), "{frames:?}");
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_page_in_a_browser_commands_nothing() {
    let echo = Echo::new(None);
    for method in ["POST", "GET"] {
        let mut browser = TcpStream::connect(echo.host()).unwrap();
        browser.write_all(format!("{method} / HTTP/1.1\r\n\r\n\0\u{5}\u{6}\0").as_bytes()).unwrap();
        assert_eq!(read_to_end(browser), b"");
    }
    let messages = echo.stop().messages();
    assert_eq!(messages.len(), 2);
    assert!(messages[0].contains("web browser"), "{messages:?}");
}

#[test]
fn half_open_connections_are_bounded_and_hold_up_nobody() {
    let folder = folder("hub-flood");
    let key = key(&folder, "key");
    let echo = Echo::new(Some(&key));
    let mut client = open(&echo.address, Some(&key)).unwrap();
    let silent: Vec<TcpStream> = (0..60).map(|_| TcpStream::connect(echo.host()).unwrap()).collect();
    // Half a handshake counts as none.
    (&silent[59]).write_all(&GREETING[..9]).unwrap();
    let start = Instant::now();
    echoes(&mut client);
    let mut other = open(&echo.address, Some(&key)).unwrap();
    echoes(&mut other);
    assert!(start.elapsed() < Duration::from_secs(1), "{:?}", start.elapsed());
    // The first ones were dropped to make room, the last ones by their time limit.
    for socket in silent {
        assert_eq!(read_to_end(socket), GREETING);
    }
    assert!(start.elapsed() < Duration::from_secs(4), "{:?}", start.elapsed());
    echoes(&mut client);
    let mut hub = echo.stop();
    assert_eq!(hub.clients(), 2);
    let messages = hub.messages();
    assert!(messages.iter().any(|message| message.contains("too many connections")), "{messages:?}");
    assert!(messages.len() <= MAX_MESSAGES);
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_client_that_does_not_read_loses_whole_messages_only() {
    let folder = folder("hub-slow-key");
    let key = key(&folder, "key");
    let echo = Echo::new(Some(&key));
    let mut client = open(&echo.address, Some(&key)).unwrap();
    let mut talks = open(&echo.address, Some(&key)).unwrap();
    let frame = [[7; LONGEST_FRAME - 1].as_slice(), &[0]].concat();
    for _ in 0..200 {
        let many = frame.repeat(80);
        talks.send(&many).unwrap();
        assert!(received(&mut talks, many.len()) == many);
    }
    // Data that arrive late can still be decrypted.
    let mut buffer = [0; 4096];
    while ByteLink::receive(&mut client, &mut buffer, within(100)).unwrap() > 0 {}
    echoes(&mut client);
    let hub = echo.stop();
    assert!(hub.dropped() > 0);
    fs::remove_dir_all(folder).unwrap();
}

/// A hub behind a slow network, which acts only every 20 ms.
fn far_hub(address: &Address, key: &Key, until: &Arc<AtomicBool>) -> JoinHandle<()> {
    let mut hub = Hub::listen(address, Some(key)).unwrap();
    let stop = Arc::clone(until);
    thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(20));
            hub.receive(&mut Vec::new(), Instant::now()).unwrap();
            hub.broadcast(&[7, 0]);
        }
    })
}

#[test]
fn a_board_behind_an_encrypted_network_is_found_again_while_it_is_pumped() {
    let folder = folder("hub-away");
    let key = key(&folder, "key");
    let board = Hub::listen(&tcp("127.0.0.1:0"), Some(&key)).unwrap();
    let address = board.address().clone();
    drop(board);
    let [first, second] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
    let far = far_hub(&address, &key, &first);
    let mut hub = Hub::listen(&tcp("127.0.0.1:0"), None).unwrap();
    let mut client = open(hub.address(), None).unwrap();
    let mut board = Reopening::open(address.clone(), Some(key.clone())).unwrap();
    let turn = Duration::from_millis(1);
    hub.pump(&mut board, turn, within(100)).unwrap();
    assert_eq!(received(&mut client, 2), [7, 0]);
    first.store(true, Ordering::Relaxed);
    far.join().unwrap();
    hub.pump(&mut board, turn, within(300)).unwrap();
    assert!(!board.is_open() && board.error().is_some());
    // Reads what was sent before.
    while client.receive(&mut [0; 64], within(0)).unwrap() > 0 {}

    let far = far_hub(&address, &key, &second);
    let given_up = within(10_000);
    while !board.is_open() && Instant::now() < given_up {
        hub.pump(&mut board, turn, within(100)).unwrap();
    }
    assert_eq!(board.reopened(), 1, "{:?}", board.error());
    hub.pump(&mut board, turn, within(200)).unwrap();
    assert_eq!(received(&mut client, 2), [7, 0]);
    second.store(true, Ordering::Relaxed);
    far.join().unwrap();
    fs::remove_dir_all(folder).unwrap();
}
