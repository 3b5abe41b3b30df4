//! For tests: a street with agents and sites at numbered doors, whose states are laid out by hand, and agents and allocators
//! that act and learn nothing.

use sortie_envs::{
    ActionSet, AgentSet, EntitySet, Environment, Episode, Observation, Random, Rewards, Rule,
    Shape, SparseRows, Spec, Split, StateError, Step, StepError, UNASSIGNED, members,
};
use sortie_learn::play::{Play, RandomTeam};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{EpisodeCounts, Rates};
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};

use super::config::Config;
use super::history::Returns;
use super::learner::Observer;
use super::replay::Replay;
use super::rollout::{Behaviour, Memory, Rollout};
use super::team_value::Segments;
use crate::alma::ALMA;
use crate::alma::agents::UtilityNetwork;

/// Slots of agents.
pub(super) const AGENTS: usize = 8;
const SITES: usize = 4;
const DOORS: u8 = 16;

/// A state: the doors of the agents, then for each site its door and whether it is open.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Street {
    pub(super) agents: Vec<u8>,
    pub(super) sites: Vec<(u8, bool)>,
}

impl Street {
    /// So many agents at their own numbers, and open sites at these doors.
    pub(super) fn new(agents: u8, doors: &[u8]) -> Self {
        let sites = doors.iter().map(|door| (*door, true)).collect();
        Self { agents: (0..agents).collect(), sites }
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![self.agents.len() as u8];
        bytes.extend(&self.agents);
        self.sites.iter().for_each(|(door, is_open)| bytes.extend([*door, u8::from(*is_open)]));
        bytes
    }

    fn read(bytes: &[u8]) -> Self {
        let (agents, sites) = bytes[1..].split_at(bytes[0].into());
        let sites = sites.chunks_exact(2).map(|site| (site[0], site[1] == 1));
        Self { agents: agents.to_vec(), sites: sites.collect() }
    }

    /// All that there is to see.
    pub(super) fn seen(&self) -> Observation {
        let mut seen = Observation::default();
        toy().observe(&self.bytes(), 0, EntitySet::MAX, &mut seen);
        seen
    }

    fn distance(&self, agent: usize, site: usize) -> u8 {
        self.agents[agent].abs_diff(self.sites[site].0)
    }
}

/// The environment of such states; nobody plays in it.
pub(super) struct Toy(Spec);

pub(super) fn toy() -> Toy {
    let rule = |name| Rule { name, about: "" };
    let shape =
        Shape { agents: AGENTS, entities: AGENTS + SITES, tasks: SITES, actions: 3, features: 3 };
    Toy(Spec {
        name: "street",
        shape,
        rewards: Rewards { tasks: true, agents: false },
        turns: 2,
        // Everybody to the last site, to the nearest, or to the first.
        rules: Box::leak(Box::new(["coordinated", "heuristic", "random"].map(rule))),
        relations: DOORS.into(),
        row_entries: 3,
        state_bytes: 1 + AGENTS + 2 * SITES,
        ..Spec::default()
    })
}

impl Environment for Toy {
    fn spec(&self) -> &Spec {
        &self.0
    }

    fn instances(&self) -> usize {
        1
    }

    fn open(&self, _: usize, _: Split) -> Box<dyn Environment> {
        Box::new(toy())
    }

    fn reset(&mut self, _: usize, _: &mut Random) {}

    fn step(&mut self, _: usize, _: &[u16], _: &mut Random) -> Result<Step, StepError> {
        Err(StepError::EpisodeOver)
    }

    fn save(&self, _: usize, state: &mut Vec<u8>) {
        state.extend(Street::new(1, &[3]).bytes());
    }

    fn load(&mut self, _: usize, _: &[u8]) -> Result<(), StateError> {
        Ok(())
    }

    /// Features: 1 for a site, the door, whether it is open.
    fn observe(&self, state: &[u8], turn: usize, wanted: EntitySet, seen: &mut Observation) {
        let street = Street::read(state);
        *seen = Observation::new(&self.0.shape);
        let (agents, sites) = (street.agents.len(), street.sites.len());
        seen.present = ((1 << sites) - 1) << AGENTS | ((1 << agents) - 1);
        seen.entities = wanted & seen.present;
        seen.observable[..agents].fill(seen.present);
        seen.available[..agents].fill(0b111);
        let turned = |door: u8| f32::from(if turn == 0 { door } else { DOORS - 1 - door });
        for entity in members(seen.entities) {
            match entity.checked_sub(AGENTS) {
                None => seen.rows.push_dense(&[0.0, turned(street.agents[entity]), 0.0]),
                Some(site) => {
                    let (door, is_open) = street.sites[site];
                    seen.rows.push_dense(&[1.0, turned(door), f32::from(u8::from(is_open))]);
                }
            }
        }
        for (site, (_, is_open)) in street.sites.iter().enumerate() {
            seen.entity_task[AGENTS + site] = 1 << site;
            seen.open_tasks |= u32::from(*is_open) << site;
        }
    }

    fn episode(&self, _: usize) -> Episode {
        Episode::default()
    }

    fn turned_action(&self, turn: usize, action: u16) -> u16 {
        [action, [0, 2, 1][usize::from(action)]][turn]
    }

