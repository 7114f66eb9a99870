use super::*;

static SITE: Site = Site {
    files: &[("/", "text/html", "hello")],
    socket: "/live",
    protocols: &[],
    origins: &[],
    name: "the page",
    choose: "",
};
static NAMED: Site = Site {
    socket: "/",
    protocols: &["new", "old"],
    origins: &["https://app.example", "http://localhost:"],
    ..SITE
};

fn text(site: &Site, request: &str) -> String {
    let address = SocketAddr::from(([127, 0, 0, 1], 7480));
    let bytes = answer(request.as_bytes(), site, &BTreeMap::new(), address).expect("the head is complete");
    String::from_utf8(bytes).expect("it is text")
}

fn status(request: &str) -> String {
    text(&SITE, request).lines().next().expect("it has a line").to_owned()
}

#[test]
fn a_socket_speaks_what_both_know_and_its_path_may_be_a_page_too() {
    let get = |rest: &str| text(&NAMED, &format!("GET / HTTP/1.1\r\nHost: localhost:7480\r\n{rest}\r\n"));
    assert!(get("").starts_with("HTTP/1.1 200 OK"));
    let socket = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                  Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let refused = get(socket);
    assert!(refused.starts_with("HTTP/1.1 400") && refused.contains("new, old"), "{refused}");
    let both = get(&format!("{socket}Sec-WebSocket-Protocol: other, old,new\r\n"));
    assert!(both.starts_with("HTTP/1.1 101") && both.contains("Sec-WebSocket-Protocol: old\r\n"), "{both}");
    for (origin, may) in [
        ("https://app.example", true),
        ("http://localhost:8080", true),
        ("http://localhost:x", false),
        ("http://localhost.app.example", false),
        ("https://app.example.org", false),
        ("null", false),
    ] {
        let answer = get(&format!("{socket}Sec-WebSocket-Protocol: new\r\nOrigin: {origin}\r\n"));
        assert_eq!(answer.starts_with("HTTP/1.1 101"), may, "{origin}");
    }
}

#[test]
fn the_accepted_key_is_that_of_the_standard() {
    // RFC 6455, 1.3.
    assert_eq!(accept_key("dGhlIHNhbXBsZSBub25jZQ=="), "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=");
}

#[test]
fn pages_of_others_are_kept_out() {
    let get = |path: &str, rest: &str| status(&format!("GET {path} HTTP/1.1\r\n{rest}\r\n"));
    assert_eq!(get("/", "Host: localhost:7480\r\n"), "HTTP/1.1 200 OK");
    assert_eq!(get("/", "Host: [::1]:9\r\n"), "HTTP/1.1 200 OK");
    assert_eq!(get("/?a=1", "Host: localhost\r\n"), "HTTP/1.1 200 OK");
    assert_eq!(get("/other", "Host: localhost\r\n"), "HTTP/1.1 404 Not Found");
    assert_eq!(get("/other?/", "Host: localhost\r\n"), "HTTP/1.1 404 Not Found");
    for host in
        ["", "Host: evil.example\r\n", "Host: evil.example:7480\r\n", "Host: localhost.evil.example\r\n"]
    {
        assert_eq!(get("/", host), "HTTP/1.1 403 Forbidden", "{host}");
    }
    let socket = "Host: localhost:7480\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
                  Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    assert!(get("/live", socket).starts_with("HTTP/1.1 101"));
    assert!(get("/live", &format!("{socket}Origin: http://localhost:7480\r\n")).starts_with("HTTP/1.1 101"));
    for origin in ["http://evil.example", "http://localhost:8080", "https://localhost:7480", "null"] {
        assert_eq!(
            get("/live", &format!("{socket}Origin: {origin}\r\n")),
            "HTTP/1.1 403 Forbidden",
            "{origin}"
        );
    }
    let own = "Origin: http://localhost:7480\r\n";
    for twice in [format!("{own}Origin: http://evil.example\r\n"), format!("{own}Host: evil.example\r\n")] {
        assert_eq!(get("/live", &format!("{socket}{twice}")), "HTTP/1.1 400 Bad Request", "{twice}");
    }
    assert_eq!(get("/live", "Host: localhost\r\n"), "HTTP/1.1 426 Upgrade Required");
    assert_eq!(status("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n"), "HTTP/1.1 405 Method Not Allowed");
    assert_eq!(status("\u{1}\u{2} nonsense\r\n\r\n"), "HTTP/1.1 400 Bad Request");
    let long = format!("GET / HTTP/1.1\r\nX: {}", "a".repeat(MAX_HEAD));
    assert_eq!(status(&long), "HTTP/1.1 431 Request Header Fields Too Large");
}

