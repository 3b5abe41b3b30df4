//! Updates: pick samples, compute their gradient on all threads, take one optimiser step.
//!
//! A batch is cut into chunks of fixed size. Threads take chunks as they come, every chunk has its own
//! gradient, and gradients are added in the order of the chunks: the result depends neither on the
//! number of threads nor on their timing.

use std::fmt::Debug;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use rand_core::Rng;
use sortie_envs::Environment;
use sortie_envs::random::below;
use sortie_nn::optimise::{Adam, clip_norm, move_towards};
use sortie_nn::random::Generator;

use super::config::{OptimiserConfig, ReplayConfig};
use super::observer::Observer;
use sortie_learn::run::UpdateReport;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::records::toy::toy;
    use sortie_learn::random::{Purpose, generator};

    /// A line through samples, by its slope and its height at 0.
    #[derive(Clone, Debug, PartialEq)]
    struct Line(Vec<f32>);

    impl Parameters for Line {
        fn parts(&self) -> Vec<&[f32]> {
            vec![&self.0]
        }
        fn parts_mut(&mut self) -> Vec<&mut [f32]> {
            vec![&mut self.0]
        }
    }

    impl Samples for Vec<(f32, f32)> {
        fn count(&self) -> usize {
            self.len()
        }
    }

    #[derive(Clone, Debug, Default)]
    struct LineLoss {
        gradient: Vec<f32>,
        squared_error: f64,
        terms: usize,
    }

    impl Loss for LineLoss {
        type Network = Line;
        type Replay = Vec<(f32, f32)>;
        const CHUNK: usize = 3;

        fn learn(
            &mut self,
            networks: Networks<'_, Line>,
            experience: Experience<'_, Self::Replay>,
            picks: &[Pick],
        ) {
            let (slope, height) = (networks.online.0[0], networks.online.0[1]);
            let errors = picks.iter().map(|pick| {
                let (x, y) = experience.replay[pick.sample as usize];
                (x, slope * x + height - y)
            });
            let by_slope = errors.clone().map(|(x, error)| 2.0 * error * x).sum();
            self.gradient = vec![by_slope, errors.clone().map(|(_, error)| 2.0 * error).sum()];
            self.squared_error = errors.map(|(_, error)| f64::from(error * error)).sum();
            self.terms = picks.len();
        }
        fn squared_error(&self) -> f64 {
            self.squared_error
        }
        fn terms(&self) -> usize {
            self.terms
        }
        fn gradient(&self) -> &[f32] {
            &self.gradient
        }
    }

    #[test]
    fn updates_find_the_line_through_the_samples() {
        let samples: Vec<_> = (-10..10).map(|x| (x as f32 * 0.1, x as f32 * 0.3 + 1.0)).collect();
        let samples = (samples, Observer::of(&toy()));
        let replay = ReplayConfig { batch: 8, ..ReplayConfig::default() };
        let optimiser = OptimiserConfig { target_rate: 0.0, ..OptimiserConfig::default() };
        let start = Line(vec![0.0, 0.0]);
        let mut learner =
            Learner::new((&replay, &optimiser), start.clone(), samples, &LineLoss::default());
        let mut picks = generator(1, Purpose::Replay, 0);
        let mut last = UpdateReport::default();
        for _ in 0..2000 {
            learner.pick(&mut picks);
            learner.job()();
            last = learner.follow(0.01);
        }
        let found = learner.knowledge().online.clone();
        assert!((found.0[0] - 3.0).abs() < 1e-3 && (found.0[1] - 1.0).abs() < 1e-3, "{found:?}");
        assert!(last.loss < 1e-6);
        assert_eq!(learner.knowledge().target, start, "a rate of zero moves no target");
        assert_ne!(learner.average, learner.knowledge().online);
    }

    #[test]
    fn an_update_follows_the_mean_of_the_batch() {
        let replay = ReplayConfig { batch: 8, ..ReplayConfig::default() };
        let optimiser = OptimiserConfig { clip: 100.0, ..OptimiserConfig::default() };
        let (start, samples) = (Line(vec![1.0, 0.0]), (vec![(2.0, 3.0)], Observer::of(&toy())));
        let mut learner = Learner::new((&replay, &optimiser), start, samples, &LineLoss::default());
        let mut picks = generator(1, Purpose::Replay, 0);
        learner.pick(&mut picks);
        learner.job()();
        // Each of the eight terms: error 1 * 2 + 0 - 3, squared 1, slopes 2 * -1 * 2 and 2 * -1.
        let update = learner.follow(0.01);
        assert_eq!((update.loss, update.gradient_norm), (1.0, 20.0_f32.sqrt()));
        // The first step of Adam is as long as the learning rate, whatever the slope.
        let first = learner.knowledge().online.clone();
        assert!((first.0[0] - 1.01).abs() < 1e-6 && (first.0[1] - 0.01).abs() < 1e-6, "{first:?}");
        assert_eq!(learner.average, first);
        // The average begins as the plain mean of what was learned.
        learner.pick(&mut picks);
        learner.job()();
        learner.follow(0.01);
        let mean = (first.0[0] + learner.knowledge().online.0[0]) / 2.0;
        assert!((learner.average.0[0] - mean).abs() < 1e-6);
    }

    #[test]
    fn samples_are_turned_by_all_symmetries_of_the_environment_or_by_none() {
        for (symmetries, turns) in [(true, vec![0, 1]), (false, vec![0])] {
            let replay = ReplayConfig { batch: 64, symmetries, ..ReplayConfig::default() };
            let optimiser = OptimiserConfig::default();
            let samples = (vec![(1.0, 1.0)], Observer::of(&toy()));
            let line = Line(vec![0.0; 2]);
            let mut learner =
                Learner::new((&replay, &optimiser), line, samples, &LineLoss::default());
            learner.pick(&mut generator(1, Purpose::Replay, 0));
            let picks = learner.knowledge().picks().to_vec();
            let mut drawn: Vec<u8> = picks.iter().map(|pick| pick.symmetry).collect();
            drawn.sort_unstable();
            drawn.dedup();
            assert_eq!(drawn, turns);
        }
    }

    #[test]
    fn a_learner_is_warm_once_it_has_seen_enough() {
        let replay = ReplayConfig { warm_up: 2, ..ReplayConfig::default() };
        let optimiser = OptimiserConfig::default();
        let is_warm = |samples| {
            let (line, samples) = (Line(vec![0.0; 2]), vec![(1.0, 1.0); samples]);
            let samples = (samples, Observer::of(&toy()));
            Learner::new((&replay, &optimiser), line, samples, &LineLoss::default()).is_warm()
        };
        assert_eq!([1, 2, 3].map(is_warm), [false, true, true]);
    }
}
