//! The rules of an agent that runs options: words of the file that `SORTIE_RULES` names.

use sortie_core::options::{Affordance, Milestone, OptionRules, PictureShape};

use crate::words::word;

const RULES: &[u8] = include_bytes!(env!("SORTIE_RULES"));

/// Columns that its networks are shown.
pub(crate) const COLUMNS: usize = at(0);
/// Numbers that it remembers.
pub(crate) const HIDDEN: usize = at(1);
pub(crate) const ACTIONS: usize = at(2);
/// Numbers of a row.
pub(crate) const FEATURES: usize = PICTURE.features();

const PICTURE: PictureShape = PictureShape {
    channels: at(3),
    size: at(4),
    counts: at(5),
    crop: at(6),
    nearest: word(RULES, 7) != 0,
};
const STEPS: u8 = word(RULES, 8) as u8;
/// The words before the milestones, and of each of them.
const HEAD: usize = 15;
const WORDS: usize = 3;
const MILESTONES: [Milestone; (RULES.len() / 4 - HEAD) / WORDS] = {
    let mut milestones = [milestone(0); _];
    let mut index = 0;
    while index < milestones.len() {
        milestones[index] = milestone(index);
        index += 1;
    }
    milestones
};

const fn at(index: usize) -> usize {
    word(RULES, index) as usize
}

const fn milestone(index: usize) -> Milestone {
    let first = HEAD + WORDS * index;
    Milestone {
        carried: at(first),
        change: word(RULES, first + 1) as i16,
        affordance: match word(RULES, first + 2) {
            0 => Affordance::Learned,
            1 => Affordance::Always,
            _ => Affordance::Never,
        },
    }
}

/// The rules, if they hold together.
pub(crate) fn rules() -> Option<OptionRules> {
    let mut rules = OptionRules::new(PICTURE, ACTIONS, STEPS, &MILESTONES)?;
    rules.threshold = f32::from_bits(word(RULES, 9));
    rules.action_chance = f32::from_bits(word(RULES, 10));
    rules.goal_chance = f32::from_bits(word(RULES, 11));
    rules.varied = word(RULES, 12) != 0;
    rules.seed = (word(RULES, 14) as u64) << 32 | word(RULES, 13) as u64;
    Some(rules)
}
