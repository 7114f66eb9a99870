//! The breadth-first search.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::vec::Vec;

use super::machine::{Input, Machine, Outcome, Said, View, Word};
use super::mutations::Mutation;
use super::specification::{COMMANDERS, Mode, Numbers, Rules, SLOTS, Specification};
use super::{CLIENTS, STRANGER};
use crate::fault::{FaultCause, FaultLog};
use crate::model::Reaction;
use crate::protocol;

/// A variation of the search.
#[derive(Clone, Copy, Debug)]
pub struct Variation {
    pub name: &'static str,
    /// Number of different messages of each client.
    pub slots: [u8; COMMANDERS],
    /// Possible contents of these messages.
    pub words: &'static [Word],
    pub numbers: Numbers,
    pub reaction: Reaction,
    /// Whether the emergency stop is used.
    pub emergency: bool,
    /// Number of resets.
    pub resets: u8,
    /// Number of faults after which a path ends.
    pub faults: u8,
    /// Whether messages with the same number may differ: two programs with the same client number.
    pub twins: bool,
    /// Number of events of a path.
    pub depth: usize,
}

/// An event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The message in the slot of the client arrives, for the first time or again.
    Deliver {
        client: u8,
        slot: u8,
        word: Word,
    },
    /// A client that never said hello.
    Stranger(Word),
    Tick,
    /// More than a second without requests.
    Silence,
    /// The emergency stop is pressed or released, and a tick passes.
    Press,
    ReadFaults,
    Reset,
}

/// A violated rule, and the shortest path to it.
#[derive(Debug)]
pub struct Violation {
    pub rule: &'static str,
    pub path: Vec<Event>,
}

/// Figures of a search without violation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Figures {
    /// Events of the longest of all shortest paths.
    pub depth: usize,
    pub states: usize,
    pub transitions: usize,
    /// States of the node among them.
    pub nodes: usize,
    /// Whether every state was expanded.
    pub complete: bool,
}

/// A hash of small numbers, fast without optimisation.
#[derive(Default)]
struct FastHasher(u64);

impl Hasher for FastHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(byte.into()));
    }

    fn write_u8(&mut self, number: u8) {
        self.write_u64(number.into());
    }

    fn write_u32(&mut self, number: u32) {
        self.write_u64(number.into());
    }

    fn write_isize(&mut self, number: isize) {
        self.write_u64(number.cast_unsigned() as u64);
    }

    fn write_usize(&mut self, number: usize) {
        self.write_u64(number as u64);
    }

    fn write_u64(&mut self, number: u64) {
        self.0 = (self.0.rotate_left(5) ^ number).wrapping_mul(0x517c_c1b7_2722_0a95);
    }

    fn finish(&self) -> u64 {
        // The hash table uses the upper bits as well as the lower ones.
        self.0 ^ self.0 >> 32
    }
}

/// Searches all paths from a board that was just set up.
pub fn search(variation: &Variation, mutation: Option<Mutation>) -> Result<Figures, Violation> {
    let rules = Rules { numbers: variation.numbers, holds: variation.reaction == Reaction::Hold };
    let mut machine = Machine::new(variation.reaction, mutation, variation.numbers[SLOTS]);
    let start = set_up(&mut machine, &rules).map_err(|rule| Violation { rule, path: Vec::new() })?;
    let start = (start, Specification::new());
    let mut known = HashMap::<_, u32, BuildHasherDefault<FastHasher>>::default();
    known.insert(start, 0);
    let mut all = std::vec![(start, 0_u32, Event::Tick)];
    let mut figures = Figures { depth: 0, states: 0, transitions: 0, nodes: 0, complete: true };
    let (mut next, mut layer_end) = (0, 1);
    let mut events = Vec::new();
    while next < all.len() {
        if next == layer_end {
            figures.depth += 1;
            layer_end = all.len();
        }
        if figures.depth == variation.depth {
            figures.complete = false;
            break;
        }
        let ((node, past), ..) = all[next];
        events.clear();
        list_events(variation, &past, &mut events);
        for &event in &events {
            figures.transitions += 1;
            let reached = step(&mut machine, &rules, variation, node, past, event).map_err(|rule| {
                let mut path = std::vec![event];
                let mut at = next;
                while at != 0 {
                    path.push(all[at].2);
                    at = all[at].1 as usize;
                }
                path.reverse();
                Violation { rule, path }
            })?;
            let index = all.len() as u32;
            if *known.entry(reached).or_insert(index) == index {
                all.push((reached, next as u32, event));
            }
        }
        next += 1;
    }
    (figures.states, figures.nodes) = (all.len(), machine.len());
    Ok(figures)
}

