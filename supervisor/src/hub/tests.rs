use std::fs;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::os::unix::net::UnixListener;
use std::thread;

use tesaki::protocol::codec::{MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Reply, ReplyFrame, Request, RequestFrame};

use super::*;
use crate::port::{Port, open, tests::folder};

mod network;

fn within(milliseconds: u64) -> Instant {
    Instant::now() + Duration::from_millis(milliseconds)
}

/// Creates a hub in a folder of its own.
fn hub(name: &str) -> (Hub, PathBuf) {
    let folder = folder(name);
    fs::create_dir_all(&folder).unwrap();
    (Hub::listen(&Address::Unix(folder.join("hub.sock")), None).unwrap(), folder)
}

fn received(link: &mut impl ByteLink, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    let mut filled = 0;
    while filled < length {
        match ByteLink::receive(link, &mut bytes[filled..], within(500)).unwrap() {
            0 => panic!("only {:?} came", &bytes[..filled]),
            more => filled += more,
        }
    }
    bytes
}

#[test]
fn two_clients_and_a_terminal_share_the_board() {
    let (mut hub, folder) = hub("hub-share");
    let pty = hub.add_pty().unwrap();
    let mut clients: Vec<Port> = [hub.address(), hub.address(), &Address::Path(pty)]
        .map(|address| open(address, None).unwrap())
        .into();
    // Interleaved pieces from different clients arrive as whole frames.
    clients[0].send(&[1, 1]).unwrap();
    clients[1].send(&[2, 2, 0]).unwrap();
    clients[2].send(&[3, 0, 13, 0x11, 0x03, 0]).unwrap(); // with what a cooked terminal would swallow
    let mut frames = Vec::new();
    while frames.len() < 9 {
        assert!(hub.receive(&mut frames, within(500)).unwrap() > 0, "only {frames:?} came");
    }
    let mut sorted: Vec<_> = frames.split_inclusive(|&byte| byte == 0).collect();
    sorted.sort_unstable();
    assert_eq!(sorted, [&[2, 2, 0][..], &[3, 0], &[13, 0x11, 0x03, 0]]);
    clients[0].send(&[1, 0, 4]).unwrap();
    assert_eq!(received(&mut hub, 4), [1, 1, 1, 0]);
    assert_eq!(ByteLink::receive(&mut hub, &mut [0; 8], within(20)).unwrap(), 0);

    hub.broadcast(&[7, 10, 13, 0]);
    for client in &mut clients {
        assert_eq!(received(client, 4), [7, 10, 13, 0]);
    }
    assert_eq!(hub.clients(), 3);
    clients.remove(0);
    assert_eq!(ByteLink::receive(&mut hub, &mut [0; 8], within(20)).unwrap(), 0);
    assert_eq!(hub.clients(), 2);
    drop(hub);
    assert!(!folder.join("hub.sock").exists());
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_terminal_survives_who_closes_it() {
    let (mut hub, folder) = hub("hub-terminal");
    let path = hub.add_pty().unwrap();
    // Raw also for programs that do not set it: a cooked terminal would insert a 13 before the 10.
    fs::OpenOptions::new().write(true).open(&path).unwrap().write_all(&[1, 10, 0]).unwrap();
    assert_eq!(received(&mut hub, 3), [1, 10, 0]);
    let address = Address::Path(path);
    for round in 1..=3 {
        let mut client = open(&address, None).unwrap();
        client.send(&[round, 0]).unwrap();
        assert_eq!(received(&mut hub, 2), [round, 0]);
        hub.broadcast(&[round, round, 0]);
        assert_eq!(received(&mut client, 3), [round, round, 0]);
        drop(client);
        assert_eq!(ByteLink::receive(&mut hub, &mut [0; 8], within(10)).unwrap(), 0);
    }
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn who_does_not_read_holds_up_nobody() {
    let (mut hub, folder) = hub("hub-slow");
    let pty = Address::Path(hub.add_pty().unwrap());
    let mut reads = open(hub.address(), None).unwrap();
    let mut sleeps = open(hub.address(), None).unwrap();
    let frame: Vec<u8> = [[5; 99].as_slice(), &[0]].concat();
    let start = Instant::now();
    for _ in 0..20_000 {
        hub.broadcast(&frame);
        assert_eq!(received(&mut reads, 100), frame);
    }
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    // The terminal lost nearly everything, the sleeping client all but the content of socket and backlog.
    assert!((2_000_000..4_000_000).contains(&hub.dropped()), "{}", hub.dropped());
    assert_eq!(hub.clients(), 3);
    // Both receive again once they read: the sleeping client old frames first, the terminal only new ones.
    sleeps.send(&[1, 0]).unwrap();
    assert_eq!(received(&mut hub, 2), [1, 0]);
    assert_eq!(received(&mut sleeps, 100), frame);
    let mut terminal = open(&pty, None).unwrap();
    hub.broadcast(&[9, 0]);
    assert_eq!(received(&mut terminal, 2), [9, 0]);
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn the_last_word_of_a_client_that_left_is_heard() {
    let (mut hub, folder) = hub("hub-last");
    let mut client = open(hub.address(), None).unwrap();
    client.send(&[3, 0]).unwrap();
    drop(client);
    hub.broadcast(&[1, 0]);
    hub.broadcast(&[1, 0]);
    assert_eq!(received(&mut hub, 2), [3, 0]);
    assert_eq!(ByteLink::receive(&mut hub, &mut [0; 8], within(20)).unwrap(), 0);
    assert_eq!(hub.clients(), 0);
    fs::remove_dir_all(folder).unwrap();
}

/// A client that sends without end, and clients that come without end, hold up nobody.
#[test]
fn a_flood_of_bytes_or_clients_does_not_hold_up_what_is_due() {
    let (mut hub, folder) = hub("hub-flood");
    let mut flooding = open(hub.address(), None).unwrap();
    let ends = thread::spawn(move || while flooding.send(&[1; 4096]).is_ok() {});
    for _ in 0..5 {
        let due = within(50);
        assert_eq!(hub.receive(&mut Vec::new(), due).unwrap(), 0);
        let late = Instant::now() - due;
        assert!(late < Duration::from_millis(500), "{late:?} late");
    }
    let address = hub.address().clone();
    let mut clients = Vec::new();
    for _ in 0..MAX_CLIENTS {
        clients.push(open(&address, None).unwrap());
        hub.broadcast(&[]);
    }
    assert_eq!(hub.clients(), MAX_CLIENTS);
    assert!(hub.messages()[0].contains("64 clients are connected, and it was silent longest"));
    drop((clients, hub));
    ends.join().unwrap();
    fs::remove_dir_all(folder).unwrap();
}

fn frame<T: serde::Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, &mut frame).unwrap();
    frame[..length].to_vec()
}

/// A request of client 7.
fn request(sequence: u16, request: Request) -> Vec<u8> {
    frame(&RequestFrame { client: 7, sequence, request })
}

#[test]
fn who_is_silent_longest_makes_room_and_who_commands_stays() {
    let (mut hub, folder) = hub("hub-room");
    hub.add_pty().unwrap();
    let address = hub.address().clone();
    let mut commander = open(&address, None).unwrap();
    let take = request(1, Request::TakeCommand { by_force: false });
    commander.send(&take).unwrap();
    assert_eq!(received(&mut hub, take.len()), take);
    let done = frame(&FromBoard::Reply(ReplyFrame { client: 7, sequence: 1, tick: 1, reply: Reply::Done }));
    hub.broadcast(&done);
    let mut clients: Vec<Port> = Vec::new();
    for number in 0..MAX_CLIENTS - 2 {
        clients.push(open(&address, None).unwrap());
        clients[number].send(&[1, 0]).unwrap();
        assert_eq!(received(&mut hub, 2), [1, 0]);
    }
    // The first one says something again, the second one does not.
    clients[0].send(&[2, 0]).unwrap();
    assert_eq!(received(&mut hub, 2), [2, 0]);
    assert!(hub.messages().is_empty());
    let mut late = open(&address, None).unwrap();
    let stop = request(1, Request::Stop);
    late.send(&stop).unwrap();
    assert_eq!(received(&mut hub, stop.len()), stop);
    assert_eq!((hub.clients(), hub.messages().len()), (MAX_CLIENTS, 1));
    hub.broadcast(&[5, 0]);
    for place in [0, 2] {
        assert_eq!(received(&mut clients[place], 2), [5, 0]);
    }
    assert_eq!(received(&mut late, 2), [5, 0]);
    assert_eq!(received(&mut commander, done.len() + 2), [done, vec![5, 0]].concat());
    assert!(clients[1].receive(&mut [0; 8], within(500)).is_err(), "the second one is still there");
    drop(hub);
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_flood_of_frames_takes_nobody_elses_turn() {
    let (mut hub, folder) = hub("hub-turns");
    let address = hub.address().clone();
    let mut floods: Vec<Port> = (0..6).map(|_| open(&address, None).unwrap()).collect();
    for flood in &mut floods {
        flood.send(&[1, 0].repeat(1000)).unwrap();
    }
    let (mut first, mut second) = (open(&address, None).unwrap(), open(&address, None).unwrap());
    let mut frames = Vec::new();
    hub.receive(&mut frames, within(0)).unwrap();
    assert!((2 * SHARE..=2 * MAX_FRAMES).contains(&frames.len()), "{}", frames.len());
    // A stop overtakes what its client has sent before it, while others wait.
    let stop = request(1, Request::Stop);
    first.send(&[&[2, 0][..], &stop].concat()).unwrap();
    second.send(&[3, 0]).unwrap();
    let (begun, mut all, mut turns) = (Instant::now(), 0, 0);
    while !frames.windows(2).any(|pair| pair == [3, 0]) {
        frames.clear();
        hub.receive(&mut frames, Instant::now() + PERIOD).unwrap();
        let stops = frames.windows(stop.len()).any(|part| part == stop);
        assert!(turns > 0 || stops, "the stop waits: {frames:?}");
        (all, turns) = (all + frames.len(), turns + 1);
    }
    let periods = usize::try_from(begun.elapsed().as_millis() / PERIOD.as_millis()).unwrap() + 2;
    assert!(turns <= 3 && all <= 2 * MAX_FRAMES * periods, "{turns} turns, {all} bytes");
    drop(hub);
    fs::remove_dir_all(folder).unwrap();
}

/// In front of a serial line, nobody fills the line: the commander's frames come in each period, and a stop
/// at once.
#[test]
fn a_flood_in_front_of_a_serial_line_holds_up_neither_the_commander_nor_a_stop() {
    let (mut hub, folder) = hub("hub-line");
    hub.limit_to(921_600);
    let address = hub.address().clone();
    let mut commander = open(&address, None).unwrap();
    let take = request(1, Request::TakeCommand { by_force: false });
    commander.send(&take).unwrap();
    assert_eq!(received(&mut hub, take.len()), take);
    hub.broadcast(&frame(&FromBoard::Reply(ReplyFrame {
        client: 7,
        sequence: 1,
        tick: 1,
        reply: Reply::Done,
    })));
    let long = [[5; 399].as_slice(), &[0]].concat();
    let mut floods: Vec<Port> = (0..12).map(|_| open(&address, None).unwrap()).collect();
    for flood in &mut floods {
        flood.send(&long.repeat(10)).unwrap();
    }
    let (mut frames, begun) = (Vec::new(), Instant::now());
    for number in 2..12 {
        let keep = request(number, Request::Keep);
        commander.send(&keep).unwrap();
        let before = frames.len();
        // What is full in this period comes in the next one.
        for _ in 0..2 {
            hub.receive(&mut frames, Instant::now() + PERIOD).unwrap();
        }
        let came = frames[before..].windows(keep.len()).any(|part| part == keep);
        assert!(came, "{number}: the commander waits");
    }
    let mut other = open(&address, None).unwrap();
    let stop = request(1, Request::Stop);
    other.send(&[&long[..], &stop].concat()).unwrap();
    let before = frames.len();
    hub.receive(&mut frames, Instant::now() + PERIOD).unwrap();
    assert!(frames[before..].starts_with(&stop), "the stop waits");
    let periods = usize::try_from(begun.elapsed().as_millis() / PERIOD.as_millis()).unwrap() + 2;
    assert!(frames.len() <= (691 + LONGEST_FRAME) * periods, "{} bytes in {periods} periods", frames.len());
    drop(hub);
    fs::remove_dir_all(folder).unwrap();
}

#[test]
fn overlong_frames_are_dropped_whole() {
    let mut hub = Hub::listen(&Address::Tcp("127.0.0.1:0".to_owned()), None).unwrap();
    let Address::Tcp(host) = hub.address().clone() else { panic!() };
    let mut client = TcpStream::connect(host).unwrap();
    let longest = [[7; LONGEST_FRAME - 1].as_slice(), &[0]].concat();
    client.write_all(&[8; LONGEST_FRAME]).unwrap();
    client.write_all(&[0]).unwrap();
    client.write_all(&[9; 10_000]).unwrap();
    client.write_all(&[0]).unwrap();
    client.write_all(&longest).unwrap();
    assert_eq!(received(&mut hub, LONGEST_FRAME), longest);
    assert_eq!(ByteLink::receive(&mut hub, &mut [0; 8], within(20)).unwrap(), 0);
}

#[test]
fn a_left_over_socket_is_replaced_and_a_used_one_is_not() {
    let (hub, folder) = hub("hub-socket");
    let address = hub.address().clone();
    let error = Hub::listen(&address, None).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
    assert!(error.to_string().contains("another program listens there"), "{error}");
    drop(hub);
    drop(UnixListener::bind(folder.join("hub.sock")).unwrap()); // leaves its file
    Hub::listen(&address, None).unwrap();
    let error = Hub::listen(&Address::Auto, None).unwrap_err();
    assert!(error.to_string().contains("use a socket"), "{error}");
    fs::write(folder.join("file"), "precious").unwrap();
    Hub::listen(&Address::Unix(folder.join("file")), None).unwrap_err();
    assert_eq!(fs::read(folder.join("file")).unwrap(), b"precious");
    fs::remove_dir_all(folder).unwrap();
    let hub = Hub::listen(&Address::Tcp("127.0.0.1:0".to_owned()), None).unwrap();
    let error = Hub::listen(hub.address(), None).unwrap_err();
    assert!(
        error.to_string().contains("in use") && error.to_string().contains("choose another port"),
        "{error}"
    );
}

#[test]
fn a_board_behind_a_link_is_pumped() {
    let (mut hub, folder) = hub("hub-pump");
    let (mut board_side, below) = self::hub("hub-pump-board");
    let mut board = open(board_side.address(), None).unwrap();
    let mut client = open(hub.address(), None).unwrap();
    let pump = thread::spawn(move || {
        hub.pump(&mut board, Duration::from_millis(1), within(300)).unwrap();
        hub
    });
    client.send(&[6, 0]).unwrap();
    assert_eq!(received(&mut board_side, 2), [6, 0]);
    board_side.broadcast(&[6, 6, 0]);
    assert_eq!(received(&mut client, 3), [6, 6, 0]);
    let mut hub = pump.join().unwrap();
    // The pump ends if the board is gone.
    let mut board = open(board_side.address(), None).unwrap();
    drop(board_side);
    hub.pump(&mut board, Duration::from_millis(1), within(500)).unwrap_err();
    fs::remove_dir_all(folder).unwrap();
    fs::remove_dir_all(below).unwrap();
}
