use std::collections::VecDeque;
use std::io;
use std::time::Instant;

use tesaki_rng::Rng;

use super::{Damage, Injected, LinkFaults};
use crate::ByteLink;

/// One direction: damaged bytes and their arrival times.
#[derive(Debug)]
struct Direction {
    damage: Damage,
    /// Separate from the damage's random numbers, so that the damage does not depend on how the bytes are
    /// divided into chunks.
    rng: Rng,
    /// In the order of sending: a late chunk holds up those behind it.
    chunks: VecDeque<(Instant, Vec<u8>)>,
    delayed: u64,
    stalled: u64,
}

impl Direction {
    fn new(faults: &LinkFaults, direction: u64) -> Self {
        Self {
            damage: Damage::new(faults, direction),
            rng: Rng::new(faults.seed, direction + 2),
            chunks: VecDeque::new(),
            delayed: 0,
            stalled: 0,
        }
    }

    /// Takes a chunk that is sent now.
    fn push(&mut self, bytes: &[u8], faults: &LinkFaults) {
        let mut due = Instant::now();
        // All numbers are always drawn, so that the faults of one chunk do not affect the draws for the next.
        let (delayed, fraction) = (self.rng.chance(faults.delay.probability), self.rng.uniform());
        let stalled = self.rng.chance(faults.stall.probability);
        if delayed {
            self.delayed += 1;
            due += faults.delay.duration.mul_f64(fraction);
        }
        if stalled {
            self.stalled += 1;
            due += faults.stall.duration;
        }
        let mut out = Vec::with_capacity(bytes.len());
        self.damage.pass(bytes, &mut out);
        if !out.is_empty() {
            self.chunks.push_back((due, out));
        }
    }

    /// Arrival time of the next chunk.
    fn due(&self) -> Option<Instant> {
        self.chunks.front().map(|(due, _)| *due)
    }

    /// Returns the next chunk, if it has arrived.
    fn ready(&mut self) -> Option<&mut Vec<u8>> {
        let now = Instant::now();
        self.chunks.front_mut().filter(|(due, _)| *due <= now).map(|(_, bytes)| bytes)
    }

    fn injected(&self) -> Injected {
        Injected { delayed: self.delayed, stalled: self.stalled, ..self.damage.injected() }
    }
}

/// A link that damages the bytes that pass through it, independently in each direction.
///
/// The faults are determined by the seed, the bytes and, for delays and stalls, the calls. As nothing runs
/// between calls, delayed bytes leave in the first call after they are due; a caller that waits for an answer
/// makes such calls.
#[derive(Debug)]
pub struct FaultyLink<L> {
    link: L,
    faults: LinkFaults,
    outward: Direction,
    inward: Direction,
}

impl<L: ByteLink> FaultyLink<L> {
    /// Wraps `link` with these faults.
    pub fn new(link: L, faults: LinkFaults) -> Self {
        Self { outward: Direction::new(&faults, 0), inward: Direction::new(&faults, 1), link, faults }
    }

    /// Faults of sent bytes.
    pub fn sent(&self) -> Injected {
        self.outward.injected()
    }

    /// Faults of received bytes.
    pub fn received(&self) -> Injected {
        self.inward.injected()
    }

    /// Faults in both directions.
    pub fn injected(&self) -> Injected {
        self.sent() + self.received()
    }

    /// The wrapped link.
    pub const fn get_ref(&self) -> &L {
        &self.link
    }

    /// The wrapped link.
    pub const fn get_mut(&mut self) -> &mut L {
        &mut self.link
    }

    fn flush(&mut self) -> io::Result<()> {
        while let Some(bytes) = self.outward.ready() {
            let bytes = std::mem::take(bytes);
            self.outward.chunks.pop_front();
            self.link.send(&bytes)?;
        }
        Ok(())
    }
}

