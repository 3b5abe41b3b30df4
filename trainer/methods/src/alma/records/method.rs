//! Learning from records as a [`Method`].

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sortie_envs::{Environment, Random};
use sortie_learn::export::{DeployedAgents, Words};
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{Level, Rates, Reports};
use sortie_learn::subtasks::{
    Allocate, AllocatorNetworks, LearnedAllocator, NoSubtasks, RuleAllocator, Subtasks,
};
use sortie_learn::{Act, LearnError, Method, Now, Scenes, State, Transition};
use sortie_nn::random::Generator;
use sortie_nn::workers::Workers;

use super::config::{Config, LEARNED};
use super::history::Returns;
use super::learner::{Knowledge, Learner, Loss, MixedNetwork, Observer};
use super::mixer::Mixer;
use super::replay::Replay;
use super::rollout::{Behaviour, Memory, Rollout};
use super::team_value::{Segments, TeamValueAllocator, TeamValueLoss};
use super::temporal_difference::Chunk;
use crate::alma::agents::{UtilityNetwork, tensors};
use crate::alma::export;
use crate::alma::learned::Learned;
use crate::alma::teams::{Agents, NetworkAgents};

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;

/// When each level makes its next update, in environment steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Due(Level<u64>);

impl Due {
    /// Whether a level has an update to make.
    fn any(&self, env_steps: u64) -> bool {
        self.0.agents.min(self.0.allocator) <= env_steps
    }

    /// Which levels have an update to make; they are taken to have made it.
    fn take(&mut self, env_steps: u64, config: &Config) -> Level<bool> {
        let take = |next: &mut u64, pause: u64| {
            let due = *next <= env_steps;
            *next += if due { pause } else { 0 };
            due
        };
        Level {
            agents: take(&mut self.0.agents, config.replay.steps_per_update),
            allocator: take(&mut self.0.allocator, config.allocator.replay.steps_per_update),
        }
    }
}

/// Agents, and where the run learns one, their allocator.
#[derive(Debug)]
pub struct Records {
    config: Config,
    /// The agents.
    pub agents: Learner<Chunk>,
    /// There is one if the run learns an allocator.
    pub allocator: Option<Learner<TeamValueLoss>>,
    observer: Observer,
    workers: Workers,
    /// Acts, and cuts what happens into records.
    pub rollout: Rollout,
    /// What each level draws its samples with.
    picks: Level<Generator>,
    due: Due,
    /// Decisions that were not reported yet.
    decisions: u64,
    /// Whether the allocator learns from the steps that are being taken.
    keeps_segments: bool,
}

impl Records {
    /// Draws the first weights, for an environment.
    pub fn new(config: &Config, environment: &dyn Environment, seed: u64, threads: usize) -> Self {
        let observer = Observer::of(environment);
        let agents = agents_learner(config, &observer, seed);
        let learns = config.learns_allocator();
        let allocator = learns.then(|| allocator_learner(config, &observer, seed));
        let (act, allocate) = (agents.job(), allocator.as_ref().map(Learner::job));
        let job = Arc::new(move || {
            act();
            allocate.iter().for_each(|allocate| allocate());
        });
        Self {
            rollout: Rollout::new(config, environment.spec()),
            observer,
            workers: Workers::new(threads, job),
            agents,
            allocator,
            picks: Level {
                agents: generator(seed, Purpose::Replay, 0),
                allocator: generator(seed, Purpose::Replay, ALLOCATOR_STREAM),
            },
            due: Due::default(),
            decisions: 0,
            keeps_segments: false,
            config: config.clone(),
        }
    }

    /// One update of each level that is due and has enough to learn from, both at the same time.
    fn update_once(&mut self, now: Now, reports: &mut Reports) {
        let Self { config, agents, allocator, picks, .. } = self;
        let due = self.due.take(now.env_steps, config);
        let learn_agents = due.agents && agents.is_warm();
        if learn_agents {
            agents.pick(&mut picks.agents);
        }
        let mut allocator = allocator.as_mut().filter(|learner| due.allocator && learner.is_warm());
        if let Some(learner) = &mut allocator {
            learner.pick(&mut picks.allocator);
        }
        self.workers.run();
        if learn_agents {
            let rate = config.optimiser.learning_rate_at(now.env_steps, now.of);
            reports.agents.push(agents.follow(rate));
        }
        if let Some(learner) = allocator {
            let rate = config.allocator.optimiser.learning_rate_at(now.env_steps, now.of);
            reports.allocator.push(learner.follow(rate));
        }
    }

