//! Who belongs to whose group: what the oracle variants of REFIL are told, and nobody else.

use serde::{Deserialize, Serialize};

use super::ring::{Ring, all_agents};

/// In which states an oracle knows the groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KnownGroups {
    /// In all of them.
    #[default]
    Always,
    /// In the first state of an episode only: later everybody counts as one group, as in the public code.
    AtFirst,
}

/// The agents, as bits, that belong to the group of this one, which is among them.
///
/// Where groups overlap, the first of an agent's groups counts, so that the relation has a direction.
pub fn same_group(ring: Ring<'_>, steps: u32, known: KnownGroups, agent: usize) -> u128 {
    let all = all_agents(ring.cells.len());
    if known == KnownGroups::AtFirst && steps > 0 {
        return all;
    }
    ring.groups().find(|members| members >> agent & 1 == 1).unwrap_or(all)
}
