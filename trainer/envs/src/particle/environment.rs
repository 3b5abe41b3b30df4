//! The scenarios as [`Environment`]s, by their names: many episodes of one at once.

use alloc::boxed::Box;
use alloc::string::{String, ToString};
use alloc::vec::Vec;
use alloc::{format, vec};

use serde::Deserialize;

use super::VERSION;
use super::navigation::Navigation;
use super::physics::ACTIONS;
use super::rover_tower::RoverTower;
use super::scenario::{PAIR, Row, Scenario, State, read_state, state_bytes, write_state};
use super::treasure::{AGENTS_PER_BANK, DeadTreasures, Hoard, TreasureCollection};
use crate::bytes::known;
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Split, StateError, Step, StepError, checked_actions};
use crate::observation::{AgentSet, EntitySet, Observation, members};
use crate::picture::{Link, Picture};
use crate::random::Random;
use crate::spec::{Rewards, Shape, Spec, View};

/// How far from the middle anything can be put, in half sides of the square that everything starts in.
const FARTHEST: f64 = 2.0;

/// A scenario of the plane, many instances in one object. A step allocates nothing.
#[derive(Clone, Debug)]
pub struct Particle<S: Scenario> {
    scenario: S,
    spec: Spec,
    episodes: Vec<Episode<S::World>>,
}

/// What an instance has once.
#[derive(Clone, Debug)]
struct Episode<W> {
    world: W,
    steps: u32,
    episode_return: f64,
    rewards: Vec<f64>,
}

impl<S: Scenario> Particle<S> {
    /// Sets up so many instances, whose episodes are over.
    pub fn new(scenario: S, instances: usize) -> Self {
        let spec = spec(&scenario);
        let episode = Episode {
            world: scenario.world(),
            steps: spec.episode_limit,
            episode_return: 0.0,
            rewards: vec![0.0; spec.shape.agents],
        };
        Self { episodes: vec![episode; instances], scenario, spec }
    }

    /// The rules.
    pub fn scenario(&self) -> &S {
        &self.scenario
    }

    /// Where everything is.
    pub fn world(&self, instance: usize) -> &S::World {
        &self.episodes[instance].world
    }

    /// Whether the episode is over and the instance waits for a reset.
    pub fn is_done(&self, instance: usize) -> bool {
        self.episodes[instance].steps >= self.spec.episode_limit
    }

    /// Starts an episode from a world that the scenario can be in.
    pub fn start(&mut self, instance: usize, world: S::World) {
        let episode = &mut self.episodes[instance];
        (episode.world, episode.steps, episode.episode_return) = (world, 0, 0.0);
    }

    /// Plays one step with actions that are checked before.
    #[inline]
    fn step_with(
        &mut self,
        instance: usize,
        actions: &[u16],
        play: impl FnOnce(&S, &mut S::World, &[u16], &mut [f64]),
    ) -> Result<Step, StepError> {
        let agents = self.spec.shape.agents;
        let actions = checked_actions(self.is_done(instance), agents, ACTIONS, actions)?;
        let Episode { world, steps, episode_return, rewards } = &mut self.episodes[instance];
        play(&self.scenario, world, actions, rewards);
        *steps += 1;
        let reward = rewards.iter().sum::<f64>() / agents as f64;
        *episode_return += reward;
        let timed_out = *steps >= self.spec.episode_limit;
        Ok(Step { reward, timed_out, ..Step::default() })
    }

    /// What the bytes of a state say.
    fn state(&self, state: &[u8]) -> Result<State<S::World>, StateError> {
        read_state(&self.scenario, self.spec.state_bytes, state)
    }
}

impl Particle<TreasureCollection> {
    /// Steps where `draw` says place and kind of each treasure, by its number, that follows a taken one: for replays.
    ///
    /// # Errors
    /// As [`Environment::step`](crate::Environment::step).
    pub fn step_drawn(
        &mut self,
        instance: usize,
        actions: &[u16],
        draw: impl FnMut(usize) -> ([f64; 2], u8),
    ) -> Result<Step, StepError> {
        self.step_with(instance, actions, |scenario, world: &mut Hoard, actions, rewards| {
            scenario.step_by(world, actions, rewards, draw);
        })
    }
}

