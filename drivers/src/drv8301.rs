//! The gate driver DRV8301 (Texas Instruments, SLOS719): six gates of three half bridges, and amplifiers for
//! the shunts of two of them. SPI mode 1, at most 10 MHz.
//!
//! A word has 16 bits both ways; the answer to a command comes with the next word, and the chip takes a
//! command when its select line rises. It protects the transistors by monitoring their voltage while they
//! conduct. It loses its settings whenever `EN_GATE` is low for longer, and some chips were seen to lose them
//! while a motor runs: then the amplifiers have another gain and the currents are measured wrongly. So
//! [`Drv8301::check`] reads the settings repeatedly.

use embedded_hal::spi::{Operation, SpiDevice};

/// A longer low pulse of `EN_GATE` is a complete reset [µs]; a shorter one only clears latched faults.
pub const RESET_TIME: f32 = 20.0;
/// Maximum time from `EN_GATE` high until the chip works and answers [µs].
pub const WAKE_TIME: f32 = 10_000.0;
/// The amplifiers' outputs reach this far to both sides of the middle [V], with a reference of 3.3 V.
pub const AMPLIFIER_SWING: f32 = 1.35;

const READ: u16 = 1 << 15;
/// In an answer: the previous command had a wrong length.
const FRAME_FAULT: u16 = 1 << 15;
const DATA: u16 = 0x7FF;

/// Addresses.
const STATUS_1: u8 = 0;
const STATUS_2: u8 = 1;
const CONTROL_1: u8 = 2;
const CONTROL_2: u8 = 3;

/// CONTROL_1: an overcurrent (too much voltage across a transistor) switches its half bridge off until the
/// next reset.
const LATCHED_SHUTDOWN: u16 = 1 << 4;
/// STATUS_1: a warning that is no fault.
const TEMPERATURE_WARNING: u16 = 1 << 6;
/// STATUS_2.
const GATE_SUPPLY_HIGH: u16 = 1 << 7;

/// Gain of the amplifiers [V/V].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gain {
    /// 10.
    Ten = 0,
    /// 20.
    Twenty = 1,
    /// 40.
    Forty = 2,
    /// 80.
    Eighty = 3,
}

impl Gain {
    /// Returns the gain [V/V].
    pub const fn factor(self) -> f32 {
        match self {
            Self::Ten => 10.0,
            Self::Twenty => 20.0,
            Self::Forty => 40.0,
            Self::Eighty => 80.0,
        }
    }
}

/// Peak current into the gates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GateCurrent {
    /// 1.7 A.
    High = 0,
    /// 0.7 A.
    Medium = 1,
    /// 0.25 A.
    Low = 2,
}

/// Settings of the chip. Fixed: six inputs, and a half bridge with an overcurrent stays off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Peak current into the gates.
    pub gate_current: GateCurrent,
    /// Row, 0 to 31, of the table of voltages across a conducting transistor that are an overcurrent: row 0
    /// is 0.060 V, 12 is 0.250 V, 31 is 2.4 V.
    pub overcurrent: u8,
    /// Gain of both amplifiers.
    pub gain: Gain,
}

impl Settings {
    /// Returns the two control registers.
    const fn registers(self) -> [u16; 2] {
        let overcurrent = (self.overcurrent & 31) as u16;
        [self.gate_current as u16 | LATCHED_SHUTDOWN | overcurrent << 6, (self.gain as u16) << 2]
    }
}

/// Current measurement by shunts, amplifiers and a converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShuntSense {
    /// Resistance of a shunt [Ω].
    pub shunt: f32,
    /// Gain of the amplifier.
    pub gain: Gain,
    /// Full scale of the converter [V].
    pub reference: f32,
    /// Counts of full scale.
    pub counts: u16,
}

impl ShuntSense {
    /// Returns the current per count [A].
    pub fn resolution(&self) -> f32 {
        self.reference / f32::from(self.counts) / (self.gain.factor() * self.shunt)
    }

    /// Returns the current at which an amplifier saturates [A].
    pub const fn range(&self) -> f32 {
        AMPLIFIER_SWING / (self.gain.factor() * self.shunt)
    }

