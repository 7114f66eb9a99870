//! `cargo xtask prove`: what holds for every run of an image, read from its instructions.
//!
//! From each vector that the image handles, all functions are followed through their decoded instructions. No path from the
//! control period, the current loop, the timer and the UARTs leads to a panic; no function calls itself; every call leads to
//! known functions. The stack is the sum of the deepest paths of the idle loop and of all interrupts, each with what the
//! processor pushes, because each of them is active once at most.

mod graph;
mod thumb;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};

use crate::firmware;
use crate::tools::ArmCompiler;
use graph::{Address, Call, Image};

/// What the processor pushes with floating-point registers, and what aligns it [bytes].
const EXCEPTION_FRAME: u32 = 26 * 4 + 4;
/// Most bytes of stack, of the 52 KiB that memory.x keeps for it.
const STACK_LIMIT: u32 = 48 * 1024;

/// A vector.
struct Vector {
    name: &'static str,
    /// In the table.
    index: u32,
    /// Whether no path of it may lead to a panic.
    is_proved: bool,
}

/// Interrupts begin behind the processor's own exceptions.
const INTERRUPTS: u32 = 16;

/// What the image handles. Exceptions that end in a reset are not among them: they never return to what they interrupt, and
/// [the fault's handler has a stack of its own](../../../firmware/src/crash.rs).
const VECTORS: [Vector; 7] = [
    Vector { name: "start and idle loop", index: 1, is_proved: false },
    Vector { name: "TIM2: instant of the period", index: INTERRUPTS + 28, is_proved: true },
    Vector { name: "ADC: current loops", index: INTERRUPTS + 18, is_proved: true },
    Vector { name: "USART1: supervisor's line", index: INTERRUPTS + 37, is_proved: true },
    Vector { name: "USART2: plant link", index: INTERRUPTS + 38, is_proved: true },
    Vector { name: "EXTI0: control", index: INTERRUPTS + 6, is_proved: true },
    Vector { name: "EXTI1: supervisor", index: INTERRUPTS + 7, is_proved: false },
];
/// Exceptions with a handler of their own that ends in a reset.
const ENDS: [u32; 2] = [2, 3];

/// A call through a table of methods, known by the text of its line of source.
struct Dynamic {
    call: &'static str,
    /// Part of the names of all functions that it can reach.
    target: &'static str,
}

/// Each stands for a boundary between modules that knows no types; the functions are found in the image.
const DYNAMIC: [Dynamic; 2] = [
    // The tasks see what the joints' servos did, and not their state.
    Dynamic { call: ".effort(", target: "robot::measured::Efforts" },
    // The core asks the board, which it does not know, whether it can drive a robot.
    Dynamic { call: "board(", target: "tesaki_firmware::app::supervisor::{{closure}}" },
];

/// What was found for a vector.
#[derive(Default)]
struct Findings {
    functions: usize,
    /// Places from which a panic is called, or that are one, with their functions.
    panics: BTreeSet<(Address, Address)>,
    resolved: usize,
    problems: Vec<String>,
    stack: u32,
    /// The functions of the deepest path.
    path: Vec<Address>,
}

/// Options of `cargo xtask prove`.
#[derive(clap::Args)]
pub struct Options {
    /// ELF files of images; without any: those of `board-weact` and `board-bare`, built first
    images: Vec<PathBuf>,
}

/// `cargo xtask prove`.
pub fn run(options: &Options) -> Result<()> {
    for image in &options.images {
        check(image)?;
    }
    if !options.images.is_empty() {
        return Ok(());
    }
    let compiler = ArmCompiler::provide()?;
    check(&firmware::build_for_board(compiler, crate::chip::BOARD)?)?;
    check(&firmware::build_for_board(compiler, firmware::BOARD)?)?;
    Ok(())
}

/// Prints what holds for an image. Returns the stack that no run exceeds [bytes].
///
/// # Errors
/// Something does not hold.
pub fn check(file: &Path) -> Result<u32> {
    let mut image = Image::read(file)?;
    println!("\nproved of {}", file.display());
    println!("{:>9} {:>7} {:>8} {:>9}  from", "functions", "panics", "dynamic", "stack");
    let default = image.vector(INTERRUPTS)?;
    let mut problems = Vec::new();
    let mut stack = 0;
    for Vector { name, index, is_proved } in VECTORS {
        let root = image.vector(index)?;
        let found = explore(&mut image, root)?;
        let frame = if index < INTERRUPTS { 0 } else { EXCEPTION_FRAME };
        stack += found.stack + frame;
        let panics = found.panics.len();
        println!(
            "{:>9} {panics:>7} {:>8} {:>9}  {name}",
            found.functions,
            found.resolved,
            found.stack + frame
        );
        if is_proved {
            let told = found.panics.iter().map(|&(site, caller)| {
                format!("{name}: {} panics at {}", image.name(caller), place(&image, site))
            });
            problems.extend(told);
        }
        problems.extend(found.problems.into_iter().map(|problem| format!("{name}: {problem}")));
        if is_proved || index >= INTERRUPTS {
            let deepest: Vec<&str> = found.path.iter().map(|function| image.name(*function)).collect();
            println!("{:>37}  {}", "", shortened(&deepest));
        }
    }
    let handled = |index: &u32| VECTORS.iter().any(|v| v.index == *index) || ENDS.contains(index);
    for index in (1..INTERRUPTS + 82).filter(|index| !handled(index)) {
        let vector = image.vector(index)?;
        if vector != 0 && vector != default {
            problems
                .push(format!("vector {index} has a handler that is not looked at: {}", image.name(vector)));
        }
    }
    println!("{stack:>35}  bytes of stack at most, limit {STACK_LIMIT}");
    if stack > STACK_LIMIT {
        problems.push(format!("{stack} bytes of stack, limit {STACK_LIMIT}"));
    }
    ensure!(problems.is_empty(), "not proved:\n  {}", problems.join("\n  "));
    Ok(stack)
}

