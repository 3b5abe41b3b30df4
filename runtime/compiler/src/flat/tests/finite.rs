//! Files with weights that are no numbers.

use prost::Message;
use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_plans::{CompileError, CompileOptions, PolicyOptions};
use tract_onnx::pb::ModelProto;
use tract_onnx::pb::tensor_proto::DataType::Float;

use super::files::File;
use super::plans::compiled;
use crate::compile::{compile, compile_policy};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/");

const NAN: f32 = f32::NAN;
const INFINITE: f32 = f32::INFINITY;

fn golden(name: &str) -> Vec<u8> {
    std::fs::read(format!("{GOLDEN}{name}")).unwrap()
}

/// A layer of four inputs and two outputs with this among its weights, behind what turns them if they are turned.
fn layer(weight: f32, is_turned: bool) -> File {
    let mut weights = [0.25; 8];
    weights[5] = weight;
    let file = File::default().input("x", Float, &["1", "4"]);
    let file = file.constant("w", if is_turned { &[2, 4] } else { &[4, 2] }, &weights);
    let (file, weights) = match is_turned {
        true => (file.node("Transpose", &["w"], "turned"), "turned"),
        false => (file, "w"),
    };
    file.node("MatMul", &["x", weights], "q").output("q")
}

#[test]
fn weights_that_are_no_numbers_are_refused_by_name() {
    for weight in [NAN, INFINITE, -INFINITE] {
        for is_turned in [false, true] {
            let error = compiled(&layer(weight, is_turned)).unwrap_err();
            assert!(matches!(error, CompileError::NonFiniteWeight { .. }), "{error}");
            assert!(error.to_string().contains("`w`"), "{error}");
        }
    }
    compiled(&layer(f32::MAX / 1e3, true)).expect("large numbers are numbers");
}

#[test]
fn infinity_closes_actions_and_is_a_limit_that_is_none() {
    let file = |mask: f32, limit: f32| {
        let file = File::default().input("x", Float, &["1", "4"]).layer("x", [4, 2], "sum");
        let file = file.constant("mask", &[2], &[0.0, mask]).constant("limit", &[], &[limit]);
        let file = file.constant("least", &[], &[-5.0]);
        let file = file.node("Clip", &["sum", "least", "limit"], "some");
        file.node("Add", &["some", "mask"], "scores").argmax("scores", "action").choice("action")
    };
    compiled(&file(-INFINITE, INFINITE)).expect("both have a meaning");
    for broken in [file(NAN, 5.0), file(-1.0, NAN), file(INFINITE, 5.0)] {
        let error = compiled(&broken).unwrap_err();
        assert!(matches!(error, CompileError::NonFiniteWeight { .. }), "{error}");
    }
}

#[test]
fn infinity_that_is_taken_away_is_refused() {
    for mean in [INFINITE, -INFINITE] {
        let file = File::default().input("x", Float, &["1", "4"]).constant("mean", &[1], &[mean]);
        let file = file.node("Sub", &["x", "mean"], "far").layer("far", [4, 2], "sum");
        let error = compiled(&file.node("Tanh", &["sum"], "q").output("q")).unwrap_err();
        assert!(matches!(error, CompileError::NonFiniteWeight { .. }), "{error}");
    }
}

#[test]
fn what_never_answers_is_not_proved() {
    let file = File::default().input("x", Float, &["1", "4"]).constant("zero", &[], &[0.0]);
    let file =
        file.node("Sub", &["x", "x"], "none").node("Div", &["none", "zero"], "q").output("q");
    let error = compiled(&file).unwrap_err();
    assert!(error.to_string().contains("on no random input"), "{error}");
}

