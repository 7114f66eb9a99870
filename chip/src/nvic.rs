//! NVIC, SCB, SysTick (registers only) and the exception rules of ARMv7-M: which exceptions are pending, and
//! which may preempt which.

pub const THREAD: i32 = 256;

pub struct Nvic {
    pub enabled: [u32; 8],
    pub pending: [u32; 8],
    pub active: [u32; 8],
    pub priority: [u8; 256],
    pub system_priority: [u8; 12],
    /// System exceptions (numbers 1 to 15), as bits.
    pub system_pending: u16,
    pub system_active: u16,
    pub vtor: u32,
    pub cpacr: u32,
    pub ccr: u32,
    pub shcsr: u32,
    pub prigroup: u32,
    pub reset_requested: bool,
    /// Registers of SysTick.
    pub systick: [u32; 3],
}

impl Nvic {
    pub(crate) fn new() -> Self {
        Self {
            enabled: [0; 8],
            pending: [0; 8],
            active: [0; 8],
            priority: [0; 256],
            system_priority: [0; 12],
            system_pending: 0,
            system_active: 0,
            vtor: 0x0800_0000,
            cpacr: 0,
            ccr: 0x200,
            shcsr: 0,
            prigroup: 0,
            reset_requested: false,
            systick: [0; 3],
        }
    }

    /// Returns the priority of an exception number; lower is more urgent. On an STM32F4 only the upper four
    /// bits count.
    fn priority_of(&self, number: u32) -> i32 {
        match number {
            2 => -2,
            3 => -1,
            4..=15 => i32::from(self.system_priority[number as usize - 4] & 0xF0),
            _ => i32::from(self.priority[number as usize - 16] & 0xF0),
        }
    }

    /// Returns the priority of the active exception. PRIGROUP is 0 to 3 after reset: all four bits are
    /// preemption priority.
    pub fn active_priority(&self) -> i32 {
        let system = (2..16).filter(|n| self.system_active >> n & 1 == 1);
        let external = bits(&self.active).map(|n| n + 16);
        system.chain(external).map(|n| self.priority_of(n)).min().unwrap_or(THREAD)
    }

    /// Returns the most urgent pending exception and its priority.
    fn best(&self) -> Option<(i32, u32)> {
        let system = (2..16).filter(|n| self.system_pending >> n & 1 == 1);
        let mut ready = [0; 8];
        for (ready, (pending, enabled)) in ready.iter_mut().zip(self.pending.iter().zip(&self.enabled)) {
            *ready = pending & enabled;
        }
        system
            .map(|n| (self.priority_of(n), n))
            .chain(bits(&ready).map(|n| (self.priority_of(n + 16), n + 16)))
            .min()
    }

    /// Returns whether an exception is pending that would run if nothing masked it.
    pub fn waits(&self) -> bool {
        (self.system_pending != 0 || self.pending.iter().zip(&self.enabled).any(|(p, e)| p & e != 0))
            && self.best().is_some_and(|(priority, _)| priority < self.active_priority())
    }

    /// Returns the exception to enter now, if any.
    pub fn due(&self, primask: bool, faultmask: bool, basepri: u8) -> Option<u32> {
        let (priority, number) = self.best()?;
        let mut limit = self.active_priority();
        if basepri != 0 {
            limit = limit.min(i32::from(basepri & 0xF0));
        }
        if primask {
            limit = limit.min(0);
        }
        if faultmask {
            limit = limit.min(-1);
        }
        (priority < limit).then_some(number)
    }

    pub fn enter(&mut self, number: u32) {
        if number < 16 {
            self.system_pending &= !(1 << number);
            self.system_active |= 1 << number;
        } else {
            let n = number as usize - 16;
            self.pending[n / 32] &= !(1 << (n % 32));
            self.active[n / 32] |= 1 << (n % 32);
        }
    }

    pub fn leave(&mut self, number: u32) {
        if number < 16 {
            self.system_active &= !(1 << number);
        } else {
            let n = number as usize - 16;
            self.active[n / 32] &= !(1 << (n % 32));
        }
    }

