//! What `bundle.toml` says of an agent that goes from milestone to milestone.

use serde::{Deserialize, Serialize};
use sortie_core::options::{Affordance, Milestone, OptionRules, PictureShape, Shown};

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
