//! Ways to run the control core.

use tesaki::node::Node;
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, LogRecord, LogStart, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFrame,
};
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError};

use crate::digest::FramesDigest;

/// The only client of a node in this process.
const CLIENT: u32 = 1;

/// A board with simulated sensors and drives.
pub trait Controller: FingerBoard {
    /// Runs one control period.
    ///
    /// # Errors
    /// The link to the controller fails.
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError>;
}

/// The control core in this process.
#[derive(Debug)]
pub struct Native {
    node: Box<Node>,
    board: BoardStatus,
    sequence: u16,
    /// News of the posted requests.
    news: News,
}

impl Default for Native {
    fn default() -> Self {
        let (node, news) = (Box::new(Node::new()), News::default());
        Self { node, board: BoardStatus::default(), sequence: 0, news }
    }
}

impl Native {
    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }
}

impl Board for Native {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        Ok(self
            .node
            .handle(&RequestFrame { client: CLIENT, sequence: self.sequence, request }, &self.board)
            .reply)
    }
}

impl Controller for Native {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        Ok(self.node.tick(sensors))
    }
}

impl FingerBoard for Native {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        if let Reply::Refused(refusal) = self.request(request)? {
            self.news.refuse(refusal);
        }
        Ok(())
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        let refusal = self.news.refusal.take();
        Ok(News { telemetry: Some(self.node.telemetry()), tips: Some(self.node.tips()), refusal })
    }
}

/// A controller that is compared with a second one, which gets the same requests and sensor frames: both must
/// answer with the same bytes. Keeps the recording from which the run can be replayed.
pub struct Watched<'a> {
    first: &'a mut dyn Controller,
    second: Option<Native>,
    /// Number of ticks in which both answers were equal.
    pub alike: u64,
    /// The first tick in which they differed, with both answers.
    pub difference: Option<(u32, ActuatorFrame, ActuatorFrame)>,
    /// Digest of all answers of each.
    digest: FramesDigest,
    second_digest: FramesDigest,
    record: Vec<LogRecord>,
    sequence: u16,
}

impl<'a> Watched<'a> {
    /// Watches `first`; with `compare`, compares it with the core in this process.
    pub fn new(first: &'a mut dyn Controller, compare: bool) -> Self {
        let second = compare.then(Native::default);
        let identity = BoardStatus::default().identity;
        let start = LogStart { schema: SCHEMA_KEY, identity, unix_time: 0 };
        let record = vec![LogRecord::Start(start)];
        Self {
            first,
            second,
            alike: 0,
            difference: None,
            digest: FramesDigest::default(),
            second_digest: FramesDigest::default(),
            record,
            sequence: 0,
        }
    }

    /// Whether all frames and replies so far were equal; `None` without a comparison.
    pub fn identical(&self) -> Option<bool> {
        let are_same = || self.alike > 0 && self.digest.hex() == self.second_digest.hex();
        self.second.is_some().then(|| self.difference.is_none() && are_same())
    }

    /// Digest of all actuator frames and replies so far.
    pub fn frames_sha256(&self) -> String {
        self.digest.hex()
    }

    /// Returns all inputs and outputs, in order: a complete recording.
    pub fn into_record(mut self) -> Vec<LogRecord> {
        let outputs = self.record.iter().filter(|record| matches!(record, LogRecord::Actuators(_)));
        let ticks = u32::try_from(outputs.count()).unwrap_or(u32::MAX);
        self.record.push(LogRecord::End { ticks });
        self.record
    }
}

impl Board for Watched<'_> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = RequestFrame { client: CLIENT, sequence: self.sequence, request: request.clone() };
        self.record.push(LogRecord::Request(frame));
        if let Some(second) = &mut self.second {
            self.second_digest.reply(&second.request(request.clone())?);
        }
        let reply = self.first.request(request)?;
        self.digest.reply(&reply);
        Ok(reply)
    }
}

impl FingerBoard for Watched<'_> {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = RequestFrame { client: CLIENT, sequence: self.sequence, request: request.clone() };
        self.record.push(LogRecord::Request(frame));
        if let Some(second) = &mut self.second {
            second.request(request.clone())?;
        }
        self.first.post(request)
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        self.first.listen()
    }
}

impl Controller for Watched<'_> {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        let actuators = self.first.tick(sensors)?;
        self.digest.frame(&actuators);
        if let Some(second) = &mut self.second {
            let other = second.tick(sensors)?;
            self.second_digest.frame(&other);
            if bytes(&actuators) == bytes(&other) {
                self.alike += 1;
            } else if self.difference.is_none() {
                self.difference = Some((sensors.sequence, actuators.clone(), other));
            }
        }
        self.record.push(LogRecord::Sensors(sensors.clone()));
        self.record.push(LogRecord::Actuators(actuators.clone()));
        Ok(actuators)
    }
}

/// Encodes the frame as on the plant link: equal bytes mean equal bits.
fn bytes(frame: &ActuatorFrame) -> Result<Vec<u8>, postcard::Error> {
    postcard::to_stdvec(frame)
}
