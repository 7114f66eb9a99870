use core::fmt;

use heapless::Vec;

use super::{MAX_STATE, Node};
use crate::protocol::{ActuatorFrame, BoardStatus, LogRecord, SCHEMA_KEY, codec};

/// Repeats a recorded run: gives a node what it was given, and compares what it answers, bit for bit.
#[derive(Debug)]
pub struct Replay<'a> {
    node: &'a mut Node,
    board: BoardStatus,
    /// Pieces of a state.
    state: Vec<u8, MAX_STATE>,
    /// The answer to the last sensors.
    computed: Option<ActuatorFrame>,
    /// Whether the node is in the state that the recorded one had.
    in_step: bool,
}

/// Why a recording cannot be repeated.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplayError {
    /// The node answered differently.
    Different {
        /// As recorded.
        recorded: ActuatorFrame,
        /// As computed now.
        computed: ActuatorFrame,
        /// The first joint whose torque differs; `None` when something else does.
        joint: Option<usize>,
    },
    /// It was recorded with another version of the protocol.
    Schema {
        /// The recording's.
        recorded: u64,
    },
    /// The pieces of a state do not make one.
    State,
    /// Actuators without sensors.
    Order,
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Different { recorded, computed, joint } => {
                write!(f, "tick {}: ", recorded.sequence)?;
                let torque = |frame: &ActuatorFrame, joint: usize| {
                    frame.torques.get(joint).copied().unwrap_or(f32::NAN)
                };
                match *joint {
                    Some(joint) => {
                        let (recorded, computed) = (torque(recorded, joint), torque(computed, joint));
                        write!(
                            f,
                            "torque of joint {joint} was {recorded} ({:#010x}), is {computed} ({:#010x}) N·m",
                            recorded.to_bits(),
                            computed.to_bits()
                        )
                    }
                    None => write!(
                        f,
                        "the outputs were {} with {} torques (tick {}), are {} with {} torques (tick {})",
                        if recorded.enabled { "on" } else { "off" },
                        recorded.torques.len(),
                        recorded.sequence,
                        if computed.enabled { "on" } else { "off" },
                        computed.torques.len(),
                        computed.sequence
                    ),
                }
            }
            Self::Schema { recorded } => write!(
                f,
                "the recording has schema {recorded:016x}, this program {SCHEMA_KEY:016x}: use the program of the \
                 version that recorded it"
            ),
            Self::State => write!(f, "the state in the recording is incomplete or damaged"),
            Self::Order => write!(f, "the recording has an answer without the sensors that it answers"),
        }
    }
}

impl core::error::Error for ReplayError {}

impl<'a> Replay<'a> {
    /// A replay on `node`, which is as new, or in the state in which the recording finds it.
    pub fn new(node: &'a mut Node) -> Self {
        Self { node, board: BoardStatus::default(), state: Vec::new(), computed: None, in_step: true }
    }

    /// Repeats one entry; says whether it was an answer that was compared and found the same.
    ///
    /// # Errors
    /// Why it cannot be repeated, or how the answers differ.
    pub fn feed(&mut self, record: &LogRecord) -> Result<bool, ReplayError> {
        match record {
            LogRecord::Start(start) if start.schema != SCHEMA_KEY => {
                return Err(ReplayError::Schema { recorded: start.schema });
            }
            LogRecord::Start(_) => {}
            LogRecord::Gap { .. } => self.in_step = false,
            LogRecord::State { offset, data } => {
                if *offset == 0 {
                    self.state.clear();
                }
                if usize::try_from(*offset) != Ok(self.state.len())
                    || self.state.extend_from_slice(data).is_err()
                {
                    return Err(ReplayError::State);
                }
            }
            LogRecord::Restore { length, checksum } => {
                let whole = usize::try_from(*length) == Ok(self.state.len())
                    && codec::checksum(&self.state) == *checksum;
                if !whole || !self.node.restore(&self.state) {
                    return Err(ReplayError::State);
                }
                self.in_step = true;
            }
            LogRecord::Request(request) => {
                self.node.handle(request, &self.board);
            }
            LogRecord::Sensors(sensors) => self.computed = Some(self.node.tick(sensors)),
            LogRecord::Actuators(recorded) if self.in_step => {
                let computed = self.computed.take().ok_or(ReplayError::Order)?;
                return compare(recorded, computed).map(|()| true);
            }
            LogRecord::Actuators(_) => {}
        }
        Ok(false)
    }
}

fn compare(recorded: &ActuatorFrame, computed: ActuatorFrame) -> Result<(), ReplayError> {
    let mut pairs = recorded.torques.iter().zip(&computed.torques);
    let joint = pairs.position(|(recorded, computed)| recorded.to_bits() != computed.to_bits());
    let same = recorded.sequence == computed.sequence
        && recorded.enabled == computed.enabled
        && recorded.torques.len() == computed.torques.len();
    if joint.is_none() && same {
        return Ok(());
    }
    Err(ReplayError::Different { recorded: recorded.clone(), computed, joint })
}
