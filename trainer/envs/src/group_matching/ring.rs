//! Who stands where, and who belongs together: from this everything else follows.

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

/// The agents of a set in rising order.
pub(super) fn each(mut set: u128) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let agent = (set != 0).then(|| set.trailing_zeros() as usize)?;
        set &= set - 1;
        Some(agent)
    })
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
