//! The functions of an image, decoded from their instructions: the calls of each, and its stack depth at each
//! call.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use super::thumb::{self, Conditional, Flow, Instruction, Lock, decode};

/// Address of a function, without the instruction-set bit.
pub type Address = u32;

/// A function.
#[derive(Debug, Default)]
pub struct Function {
    pub calls: Vec<Call>,
    /// Undefined instructions, which end in a CPU fault.
    pub traps: Vec<Address>,
    /// Largest stack of its own [bytes].
    pub stack: u32,
    /// Largest stack of its own while it holds no lock [bytes].
    pub open_stack: u32,
    /// Whether it can return to its caller.
    pub returns: bool,
}

/// A call, or a jump to another function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    /// Address of the call.
    pub site: Address,
    /// Called function; `None` for an address in a register.
    pub target: Option<Address>,
    /// Stack of the caller at that point [bytes].
    pub stack: u32,
    /// Whether the caller holds a lock there.
    pub locked: bool,
}

/// State of an `IT` block: which of the next instructions are executed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Under {
    rest: Conditional,
    /// Whether the condition holds.
    holds: bool,
    /// The condition, as long as no executed instruction may have changed it.
    condition: Option<u16>,
}

impl Under {
    /// Returns whether the next instruction is skipped.
    const fn skips(self) -> bool {
        self.rest.count > 0 && (self.rest.then & 1 == 1) != self.holds
    }

    /// Returns the state after the next instruction. After the last one of the block, both sides are the same
    /// unless an `IT` with the same condition follows: `next` is the code there, and the instruction `keeps`
    /// the flags.
    fn after(self, keeps: bool, next: Option<u16>) -> Self {
        let count = self.rest.count.saturating_sub(1);
        let condition = self.condition.filter(|_| keeps);
        if count == 0 && (condition.is_none() || condition != next.and_then(condition_of)) {
            return Self::default();
        }
        Self { rest: Conditional { count, then: self.rest.then >> 1 }, condition, ..self }
    }
}

/// Returns the condition of an `IT`.
fn condition_of(code: u16) -> Option<u16> {
    (code >> 8 == 0xBF && code & 0xF != 0).then_some(code >> 4 & 0xF)
}

/// Position of a path through a function.
#[derive(Clone, Copy, Debug)]
struct Place {
    address: Address,
    /// Stack of the function at that point [bytes].
    stack: i32,
    /// Number of locks that it holds.
    locks: u8,
    under: Under,
}

impl Place {
    /// Splits the path after an `IT` with this condition: here the condition holds, unless `before` already
    /// determines it. Returns the other side.
    fn split(&mut self, conditional: Conditional, condition: Option<u16>, before: Under) -> Option<Self> {
        self.under = Under { rest: conditional, holds: true, condition };
        if before.condition.is_some() && before.condition == condition {
            self.under.holds = before.holds;
            return None;
        }
        Some(Self { under: Under { holds: false, ..self.under }, ..*self })
    }

    /// Updates stack and locks by an instruction.
    fn account(&mut self, instruction: &Instruction) -> Result<()> {
        if instruction.new_stack {
            self.stack = 0;
        }
        self.stack += instruction.push;
        ensure!(self.stack >= 0, "the stack at {:#010x} shrinks below its beginning", self.address);
        match instruction.lock {
            Some(Lock::Begins) => self.locks += 1,
            // Without a lock: the end of an interrupt handler.
            Some(Lock::Ends) => self.locks = self.locks.saturating_sub(1),
            None => {}
        }
        Ok(())
    }

    const fn call(&self, target: Option<Address>) -> Call {
        let Self { address: site, stack, locks, .. } = *self;
        Call { site, target, stack: stack.unsigned_abs(), locked: locks > 0 }
    }
}