/// Sets up the node with a model and the hello of both clients.
fn set_up(machine: &mut Machine, rules: &Rules) -> Result<u32, &'static str> {
    let mut id = machine.reset(FaultLog::new(), false);
    for client in CLIENTS {
        let hello = Input::Request { client, number: rules.numbers[0], word: Word::Hello };
        id = machine.step(id, hello)?.next;
    }
    Ok(id)
}

/// Lists the possible next events.
fn list_events(variation: &Variation, past: &Specification, events: &mut Vec<Event>) {
    if past.total > variation.faults {
        return;
    }
    for (client, &slots) in (0..).zip(&variation.slots) {
        for slot in 1..=slots {
            let index = usize::from(client);
            let heard = past.heard[index][usize::from(slot) - 1];
            if let Some(heard) = heard.filter(|_| !variation.twins) {
                // No hello arrives across a reset.
                if heard.word != Word::Hello || slot > past.before_reset[index] {
                    events.push(Event::Deliver { client, slot, word: heard.word });
                }
                continue;
            }
            // A client waits for the answer to its hello.
            let later = past.heard[index].iter().skip(slot.into()).any(Option::is_some);
            for &word in variation.words {
                match word {
                    Word::Hello if slot <= past.before_reset[index] || later => {}
                    // Sent after, or before, the last fault was read.
                    Word::Clear(_) => {
                        events.push(Event::Deliver { client, slot, word: Word::Clear(past.total) });
                        if let Some(total) = past.total.checked_sub(1) {
                            events.push(Event::Deliver { client, slot, word: Word::Clear(total) });
                        }
                    }
                    word => events.push(Event::Deliver { client, slot, word }),
                }
            }
        }
    }
    events.extend([Word::Disable, Word::Stop, Word::Enable, Word::TakeByForce].map(Event::Stranger));
    events.extend([Event::Tick, Event::Silence, Event::ReadFaults]);
    if variation.emergency {
        events.push(Event::Press);
    }
    if past.resets < variation.resets {
        events.push(Event::Reset);
    }
}

/// Applies one event to the node and the specification.
fn step(
    machine: &mut Machine,
    rules: &Rules,
    variation: &Variation,
    node: u32,
    past: Specification,
    event: Event,
) -> Result<(u32, Specification), &'static str> {
    let mut now = past;
    let mut right = Said::Done;
    let input = match event {
        Event::Deliver { client, slot, word } => {
            right = now.deliver(rules, client, slot, word);
            let number = rules.numbers[usize::from(slot)];
            Input::Request { client: CLIENTS[usize::from(client)], number, word }
        }
        Event::Stranger(word) => {
            match word {
                Word::Disable => now.disable(),
                Word::Stop => now.stop(rules),
                _ => right = Said::Mismatch,
            }
            Input::Request { client: STRANGER, number: 1, word }
        }
        Event::Tick => {
            now.tick(rules);
            Input::Tick { pressed: now.pressed }
        }
        Event::Press => {
            now.pressed = !now.pressed;
            now.tick(rules);
            Input::Tick { pressed: now.pressed }
        }
        Event::Silence => {
            now.fall_silent(rules);
            Input::Silence { pressed: now.pressed }
        }
        Event::ReadFaults => {
            now.read = now.total;
            Input::ReadFaults
        }
        Event::Reset => {
            now.reset();
            Input::Reset { pressed: now.pressed }
        }
    };
    let outcome = machine.step(node, input)?;
    let (before, after) = (machine.view(node), machine.view(outcome.next));
    check_enabling(variation, &past, before, after, event)?;
    check_newest_word(variation, &now, after)?;
    check_faults(&now, before, after, event, outcome.cause)?;
    compare(variation, &past, &now, after, outcome, event, right)?;
    Ok((outcome.next, now))
}

fn is_enabled(view: View) -> bool {
    matches!(view.mode, protocol::Mode::Enabled(_))
}

