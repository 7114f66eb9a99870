use core::fmt;

use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::codec::FrameCounts;
use crate::model::MAX_NAME;
use crate::task::TaskKind;

/// Mode of the node.
// An explicit tag makes `Disabled` all zero, which places a new node in `.bss`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Mode {
    /// 0: outputs off.
    Disabled,
    /// 1: a task runs.
    Enabled(TaskKind),
    /// 2: a fault occurred; the outputs follow [`crate::model::Reaction`] until it is cleared.
    Fault,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Disabled => write!(f, "disabled"),
            Self::Enabled(task) => write!(f, "enabled ({task})"),
            Self::Fault => write!(f, "in fault"),
        }
    }
}

/// The state of node and board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Status {
    /// The node's part.
    pub node: NodeStatus,
    /// The board's part.
    pub board: BoardStatus,
}

/// The node's part of [`Status`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct NodeStatus {
    /// Mode.
    pub mode: Mode,
    /// Name of the model in use; empty without one.
    pub model: String<MAX_NAME>,
    /// Its [`super::codec::checksum`]; 0 without one.
    pub model_checksum: u32,
    /// Bit `i` is set when joint `i` is homed or needs no homing.
    pub homed: u16,
    /// Faults since power-on.
    pub faults: u32,
    /// Whether all faults were read.
    pub faults_read: bool,
    /// The commander.
    pub commander: Option<u32>,
    /// The last tick.
    pub tick: u32,
    /// Supply voltage [V].
    pub supply: f32,
}

/// The board's part of [`Status`]. The simulator and the replay tool report [`BoardStatus::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BoardStatus {
    /// Identity.
    pub identity: Identity,
    /// Clock source.
    pub clock: ClockSource,
    /// Cause of the last reset.
    pub reset: ResetCause,
    /// Message of the panic or CPU fault before the last reset; empty if there was none.
    pub last_words: String<96>,
    /// Maximum stack usage since the last reset [bytes].
    pub stack_used: u32,
    /// Size of the stack [bytes].
    pub stack_size: u32,
    /// The link to the supervisor.
    pub supervisor_link: LinkStatistics,
    /// The plant link.
    pub plant: LinkStatistics,
}

impl Default for BoardStatus {
    fn default() -> Self {
        Self {
            identity: Identity {
                firmware: crate::VERSION,
                capabilities: Identity::PLANT_LINK | Identity::TASKS,
                ..Identity::default()
            },
            clock: ClockSource::Crystal,
            reset: ResetCause::PowerOn,
            last_words: String::new(),
            stack_used: 0,
            stack_size: 0,
            supervisor_link: LinkStatistics::default(),
            plant: LinkStatistics::default(),
        }
    }
}

/// Statistics of a link since the last reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LinkStatistics {
    /// Received frames by kind.
    pub frames: FrameCounts,
    /// Received bytes lost because the queue was full.
    pub receive_overflow: u32,
    /// Received bytes lost in the UART: noise, framing, overrun.
    pub receive_errors: u32,
    /// Frames not sent because the queue was full.
    pub send_overflow: u32,
}

/// Clock source of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ClockSource {
    /// 0: crystal and PLL, 168 MHz.
    Crystal,
    /// 1: internal oscillator and PLL, 168 MHz, accuracy 1 %.
    InternalPll,
    /// 2: internal oscillator alone, 16 MHz.
    Internal,
}

/// Cause of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// 0: power, or the reset button.
    PowerOn,
    /// 1: the watchdog.
    Watchdog,
    /// 2: a panic.
    Panic,
    /// 3: a CPU fault.
    HardFault,
    /// 4: software or the debugger.
    Software,
    /// 5: the crystal stopped.
    CrystalStopped,
    /// 6: the supply of the microcontroller was too low.
    BrownOut,
}

/// Identity of a board. Its layout never changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Identity {
    /// Version of the firmware: major, minor, patch.
    pub firmware: [u8; 3],
    /// The first bytes of the image's build id, a hash of the whole image; 0 outside an image.
    pub image: [u8; 8],
    /// The microcontroller's unique number; 0 when it has none.
    pub board: [u8; 12],
    /// Bit 0: sensors and drives are on the plant link. Bit 1: the board has its own power stages. From bit 2
    /// on: the supported tasks, by the numbers of [`TaskKind`]. All other bits are 0.
    pub capabilities: u32,
}

impl Identity {
    /// See [`Identity::capabilities`].
    pub const PLANT_LINK: u32 = 1;
    /// See [`Identity::capabilities`].
    pub const POWER_STAGES: u32 = 2;
    /// The tasks of every node.
    pub const TASKS: u32 = {
        let (mut bits, mut index) = (0, 0);
        while index < TaskKind::ALL.len() {
            bits |= Self::task(TaskKind::ALL[index]);
            index += 1;
        }
        bits
    };

    /// The bit of a task in [`Identity::capabilities`].
    pub const fn task(task: TaskKind) -> u32 {
        4 << task as u32
    }
}
