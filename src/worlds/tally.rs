//! What a world has played, in sums that do not grow with it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_envs::{Episode, Spec};

/// The finished episodes of a world.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Tally {
    pub(crate) episodes: usize,
    pub(crate) solved: usize,
    pub(crate) returns: f64,
    /// Of every [metric](Spec::metrics) in their order.
    metrics: Vec<Sum>,
    pub(crate) by_team: BTreeMap<String, TeamTally>,
    /// The newest of them.
    #[serde(skip)]
    pub(crate) last: Option<Episode>,
}

/// A metric over the episodes that have a value of it.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Sum {
    pub(crate) sum: f64,
    pub(crate) episodes: usize,
}

/// The finished episodes of one team.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TeamTally {
    pub(crate) episodes: usize,
    pub(crate) solved: usize,
}

impl Tally {
    pub(crate) fn add(&mut self, episode: Episode) {
        self.episodes += 1;
        self.solved += usize::from(episode.solved);
        self.returns += episode.episode_return;
        self.metrics.resize(episode.metrics.len(), Sum::default());
        for (sum, value) in self.metrics.iter_mut().zip(&episode.metrics) {
            sum.sum += value.unwrap_or(0.0);
            sum.episodes += usize::from(value.is_some());
        }
        let team = self.by_team.entry(episode.group.clone()).or_default();
        team.episodes += 1;
        team.solved += usize::from(episode.solved);
        self.last = Some(episode);
    }

    /// The sum of a metric of the environment that was played.
    pub(crate) fn metric(&self, spec: &Spec, name: &str) -> Sum {
        let place = spec.metrics.iter().position(|metric| metric.name == name);
        place.and_then(|place| self.metrics.get(place)).copied().unwrap_or_default()
    }
}
