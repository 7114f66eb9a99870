//! Identity of the board: image and chip.

use core::ptr::{addr_of, read_volatile};

use tesaki::protocol::Identity;

use crate::pac;

unsafe extern "C" {
    /// The ELF note with the build id (memory.x): three words and "GNU\0", then the hash.
    static __build_id: [u8; 36];
}

/// Address of the 96-bit unique number of an STM32F405 (reference manual RM0090, 39.1).
const UNIQUE_NUMBER: *const [u8; 12] = 0x1FFF_7A10 as *const [u8; 12];

/// Returns the identity of this board. A chip whose internal oscillator is not ready is emulated and has no
/// number.
pub fn identity(rcc: &pac::RCC, capabilities: u32) -> Identity {
    // SAFETY: the linker placed the note there; volatile, because the compiler does not know its content.
    let note = unsafe { read_volatile(addr_of!(__build_id)) };
    let image = note.get(16..24).and_then(|hash| hash.try_into().ok()).unwrap_or_default();
    let board = if rcc.cr().read().hsirdy().bit_is_set() {
        // SAFETY: on this chip the address is readable memory, aligned for bytes, and any bytes are a value.
        unsafe { read_volatile(UNIQUE_NUMBER) }
    } else {
        [0; 12]
    };
    Identity { firmware: tesaki::VERSION, image, board, capabilities }
}
