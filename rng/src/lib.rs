//! Seeded random numbers, the same on every machine.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// A generator of random numbers: ChaCha with 8 rounds.
///
/// ```
/// use tesaki_rng::Rng;
/// let (mut one, mut same, mut other) = (Rng::new(7, 0), Rng::new(7, 0), Rng::new(7, 1));
/// let first = one.uniform();
/// assert_eq!(first.to_bits(), same.uniform().to_bits());
/// assert_ne!(first.to_bits(), other.uniform().to_bits());
/// assert!((0.0..1.0).contains(&first));
/// ```
#[derive(Clone, Debug)]
pub struct Rng(ChaCha8Rng);

impl Rng {
    /// Creates the `stream`-th of many independent sequences of one seed. Users with separate streams do not
    /// shift each other's numbers.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        Self(rng)
    }

    /// Returns 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Returns a number that is uniformly distributed from 0 to below 1.
    pub fn uniform(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / 9_007_199_254_740_992.0; // 2⁻⁵³
        #[expect(clippy::cast_precision_loss, reason = "53 bits are exact")]
        let bits = (self.next_u64() >> 11) as f64;
        bits * SCALE
    }

    /// Returns a number that is uniformly distributed from −1 to below 1.
    pub fn symmetric(&mut self) -> f64 {
        2.0 * self.uniform() - 1.0
    }

    /// Returns a normally distributed number with mean 0 and standard deviation 1 (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let (radius, angle) = (1.0 - self.uniform(), self.uniform());
        libm::sqrt(-2.0 * libm::log(radius)) * libm::cos(core::f64::consts::TAU * angle)
    }

    /// Returns an integer from 0 to below `limit`, which must not be 0.
    pub fn below(&mut self, limit: u32) -> u32 {
        // The high half of a 32 × 32 bit product: below 2³².
        (((self.next_u64() >> 32) * u64::from(limit)) >> 32) as u32
    }

    /// Returns true with a probability. Consumes a number even if that is 0 or 1, so that the probability
    /// does not shift the numbers that follow.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_spread_as_they_say() {
        let mut rng = Rng::new(1, 0);
        let mut counts = [0_u32; 3];
        for _ in 0..30_000 {
            counts[rng.below(3) as usize] += 1;
        }
        assert!(counts.iter().all(|count| count.abs_diff(10_000) < 400), "{counts:?}");
        let numbers: Vec<f64> = (0..30_000).map(|_| rng.normal()).collect();
        let mean = numbers.iter().sum::<f64>() / 30_000.0;
        let variance = numbers.iter().map(|number| (number - mean) * (number - mean)).sum::<f64>() / 30_000.0;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
        let certain = (0..1000).filter(|_| rng.chance(1.0)).count();
        let never = (0..1000).filter(|_| rng.chance(0.0)).count();
        assert_eq!((certain, never), (1000, 0));
    }

    /// Recorded seeds must keep producing these numbers.
    #[test]
    fn the_numbers_of_a_seed_stay() {
        let mut rng = Rng::new(1, 3);
        assert_eq!(
            [rng.next_u64(), rng.next_u64()],
            [10_481_881_765_394_875_549, 12_435_132_161_185_724_354]
        );
    }
}
