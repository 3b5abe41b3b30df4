//! Many cities at once: resets, steps and observations.

use alloc::format;
use alloc::vec;
use alloc::vec::Vec;

use rand_xoshiro::Xoshiro256PlusPlus;

use super::checks::check_state;
use super::episode::{Episode, rewards};
use super::error::CityError;
use super::features::{FEATURES, write_rows};
use super::grid::Ground;
use super::metrics::EpisodeMetrics;
use super::reset::{ABSENT_AGENT, ABSENT_BUILDING, Lots, draw_city};
use super::rules::{self, ACTIONS, Bounce, Change, Constants, Effort, availability_codes};
use super::scenarios::{ScenarioSet, Split};
use super::state::{AgentState, BuildingState, City, MAX_BUILDINGS, Status};
use crate::environment::{Environment, ObservationMut, Shape, StepError, StepOutcome, Subtasks};
use crate::random::{below, generator};

/// SaveTheCity, many instances in one object.
///
/// Agents and buildings of all instances lie in two arrays, `[I, A]` and `[I, M]`; the first ones of
/// every instance exist.
#[derive(Clone, Debug)]
pub struct SaveTheCity {
    set: ScenarioSet,
    split: Split,
    constants: Constants,
    agents: Vec<AgentState>,
    buildings: Vec<BuildingState>,
    task_rewards: Vec<f64>,
    bounces: Vec<Bounce>,
    episodes: Vec<Episode>,
    generators: Vec<Xoshiro256PlusPlus>,
    lots: Lots,
}

