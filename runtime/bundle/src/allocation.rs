//! Allocation states with the values and the allocation that every engine must give.
//!
//! Part of `golden.json`, for bundles with an allocator. A relation is written as `[row, column, value]`
//! where it is not zero.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_core::allocate::TeamQuery;
use sortie_core::{AllocationState, EntityMask, UNASSIGNED, limits};

use crate::contract::ContractV1;

/// An allocation state that owns its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnedAllocationState {
    /// Number of agents A.
    pub agents: usize,
    /// Number of subtasks T.
    pub tasks: usize,
    /// Features `[N, features]`.
    pub rows: Vec<f32>,
    /// Columns d of a row.
    pub features: usize,
    /// The entities that exist.
    pub present: EntityMask,
    /// `[N]`: bit t set where the entity belongs to subtask t.
    pub entity_task: Vec<u32>,
    /// Bit t set where subtask t is open.
    pub open_tasks: u32,
    /// Availability codes `[A, U]`, 0 = not available; empty where nobody tells.
    pub available: Vec<u16>,
}

impl OwnedAllocationState {
    /// The state as allocators take it.
    pub fn view(&self) -> AllocationState<'_> {
        AllocationState {
            agents: self.agents,
            tasks: self.tasks,
            rows: &self.rows,
            stride: self.features,
            present: self.present,
            entity_task: &self.entity_task,
            open_tasks: self.open_tasks,
            available: &self.available,
        }
    }

    /// Number of entities N.
    pub fn entities(&self) -> usize {
        self.entity_task.len()
    }

    /// The open subtasks in rising order.
    pub fn open(&self) -> impl Iterator<Item = usize> + use<> {
        let open = self.open_tasks;
        (0..limits::TASKS).filter(move |task| open >> task & 1 == 1)
    }
}

/// A state, what its entities have to do with its subtasks, and the expected answers.
#[derive(Clone, Debug, PartialEq)]
pub struct GoldenAllocation {
    /// The state.
    pub state: OwnedAllocationState,
    /// Columns F of the relation.
    pub relations: usize,
    /// The relation `[open subtasks, N, F]`, subtasks in rising order.
    pub relation: Vec<f32>,
    /// The expected values of some teams.
    pub values: Vec<GoldenValue>,
    /// The expected allocation `[A]`.
    pub allocation: Vec<u8>,
}

/// The expected value of a team at an open subtask.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoldenValue {
    /// The subtask.
    pub task: usize,
    /// Bit a set where agent a is in the team.
    pub team: u64,
    /// The value.
    pub value: f32,
}

impl GoldenAllocation {
    /// The relation `[N, F]` of all entities to an open subtask; empty for others.
    pub fn relation_to(&self, task: usize) -> &[f32] {
        let place = self.state.open().position(|open| open == task);
        let floats = self.state.entities() * self.relations;
        let start = place.map_or(self.relation.len(), |place| place * floats);
        self.relation.get(start..start + floats).unwrap_or_default()
    }

    /// What an engine is asked for a value. `state` is the view of this case's state.
    pub fn query<'a>(
        &'a self,
        state: &'a AllocationState<'a>,
        value: &GoldenValue,
    ) -> TeamQuery<'a> {
        let relation = self.relation_to(value.task);
        TeamQuery { state, task: value.task, team: value.team, relation }
    }
}

/// A case as it stands in the file.
#[derive(Serialize, Deserialize)]
pub(crate) struct AllocationCase {
    agents: usize,
    entities: Vec<BTreeMap<String, f32>>,
    present: Vec<usize>,
    entity_tasks: Vec<Vec<usize>>,
    open_tasks: Vec<usize>,
    /// By agents: the actions that are available, where that is told.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    available: Vec<Vec<usize>>,
    relations: usize,
    relation: Vec<Vec<(usize, usize, f32)>>,
    values: Vec<ValueCase>,
    allocation: Vec<Option<u8>>,
}

