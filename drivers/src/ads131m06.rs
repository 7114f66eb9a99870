//! The converter ADS131M06 (Texas Instruments, SBAS949): six channels of 24 bits, sampled at once, for six
//! strain gauges. SPI mode 1, at most 25 MHz. The gauges' supply is its reference, so that its drift has no
//! effect.
//!
//! A frame has eight words of 24 bits both ways. The host sends a command, its value if it has one, and their
//! checksum; the converter sends the answer to the previous command (its status, if there was none), six
//! values, and their checksum. A value that cannot be trusted is reported as an error: a wrong checksum, a
//! restart (the settings are gone), a late conversion, a channel at the end of its range, and one that stands
//! still, which 24 bits never do.
//!
//! No call exchanges more than one frame, so to set the converter up, [`Ads131m06::start`] is called once a
//! period.

use embedded_hal::spi::{Operation, SpiDevice};

/// Channels.
pub const CHANNELS: usize = 6;
/// Values at the ends of the range.
pub const RANGE: (i32, i32) = (-0x80_0000, 0x7F_FFFF);
/// Samples of the modulator for a value: with a clock of 8.192 MHz, 1000 values a second.
pub const OVERSAMPLING: u16 = 4096;
/// This many equal values of a channel in a row are a fault. The noise is larger than a count at each gain.
pub const STANDING: u8 = 8;

const WORD: usize = 3;
const FRAME: usize = (CHANNELS + 2) * WORD;
const CHECKED: usize = FRAME - WORD;

const NULL: u16 = 0x0000;
const RESET: u16 = 0x0011;
const RESET_DONE: u16 = 0xFF26;
const READ: u16 = 0xA000;
const WRITE: u16 = 0x6000;
const WRITTEN: u16 = 0x4000;

const ID: u16 = 0x00;
const MODE: u16 = 0x02;
const CLOCK: u16 = 0x03;
const GAIN1: u16 = 0x04;
const GAIN2: u16 = 0x05;

/// Upper half of ID: six channels.
const SIX_CHANNELS: u16 = 0x26;
/// MODE: checksums of both directions are CCITT's, words have 24 bits, a frame that stops halfway is dropped.
const CHECKED_MODE: u16 = 1 << 12 | 1 << 8 | 1 << 4;
/// CLOCK: all channels on, no crystal (the clock comes from outside), external reference, [`OVERSAMPLING`],
/// high resolution.
#[expect(clippy::cast_possible_truncation, reason = "at most 14")]
const CLOCK_VALUE: u16 = 0x3F << 8 | 1 << 7 | 1 << 6 | (OVERSAMPLING.ilog2() as u16 - 7) << 2 | 2;

/// Status: a command was damaged; the converter restarted; channels with a new value.
const COMMAND_DAMAGED: u16 = 1 << 12;
const RESTARTED: u16 = 1 << 10;
const READY: u16 = 0x3F;

/// Why the converter did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError<E> {
    /// The bus failed.
    Bus(E),
    /// It has no gains yet.
    NoGains,
    /// The answer to the reset or the number of channels was wrong: the answer, 0 when it was damaged.
    Absent(u16),
    /// A register did not keep what was written to it.
    NotKept {
        /// Its address.
        register: u16,
        /// The value that was read back.
        value: u16,
    },
}

/// Why there is no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadError<E> {
    /// The bus failed.
    Bus(E),
    /// The frame is damaged, or the one with the command was.
    Checksum,
    /// It has restarted since [`Ads131m06::start`]: its settings are gone.
    Restarted,
    /// There is no new value yet. A channel that is switched off never has one.
    NotReady,
    /// A channel is at the end of its range.
    Saturated(u8),
    /// A channel stands still.
    Stuck(u8),
}

/// The converter.
#[derive(Debug)]
pub struct Ads131m06<S> {
    spi: S,
    /// Registers and their values; `None` without gains.
    registers: Option<[(u16, u16); 4]>,
    /// Frames of the start that have been exchanged.
    step: u8,
    last: [i32; CHANNELS],
    /// How often each channel's value has repeated.
    repeats: [u8; CHANNELS],
}

impl<S: SpiDevice> Ads131m06<S> {
    /// Creates a converter that is not set up.
    pub const fn new(spi: S) -> Self {
        Self { spi, registers: None, step: 0, last: [0; CHANNELS], repeats: [0; CHANNELS] }
    }

    /// Takes the gain of each channel, a power of two up to 128, as a validated model has it; the converter
    /// must then be started.
    pub fn configure(&mut self, gains: &[u8; CHANNELS]) {
        let [gain1, gain2] = gain_registers(gains);
        self.registers = Some([(MODE, CHECKED_MODE), (CLOCK, CLOCK_VALUE), (GAIN1, gain1), (GAIN2, gain2)]);
        self.step = 0;
    }

