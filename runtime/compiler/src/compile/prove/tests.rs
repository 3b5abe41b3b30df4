//! Plans of other networks than the files': whatever a lowering could get wrong is refused.

use prost::Message;
use sortie_plans::{CompileError, CompileOptions, NetworkFiles, ProposalFiles};
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{ModelProto, TensorProto};

use super::super::{compile, compile_proposals, lower, lower_three};
use super::prove;
use crate::networks::Graphs;

const OPTIONS: fn() -> CompileOptions =
    || CompileOptions { n_max: 7, inputs: 48, ..CompileOptions::default() };

fn golden(name: &str) -> Vec<u8> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    std::fs::read(format!("{folder}{name}.onnx")).expect("is there")
}

/// A file with other numbers in one of its tensors.
fn with(onnx: &[u8], tensor: &str, fault: &dyn Fn(&mut [f32])) -> Vec<u8> {
    let mut file = ModelProto::decode(onnx).expect("a file");
    let stored = file.graph.iter_mut().flat_map(|graph| &mut graph.initializer);
    let stored = stored.filter(|stored| stored.name == tensor);
    for stored in stored {
        let mut numbers = numbers(stored);
        fault(&mut numbers);
        stored.raw_data = numbers.into_iter().flat_map(f32::to_le_bytes).collect();
        stored.float_data.clear();
    }
    file.encode_to_vec()
}

fn numbers(tensor: &TensorProto) -> Vec<f32> {
    if tensor.raw_data.is_empty() {
        return tensor.float_data.clone();
    }
    let words = tensor.raw_data.as_chunks::<4>().0.iter();
    words.map(|word| f32::from_le_bytes(*word)).collect()
}

/// Weights and biases of a file.
fn weights(onnx: &[u8]) -> Vec<String> {
    let file = ModelProto::decode(onnx).expect("a file");
    let stored = file.graph.into_iter().flat_map(|graph| graph.initializer);
    let floats = stored.filter(|tensor| tensor.data_type == DataType::Float as i32);
    floats.filter(|tensor| !tensor.dims.is_empty()).map(|tensor| tensor.name).collect()
}

/// A change of a tensor.
type Fault = (&'static str, fn(&mut [f32]));

const IN_16_BITS: &str = "in 16 bits";

const FAULTS: [Fault; 4] = [
    ("nothing in its place", |numbers| numbers.fill(0.0)),
    ("every second sign", |numbers| {
        numbers.iter_mut().step_by(2).for_each(|number| *number = -*number);
    }),
    ("turned by one", |numbers| numbers.rotate_left(1)),
    // As 16 bits with eight of exponent hold them.
    (IN_16_BITS, |numbers| {
        for number in numbers {
            *number = f32::from_bits((number.to_bits() + 0x8000) & 0xffff_0000);
        }
    }),
];

/// Judges the plan of a network of one file by another's.
fn judged(plan_of: &[u8], judged_by: &[u8]) -> Result<(), CompileError> {
    let plan = compile(plan_of, &OPTIONS()).expect("the network with the fault is one").bytes;
    let graphs = Graphs::read(&NetworkFiles::One(judged_by)).expect("a file");
    let Graphs::One(graph) = &graphs else { panic!("one file") };
    let sizes = lower(graph, &OPTIONS(), None).expect("a network").network;
    prove(&plan, &graphs, sizes.random_inputs(48, 3), &OPTIONS()).map(drop)
}

#[test]
fn what_a_lowering_could_get_wrong_is_refused() {
    for name in ["agent_skip_small", "agent_gru_small", "team_value_small", "entities_small"] {
        let right = golden(name);
        judged(&right, &right).expect("a network is its own");
        for tensor in weights(&right) {
            for (what, fault) in FAULTS {
                let wrong = with(&right, &tensor, &fault);
                // What logits lose with 16 bits a softmax hardly shows.
                let is_logit = ["query", "key"].iter().any(|part| tensor.contains(part));
                let is_same = wrong == with(&right, &tensor, &|_| ());
                if is_same || is_logit && what == IN_16_BITS {
                    continue;
                }
                let found = judged(&wrong, &right);
                let refused = matches!(found, Err(CompileError::Wrong { .. }));
                assert!(refused, "{name}, `{tensor}`, {what}: {found:?}");
            }
        }
    }
}

#[test]
fn exchanged_gates_are_refused() {
    let right = golden("agent_gru_small");
    for tensor in ["gru.input.weight", "gru.recurrent.bias"] {
        // Reset and update: the first two of three.
        let exchange = |numbers: &mut [f32]| {
            numbers.chunks_mut(24).for_each(|row| row[..16].rotate_left(8));
        };
        let found = judged(&with(&right, tensor, &exchange), &right);
        assert!(matches!(found, Err(CompileError::Wrong { .. })), "{tensor}: {found:?}");
    }
}

#[test]
fn one_wrong_weight_is_refused() {
    let right = golden("agent_small");
    for tensor in ["fc1.weight", "attention.value.weight", "head.bias"] {
        let found = judged(&with(&right, tensor, &|numbers| numbers[1] *= 1.01), &right);
        assert!(matches!(found, Err(CompileError::Wrong { .. })), "{tensor}: {found:?}");
    }
}

#[test]
fn a_wrong_part_of_an_allocator_that_proposes_is_refused() {
    let [trunk, step, critic] =
        ["trunk", "step", "critic"].map(|part| golden(&format!("proposals_{part}_small")));
    let right = ProposalFiles { trunk: &trunk, step: &step, critic: &critic };
    let graphs = Graphs::read(&NetworkFiles::Proposals(right)).expect("three files");
    let Graphs::Proposals(parts) = &graphs else { panic!("three files") };
    let sizes = lower_three(parts, &OPTIONS()).expect("a network").network;
    let judged = |files: &ProposalFiles<'_>| {
        let plan = compile_proposals(files, &OPTIONS()).expect("a network").bytes;
        prove(&plan, &graphs, sizes.random_inputs(48, 3), &OPTIONS()).map(drop)
    };
    judged(&right).expect("a network is its own");
    let swap = |onnx: &[u8], tensor: &str| with(onnx, tensor, &|numbers| numbers.swap(0, 1));
    let wrong = swap(&step, "from_agent.bias");
    assert!(judged(&ProposalFiles { step: &wrong, ..right }).is_err());
    for (part, of) in [(&trunk, "trunk"), (&critic, "critic")] {
        let tensor = weights(part).swap_remove(0);
        let wrong = swap(part, &tensor);
        let files = match of {
            "trunk" => ProposalFiles { trunk: &wrong, ..right },
            _ => ProposalFiles { critic: &wrong, ..right },
        };
        assert!(judged(&files).is_err(), "{of}, `{tensor}`");
    }
}
