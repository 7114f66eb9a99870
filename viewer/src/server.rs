//! The web server of the pages: a few fixed files over HTTP, the files of a report, and a WebSocket for each
//! page.
//!
//! It has no threads: [`Server::turn`] does what can be done without waiting. Any web page can make a browser
//! send requests, so only pages of this server may open a WebSocket (`Origin`), and only under the names of
//! this machine (`Host`), which prevents DNS rebinding.

use std::collections::BTreeMap;
use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha1::{Digest as _, Sha1};
use tungstenite::protocol::{Role, WebSocket, WebSocketConfig};
use tungstenite::{Error, Message};

/// Maximum length of a request's head [bytes].
const MAX_HEAD: usize = 8192;
/// Longest message of a page [bytes].
const MAX_MESSAGE: usize = 4096;
/// Maximum amount of data that may wait for a page [bytes].
const MAX_WAITING: usize = 1 << 20;
/// Messages of a page that are read in one turn, so that other pages, which may send a stop, get their turn.
const MAX_READ: usize = 16;
/// Maximum number of connections: for a further one, another is closed.
const MAX_CONNECTIONS: usize = 32;
/// Connections that are accepted in one turn, so that none is closed before its request could be read.
const MAX_ACCEPTED: usize = 8;
/// Maximum time for a whole request.
const REQUEST: Duration = Duration::from_secs(2);
/// Maximum time for the request and for sending the answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// The GUID of the WebSocket protocol (RFC 6455, 1.3).
const GUID: &str = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";

/// Content security policy of pages with files of their own.
const OWN_PAGE: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; \
                        connect-src 'self'; img-src data:";
/// Content security policy of a report, which is a single file and loads nothing.
const REPORT_PAGE: &str =
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:";

/// A file that is served: its path, its type, its content.
pub type File = (&'static str, &'static str, &'static str);

/// The files that are served, and to whom.
#[derive(Debug)]
pub struct Site {
    /// The files.
    pub files: &'static [File],
    /// Path of the WebSocket.
    pub socket: &'static str,
    /// Names of the protocols spoken there, if any; the first one that the page also offers is chosen.
    pub protocols: &'static [&'static str],
    /// Further origins whose pages may connect; one that ends with `:` stands for any port.
    pub origins: &'static [&'static str],
    /// Its name, for messages.
    pub name: &'static str,
    /// What may occupy the address, and how to choose another one, for messages.
    pub choose: &'static str,
}

/// An event since the last turn.
#[derive(Debug)]
pub enum Event {
    /// A page has connected.
    Opened(u64),
    /// A page has sent a message.
    Said(u64, String),
    /// A page has disconnected.
    Closed(u64),
}

/// A connection that is not yet a page.
#[derive(Debug)]
struct Visitor {
    stream: TcpStream,
    begun: Instant,
    head: Vec<u8>,
    /// The answer, and how much of it was sent.
    answer: Option<(Vec<u8>, usize)>,
    /// Whether it becomes a page once the answer is sent.
    is_page: bool,
}

/// A page at its WebSocket.
#[derive(Debug)]
struct Page {
    socket: WebSocket<TcpStream>,
    /// When it said something last; at first, when it came.
    heard: Instant,
}

/// Serves pages.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    site: &'static Site,
    /// Files of reports by their paths.
    report: BTreeMap<String, PathBuf>,
    visitors: Vec<Visitor>,
    pages: BTreeMap<u64, Page>,
    next: u64,
    /// The page that is not closed for another one.
    kept: Option<u64>,
}

