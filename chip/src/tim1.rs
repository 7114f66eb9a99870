//! TIM1 and TIM8: pulses, centre-aligned or not, preload, complementary outputs with their dead time, break,
//! the trigger of the converters.

use crate::SECOND;

const CR1: usize = 0;
const CR2: usize = 1;
const DIER: usize = 3;
const SR: usize = 4;
const CCMR1: usize = 6;
const CCER: usize = 8;
const PSC: usize = 0xA;
const ARR: usize = 0xB;
const RCR: usize = 0xC;
const CCR1: usize = 0xD;
const BDTR: usize = 0x11;

const DIR: u32 = 1 << 4;
const BIF: u32 = 1 << 7;
const MOE: u32 = 1 << 15;
const AOE: u32 = 1 << 14;
const BKP: u32 = 1 << 13;
const BKE: u32 = 1 << 12;
const OSSI: u32 = 1 << 10;

/// Level of an output pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    Low,
    High,
    /// Not driven.
    Open,
}

pub struct Tim1 {
    registers: [u32; 0x14],
    /// Active values: prescaler, top, compare values.
    prescaler: u64,
    top: u64,
    compare: [u64; 4],
    repetitions: u32,
    /// Ticks at `since`, the time up to which events were handled.
    phase: u64,
    since: u64,
    handled: u64,
    /// Level of the break input; `None` when no pin is set up for it.
    break_input: Option<bool>,
    /// Whether the fourth channel's reference has had rising and falling edges that were not fetched yet.
    triggers: (bool, bool),
    /// When the references of the first three channels last changed, at or before the last new compare
    /// values.
    changed: [Option<u64>; 3],
    /// When those values took effect.
    updated: u64,
}

impl Tim1 {
    pub(crate) fn new() -> Self {
        let mut registers = [0; 0x14];
        registers[ARR] = 0xFFFF;
        let (prescaler, top, compare, repetitions) = (1, 0xFFFF, [0; 4], 0);
        let (phase, since, handled) = (0, 0, 0);
        let (break_input, triggers, changed) = (None, (false, false), [None; 3]);
        Self {
            registers,
            prescaler,
            top,
            compare,
            repetitions,
            phase,
            since,
            handled,
            break_input,
            triggers,
            changed,
            updated: 0,
        }
    }

    fn is_centred(&self) -> bool {
        self.registers[CR1] >> 5 & 3 != 0
    }

    fn period(&self) -> u64 {
        if self.is_centred() { (2 * self.top).max(1) } else { self.top + 1 }
    }

    fn runs(&self) -> bool {
        self.registers[CR1] & 1 == 1
    }

    /// Returns the ticks since the counter began.
    fn ticks(&self, now: u64, clock: u64) -> u64 {
        if !self.runs() {
            return self.phase;
        }
        let passed = u128::from(now.saturating_sub(self.since)) * u128::from(clock)
            / u128::from(SECOND * self.prescaler);
        self.phase + passed as u64
    }

    /// Returns the time at which this many ticks have passed.
    fn time(&self, ticks: u64, clock: u64) -> u64 {
        let passed = u128::from(ticks.saturating_sub(self.phase)) * u128::from(SECOND * self.prescaler);
        self.since + passed.div_ceil(u128::from(clock)) as u64
    }

    fn count(&self, phase: u64) -> u64 {
        if self.is_centred() && phase > self.top { 2 * self.top - phase } else { phase }
    }

    fn mode(&self, channel: usize) -> u32 {
        self.registers[CCMR1 + channel / 2] >> (8 * (channel % 2) + 4) & 7
    }

    /// Returns the reference of a channel at a phase of the period.
    fn reference(&self, channel: usize, phase: u64) -> bool {
        let below = self.count(phase) < self.compare[channel];
        match self.mode(channel) {
            6 => below,
            7 => !below,
            5 => true,
            _ => false,
        }
    }

    /// Returns the phases at which the count crosses a channel's compare value, upwards and downwards.
    fn crossings(&self, channel: usize) -> [u64; 2] {
        let compare = self.compare[channel];
        let down = if self.is_centred() { 2 * self.top + 1 - compare.min(2 * self.top) } else { 0 };
        [compare, down]
    }

    /// Returns the next tick after `ticks` at which one of `phases` is reached.
    fn after(&self, ticks: u64, phases: impl IntoIterator<Item = u64>) -> u64 {
        let period = self.period();
        let (round, phase) = (ticks / period * period, ticks % period);
        let next = |p: u64| round + p + if p <= phase { period } else { 0 };
        phases.into_iter().filter(|p| *p < period).map(next).min().unwrap_or(u64::MAX)
    }

    fn update_phases(&self) -> [u64; 2] {
        [0, if self.is_centred() { self.top } else { 0 }]
    }

