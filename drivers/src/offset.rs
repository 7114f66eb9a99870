//! The offset of a current measurement, learnt while no current flows.

/// Number of samples that are left out after a current has flowed, and of samples in a mean.
const SETTLING: u16 = 64;
const MEAN: u16 = 256;

/// Offset of a converter [counts].
#[derive(Clone, Copy, Debug)]
pub struct Offset {
    expected: u16,
    tolerance: u16,
    sum: u32,
    samples: u16,
    /// The last mean; `None`: none yet, or too far from the expected value.
    value: Option<f32>,
}

impl Offset {
    /// Creates an unknown offset, which must lie within `tolerance` of `expected` [counts].
    pub const fn new(expected: u16, tolerance: u16) -> Self {
        Self { expected, tolerance, sum: 0, samples: 0, value: None }
    }

    /// Restarts the mean, because a current flows or the samples are no longer valid.
    pub const fn interrupt(&mut self) {
        (self.sum, self.samples) = (0, 0);
    }

    /// Forgets the offset.
    pub const fn forget(&mut self) {
        self.interrupt();
        self.value = None;
    }

    /// Takes a sample without current.
    pub fn learn(&mut self, counts: u16) {
        self.samples += 1;
        if self.samples <= SETTLING {
            return;
        }
        self.sum += u32::from(counts);
        if self.samples == SETTLING + MEAN {
            let expected = u32::from(self.expected) * u32::from(MEAN);
            let is_near = self.sum.abs_diff(expected) <= u32::from(self.tolerance) * u32::from(MEAN);
            #[expect(clippy::cast_precision_loss, reason = "20 bits")]
            let mean = self.sum as f32 / f32::from(MEAN);
            self.value = is_near.then_some(mean);
            (self.sum, self.samples) = (0, SETTLING);
        }
    }

    /// Returns `counts` minus the offset, or NaN while that is unknown.
    pub fn remove(&self, counts: u16) -> f32 {
        self.value.map_or(f32::NAN, |value| f32::from(counts) - value)
    }

    /// Returns whether the offset is known.
    pub const fn is_known(&self) -> bool {
        self.value.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 64 samples of a current that decays, then 256 around 2050.5.
    #[test]
    fn the_mean_at_rest_is_the_offset() {
        let mut offset = Offset::new(2048, 100);
        (0..64).for_each(|sample| offset.learn(3000 - 10 * sample));
        for sample in 0..256 {
            assert!(!offset.is_known() && offset.remove(2060).is_nan());
            offset.learn(2050 + sample % 2);
        }
        assert!((offset.remove(2060) - 9.5).abs() < 1e-6);
        // It is kept until a new one is known, which follows the amplifier's drift.
        offset.interrupt();
        (0..319).for_each(|_| offset.learn(2052));
        assert!((offset.remove(2060) - 9.5).abs() < 1e-6);
        offset.learn(2052);
        assert!((offset.remove(2060) - 8.0).abs() < 1e-6);
        offset.forget();
        assert!(!offset.is_known());
    }

    /// The amplifier is dead, or a current keeps flowing.
    #[test]
    fn an_offset_far_from_the_middle_is_none() {
        for (counts, is_known) in
            [(1947, false), (1948, true), (2148, true), (2149, false), (0, false), (4095, false)]
        {
            let mut offset = Offset::new(2048, 100);
            (0..320).for_each(|_| offset.learn(counts));
            assert_eq!(offset.is_known(), is_known, "{counts}");
        }
    }
}
