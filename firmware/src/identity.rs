//! Who this board is: which image it runs, and which chip it is.

use core::ptr::{addr_of, read_volatile};

use tesaki::protocol::Identity;

use crate::pac;

unsafe extern "C" {
    /// The ELF note with the build id (memory.x): three words and "GNU\0", then the hash.
    static __build_id: [u8; 36];
}

/// Where an STM32F405 keeps its 96-bit unique number (reference manual RM0090, 39.1).
const UNIQUE_NUMBER: *const [u8; 12] = 0x1FFF_7A10 as *const [u8; 12];

/// The identity of this board. A chip whose internal oscillator was never ready is an emulated one, and has no number.
pub fn identity(rcc: &pac::RCC, capabilities: u32) -> Identity {
    // SAFETY: the linker put the note there; volatile, as the compiler cannot know what the linker will write.
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
