//! The document of the plan format and the code say the same.

use sortie_core::include_plan;
use sortie_core::internal::ops::{
    Arrange, AttendAll, Choice, Combination, Combine, Constant, Convolve, ConvolvePatches,
    DenseRows, Flag, Fold, FoldPatches, Function, GroupSum, Gru, GruCell, Input, Int8AttendOwn,
    Int8ConvolvePatches, Int8Dense, Int8EmbedEntities, Int8Layer, Linear, LookUp, LstmCell, Map,
    MaskedSample, MeanRows, Meaning, Members, Multiply, Normalise, Op, OpRef, Output, OutputRows,
    Patches, Place, Reduce, Reduction, Select, Softmax, State,
};
use sortie_core::operators::OpKind;
use sortie_core::plan::{Checksums, HEADER_BYTES, Header, Network, Plan, Profile, Proof, VERSION};

const DOCUMENT: &str = include_str!("../../../../docs/reference/plan-format.md");
const INT8: &[u8] = include_plan!("../../../../tests/golden/plans/agent-int8-2.2.plan");
const PROPOSALS: &[u8] = include_plan!("../../../../tests/golden/plans/proposals-2.0.plan");
const AGENT: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");

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
        proof: Proof::Distance { max_distance: 108.0, inputs: 126 },
        action_mismatch: 112.0,
        profile: Profile::Exact,
        network: Network::TeamValue,
        t_max: 118,
        arena_bytes_per_agent: 120,
        skip: true,
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
        ("max_distance", 108_f32.to_le_bytes().to_vec()),
        ("action_mismatch", header.action_mismatch.to_le_bytes().to_vec()),
        ("profile", vec![header.profile.id()]),
        ("network", vec![header.network.id()]),
        ("t_max", header.t_max.to_le_bytes().to_vec()),
        ("arena_bytes_per_agent", word(header.arena_bytes_per_agent)),
        ("skip", vec![u8::from(header.skip)]),
        ("reserved", vec![0]),
        ("inputs", 126_u16.to_le_bytes().to_vec()),
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
    let number = |cell: &str| usize::from_str_radix(&cell.trim_matches('`')[..2], 16);
    let shown: Vec<(&str, usize)> =
        shown.map(|row| (row[1], number(row[0]).expect("a number"))).collect();
    let ops = plan.program().ops().map(|op| op.name());
    assert!(ops.eq(shown.iter().map(|(name, _)| *name)), "{shown:?}");
    assert!(shown.iter().all(|(name, number)| names.get(*number) == Some(name)), "{shown:?}");
}

/// One of every operator that neither the example has nor an allocator that proposes.
fn other_operators() -> [Op; 9] {
    let layer = Int8Layer { inputs: 1, outputs: 2, weights: 3, steps: 4, bias: 5 };
    let linear = Linear { inputs: 1, outputs: 2, weights: 3, bias: 4 };
    let place = |offset| Place { offset, len: 7 };
    let gru = Gru {
        size: 1,
        input: linear,
        recurrent: linear,
        sparse_input: Flag::Yes,
        from: place(1),
        state: place(2),
        input_gates: place(3),
        recurrent_gates: place(4),
        to: place(5),
    };
    let attend = AttendAll {
        rows: place(1),
        width: 2,
        heads: 3,
        query: linear,
        key: linear,
        value: linear,
        output: linear,
        relu: Flag::Yes,
        queries: place(2),
        keys: place(3),
        values: place(4),
        scores: place(5),
        attended: place(6),
        to: place(7),
    };
    let (rows, to) = (place(1), place(2));
    let int8_attend = Int8AttendOwn {
        rows: place(1),
        width: 2,
        heads: 3,
        query: layer,
        keys: 4,
        key_steps: 5,
        values: 6,
        value_steps: 7,
        output: layer,
        relu: Flag::Yes,
        query_place: place(2),
        absorbed: place(3),
        scores: place(4),
        attended: place(5),
        to: place(6),
        quantised: place(7),
    };
    let (from, quantised, embedded) = (place(3), place(4), place(5));
    [
        Op::Int8EmbedEntities(Int8EmbedEntities {
            layer,
            last_actions: 1,
            relu: Flag::Yes,
            rows,
            quantised,
            embedded,
        }),
        Op::Int8AttendOwn(int8_attend),
        Op::Int8Dense(Int8Dense { layer, relu: Flag::Yes, from, to, quantised }),
        Op::Gru(gru),
        Op::MaskedSample(MaskedSample { from: place(1) }),
        Op::AttendAll(attend),
        Op::MeanRows(MeanRows { rows, width: 3, members: Members::Agents, to }),
        Op::GroupSum(GroupSum { rows, width: 3, groups: 4, to }),
        Op::Output(Output { from: place(1), width: 3, rows: OutputRows::Groups, groups: 4 }),
    ]
}

