//! Causes of faults, and their log.

use core::fmt;

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::model::RobotModel;

/// Capacity of a [`FaultLog`].
pub const MAX_FAULTS: usize = 16;

/// Cause of a fault. The number is that on the wire and in the documentation; it is never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FaultCause {
    /// 0: no command within the timeout while enabled. Value and limit in s.
    CommandTimeout,
    /// 1: a joint is outside its limits. Value and limit in rad.
    PositionLimit,
    /// 2: a joint is too fast. Value and limit in rad/s.
    VelocityLimit,
    /// 3: a joint is too far from its reference. Value and limit in rad.
    FollowingError,
    /// 4: an angle changed faster in one tick than the joint can move. Value and limit in rad.
    EncoderJump,
    /// 5: torque beyond friction without a change of the count: a dead encoder or a blocked joint. Value: the
    /// torque beyond the weight, or the growth of an acceleration torque; limit: the torque or growth that
    /// must move the joint [N·m], 0 when the board found the fault by the motor's voltage. Both are 0 where
    /// the count has not changed since the fault.
    EncoderStuck,
    /// 6: a computed torque is not finite. Value: its magnitude, NaN or infinite.
    NotFinite,
    /// 7: a tick came late, early or twice. Value: periods since the last tick; limit: 1.
    LateTick,
    /// 8: a sensor frame with the wrong number of joints or force sensors. Value and limit: their numbers.
    SensorCount,
    /// 9: the emergency stop is pressed.
    EmergencyStop,
    /// 10: supply voltage too low. Value and limit in V.
    SupplyLow,
    /// 11: supply voltage too high. Value and limit in V.
    SupplyHigh,
    /// 12: a motor current exceeds its limit. Value and limit in A.
    OverCurrent,
    /// 13: the watchdog reset the board: no healthy tick for too long.
    WatchdogReset,
    /// 14: the firmware panicked and reset. Value: line number; the message is in
    /// [`BoardStatus`](crate::protocol::BoardStatus).
    Panic,
    /// 15: a CPU fault reset the board. Value: the program counter, rounded to single precision; the exact
    /// one is in [`BoardStatus`](crate::protocol::BoardStatus).
    HardFault,
    /// 16: the clock fell back to a less accurate source at boot. Value: number of the
    /// [`ClockSource`](crate::protocol::ClockSource). The board can still be enabled, unless it drives motors
    /// and runs on the internal oscillator alone: its current loops are too slow then (28).
    ClockFallback,
    /// 17: the supervisor asked for an immediate stop.
    Stop,
    /// 18: a force sensor is saturated; the joint is the last of its chain. Value and limit in counts; in
    /// those of the converter if the board found a gauge at the end of its range.
    ForceSaturated,
    /// 19: the counts of a force sensor do not change: it is dead. Value and limit in ticks; limit 0 when the
    /// board found a gauge that stands still.
    ForceStuck,
    /// 20: the force on a tip exceeds its limit. Value and limit in N.
    ForceLimit,
    /// 21: a finger lost contact with the object in the hand; the joint is the last of the finger. Value: its
    /// normal force; limit: the minimum normal force of a contact [N].
    ObjectLost,
    /// 22: the object slid between the fingers, or an external force moved it. Value: displacement, infinite
    /// when the fingertips are collinear; limit: maximum displacement [m].
    ObjectMoved,
    /// 23: the tool of an arm is too far from its set-point. Value and limit in m.
    ToolPositionError,
    /// 24: the tool of an arm is rotated too far from its set-point. Value and limit in rad.
    ToolOrientationError,
    /// 25: a joint runs away: it gains speed against the torque that should bring it back, because its drive
    /// is reversed, its encoder is another joint's, or a stronger force moves it. Value: the torque; limit:
    /// the torque that moves the joint [N·m].
    Runaway,
    /// 26: a force acts on an arm that its force sensor does not measure: the sensor reads too little, or a
    /// link is pushed. Value: the acceleration of the tool that the control compensated; limit [m/s²].
    ForceMismatch,
    /// 27: the drives brought energy into a robot that was to come to rest, because an encoder or a drive is
    /// wrong, the control oscillates, or an object that the robot pressed on is gone. The joint is the one
    /// that did most work in the last tick. Value and limit in J.
    EnergyGained,
    /// 28: the board could not read its sensors in a control period. Value: 1.
    SensorsSilent,
    /// 29: the crystal stopped while the board ran; it switched its outputs off and reset.
    CrystalStopped,
    /// 30: at boot, the crystal ran at another frequency than the board's and was not used. Value: the
    /// measured frequency, 0 if none could be measured; limit: the board's [Hz].
    WrongCrystal,
    /// 31: a power stage reported a fault, or the board switched one off by itself. Value: 1.
    PowerStage,
    /// 32: the converter of a force sensor's gauges gives no values that can be trusted; the joint is the
    /// last of its chain. Value: 1: none came in time, 2: they are damaged, 3: it has restarted.
    ForceSilent,
    /// 33: the supply of the microcontroller was too low. Value: 1: it fell while the board ran, which
    /// switched its outputs off and reset; 2: the chip's brown-out reset came; 3: it was too low at boot, and
    /// the clock stays slow.
    ChipSupplyLow,
    /// 34: the brown-out reset of the microcontroller is off, or below the voltage that its clock needs;
    /// found at boot, on boards with power stages. Value: its level, 0 when it is off; limit: the level that
    /// is needed, 3. The board can still be enabled.
    BrownOutResetOff,
}

