//! `cargo xtask prove`: properties of every run of an image, derived from its instructions.
//!
//! From each vector that the image handles, all functions are followed through their decoded instructions. No
//! path from the control period, the current loop, the timer and the UARTs leads to a panic; no function is
//! recursive; every call leads to known functions. The stack is the sum of the deepest paths of the idle loop
//! and of all interrupts, each with its exception frame, because each of them is active at most once. But
//! while the supervisor's task holds a lock, the control period waits, so of these two only the deeper
//! combination counts: the first with its lock, or both without. The data interrupt of a converter has the
//! priority of the control period, so of these two only the deeper counts as well. On top of all that come a
//! panic, a low supply and a stopped crystal, which could end the run one after another. A CPU fault has a
//! stack of its own.

mod graph;
mod thumb;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use tesaki_output::say;

use crate::firmware;
use crate::tools::ArmCompiler;
use graph::{Address, Call, Image};

/// Size of an exception frame with floating-point registers, and of its alignment [bytes].
const EXCEPTION_FRAME: u32 = 26 * 4 + 4;
/// Maximum stack [bytes], of the 52 KiB that memory.x reserves for it: 4 KiB are a margin.
const STACK_LIMIT: u32 = 48 * 1024;
/// Stack of the handler of a CPU fault [bytes], as in [its file](../../../firmware/src/crash.rs).
const EMERGENCY: u32 = 2048;

/// A vector.
struct Vector {
    name: &'static str,
    /// Index in the vector table.
    index: u32,
    /// Whether no path from it may lead to a panic.
    is_proved: bool,
}

/// Interrupts follow after the processor's own exceptions.
const INTERRUPTS: u32 = 16;
/// EXTI0, EXTI1 and EXTI3.
const CONTROL: u32 = INTERRUPTS + 6;
const SUPERVISOR: u32 = INTERRUPTS + 7;
const DATA: u32 = INTERRUPTS + 9;

/// The vectors that the image handles, but for those of [`ENDS`].
const VECTORS: [Vector; 11] = [
    Vector { name: "start and idle loop", index: 1, is_proved: false },
    Vector { name: "TIM2: instant of the period", index: INTERRUPTS + 28, is_proved: true },
    Vector { name: "ADC: current loops", index: INTERRUPTS + 18, is_proved: true },
    Vector { name: "USART1: supervisor's line", index: INTERRUPTS + 37, is_proved: true },
    Vector { name: "USART2: plant link", index: INTERRUPTS + 38, is_proved: true },
    Vector { name: "UART4: supervisor's line", index: INTERRUPTS + 52, is_proved: true },
    Vector { name: "EXTI2: trip", index: INTERRUPTS + 8, is_proved: true },
    Vector { name: "EXTI4: trip or data", index: INTERRUPTS + 10, is_proved: true },
    Vector { name: "EXTI3: data of a converter", index: DATA, is_proved: true },
    Vector { name: "EXTI0: control", index: CONTROL, is_proved: true },
    Vector { name: "EXTI1: supervisor", index: SUPERVISOR, is_proved: false },
];
/// Vectors whose handlers end in a reset: they never return to the interrupted code.
const ENDS: [(u32, &str); 3] =
    [(2, "NMI: crystal has stopped"), (3, FAULT), (INTERRUPTS + 1, "PVD: supply is low")];
const FAULT: &str = "HardFault: fault of the CPU";

/// A call through a method table.
struct Dynamic {
    /// The end of the receiver's name, and the method, as in the source line.
    call: &'static str,
    /// Part of the names of all functions that it can call.
    target: &'static str,
}

/// Each belongs to a type-erased boundary between modules; the functions are found in the image.
const DYNAMIC: [Dynamic; 1] = [
    // The tasks see the results of the joints' servos, but not their state.
    Dynamic { call: "efforts.effort(", target: "robot::measured::Efforts" },
];

/// Stack of a function including all functions that it calls [bytes].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Depth {
    /// Maximum.
    all: u32,
    /// Maximum while it holds no lock.
    open: u32,
}