    /// Returns whether an amplifier that gives so many counts is not saturated.
    pub const fn is_linear(&self, counts: u16) -> bool {
        const MARGIN: f32 = 0.98;
        let range = MARGIN * AMPLIFIER_SWING / self.reference * self.counts as f32;
        (counts.abs_diff(self.counts / 2 + 1) as f32) < range
    }
}

/// Why a gate driver must not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error<E> {
    /// The bus failed.
    Bus(E),
    /// The word is no answer to a query of the register: the chip is asleep, or a line is broken.
    NoAnswer {
        /// Its address.
        register: u8,
        /// The received word.
        word: u16,
    },
    /// A control register does not hold the value written to it.
    NotKept {
        /// Its address.
        register: u8,
        /// Its value.
        value: u16,
    },
    /// The chip reports a fault: its two status registers.
    Fault([u16; 2]),
}

/// How often the first register is written after the chip has woken: some chips were seen to ignore the first
/// write.
const FIRST_WRITES: u8 = 5;

/// A gate driver.
#[derive(Debug)]
pub struct Drv8301<S> {
    spi: S,
    control: [u16; 2],
}

impl<S: SpiDevice> Drv8301<S> {
    /// Creates a gate driver with these settings, which are not written yet.
    pub const fn new(spi: S, settings: Settings) -> Self {
        Self { spi, control: settings.registers() }
    }

    /// Writes the settings and reads them back. The chip must be awake.
    ///
    /// # Errors
    /// Why the gate driver must not be used.
    pub fn set_up(&mut self) -> Result<(), Error<S::Error>> {
        let [first, second] = self.control;
        for _ in 0..FIRST_WRITES {
            self.exchange(u16::from(CONTROL_1) << 11 | first)?;
        }
        self.exchange(u16::from(CONTROL_2) << 11 | second)?;
        self.check()
    }

    /// Checks that the chip still has its settings and no fault. This takes five words and clears the status
    /// registers. What it says of its settings may have been disturbed, by motors that switch nearby, and is
    /// asked for again once.
    ///
    /// # Errors
    /// Why the gate driver must not be used.
    pub fn check(&mut self) -> Result<(), Error<S::Error>> {
        match self.read_back() {
            // Not what it says of its faults: they are cleared now.
            Err(Error::NoAnswer { register: CONTROL_1 | CONTROL_2, .. } | Error::NotKept { .. }) => {
                self.read_back()
            }
            result => result,
        }
    }

    fn read_back(&mut self) -> Result<(), Error<S::Error>> {
        self.exchange(READ | u16::from(STATUS_1) << 11)?;
        let status = [self.answer(STATUS_1, STATUS_2)?, self.answer(STATUS_2, CONTROL_1)?];
        if status[0] & !TEMPERATURE_WARNING != 0 || status[1] & GATE_SUPPLY_HIGH != 0 {
            return Err(Error::Fault(status));
        }
        let [first, second] = self.control;
        // The answer to each query comes with the next one; the last query is repeated to get its answer.
        for (register, next, expected) in [(CONTROL_1, CONTROL_2, first), (CONTROL_2, CONTROL_2, second)] {
            let value = self.answer(register, next)?;
            if value != expected {
                return Err(Error::NotKept { register, value });
            }
        }
        Ok(())
    }

    /// Returns what the chip answers to the query of a register, and asks for the `next` one.
    fn answer(&mut self, register: u8, next: u8) -> Result<u16, Error<S::Error>> {
        let word = self.exchange(READ | u16::from(next) << 11)?;
        if word & FRAME_FAULT != 0 || word >> 11 != register.into() {
            return Err(Error::NoAnswer { register, word });
        }
        Ok(word & DATA)
    }

    /// Exchanges a word.
    fn exchange(&mut self, word: u16) -> Result<u16, Error<S::Error>> {
        let mut bytes = word.to_be_bytes();
        self.spi.transaction(&mut [Operation::TransferInPlace(&mut bytes)]).map_err(Error::Bus)?;
        Ok(u16::from_be_bytes(bytes))
    }
}

#[cfg(test)]
#[path = "drv8301_tests.rs"]
mod tests;
