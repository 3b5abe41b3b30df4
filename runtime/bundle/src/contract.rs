//! What a policy was trained for, independent of team size.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_core::identity::fnv1a;
use sortie_core::limits;
use sortie_core::options::{Affordance, Milestone, OptionRules, PictureShape, Shown};

/// Version of what policies are shown and answer. The messages that carry both have a number of their own,
/// [`sortie_core::wire::ABI`].
pub const CONTRACT_ABI: u16 = 1;

/// The contract, version 1; its hash is what processes compare.
///
/// Fields are hashed in this order, strings included, so that a reordered feature list differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContractV1 {
    /// [`CONTRACT_ABI`].
    pub abi: u16,
    /// Number of actions U.
    pub actions: u16,
    /// Number of features d of an entity, its last action not counted.
    pub features: u16,
    /// The features' names, in order.
    pub feature_names: Vec<String>,
    /// The actions' names, in order.
    pub action_names: Vec<String>,
    /// Steps between two allocations.
    pub decision_interval: u32,
    /// Whether the network takes the last action's one-hot behind the features.
    pub append_last_action: bool,
    /// How the policy knows its subtask.
    pub subtask_conditioning: SubtaskConditioning,
    /// Whether availability codes of 2 and more name a subtask or a target.
    pub subtask_actions: bool,
    /// The action of an agent that has no policy or no subtask; none: it does not act.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub safe_action: Option<u16>,
    /// What agents do without a valid allocation.
    pub fallback_allocation: FallbackAllocation,
}

/// How a policy is conditioned on its subtask (dissertation section 7.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SubtaskConditioning {
    /// Not at all: a flat method.
    None,
    /// The agent attends only to entities of its subtask.
    Mask,
    /// Subtasks are embedded, everything observable stays visible.
    FullObservation,
}

/// What agents do without a valid allocation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FallbackAllocation {
    /// They take the safe action.
    Unallocated,
    /// Every agent computes the same allocation by cost.
    Heuristic,
}

impl ContractV1 {
    /// 64-bit FNV-1a over the contract's postcard bytes.
    pub fn hash(&self) -> u64 {
        // Serialising plain fields to memory has no way to fail; an empty hash would still match nothing.
        fnv1a(&postcard::to_stdvec(self).unwrap_or_default())
    }

    /// Columns D of the network's input.
    pub fn input_width(&self) -> usize {
        let last_action = if self.append_last_action { self.actions } else { 0 };
        usize::from(self.features) + usize::from(last_action)
    }

    /// A row by feature names, zeros left out.
    pub(crate) fn named(&self, row: &[f32]) -> BTreeMap<String, f32> {
        let named = self.feature_names.iter().cloned().zip(row.iter().copied());
        named.filter(|(_, value)| *value != 0.0).collect()
    }

    /// Rows `[N, d]` from features by name.
    pub(crate) fn rows(&self, entities: &[BTreeMap<String, f32>]) -> Result<Vec<f32>, String> {
        let features = usize::from(self.features);
        let index: BTreeMap<&str, usize> =
            self.feature_names.iter().map(String::as_str).zip(0..features).collect();
        let mut rows = vec![0.0; entities.len() * features];
        for (row, named) in rows.chunks_exact_mut(features.max(1)).zip(entities) {
            for (name, value) in named {
                let column = index.get(name.as_str()).and_then(|&column| row.get_mut(column));
                *column.ok_or_else(|| format!("`{name}` is not a feature"))? = *value;
            }
        }
        Ok(rows)
    }