/// Findings for a vector.
#[derive(Default)]
struct Findings {
    functions: usize,
    /// Places that call a panic, or are one, with their functions.
    panics: BTreeSet<(Address, Address)>,
    /// The calls through method tables.
    dynamic: Vec<&'static str>,
    problems: Vec<String>,
    stack: Depth,
    /// The functions of the deepest path.
    path: Vec<Address>,
    /// Whether the paths go on into panics, which else are only told.
    enters_panics: bool,
}

/// Options of `cargo xtask prove`.
#[derive(clap::Args)]
pub struct Options {
    /// ELF files of images; without any: those of the boards with motors and of `board-bare`, built first
    #[arg(value_parser = crate::given_path)]
    images: Vec<PathBuf>,
}

/// Runs `cargo xtask prove`.
pub fn run(options: &Options) -> Result<()> {
    for image in &options.images {
        check(image)?;
    }
    if !options.images.is_empty() {
        return Ok(());
    }
    let compiler = ArmCompiler::provide()?;
    for board in crate::chip::BOARDS.into_iter().chain([firmware::BOARD]) {
        check(&firmware::build_for_board(compiler, board)?)?;
    }
    Ok(())
}

/// Prints the proved properties of an image. Returns the stack that no run exceeds [bytes].
///
/// # Errors
/// A property does not hold.
pub fn check(file: &Path) -> Result<u32> {
    let mut image = Image::read(file)?;
    say!("\nproved of {}", file.display());
    say!("{:>9} {:>7} {:>8} {:>9}  from", "functions", "panics", "dynamic", "stack");
    let default = image.vector(INTERRUPTS)?;
    let mut problems = Vec::new();
    let mut dynamic = BTreeSet::new();
    let mut sum = 0;
    let (mut control, mut supervisor) = (0, Depth::default());
    for Vector { name, index, is_proved } in VECTORS {
        let root = image.vector(index)?;
        let found = explore(&mut image, root, false)?;
        let frame = if index < INTERRUPTS { 0 } else { EXCEPTION_FRAME };
        let deepest = found.stack.all + frame;
        match index {
            CONTROL | DATA => control = control.max(deepest),
            SUPERVISOR => supervisor = Depth { all: deepest, open: found.stack.open + frame },
            _ => sum += deepest,
        }
        dynamic.extend(found.dynamic.iter().copied());
        let panics = found.panics.len();
        say!("{:>9} {panics:>7} {:>8} {deepest:>9}  {name}", found.functions, found.dynamic.len());
        if is_proved {
            let told = found.panics.iter().map(|&(site, caller)| {
                format!("{name}: {} panics at {}", image.name(caller), place(&image, site))
            });
            problems.extend(told);
        }
        problems.extend(found.problems.into_iter().map(|problem| format!("{name}: {problem}")));
        if is_proved || index >= INTERRUPTS {
            let deepest: Vec<&str> = found.path.iter().map(|function| image.name(*function)).collect();
            say!("{:>37}  {}", "", shortened(&deepest));
        }
    }
    say!("{:>36}  {} without a lock", "", supervisor.open);
    let mut ends = vec![("panic", image.named(is_panic), 0)];
    for (index, name) in ENDS {
        ends.push((name, vec![image.vector(index)?], EXCEPTION_FRAME));
    }
    for (name, roots, frame) in ends {
        let mut deepest = 0;
        for root in roots {
            let found = explore(&mut image, root, true)?;
            deepest = deepest.max(found.stack.all + frame);
            problems.extend(found.problems.into_iter().map(|problem| format!("{name}: {problem}")));
        }
        say!("{deepest:>36}  {name}");
        if name != FAULT {
            sum += deepest;
        } else if deepest > EMERGENCY {
            problems.push(format!("{name}: {deepest} bytes of stack, limit {EMERGENCY}"));
        }
    }
    let handled =
        |index: &u32| VECTORS.iter().any(|v| v.index == *index) || ENDS.iter().any(|(end, _)| end == index);
    for index in (1..INTERRUPTS + 82).filter(|index| !handled(index)) {
        let vector = image.vector(index)?;
        if vector != 0 && vector != default {
            problems
                .push(format!("vector {index} has a handler that is not looked at: {}", image.name(vector)));
        }
    }
    // An entry that is not needed could be taken for a call that is added later.
    let unused = DYNAMIC.iter().map(|known| known.call).filter(|call| !dynamic.contains(call));
    problems.extend(
        unused.map(|call| format!("no call through a method table is {call}): delete it from DYNAMIC")),
    );
    let stack = sum + supervisor.all.max(supervisor.open + control);
    say!("{stack:>36}  bytes of stack at most, limit {STACK_LIMIT}");
    if stack > STACK_LIMIT {
        problems.push(format!("{stack} bytes of stack, limit {STACK_LIMIT}"));
    }
    ensure!(problems.is_empty(), "not proved:\n  {}", problems.join("\n  "));
    Ok(stack)
}

