//! A training run from its first step to its last, or from where it was stopped.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{ACTIONS, AllocationRule, ScenarioSet};

use super::conditioning::Conditioning;
use super::learner::{Knowledge, Learner};
use super::replay::{RecordLayout, Replay};
use super::rollout::{EpisodeCounts, InstanceSnapshot, Rollout};
use super::utility::UtilityNetwork;
use crate::error::LearnError;
use crate::evaluate::{Evaluation, EvaluationPlan, NetworkTeam, evaluate};
use crate::methods::alma::Config;
use crate::random::{Generator, Purpose, generator};
use crate::run::{CurvePoint, RunDescription, RunFolder, checkpoint};
use crate::schedule::linear;

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
    /// Loss of the last update; 0 before the first.
    pub loss: f64,
}

/// How a call of [`Trainer::run`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All steps were taken.
    Finished,
    /// The stop flag was set; a checkpoint was written.
    Stopped,
}

/// Sums since the last evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Window {
    updates: u64,
    loss: f64,
    gradient_norm: f64,
    episodes: EpisodeCounts,
}

/// Counters that a checkpoint holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Counters {
    env_steps: u64,
    updates: u64,
    next_update: u64,
    next_evaluation: u64,
    wall_s: f64,
    cpu_s: f64,
    window: Window,
    curve: Vec<CurvePoint>,
}

/// A checkpoint's state as it is written: the replay is borrowed, for it is large.
#[derive(Serialize)]
struct StateRef<'a> {
    counters: &'a Counters,
    adam_steps: u64,
    picks: &'a Generator,
    instances: Vec<InstanceSnapshot>,
    replay: &'a Replay,
}

/// A checkpoint's state as it is read.
#[derive(Deserialize)]
struct State {
    counters: Counters,
    adam_steps: u64,
    picks: Generator,
    instances: Vec<InstanceSnapshot>,
    replay: Replay,
}

/// A run that learns.
#[derive(Debug)]
pub struct Trainer {
    description: RunDescription,
    folder: RunFolder,
    learner: Learner,
    rollout: Rollout,
    picks: Generator,
    counters: Counters,
    /// Why newer checkpoints were passed over when the run was resumed.
    refused: Vec<String>,
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
        let set = ScenarioSet::named(&description.config.environment.set)?;
        let replay = Replay::new(
            description.config.replay.capacity,
            RecordLayout::new(Conditioning::Mask, &set),
        );
        let trainer = Self::start(description, folder, replay)?;
        RunFolder::create(folder, &trainer.description)?;
        Ok(trainer)
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped.
    ///
    /// `threads` may differ from before; it changes no result. `None` takes as many as before.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, LearnError> {
        let files = RunFolder::new(folder);
        let mut description = files.read_description()?;
        description.threads = threads.unwrap_or(description.threads).max(1);
        let found = files.checkpoints().newest(checkpoint::OpenFor::Resume)?;
        let state: State = found.checkpoint.state()?;
        let misfit =
            |what: &str| LearnError::format(folder, format!("{what} does not fit train.toml"));
        if found.checkpoint.shape() != description.config.network.shape(ACTIONS) {
            return Err(misfit("the checkpoint's network"));
        }
        let set = ScenarioSet::named(&description.config.environment.set)?;
        if !state
            .replay
            .fits(description.config.replay.capacity, RecordLayout::new(Conditioning::Mask, &set))
        {
            return Err(misfit("the checkpoint's replay"));
        }

