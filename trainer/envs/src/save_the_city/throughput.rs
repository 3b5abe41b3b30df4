//! The loop that throughput is measured on.

use rand_xoshiro::Xoshiro256PlusPlus;

use super::scripted::random_actions;
use super::simulator::SaveTheCity;
use super::state::MAX_AGENTS;
use crate::environment::{Environment, ObservationBuffers};

/// Observes and steps every instance `rounds` times with random actions; returns the team return of
/// all episodes that ended.
///
/// Instances that are done start anew. The caller takes the time: `rounds` times the number of
/// instances is the number of steps.
pub fn observe_and_step(
    environment: &mut SaveTheCity,
    buffers: &mut ObservationBuffers,
    rng: &mut Xoshiro256PlusPlus,
    rounds: usize,
) -> f64 {
    let mut actions = [0; MAX_AGENTS];
    let mut returns = 0.0;
    for _ in 0..rounds {
        for instance in 0..environment.instances() {
            environment.observe(instance, &mut buffers.lend());
            random_actions(environment.city(instance), rng, &mut actions);
            let outcome = environment
                .step(instance, &actions)
                .expect("the actions were drawn from the available ones");
            if outcome.done() {
                returns += environment.metrics(instance).episode_return;
                environment.reset(instance);
            }
        }
    }
    returns
}
