//! `tesaki view` over a lossy line: stops arrive, and the robot does not move without feedback.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::pty::{OpenptyResult, Winsize, openpty};
use serde_json::{Value, json};
use tesaki::protocol::codec::Decoder;
use tesaki::protocol::{Request, RequestFrame};
use tesaki_supervisor::port::Address;

use super::server::Server;
use super::view::View;

/// A line to a board.
#[derive(Default)]
pub struct Line {
    /// Number of stops that will be lost.
    stops_to_lose: AtomicUsize,
    /// Whether every `Tare` is lost, so that its sender waits in vain for the answer.
    loses_tares: AtomicBool,
    /// Whether every `Enable` is lost.
    pub loses_enables: AtomicBool,
    /// Whether everything from the board is lost.
    is_mute: AtomicBool,
    /// The requests that arrived, including the lost ones.
    requests: Mutex<Vec<(Instant, Request)>>,
}

impl Line {
    /// Starts the line; returns it, and the port at its end.
    pub fn start(server: &Server) -> (Arc<Self>, String) {
        let Address::Unix(board) = &server.address else { panic!("a socket is expected") };
        let port = server.folder.path().join("line");
        let listener = UnixListener::bind(&port).unwrap();
        let line = Arc::new(Self::default());
        let (shared, board) = (Arc::clone(&line), board.clone());
        // The threads end when either end closes.
        std::thread::spawn(move || {
            let Ok((near, _)) = listener.accept() else { return };
            let far = UnixStream::connect(board).unwrap();
            let (replies, requests) = (far.try_clone().unwrap(), near.try_clone().unwrap());
            let back = Arc::clone(&shared);
            std::thread::spawn(move || back.carry_replies(replies, near));
            shared.carry_requests(requests, far);
        });
        (line, format!("unix://{}", port.display()))
    }

    fn carry_replies(&self, mut from: UnixStream, mut to: UnixStream) {
        let mut buffer = [0; 4096];
        while let Ok(length @ 1..) = from.read(&mut buffer) {
            if !self.is_mute.load(Ordering::Relaxed) && to.write_all(&buffer[..length]).is_err() {
                break;
            }
        }
        let _ = to.shutdown(std::net::Shutdown::Both);
    }

