//! Allocation by a matrix of costs: what it costs each agent to work on each subtask.
//!
//! For rules that people write, travel times for example. Unlike the team-value search it knows nothing of
//! who works together; a subtask only has room for a team of a certain size.

use super::{Teams, VALUE_MAX};
use crate::allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use crate::limits::{AGENTS, TASKS};

/// Tells what it costs an agent to work on a subtask.
pub trait CostModel {
    /// Writes the costs `[A, T]` of a state; NaN or +∞ where the agent cannot take the subtask.
    ///
    /// # Errors
    /// The state is none that the model knows.
    fn costs(
        &mut self,
        state: &AllocationState<'_>,
        costs: &mut [f32],
    ) -> Result<(), AllocateError>;
}

impl<M: CostModel + ?Sized> CostModel for &mut M {
    fn costs(
        &mut self,
        state: &AllocationState<'_>,
        costs: &mut [f32],
    ) -> Result<(), AllocateError> {
        (**self).costs(state, costs)
    }
}

/// How an allocation is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CostMethod {
    /// [`greedy`]: the cheapest pair first.
    Greedy,
    /// [`hungarian`]: the smallest total.
    Hungarian,
}

/// Allocates by the costs of a model. Absent agents and agents without room are [`UNASSIGNED`].
#[derive(Debug)]
pub struct CostAllocator<'a, M> {
    /// Tells the costs.
    pub model: M,
    /// How the allocation is found.
    pub method: CostMethod,
    /// Largest team of one subtask.
    pub team_max: usize,
    /// Memory for the costs `[A, T]` of the largest state.
    pub costs: &'a mut [f32],
}

impl<M: CostModel> Allocator for CostAllocator<'_, M> {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        let costs = self.costs.get_mut(..state.agents.saturating_mul(state.tasks));
        let costs = costs.ok_or(AllocateError::TooLarge)?;
        self.model.costs(state, costs)?;
        for (agent, row) in costs.chunks_exact_mut(state.tasks.max(1)).enumerate() {
            if !state.present.contains(agent) {
                row.fill(f32::INFINITY);
            }
        }
        let Self { team_max, method, .. } = *self;
        let teams = Teams { agents: state.agents, open_tasks: state.open_tasks, team_max };
        match method {
            CostMethod::Greedy => greedy(teams, state.tasks, costs, allocation),
            CostMethod::Hungarian => hungarian(teams, state.tasks, costs, allocation),
        }
    }
}

/// Takes the cheapest possible pair of agent and subtask, again and again, while there is one.
///
/// `costs [A, tasks]`; an agent cannot take what costs NaN or +∞. Equal costs go to the lowest agent, then to
/// the lowest subtask. Takes `A² · T` comparisons.
///
/// # Errors
/// `TooLarge` for more agents than [`AGENTS`]; `BadLength` for costs or an allocation of another length.
pub fn greedy(
    teams: Teams,
    tasks: usize,
    costs: &[f32],
    allocation: &mut [u8],
) -> Result<(), AllocateError> {
    let mut state = State::new(teams, tasks, costs, allocation)?;
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for agent in (0..teams.agents).filter(|agent| state.is_free(*agent)) {
            for task in teams.tasks().filter(|task| state.has_room(*task)) {
                if let Some(cost) = state.cost(agent, task)
                    && best.is_none_or(|(least, _, _)| cost < least)
                {
                    best = Some((cost, agent, task));
                }
            }
        }
        let Some((_, agent, task)) = best else { return Ok(()) };
        state.place(agent, task);
    }
}

/// Assigns as many agents as possible, and among such allocations one of the smallest total cost.
///
/// `costs [A, tasks]` as for [`greedy`]. Successive shortest augmenting paths: in each round one more agent
/// finds a place, others move on where that makes the total smaller. Totals are compared in f64, so that
/// they can be off by its rounding. Equal totals go to the shortest path found first, agents and subtasks in
/// rising order. Takes at most `A² · T²` additions.
///
/// # Errors
/// As [`greedy`].
pub fn hungarian(
    teams: Teams,
    tasks: usize,
    costs: &[f32],
    allocation: &mut [u8],
) -> Result<(), AllocateError> {
    let mut state = State::new(teams, tasks, costs, allocation)?;
    while let Some(path) = state.cheapest_path() {
        for (agent, task) in path.moves.iter().take(path.len) {
            state.place(usize::from(*agent), usize::from(*task));
        }
    }
    Ok(())
}

/// A chain of moves that gives one more agent a place: each agent of it makes room for the one before.
#[derive(Clone, Copy, Default)]
struct Path {
    cost: f64,
    /// The subtasks on the path, each at most once.
    tasks: u32,
    /// Agent, and the subtask that it moves to; the first `len` count.
    moves: [(u8, u8); TASKS],
    len: usize,
}