/// A function whose paths are being followed.
#[derive(Default)]
struct Paths {
    function: Address,
    result: Function,
    /// Stack [bytes] and number of locks at each instruction, for each state of its condition.
    seen: BTreeMap<(Address, Under), (i32, u8)>,
    /// Positions from which paths have yet to be followed.
    open: Vec<Place>,
    /// Addresses to which the function jumps.
    targets: BTreeSet<Address>,
    /// Jumps by a table whose address is in a register, and where each register is set.
    by_register: Vec<(Address, Address)>,
}

impl Paths {
    /// Returns whether no path has been here. Stack and locks must not depend on the path.
    fn is_new(&mut self, place: &Place) -> Result<bool> {
        let Place { address, stack, locks, under } = *place;
        let known = self.seen.insert((address, under), (stack, locks));
        ensure!(
            known.is_none_or(|known| known == (stack, locks)),
            "the stack or the locks at {address:#010x} depend on the way there"
        );
        Ok(known.is_none())
    }

    fn note_depth(&mut self, place: &Place) {
        let stack = place.stack.unsigned_abs();
        self.result.stack = self.result.stack.max(stack);
        if place.locks == 0 {
            self.result.open_stack = self.result.open_stack.max(stack);
        }
    }
}

/// What fills up code and tables of offsets to a multiple of 4 bytes.
const NOP: u16 = 0xBF00;

/// Begin of the names of code that the compiler has found in several functions.
const OUTLINED: &str = "OUTLINED_FUNCTION";

/// An image.
pub struct Image {
    /// Code and constants, with their addresses.
    sections: Vec<(u32, Vec<u8>)>,
    /// Start addresses of the functions, with their names.
    names: BTreeMap<Address, String>,
    /// Addresses where code begins again after data.
    code: BTreeSet<Address>,
    /// Addresses where data begin after code.
    data: BTreeSet<Address>,
    /// Addresses of the constants between the functions, to which their code refers.
    literals: BTreeSet<Address>,
    functions: BTreeMap<Address, Function>,
    lines: addr2line::Context<gimli::EndianRcSlice<gimli::LittleEndian>>,
}

