//! A coach where its players play.

use sortie_envs::Observation;
use sortie_nn::random::{Generator, normals};

use super::gaussian;
use super::input::seen_input;
use super::networks::Coach;
use super::passes::CoachPass;
use crate::alma::agents::{TaskOrder, UtilityInput};
use sortie_learn::LearnError;

/// Tells the agents of a state their strategies.
#[derive(Debug)]
pub struct Advice<'a> {
    coach: &'a Coach,
    pass: CoachPass,
    input: UtilityInput,
}

impl<'a> Advice<'a> {
    /// By a coach.
    pub fn new(coach: &'a Coach) -> Self {
        Self { coach, pass: CoachPass::default(), input: UtilityInput::default() }
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
        let Self { coach, pass, input } = self;
        let (shape, tasks) = (coach.shape(), seen.tasks());
        if tasks > shape.marks {
            let known = shape.marks;
            let reason = format!("the coach knows {known} subtasks, this state has {tasks}");
            return Err(LearnError::Config(reason));
        }
        seen_input(shape, seen, &TaskOrder::identity(tasks), input);
        let rows = pass.forward(coach, input).chunks_exact(2 * shape.strategy);
        strategies.clear();
        rows.for_each(|row| strategies.extend_from_slice(&row[..shape.strategy]));
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
        let Self { coach, pass, input } = self;
        let shape = coach.shape();
        let order = TaskOrder::shuffled(shape.marks, generator);
        seen_input(shape, seen, &order, input);
        let rows = pass.forward(coach, input).chunks_exact(2 * shape.strategy);
        let noise = normals(generator, seen.agents() * shape.strategy);
        strategies.clear();
        for (row, noise) in rows.zip(noise.chunks_exact(shape.strategy)) {
            strategies.extend(gaussian::drawn(row, noise));
        }
    }
}

/// The strategy of an agent among those `[agents, R]` of its state, if they have been told any.
pub(crate) fn strategy_of(strategies: &[f32], agent: usize, width: usize) -> Option<&[f32]> {
    strategies.get(agent * width..(agent + 1) * width)
}
