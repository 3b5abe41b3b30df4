//! Numbers of 32 bits as programs on boards read them, all little-endian.

use sortie_bundle::{Affords, MilestoneSign, OptionsContract};

/// Whole numbers that a program is built around.
pub(super) fn words(numbers: impl IntoIterator<Item = u32>) -> Vec<u8> {
    numbers.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The rules of an agent that runs options, with the sizes of what its networks are shown and of what it remembers: the
/// words of `runtime/firmware/src/rules.rs`.
pub(super) fn rules(options: &OptionsContract, [columns, hidden, actions]: [usize; 3]) -> Vec<u8> {
    let picture = options.picture;
    let sizes = [columns, hidden, actions].map(|size| size as u32);
    let picture =
        [picture.channels, picture.size, picture.counts, picture.crop, picture.nearest.into()];
    let chances = [options.threshold, options.action_chance, options.goal_chance].map(f32::to_bits);
    let rest = [options.varied.into(), options.seed as u32, (options.seed >> 32) as u32];
    let milestone = |sign: &MilestoneSign| {
        let affordance = match sign.affordance {
            Affords::Learned => 0,
            Affords::Always => 1,
            Affords::Never => 2,
        };
        [sign.carried.into(), i32::from(sign.change) as u32, affordance]
    };
    let head = sizes.into_iter().chain(picture.map(u32::from)).chain([options.steps.into()]);
    words(head.chain(chances).chain(rest).chain(options.milestones.iter().flat_map(milestone)))
}

/// Cases that stream in, one after the other, as `runtime/firmware/src/numbers.rs` reads them.
#[derive(Default)]
pub(super) struct Cases {
    count: u32,
    bytes: Vec<u8>,
}

impl Cases {
    /// A case more, and whether an episode begins with it.
    pub(super) fn add<'n>(&mut self, begins: bool, numbers: impl IntoIterator<Item = &'n f32>) {
        self.count += 1;
        self.bytes.extend(u32::from(begins).to_le_bytes());
        self.bytes.extend(numbers.into_iter().flat_map(|number| number.to_le_bytes()));
    }

    pub(super) fn count(&self) -> usize {
        self.count as usize
    }

    pub(super) fn to_bytes(&self) -> Vec<u8> {
        [&self.count.to_le_bytes()[..], &self.bytes].concat()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_counted_and_say_where_episodes_begin() {
        let mut cases = Cases::default();
        cases.add(true, &[1.0]);
        cases.add(false, &[-0.0]);
        assert_eq!(cases.to_bytes(), words([2, 1, 0x3f80_0000, 0, 0x8000_0000]));
    }
}
