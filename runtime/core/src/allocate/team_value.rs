//! The team-value allocator: a network values teams, the search finds the best allocation.
//!
//! Only present agents take part. The seam to the network is [`TeamValueNetwork`], what an environment
//! knows beside the features of entities comes from a [`TaskRelation`]; neither is known here.

use super::{TeamValue, Teams, ascent, exact};
use crate::allocator::{AllocateError, AllocationState, Allocator, UNASSIGNED};
use crate::entity_mask::EntityMask;
use crate::limits;

/// Most agents that are usually searched exactly: beyond, the values of all teams take too long.
pub const EXACT_AGENTS: usize = exact::AGENTS;

/// Teams whose values are asked for in one call.
const TOGETHER: usize = 16;

/// Sweeps of the coordinate ascent; few are needed until no agent moves.
const SWEEPS: usize = 8;

/// A team at a subtask of a state: what the network is asked about.
#[derive(Clone, Copy, Debug)]
pub struct TeamQuery<'a> {
    /// Entities, subtasks and agents.
    pub state: &'a AllocationState<'a>,
    /// The subtask, which is open.
    pub task: usize,
    /// Bit a set where the agent in row a is in the team.
    pub team: u64,
    /// How each entity relates to the subtask, `[N, F]`.
    pub relation: &'a [f32],
}

impl TeamQuery<'_> {
    /// The subtask's own row, which forms the query; none where no row belongs to it.
    pub fn own_row(&self) -> Option<usize> {
        let tasks = self.state.entity_task.iter().enumerate().skip(self.state.agents);
        let is_own = |tasks: u32| tasks.checked_shr(self.task as u32).unwrap_or(0) & 1 == 1;
        tasks.filter(|(_, tasks)| is_own(**tasks)).map(|(row, _)| row).next()
    }

    /// Whether a row stands for something of an open subtask.
    pub fn is_open(&self, row: usize) -> bool {
        let tasks = self.state.entity_task.get(row).copied().unwrap_or(0);
        row >= self.state.agents && tasks & self.state.open_tasks != 0
    }

    /// Whether a row is an agent of the team.
    pub fn is_member(&self, row: usize) -> bool {
        row < self.state.agents && self.team.checked_shr(row as u32).unwrap_or(0) & 1 == 1
    }

    /// The rows that the query attends to: present agents, and what is present of open subtasks.
    pub fn visible(&self) -> EntityMask {
        let mut visible = EntityMask::EMPTY;
        for row in self.state.present.iter() {
            if row < self.state.agents || self.is_open(row) {
                visible.insert(row);
            }
        }
        visible
    }
}

/// What a team at a subtask is worth, by a network.
pub trait TeamValueNetwork {
    /// The value; one that is no number counts as the lowest.
    ///
    /// # Errors
    /// The query does not fit the network, or a visible feature is not a finite number.
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError>;

    /// Writes the values of several teams in the place of the query's; networks may share work among them.
    ///
    /// # Errors
    /// As [`Self::value`] of the first team that has one; values are then incomplete.
    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        for (team, value) in teams.iter().zip(values) {
            *value = self.value(&TeamQuery { team: *team, ..*query })?;
        }
        Ok(())
    }
}

impl<V: TeamValueNetwork + ?Sized> TeamValueNetwork for &mut V {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        (**self).value(query)
    }

    fn values(
        &mut self,
        query: &TeamQuery<'_>,
        teams: &[u64],
        values: &mut [f32],
    ) -> Result<(), AllocateError> {
        (**self).values(query, teams, values)
    }
}

/// What is known of an entity and a subtask beside the entity's features, for example a travel time.
pub trait TaskRelation {
    /// Columns F.
    fn columns(&self) -> usize;

