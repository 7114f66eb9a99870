//! A board whose motors turn the joints of a machine in another process, see `tesaki-chip-link`.

use std::io::{Read, Write};

use tesaki_chip_link::{Answer, Call, MOTORS, Motion, Terminals, receive, send};

use crate::bench::{Bench, Motor};
use crate::cpu::Machine;

/// The exception of the timer's interrupt with which a control period begins.
const INSTANT: usize = 16 + 28;

/// Answers calls until the link is closed.
///
/// # Errors
/// The link breaks, or a call is invalid or out of order.
pub fn serve(elf: &[u8], from: &mut impl Read, to: &mut impl Write) -> Result<(), String> {
    let broken = |error: std::io::Error| error.to_string();
    let Some(first) = receive(from).map_err(broken)? else { return Ok(()) };
    let Call::Start(terminals) = first else { return Err("the first call must be a start".to_owned()) };
    let mut board = Board::new(elf, &terminals);
    send(to, &board.answer([0.0; MOTORS])).map_err(broken)?;
    while let Some(call) = receive(from).map_err(broken)? {
        let Call::Advance { duration, joints, serial } = call else {
            return Err("started a second time".to_owned());
        };
        let torques = board.advance(duration, &joints, &serial)?;
        send(to, &board.answer(torques)).map_err(broken)?;
    }
    Ok(())
}

struct Board {
    machine: Machine,
    /// The end of the last call [ps]; the last instruction may have gone beyond it.
    until: u64,
}

impl Board {
    fn new(elf: &[u8], terminals: &Terminals) -> Self {
        let motors = terminals.motors.map(|motor| Motor {
            resistance: motor.resistance,
            inductance: motor.inductance,
            constant: motor.constant,
            counts: motor.counts,
            inertia: f64::INFINITY,
            coulomb: 0.0,
            viscous: 0.0,
            load: 0.0,
            blocked: false,
        });
        let mut bench = Bench::new(motors, terminals.seed);
        (bench.supply, bench.supply_resistance) = (terminals.supply, terminals.supply_resistance);
        Self { machine: Machine::load(elf, bench), until: 0 }
    }

    /// Returns the mean torques.
    fn advance(
        &mut self,
        duration: u64,
        joints: &[Motion; MOTORS],
        serial: &[u8],
    ) -> Result<[f64; MOTORS], String> {
        let machine = &mut self.machine;
        machine.chip.supervisor().incoming.extend(serial);
        let impulses = machine.chip.bench.states.map(|state| state.impulse);
        for (state, joint) in machine.chip.bench.states.iter_mut().zip(joints) {
            (state.angle, state.velocity) = (joint.angle, joint.velocity);
        }
        self.until += duration;
        machine.run(self.until)?;
        // While the CPU sleeps, the devices at the pins are not simulated: bring them up to date.
        machine.pass(0);
        let seconds = duration as f64 * 1e-12;
        let states = machine.chip.bench.states;
        Ok(std::array::from_fn(|motor| (states[motor].impulse - impulses[motor]) / seconds))
    }

    fn answer(&mut self, torques: [f64; MOTORS]) -> Answer {
        let machine = &mut self.machine;
        Answer {
            torques,
            serial: std::mem::take(&mut machine.chip.supervisor().outgoing),
            awake: machine.chip.bench.is_awake(),
            instant: machine.entered[INSTANT],
            resets: machine.resets.len() as u32,
        }
    }
}
