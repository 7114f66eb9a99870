//! Causes of faults, and their log.

use core::fmt;

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::model::RobotModel;

/// How many faults a [`FaultLog`] remembers.
pub const MAX_FAULTS: usize = 16;

/// Why the node left what it was doing. The number is what travels and what documentation cites; it is never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FaultCause {
    /// 0: enabled, and no command for too long. Value and limit in s.
    CommandTimeout,
    /// 1: a joint is outside its limits. Value and limit in rad.
    PositionLimit,
    /// 2: a joint is too fast. Value and limit in rad/s.
    VelocityLimit,
    /// 3: a joint is too far from its reference. Value and limit in rad.
    FollowingError,
    /// 4: an angle changed faster in one tick than the joint can move. Value and limit in rad.
    EncoderJump,
    /// 5: torque beyond the friction, and the count stands still: a dead encoder or a blocked joint. Value: the
    /// torque; limit: the torque that should have moved it [N·m].
    EncoderStuck,
    /// 6: a computed torque was not finite. Value: NaN.
    NotFinite,
    /// 7: a tick came late or twice. Value: sensor frames since the last tick; limit 1.
    LateTick,
    /// 8: a sensor frame with the wrong number of joints. Value and limit: numbers of joints.
    SensorCount,
    /// 9: the emergency stop is pressed.
    EmergencyStop,
    /// 10: supply voltage too low. Value and limit in V.
    SupplyLow,
    /// 11: supply voltage too high. Value and limit in V.
    SupplyHigh,
    /// 12: a motor current is beyond its limit. Value and limit in A.
    OverCurrent,
    /// 13: the watchdog reset the board: no healthy tick for too long.
    WatchdogReset,
    /// 14: the firmware panicked and reset. Value: line number; the message is in [`super::BoardStatus`].
    Panic,
    /// 15: a CPU fault reset the board. Value: the program counter.
    HardFault,
    /// 16: the clock fell back to a less exact source at boot. Value: the [`super::ClockSource`]'s number. The
    /// board can still be enabled.
    ClockFallback,
    /// 17: the supervisor asked for an immediate stop.
    Stop,
    /// 18: a force sensor is at the end of its range; the joint is the last of its chain. Value and limit in counts.
    ForceSaturated,
    /// 19: no count of a force sensor has changed for so long: it is dead. Value and limit in ticks.
    ForceStuck,
    /// 20: the force on a tip is beyond its limit. Value and limit in N.
    ForceLimit,
    /// 21: a finger no longer touches the object that the hand holds; the joint is the last of the finger. Value: its
    /// normal force; limit: the least that counts as contact [N].
    ObjectLost,
    /// 22: the object slid between the fingers, or something moved it. Value: how far, infinite when the fingertips are in
    /// line; limit: the most that is followed [m].
    ObjectMoved,
    /// 23: the tool of an arm is too far from its set-point. Value and limit in m.
    ToolAway,
    /// 24: the tool of an arm is turned too far from its set-point. Value and limit in rad.
    ToolTurned,
}

impl FaultCause {
    /// The number on the wire and in the documentation.
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// Whether angles and velocities can still be relied on after this fault. If not, the outputs go off whatever
    /// reaction is configured.
    pub const fn leaves_sensors_trustworthy(self) -> bool {
        !matches!(
            self,
            Self::EncoderJump
                | Self::EncoderStuck
                | Self::NotFinite
                | Self::SensorCount
                | Self::EmergencyStop
                | Self::SupplyHigh
                | Self::OverCurrent
        )
    }

    /// Whether the joints are not where their reference says, so that they must stop where they are instead of
    /// coming to rest along the reference.
    pub const fn means_motion_is_wrong(self) -> bool {
        matches!(self, Self::PositionLimit | Self::VelocityLimit | Self::FollowingError)
    }

