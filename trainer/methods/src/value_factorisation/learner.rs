//! Updates: records become a gradient, the gradient better weights.

use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_learn::run::UpdateReport;
use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{Adam, clip_norm, move_towards};

use super::config::{Config, ReturnsConfig};
use super::replay::{Place, Replay};
use super::temporal_difference::{Batch, Losses, Network, TemporalDifference};

/// Records of a chunk: so many rows fit into the processor's nearest cache.
const CHUNK: usize = 32;

/// Networks and optimiser.
#[derive(Clone, Debug)]
pub struct Learner {
    config: Config,
    threads: usize,
    pub(super) online: Network,
    pub(super) target: Network,
    pub(super) average: Network,
    pub(super) adam: Adam,
    drawn: Vec<Drawn>,
    chunks: Vec<Chunk>,
}

/// A record that is learned from, and the partition that is imagined in it.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    place: Place,
    part: EntitySet,
}

/// Some records and the gradient that they give; chunks do not depend on each other.
#[derive(Clone, Debug, Default)]
struct Chunk {
    pass: TemporalDifference,
    batch: Batch,
    seen: Observation,
    companions: Vec<EntitySet>,
    gradient: Vec<f32>,
    losses: Losses,
}

impl Learner {
    /// Begins with these weights.
    pub fn new(config: Config, network: Network, threads: usize) -> Self {
        let parameters = network.parameters.len();
        let chunk = Chunk { gradient: vec![0.0; parameters], ..Chunk::default() };
        Self {
            threads,
            adam: Adam::new(parameters, config.optimiser.epsilon),
            target: network.clone(),
            average: network.clone(),
            online: network,
            drawn: Vec::new(),
            chunks: vec![chunk; config.replay.batch.div_ceil(CHUNK)],
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
        learning_rate: f32,
        random: &mut Random,
    ) -> UpdateReport {
        self.draw(replay, environment.spec().shape.entities, random);
        let Self { config, online, target, drawn, chunks, .. } = self;
        let records = drawn.len();
        in_lanes(self.threads, chunks, |index, chunk| {
            let drawn = &drawn[index * CHUNK..records.min((index + 1) * CHUNK)];
            chunk.gather(config, replay, environment, drawn);
            chunk.descend(config, online, target, records);
        });
        let (first, others) = chunks.split_first_mut().expect("a batch has records");
        for other in others {
            first.gradient.iter_mut().zip(&other.gradient).for_each(|(sum, part)| *sum += part);
            first.losses.real += other.losses.real;
            first.losses.imagined += other.losses.imagined;
        }
        let gradient_norm = clip_norm(&mut first.gradient, config.optimiser.clip);
        let parameters = &mut online.parameters;
        self.adam.step(&mut [parameters], &first.gradient, learning_rate);
        move_towards(&mut target.parameters, parameters, config.optimiser.target_rate);
        move_towards(&mut self.average.parameters, parameters, config.optimiser.average_rate);
        UpdateReport { loss: first.losses.real / records as f64, gradient_norm }
    }

    /// Draws records and partitions, in one order whoever computes with them.
    fn draw(&mut self, replay: &Replay, entities: usize, random: &mut Random) {
        let Config { imagination, returns, replay: config, .. } = &self.config;
        self.drawn.clear();
        self.drawn.extend((0..config.batch).map(|_| Drawn {
            place: replay.draw(returns.steps, random),
            part: imagination.partitions.draw(entities, random),
        }));
    }
}

impl Chunk {
    /// Looks at the states of records.
    fn gather(
        &mut self,
        config: &Config,
        replay: &Replay,
        environment: &dyn Environment,
        drawn: &[Drawn],
    ) {
        let ReturnsConfig { steps, discount } = config.returns;
        let partitions = config.imagination.partitions;
        let Self { batch, seen, companions, .. } = self;
        companions.resize(environment.spec().shape.agents, EntitySet::MAX);
        batch.clear();
        for &Drawn { place, part } in drawn {
            let state = replay.state(place);
            environment.observe(state, 0, EntitySet::MAX, seen);
            if partitions.needs_companions() {
                environment.companions(state, companions);
            }
            batch.before.push(seen, |agent| partitions.within(part, companions[agent], agent));
            batch.actions.extend_from_slice(&replay.actions(place)[..seen.agents()]);
            let future = replay.future(place, steps, discount);
            batch.rewards.push(future.reward);
            batch.discounts.push(future.discount);
            environment.observe(replay.state(future.place), 0, EntitySet::MAX, seen);
            batch.after.push(seen, |_| EntitySet::MAX);
        }
        batch.before.finish();
        batch.after.finish();
    }

    /// Computes the gradient of the mean loss of so many records, of which these are a part.
    fn descend(&mut self, config: &Config, online: &Network, target: &Network, records: usize) {
        let imagination = &config.imagination;
        let imagined = imagination.partitions.imagines().then_some(imagination.share);
        let Self { pass, batch, gradient, losses, .. } = self;
        gradient.fill(0.0);
        *losses = pass.descend(online, target, batch, imagined, records, gradient);
    }
}
