//! Random observations of all mask patterns, by seed.

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_bundle::OwnedObservation;
use sortie_core::{EntityMask, NO_ACTION};

/// `count` random observations of up to `n_max` entities: rows sparse and dense in turn, masks that show
/// everything, nothing, only the agent itself, everything but itself, or any entities.
pub fn random_observations(
    count: usize,
    n_max: usize,
    features: usize,
    actions: usize,
    seed: u64,
) -> Vec<OwnedObservation> {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(seed));
    (0..count).map(|index| random.observation(index, n_max.max(1), features, actions)).collect()
}

struct Random(Xoshiro256PlusPlus);

impl Random {
    fn observation(
        &mut self,
        index: usize,
        n_max: usize,
        features: usize,
        actions: usize,
    ) -> OwnedObservation {
        let entities = 1 + self.below(n_max);
        let agents = 1 + self.below(entities);
        let self_index = self.below(agents);
        let sparse = index.is_multiple_of(2);
        let rows = (0..entities * features).map(|_| self.feature(sparse)).collect();
        let last_actions = (0..agents).map(|_| self.last_action(actions)).collect();
        let mut available: Vec<u16> = (0..actions).map(|_| self.below(2) as u16).collect();
        let any = self.below(actions);
        available.iter_mut().skip(any).take(1).for_each(|code| *code = 1);
        let visible = self.visible(index / 2 % 5, entities, self_index);
        OwnedObservation { rows, features, last_actions, visible, self_index, available }
    }

    fn visible(&mut self, pattern: usize, entities: usize, own: usize) -> EntityMask {
        let mut mask = EntityMask::EMPTY;
        for entity in 0..entities {
            let shown = match pattern {
                0 => true,
                1 => false,
                2 => entity == own,
                3 => entity != own,
                _ => self.below(2) == 0,
            };
            if shown {
                mask.insert(entity);
            }
        }
        mask
    }

    fn feature(&mut self, sparse: bool) -> f32 {
        let zero = sparse && self.below(6) > 0;
        let value = (self.0.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0;
        if zero { 0.0 } else { value }
    }

    fn last_action(&mut self, actions: usize) -> u16 {
        match self.below(actions + 1) {
            none if none == actions => NO_ACTION,
            action => action as u16,
        }
    }

    /// A number below `bound`; the bias of the modulo does not matter here.
    fn below(&mut self, bound: usize) -> usize {
        (self.0.next_u32() as usize).checked_rem(bound).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_observations() {
        assert_eq!(random_observations(20, 9, 5, 3, 1), random_observations(20, 9, 5, 3, 1));
        assert_ne!(random_observations(20, 9, 5, 3, 1), random_observations(20, 9, 5, 3, 2));
    }

    #[test]
    fn every_mask_pattern_and_an_available_action_occur() {
        let all = random_observations(100, 6, 4, 3, 7);
        let own = |o: &OwnedObservation| o.visible.contains(o.self_index);
        assert!(all.iter().any(|o| o.visible.is_empty()));
        assert!(all.iter().any(|o| o.visible.len() == o.entities() && o.entities() == 6));
        assert!(all.iter().any(|o| o.visible.len() == 1 && own(o)));
        assert!(all.iter().any(|o| !own(o) && !o.visible.is_empty()));
        assert!(all.iter().all(|o| o.available.iter().any(|&code| code > 0)));
    }
}
