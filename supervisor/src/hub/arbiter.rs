use std::collections::{BTreeMap, VecDeque};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    EXPORT_CHUNK, FromBoard, Item, Refusal, Reply, ReplyFrame, Request, RequestFrame, SCHEMA_KEY, Stream,
};

/// A request of the hub is repeated if it is not answered within this time.
const PATIENCE: Duration = Duration::from_millis(100);
/// Number of attempts after which an export is given up, and the rate of a stream makes room for it.
const MAX_SENDINGS: u32 = 20;
/// Number of attempts at an export whose pieces do not match their checksum.
const MAX_EXPORTS: u32 = 3;

/// Arbitrates the resources of which a board has only one: the rate of each stream, and the copy of an
/// export.
///
/// The board sends each stream at the highest rate that a connection requests. The hub reads one export after
/// the other, and each connection then reads its own copy. All other frames pass unchanged.
#[derive(Debug)]
pub(super) struct Arbiter {
    connections: BTreeMap<u64, Connection>,
    /// Numbers of the clients that have greeted last, over any connection.
    greeted: VecDeque<u32>,
    /// Client number and connection of who took command last.
    commander: Option<(u32, u64)>,
    /// The hub's own requests; the first one has been sent.
    tasks: VecDeque<Task>,
    client: u32,
    sequence: u16,
    /// Time at which the request was last sent, and number of attempts.
    sent: Option<(Instant, u32)>,
    /// Whether the board has forgotten the hub, which must greet it first.
    greets: bool,
    decoder: Decoder,
    /// Frames for single connections.
    answers: Vec<(u64, Vec<u8>)>,
}

/// Number of greeted clients to remember: the board itself remembers fewer.
const MAX_GREETED: usize = 16;

/// The requests of a connection.
#[derive(Debug, Default)]
struct Connection {
    /// Periods of the streams [ticks].
    rates: [u16; Stream::ALL.len()],
    copy: Option<Copy>,
    /// Its last request for command: client and sequence number.
    claim: Option<(u32, u16)>,
}

/// An export as read from the board.
#[derive(Clone, Debug)]
struct Copy {
    /// The request's client and sequence number.
    request: (u32, u16),
    /// The board's answer to the request.
    exported: Box<Reply>,
    tick: u32,
    bytes: Vec<u8>,
}

/// A request of the hub itself.
#[derive(Debug)]
enum Task {
    /// Lowers the rate of a stream for which the highest request has ended.
    Rate(Stream),
    /// Reads an export.
    Export(Export),
}

/// An export for a connection.
#[derive(Debug)]
struct Export {
    connection: u64,
    /// The request's client and sequence number.
    request: (u32, u16),
    item: Item,
    copy: Option<Copy>,
    /// Number of failed attempts.
    failed: u32,
}

impl Task {
    /// Returns whether it is an export for this connection.
    fn is_for(&self, connection: u64) -> bool {
        matches!(self, Self::Export(export) if export.connection == connection)
    }
}

impl Copy {
    /// Returns whether the copy is intact; `None` while pieces are missing.
    fn is_intact(&self) -> Option<bool> {
        let Reply::Exported { length, checksum: expected, .. } = *self.exported else { return Some(false) };
        (self.bytes.len() >= length as usize).then(|| checksum(&self.bytes) == expected)
    }

    /// The answer to [`Request::ReadExport`].
    fn chunk(&self, offset: u32) -> Reply {
        let rest =
            usize::try_from(offset).ok().and_then(|offset| self.bytes.get(offset..)).unwrap_or_default();
        if rest.is_empty() {
            let length = u32::try_from(self.bytes.len()).unwrap_or(u32::MAX);
            return Reply::Refused(Refusal::NotExported { length });
        }
        Reply::Chunk { offset, data: rest.iter().copied().take(EXPORT_CHUNK).collect() }
    }
}

fn decode<T: DeserializeOwned>(mut frame: &[u8]) -> Option<T> {
    let mut decoder = Decoder::new();
    if decoder.take(&mut frame) { decoder.message().ok() } else { None }
}

/// Returns whether a frame is a request that switches the robot off.
pub(super) fn stops(frame: &[u8]) -> bool {
    let request = decode::<RequestFrame>(frame).map(|frame| frame.request);
    matches!(request, Some(Request::Stop | Request::Disable))
}

fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    // Cannot fail, because the buffer has the length of the longest frame.
    let length = encode(message, &mut frame).unwrap_or_default();
    frame.get(..length).unwrap_or_default().to_vec()
}

