//! A training run from its first step to its last, or from where it was stopped.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use sortie_envs::save_the_city::ScenarioSet;
use sortie_nn::random::Generator;
use sortie_nn::workers::Workers;

use super::config::{Allocation, Config, EnvironmentConfig};
use super::learner::{Knowledge, Learner};
use super::mixed_network::MixedNetwork;
use super::mixer::Mixer;
use super::replay::{RecordLayout, Replay};
use super::rollout::{Behaviour, Memory, Rollout};
use super::saved::Due;
use super::team_value::{Segments, TeamValueAllocator, TeamValueLoss};
use super::temporal_difference::Chunk;
use super::utility::UtilityNetwork;
use crate::alma::evaluate::{Agents, EvaluationPlan, NetworkTeam, NoSubtasks, evaluate};
use crate::alma::run::{Run, RunAllocator};
use sortie_learn::LearnError;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{
    Counters, CurvePoint, Labels, Learning, Level, Observer, Outcome, Progress, Rates, RunConfig,
    RunDescription, RunFolder, learn,
};

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;
/// A run that learns.
#[derive(Debug)]
pub struct Trainer {
    pub(super) description: RunDescription<Config>,
    pub(super) folder: RunFolder,
    pub(super) agents: Learner<Chunk>,
    /// There is one if the run learns an allocator.
    pub(super) allocator: Option<Learner<TeamValueLoss>>,
    workers: Workers,
    pub(super) rollout: Rollout,
    /// What each level draws its samples with.
    pub(super) picks: Level<Generator>,
    pub(super) counters: Counters,
    pub(super) due: Due,
    /// Why newer checkpoints were passed over when the run was resumed.
    pub(super) refused: Vec<String>,
}

impl Trainer {
    /// Begins a run in a new folder.
    pub fn new(
        mut config: Config,
        seed: u64,
        threads: usize,
        folder: &Path,
    ) -> Result<Self, LearnError> {
        config.check()?;
        config.run.settle_products()?;
        let description = RunDescription::new(config, seed, threads.max(1));
        let mut trainer = Self::begin(description, RunFolder::new(folder))?;
        trainer.folder.create(&trainer.description)?;
        Ok(trainer)
    }

    /// A run before its first step.
    pub(super) fn begin(
        description: RunDescription<Config>,
        folder: RunFolder,
    ) -> Result<Self, LearnError> {
        let mut trainer = Self::start(description, folder)?;
        if !trainer.description.config.run.from.is_empty() {
            trainer.take_over(&Run::open(Path::new(&trainer.description.config.run.from))?)?;
        }
        Ok(trainer)
    }

    /// Begins with the averaged weights of another run.
    fn take_over(&mut self, run: &Run) -> Result<(), LearnError> {
        let mut knowledge = self.agents.knowledge_mut();
        let online = MixedNetwork { utility: run.network.clone(), ..knowledge.online.clone() };
        let (ours, theirs) = (knowledge.online.utility.shape(), online.utility.shape());
        if ours != theirs {
            let hint = ours.hint_to_become(theirs, "network.skip");
            let reason = format!("`run.from` has agents of another shape{hint}");
            return Err(LearnError::Config(reason));
        }
        (knowledge.target, knowledge.online) = (online.clone(), online.clone());
        drop(knowledge);
        self.agents.average = online;
        let (Some(learner), Some(RunAllocator::TeamValue(network))) =
            (&mut self.allocator, &run.allocator)
        else {
            return Ok(());
        };
        let mut knowledge = learner.knowledge_mut();
        let (ours, theirs) = (knowledge.online.shape(), network.shape());
        if ours != theirs {
            let hint = ours.hint_to_become(theirs, "allocator.network.skip");
            return Err(LearnError::Config(format!("`run.from` has another allocator{hint}")));
        }
        (knowledge.target, knowledge.online) = (network.clone(), network.clone());
        drop(knowledge);
        learner.average = network.clone();
        Ok(())
    }

