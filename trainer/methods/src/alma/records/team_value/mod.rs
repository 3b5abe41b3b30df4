//! The team-value allocator: learns what a team at a subtask is worth, and searches the best teams.
//!
//! An allocation b is worth `Q(s, b) = sum over open subtasks t of f(s, t, team of t in b)`. f is one
//! attention network of the agents' kind with a single output: the row of the subtask's thing is the query, and
//! the keys are that thing itself, every agent (in the team or not, and how far away) and the things of the other
//! open subtasks. A team without agents is a legal input. `sortie_core::allocate` finds the best
//! allocation by the values of all teams.
//!
//! f is learned by SARSA, one target per subtask, from the subtask's own rewards. Compared
//! with the dissertation (section 7.4): a sum of one value per subtask instead of a critic of the whole
//! allocation, search instead of a proposal network, task rewards instead of the team's.

mod input;
mod loss;

use sortie_core::allocate::{EXACT_AGENTS, TeamValue, Teams, ascent, exact};
use sortie_envs::{Environment, Observation, UNASSIGNED, members};
use sortie_learn::LearnError;
use sortie_learn::subtasks::Allocate;
use sortie_nn::random::Generator;

use crate::alma::agents::{UtilityNetwork, UtilityPass, UtilityShape};

pub use input::{TeamColumns, TeamQuery, TeamValueInput};
pub use loss::{Decision, Segment, Segments, TeamValueLoss};

/// Sweeps of the coordinate ascent; few are needed until no agent moves.
const SWEEPS: usize = 8;

/// Space to search allocations with networks of one shape.
#[derive(Clone, Debug)]
pub struct TeamSearch {
    team_max: usize,
    pass: UtilityPass,
    input: TeamValueInput,
    seen: Observation,
    arena: Vec<exact::Cell>,
}

impl TeamSearch {
    /// Empty space; no subtask gets more than `team_max` agents.
    pub fn new(shape: UtilityShape, team_max: usize) -> Self {
        Self {
            team_max,
            pass: UtilityPass::new(shape),
            input: TeamValueInput::default(),
            seen: Observation::default(),
            arena: Vec::new(),
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Writes the best subtask of every agent; further entries are [`UNASSIGNED`].
    ///
    /// Exact for up to [`EXACT_AGENTS`] agents; for more, coordinate ascent from what the environment's usual rule allocates.
    pub fn allocate(
        &mut self,
        network: &UtilityNetwork,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        environment.observe(state, 0, 0, &mut self.seen);
        let acting: Vec<usize> = members(self.seen.acting().into()).collect();
        let (agents, open_tasks) = (acting.len(), self.seen.open_tasks);
        let teams = Teams { agents, open_tasks, team_max: self.team_max };
        let mut own = vec![UNASSIGNED; agents];
        let found = if agents <= EXACT_AGENTS {
            let values = self.pass.forward(network, self.input.all_teams(environment, state));
            self.arena.resize(values.len(), exact::Cell::default());
            exact::search(teams, values, &mut self.arena, &mut own).map(drop)
        } else {
            environment.allocate(0, state, generator, allocation);
            own.iter_mut().zip(&acting).for_each(|(own, agent)| *own = allocation[*agent]);
            let Self { pass, input, .. } = self;
            let acting = &acting;
            let mut values = NetworkValue { network, environment, state, acting, pass, input };
            ascent::search(teams, &mut values, SWEEPS, &mut own).map(drop)
        };
        allocation.fill(UNASSIGNED);
        acting.iter().zip(own).for_each(|(agent, own)| allocation[*agent] = own);
        found.map_err(|error| LearnError::Team(error.to_string()))
    }
}

/// The values of single teams, as the coordinate ascent asks for them.
struct NetworkValue<'a> {
    network: &'a UtilityNetwork,
    environment: &'a dyn Environment,
    state: &'a [u8],
    /// The agents that the bits of a team stand for.
    acting: &'a [usize],
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
        let Self { network, environment, state, acting, pass, input } = self;
        let query = |(task, team): &(usize, u64)| {
            let team = members((*team).into()).fold(0, |team, place| team | 1 << acting[place]);
            TeamQuery { state, task: *task, team, turn: 0 }
        };
        let input = input.queries(*environment, questions.iter().map(query));
        values.copy_from_slice(pass.forward(network, input));
    }
}

/// A team-value network as allocator.
#[derive(Clone, Debug)]
pub struct TeamValueAllocator<'a> {
    network: &'a UtilityNetwork,
    search: TeamSearch,
}

impl<'a> TeamValueAllocator<'a> {
    /// Allocates by a network; no subtask gets more than `team_max` agents.
    pub fn new(network: &'a UtilityNetwork, team_max: usize) -> Self {
        Self { network, search: TeamSearch::new(network.shape(), team_max) }
    }
}

