//! The loop that throughput is measured on.

use rand_xoshiro::Xoshiro256PlusPlus;

use super::features::write_row;
use super::parameters::MAX_AGENTS;
use super::rules::ACTIONS;
use super::simulator::GroupMatching;
use crate::random::below;

/// Observes and steps every instance `rounds` times with random actions; returns the team return of
/// all episodes that ended. `rows` has a feature row for every agent.
///
/// Instances that are done start anew. The caller takes the time: `rounds` times the number of
/// instances is the number of steps.
pub fn observe_and_step(
    environment: &mut GroupMatching,
    rows: &mut [f32],
    random: &mut Xoshiro256PlusPlus,
    rounds: usize,
) -> f64 {
    let parameters = *environment.parameters();
    let mut actions = [0; MAX_AGENTS];
    let mut returns = 0.0;
    for _ in 0..rounds {
        for instance in 0..environment.instances() {
            let ring = environment.ring(instance);
            for (agent, row) in rows.chunks_exact_mut(parameters.features()).enumerate() {
                write_row(&parameters, ring, agent, row);
            }
            let own = &mut actions[..parameters.agents];
            own.iter_mut().for_each(|action| *action = below(random, ACTIONS) as u16);
            let outcome =
                environment.step(instance, own, random).expect("all actions are available");
            if outcome.done() {
                returns += environment.metrics(instance).episode_return;
                environment.reset(instance, random);
            }
        }
    }
    returns
}
