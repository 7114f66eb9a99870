//! Copying and clearing memory in whole words.
//!
//! The compiler calls these functions for values of some words and more. Its own library has weak ones, which
//! take five instructions for each word and took a tenth of a control period; these take one.

use core::arch::naked_asm;

/// Copies `r2` bytes from `r1` to `r0`, which are multiples of four (Run-time ABI for the Arm Architecture,
/// 4.3.4). Subtracting 16 keeps the low four bits of the number: those of the bytes that remain.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memcpy4(_: *mut u8, _: *const u8, _: usize) {
    naked_asm!(
        "push {{r4, r5}}",
        "subs r2, r2, #16",
        "blo 2f",
        "1: ldm r1!, {{r3, r4, r5, r12}}",
        "stm r0!, {{r3, r4, r5, r12}}",
        "subs r2, r2, #16",
        "bhs 1b",
        // Eight bytes: carry; four: negative.
        "2: lsls r3, r2, #29",
        "itt cs",
        "ldmcs r1!, {{r4, r5}}",
        "stmcs r0!, {{r4, r5}}",
        "itt mi",
        "ldrmi r4, [r1], #4",
        "strmi r4, [r0], #4",
        // Two bytes: carry; one: negative.
        "lsls r3, r2, #31",
        "itt cs",
        "ldrhcs r4, [r1], #2",
        "strhcs r4, [r0], #2",
        "itt mi",
        "ldrbmi r4, [r1]",
        "strbmi r4, [r0]",
        "pop {{r4, r5}}",
        "bx lr",
    )
}

/// The same for multiples of eight.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memcpy8(_: *mut u8, _: *const u8, _: usize) {
    naked_asm!("b {copy}", copy = sym __aeabi_memcpy4)
}

/// Clears `r1` bytes at `r0`, a multiple of four.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memclr4(_: *mut u8, _: usize) {
    naked_asm!(
        "movs r2, #0",
        "movs r3, #0",
        "subs r1, r1, #16",
        "blo 2f",
        "1: strd r2, r3, [r0], #8",
        "strd r2, r3, [r0], #8",
        "subs r1, r1, #16",
        "bhs 1b",
        "2: lsls r12, r1, #29",
        "it cs",
        "strdcs r2, r3, [r0], #8",
        "it mi",
        "strmi r2, [r0], #4",
        "lsls r12, r1, #31",
        "it cs",
        "strhcs r2, [r0], #2",
        "it mi",
        "strbmi r2, [r0]",
        "bx lr",
    )
}

/// The same for a multiple of eight.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memclr8(_: *mut u8, _: usize) {
    naked_asm!("b {clear}", clear = sym __aeabi_memclr4)
}

/// Copies `r2` bytes from `r1` to `r0`, which are multiples of four and may overlap: from the end, if it
/// begins behind the source and within it.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memmove4(_: *mut u8, _: *const u8, _: usize) {
    naked_asm!(
        "subs r3, r0, r1",
        "cmp r3, r2",
        "bhs {copy}",
        "add r0, r0, r2",
        "add r1, r1, r2",
        // Two bytes behind the last word: carry; one: negative.
        "lsls r3, r2, #31",
        "itt mi",
        "ldrbmi r3, [r1, #-1]!",
        "strbmi r3, [r0, #-1]!",
        "itt cs",
        "ldrhcs r3, [r1, #-2]!",
        "strhcs r3, [r0, #-2]!",
        "1: subs r2, r2, #4",
        "it lo",
        "bxlo lr",
        "ldr r3, [r1, #-4]!",
        "str r3, [r0, #-4]!",
        "b 1b",
        copy = sym __aeabi_memcpy4,
    )
}

/// The same for multiples of eight.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn __aeabi_memmove8(_: *mut u8, _: *const u8, _: usize) {
    naked_asm!("b {copy}", copy = sym __aeabi_memmove4)
}