/// Explores all functions that can run from `root`, with or without those of a panic.
fn explore(image: &mut Image, root: Address, enters_panics: bool) -> Result<Findings> {
    let mut found = Findings { enters_panics, ..Findings::default() };
    let mut depths = BTreeMap::new();
    let mut active = Vec::new();
    found.stack = deepest(image, root, &mut found, &mut depths, &mut active)?;
    found.functions = depths.len();
    let mut function = root;
    while let Some((_, next)) = depths.get(&function) {
        found.path.push(function);
        let Some(next) = next else { break };
        function = *next;
    }
    Ok(found)
}

/// Stack of each function, with the call that needs most of it.
type Depths = BTreeMap<Address, (Depth, Option<Address>)>;

/// Computes the stack from `function` on.
fn deepest(
    image: &mut Image,
    function: Address,
    found: &mut Findings,
    depths: &mut Depths,
    active: &mut Vec<Address>,
) -> Result<Depth> {
    if let Some((known, _)) = depths.get(&function) {
        return Ok(*known);
    }
    if let Some(first) = active.iter().position(|caller| *caller == function) {
        let names: Vec<&str> = active[first..].iter().map(|caller| image.name(*caller)).collect();
        found.problems.push(format!("{} calls itself: {}", image.name(function), shortened(&names)));
        return Ok(Depth::default());
    }
    image.decode(function)?;
    active.push(function);
    let Some(decoded) = image.function(function) else { bail!("{function:#010x} was not decoded") };
    let mut depth = Depth { all: decoded.stack, open: decoded.open_stack };
    let mut next = None;
    found.panics.extend(decoded.traps.iter().map(|&site| (site, function)));
    for Call { site, target, stack, locked } in decoded.calls.clone() {
        let targets = match target {
            Some(target) if !found.enters_panics && is_panic(image.name(target)) => {
                found.panics.insert((site, function));
                continue;
            }
            Some(target) => vec![target],
            None => match resolve(image, site) {
                Ok((call, targets)) => {
                    found.dynamic.push(call);
                    targets
                }
                Err(problem) => {
                    found.problems.push(format!("{}: {problem}", image.name(function)));
                    continue;
                }
            },
        };
        for target in targets {
            let Depth { all, open } = deepest(image, target, found, depths, active)?;
            if stack + all > depth.all {
                (depth.all, next) = (stack + all, Some(target));
            }
            if !locked {
                depth.open = depth.open.max(stack + open);
            }
        }
    }
    active.pop();
    depths.insert(function, (depth, next));
    Ok(depth)
}

/// Returns whether a function starts a panic: from there on, interrupts and outputs are off, and a reset
/// follows.
fn is_panic(name: &str) -> bool {
    let starts = ["core::panicking::", "core::option::expect_failed", "core::option::unwrap_failed"];
    starts.iter().any(|start| name.starts_with(start))
        || name.starts_with("core::result::unwrap_failed")
        || name.contains("rust_begin_unwind")
}