/// The names of sets that reports and lists show; other numbers of agents are possible.
pub const SET_NAMES: [&str; 8] = [
    "treasure-8",
    "treasure-4",
    "treasure-12",
    "rover-tower-8",
    "rover-tower-10",
    "rover-tower-12",
    "rover-tower-14",
    "navigation-3",
];

/// Steps of an episode of Treasure Collection unless a setting says otherwise.
const TREASURE_STEPS: u32 = 100;
/// Steps of an episode of the other scenarios.
const STEPS: u32 = 25;

/// How `--env` finds it.
pub const ENTRY: Entry = Entry {
    name: NAME,
    about: "Agents with inertia collect treasures, lead each other or cover landmarks on a plane \
            (dissertation chapter 3)",
    version: VERSION,
    sets: || SET_NAMES.map(String::from).to_vec(),
    open,
    rules: &[],
    reader: None,
    #[cfg(feature = "std")]
    recordings: None,
};

/// What can be set in Treasure Collection besides the agents, whose number the set says.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TreasureSettings {
    episode_limit: u32,
    dead_treasures: DeadTreasures,
}

impl Default for TreasureSettings {
    fn default() -> Self {
        Self { episode_limit: TREASURE_STEPS, dead_treasures: DeadTreasures::default() }
    }
}

/// What can be set in the other scenarios.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    episode_limit: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { episode_limit: STEPS }
    }
}

fn open(choice: &Choice<'_>) -> Result<Box<dyn Environment>, EnvironmentError> {
    let set = choice.set.unwrap_or(SET_NAMES[0]);
    let steps = || choice.settings().map(|settings: Settings| settings.episode_limit);
    match sized(set).ok_or_else(|| unknown(set))? {
        ("treasure", agents) if agents % AGENTS_PER_BANK == 0 => {
            let TreasureSettings { episode_limit, dead_treasures } = choice.settings()?;
            let banks = agents / AGENTS_PER_BANK;
            opened(TreasureCollection::new(banks, dead_treasures, episode_limit), choice)
        }
        ("rover-tower", agents) if agents % 2 == 0 => {
            opened(RoverTower::new(agents / 2, steps()?), choice)
        }
        ("navigation", agents) => opened(Navigation::new(agents, steps()?), choice),
        _ => Err(unknown(set)),
    }
}

/// The scenario that a set names, and its agents.
fn sized(set: &str) -> Option<(&str, usize)> {
    let (scenario, agents) = set.rsplit_once('-')?;
    let agents = agents.parse().ok().filter(|agents| (1..=Shape::AGENTS).contains(agents))?;
    Some((scenario, agents))
}

fn unknown(set: &str) -> EnvironmentError {
    EnvironmentError::Set(format!(
        "no set `{set}`; there are `treasure-N` for N = 4, 8, 12 and so on, `rover-tower-N` for even N and \
         `navigation-N`, of at most {} agents",
        Shape::AGENTS
    ))
}

fn opened<S: Scenario>(
    scenario: S,
    choice: &Choice<'_>,
) -> Result<Box<dyn Environment>, EnvironmentError> {
    if scenario.episode_limit() == 0 {
        let reason = "an episode limit of 0 steps leaves no episode";
        return Err(EnvironmentError::Setting(reason.to_string()));
    }
    Ok(Box::new(Particle::new(scenario, choice.instances)))
}

impl<S: Scenario> Environment for Particle<S> {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn instances(&self) -> usize {
        self.episodes.len()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(Self::new(self.scenario.clone(), instances))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        let episode = &mut self.episodes[instance];
        self.scenario.reset(&mut episode.world, random);
        (episode.steps, episode.episode_return) = (0, 0.0);
    }

    fn step(
        &mut self,
        instance: usize,
        actions: &[u16],
        random: &mut Random,
    ) -> Result<Step, StepError> {
        self.step_with(instance, actions, |scenario, world, actions, rewards| {
            scenario.step(world, actions, random, rewards);
        })
    }

