//! Values from an RTIC task to one that preempts it, without a critical section.

use core::sync::atomic::{AtomicU32, Ordering};

/// A double buffer of `N` words on a single core: the writer never waits and never blocks the reader.
///
/// The reader must have the higher priority, or the same. Then a write never interrupts a read, which always
/// finds the last complete value: the writer fills the unpublished buffer and then publishes it.
///
/// ```
/// use tesaki_drivers::handover::Handover;
/// let torques = Handover::<3>::new();
/// assert_eq!(torques.read(0), None);
/// torques.write([1, 2, 3]);
/// let (number, value) = torques.read(0).unwrap();
/// assert_eq!(value, [1, 2, 3]);
/// assert_eq!(torques.read(number), None);
/// ```
pub struct Handover<const N: usize> {
    buffers: [[AtomicU32; N]; 2],
    /// Number of writes; its lowest bit selects the buffer. 0: none yet.
    published: AtomicU32,
}

impl<const N: usize> Default for Handover<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Handover<N> {
    /// Creates a buffer to which nothing was written.
    pub const fn new() -> Self {
        let buffers = [const { [const { AtomicU32::new(0) }; N] }; 2];
        Self { buffers, published: AtomicU32::new(0) }
    }

    /// Publishes a value. There must be only one writer at a time.
    pub fn write(&self, value: [u32; N]) {
        self.write_interrupted(value, || {});
    }

    /// Writes, and calls `interrupt` before each store, as a reader may interrupt there.
    #[inline(always)]
    fn write_interrupted(&self, value: [u32; N], mut interrupt: impl FnMut()) {
        // 0 means that nothing was written: the number 2 follows the largest odd one.
        let number = match self.published.load(Ordering::Relaxed) {
            u32::MAX => 2,
            last => last + 1,
        };
        for (word, value) in self.buffer(number).iter().zip(value) {
            interrupt();
            word.store(value, Ordering::Relaxed);
        }
        interrupt();
        self.published.store(number, Ordering::Release);
    }

    /// Returns the last value with its number, if that is not `seen`.
    pub fn read(&self, seen: u32) -> Option<(u32, [u32; N])> {
        let number = self.published.load(Ordering::Acquire);
        let buffer = self.buffer(number);
        (number != seen).then(|| (number, core::array::from_fn(|word| buffer[word].load(Ordering::Relaxed))))
    }

    const fn buffer(&self, number: u32) -> &[AtomicU32; N] {
        &self.buffers[(number & 1) as usize]
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// The reader preempts the writer before each of its stores.
    #[test]
    fn a_reader_never_sees_half_a_value() {
        let handover = Handover::<4>::new();
        handover.write([7; 4]);
        for round in 8..40 {
            let old = handover.read(0).unwrap();
            let mut interrupts = 0;
            handover.write_interrupted([round; 4], || {
                interrupts += 1;
                assert_eq!(handover.read(0).unwrap(), old);
                assert_eq!(handover.read(old.0), None);
            });
            assert_eq!(interrupts, 5);
            assert_eq!(handover.read(old.0).unwrap(), (old.0 + 1, [round; 4]));
        }
    }

    #[test]
    fn numbers_go_on_after_the_last_one() {
        let handover = Handover::<1>::new();
        handover.published.store(u32::MAX, Ordering::Relaxed);
        handover.write([5]);
        assert_eq!(handover.read(u32::MAX).unwrap(), (2, [5]));
    }
}
