//! The gridworld as an [`Environment`], by its sets: many episodes on one map at once.

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::sync::Arc;
use alloc::vec::Vec;
use alloc::{format, vec};

use serde::Deserialize;

use super::bytes::State;
use super::map::{MAX_AGENTS, MAX_TREASURES, MAZE, Map, PATHS, SIDE, draw_map};
use super::observation::{NAME, picture, spec, write_row};
use super::rules::{Chance, Drawn, Episode, Normals, Pit, Rules, Task, script};
use super::{ACTION_NAMES, VERSION};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Split, StateError, Step, StepError, checked_actions};
use crate::observation::{EntitySet, Observation, members};
use crate::picture::Picture;
use crate::random::{Random, chance, generator};
use crate::spec::Spec;

/// The gridworld, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Gridworld {
    rules: Arc<Rules>,
    normals: Normals,
    spec: Spec,
    episodes: Vec<Episode>,
}

impl Gridworld {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(rules: Rules, instances: usize) -> Self {
        let spec = spec(&rules);
        Self { rules: Arc::new(rules), normals: Normals::new(), spec, episodes: Vec::new() }
            .with_instances(instances)
    }

    fn with_instances(&self, instances: usize) -> Self {
        let mut episode = Episode {
            cells: [0; MAX_AGENTS],
            found: [0; MAX_AGENTS],
            tiers: 0,
            steps: 0,
            episode_return: 0.0,
            pits: vec![Pit::default(); self.rules.map.pits().len()],
        };
        episode.start(&self.rules);
        episode.steps = self.rules.episode_limit;
        Self { episodes: vec![episode; instances], ..self.clone() }
    }

    /// What all episodes have in common.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// Where the agents are.
    pub fn cells(&self, instance: usize) -> &[u16] {
        &self.episodes[instance].cells[..self.rules.agents()]
    }

    /// What each agent found: kinds of treasures as bits.
    pub fn found(&self, instance: usize) -> &[u8] {
        &self.episodes[instance].found[..self.rules.agents()]
    }

    /// Tiers that are finished.
    pub fn tiers(&self, instance: usize) -> u8 {
        self.episodes[instance].tiers
    }

    /// The pits in their order, each as it was when somebody last looked.
    pub fn pits(&self, instance: usize) -> &[Pit] {
        &self.episodes[instance].pits
    }

    /// Starts an episode.
    pub fn start(&mut self, instance: usize) {
        self.episodes[instance].start(&self.rules);
    }

    /// Plays one step of any chance, as for replays.
    ///
    /// # Errors
    /// As [`Environment::step`](crate::Environment::step).
    #[inline]
    pub fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        chance: &mut impl Chance,
    ) -> Result<Step, StepError> {
        let Self { rules, episodes, .. } = self;
        let episode = &mut episodes[instance];
        let (is_done, known) = (episode.is_done(rules), ACTION_NAMES.len());
        let actions = checked_actions(is_done, rules.agents(), known, actions)?;
        let reward = episode.play(rules, actions, chance);
        let terminated = episode.is_solved(rules);
        let timed_out = !terminated && episode.steps >= rules.episode_limit;
        Ok(Step { reward, terminated, timed_out, ..Step::default() })
    }

    /// Lets all pits of an instance make the steps that they are behind, so that all of them can be looked at.
    pub fn settle(&mut self, instance: usize, chance: &mut impl Chance) {
        let Self { rules, episodes, .. } = self;
        let episode = &mut episodes[instance];
        if !episode.is_solved(rules) {
            episode.settle(rules.tier(episode.tiers).0.magnitude(), chance);
        }
    }
}

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

impl Environment for Gridworld {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.episodes.len()
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
        let (noise, normals) = (self.rules.noise, self.normals.clone());
        self.step_with(instance, actions, &mut Drawn { random, noise, normals: &normals })
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        State::write(&self.episodes[instance], self.rules.agents(), state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let state = State::read(self.rules.counts(), state)?.check(&self.rules)?;
        state.continue_in(&mut self.episodes[instance]);
        Ok(())
    }

    fn picture(&self, state: &[u8]) -> Picture {
        picture(&self.rules, &known(State::read(self.rules.counts(), state)))
    }

    fn place(&mut self, instance: usize, agent: usize, place: [f64; 2]) -> Result<(), StateError> {
        let Self { rules, episodes, .. } = self;
        let episode = &mut episodes[instance];
        let [column, row] = place.map(|part| part as usize);
        let is_inside = agent < rules.agents() && column.max(row) < SIDE;
        let cell = is_inside.then(|| (row * SIDE + column) as u16);
        let open = cell.filter(|cell| rules.map.is_open(*cell, episode.tiers));
        let Some(cell) = open else {
            return Err(StateError::Impossible("a wall or a shut door is there".into()));
        };
        episode.cells[agent] = cell;
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let state = known(State::read(self.rules.counts(), state));
        seen.begin_agents(self.rules.agents(), ACTION_NAMES.len(), wanted, |agent| 1 << agent);
        for agent in members(seen.entities) {
            write_row(&self.rules, &state, agent, &mut seen.rows);
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> crate::Episode {
        let (rules, episode) = (&self.rules, &self.episodes[instance]);
        let found = self.found(instance).iter().map(|own| own.count_ones()).sum::<u32>();
        let (done, solved) = (episode.is_done(rules), episode.is_solved(rules));
        crate::Episode {
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
        let (rules, state) = (&self.rules, known(State::read(self.rules.counts(), state)));
        let mut found = [0; MAX_AGENTS];
        found[..rules.agents()].copy_from_slice(state.found);
        let cells: Vec<u16> = (0..rules.agents()).map(|agent| state.cell(agent)).collect();
        if usize::from(state.tiers) < rules.tiers.len() {
            script(&rules.map, rules.tier(state.tiers), &found, &cells, actions);
        }
        true
    }
}
