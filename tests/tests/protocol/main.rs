//! The bytes on the wire: every message compared with the frames of `oracles/protocol.py`, and the examples
//! of `docs/protocol.md` compared with the same frames.
#![allow(clippy::unwrap_used, reason = "tests")]

mod golden;
mod message;
mod messages;
mod page;
mod refusals;
mod replies;
mod requests;
mod session;
mod values;
mod variants;

use golden::{golden, hex};
use message::Message;
use messages::messages;
use variants::{Seen, every_variant};

#[test]
fn every_message_has_the_golden_bytes_and_they_mean_that_message() {
    let mut messages = messages();
    for (name, bytes) in golden() {
        let message = messages.remove(name).unwrap_or_else(|| panic!("{name} is not built here"));
        assert_eq!(hex(&message.encode()), hex(&bytes), "{name}");
        assert_eq!(message.decode(&bytes), [Ok(message)], "{name}");
    }
    assert!(messages.is_empty(), "without golden bytes: {:?}", messages.keys());
}

#[test]
fn no_variant_of_any_enumeration_is_missing() {
    let mut seen = Seen::default();
    messages().values().for_each(|message| seen.message(message));
    let missing: Vec<_> = every_variant().difference(&seen.0).copied().collect();
    assert!(missing.is_empty(), "no golden frame shows {missing:?}: add them to oracles/protocol.py");
}

#[test]
fn every_single_flipped_bit_and_every_truncation_of_every_frame_is_rejected() {
    let messages = messages();
    for (name, good) in golden() {
        let message = &messages[name];
        if let Message::Model(_) = message {
            continue; // travels inside frames
        }
        let rejected = |bad: &[u8]| message.decode(bad).iter().all(Result::is_err);
        for byte in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[byte] ^= 1 << bit;
                bad.push(0); // in case it was the closing zero
                assert!(rejected(&bad), "{name}: byte {byte} bit {bit}");
            }
        }
        for length in 0..good.len() - 1 {
            let mut short = good[..length].to_vec();
            short.push(0);
            assert!(rejected(&short), "{name}: cut at {length}");
        }
    }
}
