//! The gate driver DRV8301: registers, wake, faults, amplifiers. Written from the data sheet (Texas
//! Instruments, SLOS719), not from the driver.

use crate::SECOND;
use crate::spi::Sent;

/// Time until the chip is awake: less than the allowed 10 ms. `nFAULT` is low meanwhile.
const WAKE: u64 = 9 * SECOND / 1000;
/// Fastest clock [Hz].
const FASTEST: u64 = 10_000_000;

/// Bits of status register 1.
const FAULT: u16 = 1 << 10;

#[derive(Clone, Copy, Debug, Default)]
pub struct Drv8301 {
    /// Time since which `EN_GATE` has been high.
    enabled: Option<u64>,
    control: [u16; 2],
    /// Faults that last until the next reset, as bits of status register 1.
    faults: u16,
    /// Whether it was written to since it woke: it ignores the first write, as some chips were seen to do.
    was_written: bool,
    is_selected: bool,
    /// Received bits since it was selected, their number, and its answer.
    shift: u32,
    bits: u32,
    answer: u16,
    next_answer: u16,
}

impl Drv8301 {
    /// Sets `EN_GATE`: while it is low, everything is forgotten. (Low pulses shorter than 20 µs, which only
    /// clear faults, are not modelled.)
    pub fn enable(&mut self, is_high: bool, now: u64) {
        match (is_high, self.enabled) {
            (true, None) => self.enabled = Some(now),
            (false, _) => *self = Self { is_selected: self.is_selected, ..Self::default() },
            _ => {}
        }
    }

    pub fn is_awake(&self, now: u64) -> bool {
        self.enabled.is_some_and(|since| since + WAKE <= now)
    }

    /// Returns whether it pulls `nFAULT` down.
    pub fn tells_fault(&self, now: u64) -> bool {
        self.enabled.is_some() && (!self.is_awake(now) || self.faults != 0)
    }

    /// Reports an overcurrent in the transistor of a bit of status register 1. With latched shutdown its half
    /// bridge is off.
    pub fn overload(&mut self, bit: u32) {
        self.faults |= 1 << bit | FAULT;
    }

    /// Returns whether a half bridge (0 is A) works.
    pub fn drives(&self, half_bridge: usize, now: u64) -> bool {
        let overloaded = self.faults >> (4 - 2 * half_bridge) & 3 != 0;
        let latches = self.control[0] >> 4 & 3 == 1;
        // With three inputs the low sides' inputs would be ignored; the board is not wired that way.
        let six_inputs = self.control[0] & 1 << 3 == 0;
        self.is_awake(now) && six_inputs && !(overloaded && latches)
    }

    /// Returns the gain of the amplifiers; `None` while they sleep.
    pub fn gain(&self, now: u64) -> Option<f64> {
        self.is_awake(now).then(|| f64::from(10 << (self.control[1] >> 2 & 3)))
    }

    /// Loses the settings, as some chips were seen to do.
    pub fn forget(&mut self) {
        self.control = [0; 2];
    }

    /// Sets the select line, which is active low. A word is taken when it rises.
    pub fn select(&mut self, is_low: bool, now: u64) {
        if is_low == self.is_selected {
            return;
        }
        self.is_selected = is_low;
        if is_low {
            (self.shift, self.bits, self.answer) = (0, 0, self.next_answer);
        } else if self.bits == 16 && self.is_awake(now) {
            self.take(self.shift as u16);
        } else if self.bits != 0 {
            self.next_answer = 1 << 15;
        }
    }

    fn take(&mut self, word: u16) {
        let (address, data) = (word >> 11 & 15, word & 0x7FF);
        let value = match address {
            0 => self.faults,
            1 => 1,
            2 => self.control[0],
            3 => self.control[1],
            _ => 0,
        };
        self.next_answer = address << 11 | value;
        let is_write = word >> 15 == 0 && (2..4).contains(&address);
        if is_write && std::mem::replace(&mut self.was_written, true) {
            self.control[usize::from(address) - 2] = data;
        }
    }

    /// Takes the bits of a word from the master and returns the answer; `None` when the chip is not selected.
    pub fn exchange(&mut self, sent: &Sent, now: u64) -> Option<u32> {
        if !self.is_selected {
            return None;
        }
        let Sent { bits, length, mode, is_high_first, frequency } = *sent;
        let answer = if self.is_awake(now) { u32::from(self.answer) } else { 0 };
        let answer = answer >> 16_u32.saturating_sub(self.bits + length) & ((1 << length) - 1);
        self.bits += length;
        self.shift = self.shift << length | bits;
        // A wrong edge samples bits that are just changing, and so does a clock that is too fast.
        let is_right = mode == 1 && is_high_first && frequency <= FASTEST;
        if !is_right {
            self.shift >>= 1;
        }
        Some(if is_right { answer } else { answer >> 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn word(chip: &mut Drv8301, word: u16, now: u64) -> u16 {
        let sent = |bits: u16| Sent {
            bits: bits.into(),
            length: 8,
            mode: 1,
            is_high_first: true,
            frequency: 5_250_000,
        };
        chip.select(true, now);
        let high = chip.exchange(&sent(word >> 8), now).unwrap();
        let low = chip.exchange(&sent(word & 0xFF), now).unwrap();
        chip.select(false, now);
        (high << 8 | low) as u16
    }

    #[test]
    fn an_answer_comes_with_the_next_word_until_the_enable_line_falls() {
        let mut chip = Drv8301::default();
        chip.enable(true, 0);
        assert!(chip.tells_fault(WAKE - 1) && !chip.tells_fault(WAKE));
        assert_eq!(word(&mut chip, 0x9800, WAKE - 1), 0, "asleep");
        word(&mut chip, 0x180C, WAKE);
        assert_eq!(chip.gain(WAKE), Some(10.0), "the first write");
        word(&mut chip, 0x180C, WAKE);
        word(&mut chip, 0x9800, WAKE);
        assert_eq!(word(&mut chip, 0x8800, WAKE), 0x180C);
        assert_eq!(word(&mut chip, 0x8800, WAKE), 0x0801);
        assert_eq!(chip.gain(WAKE), Some(80.0));
        chip.overload(0);
        // Latched shutdown is not set: the chip only reports the fault.
        assert!(chip.tells_fault(WAKE) && chip.drives(2, WAKE));
        word(&mut chip, 0x1010, WAKE);
        assert!(!chip.drives(2, WAKE) && chip.drives(1, WAKE));
        chip.enable(false, WAKE);
        chip.enable(true, WAKE + 1);
        assert_eq!(chip.gain(2 * WAKE + 1), Some(10.0));
        assert!(!chip.tells_fault(2 * WAKE + 1));
    }
}
