//! The converter ADS131M06 (Texas Instruments, SBAS949): six channels of 24 bits, sampled at once, for six
//! strain gauges. SPI mode 1, at most 25 MHz.
//!
//! A frame has eight words of 24 bits both ways: command and status, six values, checksum. Both sides check
//! the other's; a frame that was damaged changes nothing. What a value cannot be trusted for is an error and
//! never a value: the checksum, a restart (its settings are gone), a conversion that is late, a channel at
//! its end, and one that stands still, which 24 bits never do.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{Operation, SpiDevice};

/// Channels.
pub const CHANNELS: usize = 6;
/// Values of the ends of the range.
pub const RANGE: (i32, i32) = (-0x80_0000, 0x7F_FFFF);
/// So many equal values of a channel in a row are a fault. The noise is larger than a count at each gain.
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
/// CLOCK: all channels on, high resolution.
const ALL_CHANNELS: u16 = 0x3F << 8 | 2;
const EXTERNAL_REFERENCE: u16 = 1 << 6;

/// Status: a command was damaged; it restarted; channels with a new value.
const COMMAND_DAMAGED: u16 = 1 << 12;
const RESTARTED: u16 = 1 << 10;
const READY: u16 = 0x3F;

/// After a reset no frame may begin for five periods of its clock.
const RESET_TIME: u32 = 1000;

/// How it converts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Gain of each channel, a power of two up to 128.
    pub gains: [u8; CHANNELS],
    /// Samples of the modulator for a value, a power of two from 128 to 16 384: with a clock of 8.192 MHz,
    /// 1024 make 4000 values a second.
    pub oversampling: u16,
    /// The gauges' supply is the reference, so that its drift has no effect.
    pub external_reference: bool,
}

/// Why it did not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError<E> {
    /// The bus failed.
    Bus(E),
    /// This gain of a channel does not exist.
    Gain {
        /// The channel.
        channel: u8,
        /// Its gain.
        gain: u8,
    },
    /// This oversampling does not exist.
    Oversampling(u16),
    /// It did not answer the reset as it must, or has another number of channels: what it said.
    Absent(u16),
    /// A register did not keep what was written to it.
    NotKept {
        /// Its address.
        register: u16,
        /// What it holds.
        value: u16,
    },
}

/// Why there is no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadError<E> {
    /// The bus failed.
    Bus(E),
    /// The frame is damaged, or that with the command was.
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
    last: [i32; CHANNELS],
    /// How often each channel's value has repeated.
    repeats: [u8; CHANNELS],
}

impl<S: SpiDevice> Ads131m06<S> {
    /// Resets it and sets it up.
    ///
    /// # Errors
    /// A setting that it does not have, or it does not answer as it must.
    pub fn start(
        spi: S,
        delay: &mut impl DelayNs,
        settings: &Settings,
    ) -> Result<Self, StartError<S::Error>> {
        let [gain1, gain2] = settings.gain_registers()?;
        let clock = settings.clock_register()?;
        let mut this = Self { spi, last: [0; CHANNELS], repeats: [0; CHANNELS] };
        this.exchange(RESET, 0).map_err(StartError::Bus)?;
        delay.delay_us(RESET_TIME);
        let answer = this.ask(NULL)?;
        if answer != RESET_DONE {
            return Err(StartError::Absent(answer));
        }
        let id = this.ask_register(ID)?;
        if id >> 8 != SIX_CHANNELS {
            return Err(StartError::Absent(id));
        }
        for (register, value) in [(MODE, CHECKED_MODE), (CLOCK, clock), (GAIN1, gain1), (GAIN2, gain2)] {
            this.exchange(WRITE | register << 7, value).map_err(StartError::Bus)?;
            let answer = this.ask(NULL)?;
            let kept = this.ask_register(register)?;
            if answer != WRITTEN | register << 7 || kept != value {
                return Err(StartError::NotKept { register, value: kept });
            }
        }
        Ok(this)
    }

