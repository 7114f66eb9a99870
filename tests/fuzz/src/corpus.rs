//! Corpora: the inputs of a target in one file, each preceded by its length.

use std::path::{Path, PathBuf};

use crate::Target;

/// Returns the folder of this crate.
fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the file with the corpus of a target.
pub fn path(target: &Target) -> PathBuf {
    folder().join("corpus").join(target.name).with_extension("bin")
}

/// Returns the kept inputs of a target; none if there is no corpus yet.
///
/// # Panics
/// The file is damaged.
pub fn kept(target: &Target) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(path(target)).unwrap_or_default();
    unpack(&bytes).unwrap_or_else(|| panic!("{} is damaged", path(target).display()))
}

/// Returns the inputs that once crashed a target, by name.
pub fn crashes(target: &Target) -> Vec<(String, Vec<u8>)> {
    let files = std::fs::read_dir(folder().join("crashes").join(target.name)).into_iter().flatten().flatten();
    let mut crashes: Vec<_> = files
        .filter_map(|file| {
            let content = std::fs::read(file.path()).ok()?;
            Some((file.file_name().to_string_lossy().into_owned(), content))
        })
        .collect();
    crashes.sort();
    crashes
}

/// Packs inputs into one file.
pub fn pack(inputs: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for input in inputs {
        bytes.extend(u32::try_from(input.len()).unwrap_or_default().to_le_bytes());
        bytes.extend(input);
    }
    bytes
}

fn unpack(mut bytes: &[u8]) -> Option<Vec<Vec<u8>>> {
    let mut inputs = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk() {
        let (input, rest) = rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)?;
        inputs.push(input.to_vec());
        bytes = rest;
    }
    bytes.is_empty().then_some(inputs)
}