#[derive(Serialize, Deserialize)]
struct ValueCase {
    task: usize,
    team: Vec<usize>,
    value: f32,
}

impl AllocationCase {
    pub(crate) fn from_case(case: &GoldenAllocation, contract: &ContractV1) -> Self {
        let state = &case.state;
        let named = |row: &[f32]| contract.named(row);
        let sparse = |relation: &[f32]| {
            let numbered = relation.iter().enumerate().filter(|(_, value)| **value != 0.0);
            let place = |(index, value): (usize, &f32)| {
                (index / case.relations, index % case.relations, *value)
            };
            numbered.map(place).collect()
        };
        let value = |value: &GoldenValue| ValueCase {
            task: value.task,
            team: bits(value.team),
            value: value.value,
        };
        let assigned = |task: &u8| (*task != UNASSIGNED).then_some(*task);
        let told = |codes: &[u16]| {
            let codes = codes.iter().enumerate();
            codes.filter(|(_, code)| **code != 0).map(|(action, _)| action).collect()
        };
        Self {
            agents: state.agents,
            entities: state.rows.chunks(state.features.max(1)).map(named).collect(),
            present: state.present.iter().collect(),
            entity_tasks: state.entity_task.iter().map(|tasks| bits((*tasks).into())).collect(),
            open_tasks: state.open().collect(),
            available: state.available.chunks(contract.actions.into()).map(told).collect(),
            relations: case.relations,
            relation: state.open().map(|task| sparse(case.relation_to(task))).collect(),
            values: case.values.iter().map(value).collect(),
            allocation: case.allocation.iter().map(assigned).collect(),
        }
    }

    pub(crate) fn into_case(self, contract: &ContractV1) -> Result<GoldenAllocation, String> {
        let entities = self.entities.len();
        let limits = [
            (self.agents, limits::AGENTS.min(entities)),
            (entities, limits::ENTITIES),
            (self.relations, limits::FEATURES),
        ];
        if limits.iter().any(|(size, limit)| size > limit)
            || self.entity_tasks.len() != entities
            || self.allocation.len() != self.agents
            || self.relation.len() != self.open_tasks.len()
            || ![0, self.agents].contains(&self.available.len())
            || !self.open_tasks.is_sorted_by(|task, next| task < next)
        {
            return Err("the sizes do not fit each other".to_owned());
        }
        let mut present = EntityMask::EMPTY;
        self.present.iter().for_each(|row| present.insert(*row));
        let tasks = |tasks: &[usize]| mask(tasks, limits::TASKS).map(|mask| mask as u32);
        let state = OwnedAllocationState {
            agents: self.agents,
            tasks: self.entity_tasks.iter().flatten().max().map_or(0, |task| task + 1),
            rows: contract.rows(&self.entities)?,
            features: contract.features.into(),
            present,
            entity_task: self
                .entity_tasks
                .iter()
                .map(|entity| tasks(entity))
                .collect::<Result<_, _>>()?,
            open_tasks: tasks(&self.open_tasks)?,
            available: codes(&self.available, contract.actions.into())?,
        };
        let mut relation = vec![0.0; self.open_tasks.len() * entities * self.relations];
        let floats = (entities * self.relations).max(1);
        for (to, from) in relation.chunks_exact_mut(floats).zip(&self.relation) {
            for (row, column, value) in from {
                let place = (*column < self.relations).then(|| row * self.relations + column);
                let to = place.and_then(|place| to.get_mut(place));
                *to.ok_or("a relation stands beyond the entities or columns")? = *value;
            }
        }
        let value = |case: &ValueCase| {
            let open = state.open().any(|task| task == case.task);
            let team = mask(&case.team, self.agents)?;
            let value = GoldenValue { task: case.task, team, value: case.value };
            if open { Ok(value) } else { Err("a value of a subtask that is not open".to_owned()) }
        };
        let values = self.values.iter().map(value).collect::<Result<_, _>>()?;
        let assigned = |task: &Option<u8>| task.unwrap_or(UNASSIGNED);
        let allocation = self.allocation.iter().map(assigned).collect();
        Ok(GoldenAllocation { state, relations: self.relations, relation, values, allocation })
    }
}

