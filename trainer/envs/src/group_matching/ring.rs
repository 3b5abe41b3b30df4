//! Who stands where and who belongs together, from which everything else follows: how it is drawn, what a step does to
//! it, how a script plays on it, and its bytes.

use alloc::string::String;
use alloc::vec::Vec;
use alloc::{format, vec};

use super::parameters::{MAX_AGENTS, MAX_GROUPS, Parameters};
use crate::bytes::{LAYOUT, Reader};
use crate::environment::{Split, StateError};
use crate::observation::members as each;
use crate::random::{Random, below, chance, generator, shuffle};

/// The agents' cells and groups, borrowed from a running episode or from a stored state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ring<'a> {
    /// The cell of every agent.
    pub cells: &'a [u8],
    /// The groups one behind the other, each [`member_bytes`] long: bit i, counted from the first byte's
    /// lowest, stands for agent i.
    pub(super) members: &'a [u8],
}

/// Bytes of one group's set of members.
pub(super) fn member_bytes(agents: usize) -> usize {
    agents.div_ceil(8)
}

/// The bits of all agents.
pub(super) fn all_agents(agents: usize) -> u128 {
    u128::MAX >> (u128::BITS as usize - agents)
}

impl<'a> Ring<'a> {
    /// The members of every group, as bits. Groups may be empty, and with three or more they may overlap.
    pub fn groups(self) -> impl DoubleEndedIterator<Item = u128> + ExactSizeIterator + 'a {
        self.members.chunks_exact(member_bytes(self.cells.len())).map(|bytes| {
            let mut members = [0; 16];
            members[..bytes.len()].copy_from_slice(bytes);
            u128::from_le_bytes(members)
        })
    }

    /// Whether a group has gathered: all members share a cell. An empty group always has.
    pub fn is_matched(self, members: u128) -> bool {
        let mut cells = each(members).map(|agent| self.cells[agent]);
        let first = cells.next();
        cells.all(|cell| Some(cell) == first)
    }

    /// How many groups have gathered; groups with the same members count one by one.
    pub fn matches(self) -> usize {
        self.groups().filter(|members| self.is_matched(*members)).count()
    }
}

/// The agents, as bits, that belong to the group of this one, which is among them.
///
/// Where groups overlap, the first of an agent's groups counts, so that the relation has a direction.
pub(super) fn same_group(
    parameters: &Parameters,
    ring: Ring<'_>,
    steps: u32,
    agent: usize,
) -> u128 {
    let everybody = all_agents(ring.cells.len());
    if parameters.groups_known_at_first && steps > 0 {
        return everybody;
    }
    ring.groups().find(|members| members >> agent & 1 == 1).unwrap_or(everybody)
}

/// Actions of an agent.
pub const ACTIONS: usize = 3;
/// One cell back, from the first to the last.
pub const LEFT: u16 = 0;
/// Stay.
pub const STAY: u16 = 1;
/// One cell on, from the last to the first.
pub const RIGHT: u16 = 2;

/// What the actions are called.
pub const ACTION_NAMES: [&str; ACTIONS] = ["left", "stay", "right"];

/// Where an action leads on a ring of so many cells.
pub(super) fn moved(cell: u8, action: u16, cells: usize) -> u8 {
    let step = match action {
        LEFT => cells - 1,
        RIGHT => 1,
        _ => 0,
    };
    ((usize::from(cell) + step) % cells) as u8
}

/// The action that happens when this one is asked for.
pub(super) fn slipped(parameters: &Parameters, action: u16, random: &mut Random) -> u16 {
    if chance(random, parameters.noise) { below(random, ACTIONS) as u16 } else { action }
}

/// The reward of a step that changed the number of gathered groups, in the order of operations of the
/// public code.
pub(super) fn reward(before: usize, after: usize) -> f64 {
    -0.1 + 2.5 * (after as f64 - before as f64)
}

/// Writes the action of every agent.
///
/// The best cell of a group is the one that its members have the fewest steps to, together; the first of
/// several. From the opposite side of the ring an agent goes left. An agent of two groups follows the
/// later one.
pub fn walk(parameters: &Parameters, ring: Ring<'_>, actions: &mut [u16]) {
    let cells = parameters.cells;
    let right = |agent: usize, goal: usize| {
        let cell = usize::from(ring.cells[agent]);
        (goal + cells - cell) % cells
    };
    let steps = |agent, goal| right(agent, goal).min((cells - right(agent, goal)) % cells);
    for members in ring.groups() {
        let together = |goal: &usize| each(members).map(|agent| steps(agent, *goal)).sum::<usize>();
        let goal = (0..cells).min_by_key(together).unwrap_or(0);
        for agent in each(members) {
            actions[agent] = match right(agent, goal) {
                0 => STAY,
                right if 2 * right < cells => RIGHT,
                _ => LEFT,
            };
        }
    }
}

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
        shuffle(random, order);
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

/// Bytes before the cells: the layout, the steps, the return.
const HEAD: usize = 1 + 4 + 8;

/// What the bytes of a state say.
#[derive(Clone, Copy, Debug)]
pub(super) struct State<'a> {
    pub(super) steps: u32,
    pub(super) episode_return: f64,
    pub(super) ring: Ring<'a>,
}

/// Bytes of a state of such a ring.
pub fn state_bytes(parameters: &Parameters) -> usize {
    HEAD + parameters.agents + parameters.groups * member_bytes(parameters.agents)
}

impl<'a> State<'a> {
    /// Adds the bytes of this state.
    pub(super) fn write(self, bytes: &mut Vec<u8>) {
        bytes.push(LAYOUT);
        bytes.extend_from_slice(&self.steps.to_le_bytes());
        bytes.extend_from_slice(&self.episode_return.to_le_bytes());
        bytes.extend_from_slice(self.ring.cells);
        bytes.extend_from_slice(self.ring.members);
    }

    /// Reads what [`write`](Self::write) wrote for the same ring; nothing is checked but the length.
    pub(super) fn read(parameters: &Parameters, bytes: &'a [u8]) -> Result<Self, StateError> {
        let mut reader = Reader::new(bytes, state_bytes(parameters))?;
        let (steps, episode_return) = (reader.u32(), reader.f64());
        let cells = reader.slice(parameters.agents);
        let members = reader.slice(parameters.groups * member_bytes(parameters.agents));
        Ok(Self { steps, episode_return, ring: Ring { cells, members } })
    }

    /// Refuses what no episode of the ring can be in.
    pub(super) fn check(self, parameters: &Parameters) -> Result<Self, StateError> {
        self.flaw(parameters).map_or(Ok(self), |flaw| Err(StateError::Impossible(flaw)))
    }

    fn flaw(self, parameters: &Parameters) -> Option<String> {
        let Self { steps, episode_return, ring } = self;
        if steps > parameters.episode_limit {
            return Some(format!("it is {steps} steps long"));
        }
        if !episode_return.is_finite() {
            return Some("its return is no number".into());
        }
        let off = ring.cells.iter().position(|cell| usize::from(*cell) >= parameters.cells);
        if let Some(agent) = off {
            return Some(format!("agent {agent} is in cell {}", ring.cells[agent]));
        }
        let all = all_agents(parameters.agents);
        if let Some(group) = ring.groups().position(|members| members & !all != 0) {
            return Some(format!("group {group} has a member that is no agent"));
        }
        let missing = all & !ring.groups().fold(0, |covered, members| covered | members);
        (missing != 0).then(|| format!("agent {} has no group", missing.trailing_zeros()))
    }
}
