//! The encryption of a TCP connection: `Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s`, whose pre-shared key is a
//! [`Key`].
//!
//! The listening end speaks first: it sends [`GREETING`], by which a client without a key learns why it gets
//! no answer. The client sends the same greeting and the first message of the handshake, and gets the second.
//! From then on each message is a length (`u16`, high byte first) and as many encrypted bytes. The first of
//! them is the client's and has no content: only then does the listening end know that it does not hear a
//! recorded handshake. A message that is damaged, repeated, missing or out of order does not decrypt, and
//! ends the connection.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::time::Instant;

use snow::{Builder, TransportState};

use super::{Key, stream};

/// The first bytes of both ends. The zero ends it for a decoder of frames.
pub(crate) const GREETING: &[u8] = b"tesaki 1: encrypted, see --key\n\0";
/// Length of both messages of the handshake: a public key and a tag.
const HANDSHAKE: usize = 32 + TAG;
/// Length of an authentication tag.
const TAG: usize = 16;
/// Maximum content of a message in bytes.
const CONTENT: usize = 4096;

/// One end of an encrypted connection.
#[derive(Debug)]
pub(crate) struct Channel {
    state: State,
    /// An incomplete message.
    received: Vec<u8>,
}

#[derive(Debug)]
enum State {
    /// The listening end waits for a handshake with this key.
    Greeted(Key),
    /// The handshake is over.
    Agreed {
        noise: Box<TransportState>,
        /// Whether the peer has the key. What the listening end has answered may be a recording.
        confirmed: bool,
    },
}

/// Why a client with a key found no channel.
#[derive(Debug)]
pub(super) enum Failed {
    /// The other end did not greet.
    NoGreeting,
    /// The other end has another key.
    Refused,
    /// The connection failed.
    Link(io::Error),
}

impl From<io::Error> for Failed {
    fn from(error: io::Error) -> Self {
        Self::Link(error)
    }
}

fn builder(key: &Key) -> Result<Builder<'_>, snow::Error> {
    Builder::new("Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s".parse()?).prologue(GREETING)?.psk(0, &key.0)
}

/// Why a connection is dropped.
fn invalid(why: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

impl Channel {
    /// The listening end, which has yet to send [`GREETING`].
    pub(crate) const fn listening(key: Key) -> Self {
        Self { state: State::Greeted(key), received: Vec::new() }
    }

    /// The client's end: carries out the handshake until `deadline`.
    pub(super) fn connect(file: &File, key: &Key, deadline: Instant) -> Result<Self, Failed> {
        let mut greeting = [0; GREETING.len()];
        match stream::read_exact_until(file, &mut greeting, deadline) {
            Ok(()) if greeting == *GREETING => {}
            Err(error) if error.kind() != io::ErrorKind::TimedOut => return Err(error.into()),
            _ => return Err(Failed::NoGreeting),
        }
        let mut noise = builder(key).and_then(Builder::build_initiator).map_err(io::Error::other)?;
        let mut message = [0; HANDSHAKE];
        noise.write_message(&[], &mut message).map_err(io::Error::other)?;
        stream::write_until(file, &mut &[GREETING, &message].concat()[..], deadline)?;
        stream::read_exact_until(file, &mut message, deadline).map_err(|error| match error.kind() {
            io::ErrorKind::TimedOut => Failed::Link(error),
            // Closed, or reset.
            _ => Failed::Refused,
        })?;
        noise.read_message(&message, &mut []).map_err(|_| Failed::Refused)?;
        let noise = noise.into_transport_mode().map_err(io::Error::other)?;
        let mut channel =
            Self { state: State::Agreed { noise: Box::new(noise), confirmed: true }, received: Vec::new() };
        let mut confirmation = VecDeque::new();
        channel.seal(&[], &mut confirmation)?;
        stream::write_until(file, &mut &*confirmation.make_contiguous(), deadline)?;
        Ok(channel)
    }

    /// Whether the peer has shown that it has the key.
    pub(crate) const fn is_open(&self) -> bool {
        matches!(self.state, State::Agreed { confirmed: true, .. })
    }

    /// Encrypts `bytes` and appends them to `out`. The peer drops the connection unless it gets all of `out`,
    /// in order.
    ///
    /// # Errors
    /// Before the channel is open.
    pub(crate) fn seal(&mut self, bytes: &[u8], out: &mut VecDeque<u8>) -> io::Result<()> {
        let State::Agreed { noise, confirmed: true } = &mut self.state else {
            return Err(invalid("the handshake is not over"));
        };
        // No bytes at all are a message without content.
        let (first, others) = bytes.split_at(bytes.len().min(CONTENT));
        for content in std::iter::once(first).chain(others.chunks(CONTENT)) {
            let mut message = [0; CONTENT + TAG];
            let length = noise.write_message(content, &mut message).map_err(io::Error::other)?;
            out.extend(u16::try_from(length).unwrap_or(u16::MAX).to_be_bytes());
            out.extend(message.get(..length).unwrap_or_default());
        }
        Ok(())
    }

    /// Takes received bytes. Appends decrypted ones to `content`, and what the handshake answers to `answer`.
    ///
    /// # Errors
    /// When the peer does not have the key, or a message is not the next one: drop the connection.
    pub(crate) fn open(
        &mut self,
        bytes: &[u8],
        answer: &mut VecDeque<u8>,
        content: &mut VecDeque<u8>,
    ) -> io::Result<()> {
        self.received.extend(bytes);
        if let State::Greeted(key) = &self.state {
            if !self.received.iter().zip(GREETING).all(|(received, expected)| received == expected) {
                return Err(invalid(
                    "it has no key, or is not a tesaki program. Give it the key with --key FILE",
                ));
            }
            let end = GREETING.len() + HANDSHAKE;
            let Some(hello) = self.received.get(GREETING.len()..end) else { return Ok(()) };
            let mut noise = builder(key).and_then(Builder::build_responder).map_err(io::Error::other)?;
            noise.read_message(hello, &mut []).map_err(|_| {
                invalid(
                    "it has another key. Copy the key file of this end to it, and give it with --key FILE",
                )
            })?;
            let mut message = [0; HANDSHAKE];
            noise.write_message(&[], &mut message).map_err(io::Error::other)?;
            answer.extend(message);
            self.received.drain(..end);
            let noise = noise.into_transport_mode().map_err(io::Error::other)?;
            self.state = State::Agreed { noise: Box::new(noise), confirmed: false };
        }
        self.decrypt(content)
    }

    /// Decrypts the messages that are complete.
    fn decrypt(&mut self, content: &mut VecDeque<u8>) -> io::Result<()> {
        let damaged = || invalid("what it sent does not decrypt: somebody damaged or repeated it on the way");
        let State::Agreed { noise, confirmed } = &mut self.state else { return Ok(()) };
        let mut rest = &self.received[..];
        while let Some((length, behind)) = rest.split_first_chunk() {
            let length = usize::from(u16::from_be_bytes(*length));
            if !(TAG..=CONTENT + TAG).contains(&length) {
                return Err(damaged());
            }
            let Some((message, behind)) = behind.split_at_checked(length) else { break };
            let mut plain = [0; CONTENT];
            let length = noise.read_message(message, &mut plain).map_err(|_| damaged())?;
            content.extend(plain.get(..length).unwrap_or_default());
            (rest, *confirmed) = (behind, true);
        }
        self.received = rest.to_vec();
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests;
