//! The weights of a policy in the layout of its profile, and its layers as operators of that layout.

use std::collections::HashMap;

use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Dense, DenseRows, Flag, Int8Dense, Int8Layer, Linear, Op, Place, quantised_floats,
};
use sortie_core::plan::Profile;

use crate::lower::agent::Arena;
use crate::lower::int8_layout::{Int8Weights, Order};
use crate::lower::layout::Weights;
use crate::lower::rounding::Rounded;
use crate::matching::Layer;

/// The weights of a plan, part after part.
pub(crate) enum PolicyWeights {
    /// Layout 1.
    Tiles(Weights),
    /// Layout 2, and room for the quantised inputs of layers, by its length: layers do not work at once.
    Int8(Int8Weights, HashMap<usize, Place>),
}

/// A layer among the weights.
#[derive(Clone, Copy)]
pub(super) struct StoredLayer {
    kind: Stored,
    relu: Flag,
}

#[derive(Clone, Copy)]
enum Stored {
    Tiles(Linear, Flag),
    Int8(Int8Layer, Place),
}

impl PolicyWeights {
    pub(super) fn of(profile: Profile) -> Self {
        match profile {
            Profile::Int8 => Self::Int8(Int8Weights::default(), HashMap::new()),
            _ => Self::Tiles(Weights::default()),
        }
    }

    /// Adds numbers as they are.
    pub(super) fn add_numbers(&mut self, numbers: &[f32]) -> u32 {
        match self {
            Self::Tiles(weights) => weights.add_numbers(numbers),
            Self::Int8(weights, _) => weights.add_floats(numbers),
        }
    }

    /// Adds a layer, whose input comes out of a ReLU or does not.
    pub(super) fn add_layer(
        &mut self,
        layer: &Layer,
        sparse_input: bool,
        arena: &mut Arena,
    ) -> StoredLayer {
        let kind = match self {
            Self::Tiles(weights) => {
                Stored::Tiles(weights.add_layer(layer), Flag::from(sparse_input))
            }
            Self::Int8(weights, rooms) => {
                let room = quantised_floats(layer.matrix.inputs);
                let quantised = rooms.entry(room).or_insert_with(|| arena.place(room));
                Stored::Int8(weights.add_layer(&Rounded::nearest(layer), Order::Strips), *quantised)
            }
        };
        StoredLayer { kind, relu: Flag::from(layer.relu) }
    }

    /// The weights as a plan holds them.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        match self {
            Self::Tiles(weights) => weights.to_bytes(),
            Self::Int8(weights, _) => weights.bytes.clone(),
        }
    }
}

impl StoredLayer {
    /// The layer on every row of a value, rows side by side without padding.
    pub(super) fn ops(self, rows: usize, from: Place, to: Place) -> Vec<Op> {
        match self.kind {
            Stored::Tiles(layer, _) if rows > 1 => {
                let before = (rows - 1) * usize::from(layer.outputs);
                let to = Place { len: (before + layer.padded_outputs()) as u32, ..to };
                let (relu, rows) = (self.relu, rows as u32);
                vec![Op::DenseRows(DenseRows { layer, relu, rows, from, to })]
            }
            Stored::Tiles(Linear { inputs, outputs, .. }, _)
            | Stored::Int8(Int8Layer { inputs, outputs, .. }, _) => (0..rows as u32)
                // A row's padding is written over by the next row.
                .map(|row| {
                    let at = |place: Place, width: u16| place.offset + row * u32::from(width);
                    self.op(at(from, inputs), at(to, outputs))
                })
                .collect(),
        }
    }

    /// The layer on a vector: so many floats from the first on, as its result.
    fn op(self, from: u32, to: u32) -> Op {
        let relu = self.relu;
        let places = |inputs: u16, outputs: u16| {
            let to = Place { offset: to, len: padded(outputs.into()) as u32 };
            (Place { offset: from, len: inputs.into() }, to)
        };
        match self.kind {
            Stored::Tiles(layer, sparse_input) => {
                let (from, to) = places(layer.inputs, layer.outputs);
                Op::Dense(Dense { layer, relu, sparse_input, from, to })
            }
            Stored::Int8(layer, quantised) => {
                let (from, to) = places(layer.inputs, layer.outputs);
                Op::Int8Dense(Int8Dense { layer, relu, from, to, quantised })
            }
        }
    }
}