/// One of every step of a policy.
fn steps() -> [Op; 19] {
    let place = Place { offset: 0, len: 4 };
    let (from, to, left, right) = (place, place, place, place);
    let (columns, a, b) = (4, 0, 0);
    let [sizes, from_strides, to_strides] = [[1; 4]; 3];
    let [count, steps, runs, run_steps, to_steps] = [[1; 2]; 5];
    let patches = Patches { count, steps, runs, run_steps, run: 1, to_steps };
    [
        Op::Input(Input { index: 0, meaning: Meaning::None, to }),
        Op::State(State { from, to }),
        Op::Constant(Constant { weights: 0, to }),
        Op::Map(Map { function: Function::Truncate, a, b, from, to }),
        Op::Combine(Combine { combination: Combination::Or, left, right, to }),
        Op::Select(Select { condition: from, yes: from, no: from, to }),
        Op::Arrange(Arrange { from, to, sizes, from_strides, to_strides }),
        Op::Reduce(Reduce { reduction: Reduction::ArgMax, columns, from, to }),
        Op::Softmax(Softmax { logarithm: Flag::No, columns, from, to }),
        Op::Normalise(Normalise {
            centred: Flag::Yes,
            columns,
            epsilon: 0,
            factors: 0,
            offsets: 0,
            from,
            to,
        }),
        Op::Multiply(Multiply { rows: 1, inner: 1, columns, left, right, to }),
        Op::GruCell(GruCell { input: from, recurrent: from, state: from, to }),
        Op::LstmCell(LstmCell {
            bias: 0,
            input: from,
            recurrent: from,
            cell: from,
            to,
            cell_to: to,
        }),
        Op::Convolve(Convolve {
            layer: Linear { inputs: 1, outputs: 2, weights: 3, bias: 4 },
            relu: Flag::No,
            channels: 1,
            size: [1; 2],
            kernel: [1; 2],
            stride: [1; 2],
            dilation: [1; 2],
            padding: [0; 2],
            result: [1; 2],
            from,
            patch: from,
            point: to,
            to,
        }),
        Op::DenseRows(DenseRows {
            layer: Linear { inputs: 1, outputs: 2, weights: 3, bias: 4 },
            relu: Flag::Yes,
            rows: 2,
            from,
            to,
        }),
        Op::ConvolvePatches(ConvolvePatches {
            weights: 0,
            bias: 0,
            outputs: 1,
            relu: Flag::No,
            patches,
            from,
            to,
        }),
        Op::Int8ConvolvePatches(Int8ConvolvePatches {
            weights: 0,
            steps: 0,
            bias: 0,
            outputs: 1,
            relu: Flag::No,
            patches,
            from,
            to,
            quantised: to,
        }),
        Op::FoldPatches(FoldPatches {
            fold: Fold::Maximum,
            weights: 0,
            bias: 0,
            relu: Flag::No,
            patches,
            from,
            to,
        }),
        Op::LookUp(LookUp {
            choice: Choice::FirstOrLast,
            constant: Flag::No,
            tables: from,
            rows: 2,
            columns: 2,
            indices: from,
            to,
        }),
    ]
}

#[test]
fn functions_have_the_documented_numbers() {
    let functions = |name: &str| {
        let row = table("operator").find(|row| row[0].starts_with(name)).expect("a row");
        row[1].split("; ").map(str::to_owned).collect::<Vec<_>>()
    };
    let [_, _, _, map, combine, _, _, reduce, .., look_up] = steps();
    // The last of each is what the document names last.
    for (op, name, last) in [
        (map, "Map", "x without its fraction"),
        (combine, "Combine", "one other than 0"),
        (reduce, "Reduce", "place of the largest, the first of several"),
        (look_up, "LookUp", "from the first on, else the last row"),
    ] {
        let functions = functions(name);
        assert_eq!(functions.last().map(String::as_str), Some(last));
        let number = (functions.len() - 1) as u32;
        assert_eq!(op.borrow().fields()[..4], number.to_le_bytes(), "{name}");
    }
}

/// Bytes of a list of fields as the document names them.
fn bytes_of_fields(fields: &str) -> usize {
    let (mut bytes, mut names) = (0, 0);
    for field in fields.split(", ") {
        names += 1;
        let Some((_, kind)) = field.split_once("` ") else { continue };
        let each = match kind.trim_end_matches('s') {
            "u16" | "member" | "output row" | "meaning" => 2,
            "u32" | "flag" | "choice" => 4,
            "pair" => 8,
            "quadruple" => 16,
            "place" | "vector" => 8,
            "linear" => 12,
            "int8 layer" => 16,
            "grid" => 4 * 11,
            "row attention" => 4 + 4 * 12,
            _ => panic!("an unknown kind of field: {field}"),
        };
        (bytes, names) = (bytes + each * names, 0);
    }
    assert_eq!(names, 0, "fields without a kind: {fields}");
    bytes
}

