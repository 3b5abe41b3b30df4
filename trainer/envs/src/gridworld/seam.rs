//! The gridworld as an [`Environment`], by its sets.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec;
use alloc::vec::Vec;

use serde::Deserialize;

use super::bytes::State;
use super::episode::Rules;
use super::features::write_row;
use super::flip::{PATHS, draw_map};
use super::map::{MAX_AGENTS, MAX_TREASURES, MAZE, Map};
use super::simulator::Gridworld;
use super::spec::NAME;
use super::tasks::{Task, script};
use super::{ACTION_NAMES, VERSION};
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation, members};
use crate::random::{Random, chance, generator};
use crate::spec::Spec;

/// The names of all sets.
pub const SET_NAMES: [&str; 11] = [
    "task1-2", "task1-3", "task1-4", "task2-2", "task2-3", "task2-4", "task3-2", "task3-3",
    "task3-4", "flip-2", "flip-4",
];

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: NAME,
    about: "Agents look for treasures at the ends of a maze with pits (dissertation chapter 4)",
    version: VERSION,
    sets: || SET_NAMES.map(String::from).to_vec(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: &[],
    reader: None,
    #[cfg(feature = "std")]
    recordings: None,
};

/// What can be set besides task and agents, which the set says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    noise: f64,
    episode_limit: u32,
    map_seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { noise: 0.1, episode_limit: 500, map_seed: 1 }
    }
}

fn open(choice: &Choice<'_>) -> Result<Gridworld, EnvironmentError> {
    let set = choice.set.unwrap_or(SET_NAMES[0]);
    let known = SET_NAMES.contains(&set).then(|| set.split_once('-')).flatten();
    let (task, agents) = known.ok_or_else(|| {
        let names = SET_NAMES.join("`, `");
        EnvironmentError::Set(format!("no set `{set}`; there are `{names}`"))
    })?;
    let agents = agents.parse().unwrap_or(MAX_AGENTS);
    let settings: Settings = choice.settings()?;
    if !(0.0..=1.0).contains(&settings.noise) {
        let reason = "the noise is not a probability from 0 to 1";
        return Err(EnvironmentError::Setting(reason.to_string()));
    }
    if settings.episode_limit == 0 {
        let reason = "an episode limit of 0 steps leaves no episode";
        return Err(EnvironmentError::Setting(reason.to_string()));
    }
    Ok(Gridworld::new(rules(task, agents, &settings), choice.instances))
}

fn rules(task: &str, agents: usize, settings: &Settings) -> Rules {
    let one = |task| (MAZE.to_string(), agents, vec![task]);
    let (map, treasures, tiers) = match task {
        "task1" => one(Task::All),
        "task2" => one(Task::Same),
        "task3" => one(Task::Own),
        _ => flip(agents, settings.map_seed),
    };
    let map = Map::parse(&map, agents, treasures).expect("maps of our own are sound");
    Rules { map, tiers, noise: settings.noise, episode_limit: settings.episode_limit }
}

/// A map of the Flip-Task, its treasures and its tiers, whose tasks take turns.
fn flip(agents: usize, seed: u64) -> (String, usize, Vec<Task>) {
    let mut random = generator(seed);
    let map = draw_map(agents, &mut random);
    let mut tasks = [Task::All, Task::Same];
    if chance(&mut random, 0.5) {
        tasks.reverse();
    }
    (map, MAX_TREASURES, tasks.into_iter().cycle().take(PATHS / agents).collect())
}

impl Gridworld {
    /// What a state that has been checked before says.
    fn known<'a>(&self, state: &'a [u8]) -> State<'a> {
        match State::read(self.rules().counts(), state) {
            Ok(state) => state,
            Err(error) => panic!("a state that `load` refuses: {error}"),
        }
    }
}

impl Environment for Gridworld {
    fn spec(&self) -> &Spec {
        self.own_spec()
    }

    fn instances(&self) -> usize {
        self.count()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(self.with_instances(instances))
    }

    fn reset(&mut self, instance: usize, _: &mut Random) {
        self.start(instance);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.step_by(instance, actions, random)
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.write_state(instance, state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.read_state(instance, state)
    }

    fn place(&mut self, instance: usize, agent: usize, place: [f64; 2]) -> Result<(), StateError> {
        self.put(instance, agent, place.map(|part| part as usize))
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let state = self.known(state);
        let agents = self.rules().agents();
        seen.present = (1 << agents) - 1;
        seen.entities = wanted & seen.present;
        seen.observable.clear();
        seen.observable.extend((0..agents).map(|agent| 1 << agent));
        seen.entity_task.clear();
        seen.entity_task.resize(agents, 0);
        seen.available.clear();
        seen.available.resize(agents, (1 << ACTION_NAMES.len()) - 1);
        seen.open_tasks = 0;
        seen.rows.clear();
        for agent in members(seen.entities) {
            write_row(self.rules(), &state, agent, &mut seen.rows);
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let (rules, episode) = (self.rules(), self.running(instance));
        let found = self.found(instance).iter().map(|own| own.count_ones()).sum::<u32>();
        let (done, solved) = (episode.is_done(rules), episode.is_solved(rules));
        Episode {
            steps: episode.steps,
            done,
            solved,
            timed_out: done && !solved,
            episode_return: episode.episode_return,
            group: rules.agents().to_string(),
            metrics: vec![Some(found.into()), Some(episode.tiers.into())],
            cause: None,
        }
    }

    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        let (rules, state) = (self.rules(), self.known(state));
        let mut found = [0; MAX_AGENTS];
        found[..rules.agents()].copy_from_slice(state.all_found());
        let cells: Vec<u16> = (0..rules.agents()).map(|agent| state.cell(agent)).collect();
        if usize::from(state.tiers()) < rules.tiers.len() {
            script(&rules.map, rules.tier(state.tiers()), &found, &cells, actions);
        }
        true
    }
}
