//! Who belongs to whose group: what the oracle variants of REFIL are told, and nobody else.

use super::parameters::Parameters;
use super::ring::{Ring, all_agents};

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
