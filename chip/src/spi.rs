//! SPI1 and SPI3 as masters: a word in the shift register, one waiting, and flags.

use crate::SECOND;

const CR1: usize = 0;
const SR: usize = 2;
const DR: usize = 3;

#[derive(Default)]
pub struct Spi {
    registers: [u32; 8],
    waiting: Option<u32>,
    /// The word in the shift register, and when it ends.
    shifting: Option<(u32, u64)>,
    received: Option<u32>,
    overrun: bool,
}

/// A word that has been sent: its bits, and their number.
pub struct Sent {
    pub bits: u32,
    pub length: u32,
    /// SPI mode, 0 to 3; whether the most significant bit comes first; frequency [Hz].
    pub mode: u32,
    pub is_high_first: bool,
    pub frequency: u64,
}

impl Spi {
    fn length(&self) -> u32 {
        if self.registers[CR1] & 1 << 11 == 0 { 8 } else { 16 }
    }

    fn frequency(&self, clock: u64) -> u64 {
        clock >> ((self.registers[CR1] >> 3 & 7) + 1)
    }

    /// Returns whether it is enabled as a master with software slave management.
    fn runs(&self) -> bool {
        let needed = 1 << 6 | 1 << 2;
        self.registers[CR1] & needed == needed && self.registers[CR1] >> 8 & 3 == 3
    }

    fn begin(&mut self, word: u32, from: u64, clock: u64) {
        let time = u64::from(self.length()) * SECOND / self.frequency(clock);
        self.shifting = Some((word, from + time));
    }

    pub fn next(&self) -> u64 {
        self.shifting.map_or(u64::MAX, |(_, end)| end)
    }

    /// Returns the word whose transfer ends by `now`, if any. [`Spi::receive`] must follow.
    pub fn advance(&mut self, now: u64, clock: u64) -> Option<Sent> {
        let (bits, end) = self.shifting.filter(|(_, end)| *end <= now)?;
        self.shifting = None;
        if let Some(word) = self.waiting.take() {
            self.begin(word, end, clock);
        }
        let control = self.registers[CR1];
        Some(Sent {
            bits,
            length: self.length(),
            mode: control & 3,
            is_high_first: control & 1 << 7 == 0,
            frequency: self.frequency(clock),
        })
    }

    pub fn receive(&mut self, bits: u32) {
        self.overrun |= self.received.is_some();
        self.received.get_or_insert(bits);
    }

    pub fn read(&mut self, offset: u32) -> Option<u32> {
        match offset as usize / 4 {
            SR => {
                let busy = self.shifting.is_some();
                let flags = u32::from(self.received.is_some()) | u32::from(self.waiting.is_none()) << 1;
                Some(flags | u32::from(self.overrun) << 6 | u32::from(busy) << 7)
            }
            DR => Some(self.received.take().unwrap_or(0)),
            index => self.registers.get(index).copied(),
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64, clock: u64) -> Option<()> {
        match offset as usize / 4 {
            DR if !self.runs() => {}
            DR => {
                let word = value & ((1 << self.length()) - 1);
                if self.shifting.is_none() {
                    self.begin(word, now, clock);
                } else {
                    self.waiting = Some(word);
                }
            }
            SR => {}
            index => *self.registers.get_mut(index)? = value,
        }
        Some(())
    }
}