#[test]
fn a_report_is_what_was_in_its_folder_and_nothing_else() {
    let folder = tempfile::tempdir().expect("there is room");
    let (report, outside) = (folder.path().join("run"), folder.path().join("secret"));
    std::fs::create_dir_all(report.join("figures")).expect("it can be made");
    for (path, text) in [
        (report.join("index.html"), "a page"),
        (report.join("figures/1.svg"), "<svg/>"),
        (outside.clone(), "no"),
    ] {
        std::fs::write(path, text).expect("it can be written");
    }
    #[cfg(unix)]
    std::os::unix::fs::symlink(&outside, report.join("link")).expect("it can be made");
    let mut server = Server::listen(SocketAddr::from(([127, 0, 0, 1], 0)), &SITE).expect("a port is free");
    server.add_report("/report/", &report).expect("it is a folder");
    std::fs::write(report.join("later"), "no").expect("it can be written");
    let get = |path: &str, host: &str| {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
        let bytes = answer(request.as_bytes(), &SITE, &server.report, server.address);
        String::from_utf8(bytes.expect("the head is complete")).expect("it is text")
    };
    let page = get("/report/index.html", "localhost");
    assert!(page.starts_with("HTTP/1.1 200") && page.ends_with("\r\n\r\na page"), "{page}");
    assert!(page.contains("text/html") && page.contains("default-src 'none'; script-src 'unsafe-inline'"));
    assert!(get("/report/figures/1.svg", "localhost").contains("Content-Type: image/svg+xml"));
    for path in ["/report/", "/report/../secret", "/report/link", "/report/later", "/report/%2e%2e/secret"] {
        assert!(get(path, "localhost").starts_with("HTTP/1.1 404"), "{path}");
    }
    assert!(get("/report/index.html", "evil.example").starts_with("HTTP/1.1 403"));
}

#[test]
fn addresses_that_others_reach_are_refused() {
    for address in ["0.0.0.0:0", "192.0.2.1:0", "[::]:0"] {
        let address: SocketAddr = address.parse().expect("it is an address");
        let error = Server::listen(address, &SITE).expect_err("it is refused").to_string();
        assert!(error.contains("ssh -L"), "{error}");
    }
}

/// A server in a turn of its own, with what happened.
fn turns(server: &mut Server, mut until: impl FnMut(&[Event]) -> bool) -> Vec<Event> {
    let mut events = Vec::new();
    let begun = Instant::now();
    while !until(&events) {
        assert!(begun.elapsed() < Duration::from_secs(20), "only {events:?}");
        events.extend(server.turn());
        std::thread::sleep(Duration::from_millis(1));
    }
    events
}

fn connect(server: &Server, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(server.address()).expect("it listens");
    stream.write_all(text.as_bytes()).expect("it takes it");
    stream
}

const UPGRADE: &str = "GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n\
                       Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

fn has_opened(events: &[Event]) -> bool {
    matches!(events.last(), Some(Event::Opened(_)))
}

#[test]
fn half_a_request_keeps_no_page_out_and_not_for_long() {
    let mut server = Server::listen(SocketAddr::from(([127, 0, 0, 1], 0)), &SITE).expect("a port is free");
    let halves = ["", "GET / HTTP/1.1\r\nHost: local"];
    let idle: Vec<TcpStream> = (0..40).map(|number| connect(&server, halves[number % 2])).collect();
    let begun = Instant::now();
    let page = connect(&server, UPGRADE);
    turns(&mut server, has_opened);
    assert_eq!(server.visitors.len(), MAX_CONNECTIONS - 1);
    assert!(begun.elapsed() < REQUEST, "{:?}", begun.elapsed());
    // Also one that goes on and on.
    let mut slow = &idle[39];
    while !server.visitors.is_empty() {
        assert!(begun.elapsed() < REQUEST * 3, "{} are left", server.visitors.len());
        let _ = slow.write_all(b"a");
        server.turn();
        std::thread::sleep(Duration::from_millis(5));
    }
    drop((page, idle));
}

#[test]
fn a_silent_page_makes_room_unless_it_commands() {
    let mut server = Server::listen(SocketAddr::from(([127, 0, 0, 1], 0)), &SITE).expect("a port is free");
    let mut pages: Vec<WebSocket<TcpStream>> = Vec::new();
    for _ in 0..MAX_CONNECTIONS {
        let stream = connect(&server, UPGRADE);
        turns(&mut server, has_opened);
        pages.push(WebSocket::from_raw_socket(stream, Role::Client, None));
    }
    // Of those that came first, the first one commands and the second one speaks.
    server.keep(Some(1));
    pages[1].send(Message::text("hello")).expect("it is open");
    turns(&mut server, |events| matches!(events.last(), Some(Event::Said(2, _))));
    let last = connect(&server, UPGRADE);
    let events = turns(&mut server, has_opened);
    assert!(matches!(events[..], [Event::Closed(3), Event::Opened(33)]), "{events:?}");
    drop((pages, last));
}