impl Arbiter {
    pub(super) fn new() -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "any bits will do")]
        let client = RandomState::new().build_hasher().finish() as u32 | 1;
        Self {
            connections: BTreeMap::new(),
            greeted: VecDeque::new(),
            commander: None,
            tasks: VecDeque::new(),
            client,
            sequence: 0,
            sent: None,
            greets: false,
            decoder: Decoder::new(),
            answers: Vec::new(),
        }
    }

    /// Handles a frame of a connection, and appends the frames for the board to `board`.
    pub(super) fn request(&mut self, connection: u64, frame: &[u8], board: &mut VecDeque<u8>) {
        let Some(mut request) = decode::<RequestFrame>(frame) else {
            board.extend(frame);
            return;
        };
        // A commander that has lost its connection goes on at another one.
        if let Some((client, owner)) = &mut self.commander
            && *client == request.client
            && !self.connections.contains_key(owner)
        {
            *owner = connection;
        }
        let own = self.connections.entry(connection).or_default();
        let number = (request.client, request.sequence);
        if matches!(request.request, Request::TakeCommand { .. } | Request::Enable(_)) {
            own.claim = Some(number);
        }
        match request.request {
            Request::Hello { schema } => {
                self.greeted.retain(|client| *client != request.client);
                if schema == SCHEMA_KEY {
                    self.greeted.push_back(request.client);
                }
                if self.greeted.len() > MAX_GREETED {
                    self.greeted.pop_front();
                }
                board.extend(frame);
            }
            // Without a hello, over this connection or an earlier one, the board refuses it. It forgets no
            // commander.
            Request::SetRate { stream, every }
                if self.greeted.contains(&request.client)
                    || self.commander.is_some_and(|(client, _)| client == request.client) =>
            {
                own.rates[stream as usize] = every;
                request.request = Request::SetRate { stream, every: self.rate(stream) };
                board.extend(encoded(&request));
            }
            Request::Export(item) => match &own.copy {
                // A repeated request, because the answer was late.
                Some(Copy { request, exported, tick, .. }) if *request == number => {
                    let (exported, tick) = (Reply::clone(exported), *tick);
                    self.answer(connection, number, tick, exported);
                }
                _ => self.export(connection, number, item),
            },
            Request::ReadExport { offset } => {
                let nothing = Reply::Refused(Refusal::NotExported { length: 0 });
                let read = own.copy.as_ref().map(|copy| (copy.tick, copy.chunk(offset)));
                let (tick, reply) = read.unwrap_or((0, nothing));
                self.answer(connection, number, tick, reply);
            }
            _ => board.extend(frame),
        }
    }

    /// Removes a connection, with its requested rates.
    pub(super) fn left(&mut self, connection: u64) {
        let Some(gone) = self.connections.remove(&connection) else { return };
        self.cancel_export(connection);
        for stream in Stream::ALL {
            let (asked, rate) = (gone.rates[stream as usize], self.rate(stream));
            let queued = |task: &Task| matches!(task, Task::Rate(other) if *other == stream);
            if asked != 0 && (rate == 0 || rate > asked) && !self.tasks.iter().any(queued) {
                self.tasks.push_back(Task::Rate(stream));
            }
        }
    }

    /// Takes bytes from the board.
    pub(super) fn reply(&mut self, mut bytes: &[u8]) {
        while self.decoder.take(&mut bytes) {
            let Ok(FromBoard::Reply(frame)) = self.decoder.message() else { continue };
            let ReplyFrame { client, sequence, tick, reply } = frame;
            if reply == Reply::Done {
                let claim = Some((client, sequence));
                let claimed = self.connections.iter().find(|(_, connection)| connection.claim == claim);
                if let Some((&connection, _)) = claimed {
                    self.commander = Some((client, connection));
                }
            }
            if self.sent.is_some() && (client, sequence) == (self.client, self.sequence) {
                self.sent = None;
                self.advance(tick, reply);
            }
        }
    }

    /// Sends the hub's next request, or the last one again if its answer is late.
    pub(super) fn proceed(&mut self, now: Instant, board: &mut VecDeque<u8>) {
        match self.sent {
            Some((sent, _)) if now < sent + PATIENCE => return,
            Some((_, MAX_SENDINGS)) => {
                self.sent = None;
                // The connection that waits for an export gets no answer either. A rate stays, of each stream
                // one at most: a board that comes back would go on at that of a connection that has ended.
                if let Some(task @ Task::Rate(_)) = self.tasks.pop_front() {
                    self.tasks.push_back(task);
                }
            }
            _ => {}
        }
        let Some(task) = self.tasks.front() else { return };
        let request = match task {
            _ if self.greets => Request::Hello { schema: SCHEMA_KEY },
            Task::Rate(stream) => Request::SetRate { stream: *stream, every: self.rate(*stream) },
            Task::Export(Export { item, copy: None, .. }) => Request::Export(*item),
            Task::Export(Export { copy: Some(copy), .. }) => {
                Request::ReadExport { offset: u32::try_from(copy.bytes.len()).unwrap_or(u32::MAX) }
            }
        };
        let sendings = self.sent.map_or(0, |(_, sendings)| sendings);
        if sendings == 0 {
            self.sequence = self.sequence.wrapping_add(1);
        }
        self.sent = Some((now, sendings + 1));
        let frame = RequestFrame { client: self.client, sequence: self.sequence, request };
        board.extend(encoded(&frame));
    }

    /// Returns whether this connection took command last.
    pub(super) fn is_commander(&self, connection: u64) -> bool {
        self.commander.is_some_and(|(_, owner)| owner == connection)
    }

    /// Takes the frames for single connections since the last call.
    pub(super) fn answers(&mut self) -> Vec<(u64, Vec<u8>)> {
        std::mem::take(&mut self.answers)
    }

    /// Returns the highest rate that a connection requests, as a period [ticks].
    fn rate(&self, stream: Stream) -> u16 {
        let rates = self.connections.values().map(|connection| connection.rates[stream as usize]);
        rates.filter(|&every| every != 0).min().unwrap_or(0)
    }

    /// Queues a reply to one connection.
    fn answer(&mut self, connection: u64, (client, sequence): (u32, u16), tick: u32, reply: Reply) {
        let frame = FromBoard::Reply(ReplyFrame { client, sequence, tick, reply });
        self.answers.push((connection, encoded(&frame)));
    }

    /// Queues an export, replacing an earlier one of the same connection.
    fn export(&mut self, connection: u64, request: (u32, u16), item: Item) {
        let same = |task: &Task| matches!(task, Task::Export(export) if export.request == request);
        if !self.tasks.iter().any(|task| task.is_for(connection) && same(task)) {
            self.cancel_export(connection);
            self.tasks.push_back(Task::Export(Export { connection, request, item, copy: None, failed: 0 }));
        }
    }

    fn cancel_export(&mut self, connection: u64) {
        if self.tasks.front().is_some_and(|task| task.is_for(connection)) {
            self.sent = None;
        }
        self.tasks.retain(|task| !task.is_for(connection));
    }

    /// Handles the answer to the hub's request.
    fn advance(&mut self, tick: u32, reply: Reply) {
        match reply {
            Reply::Hello { .. } => self.greets = false,
            Reply::Refused(Refusal::SchemaMismatch { board: SCHEMA_KEY, .. }) => self.greets = true,
            reply => {
                if let Some(Task::Export(export)) = self.tasks.pop_front() {
                    self.advance_export(export, tick, reply);
                }
            }
        }
    }

    fn advance_export(&mut self, mut export: Export, tick: u32, reply: Reply) {
        let Export { connection, request, ref mut copy, .. } = export;
        match (&mut *copy, reply) {
            (None, exported @ Reply::Exported { .. }) => {
                *copy = Some(Copy { request, exported: Box::new(exported), tick, bytes: Vec::new() });
            }
            (Some(copy), Reply::Chunk { data, .. }) if !data.is_empty() => {
                copy.bytes.extend_from_slice(&data)
            }
            (None, refused) => return self.answer(connection, request, tick, refused),
            (Some(_), _) => *copy = None,
        }
        if let Some(copy) = copy.take_if(|copy| copy.is_intact().is_some())
            && copy.is_intact() == Some(true)
        {
            let (exported, tick) = (Reply::clone(&copy.exported), copy.tick);
            if let Some(own) = self.connections.get_mut(&connection) {
                own.copy = Some(copy);
                self.answer(connection, request, tick, exported);
            }
            return;
        }
        export.failed += u32::from(export.copy.is_none());
        if export.failed < MAX_EXPORTS {
            self.tasks.push_front(Task::Export(export));
        } else {
            self.answer(connection, request, tick, Reply::Refused(Refusal::NotExported { length: 0 }));
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;
