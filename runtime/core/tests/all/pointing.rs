//! The allocator that points, by the plans of a small network: any state gets a feasible allocation or a refusal, and what it
//! keeps of subtasks changes no allocation.

use sortie_core::allocate::{PointingAllocator, PointingRules};
use sortie_core::plan::{Aligned, Plan, PlanError, arena_bytes};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, UNASSIGNED, include_plan,
};

const ENCODER: &[u8] = include_plan!("../../../../tests/golden/plans/pointing-encoder-2.3.plan");
const DECODER: &[u8] = include_plan!("../../../../tests/golden/plans/pointing-decoder-2.3.plan");
const ARENA: usize = {
    let [encoder, decoder] = [arena_bytes(ENCODER), arena_bytes(DECODER)];
    if encoder > decoder { encoder } else { decoder }
};

/// Agents and subtasks of the network, columns of a row, and of a subtask's row.
const AGENTS: usize = 4;
const TASKS: usize = 16;
const FEATURES: usize = 14;
const FIXED: usize = 7;
/// Subtasks for all; each of the others is for one agent alone, as long as its action is available.
const SHARED: u32 = 1 << 15;
const RULES: PointingRules = PointingRules { exclusive: SHARED - 1, first_action: 1 };

/// Pseudo-random numbers of a linear congruential generator.
struct Numbers(u64);

impl Numbers {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_041);
        self.0 >> 31
    }

    fn below(&mut self, bound: usize) -> usize {
        self.word() as usize % bound.max(1)
    }

    fn float(&mut self) -> f32 {
        self.below(2001) as f32 / 1000.0 - 1.0
    }
}

/// A team, and a thing for each subtask.
struct Case {
    agents: usize,
    rows: Vec<f32>,
    present: EntityMask,
    entity_task: Vec<u32>,
    open_tasks: u32,
    available: Vec<u16>,
}

impl Case {
    fn random(numbers: &mut Numbers) -> Self {
        let agents = 1 + numbers.below(AGENTS);
        let entities = agents + TASKS;
        // Agents have what they were given before, if anything; some things belong to several subtasks.
        let before = |numbers: &mut Numbers| 1_u32.checked_shl(numbers.below(40) as u32);
        let mut entity_task: Vec<u32> =
            (0..agents).map(|_| before(numbers).unwrap_or(0) & 0xFFFF).collect();
        entity_task.extend((0..TASKS).map(|task| 1 << task));
        if numbers.below(4) == 0 {
            entity_task[agents + numbers.below(TASKS)] |= numbers.word() as u32 & 0xFFFF;
        }
        let mut present = EntityMask::first(entities);
        (0..numbers.below(6)).for_each(|_| present.remove(numbers.below(entities)));
        Self {
            agents,
            rows: (0..entities * FEATURES).map(|_| numbers.float()).collect(),
            present,
            entity_task,
            // The subtask for all is open most of the time.
            open_tasks: (numbers.word() as u32 & 0x7FFF)
                | if numbers.below(8) > 0 { SHARED } else { 0 },
            available: (0..agents * (TASKS + 1)).map(|_| numbers.below(3) as u16).collect(),
        }
    }

    fn state(&self) -> AllocationState<'_> {
        AllocationState {
            agents: self.agents,
            tasks: TASKS,
            rows: &self.rows,
            stride: FEATURES,
            present: self.present,
            entity_task: &self.entity_task,
            open_tasks: self.open_tasks,
            available: &self.available,
        }
    }
}

/// The memory of an allocator.
struct Memory(Aligned<[u8; ARENA]>, Vec<f32>);

impl Memory {
    fn new() -> Self {
        let [encoder, decoder] = [ENCODER, DECODER].map(|plan| Plan::load(plan).unwrap());
        let floats = PointingAllocator::memory_floats([&encoder, &decoder]);
        Self(Aligned([0xFF; ARENA]), vec![f32::NAN; floats])
    }

    fn allocator(&mut self) -> PointingAllocator<'_> {
        let plans = [ENCODER, DECODER].map(|plan| Plan::load(plan).unwrap());
        PointingAllocator::new(plans, RULES, &mut self.0.0, &mut self.1).unwrap()
    }
}

