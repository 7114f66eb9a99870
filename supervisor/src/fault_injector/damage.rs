use std::fmt;
use std::ops::Add;

use tesaki_rng::Rng;

use super::LinkFaults;

/// Number of injected faults, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// Received bytes.
    pub bytes: u64,
    /// Received frames, counted by their zeros.
    pub frames: u64,
    /// Bytes lost individually, not by splices.
    pub dropped: u64,
    /// Bytes with a flipped bit.
    pub flipped: u64,
    /// Places where two frames were spliced.
    pub spliced: u64,
    /// Frames that were sent twice.
    pub duplicated: u64,
    /// Chunks that were delayed.
    pub delayed: u64,
    /// Stalls of the line.
    pub stalled: u64,
}

impl Injected {
    /// Number of faults of all kinds.
    pub const fn total(&self) -> u64 {
        self.dropped + self.flipped + self.spliced + self.duplicated + self.delayed + self.stalled
    }
}

impl Add for Injected {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            frames: self.frames + other.frames,
            dropped: self.dropped + other.dropped,
            flipped: self.flipped + other.flipped,
            spliced: self.spliced + other.spliced,
            duplicated: self.duplicated + other.duplicated,
            delayed: self.delayed + other.delayed,
            stalled: self.stalled + other.stalled,
        }
    }
}

impl fmt::Display for Injected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, frames, dropped, flipped, spliced, duplicated, delayed, stalled } = self;
        write!(
            f,
            "{frames} frames ({bytes} bytes): {dropped} bytes dropped, {flipped} flipped, {spliced} frames spliced, \
             {duplicated} duplicated, {delayed} chunks delayed, {stalled} stalls"
        )
    }
}

/// A longer frame does not belong to any protocol here, and is not repeated.
const LONGEST: usize = 512;

/// State of a splice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Splice {
    /// Nothing.
    None,
    /// Starts after this many more bytes, at the latest at the zero.
    Before(u32),
    /// Drops the bytes up to the zero.
    Tail,
    /// Drops this many more bytes after the zero.
    Head(u32),
}

/// Damages the bytes of one direction of a line. It does not depend on time, so that tests can send millions
/// of frames; with the same seed, the same bytes yield the same result, however they are divided into chunks.
#[derive(Clone, Debug)]
pub struct Damage {
    faults: LinkFaults,
    rng: Rng,
    splice: Splice,
    /// Number of bytes of the present frame so far.
    length: u32,
    /// Length of the previous frame, by which the positions of splices are chosen: the end of the present one
    /// is not known, and waiting for it would delay the line.
    usual: u32,
    /// Bytes sent since the last zero that was sent.
    frame: Vec<u8>,
    injected: Injected,
}

impl Damage {
    /// Creates the damage of direction number `direction` of a line, with separate random numbers for each.
    pub fn new(faults: &LinkFaults, direction: u64) -> Self {
        let mut damage = Self {
            rng: Rng::new(faults.seed, direction),
            faults: faults.clone(),
            splice: Splice::None,
            length: 0,
            usual: 1,
            frame: Vec::with_capacity(LONGEST),
            injected: Injected::default(),
        };
        damage.plan_splice();
        damage
    }

    /// Damages `bytes` and appends the result to `out`.
    pub fn pass(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        for &byte in bytes {
            self.injected.bytes += 1;
            self.length = self.length.saturating_add(1);
            let kept = self.splice(byte);
            if byte == 0 {
                self.injected.frames += 1;
                self.usual = std::mem::take(&mut self.length);
                if self.splice == Splice::None {
                    self.plan_splice();
                }
            }
            if kept {
                self.pass_byte(byte, out);
            }
        }
    }

    /// The faults injected so far.
    pub const fn injected(&self) -> Injected {
        self.injected
    }

    /// Decides at the start of a frame whether its end will be lost.
    fn plan_splice(&mut self) {
        let (will, position) = (self.rng.chance(self.faults.splice), self.rng.below(self.usual));
        self.splice = if will { Splice::Before(position) } else { Splice::None };
    }

    /// Returns whether the splices let this byte pass.
    fn splice(&mut self, byte: u8) -> bool {
        if let Splice::Before(left) = self.splice {
            if left > 0 && byte != 0 {
                self.splice = Splice::Before(left - 1);
                return true;
            }
            self.splice = Splice::Tail;
        }
        match self.splice {
            Splice::Tail if byte == 0 => {
                self.injected.spliced += 1;
                self.splice = match self.rng.below(self.length) {
                    0 => Splice::None,
                    head => Splice::Head(head),
                };
                false
            }
            Splice::Tail => false,
            Splice::Head(left) => {
                self.splice = if left > 1 { Splice::Head(left - 1) } else { Splice::None };
                false
            }
            Splice::None | Splice::Before(_) => true,
        }
    }

