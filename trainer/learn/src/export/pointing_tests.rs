//! Networks whose head points, with random weights, against the recorded files.

use super::skip_tests::{CONTRACT, Sizes, Tensors, assert_recorded};
use super::*;

/// A network of whose outputs the last `count` point, at entities from `first_entity` on; so many features of every pair stand
/// in the own row from a column on.
fn pointing(
    tensors: &mut Tensors,
    sizes: Sizes,
    [first_entity, count]: [usize; 2],
    [first, features]: [usize; 2],
) -> AttentionNetwork<'static> {
    let Sizes { width, base, outputs, .. } = sizes;
    let mut network = tensors.network(sizes);
    let base = base.unwrap_or(width);
    network.head = tensors.layer(base, outputs - count);
    let query = tensors.layer(base, width);
    let pairs = (features > 0).then(|| {
        let weights = tensors.layer(base, features);
        PairHead { first, features, weights }
    });
    network.pointing = Some(PointingHead { first_entity, count, query, pairs, scale: 1.0 });
    network
}

#[test]
fn an_agent_that_points_becomes_the_recorded_file() {
    let sizes = Sizes { inputs: 12, width: 16, heads: 2, base: Some(8), outputs: 6 };
    let layers = pointing(&mut Tensors(5), sizes, [2, 4], [0, 0]);
    let agent = AgentNetwork { features: 6, append_last_action: true, contract: CONTRACT, layers };
    assert_recorded("agent_pointing_small", &agent_onnx(&agent).unwrap());
}

#[test]
fn an_agent_that_points_and_remembers_becomes_the_recorded_file() {
    let mut tensors = Tensors(6);
    let sizes = Sizes { inputs: 7, width: 20, heads: 5, base: Some(9), outputs: 4 };
    let mut layers = pointing(&mut tensors, sizes, [0, 3], [0, 0]);
    layers.skip = None;
    let agent = AgentNetwork { features: 7, append_last_action: false, contract: CONTRACT, layers };
    let gru = GruCell { input: tensors.layer(9, 27), recurrent: tensors.layer(9, 27) };
    let network = RecurrentAgent { agent, attention_relu: false, gru };
    assert_recorded("agent_pointing_gru", &recurrent_agent_onnx(&network).unwrap());
}

#[test]
fn a_vector_of_another_width_is_refused() {
    let sizes = Sizes { inputs: 12, width: 16, heads: 2, base: Some(8), outputs: 6 };
    let mut layers = pointing(&mut Tensors(5), sizes, [2, 4], [0, 0]);
    let pointing = layers.pointing.as_mut().unwrap();
    pointing.query = Tensors(5).layer(8, 15);
    let agent = AgentNetwork { features: 6, append_last_action: true, contract: CONTRACT, layers };
    let refused = agent_onnx(&agent).unwrap_err();
    assert_eq!(
        refused,
        ExportError::WrongLength { tensor: "pointing.query".to_owned(), want: 16, got: 15 }
    );
}

#[test]
fn an_agent_that_is_told_of_pairs_becomes_the_recorded_file() {
    let sizes = Sizes { inputs: 17, width: 16, heads: 2, base: Some(8), outputs: 6 };
    let layers = pointing(&mut Tensors(7), sizes, [2, 4], [3, 2]);
    let agent = AgentNetwork { features: 11, append_last_action: true, contract: CONTRACT, layers };
    assert_recorded("agent_pointing_pairs", &agent_onnx(&agent).unwrap());
}
