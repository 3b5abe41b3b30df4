//! What has an operator of its own in plans: recurrent units, convolutions, functions made of several nodes. Compiling
//! proves each by double precision on 256 inputs, states fed back.

use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_plans::{CompileOptions, PolicyOptions};
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

/// The steps of a file that do more than move numbers.
fn work(file: &File) -> Vec<&'static str> {
    let mut found = steps(file);
    let moves = ["Input", "Constant", "Arrange", "Output", "MaskedArgmax"];
    found.retain(|step| !moves.contains(step));
    found
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
        assert_eq!(work(&convolution(square, &kernel, attributes)), ["ConvolvePatches"]);
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
    assert!(!steps(&camera).contains(&"Arrange"), "{:?}", steps(&camera));
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
    assert_eq!(work(&history), [["ConvolvePatches"; 3], ["FoldPatches"; 3]].concat());
    let line = convolution(&["1", "4", "9"], &[5, 4, 3], vec![("strides", vec![2])]);
    assert_eq!(work(&line), ["ConvolvePatches"]);
}

#[test]
fn groups_of_channels_have_a_step_each_and_single_channels_one_for_all() {
    let grouped = |kernel: &[usize], groups| {
        let kernels = some(kernel.iter().product());
        let pads = numbers("pads", &[1, 0, 1, 1]);
        File::default()
            .input("x", Float, &["1", "4", "7", "6"])
            .constant("V", &[4, 4, 1, 1], &some(16))
            .constant("W", kernel, &kernels)
            .nodes("Conv", &["x", "V"], &["mixed"], vec![])
            .nodes("Conv", &["mixed", "W"], &["map"], vec![number("group", groups), pads])
            .node("Relu", &["map"], "q")
            .output("q")
    };
    let found = work(&grouped(&[6, 2, 3, 2], 2));
    assert_eq!(found.iter().filter(|step| **step == "ConvolvePatches").count(), 2 + 1, "{found:?}");
    let found = work(&grouped(&[4, 1, 3, 2], 4));
    assert_eq!(found.last(), Some(&"FoldPatches"), "{found:?}");
    // Two outputs of every channel.
    let found = work(&grouped(&[8, 1, 3, 2], 4));
    assert_eq!(found.iter().filter(|step| **step == "ConvolvePatches").count(), 4 + 1, "{found:?}");
}

/// Two convolutions with something between them, and what becomes of the last.
fn two_convolutions(
    between: &dyn Fn(File) -> File,
    pads: &[i64],
    tail: &dyn Fn(File) -> File,
) -> File {
    let file = File::default()
        .input("x", Float, &["1", "3", "9", "8"])
        .constant("V", &[17, 3, 3, 3], &some(17 * 27))
        .constant("W", &[5, 17, 3, 2], &some(5 * 17 * 6))
        .nodes("Conv", &["x", "V"], &["first"], vec![]);
    let file =
        between(file).nodes("Conv", &["between", "W"], &["second"], vec![numbers("pads", pads)]);
    tail(file)
}

/// A block of a transformer without its attention, on the points of a picture: a layer beside them, their norm, a layer.
fn block_on_tokens(file: File) -> File {
    file.whole("sizes", &[1, 5, -1])
        .node("Reshape", &["second", "sizes"], "rows")
        .node_with("Transpose", &["rows"], "points", vec![numbers("perm", &[0, 2, 1])])
        .constant("start", &[1, 1, 5], &some(5))
        .node_with("Concat", &["start", "points"], "tokens", vec![number("axis", 1)])
        .constant("T", &[5, 5], &some(25))
        .constant("bias", &[5], &some(5))
        .constant("scale", &[5], &some(5))
        .node("MatMul", &["tokens", "T"], "product")
        .node("Add", &["product", "bias"], "layer")
        .node("Add", &["tokens", "layer"], "sum")
        .constant("offset", &[5], &some(5))
        .node("LayerNormalization", &["sum", "scale", "offset"], "norm")
        .constant("L", &[5, 3], &some(15))
        .node("MatMul", &["norm", "L"], "q")
        .output("q")
}

