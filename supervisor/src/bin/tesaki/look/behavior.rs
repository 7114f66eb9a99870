//! The connection to the behaviour, which says what to look for.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use tesaki_supervisor::port::{Address, connect};

use crate::find_circle::Known;
use crate::sight::{Answer, Sight};

/// An answer is waited for so long.
const ANSWER: Duration = Duration::from_millis(60);
/// A behaviour that does not listen is tried again after this time.
const AGAIN: Duration = Duration::from_millis(200);
/// Longest line [bytes].
const MAX_LINE: usize = 1 << 12;

/// The behaviour at an address, whether it runs or not.
pub struct Behavior {
    address: Address,
    stream: Option<UnixStream>,
    /// When a connection was tried last.
    tried: Option<Instant>,
    /// What has come of the next lines.
    received: Vec<u8>,
    /// What it said last, for when it does not answer in time.
    last: Option<Known>,
    /// What is wrong with it, or with what it got.
    pub troubles: Vec<String>,
}

impl Behavior {
    pub const fn new(address: Address) -> Self {
        Self { address, stream: None, tried: None, received: Vec::new(), last: None, troubles: Vec::new() }
    }

    pub const fn is_connected(&self) -> bool {
        self.stream.is_some()
    }

    /// Asks what to look for in a picture; `None` when the behaviour does not need it. Without a behaviour,
    /// it is what is `known`.
    pub fn ask(&mut self, question: &Sight, known: &Known) -> Option<Known> {
        self.open();
        self.tell(question);
        let deadline = Instant::now() + ANSWER;
        while let Some(answer) = self.answer(deadline) {
            match answer {
                Answer::Search { picture, search } if picture == question.picture => {
                    let search = Known::from(search?);
                    self.last = Some(search);
                    return Some(search);
                }
                Answer::Error { error } => self.troubles.push(format!("{} says: {error}", self.address)),
                // That of an earlier picture came too late.
                Answer::Search { .. } | Answer::Greeting { .. } => {}
            }
        }
        Some(self.last.unwrap_or(*known))
    }

    /// Sends a line, if the behaviour is there.
    pub fn tell(&mut self, sight: &Sight) {
        let line = serde_json::to_string(sight).unwrap_or_default() + "\n";
        if let Some(stream) = &mut self.stream
            && let Err(error) = stream.write_all(line.as_bytes())
        {
            self.lose(&error.to_string());
        }
    }

    fn open(&mut self) {
        if self.stream.is_some() || self.tried.is_some_and(|tried| tried.elapsed() < AGAIN) {
            return;
        }
        self.tried = Some(Instant::now());
        let opened = connect(&self.address).and_then(|stream| {
            stream.set_write_timeout(Some(ANSWER))?;
            Ok(stream)
        });
        match opened {
            Ok(stream) => self.stream = Some(stream),
            Err(error) => self.lose(&error.to_string()),
        }
    }

    fn lose(&mut self, why: &str) {
        self.stream = None;
        self.received.clear();
        self.last = None;
        self.troubles.push(format!("{}: {why}; waiting for `tesaki approach` there", self.address));
    }

    /// The next answer that comes before the deadline.
    fn answer(&mut self, deadline: Instant) -> Option<Answer> {
        loop {
            if let Some(end) = self.received.iter().position(|&byte| byte == b'\n') {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                match Answer::read(String::from_utf8_lossy(&line).trim()) {
                    Ok(answer) => return Some(answer),
                    Err(error) => {
                        self.lose(&error);
                        return None;
                    }
                }
            }
            let stream = self.stream.as_mut()?;
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
                return None;
            }
            let mut bytes = [0; 512];
            match stream.read(&mut bytes) {
                Ok(0) => self.lose("it has closed the connection"),
                Ok(length) if self.received.len() + length > MAX_LINE => {
                    self.lose("it sends too long a line")
                }
                Ok(length) => self.received.extend_from_slice(&bytes[..length]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return None;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => self.lose(&error.to_string()),
            }
        }
    }
}
