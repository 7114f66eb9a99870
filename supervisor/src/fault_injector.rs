//! A bad line on purpose: loses, flips, repeats and delays bytes, the same ones for the same seed.
//!
//! [`LinkFaults`] says how bad, [`Damage`] does it to bytes alone, and [`FaultyLink`] does it to both directions of
//! a [`ByteLink`](crate::ByteLink), and delays them too. A frame here is whatever ends with a zero byte.

mod damage;
mod faults;
mod link;

pub use damage::{Damage, Injected};
pub use faults::{FaultsError, LinkFaults, Pause};
pub use link::FaultyLink;

/// Splitmix64 (Steele, Lea, Flood 2014): good enough for faults, and the same everywhere.
#[derive(Clone, Debug)]
struct Random(u64);

impl Random {
    /// The `stream`-th of many independent sequences of one seed.
    fn new(seed: u64, stream: u64) -> Self {
        let mut seeds = Self(seed ^ stream.wrapping_mul(0xd1b5_4a32_d192_ed03));
        Self(seeds.next())
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// From 0 to below 1.
    fn fraction(&mut self) -> f64 {
        f64::from((self.next() >> 32) as u32) / 4_294_967_296.0
    }

    /// From 0 to below `limit`, which must not be 0.
    fn below(&mut self, limit: u32) -> u32 {
        // The high half of a 32 × 32 bit product.
        ((u64::from((self.next() >> 32) as u32) * u64::from(limit)) >> 32) as u32
    }

    /// With that probability. Takes a number even if it is certain, so that one fault's rate does not shift others.
    fn chance(&mut self, probability: f64) -> bool {
        self.fraction() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_numbers_are_splitmix64s() {
        // The first three of seed 1234567, as published with the algorithm (rosettacode.org/wiki/…#Splitmix64).
        let mut random = Random(1_234_567);
        let first = [random.next(), random.next(), random.next()];
        assert_eq!(first, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
        let mut counts = [0_u32; 3];
        for _ in 0..30_000 {
            counts[random.below(3) as usize] += 1;
        }
        assert!(counts.iter().all(|count| count.abs_diff(10_000) < 300), "{counts:?}");
    }
}
