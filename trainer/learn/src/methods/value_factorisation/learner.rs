//! Updates: records become a gradient, the gradient better weights.

use sortie_envs::{EntitySet, Environment, Observation, Random};
use sortie_nn::optimise::{Adam, clip_norm, move_towards};

use super::config::Config;
use super::replay::Replay;
use super::temporal_difference::{Batch, Losses, Network, TemporalDifference};

/// Records of a chunk: so many rows fit into the processor's nearest cache.
const CHUNK: usize = 32;

/// Networks, optimiser and buffers.
#[derive(Clone, Debug)]
pub struct Learner {
    config: Config,
    online: Network,
    target: Network,
    average: Network,
    adam: Adam,
    gradient: Vec<f32>,
    pass: TemporalDifference,
    batch: Batch,
    seen: Observation,
    companions: Vec<EntitySet>,
}

impl Learner {
    /// Begins with these weights.
    pub fn new(config: Config, network: Network) -> Self {
        let parameters = network.parameters.len();
        Self {
            adam: Adam::new(parameters, config.epsilon),
            gradient: vec![0.0; parameters],
            target: network.clone(),
            average: network.clone(),
            online: network,
            pass: TemporalDifference::default(),
            batch: Batch::default(),
            seen: Observation::default(),
            companions: Vec::new(),
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

    /// Learns from as many records as a batch has, at a share `progress` of the run; the mean losses.
    pub fn update(
        &mut self,
        replay: &Replay,
        environment: &dyn Environment,
        progress: f32,
        random: &mut Random,
    ) -> Losses {
        let Config { batch: records, partitions, .. } = self.config;
        let imagined = partitions.imagines().then_some(self.config.imagined);
        self.gradient.fill(0.0);
        let mut losses = Losses::default();
        for start in (0..records).step_by(CHUNK) {
            self.gather(replay, environment, CHUNK.min(records - start), random);
            let part = self.pass.descend(
                &self.online,
                &self.target,
                &self.batch,
                imagined,
                records,
                &mut self.gradient,
            );
            losses.real += part.real / records as f64;
            losses.imagined += part.imagined / records as f64;
            losses.targets += part.targets / records as f64;
        }
        clip_norm(&mut self.gradient, self.config.clip);
        let fall = ((1.0 - progress) / (1.0 - self.config.constant)).clamp(0.0, 1.0);
        let parameters = &mut self.online.parameters;
        self.adam.step(&mut [parameters], &self.gradient, self.config.learning_rate * fall);
        move_towards(&mut self.target.parameters, parameters, self.config.target_rate);
        move_towards(&mut self.average.parameters, parameters, self.config.average_rate);
        losses
    }

    /// Draws records and looks at their states.
    fn gather(
        &mut self,
        replay: &Replay,
        environment: &dyn Environment,
        records: usize,
        random: &mut Random,
    ) {
        let Config { partitions, steps, discount, .. } = self.config;
        let (batch, seen) = (&mut self.batch, &mut self.seen);
        let shape = environment.spec().shape;
        self.companions.resize(shape.agents, EntitySet::MAX);
        batch.clear();
        for _ in 0..records {
            let place = replay.draw(steps, random);
            let state = replay.state(place);
            environment.observe(state, 0, EntitySet::MAX, seen);
            let part = partitions.draw(shape.entities, random);
            if partitions.needs_companions() {
                environment.companions(state, &mut self.companions);
            }
            let companions = &self.companions;
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
}
