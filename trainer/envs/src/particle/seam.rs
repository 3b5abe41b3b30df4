//! The scenarios as [`Environment`]s, by their names.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use serde::Deserialize;

use super::VERSION;
use super::columns::Row;
use super::navigation::Navigation;
use super::physics::ACTIONS;
use super::picture::Picture;
use super::rover_tower::RoverTower;
use super::scenario::Scenario;
use super::simulator::Particle;
use super::spec::NAME;
use super::states::State;
use super::treasure::{AGENTS_PER_BANK, DeadTreasures, TreasureCollection};
use crate::entry::{Choice, Entry, EnvironmentError};
use crate::environment::{Environment, Episode, Split, StateError, Step, StepError};
use crate::observation::{AgentSet, EntitySet, Observation, members};
use crate::random::Random;
use crate::spec::{Shape, Spec};

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

impl<S: Scenario> Particle<S> {
    /// The world of a state that has been checked before.
    fn known(&self, state: &[u8]) -> S::World {
        match self.state(state) {
            Ok(State { world, .. }) => world,
            Err(error) => panic!("a state that `load` refuses: {error}"),
        }
    }
}

impl<S: Scenario> Environment for Particle<S> {
    fn spec(&self) -> &Spec {
        self.own_spec()
    }

    fn instances(&self) -> usize {
        self.count()
    }

    fn open(&self, instances: usize, _: Split) -> Box<dyn Environment> {
        Box::new(Self::new(self.scenario().clone(), instances))
    }

    fn reset(&mut self, instance: usize, random: &mut Random) {
        self.draw(instance, random);
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
        &self.running(instance).rewards
    }

    fn save(&self, instance: usize, state: &mut Vec<u8>) {
        self.write_state(instance, state);
    }

    fn load(&mut self, instance: usize, state: &[u8]) -> Result<(), StateError> {
        self.read_state(instance, state)
    }

    fn place(&mut self, instance: usize, entity: usize, place: [f64; 2]) -> Result<(), StateError> {
        self.put(instance, entity, place)
    }

    fn observe(&self, state: &[u8], _: usize, wanted: EntitySet, seen: &mut Observation) {
        let world = self.known(state);
        let agents = self.own_spec().shape.agents;
        seen.present = (1 << agents) - 1;
        seen.entities = wanted & seen.present;
        seen.observable.clear();
        seen.observable.extend((0..agents).map(|agent| 1 << agent));
        seen.entity_task.clear();
        seen.entity_task.resize(agents, 0);
        seen.available.clear();
        seen.available.resize(agents, (1 << ACTIONS) - 1);
        seen.open_tasks = 0;
        seen.rows.clear();
        for agent in members(seen.entities) {
            self.scenario().observe(&world, agent, &mut Row::new(&mut seen.rows));
            seen.rows.end_row();
        }
    }

    fn episode(&self, instance: usize) -> Episode {
        let episode = self.running(instance);
        let done = self.is_done(instance);
        let Spec { shape, roles, .. } = self.own_spec();
        let sizes = roles.iter().map(|role| role.agents.len().to_string());
        let group = sizes.reduce(|sizes, size| format!("{sizes}+{size}"));
        Episode {
            steps: episode.steps,
            done,
            solved: false,
            timed_out: done,
            episode_return: episode.episode_return,
            group: group.unwrap_or_else(|| shape.agents.to_string()),
            metrics: self.scenario().metrics(&episode.world, episode.steps),
            cause: None,
        }
    }

    fn scripted(&self, state: &[u8], _: &[u8], _: &mut Random, actions: &mut [u16]) -> bool {
        self.scenario().script(&self.known(state), actions);
        true
    }

    /// The pairs of a rover and its tower.
    fn companions(&self, state: &[u8], companions: &mut [EntitySet]) -> bool {
        let Picture { agents, .. } = self.scenario().picture(&self.known(state));
        for (agent, (drawn, companions)) in agents.iter().zip(companions).enumerate() {
            *companions = 1 << agent | drawn.partner.map_or(0, |partner| 1 << partner);
        }
        agents.iter().any(|drawn| drawn.partner.is_some())
    }

    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, _: Option<usize>) -> f32 {
        let world = self.known(state);
        let missing =
            members(team.into()).map(|agent| self.scenario().distance_to_go(&world, agent));
        -scale * missing.sum::<f64>() as f32
    }
}
