//! TIM1: three pulses in the middle of a period, a trip by hardware, and a trigger between the pulses.

use crate::board::Phase;
use crate::pac;
use pac::{RCC, TIM1, tim1};
use stm32f4xx_hal::rcc::{Enable, Reset};

/// Three channels on their complementary pins (CH1N to CH3N), centre-aligned: a pulse lies around the instant
/// at which the counter is 0. The trigger of the converters is at the other end of the count, as far from all
/// switching as possible.
pub struct Pulses(TIM1);

impl Pulses {
    /// Starts the counter, which counts to `resolution` and back. No pulse passes before [`Pulses::enable`].
    ///
    /// The break input is active when low. `AOE` stays 0: pulses that it stopped return only by
    /// [`Pulses::enable`]. `AOE`, the polarity of the break input and the outputs' idle level (low) are
    /// locked until the next reset.
    pub fn start(timer: TIM1, rcc: &mut RCC, resolution: u16) -> Self {
        TIM1::enable(rcc);
        TIM1::reset(rcc);
        timer.cr1().write(|w| w.cms().center_aligned1().arpe().set_bit());
        // The trigger output is the fourth channel's reference. Its own event would need the main output
        // enabled: before `enable`, and after a trip, nothing would be measured.
        timer.cr2().write(|w| w.mms().compare_oc4());
        timer.psc().write(|w| w.psc().set(0));
        timer.arr().write(|w| w.arr().set(resolution));
        // Duties are taken over at both ends of the count: one written at the trigger takes effect in the
        // middle of the pulse.
        timer.rcr().write(|w| w.rep().set(0));
        timer.ccmr1_output().write(|w| {
            w.oc1m().pwm_mode1().oc1pe().set_bit();
            w.oc2m().pwm_mode1().oc2pe().set_bit()
        });
        timer.ccmr2_output().write(|w| {
            w.oc3m().pwm_mode1().oc3pe().set_bit();
            w.oc4m().pwm_mode2().oc4pe().set_bit()
        });
        for channel in 0..3 {
            timer.ccr(channel).write(|w| w.ccr().set(0));
        }
        timer.ccr4().write(|w| w.ccr().set(resolution - 1));
        // With its main output disabled, a complementary output is not inverted (RM0090, table 75: CCxE 0,
        // CCxNE 1).
        timer.ccer().write(|w| w.cc1ne().set_bit().cc2ne().set_bit().cc3ne().set_bit());
        timer.egr().write(|w| w.ug().set_bit());
        // SAFETY: 1 is a valid lock level: polarity and idle levels can no longer be changed.
        timer.bdtr().write(|w| unsafe {
            w.ossi().set_bit().bke().set_bit().bkp().clear_bit().aoe().clear_bit().lock().bits(1)
        });
        timer.cr1().modify(|_, w| w.cen().set_bit());
        Self(timer)
    }

    /// Returns where the counter is between two triggers, if it counts to `resolution`.
    pub fn phase(&self, resolution: u16) -> Phase {
        phase(&self.0, resolution)
    }

    /// Lets pulses pass, unless the break input is active.
    pub fn enable(&mut self) {
        // SAFETY: zeros clear flags in this register; all but the break's stay.
        self.0.sr().write(|w| unsafe { w.bits(!BREAK_FLAG) });
        self.0.bdtr().modify(|_, w| w.moe().set_bit());
    }

    /// Returns whether no pulse passes: the break input is active, or was since [`Pulses::enable`].
    pub fn has_tripped(&self) -> bool {
        self.0.bdtr().read().moe().bit_is_clear() || self.0.sr().read().bits() & BREAK_FLAG != 0
    }

    /// Sets the duties [timer counts] from the middle of the next pulse on.
    pub fn set(&mut self, duties: [u16; 3]) {
        for (channel, duty) in duties.into_iter().enumerate() {
            self.0.ccr(channel).write(|w| w.ccr().set(duty));
        }
    }

    /// Blocks all pulses. Called from any context, even before the clock of the timer runs: then it has no
    /// effect, and no pulse passes anyway.
    pub fn off() {
        // SAFETY: control and the ADC interrupt call this, and the second may interrupt the first. After the
        // start every write of this register only clears MOE, in whatever order, but that of
        // [`Pulses::enable`]. If `enable` interrupts this, it has no effect: the outputs stay off. What
        // interrupts `enable` and calls this, such as a fault of the CPU, never returns to it.
        unsafe { (*TIM1::ptr()).bdtr().modify(|_, w| w.moe().clear_bit()) };
    }
}

/// Returns where a centre-aligned counter is between two triggers, which come at the upper end of its count.
pub(super) fn phase(timer: &tim1::RegisterBlock, resolution: u16) -> Phase {
    let (count, top) = (u32::from(timer.cnt().read().cnt().bits()), u32::from(resolution));
    let goes_down = timer.cr1().read().dir().is_down();
    Phase { since: if goes_down { top.saturating_sub(count) } else { top + count }, period: 2 * top }
}

/// BIF in TIM1_SR.
const BREAK_FLAG: u32 = 1 << 7;