    /// The first thing that is wrong with the contract itself.
    pub fn flaw(&self) -> Option<String> {
        let names = |what, names: &[String], count: u16| {
            let unique: std::collections::BTreeSet<_> = names.iter().collect();
            if names.len() != usize::from(count) {
                Some(format!("{} {what} names for {count} {what}s", names.len()))
            } else {
                (unique.len() != names.len()).then(|| format!("the same {what} name stands twice"))
            }
        };
        if self.abi != CONTRACT_ABI {
            return Some(format!("a contract of ABI {} where {CONTRACT_ABI} is known", self.abi));
        }
        if self.actions == 0 || self.features == 0 || self.decision_interval == 0 {
            return Some("actions, features and decision_interval must not be 0".to_owned());
        }
        if self.safe_action.is_some_and(|action| action >= self.actions) {
            return Some("safe_action is not an action".to_owned());
        }
        let sizes = [
            ("features", self.features, limits::FEATURES),
            ("actions", self.actions, limits::ACTIONS),
        ];
        if let Some((what, size, most)) =
            sizes.into_iter().find(|(_, size, most)| usize::from(*size) > *most)
        {
            return Some(format!("{size} {what}, at most {most} are possible"));
        }
        names("feature", &self.feature_names, self.features)
            .or_else(|| names("action", &self.action_names, self.actions))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn contract() -> ContractV1 {
        let names = |list: &[&str]| list.iter().map(|name| (*name).to_owned()).collect();
        ContractV1 {
            abi: CONTRACT_ABI,
            actions: 2,
            features: 3,
            feature_names: names(&["x", "y", "health"]),
            action_names: names(&["stay", "go"]),
            decision_interval: 5,
            append_last_action: true,
            subtask_conditioning: SubtaskConditioning::Mask,
            subtask_actions: false,
            safe_action: Some(0),
            fallback_allocation: FallbackAllocation::Unallocated,
        }
    }

    #[test]
    fn the_hash_is_that_of_the_documented_bytes() {
        // Lengths and sizes are varints, strings carry theirs, enums are their index, options start with 1.
        let bytes =
            b"\x01\x02\x03\x03\x01x\x01y\x06health\x02\x04stay\x02go\x05\x01\x01\x00\x01\x00\x00";
        assert_eq!(contract().hash(), fnv1a(bytes));
    }

    #[test]
    fn a_reordered_feature_list_is_another_contract() {
        let mut other = contract();
        other.feature_names.swap(0, 1);
        assert_ne!(other.hash(), contract().hash());
    }

    #[test]
    fn flaws_are_named() {
        assert_eq!(contract().flaw(), None);
        let flaw = |change: fn(&mut ContractV1)| {
            let mut contract = contract();
            change(&mut contract);
            contract.flaw().unwrap_or_default()
        };
        assert_eq!(flaw(|c| c.features = 4), "3 feature names for 4 features");
        assert_eq!(
            flaw(|c| c.action_names[1] = "stay".into()),
            "the same action name stands twice"
        );
        assert_eq!(flaw(|c| c.safe_action = Some(2)), "safe_action is not an action");
    }
}

/// The rules of its options, in `[network.options]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptionsContract {
    /// Steps after which an option is over without a milestone.
    pub steps: u8,
    /// Likelihood from which on a milestone counts as afforded.
    pub threshold: f32,
    /// Chance of a drawn action.
    pub action_chance: f32,
    /// Chance of a goal that is drawn from the mask.
    pub goal_chance: f32,
    /// Whether what is met again is answered otherwise.
    pub varied: bool,
    /// What is drawn follows from it, and from the ticks of the episode.
    pub seed: u64,
    /// What an observation is, and what the networks are shown of it.
    pub picture: PictureContract,
    /// The milestones, in the order of the networks' numbers; the last is the task.
    pub milestones: Vec<MilestoneSign>,
}

/// A picture, cell by cell its channels, and counts behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureContract {
    /// Channels of a cell.
    pub channels: u16,
    /// Cells to each side.
    pub size: u16,
    /// Counts behind the cells.
    pub counts: u16,
    /// Cells around the middle, to each side, that are shown one by one.
    pub crop: u16,
    /// Whether the nearest cell of every channel is shown.
    pub nearest: bool,
}

/// A milestone, and how it shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MilestoneSign {
    /// Its name.
    pub name: String,
    /// The count that shows it.
    pub carried: u16,
    /// By how much that changes at least, up or down.
    pub change: i16,
    /// Whether it can be gone for.
    pub affordance: Affords,
}

/// Whether a milestone can be gone for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Affords {
    /// The affordance network says so.
    Learned,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl OptionsContract {
    /// What the networks are shown of an observation.
    ///
    /// # Errors
    /// The picture has no such middle, or is too large.
    pub fn shown(&self) -> Result<Shown, String> {
        let PictureContract { channels, size, counts, crop, nearest } = self.picture;
        let [channels, size, counts, crop] = [channels, size, counts, crop].map(usize::from);
        let picture = PictureShape { channels, size, counts, crop, nearest };
        Shown::new(picture)
            .ok_or_else(|| format!("the picture has no such middle, or is too large: {picture:?}"))
    }

    /// The rules as the runtime takes them, for so many actions.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn rules(&self, actions: usize) -> Result<OptionRules, String> {
        let picture = *self.shown()?.shape();
        let beyond =
            |it: &&MilestoneSign| usize::from(it.carried) >= picture.counts || it.change == 0;
        if let Some(sign) = self.milestones.iter().find(beyond) {
            return Err(format!("the milestone `{}` shows in no count", sign.name));
        }
        let chances = [self.action_chance, self.goal_chance, self.threshold];
        if chances.iter().any(|chance| !(0.0..=1.0).contains(chance)) {
            return Err("chances and threshold of options are from 0 to 1".to_owned());
        }
        let milestone = |sign: &MilestoneSign| Milestone {
            carried: sign.carried.into(),
            change: sign.change,
            affordance: match sign.affordance {
                Affords::Learned => Affordance::Learned,
                Affords::Always => Affordance::Always,
                Affords::Never => Affordance::Never,
            },
        };
        let milestones: Vec<Milestone> = self.milestones.iter().map(milestone).collect();
        let rules = OptionRules::new(picture, actions, self.steps, &milestones);
        let mut rules = rules.ok_or("options need steps, and from 1 to 32 milestones")?;
        rules.threshold = self.threshold;
        rules.action_chance = self.action_chance;
        rules.goal_chance = self.goal_chance;
        rules.varied = self.varied;
        rules.seed = self.seed;
        Ok(rules)
    }
}
