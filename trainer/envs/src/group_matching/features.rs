//! What there is to see: a row per agent, all of it zeros and ones.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use super::parameters::Parameters;
use super::ring::Ring;

/// The names of the columns of a row: cells, groups, agents.
pub fn feature_names(parameters: &Parameters) -> Vec<String> {
    let Parameters { agents, cells, groups, .. } = *parameters;
    let column = |what: &'static str| move |index: usize| format!("{what} {index}");
    (0..cells)
        .map(column("cell"))
        .chain((0..groups).map(column("group")))
        .chain((0..agents).map(column("agent")))
        .collect()
}

/// The columns of an agent's row that hold a one, in rising order: its cell, its groups, itself.
pub fn columns(
    parameters: &Parameters,
    ring: Ring<'_>,
    agent: usize,
) -> impl Iterator<Item = usize> {
    let Parameters { cells, groups, .. } = *parameters;
    let own = ring.groups().enumerate().filter(move |(_, members)| members >> agent & 1 == 1);
    core::iter::once(usize::from(ring.cells[agent]))
        .chain(own.map(move |(group, _)| cells + group))
        .chain(core::iter::once(cells + groups + agent))
}

/// Writes an agent's row.
pub fn write_row(parameters: &Parameters, ring: Ring<'_>, agent: usize, row: &mut [f32]) {
    row.fill(0.0);
    columns(parameters, ring, agent).for_each(|column| row[column] = 1.0);
}
