//! A training run from its first step to its last, or from where it was stopped.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use sortie_envs::save_the_city::ScenarioSet;

use super::config::{Allocation, Config};
use super::learner::{Knowledge, Learner};
use super::mixed_network::MixedNetwork;
use super::mixer::Mixer;
use super::replay::{RecordLayout, Replay};
use super::rollout::{Behaviour, Memory, Rollout};
use super::saved::{Counters, Level};
use super::team_value::{Segments, TeamValueAllocator, TeamValueLoss};
use super::temporal_difference::Chunk;
use super::utility::UtilityNetwork;
use crate::error::LearnError;
use crate::evaluate::{Evaluation, EvaluationPlan, NetworkTeam, NoSubtasks, evaluate};
use crate::random::{Generator, Purpose, generator};
use crate::run::{CurvePoint, Run, RunDescription, RunFolder, RunResult};
use crate::workers::Workers;

/// Tells the allocator's streams of random numbers from the agents'.
const ALLOCATOR_STREAM: u64 = 1;
/// The episodes that every run reports on in the end: the same for all runs, seen by none.
const REPORT_SEED: u64 = 2_000_000;

/// Is told how a run goes.
pub trait Observer {
    /// Some steps were taken; called several hundred times a second.
    fn progress(&mut self, progress: &Progress) {
        let _ = progress;
    }

    /// An evaluation was made.
    fn evaluated(&mut self, point: &CurvePoint) {
        let _ = point;
    }

    /// A checkpoint was written.
    fn saved(&mut self, checkpoint: &Path) {
        let _ = checkpoint;
    }

    /// The run has ended and was measured on fresh episodes.
    fn finished(&mut self, result: &RunResult) {
        let _ = result;
    }
}

/// Listens to nothing.
impl Observer for () {}

/// How far a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Environment steps taken.
    pub env_steps: u64,
    /// Environment steps of the whole run.
    pub env_steps_total: u64,
}

/// How a call of [`Trainer::run`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps were taken.
    Finished,
    /// The stop flag was set; a checkpoint was written.
    Stopped,
}

/// A run that learns.
#[derive(Debug)]
pub struct Trainer {
    pub(super) description: RunDescription,
    pub(super) folder: RunFolder,
    pub(super) agents: Learner<Chunk>,
    /// There is one if the run learns an allocator.
    pub(super) allocator: Option<Learner<TeamValueLoss>>,
    workers: Workers,
    pub(super) rollout: Rollout,
    /// What each level draws its samples with.
    pub(super) picks: Level<Generator>,
    pub(super) counters: Counters,
    /// Why newer checkpoints were passed over when the run was resumed.
    pub(super) refused: Vec<String>,
}

impl Trainer {
    /// Begins a run in a new folder.
    pub fn new(
        config: Config,
        seed: u64,
        threads: usize,
        folder: &Path,
    ) -> Result<Self, LearnError> {
        config.check()?;
        let description = RunDescription::new(config, seed, threads.max(1));
        let mut trainer = Self::start(description, folder)?;
        if !trainer.description.config.run.from.is_empty() {
            trainer.take_over(&Run::open(Path::new(&trainer.description.config.run.from))?)?;
        }
        RunFolder::create(folder, &trainer.description)?;
        Ok(trainer)
    }

    /// Begins with the averaged weights of another run.
    fn take_over(&mut self, run: &Run) -> Result<(), LearnError> {
        let mut knowledge = self.agents.knowledge_mut();
        let online = MixedNetwork { utility: run.network.clone(), ..knowledge.online.clone() };
        if online.utility.shape() != knowledge.online.utility.shape() {
            return Err(LearnError::Config("`run.from` has agents of another shape".to_owned()));
        }
        (knowledge.target, knowledge.online) = (online.clone(), online.clone());
        drop(knowledge);
        self.agents.average = online;
        let (Some(learner), Some(network)) = (&mut self.allocator, &run.allocator) else {
            return Ok(());
        };
        let mut knowledge = learner.knowledge_mut();
        if network.shape() != knowledge.online.shape() {
            return Err(LearnError::Config("`run.from` has another allocator".to_owned()));
        }
        (knowledge.target, knowledge.online) = (network.clone(), network.clone());
        drop(knowledge);
        learner.average = network.clone();
        Ok(())
    }

