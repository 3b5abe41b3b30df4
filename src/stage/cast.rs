//! What a page brings along: a team, the rules of its options, what its agents answered once, and what it plays, as bytes.

use alloc::string::String;
use alloc::vec;
use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use sortie_attention::AttentionLayers;
use sortie_core::options::{Affordance, Milestone, OptionRules, PictureShape};
use sortie_core::{EntityMask, Observation};

/// A team as it is deployed, and what it plays in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cast {
    /// The environment.
    pub environment: String,
    /// The set of starts.
    pub set: String,
    /// Hash of the contract.
    pub contract: u64,
    /// Ticks between two allocations.
    pub decision_interval: u32,
    /// What an agent does that has nothing better to do.
    pub safe_action: Option<u16>,
    /// The plans of the agents.
    pub plans: Vec<Vec<u8>>,
    /// The plan of each agent; empty where one is for all, or an agent runs options.
    pub plan_of: Vec<u16>,
    /// What an agent goes by that runs options; its plans are controller, meta-controller and affordances.
    pub options: Option<OptionSettings>,
    /// Who assigns agents to subtasks, where somebody does.
    pub allocator: Option<AllocatorCast>,
    /// What tells whom agents attend to, where they do.
    pub attention: Option<AttentionLayers>,
    /// The bundle's golden observations.
    pub golden: Vec<GoldenObservation>,
}

/// A learned allocator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum AllocatorCast {
    /// It values teams.
    TeamValue {
        /// The plan of its network.
        plan: Vec<u8>,
        /// Most entities N of the networks.
        entities: u16,
        /// Most subtasks T.
        tasks: u16,
        /// Largest team of one subtask.
        team_max: u16,
    },
    /// It points at subtasks.
    Pointing {
        /// The plans of encoder and decoder.
        plans: [Vec<u8>; 2],
        /// Subtasks that one agent alone can be given, as bits.
        exclusive: u32,
        /// The action that heads for the first subtask.
        first_action: u16,
    },
}

impl Cast {
    /// As a page holds it.
    ///
    /// # Errors
    /// There is no room for it.
    pub fn to_bytes(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_allocvec(self)
    }

    /// From what a page holds.
    ///
    /// # Errors
    /// The bytes are of another version.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, postcard::Error> {
        postcard::from_bytes(bytes)
    }
}

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

/// An observation of the bundle's golden cases, without zeros.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoldenObservation {
    /// `[N]`: columns and values of each row.
    rows: Vec<Vec<(u16, f32)>>,
    /// Columns of a row.
    features: u16,
    last_actions: Vec<u16>,
    visible: [u64; 2],
    self_index: u16,
    available: Vec<u16>,
}

impl GoldenObservation {
    /// What an agent saw; the first so many columns of a row count.
    pub fn new(observation: &Observation<'_>, features: usize) -> Self {
        let rows = observation.rows.chunks(observation.stride.max(1)).map(|row| {
            let values = (0_u16..).zip(row.iter().take(features).copied());
            values.filter(|(_, value)| value.to_bits() != 0).collect()
        });
        let [low, high] = [0, 1].map(|word| observation.visible.words().get(word).copied());
        Self {
            rows: rows.collect(),
            features: features as u16,
            last_actions: observation.last_actions.to_vec(),
            visible: [low.unwrap_or(0), high.unwrap_or(0)],
            self_index: observation.self_index as u16,
            available: observation.available.to_vec(),
        }
    }

    /// Its rows in full, for [`Self::view`].
    pub fn dense(&self) -> Vec<f32> {
        let features = usize::from(self.features);
        let mut dense = vec![0.0; self.rows.len() * features];
        for (row, to) in self.rows.iter().zip(dense.chunks_exact_mut(features.max(1))) {
            for (column, value) in row {
                if let Some(to) = to.get_mut(usize::from(*column)) {
                    *to = *value;
                }
            }
        }
        dense
    }

    /// As a policy takes it, over its rows in full.
    pub fn view<'a>(&'a self, dense: &'a [f32]) -> Observation<'a> {
        Observation {
            rows: dense,
            stride: self.features.into(),
            last_actions: &self.last_actions,
            visible: EntityMask::from_words(&self.visible),
            self_index: self.self_index.into(),
            available: &self.available,
        }
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

    #[test]
    fn an_observation_comes_back_as_it_was() {
        let seen = Observation {
            rows: &[0.0, 1.5, 7.0, -0.0, 0.0, 7.0],
            stride: 3,
            last_actions: &[4],
            visible: EntityMask::from_words(&[0b10, 1]),
            self_index: 1,
            available: &[1, 0],
        };
        let kept = GoldenObservation::new(&seen, 2);
        let bytes = postcard::to_allocvec(&kept).expect("there is room");
        let kept: GoldenObservation = postcard::from_bytes(&bytes).expect("it comes back");
        let dense = kept.dense();
        let bits: Vec<u32> = dense.iter().map(|value| value.to_bits()).collect();
        assert_eq!(bits, [0.0, 1.5, -0.0_f32, 0.0].map(f32::to_bits));
        let view = kept.view(&dense);
        assert_eq!((view.stride, view.self_index, view.visible), (2, 1, seen.visible));
        assert_eq!((view.last_actions, view.available), (seen.last_actions, seen.available));
    }
}
