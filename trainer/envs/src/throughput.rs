//! The loop that throughput is measured on.

use alloc::vec::Vec;

use crate::environment::Environment;
use crate::observation::{EntitySet, Observation};
use crate::random::{Random, member};

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
            actions.extend(available.map(|set| member(random, (*set).into()).unwrap_or(0) as u16));
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
