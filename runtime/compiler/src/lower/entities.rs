//! Layers of networks over all entities become operators.

use sortie_core::internal::kernels::mark::MARKED;
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    AttendAll, Dense, EmbedEntities, GroupSum, MeanRows, Op, Output, OutputRows, Place,
};
use sortie_core::limits;
use sortie_core::plan::{OPS, ProgramDraft};
use sortie_plans::CompileError;

use super::agent::{Arena, Weights, at_most, by_heads, check_weights, padded_heads, same_sizes};
use crate::matching::{AllAttention, EntityLayers, EntityStep, Layer};

/// Sizes that the layers do not tell.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EntitySizes {
    /// Most present entities.
    pub(crate) n_max: usize,
    /// Features d of an entity.
    pub(crate) features: usize,
    /// Groups T.
    pub(crate) groups: usize,
}

/// A value of the program.
#[derive(Clone, Copy, Debug)]
struct Value {
    place: Place,
    width: usize,
    rows: OutputRows,
    /// Whether it comes out of a ReLU, so that many numbers are zero.
    relu: bool,
}

/// Lowers a network over all entities to a program and its weights.
pub(crate) fn lower_entities(
    layers: &EntityLayers,
    sizes: EntitySizes,
) -> Result<(ProgramDraft, Weights), CompileError> {
    let EntitySizes { n_max, features, groups } = sizes;
    at_most("the number of entities", n_max, limits::ENTITIES)?;
    at_most("the number of features", features, limits::FEATURES)?;
    at_most("the number of groups", groups, limits::TASKS)?;
    let mut lowering = Lowering { sizes, ..Lowering::default() };
    lowering.embed(&layers.embed)?;
    for step in &layers.steps {
        lowering.step(step)?;
    }
    for output in &layers.outputs {
        let Value { place: from, width, rows, .. } = lowering.value(*output)?;
        let groups = if rows == OutputRows::Groups { groups as u16 } else { 0 };
        lowering.ops.push(Op::Output(Output { from, width: width as u32, rows, groups }));
    }
    let count = lowering.ops.len();
    at_most("the number of layers and outputs", count, OPS)?;
    let floats = lowering.arena.floats();
    let nonzeros = lowering.longest_input.div_ceil(MARKED) as u32;
    Ok((ProgramDraft { ops: lowering.ops, floats, nonzeros }, lowering.weights))
}

#[derive(Default)]
struct Lowering {
    sizes: EntitySizes,
    weights: Weights,
    arena: Arena,
    ops: Vec<Op>,
    values: Vec<Value>,
    longest_input: usize,
}

impl Lowering {
    fn embed(&mut self, layer: &Layer) -> Result<(), CompileError> {
        self.check("first", layer, self.sizes.features)?;
        let rows = self.arena.place((self.sizes.n_max + 1) * padded(layer.matrix.outputs));
        let linear = self.weights.add_layer(layer);
        let relu = layer.relu;
        self.ops.push(Op::EmbedEntities(EmbedEntities {
            layer: linear,
            last_actions: 0,
            relu: relu.into(),
            rows,
        }));
        self.values.push(Value {
            place: rows,
            width: layer.matrix.outputs,
            rows: OutputRows::Entities,
            relu,
        });
        Ok(())
    }

    fn step(&mut self, step: &EntityStep) -> Result<(), CompileError> {
        let (op, value) = match step {
            EntityStep::Attend { rows, attention } => self.attend(*rows, attention)?,
            EntityStep::Mean { rows, members } => {
                let Value { place: rows, width, .. } = self.value(*rows)?;
                let to = self.arena.place(padded(width));
                let (members, rows_of) = (*members, OutputRows::One);
                let mean = MeanRows { rows, width: width as u16, members, to };
                (Op::MeanRows(mean), Value { place: to, width, rows: rows_of, relu: false })
            }
            EntityStep::GroupSum { rows } => {
                let Value { place: rows, width, .. } = self.value(*rows)?;
                let groups = self.sizes.groups as u16;
                let to = self.arena.place(usize::from(groups) * padded(width));
                let sum = GroupSum { rows, width: width as u16, groups, to };
                let rows = OutputRows::Groups;
                (Op::GroupSum(sum), Value { place: to, width, rows, relu: false })
            }
            EntityStep::Dense { from, layer } => self.dense(*from, layer)?,
        };
        self.ops.push(op);
        self.values.push(value);
        Ok(())
    }

    fn dense(&mut self, from: usize, layer: &Layer) -> Result<(Op, Value), CompileError> {
        let Value { place: mut from, width, relu: sparse_input, .. } = self.value(from)?;
        self.check("dense", layer, width)?;
        from.len = width as u32;
        let outputs = layer.matrix.outputs;
        let to = self.arena.place(padded(outputs));
        let relu = layer.relu;
        let linear = self.weights.add_layer(layer);
        let sparse_input = sparse_input.into();
        let dense = Dense { layer: linear, relu: relu.into(), sparse_input, from, to };
        let value = Value { place: to, width: outputs, rows: OutputRows::One, relu };
        Ok((Op::Dense(dense), value))
    }

    fn attend(
        &mut self,
        rows: usize,
        attention: &AllAttention,
    ) -> Result<(Op, Value), CompileError> {
        let AllAttention { heads, query, key, value, output } = attention;
        let Value { place: rows, width, .. } = self.value(rows)?;
        let of_heads = query.matrix.outputs;
        for (name, layer) in [("query", query), ("key", key), ("value", value)] {
            self.check(name, layer, width)?;
            same_sizes("the heads' joint width", layer.matrix.outputs, of_heads)?;
        }
        same_sizes("the heads' joint width", of_heads / (*heads).max(1) * heads, of_heads)?;
        self.check("attention output", output, of_heads)?;
        let padded_output =
            Layer { matrix: padded_heads(&output.matrix, *heads), ..output.clone() };
        let inner = padded_output.matrix.inputs;
        at_most("the width of a layer", inner, usize::from(u16::MAX) / 8)?;
        let [query, key, value] =
            [query, key, value].map(|layer| self.weights.add_layer(&by_heads(layer, *heads)));
        let output = self.weights.add_layer(&padded_output);
        let n_max = self.sizes.n_max;
        let (outputs, relu) = (padded_output.matrix.outputs, padded_output.relu);
        let mut of_rows = |width: usize| self.arena.place(n_max * width);
        let [queries, keys, values] = [inner; 3].map(&mut of_rows);
        let to = of_rows(padded(outputs));
        let attend = AttendAll {
            rows,
            width: width as u16,
            heads: *heads as u16,
            query,
            key,
            value,
            output,
            relu: relu.into(),
            queries,
            keys,
            values,
            scores: self.arena.place(n_max),
            attended: self.arena.place(inner),
            to,
        };
        let rows = OutputRows::Entities;
        Ok((Op::AttendAll(attend), Value { place: to, width: outputs, rows, relu }))
    }

    fn check(
        &mut self,
        name: &'static str,
        layer: &Layer,
        inputs: usize,
    ) -> Result<(), CompileError> {
        self.longest_input = self.longest_input.max(inputs);
        check_weights(name, &layer.matrix, &layer.bias)?;
        same_sizes("a layer's input", layer.matrix.inputs, inputs)
    }

    fn value(&self, index: usize) -> Result<Value, CompileError> {
        let last = self.values.len();
        let missing = CompileError::Size { what: "a value".into(), got: index, want: last };
        self.values.get(index).copied().ok_or(missing)
    }
}
