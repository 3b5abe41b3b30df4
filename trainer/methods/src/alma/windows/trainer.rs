//! A training run of the preset `paper`: rounds of episodes, and as many updates of both levels.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_envs::save_the_city::ScenarioSet;
use sortie_nn::random::Generator;

use super::allocation::AllocationLevel;
use super::config::Config;
use super::deciding::ProposalAllocator;
use super::low_level::LowLevel;
use super::replay::Replay;
use super::rollout::{Decide, Rollout};
use super::sampling::{SampleShape, Shaping, cut_windows, draw_episodes};
use crate::alma::evaluate::{EvaluationPlan, NetworkTeam, NoSubtasks, evaluate};
use crate::alma::records::UtilityNetwork;
use crate::alma::records::config::{Allocation, EnvironmentConfig, ReturnsConfig};
use crate::alma::run::Run;
use sortie_learn::LearnError;
use sortie_learn::evaluate::Evaluation;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::{
    Counters, CurvePoint, Labels, Learning, Observer, Outcome, Progress, Rates, RunConfig,
    RunDescription, RunFolder, UpdateReport, learn,
};

/// Episodes since the run began, and when target networks were renewed last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub(super) struct Episodes {
    pub(super) played: u64,
    agents_copied: u64,
    critic_copied: u64,
}

