//! How a run of the preset `paper` is written to a checkpoint and read back.
//!
//! A checkpoint is written between two rounds, when no episode runs.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::ScenarioSet;
use sortie_nn::layers::gru::lengths;
use sortie_nn::random::Generator;

use super::allocation::{
    AllocationCritic, AllocationLearning, AllocationLevel, AllocationPolicy, AllocationState,
};
use super::config::Config;
use super::low_level::LowLevel;
use super::low_level::coach::{Coach, CoachShape, Coaching};
use super::popart::PopArt;
use super::replay::Replay;
use super::rollout::RolloutGenerators;
use super::trainer::{Episodes, Trainer};
use crate::alma::records::{UtilityShape, saved_network, saved_shape, saved_vector};
use crate::alma::run::RunAllocator;
use sortie_learn::LearnError;
use sortie_learn::run::checkpoint::{Checkpoint, OpenFor, SavedNetwork};
use sortie_learn::run::{Counters, Observer, RunFolder};

/// A checkpoint's state as it is written: what is large is borrowed.
#[derive(Serialize)]
struct StateRef<'a> {
    counters: &'a Counters,
    episodes: Episodes,
    generator: &'a Generator,
    rollout: &'a RolloutGenerators,
    statistics: Statistics,
    replay: &'a Replay,
}

/// A checkpoint's state as it is read.
#[derive(Deserialize)]
struct State {
    counters: Counters,
    episodes: Episodes,
    generator: Generator,
    rollout: RolloutGenerators,
    statistics: Statistics,
    replay: Replay,
}

/// PopArt's statistics: online and target, of the mixer and of the critic, if there is one.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Statistics {
    mixer: [PopArt; 2],
    critic: Option<[PopArt; 2]>,
}

/// Names of the networks in a checkpoint.
const AGENTS: &str = "agents";
const MEMORY: &str = "memory";
const MIXER: &str = "mixer";
const CRITIC: &str = "critic";
const POLICY: &str = "policy";
const COACH: &str = "coach";
const RECOGNITION: &str = "recognition";

impl Trainer {
    /// Writes a checkpoint.
    pub(super) fn write_checkpoint(&self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let LowLevel { online, target, optimisers, coaching, .. } = &self.low_level;
        let [agents, memory, mixer] = optimisers;
        let allocation = self.allocation.as_ref().map(AllocationLevel::state);
        let mut networks = vec![
            SavedNetwork {
                name: AGENTS,
                shape: Some(saved_shape(online.agents.shape())?),
                vectors: vec![
                    ("online", online.agents.parameters()),
                    ("target", target.agents.parameters()),
                    ("square", &agents.square),
                ],
            },
            SavedNetwork {
                name: MIXER,
                shape: None,
                vectors: vec![
                    ("online", online.mixer.parameters()),
                    ("target", target.mixer.parameters()),
                    ("square", &mixer.square),
                ],
            },
        ];
        if !online.gru.is_empty() {
            networks.push(SavedNetwork {
                name: MEMORY,
                shape: None,
                vectors: vec![
                    ("online", &online.gru),
                    ("target", &target.gru),
                    ("square", &memory.square),
                ],
            });
        }
        networks.extend(coaching.iter().flat_map(saved_coaching));
        if let Some(state) = &allocation {
            networks.push(SavedNetwork {
                name: CRITIC,
                shape: None,
                vectors: vec![
                    ("online", &state.critic),
                    ("target", &state.target),
                    ("square", &state.critic_square),
                ],
            });
            networks.push(SavedNetwork {
                name: POLICY,
                shape: None,
                vectors: vec![("online", &state.policy), ("square", &state.policy_square)],
            });
        }
        let state = StateRef {
            counters: &self.counters,
            episodes: self.episodes,
            generator: &self.generator,
            rollout: self.rollout.generators(),
            statistics: Statistics {
                mixer: [online.popart, target.popart],
                critic: allocation.as_ref().map(|state| [state.popart, state.target_popart]),
            },
            replay: &self.replay,
        };
        let checkpoints = self.folder.checkpoints();
        observer.saved(&checkpoints.write(self.counters.env_steps, &networks, &state)?);
        Ok(())
    }