    pub(super) fn start(
        description: RunDescription<Config>,
        folder: RunFolder,
    ) -> Result<Self, LearnError> {
        let RunDescription { config, seed, threads, .. } = &description;
        let agents = agents_learner(config, *seed)?;
        let allocator = config.learns_allocator().then(|| allocator_learner(config, *seed));
        let (act, allocate) = (agents.job(), allocator.as_ref().map(Learner::job));
        let job = Arc::new(move || {
            act();
            allocate.iter().for_each(|allocate| allocate());
        });
        Ok(Self {
            rollout: Rollout::new(config, config.agent_shape()?, *seed)?,
            workers: Workers::new(*threads, job),
            agents,
            allocator,
            picks: Level {
                agents: generator(*seed, Purpose::Replay, 0),
                allocator: generator(*seed, Purpose::Replay, ALLOCATOR_STREAM),
            },
            counters: Counters::new(config.run.evaluate_every),
            due: Due::default(),
            folder,
            description,
            refused: Vec::new(),
        })
    }

    /// How the run learns.
    pub fn description(&self) -> &RunDescription<Config> {
        &self.description
    }

    /// The evaluations up to now.
    pub fn curve(&self) -> &[CurvePoint] {
        &self.counters.curve
    }

    /// Why newer checkpoints were passed over when the run was resumed.
    pub fn refused(&self) -> &[String] {
        &self.refused
    }

    /// The agents' averaged weights: what is measured and shipped.
    pub fn network(&self) -> &UtilityNetwork {
        &self.agents.average.utility
    }

    /// The allocator's averaged weights, if the run learns one.
    pub fn allocator(&self) -> Option<&UtilityNetwork> {
        self.allocator.as_ref().map(|learner| &learner.average)
    }

    /// Environment steps taken.
    pub fn env_steps(&self) -> u64 {
        self.counters.env_steps
    }

    /// Learns until all steps are taken or `stop` is set, and writes a checkpoint at the end.
    pub fn run(
        &mut self,
        observer: &mut dyn Observer,
        stop: &AtomicBool,
    ) -> Result<Outcome, LearnError> {
        learn(self, observer, stop)
    }

    fn act(&mut self) -> Result<(), LearnError> {
        let Config { exploration, allocator: config, .. } = &self.description.config;
        let env_steps = self.counters.env_steps;
        let mut agents = self.agents.knowledge_mut();
        let Knowledge { online, replay, .. } = &mut *agents;
        let mut allocator = self.allocator.as_mut().map(Learner::knowledge_mut);
        let (mut network, mut segments) = (None, None);
        if let Some(allocator) = &mut allocator {
            let Knowledge { online, replay, .. } = &mut **allocator;
            network = (env_steps >= config.decides_from).then_some(&*online);
            segments = (env_steps >= config.learns_from).then_some(replay);
        }
        let epsilon = exploration.epsilon_at(env_steps);
        let behaviour = Behaviour { agents: &online.utility, epsilon, allocator: network };
        let memory = Memory { records: replay, segments };
        self.rollout.step(behaviour, memory, &mut self.counters.window.episodes)
    }

    /// One update of each level that is due and has enough to learn from, both at the same time.
    fn update(&mut self) -> Result<(), LearnError> {
        let config = &self.description.config;
        let (now, end) = (self.counters.env_steps, config.run.steps);
        let due = self.due.take(now, config);
        let learn_agents = due.agents && self.agents.is_warm();
        if learn_agents {
            self.agents.pick(&mut self.picks.agents);
        }
        let mut allocator =
            self.allocator.as_mut().filter(|learner| due.allocator && learner.is_warm());
        if let Some(learner) = &mut allocator {
            learner.pick(&mut self.picks.allocator);
        }
        self.workers.run();
        let window = &mut self.counters.window;
        if learn_agents {
            let rate = config.optimiser.learning_rate_at(now, end);
            window.agents.add(self.agents.follow(rate).finite("agents", now)?);
        }
        if let Some(learner) = allocator {
            let rate = config.allocator.optimiser.learning_rate_at(now, end);
            window.allocator.add(learner.follow(rate).finite("allocator", now)?);
        }
        Ok(())
    }

