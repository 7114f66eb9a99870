//! The link between a simulated machine and the process that runs the image of its board on a modelled chip.
//!
//! The chip runs in a separate process because it has another licence: this crate is all that both share. The
//! machine calls over the standard input of that process, and each call has one answer on its standard
//! output. Time passes only in [`Call::Advance`], so that both run in lockstep and a run can be repeated to
//! the last bit.
//!
//! The link carries the signals at the motors' terminals and at the supervisor's connector: joint motion and
//! serial bytes to the chip, torques and serial bytes from it. Pulses, currents and encoder signals stay on
//! the chip's side.
//!
//! A message is its length (four bytes, little-endian) followed by its postcard encoding.

use std::io::{self, Read, Write};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Number of motors of a board.
pub const MOTORS: usize = 3;

/// Largest message [bytes]: the serial line's data of a second, and a reserve.
const MAX_LENGTH: usize = 1 << 20;

/// A motor at the board's terminals, seen from its joint. Its inertia and friction belong to the machine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motor {
    /// Resistance [Ω].
    pub resistance: f64,
    /// Inductance [H].
    pub inductance: f64,
    /// Torque per current [N·m/A], which is the back-EMF per velocity [V·s/rad].
    pub constant: f64,
    /// Counts of the encoder per turn of the joint.
    pub counts: f64,
}

/// How a joint moves at the beginning of a call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Angle [rad].
    pub angle: f64,
    /// Velocity, constant during the call [rad/s].
    pub velocity: f64,
}

/// The devices at the terminals of the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Terminals {
    /// The motors.
    pub motors: [Motor; MOTORS],
    /// Voltage of the supply [V].
    pub supply: f64,
    /// Its inner resistance [Ω].
    pub supply_resistance: f64,
    /// Seed of the converters' noise.
    pub seed: u32,
}

/// A call from the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Call {
    /// Power on; the first call.
    Start(Terminals),
    /// Time passes.
    Advance {
        /// How long [ps].
        duration: u64,
        /// The joints.
        joints: [Motion; MOTORS],
        /// Bytes to the board on the supervisor's line.
        serial: Vec<u8>,
    },
}

/// The chip's answer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Mean torques of the motors over the call [N·m].
    pub torques: [f64; MOTORS],
    /// Bytes from the board on the supervisor's line.
    pub serial: Vec<u8>,
    /// Whether the power stages are awake at the end of the call.
    pub awake: bool,
    /// Time since power-on at which the last control period began [ps]; 0 before the first.
    pub instant: u64,
    /// Resets of the chip since power-on.
    pub resets: u32,
}

/// Writes a message.
///
/// # Errors
/// The other end is gone.
pub fn send<T: Serialize>(to: &mut impl Write, message: &T) -> io::Result<()> {
    let bytes = postcard::to_stdvec(message).map_err(io::Error::other)?;
    let length = u32::try_from(bytes.len()).map_err(io::Error::other)?;
    to.write_all(&length.to_le_bytes())?;
    to.write_all(&bytes)?;
    to.flush()
}

/// Reads a message. Returns `None` if the other end has closed the link between two messages.
///
/// # Errors
/// The link ends within a message, or the bytes are not a message.
pub fn receive<T: DeserializeOwned>(from: &mut impl Read) -> io::Result<Option<T>> {
    let mut length = [0; 4];
    let [first, rest @ ..] = &mut length;
    match from.read_exact(std::slice::from_mut(first)) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    from.read_exact(rest)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_LENGTH {
        return Err(io::Error::other(format!("a message of {length} bytes; {MAX_LENGTH} are the most")));
    }
    let mut bytes = vec![0; length];
    from.read_exact(&mut bytes)?;
    postcard::from_bytes(&bytes).map(Some).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn messages_come_as_they_went_and_then_the_end() {
        let joints = [Motion { angle: 0.25, velocity: -1.5 }; MOTORS];
        let calls = [1_u64, 2].map(|duration| Call::Advance { duration, joints, serial: vec![0, 255] });
        let mut line = Vec::new();
        calls.iter().for_each(|call| send(&mut line, call).unwrap());
        let mut line = line.as_slice();
        for call in calls {
            assert_eq!(receive::<Call>(&mut line).unwrap(), Some(call));
        }
        assert_eq!(receive::<Call>(&mut line).unwrap(), None);
    }

    #[test]
    fn a_message_cut_in_half_or_too_long_is_an_error() {
        let mut line = Vec::new();
        send(&mut line, &Answer::default()).unwrap();
        for length in 1..line.len() {
            let error = receive::<Answer>(&mut &line[..length]).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof, "{length} bytes");
        }
        let error = receive::<Answer>(&mut u32::MAX.to_le_bytes().as_slice()).unwrap_err();
        assert_eq!(error.to_string(), "a message of 4294967295 bytes; 1048576 are the most");
    }
}
