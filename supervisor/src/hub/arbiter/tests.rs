use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, SensorFrame};
use tesaki_rng::Rng;

use super::*;

/// An arbiter in front of a node, over a lossy line.
struct Rig {
    arbiter: Arbiter,
    node: Node,
    line: VecDeque<u8>,
    now: Instant,
    rng: Rng,
    loss: f64,
    /// Frames that the connections got from the arbiter.
    answers: Vec<(u64, ReplyFrame)>,
    /// Replies that the board sent.
    replies: Vec<ReplyFrame>,
    /// All rates that were set on the board.
    rates: Vec<(Stream, u16)>,
    sequence: u16,
}

impl Rig {
    fn new() -> Self {
        Self {
            arbiter: Arbiter::new(),
            node: Node::new(),
            line: VecDeque::new(),
            now: Instant::now(),
            rng: Rng::new(1, 0),
            loss: 0.0,
            answers: Vec::new(),
            replies: Vec::new(),
            rates: Vec::new(),
            sequence: 0,
        }
    }

    /// Sends a request of a connection, whose program has 100 times the connection's number.
    fn ask(&mut self, connection: u64, request: Request) -> u16 {
        self.sequence += 1;
        self.ask_again(connection, self.sequence, request);
        self.sequence
    }

    fn ask_again(&mut self, connection: u64, sequence: u16, request: Request) {
        let client = u32::try_from(100 * connection).unwrap();
        let frame = encoded(&RequestFrame { client, sequence, request });
        self.arbiter.request(connection, &frame, &mut self.line);
    }

    /// Lets the arbiter and the board exchange frames until both are idle.
    fn run(&mut self) {
        loop {
            self.arbiter.proceed(self.now, &mut self.line);
            let frames: Vec<u8> = self.line.drain(..).collect();
            for frame in frames.split_inclusive(|&byte| byte == 0) {
                if self.rng.chance(self.loss) {
                    continue;
                }
                let request: RequestFrame = decode(frame).unwrap();
                if let Request::SetRate { stream, every } = request.request {
                    self.rates.push((stream, every));
                }
                let reply = self.node.handle(&request, &BoardStatus::default());
                self.replies.push(reply.clone());
                if !self.rng.chance(self.loss) {
                    self.arbiter.reply(&encoded(&FromBoard::Reply(reply)));
                }
            }
            for (connection, frame) in self.arbiter.answers() {
                let Some(FromBoard::Reply(reply)) = decode(&frame) else { panic!() };
                assert_eq!(u64::from(reply.client), 100 * connection);
                self.answers.push((connection, reply));
            }
            match self.arbiter.sent {
                None if self.arbiter.tasks.is_empty() => return,
                Some(_) => self.now += PATIENCE,
                None => {}
            }
        }
    }

    fn answer(&self, connection: u64, sequence: u16) -> Option<&Reply> {
        let mut answers = self.answers.iter().rev();
        let own = |(to, frame): &&(u64, ReplyFrame)| *to == connection && frame.sequence == sequence;
        answers.find(own).map(|(_, frame)| &frame.reply)
    }

    /// Reads the piece of an export that follows after `bytes`.
    fn read(&mut self, connection: u64, bytes: &mut Vec<u8>) {
        let offset = u32::try_from(bytes.len()).unwrap();
        let sequence = self.ask(connection, Request::ReadExport { offset });
        self.run();
        let Some(Reply::Chunk { data, .. }) = self.answer(connection, sequence) else { panic!() };
        bytes.extend_from_slice(data);
    }

    fn set_rate(&mut self, connection: u64, every: u16) {
        let number = u32::try_from(100 * connection).unwrap();
        self.ask(connection, Request::Hello { schema: SCHEMA_KEY });
        let sequence = self.ask(connection, Request::SetRate { stream: Stream::Telemetry, every });
        self.run();
        // The board answers the client directly.
        let last = self.replies.last().unwrap();
        assert_eq!((last.client, last.sequence, &last.reply), (number, sequence, &Reply::Done));
    }
}