#[test]
fn a_difference_is_blamed_on_weights_as_no_layer_has() {
    let onnx = golden("onnx/agent_gru_small.onnx");
    let with = |weight: f32| {
        let mut file = ModelProto::decode(&onnx[..]).unwrap();
        let tensors = &mut file.graph.as_mut().unwrap().initializer;
        let scale = tensors.iter_mut().find(|tensor| tensor.name == "attention.scale").unwrap();
        scale.raw_data = weight.to_le_bytes().to_vec();
        compile(&file.encode_to_vec(), &CompileOptions::default())
    };
    with(0.25).expect("a scale of logits");
    // Logits beyond those by which the mask closes.
    let error = with(1.9e31).unwrap_err();
    assert!(!error.to_string().contains("report"), "{error}");
    let CompileError::WildWeight { constant, weight, .. } = &error else { panic!("{error}") };
    assert_eq!((constant.as_str(), *weight), ("attention.scale", 1.9e31));
}

/// A number of few zero bits or many, of any kind: not a number, infinite, huge, tiny.
fn pattern(random: &mut Xoshiro256PlusPlus) -> f32 {
    let bits = random.next_u32();
    let exponent = 0xff << 23;
    f32::from_bits(match random.next_u32() % 4 {
        0 => bits | exponent,
        1 => (bits | exponent) & !((1 << 23) - 1),
        2 => bits & !exponent,
        _ => bits,
    })
}

/// Puts a pattern in the place of one weight, and says of which tensor and what.
fn damage(file: &mut ModelProto, random: &mut Xoshiro256PlusPlus) -> (String, f32) {
    let tensors = &mut file.graph.as_mut().unwrap().initializer;
    let mut layers: Vec<_> = tensors
        .iter_mut()
        .filter(|tensor| tensor.data_type == Float as i32 && tensor.raw_data.len() >= 32)
        .collect();
    let chosen = random.next_u32() as usize % layers.len();
    let layer = &mut *layers[chosen];
    let (weights, _) = layer.raw_data.as_chunks_mut::<4>();
    let (place, weight) = (random.next_u32() as usize % weights.len(), pattern(random));
    weights[place] = weight.to_le_bytes();
    (layer.name.clone(), weight)
}

/// In every part of networks of every kind: no plan holds what is no number, nobody panics, and nobody is asked to
/// report what is the file's fault. `SORTIE_STORM` says of how many files, 200 if it does not.
#[test]
fn a_storm_of_weights_of_any_bits_is_refused_where_they_are_no_numbers() {
    let options = CompileOptions { inputs: 16, ..CompileOptions::default() };
    let team = |onnx: &[u8]| compile(onnx, &options).map(drop);
    let one = |onnx: &[u8]| compile_policy(onnx, &PolicyOptions::default(), &options).map(drop);
    type Compile<'a> = &'a dyn Fn(&[u8]) -> Result<(), CompileError>;
    let networks: [(&str, Compile<'_>); 6] = [
        ("onnx/agent_gru_small.onnx", &team),
        ("onnx/agent_pointing_small.onnx", &team),
        ("onnx/agent_skip_small.onnx", &team),
        ("onnx/team_value_small.onnx", &team),
        ("onnx-producers/rsl_rl_gru.isaac_lab.onnx", &one),
        ("onnx-producers/torch_depthwise.dynamo.onnx", &one),
    ];
    let mut random = Xoshiro256PlusPlus::seed_from_u64(11);
    let files = std::env::var("SORTIE_STORM").map_or(200, |files| files.parse().unwrap());
    for number in 0..files {
        let (name, compile) = networks[number % networks.len()];
        let mut file = ModelProto::decode(&golden(name)[..]).unwrap();
        let (tensor, weight) = damage(&mut file, &mut random);
        let result = compile(&file.encode_to_vec());
        let refused = matches!(&result, Err(CompileError::NonFiniteWeight { .. }));
        let asks = matches!(
            &result,
            Err(CompileError::Wrong { .. } | CompileError::AnswersOtherwise { .. })
        );
        assert!(!asks, "{name}, {tensor}, {weight:e}: {result:?}");
        assert_eq!(refused, !weight.is_finite(), "{name}, {tensor}, {weight:e}: {result:?}");
    }
}
