//! Allocators that do not learn: the rules of an environment, a deployed one, and nobody.

use sortie_bundle::OwnedAllocationState;
use sortie_core::{Allocator, EntityMask};
use sortie_envs::{
    EntitySet, Environment, Observation, Shape, Spec, UNASSIGNED, deployed_tasks, members,
};

use super::{Allocate, ToAllocate};
use crate::act::codes;
use crate::error::{LearnError, Result};

/// One of the [rules](sortie_envs::Spec::rules) of an environment, by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuleAllocator<'a>(pub &'a str);

impl RuleAllocator<'_> {
    /// Its number among the rules of an environment.
    ///
    /// # Errors
    /// There is no such rule; the text says which there are.
    pub fn number(self, spec: &Spec) -> Result<usize, String> {
        let number = spec.rules.iter().position(|rule| rule.name == self.0);
        number.ok_or_else(|| {
            let names: Vec<&str> = spec.rules.iter().map(|rule| &*rule.name).collect();
            let (name, names) = (&spec.name, names.join("`, `"));
            format!("`{name}` has no rule `{}` of allocation; it has `{names}`", self.0)
        })
    }
}

impl Allocate for RuleAllocator<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
        let ToAllocate { environment, state, random, allocation } = to;
        let rule = self.number(environment.spec()).map_err(LearnError::Team)?;
        environment.allocate(rule, state, random, allocation);
        Ok(())
    }
}

/// Assigns nobody: what agents need that know of no subtasks.
#[derive(Clone, Copy, Debug)]
pub struct NoSubtasks;

impl Allocate for NoSubtasks {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
        to.allocation.fill(UNASSIGNED);
        Ok(())
    }
}

/// A deployed allocator, on what it would see of a state.
pub struct DeployedAllocator<'a>(pub Box<dyn Allocator + 'a>);

impl Allocate for DeployedAllocator<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<()> {
        let ToAllocate { environment, state, allocation, .. } = to;
        // What is proposed may depend on what was in force.
        let state = allocation_state_turned(environment, (state, allocation), 0);
        allocation.fill(UNASSIGNED);
        let team = &mut allocation[..state.agents];
        Ok(self.0.allocate(&state.view(), team)?)
    }
}

/// All that an allocator sees, under a symmetry of the rules, of a state in which an allocation was in force.
pub fn allocation_state_turned(
    environment: &dyn Environment,
    before: (&[u8], &[u8]),
    turn: usize,
) -> OwnedAllocationState {
    allocation_state_within(environment, before, turn, &mut Observation::default())
}

/// The same, by way of an observation whose room is used again.
pub fn allocation_state_within(
    environment: &dyn Environment,
    (state, in_force): (&[u8], &[u8]),
    turn: usize,
    seen: &mut Observation,
) -> OwnedAllocationState {
    let mut state = told(environment, state, turn, seen);
    tell_allocation(&mut state.entity_task, &in_force[..state.agents]);
    state
}

/// Says of agents, the first of all entities, that they belong to the subtasks that they were given.
pub(super) fn tell_allocation(entity_task: &mut [u32], allocation: &[u8]) {
    for (tasks, task) in entity_task.iter_mut().zip(allocation) {
        *tasks = 1_u32.checked_shl((*task).into()).unwrap_or(0);
    }
}

/// All that an allocator sees of a state; agents come without their last allocation.
pub fn allocation_state(environment: &dyn Environment, state: &[u8]) -> OwnedAllocationState {
    told(environment, state, 0, &mut Observation::default())
}

fn told(
    environment: &dyn Environment,
    state: &[u8],
    turn: usize,
    seen: &mut Observation,
) -> OwnedAllocationState {
    let Shape { features, actions, .. } = environment.spec().shape;
    environment.observe(state, turn, EntitySet::MAX, seen);
    let mut rows = Vec::with_capacity(seen.rows.len() * features);
    seen.rows.write_all(features, &mut rows);
    let mut present = EntityMask::first(seen.rows.len());
    members(seen.absent.into()).for_each(|agent| present.remove(agent));
    let team = &seen.available[..seen.agents()];
    OwnedAllocationState {
        agents: team.len(),
        tasks: seen.tasks(),
        rows,
        features,
        present,
        entity_task: members(seen.present)
            .map(|entity| deployed_tasks(seen.entity_task[entity]))
            .collect(),
        open_tasks: deployed_tasks(seen.open_tasks),
        available: team.iter().flat_map(|set| codes(*set, actions)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator};
    use sortie_core::{AllocateError, AllocationState};
    use sortie_envs::Split;

    /// Notes what was in force for each agent and with what the new allocation began; sends everybody to subtask 1.
    #[derive(Default)]
    struct Noting {
        in_force: Vec<u32>,
        begun: Vec<u8>,
    }

    impl Allocator for Noting {
        fn allocate(
            &mut self,
            state: &AllocationState<'_>,
            allocation: &mut [u8],
        ) -> Result<(), AllocateError> {
            self.in_force = state.entity_task[..state.agents].to_vec();
            self.begun = allocation.to_vec();
            allocation.fill(1);
            Ok(())
        }
    }

    #[test]
    fn a_deployed_allocator_is_told_what_was_in_force() {
        let city = sortie_envs::open("save-the-city", Split::Test, 1, &Default::default());
        let (mut city, mut random) = (city.unwrap(), generator(1, Purpose::Rollout, 0));
        let mut state = Vec::new();
        city.reset(0, &mut random);
        city.save(0, &mut state);
        let agents = allocation_state(&*city, &state).agents;
        assert!(agents > 2 && agents <= city.spec().shape.agents);
        let mut allocation = vec![UNASSIGNED; city.spec().shape.agents];
        allocation[0] = 3;
        allocation[2] = 0;
        let mut noting = Noting::default();
        DeployedAllocator(Box::new(&mut noting))
            .allocate(ToAllocate {
                environment: &*city,
                state: &state,
                random: &mut random,
                allocation: &mut allocation,
            })
            .unwrap();
        let mut want = vec![0; agents];
        (want[0], want[2]) = (0b1000, 0b1);
        assert_eq!((noting.in_force, noting.begun), (want, vec![UNASSIGNED; agents]));
        let whole = allocation.iter().enumerate();
        assert!(
            whole
                .into_iter()
                .all(|(agent, task)| *task == if agent < agents { 1 } else { UNASSIGNED })
        );
    }
}
