//! SPI to a few devices: short words, bounded waits, select lines.

use core::marker::PhantomData;

use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::rcc::{Enable, Reset};

use crate::pac;
use pac::{RCC, spi1};

/// Maximum number of polls for a byte, some 20 µs; a byte takes at most 1.5 µs.
const POLLS: u32 = 500;
/// Minimum time for which a select line is high, and from its falling edge to the first clock [cycles]: 0.6
/// µs.
const PAUSE: u32 = 100;
/// MSTR, SSM and SSI; CPHA, which is mode 1; BR: an eighth of the bus.
const MODE_1: u16 = 1 << 2 | 1 << 9 | 1 << 8 | 1 | 0b010 << 3;

/// A peripheral, and the port of the select lines.
pub trait Bus {
    /// The peripheral.
    type Spi: Enable + Reset;

    /// Returns its registers.
    ///
    /// # Safety
    /// Nothing else uses the peripheral meanwhile.
    unsafe fn registers() -> &'static spi1::RegisterBlock;

    /// Writes the set and reset register of the port.
    ///
    /// # Safety
    /// The bits are those of select lines of the caller.
    unsafe fn select(bits: u32);
}

/// SPI1 at 10.5 MHz, with select lines on port A.
pub struct Spi1OnA;

impl Bus for Spi1OnA {
    type Spi = pac::SPI1;

    unsafe fn registers() -> &'static spi1::RegisterBlock {
        // SAFETY: the caller guarantees that nothing else uses it.
        unsafe { &*pac::SPI1::ptr() }
    }

    unsafe fn select(bits: u32) {
        // SAFETY: a single store that changes only the pins of its bits, which are the caller's.
        unsafe { (*pac::GPIOA::ptr()).bsrr().write(|w| w.bits(bits)) };
    }
}

/// SPI3 at 5.25 MHz, with select lines on port C.
pub struct Spi3OnC;

impl Bus for Spi3OnC {
    type Spi = pac::SPI3;

    unsafe fn registers() -> &'static spi1::RegisterBlock {
        // SAFETY: the caller guarantees that nothing else uses it.
        unsafe { &*pac::SPI3::ptr() }
    }

    unsafe fn select(bits: u32) {
        // SAFETY: a single store that changes only the pins of its bits, which are the caller's.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(bits)) };
    }
}

/// A device on a bus. All of them belong to the board, so whoever exchanges frames holds its lock.
pub struct Device<B> {
    /// Bit of its select line in the port.
    select: u32,
    bus: PhantomData<B>,
}

/// A byte did not arrive: the bus is not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoByte;

impl Error for NoByte {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl<B> ErrorType for Device<B> {
    type Error = NoByte;
}

impl<B: Bus> Device<B> {
    /// Starts the bus. `pins` are its devices' select lines in the port, which must be outputs that are high.
    pub fn start<const N: usize>(_spi: B::Spi, rcc: &mut RCC, pins: [u8; N]) -> [Self; N] {
        B::Spi::enable(rcc);
        B::Spi::reset(rcc);
        let spi = Self::registers();
        // SAFETY: the bits of the reference manual (RM0090, 28.5.1).
        spi.cr1().write(|w| unsafe { w.bits(MODE_1) });
        spi.cr1().modify(|_, w| w.spe().set_bit());
        pins.map(|pin| Self { select: 1 << pin, bus: PhantomData })
    }

    fn registers() -> &'static spi1::RegisterBlock {
        // SAFETY: whoever made a device gave the peripheral away, and all of them belong to one board, behind
        // its lock.
        unsafe { B::registers() }
    }

    fn select(&self, is_selected: bool) {
        // SAFETY: the device's own line.
        unsafe { B::select(if is_selected { self.select << 16 } else { self.select }) }
    }

    fn exchange(byte: u8) -> Result<u8, NoByte> {
        let spi = Self::registers();
        wait(|| spi.sr().read().txe().bit_is_set())?;
        // SAFETY: any byte may be written.
        spi.dr().write(|w| unsafe { w.bits(byte.into()) });
        wait(|| spi.sr().read().rxne().bit_is_set())?;
        Ok(spi.dr().read().bits() as u8)
    }

    fn run(operation: &mut Operation<'_, u8>) -> Result<(), NoByte> {
        match operation {
            Operation::Read(words) => words.iter_mut().try_for_each(|word| {
                *word = Self::exchange(0)?;
                Ok(())
            }),
            Operation::Write(words) => words.iter().try_for_each(|word| Self::exchange(*word).map(drop)),
            Operation::Transfer(read, write) => {
                let mut words = write.iter();
                for word in read.iter_mut() {
                    *word = Self::exchange(words.next().copied().unwrap_or(0))?;
                }
                words.try_for_each(|word| Self::exchange(*word).map(drop))
            }
            Operation::TransferInPlace(words) => words.iter_mut().try_for_each(|word| {
                *word = Self::exchange(*word)?;
                Ok(())
            }),
            Operation::DelayNs(time) => {
                // A cycle of 168 MHz is longer than 5 ns.
                cortex_m::asm::delay(*time / 5 + 1);
                Ok(())
            }
        }
    }
}

impl<B: Bus> SpiDevice for Device<B> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), NoByte> {
        self.select(true);
        cortex_m::asm::delay(PAUSE);
        let result = operations.iter_mut().try_for_each(Self::run);
        // The last byte arrives with its last bit, and the clock ends half a bit later.
        let ended = wait(|| Self::registers().sr().read().bsy().bit_is_clear());
        self.select(false);
        cortex_m::asm::delay(PAUSE);
        result.and(ended)
    }
}

fn wait(is_ready: impl Fn() -> bool) -> Result<(), NoByte> {
    if (0..POLLS).any(|_| is_ready()) { Ok(()) } else { Err(NoByte) }
}