        let mut trainer = Self::start(description, folder, state.replay)?;
        trainer.rollout.restore(state.instances)?;
        trainer.picks = state.picks;
        trainer.counters = state.counters;
        trainer.learner.average = found.checkpoint.network("average")?;
        trainer.learner.adam.mean = found.checkpoint.vector("adam-mean")?;
        trainer.learner.adam.square = found.checkpoint.vector("adam-square")?;
        trainer.learner.adam.steps = state.adam_steps;
        let mut knowledge = trainer.learner.knowledge_mut();
        knowledge.online = found.checkpoint.network("online")?;
        knowledge.target = found.checkpoint.network("target")?;
        drop(knowledge);
        trainer.refused = found.refused;
        Ok(trainer)
    }

    fn start(
        description: RunDescription,
        folder: &Path,
        replay: Replay,
    ) -> Result<Self, LearnError> {
        let RunDescription { config, seed, threads, .. } = &description;
        let shape = config.network.shape(ACTIONS);
        let mut weights = generator(*seed, Purpose::Weights, 0);
        let online = UtilityNetwork::initialise(shape, config.network.active_inputs, &mut weights);
        let rollout = Rollout::new(config, shape, *seed)?;
        let learner = Learner::new(config, online, replay, *threads);
        Ok(Self {
            picks: generator(*seed, Purpose::Replay, 0),
            counters: Counters {
                next_evaluation: config.run.evaluate_every,
                ..Counters::default()
            },
            folder: RunFolder::new(folder),
            learner,
            rollout,
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

    /// The averaged weights: what is measured and shipped.
    pub fn network(&self) -> &UtilityNetwork {
        &self.learner.average
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
        Ok(Outcome::Finished)
    }

    /// One step in every instance, and the updates that are due.
    fn step(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let config = &self.description.config;
        let counters = &mut self.counters;
        let epsilon = epsilon(config, counters.env_steps);
        {
            let mut knowledge = self.learner.knowledge_mut();
            let Knowledge { online, replay, .. } = &mut *knowledge;
            self.rollout.step(online, epsilon, replay, &mut counters.window.episodes)?;
        }
        counters.env_steps += self.rollout.instances() as u64;
        let warm = self.learner.knowledge().replay.len() >= config.replay.warm_up;
        let mut loss = 0.0;
        while counters.next_update <= counters.env_steps {
            counters.next_update += config.replay.steps_per_update;
            if warm {
                let report = self.learner.update(&mut self.picks, counters.env_steps);
                counters.updates += 1;
                counters.window.updates += 1;
                counters.window.loss += report.loss;
                counters.window.gradient_norm += f64::from(report.gradient_norm);
                loss = report.loss;
            }
        }
        let env_steps_total = config.run.steps;
        observer.progress(&Progress { env_steps: counters.env_steps, env_steps_total, loss });
        Ok(())
    }

    /// Measures the averaged weights and adds a point to the curve.
    fn evaluate(&mut self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let config = &self.description.config;
        let plan = EvaluationPlan {
            set: ScenarioSet::named(&config.environment.set)?,
            constants: config.environment.constants,
            interval: config.allocation.interval,
            episodes: config.run.evaluate_episodes,
            // Counted from the top, so that ordinary seeds remain fresh for later evaluations.
            seed: u64::MAX - self.description.seed,
        };
        let mut team = NetworkTeam::new(&self.learner.average);
        let result = evaluate(&plan, &mut team, &mut AllocationRule::Coordinated)?;
        let point = self.point(&result);
        observer.evaluated(&point);
        self.counters.curve.push(point);
        self.counters.window = Window::default();
        self.folder.write_curve(&self.title(), &self.counters.curve)
    }

    fn point(&self, result: &Evaluation) -> CurvePoint {
        let Counters { env_steps, updates, wall_s, cpu_s, window, .. } = self.counters;
        let mean = |sum: f64, count: u64| if count == 0 { 0.0 } else { sum / count as f64 };
        CurvePoint {
            env_steps,
            updates,
            wall_s,
            cpu_s,
            success: result.success,
            success_ci95: result.success_ci95,
            timeouts: result.timeouts,
            return_mean: result.return_mean,
            length_mean: result.length_mean,
            episodes: result.episodes,
            loss: mean(window.loss, window.updates),
            gradient_norm: mean(window.gradient_norm, window.updates),
            epsilon: epsilon(&self.description.config, env_steps),
            learning_rate: self.learner.learning_rate(env_steps),
            training_success: mean(window.episodes.solved as f64, window.episodes.episodes),
        }
    }

    fn title(&self) -> String {
        let RunDescription { method, seed, config, .. } = &self.description;
        format!("{method} on {} {}, seed {seed}", config.environment.name, config.environment.set)
    }

    fn save(&self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let knowledge = self.learner.knowledge();
        let adam = &self.learner.adam;
        let vectors = [
            ("online", knowledge.online.parameters()),
            ("target", knowledge.target.parameters()),
            ("average", self.learner.average.parameters()),
            ("adam-mean", &adam.mean),
            ("adam-square", &adam.square),
        ];
        let state = StateRef {
            counters: &self.counters,
            adam_steps: adam.steps,
            picks: &self.picks,
            instances: self.rollout.snapshot(),
            replay: &knowledge.replay,
        };
        let shape = knowledge.online.shape();
        let place: PathBuf =
            self.folder.checkpoints().write(self.counters.env_steps, shape, &vectors, &state)?;
        observer.saved(&place);
        Ok(())
    }
}

fn epsilon(config: &Config, env_steps: u64) -> f32 {
    let exploration = &config.exploration;
    linear(exploration.start, exploration.end, exploration.steps, env_steps)
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
