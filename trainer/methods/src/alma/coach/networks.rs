//! The networks around strategies: the coach that draws them, and the recognition that guesses them. Both begin with a
//! trunk: entities embedded, agents that look at all of them.

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::{self, LinearShape};
use sortie_nn::layers::matrix::Store;
use sortie_nn::layers::relu;
use sortie_nn::random::{Generator, signed_unit};

use crate::alma::agents::{AttentionGradients, AttentionWeights, EntityAttention, UtilityInput};
use crate::sized;

/// Sizes of a coach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoachShape {
    /// Features d of an entity; last actions are none of them.
    pub features: usize,
    /// Columns that mark an entity's subtask.
    pub marks: usize,
    /// Width E of embedding and attention.
    pub width: usize,
    /// Attention heads, a divisor of the width.
    pub heads: usize,
    /// Numbers R of a strategy.
    pub strategy: usize,
}

impl CoachShape {
    pub(super) fn trunk(self) -> TrunkShape {
        let Self { features, marks, width, heads, .. } = self;
        TrunkShape { input: features + marks, width, heads }
    }

    /// The layer `[2 R, E]` that gives means and logarithms of variances.
    pub(super) fn head(self) -> LinearShape {
        LinearShape { input: self.width, output: 2 * self.strategy }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        let LinearShape { input, output } = self.head();
        self.trunk().parameters() + output * input + output
    }
}

/// The coach. Its parameters: `fc1.weight [d + marks, E]`, then matrices `[out, in]` with their biases:
/// query, key and value, attention's output, mean and logarithm of the variance.
#[derive(Clone, Debug, PartialEq)]
pub struct Coach {
    shape: CoachShape,
    parameters: Vec<f32>,
}

flat_network!(Coach, CoachShape);

impl Coach {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: CoachShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        draw_trunk(shape, 0, &mut parameters, generator);
        draw(&mut parameters, shape.parameters(), shape.width, generator);
        Self { shape, parameters }
    }
}

/// Sizes of a recognition network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecognitionShape {
    /// Those that it shares with the coach.
    pub coach: CoachShape,
    /// Actions U.
    pub actions: usize,
}

impl RecognitionShape {
    pub(super) fn trunk(self) -> TrunkShape {
        let trunk = self.coach.trunk();
        TrunkShape { input: trunk.input + self.actions, ..trunk }
    }

    /// The hidden layers of mean and variance, one behind the other: `[2 E, E]`.
    pub(super) fn hidden(self) -> LinearShape {
        LinearShape { input: self.coach.width, output: 2 * self.coach.width }
    }

    /// The last layer of each: `[R, E]`.
    pub(super) fn last(self) -> LinearShape {
        LinearShape { input: self.coach.width, output: self.coach.strategy }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        let layer = |LinearShape { input, output }| output * input + output;
        self.trunk().parameters() + layer(self.hidden()) + 2 * layer(self.last())
    }
}

/// The recognition network. Its parameters: those of the trunk as a [`Coach`] has them, with a row of
/// `fc1` for every action behind the marks, then the hidden layers of mean and variance, and the last
/// matrices of both, then their biases.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognition {
    shape: RecognitionShape,
    parameters: Vec<f32>,
}

flat_network!(Recognition, RecognitionShape);

impl Recognition {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: RecognitionShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        draw_trunk(shape.coach, shape.actions, &mut parameters, generator);
        draw(&mut parameters, shape.parameters(), shape.coach.width, generator);
        Self { shape, parameters }
    }
}

/// Draws a trunk: features, marks and actions are layers of their own that are added up.
fn draw_trunk(
    shape: CoachShape,
    actions: usize,
    parameters: &mut Vec<f32>,
    generator: &mut Generator,
) {
    let CoachShape { features, marks, width, .. } = shape;
    let mut end = 0;
    for (rows, inputs) in [
        (features, features),
        (marks, marks),
        (actions, actions),
        (1, features),
        (4 * width, width),
        (1, width),
    ] {
        end += rows * width;
        draw(parameters, end, inputs, generator);
    }
}