impl FaultCause {
    /// The number on the wire and in the documentation.
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// Whether sensors and drives can still bring the robot to rest after this fault. If not, the outputs are
    /// switched off, whatever the configured reaction.
    pub const fn leaves_control(self) -> bool {
        !matches!(
            self,
            Self::EncoderJump
                | Self::EncoderStuck
                | Self::Runaway
                | Self::NotFinite
                | Self::SensorCount
                | Self::EmergencyStop
                | Self::SupplyHigh
                | Self::OverCurrent
                | Self::SensorsSilent
                | Self::PowerStage
        )
    }

    /// Whether the reading of a force sensor is invalid after this fault.
    pub const fn loses_force(self) -> bool {
        matches!(self, Self::ForceSaturated | Self::ForceStuck | Self::ForceSilent)
    }

    /// Whether the joints deviate from their references, or moved on without control, so that they must stop
    /// from their measured state instead of along the reference.
    pub const fn invalidates_reference(self) -> bool {
        matches!(
            self,
            Self::PositionLimit
                | Self::VelocityLimit
                | Self::FollowingError
                | Self::LateTick
                | Self::ObjectLost
        )
    }

    /// The unit of [`Fault::value`] and [`Fault::limit`]; empty for a plain number.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::CommandTimeout => "s",
            Self::PositionLimit | Self::FollowingError | Self::EncoderJump | Self::ToolOrientationError => {
                "rad"
            }
            Self::VelocityLimit => "rad/s",
            Self::EncoderStuck | Self::Runaway | Self::NotFinite => "N·m",
            Self::ForceMismatch => "m/s²",
            Self::EnergyGained => "J",
            Self::SupplyLow | Self::SupplyHigh => "V",
            Self::OverCurrent => "A",
            Self::ForceLimit | Self::ObjectLost => "N",
            Self::ObjectMoved | Self::ToolPositionError => "m",
            Self::ForceSaturated => "counts",
            Self::ForceStuck => "ticks",
            Self::WrongCrystal => "Hz",
            _ => "",
        }
    }

    /// The cause in words.
    pub const fn description(self) -> &'static str {
        match self {
            Self::CommandTimeout => "no command from the supervisor for too long",
            Self::PositionLimit => "outside its position limit",
            Self::VelocityLimit => "faster than its velocity limit",
            Self::FollowingError => "too far from its reference",
            Self::EncoderJump => "the encoder jumped farther than the joint can move in one tick",
            Self::EncoderStuck => "torque beyond friction without motion: encoder dead or joint blocked",
            Self::NotFinite => "a computed torque was not a finite number",
            Self::LateTick => "the control tick came late, early or twice",
            Self::SensorCount => "a sensor frame has the wrong number of joints or force sensors",
            Self::EmergencyStop => "the emergency stop is pressed",
            Self::SupplyLow => "supply voltage too low",
            Self::SupplyHigh => "supply voltage too high",
            Self::OverCurrent => "motor current above its limit",
            Self::WatchdogReset => "the watchdog reset the board",
            Self::Panic => "the firmware panicked and was reset",
            Self::HardFault => "a CPU fault reset the board",
            Self::ClockFallback => "the clock fell back to a less accurate source",
            Self::Stop => "stopped by the supervisor",
            Self::ForceSaturated => "the force sensor of its tip is saturated",
            Self::ForceStuck => "the force sensor of its tip does not change: dead or unplugged",
            Self::ForceLimit => "the force on its tip exceeds the limit",
            Self::ObjectLost => "its finger no longer touches the object in the hand",
            Self::ObjectMoved => "the object in the hand was moved, or slid between the fingers",
            Self::ToolPositionError => "the tool is too far from its set-point",
            Self::ToolOrientationError => "the tool is rotated too far from its set-point",
            Self::ForceMismatch => {
                "pushed by what its force sensor does not see: sensor wrong, a link touched, or a joint at its stop"
            }
            Self::EnergyGained => {
                "drove the robot that was to stop: encoder or drive wrong, or its load is gone"
            }
            Self::Runaway => "gains speed against its torque: drive reversed, wrong encoder, or pushed",
            Self::SensorsSilent => "the board could not read its sensors",
            Self::CrystalStopped => "the crystal stopped and the board was reset",
            Self::WrongCrystal => "the crystal is not the board's and is not used",
            Self::PowerStage => "a power stage switched itself off",
            Self::ForceSilent => {
                "the force sensor of its tip gives no valid values: unplugged, disturbed or restarted"
            }
            Self::ChipSupplyLow => "the supply of the board's microcontroller was too low",
            Self::BrownOutResetOff => "the brown-out reset of the board's microcontroller is not set up",
        }
    }
}

