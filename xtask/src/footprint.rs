//! What takes the chip's memories: sections, modules, and the largest symbols of an image.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionIndex};
use tesaki_output::say;

/// Most bytes of flash that an image may take: half of the smallest STM32F405, which has 512 KiB. The rest is
/// for what a board adds of its own.
const FLASH_LIMIT: u64 = 256 * 1024;
/// Most bytes of initialised data, which take flash and RAM.
const DATA_LIMIT: u64 = 1024;

/// Rows of the table of modules, and of that of symbols.
const ROWS: usize = 20;
/// Where RAM begins; flash lies below.
const RAM_ORIGIN: u64 = 0x2000_0000;

/// A section that takes memory.
#[derive(Debug, PartialEq, Eq)]
struct Section {
    name: String,
    size: u64,
    /// Its contents are stored in the flash.
    in_flash: bool,
    in_ram: bool,
}

/// A function or a constant in the flash.
#[derive(Debug, PartialEq, Eq)]
struct Symbol {
    /// Demangled.
    name: String,
    size: u64,
}

/// What an image takes.
pub struct Footprint {
    sections: Vec<Section>,
    /// The largest first.
    symbols: Vec<Symbol>,
}

impl Footprint {
    /// Reads it from the image's ELF file.
    ///
    /// # Errors
    /// When the file cannot be read or is no ELF.
    pub fn of(image: &Path) -> Result<Self> {
        let bytes = std::fs::read(image).with_context(|| image.display().to_string())?;
        let elf = object::File::parse(&*bytes)?;
        let mut sections = Vec::new();
        let mut stored: Vec<SectionIndex> = Vec::new();
        for section in elf.sections() {
            let SectionFlags::Elf { sh_flags } = section.flags() else { continue };
            if sh_flags & u64::from(object::elf::SHF_ALLOC) == 0 || section.size() == 0 {
                continue;
            }
            let in_flash = section.file_range().is_some();
            if in_flash {
                stored.push(section.index());
            }
            let (name, size) = (section.name()?.to_owned(), section.size());
            sections.push(Section { name, size, in_flash, in_ram: section.address() >= RAM_ORIGIN });
        }
        // Several names of one place, such as interrupts without a handler of their own, count once.
        let mut by_place = BTreeMap::new();
        for symbol in elf.symbols() {
            if symbol.size() > 0 && symbol.section_index().is_some_and(|section| stored.contains(&section)) {
                let name = format!("{:#}", rustc_demangle::demangle(symbol.name()?));
                by_place.insert(symbol.address(), Symbol { name, size: symbol.size() });
            }
        }
        let mut symbols: Vec<Symbol> = by_place.into_values().collect();
        symbols.sort_by(|a, b| b.size.cmp(&a.size).then_with(|| a.name.cmp(&b.name)));
        Ok(Self { sections, symbols })
    }

    fn sum(&self, includes: impl Fn(&Section) -> bool) -> u64 {
        self.sections.iter().filter(|section| includes(section)).map(|section| section.size).sum()
    }

    /// Bytes stored in the flash.
    pub fn flash(&self) -> u64 {
        self.sum(|section| section.in_flash)
    }

    /// Bytes of static data in RAM.
    pub fn ram(&self) -> u64 {
        self.sum(|section| section.in_ram)
    }

    /// Modules by the flash that their symbols take, the largest first; last, what belongs to no symbol.
    fn modules(&self) -> Vec<(String, u64)> {
        let mut sizes: BTreeMap<String, u64> = BTreeMap::new();
        for symbol in &self.symbols {
            *sizes.entry(module(&symbol.name)).or_default() += symbol.size;
        }
        let mut modules: Vec<(String, u64)> = sizes.into_iter().collect();
        modules.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        let rest = self.flash().saturating_sub(modules.iter().map(|(_, size)| size).sum());
        modules.push(("constants without a name, padding".to_owned(), rest));
        modules
    }

    /// Prints the tables.
    pub fn print(&self) {
        say!("{:>8} {:>8}  section", "flash", "RAM");
        for Section { name, size, in_flash, in_ram } in &self.sections {
            let shown = |there: bool| if there { size.to_string() } else { String::new() };
            say!("{:>8} {:>8}  {name}", shown(*in_flash), shown(*in_ram));
        }
        say!("\n{:>8}  module, by its symbols", "flash");
        let modules = self.modules();
        let (rest, named) = modules.split_last().map_or((None, &[][..]), |(last, named)| (Some(last), named));
        for (name, size) in named.iter().take(ROWS).chain(rest) {
            say!("{size:>8}  {name}");
        }
        say!("\n{:>8}  symbol", "flash");
        for Symbol { name, size } in self.symbols.iter().take(ROWS) {
            say!("{size:>8}  {}", shortened(name));
        }
        say!();
    }

