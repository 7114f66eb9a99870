//! Clock initialisation with bounded waits: a board with a broken or a wrong crystal still starts and reports
//! it.

use tesaki::protocol::ClockSource;

use crate::pac;
use pac::{flash, rcc, tim11};

/// Polls before the crystal counts as failed: about 20 ms at 16 MHz and ten cycles per poll. A working one
/// starts within 2 to 5 ms. All waits together must be shorter than the watchdog's timeout.
const CRYSTAL_POLLS: u32 = 32_000;
/// The same for the PLL, about 2 ms. It locks within 0.3 ms.
const PLL_POLLS: u32 = 3_200;
/// Frequency of the internal oscillator [Hz]: at −40 °C and 105 °C it can be 8 % less and 4.5 % more
/// (datasheet).
const INTERNAL: u32 = 16_000_000;

/// Clock source and frequencies [Hz].
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// The source.
    pub source: ClockSource,
    /// The frequency of a crystal that runs but is not the board's; 0 if none could be measured.
    pub wrong_crystal: Option<u32>,
    /// Clock of APB1: `USART2`, `UART4`.
    pub apb1: u32,
    /// Clock of APB2: `USART1`.
    pub apb2: u32,
    /// Clock of `TIM2`.
    pub timer: u32,
    /// Rate of the UARTs [baud].
    pub baud: u32,
}

impl Clocks {
    /// The internal oscillator without PLL, as after a reset.
    pub const SLOW: Self = Self {
        source: ClockSource::Internal,
        wrong_crystal: None,
        apb1: INTERNAL,
        apb2: INTERNAL,
        timer: INTERNAL,
        baud: 115_200,
    };
}

/// Starts the PLL at 168 MHz, from the crystal if `measure` confirms its frequency `crystal` [Hz], else from
/// the internal oscillator. Without PLL the clock stays at 16 MHz, too slow for 921 600 baud: the UARTs then
/// run at 115 200. A crystal that stops later raises the NMI (clock security system).
pub fn bring_up(
    rcc: &rcc::RegisterBlock,
    flash: &flash::RegisterBlock,
    crystal: u32,
    measure: impl FnOnce() -> Option<u32>,
) -> Clocks {
    let fast = |source, wrong_crystal| Clocks {
        source,
        wrong_crystal,
        apb1: 42_000_000,
        apb2: 84_000_000,
        timer: 84_000_000,
        baud: 921_600,
    };
    let mut wrong_crystal = None;
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    if wait(CRYSTAL_POLLS, || rcc.cr().read().hserdy().bit_is_set()) {
        let measured = measure().unwrap_or(0);
        if !is_near(measured, crystal) {
            wrong_crystal = Some(measured);
        } else if start_pll(rcc, flash, Some(crystal)) {
            rcc.cr().modify(|_, w| w.csson().set_bit());
            return fast(ClockSource::Crystal, None);
        }
    }
    rcc.cr().modify(|_, w| w.hseon().clear_bit());
    if start_pll(rcc, flash, None) {
        return fast(ClockSource::InternalPll, wrong_crystal);
    }
    Clocks { wrong_crystal, ..Clocks::SLOW }
}

/// Returns to the internal oscillator, which runs since the reset, without PLL.
pub fn slow_down() {
    // SAFETY: the caller ends everything else that uses this register.
    unsafe { (*pac::RCC::ptr()).cfgr().modify(|_, w| w.sw().hsi()) };
}