impl Server {
    /// Listens at an address that only this machine reaches.
    ///
    /// # Errors
    /// The address is not free, or can be reached from other machines.
    pub fn listen(address: SocketAddr, site: &'static Site) -> io::Result<Self> {
        if !address.ip().to_canonical().is_loopback() {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!(
                    "cannot show {1} at {address}: other machines reach that address, and a browser has no key. \
                     Use 127.0.0.1:{0} here and, on the other machine, `ssh -L {0}:localhost:{0} THIS-MACHINE`",
                    address.port(),
                    site.name
                ),
            ));
        }
        let listener = TcpListener::bind(address).map_err(|error| {
            let hint = if error.kind() == io::ErrorKind::AddrInUse { site.choose } else { "" };
            io::Error::new(error.kind(), format!("cannot listen at {address}: {error}{hint}"))
        })?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let (report, visitors, pages) = (BTreeMap::new(), Vec::new(), BTreeMap::new());
        Ok(Self { listener, address, site, report, visitors, pages, next: 1, kept: None })
    }

    /// Serves the present files of a report's folder and of its subfolders below `prefix` (`/report/`). Links
    /// to elsewhere are left out.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn add_report(&mut self, prefix: &str, folder: &Path) -> io::Result<()> {
        for entry in std::fs::read_dir(folder)? {
            let entry = entry?;
            let (kind, name) = (entry.file_type()?, entry.file_name());
            let path = format!("{prefix}{}", name.to_string_lossy());
            if kind.is_dir() {
                self.add_report(&format!("{path}/"), &entry.path())?;
            } else if kind.is_file() {
                self.report.insert(path, entry.path());
            }
        }
        Ok(())
    }

    /// Returns the address at which it listens.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns whether there are no connections.
    pub fn is_idle(&self) -> bool {
        self.visitors.is_empty() && self.pages.is_empty()
    }

    /// Names the page that is not closed for another one, because it commands.
    pub const fn keep(&mut self, page: Option<u64>) {
        self.kept = page;
    }

    /// Does what can be done at once.
    pub fn turn(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        for _ in 0..MAX_ACCEPTED {
            let Ok((stream, _)) = self.listener.accept() else { break };
            if stream.set_nonblocking(true).is_ok() && stream.set_nodelay(true).is_ok() {
                self.make_room(&mut events);
                let begun = Instant::now();
                self.visitors.push(Visitor { stream, begun, head: Vec::new(), answer: None, is_page: false });
            }
        }
        for mut visitor in std::mem::take(&mut self.visitors) {
            match visitor.advance(self.site, &self.report, self.address) {
                Progress::Waits if visitor.begun.elapsed() < visitor.patience() => {
                    self.visitors.push(visitor)
                }
                Progress::Waits | Progress::Gone => {}
                Progress::IsPage => {
                    events.push(Event::Opened(self.next));
                    let page = Page { socket: socket(visitor.stream), heard: Instant::now() };
                    self.pages.insert(self.next, page);
                    self.next += 1;
                }
            }
        }
        let mut gone = Vec::new();
        for (&id, page) in &mut self.pages {
            if !read_page(id, page, &mut events) {
                gone.push(id);
            }
        }
        gone.into_iter().for_each(|id| self.drop_page(id, &mut events));
        events
    }

    /// Closes a connection if all places are taken: the oldest one that has not made its request, or that has
    /// not taken its answer for as long; else the page that has said nothing longest, but not the kept one.
    fn make_room(&mut self, events: &mut Vec<Event>) {
        if self.visitors.len() + self.pages.len() < MAX_CONNECTIONS {
            return;
        }
        let idle = |visitor: &Visitor| visitor.answer.is_none() || visitor.begun.elapsed() > REQUEST;
        let silent = self.pages.iter().filter(|(id, _)| Some(**id) != self.kept);
        let silent = silent.min_by_key(|(_, page)| page.heard).map(|(&id, _)| id);
        // They are in the order in which they came.
        if let Some(place) = self.visitors.iter().position(idle) {
            self.visitors.remove(place);
        } else if let Some(id) = silent {
            self.drop_page(id, events);
        } else {
            self.visitors.remove(0);
        }
    }

    fn drop_page(&mut self, id: u64, events: &mut Vec<Event>) {
        if let Some(mut page) = self.pages.remove(&id) {
            let _ = page.socket.close(None);
            let _ = page.socket.flush();
            events.push(Event::Closed(id));
        }
    }

    /// Sends a message. A page that does not take it is closed in the next turn.
    pub fn send(&mut self, id: u64, message: impl Into<Message>) {
        if let Some(page) = self.pages.get_mut(&id)
            && !survives(page.socket.send(message.into()))
        {
            let _ = page.socket.get_ref().shutdown(std::net::Shutdown::Both);
        }
    }
}

