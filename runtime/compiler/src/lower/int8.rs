//! Matched layers become operators of int8 weights.

use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Int8AttendOwn, Int8Dense, Int8EmbedEntities, MaskedArgmax, MaskedSample, Op, Place,
    quantised_floats,
};
use sortie_core::plan::{OPS, ProgramDraft};

use super::agent::{
    AgentSizes, Arena, Choice, at_most, behind_heads, check, padded_heads, side_by_side,
};
use super::int8_layout::{Int8Weights, Order};
use crate::matching::{AgentLayers, Layer, Matrix, Step};
use sortie_plans::CompileError;

/// As [`super::agent::lower_agent`], to operators of int8 weights.
pub(crate) fn lower_agent_int8(
    layers: &AgentLayers,
    sizes: AgentSizes,
) -> Result<(ProgramDraft, Int8Weights), CompileError> {
    check(layers, sizes)?;
    let (mut weights, mut arena) = (Int8Weights::default(), Arena::default());
    let mut ops = Vec::new();
    let Matrix { inputs, outputs: width, .. } = layers.embed.matrix;
    let places = Shared::new(layers, sizes, &mut arena);
    ops.push(Op::Int8EmbedEntities(Int8EmbedEntities {
        layer: weights.add_layer(&layers.embed, Order::Pairs),
        last_actions: (inputs - sizes.features) as u32,
        relu: layers.embed.relu.into(),
        rows: places.rows,
        quantised: places.quantised(inputs),
        embedded: Place { len: padded(width) as u32, ..places.absorbed },
    }));
    let attend = lower_attention(layers, sizes, &places, &mut weights, &mut arena);
    ops.push(Op::Int8AttendOwn(attend));
    let (mut from, mut spare) = (attend.to, [places.absorbed, places.query]);
    for step in &layers.steps {
        let layer = match step {
            Step::Dense(layer) => layer,
            Step::Gru(_) => {
                return Err(CompileError::NoInt8 { what: "a recurrent unit (Gru)".into() });
            }
        };
        from.len = layer.matrix.inputs as u32;
        let dense = Int8Dense {
            layer: weights.add_layer(layer, Order::Strips),
            relu: layer.relu.into(),
            from,
            to: within(spare[0], padded(layer.matrix.outputs), &mut arena),
            quantised: places.quantised(layer.matrix.inputs),
        };
        // A layer reads the one place and writes the other.
        spare.swap(0, 1);
        from = dense.to;
        ops.push(Op::Int8Dense(dense));
    }
    from.len = sizes.actions as u32;
    ops.push(match sizes.choice {
        Choice::Greedy => Op::MaskedArgmax(MaskedArgmax { from }),
        Choice::Drawn => Op::MaskedSample(MaskedSample { from }),
    });
    at_most("the number of layers", ops.len(), OPS)?;
    Ok((ProgramDraft { ops, floats: arena.floats(), nonzeros: 0 }, weights))
}

/// Places that stand for one thing after the other.
struct Shared {
    rows: Place,
    /// Every operator's integers.
    quantised: Place,
    query: Place,
    /// u and z of a head, and before them the embedding of a row.
    absorbed: Place,
}

impl Shared {
    fn new(layers: &AgentLayers, sizes: AgentSizes, arena: &mut Arena) -> Self {
        let width = layers.key.inputs;
        let behind = layers.steps.iter().map(|step| match step {
            Step::Dense(layer) => layer.matrix.inputs,
            Step::Gru(_) => 0,
        });
        let before = [layers.embed.matrix.inputs, width, attended(layers), sizes.n_max];
        let longest = behind.chain(before).max().unwrap_or(0);
        Self {
            rows: arena.place((sizes.n_max + 1) * (quantised_floats(width) + 1)),
            quantised: arena.place(quantised_floats(longest)),
            query: arena.place(joined(layers)),
            absorbed: arena.place(2 * quantised_floats(width)),
        }
    }

    /// The place of so many integers.
    fn quantised(&self, inputs: usize) -> Place {
        Place { len: quantised_floats(inputs) as u32, ..self.quantised }
    }
}

/// So many floats of a place that is not read any more, or of one more where it is too short.
fn within(spare: Place, floats: usize, arena: &mut Arena) -> Place {
    if floats <= spare.len as usize {
        return Place { len: floats as u32, ..spare };
    }
    arena.place(floats)
}

/// Outputs of all heads, padded.
fn joined(layers: &AgentLayers) -> usize {
    layers.heads * padded(layers.key.outputs / layers.heads)
}

/// Inputs of the layer behind the heads.
fn attended(layers: &AgentLayers) -> usize {
    joined(layers) + layers.skip.as_ref().map_or(0, |skip| skip.inputs)
}

fn lower_attention(
    layers: &AgentLayers,
    sizes: AgentSizes,
    places: &Shared,
    weights: &mut Int8Weights,
    arena: &mut Arena,
) -> Int8AttendOwn {
    let (heads, width) = (layers.heads, layers.key.inputs);
    let head_width = layers.key.outputs / heads;
    let parts = |matrix: &Matrix| -> Vec<Matrix> {
        (0..heads).map(|head| matrix.columns(head * head_width, head_width)).collect()
    };
    let query: Vec<Layer> = parts(&layers.query.matrix)
        .into_iter()
        .zip(layers.query.bias.chunks_exact(head_width))
        .map(|(matrix, bias)| Layer { matrix, bias: bias.to_vec(), relu: false })
        .collect();
    let keys: Vec<Matrix> =
        parts(&layers.key).iter().map(|keys| padded_heads(&keys.transposed(), 1)).collect();
    let values = parts(&layers.value);
    let output = behind_heads(layers);
    let all = |matrices: &[Matrix], weights: &mut Int8Weights| {
        weights.add_matrices(&matrices.iter().collect::<Vec<_>>(), Order::Strips)
    };
    let query = weights.add_layer(&side_by_side(&query), Order::Strips);
    let (keys, key_steps) = all(&keys, weights);
    let (values, value_steps) = all(&values, weights);
    Int8AttendOwn {
        rows: places.rows,
        width: width as u16,
        heads: heads as u16,
        query,
        keys,
        key_steps,
        values,
        value_steps,
        output: weights.add_layer(&output, Order::Strips),
        relu: layers.output.relu.into(),
        query_place: places.query,
        absorbed: places.absorbed,
        scores: arena.place(sizes.n_max),
        attended: arena.place(attended(layers)),
        to: within(places.query, padded(layers.output.matrix.outputs), arena),
        quantised: places.quantised(width.max(attended(layers)).max(sizes.n_max)),
    }
}
