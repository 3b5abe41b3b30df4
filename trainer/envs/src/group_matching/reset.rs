//! How an episode starts.

use alloc::vec;

use super::parameters::{MAX_AGENTS, MAX_GROUPS, Parameters};
use super::ring::member_bytes;
use crate::environment::Split;
use crate::random::{Random, below, generator};

/// Draws where everybody stands.
pub(super) fn draw_cells(parameters: &Parameters, random: &mut Random, cells: &mut [u8]) {
    cells.iter_mut().for_each(|cell| *cell = below(random, parameters.cells) as u8);
}

/// Draws who belongs together, for a start of the split.
pub(super) fn draw_groups(
    parameters: &Parameters,
    split: Split,
    random: &mut Random,
    members: &mut [u8],
) {
    loop {
        draw_any_groups(parameters, random, members);
        if !parameters.holds_out() || is_held_out(parameters, members) == (split == Split::Test) {
            return;
        }
    }
}

/// Draws among which both kinds of starts are looked for.
const LOOKS: usize = 10_000;

/// Whether starts to learn from and starts to measure on are both drawn often enough.
pub(super) fn has_both(parameters: &Parameters) -> bool {
    let mut random = generator(0);
    let mut members = vec![0; parameters.groups * member_bytes(parameters.agents)];
    let mut found = [false; 2];
    for _ in 0..LOOKS {
        draw_any_groups(parameters, &mut random, &mut members);
        found[usize::from(is_held_out(parameters, &members))] = true;
    }
    found == [true; 2]
}

/// Whether a start is kept for measuring.
fn is_held_out(parameters: &Parameters, members: &[u8]) -> bool {
    let Parameters { held_out, held_out_members, held_out_share, .. } = *parameters;
    let groups = members.chunks_exact(member_bytes(parameters.agents));
    let sizes = groups
        .clone()
        .map(|group| group.iter().map(|byte| byte.count_ones() as usize).sum::<usize>());
    let large = sizes.clone().filter(|size| *size >= held_out_members).count();
    (held_out > 0 && sizes.clone().any(|size| size == held_out))
        || (held_out_members > 0 && large > 1)
        || lot(groups) < held_out_share
}

/// A number from 0 to 1 that belongs to a way to group the agents, by chance which, whatever the order of
/// the groups.
fn lot<'a>(groups: impl Iterator<Item = &'a [u8]>) -> f64 {
    // Fowler, Noll and Vo's hash, of which the low bits are the poorest.
    let hash = |group: &[u8]| {
        let hash = group.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
        });
        (hash ^ (hash >> 29)).wrapping_mul(0x9e37_79b9_7f4a_7c15)
    };
    let mixed = groups.map(hash).fold(0, u64::wrapping_add);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

/// Draws who belongs together.
///
/// The cuts are not sorted, as in the public code: with three or more groups one may be empty where the
/// next overlaps its neighbour. Every agent is in at least one.
fn draw_any_groups(parameters: &Parameters, random: &mut Random, members: &mut [u8]) {
    let Parameters { agents, groups, .. } = *parameters;
    let mut order = [0; MAX_AGENTS];
    let order = &mut order[..agents];
    (0..agents).for_each(|agent| order[agent] = agent);
    let mut cuts = [0; MAX_GROUPS + 1];
    cuts[groups] = agents;
    if parameters.fixed_groups {
        (1..groups).for_each(|group| cuts[group] = even_share(agents, groups, group));
    } else {
        shuffle(order, random);
        cuts[1..groups].iter_mut().for_each(|cut| *cut = below(random, agents));
    }
    members.fill(0);
    let bytes = member_bytes(agents);
    for (members, cut) in members.chunks_exact_mut(bytes).zip(cuts.windows(2)) {
        for agent in order.get(cut[0]..cut[1]).unwrap_or_default() {
            members[agent / 8] |= 1 << (agent % 8);
        }
    }
}

/// `agents * group / groups`, rounded, halves to the even number.
fn even_share(agents: usize, groups: usize, group: usize) -> usize {
    let (share, rest) = (agents * group / groups, agents * group % groups);
    let up = (2 * rest).cmp(&groups).then((share % 2).cmp(&0)).is_gt();
    share + usize::from(up)
}

/// Puts the agents into a random order (Fisher and Yates 1938).
fn shuffle(order: &mut [usize], random: &mut Random) {
    for last in (1..order.len()).rev() {
        order.swap(last, below(random, last + 1));
    }
}