    /// Looks at a state; what is written next is about it.
    ///
    /// # Errors
    /// The state is none of the environment's.
    fn observe(&mut self, state: &AllocationState<'_>) -> Result<(), AllocateError>;

    /// Writes the relation `[N, F]` of every entity to a subtask.
    fn write(&mut self, state: &AllocationState<'_>, task: usize, relation: &mut [f32]);
}

/// Features say it all: F = 0.
impl TaskRelation for () {
    fn columns(&self) -> usize {
        0
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, _: usize, _: &mut [f32]) {}
}

/// Starts from the last allocation, as the state has it.
#[derive(Clone, Copy, Debug, Default)]
pub struct LastAllocation;

impl Allocator for LastAllocation {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        if allocation.len() > state.entity_task.len() {
            return Err(AllocateError::BadLength);
        }
        for (place, tasks) in allocation.iter_mut().zip(state.entity_task) {
            let task = tasks & state.open_tasks;
            *place = if task == 0 { UNASSIGNED } else { task.trailing_zeros() as u8 };
        }
        Ok(())
    }
}

/// Working memory of a [`TeamValueAllocator`].
#[derive(Debug)]
pub struct SearchMemory<'a> {
    /// Table of the exact search: [`exact::cells`] of its agents and subtasks.
    pub cells: &'a mut [exact::Cell],
    /// Values of all teams, as many as cells.
    pub values: &'a mut [f32],
    /// The relation to one subtask, `[N, F]`.
    pub relation: &'a mut [f32],
}

/// Allocates by the values of a network.
///
/// The best of all allocations for up to `exact_agents` present agents, as far as the memory holds them;
/// beyond, coordinate ascent from what `start` allocates. Absent agents are [`UNASSIGNED`] and in no team.
#[derive(Debug)]
pub struct TeamValueAllocator<'a, N, R, S> {
    /// Values teams.
    pub network: N,
    /// What the network knows beside features.
    pub relation: R,
    /// Gives the start of the ascent.
    pub start: S,
    /// Largest team of one subtask.
    pub team_max: usize,
    /// Most agents that are searched exactly, usually [`EXACT_AGENTS`]; never more than [`exact::AGENTS`].
    pub exact_agents: usize,
    /// Working memory.
    pub memory: SearchMemory<'a>,
}

impl<N, R, S> Allocator for TeamValueAllocator<'_, N, R, S>
where
    N: TeamValueNetwork,
    R: TaskRelation,
    S: Allocator,
{
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        state.check(allocation)?;
        self.relation.observe(state)?;
        let present = (0..state.agents).filter(|row| state.present.contains(*row));
        let mut rows = heapless::Vec::<u8, { limits::AGENTS }>::new();
        for row in present {
            rows.push(row as u8).map_err(|_| AllocateError::TooLarge)?;
        }
        let teams =
            Teams { agents: rows.len(), open_tasks: state.open_tasks, team_max: self.team_max };
        let mut places = [UNASSIGNED; limits::AGENTS];
        let places = places.get_mut(..rows.len()).ok_or(AllocateError::TooLarge)?;
        let cells = exact::cells(teams.agents, teams.open_tasks.count_ones() as usize);
        if teams.agents <= self.exact_agents && cells <= self.memory.cells.len() {
            self.search_all(state, &rows, teams, places)?;
        } else {
            self.start.allocate(state, allocation)?;
            for (place, row) in places.iter_mut().zip(&rows) {
                *place = allocation.get(usize::from(*row)).copied().unwrap_or(UNASSIGNED);
            }
            self.climb(state, &rows, teams, places)?;
        }
        allocation.fill(UNASSIGNED);
        for (place, row) in places.iter().zip(&rows) {
            if let Some(to) = allocation.get_mut(usize::from(*row)) {
                *to = *place;
            }
        }
        Ok(())
    }
}