impl Image {
    /// Reads an ELF file with its debugging information.
    ///
    /// # Errors
    /// It cannot be read, or is not of an ARM processor.
    pub fn read(file: &Path) -> Result<Self> {
        let bytes = std::fs::read(file).with_context(|| file.display().to_string())?;
        let elf = object::File::parse(&*bytes)
            .with_context(|| format!("{} is no complete ELF file: build the image again", file.display()))?;
        ensure!(elf.architecture() == object::Architecture::Arm, "{} is not for ARM", file.display());
        let mut sections = Vec::new();
        for name in [".vector_table", ".text", ".rodata"] {
            let section = elf.section_by_name(name).with_context(|| format!("there is no section {name}"))?;
            sections.push((u32::try_from(section.address())?, section.data()?.to_vec()));
        }
        let (mut names, mut code, mut data) = (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        for symbol in elf.symbols() {
            let address = u32::try_from(symbol.address())?;
            let name = symbol.name()?;
            if symbol.kind() == SymbolKind::Text && !name.starts_with('$') {
                names.insert(address & !1, format!("{:#}", rustc_demangle::demangle(name)));
            } else if name == "$t" || name.starts_with("$t.") {
                code.insert(address);
            } else if name == "$d" || name.starts_with("$d.") {
                data.insert(address);
            }
        }
        let load = |id: gimli::SectionId| {
            let data = elf.section_by_name(id.name()).map(|section| section.data()).transpose()?;
            let data: std::rc::Rc<[u8]> = data.unwrap_or_default().into();
            Ok::<_, anyhow::Error>(gimli::EndianRcSlice::new(data, gimli::LittleEndian))
        };
        let lines = addr2line::Context::from_dwarf(gimli::Dwarf::load(load)?)?;
        let literals = BTreeSet::new();
        let mut image = Self { sections, names, code, data, literals, functions: BTreeMap::new(), lines };
        image.literals = image.literals();
        Ok(image)
    }

    /// Returns the addresses of all constants to which code refers. Code lies between each place where it
    /// begins and the next one where data begin.
    fn literals(&self) -> BTreeSet<Address> {
        let mut literals = BTreeSet::new();
        for &begin in &self.code {
            let length = |bytes: &[u8]| u32::try_from(bytes.len()).unwrap_or(u32::MAX);
            let end = self.sections.iter().map(|(start, bytes)| start.saturating_add(length(bytes)));
            let end = end.filter(|end| *end > begin).min().unwrap_or(begin);
            let next = self.data.range(begin..).chain(self.code.range(begin + 1..).next()).min();
            let next = next.map_or(end, |next| end.min(*next));
            let mut address = begin;
            while address < next
                && let Some(first) = self.half_word(address)
            {
                let second = self.half_word(address + 2).unwrap_or_default();
                literals.extend(thumb::literal(address, first, second));
                address += if first >> 11 < 0b11101 { 2 } else { 4 };
            }
        }
        literals
    }

    /// Returns the entry of the vector table at `index`.
    ///
    /// # Errors
    /// The table is shorter.
    pub fn vector(&self, index: u32) -> Result<Address> {
        let start = self.sections.first().map_or(0, |(start, _)| *start);
        let at = |place| self.half_word(place).map(u32::from).context("the vector table is too short");
        Ok((at(start + 4 * index)? | at(start + 4 * index + 2)? << 16) & !1)
    }

    fn half_word(&self, address: u32) -> Option<u16> {
        self.sections.iter().find_map(|(start, bytes)| {
            let place = usize::try_from(address.checked_sub(*start)?).ok()?;
            Some(u16::from_le_bytes(bytes.get(place..place + 2)?.try_into().ok()?))
        })
    }

    /// Returns the name of a function.
    pub fn name(&self, function: Address) -> &str {
        self.names.get(&function).map_or("a function without a name", String::as_str)
    }

    /// Returns all functions whose names satisfy `matches`.
    pub fn named(&self, matches: impl Fn(&str) -> bool) -> Vec<Address> {
        self.names.iter().filter(|(_, name)| matches(name)).map(|(address, _)| *address).collect()
    }

    /// Returns files and lines of an instruction, the innermost inlined function first.
    pub fn lines(&self, address: Address) -> Vec<(String, u32)> {
        let mut lines = Vec::new();
        let Ok(mut frames) = self.lines.find_frames(address.into()).skip_all_loads() else { return lines };
        while let Ok(Some(frame)) = frames.next() {
            if let Some(location) = frame.location
                && let (Some(file), Some(line)) = (location.file, location.line)
            {
                lines.push((file.to_owned(), line));
            }
        }
        lines
    }

    /// Returns a decoded function.
    pub fn function(&self, address: Address) -> Option<&Function> {
        self.functions.get(&address)
    }

    /// Decodes a function and all functions that it calls directly.
    ///
    /// # Errors
    /// An instruction cannot be decoded.
    pub fn decode(&mut self, function: Address) -> Result<()> {
        if self.functions.contains_key(&function) {
            return Ok(());
        }
        // A function is assumed to return until it has been decoded, also in recursive calls.
        self.functions.insert(function, Function { returns: true, ..Function::default() });
        let decoded =
            self.decoded(function).with_context(|| format!("{} at {function:#010x}", self.name(function)))?;
        self.functions.insert(function, decoded);
        Ok(())
    }

    /// Follows all paths from the function's first instruction.
    fn decoded(&mut self, function: Address) -> Result<Function> {
        let begin = Place { address: function, stack: 0, locks: 0, under: Under::default() };
        let targets = [function].into();
        let mut paths = Paths { function, open: vec![begin], targets, ..Paths::default() };
        while let Some(mut place) = paths.open.pop() {
            while paths.is_new(&place)? && self.step(&mut place, &mut paths)? {}
        }
        for (jump, set) in paths.by_register {
            ensure!(
                paths.targets.range(set + 1..=jump).next().is_none(),
                "the jump at {jump:#010x} is by a table whose address is set at {set:#010x}, but not on \
                 every way there"
            );
        }
        Ok(paths.result)
    }

    /// Advances by one instruction. Returns whether the path continues.
    fn step(&mut self, place: &mut Place, paths: &mut Paths) -> Result<bool> {
        let (first, instruction) = self.instruction(place.address)?;
        let next = place.address + instruction.size;
        let before = place.under;
        let is_skipped = before.skips();
        // Stack operations and moves between registers keep the flags; all others are assumed to change them.
        let keeps = is_skipped || instruction.push != 0 || first >> 8 == 0x46;
        place.under = before.after(keeps, self.half_word(next));
        if is_skipped {
            place.address = next;
            return Ok(true);
        }
        if instruction.conditional.count > 0 {
            let other = place.split(instruction.conditional, condition_of(first), before);
            paths.open.extend(other.map(|other| Place { address: next, ..other }));
        }
        place.account(&instruction)?;
        paths.note_depth(place);
        let goes_on = self.follow(instruction.flow, next, place, paths)?;
        place.address = next;
        Ok(goes_on)
    }

    /// Returns the instruction at an address, with its first half word.
    fn instruction(&self, address: Address) -> Result<(u16, Instruction)> {
        let halves = (self.half_word(address), self.half_word(address + 2));
        let (Some(first), second) = (halves.0, halves.1.unwrap_or_default()) else {
            bail!("there is no code at {address:#010x}");
        };
        let Some(instruction) = decode(address, first, second) else {
            bail!("the instruction {first:04x} {second:04x} at {address:#010x} is not understood");
        };
        Ok((first, instruction))
    }

    /// Records where the instruction at `place` leads. Returns whether the path continues with the `next`
    /// one.
    fn follow(&mut self, flow: Flow, next: Address, place: &Place, paths: &mut Paths) -> Result<bool> {
        match flow {
            Flow::Next => return Ok(true),
            Flow::Jump(to) => self.jump(to, place, paths)?,
            Flow::Branch(to) => {
                self.jump(to, place, paths)?;
                return Ok(true);
            }
            Flow::Table { width, base } => {
                let start = if base == thumb::PC { next } else { self.base(place.address, base, paths)? };
                for to in self.table(next, start, width)? {
                    self.jump(to, place, paths)?;
                }
            }
            Flow::Call(to) => return self.call(&mut paths.result.calls, place.call(Some(to))),
            Flow::CallRegister => return self.call(&mut paths.result.calls, place.call(None)),
            Flow::JumpRegister => {
                paths.result.returns |= self.call(&mut paths.result.calls, place.call(None))?;
            }
            Flow::Return => {
                ensure!(
                    place.stack == 0 && place.locks == 0,
                    "at {:#010x} it returns with {} bytes and {} locks",
                    place.address,
                    place.stack,
                    place.locks
                );
                paths.result.returns = true;
            }
            Flow::Trap => paths.result.traps.push(place.address),
        }
        Ok(false)
    }

    /// Handles a jump within the function, or to another one, which then returns in its place. The code that
    /// several functions share continues them: it may remove from the stack what they have put there.
    fn jump(&mut self, to: Address, place: &Place, paths: &mut Paths) -> Result<()> {
        let name = self.names.get(&to).filter(|_| to != paths.function);
        if name.is_some_and(|name| !name.starts_with(OUTLINED)) {
            let returns = self.call(&mut paths.result.calls, place.call(Some(to)))?;
            ensure!(
                !returns || place.stack == 0,
                "at {:#010x} it ends with {} bytes on the stack",
                place.address,
                place.stack
            );
            paths.result.returns |= returns;
        } else {
            paths.targets.insert(to);
            paths.open.push(Place { address: to, under: Under::default(), ..*place });
        }
        Ok(())
    }

    /// Records a call. Returns whether it returns.
    fn call(&mut self, calls: &mut Vec<Call>, call: Call) -> Result<bool> {
        let target = call.target;
        calls.push(call);
        let Some(target) = target else { return Ok(true) };
        self.decode(target)?;
        Ok(self.functions.get(&target).is_none_or(|function| function.returns))
    }

    /// Returns the address of the table by which the instruction at `jump` jumps: what is in its `register`,
    /// which an ADR on the straight way there has set.
    fn base(&self, jump: Address, register: u32, paths: &mut Paths) -> Result<Address> {
        let mut after = jump;
        loop {
            let before = paths.seen.range(..(after, Under::default())).next_back();
            let Some((&(address, under), _)) = before else { break };
            let (first, instruction) = self.instruction(address)?;
            let goes_on = matches!(instruction.flow, Flow::Next | Flow::Branch(_));
            if address + instruction.size != after || !goes_on {
                break;
            }
            let (first, second) = (u32::from(first), self.half_word(address + 2).unwrap_or_default().into());
            match thumb::near_address(address, first, second) {
                Some((set, table)) if set == register && under.rest.count == 0 => {
                    paths.by_register.push((jump, address));
                    return Ok(table);
                }
                _ if thumb::may_write(register, first, second) => break,
                _ => after = address,
            }
        }
        bail!(
            "the jump at {jump:#010x} is by a table whose address is in r{register}, and no ADR sets it on \
             the way from {after:#010x}"
        )
    }

    /// Returns the targets of the table at `start`, whose offsets count from `origin`, behind the jump by it.
    /// Between the two are only constants. The table ends where the linker has marked code again, or at the
    /// first constant behind its beginning.
    fn table(&self, origin: Address, start: Address, width: u8) -> Result<Vec<Address>> {
        let code = *self.code.range(origin..).next().context("a table without an end")?;
        let data = self.data.range(origin..code).next().context("a table without a beginning")?;
        let is_filled = (origin..*data).step_by(2).all(|place| self.half_word(place) == Some(NOP));
        ensure!(
            is_filled && (*data..code).contains(&start),
            "the table at {start:#010x} is not in the data behind the jump by it, at {origin:#010x}"
        );
        let end = self.literals.range(start + 1..).next().map_or(code, |literal| code.min(*literal));
        ensure!(end - start <= 1024, "a table of {} bytes", end - start);
        let halves: Option<Vec<u16>> = (start..end).step_by(2).map(|place| self.half_word(place)).collect();
        let mut halves = halves.context("a table outside of the image")?;
        // It fills up. As offsets it would be one of 0, or a single one of 96 KiB.
        halves.pop_if(|last| *last == NOP);
        let mut targets = BTreeSet::new();
        for half in halves {
            let entries = if width == 1 { half.to_le_bytes().map(u16::from).to_vec() } else { vec![half] };
            targets.extend(entries.into_iter().map(|entry| origin + 2 * u32::from(entry)));
        }
        // An offset of 0 is padding to an even length.
        targets.remove(&origin);
        ensure!(!targets.is_empty(), "the table at {start:#010x} is empty");
        ensure!(
            targets.iter().all(|target| *target >= code),
            "the table at {start:#010x} leads to its own end"
        );
        Ok(targets.into_iter().collect())
    }
}

#[cfg(test)]
impl Image {
    /// Creates functions one after another from `start` on, with their names and half words.
    pub fn made_up(start: Address, functions: &[(&str, &[u16])]) -> Self {
        let (mut names, mut code) = (BTreeMap::new(), Vec::new());
        for (name, halves) in functions {
            names.insert(start + u32::try_from(code.len()).expect("short"), (*name).to_owned());
            code.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        }
        let empty = |_| Ok::<_, gimli::Error>(gimli::EndianRcSlice::new([].into(), gimli::LittleEndian));
        let lines = gimli::Dwarf::load(empty).and_then(addr2line::Context::from_dwarf).expect("empty");
        let sections = vec![(start, code)];
        Self {
            sections,
            names,
            code: BTreeSet::new(),
            data: BTreeSet::new(),
            literals: BTreeSet::new(),
            functions: BTreeMap::new(),
            lines,
        }
    }

    /// Marks where code and data begin.
    pub fn marked(mut self, code: &[Address], data: &[Address]) -> Self {
        self.code.extend(code);
        self.data.extend(data);
        self.literals = self.literals();
        self
    }
}