    fn pass_byte(&mut self, byte: u8, out: &mut Vec<u8>) {
        // One draw decides: a byte is either lost or flipped.
        let draw = self.rng.uniform();
        let byte = if draw < self.faults.drop {
            self.injected.dropped += 1;
            return;
        } else if draw < self.faults.drop + self.faults.flip {
            self.injected.flipped += 1;
            byte ^ (1 << self.rng.below(8))
        } else {
            byte
        };
        out.push(byte);
        if self.frame.len() <= LONGEST {
            self.frame.push(byte);
        }
        if byte == 0 {
            // A lone zero is padding; repeating it would have no effect.
            let whole = (2..=LONGEST).contains(&self.frame.len());
            if whole && self.rng.chance(self.faults.duplicate) {
                self.injected.duplicated += 1;
                out.extend_from_slice(&self.frame);
            }
            self.frame.clear();
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Creates frames of 20 bytes, each with a single repeated letter.
    fn stream(frames: usize) -> Vec<u8> {
        (1..=250).cycle().take(frames).flat_map(|letter| [[letter; 19].as_slice(), &[0]].concat()).collect()
    }

    fn passed(faults: &str, bytes: &[u8]) -> (Vec<u8>, Injected) {
        let mut damage = Damage::new(&faults.parse().unwrap(), 0);
        let mut out = Vec::new();
        damage.pass(bytes, &mut out);
        (out, damage.injected())
    }

    /// Returns whether a count is within five standard deviations of its expected value.
    fn is_about(count: u64, of: f64, probability: f64) -> bool {
        let deviation = f64::sqrt(of * probability * (1.0 - probability));
        (f64::from(u32::try_from(count).unwrap()) - of * probability).abs() < 5.0 * deviation
    }

    #[test]
    fn a_perfect_line_changes_nothing() {
        let bytes = stream(100);
        let (out, injected) = passed("", &bytes);
        assert_eq!(out, bytes);
        assert_eq!(injected, Injected { bytes: 2000, frames: 100, ..Injected::default() });
    }

    #[test]
    fn the_seed_and_the_bytes_decide_and_not_the_pieces() {
        let bytes = stream(5000);
        let (out, injected) = passed("seed=1,all=0.01", &bytes);
        for size in [1, 7, 64] {
            let mut damage = Damage::new(&"seed=1,all=0.01".parse().unwrap(), 0);
            let mut pieces = Vec::new();
            bytes.chunks(size).for_each(|piece| damage.pass(piece, &mut pieces));
            assert!(pieces == out, "pieces of {size}");
            assert_eq!(damage.injected(), injected);
        }
        assert_ne!(passed("seed=2,all=0.01", &bytes).0, out);
        let mut other = Damage::new(&"seed=1,all=0.01".parse().unwrap(), 1);
        let mut pieces = Vec::new();
        other.pass(&bytes, &mut pieces);
        assert_ne!(pieces, out);
    }

    #[test]
    fn each_kind_is_as_frequent_as_asked_and_does_what_it_says() {
        let bytes = stream(20_000);
        let length = bytes.len();
        let (out, injected) = passed("drop=0.01", &bytes);
        assert!(is_about(injected.dropped, 400_000.0, 0.01), "{injected}");
        assert_eq!((length - out.len()) as u64, injected.total());

        let (out, injected) = passed("flip=0.01", &bytes);
        assert!(is_about(injected.flipped, 400_000.0, 0.01), "{injected}");
        let differing = bytes.iter().zip(&out).filter(|(one, other)| one != other);
        assert!(differing.clone().all(|(one, other)| (one ^ other).count_ones() == 1));
        assert_eq!((out.len(), differing.count() as u64), (length, injected.total()));

        let (out, injected) = passed("duplicate=0.1", &bytes);
        assert!(is_about(injected.duplicated, 20_000.0, 0.1), "{injected}");
        assert_eq!(out.len() as u64, length as u64 + 20 * injected.total());
        let mut once: Vec<_> = out.split(|&byte| byte == 0).collect();
        once.dedup();
        assert_eq!(once.len(), 20_001); // the one behind the last zero is empty
    }

    #[test]
    fn a_splice_takes_a_run_of_bytes_with_a_zero() {
        let bytes = stream(20_000);
        let (out, injected) = passed("splice=0.1", &bytes);
        // After a frame that lost its head, no splice is planned, so there are fewer than one in ten.
        assert!((1700..=2000).contains(&injected.spliced), "{injected}");
        let zeros = out.iter().filter(|&&byte| byte == 0).count() as u64;
        assert_eq!(20_000 - zeros, injected.spliced);
        // The remaining bytes run from one frame into the next, in many different lengths.
        let mixed: Vec<_> = out
            .split(|&byte| byte == 0)
            .filter(|frame| frame.first() != frame.last())
            .map(<[u8]>::len)
            .collect();
        assert!(mixed.len() > 1500, "{}", mixed.len());
        for length in [3, 10, 20, 30] {
            assert!(mixed.contains(&length), "none of {length}");
        }
    }
}
