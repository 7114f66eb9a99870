//! Bytes of the fuzzer, read as numbers.

/// The remaining bytes. Beyond the end everything reads as 0.
pub struct Input<'a>(pub &'a [u8]);

impl<'a> Input<'a> {
    /// Returns whether no bytes remain.
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Reads the next `N` bytes.
    pub fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.iter_mut().for_each(|byte| *byte = self.byte());
        bytes
    }

    /// Reads the next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    /// Reads at most `count` of the next bytes.
    pub fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }

    /// Reads the next byte, signed.
    pub fn signed(&mut self) -> i8 {
        i8::from_le_bytes(self.bytes())
    }

    /// Reads a number from 0 to `limit` − 1.
    pub fn below(&mut self, limit: usize) -> usize {
        usize::from(self.byte()) % limit.max(1)
    }

    /// Reads a small multiple of `step`, or after a byte −128 a number of four arbitrary bytes.
    pub fn number(&mut self, step: f32) -> f32 {
        match self.signed() {
            i8::MIN => f32::from_le_bytes(self.bytes()),
            small => f32::from(small) * step,
        }
    }

    /// Reads three numbers.
    pub fn axes(&mut self, step: f32) -> [f32; 3] {
        [0; 3].map(|_| self.number(step))
    }
}