impl<N, R, S> TeamValueAllocator<'_, N, R, S>
where
    N: TeamValueNetwork,
    R: TaskRelation,
{
    fn search_all(
        &mut self,
        state: &AllocationState<'_>,
        rows: &[u8],
        teams: Teams,
        places: &mut [u8],
    ) -> Result<(), AllocateError> {
        let Self { network, relation, memory, .. } = self;
        let SearchMemory { cells, values, relation: buffer } = memory;
        let open = teams.open_tasks.count_ones() as usize;
        let values = values.get_mut(..exact::cells(teams.agents, open));
        let values = values.ok_or(AllocateError::TooLarge)?;
        let mut asked = Asked::new(network, relation, state, rows, buffer)?;
        for (task, values) in teams.tasks().zip(values.chunks_exact_mut(1 << teams.agents)) {
            asked.all_values(task, teams.team_max, values);
        }
        asked.failed()?;
        exact::search(teams, values, cells, places).map(drop)
    }

    fn climb(
        &mut self,
        state: &AllocationState<'_>,
        rows: &[u8],
        teams: Teams,
        places: &mut [u8],
    ) -> Result<(), AllocateError> {
        let Self { network, relation, memory, .. } = self;
        let mut asked = Asked::new(network, relation, state, rows, memory.relation)?;
        ascent::search(teams, &mut asked, SWEEPS, places)?;
        asked.failed()
    }
}

/// Turns teams of present agents into queries of a state's rows; keeps the first error.
struct Asked<'a, N, R> {
    network: &'a mut N,
    relation: &'a mut R,
    state: &'a AllocationState<'a>,
    /// Row of every present agent.
    rows: &'a [u8],
    buffer: &'a mut [f32],
    /// The subtask whose relation stands in the buffer.
    related: Option<usize>,
    error: Option<AllocateError>,
}

impl<'a, N: TeamValueNetwork, R: TaskRelation> Asked<'a, N, R> {
    fn new(
        network: &'a mut N,
        relation: &'a mut R,
        state: &'a AllocationState<'a>,
        rows: &'a [u8],
        buffer: &'a mut [f32],
    ) -> Result<Self, AllocateError> {
        let floats = state.entity_task.len().saturating_mul(relation.columns());
        let buffer = buffer.get_mut(..floats).ok_or(AllocateError::TooLarge)?;
        Ok(Self { network, relation, state, rows, buffer, related: None, error: None })
    }

    fn failed(&self) -> Result<(), AllocateError> {
        self.error.map_or(Ok(()), Err)
    }
}

impl<N: TeamValueNetwork, R: TaskRelation> Asked<'_, N, R> {
    /// The values `[2^A]` of all teams at a subtask. Those of more than `team_max` agents stay as they are: the search
    /// never reads them.
    fn all_values(&mut self, task: usize, team_max: usize, values: &mut [f32]) {
        let mut small =
            (0..values.len() as u64).filter(|team| team.count_ones() as usize <= team_max);
        let mut answers = [f32::NAN; TOGETHER];
        loop {
            let mut teams = heapless::Vec::<u64, TOGETHER>::new();
            for team in small.by_ref().take(TOGETHER) {
                // There is room for as many.
                let _ = teams.push(team);
            }
            let Some(answers) = answers.get_mut(..teams.len()) else { return };
            if answers.is_empty() {
                return;
            }
            self.team_values(task, teams.iter().copied(), answers);
            for (team, answer) in teams.iter().zip(answers) {
                if let Some(value) = values.get_mut(*team as usize) {
                    *value = *answer;
                }
            }
        }
    }

    /// The values of up to [`TOGETHER`] teams at a subtask; no numbers from the first error on.
    fn team_values(&mut self, task: usize, teams: impl Iterator<Item = u64>, values: &mut [f32]) {
        if self.error.is_none() {
            if self.related != Some(task) {
                self.relation.write(self.state, task, self.buffer);
                self.related = Some(task);
            }
            let mut rows = heapless::Vec::<u64, TOGETHER>::new();
            for team in teams {
                // Callers ask about as many as there is room for.
                let _ = rows.push(self.team_of_rows(team));
            }
            let query = TeamQuery { state: self.state, task, team: 0, relation: self.buffer };
            self.error = self.network.values(&query, &rows, values).err();
        }
        if self.error.is_some() {
            values.fill(f32::NAN);
        }
    }

    /// A team of present agents as a team of rows.
    fn team_of_rows(&self, team: u64) -> u64 {
        let members = self.rows.iter().enumerate().filter(|(agent, _)| team >> agent & 1 == 1);
        members.fold(0, |team, (_, row)| team | 1_u64 << (*row % 64))
    }
}

