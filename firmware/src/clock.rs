//! Clock bring-up with bounded waits: a board with a broken crystal still starts, and says so.

use tesaki::protocol::ClockSource;

use crate::pac;

/// Polls before an oscillator counts as dead. At 16 MHz and some ten cycles a poll about 60 ms; a crystal needs 2 to 5,
/// the PLL less than one.
const PATIENCE: u32 = 100_000;

/// What runs at which frequency [Hz].
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Where the clock comes from.
    pub source: ClockSource,
    /// Of `USART1` (APB2).
    pub usart1: u32,
    /// Of `USART2` (APB1).
    pub usart2: u32,
    /// Of `TIM2`.
    pub timer: u32,
    /// What the UARTs run at [baud].
    pub baud: u32,
}

/// Brings the clock up to 168 MHz from the 8 MHz crystal, else from the internal oscillator; else stays at the internal
/// oscillator's 16 MHz, too slow to divide to 921 600 baud, and falls back to 115 200.
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

/// 1 MHz into the PLL, ×336, /2 = 168 MHz; AHB undivided, APB1 a quarter, APB2 a half.
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
    // Flash is slower than the core: five wait states at 168 MHz, before the switch.
    flash.acr().write(|w| w.latency().ws5().prften().set_bit().icen().set_bit().dcen().set_bit());
    rcc.cfgr().modify(|_, w| w.ppre1().div4().ppre2().div2());
    rcc.cfgr().modify(|_, w| w.sw().pll());
    wait(|| rcc.cfgr().read().sws().is_pll())
}

fn wait(ready: impl Fn() -> bool) -> bool {
    (0..PATIENCE).any(|_| ready())
}
