//! Keys, tokens, attachments, hashes and bytes against what others make of them; a team and a policy behind a carrier that
//! keeps what it is given; and everything that reads bytes, with bytes that are cut, changed and made to hurt.
#![allow(clippy::unwrap_used)]

mod bridges;
mod golden;
mod hostile;
mod samples;

use std::path::Path;

/// A file of tests/golden/ros2, as lines.
fn golden(name: &str) -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/ros2");
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.lines().map(str::to_owned).collect()
}

/// What the independent writers have for `kind name`.
fn independent(kind: &str, name: &str) -> String {
    let start = format!("{kind} {name} ");
    let lines = golden("independent.txt");
    let line = lines.iter().find_map(|line| line.strip_prefix(&start));
    line.unwrap_or_else(|| panic!("no {start}in independent.txt")).to_owned()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes_of(hex: &str) -> Vec<u8> {
    let (pairs, _) = hex.as_bytes().as_chunks::<2>();
    let byte = |pair: &[u8; 2]| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap();
    pairs.iter().map(byte).collect()
}
