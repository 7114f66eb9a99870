use core::fmt;

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::reply::EXPORT_CHUNK;
use super::request::RequestFrame;
use super::status::Identity;
use crate::model::{GAUGES, MAX_CHAINS, MAX_JOINTS};

/// Sensor values of all joints at one instant, as raw counts. The node converts them to SI units.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorFrame {
    /// Number of the control period; increments by one per tick.
    pub sequence: u32,
    /// Switch and fault flags.
    pub flags: SensorFlags,
    /// Supply voltage [mV].
    pub supply: u16,
    /// Encoder counts, one per joint.
    pub encoders: Vec<i32, MAX_JOINTS>,
    /// Motor currents in counts of [`crate::model::Motor::current_resolution`], one per joint.
    pub currents: Vec<i16, MAX_JOINTS>,
    /// Counts of the force sensors, one for each chain that has one: forces along x, y, z of the tip's frame
    /// in counts of [`crate::model::ForceSensor::force_resolution`], then torques.
    pub forces: Vec<[i32; 6], MAX_CHAINS>,
}

/// Bits of [`SensorFrame::flags`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorFlags(pub u8);

impl SensorFlags {
    /// Bit 0: the emergency stop is pressed.
    pub const EMERGENCY_STOP: u8 = 1;

    /// Bit 1: the sensors could not be read; all other values are invalid.
    pub const SILENT: u8 = 2;

    /// Bit 2: a power stage has switched itself off (internal fault or overcurrent), or the board has
    /// switched its motors off (also because of the supply, or of a current that does not fit its voltage).
    pub const POWER_STAGE: u8 = 4;

    /// Bit 3: the encoder of the joint in bits 4 to 7 stands still while its motor induces a voltage. If it
    /// is not set, bits 4 to 7 are a [`ForceSensorFault`], or 0.
    pub const DEAD_ENCODER: u8 = 8;

    /// The bits of a dead encoder of `joint`, which is below 16.
    pub const fn of_dead_encoder(joint: u8) -> u8 {
        joint << 4 | Self::DEAD_ENCODER
    }

    /// The joint whose encoder stands still while its motor induces a voltage.
    pub const fn dead_encoder(self) -> Option<u8> {
        if self.0 & Self::DEAD_ENCODER != 0 { Some(self.0 >> 4) } else { None }
    }

    /// These flags with the fault of the force sensor, unless they report a dead encoder.
    #[must_use]
    pub const fn with_force_sensor(self, fault: ForceSensorFault) -> Self {
        if self.dead_encoder().is_some() { self } else { Self(self.0 & 0x0F | fault.code() << 4) }
    }

    /// The fault of the gauges of the first force sensor, if any. Its counts are then outdated.
    pub const fn force_sensor(self) -> Option<ForceSensorFault> {
        if self.0 & Self::DEAD_ENCODER != 0 { None } else { ForceSensorFault::from_code(self.0 >> 4) }
    }

    /// Whether the emergency stop is pressed.
    pub const fn emergency_stop(self) -> bool {
        self.0 & Self::EMERGENCY_STOP != 0
    }

    /// Whether a power stage has switched itself off.
    pub const fn power_stage(self) -> bool {
        self.0 & Self::POWER_STAGE != 0
    }

    /// Whether the sensors could not be read.
    pub const fn silent(self) -> bool {
        self.0 & Self::SILENT != 0
    }
}

/// Fault of the gauges of a force sensor, or of their converter, found by the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceSensorFault {
    /// 1: too few values, or none, came in a control period.
    Silent,
    /// 2: the values are damaged.
    Damaged,
    /// 3: the converter has restarted, and has not been set up again.
    Restarted,
    /// 4 to 9: this gauge (0 to 5) stands still.
    Stuck(u8),
    /// 10 to 15: this gauge (0 to 5) is at the end of its range.
    Saturated(u8),
}

impl ForceSensorFault {
    /// The number on the wire: 1 to 15.
    pub const fn code(self) -> u8 {
        const LAST: u8 = 5;
        const _: () = assert!(GAUGES == LAST as usize + 1);
        match self {
            Self::Silent => 1,
            Self::Damaged => 2,
            Self::Restarted => 3,
            Self::Stuck(gauge) => 4 + gauge % (LAST + 1),
            Self::Saturated(gauge) => 10 + gauge % (LAST + 1),
        }
    }

