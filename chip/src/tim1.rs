//! TIM1: pulses, centre-aligned or not, preload, complementary outputs, break, the trigger of the converters.

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
    /// What is in force: prescaler, top, compare values.
    prescaler: u64,
    top: u64,
    compare: [u64; 4],
    repetitions: u32,
    /// Ticks at `since`, and up to which events were handled.
    phase: u64,
    since: u64,
    handled: u64,
    /// Level of the break input; `None` when no pin is set up for it.
    break_input: Option<bool>,
    /// Rising and falling edges of the fourth channel's reference that were not fetched yet.
    triggers: (bool, bool),
}

impl Tim1 {
    pub(crate) fn new() -> Self {
        let mut registers = [0; 0x14];
        registers[ARR] = 0xFFFF;
        let (prescaler, top, compare, repetitions) = (1, 0xFFFF, [0; 4], 0);
        let (phase, since, handled) = (0, 0, 0);
        let (break_input, triggers) = (None, (false, false));
        Self { registers, prescaler, top, compare, repetitions, phase, since, handled, break_input, triggers }
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

    /// Ticks since the counter began.
    fn ticks(&self, now: u64, clock: u64) -> u64 {
        if !self.runs() {
            return self.phase;
        }
        let passed = u128::from(now.saturating_sub(self.since)) * u128::from(clock)
            / u128::from(SECOND * self.prescaler);
        self.phase + passed as u64
    }

    /// When so many ticks have passed.
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

    /// The reference of a channel at a phase of the period.
    fn reference(&self, channel: usize, phase: u64) -> bool {
        let below = self.count(phase) < self.compare[channel];
        match self.mode(channel) {
            6 => below,
            7 => !below,
            5 => true,
            _ => false,
        }
    }

    /// Phases at which the count crosses a channel's compare value: upwards and downwards.
    fn crossings(&self, channel: usize) -> [u64; 2] {
        let compare = self.compare[channel];
        let down = if self.is_centred() { 2 * self.top + 1 - compare.min(2 * self.top) } else { 0 };
        [compare, down]
    }

    /// The next tick after `ticks` at which one of `phases` is reached.
    fn after(&self, ticks: u64, phases: impl IntoIterator<Item = u64>) -> u64 {
        let period = self.period();
        let (round, phase) = (ticks / period * period, ticks % period);
        let next = |p: u64| round + p + if p <= phase { period } else { 0 };
        phases.into_iter().filter(|p| *p < period).map(next).min().unwrap_or(u64::MAX)
    }

    fn update_phases(&self) -> [u64; 2] {
        [0, if self.is_centred() { self.top } else { 0 }]
    }

    /// The next time at which something happens inside: an update, or an edge of the trigger.
    pub fn next(&self, clock: u64) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let phases = self.update_phases().into_iter().chain(self.crossings(3));
        self.time(self.after(self.handled, phases), clock)
    }

    /// The next time after `now` at which one of the first three references changes.
    pub fn next_edge(&self, now: u64, clock: u64) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let phases = (0..3).flat_map(|channel| self.crossings(channel)).chain(self.update_phases());
        self.time(self.after(self.ticks(now, clock), phases), clock)
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