#[test]
fn the_board_sends_at_the_highest_rate_that_anybody_wants() {
    let mut rig = Rig::new();
    for (connection, every, rate) in
        [(1, 5, 5), (2, 10, 5), (3, 2, 2), (2, 0, 2), (1, 0, 2), (3, 20, 20), (2, 4, 4), (3, 0, 4), (2, 0, 0)]
    {
        rig.set_rate(connection, every);
        assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, rate)), "{connection} requests {every}");
    }
    // Streams are independent.
    rig.set_rate(1, 1);
    rig.ask(2, Request::SetRate { stream: Stream::Log, every: 0 });
    rig.run();
    let sensors = SensorFrame { sequence: 1, ..SensorFrame::default() };
    rig.node.tick(&sensors);
    assert!(rig.node.is_due(Stream::Telemetry) && !rig.node.is_logged());
}

#[test]
fn a_rate_that_the_board_refuses_is_not_kept() {
    let mut rig = Rig::new();
    rig.ask(1, Request::Hello { schema: SCHEMA_KEY ^ 1 });
    rig.ask(1, Request::SetRate { stream: Stream::Telemetry, every: 1 });
    rig.ask(3, Request::SetRate { stream: Stream::Telemetry, every: 1 });
    rig.run();
    let refused = rig.replies.iter().filter(|reply| matches!(reply.reply, Reply::Refused(_)));
    assert_eq!(refused.count(), 2, "{:?}", rig.replies);
    rig.set_rate(2, 20);
    assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 20)));
}

#[test]
fn a_client_that_comes_back_has_its_rate_without_another_hello() {
    let mut rig = Rig::new();
    rig.set_rate(1, 1);
    rig.arbiter.left(1);
    rig.run();
    assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 0)));
    rig.ask(1, Request::SetRate { stream: Stream::Telemetry, every: 2 });
    rig.run();
    rig.set_rate(2, 20);
    assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 2)), "the other client's rate");
}

/// The board forgets no commander, however many others greet it.
#[test]
fn a_commander_sets_only_its_own_rate_after_many_hellos_of_others() {
    let mut rig = Rig::new();
    rig.ask(1, Request::Hello { schema: SCHEMA_KEY });
    rig.ask(1, Request::TakeCommand { by_force: false });
    rig.run();
    assert_eq!(rig.replies.last().unwrap().reply, Reply::Done);
    for other in 0..=u64::try_from(MAX_GREETED).unwrap() {
        rig.set_rate(2 + other, 2);
    }
    rig.ask(1, Request::SetRate { stream: Stream::Telemetry, every: 0 });
    rig.run();
    assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 2)), "the others' rate");
}

#[test]
fn what_a_connection_asked_for_ends_with_it() {
    for loss in [0.0, 0.3] {
        let mut rig = Rig::new();
        rig.set_rate(1, 1);
        rig.set_rate(2, 10);
        rig.loss = loss;
        let before = rig.rates.len();
        rig.arbiter.left(3); // never asked for anything
        rig.arbiter.left(1);
        rig.run();
        assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 10)), "loss {loss}");
        assert!(rig.rates.len() > before);
        rig.arbiter.left(2);
        rig.run();
        assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 0)), "loss {loss}");
        // The board has obeyed, although it did not know the hub.
        rig.node.tick(&SensorFrame { sequence: 10, ..SensorFrame::default() });
        assert!(!rig.node.is_due(Stream::Telemetry));
    }
    // Removing a connection with a lower rate than others changes nothing.
    let mut rig = Rig::new();
    rig.set_rate(1, 1);
    rig.set_rate(2, 10);
    let before = rig.rates.len();
    rig.arbiter.left(2);
    rig.run();
    assert_eq!(rig.rates.len(), before);
}

#[test]
fn a_board_that_is_away_for_long_learns_the_rates_when_it_is_back() {
    let mut rig = Rig::new();
    rig.set_rate(1, 1);
    rig.set_rate(2, 10);
    rig.arbiter.left(1);
    let export = rig.ask(2, Request::Export(Item::State));
    let mut away = VecDeque::new();
    for _ in 0..10 * MAX_SENDINGS {
        rig.arbiter.proceed(rig.now, &mut away);
        rig.now += PATIENCE;
    }
    // Neither what is lost nor what waits grows without end.
    assert_eq!(rig.arbiter.tasks.len(), 1);
    rig.run();
    assert_eq!(rig.rates.last(), Some(&(Stream::Telemetry, 10)));
    assert_eq!(rig.answer(2, export), None);
}

