//! Updates: pick samples, compute their gradient on all threads, take one optimiser step.
//!
//! A batch is cut into chunks of fixed size. Threads take chunks as they come, every chunk has its own
//! gradient, and gradients are added in the order of the chunks: the result depends neither on the
//! number of threads nor on their timing.

#[cfg(test)]
mod tests;

use std::fmt::{self, Debug};
use std::ops::Deref;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use rand_core::Rng;
use sortie_envs::random::below;
use sortie_envs::{Environment, Split};
use sortie_learn::run::UpdateReport;
use sortie_nn::optimise::{Adam, clip_norm, move_towards};
use sortie_nn::random::Generator;

use super::config::{OptimiserConfig, ReplayConfig};
use super::mixer::Mixer;
use crate::alma::agents::UtilityNetwork;

/// A sample to learn from and how its map is turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pick {
    /// Index in the replay.
    pub sample: u32,
    /// Number of the environment's symmetry; 0 changes nothing.
    pub symmetry: u8,
    /// What else the loss draws for this sample comes from this number.
    pub draw: u64,
}

/// Something with weights in flat vectors, always as many and as long.
pub trait Parameters: Clone + Debug + Send + Sync + 'static {
    /// All weights.
    fn parts(&self) -> Vec<&[f32]>;
    /// All weights, to be changed.
    fn parts_mut(&mut self) -> Vec<&mut [f32]>;

    /// Number of weights.
    fn count(&self) -> usize {
        self.parts().iter().map(|part| part.len()).sum()
    }
}

/// Numbered samples.
pub trait Samples: Debug + Send + Sync + 'static {
    /// How many there are.
    fn count(&self) -> usize;
}

/// What the loss is computed with.
#[derive(Debug)]
pub struct Networks<'a, N> {
    /// The network that learns.
    pub online: &'a N,
    /// The slowly moving network that values what comes next.
    pub target: &'a N,
}

/// What the loss is computed from.
pub struct Experience<'a, R> {
    /// What observes the states that were seen.
    pub environment: &'a dyn Environment,
    /// What was seen.
    pub replay: &'a R,
}

impl<R> Clone for Experience<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R> Copy for Experience<'_, R> {}

/// A sum of squared errors over samples, with its gradient: the space to compute them, and the result.
pub trait Loss: Clone + Debug + Send + 'static {
    /// What learns.
    type Network: Parameters;
    /// What it learns from.
    type Replay: Samples;
    /// Samples that one thread works on at a time: few enough for their activations to stay in cache.
    const CHUNK: usize;

    /// Computes the sum over the picked samples.
    fn learn(
        &mut self,
        networks: Networks<'_, Self::Network>,
        experience: Experience<'_, Self::Replay>,
        picks: &[Pick],
    );
    /// The sum of squared errors.
    fn squared_error(&self) -> f64;
    /// Number of terms in the sum.
    fn terms(&self) -> usize;
    /// The gradient of the sum by all weights, one part behind the other.
    fn gradient(&self) -> &[f32];
}

/// What updates read; written only while no update runs.
#[derive(Debug)]
pub struct Knowledge<L: Loss> {
    /// The network that learns and acts.
    pub online: L::Network,
    /// The network that values what comes next.
    pub target: L::Network,
    /// What was seen.
    pub replay: L::Replay,
    /// What observes its states.
    observer: Observer,
    /// Samples of the running update.
    picks: Vec<Pick>,
}

impl<L: Loss> Knowledge<L> {
    /// What was seen, with what observes it.
    pub fn experience(&self) -> Experience<'_, L::Replay> {
        Experience { environment: &*self.observer, replay: &self.replay }
    }

    /// The samples of the running update: those picked last and not yet followed.
    pub fn picks(&self) -> &[Pick] {
        &self.picks
    }
}

#[derive(Debug)]
struct Shared<L: Loss> {
    knowledge: RwLock<Knowledge<L>>,
    chunks: Vec<Mutex<L>>,
    next_chunk: AtomicUsize,
}

impl<L: Loss> Shared<L> {
    fn knowledge(&self) -> RwLockReadGuard<'_, Knowledge<L>> {
        self.knowledge.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn chunk(&self, index: usize) -> MutexGuard<'_, L> {
        self.chunks[index].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes chunks until none is left.
    fn work(&self) {
        let knowledge = self.knowledge();
        let Knowledge { online, target, picks, .. } = &*knowledge;
        loop {
            let index = self.next_chunk.fetch_add(1, Ordering::Relaxed);
            let Some(picks) = picks.chunks(L::CHUNK).nth(index) else { return };
            let networks = Networks { online, target };
            self.chunk(index).learn(networks, knowledge.experience(), picks);
        }
    }
}

/// The networks of one level, their optimiser and the pieces of a running update.
///
/// An update is [`pick`](Self::pick), the [`job`](Self::job) on any number of threads, and
/// [`follow`](Self::follow).
#[derive(Debug)]
pub struct Learner<L: Loss> {
    shared: Arc<Shared<L>>,
    replay: ReplayConfig,
    optimiser: OptimiserConfig,
    /// The moving average of the online weights: what is measured and shipped.
    pub average: L::Network,
    /// The optimiser.
    pub adam: Adam,
    gradient: Vec<f32>,
}