/// Checks that only permitted events switch the outputs on.
fn check_enabling(
    variation: &Variation,
    past: &Specification,
    before: View,
    after: View,
    event: Event,
) -> Result<(), &'static str> {
    if is_enabled(before) || !is_enabled(after) {
        return Ok(());
    }
    let Event::Deliver { client, slot, word: Word::Enable } = event else {
        return Err("only an enable of a client enables");
    };
    let index = usize::from(client);
    let heard = &past.heard[index];
    let newer = heard.iter().skip(slot.into()).flatten();
    let overtaken = |word: Word| !matches!(word, Word::Hello | Word::ReadStatus | Word::ReadFaults);
    let rules = [
        (before.mode == protocol::Mode::Disabled, "nothing enables before the fault is cleared"),
        (before.commander == Some(CLIENTS[index]), "only the commander enables"),
        (heard[usize::from(slot) - 1].is_none(), "no repetition enables"),
        (
            variation.twins || !newer.clone().any(|heard| overtaken(heard.word)),
            "no overtaken message enables",
        ),
        (slot > past.before_reset[index], "nothing from before a reset enables"),
        (!past.alarm, "nothing enables while the last frame shows a fault"),
    ];
    rules.iter().find(|(holds, _)| !holds).map_or(Ok(()), |(_, rule)| Err(*rule))
}

/// Checks that while the outputs follow a task, the commander has sent no later message that ends it.
fn check_newest_word(variation: &Variation, now: &Specification, after: View) -> Result<(), &'static str> {
    if !is_enabled(after) || variation.twins {
        return Ok(());
    }
    let Some(commander) = CLIENTS.iter().position(|&client| after.commander == Some(client)) else {
        return Err("nothing is enabled without a commander");
    };
    let mut words = now.heard[commander].iter().rev().flatten().map(|heard| heard.word);
    let newest = words.find(|word| matches!(word, Word::Enable | Word::Disable | Word::Stop));
    let says_so = newest == Some(Word::Enable);
    says_so.then_some(()).ok_or("the newest word of the commander is to enable")
}

/// Checks that a fault leaves `Enabled` and is recorded once, with its cause.
fn check_faults(
    now: &Specification,
    before: View,
    after: View,
    event: Event,
    cause: Option<FaultCause>,
) -> Result<(), &'static str> {
    let fault = is_enabled(before) && after.mode == protocol::Mode::Fault;
    if fault && after.total != before.total + 1 {
        return Err("a fault is recorded once");
    }
    let expected = match event {
        Event::Tick | Event::Silence | Event::Press if now.pressed => FaultCause::EmergencyStop,
        Event::Tick | Event::Silence | Event::Press => FaultCause::CommandTimeout,
        _ => FaultCause::Stop,
    };
    if cause.is_some_and(|cause| cause != expected) {
        return Err("the log names the cause");
    }
    Ok(())
}

/// Checks that the node is in the state of the specification.
fn compare(
    variation: &Variation,
    past: &Specification,
    now: &Specification,
    after: View,
    outcome: Outcome,
    event: Event,
    right: Said,
) -> Result<(), &'static str> {
    let mode = match now.mode {
        Mode::Disabled => after.mode == protocol::Mode::Disabled,
        Mode::Enabled { .. } => is_enabled(after),
        Mode::Fault { .. } => after.mode == protocol::Mode::Fault,
    };
    let passes = matches!(event, Event::Tick | Event::Silence | Event::Press);
    let rules = [
        (mode, "the mode is that of the specification"),
        (after.commander == now.commander.map(|index| CLIENTS[usize::from(index)]), "the commander is right"),
        (after.total == u32::from(now.total), "each fault is recorded once"),
        (after.read == (now.read == now.total), "faults are read or not"),
        (!passes || outcome.powered == now.is_powered(), "the power stages are on or off as specified"),
        (variation.twins || is_right(past, outcome.said, event, right), "the answer is right"),
    ];
    rules.iter().find(|(holds, _)| !holds).map_or(Ok(()), |(_, rule)| Err(*rule))
}

/// Whether the kind of answer is one that the specification allows.
fn is_right(past: &Specification, said: Said, event: Event, right: Said) -> bool {
    let Event::Deliver { client, slot, word } = event else { return said == right };
    let before = past.heard[usize::from(client)][usize::from(slot) - 1];
    match before {
        // A repetition gets the same answer as before, or is refused.
        Some(heard) if word.is_command() => match right {
            Said::Done => said == Said::Done,
            Said::NotCommander => said != Said::Done || heard.done,
            _ => said != Said::Done,
        },
        _ => said == right,
    }
}