/// A run that learns.
#[derive(Debug)]
pub struct Trainer {
    pub(super) description: RunDescription<Config>,
    pub(super) folder: RunFolder,
    pub(super) low_level: LowLevel,
    /// There is one if the run learns to allocate.
    pub(super) allocation: Option<AllocationLevel>,
    pub(super) rollout: Rollout,
    pub(super) replay: Replay,
    /// What every update draws.
    sample: SampleShape,
    /// Draws episodes, windows and everything that an update needs.
    pub(super) generator: Generator,
    pub(super) counters: Counters,
    pub(super) episodes: Episodes,
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
            trainer.take_over(Run::open(Path::new(&trainer.description.config.run.from))?)?;
        }
        Ok(trainer)
    }

    /// Begins with the agents of another run, of any preset.
    fn take_over(&mut self, run: Run) -> Result<(), LearnError> {
        let LowLevel { online, target, .. } = &mut self.low_level;
        let shape = |agents: &UtilityNetwork, unit: &[f32]| (agents.shape(), unit.len());
        if shape(&run.network, &run.memory_unit) != shape(&online.agents, &online.gru) {
            let hint = online.agents.shape().hint_to_become(run.network.shape(), "low_level.skip");
            let reason = format!("`run.from` has agents of another shape{hint}");
            return Err(LearnError::Config(reason));
        }
        (target.agents, target.gru) = (run.network.clone(), run.memory_unit.clone());
        (online.agents, online.gru) = (run.network, run.memory_unit);
        Ok(())
    }

    pub(super) fn start(
        description: RunDescription<Config>,
        folder: RunFolder,
    ) -> Result<Self, LearnError> {
        let RunDescription { config, seed, .. } = &description;
        let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
        let sizes = config.sizes(&set);
        let mut weights = generator(*seed, Purpose::Weights, 0);
        let mut low_level = LowLevel::new(config.low_level.clone(), sizes, &mut weights);
        if config.coach.enabled {
            low_level.add_coach(config.coach, &mut weights);
        }
        let learning = config.learns_allocator().then(|| config.allocation_learning(sizes));
        Ok(Self {
            rollout: Rollout::new(config, low_level.online.agents.shape(), *seed)?,
            allocation: learning.map(|learning| AllocationLevel::new(learning, *seed)),
            replay: Replay::new(config.learning.episodes),
            sample: SampleShape {
                windows: config.learning.windows,
                steps: config.learning.steps,
                agents: sizes.agents,
                tasks: sizes.tasks,
                shaping: Shaping::default(),
            },
            generator: generator(*seed, Purpose::Replay, 0),
            counters: Counters::new(config.run.evaluate_every),
            episodes: Episodes::default(),
            folder,
            refused: Vec::new(),
            low_level,
            description,
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

    /// Plays one episode in every environment and keeps them.
    fn play(&mut self) -> Result<(), LearnError> {
        let config = &self.description.config;
        let env_steps = self.counters.env_steps;
        let exploration = config.exploration.at(env_steps);
        let mut learned = self
            .allocation
            .as_ref()
            .map(|level| ProposalAllocator::new(level.networks(), config.allocation.proposals));
        let mut rule = match config.allocation()? {
            Allocation::Rule(rule) => Some(rule),
            Allocation::Learned => None,
        };
        let allocator: Option<&mut dyn Decide> = if config.low_level.conditioning.has_subtasks() {
            match (&mut learned, &mut rule) {
                (Some(learned), _) => Some(learned),
                (None, rule) => rule.as_mut().map(|rule| rule as &mut dyn Decide),
            }
        } else {
            None
        };
        let counts = &mut self.counters.window.episodes;
        let agents = self.low_level.players();
        let episodes = self.rollout.round(agents, allocator, exploration, env_steps, counts)?;
        for episode in episodes {
            self.counters.env_steps += episode.steps() as u64;
            self.replay.push(episode);
        }
        Ok(())
    }

    /// One update of each level that has enough to learn from.
    fn update(&mut self) -> Result<(), LearnError> {
        let RunDescription { config, threads, .. } = &self.description;
        let threads = *threads;
        let (now, sample) = (self.counters.env_steps, self.sample);
        let generator = &mut self.generator;
        let window = &mut self.counters.window;
        let drawn = if config.low_level.frozen {
            None
        } else {
            draw_episodes(&self.replay, sample.windows, generator, |_| true)
        };
        if let Some(drawn) = drawn {
            let ReturnsConfig { shaping: cell, discount, .. } = config.low_level.returns;
            let shaped = SampleShape { shaping: Shaping { cell, discount }, ..sample };
            let windows = cut_windows(&self.replay, &drawn, shaped, generator);
            let report = self.low_level.learn(&windows, threads, generator);
            let report = UpdateReport { loss: report.loss, gradient_norm: report.gradient_norm };
            window.agents.add(report.finite("agents", now)?);
        }
        let Some(allocation) = &mut self.allocation else { return Ok(()) };
        let recent = |added: u64| now - added <= config.allocation.oldest;
        let drawn = draw_episodes(&self.replay, sample.windows, generator, |e| recent(e.added));
        if let Some(drawn) = drawn {
            let windows = cut_windows(&self.replay, &drawn, sample, generator);
            if let Some(report) = allocation.learn(&windows, now, generator, threads) {
                let (loss, gradient_norm) = (report.critic_loss, report.critic_norm);
                let report = UpdateReport { loss, gradient_norm };
                window.allocator.add(report.finite("allocator", now)?);
            }
        }
        Ok(())
    }

    /// Renews target networks whose time has come.
    fn copy_targets(&mut self) {
        let learning = &self.description.config.learning;
        let Episodes { played, agents_copied, critic_copied } = &mut self.episodes;
        if *played >= *agents_copied + learning.copy_agents_every {
            *agents_copied = *played;
            self.low_level.copy_target();
        }
        if *played >= *critic_copied + learning.copy_critic_every {
            *critic_copied = *played;
            self.allocation.iter_mut().for_each(AllocationLevel::copy_target);
        }
    }

    /// Measures what has been learned up to now.
    pub fn measure(&self, episodes: usize, seed: u64) -> Result<Evaluation, LearnError> {
        let config = &self.description.config;
        let plan = EvaluationPlan {
            set: ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?,
            constants: config.environment.constants,
            interval: config.allocation.interval,
            episodes,
            seed,
        };
        let conditioning = config.low_level.conditioning;
        let mut team = NetworkTeam::conditioned(self.low_level.players(), conditioning);
        if !conditioning.has_subtasks() {
            return evaluate(&plan, &mut team, &mut NoSubtasks);
        }
        match (config.allocation()?, &self.allocation) {
            (Allocation::Learned, Some(level)) => {
                let proposals = config.allocation.proposals;
                let mut allocator = ProposalAllocator::new(level.networks(), proposals);
                evaluate(&plan, &mut team, &mut allocator)
            }
            (Allocation::Rule(mut rule), _) => evaluate(&plan, &mut team, &mut rule),
            (Allocation::Learned, None) => {
                Err(LearnError::Config("the run learns no allocator".to_owned()))
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
            title: format!("{method} as published on {name} {set}, seed {seed}"),
            environment: format!("{name}/{set}"),
            allocation: config.measured_allocation().to_owned(),
            seed: *seed,
        }
    }

    fn rates(&self) -> Rates {
        let (config, now) = (&self.description.config, self.counters.env_steps);
        Rates {
            epsilon: config.exploration.at(now).actions,
            learning_rate: config.low_level.learning_rate,
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

    /// One round of episodes, then the updates of each level for every one of them.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        self.play()?;
        let instances = self.description.config.environment.instances;
        let updates = self.description.config.learning.updates;
        for _ in 0..instances {
            (0..updates).try_for_each(|_| self.update())?;
            self.copy_targets();
        }
        self.episodes.played += instances as u64;
        let env_steps_total = self.description.config.run.steps;
        observer.progress(&Progress { env_steps: self.counters.env_steps, env_steps_total });
        Ok(())
    }

    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        self.write_checkpoint(observer)
    }
}
