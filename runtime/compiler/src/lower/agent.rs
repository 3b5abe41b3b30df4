//! Matched layers become operators: where weights lie and what the arena holds.

use sortie_core::internal::kernels::mark::MARKED;
use sortie_core::internal::kernels::product::{padded, tile_width};
use sortie_core::internal::ops::{
    AttendOwn, Dense, EmbedEntities, Gru, Linear, MaskedArgmax, MaskedSample, Op, Place,
    PointAtEntities, Vectors,
};
use sortie_core::limits;
use sortie_core::plan::{OPS, ProgramDraft};
use sortie_plans::CompileError;

use crate::matching::{AgentLayers, GruLayers, Layer, Matrix, Step};

/// How an agent chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Choice {
    /// The largest utility.
    Greedy,
    /// A draw from the softmax of the utilities.
    Drawn,
}

/// Sizes that the graph alone does not tell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AgentSizes {
    /// Most visible entities.
    pub(crate) n_max: usize,
    /// Features d, the last action not counted.
    pub(crate) features: usize,
    /// Actions U.
    pub(crate) actions: usize,
    /// How an action is chosen.
    pub(crate) choice: Choice,
}

/// Lowers an agent network to a program and its weights.
pub(crate) fn lower_agent(
    layers: &AgentLayers,
    sizes: AgentSizes,
) -> Result<(ProgramDraft, Weights), CompileError> {
    check(layers, sizes)?;
    let layers = &with_parts_padded(layers);
    let (mut weights, mut arena) = (Weights::default(), Arena::default());
    let mut ops = Vec::new();
    let width = padded(layers.embed.matrix.outputs);
    let rows = arena.place((sizes.n_max + 1) * width);
    ops.push(Op::EmbedEntities(EmbedEntities {
        layer: weights.add_layer(&layers.embed),
        last_actions: (layers.embed.matrix.inputs - sizes.features) as u32,
        relu: layers.embed.relu.into(),
        rows,
    }));
    let attend = lower_attention(layers, sizes, rows, &mut weights, &mut arena);
    ops.push(Op::AttendOwn(attend));
    let (mut from, mut sparse) = (attend.to, layers.output.relu);
    for step in &layers.steps {
        let op = match step {
            Step::Dense(layer) => {
                let to = arena.place(padded(layer.matrix.outputs));
                from.len = layer.matrix.inputs as u32;
                let linear = weights.add_layer(layer);
                let (relu, sparse_input) = (layer.relu.into(), sparse.into());
                let dense = Dense { layer: linear, relu, sparse_input, from, to };
                (from, sparse) = (to, layer.relu);
                Op::Dense(dense)
            }
            Step::Gru(unit) => {
                let gru = lower_gru(unit, from, sparse, &mut weights, &mut arena);
                (from, sparse) = (gru.to, false);
                Op::Gru(gru)
            }
        };
        ops.push(op);
    }
    if let Some(targets) = layers.targets {
        let (scores, to) = (arena.place(sizes.n_max), arena.place(sizes.actions));
        ops.push(Op::PointAtEntities(PointAtEntities { rows, targets, from, scores, to }));
        from = to;
    }
    from.len = sizes.actions as u32;
    ops.push(match sizes.choice {
        Choice::Greedy => Op::MaskedArgmax(MaskedArgmax { from }),
        Choice::Drawn => Op::MaskedSample(MaskedSample { from }),
    });
    at_most("the number of layers", ops.len(), OPS)?;
    let inputs = layers.embed.matrix.inputs.max(longest_input(layers));
    let nonzeros = inputs.div_ceil(MARKED) as u32;
    Ok((ProgramDraft { ops, floats: arena.floats(), nonzeros }, weights))
}

fn lower_attention(
    layers: &AgentLayers,
    sizes: AgentSizes,
    rows: Place,
    weights: &mut Weights,
    arena: &mut Arena,
) -> AttendOwn {
    let (heads, width) = (layers.heads, layers.key.inputs);
    let head_width = layers.key.outputs / heads;
    let parts = |matrix: &Matrix| -> Vec<Matrix> {
        (0..heads).map(|head| matrix.columns(head * head_width, head_width)).collect()
    };
    let keys: Vec<Matrix> = parts(&layers.key).iter().map(Matrix::transposed).collect();
    let values = parts(&layers.value);
    let output = behind_heads(layers);
    AttendOwn {
        rows,
        width: width as u16,
        heads: heads as u16,
        query: weights.add_layer(&layers.query),
        keys: weights.add_matrices(&keys.iter().collect::<Vec<_>>()),
        values: weights.add_matrices(&values.iter().collect::<Vec<_>>()),
        output: weights.add_layer(&output),
        relu: layers.output.relu.into(),
        query_place: arena.place(padded(layers.query.matrix.outputs)),
        absorbed: arena.place(padded(width)),
        scores: arena.place(sizes.n_max),
        mixed: arena.place(padded(width)),
        attended: arena.place(output.matrix.inputs),
        to: arena.place(padded(output.matrix.outputs)),
    }
}

