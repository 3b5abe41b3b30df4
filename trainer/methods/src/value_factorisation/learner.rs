//! Updates: records or episodes, of which there are single steps or whole ones, become a gradient, the gradient better
//! weights.

use sortie_envs::{EntitySet, Environment, Observation, Random, Spec};
use sortie_learn::run::UpdateReport;
use sortie_learn::state::{self, State};
use sortie_learn::{LearnError, Transition};
use sortie_nn::lanes::in_lanes;
use sortie_nn::optimise::{Adam, RmsProp, clip_norm, move_towards};

use super::memory::Moment;
use super::replay::{End, Episodes, Place, Replay};
use super::scenes::Scenes;
use super::temporal_difference::{Batch, Losses, Network, TemporalDifference};
use super::{Config, ReplayConfig, ReturnsConfig, Rule, Unit};

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

/// What is learned from, and the partition that is imagined in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn<W> {
    pub(super) what: W,
    pub(super) part: EntitySet,
}

/// Some of what an update learns from.
#[derive(Clone, Debug, Default)]
pub(super) struct Chunk {
    pass: TemporalDifference,
    batch: Batch,
    seen: Observation,
    companions: Vec<EntitySet>,
    pub(super) gradient: Vec<f32>,
    pub(super) losses: Losses,
}

impl Chunk {
    /// One with room for the gradient of so many parameters.
    pub(super) fn new(parameters: usize) -> Self {
        Self { gradient: vec![0.0; parameters], ..Self::default() }
    }

    /// Looks at the states of records.
    pub(super) fn gather(
        &mut self,
        config: &Config,
        replay: &Replay,
        environment: &dyn Environment,
        drawn: &[Drawn<Place>],
    ) {
        let ReturnsConfig { steps, discount } = config.returns;
        self.batch.clear();
        for &Drawn { what: place, part } in drawn {
            let moment = Moment { step: 0, episode: self.batch.before.sizes().len() };
            self.look(config, environment, (replay.state(place), moment), part);
            let Self { batch, seen, .. } = self;
            batch.actions.extend_from_slice(&replay.actions(place)[..seen.agents()]);
            let future = replay.future(place, steps, discount);
            batch.rewards.push(future.reward);
            batch.discounts.push(future.discount);
            environment.observe(replay.state(future.place), 0, EntitySet::MAX, seen);
            batch.after.push(seen, |_| EntitySet::MAX);
        }
        self.batch.before.finish();
        self.batch.after.finish();
    }

    /// Looks at the states of whole episodes.
    fn gather_episodes(
        &mut self,
        config: &Config,
        episodes: &Episodes,
        environment: &dyn Environment,
        drawn: &[Drawn<usize>],
    ) {
        let ReturnsConfig { steps, discount } = config.returns;
        if self.batch.before.is_empty() {
            self.batch.before = Scenes::sharing();
        }
        self.batch.clear();
        for (place, &Drawn { what: index, part }) in drawn.iter().enumerate() {
            let episode = episodes.episode(index);
            let first = self.batch.next.len();
            for step in 0..=episode.steps() {
                let moment = Moment { step, episode: place };
                self.look(config, environment, (episodes.state(index, step), moment), part);
                let Self { batch, seen, .. } = self;
                let agents = seen.agents();
                match episodes.actions(index, step) {
                    Some(actions) => batch.actions.extend_from_slice(&actions[..agents]),
                    None => batch.actions.extend((0..agents).map(|_| 0)),
                }
                let ahead = episode.ahead(step, steps, discount);
                batch.next.push(ahead.map(|ahead| first + ahead.step));
                batch.rewards.push(ahead.map_or(0.0, |ahead| ahead.reward));
                batch.discounts.push(ahead.map_or(0.0, |ahead| ahead.discount));
            }
        }
        self.batch.before.finish();
    }

    /// Adds a state with a part of its entities to those in which actions were taken.
    fn look(
        &mut self,
        config: &Config,
        environment: &dyn Environment,
        (state, moment): (&[u8], Moment),
        part: EntitySet,
    ) {
        let partitions = config.imagination.partitions;
        let Self { batch, seen, companions, .. } = self;
        environment.observe(state, 0, EntitySet::MAX, seen);
        companions.resize(environment.spec().shape.agents, EntitySet::MAX);
        if partitions.needs_companions() {
            environment.companions(state, companions);
        }
        let within = |agent: usize| partitions.within(part, companions[agent], agent);
        batch.before.push_at(moment, seen, within);
    }

