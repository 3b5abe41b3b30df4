//! Partitions of entities, for imagination (dissertation section 5.4).
//!
//! A partition says for each agent which entities are in its part. The imagined utilities see either
//! what lies within or what lies across.

use sortie_envs::random::{chance, unit};
use sortie_envs::{EntitySet, Random};
use sortie_learn::words;

words! {
    /// Where the partitions of imagined utilities come from.
    Partitions {
        /// Nothing is imagined (A-QMIX, VDN).
        None = "none",
        /// Drawn for every use of a state (REFIL): `p` uniform, then each entity with probability `p`.
        Drawn = "drawn",
        /// Who truly belongs together, as the environment knows (fixed oracle).
        Companions = "companions",
        /// Who truly belongs together and shares the drawn part (randomised oracle).
        DrawnCompanions = "drawn-companions",
    }
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

#[cfg(test)]
mod tests {
    use sortie_nn::random::stream;

    use super::*;

    #[test]
    fn a_partition_has_two_parts_that_do_not_meet() {
        let mut generator = stream(6, 1, 0);
        let mut sizes = [0; 6];
        for _ in 0..6000 {
            let part = Partitions::Drawn.draw(5, &mut generator);
            sizes[part.count_ones() as usize] += 1;
            for agent in 0..5 {
                let within = Partitions::Drawn.within(part, 0, agent);
                assert_eq!(within >> agent & 1, 1);
                for other in 0..5 {
                    let seen = Partitions::Drawn.within(part, 0, other) >> agent & 1;
                    assert_eq!(within >> other & 1, seen);
                }
            }
        }
        // With p uniform every size is as likely.
        assert!(sizes.iter().all(|count| (850..1150).contains(count)), "{sizes:?}");
    }
}