fn lower_gru(
    unit: &GruLayers,
    mut from: Place,
    sparse_input: bool,
    weights: &mut Weights,
    arena: &mut Arena,
) -> Gru {
    let (input, recurrent) = (side_by_side(&unit.input), side_by_side(&unit.recurrent));
    let (size, gates) = (recurrent.matrix.inputs, recurrent.matrix.outputs);
    from.len = input.matrix.inputs as u32;
    Gru {
        size: size as u32,
        input: weights.add_layer(&input),
        recurrent: weights.add_layer(&recurrent),
        sparse_input: sparse_input.into(),
        from,
        state: arena.place(size),
        input_gates: arena.place(gates),
        recurrent_gates: arena.place(gates),
        to: arena.place(padded(size)),
    }
}

/// Where the head points, what it says of actions that aim at nobody and both parts of the vector that points are padded each.
pub(crate) fn with_parts_padded(layers: &AgentLayers) -> AgentLayers {
    let mut layers = layers.clone();
    if let (Some(targets), Some(Step::Dense(head))) = (layers.targets, layers.steps.last_mut()) {
        let untargeted = usize::from(targets.untargeted);
        let part = |start: usize, count: usize| Layer {
            matrix: head.matrix.columns(start, count),
            bias: head.bias.iter().skip(start).take(count).copied().collect(),
            relu: false,
        };
        let width = usize::from(targets.width);
        let mut parts = vec![part(0, untargeted), part(untargeted, width)];
        if targets.pair_features > 0 {
            parts.push(part(untargeted + width, targets.pair_features.into()));
        }
        *head = side_by_side(&parts);
    }
    layers
}

/// One layer with the outputs of several, each padded with zeros.
pub(crate) fn side_by_side(layers: &[Layer]) -> Layer {
    let inputs = layers.first().map_or(0, |layer| layer.matrix.inputs);
    let (mut values, mut bias) = (Vec::new(), Vec::new());
    let zeros = |layer: &Layer| padded(layer.matrix.outputs) - layer.matrix.outputs;
    for input in 0..inputs {
        for layer in layers {
            let row = layer.matrix.values.chunks_exact(layer.matrix.outputs).nth(input);
            values.extend(row.unwrap_or_default());
            values.resize(values.len() + zeros(layer), 0.0);
        }
    }
    for layer in layers {
        bias.extend(&layer.bias);
        bias.resize(bias.len() + zeros(layer), 0.0);
    }
    Layer { matrix: Matrix { inputs, outputs: bias.len(), values }, bias, relu: false }
}

/// A layer whose outputs are padded head by head.
pub(crate) fn by_heads(layer: &Layer, heads: usize) -> Layer {
    let width = layer.matrix.outputs / heads;
    let head = |head: usize| Layer {
        matrix: layer.matrix.columns(head * width, width),
        bias: layer.bias.iter().skip(head * width).take(width).copied().collect(),
        relu: false,
    };
    side_by_side(&(0..heads).map(head).collect::<Vec<_>>())
}

/// The attention's last layer, of the heads' padded outputs; the own row's weights of a skip stand below.
pub(crate) fn behind_heads(layers: &AgentLayers) -> Layer {
    let mut matrix = padded_heads(&layers.output.matrix, layers.heads);
    if let Some(skip) = &layers.skip {
        matrix.inputs += skip.inputs;
        matrix.values.extend(&skip.values);
    }
    Layer { matrix, ..layers.output.clone() }
}

/// The matrix with zero rows behind every head, because heads write padded outputs.
pub(crate) fn padded_heads(matrix: &Matrix, heads: usize) -> Matrix {
    let head = matrix.inputs / heads * matrix.outputs;
    let padded_head = padded(matrix.inputs / heads) * matrix.outputs;
    let mut values = Vec::with_capacity(heads * padded_head);
    for rows in matrix.values.chunks_exact(head) {
        values.extend(rows);
        values.resize(values.len() + padded_head - head, 0.0);
    }
    Matrix { inputs: heads * padded(matrix.inputs / heads), outputs: matrix.outputs, values }
}

fn longest_input(layers: &AgentLayers) -> usize {
    let input = |(_, layer): (_, &Layer)| layer.matrix.inputs;
    step_layers(layers).map(input).max().unwrap_or(0).max(layers.key.inputs)
}

