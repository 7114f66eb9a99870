use core::fmt;

use heapless::Vec;

use super::export::MAX_STATE;
use super::{Node, STATE_KEY};
use crate::protocol::{ActuatorFrame, BoardStatus, LogRecord, SCHEMA_KEY, codec};

/// Replays a recorded run: feeds a node with the recorded inputs and compares its outputs bit for bit.
#[derive(Debug)]
pub struct Replay<'a> {
    node: &'a mut Node,
    board: BoardStatus,
    /// Chunks of a state.
    state: Vec<u8, MAX_STATE>,
    /// Output for the last sensor frame.
    computed: Option<ActuatorFrame>,
    /// Whether the node's state matches the recording.
    synchronized: bool,
}

/// Why a replay fails.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReplayError {
    /// The outputs differ.
    Different {
        /// Tick of the difference.
        tick: u32,
        /// The difference.
        difference: Difference,
    },
    /// The recording has another schema key.
    Schema {
        /// Key of the recording.
        recorded: u64,
    },
    /// The recording begins with a state of another key.
    StateKey {
        /// Key of the recording.
        recorded: u64,
    },
    /// The state is incomplete or damaged.
    State,
    /// An actuator frame without its sensor frame.
    Order,
}

/// Difference of a recorded and a computed output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Difference {
    /// The tick of the output.
    Sequence {
        /// As computed now.
        computed: u32,
    },
    /// Whether the power stages are on.
    Enabled {
        /// As computed now.
        computed: bool,
    },
    /// The number of torques.
    Joints {
        /// As recorded.
        recorded: usize,
        /// As computed now.
        computed: usize,
    },
    /// A torque; one bit is enough.
    Torque {
        /// The joint.
        joint: usize,
        /// As recorded [N·m].
        recorded: f32,
        /// As computed now [N·m].
        computed: f32,
    },
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sequence { computed } => write!(f, "the output is that of tick {computed}"),
            Self::Enabled { computed: true } => write!(f, "the outputs are on; recorded: off"),
            Self::Enabled { computed: false } => write!(f, "the outputs are off; recorded: on"),
            Self::Joints { recorded, computed } => {
                write!(f, "there are {computed} torques; recorded: {recorded}")
            }
            Self::Torque { joint, recorded, computed } => write!(
                f,
                "torque of joint {joint} was {recorded} ({:#010x}), is {computed} ({:#010x}) N·m",
                recorded.to_bits(),
                computed.to_bits()
            ),
        }
    }
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Different { tick, difference } => write!(f, "tick {tick}: {difference}"),
            Self::Schema { recorded } => write!(
                f,
                "the recording has schema {recorded:016x}, this program {SCHEMA_KEY:016x}: use the program of the \
                 version that recorded it"
            ),
            Self::StateKey { recorded } => write!(
                f,
                "the recording begins with a state of key {recorded:016x}, this program has {STATE_KEY:016x}: use the \
                 program of the version that ran on the board"
            ),
            Self::State => write!(f, "the state in the recording is incomplete or damaged"),
            Self::Order => write!(f, "the recording has an actuator frame without its sensor frame"),
        }
    }
}

impl core::error::Error for ReplayError {}

impl<'a> Replay<'a> {
    /// A replay on `node`.
    pub fn new(node: &'a mut Node) -> Self {
        Self { node, board: BoardStatus::default(), state: Vec::new(), computed: None, synchronized: true }
    }

    /// Replays one entry. Returns whether it was an output that was compared and equal.
    ///
    /// # Errors
    /// Why the replay fails, or how the outputs differ.
    pub fn feed(&mut self, record: &LogRecord) -> Result<bool, ReplayError> {
        match record {
            LogRecord::Start(start) if start.schema != SCHEMA_KEY => {
                return Err(ReplayError::Schema { recorded: start.schema });
            }
            LogRecord::Start(_) => {
                self.node.reset();
                (self.computed, self.synchronized) = (None, true);
                self.state.clear();
            }
            LogRecord::Gap { .. } => (self.computed, self.synchronized) = (None, false),
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
            LogRecord::Restore { key, .. } if *key != STATE_KEY => {
                return Err(ReplayError::StateKey { recorded: *key });
            }
            LogRecord::Restore { length, checksum, .. } => {
                let whole = usize::try_from(*length) == Ok(self.state.len())
                    && codec::checksum(&self.state) == *checksum;
                if !whole || !self.node.restore(&self.state) {
                    return Err(ReplayError::State);
                }
                (self.computed, self.synchronized) = (None, true);
            }
            LogRecord::Request(request) => {
                self.node.handle(request, &self.board);
            }
            LogRecord::Sensors(sensors) => self.computed = Some(self.node.tick(sensors)),
            LogRecord::Actuators(recorded) if self.synchronized => {
                let computed = self.computed.take().ok_or(ReplayError::Order)?;
                return match compare(recorded, &computed) {
                    None => Ok(true),
                    Some(difference) => Err(ReplayError::Different { tick: recorded.sequence, difference }),
                };
            }
            LogRecord::Actuators(_) | LogRecord::End { .. } => {}
        }
        Ok(false)
    }
}

fn compare(recorded: &ActuatorFrame, computed: &ActuatorFrame) -> Option<Difference> {
    if recorded.sequence != computed.sequence {
        return Some(Difference::Sequence { computed: computed.sequence });
    }
    if recorded.enabled != computed.enabled {
        return Some(Difference::Enabled { computed: computed.enabled });
    }
    if recorded.torques.len() != computed.torques.len() {
        return Some(Difference::Joints {
            recorded: recorded.torques.len(),
            computed: computed.torques.len(),
        });
    }
    let pairs = recorded.torques.iter().zip(&computed.torques);
    let (joint, (&recorded, &computed)) = pairs.enumerate().find(|(_, (a, b))| a.to_bits() != b.to_bits())?;
    Some(Difference::Torque { joint, recorded, computed })
}