    /// Pends interrupt `n`. A line that stays high pends again when its handler returns.
    pub fn pend(&mut self, n: u32) {
        self.pending[n as usize / 32] |= 1 << (n % 32);
    }
    /// Pends a system exception.
    pub fn pend_system(&mut self, number: u32) {
        self.system_pending |= 1 << number;
    }
    pub fn is_system_active(&self, number: u32) -> bool {
        self.system_active >> number & 1 == 1
    }
    pub fn is_active(&self, n: u32) -> bool {
        self.active[n as usize / 32] >> (n % 32) & 1 == 1
    }

    pub fn read(&self, offset: u32) -> Option<u32> {
        let word = |base: u32| (offset - base) as usize / 4;
        Some(match offset {
            0x010..=0x018 => self.systick[word(0x010)],
            0x100..=0x11C => self.enabled[word(0x100)],
            0x180..=0x19C => self.enabled[word(0x180)],
            0x200..=0x21C => self.pending[word(0x200)],
            0x280..=0x29C => self.pending[word(0x280)],
            0x300..=0x31C => self.active[word(0x300)],
            0x400..=0x4EC => u32::from_le_bytes(self.priority[word(0x400) * 4..][..4].try_into().ok()?),
            0xD00 => 0x410F_C241,
            0xD04 => {
                let pending = self.best().map_or(0, |(_, n)| n << 12);
                let system = (0..16).find(|n| self.system_active >> n & 1 == 1);
                pending | system.or_else(|| bits(&self.active).next().map(|n| n + 16)).unwrap_or(0)
            }
            0xD08 => self.vtor,
            0xD0C => 0xFA05_0000 | self.prigroup << 8,
            0xD10 => 0,
            0xD14 => self.ccr,
            0xD18..=0xD20 => {
                u32::from_le_bytes(self.system_priority[word(0xD18) * 4..][..4].try_into().ok()?)
            }
            0xD24 => self.shcsr,
            0xD28..=0xD3C => 0,
            0xD88 => self.cpacr,
            _ => return None,
        })
    }

    /// Writes a register. `size` matters, because the priority registers are written by bytes.
    pub fn write(&mut self, offset: u32, size: u32, value: u32) -> Option<()> {
        let word = |base: u32| (offset - base) as usize / 4;
        match offset {
            0x010..=0x018 => self.systick[word(0x010)] = value,
            0x100..=0x11C => self.enabled[word(0x100)] |= value,
            0x180..=0x19C => self.enabled[word(0x180)] &= !value,
            0x200..=0x21C => self.pending[word(0x200)] |= value,
            0x280..=0x29C => self.pending[word(0x280)] &= !value,
            0x400..=0x4EF => {
                let at = (offset - 0x400) as usize;
                self.priority[at..at + size as usize].copy_from_slice(&value.to_le_bytes()[..size as usize]);
            }
            0xD04 => {
                if value & 1 << 28 != 0 {
                    self.system_pending |= 1 << 14;
                }
                if value & 1 << 27 != 0 {
                    self.system_pending &= !(1 << 14);
                }
                if value & 1 << 26 != 0 {
                    self.system_pending |= 1 << 15;
                }
                if value & 1 << 25 != 0 {
                    self.system_pending &= !(1 << 15);
                }
                if value & 1 << 31 != 0 {
                    self.system_pending |= 1 << 2;
                }
            }
            0xD08 => self.vtor = value & !0x1FF,
            0xD0C => {
                if value >> 16 == 0x05FA {
                    self.prigroup = value >> 8 & 7;
                    self.reset_requested |= value & 4 != 0;
                }
            }
            0xD10 => {}
            0xD14 => self.ccr = value,
            0xD18..=0xD23 => {
                let at = (offset - 0xD18) as usize;
                self.system_priority[at..at + size as usize]
                    .copy_from_slice(&value.to_le_bytes()[..size as usize]);
            }
            0xD24 => self.shcsr = value,
            0xD28..=0xD3C => {}
            0xD88 => self.cpacr = value,
            0xF00 => self.pend(value & 0x1FF),
            _ => return None,
        }
        Some(())
    }
}

fn bits(words: &[u32; 8]) -> impl Iterator<Item = u32> + '_ {
    words
        .iter()
        .enumerate()
        .filter(|(_, w)| **w != 0)
        .flat_map(|(i, &w)| (0..32).filter(move |b| w >> b & 1 == 1).map(move |b| i as u32 * 32 + b))
}