impl<L: Loss> Learner<L> {
    /// A learner that starts from `online`; `loss` is the space of one chunk, to be copied.
    pub fn new(
        config: (&ReplayConfig, &OptimiserConfig),
        online: L::Network,
        (replay, observer): (L::Replay, Observer),
        loss: &L,
    ) -> Self {
        let (replay_config, optimiser) = (config.0.clone(), config.1.clone());
        let parameters = online.count();
        let (target, average) = (online.clone(), online.clone());
        let chunks = replay_config.batch.div_ceil(L::CHUNK);
        let knowledge = Knowledge { online, target, replay, observer, picks: Vec::new() };
        Self {
            shared: Arc::new(Shared {
                knowledge: RwLock::new(knowledge),
                chunks: (0..chunks).map(|_| Mutex::new(loss.clone())).collect(),
                next_chunk: AtomicUsize::new(0),
            }),
            average,
            adam: Adam::new(parameters, optimiser.epsilon),
            gradient: vec![0.0; parameters],
            replay: replay_config,
            optimiser,
        }
    }

    /// What has been learned and seen.
    pub fn knowledge(&self) -> RwLockReadGuard<'_, Knowledge<L>> {
        self.shared.knowledge()
    }

    /// The same, to be changed.
    pub fn knowledge_mut(&mut self) -> RwLockWriteGuard<'_, Knowledge<L>> {
        self.shared.knowledge.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there are enough samples to learn from.
    pub fn is_warm(&self) -> bool {
        self.knowledge().replay.count() >= self.replay.warm_up
    }

    /// Draws the samples of an update.
    pub fn pick(&mut self, generator: &mut Generator) {
        let (batch, turns) = (self.replay.batch, self.replay.symmetries);
        let mut knowledge = self.knowledge_mut();
        let symmetries = if turns { knowledge.observer.spec().turns } else { 1 };
        let samples = knowledge.replay.count();
        knowledge.picks.clear();
        knowledge.picks.extend((0..batch).map(|_| Pick {
            sample: below(generator, samples) as u32,
            symmetry: below(generator, symmetries) as u8,
            draw: generator.next_u64(),
        }));
        drop(knowledge);
        self.shared.next_chunk.store(0, Ordering::Relaxed);
    }

    /// Computes the gradients of the picked samples, together with whoever else runs it.
    pub fn job(&self) -> impl Fn() + Send + Sync + 'static {
        let shared = Arc::clone(&self.shared);
        move || shared.work()
    }

    /// Takes one optimiser step by the gradients that the job computed.
    pub fn follow(&mut self, learning_rate: f32) -> UpdateReport {
        let optimiser = &self.optimiser;
        self.gradient.fill(0.0);
        let (mut squared_error, mut terms) = (0.0, 0);
        for index in 0..self.shared.chunks.len() {
            let chunk = self.shared.chunk(index);
            for (sum, part) in self.gradient.iter_mut().zip(chunk.gradient()) {
                *sum += part;
            }
            squared_error += chunk.squared_error();
            terms += chunk.terms();
        }
        let share = 1.0 / terms.max(1) as f32;
        self.gradient.iter_mut().for_each(|slope| *slope *= share);
        let gradient_norm = clip_norm(&mut self.gradient, optimiser.clip);

        let mut knowledge = self.shared.knowledge.write().unwrap_or_else(PoisonError::into_inner);
        let Knowledge { online, target, picks, .. } = &mut *knowledge;
        picks.clear();
        self.adam.step(&mut online.parts_mut(), &self.gradient, learning_rate);
        // A plain mean at first, so that the initial weights do not linger.
        let average_rate = optimiser.average_rate.max(1.0 / self.adam.steps as f32);
        let averages = self.average.parts_mut().into_iter();
        for ((target, average), online) in
            target.parts_mut().into_iter().zip(averages).zip(online.parts())
        {
            move_towards(target, online, optimiser.target_rate);
            move_towards(average, online, average_rate);
        }
        UpdateReport { loss: squared_error / terms.max(1) as f64, gradient_norm }
    }
}

/// A utility network with its mixer.
#[derive(Clone, Debug, PartialEq)]
pub struct MixedNetwork {
    /// What agents act by, and all that is deployed.
    pub utility: UtilityNetwork,
    /// Makes a team's value of its agents' utilities.
    pub mixer: Mixer,
}

impl Parameters for UtilityNetwork {
    fn parts(&self) -> Vec<&[f32]> {
        vec![self.parameters()]
    }

    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        vec![self.parameters_mut()]
    }
}

/// The utility network's parameters, then the mixer's.
impl Parameters for MixedNetwork {
    fn parts(&self) -> Vec<&[f32]> {
        vec![self.utility.parameters(), self.mixer.parameters()]
    }

    fn parts_mut(&mut self) -> Vec<&mut [f32]> {
        vec![self.utility.parameters_mut(), self.mixer.parameters_mut()]
    }
}

/// An environment that nobody plays in, shared by all that look at states.
#[derive(Clone)]
pub struct Observer(Arc<dyn Environment>);

impl Observer {
    /// What observes the states of an environment.
    pub fn of(environment: &dyn Environment) -> Self {
        Self(Arc::from(environment.open(1, Split::Train)))
    }
}

impl Deref for Observer {
    type Target = dyn Environment;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl fmt::Debug for Observer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Observer").field(&self.spec().name).finish()
    }
}
