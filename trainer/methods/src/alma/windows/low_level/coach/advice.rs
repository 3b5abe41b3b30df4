//! A coach where its players play.

use sortie_envs::save_the_city::City;
use sortie_nn::random::{Generator, normals};

use super::super::agents::TaskOrder;
use super::gaussian;
use super::input::city_input;
use super::networks::Coach;
use super::passes::CoachPass;
use crate::alma::records::UtilityInput;
use sortie_learn::LearnError;

/// Tells the agents of a city their strategies.
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
    /// The city has more subtasks than the coach knows.
    pub fn mean(&mut self, city: City<'_>, strategies: &mut Vec<f32>) -> Result<(), LearnError> {
        let Self { coach, pass, input } = self;
        let (shape, tasks) = (coach.shape(), city.buildings.len());
        if tasks > shape.marks {
            let known = shape.marks;
            let reason = format!("the coach knows {known} subtasks, this city has {tasks}");
            return Err(LearnError::Config(reason));
        }
        city_input(shape, city, &TaskOrder::identity(tasks), input);
        let rows = pass.forward(coach, input).chunks_exact(2 * shape.strategy);
        strategies.clear();
        rows.for_each(|row| strategies.extend_from_slice(&row[..shape.strategy]));
        Ok(())
    }

    /// Writes drawn strategies `[agents, R]`, subtasks having any marks: how a coach learns. The city has
    /// as many subtasks at most as the coach knows.
    pub fn draw(&mut self, city: City<'_>, generator: &mut Generator, strategies: &mut Vec<f32>) {
        let Self { coach, pass, input } = self;
        let shape = coach.shape();
        let order = TaskOrder::shuffled(shape.marks, generator);
        city_input(shape, city, &order, input);
        let rows = pass.forward(coach, input).chunks_exact(2 * shape.strategy);
        let noise = normals(generator, city.agents.len() * shape.strategy);
        strategies.clear();
        for (row, noise) in rows.zip(noise.chunks_exact(shape.strategy)) {
            strategies.extend(gaussian::drawn(row, noise));
        }
    }
}

/// The strategy of an agent among those `[agents, R]` of its city, if they have been told any.
pub(crate) fn strategy_of(strategies: &[f32], agent: usize, width: usize) -> Option<&[f32]> {
    strategies.get(agent * width..(agent + 1) * width)
}
