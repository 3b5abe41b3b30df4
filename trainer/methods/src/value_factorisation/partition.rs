//! Partitions of the entities, for imagination (dissertation section 5.4).
//!
//! A partition says for each agent which entities are in its part. The imagined utilities see either
//! what lies within or what lies across.

use serde::{Deserialize, Serialize};
use sortie_envs::random::{chance, unit};
use sortie_envs::{EntitySet, Random};

/// Where the partitions of imagined utilities come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Partitions {
    /// Nothing is imagined (A-QMIX, VDN).
    #[default]
    None,
    /// Drawn for every use of a state (REFIL): `p` uniform, then each entity with probability `p`.
    Drawn,
    /// Who truly belongs together, as the environment knows (fixed oracle).
    Companions,
    /// Who truly belongs together and shares the drawn part (randomised oracle).
    DrawnCompanions,
}

impl Partitions {
    /// Whether anything is imagined.
    pub fn imagines(self) -> bool {
        self != Self::None
    }

    /// Whether it is about who truly belongs together.
    pub fn needs_companions(self) -> bool {
        matches!(self, Self::Companions | Self::DrawnCompanions)
    }

    /// Draws one part of so many entities, as bits, where the partition is one that is drawn.
    pub fn draw(self, entities: usize, random: &mut Random) -> EntitySet {
        if matches!(self, Self::None | Self::Companions) {
            return 0;
        }
        let probability = unit(random);
        (0..entities)
            .fold(0, |part, entity| part | EntitySet::from(chance(random, probability)) << entity)
    }

    /// The entities in the part of one agent, given the drawn part and the agent's companions.
    pub fn within(self, part: EntitySet, companions: EntitySet, agent: usize) -> EntitySet {
        let drawn = if part >> agent & 1 == 1 { part } else { !part };
        match self {
            Self::None => EntitySet::MAX,
            Self::Drawn => drawn,
            Self::Companions => companions,
            Self::DrawnCompanions => drawn & companions,
        }
    }
}
