//! What a run counts, and how it is written to a checkpoint and read back.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{ACTIONS, ScenarioSet};

use super::config::Config;
use super::learner::{Learner, Loss, Parameters, UpdateReport};
use super::replay::Replay;
use super::rollout::{EpisodeCounts, InstanceSnapshot};
use super::team_value::Segments;
use super::trainer::{Observer, Trainer};
use super::utility::{UtilityNetwork, UtilityShape};
use crate::error::LearnError;
use crate::random::Generator;
use crate::run::checkpoint::{Checkpoint, OpenFor, SavedNetwork};
use crate::run::{CurvePoint, RunFolder};

/// One value for the agents and one for the allocator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Level<T> {
    pub(super) agents: T,
    pub(super) allocator: T,
}

/// Sums over the updates since the last evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Updates {
    pub(super) updates: u64,
    loss: f64,
    gradient_norm: f64,
}

impl Updates {
    pub(super) fn add(&mut self, report: UpdateReport) {
        self.updates += 1;
        self.loss += report.loss;
        self.gradient_norm += f64::from(report.gradient_norm);
    }

    pub(super) fn mean_loss(&self) -> f64 {
        self.loss / self.updates.max(1) as f64
    }

    pub(super) fn mean_gradient_norm(&self) -> f64 {
        self.gradient_norm / self.updates.max(1) as f64
    }
}

/// What happened since the last evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Window {
    pub(super) agents: Updates,
    pub(super) allocator: Updates,
    pub(super) episodes: EpisodeCounts,
}

/// Where a run is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Counters {
    pub(super) env_steps: u64,
    /// Optimiser steps and decisions before the window.
    pub(super) updates: Level<u64>,
    pub(super) decisions: u64,
    next_update: Level<u64>,
    pub(super) next_evaluation: u64,
    pub(super) wall_s: f64,
    pub(super) cpu_s: f64,
    pub(super) window: Window,
    pub(super) curve: Vec<CurvePoint>,
}

impl Counters {
    pub(super) fn new(config: &Config) -> Self {
        Self { next_evaluation: config.run.evaluate_every, ..Self::default() }
    }

    /// Whether a level has an update to make.
    pub(super) fn updates_due(&self) -> bool {
        self.next_update.agents.min(self.next_update.allocator) <= self.env_steps
    }

    /// Which levels have an update to make; they are taken to have made it.
    pub(super) fn take_due(&mut self, config: &Config) -> Level<bool> {
        let take = |next: &mut u64, pause: u64| {
            let due = *next <= self.env_steps;
            *next += if due { pause } else { 0 };
            due
        };
        Level {
            agents: take(&mut self.next_update.agents, config.replay.steps_per_update),
            allocator: take(
                &mut self.next_update.allocator,
                config.allocator.replay.steps_per_update,
            ),
        }
    }

    /// Closes the window: an evaluation was made.
    pub(super) fn add_point(&mut self, point: CurvePoint) {
        let Window { agents, allocator, episodes } = std::mem::take(&mut self.window);
        self.updates.agents += agents.updates;
        self.updates.allocator += allocator.updates;
        self.decisions += episodes.decisions;
        self.curve.push(point);
    }
}

/// A checkpoint's state as it is written: what is large is borrowed.
#[derive(Serialize)]
struct StateRef<'a> {
    counters: &'a Counters,
    adam_steps: Level<u64>,
    picks: &'a Level<Generator>,
    instances: Vec<InstanceSnapshot>,
    records: &'a Replay,
    segments: Option<&'a Segments>,
}

/// A checkpoint's state as it is read.
#[derive(Deserialize)]
struct State {
    counters: Counters,
    adam_steps: Level<u64>,
    picks: Level<Generator>,
    instances: Vec<InstanceSnapshot>,
    records: Replay,
    segments: Option<Segments>,
}

/// Names of the networks in a checkpoint.
const AGENTS: &str = "agents";
const ALLOCATOR: &str = "allocator";