/// Looks at all that can run from `root`.
fn explore(image: &mut Image, root: Address) -> Result<Findings> {
    let mut found = Findings::default();
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

/// Stack of a function with all that it calls, and the call that needs most of it.
type Depths = BTreeMap<Address, (u32, Option<Address>)>;

/// Stack from `function` on [bytes].
fn deepest(
    image: &mut Image,
    function: Address,
    found: &mut Findings,
    depths: &mut Depths,
    active: &mut Vec<Address>,
) -> Result<u32> {
    if let Some((known, _)) = depths.get(&function) {
        return Ok(*known);
    }
    if let Some(first) = active.iter().position(|caller| *caller == function) {
        let names: Vec<&str> = active[first..].iter().map(|caller| image.name(*caller)).collect();
        found.problems.push(format!("{} calls itself: {}", image.name(function), shortened(&names)));
        return Ok(0);
    }
    image.decode(function)?;
    active.push(function);
    let Some(decoded) = image.function(function) else { bail!("{function:#010x} was not decoded") };
    let mut depth = (decoded.stack, None);
    found.panics.extend(decoded.traps.iter().map(|&site| (site, function)));
    for Call { site, target, stack } in decoded.calls.clone() {
        let targets = match target {
            Some(target) if is_panic(image.name(target)) => {
                found.panics.insert((site, function));
                continue;
            }
            Some(target) => vec![target],
            None => match resolve(image, site) {
                Ok(targets) => {
                    found.resolved += 1;
                    targets
                }
                Err(problem) => {
                    found.problems.push(format!("{}: {problem}", image.name(function)));
                    continue;
                }
            },
        };
        for target in targets {
            let all = stack + deepest(image, target, found, depths, active)?;
            if all > depth.0 {
                depth = (all, Some(target));
            }
        }
    }
    active.pop();
    depths.insert(function, depth);
    Ok(depth.0)
}

/// Whether a function is the beginning of the end: from there on interrupts are off, the outputs too, and the next thing is a
/// reset.
fn is_panic(name: &str) -> bool {
    let starts = ["core::panicking::", "core::option::expect_failed", "core::option::unwrap_failed"];
    starts.iter().any(|start| name.starts_with(start))
        || name.starts_with("core::result::unwrap_failed")
        || name.contains("rust_begin_unwind")
}

/// All functions that a call by a register can reach.
fn resolve(image: &Image, site: Address) -> Result<Vec<Address>> {
    let lines = image.lines(site);
    for (file, line) in &lines {
        let Ok(source) = std::fs::read_to_string(file) else { continue };
        let Some(text) = source.lines().nth(*line as usize - 1) else { continue };
        if let Some(dynamic) = DYNAMIC.iter().find(|dynamic| text.contains(dynamic.call)) {
            let targets = image.named(|name| name.contains(dynamic.target));
            ensure!(!targets.is_empty(), "there is no function {}", dynamic.target);
            return Ok(targets);
        }
    }
    bail!("an unknown function is called at {}", place(image, site))
}

/// Where an instruction comes from.
fn place(image: &Image, site: Address) -> String {
    let lines = image.lines(site);
    let told: Vec<String> = lines.iter().map(|(file, line)| format!("{}:{line}", short_path(file))).collect();
    format!("{site:#010x}, {}", told.join(" in "))
}

fn short_path(file: &str) -> &str {
    let here = std::env::current_dir().unwrap_or_default();
    file.strip_prefix(&*here.to_string_lossy()).map_or(file, |rest| rest.trim_start_matches('/'))
}

/// A path through functions, by the last two parts of their names.
fn shortened(names: &[&str]) -> String {
    let short = |name: &&str| {
        let parts: Vec<&str> = name.rsplitn(3, "::").take(2).collect();
        parts.into_iter().rev().collect::<Vec<_>>().join("::")
    };
    names.iter().map(short).collect::<Vec<_>>().join(" → ")
}
