//! Tests that cross the crates of tesaki; they live in `tests/`.
