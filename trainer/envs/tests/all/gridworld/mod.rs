//! The gridworld against recorded episodes and maps of the dissertation's code, and its laws.

mod conformance;
mod golden;
mod maps;
mod pictures;
mod recorded;
mod rules;
mod states;

use std::path::PathBuf;

use sortie_envs::gridworld::{Chance, Gridworld, Map, Rules, Task};
use sortie_envs::registry::Setting;
use sortie_envs::{Environment, Split, open};

/// One instance of a set with these settings.
fn opened(set: &str, settings: &[(&str, Setting)]) -> Box<dyn Environment> {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone()));
    open(&format!("gridworld/{set}"), Split::Train, 1, &settings.collect()).unwrap()
}

/// The state of the instance.
fn saved(environment: &dyn Environment) -> Vec<u8> {
    let mut state = Vec::new();
    environment.save(0, &mut state);
    state
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/gridworld")
}

/// Nothing happens by chance but what is said here.
#[derive(Default)]
struct Certain {
    /// Pits that open in every step.
    open: Vec<usize>,
    first_goes_back: bool,
}

impl Chance for Certain {
    fn taken(&mut self, _: usize, action: u8) -> u8 {
        action
    }

    fn tick(&mut self, pit: usize, _: u32, _: f64, magnitude: f64) -> Option<f64> {
        (!self.open.contains(&pit)).then_some(magnitude)
    }

    fn first_goes_back(&mut self) -> bool {
        self.first_goes_back
    }
}

/// A room of 18 by 18 cells with these things in it, each at a row and a column.
fn room(things: &[(usize, usize, char)], tiers: &[Task], agents: usize) -> Gridworld {
    let mut rows = vec!["####################".to_owned()];
    rows.extend((0..18).map(|_| "#                  #".to_owned()));
    rows.push(rows[0].clone());
    for (row, column, thing) in things {
        rows[*row].replace_range(column..&(column + 1), &thing.to_string());
    }
    let treasures = things.iter().filter(|(_, _, thing)| ('A'..='H').contains(thing)).count();
    let map = Map::parse(&rows.join("\n"), agents, treasures).unwrap();
    let rules = Rules { map, tiers: tiers.to_vec(), noise: 0.0, episode_limit: 500 };
    let mut world = Gridworld::new(rules, 1);
    world.start(0);
    world
}

/// Row and column of each agent.
fn places(world: &Gridworld) -> Vec<(u16, u16)> {
    world.cells(0).iter().map(|cell| (cell / 20, cell % 20)).collect()
}
