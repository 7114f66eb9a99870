use std::collections::VecDeque;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tesaki::protocol::codec::{Decoder, FrameCounts, MAX_FRAME, encode};
use tesaki::protocol::{
    FromBoard, LogEntry, LogRecord, Mode, NodeStatus, Refusal, Reply, ReplyFrame, Request, RequestFrame,
    SCHEMA_KEY, Stream,
};
use tesaki::task::TaskConfig;

use crate::board::{ENABLE, TARE};
use crate::{Board, BoardError};

/// Time that the first sending of a request waits for its answer before the request is repeated: short enough
/// that a lost reply does not cost an enabled board its command timeout. The wait is doubled for each
/// repetition, up to [`MAX_PATIENCE`], so as not to flood a slow board.
const PATIENCE: Duration = Duration::from_millis(40);
/// See [`PATIENCE`].
const MAX_PATIENCE: Duration = Duration::from_millis(160);
/// Maximum number of queued messages; the oldest are dropped. About twenty seconds of all streams of a board.
const INBOX: usize = 8192;

/// Number of requests after which an answer that was not awaited counts as late. Less than half of the
/// sequence numbers, so that answers to new requests never do.
const OLD: u16 = 1 << 14;

/// Interval at which the flag of [`LinkBoard::interrupt_by`] is checked.
const GLANCE: Duration = Duration::from_millis(5);

/// Ticks after homing in which a board refuses to tare, and some more.
const SETTLING: u32 = 120;
/// A board whose ticks stand still for this time has no sensors.
const STANDSTILL: Duration = Duration::from_millis(500);

/// How long a silent board has for an answer.
const RECONNECT: Duration = Duration::from_millis(200);
/// Time in which a board whose control loop runs logs something.
const LOGGED: Duration = Duration::from_millis(500);

/// A two-way stream of bytes: serial port, socket, pseudo-terminal.
pub trait ByteLink {
    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// When the link is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Receives available bytes, waiting for the first one until `deadline`; returns 0 if none came.
    ///
    /// # Errors
    /// When the link is gone.
    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize>;
}

/// A board at the other end of a [`ByteLink`].
#[derive(Debug)]
pub struct LinkBoard<L> {
    link: L,
    decoder: Decoder,
    client: u32,
    sequence: u16,
    /// The last request whose answer was awaited and received, or [`OLD`] requests ago.
    answered: u16,
    /// Whether the board has forgotten this client's hello since it took command.
    is_forgotten: bool,
    timeout: Duration,
    inbox: VecDeque<FromBoard>,
    /// Number of repeated requests.
    repeats: u64,
    round_trip: Option<Duration>,
    interrupt: Option<Arc<AtomicBool>>,
}

impl<L: ByteLink> LinkBoard<L> {
    /// Creates a board that answers within `timeout`, over a link that may damage and lose frames: a request
    /// is repeated until it is answered, or the time is over.
    pub fn new(link: L, timeout: Duration) -> Self {
        // Two programs must not choose the same number; it need not be secret.
        #[expect(clippy::cast_possible_truncation, reason = "any bits will do")]
        let client = RandomState::new().build_hasher().finish() as u32 | 1;
        Self {
            link,
            decoder: Decoder::new(),
            client,
            sequence: 0,
            answered: 0,
            is_forgotten: false,
            timeout,
            inbox: VecDeque::new(),
            repeats: 0,
            round_trip: None,
            interrupt: None,
        }
    }

    /// From now on, every wait for an answer ends with [`BoardError::Interrupted`] while `flag` is set, so
    /// that something more urgent can be [posted](Self::post).
    pub fn interrupt_by(&mut self, flag: Arc<AtomicBool>) {
        self.interrupt = Some(flag);
    }

    /// Sets the time limit for answers.
    pub const fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// The number by which the board knows this client.
    pub const fn client(&self) -> u32 {
        self.client
    }

    /// The link.
    pub const fn link(&self) -> &L {
        &self.link
    }

    /// The link, for direct use.
    pub const fn link_mut(&mut self) -> &mut L {
        &mut self.link
    }

    /// Number of received frames, by kind of damage.
    pub const fn counts(&self) -> FrameCounts {
        self.decoder.counts()
    }

    /// Number of requests that had to be repeated.
    pub const fn repeats(&self) -> u64 {
        self.repeats
    }

    /// Time from when the last request was sent first to its reply.
    pub const fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    /// Sends a request without waiting for the answer; returns its number. For set-points, each of which
    /// states the complete target: the next one replaces a lost one. A refusal comes as an
    /// [event](Self::next_event).
    ///
    /// # Errors
    /// When the link fails.
    pub fn post(&mut self, request: Request) -> Result<u16, BoardError> {
        let sequence = self.next_sequence();
        self.send(&RequestFrame { client: self.client, sequence, request })?;
        Ok(sequence)
    }