impl<N: TeamValueNetwork, R: TaskRelation> TeamValue for Asked<'_, N, R> {
    fn value(&mut self, task: usize, team: u64) -> f32 {
        let mut value = [f32::NAN];
        self.team_values(task, core::iter::once(team), &mut value);
        let [value] = value;
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// Pseudo-random numbers of a linear congruential generator.
    fn numbers(mut seed: u64) -> impl FnMut(u64) -> u64 {
        move |below| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040);
            (seed >> 33) % below
        }
    }

    /// Values that depend on subtask, team and relation; strange ones among them.
    struct Noise {
        strange: bool,
        refuses: bool,
        asked: Vec<(usize, u64)>,
    }

    impl TeamValueNetwork for Noise {
        fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
            assert_eq!(query.relation.len(), query.state.entity_task.len());
            assert!(query.relation.iter().all(|value| *value == query.task as f32));
            self.asked.push((query.task, query.team));
            match noise_word(query.task, query.team) >> 61 {
                0 if self.strange => Ok(f32::NAN),
                1 if self.strange => Ok(f32::INFINITY),
                2 if self.strange => Ok(f32::NEG_INFINITY),
                _ if self.refuses && self.asked.len() == 7 => Err(AllocateError::NonFinite),
                _ => Ok(noise_of(query.task, query.team)),
            }
        }
    }

    fn noise_word(task: usize, team: u64) -> u64 {
        (team << 5 | task as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
    }

    fn noise_of(task: usize, team: u64) -> f32 {
        (noise_word(task, team) >> 44) as f32
    }

    /// One column that repeats the subtask.
    struct TaskNumber;

    impl TaskRelation for TaskNumber {
        fn columns(&self) -> usize {
            1
        }

        fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
            Ok(())
        }

        fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
            relation.fill(task as f32);
        }
    }

    struct Case {
        agents: usize,
        tasks: usize,
        present: EntityMask,
        entity_task: Vec<u32>,
        open_tasks: u32,
        team_max: usize,
        exact_agents: usize,
    }

    impl Case {
        fn random(seed: u64) -> Self {
            let mut below = numbers(seed);
            let (agents, tasks) = (below(14) as usize, below(7) as usize);
            let mut present = EntityMask::EMPTY;
            (0..agents + tasks).filter(|_| below(4) > 0).for_each(|row| present.insert(row));
            let entity_task = (0..agents).map(|_| below(1 << 7) as u32);
            let entity_task = entity_task.collect::<Vec<_>>();
            let entity_task = entity_task.into_iter().chain((0..tasks).map(|t| 1 << t)).collect();
            Self {
                agents,
                tasks,
                present,
                entity_task,
                open_tasks: below(1 << tasks) as u32,
                team_max: below(6) as usize,
                exact_agents: below(8) as usize,
            }
        }

        fn state(&self) -> AllocationState<'_> {
            AllocationState {
                agents: self.agents,
                tasks: self.tasks,
                rows: &[0.0; 32],
                stride: 1,
                present: self.present,
                entity_task: &self.entity_task,
                open_tasks: self.open_tasks,
            }
        }

        fn run(&self, noise: &mut Noise) -> Result<Vec<u8>, AllocateError> {
            let mut cells = vec![exact::Cell::default(); exact::cells(EXACT_AGENTS, 6)];
            let (mut values, mut relation) = (vec![0.0; cells.len()], vec![0.0; 32]);
            let memory =
                SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
            let mut allocator = TeamValueAllocator {
                network: noise,
                relation: TaskNumber,
                start: LastAllocation,
                team_max: self.team_max,
                exact_agents: self.exact_agents,
                memory,
            };
            let mut allocation = vec![77; self.agents];
            allocator.allocate(&self.state(), &mut allocation).map(|()| allocation)
        }
    }

    fn noise(strange: bool, refuses: bool) -> Noise {
        Noise { strange, refuses, asked: Vec::new() }
    }

    #[test]
    fn any_state_and_any_values_give_a_feasible_allocation() {
        for seed in 0..2_000 {
            let case = Case::random(seed);
            let mut network = noise(seed % 2 == 0, false);
            let allocation = case.run(&mut network).unwrap();
            let present = (0..case.agents).filter(|row| case.present.contains(*row)).count();
            let teams =
                Teams { agents: present, open_tasks: case.open_tasks, team_max: case.team_max };
            let assigned: Vec<u8> =
                allocation.iter().copied().filter(|task| *task != UNASSIGNED).collect();
            assert_eq!(assigned.len(), teams.places(), "seed {seed}");
            for (row, task) in allocation.iter().enumerate().filter(|(_, t)| **t != UNASSIGNED) {
                assert!(case.present.contains(row), "seed {seed}: an absent agent was assigned");
                assert!(case.open_tasks >> task & 1 == 1, "seed {seed}: a closed subtask");
                let team = assigned.iter().filter(|other| *other == task).count();
                assert!(team <= case.team_max, "seed {seed}: a team of {team}");
            }
            for (task, team) in network.asked {
                assert!(case.open_tasks >> task & 1 == 1);
                let absent = (0..64).any(|row| team >> row & 1 == 1 && !case.present.contains(row));
                assert!(!absent, "seed {seed}: an absent agent in a team");
            }
        }
    }

    #[test]
    fn an_exact_search_is_never_worse_than_the_ascent() {
        let mut better = 0;
        for seed in 0..200 {
            let total = |exact_agents: usize| {
                let case = Case { exact_agents, team_max: 3, ..Case::random(seed) };
                if case.agents > 7 {
                    return 0.0;
                }
                let allocation = case.run(&mut noise(false, false)).unwrap();
                let state = case.state();
                let relation = |task: usize| vec![task as f32; case.entity_task.len()];
                let open = (0..case.tasks).filter(|task| case.open_tasks >> task & 1 == 1);
                let value = |task: usize| {
                    let members = allocation.iter().enumerate();
                    let members = members.filter(|(_, other)| usize::from(**other) == task);
                    let team = members.map(|(row, _)| 1 << row).sum();
                    let relation = relation(task);
                    let query = TeamQuery { state: &state, task, team, relation: &relation };
                    noise(false, false).value(&query).unwrap()
                };
                open.map(|task| f64::from(value(task))).sum::<f64>()
            };
            let (exact, ascent) = (total(7), total(0));
            assert!(exact >= ascent, "seed {seed}: {exact} is below {ascent}");
            better += usize::from(exact > ascent);
        }
        assert!(better > 10, "only {better} of 200 states tell the two apart");
    }

    #[test]
    fn the_best_of_all_allocations_of_ten_agents_is_found_and_no_larger_team_valued() {
        for (team_max, teams) in [(10, 1024), (5, 638), (3, 176)] {
            let case = Case {
                agents: 10,
                tasks: 2,
                present: EntityMask::first(12),
                entity_task: [0; 10].into_iter().chain([1, 2]).collect(),
                open_tasks: 0b11,
                team_max,
                exact_agents: EXACT_AGENTS,
            };
            let mut network = noise(false, false);
            let allocation = case.run(&mut network).unwrap();
            assert_eq!(network.asked.len(), 2 * teams, "teams of up to {team_max}");
            let total = |places: &[u8]| -> Option<f32> {
                let team_of = |task: u8| {
                    let rows = (0..10).filter(|row| places[*row] == task);
                    rows.map(|row| 1_u64 << row).sum::<u64>()
                };
                let of_tasks = [0, 1].map(|task| (usize::from(task), team_of(task)));
                let sizes = of_tasks.map(|(_, team)| team.count_ones() as usize);
                let placed = sizes.iter().sum::<usize>() == 10.min(2 * team_max);
                let fits = placed && sizes.iter().all(|size| *size <= team_max);
                fits.then(|| of_tasks.map(|(task, team)| noise_of(task, team)).iter().sum())
            };
            let choices = [0, 1, UNASSIGNED];
            let all = (0..3_usize.pow(10)).filter_map(|number| {
                let places: [u8; 10] =
                    core::array::from_fn(|row| choices[number / 3_usize.pow(row as u32) % 3]);
                total(&places)
            });
            assert_eq!(total(&allocation), Some(all.fold(0.0, f32::max)));
        }
    }

    #[test]
    fn a_refusal_of_the_network_is_passed_on() {
        let mut refused = 0;
        for seed in 0..100 {
            let mut network = noise(false, true);
            let result = Case::random(seed).run(&mut network);
            if network.asked.len() == 7 && result.is_err() {
                assert_eq!(result, Err(AllocateError::NonFinite));
                refused += 1;
            } else {
                assert!(result.is_ok() && network.asked.len() < 7);
            }
        }
        assert!(refused > 30, "{refused}");
    }

    #[test]
    fn states_that_contradict_themselves_are_refused() {
        let case = Case { agents: 3, tasks: 2, open_tasks: 0b11, ..Case::random(1) };
        let case = Case { entity_task: vec![0, 0, 0, 1, 2], ..case };
        let allocate = |state: &AllocationState<'_>, agents: usize| {
            let memory = SearchMemory { cells: &mut [], values: &mut [], relation: &mut [] };
            let mut allocator = TeamValueAllocator {
                network: noise(false, false),
                relation: (),
                start: LastAllocation,
                team_max: 3,
                exact_agents: 8,
                memory,
            };
            allocator.allocate(state, &mut vec![0; agents])
        };
        let short = AllocationState { rows: &[0.0; 4], ..case.state() };
        assert_eq!(allocate(&short, 3), Err(AllocateError::BadLength));
        assert_eq!(allocate(&case.state(), 2), Err(AllocateError::BadLength));
        let unknown = AllocationState { open_tasks: 0b100, ..case.state() };
        assert_eq!(allocate(&unknown, 3), Err(AllocateError::BadLength));
        let many = AllocationState { agents: 65, ..case.state() };
        assert_eq!(allocate(&many, 65), Err(AllocateError::TooLarge));
    }

    #[test]
    fn a_full_team_is_beyond_the_exact_search_whatever_is_asked_for() {
        let case = Case {
            agents: 64,
            tasks: 2,
            present: EntityMask::first(66),
            entity_task: (0..66).map(|row| if row < 64 { 0 } else { 1 << (row - 64) }).collect(),
            open_tasks: 0b11,
            team_max: 40,
            exact_agents: usize::MAX,
        };
        let memory = SearchMemory { cells: &mut [], values: &mut [], relation: &mut vec![0.0; 66] };
        let mut allocator = TeamValueAllocator {
            network: noise(false, false),
            relation: TaskNumber,
            start: LastAllocation,
            team_max: case.team_max,
            exact_agents: case.exact_agents,
            memory,
        };
        let mut allocation = [9; 64];
        let state = AllocationState { rows: &[0.0; 66], ..case.state() };
        allocator.allocate(&state, &mut allocation).unwrap();
        assert!(allocation.iter().all(|task| *task < 2));
    }

    #[test]
    fn a_query_tells_rows_apart() {
        let entity_task = [0b10, 0, 0b01, 0b10, 0b100];
        let mut present = EntityMask::first(5);
        present.remove(1);
        let state = AllocationState {
            agents: 2,
            tasks: 3,
            rows: &[],
            stride: 0,
            present,
            entity_task: &entity_task,
            open_tasks: 0b110,
        };
        let query = TeamQuery { state: &state, task: 1, team: 0b01, relation: &[] };
        assert_eq!(query.own_row(), Some(3));
        assert!(query.visible().iter().eq([0, 3, 4]));
        let members: Vec<usize> = (0..5).filter(|row| query.is_member(*row)).collect();
        assert_eq!(members, [0]);
        let mut last = [9; 2];
        LastAllocation.allocate(&state, &mut last).unwrap();
        assert_eq!(last, [1, UNASSIGNED]);
    }
}