    /// The fault with this number; `None` for any but 1 to 15.
    pub const fn from_code(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::Silent,
            2 => Self::Damaged,
            3 => Self::Restarted,
            4..=9 => Self::Stuck(code - 4),
            10..=15 => Self::Saturated(code - 10),
            _ => return None,
        })
    }
}

impl fmt::Display for ForceSensorFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => write!(f, "no values come from its converter in time"),
            Self::Damaged => write!(f, "the values of its converter are damaged on the way"),
            Self::Restarted => write!(f, "its converter has restarted"),
            Self::Stuck(gauge) => write!(f, "gauge {} stands still", gauge + 1),
            Self::Saturated(gauge) => write!(f, "gauge {} is at the end of its converter's range", gauge + 1),
        }
    }
}

impl SensorFrame {
    /// The frame of a control period in which the sensors could not be read.
    pub const fn silent(sequence: u32) -> Self {
        let flags = SensorFlags(SensorFlags::SILENT);
        Self { sequence, flags, supply: 0, encoders: Vec::new(), currents: Vec::new(), forces: Vec::new() }
    }
}

/// Commands to the drives of all joints for one period.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ActuatorFrame {
    /// [`SensorFrame::sequence`] of the sensor frame of this tick.
    pub sequence: u32,
    /// Whether the power stages are on. If not, the joints move freely.
    pub enabled: bool,
    /// Joint torques [N·m], within the limits of the model, always finite; all 0 when not enabled.
    pub torques: Vec<f32, MAX_JOINTS>,
}

/// One entry of a recording: inputs and outputs of the node, in order. [`crate::node::Replay`] replays it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum LogRecord {
    /// 0: a request that was handled before the next tick.
    Request(RequestFrame),
    /// 1: a tick's input.
    Sensors(SensorFrame),
    /// 2: the tick's output.
    Actuators(ActuatorFrame),
    /// 3: header of the recording; the first entry of a file.
    Start(LogStart),
    /// 4: a chunk of a [`crate::node::State`], for a recording that starts while the node runs.
    State {
        /// Offset of the chunk.
        offset: u32,
        /// The bytes.
        data: Vec<u8, EXPORT_CHUNK>,
    },
    /// 5: the chunks are complete: the node has this state from here on.
    Restore {
        /// Length of the state in bytes.
        length: u32,
        /// Its [`super::codec::checksum`].
        checksum: u32,
        /// Its [`STATE_KEY`](crate::node::STATE_KEY).
        key: u64,
    },
    /// 6: entries are missing here; a replay continues at the next [`LogRecord::Restore`].
    Gap {
        /// Number of missing entries.
        missing: u32,
    },
    /// 7: the last entry of a file; a file without it was cut, or its recorder was killed.
    End {
        /// Number of ticks in the file: of its [`LogRecord::Actuators`].
        ticks: u32,
    },
}

/// Header of a recording. Its layout never changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LogStart {
    /// [`super::SCHEMA_KEY`] of the recorder.
    pub schema: u64,
    /// The board.
    pub identity: Identity,
    /// Seconds since 1970; 0 when unknown.
    pub unix_time: u64,
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_fault_of_the_gauges_has_a_code_of_its_own() {
        let told = |code: u8| SensorFlags(code << 4 | 1).force_sensor();
        assert_eq!(told(0), None);
        for code in 1..16 {
            let fault = told(code).unwrap();
            assert_eq!(fault.code(), code);
            let flags = SensorFlags(SensorFlags::EMERGENCY_STOP).with_force_sensor(fault);
            assert_eq!((flags.0, flags.dead_encoder()), (code << 4 | 1, None));
        }
        assert_eq!(told(9), Some(ForceSensorFault::Stuck(5)));
        assert_eq!(told(15), Some(ForceSensorFault::Saturated(5)));
    }

    #[test]
    fn a_dead_encoder_is_told_before_the_gauges() {
        let flags = SensorFlags(SensorFlags::of_dead_encoder(6)).with_force_sensor(ForceSensorFault::Silent);
        assert_eq!((flags.dead_encoder(), flags.force_sensor()), (Some(6), None));
    }
}