impl SaveTheCity {
    /// Sets up `instances` cities and starts an episode of the training scenarios in each.
    ///
    /// The instances' generators are stretches of one sequence, 2^128 draws apart.
    pub fn new(
        set: ScenarioSet,
        constants: Constants,
        instances: usize,
        seed: u64,
    ) -> Result<Self, CityError> {
        set.check()?;
        let mut next = generator(seed);
        let generators = (0..instances)
            .map(|_| {
                let own = next.clone();
                next.jump();
                own
            })
            .collect();
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
        let mut city = Self {
            agents: vec![ABSENT_AGENT; instances * set.max_agents],
            buildings: vec![ABSENT_BUILDING; instances * set.max_buildings],
            task_rewards: vec![0.0; instances * set.max_buildings],
            bounces: vec![Bounce::default(); instances * set.max_agents],
            episodes: vec![empty; instances],
            generators,
            lots: Lots::new(),
            split: Split::Train,
            set,
            constants,
        };
        for instance in 0..instances {
            city.reset(instance);
        }
        Ok(city)
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

    /// The collisions of the last step, in the order in which they were resolved.
    pub fn bounces(&self, instance: usize) -> &[Bounce] {
        &self.bounces[instance * self.set.max_agents..][..self.episodes[instance].bounces]
    }

    /// Starts an episode of one scenario of the current list.
    pub fn reset_to(&mut self, instance: usize, scenario: usize) -> Result<(), CityError> {
        let count = self.set.scenarios(self.split).len();
        if scenario >= count {
            return Err(CityError::Set(format!(
                "`{}`: scenario {scenario} of {count}",
                self.set.name
            )));
        }
        self.start(instance, scenario);
        Ok(())
    }

    /// Starts an episode of a random scenario with so many buildings.
    pub fn reset_with_tasks(&mut self, instance: usize, tasks: usize) -> Result<(), CityError> {
        let scenarios = self.set.scenarios(self.split);
        let fits = |index: &usize| scenarios[*index].buildings.count() == tasks;
        let candidates = (0..scenarios.len()).filter(fits).count();
        if candidates == 0 {
            return Err(CityError::Set(format!(
                "`{}`: no scenario has {tasks} buildings",
                self.set.name
            )));
        }
        let chosen = below(&mut self.generators[instance], candidates);
        let scenario = (0..scenarios.len()).filter(fits).nth(chosen).unwrap_or(0);
        self.start(instance, scenario);
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
        self.episodes[instance].scenario = 0;
        self.begin(instance, agents.len(), buildings.len(), ground);
        self.episodes[instance].metrics.steps = steps;
        Ok(())
    }

    /// Draws agents and buildings of a scenario.
    fn start(&mut self, instance: usize, scenario: usize) {
        let drawn = &self.set.scenarios(self.split)[scenario];
        let (agents, buildings) = (drawn.team.len(), drawn.buildings.count());
        draw_city(
            &self.constants,
            self.set.spacing,
            drawn,
            &mut self.lots,
            &mut self.generators[instance],
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
    ) -> Result<StepOutcome, StepError> {
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
        let total =
            rewards(&self.constants, changes, episode.metrics.solved, max_reward, task_rewards);
        outcome.reward = total;
        episode.metrics.episode_return += total;
        Ok(outcome)
    }
}

impl Environment for SaveTheCity {
    fn shape(&self) -> Shape {
        Shape {
            agents: self.set.max_agents,
            entities: self.set.max_agents + self.set.max_buildings,
            tasks: self.set.max_buildings,
            actions: ACTIONS,
            features: FEATURES,
        }
    }

    fn instances(&self) -> usize {
        self.episodes.len()
    }

    fn seed(&mut self, instance: usize, seed: u64) {
        self.generators[instance] = generator(seed);
    }

    fn reset(&mut self, instance: usize) {
        let count = self.set.scenarios(self.split).len();
        let scenario = below(&mut self.generators[instance], count);
        self.start(instance, scenario);
    }

    fn step(&mut self, instance: usize, actions: &[u16]) -> Result<StepOutcome, StepError> {
        let mut rng = self.generators[instance].clone();
        let outcome = self.step_with_losers(instance, actions, |first, second| {
            if below(&mut rng, 2) == 0 { first } else { second }
        });
        self.generators[instance] = rng;
        outcome
    }

    fn observe(&self, instance: usize, observation: &mut ObservationMut<'_>) {
        let city = self.city(instance);
        let (max_agents, agents) = (self.set.max_agents, city.agents.len());
        let entities = max_agents + self.set.max_buildings;
        let stride = observation.stride;
        let rows = &mut observation.rows[..entities * stride];
        write_rows(city, max_agents, rows, stride);

        let building_bits = ((1u128 << city.buildings.len()) - 1) << max_agents;
        let present = building_bits | ((1u128 << agents) - 1);
        *observation.present = present;
        observation.observable[..agents].fill(present);
        observation.observable[agents..max_agents].fill(0);
        for (task, tasks) in observation.entity_task[max_agents..entities].iter_mut().enumerate() {
            *tasks = if task < city.buildings.len() { 1 << task } else { 0 };
        }
        let (codes, _) = observation.available.as_chunks_mut::<ACTIONS>();
        for (agent, codes) in codes[..max_agents].iter_mut().enumerate() {
            *codes = availability_codes(city.agents.get(agent).unwrap_or(&ABSENT_AGENT));
        }
        *observation.open_tasks = self.episodes[instance].open_tasks;
    }

    fn agent_count(&self, instance: usize) -> usize {
        self.episodes[instance].agents
    }

    fn is_done(&self, instance: usize) -> bool {
        self.episodes[instance].done
    }
}

impl Subtasks for SaveTheCity {
    fn open_tasks(&self, instance: usize) -> u32 {
        self.episodes[instance].open_tasks
    }

    fn task_rewards(&self, instance: usize) -> &[f64] {
        &self.task_rewards[instance * self.set.max_buildings..][..self.set.max_buildings]
    }

    fn entity_task(&self, instance: usize, entity: usize) -> u32 {
        let task = entity.checked_sub(self.set.max_agents);
        match task {
            Some(task) if task < self.episodes[instance].buildings => 1 << task,
            _ => 0,
        }
    }
}
