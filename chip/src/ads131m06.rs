//! The converter ADS131M06: frames, registers, checksums, conversions, DRDY. Written from the data sheets of
//! the family (Texas Instruments, SBAS949 and SBAS950), not from the driver.
//!
//! The sheets do not say which of three conversions is lost if none is read; here it is the last one. The
//! filters are not modelled: a conversion shows the inputs at its end.

use std::collections::VecDeque;

use crate::SECOND;
use crate::spi::Sent;

const CHANNELS: usize = 6;
const WORD: usize = 3;
const FRAME: usize = (CHANNELS + 2) * WORD;
/// Fastest clock [Hz].
const FASTEST: u64 = 25_000_000;

const MODE: usize = 2;
const CLOCK: usize = 3;
const GAIN1: usize = 4;
/// Registers after a reset, from ID on; STATUS is composed when it is read.
const DEFAULTS: [u16; 6] = [0x2600, 0, 0x0510, 0x3F0E, 0, 0];
const RESET_FLAG: u16 = 1 << 10;
const CRC_ENABLED: u16 = 1 << 12;
/// Periods of the clock for which DRDY is high before it falls again, when nothing was read.
const HIGH: u64 = 8;

/// Defects of the converter.
#[derive(Clone, Copy, Debug, Default)]
pub struct Defects {
    /// A bit of each frame from the converter is flipped.
    pub damaged: bool,
    /// Its clock has stopped.
    pub stopped: bool,
    /// The cable is unplugged.
    pub unplugged: bool,
    /// This channel's input is no longer connected to the modulator.
    pub standing: Option<usize>,
    /// This channel's input is beyond its range.
    pub beyond: Option<usize>,
}

pub struct Ads131m06 {
    registers: [u16; 6],
    crc_error: bool,
    pub defects: Defects,
    /// Conversions that have not been read.
    unread: VecDeque<[i32; CHANNELS]>,
    last: [i32; CHANNELS],
    /// When the next conversion ends.
    next: u64,
    /// Whether DRDY is high before it falls for the next conversion; `None`: not yet determined.
    pulse: Option<bool>,
    is_selected: bool,
    input: Vec<u8>,
    output: [u8; FRAME],
    /// The answer to the last command; `None`: the status.
    answer: Option<u16>,
    /// Whether the first word of the frame was the status.
    told_status: bool,
    /// Frequency of its clock [Hz].
    clock: u64,
}

impl Default for Ads131m06 {
    fn default() -> Self {
        Self {
            registers: DEFAULTS,
            crc_error: false,
            defects: Defects::default(),
            unread: VecDeque::new(),
            last: [0; CHANNELS],
            next: 0,
            pulse: None,
            is_selected: false,
            input: Vec::new(),
            output: [0; FRAME],
            answer: None,
            told_status: false,
            clock: 8_192_000,
        }
    }
}

impl Ads131m06 {
    /// Resets the converter, as a dip of its supply does.
    pub fn restart(&mut self, now: u64) {
        self.registers = DEFAULTS;
        (self.crc_error, self.answer) = (false, None);
        self.unread.clear();
        self.begin(now);
    }

    fn oversampling(&self) -> u64 {
        128 << (self.registers[CLOCK] >> 2 & 7)
    }

    /// Returns the duration of modulator samples, each of which takes two periods of the clock.
    fn modulator(&self, samples: u64) -> u64 {
        2 * samples * SECOND / self.clock
    }

    /// Restarts the conversions.
    fn begin(&mut self, now: u64) {
        self.next = now + self.modulator(256 + 44 + self.oversampling());
        self.pulse = None;
    }

    /// Returns the next time at which it does something by itself.
    pub fn next(&self) -> u64 {
        let high = HIGH * SECOND / self.clock;
        match self.pulse {
            _ if self.defects.stopped => u64::MAX,
            None => self.next.saturating_sub(high),
            Some(_) => self.next,
        }
    }

    fn is_low(&self) -> bool {
        !self.unread.is_empty() && self.pulse != Some(true)
    }

    /// Returns the level of DRDY; `None` when nothing drives the line.
    pub fn ready_line(&self) -> Option<bool> {
        (!self.defects.unplugged).then(|| !self.is_low())
    }

