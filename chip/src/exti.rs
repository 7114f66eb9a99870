//! The EXTI lines of pins and of the voltage detector: edges, and their interrupts.

const IMR: usize = 0;
const RTSR: usize = 2;
const FTSR: usize = 3;
const SWIER: usize = 4;
const PR: usize = 5;

/// Lines 0 to 15 are pins, line 16 is the voltage detector.
const LINES: u32 = 0x1_FFFF;
/// Interrupts, and their lines.
pub const INTERRUPTS: [(u32, u32); 8] =
    [(1, 1 << 16), (6, 1), (7, 1 << 1), (8, 1 << 2), (9, 1 << 3), (10, 1 << 4), (23, 0x3E0), (40, 0xFC00)];

#[derive(Default)]
pub struct Exti {
    registers: [u32; 6],
    /// The lines' last levels.
    levels: u32,
}

impl Exti {
    /// Returns the lines that react to edges.
    pub fn watched(&self) -> u32 {
        (self.registers[RTSR] | self.registers[FTSR]) & LINES
    }

    /// Sets the levels of the watched lines.
    pub fn set_levels(&mut self, levels: u32) {
        let (rising, falling) = (levels & !self.levels, !levels & self.levels);
        self.registers[PR] |= rising & self.registers[RTSR] & LINES | falling & self.registers[FTSR] & LINES;
        self.levels = levels;
    }

    /// Returns whether an interrupt of these lines is requested.
    pub fn line(&self, lines: u32) -> bool {
        self.registers[PR] & self.registers[IMR] & lines != 0
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        self.registers.get(offset as usize / 4).copied()
    }

    /// Sets the levels of the watched lines without causing edges.
    pub fn begin(&mut self, levels: u32) {
        self.levels = levels;
    }

    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let index = offset as usize / 4;
        match index {
            PR => self.registers[PR] &= !value,
            SWIER => self.registers[PR] |= value & self.registers[IMR],
            _ => *self.registers.get_mut(index)? = value,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_selected_edges_of_unmasked_lines_interrupt() {
        let mut exti = Exti::default();
        exti.write(0x0C, 1 << 2 | 1 << 4);
        exti.write(0x00, 1 << 4);
        exti.begin(0x14);
        exti.set_levels(0x00);
        assert!(!exti.line(1 << 2) && exti.line(1 << 4));
        assert_eq!(exti.read(0x14), Some(0x14));
        exti.write(0x14, 1 << 4);
        assert_eq!(exti.read(0x14), Some(0x04));
        // A rising edge is not a falling one.
        exti.set_levels(0x14);
        assert!(!exti.line(1 << 4));
    }
}