    /// The agents that are measured.
    fn measured(&self) -> Agents<'_> {
        Agents::new(&self.agents.average.utility)
    }

    /// The averaged weights of the allocator.
    fn team_values(&self) -> Option<&UtilityNetwork> {
        self.allocator.as_ref().map(|learner| &learner.average)
    }

    /// The agents, and what they are allocated by if the run learns that.
    fn allocated(&self) -> Subtasks<'_> {
        let Config { network, allocation, .. } = &self.config;
        let team_max = allocation.team_max;
        Subtasks {
            agents: Box::new(NetworkAgents::new(self.measured(), network.subtask)),
            are_seen: network.subtask.has_subtasks(),
            interval: allocation.interval,
            allocator: self.team_values().map(|network| LearnedAllocator {
                allocate: Box::new(TeamValueAllocator::new(network, team_max)),
                networks: AllocatorNetworks::TeamValue(Box::new(network.layers())),
                team_max: Some(team_max),
            }),
        }
    }

    /// Who allocates where the team is measured.
    fn measured_allocator<'a>(
        &'a self,
        learned: Option<LearnedAllocator<'a>>,
    ) -> Box<dyn Allocate + 'a> {
        if !self.config.network.subtask.has_subtasks() {
            return Box::new(NoSubtasks);
        }
        match (self.config.allocation.measured(), learned) {
            (LEARNED, Some(learned)) => learned.allocate,
            // Whoever is measured under learned allocation learns it.
            (LEARNED, None) => Box::new(NoSubtasks),
            (rule, _) => Box::new(RuleAllocator(rule)),
        }
    }
}