/// The numbers of the bits that are set.
fn bits(mask: u64) -> Vec<usize> {
    (0..64).filter(|bit| mask >> bit & 1 == 1).collect()
}

/// Availability codes of so many actions, from the numbers of those that are available.
fn codes(available: &[Vec<usize>], actions: usize) -> Result<Vec<u16>, String> {
    let mut codes = vec![0; available.len() * actions];
    for (codes, available) in codes.chunks_exact_mut(actions.max(1)).zip(available) {
        for action in available {
            *codes.get_mut(*action).ok_or("an action is available that there is not")? = 1;
        }
    }
    Ok(codes)
}

/// The mask of bits below `limit`.
fn mask(bits: &[usize], limit: usize) -> Result<u64, String> {
    let mut mask = 0;
    for bit in bits {
        if *bit >= limit {
            return Err(format!("number {bit} where {limit} is too large"));
        }
        mask |= 1 << bit;
    }
    Ok(mask)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::contract::tests::contract;
    use crate::golden::Golden;
    use crate::golden::tests::golden;

    pub(crate) fn allocation() -> GoldenAllocation {
        let mut present = EntityMask::first(5);
        present.remove(1);
        let mut relation = vec![0.0; 2 * 5 * 2];
        (relation[1], relation[19]) = (1.0, 0.25);
        GoldenAllocation {
            state: OwnedAllocationState {
                agents: 2,
                tasks: 3,
                rows: (0..15).map(|number| number as f32 / 7.0).collect(),
                features: 3,
                present,
                entity_task: vec![0, 0, 1, 2, 4],
                open_tasks: 0b101,
                available: vec![0, 1, 1, 0],
            },
            relations: 2,
            relation,
            values: vec![
                GoldenValue { task: 0, team: 0, value: 0.123_456_79 },
                GoldenValue { task: 2, team: 0b11, value: -1.0e-7 },
            ],
            allocation: vec![2, UNASSIGNED],
        }
    }

    #[test]
    fn comes_back_bit_for_bit() {
        let golden = Golden { allocations: vec![allocation(); 2], ..golden(1) };
        let json = golden.to_json(&contract()).unwrap();
        assert_eq!(Golden::from_json(&json, &contract()), Ok(golden));
    }

    #[test]
    fn relations_are_found_by_subtask() {
        let case = allocation();
        assert_eq!(case.relation_to(0)[..2], [0.0, 1.0]);
        assert_eq!(case.relation_to(2)[8..], [0.0, 0.25]);
        assert_eq!(case.relation_to(1), [0.0; 0]);
        let state = case.state.view();
        let query = case.query(&state, &case.values[1]);
        assert_eq!((query.own_row(), query.relation), (Some(4), case.relation_to(2)));
    }

    #[test]
    fn names_what_is_wrong() {
        let golden = Golden { allocations: vec![allocation()], ..golden(1) };
        let json = String::from_utf8(golden.to_json(&contract()).unwrap()).unwrap();
        let error = |from: &str, to: &str| {
            assert!(json.contains(from), "{from} in {json}");
            Golden::from_json(json.replace(from, to).as_bytes(), &contract()).unwrap_err()
        };
        let (open, other) = (r#""task":2,"team""#, r#""task":1,"team""#);
        assert_eq!(error(open, other), "allocation 0: a value of a subtask that is not open");
        let relation = error("[0,1,1.0]", "[0,2,1.0]");
        assert!(relation.ends_with("beyond the entities or columns"), "{relation}");
        let agents = error(r#""agents":2"#, r#""agents":9"#);
        assert_eq!(agents, "allocation 0: the sizes do not fit each other");
        for beyond in [2, 7] {
            let team = format!("[0,{beyond}],\"value\"");
            assert!(error("[0,1],\"value\"", &team).contains(&format!("{beyond} where 2")));
        }
    }
}