    const fn next_sequence(&mut self) -> u16 {
        self.sequence = self.sequence.wrapping_add(1);
        if self.sequence.wrapping_sub(self.answered) > OLD {
            self.answered = self.sequence.wrapping_sub(OLD);
        }
        self.sequence
    }

    /// Returns the next unsolicited message, or a refusal of a [posted](Self::post) request; `None` if
    /// nothing comes until `deadline`.
    ///
    /// # Errors
    /// When the link fails.
    pub fn next_event(&mut self, deadline: Instant) -> Result<Option<FromBoard>, BoardError> {
        while self.inbox.is_empty() {
            self.receive(deadline, None)?;
            if self.inbox.is_empty() && Instant::now() >= deadline {
                return Ok(None);
            }
        }
        Ok(self.inbox.pop_front())
    }

    fn send(&mut self, request: &RequestFrame) -> Result<(), BoardError> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(request, &mut frame).map_err(io::Error::other)?;
        Ok(self.link.send(&frame[..length])?)
    }

    /// Receives once, waiting until `deadline`: returns the reply to request `sequence`, and puts unsolicited
    /// messages and refusals into the inbox.
    fn receive(&mut self, deadline: Instant, sequence: Option<u16>) -> Result<Option<Reply>, BoardError> {
        let mut buffer = [0; 4096];
        let received = self.link.receive(&mut buffer, deadline)?;
        let mut bytes = &buffer[..received];
        let mut answer = None;
        while self.decoder.take(&mut bytes) {
            match self.decoder.message() {
                // Damaged frames are counted by the decoder; requests without an answer are repeated.
                Err(_) => {}
                Ok(FromBoard::Reply(ReplyFrame { client, .. })) if client != self.client => {}
                Ok(FromBoard::Reply(reply)) if sequence == Some(reply.sequence) => answer = Some(reply.reply),
                Ok(FromBoard::Reply(ReplyFrame { reply: Reply::Done, .. })) => {}
                // The answer to a repetition of an answered request, or to an earlier request.
                Ok(FromBoard::Reply(reply)) if self.answered.wrapping_sub(reply.sequence) < 1 << 15 => {}
                Ok(event) => {
                    if self.inbox.len() >= INBOX {
                        self.inbox.pop_front();
                    }
                    self.inbox.push_back(event);
                }
            }
        }
        Ok(answer)
    }
}

impl<L: ByteLink> Board for LinkBoard<L> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        let takes_command = matches!(request, Request::TakeCommand { .. });
        let mut reply = self.exchange(request.clone())?;
        if let Reply::Refused(Refusal::SchemaMismatch { board: SCHEMA_KEY, .. }) = reply {
            // The board was reset, or has since talked to many other clients.
            self.is_forgotten = true;
            self.exchange(Request::Hello { schema: SCHEMA_KEY })?;
            reply = self.exchange(request)?;
        }
        match reply {
            // A board forgets its commander only in a reset.
            Reply::Refused(Refusal::NotCommander) if self.is_forgotten => Err(BoardError::Reset),
            Reply::Done if takes_command => {
                self.is_forgotten = false;
                Ok(reply)
            }
            reply => Ok(reply),
        }
    }

    /// What comes next may take another round trip: the board gets a command before.
    fn enable(&mut self, task: TaskConfig) -> Result<(), BoardError> {
        self.ask(ENABLE, Request::Enable(task))?;
        self.post(Request::Keep).map(|_| ())
    }

    /// Waits while the board, disabled, refuses because it was homed just now. An enabled one needs the
    /// requests of its client meanwhile.
    fn tare(&mut self) -> Result<(), BoardError> {
        let mut first = None;
        let (mut last, mut moved) = (None, Instant::now());
        loop {
            let answer = self.ask(TARE, Request::Tare);
            if !matches!(answer, Err(BoardError::Refused { refusal: Refusal::NoSensors, .. })) {
                return answer;
            }
            let NodeStatus { mode, tick, .. } = self.status()?.node;
            // A simulated board may be slower than the clock.
            let passed = tick.wrapping_sub(*first.get_or_insert(tick));
            if last.replace(tick) != Some(tick) {
                moved = Instant::now();
            }
            if mode != Mode::Disabled || passed > SETTLING || moved.elapsed() > STANDSTILL {
                return answer;
            }
            self.check_interrupt()?;
            std::thread::sleep(GLANCE);
        }
    }
}

