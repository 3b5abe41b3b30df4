//! The rules of an agent that runs options, as a page holds them.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_core::options::{Affordance, Milestone, OptionRules, PictureShape};

/// What makes [`OptionRules`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OptionSettings {
    /// Channels, size, counts and crop of the picture.
    picture: [u16; 4],
    nearest: bool,
    actions: u16,
    steps: u8,
    threshold: f32,
    action_chance: f32,
    goal_chance: f32,
    varied: bool,
    seed: u64,
    /// The count that shows each milestone, by how much it changes, and whether the milestone can be gone for: none where
    /// the network says so.
    milestones: Vec<(u16, i16, Option<bool>)>,
}

impl From<&OptionRules> for OptionSettings {
    fn from(rules: &OptionRules) -> Self {
        let PictureShape { channels, size, counts, crop, nearest } = rules.picture;
        let milestone = |it: &Milestone| {
            let affordance = match it.affordance {
                Affordance::Learned => None,
                Affordance::Always => Some(true),
                Affordance::Never => Some(false),
            };
            (it.carried as u16, it.change, affordance)
        };
        Self {
            picture: [channels, size, counts, crop].map(|number| number as u16),
            nearest,
            actions: rules.actions as u16,
            steps: rules.steps,
            threshold: rules.threshold,
            action_chance: rules.action_chance,
            goal_chance: rules.goal_chance,
            varied: rules.varied,
            seed: rules.seed,
            milestones: rules.milestones().iter().map(milestone).collect(),
        }
    }
}

impl OptionSettings {
    /// The rules; none where they do not hold together.
    pub fn rules(&self) -> Option<OptionRules> {
        let [channels, size, counts, crop] = self.picture.map(usize::from);
        let picture = PictureShape { channels, size, counts, crop, nearest: self.nearest };
        let milestone = |(carried, change, affordance): &(u16, i16, Option<bool>)| Milestone {
            carried: (*carried).into(),
            change: *change,
            affordance: match affordance {
                None => Affordance::Learned,
                Some(true) => Affordance::Always,
                Some(false) => Affordance::Never,
            },
        };
        let milestones: Vec<Milestone> = self.milestones.iter().map(milestone).collect();
        let actions = self.actions.into();
        let mut rules = OptionRules::new(picture, actions, self.steps, &milestones)?;
        rules.threshold = self.threshold;
        rules.action_chance = self.action_chance;
        rules.goal_chance = self.goal_chance;
        rules.varied = self.varied;
        rules.seed = self.seed;
        Some(rules)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_come_back_as_they_were() {
        let picture = PictureShape { channels: 3, size: 5, counts: 2, crop: 3, nearest: true };
        let kinds = [Affordance::Learned, Affordance::Always, Affordance::Never];
        let milestones = [(0, 1), (1, -2), (1, 3)];
        let milestones: Vec<Milestone> = milestones
            .into_iter()
            .zip(kinds)
            .map(|((carried, change), affordance)| Milestone { carried, change, affordance })
            .collect();
        let mut rules = OptionRules::new(picture, 7, 9, &milestones).expect("they hold together");
        rules.threshold = 0.25;
        rules.action_chance = 0.125;
        rules.goal_chance = 0.75;
        rules.varied = false;
        rules.seed = u64::MAX;
        assert_eq!(OptionSettings::from(&rules).rules(), Some(rules));
    }
}