impl Trainer {
    /// Writes a checkpoint.
    pub(super) fn save(&self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let agents = self.agents.knowledge();
        let allocator = self.allocator.as_ref().map(|learner| (learner, learner.knowledge()));
        let mut networks = vec![saved(AGENTS, &self.agents, [&agents.online, &agents.target])];
        if let Some((learner, knowledge)) = &allocator {
            networks.push(saved(ALLOCATOR, learner, [&knowledge.online, &knowledge.target]));
        }
        let state = StateRef {
            counters: &self.counters,
            adam_steps: Level {
                agents: self.agents.adam.steps,
                allocator: allocator.as_ref().map_or(0, |(learner, _)| learner.adam.steps),
            },
            picks: &self.picks,
            instances: self.rollout.snapshot(),
            records: &agents.replay,
            segments: allocator.as_ref().map(|(_, knowledge)| &knowledge.replay),
        };
        let checkpoints = self.folder.checkpoints();
        observer.saved(&checkpoints.write(self.counters.env_steps, &networks, &state)?);
        Ok(())
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped.
    ///
    /// `threads` may differ from before; it changes no result. `None` takes as many as before.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, LearnError> {
        let files = RunFolder::new(folder);
        let mut description = files.read_description()?;
        description.threads = threads.unwrap_or(description.threads).max(1);
        let found = files.checkpoints().newest(OpenFor::Resume)?;
        let state: State = found.checkpoint.state()?;
        let misfit = |what: &str| {
            LearnError::format(folder, format!("the checkpoint's {what} does not fit train.toml"))
        };
        let config = &description.config;
        let set = ScenarioSet::named(&config.environment.set)?;
        if !state.records.fits(config.replay.capacity, set.max_agents) {
            return Err(misfit("replay"));
        }
        let fits = |segments: &Segments| segments.fits(config.allocator.replay.capacity);
        if state.segments.is_some() != config.allocation.is_learned()
            || !state.segments.as_ref().is_none_or(fits)
        {
            return Err(misfit("allocator"));
        }

        let mut trainer = Self::start(description, folder)?;
        trainer.rollout.restore(state.instances)?;
        trainer.picks = state.picks;
        trainer.counters = state.counters;
        let shape = trainer.description.config.network.shape(ACTIONS);
        let agents = Saved { checkpoint: &found.checkpoint, name: AGENTS, shape };
        agents.restore(&mut trainer.agents, state.adam_steps.agents, state.records)?;
        if let (Some(learner), Some(segments)) = (&mut trainer.allocator, state.segments) {
            let shape = trainer.description.config.allocator.shape();
            let allocator = Saved { checkpoint: &found.checkpoint, name: ALLOCATOR, shape };
            allocator.restore(learner, state.adam_steps.allocator, segments)?;
        }
        trainer.refused = found.refused;
        Ok(trainer)
    }
}

/// The vectors of a learner whose networks are borrowed.
fn saved<'a, L: Loss<Network = UtilityNetwork>>(
    name: &'static str,
    learner: &'a Learner<L>,
    [online, target]: [&'a UtilityNetwork; 2],
) -> SavedNetwork<'a> {
    SavedNetwork {
        name,
        shape: online.shape(),
        vectors: vec![
            ("online", online.parameters()),
            ("target", target.parameters()),
            ("average", learner.average.parameters()),
            ("adam-mean", &learner.adam.mean),
            ("adam-square", &learner.adam.square),
        ],
    }
}

/// A learner's part of a checkpoint.
struct Saved<'a> {
    checkpoint: &'a Checkpoint,
    name: &'static str,
    /// The shape that the configuration asks for.
    shape: UtilityShape,
}

impl Saved<'_> {
    fn restore<L: Loss<Network = UtilityNetwork>>(
        &self,
        learner: &mut Learner<L>,
        adam_steps: u64,
        replay: L::Replay,
    ) -> Result<(), LearnError> {
        if self.checkpoint.shape(self.name)? != self.shape {
            let reason = format!("its {} network does not fit train.toml", self.name);
            return Err(LearnError::format(self.checkpoint.place(), reason));
        }
        let network = |vector: &str| self.checkpoint.network(self.name, vector);
        learner.average = network("average")?;
        learner.adam.mean = self.checkpoint.vector(self.name, "adam-mean")?;
        learner.adam.square = self.checkpoint.vector(self.name, "adam-square")?;
        learner.adam.steps = adam_steps;
        let mut knowledge = learner.knowledge_mut();
        knowledge.online = network("online")?;
        knowledge.target = network("target")?;
        knowledge.replay = replay;
        Ok(())
    }
}
