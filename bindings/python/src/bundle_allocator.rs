//! What a team's agents see, read from arrays, and the allocator that it learned: its network, and the search of the best
//! allocation.

use std::sync::{Mutex, PoisonError};

use numpy::PyUntypedArrayMethods;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use sortie_bundle::{Bundle, ContractV1, OwnedAllocationState};
use sortie_core::allocate::{
    EXACT_AGENTS, LastAllocation, PlanTeamValue, PointingMemory, ProposalAllocator, SearchMemory,
    TaskRelation, TeamValueAllocator, exact,
};
use sortie_core::plan::{AlignedBytes, PlanError};
use sortie_core::{
    AllocateError, AllocationState, Allocator, EntityMask, NO_ACTION, Observation, UNASSIGNED,
    limits,
};

use crate::arrays::{array, mask, numbers, slice, whole};
use crate::errors::{exceptions, words};
use crate::owned_plan::OwnedPlan;

/// Columns of the network beside features and relation: a flag of the subtask's own row, and one of the team.
const FLAGS: usize = 2;

/// What an allocation is made of.
pub(crate) struct Asked<'a, 'py> {
    pub(crate) entities: &'a Bound<'py, PyAny>,
    pub(crate) agents: usize,
    pub(crate) entity_tasks: &'a Bound<'py, PyAny>,
    pub(crate) open_tasks: &'a Bound<'py, PyAny>,
    pub(crate) present: Option<&'a Bound<'py, PyAny>>,
    pub(crate) available: Option<&'a Bound<'py, PyAny>>,
    pub(crate) relation: Option<&'a Bound<'py, PyAny>>,
}

/// How the best allocation is found.
#[derive(Clone, Copy)]
pub(crate) enum How {
    /// By the values of teams.
    Search,
    /// As the best of those that a policy draws, by noise from the seed; one is the most probable.
    Propose { proposals: usize, seed: u64 },
}

/// What an entity has to do with a subtask, `[T, N, F]`.
struct Relation {
    numbers: Vec<f32>,
    columns: usize,
    entities: usize,
}

impl TaskRelation for Relation {
    fn columns(&self) -> usize {
        self.columns
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        let floats = (self.columns * self.entities).max(1);
        let of_task = self.numbers.chunks_exact(floats).nth(task).unwrap_or_default();
        for (to, from) in relation.iter_mut().zip(of_task) {
            *to = *from;
        }
    }
}

pub(crate) fn allocate<'py>(
    bundle: &Bundle,
    plan: &OwnedPlan,
    asked: &Asked<'_, 'py>,
    how: How,
) -> PyResult<Bound<'py, PyAny>> {
    let py = asked.entities.py();
    let features = usize::from(bundle.contract().features);
    let columns = plan.plan().header().features as usize;
    let state = asked.state(bundle.contract())?;
    let relation = match how {
        How::Search => columns.saturating_sub(features + FLAGS),
        How::Propose { .. } => 0,
    };
    let relation = asked.relation(&state, relation)?;
    let team_max = bundle.manifest().limits.team_max.into();
    let allocation = py.detach(|| match how {
        How::Search => search(plan, &state, relation, team_max),
        How::Propose { proposals, seed } => propose(plan, &state, proposals, seed),
    });
    subtasks(py, allocation)
}

/// Allocates by an allocator that points.
pub(crate) fn point<'py>(
    bundle: &Bundle,
    memory: &Mutex<PointingMemory>,
    asked: &Asked<'_, 'py>,
) -> PyResult<Bound<'py, PyAny>> {
    let (py, contract) = (asked.entities.py(), bundle.contract());
    if asked.available.is_none() {
        return Err(PyValueError::new_err(format!(
            "the allocator offers agents what their actions lead to: give `available` [{}, {}]",
            asked.agents, contract.actions
        )));
    }
    let state = asked.state(contract)?;
    let allocation = py.detach(|| {
        let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
        allocation_of(&mut memory.bind().map_err(|error| words(&error))?, &state)
    });
    subtasks(py, allocation)
}

