//! Damaged files of objects are refused or still valid.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki_rng::Rng;
use tesaki_sim::plant::ObjectValues;

/// Number of files; the same ones in each run.
const RUNS: u64 = 3000;

/// Words that are inserted into files.
const WORDS: &[&str] = &[
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "-0",
    "0",
    ",",
    "\n",
    "\r\n",
    "\"",
    "=",
    "[",
    "]",
    "{",
    "top = 0.5",
    "shape = \"wedge\"",
    "shape = \"cylinder\"",
    "#",
    "\u{feff}",
    "é",
    "9999999999999999999999",
];

/// Returns `text` with some of its pieces removed, repeated or replaced.
fn damaged(seed: u64, text: &str) -> String {
    let mut rng = Rng::new(seed, 0);
    let mut below = |limit: usize| rng.below(limit.try_into().unwrap()) as usize;
    let mut chars: Vec<char> = text.chars().collect();
    for _ in 0..=below(4) {
        let start = below(chars.len() + 1);
        let end = chars.len().min(start + below(12));
        let piece: Vec<char> = match below(4) {
            0 => Vec::new(),
            1 => chars[start..end].repeat(2),
            2 => (0..below(4)).map(|_| char::from_u32(below(128).try_into().unwrap()).unwrap()).collect(),
            _ => WORDS[below(WORDS.len())].chars().collect(),
        };
        chars.splice(start..end, piece);
    }
    chars.into_iter().collect()
}

#[test]
fn a_damaged_object_is_refused_or_valid() {
    let mut accepted = 0;
    for name in ["box", "cylinder", "wedge"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3/objects");
        let good = std::fs::read_to_string(folder.join(name).with_extension("toml")).unwrap();
        assert!(ObjectValues::from_toml(&good).is_ok());
        for seed in 0..RUNS / 3 {
            match ObjectValues::from_toml(&damaged(seed, &good)) {
                Ok(object) => {
                    accepted += 1;
                    let numbers = [&[object.mass][..], &object.size].concat();
                    let all = numbers.iter().all(|number| number.is_finite() && *number > 0.0);
                    assert!(all, "{name}, seed {seed}: {object:?}");
                }
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
    }
    assert!((1..RUNS).contains(&accepted), "{accepted}");
}
