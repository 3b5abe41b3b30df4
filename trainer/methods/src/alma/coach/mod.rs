//! COPA (coach-player): flat players and a coach that sees everything and tells each of them a strategy.
//!
//! The baseline of dissertation section 7.5, after its public code. At decision points the coach draws a
//! vector for every agent, its strategy, which is added before the head of the agent's utility network
//! until the next decision; before the first it is zero. Where a team is measured the mean is told.

pub(crate) mod gaussian;
mod networks;

use sortie_envs::{Observation, members};
use sortie_learn::LearnError;
use sortie_nn::random::{Generator, normals};
use sortie_nn::tape::{Pass, Tape};

use super::agents::{TaskOrder, UtilityInput};

pub use gaussian::Gaussian;
pub use networks::{CoachLayers, CoachShape, RecognitionLayers};

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

/// The strategy of an agent among those `[agents, R]` of its state, if they have been told any.
pub(crate) fn strategy_of(strategies: &[f32], agent: usize, width: usize) -> Option<&[f32]> {
    strategies.get(agent * width..(agent + 1) * width)
}

/// Writes a state that is played in, of which everything is seen, for its coach.
pub fn seen_input(
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