/// Numbers of subtasks, -1 for none.
fn subtasks(py: Python<'_>, allocation: Result<Vec<u8>, String>) -> PyResult<Bound<'_, PyAny>> {
    let allocation = allocation.map_err(exceptions::DecideError::new_err)?;
    let task = |task: &u8| if *task == UNASSIGNED { -1 } else { i64::from(*task) };
    let allocation: Vec<i64> = allocation.iter().map(task).collect();
    Ok(array(py, &[allocation.len()], &allocation)?.into_any())
}

impl Asked<'_, '_> {
    fn state(&self, contract: &ContractV1) -> PyResult<OwnedAllocationState> {
        let (features, actions) = (contract.features.into(), contract.actions.into());
        let (rows, count) = rows(self.entities, features)?;
        let tasks = self.open_tasks.len()?;
        if tasks > limits::TASKS || self.agents > count.min(limits::AGENTS) {
            return Err(PyValueError::new_err(format!(
                "{} agents of {count} entities and {tasks} subtasks: agents are the first entities, at most {}; \
                 at most {} subtasks",
                self.agents,
                limits::AGENTS,
                limits::TASKS
            )));
        }
        let present = match self.present {
            Some(present) => set(&mask("present", present, &[count])?),
            None => EntityMask::first(count),
        };
        let open = mask("open_tasks", self.open_tasks, &[tasks])?;
        let entity_tasks = mask("entity_tasks", self.entity_tasks, &[count, tasks])?;
        let entity_task = match tasks {
            0 => vec![0; count],
            _ => entity_tasks.chunks(tasks).map(bits).collect(),
        };
        let (agents, open_tasks) = (self.agents, bits(&open));
        let available = match self.available {
            Some(available) => mask("available", available, &[agents, actions])?,
            None => Vec::new(),
        };
        Ok(OwnedAllocationState {
            agents,
            tasks,
            rows,
            features,
            present,
            entity_task,
            open_tasks,
            available,
        })
    }

    fn relation(&self, state: &OwnedAllocationState, columns: usize) -> PyResult<Relation> {
        let (tasks, entities) = (state.tasks, state.entities());
        let want = [tasks, entities, columns];
        let numbers = match self.relation {
            Some(relation) => {
                let relation = numbers("relation", relation)?;
                if relation.shape() != want {
                    return Err(PyValueError::new_err(format!(
                        "`relation` has the shape {:?}, needed is {want:?}: subtasks, entities, columns",
                        relation.shape()
                    )));
                }
                slice(&relation)?.to_vec()
            }
            None if columns == 0 => Vec::new(),
            None => {
                return Err(PyValueError::new_err(format!(
                    "the allocator knows more of entities than their features: give `relation` {want:?}"
                )));
            }
        };
        Ok(Relation { numbers, columns, entities })
    }
}

/// The flags as bits, the first the lowest.
fn bits(flags: &[u16]) -> u32 {
    let set = flags.iter().enumerate().filter(|(_, flag)| **flag != 0);
    set.fold(0, |bits, (place, _)| bits | 1 << place)
}

/// The allocation of the highest value among so many that are drawn.
fn propose(
    plan: &OwnedPlan,
    state: &OwnedAllocationState,
    proposals: usize,
    seed: u64,
) -> Result<Vec<u8>, String> {
    let plan = plan.plan().clone();
    let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&plan, proposals));
    let allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), proposals, seed);
    allocation_of(&mut allocator.map_err(|error| words(&error))?, state)
}

/// The allocation of the highest value of all.
fn search(
    plan: &OwnedPlan,
    state: &OwnedAllocationState,
    relation: Relation,
    team_max: usize,
) -> Result<Vec<u8>, String> {
    let plan = plan.plan().clone();
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(limits::AGENTS));
    let entities = state.entities();
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, entities)];
    let cells = exact::cells(state.agents.min(EXACT_AGENTS), state.open().count());
    let (mut values, mut cells) = (vec![0.0; cells], vec![exact::Cell::default(); cells]);
    let mut relations = vec![0.0; entities * relation.columns];
    let network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows);
    let mut allocator = TeamValueAllocator {
        network: network.map_err(|error: PlanError| words(&error))?,
        relation,
        start: LastAllocation,
        team_max,
        exact_agents: EXACT_AGENTS,
        memory: SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relations },
    };
    allocation_of(&mut allocator, state)
}

