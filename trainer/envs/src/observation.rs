//! What there is to see in one state.

use alloc::vec;
use alloc::vec::Vec;

use crate::decisions::UNASSIGNED;
use crate::rows::SparseRows;
use crate::spec::Shape;

/// Entities as bits: bit e stands for entity e.
pub type EntitySet = u128;

/// Agents as bits.
pub type AgentSet = u64;

/// Actions as bits.
pub type ActionSet = u128;

/// Subtasks as bits.
pub type TaskSet = u128;

/// Subtasks as messages and plans know them, which hold 32. Whoever has more learns and is measured, but is not deployed.
#[inline]
pub fn deployed_tasks(tasks: TaskSet) -> u32 {
    tasks as u32
}

/// The members of a set, lowest first.
#[inline]
pub fn members(set: EntitySet) -> Members {
    Members(set)
}

/// The members of a set that are still to come.
#[derive(Clone, Debug)]
pub struct Members(EntitySet);

impl Iterator for Members {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        let member = (self.0 != 0).then(|| self.0.trailing_zeros() as usize)?;
        self.0 &= self.0 - 1;
        Some(member)
    }
}

/// What there is to see in one state; filled by [`Environment::observe`](crate::Environment::observe).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// The entities that have a row: those that exist and were wanted.
    pub entities: EntitySet,
    /// Their features, in rising order of the entities.
    pub rows: SparseRows,
    /// The entities that exist. Agents are the first of all entities, and those that exist the first of them.
    pub present: EntitySet,
    /// Agents that exist and for which nobody acts any more: dead, or [failed](crate::Failing). Their bodies are seen as far
    /// as others observe them, but nobody counts on them: allocations and mixers leave them out.
    pub absent: AgentSet,
    /// `[A]`: the entities that each agent can observe; empty for those that do not exist.
    pub observable: Vec<EntitySet>,
    /// `[N]`: the subtasks, as bits, that each entity belongs to by itself; none for agents and absent entities.
    pub entity_task: Vec<TaskSet>,
    /// `[A]`: the actions that each agent may take; one alone for absent agents, action 0 for those that do not exist.
    pub available: Vec<ActionSet>,
    /// The subtasks that exist and are not finished.
    pub open_tasks: TaskSet,
}

impl Observation {
    /// Room for the observation of an environment of this shape.
    pub fn new(shape: &Shape) -> Self {
        Self {
            observable: vec![0; shape.agents],
            entity_task: vec![0; shape.entities],
            available: vec![1; shape.agents],
            ..Self::default()
        }
    }

    /// Begins what agents alone show, all of whom exist and may do so many things each; rows are still to come.
    pub(crate) fn begin_agents(
        &mut self,
        agents: usize,
        actions: usize,
        wanted: EntitySet,
        sees: impl Fn(usize) -> EntitySet,
    ) {
        self.present = EntitySet::MAX >> (EntitySet::BITS as usize - agents);
        self.entities = wanted & self.present;
        self.observable.clear();
        self.observable.extend((0..agents).map(sees));
        self.entity_task.clear();
        self.entity_task.resize(agents, 0);
        self.available.clear();
        self.available.resize(agents, (1 << actions) - 1);
        self.open_tasks = 0;
        self.rows.clear();
    }

    /// Number of agents that exist.
    pub fn agents(&self) -> usize {
        let agents = self.observable.len() as u32;
        (self.present.trailing_ones().min(agents)) as usize
    }

    /// The agents that exist and for which somebody acts.
    pub fn acting(&self) -> AgentSet {
        let slots = (1_u128 << self.observable.len()) - 1;
        (self.present & slots) as AgentSet & !self.absent
    }

    /// Number of subtasks up to the last one that is open or that something belongs to.
    pub fn tasks(&self) -> usize {
        let known = self.entity_task.iter().fold(self.open_tasks, |all, tasks| all | tasks);
        (TaskSet::BITS - known.leading_zeros()) as usize
    }

    /// The entities that exist and are no agents.
    #[inline]
    pub fn things(&self) -> EntitySet {
        self.present & !((1 << self.observable.len()) - 1)
    }

    /// Those of them that belong to a subtask.
    pub fn things_of(&self, task: usize) -> EntitySet {
        let belong = |entity: &usize| self.entity_task[*entity] >> task & 1 == 1;
        members(self.things()).filter(belong).fold(0, |set, entity| set | 1 << entity)
    }

    /// The first subtask that an entity belongs to, [`UNASSIGNED`] where it belongs to none.
    #[inline]
    pub fn task_of(&self, entity: usize) -> u8 {
        match self.entity_task[entity] {
            0 => UNASSIGNED,
            tasks => tasks.trailing_zeros() as u8,
        }
    }

    /// The row in [`rows`](Self::rows) of an entity that has one.
    #[inline]
    pub fn row_of(&self, entity: usize) -> usize {
        (self.entities & ((1 << entity) - 1)).count_ones() as usize
    }
}