fn socket(stream: TcpStream) -> WebSocket<TcpStream> {
    let limits = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE))
        .max_frame_size(Some(MAX_MESSAGE))
        .max_write_buffer_size(MAX_WAITING);
    WebSocket::from_raw_socket(stream, Role::Server, Some(limits))
}

/// Reads a page's messages, and sends those that wait for it. Returns false when it has gone.
fn read_page(id: u64, page: &mut Page, events: &mut Vec<Event>) -> bool {
    let count = events.len();
    for _ in 0..MAX_READ {
        match page.socket.read() {
            Ok(Message::Text(text)) => events.push(Event::Said(id, text.to_string())),
            Ok(Message::Binary(_)) => events.push(Event::Said(id, String::new())),
            Ok(_) => {}
            Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => break,
            Err(_) => return false,
        }
    }
    if events.len() > count {
        page.heard = Instant::now();
    }
    survives(page.socket.flush())
}

/// Returns whether the connection continues. Data that cannot be written now wait.
fn survives(result: Result<(), Error>) -> bool {
    match result {
        Err(Error::Io(error)) => error.kind() == io::ErrorKind::WouldBlock,
        other => other.is_ok(),
    }
}

enum Progress {
    Waits,
    Gone,
    IsPage,
}

impl Visitor {
    /// How long it may take in all.
    const fn patience(&self) -> Duration {
        if self.answer.is_none() { REQUEST } else { PATIENCE }
    }

    fn advance(&mut self, site: &Site, report: &BTreeMap<String, PathBuf>, address: SocketAddr) -> Progress {
        if self.answer.is_none() {
            let mut buffer = [0; 1024];
            match self.stream.read(&mut buffer) {
                Ok(0) => return Progress::Gone,
                Ok(length) => self.head.extend_from_slice(buffer.get(..length).unwrap_or_default()),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Progress::Waits,
                Err(_) => return Progress::Gone,
            }
            let Some(answer) = answer(&self.head, site, report, address) else { return Progress::Waits };
            self.is_page = answer.starts_with(b"HTTP/1.1 101");
            self.answer = Some((answer, 0));
        }
        let Some((answer, sent)) = &mut self.answer else { return Progress::Waits };
        while *sent < answer.len() {
            match self.stream.write(answer.get(*sent..).unwrap_or_default()) {
                Ok(length) => *sent += length,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Progress::Waits,
                Err(_) => return Progress::Gone,
            }
        }
        if self.is_page { Progress::IsPage } else { Progress::Gone }
    }
}

