//! What has an operator of its own in plans: recurrent units, convolutions, functions made of several nodes. Compiling
//! proves each by double precision on 256 inputs, states fed back.

use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_plans::{CompileError, CompileOptions, PolicyOptions};
use tract_onnx::pb::tensor_proto::DataType::Float;

use super::files::File;
use super::plans::{compiled, float, number, numbers, steps};
use crate::compile::compile_policy;

/// Any numbers in [-1, 1], so many of them.
pub(super) fn some(count: usize) -> Vec<f32> {
    (0..count).map(|index| ((index * 37 + 11) % 64) as f32 / 32.0 - 1.0).collect()
}

/// A recurrent unit of 5 inputs and 6 numbers, its biases among them, for one step.
fn unit(operator: &str, gates: usize, states: &[&str]) -> File {
    let (inputs, size) = (5, 6);
    let mut file = File::default()
        .input("x", Float, &["1", "5"])
        .whole("shape", &[1, 1, 5])
        .whole("flat", &[1, 6])
        .constant("W", &[1, gates * size, inputs], &some(gates * size * inputs))
        .constant("R", &[1, gates * size, size], &some(gates * size * size))
        .constant("B", &[1, 2 * gates * size], &some(2 * gates * size));
    let mut given = vec!["step", "W", "R", "B", ""];
    for state in states {
        file = file.input(&format!("{state}_in"), Float, &["1", "1", "6"]);
    }
    let names: Vec<String> = states.iter().map(|state| format!("{state}_in")).collect();
    given.extend(names.iter().map(String::as_str));
    let results: Vec<String> = states.iter().map(|state| format!("{state}_out")).collect();
    let mut outputs = vec!["all"];
    outputs.extend(results.iter().map(String::as_str));
    let mut attributes = vec![number("hidden_size", 6)];
    if gates == 3 {
        attributes.push(number("linear_before_reset", 1));
    }
    file = file
        .node("Reshape", &["x", "shape"], "step")
        .nodes(operator, &given, &outputs, attributes)
        .node("Reshape", &["h_out", "flat"], "h")
        .layer("h", [6, 3], "q")
        .output("q");
    results.iter().fold(file, |file, result| file.output(result))
}

#[test]
fn recurrent_units_are_two_layers_and_a_cell() {
    let found = steps(&unit("GRU", 3, &["h"]));
    assert_eq!(
        found,
        ["Input", "State", "Dense", "Dense", "GruCell", "Dense", "Output", "MaskedArgmax"]
    );
    let found = steps(&unit("LSTM", 4, &["h", "c"]));
    let two = ["Input", "State", "State", "Dense", "Dense", "LstmCell"];
    assert_eq!(found, [&two[..], &["Dense", "Output", "MaskedArgmax"]].concat());
}

/// A convolution of pictures of so many channels and points.
fn convolution(picture: &[&str], kernel: &[usize], attributes: Vec<(&str, Vec<i64>)>) -> File {
    let attributes = attributes.iter().map(|(name, ints)| numbers(name, ints)).collect();
    File::default()
        .input("x", Float, picture)
        .constant("W", kernel, &some(kernel.iter().product()))
        .constant("B", &kernel[..1], &some(kernel[0]))
        .nodes("Conv", &["x", "W", "B"], &["map"], attributes)
        .node("Relu", &["map"], "seen")
        .node("Flatten", &["seen"], "q")
        .output("q")
}

