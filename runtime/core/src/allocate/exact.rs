//! The best of all allocations, by dynamic programming over subsets of agents.
//!
//! With the first open subtasks only, the best total that places a set of agents S is the largest, over
//! all teams within S at the last of them, of that team's value plus the best total that places the
//! rest before. A agents and T open subtasks take `T * 3^A` additions instead of `T^A` sums.
//!
//! ```
//! use sortie_core::allocate::{Teams, exact};
//!
//! // Two agents, subtasks 0 and 3 open; the empty team comes first, then agent 0, agent 1, both.
//! let values = [0.0, 1.0, 4.0, 4.5, 0.0, 2.0, 6.0, 6.5];
//! let teams = Teams { agents: 2, open_tasks: 0b1001, team_max: 2 };
//! let mut arena = [exact::Cell::default(); exact::cells(2, 2)];
//! let mut allocation = [0; 2];
//! let total = exact::search(teams, &values, &mut arena, &mut allocation)?;
//! assert_eq!((total, allocation), (7.0, [0, 3]));
//! # Ok::<(), sortie_core::AllocateError>(())
//! ```

use super::{Teams, comparable};
use crate::allocator::{AllocateError, UNASSIGNED};

/// Most agents that are searched exactly.
pub const AGENTS: usize = 10;

/// One entry of the table: a set of agents placed at the first open subtasks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cell {
    /// The best total, negative infinity where the set has no room.
    total: f32,
    /// The team of the last of these subtasks in that allocation.
    team: u16,
}

/// Cells that [`search`] needs for so many agents and open subtasks: more than there can be beyond [`AGENTS`].
pub const fn cells(agents: usize, open_tasks: usize) -> usize {
    if agents > AGENTS { usize::MAX } else { open_tasks.saturating_mul(1 << agents) }
}

/// Writes the allocation `[A]` of the largest total and returns that total.
///
/// `values [open subtasks, 2^A]` holds `f(subtask, team)`, subtasks in rising order, a team's bit a
/// standing for agent a. Totals are summed in f32, subtasks in rising order. Where there is less room
/// than agents, as many as possible are placed and the rest is unassigned. Equal totals go to the
/// lowest set of placed agents, then to the lowest team (as a number) at the last open subtask, then
/// at the one before, and so on.
///
/// # Errors
/// `TooLarge` for more than [`AGENTS`] agents or an arena of fewer than [`cells`]; `BadLength` where
/// `values` or `allocation` has another length than said.
pub fn search(
    teams: Teams,
    values: &[f32],
    arena: &mut [Cell],
    allocation: &mut [u8],
) -> Result<f32, AllocateError> {
    teams.check(AGENTS, allocation)?;
    let open = teams.open_tasks.count_ones() as usize;
    let count = cells(teams.agents, open);
    if values.len() != count {
        return Err(AllocateError::BadLength);
    }
    let table = arena.get_mut(..count).ok_or(AllocateError::TooLarge)?;
    allocation.fill(UNASSIGNED);
    if open == 0 {
        return Ok(0.0);
    }
    fill(teams, values, table);
    let subsets = 1 << teams.agents;
    let mut placed = 0;
    let mut total = f32::NEG_INFINITY;
    for (set, cell) in table.iter().skip(count - subsets).enumerate() {
        if set.count_ones() as usize == teams.places() && cell.total > total {
            (placed, total) = (set, cell.total);
        }
    }
    write_back(teams, table, placed, allocation);
    Ok(total)
}

/// Fills the table subtask by subtask.
fn fill(teams: Teams, values: &[f32], table: &mut [Cell]) {
    let subsets = 1 << teams.agents;
    let mut before: &[Cell] = &[];
    for (row, values) in table.chunks_exact_mut(subsets).zip(values.chunks_exact(subsets)) {
        for (set, cell) in row.iter_mut().enumerate() {
            *cell = best_cell(teams.team_max, set, values, before);
        }
        before = row;
    }
}

