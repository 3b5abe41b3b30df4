//! Matched layers become operators of int8 weights.

use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Int8AttendOwn, Int8Dense, Int8EmbedEntities, MaskedArgmax, MaskedSample, Op, Place,
    quantised_floats,
};
use sortie_core::plan::{OPS, ProgramDraft};

use super::agent::{AgentSizes, Arena, Choice, at_most, check};
use super::int8_layout::{Int8Weights, Order};
use super::rounding::{EMBED, Products, QUERY, Rounded, nearest, round};
use crate::matching::{AgentLayers, Layer};
use sortie_bundle::Recording;
use sortie_plans::CompileError;

/// As [`super::agent::lower_agent`], to operators of int8 weights, which are rounded for `examples` if there are any.
pub(crate) fn lower_agent_int8(
    layers: &AgentLayers,
    sizes: AgentSizes,
    examples: Option<&Recording>,
) -> Result<(ProgramDraft, Int8Weights), CompileError> {
    check(layers, sizes)?;
    let products = Products::of(layers, sizes.features)?;
    let rounded =
        examples.map_or_else(|| nearest(&products), |examples| round(&products, examples));
    let (mut weights, mut arena) = (Int8Weights::default(), Arena::default());
    let mut ops = Vec::new();
    let embed = &rounded[EMBED];
    let places = Shared::new(&rounded, sizes, &mut arena);
    ops.push(Op::Int8EmbedEntities(Int8EmbedEntities {
        layer: weights.add_layer(embed, Order::Pairs),
        last_actions: (embed.inputs - sizes.features) as u32,
        relu: layers.embed.relu.into(),
        rows: places.rows,
        quantised: places.quantised(embed.inputs),
        embedded: Place { len: padded(embed.outputs) as u32, ..places.absorbed },
    }));
    let attend = lower_attention(&products, &rounded, (sizes, &places), &mut weights, &mut arena);
    ops.push(Op::Int8AttendOwn(attend));
    let (mut from, mut spare) = (attend.to, [places.absorbed, places.query]);
    for (layer, Layer { relu, .. }) in
        rounded.iter().zip(&products.layers).skip(products.output() + 1)
    {
        from.len = layer.inputs as u32;
        let dense = Int8Dense {
            layer: weights.add_layer(layer, Order::Strips),
            relu: (*relu).into(),
            from,
            to: within(spare[0], padded(layer.outputs), &mut arena),
            quantised: places.quantised(layer.inputs),
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
    fn new(rounded: &[Rounded], sizes: AgentSizes, arena: &mut Arena) -> Self {
        let width = rounded[QUERY].inputs;
        let inputs = rounded.iter().map(|product| product.inputs);
        let longest = inputs.max().unwrap_or(0).max(sizes.n_max);
        Self {
            rows: arena.place((sizes.n_max + 1) * (quantised_floats(width) + 1)),
            quantised: arena.place(quantised_floats(longest)),
            query: arena.place(rounded[QUERY].outputs),
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

fn lower_attention(
    products: &Products,
    rounded: &[Rounded],
    (sizes, places): (AgentSizes, &Shared),
    weights: &mut Int8Weights,
    arena: &mut Arena,
) -> Int8AttendOwn {
    let width = rounded[QUERY].inputs;
    let query = weights.add_layer(&rounded[QUERY], Order::Strips);
    let (keys, key_steps) = weights.add_matrices(&rounded[products.keys()], Order::Strips);
    let (values, value_steps) = weights.add_matrices(&rounded[products.values()], Order::Strips);
    let output = &rounded[products.output()];
    Int8AttendOwn {
        rows: places.rows,
        width: width as u16,
        heads: products.heads as u16,
        query,
        keys,
        key_steps,
        values,
        value_steps,
        output: weights.add_layer(output, Order::Strips),
        relu: products.layers[products.output()].relu.into(),
        query_place: places.query,
        absorbed: places.absorbed,
        scores: arena.place(sizes.n_max),
        attended: arena.place(output.inputs),
        to: within(places.query, padded(output.outputs), arena),
        quantised: places.quantised(width.max(output.inputs).max(sizes.n_max)),
    }
}
