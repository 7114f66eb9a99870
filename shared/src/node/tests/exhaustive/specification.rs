//! A second, independent specification of modes, command, numbers and faults in docs/protocol.md: a small
//! automaton of the state that a client can see. It shares no code with the node.

use super::machine::{Said, TIMEOUT, Word};

/// Number of clients that may command.
pub const COMMANDERS: usize = 2;
/// Largest number of messages of such a client.
pub const SLOTS: usize = 5;

/// The mode in the specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    Disabled,
    /// Ticks since the last accepted `Enable` or `Keep`.
    Enabled {
        silence: u8,
    },
    /// Whether the power stages hold the robot.
    Fault {
        held: bool,
    },
}

/// A message that has arrived at least once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Heard {
    pub word: Word,
    /// Whether the answer was `Done` at least once.
    pub done: bool,
}

/// The numbers of a client's messages: slot 0 is its hello, the others are sent in the order of the slots.
pub type Numbers = [u16; SLOTS + 1];

/// The rules' constants.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    pub numbers: Numbers,
    /// The model's reaction is `Hold`, else `Off`.
    pub holds: bool,
}

/// The state of the specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Specification {
    pub mode: Mode,
    pub commander: Option<u8>,
    /// The commander has sent nothing for more than a second.
    pub idle: bool,
    pub heard: [[Option<Heard>; SLOTS]; COMMANDERS],
    /// Twice the slot of the newest message of each client after which older commands are stale; one less:
    /// just before that slot.
    newest: [u8; COMMANDERS],
    /// Whether the board has the client's hello.
    welcome: [bool; COMMANDERS],
    /// Messages up to this slot were sent before the last reset.
    pub before_reset: [u8; COMMANDERS],
    pub resets: u8,
    /// The emergency stop is pressed; it was in the last sensor frame.
    pub pressed: bool,
    pub alarm: bool,
    pub total: u8,
    pub read: u8,
    /// The last fault is a `Stop`.
    stopped: bool,
}

impl Rules {
    /// The number of the message in a slot, given twice the slot.
    fn number(&self, half: u8) -> u16 {
        self.numbers[usize::from(half / 2 + half % 2)].wrapping_sub(u16::from(half % 2))
    }
}

impl Specification {
    /// Disabled, with the hello of both clients.
    pub const fn new() -> Self {
        Self {
            mode: Mode::Disabled,
            commander: None,
            idle: false,
            heard: [[None; SLOTS]; COMMANDERS],
            newest: [0; COMMANDERS],
            welcome: [true; COMMANDERS],
            before_reset: [0; COMMANDERS],
            resets: 0,
            pressed: false,
            alarm: false,
            total: 0,
            read: 0,
            stopped: false,
        }
    }

    /// Delivers the message in `slot` of `client`. Returns the permitted kinds of answer.
    pub fn deliver(&mut self, rules: &Rules, client: u8, slot: u8, word: Word) -> Said {
        let (index, at) = (usize::from(client), usize::from(slot) - 1);
        if self.commander == Some(client) {
            self.idle = false;
        }
        self.forget_old_numbers(rules, index, slot);
        let before = self.heard[index][at];
        let said = self.answer(rules, client, slot, word, before);
        let heard = self.heard[index][at].get_or_insert(Heard { word, done: false });
        heard.done |= said == Said::Done && heard.word == word;
        said
    }

    /// If the last command is a quarter of the number range behind, the number just before this message
    /// replaces it.
    fn forget_old_numbers(&mut self, rules: &Rules, index: usize, slot: u8) {
        let newest = &mut self.newest[index];
        if (1 << 14..1 << 15).contains(&rules.number(2 * slot).wrapping_sub(rules.number(*newest))) {
            *newest = (*newest).max(2 * slot - 1);
        }
    }

