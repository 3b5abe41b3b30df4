use sortie_learn::random::{Purpose, generator};

use super::*;
use crate::alma::agents::transpose;

const SHAPE: AllocationShape = AllocationShape { features: 7, columns: 3, width: 16, heads: 2 };

/// Any small numbers.
fn numbers(seed: u32) -> impl FnMut(usize) -> Vec<f32> {
    let mut state = seed;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    move |count| (0..count).map(|_| next()).collect()
}

/// Fills parameters with such numbers, in the order and in the layouts of PyTorch.
fn fill(parameters: &mut Parameters, names: &[&str], mut tensor: impl FnMut(usize) -> Vec<f32>) {
    let width = SHAPE.width;
    for name in names {
        let own = parameters.tensors().iter().find(|tensor| tensor.name == *name);
        let range = own.expect(name).range.clone();
        let drawn = tensor(range.len());
        let is_turned = ["entity.weight", "task.weight", "count.weight"].contains(name);
        let drawn = if is_turned { transpose(&drawn, width, drawn.len() / width) } else { drawn };
        parameters.values[range].copy_from_slice(&drawn);
    }
}

/// Tensors of both networks, as they are drawn.
const ENTITIES: [&str; 3] = ["entity.weight", "entity.bias", "task.weight"];
const ATTENTION: [&str; 3] = ["attention.in.weight", "attention.out.weight", "attention.out.bias"];
const COUNTS: [&str; 2] = ["count.weight", "count.bias"];

fn networks(shape: AllocationShape) -> (AllocationPolicy, AllocationCritic) {
    let (random, mut tensor) = (&mut generator(1, Purpose::Weights, 0), numbers(5));
    let mut policy = AllocationPolicy::initialise(shape, random);
    for part in [&ENTITIES[..], &ATTENTION, &COUNTS] {
        fill(&mut policy.parameters, part, &mut tensor);
    }
    let update = tensor(2 * shape.width * shape.width);
    for (half, name) in ["update.task.weight", "update.agent.weight"].iter().enumerate() {
        let rows = update.chunks(shape.width).skip(half).step_by(2);
        fill(&mut policy.parameters, &[name], |_| rows.clone().flatten().copied().collect());
    }
    fill(&mut policy.parameters, &["update.agent.bias"], &mut tensor);
    let mut critic = AllocationCritic::initialise(shape, random);
    for part in [&ENTITIES[..], &COUNTS, &ATTENTION] {
        fill(&mut critic.parameters, part, &mut tensor);
    }
    fill(&mut critic.parameters, &["value.weight", "value.bias"], &mut tensor);
    let mut head = [0.75, -0.5].into_iter();
    fill(&mut critic.parameters, &["head.weight", "head.bias"], |_| {
        head.next().into_iter().collect()
    });
    (critic.popart.mean, critic.popart.variance) = (2.0, 9.0);
    (policy, critic)
}

fn assert_recorded(name: &str, written: &[u8]) {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    let recorded = std::fs::read(format!("{root}{name}")).unwrap();
    assert!(written == recorded, "the exported bytes of {name} changed");
}

#[test]
fn networks_become_the_recorded_files() {
    let (policy, critic) = networks(SHAPE);
    let graphs = export_proposals(&policy, &critic, 0x0123_4567_89ab_cdef).unwrap();
    assert_recorded("proposals_trunk_small.onnx", &graphs.trunk);
    assert_recorded("proposals_step_small.onnx", &graphs.step);
    assert_recorded("proposals_critic_small.onnx", &graphs.critic);
}

#[test]
fn what_does_not_fit_is_refused() {
    let (policy, mut critic) = networks(SHAPE);
    fill(&mut critic.parameters, &["value.bias"], |_| vec![f32::NAN]);
    let error = export_proposals(&policy, &critic, 0).unwrap_err();
    assert_eq!(error, ExportError::NonFinite { tensor: "head".to_owned() });
    let (policy, critic) = networks(AllocationShape { heads: 5, ..SHAPE });
    let error = export_proposals(&policy, &critic, 0).unwrap_err();
    assert_eq!(error, ExportError::Heads { heads: 5, width: 16 });
}