    /// The update event: what was preloaded comes into force.
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
        for channel in 0..4 {
            self.compare[channel] = (self.registers[CCR1 + channel] & 0xFFFF).into();
        }
        self.repetitions = self.registers[RCR] & 0xFF;
        self.registers[SR] |= 1;
        // AOE: what a break stopped comes back by itself.
        if self.registers[BDTR] & AOE != 0 && !self.breaks() {
            self.registers[BDTR] |= MOE;
        }
    }

    /// Whether the break input is active now. Without a pin it is not.
    fn breaks(&self) -> bool {
        let active = self.registers[BDTR] & BKP != 0;
        self.registers[BDTR] & BKE != 0 && self.break_input == Some(active)
    }

    /// The level at the break input; `None` when no pin is set up for it.
    pub fn set_break_input(&mut self, level: Option<bool>) {
        self.break_input = level;
        self.trip();
    }

    /// No instruction is needed for this.
    fn trip(&mut self) {
        if self.breaks() {
            self.registers[SR] |= BIF;
            self.registers[BDTR] &= !MOE;
        }
    }

    /// Rising and falling edges since the last call: of the fourth channel's event, which is that of an
    /// output and so needs CC4E and MOE, and of the trigger output, when it is the fourth channel's
    /// reference.
    pub fn take_triggers(&mut self) -> [(bool, bool); 2] {
        let edges = std::mem::take(&mut self.triggers);
        let passes = |open: bool| if open { edges } else { (false, false) };
        let is_output = self.registers[CCER] >> 12 & 1 == 1 && self.registers[BDTR] & MOE != 0;
        [passes(is_output), passes(self.registers[CR2] >> 4 & 7 == 7)]
    }

    /// Level of the complementary output of channel 0 to 2 (RM0090, table 75).
    pub fn complementary(&self, channel: usize, now: u64, clock: u64) -> Level {
        let enabled = |bit: u32| self.registers[CCER] >> (4 * channel as u32 + bit) & 1 == 1;
        let (main, own, inverted) = (enabled(0), enabled(2), enabled(3));
        let level = |high| if high { Level::High } else { Level::Low };
        if self.registers[BDTR] & MOE == 0 {
            let idle = self.registers[CR2] >> (9 + 2 * channel) & 1 == 1;
            return if self.registers[BDTR] & OSSI != 0 && (main || own) { level(idle) } else { Level::Open };
        }
        if !own {
            return Level::Open;
        }
        let phase = self.ticks(now, clock) % self.period();
        let reference = self.reference(channel, phase);
        // With both outputs of a channel, this one is the complement; alone, it is not.
        level(reference ^ main ^ inverted)
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
                // Level 1 of the lock: dead time, break and its polarity, AOE. The lock itself is written
                // once.
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
mod tests {
    use super::*;

    const CLOCK: u64 = 168_000_000;

    /// Centre-aligned at 20 kHz with a duty of a quarter on channel 1, its pulse around the underflow.
    fn pulses(main: bool) -> Tim1 {
        let mut timer = Tim1::new();
        let writes = [
            (0x00, 0xA0),
            (0x04, 7 << 4),
            (0x2C, 4200),
            (0x18, 0x6868),
            (0x1C, 0x7868),
            (0x34, 1050),
            (0x40, 4199),
            (0x20, if main { 0x1005 } else { 0x1004 }),
            (0x14, 1),
            (0x44, 0x9400 | BKE),
            (0x00, 0xA1),
        ];
        for (offset, value) in writes {
            timer.write(offset, value, 0, CLOCK);
        }
        timer
    }

    /// By hand: a period is 50 µs; the pulse lasts from 6.25 µs before the underflow to 6.25 µs after it.
    #[test]
    fn a_pulse_lies_around_the_underflow() {
        let timer = pulses(false);
        let at = |microseconds: f64| timer.complementary(0, (microseconds * 1e6) as u64, CLOCK);
        for (time, level) in [(1.0, Level::High), (6.2, Level::High), (6.3, Level::Low), (43.7, Level::Low)] {
            assert_eq!(at(time), level, "{time}");
        }
        assert_eq!(at(43.8), Level::High);
        assert_eq!(pulses(true).complementary(0, 1_000_000, CLOCK), Level::Low, "the complement");
    }

    #[test]
    fn the_trigger_comes_once_a_period_just_before_the_top() {
        let mut timer = pulses(false);
        let mut rising = Vec::new();
        while rising.len() < 3 {
            let now = timer.next(CLOCK);
            timer.advance(now, CLOCK);
            let [event, output] = timer.take_triggers();
            assert_eq!(event, output, "with the main output enabled");
            if output.0 {
                rising.push(now as f64 * 1e-6);
            }
        }
        // 4199 of 4200 counts of 5.952 ns.
        for (time, expected) in rising.into_iter().zip([24.994, 74.994, 124.994]) {
            assert!((time - expected).abs() < 0.001, "{time}");
        }
    }

    #[test]
    fn without_the_main_output_only_the_trigger_output_triggers() {
        let mut timer = pulses(false);
        timer.write(0x44, 0x1400 | BKE, 0, CLOCK);
        let mut triggers = [(false, false); 2];
        for _ in 0..8 {
            timer.advance(timer.next(CLOCK), CLOCK);
            for (all, [rises, falls]) in triggers.iter_mut().zip(timer.take_triggers().map(<[bool; 2]>::from))
            {
                *all = (all.0 || rises, all.1 || falls);
            }
        }
        assert_eq!(triggers, [(false, false), (true, true)]);
    }

    #[test]
    fn a_break_stops_until_software_starts_again_unless_aoe_is_set() {
        for aoe in [0, AOE] {
            let mut timer = pulses(false);
            timer.write(0x44, 0x9400 | BKE | aoe, 0, CLOCK);
            timer.set_break_input(Some(false));
            assert_eq!(timer.complementary(0, 1_000_000, CLOCK), Level::Low);
            timer.write(0x44, 0x9400 | BKE | aoe, 2_000_000, CLOCK);
            assert_eq!(timer.complementary(0, 2_000_000, CLOCK), Level::Low, "still active");
            timer.set_break_input(Some(true));
            let later = 201_000_000;
            timer.advance(later, CLOCK);
            let expected = if aoe == 0 { Level::Low } else { Level::High };
            assert_eq!(timer.complementary(0, later, CLOCK), expected);
            timer.write(0x44, 0x9400 | BKE | aoe, later, CLOCK);
            assert_eq!(timer.complementary(0, later, CLOCK), Level::High);
        }
    }

    #[test]
    fn the_lock_keeps_polarity_and_aoe() {
        let mut timer = Tim1::new();
        timer.write(0x44, 0x100 | BKE | OSSI, 0, CLOCK);
        timer.write(0x44, MOE | AOE | BKP | OSSI, 0, CLOCK);
        assert_eq!(timer.read(0x44, 0, CLOCK), Some(0x100 | BKE | OSSI | MOE));
    }
}