    /// Continues a run from its newest sound checkpoint, exactly as if it had not been stopped; begins it anew
    /// where none was written yet.
    ///
    /// `threads` may differ from before; it changes no result. `None` takes as many as before.
    pub fn resume(folder: &Path, threads: Option<usize>) -> Result<Self, LearnError> {
        let files = RunFolder::claim(folder)?;
        let mut description = files.read_description::<Config>()?;
        description.threads = threads.unwrap_or(description.threads).max(1);
        description.config.run.settle_products()?;
        if !files.checkpoints().exist()? {
            return Self::begin(description, files);
        }
        let found = files.checkpoints().newest(OpenFor::Resume)?;
        let state: State = found.checkpoint.state()?;
        let mut trainer = Self::start(description, files)?;
        trainer.rollout.restore(state.rollout)?;
        restore_low_level(&mut trainer.low_level, &found.checkpoint, state.statistics.mixer)?;
        let learning = trainer.allocation.as_ref().map(AllocationLevel::learning);
        trainer.allocation = match (learning, state.statistics.critic) {
            (Some(learning), Some(statistics)) => {
                Some(restored_allocation(learning, &found.checkpoint, statistics)?)
            }
            (None, None) => None,
            _ => {
                let reason = "the checkpoint's allocator does not fit train.toml";
                return Err(LearnError::format(folder, reason));
            }
        };
        trainer.replay = state.replay;
        trainer.generator = state.generator;
        trainer.counters = state.counters;
        trainer.episodes = state.episodes;
        trainer.refused = found.refused;
        Ok(trainer)
    }
}

/// A coach and its recognition network, as a checkpoint holds them.
fn saved_coaching(coaching: &Coaching) -> [SavedNetwork<'_>; 2] {
    let Coaching { online, target, recognition, optimisers: [of_coach, of_recognition], .. } =
        coaching;
    [
        SavedNetwork {
            name: COACH,
            shape: None,
            vectors: vec![
                ("online", online.parameters()),
                ("target", target.parameters()),
                ("square", &of_coach.square),
            ],
        },
        SavedNetwork {
            name: RECOGNITION,
            shape: None,
            vectors: vec![("online", recognition.parameters()), ("square", &of_recognition.square)],
        },
    ]
}

/// The coach of a run, to be used, if it has one.
pub(crate) fn saved_coach(
    checkpoint: &Checkpoint,
    config: &Config,
) -> Result<Option<Coach>, LearnError> {
    if !config.coach.enabled {
        return Ok(None);
    }
    let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
    let shape = CoachShape::of(&config.low_level, config.sizes(&set));
    let parameters = whole(checkpoint, COACH, "online", shape.parameters())?;
    Ok(Coach::from_parameters(shape, parameters))
}

/// The allocator of a run, to be used, if it learns one.
pub(crate) fn saved_allocator(
    checkpoint: &Checkpoint,
    config: &Config,
) -> Result<Option<RunAllocator>, LearnError> {
    if !config.learns_allocator() {
        return Ok(None);
    }
    let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
    let shape = config.allocation_learning(config.sizes(&set)).shape;
    let misfit = || LearnError::format(checkpoint.place(), "its allocator does not fit train.toml");
    let critic = whole(checkpoint, CRITIC, "online", AllocationCritic::count(shape))?;
    let policy = whole(checkpoint, POLICY, "online", AllocationPolicy::count(shape))?;
    // Which of two allocations is better does not depend on the units of their values.
    let critic = AllocationCritic::from_parameters(shape, critic, PopArt::default());
    let policy = AllocationPolicy::from_parameters(shape, policy);
    let (critic, policy) = (critic.ok_or_else(misfit)?, policy.ok_or_else(misfit)?);
    Ok(Some(RunAllocator::Proposals { policy, critic }))
}