    /// What is beyond its limit, a line each.
    fn excess(&self) -> Vec<String> {
        let data = self.sum(|section| section.in_flash && section.in_ram);
        let limits = [("flash", self.flash(), FLASH_LIMIT), ("initialised data", data, DATA_LIMIT)];
        let over = limits.into_iter().filter(|(_, size, limit)| size > limit);
        over.map(|(what, size, limit)| format!("{size} bytes of {what}, limit {limit}")).collect()
    }

    /// Tells what is beyond its limit.
    ///
    /// # Errors
    /// When something is.
    pub fn check(&self) -> Result<()> {
        let excess = self.excess().join("; ");
        if !excess.is_empty() {
            bail!("the image takes too much: {excess}");
        }
        Ok(())
    }
}

/// The module that a symbol counts for: crate and first module, or the crate alone where there is no module.
fn module(symbol: &str) -> String {
    // `<tesaki::node::Node as core::fmt::Debug>::fmt` and `<&mut T as …>` belong to their type.
    let path = symbol.trim_start_matches(['<', '&', '*', '(', '[']);
    let path =
        ["mut ", "const ", "dyn "].iter().fold(path, |path, word| path.strip_prefix(word).unwrap_or(path));
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let mut names = path.split("::");
    let first = names.next().unwrap_or("");
    let is_path = names.clone().next().is_some() && !first.is_empty() && first.chars().all(is_name);
    if !is_path {
        return "without a module: C, assembly, interrupt handlers".to_owned();
    }
    let second = names.next().filter(|name| name.chars().all(|c| is_name(c) && !c.is_uppercase()));
    // A function directly in its crate has nothing behind it.
    match second.filter(|_| names.next().is_some()) {
        Some(second) => format!("{first}::{second}"),
        None => first.to_owned(),
    }
}

/// The name, cut where it would fill more than a line.
fn shortened(name: &str) -> String {
    const LENGTH: usize = 100;
    if name.chars().count() <= LENGTH {
        name.to_owned()
    } else {
        name.chars().take(LENGTH).chain(['…']).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_belong_to_modules() {
        for (symbol, expected) in [
            ("tesaki::node::tick::run", "tesaki::node"),
            ("<tesaki::grasp::Grip as core::fmt::Debug>::fmt", "tesaki::grasp"),
            ("<&mut tesaki::grasp::Grip as core::fmt::Debug>::fmt", "tesaki::grasp"),
            ("libm::sqrtf", "libm"),
            ("tesaki_firmware::Board::new", "tesaki_firmware"),
            ("memcpy", "without a module: C, assembly, interrupt handlers"),
        ] {
            assert_eq!(module(symbol), expected);
        }
    }

    fn made_up(text: u64, data: u64) -> Footprint {
        let section =
            |name: &str, size, in_flash, in_ram| Section { name: name.into(), size, in_flash, in_ram };
        let symbol = |name: &str, size| Symbol { name: name.into(), size };
        Footprint {
            sections: vec![
                section(".text", text, true, false),
                section(".data", data, true, true),
                section(".bss", 5000, false, true),
            ],
            symbols: vec![
                symbol("tesaki::node::tick", 300),
                symbol("libm::sqrtf", 200),
                symbol("tesaki::node::new", 50),
            ],
        }
    }

    #[test]
    fn flash_and_ram_by_hand() {
        let footprint = made_up(1000, 24);
        assert_eq!((footprint.flash(), footprint.ram()), (1024, 5024));
        let modules = footprint.modules();
        let modules: Vec<(&str, u64)> = modules.iter().map(|(name, size)| (name.as_str(), *size)).collect();
        let rest = ("constants without a name, padding", 474);
        assert_eq!(modules, [("tesaki::node", 350), ("libm", 200), rest]);
    }

    #[test]
    fn what_is_beyond_its_limit_is_told() {
        assert!(made_up(FLASH_LIMIT - 1024, 1024).excess().is_empty());
        let excess = made_up(FLASH_LIMIT - 1024, 1025).excess();
        assert_eq!(
            excess,
            ["262145 bytes of flash, limit 262144", "1025 bytes of initialised data, limit 1024"]
        );
    }
}
