//! Tests that cross the crates of tesaki; the tests themselves are in `tests/`. Here is what several of them
//! use.

use std::path::Path;
use std::process::Command;

/// The program `tesaki`, as cargo built it with the running test: cargo tells only tests of
/// `tesaki-supervisor` its path.
///
/// # Panics
/// The program is not there: it is built by `cargo test --workspace`, not by `cargo test -p tesaki-tests`.
pub fn tesaki() -> Command {
    let test = std::env::current_exe().unwrap_or_default();
    // The test is in the folder `deps` beside the program.
    let folder = test.parent().and_then(Path::parent).unwrap_or(&test);
    let program = folder.join("tesaki").with_extension(std::env::consts::EXE_EXTENSION);
    assert!(
        program.is_file(),
        "{} is missing: run `cargo build -p tesaki-supervisor` with the same profile first",
        program.display()
    );
    Command::new(program)
}
