//! The connection to the vision: lines that come, answers that go back.

use std::io::{BufReader, ErrorKind, Write as _};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tesaki_supervisor::port::{LocalListener, SocketFile};

use crate::args::SightSource;
use crate::failure::Failure;
use crate::feed::{self, Feed, Inlet};
use crate::motion::PERIOD;
use crate::sight::{Answer, Search, Sight};

/// A connection is waited for so long at a time.
const WAIT: Duration = Duration::from_secs(1);
/// Longest time that an answer waits for a vision that does not read. Then its connection ends, because the
/// next answers would wait as long, and the arm with them.
const PATIENCE: Duration = Duration::from_millis(1);
/// Lines that are taken in a period at most.
const MAX_TAKEN: usize = 64;

/// A line, and who has sent it.
pub struct Content {
    text: String,
    from: Option<Arc<UnixStream>>,
    /// Whether it is the first one of its connection.
    is_first: bool,
}

impl From<String> for Content {
    fn from(text: String) -> Self {
        Self { text, from: None, is_first: false }
    }
}

/// A line that has come.
pub struct Line {
    pub arrived: Instant,
    pub text: String,
    from: Option<Arc<UnixStream>>,
    is_first: bool,
}

impl Line {
    /// Answers who has sent it, if that can be. An answer that cannot be sent is not needed: the next line
    /// asks again.
    pub fn answer(&self, answer: &Answer) {
        if let Some(stream) = &self.from {
            send(stream, answer);
        }
    }
}

fn send(mut stream: &UnixStream, answer: &Answer) {
    let line = serde_json::to_string(answer).unwrap_or_default() + "\n";
    if stream.write_all(line.as_bytes()).is_err() {
        let _ = stream.shutdown(Shutdown::Both);
    }
}

/// The lines of a vision.
pub struct Vision {
    feed: Feed<Content>,
    taken: usize,
    /// Of the socket, whose listener is in a thread.
    _file: SocketFile,
}

impl Vision {
    pub fn open(source: &SightSource) -> Result<Self, Failure> {
        let what = "circle";
        let mut file = SocketFile::default();
        let feed = match source {
            SightSource::StandardInput => Feed::standard_input(what, Duration::MAX),
            SightSource::Listen(address) => {
                let mut listener = LocalListener::new(address).map_err(|error| match error.kind() {
                    ErrorKind::InvalidInput => Failure::Usage(error.to_string()),
                    _ => Failure::Other(error.to_string()),
                })?;
                let place = listener.address().to_string();
                file = listener.take_file();
                Feed::spawn(place, what, Duration::MAX, move |inlet| listen(&listener, inlet))
            }
        };
        Ok(Self { feed, taken: 0, _file: file })
    }

    pub fn place(&self) -> &str {
        &self.feed.place
    }

    /// The next line of this period.
    pub fn next(&mut self) -> Option<Line> {
        while self.taken < MAX_TAKEN
            && let Some((arrived, Content { text, from, is_first })) = self.feed.next()
        {
            self.taken += 1;
            if !text.trim().is_empty() {
                return Some(Line { arrived, text, from, is_first });
            }
        }
        self.taken = 0;
        None
    }

    /// Before the arm is enabled: answers questions by this search. Whether there is a vision.
    pub fn greet(&mut self, search: Search, size: Option<[usize; 2]>) -> Result<bool, Failure> {
        let mut is_there = false;
        while let Some(line) = self.next() {
            match Sight::read(&line.text, size) {
                Ok(sight) if sight.circle.is_none() => {
                    line.answer(&Answer::Search { picture: sight.picture, search: Some(search) });
                }
                Ok(_) => is_there = true,
                Err(error) => self.reject(&line, error),
            }
        }
        match self.feed.ending() {
            Some(ending) if !is_there => Err(ending.before_enabling("")),
            _ => Ok(is_there),
        }
    }

