//! Deciding in the environment by proposal policy and critic.

use rand_core::Rng;
use sortie_envs::random::{below, chance};
use sortie_envs::save_the_city::{City, UNASSIGNED, agent_features, building_features};
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
        }
    }

    /// The same whose first proposal is what the policy holds most probable, as deployed allocators have it.
    pub fn greedy_first(self) -> Self {
        Self { greedy_first: true, ..self }
    }

    /// Decides in a city where `last` `[A]` was in force before. `None` shuffles the task columns.
    fn propose(
        &mut self,
        city: City<'_>,
        last: &[u8],
        columns: Option<TaskColumns>,
        generator: &mut Generator,
    ) -> Result<Decided, LearnError> {
        let (agents, tasks) = (last.len(), city.buildings.len());
        let known = self.networks.policy.shape().columns;
        if tasks > known {
            let reason = format!("the allocator knows {known} subtasks, this city has {tasks}");
            return Err(LearnError::Config(reason));
        }
        self.features.clear();
        for agent in 0..agents {
            if let Some(agent) = city.agents.get(agent) {
                agent_features(agent, |column, value| self.features.push(column, value));
            }
            self.features.end_row();
        }
        for building in city.buildings {
            building_features(building, |column, value| self.features.push(column, value));
            self.features.end_row();
        }
        let present: Vec<bool> =
            (0..agents + tasks).map(|row| row < city.agents.len() || row >= agents).collect();
        let entity_task: Vec<u8> =
            vec![NO_TASK; agents].into_iter().chain((0..).take(tasks)).collect();
        let open: Vec<bool> = city.buildings.iter().map(|building| building.is_open()).collect();
        let mut states = States::new(agents, agents + tasks, tasks);
        states.push(StateView {
            features: &self.features,
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
        city: City<'_>,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let columns = TaskColumns::in_order(city.buildings.len());
        let decided = self.propose(city, allocation, Some(columns), generator)?;
        allocation.copy_from_slice(&decided.best);
        Ok(())
    }
}

impl Decide for ProposalAllocator<'_> {
    fn decide(
        &mut self,
        city: City<'_>,
        exploration: Exploration,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let decided = self.propose(city, allocation, None, generator)?;
        let first = chance(generator, exploration.proposal.into());
        allocation.copy_from_slice(if first { &decided.first } else { &decided.best });
        let open: Vec<u8> = (0..)
            .zip(city.buildings)
            .filter(|(_, building)| building.is_open())
            .map(|(task, _)| task)
            .collect();
        for task in &mut allocation[..city.agents.len()] {
            if !open.is_empty() && chance(generator, exploration.allocation.into()) {
                *task = open[below(generator, open.len())];
            }
        }
        Ok(())
    }
}

/// The environment's word for no building and the learner's are the same, so that allocations need no
/// translation.
const _: () = assert!(NO_TASK == UNASSIGNED);