/// The best team within `set` for one subtask, the others of the set being placed `before`.
fn best_cell(team_max: usize, set: usize, values: &[f32], before: &[Cell]) -> Cell {
    let mut best = Cell { total: f32::NEG_INFINITY, team: 0 };
    // The subsets of `set` in rising order, from the empty one to itself.
    let mut team = 0_usize;
    loop {
        if team.count_ones() as usize <= team_max {
            let rest = match before.get(set & !team) {
                Some(cell) => cell.total,
                None if team == set => 0.0,
                None => f32::NEG_INFINITY,
            };
            let value = values.get(team).map_or(f32::NEG_INFINITY, |value| comparable(*value));
            let total = rest + value;
            if total > best.total {
                best = Cell { total, team: team as u16 };
            }
        }
        if team == set {
            return best;
        }
        team = team.wrapping_sub(set) & set;
    }
}

/// Follows the choices back from the last subtask to the first.
fn write_back(teams: Teams, table: &[Cell], placed: usize, allocation: &mut [u8]) {
    let mut set = placed;
    let mut tasks = [0_u8; crate::limits::TASKS];
    let mut open = 0;
    for (place, task) in tasks.iter_mut().zip(teams.tasks()) {
        *place = task as u8;
        open += 1;
    }
    for (row, task) in table.rchunks_exact(1 << teams.agents).zip(tasks.iter().take(open).rev()) {
        let team = row.get(set).map_or(0, |cell| usize::from(cell.team));
        for (agent, place) in allocation.iter_mut().enumerate() {
            if team >> agent & 1 == 1 {
                *place = *task;
            }
        }
        set &= !team;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;
    use std::{format, vec};

    /// Pseudo-random numbers of a linear congruential generator.
    fn numbers(mut seed: u64) -> impl FnMut() -> u32 {
        move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040);
            (seed >> 33) as u32
        }
    }

    fn run(teams: Teams, values: &[f32]) -> (f32, Vec<u8>) {
        let open = teams.open_tasks.count_ones() as usize;
        let mut arena = vec![Cell::default(); cells(teams.agents, open)];
        let mut allocation = vec![77; teams.agents];
        let total = search(teams, values, &mut arena, &mut allocation).unwrap();
        (total, allocation)
    }

    /// The team of every open subtask, in rising order.
    fn teams_of(teams: Teams, allocation: &[u8]) -> Vec<usize> {
        let team = |task| {
            let members = allocation.iter().enumerate().filter(|(_, t)| usize::from(**t) == task);
            members.map(|(agent, _)| 1 << agent).sum()
        };
        teams.tasks().map(team).collect()
    }

    /// The total of an allocation, or `None` where it is not feasible.
    fn total(teams: Teams, values: &[f32], allocation: &[u8]) -> Option<f32> {
        let of_tasks = teams_of(teams, allocation);
        let assigned = allocation.iter().filter(|task| **task != UNASSIGNED);
        let open = |task: &u8| teams.open_tasks.checked_shr((*task).into()).unwrap_or(0) & 1 == 1;
        let feasible = assigned.clone().all(open)
            && assigned.count() == teams.places()
            && of_tasks.iter().all(|team| team.count_ones() as usize <= teams.team_max);
        feasible.then(|| {
            let values =
                of_tasks.iter().enumerate().map(|(i, team)| values[(i << teams.agents) + team]);
            values.map(comparable).fold(0.0, |sum, value| sum + value)
        })
    }

    /// The best allocation by trying all of them, ties as documented.
    fn brute_force(teams: Teams, values: &[f32]) -> (f32, Vec<u8>) {
        let choices: Vec<u8> = teams.tasks().map(|t| t as u8).chain([UNASSIGNED]).collect();
        let mut best: Option<(f32, Vec<usize>, Vec<u8>)> = None;
        for mut number in 0..choices.len().pow(teams.agents as u32) {
            let allocation: Vec<u8> = (0..teams.agents)
                .map(|_| {
                    let choice = choices[number % choices.len()];
                    number /= choices.len();
                    choice
                })
                .collect();
            let Some(total) = total(teams, values, &allocation) else { continue };
            let mut order = teams_of(teams, &allocation);
            order.push(order.iter().sum());
            order.reverse();
            let better = best.as_ref().is_none_or(|(best_total, best_order, _)| {
                total > *best_total || (total == *best_total && order < *best_order)
            });
            if better {
                best = Some((total, order, allocation));
            }
        }
        let (total, _, allocation) = best.unwrap();
        (total, allocation)
    }

    /// Every size up to four agents and four open subtasks, with every limit of teams.
    fn small_cases() -> impl Iterator<Item = Teams> {
        let sizes = (0..=4_usize).flat_map(|agents| (0..=4_usize).map(move |open| (agents, open)));
        sizes.flat_map(|(agents, open)| {
            let open_tasks = [0, 0b100, 0b1010, 0x8000_0003, 0b1_1011][open];
            (0..=4).map(move |team_max| Teams { agents, open_tasks, team_max })
        })
    }

    #[test]
    fn finds_what_trying_everything_finds() {
        for (seed, teams) in small_cases().enumerate() {
            let mut number = numbers(seed as u64);
            let count = cells(teams.agents, teams.open_tasks.count_ones() as usize);
            // Few different whole numbers: sums are exact and many totals are equal.
            let values: Vec<f32> = (0..count).map(|_| (number() % 4) as f32).collect();
            assert_eq!(run(teams, &values), brute_force(teams, &values), "{teams:?} {values:?}");
            let values: Vec<f32> = (0..count).map(|_| number() as f32 / 1e9).collect();
            assert_eq!(run(teams, &values), brute_force(teams, &values), "{teams:?} {values:?}");
        }
    }

    #[test]
    fn any_values_give_a_feasible_allocation() {
        let strange = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 0.0, -1.0];
        for (seed, teams) in small_cases().enumerate() {
            let mut number = numbers(seed as u64);
            let count = cells(teams.agents, teams.open_tasks.count_ones() as usize);
            let values: Vec<f32> =
                (0..count).map(|_| strange[number() as usize % strange.len()]).collect();
            let (best, allocation) = run(teams, &values);
            let what = format!("{teams:?} {values:?} {allocation:?}");
            assert_eq!(total(teams, &values, &allocation), Some(best), "{what}");
            assert!(best.is_finite(), "{what}");
        }
    }

    #[test]
    fn nan_never_wins() {
        let teams = Teams { agents: 1, open_tasks: 0b11, team_max: 1 };
        assert_eq!(run(teams, &[0.0, f32::NAN, 0.0, -1e30]), (-1e30, vec![1]));
        assert_eq!(run(teams, &[0.0, -1e30, f32::NAN, 5.0]).1, [1]);
    }

    #[test]
    fn the_largest_case_fits_its_arena() {
        let teams = Teams { agents: AGENTS, open_tasks: u32::MAX, team_max: 3 };
        let mut number = numbers(1);
        let values: Vec<f32> = (0..cells(AGENTS, 32)).map(|_| number() as f32).collect();
        let (best, allocation) = run(teams, &values);
        assert_eq!(total(teams, &values, &allocation), Some(best));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let teams = Teams { agents: 2, open_tasks: 1, team_max: 2 };
        let refusal = |teams, values: &[f32], cells: usize, agents: usize| {
            search(teams, values, &mut vec![Cell::default(); cells], &mut vec![0; agents])
        };
        assert_eq!(refusal(teams, &[0.0; 4], 3, 2), Err(AllocateError::TooLarge));
        assert_eq!(refusal(teams, &[0.0; 5], 4, 2), Err(AllocateError::BadLength));
        assert_eq!(refusal(teams, &[0.0; 4], 4, 3), Err(AllocateError::BadLength));
        let many = Teams { agents: AGENTS + 1, ..teams };
        assert_eq!(refusal(many, &[0.0; 4], 4, AGENTS + 1), Err(AllocateError::TooLarge));
    }
}
