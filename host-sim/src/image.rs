//! Firmware images: whether a file is one, and of which board.

/// Finds the board module of an image from the mangled names of its functions: crate, module `boards` and the
/// module of the board, each preceded by its length.
pub fn board_of(image: &[u8]) -> Option<String> {
    const MODULE: &[u8] = b"tesaki_firmware6boards";
    let after = |at| image.get(at + MODULE.len()..at + MODULE.len() + 32);
    let starts = image.windows(MODULE.len()).enumerate().filter(|(_, bytes)| *bytes == MODULE);
    let mut names = starts.filter_map(|(at, _)| {
        let text = after(at)?;
        let digits = text.iter().take_while(|letter| letter.is_ascii_digit()).count();
        let length: usize = std::str::from_utf8(&text[..digits]).ok()?.parse().ok()?;
        String::from_utf8(text.get(digits..digits + length)?.to_vec()).ok()
    });
    names.next()
}

/// Whether the bytes are a whole ELF file for the microcontroller. An emulator runs everything else as a raw
/// image, or not at all.
pub fn check(image: &[u8]) -> Result<(), &'static str> {
    const ARM: usize = 40;
    let number = |at: usize, bytes: usize| {
        let bytes = image.get(at..at + bytes)?;
        Some(bytes.iter().rev().fold(0, |number, &byte| number << 8 | usize::from(byte)))
    };
    if !image.starts_with(b"\x7fELF\x01\x01") || number(18, 2).is_some_and(|machine| machine != ARM) {
        return Err("it is not an ELF file for an ARM microcontroller");
    }
    // The table of the sections stands at the end of the file: its place, the size of a row, their number.
    let table = number(32, 4).zip(number(46, 2)).zip(number(48, 2));
    match table {
        Some(((start, row), rows)) if start + row * rows <= image.len() => Ok(()),
        _ => Err("the file is cut off"),
    }
}

/// Whether functions of the firmware are in it, by their names.
pub fn is_of_tesaki(image: &[u8]) -> bool {
    const CRATE: &[u8] = b"tesaki_firmware";
    image.windows(CRATE.len()).any(|bytes| bytes == CRATE)
}

#[cfg(test)]
mod tests {
    use super::{board_of, check, is_of_tesaki};

    #[test]
    fn only_a_whole_elf_file_for_arm_is_an_image() {
        // ELF of 32 bits, little endian, for ARM; two rows of 40 bytes behind the header of 52.
        let mut whole = b"\x7fELF\x01\x01".to_vec();
        whole.resize(132, 0);
        (whole[18], whole[32], whole[46], whole[48]) = (40, 52, 40, 2);
        assert_eq!(check(&whole), Ok(()));
        for length in 6..132 {
            assert_eq!(check(&whole[..length]), Err("the file is cut off"), "{length}");
        }
        let other = "it is not an ELF file for an ARM microcontroller";
        assert_eq!([check(b""), check(b"hello")], [Err(other); 2]);
        whole[18] = 62;
        assert_eq!(check(&whole), Err(other));
    }

    #[test]
    fn an_image_tells_its_board_by_the_names_of_its_functions() {
        // Mangled as by rustc: `<tesaki_firmware::boards::weact::Board as …>::start`, and a function outside
        // `boards`.
        let names =
            b"_RNvNtCs1_15tesaki_firmware4boot\0_RNvXNtNtCs1_15tesaki_firmware6boards5weactNtB2_5Board\0";
        let padded = [&names[..], &[0; 32]].concat();
        assert_eq!(board_of(&padded).as_deref(), Some("weact"));
        let boot = b"_RNvNtCs1_15tesaki_firmware4boot\0";
        assert!(board_of(boot).is_none() && is_of_tesaki(boot) && !is_of_tesaki(b"_RNvNtCs1_4main\0"));
        // An image that ends within the name.
        assert_eq!(board_of(b"15tesaki_firmware6boards5we"), None);
    }
}
