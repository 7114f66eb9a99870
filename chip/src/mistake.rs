//! Mistakes in a driver, seeded into the image by changing what it writes to a register.

/// Changes the writes to an address: the bits of `mask` are replaced by those of `value`.
#[derive(Clone, Copy, Debug)]
pub struct Mistake {
    pub address: u32,
    pub mask: u32,
    pub value: u32,
}

impl Mistake {
    pub fn apply(&self, address: u32, written: u32) -> u32 {
        if address == self.address { written & !self.mask | self.value & self.mask } else { written }
    }
}
