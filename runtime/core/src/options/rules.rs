//! What an agent that runs options goes by, besides its networks.

use heapless::Vec;

use super::shown::PictureShape;

/// Most milestones.
pub const MILESTONES: usize = 32;

/// Whether a milestone can be gone for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Affordance {
    /// The affordance network says so.
    Learned,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// Something that can be reached on the way to the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Milestone {
    /// The count that shows it.
    pub carried: usize,
    /// By how much that changes at least, up or down, where it is reached. Of several what rises counts.
    pub change: i16,
    /// Whether it can be gone for.
    pub affordance: Affordance,
}

impl Milestone {
    fn is_reached(&self, before: &[f32], now: &[f32]) -> bool {
        let count = |counts: &[f32]| counts.get(self.carried).copied().unwrap_or(0.0);
        let (change, found) = (f32::from(self.change), count(now) - count(before));
        if change > 0.0 { found >= change } else { found <= change }
    }
}

/// The rules of an agent that goes from milestone to milestone.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionRules {
    /// What its row is, and what its networks are shown of it.
    pub picture: PictureShape,
    /// Its actions, at most 256.
    pub actions: usize,
    /// Steps after which an option is over without a milestone; not 0.
    pub steps: u8,
    /// Likelihood from which on a milestone counts as afforded.
    pub threshold: f32,
    /// Chance of a drawn action.
    pub action_chance: f32,
    /// Chance of a goal that is drawn from the mask.
    pub goal_chance: f32,
    /// Whether what is met again is answered otherwise: the same view within an option by the next best action, a mask since
    /// the last milestone by a goal that was missed less often.
    pub varied: bool,
    /// What is drawn follows from it, and from the ticks of the episode.
    pub seed: u64,
    milestones: Vec<Milestone, MILESTONES>,
}

impl OptionRules {
    /// Rules that leave nothing to chance. None where there are no milestones, or too many.
    pub fn new(
        picture: PictureShape,
        actions: usize,
        steps: u8,
        milestones: &[Milestone],
    ) -> Option<Self> {
        let milestones = Vec::from_slice(milestones).ok()?;
        let sound = !milestones.is_empty() && steps > 0 && actions > 0;
        sound.then_some(Self {
            picture,
            actions,
            steps,
            threshold: 0.5,
            action_chance: 0.0,
            goal_chance: 0.0,
            varied: true,
            seed: 0,
            milestones,
        })
    }

    /// The milestones, in the order of the networks' numbers.
    pub fn milestones(&self) -> &[Milestone] {
        &self.milestones
    }

    /// All milestones, as bits.
    pub(super) fn all(&self) -> u32 {
        self.milestones.iter().enumerate().fold(0, |set, (goal, _)| set | bit(goal))
    }

    /// The milestone that what is carried shows to be reached.
    pub fn reached(&self, before: &[f32], now: &[f32]) -> Option<usize> {
        let found = |rises: bool| {
            let mut milestones = self.milestones.iter();
            milestones.position(|it| (it.change > 0) == rises && it.is_reached(before, now))
        };
        found(true).or_else(|| found(false))
    }

    /// The milestones, as bits, that can be gone for by their likelihoods; all where none can.
    pub fn mask(&self, likelihoods: &[f32]) -> u32 {
        let open = |(milestone, likelihood): (&Milestone, &f32)| match milestone.affordance {
            Affordance::Learned => *likelihood > self.threshold,
            Affordance::Always => true,
            Affordance::Never => false,
        };
        let flags = self.milestones.iter().zip(likelihoods).map(open);
        let mask =
            flags.enumerate().filter(|flag| flag.1).fold(0, |set, (goal, _)| set | bit(goal));
        if mask == 0 { self.all() } else { mask }
    }
}

/// A set of one goal.
pub(super) fn bit(goal: usize) -> u32 {
    1_u32.checked_shl(goal as u32).unwrap_or(0)
}