impl Method for Records {
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
        let Config { exploration, allocator: config, .. } = &self.config;
        self.keeps_segments = now.env_steps >= config.learns_from;
        let mut agents = self.agents.knowledge_mut();
        let Knowledge { online, replay: records, .. } = &mut *agents;
        let mut allocator = self.allocator.as_mut().map(Learner::knowledge_mut);
        let (mut network, mut segments) = (None, None);
        if let Some(allocator) = &mut allocator {
            let Knowledge { online, replay, .. } = &mut **allocator;
            network = (now.env_steps >= config.decides_from).then_some(&*online);
            segments = self.keeps_segments.then_some(replay);
        }
        let epsilon = exploration.epsilon_at(now.env_steps);
        let behaviour = Behaviour { agents: &online.utility, epsilon, allocator: network };
        let memory = Memory { records, segments };
        self.decisions += self.rollout.act(scenes, random, behaviour, memory, actions)?;
        Ok(())
    }

    fn remember(&mut self, transition: &Transition<'_>) -> Result<(), LearnError> {
        let mut agents = self.agents.knowledge_mut();
        let mut allocator = self.allocator.as_mut().map(Learner::knowledge_mut);
        let segments = allocator.as_mut().map(|allocator| &mut allocator.replay);
        let segments = segments.filter(|_| self.keeps_segments);
        self.rollout.remember(transition, Memory { records: &mut agents.replay, segments });
        Ok(())
    }

    fn update(
        &mut self,
        _: &dyn Environment,
        now: Now,
        reports: &mut Reports,
    ) -> Result<(), LearnError> {
        reports.decisions += std::mem::take(&mut self.decisions);
        while self.due.any(now.env_steps) {
            self.update_once(now, reports);
        }
        Ok(())
    }

    fn rates(&self, now: Now) -> Rates {
        Rates {
            epsilon: self.config.exploration.epsilon_at(now.env_steps),
            learning_rate: self.config.optimiser.learning_rate_at(now.env_steps, now.of),
        }
    }

    fn team(&self) -> Box<dyn Act + '_> {
        let mut subtasks = self.allocated();
        let allocator = self.measured_allocator(subtasks.allocator.take());
        Box::new(subtasks.under(allocator))
    }

    fn subtasks(&self) -> Option<Subtasks<'_>> {
        Some(self.allocated())
    }

    fn deployed(&self) -> Result<DeployedAgents<'_>, LearnError> {
        export::deployed(self.measured(), self.config.network.subtask)
    }

    fn words(&self) -> Words {
        let Config { network, returns, replay, allocation, .. } = &self.config;
        let allocator = match &self.allocator {
            None => String::new(),
            Some(_) => format!(
                "The allocator values every team at every open building by a network of the same kind and takes the\n\
                 best allocation; a team has at most {} agents.\n\n",
                allocation.team_max
            ),
        };
        let mut departures = export::skips(self.measured().network, self.team_values());
        departures += &format!(
            "- Utilities of a subtask's team are summed (VDN); there is no mixing network.\n\
             - It learns from records of one step and one subtask, with {}-step returns and discount {}.\n\
             - Adam with averaged weights; embedding width {}.\n",
            returns.steps, returns.discount, network.width,
        );
        if returns.shaping != 0.0 {
            departures += &format!(
                "- Potential shaping of {} per cell between an agent and its building, which leaves the best policy\n  \
                 as it is.\n",
                returns.shaping
            );
        }
        if replay.symmetries {
            departures += "- Sampled records are turned and mirrored at random.\n";
        }
        export::words(allocator, departures)
    }

    fn allocation(&self) -> &str {
        self.config.measured_allocation()
    }

    fn allocator_steps(&self) -> Option<[u64; 2]> {
        let config = &self.config.allocator;
        self.allocator.is_some().then_some([config.learns_from, config.decides_from])
    }

    /// Begins with the averaged weights of another run.
    fn take_over(&mut self, folder: &Path) -> Result<(), LearnError> {
        let learned = Learned::open(folder, self.observer.spec())?;
        let online = {
            let knowledge = self.agents.knowledge();
            MixedNetwork { utility: learned.network, ..knowledge.online.clone() }
        };
        let ours = self.agents.average.utility.shape();
        if ours != online.utility.shape() {
            let hint = ours.hint_to_become(online.utility.shape(), "network.skip");
            let reason = format!("`run.from` has agents of another shape{hint}");
            return Err(LearnError::Config(reason));
        }
        begin_with(&mut self.agents, &online);
        let (Some(learner), Some(network)) = (&mut self.allocator, &learned.team_values) else {
            return Ok(());
        };
        let ours = learner.average.shape();
        if ours != network.shape() {
            let hint = ours.hint_to_become(network.shape(), "allocator.network.skip");
            return Err(LearnError::Config(format!("`run.from` has another allocator{hint}")));
        }
        begin_with(learner, network);
        Ok(())
    }

    fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.value("due", &mut self.due)?;
        state.value("picks", &mut self.picks)?;
        self.rollout.state(state)?;
        let Self { config, agents, allocator, observer, .. } = self;
        agents_state(agents, state)?;
        let (capacity, lag) = (config.replay.capacity, lag(config));
        if state.is_reading() && !agents.knowledge().replay.fits(capacity, lag, observer.spec()) {
            return Err(misfit("replay"));
        }
        let Some(learner) = allocator else { return Ok(()) };
        allocator_state(learner, state)?;
        if state.is_reading() && !learner.knowledge().replay.fits(config.allocator.replay.capacity)
        {
            return Err(misfit("allocator's replay"));
        }
        Ok(())
    }
}

fn misfit(what: &str) -> LearnError {
    LearnError::Config(format!("the checkpoint's {what} does not fit train.toml"))
}

/// A learner whose networks are all the same.
fn begin_with<L: Loss>(learner: &mut Learner<L>, network: &L::Network) {
    learner.average = network.clone();
    let mut knowledge = learner.knowledge_mut();
    (knowledge.target, knowledge.online) = (network.clone(), network.clone());
}

