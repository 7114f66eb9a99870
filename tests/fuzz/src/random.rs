//! Unguided inputs, the same ones each time.

use tesaki_rng::Rng;

use crate::{Target, corpus};

/// Maximum length of noise [bytes].
const NOISE: u32 = 300;
/// Boundary values of bytes.
const EDGES: &[u8] = &[0, 1, 0x7f, 0x80, 0xff];

/// An endless sequence of inputs of a target: one in eight is noise; of the others, half are kept inputs and
/// half initial inputs, changed in some places.
pub struct Inputs {
    target: &'static Target,
    /// The initial inputs, and the kept ones.
    known: [Vec<Vec<u8>>; 2],
    rng: Rng,
}

impl Inputs {
    /// Creates the inputs of `target`.
    pub fn new(target: &'static Target) -> Self {
        let known = [(target.seeds)(), corpus::kept(target)];
        Self { target, known, rng: Rng::new(1, 0) }
    }

    fn below(&mut self, limit: usize) -> usize {
        let limit = u32::try_from(limit).unwrap_or(u32::MAX).max(1);
        usize::try_from(self.rng.below(limit)).unwrap_or(0)
    }

    fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }

    fn noise(&mut self, most: u32) -> Vec<u8> {
        let length = self.rng.below(most + 1);
        (0..length).map(|_| self.rng.next_u64().to_le_bytes()[0]).collect()
    }

    fn known(&mut self) -> Vec<u8> {
        let kind = self.below(2);
        let place = self.below(self.known[kind].len());
        self.known[kind].get(place).cloned().unwrap_or_default()
    }

    /// Changes `bytes` in one place.
    fn change(&mut self, bytes: &mut Vec<u8>) {
        let start = self.below(bytes.len() + 1);
        let end = bytes.len().min(start + 1 + self.below(16));
        match self.below(9) {
            0 => {
                let bit = self.below(8);
                bytes.iter_mut().skip(start).take(1).for_each(|byte| *byte ^= 1 << bit);
            }
            1 => {
                let edge = EDGES[self.below(EDGES.len())];
                bytes.iter_mut().skip(start).take(1).for_each(|byte| *byte = edge);
            }
            2 => drop(bytes.drain(start..end)),
            3 => bytes.extend_from_within(start..end),
            4 => drop(bytes.splice(start..end, self.noise(16))),
            5 if !self.target.words.is_empty() => {
                let word = self.target.words[self.below(self.target.words.len())];
                drop(bytes.splice(start..start, word.bytes()));
            }
            // A number that is not a multiple of a step.
            6 => drop(bytes.splice(start..start, [&[0x80], &self.noise(4)[..]].concat())),
            7 => {
                // Another input continues from here.
                let other = self.known();
                let from = self.below(other.len() + 1);
                bytes.truncate(start);
                bytes.extend(&other[from..]);
            }
            _ => {
                bytes.truncate(start);
                bytes.extend(self.noise(NOISE));
            }
        }
    }
}

impl Iterator for Inputs {
    type Item = Vec<u8>;

    fn next(&mut self) -> Option<Vec<u8>> {
        let mut bytes = if self.one_in(8) { self.noise(NOISE) } else { self.known() };
        for _ in 0..=self.below(3) {
            self.change(&mut bytes);
        }
        bytes.truncate(self.target.max_len);
        Some(bytes)
    }
}
