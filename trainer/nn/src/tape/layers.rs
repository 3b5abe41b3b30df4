//! Steps with parameters, and those of networks: layers, attention, memories.

use super::{Attended, Gru, Linear, Operation, Pass, Var};
use crate::layers::attention::{AttentionShape, Forward};
use crate::layers::gru::GruShape;
use crate::layers::matrix::Store;
use crate::layers::split_attention::{self, BLOCKS};
use crate::layers::unfold::UnfoldShape;
use crate::layers::{
    SparseRows, VisibleLists, attention, elementwise, linear, sparse_linear, unfold,
};

impl Pass<'_> {
    /// `x W' + b`
    pub fn linear(&mut self, x: Var, layer: Linear) -> Var {
        self.affine(x, layer, false)
    }

    /// `max(0, x W' + b)`
    pub fn linear_rectified(&mut self, x: Var, layer: Linear) -> Var {
        self.affine(x, layer, true)
    }

    /// `max(0, x W' + added V' + b)`: a layer whose columns are in two parts, the second of which has no offsets.
    pub fn linear_sum_rectified(
        &mut self,
        [x, added]: [Var; 2],
        [layer, added_layer]: [Linear; 2],
    ) -> Var {
        let ([rows, columns], [added_rows, added_columns]) = (self.size(x), self.size(added));
        let inputs = [layer, added_layer].map(|layer| layer.shape.input);
        assert_eq!(([columns, added_columns], rows), (inputs, added_rows), "sizes of the inputs");
        assert_eq!(layer.shape.output, added_layer.shape.output, "columns of the output");
        let operation = Operation::LinearSum { x: [x, added], layers: [layer, added_layer] };
        let y = self.tape.push(operation, rows, layer.shape.output, true);
        let [weight, added_weight] =
            [layer, added_layer].map(|layer| &self.parameters[layer.weight_range()]);
        let bias = &self.parameters[layer.bias_range().expect("the first part has the offsets")];
        let ([x, added], out) = self.tape.split([x, added], y);
        linear::product(layer.shape, Store::Replace, x, weight, out);
        linear::product(added_layer.shape, Store::Add, added, added_weight, out);
        linear::add_bias(0.0, bias, out);
        y
    }

    fn affine(&mut self, x: Var, layer: Linear, rectified: bool) -> Var {
        let [rows, columns] = self.size(x);
        assert_eq!(columns, layer.shape.input, "columns of the input");
        let operation = Operation::Linear { x, layer, rectified };
        let y = self.tape.push(operation, rows, layer.shape.output, true);
        let weight = &self.parameters[layer.weight_range()];
        let bias = layer.bias_range().map(|range| &self.parameters[range]);
        let ([x], out) = self.tape.split([x], y);
        linear::product(layer.shape, Store::Replace, x, weight, out);
        match bias {
            Some(bias) if rectified => linear::add_bias(0.0, bias, out),
            Some(bias) => linear::add_bias(f32::NEG_INFINITY, bias, out),
            None if rectified => elementwise::rectify(out),
            None => {}
        }
        y
    }

    /// A first layer over features that are mostly zeros; its weight is `[input, output]`.
    pub fn sparse_linear(&mut self, features: &SparseRows, layer: Linear) -> Var {
        self.sparse(features, layer, false)
    }

    /// The same, rectified.
    pub fn sparse_linear_rectified(&mut self, features: &SparseRows, layer: Linear) -> Var {
        self.sparse(features, layer, true)
    }

    fn sparse(&mut self, features: &SparseRows, layer: Linear, rectified: bool) -> Var {
        let (rows, kept) = self.tape.sparse.next();
        if self.tape.goes_back {
            kept.clear();
            kept.append(features);
        }
        let entries = features.entries();
        let operation = Operation::SparseLinear { rows, entries, layer, rectified };
        let y = self.tape.push(operation, features.len(), layer.shape.output, true);
        let weight = &self.parameters[layer.weight_range()];
        let bias = layer.bias_range().expect("sparse layers have offsets");
        let ([], out) = self.tape.split([], y);
        sparse_linear::forward(features, weight, &self.parameters[bias], out);
        if rectified {
            elementwise::rectify(out);
        }
        y
    }

    /// A convolution: a picture a row in, its patches behind each other out, `[patches, output]` of each. The kernels are
    /// those of a layer over a patch.
    pub fn convolution(&mut self, x: Var, shape: UnfoldShape, layer: Linear) -> Var {
        let pictures = self.size(x)[0];
        let patches = self.unfold(x, shape);
        let y = self.linear(patches, layer);
        let numbers = self.size(y)[0] * layer.shape.output;
        self.reshape(y, numbers / pictures)
    }

    /// The patches of pictures, each a row.
    pub fn unfold(&mut self, x: Var, shape: UnfoldShape) -> Var {
        let [pictures, columns] = self.size(x);
        assert_eq!(columns, shape.picture(), "columns of a picture");
        let (down, across) = shape.patches();
        let rows = pictures * down * across;
        self.step(Operation::Unfold { x, shape }, x, [rows, shape.patch()], |x, y| {
            unfold::forward(shape, x, y);
        })
    }

    /// What each query makes of the rows that it sees: `queries [queries, width]`, `keys_values [rows, 2 width]`
    /// a key and its value in a row. Several passes may share keys and values, and see others of them.
    pub fn attention(
        &mut self,
        queries: Var,
        keys_values: Var,
        visible: &VisibleLists,
        heads: usize,
    ) -> Var {
        self.attend([queries, keys_values], visible, heads, Attended::Whole)
    }

    /// Three blocks `[3 * queries, width]` of attention in four heads, at a width of one of
    /// [`WIDTHS`](split_attention::WIDTHS): of everything that a query sees, of what lies within its part and of what lies
    /// across, as imagined passes need them (REFIL, dissertation section 5.4); no pair is looked at twice. Sizes as of
    /// [`attention`](Self::attention).
    pub fn split_attention(
        &mut self,
        queries: Var,
        keys_values: Var,
        visible: &VisibleLists,
    ) -> Var {
        let inputs = [queries, keys_values];
        self.attend(inputs, visible, split_attention::HEADS, Attended::Parts)
    }

    /// `[queries, 1]`: the sum of the squared scores of what each query sees, before they are scaled, over all heads.
    pub fn squared_scores(
        &mut self,
        queries: Var,
        keys_values: Var,
        visible: &VisibleLists,
        heads: usize,
    ) -> Var {
        self.attend([queries, keys_values], visible, heads, Attended::Scores)
    }

    fn attend(
        &mut self,
        inputs: [Var; 2],
        visible: &VisibleLists,
        heads: usize,
        to: Attended,
    ) -> Var {
        let [count, width] = self.size(inputs[0]);
        assert_eq!((count, 2 * width), (visible.queries(), self.size(inputs[1])[1]), "sizes");
        let shape = AttentionShape { width, heads };
        let (lists, pairs) = (self.tape.keep_lists(visible), visible.pairs());
        let (size, shares) = match to {
            Attended::Whole => ([count, width], 0),
            Attended::Parts => ([BLOCKS * count, width], count * heads),
            Attended::Scores => ([count, 1], 0),
        };
        let operation = |kept| Operation::Attend { inputs, lists, pairs, kept, shape, to };
        let weights = pairs * heads;
        self.keep(weights + shares, operation, inputs, size, |inputs, kept, output| {
            let ([queries, keys_values], (of_pairs, shares)) = (inputs, kept.split_at_mut(weights));
            let pass = Forward { queries, keys_values, of_pairs, shares, output };
            match to {
                Attended::Scores => attention::squared_scores(shape, visible, pass),
                Attended::Whole if !split_attention::is_built_for(width, heads) => {
                    attention::forward(shape, visible, pass);
                }
                _ => split_attention::forward(width, visible, pass),
            }
        })
    }

    /// `[pairs, heads]`: the weights of what each query sees, list behind list, of a matrix that is
    /// [`attention`](Self::attention)'s or [`absorbed_attention`](Self::absorbed_attention)'s.
    pub fn attention_weights(&self, attended: Var) -> Option<&[f32]> {
        match self.tape.of(attended).operation {
            Operation::Attend { pairs, kept, shape, .. } => {
                Some(&self.tape.values[kept..][..pairs * shape.heads])
            }
            Operation::Absorb { pairs, pass, heads, .. } => {
                let weights = self.tape.absorbed.things[pass].weights();
                Some(&weights[..pairs * heads])
            }
            _ => None,
        }
    }

    /// The memories of a recurrent unit after each step of `x [steps * slots, width]`, from `memory
    /// [slots, width]`, which gets no slopes and becomes what is left; it is emptied behind each step where
    /// `carry [steps * slots]` does not hold.
    pub fn gru(&mut self, x: Var, layer: Gru, carry: &[bool], memory: &mut [f32]) -> Var {
        let [rows, width] = self.size(x);
        assert_eq!((rows, width), (carry.len(), layer.width), "sizes");
        let slots = memory.len() / width;
        let first = self.tape.carry.len();
        self.tape.carry.extend_from_slice(carry);
        let (pass, _) = self.tape.grus.next();
        let operation = Operation::Recur { x, pass, carry: first, slots, layer };
        let y = self.tape.push(operation, rows, width, true);
        let (range, out) = (self.tape.of(x).range(), self.tape.of(y).range());
        let (before, rest) = self.tape.values.split_at_mut(out.start);
        self.tape.grus.things[pass].forward(
            GruShape { width, slots },
            &self.parameters[layer.range()],
            (&before[range], carry),
            memory,
            &mut rest[..out.len()],
        );
        y
    }
}