    /// Returns the time of the next update or edge of the trigger.
    pub fn next(&self, clock: u64) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let phases = self.update_phases().into_iter().chain(self.crossings(3));
        self.time(self.after(self.handled, phases), clock)
    }

    /// Returns the dead time between the outputs of a pair [ticks], with CKD 0.
    fn dead_time(&self) -> u64 {
        let bits = u64::from(self.registers[BDTR] & 0xFF);
        match bits >> 5 {
            0..=3 => bits,
            4 | 5 => (64 + (bits & 63)) * 2,
            6 => (32 + (bits & 31)) * 8,
            _ => (32 + (bits & 31)) * 16,
        }
    }

    /// Returns the next time after `now` at which one of the first three references changes, or an output
    /// after its dead time.
    pub fn next_edge(&self, now: u64, clock: u64) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let (dead, period) = (self.dead_time(), self.period());
        let crossings = (0..3).filter(|channel| self.registers[CCER] >> (4 * channel) & 5 != 0);
        let crossings = crossings.flat_map(|channel| self.crossings(channel));
        let later = |phase: u64| if dead > 0 && phase < period { (phase + dead) % period } else { u64::MAX };
        let phases = crossings.flat_map(|phase| [phase, later(phase)]).chain(self.update_phases());
        let next = self.time(self.after(self.ticks(now, clock), phases), clock);
        let dead_ends = self.changed.iter().flatten().map(|time| time + dead * SECOND / clock);
        dead_ends.filter(|end| *end > now).fold(next, u64::min)
    }

    /// Returns when the count last crossed a channel's compare value so that the reference changed; `None`:
    /// not since that value took effect.
    fn last_crossing(&self, channel: usize, phase: u64, now: u64, clock: u64) -> Option<u64> {
        let period = self.period();
        let changes = |edge: &u64| {
            self.reference(channel, *edge) != self.reference(channel, (edge + period - 1) % period)
        };
        // A pulse of one count around the underflow begins there.
        let edges = self.crossings(channel).map(|edge| if edge == period { 0 } else { edge });
        let edges = edges.into_iter().filter(|edge| *edge < period).filter(changes);
        let ago = edges.map(|edge| (phase + period - edge) % period).min()?;
        let time = now.checked_sub(ago * SECOND * self.prescaler / clock)?;
        (time >= self.updated).then_some(time)
    }

    /// Returns whether the reference of a channel has been constant for the dead time.
    fn is_settled(&self, channel: usize, phase: u64, now: u64, clock: u64) -> bool {
        let last = self.last_crossing(channel, phase, now, clock).max(self.changed[channel]);
        last.is_none_or(|time| time + self.dead_time() * SECOND / clock <= now)
    }

    pub fn advance(&mut self, now: u64, clock: u64) {
        while self.next(clock) <= now {
            let phases = self.update_phases().into_iter().chain(self.crossings(3));
            let ticks = self.after(self.handled, phases);
            let (before, phase) = ((ticks - 1) % self.period(), ticks % self.period());
            match (self.reference(3, before), self.reference(3, phase)) {
                (false, true) => self.triggers.0 = true,
                (true, false) => self.triggers.1 = true,
                _ => {}
            }
            self.handled = ticks;
            if self.update_phases().contains(&phase) {
                if self.repetitions == 0 {
                    self.update(now, clock);
                } else {
                    self.repetitions -= 1;
                }
            }
        }
    }

    /// Performs the update event: preloaded values take effect.
    fn update(&mut self, now: u64, clock: u64) {
        if self.registers[CR1] & 2 != 0 {
            return;
        }
        let (prescaler, top) =
            (u64::from(self.registers[PSC] & 0xFFFF) + 1, u64::from(self.registers[ARR] & 0xFFFF));
        if (prescaler, top) != (self.prescaler, self.top) {
            let phase = self.ticks(now, clock) % self.period();
            (self.phase, self.since, self.handled) = (phase, now, phase);
            (self.prescaler, self.top) = (prescaler, top);
        }
        let phase = self.ticks(now, clock) % self.period();
        let references = |timer: &Self| [0, 1, 2].map(|channel| timer.reference(channel, phase));
        let before = references(self);
        let crossed = [0, 1, 2].map(|channel| self.last_crossing(channel, phase, now, clock));
        for channel in 0..4 {
            self.compare[channel] = (self.registers[CCR1 + channel] & 0xFFFF).into();
        }
        let after = references(self);
        for channel in 0..3 {
            if before[channel] != after[channel] {
                self.changed[channel] = Some(now);
            } else if crossed[channel].is_some() {
                self.changed[channel] = crossed[channel];
            }
        }
        self.updated = now;
        self.repetitions = self.registers[RCR] & 0xFF;
        self.registers[SR] |= 1;
        // AOE: outputs that a break stopped come back by themselves.
        if self.registers[BDTR] & AOE != 0 && !self.breaks() {
            self.registers[BDTR] |= MOE;
        }
    }

    /// Returns whether the break input is active now. Without a pin it is not.
    fn breaks(&self) -> bool {
        let active = self.registers[BDTR] & BKP != 0;
        self.registers[BDTR] & BKE != 0 && self.break_input == Some(active)
    }

    /// Sets the level at the break input; `None` when no pin is set up for it.
    pub fn set_break_input(&mut self, level: Option<bool>) {
        self.break_input = level;
        self.trip();
    }

    /// Applies an active break input, without an instruction.
    fn trip(&mut self) {
        if self.breaks() {
            self.registers[SR] |= BIF;
            self.registers[BDTR] &= !MOE;
        }
    }

    /// Returns the rising and falling edges since the last call: of the fourth channel's event, which needs
    /// CC4E and MOE because it is that of the output, and of the trigger output, if it is the fourth
    /// channel's reference.
    pub fn take_triggers(&mut self) -> [(bool, bool); 2] {
        let edges = std::mem::take(&mut self.triggers);
        let passes = |open: bool| if open { edges } else { (false, false) };
        let is_output = self.registers[CCER] >> 12 & 1 == 1 && self.registers[BDTR] & MOE != 0;
        [passes(is_output), passes(self.registers[CR2] >> 4 & 7 == 7)]
    }

    /// Returns the level of the complementary output of channel 0 to 2 (RM0090, table 75).
    pub fn complementary(&self, channel: usize, now: u64, clock: u64) -> Level {
        self.outputs(channel, now, clock)[1]
    }

    /// Returns the levels of the output of channel 0 to 2 and of its complementary one (RM0090, table 75).
    pub fn outputs(&self, channel: usize, now: u64, clock: u64) -> [Level; 2] {
        let enabled = |bit: u32| self.registers[CCER] >> (4 * channel as u32 + bit) & 1 == 1;
        let (main, own) = (enabled(0), enabled(2));
        let level = |high| if high { Level::High } else { Level::Low };
        if self.registers[BDTR] & MOE == 0 {
            let driven = self.registers[BDTR] & OSSI != 0 && (main || own);
            return [0, 1].map(|output| {
                let idle = self.registers[CR2] >> (8 + 2 * channel + output) & 1 == 1;
                if driven { level(idle) } else { Level::Open }
            });
        }
        let phase = self.ticks(now, clock) % self.period();
        let reference = self.reference(channel, phase);
        // In a pair, each output switches on a dead time after the other switches off. Alone, the
        // complementary output is not inverted.
        let [first, second] = if main && own {
            let is_settled = self.is_settled(channel, phase, now, clock);
            [reference && is_settled, !reference && is_settled]
        } else {
            [reference; 2]
        };
        let output = |is_on: bool, high: bool, inverted: bool| {
            if is_on { level(high ^ inverted) } else { Level::Open }
        };
        [output(main, first, enabled(1)), output(own, second, enabled(3))]
    }

    pub fn line(&self) -> bool {
        self.registers[DIER] & self.registers[SR] & 0xDF != 0
    }

    pub fn hold(&mut self, now: u64, clock: u64) {
        let ticks = self.ticks(now, clock);
        let phase = ticks % self.period();
        self.handled = phase + self.handled - self.handled.min(ticks);
        (self.phase, self.since) = (phase, now);
    }

    pub fn read(&self, offset: u32, now: u64, clock: u64) -> Option<u32> {
        match offset {
            0x00 => {
                let goes_down = self.is_centred() && self.ticks(now, clock) % self.period() >= self.top;
                Some(self.registers[CR1] & !DIR | if goes_down { DIR } else { 0 })
            }
            0x24 => Some(self.count(self.ticks(now, clock) % self.period()) as u32),
            _ if offset <= 0x4C => Some(self.registers[offset as usize / 4]),
            _ => None,
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64, clock: u64) -> Option<()> {
        let index = offset as usize / 4;
        match offset {
            0x00 => {
                self.hold(now, clock);
                self.registers[CR1] = value;
            }
            0x04 if self.lock() >= 1 => self.registers[CR2] = self.registers[CR2] & 0x3F00 | value & !0x3F00,
            0x10 => self.registers[SR] &= value,
            0x14 => {
                if value & 1 == 1 {
                    self.hold(now, clock);
                    (self.phase, self.handled) = (0, 0);
                    self.update(now, clock);
                }
            }
            0x24 => {
                self.hold(now, clock);
                (self.phase, self.handled) = (value.into(), value.into());
            }
            0x2C => {
                self.registers[ARR] = value & 0xFFFF;
                if self.registers[CR1] & 0x80 == 0 {
                    self.hold(now, clock);
                    self.top = u64::from(value & 0xFFFF);
                }
            }
            0x34..=0x40 => {
                let channel = index - CCR1;
                self.registers[index] = value & 0xFFFF;
                let preloaded = self.registers[CCMR1 + channel / 2] >> (8 * (channel % 2) + 3) & 1 == 1;
                if !preloaded {
                    self.compare[channel] = (value & 0xFFFF).into();
                }
            }
            0x44 => {
                // Level 1 of the lock: dead time, break and its polarity, AOE. The lock itself can be written
                // only once.
                let locked = if self.lock() >= 1 { 0x7000 | 0x0FF | 0x300 } else { 0 };
                self.registers[BDTR] = self.registers[BDTR] & locked | value & !locked;
                self.trip();
            }
            _ if offset <= 0x4C => self.registers[index] = value,
            _ => return None,
        }
        Some(())
    }

    fn lock(&self) -> u32 {
        self.registers[BDTR] >> 8 & 3
    }
}

#[cfg(test)]
#[path = "tim1_tests.rs"]
mod tests;