/// Result of a check: the cause of a fault, with the value and the limit that it exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Finding {
    pub cause: FaultCause,
    pub value: f32,
    pub limit: f32,
}

impl Finding {
    /// The fault of a joint, or of the whole robot, in a tick.
    pub const fn at(self, joint: Option<u8>, tick: u32) -> Fault {
        let Self { cause, value, limit } = self;
        Fault { cause, joint, value, limit, tick }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { cause, value, limit } = self;
        // A stop, for example, has neither.
        if *value == 0.0 && *limit == 0.0 {
            return f.write_str(cause.description());
        }
        let unit = cause.unit();
        let space = if unit.is_empty() { "" } else { " " };
        write!(f, "{} (value {value}{space}{unit}, limit {limit}{space}{unit})", cause.description())
    }
}

/// A fault: cause, joint, value, limit, tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// Cause.
    pub cause: FaultCause,
    /// Index of the joint, if it concerns one.
    pub joint: Option<u8>,
    /// The value that exceeds the limit, see [`FaultCause`].
    pub value: f32,
    /// The limit.
    pub limit: f32,
    /// The tick that detected it.
    pub tick: u32,
}

impl Fault {
    /// The fault in words, with the joint's name from the model.
    pub fn named<'a>(&'a self, model: &'a RobotModel) -> impl fmt::Display + 'a {
        Description { fault: self, joint: self.joint.map(|joint| model.joint_name(usize::from(joint))) }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Description { fault: self, joint: None }.fmt(f)
    }
}

/// A fault in words.
struct Description<'a> {
    fault: &'a Fault,
    /// The joint's name, if known.
    joint: Option<&'a str>,
}

impl fmt::Display for Description<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Fault { cause, joint, value, limit, tick } = self.fault;
        write!(f, "fault {} in tick {tick}: ", cause.number())?;
        match (self.joint, joint) {
            (Some(name), _) => write!(f, "{name}: ")?,
            (None, Some(number)) => write!(f, "joint {number}: ")?,
            (None, None) => {}
        }
        Finding { cause: *cause, value: *value, limit: *limit }.fmt(f)
    }
}

/// The last [`MAX_FAULTS`] faults. It survives a reset in retained memory of the board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultLog {
    /// Number of faults since power-on.
    pub total: u32,
    /// The last faults, oldest first.
    pub faults: Vec<Fault, MAX_FAULTS>,
}

impl FaultLog {
    /// Identifies the layout of a log with the checksum of its joints: retained memory may hold the log of
    /// another firmware.
    pub const KEY: u64 =
        u64::from_le_bytes(postcard_schema::key::Key::for_path::<(Self, u32)>("tesaki/faults").to_bytes());

    /// No faults.
    pub const fn new() -> Self {
        Self { total: 0, faults: Vec::new() }
    }

    /// Adds a fault. A full log drops the oldest one.
    pub fn record(&mut self, fault: Fault) {
        self.total = self.total.saturating_add(1);
        if self.faults.is_full() {
            self.faults.remove(0);
        }
        // Cannot fail: the oldest entry was removed.
        let _ = self.faults.push(fault);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_displays_cause_joint_value_limit_and_tick() {
        let jump =
            Fault { cause: FaultCause::EncoderJump, joint: Some(4), value: 0.5, limit: 0.25, tick: 12 };
        assert_eq!(
            jump.to_string(),
            "fault 4 in tick 12: joint 4: the encoder jumped farther than the joint can move in one tick \
             (value 0.5 rad, limit 0.25 rad)"
        );
        let late = Fault { cause: FaultCause::LateTick, joint: None, value: 3.0, limit: 1.0, tick: 7 };
        assert_eq!(
            late.to_string(),
            "fault 7 in tick 7: the control tick came late, early or twice (value 3, limit 1)"
        );
        let stop = Fault { cause: FaultCause::Stop, joint: None, value: 0.0, limit: 0.0, tick: 8 };
        assert_eq!(stop.to_string(), "fault 17 in tick 8: stopped by the supervisor");
    }

    #[test]
    fn a_full_log_drops_the_oldest_fault_and_keeps_counting() {
        let mut log = FaultLog::new();
        for tick in 0..20 {
            log.record(Fault { cause: FaultCause::Stop, joint: None, value: 0.0, limit: 0.0, tick });
        }
        assert_eq!((log.total, log.faults.len(), log.faults[0].tick, log.faults[15].tick), (20, 16, 4, 19));
    }
}