    /// Greets while a person is asked. Else lines that wait beyond what is kept would seem to come after the
    /// answer.
    pub fn greet_during(
        &mut self,
        initial: Search,
        size: Option<[usize; 2]>,
        ask: impl FnOnce() -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let is_answered = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !is_answered.load(Ordering::Relaxed) && self.greet(initial, size).is_ok() {
                    std::thread::sleep(PERIOD);
                }
            });
            let answer = ask();
            is_answered.store(true, Ordering::Relaxed);
            answer
        })
    }

    /// A line told of a picture.
    pub fn accept(&mut self) {
        self.feed.seen = self.feed.seen.saturating_add(1);
    }

    /// Says what is wrong with a line. Who begins with such a line is no vision.
    pub fn reject(&mut self, line: &Line, error: String) {
        self.feed.reject(line.arrived, &error);
        line.answer(&Answer::Error { error });
        if let Some(stream) = line.from.as_ref().filter(|_| line.is_first) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Pictures that were told of, and bad lines.
    pub const fn counts(&self) -> (u32, u32) {
        (self.feed.seen, self.feed.dropped)
    }

    /// What is wrong with the last bad line.
    pub fn error(&self) -> Option<&str> {
        self.feed.error()
    }

    /// Its rate, and what is wrong with it.
    pub fn one_line(&mut self) -> String {
        let error = self.error().map_or_else(String::new, |error| format!(" ({error})"));
        format!("{:.0} pictures/s{error}", self.feed.rate(Instant::now()))
    }
}

/// Puts in the lines of who has connected last.
fn listen(listener: &LocalListener, inlet: &Inlet<Content>) {
    let mut present: Option<Arc<UnixStream>> = None;
    loop {
        let stream = match listener.accept(WAIT) {
            Ok(Some(stream)) => Arc::new(stream),
            Ok(None) => continue,
            Err(error) => {
                inlet.send(Err(error));
                break;
            }
        };
        // One that hangs makes room.
        if let Some(before) = present.replace(Arc::clone(&stream)) {
            let _ = before.shutdown(Shutdown::Both);
        }
        let (Ok(reader), Ok(())) = (stream.try_clone(), stream.set_write_timeout(Some(PATIENCE))) else {
            continue;
        };
        send(&stream, &Answer::GREETING);
        let inlet = inlet.clone();
        std::thread::spawn(move || {
            let mut input = BufReader::new(reader);
            let mut is_first = true;
            // Who is killed within a line has not sent it.
            while let Some(Ok(text)) = feed::line(&mut input)
                && text.ends_with('\n')
            {
                let content = Content { text, from: Some(Arc::clone(&stream)), is_first };
                is_first = false;
                if !inlet.send(Ok(content)) {
                    break;
                }
            }
        });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tesaki_supervisor::port::Address;

    use super::*;

    /// A vision that has sent this, in a folder that lasts as long; and the first line of it that has come.
    fn sent(text: &str) -> (tempfile::TempDir, Vision, UnixStream, Line) {
        let folder = tempfile::tempdir().unwrap();
        let address = Address::Unix(folder.path().join("circles"));
        let mut vision = Vision::open(&SightSource::Listen(address)).unwrap();
        let mut sender = UnixStream::connect(folder.path().join("circles")).unwrap();
        sender.write_all(text.as_bytes()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(30);
        let line = loop {
            if let Some(line) = vision.next() {
                break line;
            }
            assert!(Instant::now() < deadline);
        };
        (folder, vision, sender, line)
    }

    #[test]
    fn a_line_that_its_sender_has_not_ended_is_none() {
        let (folder, mut vision, sender, line) = sent("{\"picture\": 1, \"age\": 0}\n{\"picture\": 2, \"a");
        assert_eq!(line.text.trim(), "{\"picture\": 1, \"age\": 0}");
        drop(sender);
        std::thread::sleep(Duration::from_millis(100));
        assert!(vision.next().is_none());
        drop(vision);
        assert!(!folder.path().join("circles").exists());
    }

    #[test]
    fn a_vision_that_does_not_read_its_answers_is_disconnected() {
        let (_folder, _vision, mut sender, line) = sent("{\"picture\": 1}\n");
        let error = "e".repeat(100);
        (0..100_000).for_each(|_| line.answer(&Answer::Error { error: error.clone() }));
        sender.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        let mut answers = String::new();
        std::io::Read::read_to_string(&mut sender, &mut answers).unwrap();
        assert!(answers.lines().count() < 100_000);
    }
}
