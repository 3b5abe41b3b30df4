//! Parts of a batch, which do not depend on each other: what is learned from, and the gradient that it gives.

use sortie_envs::{EntitySet, Environment, Observation};

use super::config::{Config, ReturnsConfig};
use super::episodes::Episodes;
use super::memory::Moment;
use super::replay::{Place, Replay};
use super::scenes::Scenes;
use super::temporal_difference::{Batch, Losses, Network, TemporalDifference};

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
    pub(super) fn gather_episodes(
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