    /// Performs the conversions up to `now`. `inputs` returns the counts of a channel at a gain of 1; its
    /// first argument is true if the reference is that of the gauges, false for the internal one.
    pub fn advance(&mut self, now: u64, inputs: impl Fn(bool, usize) -> f64) {
        while self.next() <= now {
            if self.pulse.is_none() {
                // Not while conversion data are read.
                self.pulse = Some(self.input.is_empty());
                continue;
            }
            let gain = |channel: usize| self.registers[GAIN1 + channel / 4] >> (4 * (channel % 4)) & 7;
            let is_on = |channel: usize| self.registers[CLOCK] >> (8 + channel) & 1 == 1;
            let external = self.registers[CLOCK] & 1 << 6 != 0;
            let values = std::array::from_fn(|channel| {
                let counts = inputs(external, channel) * f64::from(1 << gain(channel));
                match self.defects {
                    _ if !is_on(channel) => 0,
                    Defects { standing: Some(gauge), .. } if gauge == channel => self.last[channel],
                    Defects { beyond: Some(gauge), .. } if gauge == channel => 0x7F_FFFF,
                    _ => counts.round().clamp(-8_388_608.0, 8_388_607.0) as i32,
                }
            });
            self.last = values;
            if self.unread.len() < 2 {
                self.unread.push_back(values);
            }
            self.pulse = None;
            self.next += self.modulator(self.oversampling());
        }
    }

    fn status(&self) -> u16 {
        let ready = if self.unread.is_empty() { 0 } else { self.registers[CLOCK] >> 8 & 0x3F };
        self.registers[MODE] & (RESET_FLAG | 3 << 8) | u16::from(self.crc_error) << 12 | ready
    }

    /// Sets the select line, which is active low. A command is taken when it rises.
    pub fn select(&mut self, is_low: bool, now: u64) {
        if is_low == self.is_selected {
            return;
        }
        self.is_selected = is_low;
        if is_low {
            self.input.clear();
            self.told_status = self.answer.is_none();
            let first = self.answer.take().unwrap_or(self.status());
            let values = self.unread.front().copied().unwrap_or(self.last);
            self.output = [0; FRAME];
            self.output[..2].copy_from_slice(&first.to_be_bytes());
            for (word, value) in self.output[WORD..].chunks_exact_mut(WORD).zip(values) {
                word.copy_from_slice(&value.to_be_bytes()[1..]);
            }
            let crc = crc(&self.output[..FRAME - WORD]);
            self.output[FRAME - WORD..FRAME - 1].copy_from_slice(&crc.to_be_bytes());
            self.output[10] ^= u8::from(self.defects.damaged) << 4;
        } else if !self.input.is_empty() {
            let input = std::mem::take(&mut self.input);
            self.take(&input, now);
        }
    }

    fn take(&mut self, input: &[u8], now: u64) {
        let half = |word: usize| {
            let bytes = input.get(WORD * word..WORD * word + 2);
            bytes.map_or(0, |bytes| u16::from_be_bytes([bytes[0], bytes[1]]))
        };
        let is_complete = input.len() >= FRAME;
        if is_complete {
            self.unread.pop_front();
        }
        if self.told_status {
            self.crc_error = false;
        }
        let command = half(0);
        let (kind, first) = (command >> 13, usize::from(command >> 7 & 63));
        let more = usize::from(command & 0x7F);
        let checked = if kind == 3 { more + 2 } else { 1 };
        let is_right = self.registers[MODE] & CRC_ENABLED == 0
            || input.get(..WORD * checked).is_some_and(|bytes| half(checked) == crc(bytes));
        if kind == 3 {
            // Also with a wrong checksum.
            let before = self.oversampling();
            for (word, register) in (1..=more + 1).zip(first..) {
                if (MODE..DEFAULTS.len()).contains(&register) {
                    let flag = self.registers[register] & RESET_FLAG;
                    let value = half(word);
                    let is_mode = register == MODE;
                    self.registers[register] =
                        if is_mode { value & !RESET_FLAG | value & flag } else { value };
                }
            }
            if self.oversampling() != before {
                self.begin(now);
            }
            self.answer = Some(2 << 13 | command & 0xFFF);
        } else if is_right && kind == 5 && more == 0 {
            let value = self.registers.get(first).copied().unwrap_or(0);
            self.answer = Some(if first == 1 { self.status() } else { value });
        } else if is_right && command == 0x11 {
            if is_complete {
                self.restart(now);
                self.answer = Some(0xFF26);
            } else {
                self.answer = Some(0x0011);
            }
        }
        if !is_right {
            (self.crc_error, self.answer) = (true, None);
        }
    }