/// Draws parameters of a layer with so many inputs, up to a length of the vector.
fn draw(parameters: &mut Vec<f32>, end: usize, inputs: usize, generator: &mut Generator) {
    let bound = 1.0 / (inputs as f32).sqrt();
    let count = end - parameters.len();
    parameters.extend((0..count).map(|_| bound * signed_unit(generator)));
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TrunkShape {
    /// Input columns of one entity.
    pub(super) input: usize,
    /// Width E of embedding and attention.
    pub(super) width: usize,
    /// Attention heads, a divisor of the width.
    pub(super) heads: usize,
}

impl TrunkShape {
    /// Lengths of `fc1.weight [input, E]`, `fc1.bias`, queries, keys and values, `out.weight`, `out.bias`.
    fn lengths(self) -> [usize; 6] {
        let Self { input, width, .. } = self;
        let square = width * width;
        [input * width, width, square, 2 * square, square, width]
    }

    pub(super) fn parameters(self) -> usize {
        self.lengths().iter().sum()
    }

    fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    fn square(self) -> LinearShape {
        LinearShape { input: self.width, output: self.width }
    }

    fn view(self, parameters: &[f32]) -> (AttentionWeights<'_>, &[f32], &[f32]) {
        let mut rest = parameters;
        let [fc1, fc1_bias, queries, keys_values, out, out_bias] =
            self.lengths().map(|length| rest.split_off(..length).expect("all tensors"));
        (AttentionWeights { fc1, fc1_bias, queries, keys_values }, out, out_bias)
    }

    fn view_mut(self, vector: &mut [f32]) -> (AttentionGradients<'_>, &mut [f32], &mut [f32]) {
        let mut rest = vector;
        let [fc1, fc1_bias, queries, keys_values, out, out_bias] =
            self.lengths().map(|length| rest.split_off_mut(..length).expect("all tensors"));
        (AttentionGradients { fc1, fc1_bias, queries, keys_values }, out, out_bias)
    }
}

/// Buffers of one worker: the activations of the last forward pass and space for a backward pass.
#[derive(Clone, Debug, Default)]
pub(super) struct TrunkPass {
    attention: EntityAttention,
    looked: Vec<f32>,
    d_attended: Vec<f32>,
}

impl TrunkPass {
    /// Computes what each agent makes of all it looks at, `[queries, E]`, rectified.
    pub(super) fn forward(
        &mut self,
        shape: TrunkShape,
        parameters: &[f32],
        input: &UtilityInput,
    ) -> &[f32] {
        let (weights, out, out_bias) = shape.view(parameters);
        let attended = self.attention.forward(shape.attention(), weights, input);
        let looked = sized(&mut self.looked, attended.len());
        linear::forward_rectified(shape.square(), attended, out, out_bias, looked);
        looked
    }

    /// What the last forward pass computed for so many agents.
    pub(super) fn looked(&self, shape: TrunkShape, queries: usize) -> &[f32] {
        &self.looked[..queries * shape.width]
    }

    /// Adds the gradients of a loss whose slope by what the last forward pass computed is `d_looked`,
    /// which is rectified in place.
    pub(super) fn backward(
        &mut self,
        shape: TrunkShape,
        parameters: &[f32],
        input: &UtilityInput,
        d_looked: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (weights, out, _) = shape.view(parameters);
        let (gradients, d_out, d_out_bias) = shape.view_mut(gradient);
        relu::backward(&self.looked[..d_looked.len()], d_looked);
        let attended = self.attention.attended(d_looked.len());
        linear::backward_weight(shape.square(), attended, d_looked, d_out);
        linear::backward_bias(d_looked, d_out_bias);
        let d_attended = sized(&mut self.d_attended, d_looked.len());
        linear::backward_input(shape.square(), d_looked, out, Store::Replace, d_attended);
        self.attention.backward(shape.attention(), weights, input, d_attended, None, gradients);
    }
}