    fn allocate(&self, rule: usize, state: &[u8], _: &mut Random, allocation: &mut [u8]) {
        let street = Street::read(state);
        let open: Vec<usize> = (0..street.sites.len()).filter(|s| street.sites[*s].1).collect();
        allocation.fill(UNASSIGNED);
        for (agent, task) in allocation.iter_mut().take(street.agents.len()).enumerate() {
            let nearest = open.iter().copied().min_by_key(|site| street.distance(agent, *site));
            let site = [open.last().copied(), nearest, open.first().copied()][rule];
            *task = site.map_or(UNASSIGNED, |site| site as u8);
        }
    }

    /// The distance to the site, or without one to the nearest that is open.
    fn potential(&self, state: &[u8], scale: f32, team: AgentSet, task: Option<usize>) -> f32 {
        let street = Street::read(state);
        let open = || (0..street.sites.len()).filter(|site| street.sites[*site].1);
        let distance = |agent: usize| match task {
            Some(task) => Some(street.distance(agent, task)),
            None => open().map(|site| street.distance(agent, site)).min(),
        };
        members(team.into()).map(|agent| -scale * f32::from(distance(agent).unwrap_or(0))).sum()
    }

    /// The distance as one-hot.
    fn relate(
        &self,
        state: &[u8],
        _: usize,
        task: usize,
        wanted: EntitySet,
        rows: &mut SparseRows,
    ) {
        let street = Street::read(state);
        let door = street.sites[task].0;
        for entity in members(wanted & street.seen().present) {
            let other = match entity.checked_sub(AGENTS) {
                None => Some(street.agents[entity]),
                Some(site) if site != task && street.sites[site].1 => Some(street.sites[site].0),
                Some(_) => None,
            };
            other.iter().for_each(|other| rows.push(other.abs_diff(door).into(), 1.0));
            rows.end_row();
        }
    }
}

/// Agents and an allocator that learn nothing; the allocator decides from a step on.
pub(super) struct Fixed {
    pub(super) rollout: Rollout,
    pub(super) agents: UtilityNetwork,
    pub(super) epsilon: f32,
    pub(super) allocator: UtilityNetwork,
    pub(super) decides_from: u64,
    pub(super) records: Replay,
    pub(super) segments: Option<Segments>,
    pub(super) decisions: u64,
    /// The actions that were available to whoever acted, and what was done, by instance.
    pub(super) acted: Vec<(usize, ActionSet, u16)>,
}

impl Method for Fixed {
    fn begins(&mut self, instance: usize, random: &mut Random) {
        self.rollout.begin(instance, random);
    }

    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        now: Now,
        random: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        let allocator = (now.env_steps >= self.decides_from).then_some(&self.allocator);
        let behaviour = Behaviour { agents: &self.agents, epsilon: self.epsilon, allocator };
        let memory = Memory { records: &mut self.records, segments: self.segments.as_mut() };
        self.decisions += self.rollout.act(scenes, random, behaviour, memory, actions)?;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let mut seen = Observation::default();
        transition.environment.observe(transition.state, 0, 0, &mut seen);
        let acted = seen.available[..seen.agents()].iter().zip(transition.actions);
        let instance = transition.instance;
        self.acted.extend(acted.map(|(available, action)| (instance, *available, *action)));
        let memory = Memory { records: &mut self.records, segments: self.segments.as_mut() };
        self.rollout.remember(transition, memory);
        Ok(())
    }

    fn rates(&self, _: Now) -> Rates {
        Rates { epsilon: self.epsilon, learning_rate: 0.0 }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        Box::new(RandomTeam::new(1))
    }

    fn state(&mut self, _: &mut State<'_>) -> Result<(), LearnError> {
        Ok(())
    }
}

/// The preset `fast`.
pub(super) fn usual() -> Config {
    Config::of(&ALMA.preset("fast").unwrap()).unwrap()
}

/// Where a run learns.
fn city(config: &Config) -> Box<dyn Environment> {
    let settings = &config.environment.settings;
    sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, settings).unwrap()
}

/// Greedy agents with the first weights of seed 1, with room for records, and for so many segments.
pub(super) fn fixed(config: &Config, segments: usize) -> Fixed {
    let network =
        |shape| UtilityNetwork::initialise(shape, 8.0, &mut generator(1, Purpose::Weights, 0));
    let environment = city(config);
    let spec = environment.spec();
    let lag = Returns::from(&config.returns).lag(config.environment.instances);
    Fixed {
        rollout: Rollout::new(config, spec),
        agents: network(config.network.shape(spec)),
        epsilon: 0.0,
        allocator: network(config.allocator.shape(spec)),
        decides_from: 0,
        records: Replay::new(10_000, lag, spec),
        segments: Some(Segments::new(segments)),
        decisions: 0,
        acted: Vec::new(),
    }
}

/// Starts an episode in every instance.
pub(super) fn begin(config: &Config, seed: u64, method: &mut Fixed) -> Play {
    let city = city(config);
    let stream = |index| generator(seed, Purpose::Rollout, index as u64);
    let random = (0..config.environment.instances).map(stream).collect();
    Play::new(&*city, method, random)
}

/// Steps all instances so many times; what ended, and how often it was decided.
pub(super) fn play(play: &mut Play, method: &mut Fixed, steps: u64) -> (EpisodeCounts, u64) {
    let (mut counts, before) = (EpisodeCounts::default(), method.decisions);
    for env_steps in 0..steps {
        play.round(method, Now { env_steps, of: steps }, &mut counts).unwrap();
    }
    (counts, method.decisions - before)
}

/// What observes the states of a run.
pub(super) fn observer(config: &Config) -> Observer {
    Observer::of(&*city(config))
}