    /// Takes the bits of a word from the master and returns the answer; `None` when the converter does not
    /// answer.
    pub fn exchange(&mut self, sent: &Sent) -> Option<u32> {
        if !self.is_selected || self.defects.unplugged {
            return None;
        }
        let Sent { bits, length, mode, is_high_first, frequency } = *sent;
        let mut answer = 0;
        for byte in (0..length / 8).rev().map(|byte| (bits >> (8 * byte)) as u8) {
            answer = answer << 8 | u32::from(self.output.get(self.input.len()).copied().unwrap_or(0));
            self.input.push(byte);
        }
        // A wrong edge samples bits that are just changing, and so does a clock that is too fast.
        let is_right = mode == 1 && is_high_first && frequency <= FASTEST;
        if !is_right && let Some(last) = self.input.last_mut() {
            *last >>= 1;
        }
        Some(if is_right { answer } else { answer >> 1 })
    }
}

/// Computes the CRC of CCITT, bit by bit.
fn crc(bytes: &[u8]) -> u16 {
    let mut crc = 0xFFFF_u16;
    for byte in bytes {
        crc ^= u16::from(*byte) << 8;
        for _ in 0..8 {
            crc = crc << 1 ^ if crc >> 15 == 1 { 0x1021 } else { 0 };
        }
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends a frame that begins with these words, and returns the answer.
    fn frame(chip: &mut Ads131m06, words: &[u16], now: u64) -> [u16; 8] {
        chip.select(true, now);
        let mut bytes = [0; FRAME];
        for (place, word) in bytes.chunks_exact_mut(WORD).zip(words) {
            place[..2].copy_from_slice(&word.to_be_bytes());
        }
        let back = bytes.map(|byte| {
            let (bits, frequency) = (byte.into(), 10_500_000);
            let sent = Sent { bits, length: 8, mode: 1, is_high_first: true, frequency };
            chip.exchange(&sent).unwrap() as u8
        });
        chip.select(false, now);
        std::array::from_fn(|word| u16::from_be_bytes([back[WORD * word], back[WORD * word + 1]]))
    }

    #[test]
    fn registers_are_written_read_and_reset() {
        let mut chip = Ads131m06::default();
        assert_eq!(frame(&mut chip, &[0x6100, 0x0110], 0)[0], 0x0500, "the status, with the flag of a reset");
        assert_eq!(frame(&mut chip, &[0xA100], 0)[0], 0x4100);
        assert_eq!(frame(&mut chip, &[0], 0)[0], 0x0110);
        assert_eq!(frame(&mut chip, &[0x0011], 0)[0], 0x0100);
        assert_eq!(frame(&mut chip, &[0xA000], 0)[0], 0xFF26);
        assert_eq!(frame(&mut chip, &[0xA180], 0)[0], 0x2600);
        assert_eq!(frame(&mut chip, &[0], 0)[0], 0x3F0E);
    }

    /// Checksums by Python: `binascii.crc_hqx(bytes([0xA1, 0x80, 0]), 0xFFFF)`.
    #[test]
    fn a_damaged_command_is_not_taken_and_told_once() {
        let mut chip = Ads131m06::default();
        frame(&mut chip, &[0x6100, 0x1110, 0x6388], 0);
        frame(&mut chip, &[0xA180, 0x5DA8], 0);
        assert_eq!(frame(&mut chip, &[0xA180, 0x5DA9], 0)[0], 0x3F0E);
        assert_eq!(frame(&mut chip, &[0, 0xCC9C], 0)[0], 0x1100);
        assert_eq!(frame(&mut chip, &[0, 0xCC9C], 0)[0], 0x0100);
    }

    #[test]
    fn two_conversions_are_kept_and_drdy_tells_them() {
        let mut chip = Ads131m06::default();
        chip.restart(0);
        assert_eq!(chip.ready_line(), Some(true));
        // 4000 per second, of which the first one is late.
        let late = 300 * 2 * SECOND / 8_192_000;
        let time = |conversion: u64| late + conversion * SECOND / 4000 + 1000;
        for conversion in 1..4 {
            chip.advance(time(conversion), |_, channel| (10 * conversion) as f64 + channel as f64);
        }
        assert_eq!(chip.ready_line(), Some(false));
        let read = frame(&mut chip, &[0], time(3));
        assert_eq!((read[0], read[1]), (0x053F, 0), "the status; values are lower");
        assert_eq!(chip.unread.front().unwrap()[1], 21);
        frame(&mut chip, &[0], time(3));
        assert_eq!(chip.ready_line(), Some(true));
        assert_eq!(frame(&mut chip, &[0], time(3))[0], 0x0500, "no new one");
        // Nothing was read: DRDY is high for a moment before it falls again.
        chip.advance(time(4), |_, _| 0.0);
        let next = chip.next();
        chip.advance(next, |_, _| 0.0);
        assert_eq!((chip.ready_line(), next < time(5) - 1000), (Some(true), true));
        chip.advance(time(5), |_, _| 0.0);
        assert_eq!(chip.ready_line(), Some(false));
    }
}
