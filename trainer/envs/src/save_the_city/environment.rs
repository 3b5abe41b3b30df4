//! SaveTheCity as an [`Environment`]: its state as bytes and what is seen in it.

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use super::bytes::{CityBytes, write_state};
use super::causes::Cause;
use super::decode::CityDecoder;
use super::episode::EpisodeMetrics;
use super::grid::Symmetry;
use super::observation::{
    BUILDINGS, METRICS, NAME, agent_features, agent_relation, building_features, building_relation,
    picture, potential,
};
use super::rules::FIGHT;
use super::scenarios::{CityError, SET_NAMES, ScenarioSet};
use super::scripted::{AllocationRule, RULES, scripted_actions};
use super::simulator::SaveTheCity;
use super::state::{AgentState, BuildingState, City, MAX_AGENTS, MAX_BUILDINGS, NO_BUILDING};
use super::{Constants, VERSION};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{AgentSet, EntitySet, Observation, TaskSet, members};
use crate::picture::Picture;
use crate::random::{Random, below};
use crate::rows::SparseRows;
use crate::spec::{Shape, Spec};

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: NAME,
    about: "A team extinguishes and repairs burning buildings (dissertation chapter 7)",
    version: VERSION,
    sets: || SET_NAMES.map(String::from).to_vec(),
    open: |choice| Ok(Box::new(open(choice)?)),
    rules: RULES,
    reader: Some(|| Box::new(CityDecoder::new())),
    #[cfg(feature = "std")]
    recordings: Some(super::golden::RECORDINGS),
};

/// The set that is played where none is named.
const DEFAULT_SET: &str = SET_NAMES[0];

fn open(choice: &Choice<'_>) -> Result<SaveTheCity, EnvironmentError> {
    let unfit = |error: &dyn ToString| EnvironmentError::Set(error.to_string());
    let set = ScenarioSet::named(choice.set.unwrap_or(DEFAULT_SET)).map_err(|e| unfit(&e))?;
    let constants: Constants = choice.settings()?;
    constants.check().map_err(EnvironmentError::Setting)?;
    let mut city =
        SaveTheCity::new(set, constants, choice.instances, 0).map_err(|error| unfit(&error))?;
    city.use_split(choice.split);
    Ok(city)
}

/// Calls `with` on the city of a saved state.
///
/// # Panics
/// The bytes are none that [`Environment::save`] has written.
pub fn with_city<T>(state: &[u8], with: impl FnOnce(City<'_>) -> T) -> T {
    let state = known(CityBytes::new(state));
    let mut agents = [super::scenarios::ABSENT_AGENT; MAX_AGENTS];
    let mut buildings = [super::scenarios::ABSENT_BUILDING; MAX_BUILDINGS];
    let (agents, buildings) = decode(&state, &mut agents, &mut buildings);
    with(City { agents, buildings })
}

fn decode<'a>(
    state: &CityBytes<'_>,
    agents: &'a mut [AgentState],
    buildings: &'a mut [BuildingState],
) -> (&'a [AgentState], &'a [BuildingState]) {
    let (agents, buildings) = (&mut agents[..state.agents()], &mut buildings[..state.buildings()]);
    agents.iter_mut().enumerate().for_each(|(index, agent)| *agent = state.agent(index));
    buildings.iter_mut().enumerate().for_each(|(index, it)| *it = state.building(index));
    (agents, buildings)
}

fn metrics(metrics: &EpisodeMetrics) -> Vec<Option<f64>> {
    let entries: Vec<_> = metrics.entries().collect();
    let value = |name| match name {
        BUILDINGS => Some(f64::from(metrics.buildings)),
        _ => entries.iter().find(|(known, _)| *known == name).map(|(_, value)| *value),
    };
    METRICS.iter().map(|metric| value(&metric.name)).collect()
}

fn impossible(error: CityError) -> StateError {
    StateError::Impossible(match error {
        CityError::State(reason) => reason,
        error => error.to_string(),
    })
}

