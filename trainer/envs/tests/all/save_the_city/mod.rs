//! SaveTheCity against its rule book, the recorded episodes of the dissertation's code, and its laws.

mod allocation;
mod conformance;
mod features;
mod golden;
mod interference;
mod laws;
mod reference_points;
mod resets;
mod rules;
mod symmetry;

use std::path::PathBuf;

use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    City, Constants, SET_NAMES, SaveTheCity, ScenarioSet, random_actions,
};
use sortie_envs::{EntitySet, Environment, Observation};

/// The folder of recorded episodes.
fn golden_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/save-the-city")
}

/// One instance of a named set with the usual constants.
fn environment(set: &str, seed: u64) -> SaveTheCity {
    let set = ScenarioSet::named(set).unwrap();
    SaveTheCity::new(set, Constants::default(), 1, seed).unwrap()
}

/// All that there is to see.
fn observed(city: &SaveTheCity) -> Observation {
    let (mut state, mut seen) = (Vec::new(), Observation::default());
    city.save(0, &mut state);
    city.observe(&state, 0, EntitySet::MAX, &mut seen);
    seen
}

/// Calls `visit` in every state of episodes of random actions, over all sets.
fn for_random_states(episodes: u64, mut visit: impl FnMut(&SaveTheCity, &str)) {
    for set in SET_NAMES {
        let mut city = environment(set, 1);
        for seed in 0..episodes {
            let label = format!("set {set}, seed {seed}");
            city.reset(0, &mut generator(seed));
            visit(&city, &label);
            play_randomly(&mut city, seed, |city, _| visit(city, &label));
        }
    }
}

/// Plays instance 0 to its end with random actions, calling `after_step` after each.
fn play_randomly(
    city: &mut SaveTheCity,
    seed: u64,
    mut after_step: impl FnMut(&SaveTheCity, &[u16]),
) {
    let mut rng = generator(seed);
    let mut actions = [0; 64];
    while !city.is_done(0) {
        random_actions(city.city(0), &mut rng, &mut actions);
        city.step(0, &actions, &mut rng).unwrap();
        after_step(city, &actions);
    }
}

/// The team's letters.
fn letters(city: City<'_>) -> String {
    city.agents.iter().map(|agent| agent.kind.letter()).collect()
}
