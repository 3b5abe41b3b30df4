//! Allocation states of greedy episodes, with the answers of the trainer's own search and network.

use sortie_bundle::{GoldenAllocation, GoldenValue};
use sortie_envs::save_the_city::{City, RELATIONS, Symmetry, write_relation};
use sortie_nn::random::Generator;

use super::bundle::LearnedAllocator;
use crate::alma::evaluate::{Allocate, EvaluationPlan, NetworkTeam, allocation_state, evaluate};
use crate::alma::records::team_value::{TeamQuery, TeamValueAllocator, TeamValueInput};
use crate::alma::records::{UtilityNetwork, UtilityPass};
use sortie_learn::LearnError;

/// Allocation states of a bundle.
const CASES: usize = 48;
/// One of so many allocations becomes golden, so that they come from many episodes.
const STRIDE: usize = 23;

/// Plays the episodes of a plan and keeps some of the allocations.
pub(super) fn golden_allocations(
    plan: &EvaluationPlan,
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
        city: City<'_>,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.allocator.allocate(city, generator, allocation)?;
        self.allocations += 1;
        if self.allocations % STRIDE == 1 && self.cases.len() < CASES {
            let case = self.case(city, &allocation[..city.agents.len()]);
            self.cases.push(case);
        }
        Ok(())
    }
}

impl Recorder<'_> {
    fn case(&mut self, city: City<'_>, allocation: &[u8]) -> GoldenAllocation {
        let state = allocation_state(city);
        let rows: Vec<usize> = (0..city.agents.len()).collect();
        let mut relation = Vec::new();
        let mut values = Vec::new();
        for task in state.open() {
            let mut to_task = vec![0.0; state.entities() * RELATIONS];
            write_relation(city, task, &rows, rows.len(), &mut to_task);
            relation.extend(to_task);
            let assigned = allocation.iter().enumerate();
            let team = assigned.filter(|(_, place)| usize::from(**place) == task);
            let team = team.map(|(agent, _)| 1_u64 << agent).sum();
            let everybody = rows.iter().map(|agent| 1_u64 << agent).sum();
            values.extend(self.values(city, task, [0, team, everybody]));
        }
        let allocation = allocation.to_vec();
        GoldenAllocation { state, relations: RELATIONS, relation, values, allocation }
    }

    fn values(&mut self, city: City<'_>, task: usize, teams: [u64; 3]) -> [GoldenValue; 3] {
        let turn = Symmetry::ALL[0];
        let mut input = TeamValueInput::default();
        let queries = teams.iter().map(|team| TeamQuery { city, task, team: *team, turn });
        let values = self.pass.forward(self.network, input.queries(queries));
        std::array::from_fn(|index| GoldenValue { task, team: teams[index], value: values[index] })
    }
}
