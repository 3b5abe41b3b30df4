//! Many cities at once: resets, steps, and what somebody outside changes between two of them.

use alloc::vec::Vec;
use alloc::{format, vec};

use super::causes::{Cause, CauseFinder, Done};
use super::episode::{Episode, EpisodeMetrics, rewards};
use super::grid::Ground;
use super::observation::spec;
use super::rules::{self, Bounce, Change, Constants, Effort};
use super::scenarios::{
    ABSENT_AGENT, ABSENT_BUILDING, CityError, Lots, ScenarioSet, check_state, draw_city,
};
use super::state::{AgentState, BuildingState, City, MAX_BUILDINGS, Status};
use crate::decisions::UNASSIGNED;
use crate::environment::{Split, Step, StepError};
use crate::random::{Random, below, generator};
use crate::spec::{Shape, Spec};

/// SaveTheCity, many instances in one object.
///
/// Agents and buildings of all instances lie in two arrays, `[I, A]` and `[I, M]`; the first ones of
/// every instance exist.
#[derive(Clone, Debug)]
pub struct SaveTheCity {
    pub(super) spec: Spec,
    pub(super) set: ScenarioSet,
    split: Split,
    pub(super) constants: Constants,
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
    pub(super) task_rewards: Vec<f64>,
    bounces: Vec<Bounce>,
    pub(super) episodes: Vec<Episode>,
    lots: Lots,
    /// Those who are told how agents are allocated, one by one as they are.
    causes: Vec<Option<Told>>,
}

/// Why the episode of an instance may fail, and what its agents act for in the next step.
#[derive(Clone, Debug, Default)]
struct Told {
    finder: CauseFinder,
    allocation: Vec<u8>,
}

impl SaveTheCity {
    /// Sets up `instances` cities and starts an episode of the training scenarios in each.
    pub fn new(
        set: ScenarioSet,
        constants: Constants,
        instances: usize,
        seed: u64,
    ) -> Result<Self, CityError> {
        set.check()?;
        let mut random = generator(seed);
        let mut city = Self::empty(set, constants, instances);
        for instance in 0..instances {
            city.reset_to_any(instance, &mut random);
        }
        Ok(city)
    }

    /// Cities without agents and buildings, whose episodes are over.
    pub(super) fn empty(set: ScenarioSet, constants: Constants, instances: usize) -> Self {
        let empty = Episode {
            agents: 0,
            buildings: 0,
            scenario: 0,
            ground: Ground::empty(),
            open_tasks: 0,
            done: true,
            bounces: 0,
            metrics: EpisodeMetrics::default(),
        };
        Self {
            spec: spec(&set, &constants),
            agents: vec![ABSENT_AGENT; instances * set.max_agents],
            buildings: vec![ABSENT_BUILDING; instances * set.max_buildings],
            task_rewards: vec![0.0; instances * set.max_buildings],
            bounces: vec![Bounce::default(); instances * set.max_agents],
            episodes: vec![empty; instances],
            lots: Lots::new(),
            causes: vec![None; instances],
            split: Split::Train,
            set,
            constants,
        }
    }

    /// The padded sizes.
    pub fn shape(&self) -> Shape {
        self.spec.shape
    }

    /// The agents that exist in the running episode.
    pub fn agent_count(&self, instance: usize) -> usize {
        self.episodes[instance].agents
    }

    /// Whether the episode is over and the instance waits for a reset.
    pub fn is_done(&self, instance: usize) -> bool {
        self.episodes[instance].done
    }

    /// The buildings that are open, as bits.
    pub fn open_tasks(&self, instance: usize) -> u32 {
        self.episodes[instance].open_tasks
    }

    /// Chooses the list that later resets draw from.
    pub fn use_split(&mut self, split: Split) {
        self.split = split;
    }

    /// The scenario set.
    pub fn scenario_set(&self) -> &ScenarioSet {
        &self.set
    }

    /// The constants of the rules.
    pub fn constants(&self) -> &Constants {
        &self.constants
    }

    /// The index, in the current list, of the scenario that the episode was drawn from.
    pub fn scenario(&self, instance: usize) -> usize {
        self.episodes[instance].scenario
    }