/// Returns the call through a method table at `site`, and all functions that it can reach.
fn resolve(image: &Image, site: Address) -> Result<(&'static str, Vec<Address>)> {
    let Some(Dynamic { call, target }) = dynamic(&image.lines(site)) else {
        bail!("an unknown function is called at {}", place(image, site))
    };
    let targets = image.named(|name| name.contains(target));
    ensure!(!targets.is_empty(), "there is no function {target}");
    Ok((call, targets))
}

/// Returns the known call in the innermost of `lines`. The others only call the function that was inlined
/// there, whatever that calls.
fn dynamic(lines: &[(String, u32)]) -> Option<&'static Dynamic> {
    let (file, line) = lines.first()?;
    let source = std::fs::read_to_string(file).ok()?;
    let text = source.lines().nth((*line as usize).checked_sub(1)?)?;
    let is_name = |before: char| before.is_alphanumeric() || before == '_';
    let is_in = |call| text.match_indices(call).any(|(begin, _)| !text[..begin].ends_with(is_name));
    DYNAMIC.iter().find(|known| is_in(known.call))
}

/// Describes the source of an instruction.
fn place(image: &Image, site: Address) -> String {
    let lines = image.lines(site);
    let told: Vec<String> = lines.iter().map(|(file, line)| format!("{}:{line}", short_path(file))).collect();
    if told.is_empty() { format!("{site:#010x}") } else { format!("{site:#010x}, {}", told.join(" in ")) }
}

fn short_path(file: &str) -> &str {
    let here = std::env::current_dir().unwrap_or_default();
    file.strip_prefix(&*here.to_string_lossy()).map_or(file, |rest| rest.trim_start_matches('/'))
}