#[test]
fn tokens_that_the_graph_turns_stand_row_behind_row() {
    let relu = |file: File| file.node("Relu", &["first"], "between");
    let file = two_convolutions(&relu, &[0; 4], &block_on_tokens);
    let steps = steps(&file);
    // Three put the tokens behind each other, two turn them, for the layer and for the sum; means, factors and offsets
    // are repeated along rows. What comes of the layer is not turned any more, and the bias is the layer's.
    assert_eq!(steps.iter().filter(|step| **step == "Arrange").count(), 8, "{steps:?}");
    assert_eq!(steps.iter().filter(|step| **step == "Combine").count(), 4, "{steps:?}");
}

#[test]
fn pictures_stand_as_convolutions_take_them() {
    let relu = |file: File| file.node("Relu", &["first"], "between");
    let leaky = |file: File| file.node("LeakyRelu", &["first"], "between");
    let elu = |file: File| file.nodes("Elu", &["first"], &["between"], vec![]);
    let pool = |file: File| {
        let (sizes, pads) = (numbers("kernel_shape", &[2, 3]), numbers("pads", &[1, 1, 0, 1]));
        file.nodes("MaxPool", &["first"], &["between"], vec![sizes, pads])
    };
    let residual = |file: File| {
        file.constant("U", &[17, 17, 1, 1], &some(17 * 17))
            .node("Relu", &["first"], "kept")
            .nodes("Conv", &["kept", "U"], &["more"], vec![])
            .node("Add", &["kept", "more"], "between")
    };
    let scaled = |file: File| {
        file.constant("scale", &[1, 17, 1, 1], &some(17)).node(
            "Mul",
            &["first", "scale"],
            "between",
        )
    };
    let layer = |file: File| {
        file.node("Flatten", &["second"], "row")
            .constant("L", &[5 * 25, 4], &some(5 * 25 * 4))
            .node("MatMul", &["row", "L"], "q")
            .output("q")
    };
    let tokens = |file: File| {
        file.whole("sizes", &[1, 5, -1])
            .node("Reshape", &["second", "sizes"], "rows")
            .node_with("Transpose", &["rows"], "tokens", vec![numbers("perm", &[0, 2, 1])])
            .constant("T", &[5, 3], &some(15))
            .node("MatMul", &["tokens", "T"], "q")
            .output("q")
    };
    let both = |file: File| file.node("Neg", &["second"], "q").output("q").output("second");
    // Compiling proves each against double precision.
    let moves = |file: &File| steps(file).iter().filter(|step| **step == "Arrange").count();
    let (plain, padded) = (&[0, 0, 0, 0], &[1, 1, 0, 1]);
    let straight = two_convolutions(&relu, plain, &layer);
    assert_eq!(moves(&straight), 0, "{:?}", steps(&straight));
    let bordered = two_convolutions(&relu, padded, &tokens);
    // A border and its filling: written where the first convolution writes.
    assert_eq!(moves(&bordered), 1, "{:?}", steps(&bordered));
    let all: [&dyn Fn(File) -> File; 5] = [&leaky, &elu, &pool, &residual, &scaled];
    for between in all {
        let file = two_convolutions(between, padded, &both);
        assert!(compiled(&file).is_ok(), "{:?}", compiled(&file).err());
    }
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
fn weights_of_eight_bits_are_near() {
    let options = CompileOptions { profile: Profile::Int8, ..CompileOptions::default() };
    let int8 = |file: &File| compile_policy(&file.bytes(), &PolicyOptions::default(), &options);
    let layers = File::default()
        .input("x", Float, &["1", "64"])
        .layer("x", [64, 64], "p0")
        .nodes("Elu", &["p0"], &["v0"], vec![])
        .layer("v0", [64, 5], "q")
        .output("q");
    // An odd run of an odd number of channels.
    let kernel = [20, 5, 3, 3];
    let pads = ("pads", vec![1, 1, 1, 1]);
    let picture = convolution(&["1", "5", "9", "8"], &kernel, vec![pads]);
    for file in [layers, picture] {
        let exact = compiled(&file).unwrap().compiled;
        let few = int8(&file).unwrap().compiled;
        assert!(few.report.flash_bytes < exact.report.flash_bytes * 6 / 10);
        let times = few.report.max_distance / exact.report.max_distance;
        assert!((10.0..100_000.0).contains(&times), "{times}");
    }
}
