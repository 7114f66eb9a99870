//! Builds, tests and measures tesaki.
fn main() {}