/// Returns the answer to a request; `None` until its head is complete.
fn answer(
    head: &[u8],
    site: &Site,
    report: &BTreeMap<String, PathBuf>,
    address: SocketAddr,
) -> Option<Vec<u8>> {
    let mut headers = [httparse::EMPTY_HEADER; 64];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) if head.len() < MAX_HEAD => return None,
        Ok(httparse::Status::Partial) => {
            return Some(refuse("431 Request Header Fields Too Large", "too long"));
        }
        Err(error) => return Some(refuse("400 Bad Request", &error.to_string())),
    }
    let values = |name: &'static str| {
        let named = request.headers.iter().filter(move |header| header.name.eq_ignore_ascii_case(name));
        named.map(|header| std::str::from_utf8(header.value).ok())
    };
    // What the next lines decide by must be there once.
    for name in ["Host", "Origin"] {
        if values(name).count() > 1 || values(name).any(|value| value.is_none()) {
            return Some(refuse("400 Bad Request", &format!("{name} is not a text, or is there twice")));
        }
    }
    let header = |name| values(name).next().flatten();
    let host = header("host").unwrap_or_default();
    if !is_ours(host, address) {
        return Some(refuse("403 Forbidden", &format!("this is http://{address}, not {host:?}")));
    }
    if request.method != Some("GET") {
        return Some(refuse("405 Method Not Allowed", "only GET"));
    }
    // Through a tunnel (ssh -L) the page has the name that the browser uses.
    let may_look = |origin: &str| origin == format!("http://{host}") || site.admits(origin);
    if header("origin").is_some_and(|origin| !may_look(origin)) {
        return Some(refuse("403 Forbidden", "pages of other servers may not look here"));
    }
    // A query after the path, such as `?utm_source=…`, does not select another file.
    let path = request.path.unwrap_or_default().split('?').next().unwrap_or_default();
    let file = site.files.iter().find(|(name, ..)| *name == path);
    if path == site.socket && (file.is_none() || header("upgrade").is_some()) {
        let protocols = header("sec-websocket-protocol").unwrap_or_default();
        return Some(upgrade(
            site,
            protocols,
            header("upgrade"),
            header("sec-websocket-version"),
            header("sec-websocket-key"),
        ));
    }
    Some(match (file, report.get(path)) {
        (Some((_, kind, text)), _) => respond("200 OK", kind, OWN_PAGE, text.as_bytes()),
        (None, Some(path)) => match std::fs::read(path) {
            Ok(bytes) => respond("200 OK", content_type(path), REPORT_PAGE, &bytes),
            Err(error) => refuse("404 Not Found", &format!("{}: {error}", path.display())),
        },
        (None, None) => refuse("404 Not Found", path),
    })
}

impl Site {
    /// Returns whether pages of this origin may connect.
    fn admits(&self, origin: &str) -> bool {
        self.origins.iter().any(|own| {
            origin == own.trim_end_matches(':')
                || own.ends_with(':')
                    && origin.strip_prefix(own).is_some_and(|port| port.parse::<u16>().is_ok())
        })
    }
}

/// Returns whether a `Host` is a name of this machine, with any port, as a tunnel has another one.
fn is_ours(host: &str, address: SocketAddr) -> bool {
    let name =
        host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name);
    let own = match address.ip() {
        std::net::IpAddr::V4(ip) => ip.to_string(),
        std::net::IpAddr::V6(ip) => format!("[{ip}]"),
    };
    ["localhost", "127.0.0.1", "[::1]", &own].contains(&name)
}

/// Accepts a WebSocket (RFC 6455, 4.2).
fn upgrade(
    site: &Site,
    protocols: &str,
    upgrade: Option<&str>,
    version: Option<&str>,
    key: Option<&str>,
) -> Vec<u8> {
    let (Some(key), Some("13")) = (key, version) else {
        return refuse("426 Upgrade Required", "this is for WebSockets of version 13");
    };
    if !upgrade.is_some_and(|kind| kind.eq_ignore_ascii_case("websocket")) {
        return refuse("426 Upgrade Required", "this is for WebSockets of version 13");
    }
    let known = protocols.split(',').map(str::trim).find(|protocol| site.protocols.contains(protocol));
    if known.is_none() && !site.protocols.is_empty() {
        return refuse("400 Bad Request", &format!("spoken here: {}", site.protocols.join(", ")));
    }
    let protocol = known.map_or_else(String::new, |known| format!("Sec-WebSocket-Protocol: {known}\r\n"));
    let accept = accept_key(key);
    format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         {protocol}Sec-WebSocket-Accept: {accept}\r\n\r\n"
    )
    .into_bytes()
}

fn accept_key(key: &str) -> String {
    STANDARD.encode(Sha1::digest(format!("{key}{GUID}")))
}

fn refuse(status: &str, why: &str) -> Vec<u8> {
    respond(status, "text/plain; charset=utf-8", OWN_PAGE, format!("{status}: {why}\n").as_bytes())
}

fn respond(status: &str, kind: &str, policy: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\n\
         Content-Security-Policy: {policy}\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

/// Returns the content type of a file of a report, by its extension.
fn content_type(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("html") => "text/html; charset=utf-8",
        Some("json") => "application/json",
        Some("csv") => "text/csv; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests;