impl Environment for SaveTheCity {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.episodes.len()
    }

    fn open(&self, instances: usize, split: Split) -> Box<dyn Environment> {
        let mut city = Self::empty(self.set.clone(), self.constants, instances);
        city.use_split(split);
        Box::new(city)
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.reset_to_any(instance, random);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.step_with_losers(
            instance,
            actions,
            |first, second| {
                if below(random, 2) == 0 { first } else { second }
            },
        )
    }

    fn note_allocation(&mut self, instance: usize, allocation: &[u8]) {
        SaveTheCity::note_allocation(self, instance, allocation);
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        let buildings = self.set.max_buildings;
        &self.task_rewards[instance * buildings..][..buildings]
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        write_state(self.city(instance), self.scenario(instance), self.metrics(instance), state);
    }

    fn picture(&self, state: &[u8]) -> Picture {
        with_city(state, picture)
    }

    fn place(&mut self, instance: usize, agent: usize, place: [f64; 2]) -> Result<(), StateError> {
        // Whatever is less than the first cell is none of the map either.
        let [x, y] = place.map(|part| if part < 0.0 { u8::MAX } else { part as u8 });
        self.place_agent(instance, agent, (x, y)).map_err(impossible)
    }

    /// Sets a building on fire.
    fn disturb(&mut self, instance: usize, building: usize) -> Result<(), StateError> {
        self.set_fire(instance, building).map_err(impossible)
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let state = CityBytes::new(state)?;
        let mut agents = [super::scenarios::ABSENT_AGENT; MAX_AGENTS];
        let mut buildings = [super::scenarios::ABSENT_BUILDING; MAX_BUILDINGS];
        let (agents, buildings) = decode(&state, &mut agents, &mut buildings);
        self.restore_with(instance, agents, buildings, state.scenario(), state.metrics())
            .map_err(|error| StateError::Impossible(error.to_string()))
    }

    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        let state = known(CityBytes::new(state));
        let Shape { agents: max_agents, entities, .. } = self.spec.shape;
        let (agents, buildings) = (state.agents(), state.buildings());
        let turn = Symmetry::ALL[turn];

        seen.present = ((1 << buildings) - 1) << max_agents | ((1 << agents) - 1);
        seen.entities = wanted & seen.present;
        seen.observable.resize(max_agents, 0);
        seen.observable[..agents].fill(seen.present);
        seen.observable[agents..].fill(0);
        seen.entity_task.resize(entities, 0);
        for (task, tasks) in seen.entity_task[max_agents..].iter_mut().enumerate() {
            *tasks = TaskSet::from(task < buildings) << task;
        }
        seen.available.resize(max_agents, 1);
        for (index, available) in seen.available[..agents].iter_mut().enumerate() {
            *available = turn.available(state.available(index)).into();
        }
        seen.available[agents..].fill(1);
        seen.open_tasks = state.open_tasks().into();

        seen.rows.clear();
        for entity in members(seen.entities) {
            match entity.checked_sub(max_agents) {
                None => agent_features(&turn.agent(&state.agent(entity)), |column, value| {
                    seen.rows.push(column, value);
                }),
                Some(task) => {
                    let building = turn.building(&state.building(task));
                    building_features(&building, |column, value| seen.rows.push(column, value));
                }
            }
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let counted = self.metrics(instance);
        Episode {
            steps: counted.steps,
            done: self.is_done(instance),
            solved: counted.solved,
            timed_out: counted.timed_out,
            episode_return: counted.episode_return,
            group: self.city(instance).agents.iter().map(|agent| agent.kind.letter()).collect(),
            metrics: metrics(counted),
            cause: self.cause(instance).map(Cause::name),
        }
    }

    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        Symmetry::ALL[turn].action(action)
    }

    fn subtask_of(&self, state: &[u8], agent: usize, action: u16) -> Option<usize> {
        let agent = known(CityBytes::new(state)).agent(agent);
        let applies = action >= FIGHT && agent.beside != NO_BUILDING;
        applies.then_some(agent.beside.into())
    }

    fn allocate(&self, rule: usize, state: &[u8], random: &mut Random, allocation: &mut [u8]) {
        with_city(state, |city| AllocationRule::ALL[rule].allocate(city, random, allocation));
    }

    fn scripted(
        &self,
        state: &[u8],
        allocation: &[u8],
        random: &mut Random,
        actions: &mut [u16],
    ) -> bool {
        with_city(state, |city| scripted_actions(city, allocation, random, actions));
        true
    }

    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, task: Option<usize>) -> f32 {
        with_city(state, |city| potential(scale, city, members(team.into()), task))
    }

    fn relate(
        &self,
        state: &[u8],
        turn: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        // Distances look the same from every side.
        let _ = turn;
        let state = known(CityBytes::new(state));
        let max_agents = self.spec.shape.agents;
        let present = ((1 << state.buildings()) - 1) << max_agents | ((1 << state.agents()) - 1);
        let is_open = task < state.buildings() && state.is_open(task);
        for entity in members(wanted & present) {
            let bin = match entity.checked_sub(max_agents) {
                _ if !is_open => None,
                None => Some(agent_relation(&state.agent(entity), &state.building(task))),
                Some(other) if other != task && state.is_open(other) => {
                    Some(building_relation(&state.building(other), &state.building(task)))
                }
                Some(_) => None,
            };
            bin.into_iter().for_each(|bin| rows.push(bin, 1.0));
            rows.end_row();
        }
    }
}
