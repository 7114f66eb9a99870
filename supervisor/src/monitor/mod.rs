//! The live terminal view of `tesaki monitor`.
//!
//! [`draw`] is a pure function of a [`View`]: whoever talks to the board fills in the view, and nothing here
//! knows the protocol. [`Screen`] owns the terminal and brings it back to normal at its end.

mod draw;
mod joints;
mod screen;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use ratatui::crossterm::event::{Event, KeyCode, KeyEventKind, KeyModifiers};

pub use draw::{draw, draw_faults, draw_help};
pub use screen::{Overlay, Screen};

/// How many positions [`JointView::remember`] keeps.
pub const HISTORY: usize = 240;

/// Everything the monitor shows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct View {
    /// Which robot where: "hand3 on /dev/ttyUSB0, firmware 0.1.0".
    pub title: String,
    /// What the board is doing: "armed (joint servo, observer)".
    pub mode: String,
    /// The same in one word, for the badge and its colour.
    pub state: State,
    /// Seconds since the board started.
    pub time: f64,
    /// The joints, in the model's order.
    pub joints: Vec<JointView>,
    /// The faults known here, newest last.
    pub faults: Vec<String>,
    /// How the line to the board is doing.
    pub link: LinkView,
    /// Supply voltage in V, where the board measures it.
    pub supply: Option<f32>,
    /// What to do next: "faults unread: press f".
    pub hint: String,
}

/// The board's state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum State {
    /// Connected, actuators off.
    Disarmed,
    /// Actuators on.
    Armed,
    /// Stopped by a fault.
    Fault,
    /// Nothing is heard from the board; what is shown is old.
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
    /// Where it is told to be, in rad.
    pub reference: f32,
    /// Lower limit of the position in rad.
    pub lower: f32,
    /// Upper limit of the position in rad.
    pub upper: f32,
    /// Torque in N·m.
    pub torque: f32,
    /// The largest torque allowed, in N·m, either way.
    pub torque_limit: f32,
    /// Whether the position means anything yet.
    pub homed: bool,
    /// Past positions in rad, newest last.
    pub history: VecDeque<f32>,
}

impl JointView {
    /// Takes a new position and puts it in the history, which keeps the last [`HISTORY`].
    pub fn remember(&mut self, position: f32) {
        self.position = position;
        while self.history.len() >= HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(position);
    }
}

/// The line to the board.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LinkView {
    /// Whether the port is open.
    pub open: bool,
    /// Telemetry frames a second that come in.
    pub rate: f32,
    /// Telemetry frames a second that the board sends.
    pub expected_rate: f32,
    /// Frames that never came.
    pub lost: u64,
    /// Frames that came damaged.
    pub damaged: u64,
    /// From a request to its reply, in ms, where one has been measured.
    pub round_trip_ms: Option<f32>,
    /// Seconds since the last telemetry.
    pub last_seconds: f32,
}

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Leave the monitor: q, Esc, Ctrl-C.
    Quit,
    /// Stop the motion: space.
    Stop,
    /// Switch the actuators off: d.
    Disarm,
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
    /// The meaning of a terminal event, if it has one.
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
            KeyCode::Char('d') => Some(Self::Disarm),
            KeyCode::Char('f') => Some(Self::ReadFaults),
            KeyCode::Char('?' | 'h') => Some(Self::Help),
            KeyCode::Up | KeyCode::Char('k') => Some(Self::Up),
            KeyCode::Down | KeyCode::Char('j') => Some(Self::Down),
            _ => None,
        }
    }

    /// The selection after this key among `joints` joints: from none, down goes to the first and up to the
    /// last.
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
