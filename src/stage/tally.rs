//! What a world has played, in sums that do not grow with it.

use alloc::collections::BTreeMap;
use alloc::string::String;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_envs::{Episode, Spec};

/// The finished episodes of a world.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Tally {
    /// How many.
    pub episodes: usize,
    /// Those whose task was fulfilled.
    pub solved: usize,
    /// Sum of their returns.
    pub returns: f64,
    /// Of every [metric](Spec::metrics) in their order.
    metrics: Vec<Sum>,
    /// By what kind of episode they are.
    pub by_team: BTreeMap<String, TeamTally>,
    /// The newest of them.
    #[serde(skip)]
    pub last: Option<Episode>,
}

/// A metric over the episodes that have a value of it.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Sum {
    /// The sum.
    pub sum: f64,
    /// How many episodes have a value.
    pub episodes: usize,
}

/// The finished episodes of one team.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TeamTally {
    /// How many.
    pub episodes: usize,
    /// Those whose task was fulfilled.
    pub solved: usize,
}

impl Tally {
    /// Counts one more.
    pub fn add(&mut self, episode: Episode) {
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
    pub fn metric(&self, spec: &Spec, name: &str) -> Sum {
        let place = spec.metrics.iter().position(|metric| metric.name == name);
        place.and_then(|place| self.metrics.get(place)).copied().unwrap_or_default()
    }
}