    pub(super) fn start(description: RunDescription, folder: &Path) -> Result<Self, LearnError> {
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
            counters: Counters::new(config),
            folder: RunFolder::new(folder),
            description,
            refused: Vec::new(),
        })
    }

    /// How the run learns.
    pub fn description(&self) -> &RunDescription {
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
        let mut clock = Clock::start();
        let minutes = self.description.config.run.checkpoint_minutes.max(0.0);
        let pause = Duration::try_from_secs_f64(60.0 * minutes).unwrap_or(Duration::MAX);
        let mut saved = Instant::now();
        while self.counters.env_steps < self.description.config.run.steps {
            if stop.load(Ordering::Relaxed) {
                clock.add_to(&mut self.counters);
                self.save(observer)?;
                return Ok(Outcome::Stopped);
            }
            self.step(observer)?;
            if self.counters.env_steps >= self.counters.next_evaluation {
                clock.add_to(&mut self.counters);
                self.counters.next_evaluation += self.description.config.run.evaluate_every;
                self.evaluate(observer)?;
            }
            if saved.elapsed() >= pause {
                clock.add_to(&mut self.counters);
                self.save(observer)?;
                saved = Instant::now();
            }
        }
        clock.add_to(&mut self.counters);
        if self.counters.curve.last().is_none_or(|p| p.env_steps < self.counters.env_steps) {
            self.evaluate(observer)?;
        }
        self.save(observer)?;
        self.report(observer)?;
        Ok(Outcome::Finished)
    }

    /// One step in every instance, and the updates that are due.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        self.act()?;
        self.counters.env_steps += self.rollout.instances() as u64;
        while self.counters.updates_due() {
            self.update();
        }
        let env_steps_total = self.description.config.run.steps;
        observer.progress(&Progress { env_steps: self.counters.env_steps, env_steps_total });
        Ok(())
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
    fn update(&mut self) {
        let config = &self.description.config;
        let (now, end) = (self.counters.env_steps, config.run.steps);
        let due = self.counters.take_due(config);
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
            window.agents.add(self.agents.follow(rate));
        }
        if let Some(learner) = allocator {
            let rate = config.allocator.optimiser.learning_rate_at(now, end);
            window.allocator.add(learner.follow(rate));
        }
    }

    /// So many episodes in the world of this run.
    fn plan(&self, episodes: usize, seed: u64) -> Result<EvaluationPlan, LearnError> {
        let config = &self.description.config;
        Ok(EvaluationPlan {
            set: ScenarioSet::named(&config.environment.set)?,
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
        let mut team = NetworkTeam::conditioned(self.network(), network.subtask);
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

    /// Adds a point to the curve.
    fn evaluate(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let episodes = self.description.config.run.evaluate_episodes;
        // Counted from the top, so that ordinary seeds remain fresh for later evaluations.
        let result = self.measure(episodes, u64::MAX - self.description.seed)?;
        let point = self.point(&result);
        observer.evaluated(&point);
        self.counters.add_point(point);
        self.folder.write_curve(&self.title(), &self.counters.curve)
    }

    /// Measures the finished run on episodes that no run uses before its end.
    fn report(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let config = &self.description.config;
        let Config { environment, run, .. } = config;
        if run.final_episodes == 0 {
            return Ok(());
        }
        let result = RunResult {
            env: format!("{}/{}", environment.name, environment.set),
            allocation: config.measured_allocation().to_owned(),
            seed: REPORT_SEED,
            evaluation: self.measure(run.final_episodes, REPORT_SEED)?,
        };
        self.folder.write_result(&result)?;
        observer.finished(&result);
        Ok(())
    }

    fn point(&self, result: &Evaluation) -> CurvePoint {
        let config = &self.description.config;
        let Counters { env_steps, updates, decisions, wall_s, cpu_s, window, .. } = &self.counters;
        let episodes = &window.episodes;
        CurvePoint {
            env_steps: *env_steps,
            updates: updates.agents + window.agents.updates,
            decisions: decisions + episodes.decisions,
            wall_s: *wall_s,
            cpu_s: *cpu_s,
            allocation: config.measured_allocation().to_owned(),
            success: result.success,
            success_ci95: result.success_ci95,
            timeouts: result.timeouts,
            none_burned: result.none_burned,
            return_mean: result.return_mean,
            length_mean: result.length_mean,
            episodes: result.episodes,
            loss: window.agents.mean_loss(),
            gradient_norm: window.agents.mean_gradient_norm(),
            allocator_updates: updates.allocator + window.allocator.updates,
            allocator_loss: window.allocator.mean_loss(),
            epsilon: config.exploration.epsilon_at(*env_steps),
            learning_rate: config.optimiser.learning_rate_at(*env_steps, config.run.steps),
            training_success: episodes.solved as f64 / episodes.episodes.max(1) as f64,
        }
    }

    fn title(&self) -> String {
        let RunDescription { method, seed, config, .. } = &self.description;
        format!("{method} on {} {}, seed {seed}", config.environment.name, config.environment.set)
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
    let set = ScenarioSet::named(&config.environment.set)?;
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

/// Wall and processor time since the last reading.
struct Clock {
    wall: Instant,
    cpu_s: f64,
}

impl Clock {
    fn start() -> Self {
        Self { wall: Instant::now(), cpu_s: process_cpu_s() }
    }

    fn add_to(&mut self, counters: &mut Counters) {
        let now = Self::start();
        counters.wall_s += (now.wall - self.wall).as_secs_f64();
        counters.cpu_s += now.cpu_s - self.cpu_s;
        *self = now;
    }
}

/// Processor time of all threads of this process.
fn process_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