    /// The unit of [`Fault::value`] and [`Fault::limit`]; empty for a plain number.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::CommandTimeout => "s",
            Self::PositionLimit | Self::FollowingError | Self::EncoderJump | Self::ToolTurned => "rad",
            Self::VelocityLimit => "rad/s",
            Self::EncoderStuck | Self::NotFinite => "N·m",
            Self::SupplyLow | Self::SupplyHigh => "V",
            Self::OverCurrent => "A",
            Self::ForceLimit | Self::ObjectLost => "N",
            Self::ObjectMoved | Self::ToolAway => "m",
            Self::ForceSaturated => "counts",
            Self::ForceStuck => "ticks",
            _ => "",
        }
    }

    /// What happened, in words, for people.
    pub const fn description(self) -> &'static str {
        match self {
            Self::CommandTimeout => "no command from the supervisor for too long",
            Self::PositionLimit => "outside its position limit",
            Self::VelocityLimit => "faster than its velocity limit",
            Self::FollowingError => "too far from its reference",
            Self::EncoderJump => "the encoder jumped further than the joint can move in one tick",
            Self::EncoderStuck => "torque beyond friction and no motion: encoder dead or joint blocked",
            Self::NotFinite => "a computed torque was not a finite number",
            Self::LateTick => "the control tick came late, early or twice",
            Self::SensorCount => "a sensor frame has the wrong number of joints",
            Self::EmergencyStop => "the emergency stop is pressed",
            Self::SupplyLow => "supply voltage too low",
            Self::SupplyHigh => "supply voltage too high",
            Self::OverCurrent => "motor current beyond its limit",
            Self::WatchdogReset => "the watchdog reset the board",
            Self::Panic => "the firmware panicked and was reset",
            Self::HardFault => "a CPU fault reset the board",
            Self::ClockFallback => "the clock fell back to a less exact source",
            Self::Stop => "stopped by the supervisor",
            Self::ForceSaturated => "the force sensor of its tip is at the end of its range",
            Self::ForceStuck => "the force sensor of its tip reads the same all the time: dead or unplugged",
            Self::ForceLimit => "more force on its tip than allowed",
            Self::ObjectLost => "its finger no longer touches the object in the hand",
            Self::ObjectMoved => "the object in the hand was moved, or slid between the fingers",
            Self::ToolAway => "the tool is too far from its set-point",
            Self::ToolTurned => "the tool is turned too far from its set-point",
        }
    }
}

/// One fault: what, where, how much, against which limit, when.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Fault {
    /// Why.
    pub cause: FaultCause,
    /// Index of the joint, if it concerns one.
    pub joint: Option<u8>,
    /// The offending value, see [`FaultCause`].
    pub value: f32,
    /// The limit that it broke.
    pub limit: f32,
    /// The tick in which it was found.
    pub tick: u32,
}

impl Fault {
    /// The fault in words, with the joint's name as the model has it.
    pub fn named<'a>(&'a self, model: &'a RobotModel) -> impl fmt::Display + 'a {
        Words { fault: self, joint: self.joint.map(|joint| model.joint_name(usize::from(joint))) }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Words { fault: self, joint: None }.fmt(f)
    }
}

/// A fault in words.
struct Words<'a> {
    fault: &'a Fault,
    /// The joint's name, where it is known.
    joint: Option<&'a str>,
}

impl fmt::Display for Words<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Fault { cause, joint, value, limit, tick } = self.fault;
        write!(f, "fault {} in tick {tick}: ", cause.number())?;
        match (self.joint, joint) {
            (Some(name), _) => write!(f, "{name}: ")?,
            (None, Some(number)) => write!(f, "joint {number}: ")?,
            (None, None) => {}
        }
        let space = if cause.unit().is_empty() { "" } else { " " };
        let unit = cause.unit();
        write!(f, "{} (value {value}{space}{unit}, limit {limit}{space}{unit})", cause.description())
    }
}

/// The last [`MAX_FAULTS`] faults, oldest first. Survives a reset: the board keeps it in memory that a reset leaves
/// alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultLog {
    /// Faults since power-on, those no longer remembered included.
    pub total: u32,
    /// The latest ones, oldest first.
    pub faults: Vec<Fault, MAX_FAULTS>,
}

impl FaultLog {
    /// No faults.
    pub const fn new() -> Self {
        Self { total: 0, faults: Vec::new() }
    }

    /// Adds a fault; the oldest is forgotten when there is no room.
    pub fn record(&mut self, fault: Fault) {
        self.total = self.total.saturating_add(1);
        if self.faults.is_full() {
            self.faults.remove(0);
        }
        // Cannot fail: a place was just freed.
        let _ = self.faults.push(fault);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_what_where_how_much_against_which_limit_and_when() {
        let jump =
            Fault { cause: FaultCause::EncoderJump, joint: Some(4), value: 0.5, limit: 0.25, tick: 12 };
        assert_eq!(
            jump.to_string(),
            "fault 4 in tick 12: joint 4: the encoder jumped further than the joint can move in one tick \
             (value 0.5 rad, limit 0.25 rad)"
        );
        let late = Fault { cause: FaultCause::LateTick, joint: None, value: 3.0, limit: 1.0, tick: 7 };
        assert_eq!(
            late.to_string(),
            "fault 7 in tick 7: the control tick came late, early or twice (value 3, limit 1)"
        );
    }

    #[test]
    fn a_full_log_forgets_the_oldest_and_counts_on() {
        let mut log = FaultLog::new();
        for tick in 0..20 {
            log.record(Fault { cause: FaultCause::Stop, joint: None, value: 0.0, limit: 0.0, tick });
        }
        assert_eq!((log.total, log.faults.len(), log.faults[0].tick, log.faults[15].tick), (20, 16, 4, 19));
    }
}