impl<L: ByteLink> LinkBoard<L> {
    /// Requests the streams again, with their periods [ticks], from a silent board, which may have been reset
    /// or replaced. Returns whether it answered.
    ///
    /// # Errors
    /// One that does not [pass](BoardError::passes).
    pub fn reconnect(&mut self, streams: &[(Stream, u16)]) -> Result<bool, BoardError> {
        let timeout = self.timeout;
        self.timeout = timeout.min(RECONNECT);
        let answer = self
            .hello()
            .and_then(|_| streams.iter().try_for_each(|&(stream, every)| self.set_rate(stream, every)));
        self.timeout = timeout;
        match answer {
            Ok(()) => Ok(true),
            // The caller tries again later.
            Err(error) if error.passes() => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Returns what `find` finds first in the entries of the board's log; `None` when its control loop does
    /// not run.
    ///
    /// # Errors
    /// When the board refuses, or does not answer.
    pub fn find_in_log<T>(
        &mut self,
        mut find: impl FnMut(&LogRecord) -> Option<T>,
    ) -> Result<Option<T>, BoardError> {
        self.set_rate(Stream::Log, 1)?;
        let deadline = Instant::now() + LOGGED;
        let mut found = None;
        while found.is_none()
            && Instant::now() < deadline
            && let Some(event) = self.next_event(deadline)?
        {
            if let FromBoard::Log(LogEntry { record, .. }) = event {
                found = find(&record);
            }
        }
        self.set_rate(Stream::Log, 0)?;
        Ok(found)
    }

    /// Returns whether the outputs are on; `None` when the control loop does not run.
    ///
    /// # Errors
    /// As [`find_in_log`](Self::find_in_log).
    pub fn outputs(&mut self) -> Result<Option<bool>, BoardError> {
        self.find_in_log(|record| match record {
            LogRecord::Actuators(frame) => Some(frame.enabled),
            _ => None,
        })
    }

    /// Sends a request until it is answered.
    fn exchange(&mut self, request: Request) -> Result<Reply, BoardError> {
        let frame = RequestFrame { client: self.client, sequence: self.next_sequence(), request };
        let begun = Instant::now();
        let deadline = begun + self.timeout;
        let mut wait = PATIENCE;
        loop {
            self.check_interrupt()?;
            let sent = Instant::now();
            self.send(&frame)?;
            let patience = (sent + wait).min(deadline);
            wait = (2 * wait).min(MAX_PATIENCE);
            loop {
                self.check_interrupt()?;
                let glance =
                    self.interrupt.as_ref().map_or(patience, |_| patience.min(Instant::now() + GLANCE));
                if let Some(answer) = self.receive(glance, Some(frame.sequence))? {
                    self.round_trip = Some(begun.elapsed());
                    self.answered = frame.sequence;
                    return Ok(answer);
                }
                if Instant::now() >= patience {
                    break;
                }
            }
            if Instant::now() >= deadline {
                return Err(BoardError::Timeout { seconds: self.timeout.as_secs_f64() });
            }
            self.repeats += 1;
        }
    }

    fn check_interrupt(&self) -> Result<(), BoardError> {
        match &self.interrupt {
            Some(flag) if flag.load(Ordering::Relaxed) => Err(BoardError::Interrupted),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Takes everything, and gives what was put in.
    #[derive(Default)]
    struct Answers(VecDeque<u8>);

    impl ByteLink for Answers {
        fn send(&mut self, _: &[u8]) -> io::Result<()> {
            Ok(())
        }

        fn receive(&mut self, buffer: &mut [u8], _: Instant) -> io::Result<usize> {
            let length = self.0.len().min(buffer.len());
            buffer.iter_mut().zip(self.0.drain(..length)).for_each(|(place, byte)| *place = byte);
            Ok(length)
        }
    }

    /// The refusal of a request is an event, however many requests were posted before it.
    #[test]
    fn refusals_come_through_after_more_requests_than_there_are_numbers() {
        let mut board = LinkBoard::new(Answers::default(), Duration::from_secs(1));
        for number in 0..200_000 {
            let sequence = board.post(Request::Keep).unwrap();
            if number % 1000 != 0 {
                continue;
            }
            let reply = Reply::Refused(Refusal::NotCommander);
            let frame = FromBoard::Reply(ReplyFrame { client: board.client(), sequence, tick: 0, reply });
            let mut bytes = [0; MAX_FRAME];
            let length = encode(&frame, &mut bytes).unwrap();
            board.link_mut().0.extend(&bytes[..length]);
            let event = board.next_event(Instant::now()).unwrap();
            assert!(matches!(event, Some(FromBoard::Reply(_))), "{number}: {event:?}");
        }
    }
}
