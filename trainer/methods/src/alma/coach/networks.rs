//! The networks around strategies: the coach that draws them, and the recognition that guesses them. Both begin with a
//! trunk: entities embedded, agents that look at all of them.

use sortie_learn::networks::EntityAttention;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::gaussian::Gaussian;
use crate::alma::agents::{UtilityInput, stacked};

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
    /// Adds a trunk's tensors: features, marks and so many actions are layers of their own that are added up.
    fn trunk(
        self,
        name: &str,
        actions: usize,
        p: &mut Parameters,
        random: &mut Generator,
    ) -> EntityAttention {
        let Self { features, marks, width, heads, .. } = self;
        let mut drawn = |part: &str, rows: usize, inputs: usize| {
            p.tensor(
                &format!("{name}.{part}"),
                &[rows, width],
                1.0 / (inputs as f32).sqrt(),
                random,
            )
        };
        let weight = drawn("features", features, features);
        drawn("marks", marks, marks);
        drawn("actions", actions, actions);
        let bias = Some(drawn("bias", 1, features));
        let shape = LinearShape { input: features + marks + actions, output: width };
        let attention = format!("{name}.attention.in");
        let [queries, keys_values] = stacked(p, &attention, (width, [1, 2]), random);
        let embed = Linear { shape, weight, bias };
        EntityAttention { embed, queries, keys_values, heads, absorbs: true }
    }
}

/// The layers of a coach, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct CoachLayers {
    /// The sizes.
    pub shape: CoachShape,
    /// Over rows of features, then marks.
    trunk: EntityAttention,
    out: Linear,
    /// Means, then logarithms of variances.
    head: Linear,
}

impl CoachLayers {
    /// Adds tensors, drawn uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does.
    pub fn new(shape: CoachShape, p: &mut Parameters, random: &mut Generator) -> Self {
        let CoachShape { width, strategy, .. } = shape;
        Self {
            shape,
            trunk: shape.trunk("coach", 0, p, random),
            out: p.linear("coach.out", width, width, random),
            head: p.linear("coach.head", width, 2 * strategy, random),
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
fn look(t: &mut Pass<'_>, trunk: EntityAttention, out: Linear, input: &UtilityInput) -> Var {
    let attended = trunk.attend(t, input.view());
    t.linear_rectified(attended.output, out)
}

/// The layers of a recognition network, in the order of its parameters.
#[derive(Clone, Copy, Debug)]
pub struct RecognitionLayers {
    /// Over rows of features, marks and actions.
    trunk: EntityAttention,
    out: Linear,
    /// Those of mean and variance, one behind the other: `[2 E, E]`.
    hidden: Linear,
    /// The last layer of each; their weights stand together, then their biases.
    last: [Linear; 2],
}

impl RecognitionLayers {
    /// Adds tensors for players of so many actions, drawn likewise.
    pub fn new(
        shape: CoachShape,
        actions: usize,
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let CoachShape { width, strategy, .. } = shape;
        let trunk = shape.trunk("recognition", actions, p, random);
        let out = p.linear("recognition.out", width, width, random);
        let hidden = p.linear("recognition.hidden", width, 2 * width, random);
        let last = [0, 1]
            .map(|half| p.projection(&format!("recognition.last.{half}"), width, strategy, random));
        let bound = 1.0 / (width as f32).sqrt();
        let last = last.map(|layer| {
            let bias = Some(p.tensor("recognition.last.bias", &[strategy], bound, random));
            Linear { bias, ..layer }
        });
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
