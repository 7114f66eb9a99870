//! Identity of the board: image and chip.

use core::ptr::{addr_of, read_volatile};

use tesaki::protocol::Identity;

use crate::pac;

unsafe extern "C" {
    /// The ELF note with the build id (memory.x): three words and "GNU\0", then the hash.
    static __build_id: [u32; 9];
}

/// Address of the 96-bit unique number of an STM32F405 (reference manual RM0090, 39.1).
const UNIQUE_NUMBER: *const [u32; 3] = 0x1FFF_7A10 as *const [u32; 3];

/// Returns the identity of this board. A chip whose internal oscillator is not ready is emulated and has no
/// number.
pub fn identity(rcc: &pac::RCC, capabilities: u32) -> Identity {
    // SAFETY: the linker placed the note there, aligned to words; volatile, because the compiler does not
    // know its content.
    let [_, _, _, _, first, second, ..] = unsafe { read_volatile(addr_of!(__build_id)) };
    let image = (u64::from(second) << 32 | u64::from(first)).to_le_bytes();
    let mut board = [0; 12];
    if rcc.cr().read().hsirdy().bit_is_set() {
        // SAFETY: on this chip the address is readable memory, aligned to words, and any words are a value.
        let number = unsafe { read_volatile(UNIQUE_NUMBER) };
        for (bytes, word) in board.chunks_exact_mut(4).zip(number) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
    }
    Identity { firmware: tesaki::VERSION, image, board, capabilities }
}
