//! Large files designed to be slow give a result, and soon.

use std::time::{Duration, Instant};

use tesaki_fuzz::{TARGETS, large};

/// Each file takes a small part of this, even in an unoptimised build on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

#[test]
fn files_made_to_be_slow_are_read_in_bounded_time() {
    for (target, kinds, texts) in [
        ("robot", &[0, 3][..], large::urdfs(60_000)),
        ("robot", &[0][..], large::urdfs(2_000_000)),
        ("robot", &[1, 2][..], large::tomls(30_000)),
        ("robot", &[1, 2][..], large::tomls(1_000_000)),
        ("files", &[0, 1, 2][..], large::tomls(30_000)),
        ("files", &[0, 1, 2][..], large::tomls(1_000_000)),
    ] {
        let target = TARGETS.iter().find(|known| known.name == target).unwrap_or_else(|| panic!("{target}"));
        for (index, text) in texts.iter().enumerate() {
            for kind in kinds {
                let start = Instant::now();
                (target.run)(&[&[*kind], text.as_bytes()].concat());
                let time = start.elapsed();
                assert!(
                    time < PATIENCE,
                    "{} {kind}, text {index} of {} bytes: {time:?}",
                    target.name,
                    text.len()
                );
            }
        }
    }
}
