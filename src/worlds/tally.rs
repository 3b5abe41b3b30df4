//! What a world has played, in sums that do not grow with it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::EpisodeMetrics;

/// How one episode of the world ended.
#[derive(Clone, Debug)]
pub(crate) struct FinishedEpisode {
    /// The team's letters, such as `BFFG`.
    pub(crate) team: String,
    pub(crate) metrics: EpisodeMetrics,
}

/// The finished episodes of a world.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Tally {
    pub(crate) episodes: usize,
    pub(crate) solved: usize,
    pub(crate) returns: f64,
    pub(crate) buildings_saved: u64,
    pub(crate) buildings: u64,
    pub(crate) by_team: BTreeMap<String, TeamTally>,
    /// The newest of them.
    #[serde(skip)]
    pub(crate) last: Option<FinishedEpisode>,
}

/// The finished episodes of one team.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TeamTally {
    pub(crate) episodes: usize,
    pub(crate) solved: usize,
}

impl Tally {
    pub(crate) fn add(&mut self, episode: FinishedEpisode) {
        let metrics = &episode.metrics;
        self.episodes += 1;
        self.solved += usize::from(metrics.solved);
        self.returns += metrics.episode_return;
        self.buildings_saved += u64::from(metrics.buildings_completed);
        self.buildings += u64::from(metrics.buildings);
        let team = self.by_team.entry(episode.team.clone()).or_default();
        team.episodes += 1;
        team.solved += usize::from(metrics.solved);
        self.last = Some(episode);
    }
}