    /// Exchanges the next frame of the reset and set-up: eleven in all, at least 5 µs apart. Returns whether
    /// it was the last one. After an error, and after the last one, the next call begins again.
    ///
    /// # Errors
    /// It does not answer as it must.
    pub fn start(&mut self) -> Result<bool, StartError<S::Error>> {
        let step = core::mem::take(&mut self.step);
        let registers = self.registers.ok_or(StartError::NoGains)?;
        let register = |frame: u8| registers.get(usize::from(frame / 2)).copied();
        // Each frame has the answer to the previous one.
        let (command, value) = match step.checked_sub(2) {
            None if step == 0 => (RESET, None),
            None => (READ | ID << 7, None),
            Some(frame) => match register(frame) {
                Some((register, value)) if frame % 2 == 0 => (WRITE | register << 7, Some(value)),
                Some((register, _)) => (READ | register << 7, None),
                None => (NULL, None),
            },
        };
        let answer = self.exchange(command, value).map_err(StartError::Bus)?;
        // A damaged answer counts as none.
        let answer = checked(&answer).unwrap_or(0);
        match step.checked_sub(3) {
            None if step == 0 => {}
            None if step == 1 && answer == RESET_DONE || step == 2 && answer >> 8 == SIX_CHANNELS => {}
            None => return Err(StartError::Absent(answer)),
            Some(frame) => {
                let (register, value) = register(frame).unwrap_or_default();
                let expected = if frame % 2 == 0 { WRITTEN | register << 7 } else { value };
                if answer != expected {
                    return Err(StartError::NotKept { register, value: answer });
                }
            }
        }
        let is_last = command == NULL;
        if is_last {
            self.repeats = [0; CHANNELS];
        } else {
            self.step = step + 1;
        }
        Ok(is_last)
    }

    /// Returns the values of a conversion [counts], of all channels or of none. The converter keeps two
    /// conversions: after a pause, the first one that it gives is old.
    ///
    /// # Errors
    /// A value cannot be trusted.
    pub fn read(&mut self) -> Result<[i32; CHANNELS], ReadError<S::Error>> {
        let frame = self.exchange(NULL, None).map_err(ReadError::Bus)?;
        let Some(status) = checked(&frame) else { return Err(ReadError::Checksum) };
        if status & RESTARTED != 0 {
            return Err(ReadError::Restarted);
        }
        if status & COMMAND_DAMAGED != 0 {
            return Err(ReadError::Checksum);
        }
        if status & READY != READY {
            return Err(ReadError::NotReady);
        }
        let mut values = [0; CHANNELS];
        let (words, _) = frame.as_chunks::<WORD>();
        for (value, &[high, middle, low]) in values.iter_mut().zip(words.iter().skip(1)) {
            *value = i32::from_be_bytes([high, middle, low, 0]) >> 8;
        }
        for ((repeats, last), value) in self.repeats.iter_mut().zip(&mut self.last).zip(&values) {
            *repeats = if last == value { repeats.saturating_add(1) } else { 0 };
            *last = *value;
        }
        let channels = || (0..).zip(values.iter().zip(&self.repeats));
        if let Some((channel, _)) =
            channels().find(|(_, (value, _))| !(RANGE.0 + 1..RANGE.1).contains(*value))
        {
            return Err(ReadError::Saturated(channel));
        }
        if let Some((channel, _)) = channels().find(|(_, (_, repeats))| **repeats >= STANDING - 1) {
            return Err(ReadError::Stuck(channel));
        }
        Ok(values)
    }

    /// Exchanges a frame. The checksum follows the words that it covers; the converter ignores it until it is
    /// set up to check it.
    fn exchange(&mut self, command: u16, value: Option<u16>) -> Result<[u8; FRAME], S::Error> {
        let mut frame = [0; FRAME];
        let (words, _) = frame.as_chunks_mut::<WORD>();
        let mut crc = SEED;
        let mut words = words.iter_mut();
        for (half, word) in [Some(command), value].iter().flatten().zip(words.by_ref()) {
            let [high, low] = half.to_be_bytes();
            *word = [high, low, 0];
            crc = checksum(crc, word);
        }
        if let Some(word) = words.next() {
            let [high, low] = crc.to_be_bytes();
            *word = [high, low, 0];
        }
        self.spi.transaction(&mut [Operation::TransferInPlace(&mut frame)])?;
        Ok(frame)
    }
}

/// Returns the registers of the gains: four bits of a channel, the first lowest.
fn gain_registers(gains: &[u8; CHANNELS]) -> [u16; 2] {
    let mut registers = [0; 2];
    for (register, gains) in registers.iter_mut().zip(gains.chunks(4)) {
        for gain in gains.iter().rev() {
            *register = *register << 4 | u16::from(gain.trailing_zeros().to_le_bytes()[0]);
        }
    }
    registers
}

/// Returns the first half word of a frame, if its checksum is right.
fn checked(frame: &[u8; FRAME]) -> Option<u16> {
    let [high, low] = checksum(SEED, frame.get(..CHECKED)?).to_be_bytes();
    (frame[CHECKED..CHECKED + 2] == [high, low]).then(|| u16::from_be_bytes([frame[0], frame[1]]))
}

const SEED: u16 = 0xFFFF;

/// Computes the CRC-16 of CCITT (x^16 + x^12 + x^5 + 1), a byte at a time.
fn checksum(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| {
        let mut high = crc >> 8 ^ u16::from(byte);
        high ^= high >> 4;
        crc << 8 ^ high << 12 ^ high << 5 ^ high
    })
}

#[cfg(test)]
#[path = "ads131m06_tests.rs"]
mod tests;
