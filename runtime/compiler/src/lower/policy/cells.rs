//! Recurrent units: what stands between and behind their products.

use sortie_core::internal::ops::{GruCell, LstmCell, Op};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;

use super::values::numbers;
use super::{Lowered, Lowering};

/// Why a unit is refused that works on several rows.
const ONE_STEP: &str = "plans run a recurrent unit for one step of one sequence";

impl Lowering<'_> {
    /// A gated recurrent unit: products on the input and on the state, both with their biases.
    pub(super) fn gru(&mut self, node: &TypedNode, size: usize) -> Lowered<()> {
        let [input, recurrent, state] = [0, 1, 2].map(|slot| self.operand(node, slot));
        let (input, recurrent, state) = (input?.place, recurrent?.place, state?.place);
        let gates = [input, recurrent].map(|place| place.len as usize);
        if gates != [3 * size; 2] || state.len as usize != size {
            return Err(self.unsupported(node, ONE_STEP));
        }
        let to = self.arena.place(size);
        self.ops.push(Op::GruCell(GruCell { input, recurrent, state, to }));
        self.give(node, 0, to)
    }

    /// A long short-term memory: the sum of two products and a bias, and the cell.
    pub(super) fn lstm(&mut self, node: &TypedNode, size: usize) -> Lowered<()> {
        let gates = 4 * size;
        let mut sum = Sum { values: Vec::new(), bias: vec![0.0; gates] };
        self.add_to(&mut sum, self.outlet(node, 0)?, gates);
        let (values, bias) = match sum.values.as_slice() {
            &[input, recurrent] => ([self.place_of(input)?, self.place_of(recurrent)?], sum.bias),
            _ => {
                let all = self.operand(node, 0)?.place;
                ([all, self.stored(&vec![0.0; gates])], vec![0.0; gates])
            }
        };
        let [input, recurrent] = values;
        let cell = self.operand(node, 1)?.place;
        let lengths = [input.len, recurrent.len].map(|len| len as usize);
        if lengths != [gates; 2] || cell.len as usize != size {
            return Err(self.unsupported(node, ONE_STEP));
        }
        let bias = self.weights.add_numbers(&bias);
        let (to, cell_to) = (self.arena.place(size), self.arena.place(size));
        self.ops.push(Op::LstmCell(LstmCell { bias, input, recurrent, cell, to, cell_to }));
        self.give(node, 0, to)?;
        self.give(node, 1, cell_to)
    }

    /// Takes a sum apart into values and a bias, as far as all are as long.
    fn add_to(&self, sum: &mut Sum, outlet: OutletId, length: usize) {
        let constant = self.constant(outlet).and_then(|tensor| numbers(&tensor));
        if let Some(constant) = constant.filter(|constant| constant.len() == length) {
            for (bias, number) in sum.bias.iter_mut().zip(constant) {
                *bias += number;
            }
            return;
        }
        let node = self.model.node(outlet.node);
        let is_sum = node.op_as::<TypedBinOp>().is_some_and(|op| op.0.name() == "Add");
        let is_long = |outlet: &OutletId| {
            let shape = self.model.outlet_fact(*outlet).map(|fact| fact.shape.as_concrete());
            shape.is_ok_and(|shape| shape.is_some_and(|s| s.iter().product::<usize>() == length))
        };
        if is_sum && node.inputs.iter().all(is_long) {
            node.inputs.iter().for_each(|outlet| self.add_to(sum, *outlet, length));
        } else {
            sum.values.push(outlet);
        }
    }
}

/// A sum taken apart.
struct Sum {
    values: Vec<OutletId>,
    bias: Vec<f32>,
}
