//! Firmware images: whether a file is one, and of which board.

use object::{Architecture, Object, ObjectSymbol};

/// What the names of the functions in an image tell.
#[derive(Debug, PartialEq, Eq)]
pub struct Image {
    /// Module of the board: `bare` of `board-bare`.
    pub board: Option<String>,
    /// Whether functions of the firmware are in it.
    pub is_of_tesaki: bool,
}

impl Image {
    /// Reads a whole ELF file for the microcontroller. An emulator runs everything else as a raw image, or
    /// not at all.
    pub fn parse(bytes: &[u8]) -> Result<Self, &'static str> {
        match object::File::parse(bytes) {
            Ok(file) if file.architecture() == Architecture::Arm => {
                let names = || file.symbols().filter_map(|symbol| symbol.name().ok());
                Ok(Self {
                    board: names().find_map(board_in).map(str::to_owned),
                    is_of_tesaki: names().any(|name| name.contains("tesaki_firmware")),
                })
            }
            Err(_) if bytes.starts_with(&object::elf::ELFMAG) => Err("the file is cut off"),
            _ => Err("it is not an ELF file for an ARM microcontroller"),
        }
    }
}

/// The module of a board in a mangled name: crate, module `boards` and that module, each preceded by its
/// length.
fn board_in(name: &str) -> Option<&str> {
    let (_, rest) = name.split_once("tesaki_firmware6boards")?;
    let module = rest.trim_start_matches(|letter: char| letter.is_ascii_digit());
    let length: usize = rest[..rest.len() - module.len()].parse().ok()?;
    module.get(..length)
}

#[cfg(test)]
mod tests {
    use super::{Image, board_in};

    #[test]
    fn only_a_whole_elf_file_for_arm_is_an_image() {
        // ELF of 32 bits, little endian, version 1, for ARM; behind the header of 52 bytes two rows of 40,
        // the second one of the names of sections.
        let mut whole = b"\x7fELF\x01\x01\x01".to_vec();
        whole.resize(132, 0);
        (whole[18], whole[20], whole[32], whole[40]) = (40, 1, 52, 52);
        (whole[46], whole[48], whole[50], whole[96], whole[112]) = (40, 2, 1, 3, 1);
        assert_eq!(Image::parse(&whole), Ok(Image { board: None, is_of_tesaki: false }));
        for length in 7..132 {
            assert_eq!(Image::parse(&whole[..length]), Err("the file is cut off"), "{length}");
        }
        whole[18] = 62;
        for other in [&whole[..], b"", b"hello"] {
            assert_eq!(Image::parse(other), Err("it is not an ELF file for an ARM microcontroller"));
        }
    }

    #[test]
    fn the_name_of_a_function_tells_the_board() {
        // Mangled by rustc: `<tesaki_firmware::boards::weact::Board as …>::start`, a function outside
        // `boards`, and a name that ends within the module.
        assert_eq!(board_in("_RNvXNtNtCs1_15tesaki_firmware6boards5weactNtB2_5Board"), Some("weact"));
        assert_eq!(board_in("_RNvNtCs1_15tesaki_firmware4boot"), None);
        assert_eq!(board_in("15tesaki_firmware6boards5we"), None);
    }
}
