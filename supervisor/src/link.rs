use std::collections::VecDeque;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use tesaki::protocol::codec::{Decoder, FrameCounts, MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Refusal, Reply, ReplyFrame, Request, RequestFrame, SCHEMA_KEY};

use crate::{Board, BoardError};

/// How long the first sending of a request waits for its answer before the request is sent again: short
/// enough that a lost reply does not cost an enabled board its command timeout. Then it waits twice as long
/// each time, up to [`MAX_PATIENCE`], so as not to choke a slow board.
const PATIENCE: Duration = Duration::from_millis(40);
/// See [`PATIENCE`].
const MAX_PATIENCE: Duration = Duration::from_millis(160);
/// Maximum number of queued messages; the oldest are dropped. Some twenty seconds of everything a board
/// sends.
const INBOX: usize = 8192;

/// From one look at the flag of [`LinkBoard::interrupt_by`] to the next.
const GLANCE: Duration = Duration::from_millis(5);

/// A two-way stream of bytes: serial port, socket, pseudo-terminal.
pub trait ByteLink {
    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// When the link is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Receives what is there, waiting for the first byte until `deadline`; 0 when none came.
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
    /// The last request whose answer was waited for and came.
    answered: u16,
    timeout: Duration,
    inbox: VecDeque<FromBoard>,
    /// Requests that were sent again.
    repeats: u64,
    round_trip: Option<Duration>,
    interrupt: Option<Arc<AtomicBool>>,
}

impl<L: ByteLink> LinkBoard<L> {
    /// A board that answers within `timeout`, over a link that may damage and lose: what is not answered is
    /// sent again until then.
    pub fn new(link: L, timeout: Duration) -> Self {
        // Two programs must not choose the same number, and it needs no secrecy.
        #[expect(clippy::cast_possible_truncation, reason = "any bits will do")]
        let client = RandomState::new().build_hasher().finish() as u32 | 1;
        Self {
            link,
            decoder: Decoder::new(),
            client,
            sequence: 0,
            answered: 0,
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

    /// Answers are waited for so long from now on.
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

    /// The link, to be used by hand.
    pub const fn link_mut(&mut self) -> &mut L {
        &mut self.link
    }

    /// Frames received, by kind of damage.
    pub const fn counts(&self) -> FrameCounts {
        self.decoder.counts()
    }

    /// Requests that had to be sent again.
    pub const fn repeats(&self) -> u64 {
        self.repeats
    }

    /// From the last request to its reply.
    pub const fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    /// Sends a request without waiting for the answer; returns its number. For set-points, each of which says
    /// the whole aim: one that is lost is made up for by the next. A refusal comes as an
    /// [event](Self::next_event).
    ///
    /// # Errors
    /// When the link fails.
    pub fn post(&mut self, request: Request) -> Result<u16, BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        self.send(&RequestFrame { client: self.client, sequence: self.sequence, request })?;
        Ok(self.sequence)
    }

    /// The next thing that came unasked, or a refusal of what was [posted](Self::post); `None` when nothing
    /// comes until `deadline`.
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

    /// Takes what comes until `deadline`, but not more than once: returns the reply to request `sequence`,
    /// and puts what came unasked and refusals into the inbox.
    fn receive(&mut self, deadline: Instant, sequence: Option<u16>) -> Result<Option<Reply>, BoardError> {
        let mut buffer = [0; 4096];
        let received = self.link.receive(&mut buffer, deadline)?;
        let mut bytes = &buffer[..received];
        let mut answer = None;
        while self.decoder.take(&mut bytes) {
            match self.decoder.message() {
                // Damaged frames are counted by the decoder; what is missing is asked for again.
                Err(_) => {}
                Ok(FromBoard::Reply(ReplyFrame { client, .. })) if client != self.client => {}
                Ok(FromBoard::Reply(reply)) if sequence == Some(reply.sequence) => answer = Some(reply.reply),
                Ok(FromBoard::Reply(ReplyFrame { reply: Reply::Done, .. })) => {}
                // The answer to a repetition of a request that was answered, or to an earlier one.
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
        match self.exchange(request.clone())? {
            // It was reset, or many others have talked to it since: it has forgotten our hello.
            Reply::Refused(Refusal::SchemaMismatch { board: SCHEMA_KEY, .. }) => {
                self.exchange(Request::Hello { schema: SCHEMA_KEY })?;
                match self.exchange(request)? {
                    // A commander is forgotten in a reset only.
                    Reply::Refused(Refusal::NotCommander) => Err(BoardError::Reset),
                    reply => Ok(reply),
                }
            }
            reply => Ok(reply),
        }
    }
}

impl<L: ByteLink> LinkBoard<L> {
    /// Sends a request until it is answered.
    fn exchange(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = RequestFrame { client: self.client, sequence: self.sequence, request };
        let deadline = Instant::now() + self.timeout;
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
                    self.round_trip = Some(sent.elapsed());
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
