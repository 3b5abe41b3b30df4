//! What networks of this trainer are asked, and what their plans answer.

use sortie_bundle::{OwnedAllocationState, OwnedObservation};
use sortie_core::allocate::proposals::{Draw, GumbelDraw};
use sortie_core::allocate::{PlanTeamValue, ProposalAllocator, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::internal::ops::OutputRows;
use sortie_core::plan::{AlignedBytes, Network, Plan};
use sortie_core::{Observation, PlanPolicy, Policy, limits};

use crate::comparison::{TrueNumber, cannot_run};
use crate::error::CompileError;
use crate::families::Rows;
use crate::observations::{
    OwnedEntities, OwnedTeamQuery, random_allocation_states, random_entities, random_observations,
    random_states, random_team_queries,
};
use crate::report::ProposalFiles;

/// Proposals by which an allocator's plan is judged.
const PROPOSALS: usize = 4;

/// An input of a network.
#[derive(Clone, Debug, PartialEq)]
pub enum NetworkInput {
    /// What an agent sees, and what it remembers: nothing where that is shorter than its memory.
    Agent {
        /// What it sees.
        seen: OwnedObservation,
        /// Its recurrent state.
        memory: Vec<f32>,
    },
    /// A team at a subtask.
    TeamValue(OwnedTeamQuery),
    /// All entities of a step.
    Entities(OwnedEntities),
    /// A state of an allocator that proposes, and what its plan proposed, from which graphs go on.
    Proposals {
        /// Entities, subtasks and agents.
        state: OwnedAllocationState,
        /// The subtask of every agent in each proposal.
        allocations: Vec<Vec<u8>>,
    },
}

/// What comes of an input.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    /// The numbers of every output: of an agent its utilities and its next state, of proposals the logarithms of open
    /// subtasks' probabilities and the values.
    pub outputs: Vec<Vec<f32>>,
    /// The action of an agent; none where none is available.
    pub action: Option<u16>,
}

/// The files of a network.
#[derive(Clone, Copy, Debug)]
pub enum NetworkFiles<'a> {
    /// An agent, a team-value network, or one over all entities.
    One(&'a [u8]),
    /// An allocator that proposes.
    Proposals(ProposalFiles<'a>),
}

/// A network's graph in an engine.
pub trait GraphAnswers {
    /// The outputs for an input, of which the graph gets some rows, whatever numbers these are.
    ///
    /// # Errors
    /// The input is another network's, or the engine refuses its sizes.
    fn answer(&mut self, input: &NetworkInput, rows: Rows) -> Result<Answer, CompileError>;
}

/// The same in double precision, and how far right engines of 32 bits scatter.
pub trait TrueAnswers {
    /// The true outputs for an input.
    ///
    /// # Errors
    /// As [`GraphAnswers::answer`].
    fn answer(
        &mut self,
        input: &NetworkInput,
        rows: Rows,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError>;
}

/// Sizes of a network and of its world.
#[derive(Clone, Copy, Debug)]
pub struct NetworkSizes {
    /// What it computes.
    pub network: Network,
    /// Most entities.
    pub n_max: usize,
    /// Features d.
    pub features: usize,
    /// Actions U of an agent.
    pub actions: usize,
    /// Floats of its recurrent state.
    pub memory: usize,
    /// Columns F of a team-value network's relation.
    pub relations: usize,
    /// Groups of entities, or subtasks.
    pub groups: usize,
}

impl NetworkSizes {
    /// Random inputs of all mask patterns, by seed; none for policies over inputs of fixed sizes.
    pub fn random_inputs(self, count: usize, seed: u64) -> Vec<NetworkInput> {
        let Self { n_max, features, actions, relations, groups, .. } = self;
        match self.network {
            Network::Agent => {
                let mut states = random_states(self.memory, seed);
                let seen = random_observations(count, n_max, features, actions, seed);
                let input = |seen| NetworkInput::Agent { seen, memory: states() };
                seen.into_iter().map(input).collect()
            }
            Network::TeamValue => {
                let queries = random_team_queries(count, n_max, features, relations, seed);
                queries.into_iter().map(NetworkInput::from).collect()
            }
            Network::Entities => {
                let steps = random_entities(count, n_max, features, groups, seed);
                steps.into_iter().map(NetworkInput::Entities).collect()
            }
            Network::Proposals => {
                let states = random_allocation_states(count, n_max, features, groups, seed);
                states.into_iter().map(NetworkInput::from).collect()
            }
            _ => Vec::new(),
        }
    }
}

impl From<OwnedObservation> for NetworkInput {
    fn from(seen: OwnedObservation) -> Self {
        Self::Agent { seen, memory: Vec::new() }
    }
}

impl From<OwnedTeamQuery> for NetworkInput {
    fn from(query: OwnedTeamQuery) -> Self {
        Self::TeamValue(query)
    }
}

impl From<OwnedAllocationState> for NetworkInput {
    fn from(state: OwnedAllocationState) -> Self {
        Self::Proposals { state, allocations: Vec::new() }
    }
}

impl Answer {
    /// The outputs of a graph, and the action that follows from them.
    pub fn of_graph(input: &NetworkInput, outputs: Vec<Vec<f32>>) -> Self {
        let action = match (input, outputs.first()) {
            (NetworkInput::Agent { seen, .. }, Some(utilities)) => {
                masked_argmax(utilities, &seen.available).ok().map(|decision| decision.action)
            }
            _ => None,
        };
        Self { outputs, action }
    }

    /// What a policy answers, if it does.
    pub fn of_policy(
        policy: &mut dyn Policy,
        seen: &Observation<'_>,
        memory: &[f32],
    ) -> Option<Self> {
        let mut memory = memory.to_vec();
        memory.resize(policy.hidden(), 0.0);
        let (mut next, mut utilities) = (memory.clone(), vec![0.0; policy.actions()]);
        policy.utilities_with(seen, &mut next, &mut utilities).ok()?;
        // The choice is a path of its own in a plan.
        let action = policy.decide_with(seen, &mut memory).ok().map(|decision| decision.action);
        Some(Self { outputs: vec![utilities, next], action })
    }

    /// Whether all of its numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.outputs.iter().flatten().all(|number| number.is_finite())
    }
}

/// Asks a plan; none where it gives no answer. What a proposing allocator draws, by seed, is written into its inputs.
///
/// # Errors
/// The plan cannot be loaded, or the inputs are another network's.
pub fn plan_answers(
    plan: &[u8],
    inputs: &mut [NetworkInput],
    seed: u64,
) -> Result<Vec<Option<Answer>>, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    match plan.header().network {
        Network::Agent => agent_answers(plan, inputs),
        Network::TeamValue => team_values(plan, inputs),
        Network::Entities => inputs.iter().map(|input| entity_outputs(&plan, input)).collect(),
        Network::Proposals => proposals(plan, inputs, seed),
        _ => Err(other_network()),
    }
}

