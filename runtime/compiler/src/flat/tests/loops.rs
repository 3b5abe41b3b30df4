//! Loops and branches: laid open they are steps like others. Compiling proves each by double precision on 256 inputs.

use sortie_plans::PolicyOptions;
use tract_onnx::pb::tensor_proto::DataType::{Bool, Float, Int32, Int64};
use tract_onnx::pb::{AttributeProto, GraphProto};

use super::files::File;
use super::plans::{compiled, number, numbers, steps};
use super::units::some;
use crate::compile::compile_policy;

/// A recurrent unit of 5 inputs and 6 numbers on so many observations; both directions where `sides` is 2.
fn history(operator: &str, gates: usize, turns: usize, sides: usize) -> File {
    let (inputs, size) = (5, 6);
    let mut attributes = vec![number("hidden_size", 6)];
    if gates == 3 {
        attributes.push(number("linear_before_reset", 1));
    }
    if sides == 2 {
        attributes.push(AttributeProto { s: b"bidirectional".to_vec(), ..number("direction", 0) });
    }
    File::default()
        .input("x", Float, &[&turns.to_string(), "1", "5"])
        .constant("W", &[sides, gates * size, inputs], &some(sides * gates * size * inputs))
        .constant("R", &[sides, gates * size, size], &some(sides * gates * size * size))
        .constant("B", &[sides, 2 * gates * size], &some(sides * 2 * gates * size))
        .nodes(operator, &["x", "W", "R", "B"], &["all", "last"], attributes)
}

#[test]
fn units_over_a_history_are_cells_one_behind_the_other() {
    for (operator, gates, cell) in
        [("GRU", 3, "GruCell"), ("LSTM", 4, "LstmCell"), ("RNN", 1, "Map")]
    {
        for (turns, sides) in [(3, 1), (6, 1), (6, 2)] {
            for output in ["all", "last"] {
                let file = history(operator, gates, turns, sides).node("Relu", &[output], "q");
                let found = steps(&file.output("q"));
                let cells = found.iter().filter(|step| **step == cell).count();
                assert!(cells >= turns, "{operator} {turns} {sides} {output}: {found:?}");
            }
        }
    }
}

#[test]
fn lengths_of_a_history_are_all_of_it_or_refused() {
    let of = |lengths: &[i64], is_given: bool| {
        let mut file = history("GRU", 3, 6, 1);
        file = match is_given {
            true => file.input("lengths", Int32, &["1"]),
            false => file.whole("whole", lengths).node_with(
                "Cast",
                &["whole"],
                "lengths",
                vec![number("to", Int32 as i64)],
            ),
        };
        let unit = file.0.node.iter_mut().find(|node| node.op_type == "GRU").unwrap();
        unit.input.push("lengths".to_owned());
        file.0.node.rotate_left(1);
        compiled(&file.node("Relu", &["last"], "q").output("q"))
    };
    assert!(of(&[6], false).is_ok());
    for refused in [of(&[5], false), of(&[], true)] {
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains("sequence_lens"), "{refused}");
    }
}

#[test]
fn a_layer_that_every_turn_has_is_stored_once() {
    let bytes = |turns| {
        let file = history("GRU", 3, turns, 1).node("Relu", &["last"], "q").output("q");
        compiled(&file).unwrap().compiled.report.flash_bytes
    };
    let layer = 4 * 24 * 6;
    assert!(bytes(9) - bytes(8) < layer, "{} {}", bytes(8), bytes(9));
}

#[test]
fn a_loop_of_a_files_own_is_laid_open() {
    let body = File::default()
        .input("state", Float, &["1", "4"])
        .input("row", Float, &["1", "4"])
        .node("Add", &["state", "row"], "sum")
        .node("Tanh", &["sum"], "next")
        .node("Identity", &["next"], "seen")
        .output("next")
        .output("seen");
    let loops = |direction: i64| {
        let body = AttributeProto {
            name: "body".into(),
            g: Some(GraphProto { name: "body".into(), ..body.0.clone() }),
            r#type: 5,
            ..Default::default()
        };
        let directions = numbers("scan_input_directions", &[direction]);
        let attributes = vec![body, number("num_scan_inputs", 1), directions];
        File::default()
            .input("first", Float, &["1", "4"])
            .input("x", Float, &["5", "1", "4"])
            .nodes("Scan", &["first", "x"], &["last", "all"], attributes)
            .node("Relu", &["all"], "q")
            .output("q")
    };
    for direction in [0, 1] {
        assert!(steps(&loops(direction)).iter().filter(|step| **step == "Map").count() >= 5);
    }
}

#[test]
fn a_branch_is_both_of_its_ways_and_a_choice() {
    let way = |operator: &str| {
        let way = File::default().node(operator, &["x"], "way").output("way").0;
        AttributeProto { g: Some(way), r#type: 5, ..Default::default() }
    };
    let named = |name: &str, way: AttributeProto| AttributeProto { name: name.into(), ..way };
    let ways = [("then_branch", "Relu"), ("else_branch", "Tanh")];
    let file = File::default()
        .input("x", Float, &["1", "4"])
        .input("c", Bool, &["1"])
        .nodes("If", &["c"], &["q"], ways.map(|(name, operator)| named(name, way(operator))).into())
        .output("q");
    let options = PolicyOptions { available: Some("none".into()), ..PolicyOptions::default() };
    let compiled = compile_policy(&file.bytes(), &options, &Default::default());
    assert!(compiled.is_ok(), "{}", compiled.unwrap_err());
    assert!(steps(&file).contains(&"Select"));
}

/// A loop whose body adds what it is given of `x`, each turn another row, to its state.
fn counted(turns: i64, goes_on: &str) -> File {
    let body = File::default()
        .input("turn", Int64, &[])
        .input("holds", Bool, &[])
        .input("state", Float, &["1", "4"])
        .whole("first", &[0])
        .constant("half", &[], &[0.5])
        .node_with("Gather", &["x", "turn"], "row", vec![number("axis", 0)])
        .node("Mul", &["state", "half"], "less")
        .node("Add", &["less", "row"], "next")
        .node("Identity", &["holds"], "same")
        .node("Not", &["holds"], "other")
        .node("Squeeze", &["next", "first"], "seen")
        .output(goes_on)
        .output("next")
        .output("seen");
    let body = AttributeProto {
        name: "body".into(),
        g: Some(GraphProto { name: "body".into(), ..body.0 }),
        r#type: 5,
        ..Default::default()
    };
    let mut file = File::default()
        .input("x", Float, &["5", "4"])
        .input("first", Float, &["1", "4"])
        .whole("turns", &[turns])
        .nodes("Loop", &["turns", "", "first"], &["last", "all"], vec![body])
        .node("Add", &["all", "last"], "q")
        .output("q");
    file.0.initializer[0].dims.clear();
    file
}

#[test]
fn a_loop_of_a_constant_count_is_its_turns() {
    for turns in [1, 5] {
        let found = compiled(&counted(turns, "same"));
        assert!(found.is_ok(), "{turns}: {}", found.unwrap_err());
    }
    for (turns, goes_on) in [(5, "other"), (129, "same")] {
        assert!(compiled(&counted(turns, goes_on)).is_err(), "{turns} {goes_on}");
    }
}