    fn agent_rewards(&self, instance: usize) -> &[f64] {
        &self.episodes[instance].rewards
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        let Episode { world, steps, episode_return, .. } = &self.episodes[instance];
        write_state(&self.scenario, (*steps, *episode_return, world), state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        let State { steps, episode_return, world } = self.state(state)?;
        let episode = &mut self.episodes[instance];
        (episode.world, episode.steps, episode.episode_return) = (world, steps, episode_return);
        Ok(())
    }

    fn picture(&self, state: &[u8]) -> Picture {
        self.scenario.picture(&known(self.state(state)).world)
    }

    /// What is put somewhere comes to rest there.
    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        let refused = |reason: &str| Err(StateError::Impossible(reason.into()));
        if !place.iter().all(|part| part.abs() <= FARTHEST) {
            return refused("that is too far away");
        }
        let world = &mut self.episodes[instance].world;
        let Some((position, velocity)) = self.scenario.entity(world, entity) else {
            return refused("it is nowhere, and stays there");
        };
        *position = place;
        if let Some(velocity) = velocity {
            *velocity = [0.0; 2];
        }
        Ok(())
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let world = known(self.state(state)).world;
        seen.begin_agents(self.spec.shape.agents, ACTIONS, wanted, |agent| 1 << agent);
        for agent in members(seen.entities) {
            self.scenario.observe(&world, agent, &mut Row::new(&mut seen.rows));
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> crate::Episode {
        let episode = &self.episodes[instance];
        let done = self.is_done(instance);
        let Spec { shape, roles, .. } = &self.spec;
        let sizes = roles.iter().map(|role| role.agents.len().to_string());
        let group = sizes.reduce(|sizes, size| format!("{sizes}+{size}"));
        crate::Episode {
            steps: episode.steps,
            done,
            solved: false,
            timed_out: done,
            episode_return: episode.episode_return,
            group: group.unwrap_or_else(|| shape.agents.to_string()),
            metrics: self.scenario.metrics(&episode.world, episode.steps),
            cause: None,
        }
    }

    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        self.scenario.script(&known(self.state(state)).world, actions);
        true
    }

    /// The pairs of a rover and its tower.
    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        let Picture { links, .. } = self.picture(state);
        (0..).zip(&mut *companions).for_each(|(agent, set)| *set = 1 << agent);
        for Link { from, to, .. } in links.iter().filter(|link| link.name == PAIR) {
            companions[*from] |= 1 << to;
            companions[*to] |= 1 << from;
        }
        !links.is_empty()
    }

    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, _: Option<usize>) -> f32 {
        let world = known(self.state(state)).world;
        let missing = members(team.into()).map(|agent| self.scenario.distance_to_go(&world, agent));
        -scale * missing.sum::<f64>() as f32
    }

    /// Reads the state once, not once for each agent.
    fn potentials(&self, state: &[u8], scale: f32, potentials: &mut [f32]) {
        let world = known(self.state(state)).world;
        for (agent, potential) in potentials.iter_mut().enumerate() {
            *potential = -scale * self.scenario.distance_to_go(&world, agent) as f32;
        }
    }
}

/// Its name, as `--env` takes it.
const NAME: &str = "particle";

/// What a scenario says of itself. Where all agents are alike there are no roles.
fn spec<S: Scenario>(scenario: &S) -> Spec {
    let mut roles = scenario.roles();
    let agents = roles.iter().map(|role| role.agents.len()).sum();
    let widest = roles.iter().max_by_key(|role| role.features.len());
    let widest = widest.expect("somebody plays").clone();
    let features = widest.features.len();
    if roles.len() == 1 {
        roles = Vec::new();
    }
    Spec {
        name: NAME.into(),
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions: ACTIONS, features },
        view: View::Vectors,
        features: widest.features,
        units: widest.units,
        actions: widest.actions,
        roles,
        safe_action: Some(0),
        has_success: false,
        metrics: S::METRICS.to_vec(),
        rewards: Rewards { tasks: false, agents: true },
        row_entries: features,
        state_bytes: state_bytes(scenario),
        episode_limit: scenario.episode_limit(),
        ..Spec::default()
    }
}