impl<L: ByteLink> ByteLink for FaultyLink<L> {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.outward.push(bytes, &self.faults);
        self.flush()
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            self.flush()?;
            if let Some(bytes) = self.inward.ready() {
                let length = bytes.len().min(buffer.len());
                for (slot, byte) in buffer.iter_mut().zip(bytes.drain(..length)) {
                    *slot = byte;
                }
                if bytes.is_empty() {
                    self.inward.chunks.pop_front();
                }
                return Ok(length);
            }
            let wakes = [self.inward.due(), self.outward.due()];
            let wake = wakes.into_iter().flatten().fold(deadline, Instant::min);
            // Uses the caller's buffer, because there is no other; the bytes go through the queue.
            let length = self.link.receive(buffer, wake)?;
            if let Some(bytes) = buffer.get(..length).filter(|bytes| !bytes.is_empty()) {
                self.inward.push(bytes, &self.faults);
            } else if Instant::now() >= deadline && self.inward.due().is_none_or(|due| due > Instant::now()) {
                return Ok(0);
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use std::thread;
    use std::time::Duration;

    /// A link that returns the bytes that are sent.
    #[derive(Default)]
    struct Echo(VecDeque<u8>);

    impl ByteLink for Echo {
        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.0.extend(bytes);
            Ok(())
        }

        fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
            let length = self.0.len().min(buffer.len());
            if length == 0 {
                thread::sleep(deadline.saturating_duration_since(Instant::now()));
            }
            for (slot, byte) in buffer.iter_mut().zip(self.0.drain(..length)) {
                *slot = byte;
            }
            Ok(length)
        }
    }

    fn link(faults: &str) -> FaultyLink<Echo> {
        FaultyLink::new(Echo::default(), faults.parse().unwrap())
    }

    /// Sends frames; returns the bytes that come back within the given milliseconds, and the time until the
    /// last did.
    fn echoed(link: &mut FaultyLink<Echo>, frames: u8, milliseconds: u64) -> (Vec<u8>, Duration) {
        let start = Instant::now();
        let deadline = start + Duration::from_millis(milliseconds);
        (1..=frames).for_each(|frame| link.send(&[frame, frame, frame, 0]).unwrap());
        let (mut received, mut last) = (Vec::new(), Duration::ZERO);
        let mut buffer = [0; 5];
        loop {
            match link.receive(&mut buffer, deadline).unwrap() {
                0 => return (received, last),
                length => received.extend(&buffer[..length]),
            }
            last = start.elapsed();
        }
    }

    #[test]
    fn the_same_calls_meet_the_same_faults_and_both_directions_others() {
        let faults = "seed=5,drop=0.05,flip=0.05,splice=0.05,duplicate=0.05";
        let (mut one, mut two) = (link(faults), link(faults));
        let (first, second) = (echoed(&mut one, 250, 20).0, echoed(&mut two, 250, 20).0);
        assert_eq!(first, second);
        assert_eq!((one.sent(), one.received()), (two.sent(), two.received()));
        assert_ne!(one.sent(), one.received());
        let all = one.injected();
        assert!(
            [all.dropped, all.flipped, all.spliced, all.duplicated].iter().all(|&count| count > 10),
            "{all}"
        );
    }

    #[test]
    fn what_does_not_fit_the_buffer_comes_with_the_next_call() {
        let (received, _) = echoed(&mut link("duplicate=1"), 2, 50);
        let expected: Vec<u8> =
            [1, 1, 1, 1, 2, 2, 2, 2].iter().flat_map(|&frame| [frame, frame, frame, 0]).collect();
        assert_eq!(received, expected);
    }

    #[test]
    fn delays_keep_the_order_and_the_limit() {
        let mut link = link("seed=1,delay=40ms@0.5");
        let (received, last) = echoed(&mut link, 50, 500);
        let expected: Vec<u8> = (1..=50).flat_map(|frame| [frame, frame, frame, 0]).collect();
        assert_eq!(received, expected);
        let injected = link.injected();
        assert!((10..=40).contains(&link.sent().delayed), "{injected}");
        assert!(last > Duration::from_millis(30) && last < Duration::from_millis(200), "{last:?}");
    }

    #[test]
    fn a_stall_is_silence_and_then_everything() {
        let mut link = link("stall=100ms@1");
        let start = Instant::now();
        link.send(&[9, 0]).unwrap();
        let mut buffer = [0; 8];
        assert_eq!(link.receive(&mut buffer, start + Duration::from_millis(50)).unwrap(), 0);
        assert_eq!(link.receive(&mut buffer, start + Duration::from_secs(2)).unwrap(), 2);
        assert!(start.elapsed() >= Duration::from_millis(200)); // one in each direction
        assert_eq!(link.injected().stalled, 2);
    }
}
