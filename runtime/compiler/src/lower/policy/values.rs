//! Where the values of a graph stand, and what their sizes are.

use std::collections::HashMap;

use sortie_bundle::sha256;
use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Constant, Dense, DenseRows, Flag, Int8Dense, Int8Layer, Linear, Op, Place, quantised_floats,
};
use sortie_core::plan::Profile;
use sortie_plans::CompileError;
use tract_onnx::prelude::*;

use super::pictures::Picture;
use super::{Lowered, Lowering};
use crate::graph::{guarded, unsupported};
use crate::lower::agent::{Arena, Weights};
use crate::lower::int8::{Int8Weights, Order};
use crate::lower::rounding::Rounded;
use crate::matching::Layer;

/// The values that have a place: in the order of the graph, or as pictures in another.
#[derive(Default)]
pub(super) struct Values {
    in_order: HashMap<OutletId, Value>,
    pictures: HashMap<OutletId, Picture>,
    /// Pictures with the border of zeros that their only reader wants, as it reads them.
    framed: HashMap<OutletId, Place>,
    /// Values whose axes stand in another order once more.
    pub(super) permuted: HashMap<(OutletId, Vec<usize>), Place>,
    /// While a function of every number is lowered: the picture in whose order it works.
    pub(super) as_picture: Option<Picture>,
}

/// A value: numbers behind each other, the last size the fastest.
#[derive(Clone, Debug)]
pub(super) struct Value {
    pub(super) place: Place,
    pub(super) shape: Vec<usize>,
}

impl Values {
    pub(super) fn insert(&mut self, outlet: OutletId, place: Place, shape: Vec<usize>) {
        self.in_order.insert(outlet, Value { place, shape });
    }

    pub(super) fn insert_picture(&mut self, outlet: OutletId, picture: Picture) {
        self.pictures.insert(outlet, picture);
    }

    /// The picture that stands in its own order, unless it stands in the graph's as well.
    pub(super) fn picture(&self, outlet: OutletId) -> Option<Picture> {
        self.pictures.get(&outlet).copied()
    }

    /// Whether a value stands in the order of the picture in whose order the function at hand works.
    pub(super) fn stands(&self, outlet: OutletId) -> bool {
        let own = self.picture(outlet);
        own.zip(self.as_picture).is_some_and(|(own, wanted)| own.is_like(&wanted))
    }

    pub(super) fn insert_framed(&mut self, outlet: OutletId, place: Place) {
        self.framed.insert(outlet, place);
    }

    pub(super) fn framed(&self, outlet: OutletId) -> Option<Place> {
        self.framed.get(&outlet).copied()
    }

    pub(super) fn has(&self, outlet: OutletId) -> bool {
        self.in_order.contains_key(&outlet)
            || self.pictures.contains_key(&outlet)
            || self.framed.contains_key(&outlet)
    }
}

impl Lowering<'_> {
    /// The value behind an input of a node; a constant gets a place here.
    pub(super) fn operand(&mut self, node: &TypedNode, slot: usize) -> Lowered<Value> {
        let outlet = self.outlet(node, slot)?;
        self.value(outlet)
    }

    pub(super) fn outlet(&self, node: &TypedNode, slot: usize) -> Lowered<OutletId> {
        let missing = || self.unsupported(node, "it lacks an input");
        node.inputs.get(slot).copied().ok_or_else(missing)
    }

    pub(super) fn value(&mut self, outlet: OutletId) -> Lowered<Value> {
        let node = self.model.node(outlet.node);
        let picture = self.values.picture(outlet);
        if let (Some(picture), true) = (picture, self.values.stands(outlet)) {
            return Ok(Value { place: picture.place, shape: self.shape(node, outlet.slot)? });
        }
        if let Some(value) = self.values.in_order.get(&outlet) {
            return Ok(value.clone());
        }
        if let Some(picture) = picture {
            let place = self.channels_first(node, picture)?;
            let shape = self.shape(node, outlet.slot)?;
            self.values.insert(outlet, place, shape);
            return self.value(outlet);
        }
        let missing = || self.unsupported(node, "nothing computes it");
        let constant = self.constant(outlet).ok_or_else(missing)?;
        let numbers = numbers(&constant).ok_or_else(missing)?;
        let to = self.stored(&numbers);
        self.values.insert(outlet, to, constant.shape().to_vec());
        self.value(outlet)
    }

    /// Adds numbers that the plan has: behind inputs and states, which come first, and before whatever reads them.
    pub(super) fn stored(&mut self, numbers: &[f32]) -> Place {
        let to = self.arena.place(numbers.len());
        let weights = self.weights.add_numbers(numbers);
        self.ops.push(Op::Constant(Constant { weights, to }));
        to
    }

    /// Adds a table to the weights; one that stands there already, as in every turn of a loop, stands there once.
    pub(super) fn stored_table(&mut self, numbers: &[f32]) -> Place {
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let weights = &mut self.weights;
        let offset =
            self.tables.entry(sha256(&bytes)).or_insert_with(|| weights.add_numbers(numbers));
        Place { offset: *offset, len: numbers.len() as u32 }
    }

    pub(super) fn place_of(&mut self, outlet: OutletId) -> Lowered<Place> {
        self.value(outlet).map(|value| value.place)
    }

    /// The tensor of a constant.
    pub(super) fn constant(&self, outlet: OutletId) -> Option<Arc<Tensor>> {
        self.model.outlet_fact(outlet).ok()?.konst.clone()
    }

    /// The number that a constant repeats.
    pub(super) fn uniform(&self, outlet: OutletId) -> Option<f32> {
        let numbers = numbers(&*self.constant(outlet)?)?;
        let first = *numbers.first()?;
        numbers.iter().all(|number| *number == first).then_some(first)
    }

    /// The sizes of an output of a node.
    pub(super) fn shape(&self, node: &TypedNode, slot: usize) -> Lowered<Vec<usize>> {
        let fact = node.outputs.get(slot).map(|output| &output.fact);
        let sizes = fact.and_then(|fact| fact.shape.as_concrete());
        sizes.map(<[usize]>::to_vec).ok_or_else(|| self.unsupported(node, "its size is left open"))
    }

    /// Says where an output of a node stands.
    pub(super) fn give(&mut self, node: &TypedNode, slot: usize, place: Place) -> Lowered<()> {
        let shape = self.shape(node, slot)?;
        if shape.iter().product::<usize>() != place.len as usize {
            return Err(self.unsupported(node, "its numbers are not as many as its sizes say"));
        }
        let outlet = (node.id, slot).into();
        match self.values.as_picture {
            Some(picture) => self.values.insert_picture(outlet, Picture { place, ..picture }),
            None => self.values.insert(outlet, place, shape),
        }
        Ok(())
    }

    /// The error that names a node.
    pub(super) fn unsupported(&self, node: &TypedNode, hint: &'static str) -> CompileError {
        unsupported(self.model, node, hint)
    }
}

/// The numbers of a tensor as f32: masks are 0 and 1.
pub(super) fn numbers(tensor: &Tensor) -> Option<Vec<f32>> {
    let read = || {
        let tensor = tensor.cast_to::<f32>()?;
        Ok(tensor.to_plain_array_view::<f32>()?.iter().copied().collect())
    };
    guarded(read).ok()
}

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