#[test]
fn every_operator_is_written_as_documented() {
    let rows: Vec<Vec<&str>> = table("number").collect();
    let names: Vec<&str> = rows.iter().map(|row| row[1]).collect();
    assert!(OpKind::ALL.iter().map(|kind| kind.name()).eq(names.iter().copied()));
    let fits = |op: OpRef<'_>| {
        let row = rows.iter().find(|row| row[1] == op.name()).expect("a row of the table");
        assert_eq!((op.kind() as u16).to_string(), row[0], "{}", op.name());
        assert_eq!(op.fields().len(), bytes_of_fields(row[2]), "{}", op.name());
    };
    other_operators().iter().chain(&steps()).for_each(|op| fits(op.borrow()));
    for plan in [AGENT, PROPOSALS] {
        Plan::load(plan).expect("a golden plan").program().ops().for_each(fits);
    }
}

#[test]
fn choices_have_the_documented_numbers() {
    for (number, rows) in
        [OutputRows::One, OutputRows::Entities, OutputRows::Groups].into_iter().enumerate()
    {
        let output = Output { from: Place { offset: 0, len: 8 }, width: 3, rows, groups: 0 };
        assert_eq!(Op::Output(output).borrow().fields()[12..14], (number as u16).to_le_bytes());
    }
    let meanings = [
        Meaning::None,
        Meaning::OwnRow,
        Meaning::Available,
        Meaning::Rows,
        Meaning::RowsOwnFirst,
        Meaning::Visible,
        Meaning::VisibleOwnFirst,
        Meaning::Blocked,
        Meaning::BlockedOwnFirst,
        Meaning::OwnIndex,
    ];
    assert!(table("in a team").map(|row| row[0]).eq((0..meanings.len()).map(|n| n.to_string())));
    for (number, meaning) in meanings.into_iter().enumerate() {
        let input = Input { index: 0, meaning, to: Place { offset: 0, len: 8 } };
        assert_eq!(Op::Input(input).borrow().fields()[2..4], (number as u16).to_le_bytes());
    }
    for (number, members) in [Members::Present, Members::Agents].into_iter().enumerate() {
        let (rows, to) = (Place { offset: 0, len: 8 }, Place { offset: 8, len: 8 });
        let mean = Op::MeanRows(MeanRows { rows, width: 3, members, to });
        assert_eq!(mean.borrow().fields()[10..12], (number as u16).to_le_bytes());
    }
}

#[test]
fn profiles_have_the_documented_numbers() {
    let row = table("offset").find(|row| row[3] == "profile").expect("a row of the table");
    for (profile, text) in [
        (Profile::Exact, "0: exact"),
        (Profile::Fused, "1: fused multiply-add"),
        (Profile::Int8, "2: int8"),
    ] {
        assert!(row[4].contains(text) && text.starts_with(&profile.id().to_string()), "{text}");
    }
    assert_eq!([Profile::Fused, Profile::Int8].map(Profile::layout), [1, 3]);
}

#[test]
fn int8_weights_stand_where_the_document_says() {
    for text in [
        "P = 4 · ceil(I / 8), strips S = ceil(O / 16)",
        "32 · (s · P + p)    in Int8AttendOwn and Int8Dense",
        "32 · (p · S + s)    in Int8EmbedEntities",
        "byte 2 · (o mod 16) + i mod 2 of the row of pair i / 2 and strip o / 16",
        "Layout 4, int8 for the DSP extension",
    ] {
        assert!(DOCUMENT.contains(text), "{text}");
    }
    let plan = Plan::load(INT8).expect("the golden plan");
    let start = plan.header().weights_offset as usize;
    let Some(OpRef::Int8EmbedEntities(embed)) = plan.program().ops().next() else {
        panic!("another operator")
    };
    let (inputs, outputs) = (usize::from(embed.layer.inputs), usize::from(embed.layer.outputs));
    let (pairs, strips) = (4 * inputs.div_ceil(8), outputs.div_ceil(16));
    let matrix = &INT8[start + 4 * embed.layer.weights as usize..];
    let mut largest = vec![0_u8; outputs];
    for pair in 0..pairs {
        for output in 0..16 * strips {
            for of_pair in 0..2 {
                let row = 32 * (pair * strips + output / 16);
                let weight = (matrix[row + 2 * (output % 16) + of_pair] as i8).unsigned_abs();
                match largest.get_mut(output) {
                    Some(largest) if 2 * pair + of_pair < inputs => *largest = weight.max(*largest),
                    _ => assert_eq!(weight, 0, "padding"),
                }
            }
        }
    }
    // The largest weight of every output is what its step was made for.
    assert_eq!(largest, vec![127; outputs]);
}

#[test]
fn networks_have_the_documented_numbers() {
    let row = table("offset").find(|row| row[3] == "network").expect("a row of the table");
    let networks = [
        (Network::Agent, "0: an agent's utilities"),
        (Network::TeamValue, "1: the value of a team"),
        (Network::Entities, "5: outputs of a network over all entities"),
        (Network::Policy, "6: a policy over inputs of fixed sizes"),
    ];
    for (network, text) in networks {
        assert!(row[4].contains(text) && text.starts_with(&network.id().to_string()), "{text}");
    }
}