    fn carry_requests(&self, mut from: UnixStream, mut to: UnixStream) {
        let (mut buffer, mut frame, mut decoder) = ([0; 4096], Vec::new(), Decoder::new());
        while let Ok(length @ 1..) = from.read(&mut buffer) {
            for &byte in &buffer[..length] {
                frame.push(byte);
                let Some(Ok(RequestFrame { request, .. })) = decoder.push(byte) else { continue };
                let one_less = |left: usize| left.checked_sub(1);
                let is_lost = match request {
                    Request::Stop => self
                        .stops_to_lose
                        .fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_less)
                        .is_ok(),
                    Request::Tare => self.loses_tares.load(Ordering::Relaxed),
                    Request::Enable(_) => self.loses_enables.load(Ordering::Relaxed),
                    _ => false,
                };
                self.requests.lock().unwrap().push((Instant::now(), request));
                if !is_lost && to.write_all(&frame).is_err() {
                    return;
                }
                frame.clear();
            }
        }
        let _ = to.shutdown(std::net::Shutdown::Both);
    }

    /// Returns when the last such request came.
    pub fn last(&self, sought: impl Fn(&Request) -> bool) -> Option<Instant> {
        let requests = self.requests.lock().unwrap();
        requests.iter().rev().find(|(_, request)| sought(request)).map(|(at, _)| *at)
    }

    /// Returns the time from `since` to the first stop, waiting for it if necessary.
    #[track_caller]
    fn stop_after(&self, since: Instant) -> Duration {
        loop {
            let requests = self.requests.lock().unwrap().clone();
            let mut stops = requests.iter().filter(|(at, request)| *at >= since && *request == Request::Stop);
            if let Some((at, _)) = stops.next() {
                return *at - since;
            }
            assert!(since.elapsed() < Duration::from_secs(60), "no stop after {since:?}: {requests:?}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Allows for a busy machine.
const AT_ONCE: Duration = Duration::from_millis(500);

#[test]
fn a_lost_stop_of_a_disabled_board_is_repeated() {
    let server = Server::ready();
    let (line, port) = Line::start(&server);
    let view = View::start(&server, &["--port", &port]);
    let mut page = view.open();
    page.wait("scene", |value| value["kind"] == "scene");
    page.mode("disabled");
    line.stops_to_lose.store(5, Ordering::Relaxed);
    page.succeeds(json!({ "do": "stop" }));
    // The page must see that it has stopped before anything else is allowed.
    for command in [json!({ "do": "take" }), json!({ "do": "enable", "task": "joint servo" })] {
        page.fails(command, "does not show yet that it has stopped");
    }
    page.mode("fault");
    page.succeeds(json!({ "do": "take" }));
    assert_eq!(line.stops_to_lose.load(Ordering::Relaxed), 0);
    // A stop that arrived is not repeated: the fault can be cleared, and stays cleared.
    page.clears();
    page.mode("disabled");
    std::thread::sleep(Duration::from_millis(300));
    page.enables();
}

/// The same of the monitor, which runs on a terminal.
#[test]
fn a_lost_stop_of_the_monitor_is_repeated() {
    let server = Server::ready();
    let (line, port) = Line::start(&server);
    let size = Winsize { ws_row: 40, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 };
    let OpenptyResult { master, slave } = openpty(Some(&size), None).unwrap();
    let end = || Stdio::from(slave.try_clone().unwrap());
    let mut monitor = server.command(&["--port", &port, "monitor"]);
    let mut monitor = monitor.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
    drop(slave);
    let mut terminal = File::from(master);
    let mut screen = terminal.try_clone().unwrap();
    // Read, so that it does not block.
    let (sender, drawn) = channel();
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(1..) = screen.read(&mut buffer) {
            let _ = sender.send(());
        }
    });
    drawn.recv_timeout(Duration::from_secs(60)).expect("a screen");
    line.stops_to_lose.store(8, Ordering::Relaxed);
    terminal.write_all(b" ").unwrap();
    server.wait_for("in fault");
    terminal.write_all(b"q").unwrap();
    assert!(monitor.wait().unwrap().success());
}

#[test]
fn no_set_point_is_sent_while_the_telemetry_is_silent() {
    let server = Server::ready();
    let (line, port) = Line::start(&server);
    let view = View::start(&server, &["--port", &port]);
    let mut page = view.open_commanding();
    page.enables();
    page.succeeds(json!({ "do": "goal", "joint": 0, "angle": 0.3 }));
    let begun = Instant::now();
    line.is_mute.store(true, Ordering::Relaxed);
    page.wait("why", |value| {
        value["text"].as_str().is_some_and(|text| text.contains("telemetry has ceased"))
    });
    let told = begun.elapsed();
    assert!(told > Duration::from_millis(400), "told after {told:?}");
    std::thread::sleep(AT_ONCE);
    assert!(line.stop_after(begun) >= Duration::from_millis(400));
    let moves = |request: &Request| matches!(request, Request::Task(_) | Request::Keep | Request::Enable(_));
    let last = line.last(moves).unwrap().saturating_duration_since(begun);
    assert!(last <= told, "set-points until {last:?}");
    line.is_mute.store(false, Ordering::Relaxed);
    page.mode("fault");
}

#[test]
fn a_stop_waits_neither_for_slow_commands_nor_behind_a_flood() {
    let server = Server::ready();
    let (line, port) = Line::start(&server);
    let view = View::start(&server, &["--port", &port]);
    let mut commander = view.open();
    commander.mode("disabled");
    commander.succeeds(json!({ "do": "take" }));
    let mut watcher = view.open();
    watcher.mode("disabled");
    // Each waits 2 s for its answer.
    line.loses_tares.store(true, Ordering::Relaxed);
    (0..3).for_each(|_| commander.send(&json!({ "do": "tare" })));
    while line.last(|request| *request == Request::Tare).is_none() {
        std::thread::sleep(Duration::from_millis(5));
    }
    // The other requests are read while the first waits; a request that is read after the stop is a new
    // command.
    std::thread::sleep(AT_ONCE);
    let begun = Instant::now();
    watcher.send(&json!({ "do": "stop" }));
    watcher.wait("the stop", |value| value["kind"] == "answer" && value["ok"] == true);
    let took = line.stop_after(begun);
    assert!(took < AT_ONCE, "the stop came after {took:?}");
    let text = |value: &Value| value["text"].as_str().unwrap_or_default().to_owned();
    commander.wait("the first", |value| text(value).contains("a stop was sent before the board answered"));
    for _ in 0..2 {
        commander.wait("the others", |value| text(value).contains("a stop came first"));
    }
    watcher.mode("fault");

    // A page that sends too much is told so, and its own stop is carried out, too. (Telemetry of after the
    // last stop may still be on its way.)
    line.loses_tares.store(false, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(200));
    commander.clears();
    watcher.mode("disabled");
    let begun = Instant::now();
    (0..1000).for_each(|_| commander.send(&json!({ "do": "tare" })));
    commander.send(&json!({ "do": "stop" }));
    watcher.mode("fault");
    let took = line.stop_after(begun);
    assert!(took < 2 * AT_ONCE, "behind a flood, the stop came after {took:?}");
    commander.wait("too many", |value| text(value).contains("too many commands at once"));
    watcher.succeeds(json!({ "do": "stop" }));
}
