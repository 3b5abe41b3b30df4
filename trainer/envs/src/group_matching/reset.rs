//! How an episode starts.

use super::parameters::{MAX_AGENTS, MAX_GROUPS, Parameters};
use super::ring::member_bytes;
use crate::environment::Split;
use crate::random::{Random, below};

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
        let mut groups = members.chunks_exact(member_bytes(parameters.agents));
        let size =
            |group: &[u8]| group.iter().map(|byte| byte.count_ones() as usize).sum::<usize>();
        let has_size = groups.any(|group| size(group) == parameters.held_out);
        if parameters.held_out == 0 || has_size == (split == Split::Test) {
            return;
        }
    }
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