    /// The values of the last conversion [counts], of all channels or none.
    ///
    /// # Errors
    /// A value cannot be trusted.
    pub fn read(&mut self) -> Result<[i32; CHANNELS], ReadError<S::Error>> {
        let frame = self.exchange(NULL, 0).map_err(ReadError::Bus)?;
        let Some(status) = checked(&frame) else { return Err(ReadError::Checksum) };
        if status & COMMAND_DAMAGED != 0 {
            return Err(ReadError::Checksum);
        }
        if status & RESTARTED != 0 {
            return Err(ReadError::Restarted);
        }
        if status & READY != READY {
            return Err(ReadError::NotReady);
        }
        let mut values = [0; CHANNELS];
        let (words, _) = frame.as_chunks::<WORD>();
        for (value, &[high, middle, low]) in values.iter_mut().zip(words.iter().skip(1)) {
            *value = i32::from_be_bytes([high, middle, low, 0]) >> 8;
        }
        for ((repeats, last), value) in self.repeats.iter_mut().zip(&mut self.last).zip(values) {
            *repeats = if *last == value { repeats.saturating_add(1) } else { 0 };
            *last = value;
        }
        let channels = || (0..).zip(values.iter().zip(&self.repeats));
        if let Some((channel, _)) =
            channels().find(|(_, (value, _))| !(RANGE.0 + 1..RANGE.1).contains(*value))
        {
            return Err(ReadError::Saturated(channel));
        }
        if let Some((channel, _)) = channels().find(|(_, (_, repeats))| **repeats + 1 >= STANDING) {
            return Err(ReadError::Stuck(channel));
        }
        Ok(values)
    }

    fn ask_register(&mut self, register: u16) -> Result<u16, StartError<S::Error>> {
        self.exchange(READ | register << 7, 0).map_err(StartError::Bus)?;
        self.ask(NULL)
    }

    /// The answer to the command of the frame before.
    fn ask(&mut self, command: u16) -> Result<u16, StartError<S::Error>> {
        let frame = self.exchange(command, 0).map_err(StartError::Bus)?;
        // A damaged answer is none.
        Ok(checked(&frame).unwrap_or(0))
    }

    /// A frame both ways.
    fn exchange(&mut self, command: u16, value: u16) -> Result<[u8; FRAME], S::Error> {
        let mut frame = [0; FRAME];
        let (words, _) = frame.as_chunks_mut::<WORD>();
        for (word, half) in words.iter_mut().zip([command, value]) {
            let [high, low] = half.to_be_bytes();
            *word = [high, low, 0];
        }
        // Until it is told to check them, it ignores them.
        let [high, low] = checksum(&frame).to_be_bytes();
        [frame[CHECKED], frame[CHECKED + 1]] = [high, low];
        self.spi.transaction(&mut [Operation::TransferInPlace(&mut frame)])?;
        Ok(frame)
    }
}

impl Settings {
    fn gain_registers<E>(&self) -> Result<[u16; 2], StartError<E>> {
        let mut registers = [0; 2];
        for (channel, &gain) in (0_u8..).zip(&self.gains) {
            if !gain.is_power_of_two() {
                return Err(StartError::Gain { channel, gain });
            }
            let bits = u16::from(gain.trailing_zeros().to_le_bytes()[0]);
            registers[usize::from(channel / 4)] |= bits << (4 * (channel % 4));
        }
        Ok(registers)
    }

    fn clock_register<E>(&self) -> Result<u16, StartError<E>> {
        let Self { oversampling, external_reference, .. } = *self;
        if !oversampling.is_power_of_two() || !(128..=16_384).contains(&oversampling) {
            return Err(StartError::Oversampling(oversampling));
        }
        let rate = u16::from(oversampling.trailing_zeros().to_le_bytes()[0]) - 7;
        Ok(ALL_CHANNELS | rate << 2 | if external_reference { EXTERNAL_REFERENCE } else { 0 })
    }
}

/// The first half word of a frame whose checksum is right.
fn checked(frame: &[u8; FRAME]) -> Option<u16> {
    let [high, low] = checksum(frame).to_be_bytes();
    (frame[CHECKED..CHECKED + 2] == [high, low]).then(|| u16::from_be_bytes([frame[0], frame[1]]))
}

/// CRC-16 of CCITT over all words but the last.
fn checksum(frame: &[u8; FRAME]) -> u16 {
    let mut crc = 0xFFFF_u16;
    for &byte in frame.iter().take(CHECKED) {
        crc ^= u16::from(byte) << 8;
        for _ in 0..8 {
            crc = crc << 1 ^ if crc >> 15 == 1 { 0x1021 } else { 0 };
        }
    }
    crc
}

#[cfg(test)]
#[path = "ads131m06_tests.rs"]
mod tests;