impl Path {
    /// The path with one more move; none where it would cross itself.
    fn and_then(mut self, agent: usize, task: usize, cost: f64) -> Option<Self> {
        let bit = 1_u32.checked_shl(task as u32)?;
        if self.tasks & bit != 0 {
            return None;
        }
        *self.moves.get_mut(self.len)? = (agent as u8, task as u8);
        self.len += 1;
        self.cost += cost;
        self.tasks |= bit;
        Some(self)
    }
}

/// An allocation while it is made.
struct State<'a> {
    teams: Teams,
    tasks: usize,
    costs: &'a [f32],
    places: &'a mut [u8],
    /// Agents at every subtask.
    counts: [u8; TASKS],
}

impl<'a> State<'a> {
    /// Nobody has a subtask yet.
    fn new(
        teams: Teams,
        tasks: usize,
        costs: &'a [f32],
        places: &'a mut [u8],
    ) -> Result<Self, AllocateError> {
        teams.check(AGENTS, places)?;
        let known = tasks >= TASKS || teams.open_tasks >> tasks == 0;
        if costs.len() != teams.agents.saturating_mul(tasks) || !known {
            return Err(AllocateError::BadLength);
        }
        places.fill(UNASSIGNED);
        Ok(Self { teams, tasks, costs, places, counts: [0; TASKS] })
    }

    /// What an agent costs at a subtask, if it can be there.
    fn cost(&self, agent: usize, task: usize) -> Option<f64> {
        let cost = *self.costs.get(agent * self.tasks + task)?;
        let possible = !cost.is_nan() && cost != f32::INFINITY;
        possible.then(|| f64::from(cost.clamp(-VALUE_MAX, VALUE_MAX)))
    }

    fn is_free(&self, agent: usize) -> bool {
        self.places.get(agent) == Some(&UNASSIGNED)
    }

    fn has_room(&self, task: usize) -> bool {
        self.counts.get(task).is_some_and(|count| usize::from(*count) < self.teams.team_max)
    }

    /// Moves an agent to a subtask.
    fn place(&mut self, agent: usize, task: usize) {
        let Some(place) = self.places.get_mut(agent) else { return };
        if let Some(count) = self.counts.get_mut(usize::from(*place)) {
            *count = count.saturating_sub(1);
        }
        *place = task as u8;
        if let Some(count) = self.counts.get_mut(task) {
            *count = count.saturating_add(1);
        }
    }

    /// The cheapest path that ends where there is room.
    fn cheapest_path(&self) -> Option<Path> {
        let mut paths = [None; TASKS];
        for agent in (0..self.teams.agents).filter(|agent| self.is_free(*agent)) {
            for task in self.teams.tasks() {
                self.offer(&mut paths, Path::default(), agent, task, 0.0);
            }
        }
        // A path that cannot be made cheaper by a further move is cheapest after as many rounds as subtasks.
        for _ in self.teams.tasks() {
            if !self.lengthen(&mut paths) {
                break;
            }
        }
        let open = paths.into_iter().enumerate().filter(|(task, _)| self.has_room(*task));
        open.filter_map(|(_, path)| path).reduce(
            |best, path| {
                if path.cost < best.cost { path } else { best }
            },
        )
    }

    /// Lets every agent of a full subtask move on; whether any path became cheaper.
    fn lengthen(&self, paths: &mut [Option<Path>; TASKS]) -> bool {
        let mut changed = false;
        for (agent, from) in self.places.iter().map(|place| usize::from(*place)).enumerate() {
            let Some(path) = paths.get(from).copied().flatten() else { continue };
            let Some(saved) = self.cost(agent, from).filter(|_| !self.has_room(from)) else {
                continue;
            };
            for task in self.teams.tasks() {
                changed |= self.offer(paths, path, agent, task, saved);
            }
        }
        changed
    }

