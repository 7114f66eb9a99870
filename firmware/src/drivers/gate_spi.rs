//! SPI3 to gate drivers: short words, bounded waits, select lines on port C.

use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};

use crate::pac;
use pac::{GPIOC, SPI3};

/// Polls for a byte, which takes 1.5 µs: some 20 µs.
const POLLS: u32 = 500;
/// Time for which a select line is high at least, and before the first clock [cycles]: 0.6 µs.
const PAUSE: u32 = 100;
/// MSTR, SSM and SSI; CPHA, which is mode 1; BR: an eighth of 42 MHz.
const MODE_1: u16 = 1 << 2 | 1 << 9 | 1 << 8 | 1 | 0b010 << 3;

/// A device on SPI3. All of them belong to the same RTIC task.
pub struct GateSpi {
    /// Bit of its select line in GPIOC.
    select: u32,
}

/// A byte did not come: the bus is not set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoByte;

impl Error for NoByte {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ErrorType for GateSpi {
    type Error = NoByte;
}

impl GateSpi {
    /// Starts the bus, with its devices' pins of port C, which must be outputs that are high.
    pub fn start<const N: usize>(spi: SPI3, rcc: &mut Rcc, pins: [u8; N]) -> [Self; N] {
        SPI3::enable(rcc);
        SPI3::reset(rcc);
        // SAFETY: the bits of the reference manual (RM0090, 28.5.1).
        spi.cr1().write(|w| unsafe { w.bits(MODE_1) });
        spi.cr1().modify(|_, w| w.spe().set_bit());
        pins.map(|pin| Self { select: 1 << pin })
    }

    fn exchange(byte: u8) -> Result<u8, NoByte> {
        // SAFETY: only the task that owns the devices uses this peripheral.
        let spi = unsafe { &*SPI3::ptr() };
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
                // 168 MHz: less than a fifth of the nanoseconds.
                cortex_m::asm::delay(*time / 5 + 1);
                Ok(())
            }
        }
    }
}

impl SpiDevice for GateSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), NoByte> {
        // SAFETY: single stores to the set and reset register, which change one pin.
        let set = |bits| unsafe { (*GPIOC::ptr()).bsrr().write(|w| w.bits(bits)) };
        set(self.select << 16);
        cortex_m::asm::delay(PAUSE);
        let result = operations.iter_mut().try_for_each(Self::run);
        // SAFETY: as above; the last bit has ended when its byte is there, and the clock half a bit later.
        let spi = unsafe { &*SPI3::ptr() };
        let ended = wait(|| spi.sr().read().bsy().bit_is_clear());
        set(self.select);
        cortex_m::asm::delay(PAUSE);
        result.and(ended)
    }
}

fn wait(is_ready: impl Fn() -> bool) -> Result<(), NoByte> {
    if (0..POLLS).any(|_| is_ready()) { Ok(()) } else { Err(NoByte) }
}
