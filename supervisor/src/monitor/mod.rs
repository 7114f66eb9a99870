//! The live terminal view of `tesaki monitor`.
//!
//! [`draw`] is a pure function of a [`View`]: the caller fills in the view from the board, and nothing here
//! depends on the protocol. [`Screen`] owns the terminal and restores it when dropped.

mod draw;
mod joints;
mod screen;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use ratatui::crossterm::event::{Event, KeyCode, KeyEventKind, KeyModifiers};

pub use draw::{draw, draw_faults, draw_help};
pub use screen::{Overlay, Screen};

/// Number of positions that [`JointView::remember`] keeps.
pub const HISTORY: usize = 240;

/// Everything the monitor shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct View {
    /// Robot, port and firmware: "hand3 on /dev/ttyUSB0, firmware 0.1.0".
    pub title: String,
    /// The mode of the board: "enabled (joint servo)".
    pub mode: String,
    /// The state for the badge and its colour.
    pub state: State,
    /// Seconds since the board started.
    pub time: f64,
    /// The joints, in the model's order.
    pub joints: Vec<JointView>,
    /// The known faults, newest last.
    pub faults: Vec<String>,
    /// The link to the board.
    pub link: LinkView,
    /// Supply voltage in V, if the board measures it.
    pub supply: Option<f32>,
    /// Advice: "faults unread: press f".
    pub hint: String,
}

/// The board's state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum State {
    /// Connected, actuators off.
    Disabled,
    /// Actuators on.
    Enabled,
    /// Stopped by a fault.
    Fault,
    /// No data from the board; the view is outdated.
    #[default]
    Lost,
}

/// One joint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointView {
    /// Its name in the model.
    pub name: String,
    /// Measured position in rad.
    pub position: f32,
    /// Measured velocity in rad/s.
    pub velocity: f32,
    /// Reference position in rad.
    pub reference: f32,
    /// Lower limit of the position in rad.
    pub lower: f32,
    /// Upper limit of the position in rad.
    pub upper: f32,
    /// Torque in N·m.
    pub torque: f32,
    /// Torque limit in N·m, in both directions.
    pub torque_limit: f32,
    /// Whether the encoder is homed, so that the position is valid.
    pub homed: bool,
    /// Past positions in rad, newest last.
    pub history: VecDeque<f32>,
}

impl JointView {
    /// Sets the position and appends it to the history, which keeps the last [`HISTORY`].
    pub fn remember(&mut self, position: f32) {
        self.position = position;
        while self.history.len() >= HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(position);
    }
}

/// The link to the board.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinkView {
    /// Whether the port is open.
    pub open: bool,
    /// Received telemetry frames per second, after the first second.
    pub rate: Option<f32>,
    /// Telemetry frames per second that the board sends.
    pub expected_rate: f32,
    /// Lost frames.
    pub lost: u64,
    /// Damaged frames.
    pub damaged: u64,
    /// Time from a request to its reply in ms, if one has been measured.
    pub round_trip_ms: Option<f32>,
    /// Seconds since the last telemetry.
    pub last_seconds: f32,
}

/// The command of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Leave the monitor: q, Esc, Ctrl-C.
    Quit,
    /// Stop the motion: space.
    Stop,
    /// Switch the actuators off: d.
    Disable,
    /// Read the fault log and show it: f.
    ReadFaults,
    /// Show or hide the help: ?, h.
    Help,
    /// Select the joint above: up, k.
    Up,
    /// Select the joint below: down, j.
    Down,
}

impl Key {
    /// Returns the meaning of a terminal event, if it has one.
    #[must_use]
    pub fn from_event(event: &Event) -> Option<Self> {
        let Event::Key(key) = event else { return None };
        if key.kind == KeyEventKind::Release {
            return None;
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return (key.code == KeyCode::Char('c')).then_some(Self::Quit);
        }
        if key.modifiers.contains(KeyModifiers::ALT) {
            return None;
        }
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => Some(Self::Quit),
            KeyCode::Char(' ') => Some(Self::Stop),
            KeyCode::Char('d') => Some(Self::Disable),
            KeyCode::Char('f') => Some(Self::ReadFaults),
            KeyCode::Char('?' | 'h') => Some(Self::Help),
            KeyCode::Up | KeyCode::Char('k') => Some(Self::Up),
            KeyCode::Down | KeyCode::Char('j') => Some(Self::Down),
            _ => None,
        }
    }

    /// Returns the selection after this key among `joints` joints: without a selection, down selects the
    /// first joint and up the last.
    #[must_use]
    pub fn select(self, selected: Option<usize>, joints: usize) -> Option<usize> {
        let last = joints.checked_sub(1)?;
        match (self, selected) {
            (Self::Up, None) => Some(last),
            (Self::Up, Some(index)) => Some(index.saturating_sub(1).min(last)),
            (Self::Down, None) => Some(0),
            (Self::Down, Some(index)) => Some(index.saturating_add(1).min(last)),
            _ => selected,
        }
    }
}
