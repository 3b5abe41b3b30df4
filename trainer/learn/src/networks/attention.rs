//! Entities embedded and attended to: what agents and hypernetworks begin with (dissertation section 2.3).

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::batch::View;

/// Sizes of embedding and attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LookShape {
    /// Columns of an entity's row.
    pub input: usize,
    /// Columns that are usually not zero, by which the first weights are scaled.
    pub active_inputs: usize,
    /// Width of embedding, queries, keys and values. What is imagined takes one of
    /// [`WIDTHS`](sortie_nn::layers::split_attention::WIDTHS), for which attention in four heads is built.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
}

/// The layers: features are embedded, `max(0, W x + b)`, and every query attends to the embeddings that it sees.
#[derive(Clone, Copy, Debug)]
pub struct EntityAttention {
    /// `[input, width]`
    pub embed: Linear,
    /// `[width, width]`, without offsets.
    pub queries: Linear,
    /// `[2 width, width]`, without offsets.
    pub keys_values: Linear,
    /// Attention heads.
    pub heads: usize,
    /// Whether queries absorb their keys, which comes to other last bits, where nothing is imagined and that takes fewer
    /// multiplications.
    pub absorbs: bool,
}

/// What queries have attended to.
#[derive(Clone, Copy, Debug)]
pub struct Attended {
    /// Embeddings of all rows, `[rows, width]`.
    pub embeddings: Var,
    /// `[blocks * queries, width]`
    pub output: Var,
}

impl EntityAttention {
    /// Adds tensors `fc1` and `attention.in`, whose rows are those of queries, then keys, then values; drawn as PyTorch does.
    pub fn new(
        parameters: &mut Parameters,
        name: &str,
        shape: LookShape,
        random: &mut Generator,
    ) -> Self {
        let LookShape { input, active_inputs, width, heads } = shape;
        let sizes = [input, width];
        let embed =
            parameters.sparse_linear(&format!("{name}.fc1"), sizes, active_inputs as f32, random);
        let name = format!("{name}.attention.in");
        let Linear { weight, .. } = parameters.projection(&name, width, 3 * width, random);
        let part = |output: usize, weight: usize| Linear {
            shape: LinearShape { input: width, output },
            weight,
            bias: None,
        };
        let queries = part(width, weight);
        let keys_values = part(2 * width, weight + width * width);
        Self { embed, queries, keys_values, heads, absorbs: false }
    }

    /// Attends to what a batch shows: queries are made of agents' rows only, keys and values of all.
    pub fn attend(&self, pass: &mut Pass<'_>, view: View<'_>) -> Attended {
        let embeddings = pass.sparse_linear_rectified(view.rows, self.embed);
        let queries = if view.own.is_empty() {
            let own = pass.rows(embeddings, 0..view.queries());
            pass.linear(own, self.queries)
        } else {
            // Several queries may be of one row.
            let queries = pass.linear(embeddings, self.queries);
            pass.gather(queries, view.own)
        };
        let output = if self.absorbs && self.pays(view) {
            pass.absorbed_attention(queries, embeddings, self.keys_values, view.lists, self.heads)
        } else {
            let keys_values = pass.linear(embeddings, self.keys_values);
            match view.imagines {
                true => pass.split_attention(queries, keys_values, view.lists),
                false => pass.attention(queries, keys_values, view.lists, self.heads),
            }
        };
        Attended { embeddings, output }
    }

    /// Whether queries had better absorb their keys. The products of whole matrices that keys and values allow are faster than
    /// the sums over pairs, so pairs count twice.
    fn pays(&self, view: View<'_>) -> bool {
        let width = self.embed.shape.output;
        let (matrix, pair) = (2 * width * width, 2 * self.heads * width);
        let (rows, queries) = (view.rows.len(), view.queries());
        !view.imagines && queries * matrix + 4 * view.lists.pairs() * pair < rows * matrix
    }
}

impl Attended {
    /// The queries' own embeddings.
    pub fn own(&self, pass: &mut Pass<'_>, view: View<'_>) -> Var {
        if view.own.is_empty() {
            pass.rows(self.embeddings, 0..view.queries())
        } else {
            pass.gather(self.embeddings, view.own)
        }
    }
}
