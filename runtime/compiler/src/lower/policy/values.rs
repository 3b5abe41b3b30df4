//! Where the values of a graph stand, and what their sizes are.

use std::collections::HashMap;

use sortie_core::internal::ops::{Constant, Op, Place};
use sortie_plans::CompileError;
use tract_onnx::prelude::*;

use super::{Lowered, Lowering};
use crate::graph::{guarded, shape};

/// The values that have a place.
#[derive(Default)]
pub(super) struct Values(HashMap<OutletId, Value>);

/// A value: numbers behind each other, the last size the fastest.
#[derive(Clone, Debug)]
pub(super) struct Value {
    pub(super) place: Place,
    pub(super) shape: Vec<usize>,
}

impl Values {
    pub(super) fn insert(&mut self, outlet: OutletId, place: Place, shape: Vec<usize>) {
        self.0.insert(outlet, Value { place, shape });
    }

    pub(super) fn has(&self, outlet: OutletId) -> bool {
        self.0.contains_key(&outlet)
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
        if let Some(value) = self.values.0.get(&outlet) {
            return Ok(value.clone());
        }
        let node = self.model.node(outlet.node);
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
        self.values.insert((node.id, slot).into(), place, shape);
        Ok(())
    }

    /// The error that names a node.
    pub(super) fn unsupported(&self, node: &TypedNode, hint: &'static str) -> CompileError {
        let facts = self.model.node_input_facts(node.id).unwrap_or_default();
        let shapes: Vec<String> = facts.iter().map(|fact| shape(fact)).collect();
        CompileError::Unsupported {
            node: node.name.clone(),
            operator: node.op.name().into_owned(),
            shapes: shapes.join(", "),
            hint: hint.into(),
        }
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
