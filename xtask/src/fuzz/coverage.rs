//! Coverage of a corpus: edges of the whole program, functions of the project's crates.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use object::{Object, ObjectSymbol};

/// Number covered, and total number.
pub type Part = [u64; 2];

/// Coverage of a corpus.
pub struct Share {
    /// Edges in the functions of the project.
    pub edges: Part,
    /// Functions of the project in the program.
    pub functions: Part,
    /// Functions of the modules that the target tests.
    pub of_target: Part,
}

/// Prefixes of the project's functions.
const PROJECT: [&str; 2] = ["tesaki::", "tesaki_description::"];
/// Addresses in the file `edges` are relative to this function.
const ORIGIN: &str = "rust_fuzzer_test_input";

/// Reads the file `edges` in `folder`, written by `program`. Functions of `modules` that are not covered are
/// listed in the file `uncovered`.
pub fn measure(program: &Path, folder: &Path, modules: &[String]) -> Result<Share> {
    let bytes = std::fs::read(program)?;
    let file = object::File::parse(&*bytes)?;
    let mut symbols: Vec<(u64, &str)> = file
        .symbols()
        .filter(|symbol| symbol.is_definition())
        .filter_map(|symbol| Some((symbol.address(), symbol.name().ok()?)))
        .collect();
    symbols.sort_unstable();
    let origin = symbols.iter().find(|(_, name)| *name == ORIGIN).context("the program has no origin")?.0;
    let text = std::fs::read_to_string(folder.join("edges"))?;
    let mut functions: BTreeMap<u64, (&str, Part)> = BTreeMap::new();
    for line in text.lines() {
        let numbers: Option<Vec<u64>> = line.split(' ').map(|word| word.parse().ok()).collect();
        let Some([offset, _, covered]) = numbers.as_deref() else { anyhow::bail!("not an edge: {line:?}") };
        let address = origin.wrapping_add(*offset);
        let place = symbols.partition_point(|(start, _)| *start <= address).checked_sub(1);
        let Some((start, name)) = place.and_then(|place| symbols.get(place)) else { continue };
        let (_, [all_covered, all]) = functions.entry(*start).or_insert((name, [0, 0]));
        *all += 1;
        *all_covered += covered;
    }
    let mut share = Share { edges: [0; 2], functions: [0; 2], of_target: [0; 2] };
    let mut uncovered = Vec::new();
    for (name, [covered, all]) in functions.values() {
        let name = format!("{:#}", rustc_demangle::demangle(name));
        if !PROJECT.iter().any(|path| is_in(&name, path)) {
            continue;
        }
        add(&mut share.edges, *covered, *all);
        add(&mut share.functions, u64::from(*covered > 0), 1);
        if modules.iter().any(|module| is_in(&name, module)) {
            add(&mut share.of_target, u64::from(*covered > 0), 1);
            if *covered == 0 {
                uncovered.push(name);
            }
        }
    }
    uncovered.sort();
    std::fs::write(folder.join("uncovered"), uncovered.join("\n") + "\n")?;
    Ok(share)
}

fn add(part: &mut Part, covered: u64, all: u64) {
    part[0] += covered;
    part[1] += all;
}

/// Returns whether a function with this name belongs to the module `path`, such as
/// `<tesaki::node::Node>::tick` to `tesaki::node::`.
fn is_in(name: &str, path: &str) -> bool {
    name.trim_start_matches(['<', '&', '[', '(']).trim_start_matches("mut ").starts_with(path)
}

#[cfg(test)]
mod tests {
    use super::is_in;

    #[test]
    fn a_function_is_in_the_module_that_its_type_is_in() {
        for (name, path, expected) in [
            ("<tesaki::node::Node>::tick", "tesaki::node::", true),
            ("<tesaki::node::Node as core::default::Default>::default", "tesaki::node::", true),
            ("<&mut tesaki::node::Node as core::fmt::Debug>::fmt", "tesaki::", true),
            ("tesaki::protocol::codec::encode::<tesaki::node::State>", "tesaki::node::", false),
            ("tesaki_description::urdf::names", "tesaki::", false),
            ("core::ptr::drop_in_place::<tesaki::node::Node>", "tesaki::", false),
        ] {
            assert_eq!(is_in(name, path), expected, "{name}");
        }
    }
}