/// Starts the PLL: 1 MHz · 336 / 2 = 168 MHz. AHB undivided, APB1 a quarter, APB2 a half. `crystal` is the
/// frequency of the crystal [Hz], or `None` for the internal oscillator. Returns whether the PLL is the
/// system clock.
fn start_pll(rcc: &rcc::RegisterBlock, flash: &flash::RegisterBlock, crystal: Option<u32>) -> bool {
    rcc.cr().modify(|_, w| w.pllon().clear_bit());
    let divider = crystal.unwrap_or(INTERNAL) / 1_000_000;
    rcc.pllcfgr().write(|w| {
        // SAFETY: the values are within the fields' documented ranges: M 2 to 63, N 50 to 432, Q 2 to 15.
        let w = unsafe { w.pllm().bits(divider as u8).plln().bits(336).pllq().bits(7) };
        w.pllp().div2().pllsrc().bit(crystal.is_some())
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());
    if !wait(PLL_POLLS, || rcc.cr().read().pllrdy().bit_is_set()) {
        rcc.cr().modify(|_, w| w.pllon().clear_bit());
        return false;
    }
    // The flash needs five wait states at 168 MHz, set before the switch.
    flash.acr().write(|w| w.latency().ws5().prften().set_bit().icen().set_bit().dcen().set_bit());
    rcc.cfgr().modify(|_, w| w.ppre1().div4().ppre2().div2());
    rcc.cfgr().modify(|_, w| w.sw().pll());
    wait(PLL_POLLS, || rcc.cfgr().read().sws().is_pll())
}

fn wait(polls: u32, ready: impl Fn() -> bool) -> bool {
    (0..polls).any(|_| ready())
}

/// Returns whether a measured frequency is that of the board's crystal, within a tenth: the internal
/// oscillator is no more accurate, and the crystals in use differ by more.
fn is_near(measured: u32, crystal: u32) -> bool {
    measured.abs_diff(crystal) <= crystal / 10
}

/// Number of capture intervals in a measurement. A capture comes every 16 · 8 periods of the crystal.
const INTERVALS: u32 = 16;
const PERIODS: u32 = 16 * 8;

/// Computes the frequency of the crystal [Hz] from `counts` of the internal oscillator in [`INTERVALS`]
/// captures; `None` for 0.
pub fn frequency(counts: u16) -> Option<u32> {
    // To 8 Hz: the product fits into 32 bits then, of which a division is one instruction.
    (INTERNAL / 8 * INTERVALS * PERIODS).checked_div(counts.into())?.checked_mul(8)
}

/// Measures the running crystal [Hz] with the internal oscillator, which must be the system clock: TIM11
/// captures its count at edges of the crystal divided by 16 (RM0090: HSE_RTC in TIM11_OR). `None` without
/// edges.
pub fn measure_crystal(rcc: &rcc::RegisterBlock, timer: &tim11::RegisterBlock) -> Option<u32> {
    rcc.apb2enr().modify(|_, w| w.tim11en().set_bit());
    // SAFETY: 16 is a valid divider (2 to 31).
    rcc.cfgr().modify(|_, w| unsafe { w.rtcpre().bits(16) });
    // SAFETY: the fields and values of the reference manual: TI1 is HSE_RTC; channel 1 captures it at each
    // eighth rising edge, unfiltered; all 16 bits are counted.
    unsafe {
        timer.or().write(|w| w.bits(0b10));
        timer.ccmr1_input().write(|w| w.bits(0b1101));
        timer.arr().write(|w| w.bits(0xFFFF));
        timer.ccer().write(|w| w.bits(1));
    }
    timer.cr1().write(|w| w.cen().set_bit());
    // With an 8 MHz crystal an interval is 256 cycles. If the loop misses one, the over-capture flag is set.
    let capture = || {
        let captured = (0..1000).any(|_| timer.sr().read().cc1if().bit_is_set());
        captured.then(|| timer.ccr1().read().bits() as u16)
    };
    let counts = (|| {
        capture()?;
        let first = capture()?;
        let mut last = first;
        for _ in 0..INTERVALS {
            last = capture()?;
        }
        let missed = timer.sr().read().bits() & 1 << 9 != 0;
        (!missed).then_some(last.wrapping_sub(first))
    })();
    timer.cr1().write(|w| w.cen().clear_bit());
    rcc.apb2enr().modify(|_, w| w.tim11en().clear_bit());
    frequency(counts?)
}