/// Formats a path through functions with the last two parts of their names.
fn shortened(names: &[&str]) -> String {
    let short = |name: &&str| {
        let parts: Vec<&str> = name.rsplitn(3, "::").take(2).collect();
        parts.into_iter().rev().collect::<Vec<_>>().join("::")
    };
    names.iter().map(short).collect::<Vec<_>>().join(" → ")
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Address = 0x0800_0000;

    /// Encodes a BL by the given number of half words from the next instruction.
    const fn call(halves: i16) -> [u16; 2] {
        let offset = halves.cast_unsigned();
        [if halves < 0 { 0xF7FF } else { 0xF000 }, 0xF800 | offset & 0x7FF]
    }

    fn explored(functions: &[(&str, &[u16])]) -> Findings {
        explore(&mut Image::made_up(START, functions), START, false).expect("is understood")
    }

    #[test]
    fn two_blocks_under_one_condition_go_together() {
        // sub sp, #16; itt ne; INSTRUCTION; addne sp, #16; it ne; bxne lr; add sp, #16; bx lr.
        let explored = |instruction| {
            let code = [0xB084, 0xBF1C, instruction, 0xB004, 0xBF18, 0x4770, 0xB004, 0x4770];
            explore(&mut Image::made_up(START, &[("function", &code)]), START, false)
        };
        // mov r0, r4.
        assert_eq!(explored(0x4620).expect("is understood").stack, Depth { all: 16, open: 16 });
        // cmp r0, #0: the second condition is different.
        assert!(explored(0x2800).is_err());
    }

    /// An end that several functions share frees what they have put on the stack.
    #[test]
    fn shared_code_continues_the_function_that_jumps_to_it() {
        // push {r4, r5, r6, r7, lr}; b.w. pop {r4, r5, r6, r7, pc}.
        let jumper: &[u16] = &[0xB5F0, 0xF000, 0xB800];
        let found = explored(&[("jumper", jumper), ("OUTLINED_FUNCTION_0", &[0xBDF0])]);
        assert_eq!((found.stack.all, found.functions), (20, 1));
        let explored = |name| {
            explore(&mut Image::made_up(START, &[("jumper", jumper), (name, &[0xBDF0])]), START, false)
        };
        assert!(explored("other").is_err());
        // bx lr: nobody frees it.
        assert!(
            explore(&mut Image::made_up(START, &[("jumper", jumper), ("other", &[0x4770])]), START, false)
                .is_err()
        );
        // push {r4, lr}; bx lr: what it has put on the stack stays there.
        assert!(explore(&mut Image::made_up(START, &[("other", &[0xB510, 0x4770])]), START, false).is_err());
    }

    /// 8 bytes for two registers plus 16 of the called function; or 20, which are freed before the jump.
    #[test]
    fn stacks_add_up_along_the_deepest_path() {
        let [first, second] = call(2);
        // push {r4, lr}; bl; pop {r4, pc}. sub sp, #16; add sp, #16; bx lr.
        let caller = [0xB510, first, second, 0xBD10, 0xBF00];
        let other = [0xB084, 0xB004, 0x4770];
        let found = explored(&[("caller", &caller), ("other", &other)]);
        assert_eq!((found.stack, found.functions, found.path.len()), (Depth { all: 24, open: 24 }, 2, 2));
        assert_eq!((found.panics.len(), found.problems.len()), (0, 0));
        // push {r4-r7, lr}; pop {r4-r7, lr} (as add sp, #20); b.w.
        let jumper = [0xB5F0, 0xB005, 0xF000, 0xB800];
        assert_eq!(explored(&[("jumper", &jumper), ("other", &other)]).stack.all, 20);
    }

    #[test]
    fn a_panic_behind_another_function_is_found_with_its_place() {
        let [first, second] = call(1);
        let caller = [0xB510, first, second, 0xBD10];
        let [third, fourth] = call(0);
        let other = [0xB510, third, fourth];
        let found =
            explored(&[("caller", &caller), ("other", &other), ("core::panicking::panic", &[0xE7FE])]);
        assert_eq!(found.panics, [(START + 10, START + 8)].into());
        // cbz r0, +4; udf; bx lr.
        let traps = explored(&[("traps", &[0xB100, 0xDEFE, 0x4770])]);
        assert_eq!(traps.panics, [(START + 2, START)].into());
    }

    /// 8 bytes each of the caller and of the panic.
    #[test]
    fn the_stack_of_a_panic_counts_where_it_is_entered() {
        let [first, second] = call(0);
        let caller = [0xB510, first, second];
        let functions: [(&str, &[u16]); 2] =
            [("caller", &caller), ("core::panicking::panic", &[0xB510, 0xE7FE])];
        let stack = |enters_panics| {
            let found = explore(&mut Image::made_up(START, &functions), START, enters_panics);
            found.expect("is understood").stack.all
        };
        assert_eq!([stack(false), stack(true)], [8, 16]);
    }

    #[test]
    fn a_function_that_calls_itself_is_found() {
        let [first, second] = call(1);
        let [back, again] = call(-7);
        let one = [0xB510, first, second, 0xBD10];
        let two = [0xB510, back, again, 0xBD10];
        let found = explored(&[("one", &one), ("two", &two)]);
        assert_eq!(found.problems, ["one calls itself: one → two"]);
    }

    #[test]
    fn a_dynamic_call_is_known_by_its_receiver_in_the_innermost_line() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let source = "io.efforts.effort(1)\nself.observer.effort(2)\nno_efforts.effort(3)\nlaw(4)\n";
        std::fs::write(&file, source).expect("is written");
        let is_known = |lines: &[u32]| {
            let place = |line: &u32| (file.path().display().to_string(), *line);
            dynamic(&lines.iter().map(place).collect::<Vec<_>>()).is_some()
        };
        assert!(is_known(&[1]) && is_known(&[1, 4]));
        for other in [&[2][..], &[3], &[4, 1], &[0], &[5], &[]] {
            assert!(!is_known(other), "{other:?}");
        }
    }

    #[test]
    fn a_call_of_an_unknown_function_is_found() {
        let found = explored(&[("caller", &[0xB510, 0x4790, 0xBD10])]);
        assert_eq!(found.problems, ["caller: an unknown function is called at 0x08000002"]);
    }

    /// 16 bytes more where the lock blocks interrupts, 4 where it does not.
    #[test]
    fn what_a_lock_protects_is_told_apart() {
        let [first, second] = call(5);
        let [third, fourth] = call(4);
        // push {r4, lr}; msr basepri_max, r0; bl deep; msr basepri, r0; bl flat; pop {r4, pc}.
        let code = [0xB510, 0xF380, 0x8812, first, second, 0xF380, 0x8811, third, fourth, 0xBD10];
        let deep = [0xB084, 0xB004, 0x4770];
        let flat = [0xB081, 0xB001, 0x4770];
        let found = explored(&[("code", &code), ("deep", &deep), ("flat", &flat)]);
        assert_eq!((found.stack, found.problems.len()), (Depth { all: 24, open: 12 }, 0));
    }

    /// tbb [pc, r1]; .byte 2, 3, 2, 0; bx lr; udf.
    #[test]
    fn a_table_behind_its_jump_leads_on() {
        let code: &[u16] = &[0xE8DF, 0xF001, 0x0302, 0x0002, 0x4770, 0xDEFE];
        let mut image =
            Image::made_up(START, &[("function", code)]).marked(&[START, START + 8], &[START + 4]);
        let found = explore(&mut image, START, false).expect("is understood");
        assert_eq!(found.panics, [(START + 10, START)].into());
    }

    /// A table whose address is in a register, between constants. Code around the `adr` and its offset vary:
    /// ldr r1, [pc, #24]; BEFORE; adr.w r2, #OFFSET; AFTER; tbb [r2, r1]; nop; .word;
    /// .byte 9, 10, 11, 9, 11, 0; nop; .word; bx lr; udf; sub sp, #16; add sp, #16; bx lr.
    fn by_register(before: u16, offset: u16, after: u16) -> Result<Findings> {
        let jump = [0x4906, before, 0xF20F, 0x0200 | offset, after, 0xE8D2, 0xF001, 0xBF00];
        let table = [0xD70A, 0x3C23, 0x0A09, 0x090B, 0x000B, 0xBF00, 0xD70A, 0x3CA3];
        let code = [&jump[..], &table, &[0x4770, 0xDEFE, 0xB084, 0xB004, 0x4770]].concat();
        let image = Image::made_up(START, &[("function", &code)]);
        explore(&mut image.marked(&[START, START + 0x20], &[START + 0x10]), START, false)
    }

    #[test]
    fn a_table_whose_address_is_in_a_register_leads_on() {
        // nop; ldr r3, [r1]; beq to the last part.
        for after in [0xBF00, 0x680B, 0xD00C] {
            let found = by_register(0xBF00, 12, after).expect("is understood");
            assert_eq!((found.stack.all, found.panics), (16, [(START + 0x22, START)].into()));
        }
    }

    #[test]
    fn a_table_whose_address_is_unknown_is_told() {
        let not_set =
            "the jump at 0x0800000a is by a table whose address is in r2, and no ADR sets it on the way";
        for (what, before, offset, after, told) in [
            ("movs r2, #0", 0xBF00, 12, 0x2200, not_set),
            ("blx r3", 0xBF00, 12, 0x4798, not_set),
            ("it eq", 0xBF08, 12, 0xBF00, not_set),
            ("cbz r1, to the instruction behind the adr", 0xB109, 12, 0xBF00, "but not on every way there"),
            ("a table before the jump", 0xBF00, 0, 0xBF00, "is not in the data behind the jump by it"),
        ] {
            let problem = by_register(before, offset, after).err().expect(what);
            assert!(format!("{problem:#}").contains(told), "{what}: {problem:#}");
        }
    }

    /// push {r4, lr}; cmp r0, #0; itt ne; popne {r4, lr}; bxne lr; pop {r4, pc}.
    #[test]
    fn both_sides_of_a_condition_have_their_own_stack() {
        let code = [0xB510, 0x2800, 0xBF1C, 0xE8BD, 0x4010, 0x4770, 0xBD10];
        let found = explored(&[("conditional", &code)]);
        assert_eq!((found.stack.all, found.problems.len()), (8, 0));
    }
}
