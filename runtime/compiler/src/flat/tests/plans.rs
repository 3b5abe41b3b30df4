//! What operators become in plans: each is compiled alone, and compiling proves it by double precision on 256 inputs.

use sortie_core::internal::ops::OpRef;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_plans::{CompileError, CompileOptions, CompiledPolicy, PolicyOptions};
use tract_onnx::pb::AttributeProto;
use tract_onnx::pb::tensor_proto::DataType::{Bool, Float};

use super::files::File;
use crate::compile::compile_policy;

pub(super) fn compiled(file: &File) -> Result<CompiledPolicy, CompileError> {
    compile_policy(&file.bytes(), &PolicyOptions::default(), &CompileOptions::default())
}

/// The names of a file's operators in its plan.
pub(super) fn steps(file: &File) -> Vec<&'static str> {
    let bytes = AlignedBytes::copy_of(&compiled(file).unwrap().compiled.bytes);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    plan.program().ops().map(OpRef::name).collect()
}

pub(super) fn number(name: &str, i: i64) -> AttributeProto {
    AttributeProto { name: name.into(), i, r#type: 2, ..Default::default() }
}

pub(super) fn float(name: &str, f: f32) -> AttributeProto {
    AttributeProto { name: name.into(), f, r#type: 1, ..Default::default() }
}

pub(super) fn numbers(name: &str, ints: &[i64]) -> AttributeProto {
    AttributeProto { name: name.into(), ints: ints.to_vec(), r#type: 7, ..Default::default() }
}

/// Two inputs of `[1, 3, 4]`, and one as long as a row.
fn inputs() -> File {
    File::default().input("x", Float, &["1", "3", "4"]).input("y", Float, &["1", "3", "4"]).input(
        "row",
        Float,
        &["1", "1", "4"],
    )
}

fn one(operator: &str, attributes: Vec<AttributeProto>) -> File {
    inputs().node_with(operator, &["x"], "q", attributes).output("q")
}

#[test]
fn functions_of_one_number() {
    for (operator, attributes) in [
        ("Relu", vec![]),
        ("LeakyRelu", vec![float("alpha", 0.2)]),
        ("Elu", vec![float("alpha", 1.5)]),
        ("Selu", vec![]),
        ("Celu", vec![float("alpha", 0.5)]),
        ("Tanh", vec![]),
        ("Sigmoid", vec![]),
        ("HardSigmoid", vec![]),
        ("Softplus", vec![]),
        ("Softsign", vec![]),
        ("Exp", vec![]),
        ("Abs", vec![]),
        ("Neg", vec![]),
        ("Tan", vec![]),
        ("Sinh", vec![]),
        ("Cosh", vec![]),
        ("Asinh", vec![]),
        ("Atan", vec![]),
        ("IsNaN", vec![]),
        ("ReduceProd", vec![numbers("axes", &[2])]),
        ("ReduceProd", vec![numbers("axes", &[0, 1]), number("keepdims", 0)]),
        ("Trilu", vec![number("upper", 0)]),
        ("Identity", vec![]),
        ("Softmax", vec![number("axis", -1)]),
        ("Softmax", vec![number("axis", 1)]),
        ("LogSoftmax", vec![number("axis", 2)]),
        ("ReduceMean", vec![numbers("axes", &[2])]),
        ("ReduceMax", vec![numbers("axes", &[1])]),
        ("ReduceMin", vec![numbers("axes", &[1, 2]), number("keepdims", 0)]),
        ("Transpose", vec![numbers("perm", &[0, 2, 1])]),
        ("Flatten", vec![]),
    ] {
        let compiled = compiled(&one(operator, attributes));
        assert!(compiled.is_ok(), "{operator}: {}", compiled.unwrap_err());
    }
    let file = inputs().node("Abs", &["x"], "size").node("Sqrt", &["size"], "q").output("q");
    assert!(steps(&file).contains(&"Map"));
    let file = inputs()
        .constant("one", &[1], &[1.5])
        .node("Abs", &["x"], "size")
        .node("Add", &["size", "one"], "sum")
        .node("Log", &["sum"], "log")
        .node("Reciprocal", &["sum"], "inverse")
        .node("Mul", &["log", "inverse"], "q")
        .output("q");
    assert!(steps(&file).contains(&"Map"));
}

#[test]
fn functions_of_two_values_repeat_what_is_shorter() {
    for operator in ["Add", "Sub", "Mul", "Min", "Max"] {
        for (left, right) in [("x", "y"), ("x", "row"), ("row", "x"), ("half", "x"), ("x", "half")]
        {
            let file = inputs().constant("half", &[1], &[0.5]);
            let file = file.node(operator, &[left, right], "q").output("q");
            let compiled = compiled(&file);
            assert!(compiled.is_ok(), "{operator} {left} {right}: {}", compiled.unwrap_err());
        }
    }
    for divisor in [0.5, 3.0] {
        let file = inputs().constant("by", &[1], &[divisor]);
        assert!(compiled(&file.node("Div", &["x", "by"], "q").output("q")).is_ok());
    }
    for operator in ["Less", "Greater", "LessOrEqual", "GreaterOrEqual", "Equal"] {
        let file = inputs()
            .node(operator, &["x", "y"], "holds")
            .node("Where", &["holds", "x", "row"], "q")
            .output("q");
        let compiled = compiled(&file);
        assert!(compiled.is_ok(), "{operator}: {}", compiled.unwrap_err());
    }
    let file = inputs()
        .input("mask", Bool, &["1", "3", "4"])
        .node("Not", &["mask"], "hidden")
        .node("Less", &["x", "y"], "less")
        .node("And", &["hidden", "less"], "both")
        .node("Or", &["both", "mask"], "any")
        .node("Xor", &["any", "less"], "one")
        .node("Where", &["one", "x", "y"], "q")
        .output("q");
    assert!(steps(&file).contains(&"Select"));
}

#[test]
fn numbers_move_as_the_graph_says() {
    let file = inputs()
        .whole("last", &[2])
        .whole("some", &[2, 0])
        .node_with("Concat", &["x", "y"], "wide", vec![number("axis", 2)])
        .node_with("Gather", &["wide", "some"], "rows", vec![number("axis", 1)])
        .node_with("Gather", &["wide", "last"], "column", vec![number("axis", 2)])
        .node_with("ReduceSum", &["rows"], "sum", vec![])
        .node("Mul", &["column", "sum"], "q")
        .output("q");
    assert!(steps(&file).contains(&"Arrange"));
    let file = inputs()
        .whole("start", &[1])
        .whole("end", &[3])
        .whole("axis", &[2])
        .node("Slice", &["x", "start", "end", "axis"], "part")
        .node_with("Transpose", &["part"], "q", vec![numbers("perm", &[2, 0, 1])])
        .output("q");
    assert!(steps(&file).contains(&"Arrange"));
    let file = inputs()
        .whole("pads", &[0, 1, 2, 0, 0, 1])
        .constant("around", &[], &[0.5])
        .node("Pad", &["x", "pads", "around"], "q")
        .output("q");
    assert!(steps(&file).contains(&"Arrange"));
}

#[test]
fn products_become_layers_with_their_bias_and_relu() {
    let file = File::default()
        .input("x", Float, &["1", "4"])
        .constant("bias", &[3], &[0.5, -0.25, 0.0])
        .layer("x", [4, 3], "product")
        .node("Add", &["product", "bias"], "sum")
        .node("Relu", &["sum"], "hidden")
        .layer("hidden", [3, 5], "q")
        .output("q");
    assert_eq!(steps(&file), ["Input", "Dense", "Dense", "Output", "MaskedArgmax"]);
    // What something else reads stays a value of its own.
    let file = File::default()
        .input("x", Float, &["1", "4"])
        .constant("bias", &[3], &[0.5, -0.25, 0.0])
        .layer("x", [4, 3], "product")
        .node("Add", &["product", "bias"], "sum")
        .node("Relu", &["sum"], "hidden")
        .node("Mul", &["hidden", "sum"], "both")
        .node("Mul", &["both", "product"], "q")
        .output("q");
    assert_eq!(steps(&file).iter().filter(|step| **step == "Dense").count(), 1);
    // The same layer for every row, and a product of two values.
    let file = inputs()
        .layer("x", [4, 3], "rows")
        .node_with("Transpose", &["y"], "turned", vec![numbers("perm", &[0, 2, 1])])
        .node("MatMul", &["x", "turned"], "scores")
        .node("Add", &["rows", "scores"], "q")
        .output("q");
    let found = steps(&file);
    assert_eq!(found.iter().filter(|step| **step == "DenseRows").count(), 1);
    assert!(found.contains(&"Multiply"));
}

#[test]
fn layer_normalisation_is_a_policy_like_others() {
    let file = inputs()
        .constant("scale", &[4], &[1.0, 0.5, 2.0, 1.0])
        .constant("offset", &[4], &[0.0, 0.5, -1.0, 0.0])
        .node_with("LayerNormalization", &["x", "scale", "offset"], "q", vec![number("axis", -1)])
        .output("q");
    let compiled = compiled(&file);
    assert!(compiled.is_ok(), "{}", compiled.unwrap_err());
}

#[test]
fn what_would_be_computed_otherwise_is_refused() {
    let strings = |name: &str, strings: &[&str]| AttributeProto {
        name: name.into(),
        strings: strings.iter().map(|text| text.as_bytes().to_vec()).collect(),
        ..Default::default()
    };
    let text = |name: &str, text: &str| AttributeProto { s: text.into(), ..strings(name, &[]) };

    let usual = ["Sigmoid", "Tanh"];
    for (operator, attribute, what) in [
        ("RNN", strings("activations", &["Relu"]), "asks for Relu,"),
        ("GRU", strings("activations", &["HardSigmoid", "Tanh"]), "asks for HardSigmoid, Tanh,"),
        ("GRU", strings("activations", &[usual, ["Relu"; 2]].concat()), "Relu, Relu,"),
        ("LSTM", float("clip", 0.5), "asks for clip,"),
        ("LSTM", number("input_forget", 1), "asks for input_forget,"),
        ("Celu", float("alpha", -0.5), "asks for alpha = -0.5,"),
        ("GlobalLpPool", number("p", 2), "asks for a root of its sums,"),
        ("BatchNormalization", number("training_mode", 1), "asks for the means of training,"),
    ] {
        let file = one(operator, vec![attribute]);
        let refused = compiled(&file).unwrap_err();
        assert!(matches!(refused, CompileError::PassedOver { .. }), "{refused}");
        assert!(refused.to_string().contains(what), "{refused}");
    }
    for (operator, attribute) in [
        ("LSTM", strings("activations", &["Sigmoid", "Tanh", "Tanh"])),
        ("GRU", strings("activations", &[usual; 2].concat())),
        ("GRU", text("direction", "forward")),
        ("LSTM", number("input_forget", 0)),
        ("Celu", float("alpha", 1.0)),
    ] {
        let refused = compiled(&one(operator, vec![attribute])).err();
        let is_passed = matches!(refused, Some(CompileError::PassedOver { .. }));
        assert!(!is_passed, "{operator}: {refused:?}");
    }
}

#[test]
fn what_has_no_step_is_named() {
    let file = one("LRN", vec![number("size", 3)]);
    let refused = compiled(&file).unwrap_err();
    let CompileError::Unsupported { node, operator, shapes, .. } = &refused else {
        panic!("{refused}")
    };
    assert_eq!(
        (node.as_str(), operator.as_str(), shapes.as_str()),
        ("q.node", "Lrn", "f32 [1, 3, 4]")
    );
}

#[test]
fn a_state_that_comes_back_as_it_was_is_kept() {
    let file = File::default()
        .input("x", Float, &["1", "4"])
        .input("h_in", Float, &["1", "4"])
        .node("Identity", &["h_in"], "h_out")
        .node("Add", &["x", "h_in"], "q")
        .output("q")
        .output("h_out");
    let CompiledPolicy { compiled, facts, .. } = compiled(&file).unwrap();
    assert_eq!(facts.state_length(), 4);
    let bytes = AlignedBytes::copy_of(&compiled.bytes);
    let plan = Plan::load(bytes.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let (mut states, mut q) = ([1.0, 2.0, 3.0, 4.0], [0.0; 4]);
    plan.respond(arena.as_mut_slice(), &[&[0.5; 4]], &mut states, &mut [&mut q]).unwrap();
    assert_eq!((q, states), ([1.5, 2.5, 3.5, 4.5], [1.0, 2.0, 3.0, 4.0]));
}

#[test]
fn deep_networks_have_many_steps_and_wide_ones_long_layers() {
    let mut file = File::default().input("x.0", Float, &["1", "4"]);
    for layer in 0..300 {
        file = file.node("Sin", &[&format!("x.{layer}")], &format!("x.{}", layer + 1));
    }
    let found = steps(&file.output("x.300"));
    assert_eq!(found.iter().filter(|step| **step == "Map").count(), 300);
    let wide = File::default().input("x", Float, &["1", "9000"]);
    let mut wide = wide.layer("x", [9000, 3], "q");
    wide.0.initializer.iter_mut().for_each(|weights| weights.float_data.fill(0.01));
    assert_eq!(steps(&wide.output("q"))[..2], ["Input", "Dense"]);
}
