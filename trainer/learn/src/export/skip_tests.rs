//! Networks whose own row skips the attention, with random weights, against the recorded files.

use super::*;

pub(super) const CONTRACT: u64 = 0x0123_4567_89ab_cdef;

/// Sizes of a network: columns, width, heads, width before the head if there is such a layer, outputs.
pub(super) struct Sizes {
    pub(super) inputs: usize,
    pub(super) width: usize,
    pub(super) heads: usize,
    pub(super) base: Option<usize>,
    pub(super) outputs: usize,
}

/// Tensors of random numbers in ±0.5, one after the other.
pub(super) struct Tensors(pub(super) u32);

impl Tensors {
    fn next(&mut self, count: usize) -> &'static [f32] {
        let mut next = || {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        // The network borrows them; a test can afford the leak.
        (0..count).map(|_| next()).collect::<Vec<_>>().leak()
    }

    fn matrix(&mut self, inputs: usize, outputs: usize) -> Matrix<'static> {
        Matrix { values: self.next(inputs * outputs), layout: Layout::InputsFirst }
    }

    pub(super) fn layer(&mut self, inputs: usize, outputs: usize) -> Layer<'static> {
        Layer { weight: self.matrix(inputs, outputs), bias: self.next(outputs) }
    }

    pub(super) fn network(&mut self, sizes: Sizes) -> AttentionNetwork<'static> {
        let Sizes { inputs, width, heads, base, outputs } = sizes;
        AttentionNetwork {
            inputs,
            width,
            heads,
            base: base.unwrap_or(width),
            outputs,
            fc1: self.layer(inputs, width),
            attention_in: self.matrix(width, 3 * width),
            attention_out: self.layer(width, width),
            fc2: base.map(|base| self.layer(width, base)),
            head: self.layer(base.unwrap_or(width), outputs),
            pointing: None,
            skip: Some(self.matrix(width, width)),
        }
    }
}

pub(super) fn assert_recorded(name: &str, written: &[u8]) {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    let recorded = std::fs::read(format!("{root}{name}.onnx")).unwrap();
    assert!(written == recorded, "the exported bytes of {name} changed");
}

#[test]
fn an_agent_with_a_skip_becomes_the_recorded_file() {
    let sizes = Sizes { inputs: 10, width: 16, heads: 2, base: Some(8), outputs: 4 };
    let layers = Tensors(1).network(sizes);
    let agent = AgentNetwork { features: 6, append_last_action: true, contract: CONTRACT, layers };
    assert_recorded("agent_skip_small", &agent_onnx(&agent).unwrap());
}

#[test]
fn an_agent_without_a_layer_before_the_head_becomes_the_recorded_file() {
    let sizes = Sizes { inputs: 7, width: 32, heads: 4, base: None, outputs: 5 };
    let layers = Tensors(2).network(sizes);
    let agent = AgentNetwork { features: 7, append_last_action: false, contract: CONTRACT, layers };
    assert_recorded("agent_skip_one_layer", &agent_onnx(&agent).unwrap());
}

#[test]
fn an_agent_that_remembers_and_has_a_skip_becomes_the_recorded_file() {
    let mut tensors = Tensors(3);
    let sizes = Sizes { inputs: 7, width: 20, heads: 5, base: Some(9), outputs: 3 };
    let layers = tensors.network(sizes);
    let agent = AgentNetwork { features: 7, append_last_action: false, contract: CONTRACT, layers };
    let gru = GruCell { input: tensors.layer(9, 27), recurrent: tensors.layer(9, 27) };
    let network = RecurrentAgent { agent, attention_relu: true, gru };
    assert_recorded("agent_gru_skip_odd_sizes", &recurrent_agent_onnx(&network).unwrap());
}

#[test]
fn a_team_value_with_a_skip_becomes_the_recorded_file() {
    let sizes = Sizes { inputs: 11, width: 16, heads: 2, base: Some(8), outputs: 1 };
    let layers = Tensors(4).network(sizes);
    let network = TeamValueExport { features: 6, relations: 3, contract: CONTRACT, layers };
    assert_recorded("team_value_skip_small", &team_value_onnx(&network).unwrap());
}

#[test]
fn a_skip_of_another_width_is_refused() {
    let sizes = Sizes { inputs: 10, width: 16, heads: 2, base: Some(8), outputs: 4 };
    let mut layers = Tensors(1).network(sizes);
    layers.skip = Some(Tensors(1).matrix(16, 8));
    let agent = AgentNetwork { features: 6, append_last_action: true, contract: CONTRACT, layers };
    let refused = agent_onnx(&agent).unwrap_err();
    assert_eq!(
        refused,
        ExportError::WrongLength { tensor: "skip.weight".to_owned(), want: 256, got: 128 }
    );
}
