//! COPA (coach-player): flat players and a coach that sees everything and tells each of them a strategy.
//!
//! The baseline of dissertation section 7.5, after its public code. At decision points the coach draws a
//! vector for every agent, its strategy, which is added before the head of the agent's utility network
//! until the next decision; before the first it is zero. Where a team is measured the mean is told.
//!
//! Of the networks around strategies, the coach that draws them and the recognition that guesses them, both begin with a
//! trunk: entities embedded, agents that look at all of them.

use std::f32::consts::PI;

use sortie_envs::{Observation, members};
use sortie_learn::LearnError;
use sortie_learn::networks::EntityAttention;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::random::{Generator, normals};
use sortie_nn::tape::{Linear, Parameters, Pass, Tape, Var};

use super::agents::{TaskOrder, UtilityInput, stacked};

/// A coach: its layers, and the parameters among which its own are.
#[derive(Clone, Copy, Debug)]
pub struct Coach<'a> {
    /// The layers.
    pub layers: CoachLayers,
    /// All parameters.
    pub parameters: &'a [f32],
}

/// Tells the agents of a state their strategies.
#[derive(Debug)]
pub struct Advice<'a> {
    coach: Coach<'a>,
    tape: Tape,
    input: UtilityInput,
}

impl<'a> Advice<'a> {
    /// By a coach.
    pub fn new(coach: Coach<'a>) -> Self {
        Self { coach, tape: Tape::default(), input: UtilityInput::default() }
    }

    /// Writes the mean strategies `[agents, R]`, subtasks having the marks of their numbers: how a team is
    /// measured.
    ///
    /// # Errors
    /// The state has more subtasks than the coach knows.
    pub fn mean(
        &mut self,
        seen: &Observation,
        strategies: &mut Vec<f32>,
    ) -> Result<(), LearnError> {
        let (shape, tasks) = (self.coach.layers.shape, seen.tasks());
        if tasks > shape.marks {
            let known = shape.marks;
            let reason = format!("the coach knows {known} subtasks, this state has {tasks}");
            return Err(LearnError::Config(reason));
        }
        let (t, told) = self.told(seen, &TaskOrder::identity(tasks));
        strategies.clear();
        strategies.extend_from_slice(t.values(told.means));
        Ok(())
    }

    /// Writes drawn strategies `[agents, R]`, subtasks having any marks: how a coach learns. The state has
    /// as many subtasks at most as the coach knows.
    pub fn draw(
        &mut self,
        seen: &Observation,
        generator: &mut Generator,
        strategies: &mut Vec<f32>,
    ) {
        let CoachShape { marks, strategy, .. } = self.coach.layers.shape;
        let (mut t, told) = self.told(seen, &TaskOrder::shuffled(marks, generator));
        let drawn = told.draw(&mut t, &normals(generator, seen.agents() * strategy));
        strategies.clear();
        strategies.extend_from_slice(t.values(drawn));
    }

    /// What the strategies of a state are drawn from.
    fn told(&mut self, seen: &Observation, order: &TaskOrder) -> (Pass<'_>, Gaussian) {
        let Self { coach: Coach { layers, parameters }, tape, input } = self;
        seen_input(layers.shape, seen, order, input);
        let mut t = tape.begin(parameters);
        let told = layers.strategies(&mut t, input);
        (t, told)
    }
}

/// Writes a state that is played in, of which everything is seen, for its coach.
pub(crate) fn seen_input(
    shape: CoachShape,
    seen: &Observation,
    order: &TaskOrder,
    input: &mut UtilityInput,
) {
    input.clear();
    for entity in members(seen.present) {
        input.rows.push_row(&seen.rows, seen.row_of(entity));
        if let Some(mark) = order.0.get(usize::from(seen.task_of(entity))) {
            input.rows.push(shape.features + usize::from(*mark), 1.0);
        }
        input.rows.end_row();
    }
    for _ in 0..seen.agents() {
        (0..input.rows.len()).for_each(|row| input.visible.push(row));
        input.visible.end_list();
    }
}

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

/// Bounds of the logarithm of a variance.
const LOG_VARIANCE: (f32, f32) = (-10.0, 0.0);
/// Bounds of the logarithm of a density.
const LOG_DENSITY: (f32, f32) = (-1000.0, 0.0);
/// Bounds of the entropy of a number.
const ENTROPY: (f32, f32) = (0.0, 10.0);

/// Distributions of so many rows of numbers.
#[derive(Clone, Copy, Debug)]
pub struct Gaussian {
    /// `[rows, R]`
    pub means: Var,
    /// Logarithms of variances `[rows, R]`.
    pub log_variances: Var,
}

impl Gaussian {
    /// Means, and logarithms of variances that are kept within their bounds.
    fn bounded(t: &mut Pass<'_>, [means, log_variances]: [Var; 2]) -> Self {
        let (least, most) = LOG_VARIANCE;
        Self { means, log_variances: t.clamp(log_variances, least, most) }
    }

    /// Numbers `[rows, R]` drawn with as many standard normal ones.
    pub fn draw(self, t: &mut Pass<'_>, noise: &[f32]) -> Var {
        let width = t.size(self.means)[1];
        let halves = t.scale(self.log_variances, 0.5);
        let (deviations, noise) = (t.exp(halves), t.input(width, noise));
        let distances = t.multiply(noise, deviations);
        t.add(self.means, distances)
    }

    /// Logarithms of the densities of numbers, within their bounds.
    pub(crate) fn log_density(self, t: &mut Pass<'_>, numbers: Var) -> Var {
        let negative = t.scale(self.means, -1.0);
        let distances = t.add(numbers, negative);
        let squares = t.multiply(distances, distances);
        let negative = t.scale(self.log_variances, -1.0);
        let precisions = t.exp(negative);
        let scaled = t.multiply(squares, precisions);
        let sum = t.add(scaled, self.log_variances);
        let sum = t.offset(sum, (2.0 * PI).ln());
        let logarithms = t.scale(sum, -0.5);
        t.clamp(logarithms, LOG_DENSITY.0, LOG_DENSITY.1)
    }
}

/// The entropies of numbers whose logarithms of variances these are, within their bounds.
pub(crate) fn entropies(t: &mut Pass<'_>, log_variances: Var) -> Var {
    let sum = t.offset(log_variances, 1.0 + (2.0 * PI).ln());
    let entropies = t.scale(sum, 0.5);
    t.clamp(entropies, ENTROPY.0, ENTROPY.1)
}
