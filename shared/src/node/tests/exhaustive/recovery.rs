//! From every state of the node, a stop works immediately, and a client that follows the protocol can enable
//! the robot.

use super::machine::{Machine, Word};
use crate::model::Reaction;
use crate::protocol::{Mode, Reply};

/// A client that has sent nothing before.
const STRANGER: u32 = 77;

/// Checks the ways out of a state.
pub fn check(machine: &mut Machine, id: u32) -> Result<(), &'static str> {
    machine.load(id);
    machine.ask(STRANGER, 1, Word::Disable.request());
    if matches!(machine.look().mode, Mode::Enabled(_)) || machine.tick(false) {
        return Err("a disable by anybody switches the outputs off");
    }
    machine.load(id);
    machine.ask(STRANGER, 1, Word::Stop.request());
    let stopped = !matches!(machine.look().mode, Mode::Enabled(_));
    let powered = machine.tick(false);
    let held = machine.look().mode == Mode::Fault && machine.node.state.reaction == Reaction::Hold;
    if !stopped || powered && !held {
        return Err("a stop by anybody ends in the outputs off or held");
    }
    for client in [STRANGER, super::CLIENTS[0], super::CLIENTS[1]] {
        machine.load(id);
        recover(machine, client).ok_or("a client that follows the protocol gets the robot enabled")?;
    }
    Ok(())
}

/// Enables the robot as this client, with new sequence numbers.
fn recover(machine: &mut Machine, client: u32) -> Option<()> {
    let mut number = machine.unused;
    let mut ask = |machine: &mut Machine, word: Word| {
        number = number.wrapping_add(1);
        machine.ask(client, number, word.request())
    };
    ask(machine, Word::Disable);
    ask(machine, Word::Hello);
    (ask(machine, Word::TakeByForce) == Reply::Done).then_some(())?;
    let Reply::Faults(log) = ask(machine, Word::ReadFaults) else { return None };
    machine.tick(false);
    (ask(machine, Word::Clear(log.total as u8)) == Reply::Done).then_some(())?;
    (ask(machine, Word::Enable) == Reply::Done).then_some(())?;
    machine.tick(false).then_some(())
}
