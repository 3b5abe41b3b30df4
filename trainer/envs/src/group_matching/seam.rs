//! Group Matching as an [`Environment`].

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Deserialize;

use super::VERSION;
use super::bytes::State;
use super::features::columns;
use super::groups::same_group;
use super::parameters::{Parameters, SET_NAMES};
use super::ring::all_agents;
use super::rules::ACTIONS;
use super::simulator::GroupMatching;
use super::spec::NAME;
use super::walk::walk;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{EntitySet, Observation, members};
use crate::random::Random;
use crate::spec::Spec;

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: NAME,
    about: "Agents on a ring of cells gather, each with its group (dissertation chapter 5)",
    version: VERSION,
    sets: || SET_NAMES.map(String::from).to_vec(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: &[],
    reader: None,
    #[cfg(feature = "std")]
    recordings: Some(super::golden::RECORDINGS),
};

/// What can be set besides the sizes, which the name of the set says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    noise: f64,
    episode_limit: u32,
    groups_known_at_first: bool,
    held_out: usize,
    held_out_members: usize,
    held_out_share: f64,
}

impl Default for Settings {
    fn default() -> Self {
        let usual = Parameters::default();
        Self {
            noise: usual.noise,
            episode_limit: usual.episode_limit,
            groups_known_at_first: usual.groups_known_at_first,
            held_out: usual.held_out,
            held_out_members: usual.held_out_members,
            held_out_share: usual.held_out_share,
        }
    }
}

impl Settings {
    /// The parameters of a ring of these sizes.
    fn with_sizes(self, sizes: Parameters) -> Parameters {
        Parameters {
            noise: self.noise,
            episode_limit: self.episode_limit,
            groups_known_at_first: self.groups_known_at_first,
            held_out: self.held_out,
            held_out_members: self.held_out_members,
            held_out_share: self.held_out_share,
            ..sizes
        }
    }
}

fn open(choice: &Choice<'_>) -> Result<GroupMatching, EnvironmentError> {
    let settings: Settings = choice.settings()?;
    let sizes = Parameters::named(choice.set.unwrap_or(SET_NAMES[0]))
        .map_err(|error| EnvironmentError::Set(error.to_string()))?;
    let parameters = settings.with_sizes(sizes);
    GroupMatching::new(parameters, choice.instances)
        .map(|ring| ring.with_instances(choice.instances, choice.split))
        .map_err(|error| EnvironmentError::Setting(error.to_string()))
}

impl GroupMatching {
    /// What a state that has been checked before says.
    fn known<'a>(&self, state: &'a [u8]) -> State<'a> {
        match State::read(self.parameters(), state) {
            Ok(state) => state,
            Err(error) => panic!("a state that `load` refuses: {error}"),
        }
    }
}

impl Environment for GroupMatching {
    fn spec(&self) -> &Spec {
        self.own_spec()
    }

    fn instances(&self) -> usize {
        self.count()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        Box::new(self.with_instances(instances, split))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.start(instance, random);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.step_with_noise(instance, actions, random)
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.write_state(instance, state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.read_state(instance, state)
    }

    /// A cell is a column of the only row.
    fn place(
        &mut self,
        instance: usize,
        agent: usize,
        [cell, _]: [f64; 2],
    ) -> Result<(), StateError> {
        self.put(instance, agent, cell as u8)
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let parameters = self.parameters();
        let ring = self.known(state).ring;
        let all = all_agents(parameters.agents);
        seen.present = all;
        seen.entities = wanted & all;
        seen.observable.clear();
        seen.observable.resize(parameters.agents, all);
        seen.entity_task.clear();
        seen.entity_task.resize(parameters.agents, 0);
        seen.available.clear();
        seen.available.resize(parameters.agents, (1 << ACTIONS) - 1);
        seen.open_tasks = 0;
        seen.rows.clear();
        for agent in members(seen.entities) {
            columns(parameters, ring, agent).for_each(|column| seen.rows.push(column, 1.0));
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let counted = self.metrics(instance);
        let sizes = self.ring(instance).groups().map(|members| members.count_ones().to_string());
        Episode {
            steps: counted.steps,
            done: self.is_done(instance),
            solved: counted.solved,
            timed_out: counted.timed_out,
            episode_return: counted.episode_return,
            group: sizes.reduce(|sizes, size| format!("{sizes}+{size}")).unwrap_or_default(),
            metrics: [Some(counted.matches as f64)].to_vec(),
            cause: None,
        }
    }

    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        walk(self.parameters(), self.known(state).ring, actions);
        true
    }

    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        let state = self.known(state);
        for (agent, companions) in companions.iter_mut().enumerate() {
            *companions = same_group(self.parameters(), state.ring, state.steps, agent);
        }
        true
    }
}