/// The layers behind the attention, with their names in messages.
fn step_layers(layers: &AgentLayers) -> impl Iterator<Item = (&'static str, &Layer)> {
    layers.steps.iter().flat_map(|step| -> Vec<(&'static str, &Layer)> {
        match step {
            Step::Dense(layer) => vec![("dense", layer)],
            Step::Gru(unit) => {
                let input = unit.input.iter().map(|layer| ("recurrent unit's", layer));
                input.chain(unit.recurrent.iter().map(|l| ("recurrent unit's", l))).collect()
            }
        }
    })
}

/// Checks that sizes fit together and into a plan.
pub(crate) fn check(layers: &AgentLayers, sizes: AgentSizes) -> Result<(), CompileError> {
    at_most("the number of visible entities", sizes.n_max, limits::ENTITIES)?;
    at_most("the number of features", sizes.features, limits::FEATURES)?;
    at_most("the number of actions", sizes.actions, limits::ACTIONS)?;
    let with_last_action = sizes.features + sizes.actions;
    let got = layers.embed.matrix.inputs;
    if got != sizes.features && got != with_last_action {
        let what = "the input width".into();
        return Err(CompileError::Size { what, got, want: with_last_action });
    }
    let attention = [
        ("query", &layers.query.matrix, layers.query.bias.as_slice()),
        ("key", &layers.key, &[]),
        ("value", &layers.value, &[]),
    ];
    let plain = |name, layer| -> (&'static str, &Matrix, &[f32]) {
        let Layer { matrix, bias, .. }: &Layer = layer;
        (name, matrix, bias)
    };
    let skip = layers.skip.iter().map(|matrix| ("skip", matrix, [].as_slice()));
    let dense = step_layers(layers).map(|(name, layer)| plain(name, layer));
    let ends = [plain("first", &layers.embed), plain("attention output", &layers.output)];
    for (layer, matrix, bias) in attention.into_iter().chain(skip).chain(ends).chain(dense) {
        check_weights(layer, matrix, bias)?;
    }
    check_chain(layers, sizes)
}

/// Checks that every layer takes what the one before it gives.
fn check_chain(layers: &AgentLayers, sizes: AgentSizes) -> Result<(), CompileError> {
    let width = layers.embed.matrix.outputs;
    let inner = layers.query.matrix.outputs;
    let mut pairs = vec![
        ("the query's input", layers.query.matrix.inputs, width),
        ("the keys' input", layers.key.inputs, width),
        ("the values' input", layers.value.inputs, width),
        ("the keys' width", layers.key.outputs, inner),
        ("the values' width", layers.value.outputs, inner),
        ("the attention output's input", layers.output.matrix.inputs, inner),
        ("the heads' joint width", inner / layers.heads.max(1) * layers.heads, inner),
    ];
    let mut before = layers.output.matrix.outputs;
    if let Some(skip) = &layers.skip {
        pairs.push(("the skip's input", skip.inputs, width));
        pairs.push(("the skip's width", skip.outputs, before));
    }
    for step in &layers.steps {
        match step {
            Step::Dense(layer) => {
                pairs.push(("a layer's input", layer.matrix.inputs, before));
                before = layer.matrix.outputs;
            }
            Step::Gru(unit) => {
                let size = unit.recurrent.first().map_or(0, |layer| layer.matrix.inputs);
                for (gate, input) in unit.recurrent.iter().zip(&unit.input) {
                    pairs.push(("the recurrent unit's input", input.matrix.inputs, before));
                    pairs.push(("the recurrent unit's state", gate.matrix.inputs, size));
                    pairs.push(("a gate's width", gate.matrix.outputs, size));
                    pairs.push(("a gate's width", input.matrix.outputs, size));
                }
                before = size;
            }
        }
    }
    match layers.targets {
        None => pairs.push(("the number of utilities", before, sizes.actions)),
        Some(targets) => {
            let [untargeted, aimed] = [targets.untargeted, targets.count].map(usize::from);
            pairs.push(("the number of utilities", untargeted + aimed, sizes.actions));
            pairs.push(("the pointing head's width", targets.width.into(), width));
            let features = usize::from(targets.pair_features);
            let end = usize::from(targets.first_pair) + aimed * features;
            pairs.push(("the head's width", before, untargeted + width + features));
            pairs.push(("features up to the last pair's", end.max(sizes.features), sizes.features));
        }
    }
    pairs.into_iter().try_for_each(|(what, got, want)| same_sizes(what, got, want))
}

pub(crate) fn at_most(what: &'static str, got: usize, max: usize) -> Result<(), CompileError> {
    let what = what.into();
    if got > max { Err(CompileError::TooLarge { what, got, max }) } else { Ok(()) }
}

pub(crate) fn same_sizes(what: &'static str, got: usize, want: usize) -> Result<(), CompileError> {
    let what = what.into();
    if got == want { Ok(()) } else { Err(CompileError::Size { what, got, want }) }
}

