//! The loops that throughput is measured on.

use alloc::vec::Vec;

use crate::environment::{Environment, StepError};
use crate::observation::{EntitySet, Observation};
use crate::random::{Random, below, member};

/// Observes and steps every instance `rounds` times with random actions; returns the team return of
/// all episodes that ended.
///
/// Instances that are done start anew. The caller takes the time: `rounds` times the number of
/// instances is the number of steps.
pub fn observe_and_step(
    environment: &mut dyn Environment,
    random: &mut Random,
    rounds: usize,
) -> f64 {
    let mut seen = Observation::new(&environment.spec().shape);
    let (mut state, mut actions) = (Vec::new(), Vec::new());
    let mut returns = 0.0;
    for _ in 0..rounds {
        for instance in 0..environment.instances() {
            state.clear();
            environment.save(instance, &mut state);
            environment.observe(&state, 0, EntitySet::MAX, &mut seen);
            actions.clear();
            let available = seen.available.iter();
            actions.extend(available.map(|set| member(random, *set).unwrap_or(0) as u16));
            let step = environment
                .step(instance, &actions, random)
                .expect("the actions were drawn from the available ones");
            if step.done() {
                returns += environment.episode(instance).episode_return;
                environment.reset(instance, random);
            }
        }
    }
    returns
}

/// Steps every instance `rounds` times with random actions, as [`observe_and_step`] does but without looking.
///
/// # Errors
/// An action was not available: which are is what observations say.
pub fn step_alone(
    environment: &mut dyn Environment,
    random: &mut Random,
    rounds: usize,
) -> Result<f64, StepError> {
    let spec = environment.spec();
    let agents = 0..spec.shape.agents;
    let possible: Vec<usize> = agents.map(|agent| spec.actions_of(agent).len()).collect();
    let (mut actions, mut returns) = (Vec::new(), 0.0);
    for _ in 0..rounds {
        for instance in 0..environment.instances() {
            actions.clear();
            actions.extend(possible.iter().map(|count| below(random, *count) as u16));
            if environment.step(instance, &actions, random)?.done() {
                returns += environment.episode(instance).episode_return;
                environment.reset(instance, random);
            }
        }
    }
    Ok(returns)
}
