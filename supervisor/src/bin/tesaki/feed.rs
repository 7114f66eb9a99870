//! What leads a robot live: samples that come one after the other, the clock of their time stamps, and how
//! they end.

mod clock;

use std::fs::File;
use std::io::{self, BufRead, Read};
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use crate::failure::Failure;
use clock::SourceClock;

/// A source whose samples are all bad for this time has ended.
const BAD: Duration = Duration::from_millis(500);
/// Samples taken in a tick; a faster source waits.
pub const MAX_TAKEN: usize = 64;
/// By how much the time stamps of a source go back that has begun anew [s].
pub const RESTART: f64 = 1.0;
/// Longest line [bytes].
const MAX_LINE: u64 = 1 << 16;

/// Something with the time of its arrival.
struct Arrival<T> {
    arrived: Instant,
    content: io::Result<T>,
}

/// Where what arrives is put, in a thread of its own.
pub struct Inlet<T>(SyncSender<Arrival<T>>);

impl<T> Clone for Inlet<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> Inlet<T> {
    /// Puts in what arrives now. False if nobody takes it any more.
    pub fn send(&self, content: io::Result<T>) -> bool {
        self.0.send(Arrival { arrived: Instant::now(), content }).is_ok()
    }
}

/// The samples of a source as they arrive.
pub struct Feed<T> {
    arrivals: Receiver<Arrival<T>>,
    pub place: String,
    /// What it calls a sample.
    what: &'static str,
    silence: Duration,
    /// So long only bad samples may come.
    bad_limit: Duration,
    clock: SourceClock,
    /// When anything came last.
    heard: Instant,
    /// Number of the last line.
    number: u64,
    /// Good samples.
    pub seen: u32,
    pub dropped: u32,
    /// Since when there are only bad samples, and what is wrong with the last one.
    bad: Option<(Instant, String)>,
    /// How the source has ended.
    closed: Option<io::Result<()>>,
    /// Good samples at the start of the current second, and that start; samples a second in the last one.
    second: (u32, Instant, f64),
}