/// Names the agents' networks, their mixers, their optimiser and what they have seen.
fn agents_state(learner: &mut Learner<Chunk>, state: &mut State<'_>) -> Result<(), LearnError> {
    let shape = learner.average.utility.shape();
    let (tensors, utilities) = (tensors(shape), shape.parameters());
    let (mut adam, mut average) = (learner.adam.clone(), learner.average.clone());
    {
        let mut knowledge = learner.knowledge_mut();
        let Knowledge { online, target, replay, .. } = &mut *knowledge;
        for (name, network) in [("online", online), ("target", target), ("average", &mut average)] {
            let MixedNetwork { utility, mixer } = network;
            state.tensors(&format!("agents/{name}"), &tensors, utility.parameters_mut())?;
            let mut parameters = mixer.parameters().to_vec();
            state.value(&format!("mixer/{name}"), &mut parameters)?;
            let read = Mixer::from_parameters(mixer.shape(), parameters);
            *mixer = read.ok_or_else(|| misfit("mixer"))?;
        }
        state.value("records", replay)?;
    }
    for (name, vector) in [("mean", &mut adam.mean), ("square", &mut adam.square)] {
        let (own, mixer) = vector.split_at_mut(utilities);
        state.tensors(&format!("agents/adam-{name}"), &tensors, own)?;
        let mut numbers = mixer.to_vec();
        state.value(&format!("mixer/adam-{name}"), &mut numbers)?;
        if numbers.len() != mixer.len() {
            return Err(misfit("mixer"));
        }
        mixer.copy_from_slice(&numbers);
    }
    state.value("agents/adam-steps", &mut adam.steps)?;
    (learner.adam, learner.average) = (adam, average);
    Ok(())
}

/// The same of the allocator.
fn allocator_state(
    learner: &mut Learner<TeamValueLoss>,
    state: &mut State<'_>,
) -> Result<(), LearnError> {
    let tensors = tensors(learner.average.shape());
    let (mut adam, mut average) = (learner.adam.clone(), learner.average.clone());
    {
        let mut knowledge = learner.knowledge_mut();
        let Knowledge { online, target, replay, .. } = &mut *knowledge;
        for (name, network) in [("online", online), ("target", target), ("average", &mut average)] {
            state.tensors(&format!("allocator/{name}"), &tensors, network.parameters_mut())?;
        }
        state.value("segments", replay)?;
    }
    state.tensors("allocator/adam-mean", &tensors, &mut adam.mean)?;
    state.tensors("allocator/adam-square", &tensors, &mut adam.square)?;
    state.value("allocator/adam-steps", &mut adam.steps)?;
    (learner.adam, learner.average) = (adam, average);
    Ok(())
}

/// The learner of the agents, before its first update.
pub fn agents_learner(config: &Config, observer: &Observer, seed: u64) -> Learner<Chunk> {
    let (shape, inputs) = (config.network.shape(observer.spec()), config.network.active_inputs);
    let mut weights = generator(seed, Purpose::Weights, 0);
    let online = MixedNetwork {
        utility: UtilityNetwork::initialise(shape, inputs, &mut weights),
        mixer: Mixer::initialise(config.mixer.shape(shape.input), inputs, &mut weights),
    };
    let replay = Replay::new(config.replay.capacity, lag(config), observer.spec());
    let seen = (replay, observer.clone());
    let loss = Chunk::new(&online, config.network.subtask, config.mixer.reward_factor());
    Learner::new((&config.replay, &config.optimiser), online, seen, &loss)
}

/// How many moments a record reaches back.
fn lag(config: &Config) -> u64 {
    Returns::from(&config.returns).lag(config.environment.instances)
}

/// The learner of the allocator, before its first update.
pub fn allocator_learner(
    config: &Config,
    observer: &Observer,
    seed: u64,
) -> Learner<TeamValueLoss> {
    let config = &config.allocator;
    let shape = config.shape(observer.spec());
    let mut weights = generator(seed, Purpose::Weights, ALLOCATOR_STREAM);
    let online = UtilityNetwork::initialise(shape, config.network.active_inputs, &mut weights);
    let seen = (Segments::new(config.replay.capacity), observer.clone());
    let loss = TeamValueLoss::new(shape);
    Learner::new((&config.replay, &config.optimiser), online, seen, &loss)
}
