//! Reset and clock control: oscillators, PLL, dividers, clocks of the peripherals, clock security system.

const CR: usize = 0;
const PLLCFGR: usize = 1;
const CFGR: usize = 2;
const CIR: usize = 3;
const CSR: usize = 0x74 / 4;

const INTERNAL: u64 = 16_000_000;

pub struct Rcc {
    registers: [u32; 0x24],
    /// The crystal at the pins [Hz]; `None`: it does not oscillate.
    pub crystal: Option<u64>,
}

impl Rcc {
    pub fn new(crystal: Option<u64>) -> Self {
        let mut registers = [0; 0x24];
        registers[CR] = 0x83;
        registers[PLLCFGR] = 0x2400_3010;
        registers[CSR] = 0x0E00_0000;
        registers[0x30 / 4] = 0x0010_0000;
        Self { registers, crystal }
    }

    /// Resets the registers; `flag` is the cause in CSR.
    pub fn reset(&mut self, flag: u32) {
        let flags = self.registers[CSR] & 0xFE00_0000 | flag | 1 << 26;
        *self = Self::new(self.crystal);
        self.registers[CSR] = flags;
    }

    /// Returns whether the clock of a peripheral is on, given the offset of its register and the bit.
    pub fn enables(&self, offset: usize, bit: u32) -> bool {
        self.registers[offset / 4] >> bit & 1 == 1
    }

    /// Returns whether a peripheral is held in reset.
    pub fn resets(&self, offset: usize, bit: u32) -> bool {
        self.registers[(offset - 0x20) / 4] >> bit & 1 == 1
    }

    pub fn hclk(&self) -> u64 {
        let source = match self.registers[CFGR] >> 2 & 3 {
            0 => INTERNAL,
            1 => self.crystal.unwrap_or(INTERNAL),
            _ => {
                let pll = self.registers[PLLCFGR];
                let input = if pll & 1 << 22 != 0 { self.crystal.unwrap_or(INTERNAL) } else { INTERNAL };
                let (m, n, p) = (u64::from(pll & 63), u64::from(pll >> 6 & 0x1FF), u64::from(pll >> 16 & 3));
                input / m.max(1) * n / (2 * (p + 1))
            }
        };
        let divider = self.registers[CFGR] >> 4 & 15;
        source >> if divider < 8 { 0 } else { [1, 2, 3, 4, 6, 7, 8, 9][divider as usize - 8] }
    }

    fn divider(&self, bus: usize) -> u64 {
        let bits = self.registers[CFGR] >> if bus == 1 { 10 } else { 13 } & 7;
        if bits < 4 { 1 } else { 2 << (bits - 4) }
    }

    /// Returns the clock of bus 1 or 2.
    pub fn pclk(&self, bus: usize) -> u64 {
        self.hclk() / self.divider(bus)
    }

    /// Returns the clock of the timers on bus 1 or 2.
    pub fn timers(&self, bus: usize) -> u64 {
        self.pclk(bus) * if self.divider(bus) == 1 { 1 } else { 2 }
    }

    /// Returns the divider of the crystal for TIM11.
    pub fn rtc_divider(&self) -> u64 {
        (self.registers[CFGR] >> 16 & 31).into()
    }

    /// Stops the crystal. Returns whether the clock security system raises the NMI.
    pub fn stop_crystal(&mut self) -> bool {
        self.crystal = None;
        let supervised = self.registers[CR] & (1 << 19 | 1 << 16) == 1 << 19 | 1 << 16;
        self.registers[CR] &= !(1 << 17);
        if supervised {
            // HSEON and the PLL that it fed go off; the system runs on the internal oscillator.
            self.registers[CR] &= !(1 << 16 | 1 << 24 | 1 << 25);
            self.registers[CFGR] &= !0xF;
            self.registers[CIR] |= 1 << 7;
        }
        supervised
    }

    /// Returns whether the NMI is requested.
    pub fn nmi(&self) -> bool {
        self.registers[CIR] >> 7 & 1 == 1
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        self.registers.get(offset as usize / 4).copied()
    }

    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let index = offset as usize / 4;
        let old = *self.registers.get(index)?;
        self.registers[index] = match index {
            CR => {
                let on = |bit: u32| value >> bit & 1;
                let crystal = on(16) & u32::from(self.crystal.is_some());
                let fed = self.registers[PLLCFGR] & 1 << 22 == 0 || crystal == 1;
                value & !(1 << 17 | 1 << 25 | 2)
                    | on(0) << 1
                    | crystal << 17
                    | (on(24) & u32::from(fed)) << 25
            }
            CFGR => value & !0xC | (value & 3) << 2,
            CIR => value & 0x7F00 | old & 0xFF & !(value >> 16 & 0xFF),
            CSR if value & 1 << 24 != 0 => 0,
            CSR => old & 0xFE00_0000 | value & 1 | (value & 1) << 1,
            _ => value,
        };
        Some(())
    }
}