    /// Computes the gradient of the mean loss of so many records, of which these are a part.
    pub(super) fn descend(
        &mut self,
        config: &Config,
        online: &Network,
        target: &Network,
        records: usize,
    ) {
        let imagination = &config.imagination;
        let imagined = imagination.partitions.imagines().then_some(imagination.share);
        let Self { pass, batch, gradient, losses, .. } = self;
        gradient.fill(0.0);
        *losses = pass.descend(online, target, batch, imagined, records, gradient);
    }
}

#[derive(Clone, Debug)]
pub(super) enum Optimiser {
    Adam(Adam),
    RmsProp(RmsProp),
}

impl Optimiser {
    /// One that has taken no step yet.
    pub(super) fn new(rule: Rule, parameters: usize, epsilon: f32) -> Self {
        match rule {
            Rule::Adam => Self::Adam(Adam::new(parameters, epsilon)),
            Rule::RmsProp => Self::RmsProp(RmsProp::new(parameters)),
        }
    }

    /// Takes one step down the gradient.
    pub(super) fn step(&mut self, parameters: &mut [f32], gradient: &[f32], learning_rate: f32) {
        match self {
            Self::Adam(adam) => adam.step(&mut [parameters], gradient, learning_rate),
            Self::RmsProp(rule) => rule.step(parameters, gradient, learning_rate),
        }
    }

    /// Names what later steps depend on.
    pub(super) fn state(
        &mut self,
        state: &mut State<'_>,
        tensors: &[state::Tensor],
    ) -> Result<(), LearnError> {
        match self {
            Self::Adam(adam) => {
                state.tensors("adam-mean", tensors, &mut adam.mean)?;
                state.tensors("adam-square", tensors, &mut adam.square)?;
                state.value("adam-steps", &mut adam.steps)
            }
            Self::RmsProp(rule) => state.tensors("square", tensors, &mut rule.square),
        }
    }
}

#[derive(Debug)]
pub(super) enum Experience {
    Steps(Replay),
    Episodes(Episodes),
}

impl Experience {
    /// Room for as much as is to be kept of so many instances.
    pub(super) fn new(config: &ReplayConfig, instances: usize, spec: &Spec) -> Self {
        let (agents, bytes) = (spec.shape.agents, spec.state_bytes);
        let capacity = config.capacity;
        match config.unit {
            Unit::Steps => Self::Steps(Replay::new(instances, capacity / instances, agents, bytes)),
            Unit::Episodes => Self::Episodes(Episodes::new(instances, capacity, agents)),
        }
    }

    pub(super) fn push(&mut self, transition: &Transition<'_>) {
        let Transition { instance, state, actions, step, next, .. } = *transition;
        let end = match (step.terminated, step.timed_out) {
            (true, _) => End::Over,
            (_, true) => End::TimedOut,
            _ => End::Open,
        };
        let reward = step.reward as f32;
        match self {
            Self::Steps(replay) => {
                replay.push(instance, state, actions, reward, end);
                if step.done() {
                    replay.push_last(instance, next);
                }
            }
            Self::Episodes(episodes) => {
                episodes.push(instance, (state, actions), (reward, end), next);
            }
        }
    }

    /// Episodes that have ended, where they are counted.
    pub(super) fn finished(&self) -> u64 {
        match self {
            Self::Steps(_) => 0,
            Self::Episodes(episodes) => episodes.finished(),
        }
    }

    /// An update from what has been seen; `None` while that is less than a batch.
    pub(super) fn teach(
        &self,
        learner: &mut Learner,
        environment: &dyn Environment,
        update: Update,
        random: &mut Random,
        batch: usize,
    ) -> Option<UpdateReport> {
        match self {
            Self::Steps(replay) => Some(learner.update(replay, environment, update, random)),
            Self::Episodes(episodes) if episodes.finished() < batch as u64 => None,
            Self::Episodes(episodes) => {
                Some(learner.update_from_episodes(episodes, environment, update, random))
            }
        }
    }

    /// Names all of it.
    pub(super) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        match self {
            Self::Steps(replay) => state.value("replay", replay),
            Self::Episodes(episodes) => state.value("episodes", episodes),
        }
    }
}
