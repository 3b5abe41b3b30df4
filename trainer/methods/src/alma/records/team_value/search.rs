//! The best allocation by the team-value network.

use sortie_core::allocate::{EXACT_AGENTS, TeamValue, Teams, ascent, exact};
use sortie_envs::save_the_city::{City, Symmetry, UNASSIGNED, coordinated_allocation};
use sortie_nn::random::Generator;

use super::input::{TeamQuery, TeamValueInput};
use crate::alma::evaluate::Allocate;
use crate::alma::records::{UtilityNetwork, UtilityPass, UtilityShape};
use sortie_learn::LearnError;

/// Sweeps of the coordinate ascent; few are needed until no agent moves.
const SWEEPS: usize = 8;

/// Space to search allocations with networks of one shape.
#[derive(Clone, Debug)]
pub struct TeamSearch {
    team_max: usize,
    pass: UtilityPass,
    input: TeamValueInput,
    arena: Vec<exact::Cell>,
}

impl TeamSearch {
    /// Empty space; no building gets more than `team_max` agents.
    pub fn new(shape: UtilityShape, team_max: usize) -> Self {
        Self {
            team_max,
            pass: UtilityPass::new(shape),
            input: TeamValueInput::default(),
            arena: Vec::new(),
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Writes the best building of every agent; further entries are [`UNASSIGNED`].
    ///
    /// Exact for up to [`EXACT_AGENTS`] agents; for more, coordinate ascent from the coordinated allocation.
    pub fn allocate(
        &mut self,
        network: &UtilityNetwork,
        city: City<'_>,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let agents = city.agents.len();
        let open_tasks = city.open_tasks();
        let teams = Teams { agents, open_tasks, team_max: self.team_max };
        allocation.fill(UNASSIGNED);
        let found = if agents <= EXACT_AGENTS {
            let values = self.pass.forward(network, self.input.all_teams(city));
            self.arena.resize(values.len(), exact::Cell::default());
            exact::search(teams, values, &mut self.arena, &mut allocation[..agents]).map(drop)
        } else {
            coordinated_allocation(city, allocation);
            let Self { pass, input, .. } = self;
            let mut values = NetworkValue { network, city, pass, input };
            ascent::search(teams, &mut values, SWEEPS, &mut allocation[..agents]).map(drop)
        };
        found.map_err(|error| LearnError::Team(error.to_string()))
    }
}

/// The values of single teams, as the coordinate ascent asks for them.
struct NetworkValue<'a> {
    network: &'a UtilityNetwork,
    city: City<'a>,
    pass: &'a mut UtilityPass,
    input: &'a mut TeamValueInput,
}

impl TeamValue for NetworkValue<'_> {
    fn value(&mut self, task: usize, team: u64) -> f32 {
        let mut value = [0.0];
        self.values(&[(task, team)], &mut value);
        value[0]
    }

    fn values(&mut self, questions: &[(usize, u64)], values: &mut [f32]) {
        let (city, turn) = (self.city, Symmetry::ALL[0]);
        let query =
            |(task, team): &(usize, u64)| TeamQuery { city, task: *task, team: *team, turn };
        let queries = questions.iter().map(query);
        values.copy_from_slice(self.pass.forward(self.network, self.input.queries(queries)));
    }
}

/// A team-value network as allocator.
#[derive(Clone, Debug)]
pub struct TeamValueAllocator<'a> {
    network: &'a UtilityNetwork,
    search: TeamSearch,
}

impl<'a> TeamValueAllocator<'a> {
    /// Allocates by a network; no building gets more than `team_max` agents.
    pub fn new(network: &'a UtilityNetwork, team_max: usize) -> Self {
        Self { network, search: TeamSearch::new(network.shape(), team_max) }
    }
}

impl Allocate for TeamValueAllocator<'_> {
    fn allocate(
        &mut self,
        city: City<'_>,
        _: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.search.allocate(self.network, city, allocation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::evaluate::{EvaluationPlan, ScriptedActors, evaluate};
    use crate::alma::records::config::AllocatorConfig;
    use sortie_envs::save_the_city::{Constants, SaveTheCity, ScenarioSet};
    use sortie_learn::random::{Purpose, generator};

    fn network() -> UtilityNetwork {
        let mut config = AllocatorConfig::default();
        (config.network.width, config.network.base) = (8, 8);
        UtilityNetwork::initialise(config.shape(), 8.0, &mut generator(2, Purpose::Weights, 0))
    }

    #[test]
    fn every_agent_gets_an_open_building_and_no_team_is_too_large() {
        for set in ["2-5a_2-5b", "12a_12b"] {
            let set = ScenarioSet::named(set).unwrap();
            let world = SaveTheCity::new(set, Constants::default(), 6, 5).unwrap();
            let network = network();
            for instance in 0..6 {
                let city = world.city(instance);
                let mut allocation = [7; 64];
                let mut search = TeamSearch::new(network.shape(), 2);
                search.allocate(&network, city, &mut allocation).unwrap();
                let (assigned, rest) = allocation.split_at(city.agents.len());
                assert!(rest.iter().all(|task| *task == UNASSIGNED));
                for task in assigned {
                    assert!(city.buildings[usize::from(*task)].is_open());
                    assert!(assigned.iter().filter(|other| *other == task).count() <= 2);
                }
            }
        }
    }

    #[test]
    fn an_untrained_allocator_plays_to_the_end() {
        let plan = EvaluationPlan::new("2-5a_2-5b", 20, 3).unwrap();
        let network = network();
        let play = || {
            let mut allocator = TeamValueAllocator::new(&network, 5);
            evaluate(&plan, &mut ScriptedActors::new(1), &mut allocator).unwrap()
        };
        let first = play();
        assert_eq!(first.episodes, 20);
        assert_eq!(first, play());
    }
}
