//! The networks around strategies: the coach that draws them, and the recognition that guesses them.

use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::{Generator, signed_unit};

use super::trunk::TrunkShape;

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

impl Coach {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: CoachShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        draw_trunk(shape, 0, &mut parameters, generator);
        draw(&mut parameters, shape.parameters(), shape.width, generator);
        Self { shape, parameters }
    }

    /// A coach with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(shape: CoachShape, parameters: Vec<f32>) -> Option<Self> {
        (parameters.len() == shape.parameters()).then_some(Self { shape, parameters })
    }

    /// The sizes.
    pub fn shape(&self) -> CoachShape {
        self.shape
    }

    /// All parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
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

impl Recognition {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: RecognitionShape, generator: &mut Generator) -> Self {
        let mut parameters = Vec::with_capacity(shape.parameters());
        draw_trunk(shape.coach, shape.actions, &mut parameters, generator);
        draw(&mut parameters, shape.parameters(), shape.coach.width, generator);
        Self { shape, parameters }
    }

    /// A network with these parameters, or `None` where their number does not fit the shape.
    pub fn from_parameters(shape: RecognitionShape, parameters: Vec<f32>) -> Option<Self> {
        (parameters.len() == shape.parameters()).then_some(Self { shape, parameters })
    }

    /// The sizes.
    pub fn shape(&self) -> RecognitionShape {
        self.shape
    }

    /// All parameters.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// All parameters, to be changed.
    pub fn parameters_mut(&mut self) -> &mut [f32] {
        &mut self.parameters
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