impl<T: Send + 'static> Feed<T> {
    /// What `source` puts in, from a thread of its own, at a `place`, where `silence` ends it.
    pub fn spawn(
        place: String,
        what: &'static str,
        silence: Duration,
        source: impl FnOnce(&Inlet<T>) + Send + 'static,
    ) -> Self {
        let (sender, arrivals) = sync_channel(MAX_TAKEN);
        std::thread::spawn(move || source(&Inlet(sender)));
        let now = Instant::now();
        Self {
            arrivals,
            place,
            what,
            silence,
            bad_limit: BAD,
            clock: SourceClock::new(now),
            heard: now,
            number: 0,
            seen: 0,
            dropped: 0,
            bad: None,
            closed: None,
            second: (0, now, 0.0),
        }
    }

    /// Lines of standard input.
    pub fn standard_input(what: &'static str, silence: Duration) -> Self
    where
        T: From<String>,
    {
        Self::spawn("standard input".to_owned(), what, silence, read)
    }

    /// Lines of datagrams.
    pub fn udp(address: SocketAddr, what: &'static str, silence: Duration) -> Result<Self, Failure>
    where
        T: From<String>,
    {
        let socket = UdpSocket::bind(address).map_err(Failure::file(format!("UDP port {address}")))?;
        let place = format!("UDP port {}", address.port());
        Ok(Self::spawn(place, what, silence, move |inlet| receive(&socket, inlet)))
    }
}

impl<T> Feed<T> {
    /// Bad samples alone do not end the source.
    pub const fn patient(mut self) -> Self {
        self.bad_limit = Duration::MAX;
        self
    }

    /// The next of what has come, and when it came.
    pub fn next(&mut self) -> Option<(Instant, T)> {
        self.wait(Duration::ZERO)
    }

    /// The next of what comes within a time.
    pub fn wait(&mut self, longest: Duration) -> Option<(Instant, T)> {
        match self.arrivals.recv_timeout(longest) {
            Ok(Arrival { arrived, content }) => {
                self.number += 1;
                self.heard = arrived;
                match content {
                    Ok(content) => return Some((arrived, content)),
                    Err(error) => self.closed = Some(Err(error)),
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                self.closed.get_or_insert(Ok(()));
            }
        }
        None
    }

    /// A good sample has come, whose time stamp does not matter.
    pub fn count(&mut self) {
        self.seen = self.seen.saturating_add(1);
        self.bad = None;
    }

    /// A good sample has come. Returns how much later it comes than the soonest ones, by its time stamp [s].
    pub fn accept(&mut self, arrived: Instant, time: f64) -> f32 {
        self.count();
        self.clock.age(arrived, time)
    }

    /// A sample is bad.
    pub fn reject(&mut self, arrived: Instant, error: &str) {
        self.dropped = self.dropped.saturating_add(1);
        let since = self.bad.take().map_or(arrived, |(since, _)| since);
        self.bad = Some((since, format!("line {}: {error}", self.number)));
    }

    /// What came before was stray, and so is its time.
    pub const fn forget_time(&mut self) {
        self.clock.forget();
    }

    /// The time stamps are wrong.
    pub fn distrust(&mut self, why: String) {
        self.clock.wrong = Some(why);
    }

    /// Whether samples are late by their time stamps.
    pub const fn is_late(&self) -> bool {
        self.clock.is_late()
    }

    /// What is wrong with the last sample.
    pub fn error(&self) -> Option<&str> {
        self.bad.as_ref().map(|(_, error)| error.as_str())
    }

    /// Good samples a second.
    pub fn rate(&mut self, now: Instant) -> f64 {
        let (seen, begin, _) = self.second;
        let elapsed = now.duration_since(begin);
        if elapsed >= Duration::from_secs(1) {
            self.second = (self.seen, now, f64::from(self.seen - seen) / elapsed.as_secs_f64());
        }
        self.second.2
    }

    /// Why the source has ended, if it has.
    pub fn ending(&self) -> Option<Ending> {
        if let Some(wrong) = &self.clock.wrong {
            return Some(self.bad_ending(wrong));
        }
        match (&self.bad, &self.closed) {
            (Some((since, error)), closed)
                if self.heard.duration_since(*since) > self.bad_limit
                    || (closed.is_some() && self.seen == 0) =>
            {
                Some(self.bad_ending(error))
            }
            (_, Some(Err(error))) => Some(self.bad_ending(&error.to_string())),
            (_, Some(Ok(()))) => {
                Some(Ending { kind: EndingKind::Closed, reason: format!("{} has ended", self.place) })
            }
            // A source may take its time to begin.
            (_, None) => (self.seen > 0 && self.heard.elapsed() > self.silence).then(|| Ending {
                kind: EndingKind::Silent,
                reason: format!("{} has sent nothing for {} s", self.place, self.silence.as_secs_f64()),
            }),
        }
    }

    fn bad_ending(&self, error: &str) -> Ending {
        let reason = format!("{} sends no valid {} any more; the last error: {error}", self.place, self.what);
        Ending { kind: EndingKind::Bad, reason }
    }
}

/// Puts in the lines of standard input.
pub fn read<T: From<String>>(inlet: &Inlet<T>) {
    let mut input = io::stdin().lock();
    while let Some(text) = line(&mut input)
        && inlet.send(text.map(T::from))
    {}
}

/// All of the file at `path`, `-` for standard input, with the name to call it by.
pub fn read_path(path: &Path, most: u64) -> Result<(String, Vec<u8>), Failure> {
    let (name, read) = if path == Path::new("-") {
        ("standard input".to_owned(), read_all(io::stdin(), most))
    } else {
        (path.display().to_string(), File::open(path).and_then(|file| read_all(file, most)))
    };
    let bytes = read.map_err(Failure::file(&name))?;
    Ok((name, bytes))
}

/// All of `input`, unless it has more than `most` bytes, as a device may have.
pub fn read_all(input: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    input.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let message = format!("larger than {} MiB: is it the right file?", most >> 20);
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// The next line; `None` at the end.
pub fn line(input: &mut impl BufRead) -> Option<io::Result<String>> {
    let mut bytes = Vec::new();
    match input.take(MAX_LINE).read_until(b'\n', &mut bytes) {
        Ok(0) => None,
        Ok(length) if length as u64 == MAX_LINE && bytes.last() != Some(&b'\n') => {
            Some(Err(io::Error::other(format!("a line is longer than {MAX_LINE} bytes"))))
        }
        Ok(_) => Some(Ok(String::from_utf8_lossy(&bytes).into_owned())),
        Err(error) => Some(Err(error)),
    }
}

/// Puts in the lines of datagrams.
fn receive<T: From<String>>(socket: &UdpSocket, inlet: &Inlet<T>) {
    let mut datagram = vec![0; 1 << 16];
    loop {
        let alive = match socket.recv(&mut datagram) {
            Ok(length) => {
                let text = String::from_utf8_lossy(datagram.get(..length).unwrap_or_default()).into_owned();
                text.lines().all(|line| inlet.send(Ok(line.to_owned().into())))
            }
            Err(error) => {
                inlet.send(Err(error));
                false
            }
        };
        if !alive {
            break;
        }
    }
}

/// How a source ends.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum EndingKind {
    /// Its end.
    Closed,
    /// Nothing for too long.
    Silent,
    /// Bad samples only, or bad time stamps.
    Bad,
}

/// That and why a source has ended.
pub struct Ending {
    pub kind: EndingKind,
    pub reason: String,
}

impl Ending {
    /// It was not followed yet; `hint` says what to do where nothing came.
    pub fn before_enabling(self, hint: &str) -> Failure {
        let hint = if self.kind == EndingKind::Closed { hint } else { "" };
        let told = format!("{}; nothing was enabled{hint}", self.reason);
        self.failure(told)
    }

    /// The end of a source that was followed is no failure.
    pub fn after_enabling(self) -> Result<(), Failure> {
        match self.kind {
            EndingKind::Closed => Ok(()),
            EndingKind::Silent | EndingKind::Bad => {
                let told = format!("{}; the board is disabled", self.reason);
                Err(self.failure(told))
            }
        }
    }

    const fn failure(&self, told: String) -> Failure {
        match self.kind {
            EndingKind::Silent => Failure::Late(told),
            EndingKind::Closed | EndingKind::Bad => Failure::Other(told),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn bad_samples_alone_end_a_source_unless_it_is_patient() {
        let source = |inlet: &Inlet<String>| {
            inlet.send(Ok("first".to_owned()));
            std::thread::sleep(BAD + Duration::from_millis(100));
            inlet.send(Ok("last".to_owned()));
            std::thread::sleep(Duration::from_secs(60));
        };
        let feed = || Feed::spawn("here".to_owned(), "sample", Duration::MAX, source);
        for (mut feed, ends) in [(feed(), true), (feed().patient(), false)] {
            for _ in 0..2 {
                let (arrived, _) = feed.wait(Duration::from_secs(30)).unwrap();
                feed.reject(arrived, "bad");
            }
            assert_eq!(feed.ending().is_some_and(|ending| ending.kind == EndingKind::Bad), ends);
        }
    }
}
