//! Allocations by values of teams.

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
            available: &[],
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
        let teams = Teams { agents: present, open_tasks: case.open_tasks, team_max: case.team_max };
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
        available: &[],
    };
    let query = TeamQuery { state: &state, task: 1, team: 0b01, relation: &[] };
    assert_eq!(query.own_row(), Some(3));
    assert!(query.visible().iter().eq([0, 3, 4]));
    // All that is there of an army is the subtask's, and the first of those asks.
    let entity_task = [0b10, 0b10, 0b10, 0b01, 0b10, 0b10, 0b10];
    let army = |present: &[usize]| {
        let mut mask = EntityMask::EMPTY;
        present.iter().for_each(|row| mask.insert(*row));
        let state = AllocationState { present: mask, entity_task: &entity_task, ..state };
        let query = TeamQuery { state: &state, ..query };
        let own: Vec<usize> = (0..7).filter(|row| query.is_own(*row)).collect();
        (query.own_row(), own)
    };
    assert_eq!(army(&[0, 3, 5, 6]), (Some(5), vec![5, 6]));
    assert_eq!(army(&[0, 3]), (Some(2), vec![2]));
    let members: Vec<usize> = (0..5).filter(|row| query.is_member(*row)).collect();
    assert_eq!(members, [0]);
    let mut last = [9; 2];
    LastAllocation.allocate(&state, &mut last).unwrap();
    assert_eq!(last, [1, UNASSIGNED]);
}
