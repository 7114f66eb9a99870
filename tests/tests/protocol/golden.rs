//! The frames that `oracles/protocol.py` wrote.

const GOLDEN: &str = include_str!("../../oracles/data/protocol_frames.in");

/// Parses a line of [`GOLDEN`], or of an example.
pub fn parse(line: &str) -> (&str, Vec<u8>) {
    let (name, hex) = line.split_once(": ").unwrap_or_else(|| panic!("{line:?} is not `name: hex`"));
    (name, hex.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect())
}

pub fn golden() -> Vec<(&'static str, Vec<u8>)> {
    GOLDEN.lines().filter(|line| !line.starts_with('#')).map(parse).collect()
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}