/// The recurrent unit of a run's agents, to be used; empty where they have no memory.
pub(crate) fn saved_memory_unit(
    checkpoint: &Checkpoint,
    config: &Config,
) -> Result<Vec<f32>, LearnError> {
    let count =
        if config.low_level.recurrent { lengths(config.low_level.base).iter().sum() } else { 0 };
    memory_unit(checkpoint, "online", count)
}

/// A vector of the recurrent unit, of which there is none where agents have no memory.
fn memory_unit(
    checkpoint: &Checkpoint,
    vector: &str,
    count: usize,
) -> Result<Vec<f32>, LearnError> {
    if count == 0 { Ok(Vec::new()) } else { whole(checkpoint, MEMORY, vector, count) }
}

fn restore_low_level(
    level: &mut LowLevel,
    checkpoint: &Checkpoint,
    [online, target]: [PopArt; 2],
) -> Result<(), LearnError> {
    if checkpoint.shape::<UtilityShape>(AGENTS)? != level.online.agents.shape() {
        let reason = "its agents do not fit train.toml";
        return Err(LearnError::format(checkpoint.place(), reason));
    }
    let sides = [(&mut level.online, "online", online), (&mut level.target, "target", target)];
    for (networks, name, popart) in sides {
        networks.agents = saved_network(checkpoint, AGENTS, name)?;
        let mixer = networks.mixer.parameters_mut();
        mixer.copy_from_slice(&whole(checkpoint, MIXER, name, mixer.len())?);
        networks.popart = popart;
        networks.gru = memory_unit(checkpoint, name, networks.gru.len())?;
    }
    let [agents, memory, mixer] = &mut level.optimisers;
    agents.square = saved_vector(checkpoint, AGENTS, "square")?;
    memory.square = memory_unit(checkpoint, "square", memory.square.len())?;
    mixer.square = whole(checkpoint, MIXER, "square", mixer.square.len())?;
    level.coaching.iter_mut().try_for_each(|coaching| restore_coaching(coaching, checkpoint))
}

fn restore_coaching(coaching: &mut Coaching, checkpoint: &Checkpoint) -> Result<(), LearnError> {
    let Coaching { online, target, recognition, optimisers: [of_coach, of_recognition], .. } =
        coaching;
    for (network, name, vector) in [
        (COACH, "online", online.parameters_mut()),
        (COACH, "target", target.parameters_mut()),
        (COACH, "square", &mut of_coach.square),
        (RECOGNITION, "online", recognition.parameters_mut()),
        (RECOGNITION, "square", &mut of_recognition.square),
    ] {
        vector.copy_from_slice(&whole(checkpoint, network, name, vector.len())?);
    }
    Ok(())
}

fn restored_allocation(
    learning: &AllocationLearning,
    checkpoint: &Checkpoint,
    [popart, target_popart]: [PopArt; 2],
) -> Result<AllocationLevel, LearnError> {
    let shape = learning.shape;
    let (critics, policies) = (AllocationCritic::count(shape), AllocationPolicy::count(shape));
    let state = AllocationState {
        critic: whole(checkpoint, CRITIC, "online", critics)?,
        popart,
        target: whole(checkpoint, CRITIC, "target", critics)?,
        target_popart,
        policy: whole(checkpoint, POLICY, "online", policies)?,
        critic_square: whole(checkpoint, CRITIC, "square", critics)?,
        policy_square: whole(checkpoint, POLICY, "square", policies)?,
    };
    AllocationLevel::restore(*learning, state).ok_or_else(|| {
        LearnError::format(checkpoint.place(), "its allocator does not fit train.toml")
    })
}

fn whole(
    checkpoint: &Checkpoint,
    network: &str,
    vector: &str,
    count: usize,
) -> Result<Vec<f32>, LearnError> {
    checkpoint.whole_vector(&format!("{network}/{vector}"), count)
}
