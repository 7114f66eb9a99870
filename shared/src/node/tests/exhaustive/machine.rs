//! The real node as a finite automaton.
//!
//! A state of the automaton is the complete [`State`] of the node, except for three numbers without effect:
//! the tick (all ticks are relative to the present one; ages beyond the lease are equal), the index of the
//! log, and the faults before the last one, of which only the total is kept. The robot stands still.

use std::collections::HashMap;
use std::vec::Vec;

use serde::Serialize;

use super::mutations::{self, Mutation};
use super::recovery;
use crate::control::ServoMode;
use crate::fault::{Fault, FaultCause, FaultLog};
use crate::model::{Reaction, RobotModel};
use crate::node::clients::Clients;
use crate::node::lease::Lease;
use crate::node::optional::Optional;
use crate::node::tests::rig::{Rig, model};
use crate::node::{Node, State};
use crate::protocol::{
    BoardStatus, LEASE, Mode, Refusal, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFlags, SensorFrame,
};
use crate::task::TaskConfig;

/// The command timeout of the robot [ticks].
pub const TIMEOUT: u8 = 2;
/// The tick of every state.
const NOW: u32 = 1000;
/// The client that pushes the model after a reset and reads the faults.
pub const OPERATOR: u32 = 9;

/// A message of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Word {
    Hello,
    Take,
    TakeByForce,
    Release,
    Enable,
    Disable,
    Stop,
    Keep,
    /// Clears the faults, of which the sender has read this number.
    Clear(u8),
    ReadStatus,
    ReadFaults,
}

impl Word {
    pub const fn is_take(self) -> bool {
        matches!(self, Self::Take | Self::TakeByForce)
    }

    /// Whether only the commander may send it and it is executed once.
    pub const fn is_command(self) -> bool {
        matches!(self, Self::Release | Self::Enable | Self::Keep | Self::Clear(_))
    }

    pub fn request(self) -> Request {
        match self {
            Self::Hello => Request::Hello { schema: SCHEMA_KEY },
            Self::Take => Request::TakeCommand { by_force: false },
            Self::TakeByForce => Request::TakeCommand { by_force: true },
            Self::Release => Request::ReleaseCommand,
            Self::Enable => Request::Enable(TaskConfig::JointServo(ServoMode::Pid)),
            Self::Disable => Request::Disable,
            Self::Stop => Request::Stop,
            Self::Keep => Request::Keep,
            Self::Clear(total) => Request::ClearFaults { total: total.into() },
            Self::ReadStatus => Request::ReadStatus,
            Self::ReadFaults => Request::ReadFaults,
        }
    }
}

/// The kind of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Said {
    Done,
    Data,
    Mismatch,
    WrongMode,
    Commanded,
    NotCommander,
    Stale,
    Unread,
    Unsafe,
    Other,
}

impl From<&Reply> for Said {
    fn from(reply: &Reply) -> Self {
        match reply {
            Reply::Done => Self::Done,
            Reply::Refused(refusal) => match refusal {
                Refusal::SchemaMismatch { .. } => Self::Mismatch,
                Refusal::WrongMode(_) => Self::WrongMode,
                Refusal::Commanded { .. } => Self::Commanded,
                Refusal::NotCommander => Self::NotCommander,
                Refusal::Stale { .. } => Self::Stale,
                Refusal::FaultsUnread { .. } => Self::Unread,
                Refusal::Unsafe(_) => Self::Unsafe,
                _ => Self::Other,
            },
            _ => Self::Data,
        }
    }
}

/// An input of the node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Input {
    Request {
        client: u32,
        number: u16,
        word: Word,
    },
    /// 10 ms pass, with or without the emergency stop pressed.
    Tick {
        pressed: bool,
    },
    /// More than a second passes.
    Silence {
        pressed: bool,
    },
    /// The operator reads the faults.
    ReadFaults,
    /// The board is reset; the operator pushes the model again.
    Reset {
        pressed: bool,
    },
}

/// The result of an input.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub next: u32,
    pub said: Said,
    /// Whether the last actuator frame had the power stages on.
    pub powered: bool,
    /// The last fault that was recorded.
    pub cause: Option<FaultCause>,
}

/// The state of the node that a client can see.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    pub mode: Mode,
    pub commander: Option<u32>,
    pub total: u32,
    pub read: bool,
}

/// The part of the [`State`] that requests and time change.
#[derive(Clone, Debug, Serialize)]
struct Control {
    lease: Lease,
    accepted: Clients,
    mode: Mode,
    reaction: Reaction,
    halting: bool,
    alarm: Optional<Fault>,
    silence: u32,
    faults: FaultLog,
    faults_read: u32,
    /// Index of the remaining state.
    rest: u32,
}