    /// So many episodes in the world of this run.
    fn plan(&self, episodes: usize, seed: u64) -> Result<EvaluationPlan, LearnError> {
        let config = &self.description.config;
        Ok(EvaluationPlan {
            set: ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?,
            constants: config.environment.constants,
            interval: config.allocation.interval,
            episodes,
            seed,
        })
    }

    /// Measures the averaged weights of both levels.
    pub fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation, LearnError> {
        let plan = self.plan(episodes, seed)?;
        let Config { network, allocation: config, .. } = &self.description.config;
        let agents = Agents::new(self.network());
        let mut team = NetworkTeam::conditioned(agents, network.subtask);
        if !network.subtask.has_subtasks() {
            return evaluate(&plan, &mut team, &mut NoSubtasks);
        }
        match (config.measured(), self.allocator()) {
            (Allocation::Rule(mut rule), _) => evaluate(&plan, &mut team, &mut rule),
            (Allocation::Learned, network) => {
                let network = network
                    .ok_or_else(|| LearnError::Config("the run learns no allocator".to_owned()))?;
                let mut allocator = TeamValueAllocator::new(network, config.team_max);
                evaluate(&plan, &mut team, &mut allocator)
            }
        }
    }
}

impl Learning for Trainer {
    fn schedule(&self) -> RunConfig {
        self.description.config.run.clone()
    }

    fn labels(&self) -> Labels {
        let RunDescription { method, seed, config, .. } = &self.description;
        let EnvironmentConfig { name, set, .. } = &config.environment;
        Labels {
            title: format!("{method} on {name} {set}, seed {seed}"),
            environment: format!("{name}/{set}"),
            allocation: config.measured_allocation().to_owned(),
            seed: *seed,
        }
    }

    fn rates(&self) -> Rates {
        let (config, now) = (&self.description.config, self.counters.env_steps);
        Rates {
            epsilon: config.exploration.epsilon_at(now),
            learning_rate: config.optimiser.learning_rate_at(now, config.run.steps),
        }
    }

    fn folder(&mut self) -> &mut RunFolder {
        &mut self.folder
    }

    fn counters(&mut self) -> &mut Counters {
        &mut self.counters
    }

    fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation, LearnError> {
        Self::measure(self, episodes, seed)
    }

    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        self.act()?;
        self.counters.env_steps += self.rollout.instances() as u64;
        while self.due.any(self.counters.env_steps) {
            self.update()?;
        }
        let env_steps_total = self.description.config.run.steps;
        observer.progress(&Progress { env_steps: self.counters.env_steps, env_steps_total });
        Ok(())
    }

    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        self.write_checkpoint(observer)
    }
}

/// The learner of the agents, before its first update.
pub fn agents_learner(config: &Config, seed: u64) -> Result<Learner<Chunk>, LearnError> {
    let (shape, inputs) = (config.agent_shape()?, config.network.active_inputs);
    let mut weights = generator(seed, Purpose::Weights, 0);
    let online = MixedNetwork {
        utility: UtilityNetwork::initialise(shape, inputs, &mut weights),
        mixer: Mixer::initialise(config.mixer.shape(shape.input), inputs, &mut weights),
    };
    let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
    let layout = RecordLayout::new(config.network.subtask, &set);
    let replay = Replay::new(config.replay.capacity, layout);
    let loss = Chunk::new(&online, config.network.subtask, config.mixer.reward_factor());
    Ok(Learner::new((&config.replay, &config.optimiser), online, replay, &loss))
}

/// The learner of the allocator, before its first update.
pub fn allocator_learner(config: &Config, seed: u64) -> Learner<TeamValueLoss> {
    let config = &config.allocator;
    let mut weights = generator(seed, Purpose::Weights, ALLOCATOR_STREAM);
    let inputs = config.network.active_inputs;
    let online = UtilityNetwork::initialise(config.shape(), inputs, &mut weights);
    let replay = Segments::new(config.replay.capacity);
    let loss = TeamValueLoss::new(config.shape());
    Learner::new((&config.replay, &config.optimiser), online, replay, &loss)
}
