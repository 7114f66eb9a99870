//! Extension of 16-bit counters to 32 bits.

/// Extends a 16-bit counter beyond its range. It must be read at least every 32 767 counts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counter {
    last: u16,
    total: i32,
}

impl Counter {
    /// Creates the extension at 0, where the counter begins after its reset.
    pub const fn new() -> Self {
        Self { last: 0, total: 0 }
    }

    /// Returns the extended count at `raw`; it wraps as an `i32` does.
    pub const fn extend(&mut self, raw: u16) -> i32 {
        let change = raw.wrapping_sub(self.last).cast_signed();
        self.last = raw;
        self.total = self.total.wrapping_add(change as i32);
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_go_on_through_both_ends_of_the_range() {
        let mut counter = Counter::new();
        let raw = [0_u16, 0xFFFF, 0x8001, 0x0010, 0x7000, 0xE000, 0x1000];
        let expected = [0, -1, -32_767, -65_520, -36_864, -8_192, 4_096];
        assert_eq!(raw.map(|raw| counter.extend(raw)), expected);
    }
}