/// The node and its states so far.
pub struct Machine {
    pub node: Node,
    pub mutation: Option<Mutation>,
    /// A sequence number after all that the clients have used so far.
    pub unused: u16,
    model: RobotModel,
    states: Vec<(Control, View)>,
    ids: HashMap<Vec<u8>, u32>,
    rests: Vec<State>,
    rest_ids: HashMap<Vec<u8>, u32>,
    outcomes: HashMap<(u32, Input), Outcome>,
    resets: HashMap<(Vec<u8>, bool), u32>,
    checked: usize,
}

impl Machine {
    pub fn new(reaction: Reaction, mutation: Option<Mutation>, unused: u16) -> Self {
        let mut model = model();
        model.joints.truncate(1);
        model.chains[0].joints = 1;
        model.safety.reaction = reaction;
        model.safety.command_timeout = 0.01 * f32::from(TIMEOUT);
        let node = Node::new();
        let (states, ids, rests) = (Vec::new(), HashMap::new(), Vec::new());
        let (rest_ids, outcomes, resets) = (HashMap::new(), HashMap::new(), HashMap::new());
        Self { node, mutation, unused, model, states, ids, rests, rest_ids, outcomes, resets, checked: 0 }
    }

    /// Number of states of the node so far.
    pub fn len(&self) -> usize {
        self.states.len()
    }

    /// The part of the state that a client sees.
    pub fn view(&self, id: u32) -> View {
        self.states[id as usize].1
    }

    /// The state after a reset, once the operator has pushed the model.
    pub fn reset(&mut self, faults: FaultLog, pressed: bool) -> u32 {
        let key = (postcard::to_stdvec(&faults).unwrap(), pressed);
        if let Some(&id) = self.resets.get(&key) {
            return id;
        }
        let mut rig = Rig::new();
        rig.client = OPERATOR;
        rig.node.restore_faults(faults, 0);
        rig.command();
        rig.sensors.encoders.truncate(1);
        rig.sensors.currents.truncate(1);
        assert_eq!(rig.push(&self.model), Reply::Done);
        rig.sensors.sequence = NOW;
        rig.sensors.flags = SensorFlags(pressed.into());
        rig.tick();
        assert_eq!(rig.ask(Request::ReleaseCommand), Reply::Done);
        self.node = rig.node;
        let id = self.store();
        self.resets.insert(key, id);
        id
    }

    /// Puts the node into a state.
    pub fn load(&mut self, id: u32) {
        let (control, _) = &self.states[id as usize];
        let state = &mut self.node.state;
        *state = self.rests[control.rest as usize].clone();
        state.lease = control.lease;
        state.accepted = control.accepted;
        (state.mode, state.reaction, state.halting) = (control.mode, control.reaction, control.halting);
        (state.alarm, state.silence) = (control.alarm, control.silence);
        state.faults.clone_from(&control.faults);
        state.faults_read = control.faults_read;
        (state.tick, state.reacting_since) = (NOW, NOW - 1);
    }

    /// Stores the state of the node, and returns its index.
    fn store(&mut self) -> u32 {
        let view = self.look();
        let state = &self.node.state;
        let mut lease = state.lease;
        let age = state.tick.wrapping_sub(lease.last_request);
        lease.last_request = if lease.held && age > LEASE { NOW - LEASE - 1 } else { NOW };
        if let Optional::Some(Refusal::Unsafe(fault)) = &mut lease.refusal {
            fault.tick = NOW;
        }
        let mut alarm = state.alarm;
        if let Optional::Some(fault) = &mut alarm {
            fault.tick = NOW;
        }
        let mut faults = FaultLog { total: state.faults.total, ..FaultLog::new() };
        if let Some(last) = state.faults.faults.last() {
            faults.faults.push(Fault { tick: NOW, ..*last }).unwrap();
        }
        let mut control = Control {
            lease,
            accepted: state.accepted,
            mode: state.mode,
            reaction: if state.mode == Mode::Fault { state.reaction } else { Reaction::Off },
            halting: state.halting,
            alarm,
            silence: if matches!(state.mode, Mode::Enabled(_)) { state.silence } else { 0 },
            faults,
            faults_read: state.faults_read,
            rest: 0,
        };
        control.rest = self.store_rest();
        let next = self.states.len() as u32;
        let id = *self.ids.entry(postcard::to_stdvec(&control).unwrap()).or_insert(next);
        if id == next {
            self.states.push((control, view));
        }
        id
    }

