//! The independent watchdog (RM0090, 21). Its oscillator has its nominal 32 kHz.

use crate::SECOND;

pub struct Iwdg {
    prescaler: u32,
    reload: u32,
    writable: bool,
    /// When it resets the chip.
    pub end: Option<u64>,
}

impl Iwdg {
    pub(crate) fn new() -> Self {
        Self { prescaler: 0, reload: 0xFFF, writable: false, end: None }
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            0x0 | 0xC => Some(0),
            0x4 => Some(self.prescaler),
            0x8 => Some(self.reload),
            _ => None,
        }
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64) -> Option<()> {
        match (offset, value) {
            (0, 0x5555) => self.writable = true,
            (0, 0xAAAA | 0xCCCC) => {
                self.writable &= value == 0xCCCC;
                if self.end.is_some() || value == 0xCCCC {
                    // It starts from 0xFFF, whatever was set; only the reload key takes the reload value.
                    let counts = if value == 0xCCCC { 0xFFF } else { self.reload };
                    let periods = (u64::from(counts) + 1) * (4 << self.prescaler.min(6));
                    self.end = Some(now + periods * SECOND / 32_000);
                }
            }
            (0, _) => self.writable = false,
            (4, _) if self.writable => self.prescaler = value & 7,
            (8, _) if self.writable => self.reload = value & 0xFFF,
            (4 | 8 | 12, _) => {}
            _ => return None,
        }
        Some(())
    }
}