/// The numbers of a row of each of a plan's outputs, as [`plan_answers`] gives them.
///
/// # Errors
/// The plan cannot be loaded.
pub fn output_widths(plan: &[u8]) -> Result<Vec<usize>, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    Ok(match plan.header().network {
        Network::Agent => vec![plan.actions(), plan.hidden()],
        Network::Entities => plan.program().outputs().map(|output| output.width as usize).collect(),
        _ => vec![1, 1],
    })
}

fn other_network() -> CompileError {
    CompileError::OtherNetwork { want: "this input's".into() }
}

fn agent_answers(
    plan: Plan<'_>,
    inputs: &[NetworkInput],
) -> Result<Vec<Option<Answer>>, CompileError> {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice())?;
    let mut answer = |input: &NetworkInput| {
        let NetworkInput::Agent { seen, memory } = input else { return Err(other_network()) };
        Ok(Answer::of_policy(&mut policy, &seen.view(), memory))
    };
    inputs.iter().map(&mut answer).collect()
}

fn team_values(
    plan: Plan<'_>,
    inputs: &[NetworkInput],
) -> Result<Vec<Option<Answer>>, CompileError> {
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let entities = inputs.iter().filter_map(|input| match input {
        NetworkInput::TeamValue(query) => Some(query.state.entities()),
        _ => None,
    });
    let mut rows = vec![0.0; PlanTeamValue::memory_floats(&plan, entities.max().unwrap_or(0))];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows)?;
    let mut answer = |input: &NetworkInput| {
        let NetworkInput::TeamValue(query) = input else { return Err(other_network()) };
        let state = query.state.view();
        let value = network.value(&query.view(&state)).ok();
        Ok(value.map(|value| Answer { outputs: vec![vec![value]], action: None }))
    };
    inputs.iter().map(&mut answer).collect()
}

fn entity_outputs(plan: &Plan<'_>, input: &NetworkInput) -> Result<Option<Answer>, CompileError> {
    let NetworkInput::Entities(entities) = input else { return Err(other_network()) };
    let view = entities.view();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut outputs: Vec<Vec<f32>> = Vec::new();
    for output in plan.program().outputs() {
        let rows = match output.rows {
            OutputRows::Entities => view.groups.len(),
            OutputRows::Groups => output.groups.into(),
            _ => 1,
        };
        outputs.push(vec![0.0; rows * output.width as usize]);
    }
    let mut places: Vec<&mut [f32]> = outputs.iter_mut().map(Vec::as_mut_slice).collect();
    let found = plan.evaluate(arena.as_mut_slice(), &view, &mut places);
    Ok(found.is_ok().then_some(Answer { outputs, action: None }))
}

fn proposals(
    plan: Plan<'_>,
    inputs: &mut [NetworkInput],
    seed: u64,
) -> Result<Vec<Option<Answer>>, CompileError> {
    let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&plan, PROPOSALS));
    let mut allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), PROPOSALS, 0)?;
    let mut answer = |input: &mut NetworkInput| {
        let NetworkInput::Proposals { state, allocations } = input else {
            return Err(other_network());
        };
        let mut draw = Witness { draw: GumbelDraw { seed }, log_pi: Default::default() };
        let found = allocator.propose(&state.view(), &mut draw).map_err(cannot_run)?;
        if found.best().is_none() {
            return Ok(None);
        }
        *allocations = (0..PROPOSALS).map(|number| found.allocation(number).collect()).collect();
        let outputs = vec![draw.log_pi.concat(), found.values().to_vec()];
        Ok(Some(Answer { outputs, action: None }))
    };
    inputs.iter_mut().map(&mut answer).collect()
}

/// Draws, and keeps what was drawn from.
struct Witness {
    draw: GumbelDraw,
    /// The logarithms of open subtasks' probabilities, of every agent in each proposal.
    log_pi: [Vec<f32>; PROPOSALS],
}

impl Draw for Witness {
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize {
        let is_open = |task: usize| task < limits::TASKS && open_tasks >> task & 1 == 1;
        let open = logits.iter().enumerate().filter(|(task, _)| is_open(*task));
        let open: Vec<f64> = open.map(|(_, logit)| f64::from(*logit)).collect();
        let largest = open.iter().copied().fold(f64::MIN, f64::max);
        let total: f64 = open.iter().map(|logit| (logit - largest).exp()).sum();
        if let Some(of_proposal) = self.log_pi.get_mut(proposal) {
            of_proposal.extend(open.iter().map(|logit| (logit - largest - total.ln()) as f32));
        }
        self.draw.draw(proposal, agent, logits, open_tasks)
    }
}
