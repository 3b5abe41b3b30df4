//! Updates: records or episodes become a gradient, the gradient better weights.

use sortie_envs::{Environment, Random};
use sortie_learn::run::UpdateReport;
use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{clip_norm, move_towards};

use super::chunk::{Chunk, Drawn};
use super::config::Config;
use super::episodes::Episodes;
use super::optimiser::Optimiser;
use super::replay::{Place, Replay};
use super::temporal_difference::Network;

/// Records of a chunk: so many rows fit into the processor's nearest cache.
const CHUNK: usize = 32;
/// States of a chunk of whole episodes, one episode at least. Many share their rows.
const CHUNK_STATES: usize = 128;

/// Networks and optimiser.
#[derive(Clone, Debug)]
pub struct Learner {
    config: Config,
    threads: usize,
    pub(super) online: Network,
    pub(super) target: Network,
    pub(super) average: Network,
    pub(super) optimiser: Optimiser,
    drawn: Vec<Drawn<Place>>,
    drawn_episodes: Vec<Drawn<usize>>,
    indices: Vec<usize>,
    chunks: Vec<Chunk>,
}

/// What changes from one update to the next.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// Step size of the optimiser.
    pub learning_rate: f32,
    /// Whether the target network moves.
    pub moves_target: bool,
}

impl Learner {
    /// Begins with these weights.
    pub fn new(config: Config, network: Network, threads: usize) -> Self {
        let parameters = network.parameters.len();
        let optimiser = Optimiser::new(config.update.rule, parameters, config.optimiser.epsilon);
        Self {
            threads,
            optimiser,
            target: network.clone(),
            average: network.clone(),
            online: network,
            drawn: Vec::new(),
            drawn_episodes: Vec::new(),
            indices: Vec::new(),
            chunks: Vec::new(),
            config,
        }
    }

    /// The network that explores.
    pub fn online(&self) -> &Network {
        &self.online
    }

    /// The network that is evaluated.
    pub fn average(&self) -> &Network {
        &self.average
    }

    /// Learns from as many records as a batch has.
    pub fn update(
        &mut self,
        replay: &Replay,
        environment: &dyn Environment,
        update: Update,
        random: &mut Random,
    ) -> UpdateReport {
        let entities = environment.spec().shape.entities;
        let Config { imagination, returns, replay: sizes, .. } = &self.config;
        self.drawn.clear();
        self.drawn.extend((0..sizes.batch).map(|_| Drawn {
            what: replay.draw(returns.steps, random),
            part: imagination.partitions.draw(entities, random),
        }));
        let records = self.drawn.len();
        self.resize(records.div_ceil(CHUNK));
        let Self { config, online, target, drawn, chunks, .. } = self;
        in_lanes(self.threads, chunks, |index, chunk| {
            let drawn = &drawn[index * CHUNK..records.min((index + 1) * CHUNK)];
            chunk.gather(config, replay, environment, drawn);
            chunk.descend(config, online, target, records);
        });
        self.follow(update, records)
    }

    /// Learns from as many whole episodes as a batch has, of which there need to be so many.
    pub fn update_from_episodes(
        &mut self,
        episodes: &Episodes,
        environment: &dyn Environment,
        update: Update,
        random: &mut Random,
    ) -> UpdateReport {
        let entities = environment.spec().shape.entities;
        let Config { imagination, replay: sizes, .. } = &self.config;
        episodes.draw(sizes.batch, random, &mut self.indices);
        self.drawn_episodes.clear();
        self.drawn_episodes.extend(self.indices.iter().map(|index| Drawn {
            what: *index,
            part: imagination.partitions.draw(entities, random),
        }));
        let steps = |drawn: &Drawn<usize>| episodes.episode(drawn.what).steps();
        // Episodes of about one length go through time together.
        self.drawn_episodes.sort_by_key(steps);
        let records = self.drawn_episodes.iter().map(steps).sum();
        let groups = grouped(&self.drawn_episodes, |drawn| steps(drawn) + 1);
        self.resize(groups.len());
        let Self { config, online, target, drawn_episodes, chunks, .. } = self;
        in_lanes(self.threads, chunks, |index, chunk| {
            let drawn = &drawn_episodes[groups[index].clone()];
            chunk.gather_episodes(config, episodes, environment, drawn);
            chunk.descend(config, online, target, records);
        });
        self.follow(update, records)
    }

    fn resize(&mut self, chunks: usize) {
        let parameters = self.online.parameters.len();
        self.chunks.resize_with(chunks, || Chunk::new(parameters));
    }

    /// Follows the gradient of all chunks.
    fn follow(&mut self, update: Update, records: usize) -> UpdateReport {
        let Self { config, online, target, average, optimiser, chunks, .. } = self;
        let (first, others) = chunks.split_first_mut().expect("a batch has records");
        for other in others {
            first.gradient.iter_mut().zip(&other.gradient).for_each(|(sum, part)| *sum += part);
            first.losses.real += other.losses.real;
            first.losses.imagined += other.losses.imagined;
        }
        let gradient_norm = clip_norm(&mut first.gradient, config.optimiser.clip);
        let parameters = &mut online.parameters;
        optimiser.step(parameters, &first.gradient, update.learning_rate);
        if update.moves_target {
            come_nearer(&mut target.parameters, parameters, config.optimiser.target_rate);
        }
        come_nearer(&mut average.parameters, parameters, config.optimiser.average_rate);
        UpdateReport { loss: first.losses.real / records as f64, gradient_norm }
    }
}

/// Moves parameters a share of the way; the whole way without rounding.
fn come_nearer(parameters: &mut [f32], to: &[f32], rate: f32) {
    if rate < 1.0 {
        move_towards(parameters, to, rate);
    } else {
        parameters.copy_from_slice(to);
    }
}

/// Cuts a list into ranges of about so many states, at least one item each.
fn grouped<T>(items: &[T], states: impl Fn(&T) -> usize) -> Vec<std::ops::Range<usize>> {
    let mut groups: Vec<std::ops::Range<usize>> = Vec::new();
    let mut sum = CHUNK_STATES;
    for (index, item) in items.iter().enumerate() {
        sum += states(item);
        match groups.last_mut() {
            Some(group) if sum <= CHUNK_STATES => group.end = index + 1,
            _ => {
                groups.push(index..index + 1);
                sum = states(item);
            }
        }
    }
    groups
}
