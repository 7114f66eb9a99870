//! ADC1 to ADC3: injected conversions by the trigger of TIM1 or by software. Regular conversions are not
//! modelled.

use crate::SECOND;

/// The levels of the analogue inputs by channel (0 to 18), as fractions of full scale.
pub type Inputs<'a> = &'a dyn Fn(u32) -> f64;

const SR: usize = 0;
const CR1: usize = 1;
const CR2: usize = 2;
const JSQR: usize = 0xE;
const JDR: usize = 0xF;

#[derive(Default)]
pub struct Adc {
    registers: [u32; 0x14],
    /// Channels to convert, how many are done, and when the present one ends.
    sequence: Vec<u32>,
    converted: usize,
    end: Option<u64>,
}

impl Adc {
    /// Begins a conversion, at whose beginning the level is held. `clock` is that of the converter.
    fn begin(&mut self, now: u64, clock: u64, inputs: Inputs<'_>) {
        let Some(&channel) = self.sequence.get(self.converted) else { return };
        let times = [3, 15, 28, 56, 84, 112, 144, 480];
        let sampling = if channel >= 10 {
            self.registers[3] >> (3 * (channel - 10)) & 7
        } else {
            self.registers[4] >> (3 * channel) & 7
        };
        let counts = (inputs(channel) * 4095.0).round().clamp(0.0, 4095.0) as u32;
        self.registers[JDR + self.converted] = counts;
        let cycles = times[sampling as usize] + 12;
        self.end = Some(self.end.unwrap_or(now) + cycles * SECOND / clock);
    }

    /// Handles rising and falling edges of TIM1's fourth channel and of its trigger output.
    pub fn trigger(&mut self, triggers: [(bool, bool); 2], now: u64, clock: u64, inputs: Inputs<'_>) {
        let control = self.registers[CR2];
        let Some(&edges) = triggers.get((control >> 16 & 15) as usize) else { return };
        let selected = control & 1 == 1;
        let edge = control >> 20 & 3;
        if selected && (edge & 1 != 0 && edges.0 || edge & 2 != 0 && edges.1) && self.end.is_none() {
            self.start(now, clock, inputs);
        }
    }

    fn start(&mut self, now: u64, clock: u64, inputs: Inputs<'_>) {
        let length = self.registers[JSQR] >> 20 & 3;
        // A sequence of n ends with the fourth entry; without scan mode only the first one is converted.
        let entries = (3 - length..4).map(|entry| self.registers[JSQR] >> (5 * entry) & 31);
        let scans = self.registers[CR1] & 1 << 8 != 0;
        self.sequence = entries.take(if scans { 4 } else { 1 }).collect();
        (self.converted, self.end) = (0, None);
        self.registers[SR] |= 1 << 3;
        self.begin(now, clock, inputs);
    }

    pub fn next(&self) -> u64 {
        self.end.unwrap_or(u64::MAX)
    }

    pub fn advance(&mut self, now: u64, clock: u64, inputs: Inputs<'_>) {
        while self.end.is_some_and(|end| end <= now) {
            self.converted += 1;
            if self.converted == self.sequence.len() {
                self.end = None;
                self.registers[SR] |= 1 << 2;
            } else {
                self.begin(now, clock, inputs);
            }
        }
    }

    pub fn line(&self) -> bool {
        self.registers[SR] >> 2 & self.registers[CR1] >> 7 & 1 == 1
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        self.registers.get(offset as usize / 4).copied()
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64, clock: u64, inputs: Inputs<'_>) -> Option<()> {
        let index = offset as usize / 4;
        match index {
            SR => self.registers[SR] &= value,
            CR2 => {
                self.registers[CR2] = value & !(1 << 22);
                if value & (1 << 22 | 1) == 1 << 22 | 1 {
                    self.start(now, clock, inputs);
                }
            }
            JDR..=0x13 => {}
            _ => *self.registers.get_mut(index)? = value,
        }
        Some(())
    }
}