impl Allocate for TeamValueAllocator<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.search.allocate(self.network, environment, state, generator, allocation)
    }

    fn values(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        task: usize,
        teams: &[u64],
    ) -> Vec<f32> {
        let TeamSearch { pass, input, .. } = &mut self.search;
        let query = |&team| TeamQuery { state, task, team, turn: 0 };
        pass.forward(self.network, input.queries(environment, teams.iter().map(query))).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use sortie_envs::{EntitySet, Failing, Split};
    use sortie_learn::random::{Purpose, generator};

    use super::*;
    use crate::alma::records::config::AllocatorConfig;
    use sortie_learn::play::evaluate;
    use sortie_learn::subtasks::{AllocatedTeam, ScriptedAgents};

    fn environment(set: &str, instances: usize) -> Box<dyn Environment> {
        let name = format!("save-the-city/{set}");
        sortie_envs::open(&name, Split::Train, instances, &Default::default()).unwrap()
    }

    fn network(environment: &dyn Environment) -> UtilityNetwork {
        let mut config = AllocatorConfig::default();
        (config.network.width, config.network.base) = (8, 8);
        let shape = config.shape(environment.spec());
        UtilityNetwork::initialise(shape, 8.0, &mut generator(2, Purpose::Weights, 0))
    }

    #[test]
    fn every_agent_gets_an_open_subtask_and_no_team_is_too_large() {
        for set in ["2-5a_2-5b", "12a_12b"] {
            let mut worlds = environment(set, 6);
            let network = network(&*worlds);
            let (mut random, mut seen) =
                (generator(5, Purpose::Rollout, 0), Observation::default());
            for instance in 0..6 {
                worlds.reset(instance, &mut random);
                let mut state = Vec::new();
                worlds.save(instance, &mut state);
                worlds.observe(&state, 0, 0, &mut seen);
                let mut allocation = [7; 64];
                let mut search = TeamSearch::new(network.shape(), 2);
                let found =
                    search.allocate(&network, &*worlds, &state, &mut random, &mut allocation);
                found.unwrap();
                let (assigned, rest) = allocation.split_at(seen.agents());
                assert!(rest.iter().all(|task| *task == UNASSIGNED));
                for task in assigned {
                    assert!(seen.open_tasks >> task & 1 == 1);
                    assert!(assigned.iter().filter(|other| *other == task).count() <= 2);
                }
            }
        }
    }

    #[test]
    fn agents_that_have_failed_get_nothing_and_are_in_no_question() {
        for (set, exact) in [("2-5a_2-5b", true), ("12a_12b", false)] {
            let mut worlds = Failing::new(environment(set, 1), 0.3).open(1, Split::Train);
            let network = network(&*worlds);
            let (mut random, mut seen) =
                (generator(5, Purpose::Rollout, 0), Observation::default());
            let (mut state, mut failed) = (Vec::new(), 0);
            let mut search = TeamSearch::new(network.shape(), 2);
            let mut input = TeamValueInput::default();
            for _ in 0..20 {
                worlds.reset(0, &mut random);
                let safe = vec![worlds.spec().safe_action.unwrap(); 64];
                worlds.step(0, &safe, &mut random).unwrap();
                state.clear();
                worlds.save(0, &mut state);
                worlds.observe(&state, 0, EntitySet::MAX, &mut seen);
                let mut allocation = [7; 64];
                let found =
                    search.allocate(&network, &*worlds, &state, &mut random, &mut allocation);
                found.unwrap();
                for (agent, task) in allocation.into_iter().enumerate() {
                    let is_open = task < 32 && seen.open_tasks >> task & 1 == 1;
                    let acts = seen.acting() >> agent & 1 == 1;
                    let is_right = if acts { is_open } else { task == UNASSIGNED };
                    assert!(is_right, "agent {agent} of {:b}: {task}", seen.acting());
                }
                failed += seen.absent.count_ones();
                // Each acting agent has a row in the team and one beside it, and nobody else has any.
                if exact {
                    let (agents, open) = (seen.acting().count_ones(), seen.open_tasks.count_ones());
                    let things = open as usize - 1;
                    let rows = open as usize * ((1 << agents) + 2 * agents as usize + things);
                    assert_eq!(input.all_teams(&*worlds, &state).rows.len(), rows);
                }
            }
            assert!(failed > 10, "{failed}");
        }
    }

    #[test]
    fn an_untrained_allocator_plays_to_the_end() {
        let environment = environment("2-5a_2-5b", 1);
        let network = network(&*environment);
        let play = || {
            let allocator = Box::new(TeamValueAllocator::new(&network, 5));
            let mut team = AllocatedTeam::new(Box::new(ScriptedAgents::new(1)), allocator, 5);
            evaluate(&*environment, &mut team, 20, 3).unwrap()
        };
        let first = play();
        assert_eq!(first.episodes, 20);
        assert_eq!(first, play());
    }
}