/// Checks that a plan can express a layer's width, and that its numbers are finite.
pub(crate) fn check_weights(
    layer: &'static str,
    matrix: &Matrix,
    bias: &[f32],
) -> Result<(), CompileError> {
    let widest = matrix.inputs.max(matrix.outputs);
    at_most("the width of a layer", widest, usize::from(u16::MAX) / 8)?;
    if matrix.values.iter().chain(bias).any(|value| !value.is_finite()) {
        let layer = format!("the {layer} layer").into();
        return Err(CompileError::NonFiniteWeight { layer });
    }
    Ok(())
}

/// Hands out places of the arena, each at the start of a cache line.
#[derive(Default)]
pub(crate) struct Arena {
    used: usize,
    /// All places that were handed out.
    pub(crate) places: Vec<Place>,
}

impl Arena {
    pub(crate) fn place(&mut self, len: usize) -> Place {
        let place = Place { offset: self.used as u32, len: len as u32 };
        self.used = (self.used + len).next_multiple_of(16);
        self.places.push(place);
        place
    }

    pub(crate) fn floats(&self) -> u32 {
        self.used as u32
    }
}

/// Floats that every part starts at a multiple of: one cache line.
const ALIGN: usize = 16;

/// The weights of a plan, part after part.
#[derive(Clone, Debug, Default)]
pub(crate) struct Weights {
    pub(crate) floats: Vec<f32>,
}

impl Weights {
    /// The weights as a plan holds them.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        self.floats.iter().flat_map(|weight| weight.to_le_bytes()).collect()
    }

    /// Adds a layer, its columns in tiles, matrix and bias padded with zeros.
    pub(crate) fn add_layer(&mut self, layer: &Layer) -> Linear {
        let Matrix { inputs, outputs, .. } = layer.matrix;
        let weights = self.add_matrices(&[&layer.matrix]);
        let bias = self.align();
        // Adding zero turns -0 into +0: sums that never are -0 may leave out terms of ±0.
        self.floats.extend(layer.bias.iter().map(|bias| bias + 0.0));
        self.floats.resize(bias + padded(outputs), 0.0);
        Linear { inputs: inputs as u16, outputs: outputs as u16, weights, bias: bias as u32 }
    }

    /// Adds matrices of the same size one behind the other and returns where the first starts.
    pub(crate) fn add_matrices(&mut self, matrices: &[&Matrix]) -> u32 {
        let start = self.align();
        for matrix in matrices {
            let mut column = 0;
            while column < matrix.outputs {
                let width = tile_width(padded(matrix.outputs) - column);
                for row in matrix.values.chunks_exact(matrix.outputs) {
                    let tile = row.iter().skip(column).chain(std::iter::repeat(&0.0)).take(width);
                    self.floats.extend(tile);
                }
                column += width;
            }
        }
        start as u32
    }

    /// Adds the rows of a matrix as vectors, each padded with zeros.
    pub(crate) fn add_vectors(&mut self, rows: &Matrix) -> Vectors {
        let Matrix { inputs: count, outputs: width, values } = rows;
        let start = self.align();
        for row in values.chunks_exact(*width) {
            self.floats.extend(row);
            self.floats.resize(self.floats.len() + padded(*width) - width, 0.0);
        }
        Vectors { weights: start as u32, count: *count as u16, width: *width as u16 }
    }

    /// Adds numbers as they are.
    pub(crate) fn add_numbers(&mut self, numbers: &[f32]) -> u32 {
        let start = self.align();
        self.floats.extend(numbers);
        start as u32
    }

    fn align(&mut self) -> usize {
        self.floats.resize(self.floats.len().next_multiple_of(ALIGN), 0.0);
        self.floats.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_go_to_tiles_and_padding_is_zero() {
        let value = |row: usize, column: usize| (100 * row + column) as f32;
        let values = (0..2).flat_map(|row| (0..75).map(move |column| value(row, column))).collect();
        let layer = Layer {
            matrix: Matrix { inputs: 2, outputs: 75, values },
            bias: vec![-0.0; 75],
            relu: false,
        };
        let mut weights = Weights::default();
        let linear = weights.add_layer(&layer);
        assert_eq!((linear.weights_len(), linear.bias as usize), (2 * 80, 2 * 80));
        let at = |index: usize| weights.floats[index];
        assert_eq!((at(0), at(63), at(64)), (value(0, 0), value(0, 63), value(1, 0)));
        // The rest of 16 padded columns is one tile.
        assert_eq!((at(128), at(138), at(139)), (value(0, 64), value(0, 74), 0.0));
        assert_eq!((at(144), at(154), at(155)), (value(1, 64), value(1, 74), 0.0));
        assert!(weights.floats[160..].iter().all(|bias| bias.to_bits() == 0));
    }
}