    /// Offers a subtask the path `from`, lengthened by an agent's move; whether it is the cheapest so far.
    fn offer(
        &self,
        paths: &mut [Option<Path>; TASKS],
        from: Path,
        agent: usize,
        task: usize,
        saved: f64,
    ) -> bool {
        let Some(cost) = self.cost(agent, task) else { return false };
        let Some(known) = paths.get_mut(task) else { return false };
        if known.is_some_and(|known| known.cost <= from.cost + cost - saved) {
            return false;
        }
        let path = from.and_then(agent, task, cost - saved);
        *known = path.or(*known);
        path.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;
    use std::{format, vec};

    /// Pseudo-random numbers of a linear congruential generator.
    fn numbers(mut seed: u64) -> impl FnMut(u64) -> u64 {
        move |below| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040);
            (seed >> 33) % below
        }
    }

    type Method = fn(Teams, usize, &[f32], &mut [u8]) -> Result<(), AllocateError>;

    fn run(method: Method, teams: Teams, tasks: usize, costs: &[f32]) -> Vec<u8> {
        let mut allocation = vec![77; teams.agents];
        method(teams, tasks, costs, &mut allocation).unwrap();
        allocation
    }

    /// Agents with a subtask and their total cost, or none where the allocation is not possible.
    fn rate(teams: Teams, tasks: usize, costs: &[f32], allocation: &[u8]) -> Option<(usize, f64)> {
        let (mut assigned, mut total) = (0, 0.0);
        for (agent, task) in allocation.iter().enumerate().filter(|(_, t)| **t != UNASSIGNED) {
            let cost = costs[agent * tasks + usize::from(*task)];
            let team = allocation.iter().filter(|other| *other == task).count();
            let open = teams.open_tasks >> task & 1 == 1;
            if !open || cost.is_nan() || cost == f32::INFINITY || team > teams.team_max {
                return None;
            }
            assigned += 1;
            total += f64::from(cost.clamp(-VALUE_MAX, VALUE_MAX));
        }
        Some((assigned, total))
    }

    /// The most agents and, with them, the smallest total, by trying everything.
    fn brute_force(teams: Teams, tasks: usize, costs: &[f32]) -> (usize, f64) {
        let choices: Vec<u8> = teams.tasks().map(|t| t as u8).chain([UNASSIGNED]).collect();
        let count = choices.len().pow(teams.agents as u32);
        let allocations = (0..count).map(|mut number| -> Vec<u8> {
            let mut digit = || {
                let digit = number % choices.len();
                number /= choices.len();
                digit
            };
            (0..teams.agents).map(|_| choices[digit()]).collect()
        });
        let rated = allocations.filter_map(|allocation| rate(teams, tasks, costs, &allocation));
        let better = |a: (usize, f64), b: (usize, f64)| {
            if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
        };
        rated.reduce(better).unwrap()
    }

    fn case(seed: u64, agents_max: u64) -> (Teams, usize, impl FnMut(u64) -> u64) {
        let mut below = numbers(seed);
        let (agents, tasks) = (below(agents_max + 1) as usize, below(5) as usize);
        let open_tasks = (below(1 << tasks) | below(1 << tasks)) as u32;
        let team_max = [0, 1, 1, 1, 2, 2, 3][below(7) as usize];
        (Teams { agents, open_tasks, team_max }, tasks, below)
    }

    #[test]
    fn hungarian_is_as_good_as_trying_everything() {
        let mut complete = 0;
        for seed in 0..600 {
            let (teams, tasks, mut below) = case(seed, 5);
            // Whole numbers of both signs, so that totals are exact; some pairs are impossible.
            let costs: Vec<f32> = (0..teams.agents * tasks)
                .map(|_| match below(6) {
                    0 => [f32::NAN, f32::INFINITY][below(2) as usize],
                    _ => below(9) as f32 - 4.0,
                })
                .collect();
            let allocation = run(hungarian, teams, tasks, &costs);
            let rated = rate(teams, tasks, &costs, &allocation);
            let want = brute_force(teams, tasks, &costs);
            assert_eq!(rated, Some(want), "seed {seed}: {teams:?} {costs:?} {allocation:?}");
            complete += usize::from(want.0 > 2);
        }
        assert!(complete > 60, "only {complete} of 600 cases place three agents");
    }

    #[test]
    fn greedy_takes_the_cheapest_pair_each_time() {
        let mut dearer = 0;
        for seed in 0..600 {
            let (teams, tasks, mut below) = case(seed, 8);
            let costs: Vec<f32> = (0..teams.agents * tasks).map(|_| below(50) as f32).collect();
            let allocation = run(greedy, teams, tasks, &costs);
            let mut want = vec![UNASSIGNED; teams.agents];
            let mut pairs: Vec<(usize, usize)> = (0..teams.agents)
                .flat_map(|agent| teams.tasks().map(move |task| (agent, task)))
                .collect();
            pairs.sort_by_key(|(agent, task)| costs[agent * tasks + task] as u32);
            for (agent, task) in pairs {
                let team = want.iter().filter(|other| usize::from(**other) == task).count();
                if want[agent] == UNASSIGNED && team < teams.team_max {
                    want[agent] = task as u8;
                }
            }
            assert_eq!(allocation, want, "seed {seed}: {teams:?} {costs:?}");
            let [greedy, best] = [allocation, run(hungarian, teams, tasks, &costs)]
                .map(|allocation| rate(teams, tasks, &costs, &allocation).unwrap());
            assert!(best.0 >= greedy.0 && (best.0 > greedy.0 || best.1 <= greedy.1));
            dearer += usize::from(best.1 < greedy.1);
        }
        assert!(dearer > 25, "only {dearer} of 600 cases tell the methods apart");
    }

    #[test]
    fn any_costs_give_a_possible_allocation_that_nobody_can_join() {
        let strange = [
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::MAX,
            f32::MIN,
            f32::MIN_POSITIVE,
            1e-45,
            -0.0,
            1.0,
        ];
        for seed in 0..400 {
            let mut below = numbers(seed);
            let (agents, tasks) = (below(65) as usize, below(33) as usize);
            let open_tasks = below(1 << 32) as u32 & (u64::MAX >> (64 - tasks.max(1))) as u32;
            let open_tasks = if tasks == 0 { 0 } else { open_tasks };
            let team_max = [0, 1, 2, 5, usize::MAX][below(5) as usize];
            let teams = Teams { agents, open_tasks, team_max };
            let costs: Vec<f32> = (0..agents * tasks)
                .map(|_| match below(3) {
                    0 => strange[below(9) as usize],
                    _ => f32::from_bits(below(1 << 32) as u32),
                })
                .collect();
            for method in [greedy as Method, hungarian] {
                let allocation = run(method, teams, tasks, &costs);
                let what = format!("seed {seed}: {teams:?} {allocation:?}");
                assert!(rate(teams, tasks, &costs, &allocation).is_some(), "{what}");
                for (agent, _) in allocation.iter().enumerate().filter(|(_, t)| **t == UNASSIGNED) {
                    for task in teams.tasks() {
                        let mut joined = allocation.clone();
                        joined[agent] = task as u8;
                        assert_eq!(rate(teams, tasks, &costs, &joined), None, "{what}");
                    }
                }
            }
        }
    }

    struct Distance;

    impl CostModel for Distance {
        fn costs(
            &mut self,
            state: &AllocationState<'_>,
            costs: &mut [f32],
        ) -> Result<(), AllocateError> {
            for (place, cost) in costs.iter_mut().enumerate() {
                let [agent, task] = [place / state.tasks, state.agents + place % state.tasks];
                *cost = (state.rows[agent] - state.rows[task]).abs();
            }
            Ok(())
        }
    }

    #[test]
    fn absent_agents_and_closed_subtasks_are_left_out() {
        let mut present = crate::EntityMask::first(5);
        present.remove(1);
        let state = AllocationState {
            agents: 3,
            tasks: 2,
            rows: &[0.0, 10.0, 9.0, 10.0, 0.0],
            stride: 1,
            present,
            entity_task: &[0, 0, 0, 0b01, 0b10],
            open_tasks: 0b11,
            available: &[],
        };
        let mut memory = [0.0; 6];
        let mut allocate = |state: &AllocationState<'_>, team_max| {
            let mut allocation = [9; 3];
            let method = CostMethod::Hungarian;
            CostAllocator { model: Distance, method, team_max, costs: &mut memory }
                .allocate(state, &mut allocation)
                .map(|()| allocation)
        };
        assert_eq!(allocate(&state, 1), Ok([1, UNASSIGNED, 0]));
        let closed = AllocationState { open_tasks: 0b01, ..state };
        assert_eq!(allocate(&closed, 1), Ok([UNASSIGNED, UNASSIGNED, 0]));
        assert_eq!(allocate(&closed, 2), Ok([0, UNASSIGNED, 0]));
        let unknown = AllocationState { open_tasks: 0b100, ..state };
        assert_eq!(allocate(&unknown, 1), Err(AllocateError::BadLength));
        let larger = AllocationState { tasks: 3, ..state };
        assert_eq!(allocate(&larger, 1), Err(AllocateError::TooLarge));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let teams = Teams { agents: 2, open_tasks: 0b10, team_max: 1 };
        for method in [greedy as Method, hungarian] {
            let refusal = |teams, tasks, costs: &[f32], agents: usize| {
                method(teams, tasks, costs, &mut vec![0; agents])
            };
            assert_eq!(refusal(teams, 2, &[0.0; 3], 2), Err(AllocateError::BadLength));
            assert_eq!(refusal(teams, 1, &[0.0; 2], 2), Err(AllocateError::BadLength));
            assert_eq!(refusal(teams, 2, &[0.0; 4], 3), Err(AllocateError::BadLength));
            let many = Teams { agents: 65, ..teams };
            assert_eq!(refusal(many, 2, &[0.0; 130], 65), Err(AllocateError::TooLarge));
        }
    }
}