fn allocation_of(
    allocator: &mut impl Allocator,
    state: &OwnedAllocationState,
) -> Result<Vec<u8>, String> {
    let mut allocation = vec![0; state.agents];
    let found = allocator.allocate(&state.view(), &mut allocation);
    found.map(|()| allocation).map_err(|error| error.to_string())
}

/// Copies of what the agents of one frame see, so that others may write to the arrays meanwhile.
pub(crate) struct Observations {
    rows: Vec<f32>,
    features: usize,
    last_actions: Vec<u16>,
    visible: Vec<EntityMask>,
    /// Availability `[A, U]`.
    available: Vec<u16>,
    actions: usize,
}

impl Observations {
    pub(crate) fn read(
        contract: &ContractV1,
        entities: &Bound<'_, PyAny>,
        visible: &Bound<'_, PyAny>,
        available: &Bound<'_, PyAny>,
        last_actions: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let (features, actions) = (contract.features.into(), contract.actions.into());
        let (rows, count) = rows(entities, features)?;
        let agents = visible.len()?;
        if agents > limits::AGENTS.min(count) {
            return Err(PyValueError::new_err(format!(
                "`visible` has {agents} agents; they are the first of {count} entities, at most {}",
                limits::AGENTS
            )));
        }
        let seen = mask("visible", visible, &[agents, count])?;
        let visible = if count == 0 { Vec::new() } else { seen.chunks(count).map(set).collect() };
        let available = mask("available", available, &[agents, actions])?;
        let last_actions = match last_actions {
            Some(last) => last_of(last, agents, actions)?,
            None => vec![NO_ACTION; agents],
        };
        Ok(Self { rows, features, last_actions, visible, available, actions })
    }

    /// As policies take them, in the agents' order.
    pub(crate) fn views(&self) -> Vec<Observation<'_>> {
        let available = self.available.chunks(self.actions.max(1));
        let each = self.visible.iter().zip(available).enumerate();
        let views = each.map(|(self_index, (visible, available))| Observation {
            rows: &self.rows,
            stride: self.features,
            last_actions: &self.last_actions,
            visible: *visible,
            self_index,
            available,
        });
        views.collect()
    }
}

/// Rows of features `[N, d]`, and how many.
pub(crate) fn rows(entities: &Bound<'_, PyAny>, features: usize) -> PyResult<(Vec<f32>, usize)> {
    let entities = numbers("entities", entities)?;
    let [count, columns] = *entities.shape() else {
        return Err(PyValueError::new_err(format!(
            "`entities` has the shape {:?}, needed is a row of {features} features for each",
            entities.shape()
        )));
    };
    if columns != features || count > limits::ENTITIES {
        return Err(PyValueError::new_err(format!(
            "`entities` has the shape [{count}, {columns}], needed are at most {} rows of {features} features",
            limits::ENTITIES
        )));
    }
    Ok((slice(&entities)?.to_vec(), count))
}

/// The entities whose flag is set.
fn set(flags: &[u16]) -> EntityMask {
    let mut set = EntityMask::EMPTY;
    for (entity, _) in flags.iter().enumerate().filter(|(_, flag)| **flag != 0) {
        set.insert(entity);
    }
    set
}

/// Last actions, -1 where there was none.
fn last_of(given: &Bound<'_, PyAny>, agents: usize, actions: usize) -> PyResult<Vec<u16>> {
    let last = |action: i64| match u16::try_from(action) {
        Ok(action) if usize::from(action) < actions => Ok(action),
        _ if action == -1 => Ok(NO_ACTION),
        _ => Err(PyValueError::new_err(format!(
            "`last_actions` holds {action}: an action is one of {actions} from 0, or -1 for none"
        ))),
    };
    let given = whole("last_actions", given)?;
    if given.len() != agents {
        let got = given.len();
        return Err(PyTypeError::new_err(format!("`last_actions` has {got} of {agents} agents")));
    }
    given.into_iter().map(last).collect()
}