fn allocated(allocator: &mut PointingAllocator<'_>, case: &Case) -> Vec<u8> {
    let mut allocation = vec![77; case.agents];
    allocator.allocate(&case.state(), &mut allocation).expect("a state of these sizes");
    allocation
}

/// What agents were given is open, they can have it, and one alone has it; who was given nothing could have had nothing.
fn check(case: &Case, allocation: &[u8], label: &str) {
    let mut taken = 0_u32;
    for (agent, task) in allocation.iter().enumerate() {
        let may = |task: usize| {
            let bit = 1_u32 << task;
            let code = case.available[agent * (TASKS + 1) + 1 + task];
            case.present.contains(agent)
                && case.open_tasks & bit != 0
                && (bit == SHARED || code != 0 && taken & bit == 0)
        };
        if *task == UNASSIGNED {
            assert!(!(0..TASKS).any(may), "{label}: agent {agent} could have had something");
        } else {
            assert!(may(usize::from(*task)), "{label}: {allocation:?}");
            taken |= 1 << task;
        }
    }
}

/// States that are tried; more of them: `SORTIE_STATES=1000000`.
fn states() -> u64 {
    std::env::var("SORTIE_STATES").map_or(4_000, |states| states.parse().unwrap())
}

#[test]
fn what_is_given_is_open_and_can_be_had_and_is_given_once() {
    let (mut memory, mut decided) = (Memory::new(), [0; TASKS]);
    let mut allocator = memory.allocator();
    for seed in 0..states() {
        let case = Case::random(&mut Numbers(seed));
        let allocation = allocated(&mut allocator, &case);
        check(&case, &allocation, &format!("{seed}"));
        let given = allocation.iter().filter(|task| **task != UNASSIGNED);
        given.for_each(|task| decided[usize::from(*task)] += 1);
    }
    assert!(decided.iter().all(|count| *count > 20), "{decided:?}");
}

/// States that nobody would tell of in earnest.
#[test]
fn hostile_states_are_answered_or_refused_by_name() {
    let mut memory = Memory::new();
    let mut allocator = memory.allocator();
    let (mut answered, mut refused) = (0, 0);
    for seed in 0..states() {
        let mut numbers = Numbers(seed);
        let mut case = Case::random(&mut numbers);
        let (agents, entities) = (case.agents, case.agents + TASKS);
        let [entity, column] = [entities, FEATURES].map(|bound| numbers.below(bound));
        let strange = [f32::NAN, f32::INFINITY, f32::MAX, 1e30, -1e30][numbers.below(5)];
        let is_seen = case.present.contains(entity) && !strange.is_finite();
        let expected = match seed % 10 {
            // A number that is none, or far too large, in the row of somebody who is there or not.
            0..3 => {
                case.rows[entity * FEATURES + column] = strange;
                is_seen.then_some(AllocateError::NonFinite)
            }
            // Vehicles without room, demands above all capacity: rows of one number.
            3 => {
                case.rows.fill([0.0, -1.0, 1e6][numbers.below(3)]);
                None
            }
            4 => {
                case.present = EntityMask::first(numbers.below(2) * agents);
                None
            }
            5 => {
                case.open_tasks = 0;
                None
            }
            6 => {
                case.entity_task.fill(u32::MAX);
                None
            }
            7 => {
                case.available.truncate(numbers.below(agents * (TASKS + 1)));
                Some(AllocateError::BadLength)
            }
            8 => {
                case.rows.truncate(numbers.below(entities * FEATURES));
                Some(AllocateError::BadLength)
            }
            _ => {
                case.open_tasks |= 1 << (TASKS + numbers.below(16));
                Some(AllocateError::BadLength)
            }
        };
        let mut allocation = vec![77; agents];
        match allocator.allocate(&case.state(), &mut allocation) {
            Ok(()) => {
                assert_eq!(expected, None, "{seed}");
                check(&case, &allocation, &format!("{seed}"));
                answered += 1;
            }
            // What is finite and far too large may be so no more inside the network.
            Err(AllocateError::NonFinite) if seed % 10 < 3 && strange.is_finite() => refused += 1,
            Err(error) => {
                assert_eq!(expected, Some(error), "{seed}");
                refused += 1;
            }
        }
    }
    assert!(answered > states() / 4 && refused > states() / 4, "{answered} {refused}");
}