#[test]
fn convolutions_of_all_kinds_are_one_step() {
    let square: &[&str] = &["1", "2", "7", "6"];
    let kernel = [3, 2, 3, 2];
    for attributes in [
        vec![],
        vec![("strides", vec![2, 3])],
        vec![("pads", vec![1, 0, 2, 1])],
        vec![("dilations", vec![2, 3])],
        vec![("strides", vec![2, 1]), ("pads", vec![1, 1, 1, 1]), ("dilations", vec![1, 2])],
    ] {
        let found = steps(&convolution(square, &kernel, attributes));
        assert!(found.starts_with(&["Input", "Convolve", "Output"]), "{found:?}");
    }
    // Channels behind the points, as cameras give them.
    let camera = File::default()
        .input("x", Float, &["1", "7", "6", "2"])
        .constant("W", &kernel, &some(36))
        .node_with("Transpose", &["x"], "picture", vec![numbers("perm", &[0, 3, 1, 2])])
        .nodes("Conv", &["picture", "W"], &["map"], vec![numbers("strides", &[2, 1])])
        .node_with("Transpose", &["map"], "seen", vec![numbers("perm", &[0, 2, 3, 1])])
        .node("Flatten", &["seen"], "q")
        .output("q");
    assert!(steps(&camera).contains(&"Convolve"));
    // Pictures of a history, one behind the other.
    let history = File::default()
        .input("x", Float, &["1", "6", "7", "6"])
        .whole("each", &[3, 2, 7, 6])
        .whole("all", &[1, -1])
        .constant("W", &kernel, &some(36))
        .node("Reshape", &["x", "each"], "pictures")
        .nodes("Conv", &["pictures", "W"], &["map"], vec![numbers("strides", &[2, 1])])
        .nodes("MaxPool", &["map"], &["seen"], vec![numbers("kernel_shape", &[2, 2])])
        .node("Reshape", &["seen", "all"], "q")
        .output("q");
    assert_eq!(steps(&history).iter().filter(|step| **step == "Convolve").count(), 3);
    let line = convolution(&["1", "4", "9"], &[5, 4, 3], vec![("strides", vec![2])]);
    assert!(steps(&line).contains(&"Convolve"));
    let grouped = File::default()
        .input("x", Float, square)
        .constant("W", &[4, 1, 3, 2], &some(24))
        .nodes("Conv", &["x", "W"], &["q"], vec![number("group", 2)])
        .output("q");
    // A step for each group.
    let found = steps(&grouped);
    assert_eq!(found.iter().filter(|step| **step == "Convolve").count(), 2, "{found:?}");
}

#[test]
fn functions_made_of_several_nodes_are_one_step() {
    for alpha in [1.0, 0.3] {
        let file = File::default().input("x", Float, &["1", "9"]);
        let file = file.nodes("Elu", &["x"], &["q"], vec![float("alpha", alpha)]).output("q");
        assert!(steps(&file).starts_with(&["Input", "Map", "Output"]), "{:?}", steps(&file));
    }
    let file = File::default().input("x", Float, &["1", "9"]).node("Erf", &["x"], "q").output("q");
    assert!(steps(&file).contains(&"Map"));
}

#[test]
fn values_share_floats_that_are_not_needed_at_once() {
    let deep = |layers: usize| {
        let mut file = File::default().input("v0", Float, &["1", "64"]);
        for layer in 0..layers {
            let [before, between, after] =
                [format!("v{layer}"), format!("p{layer}"), format!("v{}", layer + 1)];
            file = file.layer(&before, [64, 64], &between).node("Tanh", &[&between], &after);
        }
        let file = file.node("Identity", &[&format!("v{layers}")], "q").output("q");
        let bytes = AlignedBytes::copy_of(&compiled(&file).unwrap().compiled.bytes);
        Plan::load(bytes.as_slice()).unwrap().arena_bytes()
    };
    // Two values of 64 floats and what lies behind the last, however deep the network is.
    assert_eq!([deep(2), deep(9)], [4 * (2 * 64 + 16); 2]);
}

#[test]
fn what_is_read_later_keeps_its_floats() {
    let file = File::default()
        .input("x", Float, &["1", "32"])
        .node("Tanh", &["x"], "first")
        .node("Exp", &["first"], "second")
        .node("Mul", &["second", "second"], "third")
        .node("Sub", &["third", "first"], "fourth")
        .node("Add", &["fourth", "x"], "q")
        .output("q");
    // Compiling has compared the numbers.
    assert!(compiled(&file).is_ok());
}

#[test]
fn weights_of_eight_bits_are_near_and_convolutions_have_none() {
    let options = CompileOptions { profile: Profile::Int8, ..CompileOptions::default() };
    let int8 = |file: &File| compile_policy(&file.bytes(), &PolicyOptions::default(), &options);
    let file = File::default()
        .input("x", Float, &["1", "64"])
        .layer("x", [64, 64], "p0")
        .nodes("Elu", &["p0"], &["v0"], vec![])
        .layer("v0", [64, 5], "q")
        .output("q");
    let exact = compiled(&file).unwrap().compiled;
    let few = int8(&file).unwrap().compiled;
    assert!(few.report.flash_bytes < exact.report.flash_bytes / 2);
    let error = few.report.max_rel_error;
    assert!((1.0e-5..0.05).contains(&error), "{error}");
    let refused = int8(&convolution(&["1", "2", "7", "6"], &[3, 2, 3, 2], vec![]));
    assert!(matches!(refused, Err(CompileError::NoInt8 { .. })));
}
