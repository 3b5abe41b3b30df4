//! The networks around strategies: the coach that draws them, and the recognition that guesses them. Both begin with a
//! trunk: entities embedded, agents that look at all of them.

use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Pass, Places, Var};

use super::gaussian::Gaussian;
use crate::alma::agents::{TrunkLayers, UtilityInput, drawn};

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
    fn attention(self) -> AttentionShape {
        AttentionShape { width: self.width, heads: self.heads }
    }

    /// Number of parameters.
    pub fn parameters(self) -> usize {
        let places = &mut Places::default();
        CoachLayers::of(self, places);
        places.end
    }
}

/// The layers of a coach, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct CoachLayers {
    /// Over rows of features, then marks.
    trunk: TrunkLayers,
    out: Linear,
    /// Means, then logarithms of variances.
    head: Linear,
}

impl CoachLayers {
    /// Those of a coach of this shape.
    pub fn of(shape: CoachShape, places: &mut Places) -> Self {
        let CoachShape { features, marks, width, strategy, .. } = shape;
        Self {
            trunk: TrunkLayers::of(features + marks, shape.attention(), places),
            out: places.linear(width, width),
            head: places.linear(width, 2 * strategy),
        }
    }

    /// What the strategies of all agents are drawn from.
    pub fn strategies(self, t: &mut Pass<'_>, input: &UtilityInput) -> Gaussian {
        let looked = look(t, self.trunk, self.out, input);
        let rows = t.linear(looked, self.head);
        let strategy = self.head.shape.output / 2;
        let halves = [0..strategy, strategy..2 * strategy].map(|half| t.columns(rows, half));
        Gaussian::bounded(t, halves)
    }
}

/// What each agent makes of all it looks at, `[agents, E]`.
fn look(t: &mut Pass<'_>, trunk: TrunkLayers, out: Linear, input: &UtilityInput) -> Var {
    let [attended, _] = trunk.attend(t, input);
    t.linear_rectified(attended, out)
}

/// The coach: its sizes and all parameters, in the order of its layers.
#[derive(Clone, Debug, PartialEq)]
pub struct Coach {
    shape: CoachShape,
    parameters: Vec<f32>,
}

flat_network!(Coach, CoachShape);

impl Coach {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: CoachShape, generator: &mut Generator) -> Self {
        let parameters = drawn(tensors(shape, 0, shape.parameters()), generator);
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
    /// Number of parameters.
    pub fn parameters(self) -> usize {
        let places = &mut Places::default();
        RecognitionLayers::of(self, places);
        places.end
    }
}

/// The layers of a recognition network, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct RecognitionLayers {
    /// Over rows of features, marks and actions.
    trunk: TrunkLayers,
    out: Linear,
    /// Those of mean and variance, one behind the other: `[2 E, E]`.
    hidden: Linear,
    /// The last layer of each; their weights stand together, then their biases.
    last: [Linear; 2],
}

impl RecognitionLayers {
    /// Those of a network of this shape.
    pub fn of(shape: RecognitionShape, places: &mut Places) -> Self {
        let CoachShape { features, marks, width, strategy, .. } = shape.coach;
        let attention = shape.coach.attention();
        let trunk = TrunkLayers::of(features + marks + shape.actions, attention, places);
        let (out, hidden) = (places.linear(width, width), places.linear(width, 2 * width));
        let last = [0, 1].map(|_| places.projection(width, strategy));
        let last = last.map(|layer| Linear { bias: Some(places.numbers(strategy)), ..layer });
        Self { trunk, out, hidden, last }
    }

    /// What the strategies of all agents seem to be.
    pub fn guess(self, t: &mut Pass<'_>, input: &UtilityInput) -> Gaussian {
        let looked = look(t, self.trunk, self.out, input);
        let hidden = t.linear_rectified(looked, self.hidden);
        let width = self.hidden.shape.input;
        let halves = [0, 1].map(|half| {
            let own = t.columns(hidden, half * width..(half + 1) * width);
            t.linear(own, self.last[half])
        });
        Gaussian::bounded(t, halves)
    }
}

/// The recognition network: its sizes and all parameters, in the order of its layers.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognition {
    shape: RecognitionShape,
    parameters: Vec<f32>,
}

flat_network!(Recognition, RecognitionShape);

impl Recognition {
    /// Draws weights and biases uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn initialise(shape: RecognitionShape, generator: &mut Generator) -> Self {
        let tensors = tensors(shape.coach, shape.actions, shape.parameters());
        Self { shape, parameters: drawn(tensors, generator) }
    }
}

/// Numbers and inputs of all tensors of a network of so many parameters: features, marks and actions are layers of their
/// own that are added up; all others are over the width.
fn tensors(shape: CoachShape, actions: usize, parameters: usize) -> [(usize, usize); 5] {
    let CoachShape { features, marks, width, .. } = shape;
    let [entities, marked, acting] = [features, marks, actions].map(|inputs| inputs * width);
    let rest = parameters - entities - marked - acting - width;
    [(entities, features), (marked, marks), (acting, actions), (width, features), (rest, width)]
}
