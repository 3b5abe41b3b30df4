//! What an episode came to.

/// Counts of one episode, final once it is done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeMetrics {
    /// Steps so far.
    pub steps: u32,
    /// Buildings of the episode.
    pub buildings: u32,
    /// Whether all buildings are complete.
    pub solved: bool,
    /// Whether the time ran out.
    pub timed_out: bool,
    /// Sum of the team's rewards.
    pub episode_return: f64,
    /// Fires put out.
    pub fires_extinguished: u32,
    /// Buildings completed.
    pub buildings_completed: u32,
    /// Buildings lost.
    pub buildings_burned: u32,
    /// Sum of all changes of health.
    pub health_delta: f64,
    pub(super) firefights: KindCount,
    pub(super) builds: KindCount,
}

/// Over (step, building) pairs with at least one agent at work, the kinds that worked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct KindCount {
    pub(super) pairs: u32,
    pub(super) kinds: u32,
}

impl KindCount {
    pub(super) fn add(&mut self, kinds: u8) {
        self.pairs += u32::from(kinds != 0);
        self.kinds += kinds.count_ones();
    }

    fn mean(&self) -> Option<f64> {
        (self.pairs > 0).then(|| f64::from(self.kinds) / f64::from(self.pairs))
    }
}

impl EpisodeMetrics {
    /// Share of the buildings that are complete.
    pub fn proportion_completed(&self) -> f64 {
        f64::from(self.buildings_completed) / f64::from(self.buildings)
    }

    /// Whether no building was lost, which is what the dissertation's text calls success.
    pub fn none_burned(&self) -> bool {
        self.buildings_burned == 0
    }

    /// Mean number of distinct kinds at a fire that anyone fought.
    pub fn types_per_firefight(&self) -> Option<f64> {
        self.firefights.mean()
    }

    /// Mean number of distinct kinds at a building that anyone built.
    pub fn types_per_build(&self) -> Option<f64> {
        self.builds.mean()
    }

    /// All values that the episode has, under the names that reports use.
    pub fn entries(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let flag = |value: bool| Some(f64::from(u8::from(value)));
        [
            ("return", Some(self.episode_return)),
            ("length", Some(f64::from(self.steps))),
            ("solved", flag(self.solved)),
            ("episode_limit", flag(self.timed_out)),
            ("none_burned", flag(self.none_burned())),
            ("prop_buildings_completed", Some(self.proportion_completed())),
            ("fires_extinguished", Some(self.fires_extinguished.into())),
            ("buildings_completed", Some(self.buildings_completed.into())),
            ("buildings_burned", Some(self.buildings_burned.into())),
            ("buildings_health_delta", Some(self.health_delta)),
            ("types_per_firefight", self.types_per_firefight()),
            ("types_per_build", self.types_per_build()),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
    }
}
