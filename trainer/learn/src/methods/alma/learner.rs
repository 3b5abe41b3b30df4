//! Updates: pick records, compute their gradient on all threads, take one optimiser step.
//!
//! A batch is cut into chunks of fixed size. Threads take chunks as they come, every chunk has its own
//! gradient, and gradients are added in the order of the chunks: the result depends neither on the
//! number of threads nor on their timing.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::config::Config;
use super::replay::Replay;
use super::temporal_difference::{Chunk, Networks, Pick};
use super::utility::UtilityNetwork;
use crate::optimise::{Adam, clip_norm, move_towards};
use crate::random::{Generator, below};
use crate::schedule::constant_then_linear;
use crate::workers::Workers;

/// Records that one thread works on at a time: few enough for their activations to stay in cache.
const CHUNK: usize = 64;

/// What updates read; written only while no update runs.
#[derive(Debug)]
pub struct Knowledge {
    /// The network that learns and acts.
    pub online: UtilityNetwork,
    /// The network that values next states.
    pub target: UtilityNetwork,
    /// What was seen.
    pub replay: Replay,
    /// Records of the running update.
    picks: Vec<Pick>,
}

#[derive(Debug)]
struct Shared {
    knowledge: RwLock<Knowledge>,
    chunks: Vec<Mutex<Chunk>>,
    next_chunk: AtomicUsize,
}

impl Shared {
    fn knowledge(&self) -> RwLockReadGuard<'_, Knowledge> {
        self.knowledge.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn chunk(&self, index: usize) -> MutexGuard<'_, Chunk> {
        self.chunks[index].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes chunks until none is left.
    fn work(&self) {
        let knowledge = self.knowledge();
        let networks = Networks { online: &knowledge.online, target: &knowledge.target };
        let batch = knowledge.picks.len();
        loop {
            let index = self.next_chunk.fetch_add(1, Ordering::Relaxed);
            let Some(picks) = knowledge.picks.chunks(CHUNK).nth(index) else { return };
            self.chunk(index).learn(networks, &knowledge.replay, picks, batch);
        }
    }
}

/// What one update found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpdateReport {
    /// Mean squared error of the batch.
    pub loss: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
}

/// The networks, the optimiser and the threads that compute gradients.
#[derive(Debug)]
pub struct Learner {
    shared: Arc<Shared>,
    workers: Workers,
    config: Config,
    /// The moving average of the online weights.
    pub average: UtilityNetwork,
    /// The optimiser.
    pub adam: Adam,
    gradient: Vec<f32>,
}

impl Learner {
    /// A learner that starts from `online`, with an empty target history.
    pub fn new(config: &Config, online: UtilityNetwork, replay: Replay, threads: usize) -> Self {
        let shape = online.shape();
        let batch = config.replay.batch;
        let average = online.clone();
        let knowledge = Knowledge {
            target: online.clone(),
            online,
            replay,
            picks: vec![Pick { record: 0, symmetry: 0 }; batch],
        };
        let shared = Arc::new(Shared {
            knowledge: RwLock::new(knowledge),
            chunks: (0..batch.div_ceil(CHUNK)).map(|_| Mutex::new(Chunk::new(shape))).collect(),
            next_chunk: AtomicUsize::new(0),
        });
        let job = Arc::clone(&shared);
        Self {
            workers: Workers::new(threads, Arc::new(move || job.work())),
            shared,
            config: config.clone(),
            average,
            adam: Adam::new(shape.parameters(), config.optimiser.epsilon),
            gradient: vec![0.0; shape.parameters()],
        }
    }