    fn answer(&mut self, rules: &Rules, client: u8, slot: u8, word: Word, before: Option<Heard>) -> Said {
        let index = usize::from(client);
        let (stale, last) = (2 * slot < self.newest[index], 2 * slot == self.newest[index]);
        let commands = self.commander == Some(client);
        let remember = |newest: &mut u8| *newest = (*newest).max(2 * slot);
        match word {
            Word::Hello => {
                self.welcome[index] = true;
                remember(&mut self.newest[index]);
                return Said::Data;
            }
            Word::Disable => {
                remember(&mut self.newest[index]);
                self.disable();
                return Said::Done;
            }
            Word::Stop => {
                remember(&mut self.newest[index]);
                self.stop(rules);
                return Said::Done;
            }
            _ if !self.welcome[index] && !commands => return Said::Mismatch,
            Word::ReadStatus => return Said::Data,
            Word::ReadFaults => {
                self.read = self.total;
                return Said::Data;
            }
            _ => {}
        }
        if word.is_take() {
            let same = rules.number(2 * slot) == rules.number(self.newest[index]);
            if stale && !(commands && same) || last && !commands {
                return Said::Stale;
            }
            let enabled = matches!(self.mode, Mode::Enabled { .. });
            let free = commands || self.commander.is_none();
            if !free && (enabled || !(word == Word::TakeByForce || self.idle)) {
                self.newest[index] = self.newest[index].max(2 * slot - 1);
                return Said::Commanded;
            }
            (self.commander, self.idle) = (Some(client), false);
            remember(&mut self.newest[index]);
            return Said::Done;
        }
        if commands
            && last
            && let Some(heard) = before
        {
            // The same answer as before, and no second effect.
            return if heard.done { Said::Done } else { Said::Other };
        }
        if !commands {
            remember(&mut self.newest[index]);
            return if self.commander.is_some() { Said::Commanded } else { Said::NotCommander };
        }
        if stale {
            return Said::Stale;
        }
        remember(&mut self.newest[index]);
        self.command(word)
    }

    /// A new command of the commander.
    fn command(&mut self, word: Word) -> Said {
        match (word, self.mode) {
            (Word::Release, Mode::Disabled | Mode::Fault { .. }) => {
                (self.commander, self.idle) = (None, false);
                Said::Done
            }
            (Word::Enable, Mode::Disabled) if self.alarm => Said::Unsafe,
            (Word::Enable, Mode::Disabled) | (Word::Keep, Mode::Enabled { .. }) => {
                self.mode = Mode::Enabled { silence: 0 };
                Said::Done
            }
            (Word::Clear(total), _) if total != self.total || total != self.read => Said::Unread,
            (Word::Clear(_), mode) => {
                if let Mode::Fault { .. } = mode {
                    self.mode = Mode::Disabled;
                }
                Said::Done
            }
            _ => Said::WrongMode,
        }
    }

    /// `Disable`, from any client.
    pub fn disable(&mut self) {
        self.mode = match self.mode {
            Mode::Fault { .. } => Mode::Fault { held: false },
            _ => Mode::Disabled,
        };
    }

    /// `Stop`, from any client.
    pub fn stop(&mut self, rules: &Rules) {
        let held = match self.mode {
            Mode::Enabled { .. } => rules.holds,
            Mode::Disabled => false,
            // The earlier stop has not been read yet.
            Mode::Fault { .. } if self.stopped && self.read != self.total => return,
            Mode::Fault { held } => held,
        };
        self.mode = Mode::Fault { held };
        (self.total, self.stopped) = (self.total + 1, true);
    }

    /// 10 ms pass.
    pub fn tick(&mut self, rules: &Rules) {
        self.alarm = self.pressed;
        let fault = match &mut self.mode {
            Mode::Enabled { .. } if self.pressed => Some(false),
            Mode::Enabled { silence } => {
                *silence += 1;
                (*silence > TIMEOUT).then_some(rules.holds)
            }
            Mode::Fault { held: true } if self.pressed => Some(false),
            _ => None,
        };
        if let Some(held) = fault {
            self.mode = Mode::Fault { held };
            (self.total, self.stopped) = (self.total + 1, false);
        }
    }

    /// More than a second passes.
    pub fn fall_silent(&mut self, rules: &Rules) {
        (0..TIMEOUT + 2).for_each(|_| self.tick(rules));
        self.idle = self.commander.is_some();
    }

    /// The board is reset, and a third client pushes the model.
    pub fn reset(&mut self) {
        for (client, heard) in self.heard.iter().enumerate() {
            let slots = heard.iter().rposition(Option::is_some).map_or(0, |last| last as u8 + 1);
            self.before_reset[client] = self.before_reset[client].max(slots);
        }
        (self.mode, self.commander, self.idle) = (Mode::Disabled, None, false);
        (self.newest, self.welcome) = ([0; COMMANDERS], [false; COMMANDERS]);
        (self.alarm, self.read) = (self.pressed, 0);
        self.resets += 1;
    }

    /// Whether the power stages are on in the tick that has passed.
    pub const fn is_powered(&self) -> bool {
        matches!(self.mode, Mode::Enabled { .. } | Mode::Fault { held: true })
    }
}
