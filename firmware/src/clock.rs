//! Clock initialisation with bounded waits: a board with a broken crystal still starts and reports it.

use tesaki::protocol::ClockSource;

use crate::pac;

/// Polls before an oscillator counts as failed: about 60 ms at 16 MHz and ten cycles per poll. A crystal
/// starts within 2 to 5 ms, the PLL within 1 ms.
const MAX_POLLS: u32 = 100_000;

/// Clock source and frequencies [Hz].
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// The source.
    pub source: ClockSource,
    /// Clock of `USART1` (APB2).
    pub usart1: u32,
    /// Clock of `USART2` (APB1).
    pub usart2: u32,
    /// Clock of `TIM2`.
    pub timer: u32,
    /// Rate of the UARTs [baud].
    pub baud: u32,
}

/// Starts the PLL with 168 MHz from the 8 MHz crystal or, if that fails, from the internal oscillator.
/// Without PLL the clock stays at 16 MHz, too slow for 921 600 baud: the UARTs then run at 115 200.
pub fn bring_up(rcc: &pac::RCC, flash: &pac::FLASH) -> Clocks {
    let fast =
        |source| Clocks { source, usart1: 84_000_000, usart2: 42_000_000, timer: 84_000_000, baud: 921_600 };
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    if wait(|| rcc.cr().read().hserdy().bit_is_set()) {
        if start_pll(rcc, flash, true) {
            return fast(ClockSource::Crystal);
        }
    } else {
        rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }
    if start_pll(rcc, flash, false) {
        return fast(ClockSource::InternalPll);
    }
    Clocks {
        source: ClockSource::Internal,
        usart1: 16_000_000,
        usart2: 16_000_000,
        timer: 16_000_000,
        baud: 115_200,
    }
}

/// PLL: 1 MHz · 336 / 2 = 168 MHz. AHB undivided, APB1 a quarter, APB2 a half.
fn start_pll(rcc: &pac::RCC, flash: &pac::FLASH, crystal: bool) -> bool {
    rcc.cr().modify(|_, w| w.pllon().clear_bit());
    rcc.pllcfgr().write(|w| {
        // SAFETY: the values are within the fields' documented ranges: M 2 to 63, N 50 to 432, Q 2 to 15.
        let w = unsafe { w.pllm().bits(if crystal { 8 } else { 16 }).plln().bits(336).pllq().bits(7) };
        w.pllp().div2().pllsrc().bit(crystal)
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());
    if !wait(|| rcc.cr().read().pllrdy().bit_is_set()) {
        rcc.cr().modify(|_, w| w.pllon().clear_bit());
        return false;
    }
    // The flash needs five wait states at 168 MHz, set before the switch.
    flash.acr().write(|w| w.latency().ws5().prften().set_bit().icen().set_bit().dcen().set_bit());
    rcc.cfgr().modify(|_, w| w.ppre1().div4().ppre2().div2());
    rcc.cfgr().modify(|_, w| w.sw().pll());
    wait(|| rcc.cfgr().read().sws().is_pll())
}

fn wait(ready: impl Fn() -> bool) -> bool {
    (0..MAX_POLLS).any(|_| ready())
}
