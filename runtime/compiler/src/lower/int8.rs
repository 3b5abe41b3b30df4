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
    let rows = arena.place((sizes.n_max + 1) * padded(width));
    ops.push(Op::Int8EmbedEntities(Int8EmbedEntities {
        layer: weights.add_layer(&layers.embed, Order::Pairs),
        last_actions: (inputs - sizes.features) as u32,
        relu: layers.embed.relu.into(),
        rows,
        quantised: arena.place(quantised_floats(inputs)),
    }));
    let attend = lower_attention(layers, sizes, rows, &mut weights, &mut arena);
    ops.push(Op::Int8AttendOwn(attend));
    let mut from = attend.to;
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
            to: arena.place(padded(layer.matrix.outputs)),
            quantised: arena.place(quantised_floats(layer.matrix.inputs)),
        };
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

fn lower_attention(
    layers: &AgentLayers,
    sizes: AgentSizes,
    rows: Place,
    weights: &mut Int8Weights,
    arena: &mut Arena,
) -> Int8AttendOwn {
    let (heads, width) = (layers.heads, layers.key.inputs);
    let head_width = layers.key.outputs / heads;
    let attended = heads * padded(head_width);
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
    let kept = output.matrix.inputs;
    let all = |matrices: &[Matrix], weights: &mut Int8Weights| {
        weights.add_matrices(&matrices.iter().collect::<Vec<_>>(), Order::Strips)
    };
    let query = weights.add_layer(&side_by_side(&query), Order::Strips);
    let (keys, key_steps) = all(&keys, weights);
    let (values, value_steps) = all(&values, weights);
    Int8AttendOwn {
        rows,
        width: width as u16,
        heads: heads as u16,
        query,
        keys,
        key_steps,
        values,
        value_steps,
        output: weights.add_layer(&output, Order::Strips),
        relu: layers.output.relu.into(),
        query_place: arena.place(attended),
        absorbed: arena.place(padded(width)),
        scores: arena.place(sizes.n_max),
        mixed: arena.place(padded(width)),
        attended: arena.place(kept),
        to: arena.place(padded(layers.output.matrix.outputs)),
        quantised: arena.place(quantised_floats(width.max(kept))),
    }
}