#[test]
fn each_connection_reads_its_own_export() {
    for loss in [0.0, 0.2] {
        let mut rig = Rig::new();
        rig.loss = loss;
        let numbers = [1, 2, 3].map(|connection| rig.ask(connection, Request::Export(Item::State)));
        rig.run();
        let mut exports = [(1, numbers[0]), (2, numbers[1]), (3, numbers[2])].map(|(connection, number)| {
            let reply = rig.answer(connection, number);
            let Some(&Reply::Exported { length, checksum, .. }) = reply else { panic!("{reply:?}") };
            (connection, length as usize, checksum, Vec::new())
        });
        // Each export has a different state, because the board counts the requests.
        assert!(exports[0].2 != exports[1].2 && exports[1].2 != exports[2].2);
        // The board is reset, or replaced by another: the copies remain.
        rig.node = Node::new();
        while exports.iter().any(|(_, length, _, bytes)| bytes.len() < *length) {
            for (connection, length, _, bytes) in &mut exports {
                if bytes.len() < *length {
                    rig.read(*connection, bytes);
                }
            }
        }
        for (connection, _, expected, bytes) in &exports {
            assert_eq!(checksum(bytes), *expected, "{connection}");
        }
    }
}

#[test]
fn a_repeated_export_is_made_once_and_a_new_one_anew() {
    let mut rig = Rig::new();
    let sequence = rig.ask(1, Request::Export(Item::State));
    rig.ask_again(1, sequence, Request::Export(Item::State)); // the client is impatient
    rig.run();
    rig.ask_again(1, sequence, Request::Export(Item::State)); // the answer was lost
    rig.run();
    let exported = |reply: &ReplyFrame| matches!(reply.reply, Reply::Exported { .. });
    assert_eq!(rig.replies.iter().filter(|reply| exported(reply)).count(), 1);
    assert_eq!(rig.answers.len(), 2);
    assert_eq!(rig.answers[0].1, rig.answers[1].1);
    rig.ask(1, Request::Export(Item::State));
    rig.run();
    assert_eq!(rig.replies.iter().filter(|reply| exported(reply)).count(), 2);
}

#[test]
fn refusals_of_exports_reach_the_one_who_asked() {
    let mut rig = Rig::new();
    let sequence = rig.ask(1, Request::ReadExport { offset: 0 });
    let other = rig.ask(2, Request::Export(Item::Model));
    rig.run();
    assert_eq!(rig.answer(1, sequence), Some(&Reply::Refused(Refusal::NotExported { length: 0 })));
    assert_eq!(rig.answer(2, other), Some(&Reply::Refused(Refusal::NoModel)));
    let sequence = rig.ask(1, Request::Export(Item::State));
    let beyond = rig.ask(1, Request::ReadExport { offset: u32::MAX });
    rig.run();
    let Some(&Reply::Exported { length, .. }) = rig.answer(1, sequence) else { panic!() };
    assert_eq!(rig.answer(1, beyond), Some(&Reply::Refused(Refusal::NotExported { length: 0 })));
    let beyond = rig.ask(1, Request::ReadExport { offset: length });
    rig.run();
    assert_eq!(rig.answer(1, beyond), Some(&Reply::Refused(Refusal::NotExported { length })));
}

#[test]
fn nobody_keeps_others_from_their_export() {
    let mut rig = Rig::new();
    let export = rig.ask(2, Request::Export(Item::State));
    // One connection leaves during its export, another restarts its export all the time.
    rig.ask(1, Request::Export(Item::State));
    rig.arbiter.proceed(rig.now, &mut rig.line);
    rig.arbiter.left(1);
    for _ in 0..1000 {
        rig.ask(3, Request::Export(Item::State));
        rig.ask(3, Request::Export(Item::Model));
    }
    assert!(rig.arbiter.tasks.len() <= 3, "{} tasks", rig.arbiter.tasks.len());
    rig.run();
    assert!(matches!(rig.answer(2, export), Some(Reply::Exported { .. })));

    // Requests to a board that does not answer are given up.
    rig.loss = 1.0;
    rig.ask(2, Request::Export(Item::State));
    rig.run();
    assert!(rig.arbiter.tasks.is_empty());
}

#[test]
fn what_is_not_understood_passes_unchanged() {
    let mut rig = Rig::new();
    for frame in [&[1, 2, 3, 0][..], &[0], &encoded(&(7_u32, 1_u16, 99_u8))] {
        rig.arbiter.request(1, frame, &mut rig.line);
        assert_eq!(rig.line.drain(..).collect::<Vec<u8>>(), frame);
    }
}
