//! Matched layers become operators of int8 weights.

use sortie_bundle::Recording;
use sortie_core::internal::kernels::int8::{PAIRS, STRIP};
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Int8AttendOwn, Int8Dense, Int8EmbedEntities, Int8Layer, Int8PointAtEntities, MaskedArgmax,
    MaskedSample, Op, Place, quantised_floats,
};
use sortie_core::plan::{OPS, ProgramDraft};
use sortie_plans::CompileError;

use super::agent::{AgentSizes, Arena, Choice, at_most, check, with_parts_padded};
use super::rounding::{EMBED, Products, QUERY, Rounded, nearest, round};
use crate::matching::{AgentLayers, Layer};

/// As [`super::agent::lower_agent`], to operators of int8 weights, which are rounded for `examples` if there are any.
pub(crate) fn lower_agent_int8(
    layers: &AgentLayers,
    sizes: AgentSizes,
    examples: Option<&Recording>,
) -> Result<(ProgramDraft, Int8Weights), CompileError> {
    check(layers, sizes)?;
    let layers = &with_parts_padded(layers);
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
    if let Some(targets) = layers.targets {
        let to = arena.place(sizes.actions);
        ops.push(Op::Int8PointAtEntities(Int8PointAtEntities {
            rows: places.rows,
            targets,
            from,
            scores: attend.scores,
            quantised: places.quantised(targets.width.into()),
            to,
        }));
        from = to;
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

/// Bytes that every part starts at a multiple of: one cache line.
const ALIGN: usize = 64;

/// In which order rows of weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// All pairs of a strip, then the next strip.
    Strips,
    /// All strips of a pair, then the next pair: for inputs of which few are not zero.
    Pairs,
}

/// The weights of a plan, part after part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Int8Weights {
    pub(crate) bytes: Vec<u8>,
}

impl Int8Weights {
    /// Adds a layer: its matrix, what the weights count, its bias.
    pub(crate) fn add_layer(&mut self, layer: &Rounded, order: Order) -> Int8Layer {
        let Rounded { inputs, outputs, .. } = *layer;
        let (weights, steps) = self.add_matrices(std::slice::from_ref(layer), order);
        let bias = self.add_floats(&layer.bias);
        Int8Layer { inputs: inputs as u16, outputs: outputs as u16, weights, steps, bias }
    }

    /// Adds matrices of the same size one behind the other, then their steps; returns where both start, in floats.
    pub(crate) fn add_matrices(&mut self, matrices: &[Rounded], order: Order) -> (u32, u32) {
        let start = self.align();
        let mut all_steps = Vec::new();
        for matrix in matrices {
            self.add_rows(matrix, order);
            all_steps.extend(&matrix.steps);
            all_steps.resize(all_steps.len().next_multiple_of(STRIP), 0.0);
        }
        (start, self.add_floats(&all_steps))
    }

    /// Adds a layer on patches that are made of runs of so many numbers: weights, steps and bias.
    pub(crate) fn add_patches(&mut self, layer: &Rounded, run: usize) -> [u32; 3] {
        let Rounded { inputs, outputs, integers, steps, bias } = layer;
        let start = self.align();
        for first in (0..*outputs).step_by(STRIP) {
            for pair in (0..*inputs)
                .step_by(run)
                .flat_map(|start| (0..run).step_by(2).map(move |at| [start, at]))
            {
                let [start, at] = pair;
                for output in first..first + STRIP {
                    let both = [at, at + 1].map(|at| {
                        match integers.get((start + at) * outputs + output) {
                            Some(integer) if at < run && output < *outputs => *integer as u8,
                            _ => 0,
                        }
                    });
                    self.bytes.extend(both);
                }
            }
        }
        [start, self.add_floats(steps), self.add_floats(bias)]
    }

    fn add_rows(&mut self, matrix: &Rounded, order: Order) {
        let pairs = matrix.inputs.div_ceil(2).next_multiple_of(PAIRS);
        let strips = matrix.outputs.div_ceil(STRIP);
        let weight = |input: usize, output: usize| match matrix
            .integers
            .get(input * matrix.outputs + output)
        {
            Some(integer) if output < matrix.outputs => *integer,
            _ => 0,
        };
        let mut add = |pair: usize, strip: usize| {
            for output in strip * STRIP..(strip + 1) * STRIP {
                let both = [2 * pair, 2 * pair + 1].map(|input| weight(input, output) as u8);
                self.bytes.extend(both);
            }
        };
        match order {
            Order::Strips => {
                (0..strips).for_each(|strip| (0..pairs).for_each(|pair| add(pair, strip)))
            }
            Order::Pairs => {
                (0..pairs).for_each(|pair| (0..strips).for_each(|strip| add(pair, strip)))
            }
        }
    }

    /// Adds numbers, zeros behind them up to whole strips.
    pub(crate) fn add_floats(&mut self, floats: &[f32]) -> u32 {
        let start = self.align();
        let zeros = floats.len().next_multiple_of(STRIP) - floats.len();
        // Adding zero turns -0 into +0.
        let bytes = floats.iter().flat_map(|float| (float + 0.0).to_le_bytes());
        self.bytes.extend(bytes.chain(std::iter::repeat_n(0, 4 * zeros)));
        start
    }

    fn align(&mut self) -> u32 {
        self.bytes.resize(self.bytes.len().next_multiple_of(ALIGN), 0);
        (self.bytes.len() / 4) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer() -> Rounded {
        let integers = [-127, 0, 127].iter().flat_map(|weight| [*weight; 18]).collect();
        let steps = (1..=18).map(|output| output as f32 / 127.0).collect();
        Rounded { inputs: 3, outputs: 18, integers, steps, bias: vec![-0.0; 18] }
    }

    #[test]
    fn rows_stand_where_the_format_says() {
        // Inputs 0, 1 and 2 weigh -127, 0 and 127 for every output; there is no input 3 or beyond.
        let both = |pair: usize| [[129, 0], [127, 0], [0, 0], [0, 0]][pair];
        for order in [Order::Strips, Order::Pairs] {
            let place = |row: usize| match order {
                Order::Strips => (row % 4, row / 4),
                Order::Pairs => (row / 2, row % 2),
            };
            let places = (0..8).map(place);
            let mut weights = Int8Weights::default();
            let added = weights.add_layer(&layer(), order);
            assert_eq!((added.weights, added.steps, added.bias), (0, 64, 96));
            for (row, (pair, strip)) in weights.bytes.chunks(32).zip(places) {
                for (column, got) in row.chunks(2).enumerate() {
                    let exists = strip * STRIP + column < 18;
                    assert_eq!(got, if exists { both(pair) } else { [0; 2] }, "{order:?}");
                }
            }
            let float = |index: usize| {
                f32::from_le_bytes(*weights.bytes[4 * index..].first_chunk().unwrap())
            };
            assert_eq!((float(64), float(81), float(82)), (1.0 / 127.0, 18.0 / 127.0, 0.0));
            assert!(weights.bytes[384..].iter().all(|byte| *byte == 0));
        }
    }
}
