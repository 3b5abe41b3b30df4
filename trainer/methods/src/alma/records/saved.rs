//! How a run is written to a checkpoint and read back.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::ScenarioSet;
use sortie_nn::optimise::Adam;
use sortie_nn::random::Generator;

use super::config::Config;
use super::learner::{Learner, Loss};
use super::mixed_network::MixedNetwork;
use super::mixer::{Mixer, MixerShape};
use super::replay::{RecordLayout, Replay};
use super::rollout::InstanceSnapshot;
use super::saved_network::{saved_network, saved_shape, saved_vector};
use super::team_value::Segments;
use super::trainer::Trainer;
use super::utility::{UtilityNetwork, UtilityShape};
use sortie_learn::LearnError;
use sortie_learn::run::checkpoint::{Checkpoint, OpenFor, SavedNetwork};
use sortie_learn::run::{Counters, Level, Observer, RunFolder};

/// When each level makes its next update, in environment steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Due(Level<u64>);

impl Due {
    /// Whether a level has an update to make.
    pub(super) fn any(&self, env_steps: u64) -> bool {
        self.0.agents.min(self.0.allocator) <= env_steps
    }

    /// Which levels have an update to make; they are taken to have made it.
    pub(super) fn take(&mut self, env_steps: u64, config: &Config) -> Level<bool> {
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

/// A checkpoint's state as it is written: what is large is borrowed.
#[derive(Serialize)]
struct StateRef<'a> {
    counters: &'a Counters,
    due: Due,
    adam_steps: Level<u64>,
    picks: &'a Level<Generator>,
    instances: Vec<InstanceSnapshot>,
    mixer: SavedMixer<&'a [f32]>,
    records: &'a Replay,
    segments: Option<&'a Segments>,
}

/// A checkpoint's state as it is read.
#[derive(Deserialize)]
struct State {
    counters: Counters,
    due: Due,
    adam_steps: Level<u64>,
    picks: Level<Generator>,
    instances: Vec<InstanceSnapshot>,
    mixer: SavedMixer<Vec<f32>>,
    records: Replay,
    segments: Option<Segments>,
}

/// The mixer's part of a state. Nobody needs it but the run itself.
#[derive(Serialize, Deserialize)]
struct SavedMixer<V> {
    /// Parameters: online, target and average.
    networks: [V; 3],
    /// Mean and square of the optimiser.
    adam: [V; 2],
}

impl SavedMixer<Vec<f32>> {
    /// Puts utilities and mixers together again, or gives `None` where a length does not fit the shape.
    fn join(self, utilities: Restored, shape: MixerShape) -> Option<([MixedNetwork; 3], Adam)> {
        let [mean, square] = self.adam;
        if [&mean, &square].iter().any(|vector| vector.len() != shape.parameters()) {
            return None;
        }
        let mut adam = utilities.adam;
        adam.mean.extend(mean);
        adam.square.extend(square);
        let mut mixed = Vec::new();
        for (utility, parameters) in utilities.networks.into_iter().zip(self.networks) {
            let mixer = Mixer::from_parameters(shape, parameters)?;
            mixed.push(MixedNetwork { utility, mixer });
        }
        Some((mixed.try_into().ok()?, adam))
    }
}

/// Names of the networks in a checkpoint.
const AGENTS: &str = "agents";
const ALLOCATOR: &str = "allocator";

impl Trainer {
    /// Writes a checkpoint.
    pub(super) fn write_checkpoint(&self, observer: &mut dyn Observer) -> Result<(), LearnError> {
        let agents = self.agents.knowledge();
        let allocator = self.allocator.as_ref().map(|learner| (learner, learner.knowledge()));
        let mixed = [&agents.online, &agents.target, &self.agents.average];
        let mut networks =
            vec![saved(AGENTS, mixed.map(|network| &network.utility), &self.agents.adam)?];
        if let Some((learner, knowledge)) = &allocator {
            let all = [&knowledge.online, &knowledge.target, &learner.average];
            networks.push(saved(ALLOCATOR, all, &learner.adam)?);
        }
        let (utilities, adam) = (agents.online.utility.shape().parameters(), &self.agents.adam);
        let state = StateRef {
            counters: &self.counters,
            due: self.due,
            adam_steps: Level {
                agents: self.agents.adam.steps,
                allocator: allocator.as_ref().map_or(0, |(learner, _)| learner.adam.steps),
            },
            picks: &self.picks,
            instances: self.rollout.snapshot(),
            mixer: SavedMixer {
                networks: mixed.map(|network| network.mixer.parameters()),
                adam: [&adam.mean[utilities..], &adam.square[utilities..]],
            },
            records: &agents.replay,
            segments: allocator.as_ref().map(|(_, knowledge)| &knowledge.replay),
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
        let misfit = |what: &str| {
            LearnError::format(folder, format!("the checkpoint's {what} does not fit train.toml"))
        };
        let config = &description.config;
        let set = ScenarioSet::named(&config.environment.set).map_err(LearnError::environment)?;
        if !state
            .records
            .fits(config.replay.capacity, RecordLayout::new(config.network.subtask, &set))
        {
            return Err(misfit("replay"));
        }
        let fits = |segments: &Segments| segments.fits(config.allocator.replay.capacity);
        if state.segments.is_some() != config.learns_allocator()
            || !state.segments.as_ref().is_none_or(fits)
        {
            return Err(misfit("allocator"));
        }

        let mut trainer = Self::start(description, files)?;
        trainer.rollout.restore(state.instances)?;
        trainer.picks = state.picks;
        (trainer.counters, trainer.due) = (state.counters, state.due);
        let config = trainer.description.config.clone();
        let shape = config.agent_shape()?;
        let adam = Adam { steps: state.adam_steps.agents, ..trainer.agents.adam.clone() };
        let agents = restored(&found.checkpoint, AGENTS, shape, adam)?;
        let mixer = config.mixer.shape(shape.input);
        let (mixed, adam) = state.mixer.join(agents, mixer).ok_or_else(|| misfit("mixer"))?;
        put_back(&mut trainer.agents, mixed, adam, state.records);
        if let (Some(learner), Some(segments)) = (&mut trainer.allocator, state.segments) {
            let shape = config.allocator.shape();
            let adam = Adam { steps: state.adam_steps.allocator, ..learner.adam.clone() };
            let restored = restored(&found.checkpoint, ALLOCATOR, shape, adam)?;
            put_back(learner, restored.networks, restored.adam, segments);
        }
        trainer.refused = found.refused;
        Ok(trainer)
    }
}

/// The vectors of a network and of its optimiser, whose vectors may go on behind its own.
fn saved<'a>(
    name: &'static str,
    [online, target, average]: [&'a UtilityNetwork; 3],
    adam: &'a Adam,
) -> Result<SavedNetwork<'a>, LearnError> {
    let count = online.shape().parameters();
    Ok(SavedNetwork {
        name,
        shape: Some(saved_shape(online.shape())?),
        vectors: vec![
            ("online", online.parameters()),
            ("target", target.parameters()),
            ("average", average.parameters()),
            ("adam-mean", &adam.mean[..count]),
            ("adam-square", &adam.square[..count]),
        ],
    })
}

/// What a checkpoint holds of a network: online, target and average, and the optimiser.
struct Restored {
    networks: [UtilityNetwork; 3],
    adam: Adam,
}

/// Reads a network of the shape that the configuration asks for.
fn restored(
    checkpoint: &Checkpoint,
    name: &str,
    shape: UtilityShape,
    adam: Adam,
) -> Result<Restored, LearnError> {
    if checkpoint.shape::<UtilityShape>(name)? != shape {
        let reason = format!("its {name} network does not fit train.toml");
        return Err(LearnError::format(checkpoint.place(), reason));
    }
    let network = |vector: &str| saved_network(checkpoint, name, vector);
    let mean = saved_vector(checkpoint, name, "adam-mean")?;
    let square = saved_vector(checkpoint, name, "adam-square")?;
    let networks = [network("online")?, network("target")?, network("average")?];
    Ok(Restored { networks, adam: Adam { mean, square, ..adam } })
}

/// Puts a learner back to where it was.
fn put_back<L: Loss>(
    learner: &mut Learner<L>,
    [online, target, average]: [L::Network; 3],
    adam: Adam,
    replay: L::Replay,
) {
    learner.average = average;
    learner.adam = adam;
    let mut knowledge = learner.knowledge_mut();
    knowledge.online = online;
    knowledge.target = target;
    knowledge.replay = replay;
}
