//! Allocation states of greedy episodes, with the answers of the trainer's own search and network.

use sortie_bundle::{GoldenAllocation, GoldenValue};
use sortie_envs::{EntitySet, Environment, SparseRows};
use sortie_nn::random::Generator;

use super::learned::LearnedAllocator;
use crate::alma::agents::{UtilityNetwork, UtilityPass};
use crate::alma::evaluate::{EvaluationPlan, evaluate};
use crate::alma::records::team_value::{TeamQuery, TeamValueAllocator, TeamValueInput};
use crate::alma::teams::{Allocate, NetworkTeam, allocation_state};
use sortie_learn::LearnError;

/// Allocation states of a bundle.
const CASES: usize = 48;
/// One of so many allocations becomes golden, so that they come from many episodes.
const STRIDE: usize = 23;

/// Plays the episodes of a plan and keeps some of the allocations.
pub(super) fn golden_allocations(
    plan: &EvaluationPlan<'_>,
    agents: &UtilityNetwork,
    learned: LearnedAllocator<'_>,
) -> Result<Vec<GoldenAllocation>, LearnError> {
    let mut recorder = Recorder {
        allocator: TeamValueAllocator::new(learned.network, learned.team_max),
        network: learned.network,
        pass: UtilityPass::new(learned.network.shape()),
        allocations: 0,
        cases: Vec::new(),
    };
    evaluate(plan, &mut NetworkTeam::new(agents), &mut recorder)?;
    Ok(recorder.cases)
}

/// Allocates, and keeps every so many-th allocation.
struct Recorder<'a> {
    allocator: TeamValueAllocator<'a>,
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    allocations: usize,
    cases: Vec<GoldenAllocation>,
}

impl Allocate for Recorder<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.allocator.allocate(environment, state, generator, allocation)?;
        self.allocations += 1;
        if self.allocations % STRIDE == 1 && self.cases.len() < CASES {
            let case = self.case(environment, state, allocation);
            self.cases.push(case);
        }
        Ok(())
    }
}

impl Recorder<'_> {
    fn case(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        allocation: &[u8],
    ) -> GoldenAllocation {
        let seen = allocation_state(environment, state);
        let allocation = allocation[..seen.agents].to_vec();
        let relations = environment.spec().relations;
        let mut relation = Vec::new();
        let mut values = Vec::new();
        for task in seen.open() {
            relation.extend(to_task(environment, state, task));
            let assigned = allocation.iter().enumerate();
            let team = assigned.filter(|(_, place)| usize::from(**place) == task);
            let team = team.map(|(agent, _)| 1_u64 << agent).sum();
            let everybody = (0..seen.agents).map(|agent| 1_u64 << agent).sum();
            values.extend(self.values((environment, state), task, [0, team, everybody]));
        }
        GoldenAllocation { state: seen, relations, relation, values, allocation }
    }

    fn values(
        &mut self,
        (environment, state): (&dyn Environment, &[u8]),
        task: usize,
        teams: [u64; 3],
    ) -> [GoldenValue; 3] {
        let mut input = TeamValueInput::default();
        let queries = teams.iter().map(|team| TeamQuery { state, task, team: *team, turn: 0 });
        let values = self.pass.forward(self.network, input.queries(environment, queries));
        std::array::from_fn(|index| GoldenValue { task, team: teams[index], value: values[index] })
    }
}

/// How every entity stands to a subtask, in full.
fn to_task(environment: &dyn Environment, state: &[u8], task: usize) -> Vec<f32> {
    let mut rows = SparseRows::default();
    environment.relate(state, 0, task, EntitySet::MAX, &mut rows);
    let mut dense = Vec::new();
    rows.write_all(environment.spec().relations, &mut dense);
    dense
}