    /// What has been learned and seen.
    pub fn knowledge(&self) -> RwLockReadGuard<'_, Knowledge> {
        self.shared.knowledge()
    }

    /// The same, to be changed.
    pub fn knowledge_mut(&mut self) -> RwLockWriteGuard<'_, Knowledge> {
        self.shared.knowledge.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Learns from one batch drawn from the replay, `env_steps` into the run.
    pub fn update(&mut self, generator: &mut Generator, env_steps: u64) -> UpdateReport {
        self.pick(generator);
        self.shared.next_chunk.store(0, Ordering::Relaxed);
        self.workers.run();
        self.add_gradients(env_steps)
    }

    /// The learning rate, `env_steps` into the run.
    pub fn learning_rate(&self, env_steps: u64) -> f32 {
        let (steps, optimiser) = (self.config.run.steps, &self.config.optimiser);
        let from = (optimiser.decay_from * steps as f64) as u64;
        constant_then_linear(optimiser.learning_rate, from, steps, env_steps)
    }

    fn pick(&mut self, generator: &mut Generator) {
        let symmetries = if self.config.replay.symmetries { 8 } else { 1 };
        let mut knowledge = self.knowledge_mut();
        let records = knowledge.replay.len();
        for pick in &mut knowledge.picks {
            pick.record = below(generator, records) as u32;
            pick.symmetry = below(generator, symmetries) as u8;
        }
    }

    fn add_gradients(&mut self, env_steps: u64) -> UpdateReport {
        let optimiser = &self.config.optimiser;
        self.gradient.fill(0.0);
        let mut squared_error = 0.0;
        for index in 0..self.shared.chunks.len() {
            let chunk = self.shared.chunk(index);
            for (sum, part) in self.gradient.iter_mut().zip(chunk.gradient()) {
                *sum += part;
            }
            squared_error += chunk.squared_error();
        }
        let gradient_norm = clip_norm(&mut self.gradient, optimiser.clip);

        let rate = self.learning_rate(env_steps);
        let shared = Arc::clone(&self.shared);
        let mut knowledge = shared.knowledge.write().unwrap_or_else(PoisonError::into_inner);
        let Knowledge { online, target, .. } = &mut *knowledge;
        self.adam.step(online.parameters_mut(), &self.gradient, rate);
        move_towards(target.parameters_mut(), online.parameters(), optimiser.target_rate);
        // A plain mean at first, so that the initial weights do not linger.
        let average_rate = optimiser.average_rate.max(1.0 / self.adam.steps as f32);
        move_towards(self.average.parameters_mut(), online.parameters(), average_rate);
        UpdateReport { loss: squared_error / self.config.replay.batch as f64, gradient_norm }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::alma::{EpisodeCounts, Rollout};
    use crate::random::{Purpose, generator};
    use sortie_envs::save_the_city::ACTIONS;

    #[test]
    fn updates_learn_what_the_replay_says() {
        let mut config = Config::default();
        config.network.width = 32;
        config.replay.batch = 100;
        config.replay.symmetries = false;
        config.optimiser.target_rate = 0.0;
        let mut weights = generator(1, Purpose::Weights, 0);
        let shape = config.network.shape(ACTIONS);
        let online = UtilityNetwork::initialise(shape, 8.0, &mut weights);
        let mut replay = Replay::new(300, super::super::RecordLayout { agents: 5, buildings: 1 });
        let mut rollout = Rollout::new(&config, shape, 1).unwrap();
        for _ in 0..40 {
            rollout.step(&online, 1.0, &mut replay, &mut EpisodeCounts::default()).unwrap();
        }
        assert_eq!(replay.len(), 300, "the ring is full");

        let mut learner = Learner::new(&config, online.clone(), replay, 2);
        let mut picks = generator(1, Purpose::Replay, 0);
        let losses: Vec<f64> = (0..400).map(|_| learner.update(&mut picks, 0).loss).collect();
        let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
        let (first, last) = (mean(&losses[..10]), mean(&losses[390..]));
        assert!(last < 0.6 * first, "loss {first} became {last}");
        assert_eq!(learner.knowledge().target, online, "a rate of zero moves no target");
        assert_ne!(learner.average, learner.knowledge().online);
    }
}
