//! The document of the plan format and the code say the same.

use sortie_core::include_plan;
use sortie_core::plan::{Checksums, HEADER_BYTES, Header, Network, Plan, Profile, VERSION};

const DOCUMENT: &str = include_str!("../../../docs/plan-format.md");
const AGENT: &[u8] = include_plan!("../../../tests/golden/plans/agent-1.0.plan");

/// The cells of every row of the table whose first column is headed `heading`.
fn table(heading: &str) -> impl Iterator<Item = Vec<&'static str>> {
    let start = format!("| {heading} |");
    let rows = DOCUMENT.lines().skip_while(move |line| !line.starts_with(&start)).skip(2);
    let rows = rows.take_while(|line| line.starts_with('|'));
    rows.map(|row| row.trim_matches('|').split(" | ").map(str::trim).collect())
}

/// A header whose fields are all different, and each field's bytes by its name in the document.
fn header() -> ([u8; HEADER_BYTES], Vec<(&'static str, Vec<u8>)>) {
    let checksums = Checksums { program: 0x6060_6060, weights: 0x6464_6464 };
    let header = Header {
        layout: 1,
        arena_bytes: 0x2020,
        arena_alignment: 64,
        n_max: 28,
        features: 32,
        actions: 36,
        hidden: 40,
        program_offset: 44,
        program_len: 48,
        weights_offset: 52,
        weights_len: 56,
        source: [68; 32],
        contract: 100,
        max_error: 108.0,
        action_mismatch: 112.0,
        profile: Profile::Exact,
        network: Network::TeamValue,
        t_max: 118,
        arena_bytes_per_agent: 120,
    };
    let word = |value: u32| value.to_le_bytes().to_vec();
    let fields = vec![
        ("magic", b"SORTIEPL".to_vec()),
        ("major", VERSION.0.to_le_bytes().to_vec()),
        ("minor", VERSION.1.to_le_bytes().to_vec()),
        ("endian", vec![4, 3, 2, 1]),
        ("layout", word(header.layout)),
        ("arena_bytes", word(header.arena_bytes)),
        ("arena_alignment", word(header.arena_alignment)),
        ("n_max", word(header.n_max)),
        ("features", word(header.features)),
        ("actions", word(header.actions)),
        ("hidden", word(header.hidden)),
        ("program_offset", word(header.program_offset)),
        ("program_len", word(header.program_len)),
        ("weights_offset", word(header.weights_offset)),
        ("weights_len", word(header.weights_len)),
        ("program_checksum", word(checksums.program)),
        ("weights_checksum", word(checksums.weights)),
        ("source", header.source.to_vec()),
        ("contract", header.contract.to_le_bytes().to_vec()),
        ("max_error", header.max_error.to_le_bytes().to_vec()),
        ("action_mismatch", header.action_mismatch.to_le_bytes().to_vec()),
        ("profile", vec![header.profile.id()]),
        ("network", vec![header.network.id()]),
        ("t_max", header.t_max.to_le_bytes().to_vec()),
        ("arena_bytes_per_agent", word(header.arena_bytes_per_agent)),
        ("reserved", vec![0; 4]),
    ];
    (header.to_bytes(checksums), fields)
}

#[test]
fn the_header_stands_where_the_document_says() {
    let (bytes, fields) = header();
    let (mut end, mut rows) = (0, 0);
    for (row, (name, want)) in table("offset").zip(&fields) {
        let number = |cell: &str| cell.parse::<usize>().expect("a number of the table");
        let (offset, len) = (number(row[0]), number(row[1]));
        assert_eq!((row[3], offset, len), (*name, end, want.len()), "{row:?}");
        assert_eq!(bytes[offset..offset + len], want[..], "{name}");
        (end, rows) = (offset + len, rows + 1);
    }
    assert_eq!((end, rows, table("offset").count()), (HEADER_BYTES, fields.len(), fields.len()));
    assert!(DOCUMENT.contains(&format!("version {}.{}.", VERSION.0, VERSION.1)));
}

#[test]
fn the_example_is_the_program_of_the_golden_plan() {
    let cells = table("bytes").map(|row| row[0].trim_matches('`'));
    let bytes: Vec<u8> = cells
        .flat_map(str::split_whitespace)
        .map(|byte| u8::from_str_radix(byte, 16).expect("a byte of the example"))
        .collect();
    let plan = Plan::load(AGENT).expect("the golden plan");
    let (start, len) = (plan.header().program_offset as usize, plan.header().program_len as usize);
    assert_eq!(bytes, AGENT[start..start + len]);
}

#[test]
fn operators_have_the_documented_numbers() {
    let plan = Plan::load(AGENT).expect("the golden plan");
    let names: Vec<&str> = table("number").map(|row| row[1]).collect();
    for (number, row) in table("number").enumerate() {
        assert_eq!(row[0], number.to_string());
    }
    // The example shows each one's number at its start, in the program's order.
    let shown = table("bytes").filter(|row| names.contains(&row[1]));
    let shown: Vec<(&str, usize)> = shown
        .map(|row| (row[1], usize::from_str_radix(row[0].trim_matches('`'), 16).expect("a number")))
        .collect();
    let ops = plan.program().ops.iter().map(|op| op.name());
    assert!(ops.eq(shown.iter().map(|(name, _)| *name)), "{shown:?}");
    assert!(shown.iter().all(|(name, number)| names.get(*number) == Some(name)), "{shown:?}");
}
