//! General-purpose timers: counting up with an interrupt (TIM2), quadrature counting (TIM3 to TIM5), and
//! TIM11's capture of the crystal.

use crate::SECOND;

/// Registers by offset / 4.
const CR1: usize = 0;
const SMCR: usize = 2;
const DIER: usize = 3;
const SR: usize = 4;
const CCMR1: usize = 6;
const CCER: usize = 8;
const PSC: usize = 0xA;
const ARR: usize = 0xB;
const CCR1: usize = 0xD;
const OR: usize = 0x14;

pub struct Timer {
    registers: [u32; 0x20],
    /// Largest value of the counter.
    mask: u32,
    prescaler: u64,
    top: u64,
    count: u64,
    since: u64,
    /// TIM11: number of captures.
    captures: u64,
    running_since: u64,
}

impl Timer {
    pub fn new(mask: u32) -> Self {
        let mut registers = [0; 0x20];
        registers[ARR] = mask;
        let (prescaler, top) = (1, mask.into());
        Self { registers, mask, prescaler, top, count: 0, since: 0, captures: 0, running_since: 0 }
    }

    fn is_encoder(&self) -> bool {
        matches!(self.registers[SMCR] & 7, 1..=3)
    }

    fn counts_clock(&self) -> bool {
        self.registers[CR1] & 1 == 1 && !self.is_encoder()
    }

    /// Counts `edges`, the quadrature edges of both channels together. Both inputs must be mapped to their
    /// channels.
    pub fn turn(&mut self, edges: i64) {
        let mapped = self.registers[CCMR1] & 0x303 == 0x101;
        if edges == 0 || !self.is_encoder() || self.registers[CR1] & 1 == 0 || !mapped {
            return;
        }
        let inverted = (self.registers[CCER] >> 1 ^ self.registers[CCER] >> 5) & 1 == 1;
        let edges = if self.registers[SMCR] & 7 == 3 { edges } else { edges / 2 };
        let edges = if inverted { -edges } else { edges };
        self.count = (self.count as i64 + edges).rem_euclid(self.top as i64 + 1) as u64;
    }

    /// A disturbance of both channels, the second one a little later: four edges, unless the input filters
    /// need more time than its `width` [ps].
    pub fn disturb(&mut self, width: u64, clock: u64) {
        // Samples, and clock cycles from one to the next (RM0090, 18.4.7; CKD is 0).
        let filter = |bits: u32| {
            let (samples, cycles) = [
                (0, 0),
                (2, 1),
                (4, 1),
                (8, 1),
                (6, 2),
                (8, 2),
                (6, 4),
                (8, 4),
                (6, 8),
                (8, 8),
                (5, 16),
                (6, 16),
                (8, 16),
                (5, 32),
                (6, 32),
                (8, 32),
            ][(bits & 15) as usize];
            samples * cycles * SECOND / clock
        };
        let modes = self.registers[CCMR1];
        // One disturbed channel counts forth and back.
        if filter(modes >> 4) <= width && filter(modes >> 12) <= width {
            self.turn(4);
        }
    }

    fn now(&self, now: u64, clock: u64) -> u64 {
        if !self.counts_clock() {
            return self.count;
        }
        let ticks = u128::from(now.saturating_sub(self.since)) * u128::from(clock)
            / u128::from(SECOND * self.prescaler);
        self.count + ticks as u64
    }

    /// Returns when the counter overflows.
    pub fn next(&self, clock: u64) -> u64 {
        if !self.counts_clock() || self.registers[DIER] & 1 == 0 {
            return u64::MAX;
        }
        let left = u128::from(self.top + 1 - self.count.min(self.top));
        let time = (left * u128::from(self.prescaler) * u128::from(SECOND)).div_ceil(u128::from(clock));
        self.since + time as u64
    }

    pub fn advance(&mut self, now: u64, clock: u64) {
        while self.next(clock) <= now {
            self.since = self.next(clock);
            self.update();
        }
    }

    fn update(&mut self) {
        self.count = 0;
        self.prescaler = u64::from(self.registers[PSC] & 0xFFFF) + 1;
        self.top = self.registers[ARR].into();
        self.registers[SR] |= 1;
    }

    pub fn line(&self) -> bool {
        self.registers[DIER] & self.registers[SR] & 0x5F != 0
    }

    /// Latches the count before the clock changes, because it was counted with the old one.
    pub fn hold(&mut self, now: u64, clock: u64) {
        (self.count, self.since) = (self.now(now, clock), now);
    }

    /// TIM11: captures the crystal divided by `divider`, if there is a `crystal` [Hz].
    fn capture(&mut self, now: u64, clock: u64, crystal: Option<u64>, divider: u64) {
        let captures = self.registers[CCMR1] & 0x3 == 1 && self.registers[CCER] & 1 == 1;
        let selected = self.registers[OR] & 3 == 2 && divider >= 2;
        let Some(crystal) = crystal.filter(|_| captures && selected && self.registers[CR1] & 1 == 1) else {
            return;
        };
        let edges = 1_u64 << (self.registers[CCMR1] >> 2 & 3);
        let interval = u128::from(SECOND) * u128::from(divider * edges) / u128::from(crystal);
        let taken = (u128::from(now.saturating_sub(self.running_since)) / interval) as u64;
        if taken > self.captures {
            let waiting = self.registers[SR] & 2 != 0;
            if waiting || taken > self.captures + 1 {
                self.registers[SR] |= 1 << 9;
            }
            let at = self.running_since + (interval * u128::from(taken)) as u64;
            self.registers[CCR1] = self.now(at, clock) as u32 & self.mask;
            self.registers[SR] |= 2;
            self.captures = taken;
        }
    }

    /// Reads a register. `crystal` is its frequency [Hz] and its divider for TIM11.
    pub fn read(&mut self, offset: u32, now: u64, clock: u64, crystal: (Option<u64>, u64)) -> Option<u32> {
        self.capture(now, clock, crystal.0, crystal.1);
        let index = offset as usize / 4;
        match offset {
            0x24 => Some((self.now(now, clock) % (self.top + 1)) as u32),
            0x34 => {
                self.registers[SR] &= !2;
                Some(self.registers[index])
            }
            _ if offset <= 0x50 => Some(self.registers[index]),
            _ => None,
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64, clock: u64) -> Option<()> {
        // The fraction of a tick is lost only if the counting changes.
        if matches!(offset, 0x00 | 0x08 | 0x14 | 0x24 | 0x2C) {
            self.hold(now, clock);
        }
        match offset {
            0x00 => {
                if value & !self.registers[CR1] & 1 == 1 {
                    (self.running_since, self.captures) = (now, 0);
                }
                self.registers[CR1] = value;
            }
            0x10 => self.registers[SR] &= value,
            0x14 if value & 1 == 1 => self.update(),
            0x14 => {}
            0x24 => self.count = (value & self.mask).into(),
            0x2C => {
                self.registers[ARR] = value & self.mask;
                if self.registers[CR1] & 0x80 == 0 {
                    self.top = self.registers[ARR].into();
                }
            }
            _ if offset <= 0x50 => self.registers[offset as usize / 4] = value,
            _ => return None,
        }
        Some(())
    }
}
