//! TIM1 and TIM8: the gates of two half bridges each, and a trigger between their pulses.

use super::pulses::phase;
use crate::board::Phase;
use crate::pac;
use pac::{RCC, TIM1, TIM8, tim1};
use stm32f4xx_hal::rcc::{Enable, Reset};

/// Dead time, for which both gates of a half bridge are off before one switches on [counts]: 0.12 µs.
const DEAD_TIME: u8 = 20;

/// Channels 2 and 3 of both timers on their pairs of complementary outputs, centre-aligned: high sides are on
/// around the instant at which the counter is 0. The trigger of the converters is at the other end of the
/// count: there all low sides are on, and the motors' currents flow through the shunts.
///
/// Both timers count in step. Neither has a break input here. The clock security system could break them, too
/// (RM0090, 17.3.12), but only together with the input, of which the manual does not say what level it has
/// without a pin: a wrong one would keep all gates off. So a stopped crystal is left to the NMI.
pub struct HalfBridges(TIM1, TIM8);

impl HalfBridges {
    /// Starts the counters, which count to `resolution` and back. All gates are off before
    /// [`HalfBridges::enable`].
    ///
    /// `AOE` stays 0, so that nothing but [`HalfBridges::enable`] switches them on; this, the dead time and
    /// the outputs' idle level (off) are locked until the next reset.
    pub fn start(timers: (TIM1, TIM8), rcc: &mut RCC, resolution: u16) -> Self {
        let (first, second) = timers;
        TIM1::enable(rcc);
        TIM1::reset(rcc);
        TIM8::enable(rcc);
        TIM8::reset(rcc);
        set_up(&first, resolution);
        set_up(&second, resolution);
        // The trigger output is the fourth channel's reference, see `pulses.rs`.
        first.cr2().write(|w| w.mms().compare_oc4());
        first.cr1().modify(|_, w| w.cen().set_bit());
        // This is a few cycles later, always as many, as interrupts are off.
        second.cr1().modify(|_, w| w.cen().set_bit());
        Self(first, second)
    }

    /// Returns where the counters are between two triggers, if they count to `resolution`.
    pub fn phase(&self, resolution: u16) -> Phase {
        phase(&self.0, resolution)
    }

    /// Switches the half bridges on.
    pub fn enable(&mut self) {
        self.0.bdtr().modify(|_, w| w.moe().set_bit());
        self.1.bdtr().modify(|_, w| w.moe().set_bit());
    }

    /// Returns whether all half bridges are on.
    pub fn are_on(&self) -> bool {
        let is_on = |timer: &tim1::RegisterBlock| timer.bdtr().read().moe().bit_is_set();
        is_on(&self.0) && is_on(&self.1)
    }

    /// Sets the duties of channels 2 and 3 of both timers [timer counts] from the middle of the next pulse
    /// on.
    pub fn set(&mut self, duties: [[u16; 2]; 2]) {
        for (timer, duties) in [&*self.0, &*self.1].into_iter().zip(duties) {
            let [second, third] = duties;
            timer.ccr2().write(|w| w.ccr().set(second));
            timer.ccr3().write(|w| w.ccr().set(third));
        }
    }

    /// Switches all gates off. Called from any context, even before the clocks of the timers run: then it has
    /// no effect, and the gates are off anyway.
    pub fn off() {
        // SAFETY: control, the ADC interrupt and `on_edge` call this and may interrupt each other. After the
        // start every write of these registers only clears MOE, in whatever order, but that of
        // [`HalfBridges::enable`]. If `enable` interrupts this, it has no effect: the gates stay off. If this
        // interrupts `enable`, it may have none; only `on_edge` can, and first pulls the gate drivers' enable
        // line low, which the caller of `enable` checks afterwards.
        unsafe {
            (*TIM1::ptr()).bdtr().modify(|_, w| w.moe().clear_bit());
            (*TIM8::ptr()).bdtr().modify(|_, w| w.moe().clear_bit());
        }
    }
}

fn set_up(timer: &tim1::RegisterBlock, resolution: u16) {
    timer.cr1().write(|w| w.cms().center_aligned1().arpe().set_bit());
    timer.psc().write(|w| w.psc().set(0));
    timer.arr().write(|w| w.arr().set(resolution));
    // Duties are taken over at both ends of the count: one written at the trigger takes effect in the middle
    // of the pulse.
    timer.rcr().write(|w| w.rep().set(0));
    timer.ccmr1_output().write(|w| w.oc2m().pwm_mode1().oc2pe().set_bit());
    timer
        .ccmr2_output()
        .write(|w| w.oc3m().pwm_mode1().oc3pe().set_bit().oc4m().pwm_mode2().oc4pe().set_bit());
    timer.ccr2().write(|w| w.ccr().set(0));
    timer.ccr3().write(|w| w.ccr().set(0));
    timer.ccr4().write(|w| w.ccr().set(resolution - 1));
    timer.ccer().write(|w| w.cc2e().set_bit().cc2ne().set_bit().cc3e().set_bit().cc3ne().set_bit());
    timer.egr().write(|w| w.ug().set_bit());
    // SAFETY: the dead time is in steps of the timer's clock up to 127; 1 is a valid lock level: dead time,
    // AOE, polarity and idle levels can no longer be changed.
    timer.bdtr().write(|w| unsafe {
        w.dtg().bits(DEAD_TIME).ossi().set_bit().bke().clear_bit().aoe().clear_bit().lock().bits(1)
    });
}