    /// The existing agents and buildings.
    pub fn city(&self, instance: usize) -> City<'_> {
        let episode = &self.episodes[instance];
        City {
            agents: &self.agents[instance * self.set.max_agents..][..episode.agents],
            buildings: &self.buildings[instance * self.set.max_buildings..][..episode.buildings],
        }
    }

    /// The counts of the episode so far.
    pub fn metrics(&self, instance: usize) -> &EpisodeMetrics {
        &self.episodes[instance].metrics
    }

    /// Notes what the agents of an instance act for in its next step.
    pub(super) fn note_allocation(&mut self, instance: usize, allocation: &[u8]) {
        let mut told = self.causes[instance].take().unwrap_or_else(|| {
            let mut told = Told::default();
            told.finder.begin(self.city(instance));
            told
        });
        told.allocation.clear();
        told.allocation.extend_from_slice(allocation);
        // Who is not told of works for nothing.
        told.allocation.resize(self.set.max_agents, UNASSIGNED);
        self.causes[instance] = Some(told);
    }

    /// Why the episode that is over failed, if somebody has noted all its allocations.
    pub(super) fn cause(&self, instance: usize) -> Option<Cause> {
        let Episode { done, metrics, .. } = &self.episodes[instance];
        let told = self.causes[instance].as_ref().filter(|_| *done)?;
        told.finder.cause(metrics.solved)
    }

    /// The collisions of the last step, in the order in which they were resolved.
    pub fn bounces(&self, instance: usize) -> &[Bounce] {
        &self.bounces[instance * self.set.max_agents..][..self.episodes[instance].bounces]
    }

    /// Starts an episode of a random scenario of the current list.
    pub(super) fn reset_to_any(&mut self, instance: usize, random: &mut Random) {
        let scenario = below(random, self.set.scenarios(self.split).len());
        self.start(instance, scenario, random);
    }

    /// Starts an episode of one scenario of the current list.
    pub fn reset_to(
        &mut self,
        instance: usize,
        scenario: usize,
        random: &mut Random,
    ) -> Result<(), CityError> {
        let count = self.set.scenarios(self.split).len();
        if scenario >= count {
            let reason = format!("`{}`: scenario {scenario} of {count}", self.set.name);
            return Err(CityError::Set(reason));
        }
        self.start(instance, scenario, random);
        Ok(())
    }

    /// Starts an episode of a random scenario with so many buildings.
    pub fn reset_with_tasks(
        &mut self,
        instance: usize,
        tasks: usize,
        random: &mut Random,
    ) -> Result<(), CityError> {
        let scenarios = self.set.scenarios(self.split);
        let fits = |index: &usize| scenarios[*index].buildings.count() == tasks;
        let candidates = (0..scenarios.len()).filter(fits).count();
        if candidates == 0 {
            let reason = format!("`{}`: no scenario has {tasks} buildings", self.set.name);
            return Err(CityError::Set(reason));
        }
        let chosen = below(random, candidates);
        let scenario = (0..scenarios.len()).filter(fits).nth(chosen).unwrap_or(0);
        self.start(instance, scenario, random);
        Ok(())
    }

    /// Continues from a given state instead of a drawn one, `steps` into an episode.
    ///
    /// What agents stand beside and may do is computed; open tasks follow from the buildings' health.
    pub fn restore(
        &mut self,
        instance: usize,
        agents: &[AgentState],
        buildings: &[BuildingState],
        steps: u32,
    ) -> Result<(), CityError> {
        let metrics = EpisodeMetrics { steps, ..EpisodeMetrics::default() };
        self.restore_with(instance, agents, buildings, 0, metrics)
    }

    /// As [`restore`](Self::restore), with all that the episode has counted.
    pub(super) fn restore_with(
        &mut self,
        instance: usize,
        agents: &[AgentState],
        buildings: &[BuildingState],
        scenario: usize,
        counted: EpisodeMetrics,
    ) -> Result<(), CityError> {
        check_state(&self.set, agents, buildings)?;
        let ground = Ground::new(buildings).map_err(|(one, other)| {
            CityError::State(format!("buildings {one} and {other} are less than 3 cells apart"))
        })?;
        let at = instance * self.set.max_agents;
        self.agents[at..][..agents.len()].copy_from_slice(agents);
        let at = instance * self.set.max_buildings;
        self.buildings[at..][..buildings.len()].copy_from_slice(buildings);
        for building in &mut self.buildings[at..][..buildings.len()] {
            building.status = Status::of_health(building.health);
            if !building.is_open() {
                rules::close(building);
            }
        }
        self.episodes[instance].scenario = scenario;
        self.begin(instance, agents.len(), buildings.len(), ground);
        self.episodes[instance].resume(&self.constants, buildings, counted);
        Ok(())
    }

    /// Draws agents and buildings of a scenario.
    fn start(&mut self, instance: usize, scenario: usize, random: &mut Random) {
        let drawn = &self.set.scenarios(self.split)[scenario];
        let (agents, buildings) = (drawn.team.len(), drawn.buildings.count());
        draw_city(
            &self.constants,
            self.set.spacing,
            drawn,
            &mut self.lots,
            random,
            &mut self.agents[instance * self.set.max_agents..][..agents],
            &mut self.buildings[instance * self.set.max_buildings..][..buildings],
        );
        let ground = Ground::new(&self.buildings[instance * self.set.max_buildings..][..buildings])
            .expect("sites are at least 3 cells apart, which the set's check ensures");
        self.episodes[instance].scenario = scenario;
        self.begin(instance, agents, buildings, ground);
    }

    /// Sets what follows from the first state.
    fn begin(&mut self, instance: usize, agents: usize, buildings: usize, ground: Ground) {
        let own_agents = &mut self.agents[instance * self.set.max_agents..][..agents];
        let own_buildings = &self.buildings[instance * self.set.max_buildings..][..buildings];
        rules::refresh_agents(&ground, own_agents, own_buildings);
        let open_tasks = City { agents: own_agents, buildings: own_buildings }.open_tasks();
        let max = self.set.max_buildings;
        self.task_rewards[instance * max..][..max].fill(0.0);
        let scenario = self.episodes[instance].scenario;
        self.causes[instance] = None;
        self.episodes[instance] = Episode {
            agents,
            buildings,
            scenario,
            ground,
            open_tasks,
            done: open_tasks == 0,
            bounces: 0,
            metrics: EpisodeMetrics { buildings: buildings as u32, ..EpisodeMetrics::default() },
        };
    }

    /// Steps one instance; `draw_loser(i, j)` names the one of two agents in a cell that goes back.
    ///
    /// For replays, where the losers are known. Any other answer than `i` or `j` counts as `i`.
    pub fn step_with_losers(
        &mut self,
        instance: usize,
        actions: &[u16],
        mut draw_loser: impl FnMut(usize, usize) -> usize,
    ) -> Result<Step, StepError> {
        let max_reward = self.constants.max_reward(self.set.max_buildings);
        let episode = &mut self.episodes[instance];
        let agents = &mut self.agents[instance * self.set.max_agents..][..episode.agents];
        let buildings =
            &mut self.buildings[instance * self.set.max_buildings..][..episode.buildings];
        episode.check_actions(agents, actions)?;

        let previous = rules::cells(agents);
        let mut efforts = [Effort::default(); MAX_BUILDINGS];
        rules::act(&self.constants, agents, actions, &mut efforts);
        let mut changes = [Change::default(); MAX_BUILDINGS];
        for ((building, effort), change) in buildings.iter_mut().zip(&efforts).zip(&mut changes) {
            if building.is_open() {
                *change = rules::update_building(&self.constants, building, effort);
                episode.metrics.firefights.add(effort.fire_kinds);
                episode.metrics.builds.add(effort.build_kinds);
            }
        }
        episode.bounces = rules::resolve_collisions(
            agents,
            &previous,
            &mut self.bounces[instance * self.set.max_agents..][..self.set.max_agents],
            |first, second| if draw_loser(first, second) == second { second } else { first },
        );
        rules::refresh_agents(&episode.ground, agents, buildings);

        let changes = &changes[..buildings.len()];
        let mut outcome = episode.advance(&self.constants, buildings, changes);
        let task_rewards = &mut self.task_rewards[instance * self.set.max_buildings..];
        let solved = episode.metrics.solved;
        outcome.reward = rewards(&self.constants, changes, solved, max_reward, task_rewards);
        episode.metrics.episode_return += outcome.reward;
        if let Some(Told { finder, allocation }) = &mut self.causes[instance] {
            let bounces = &self.bounces[instance * self.set.max_agents..][..episode.bounces];
            let city = City { agents, buildings };
            finder.stepped(&self.constants, Done { city, allocation, actions, bounces });
        }
        Ok(outcome)
    }

    /// Puts an agent on another cell, between two steps.
    ///
    /// # Errors
    /// There is no such agent, or the cell is taken or none of the map; nothing has changed then.
    pub fn place_agent(
        &mut self,
        instance: usize,
        agent: usize,
        (x, y): (u8, u8),
    ) -> Result<(), CityError> {
        self.change(instance, |agents, _| {
            let own = agents.get_mut(agent).ok_or("there is no such agent")?;
            *own = AgentState { x, y, ..*own };
            Ok(())
        })
    }

    /// Sets a building on full fire and restarts its clock, between two steps.
    ///
    /// # Errors
    /// There is no such building, or it is complete or burned down; nothing has changed then.
    pub fn set_fire(&mut self, instance: usize, building: usize) -> Result<(), CityError> {
        self.change(instance, |_, buildings| {
            let own = buildings.get_mut(building).ok_or("there is no such building")?;
            if !own.is_open() {
                return Err("the building is complete or burned down");
            }
            rules::ignite(own);
            Ok(())
        })
    }

    /// Continues from a changed state.
    fn change(
        &mut self,
        instance: usize,
        change: impl FnOnce(&mut [AgentState], &mut [BuildingState]) -> Result<(), &'static str>,
    ) -> Result<(), CityError> {
        let City { agents, buildings } = self.city(instance);
        let (mut agents, mut buildings) = (agents.to_vec(), buildings.to_vec());
        change(&mut agents, &mut buildings).map_err(|why| CityError::State(why.into()))?;
        let (scenario, metrics) = (self.scenario(instance), *self.metrics(instance));
        self.restore_with(instance, &agents, &buildings, scenario, metrics)
    }
}