    /// Stores the part of the state that is not in [`Control`].
    fn store_rest(&mut self) -> u32 {
        let none = State::new();
        let mut rest = self.node.state.clone();
        (rest.lease, rest.accepted, rest.faults) = (none.lease, none.accepted, none.faults);
        (rest.mode, rest.reaction, rest.halting) = (none.mode, none.reaction, none.halting);
        (rest.alarm, rest.silence, rest.faults_read) = (none.alarm, 0, 0);
        (rest.tick, rest.reacting_since, rest.records) = (0, 0, 0);
        let next = self.rests.len() as u32;
        let id = *self.rest_ids.entry(postcard::to_stdvec(&rest).unwrap()).or_insert(next);
        if id == next {
            self.rests.push(rest);
        }
        id
    }

    /// The part of the node that a client sees.
    pub fn look(&self) -> View {
        let status = self.node.status(&BoardStatus::default()).node;
        View {
            mode: status.mode,
            commander: status.commander,
            total: status.faults,
            read: status.faults_read,
        }
    }

    /// Sends a request to the node.
    pub fn ask(&mut self, client: u32, sequence: u16, request: Request) -> Reply {
        let frame = RequestFrame { client, sequence, request };
        mutations::handle(self.mutation, &mut self.node, &frame)
    }

    /// Ticks the robot at rest. Returns whether the power stages are on.
    pub fn tick(&mut self, pressed: bool) -> bool {
        let sensors = SensorFrame {
            sequence: self.node.state.tick.wrapping_add(1),
            flags: SensorFlags(pressed.into()),
            supply: 24_000,
            encoders: heapless::Vec::from_slice(&[0]).unwrap(),
            currents: heapless::Vec::from_slice(&[0]).unwrap(),
            forces: heapless::Vec::new(),
        };
        let frame = mutations::tick(self.mutation, &mut self.node, &sensors);
        assert!(frame.enabled || frame.torques.iter().all(|&torque| torque == 0.0));
        frame.enabled
    }

    /// Applies `input`. The error names a rule that is violated regardless of the history.
    pub fn step(&mut self, id: u32, input: Input) -> Result<Outcome, &'static str> {
        if let Some(outcome) = self.outcomes.get(&(id, input)) {
            return Ok(*outcome);
        }
        self.load(id);
        let mut outcome = Outcome { next: id, said: Said::Done, powered: false, cause: None };
        match input {
            Input::Request { client, number, word } => {
                let reply = self.ask(client, number, word.request());
                outcome.said = Said::from(&reply);
                outcome.next = self.store();
                if self.ask(client, number, word.request()) != reply || self.store() != outcome.next {
                    return Err("a repetition at once gets the same answer and changes nothing");
                }
                self.check_stranger(id, outcome.next, client, word)?;
            }
            Input::ReadFaults => {
                self.ask(OPERATOR, u16::MAX, Word::ReadFaults.request());
                outcome.next = self.store();
            }
            Input::Tick { pressed } => {
                outcome.powered = self.tick(pressed);
                outcome.next = self.store();
            }
            Input::Silence { pressed } => {
                for _ in 0..TIMEOUT + 2 {
                    outcome.powered = self.tick(pressed);
                }
                let at_rest = self.store();
                self.tick(pressed);
                assert_eq!(self.store(), at_rest, "nothing changes any more");
                self.node.state.lease.last_request = self.node.state.tick.wrapping_sub(LEASE + 1);
                outcome.next = self.store();
            }
            Input::Reset { pressed } => {
                if !mutations::resets_nothing(self.mutation) {
                    outcome.next = self.reset(self.node.state.faults.clone(), pressed);
                }
            }
        }
        if self.view(outcome.next).total != self.view(id).total {
            let (control, _) = &self.states[outcome.next as usize];
            outcome.cause = control.faults.faults.last().map(|fault| fault.cause);
        }
        // Every reached state must have a way out.
        while self.checked < self.len() {
            recovery::check(self, self.checked as u32)?;
            self.checked += 1;
        }
        self.outcomes.insert((id, input), outcome);
        Ok(outcome)
    }

    /// Checks the effect of a client that does not command.
    fn check_stranger(&self, id: u32, next: u32, client: u32, word: Word) -> Result<(), &'static str> {
        let commands = self.view(id).commander == Some(client) || self.view(next).commander == Some(client);
        if commands || matches!(word, Word::Disable | Word::Stop) {
            return Ok(());
        }
        // The sequence numbers that the node stores for the client may change.
        let visible = |id: u32| {
            let mut control = self.states[id as usize].0.clone();
            control.accepted = Clients::NONE;
            control.lease.former = Clients::NONE;
            if control.lease.client == Some(client) {
                (control.lease.sequence, control.lease.refusal) = (0, Optional::None);
            }
            postcard::to_stdvec(&control).unwrap()
        };
        let same = visible(id) == visible(next);
        same.then_some(()).ok_or("a client that does not command changes nothing")
    }
}
