//! Group Matching against its rule book, the recorded episodes of the dissertation's code, and its laws.

mod conformance;
mod golden;
mod laws;
mod observations;
mod parameters;
mod reference_points;
mod states;

use sortie_envs::Environment;
use sortie_envs::group_matching::{ACTIONS, GroupMatching, Parameters};
use sortie_envs::random::{below, generator};

/// One ring of a named set.
fn ring(set: &str) -> GroupMatching {
    GroupMatching::new(Parameters::named(set).unwrap(), 1).unwrap()
}

/// Calls `visit` in every state of episodes of random actions, over rings of all kinds.
fn for_random_states(episodes: u64, mut visit: impl FnMut(&GroupMatching, &str)) {
    for set in ["8x6x2", "8x6x2-fixed", "1x1x1", "2x3x5", "12x10x4", "64x256x20"] {
        let mut world = ring(set);
        let agents = world.parameters().agents;
        for seed in 0..episodes {
            let (label, mut random) = (format!("set {set}, seed {seed}"), generator(seed));
            world.reset(0, &mut random);
            visit(&world, &label);
            while !world.is_done(0) {
                let actions: Vec<u16> =
                    (0..agents).map(|_| below(&mut random, ACTIONS) as u16).collect();
                world.step(0, &actions, &mut random).unwrap();
                visit(&world, &label);
            }
        }
    }
}