/// An allocator that has seen other subtasks before gives what a new one gives.
#[test]
fn subtasks_are_encoded_anew_when_they_change() {
    let (mut memory, mut differ) = (Memory::new(), 0);
    let mut kept = memory.allocator();
    let mut case = Case::random(&mut Numbers(1));
    let mut before = Vec::new();
    for seed in 0..400 {
        let mut numbers = Numbers(seed);
        match seed % 4 {
            0 => case = Case::random(&mut numbers),
            1 => {
                let place = (case.agents + numbers.below(TASKS)) * FEATURES + numbers.below(FIXED);
                case.rows[place] = 1.5;
            }
            2 => case.present.remove(case.agents + numbers.below(TASKS)),
            _ => case.rows[..FEATURES].fill_with(|| numbers.float()),
        }
        let allocation = allocated(&mut kept, &case);
        assert_eq!(allocation, allocated(&mut Memory::new().allocator(), &case), "{seed}");
        differ += usize::from(allocation != before);
        before = allocation;
    }
    assert!(differ > 100, "{differ}");
}

#[test]
fn agents_that_are_alike_leave_in_their_order() {
    let (mut memory, mut stay) = (Memory::new(), 0);
    let mut allocator = memory.allocator();
    for seed in 0..400 {
        let mut case = Case::random(&mut Numbers(seed));
        case.open_tasks |= SHARED;
        let first = case.rows[..FEATURES].to_vec();
        case.rows[..case.agents * FEATURES].copy_from_slice(&first.repeat(case.agents));
        case.present = EntityMask::first(case.agents + TASKS);
        case.available.fill(1);
        let stays: Vec<bool> =
            allocated(&mut allocator, &case).iter().map(|task| 1 << task == SHARED).collect();
        assert!(stays.is_sorted(), "{seed}: {stays:?}");
        stay += stays.iter().filter(|stays| **stays).count();
    }
    assert!(stay > 20, "{stay}");
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut memory = Memory::new();
    let mut allocator = memory.allocator();
    assert_eq!(allocator.most(), [AGENTS, TASKS]);
    let case = Case::random(&mut Numbers(3));
    let mut refused = |state: AllocationState<'_>| {
        allocator.allocate(&state, &mut vec![0; state.agents]).expect_err("it does not fit")
    };
    let state = case.state();
    let (rows, tasks) = (vec![0.0; 21 * FEATURES], vec![0; 21]);
    let more = AllocationState { agents: 5, rows: &rows, entity_task: &tasks, ..state };
    assert_eq!(refused(more), AllocateError::TooLarge);
    assert_eq!(refused(AllocationState { tasks: 17, ..state }), AllocateError::TooLarge);
    assert_eq!(refused(AllocationState { stride: 11, ..state }), AllocateError::BadLength);
    assert_eq!(refused(AllocationState { rows: &[], ..state }), AllocateError::BadLength);
    for strange in [f32::NAN, f32::INFINITY] {
        let mut rows = case.rows.clone();
        let entity = case.present.iter().last().expect("somebody");
        rows[entity * FEATURES + FEATURES - 1] = strange;
        assert_eq!(refused(AllocationState { rows: &rows, ..state }), AllocateError::NonFinite);
    }
}

#[test]
fn other_plans_and_too_little_memory_are_refused() {
    let plans = || [ENCODER, DECODER].map(|plan| Plan::load(plan).unwrap());
    let [encoder, decoder] = plans();
    assert_eq!(PointingAllocator::memory_floats([&decoder, &encoder]), 0);
    let mut arena = Aligned([0; ARENA]);
    let mut floats = vec![0.0; PointingAllocator::memory_floats([&encoder, &decoder])];
    let turned = PointingAllocator::new([decoder, encoder], RULES, &mut arena.0, &mut floats);
    assert_eq!(turned.err(), Some(PlanError::WrongNetwork));
    let (need, got) = (4 * floats.len(), 4 * (floats.len() - 1));
    let less = PointingAllocator::new(plans(), RULES, &mut arena.0, &mut floats[1..]);
    assert_eq!(less.err(), Some(PlanError::ArenaTooSmall { need, got }));
    let less = PointingAllocator::new(plans(), RULES, &mut arena.0[..64], &mut floats);
    assert!(matches!(less.err(), Some(PlanError::ArenaTooSmall { .. })));
}
