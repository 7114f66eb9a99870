//! Random numbers, the same for the same seed.

/// A generator of Weyl and mix (splitmix64): fast, and the same everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }

    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// Mostly an ordinary angle, sometimes a limit, sometimes anything.
    pub fn value(&mut self) -> f32 {
        match self.below(12) {
            0 => f32::from_bits(self.next() as u32),
            1 => [0.0, -0.0, f32::NAN, f32::INFINITY, f32::MIN, f32::MIN_POSITIVE, 1e30][self.below(7)],
            _ => (self.below(3001) as f32 - 1500.0) / 1000.0,
        }
    }
}
