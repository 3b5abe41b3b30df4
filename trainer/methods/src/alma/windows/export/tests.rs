use super::*;

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

fn networks(shape: AllocationShape) -> (PolicyWeights, CriticWeights) {
    let AllocationShape { features, columns, width, .. } = shape;
    let mut tensor = numbers(5);
    let policy = PolicyWeights {
        shape,
        entity_weight: tensor(width * features),
        entity_bias: tensor(width),
        task_weight: tensor(width * columns),
        attention_in_weight: tensor(3 * width * width),
        attention_out_weight: tensor(width * width),
        attention_out_bias: tensor(width),
        count_weight: tensor(width * 2),
        count_bias: tensor(width),
        update_weight: tensor(width * 2 * width),
        update_bias: tensor(width),
    };
    let critic = CriticWeights {
        shape,
        entity_weight: tensor(width * features),
        entity_bias: tensor(width),
        task_weight: tensor(width * columns),
        count_weight: tensor(width * 2),
        count_bias: tensor(width),
        attention_in_weight: tensor(3 * width * width),
        attention_out_weight: tensor(width * width),
        attention_out_bias: tensor(width),
        value_weight: tensor(width),
        value_bias: tensor(1),
        popart_weight: 0.75,
        popart_bias: -0.5,
        mean: 2.0,
        deviation: 3.0,
    };
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
    let (mut policy, critic) = networks(SHAPE);
    policy.update_weight.pop();
    let error = export_proposals(&policy, &critic, 0).unwrap_err();
    assert_eq!(error, ExportError::WrongLength { tensor: "update.weight", want: 512, got: 511 });
    let (policy, mut critic) = networks(SHAPE);
    critic.value_weight[3] = f32::NAN;
    let error = export_proposals(&policy, &critic, 0).unwrap_err();
    assert_eq!(error, ExportError::NonFinite { tensor: "head.weight" });
    let (policy, critic) = networks(AllocationShape { heads: 5, ..SHAPE });
    let error = export_proposals(&policy, &critic, 0).unwrap_err();
    assert_eq!(error, ExportError::Heads { heads: 5, width: 16 });
}
