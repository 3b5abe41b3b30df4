//! Deciding in the environment by proposal policy and critic.

use rand_core::Rng;
use sortie_envs::random::{below, chance};
use sortie_envs::{EntitySet, Environment, Observation, UNASSIGNED, members};
use sortie_nn::layers::SparseRows;
use sortie_nn::random::Generator;

use super::allocation::{
    AllocationNetworks, Decided, Decider, Noise, StateView, States, TaskColumns,
};
use super::batch::NO_TASK;
use super::rollout::{Decide, Exploration};
use crate::alma::evaluate::Allocate;
use sortie_learn::LearnError;

/// Proposes allocations and takes the one that the critic values most.
#[derive(Debug)]
pub struct ProposalAllocator<'a> {
    networks: AllocationNetworks<'a>,
    proposals: usize,
    greedy_first: bool,
    decider: Decider,
    features: SparseRows,
    seen: Observation,
}

impl<'a> ProposalAllocator<'a> {
    /// An allocator that chooses among so many proposals.
    pub fn new(networks: AllocationNetworks<'a>, proposals: usize) -> Self {
        Self {
            networks,
            proposals,
            greedy_first: false,
            decider: Decider::default(),
            features: SparseRows::default(),
            seen: Observation::default(),
        }
    }

    /// The same whose first proposal is what the policy holds most probable, as deployed allocators have it.
    pub fn greedy_first(self) -> Self {
        Self { greedy_first: true, ..self }
    }

    /// Decides in a state where `last` `[A]` was in force before. `None` shuffles the task columns.
    fn propose(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        last: &[u8],
        columns: Option<TaskColumns>,
        generator: &mut Generator,
    ) -> Result<Decided, LearnError> {
        let Self { seen, features, .. } = self;
        environment.observe(state, 0, EntitySet::MAX, seen);
        let (agents, tasks) = (last.len(), seen.tasks());
        let known = self.networks.policy.shape().columns;
        if tasks > known {
            let reason = format!("the allocator knows {known} subtasks, this state has {tasks}");
            return Err(LearnError::Config(reason));
        }
        // Agents that do not exist have a row as well, things do not.
        let slots: EntitySet = (1 << agents) - 1;
        let entities = || members(slots | seen.things());
        features.clear();
        for entity in entities() {
            if seen.present >> entity & 1 == 1 {
                features.push_row(&seen.rows, seen.row_of(entity));
            }
            features.end_row();
        }
        let present: Vec<bool> = entities().map(|entity| seen.present >> entity & 1 == 1).collect();
        let entity_task: Vec<u8> = entities().map(|entity| seen.task_of(entity)).collect();
        let open: Vec<bool> = (0..tasks).map(|task| seen.open_tasks >> task & 1 == 1).collect();
        let mut states = States::new(agents, present.len(), tasks);
        states.push(StateView {
            features,
            first_row: 0,
            present: &present,
            entity_task: &entity_task,
            open: &open,
            last_allocation: last,
        });
        let columns = columns.unwrap_or_else(|| TaskColumns::shuffled(tasks, known, generator));
        let noise = Noise::Seeded { seed: generator.next_u64(), greedy_first: self.greedy_first };
        Ok(self.decider.decide(self.networks, &states, &columns, (self.proposals, noise)))
    }
}

impl Allocate for ProposalAllocator<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        environment.observe(state, 0, 0, &mut self.seen);
        let columns = TaskColumns::in_order(self.seen.tasks());
        let decided = self.propose(environment, state, allocation, Some(columns), generator)?;
        allocation.copy_from_slice(&decided.best);
        Ok(())
    }
}

impl Decide for ProposalAllocator<'_> {
    fn decide(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        exploration: Exploration,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let decided = self.propose(environment, state, allocation, None, generator)?;
        let first = chance(generator, exploration.proposal.into());
        allocation.copy_from_slice(if first { &decided.first } else { &decided.best });
        let open: Vec<u8> = members(self.seen.open_tasks.into()).map(|task| task as u8).collect();
        for task in &mut allocation[..self.seen.agents()] {
            if !open.is_empty() && chance(generator, exploration.allocation.into()) {
                *task = open[below(generator, open.len())];
            }
        }
        Ok(())
    }
}

/// The environment's word for no subtask and the learner's are the same, so that allocations need no
/// translation.
const _: () = assert!(NO_TASK == UNASSIGNED);
