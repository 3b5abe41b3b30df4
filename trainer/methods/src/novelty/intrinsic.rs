//! Intrinsic rewards: what an agent earns for being where it, or others, have rarely been
//! (dissertation section 4.3).

use serde::{Deserialize, Serialize};

/// What counts as worth exploring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Intrinsic {
    /// What is novel to the agent itself.
    Independent,
    /// What is novel to everybody.
    Minimum,
    /// What is more novel to the agent than to the team: places that it knows less than others.
    Covering,
    /// What is less novel to the agent than to the team: places that it knows better than others.
    Burrowing,
    /// The first agent burrows, the others cover.
    LeaderFollower,
    /// Where the team as a whole has not been.
    Centralized,
}

impl Intrinsic {
    /// The types that the dissertation chooses among, in its order.
    pub const CHOSEN: [Self; 5] =
        [Self::Independent, Self::Minimum, Self::Covering, Self::Burrowing, Self::LeaderFollower];

    /// Its name, as configurations have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Independent => "independent",
            Self::Minimum => "minimum",
            Self::Covering => "covering",
            Self::Burrowing => "burrowing",
            Self::LeaderFollower => "leader-follower",
            Self::Centralized => "centralized",
        }
    }

    /// What an agent earns in a cell that is so novel to each agent, and where the team's cells together are so novel.
    ///
    /// In 32 bits and in the published order: where all are equal, the mean may differ from them by one bit, and a tie
    /// pays.
    #[inline]
    pub fn reward(self, novelties: &[f32], team: f32, agent: usize) -> f32 {
        let own = novelties[agent];
        let mean = || novelties.iter().sum::<f32>() / novelties.len() as f32;
        let paid = |pays: fn(&f32) -> bool| {
            let (mean, beyond) = (mean(), own - mean());
            if pays(&beyond) { beyond + mean } else { 0.0 }
        };
        match self {
            Self::Independent => own,
            Self::Minimum => novelties.iter().copied().fold(f32::INFINITY, f32::min),
            Self::Covering => paid(|beyond| *beyond > 0.0),
            Self::Burrowing => paid(|beyond| *beyond < 0.0),
            Self::LeaderFollower if agent == 0 => Self::Burrowing.reward(novelties, team, agent),
            Self::LeaderFollower => Self::Covering.reward(novelties, team, agent),
            Self::Centralized => team,
        }
    }
}

/// Types of intrinsic rewards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Types {
    /// The five that the dissertation chooses among.
    Multi,
    /// None.
    None,
    /// One.
    #[serde(untagged)]
    One(Intrinsic),
}

impl Types {
    /// All of them, as files have them.
    pub(crate) const WORDS: &[&str] = &[
        "multi",
        "none",
        "independent",
        "minimum",
        "covering",
        "burrowing",
        "leader-follower",
        "centralized",
    ];

    /// The types of the heads, and at last the one without.
    pub(crate) fn heads(self) -> Vec<Option<Intrinsic>> {
        let types = match self {
            Self::Multi => Intrinsic::CHOSEN.to_vec(),
            Self::None => Vec::new(),
            Self::One(intrinsic) => vec![intrinsic],
        };
        types.into_iter().map(Some).chain([None]).collect()
    }
}
