//! Whether two engines give the same answers.

use serde::Serialize;
use sortie_bundle::{Golden, GoldenAllocation, GoldenCase, GoldenValue};
use sortie_core::allocate::{
    EXACT_AGENTS, LastAllocation, SearchMemory, TaskRelation, TeamValueAllocator, TeamValueNetwork,
    exact,
};
use sortie_core::{AllocateError, AllocationState, Allocator, Policy};

use crate::error::CompileError;

/// Largest error of an f32 plan, see [`Comparison::max_rel_error`].
pub const TOLERANCE: f32 = 1.0e-5;

/// So many times its scatter a right engine's number may be from the truth: the worst of the right ones measured was six, a
/// weight matrix in 16 bits moves some number by twenty and more.
pub const MOST_DISTANCE: f64 = 16.0;

/// So large the root mean square of an output number's distances may be; right engines stay below one.
pub const MOST_MEAN_DISTANCE: f64 = 3.0;

/// A number of an answer in double precision, and how far from it right engines of 32 bits are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueNumber {
    /// The number.
    pub value: f64,
    /// The root mean square of right engines' distances from it.
    pub scatter: f64,
}

impl TrueNumber {
    /// How far an engine's number is from it, in scatters.
    pub fn distance(self, number: f32) -> f64 {
        let number = f64::from(number);
        if number == self.value { 0.0 } else { (number - self.value).abs() / self.scatter }
    }

    /// Whether 32 bits hold the number, and no right engine may find it to be none.
    pub fn is_finite(self) -> bool {
        fits(self.value) && self.scatter.is_finite()
    }

    /// Whether right engines agree that there is a number, or that there is none.
    pub fn is_sure(self) -> bool {
        self.scatter.is_finite()
    }
}

/// Whether it is a number, and 32 bits hold it.
pub fn fits(number: f64) -> bool {
    number.abs() <= f64::from(f32::MAX)
}

/// How far an engine is from the expected answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// What was compared, for example `plan against tract`.
    pub name: String,
    /// Observations.
    pub inputs: usize,
    /// Largest |a - b| / (1 + m) of any utility, with m the largest |b| of its observation.
    ///
    /// Rounding grows with the largest numbers of a sum, not with its result: a small utility beside
    /// large ones carries their error, in the source graph as well.
    pub max_rel_error: f32,
    /// Largest distance of a number from the truth, or of two engines' numbers from each other, in what right engines
    /// are found from the truth there; none where the truth is not known. It judges its inputs in the place of the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_distance: Option<f64>,
    /// Largest error of the inputs whose truth is not known: what judges them.
    #[serde(skip)]
    pub max_judged_error: f32,
    /// Observations for which another action, or another allocation, was chosen.
    pub action_mismatches: usize,
    /// Inputs without an answer, as it should be: an engine refuses, its numbers are not finite, or no
    /// action is available.
    pub refused: usize,
    /// Inputs for which only one of both gave an answer, and inputs that should have been refused.
    pub refusals_differ: usize,
    /// Inputs that are no numbers, rightly refused, to which the other engine gave finite numbers.
    pub swallowed: usize,
    /// Whether differences count: not where products leave the range of f32 in any engine.
    pub judged: bool,
    /// The observation with the largest error.
    #[serde(skip)]
    pub worst_input: usize,
}

impl Comparison {
    /// Nothing compared yet.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            inputs: 0,
            max_rel_error: 0.0,
            max_distance: None,
            max_judged_error: 0.0,
            action_mismatches: 0,
            refused: 0,
            refusals_differ: 0,
            swallowed: 0,
            judged: true,
            worst_input: 0,
        }
    }

    /// Adds an input that one engine did not answer, or both.
    pub fn add_refusal(&mut self, agreed: bool) {
        self.inputs += 1;
        self.refused += usize::from(agreed);
        self.refusals_differ += usize::from(!agreed);
    }

    /// Adds an input that must be refused, whatever the other engine makes of it.
    pub fn add_no_number(&mut self, refused: bool, other_answers: bool) {
        self.add_refusal(refused);
        self.swallowed += usize::from(refused && other_answers);
    }

    /// Whether nothing counts as a difference, but for other choices: within the tolerance they are near ties.
    pub fn agrees(&self) -> bool {
        let is_near = self.max_judged_error <= TOLERANCE
            && self.max_distance.is_none_or(|distance| distance <= MOST_DISTANCE);
        !self.judged || is_near && self.refusals_differ == 0
    }

    /// Adds an input by how far its numbers are, in scatters, beside their error. What is no number is further than any.
    pub fn add_distance(&mut self, distance: f64, error: f32, same_action: bool) {
        let distance = if distance.is_nan() { f64::INFINITY } else { distance };
        self.max_distance = Some(self.max_distance.map_or(distance, |most| most.max(distance)));
        self.note(error, same_action);
    }

    /// Adds answers of both engines.
    pub fn add(&mut self, got: &[f32], want: &[f32], same_action: bool) {
        self.add_on_scale(magnitude(want), got, want, same_action);
    }

    /// Adds utilities from which no action was chosen, by both engines or by one.
    pub fn add_unchosen(&mut self, got: &[f32], want: &[f32], by_both: bool) {
        self.add(got, want, true);
        self.refused += usize::from(by_both);
        self.refusals_differ += usize::from(!by_both);
    }

    /// Adds answers whose largest magnitude is known from more than themselves.
    pub fn add_on_scale(&mut self, largest: f32, got: &[f32], want: &[f32], same_action: bool) {
        let distance =
            got.iter().zip(want).map(|(got, want)| (got - want).abs()).fold(0.0, f32::max);
        self.add_error(distance / (1.0 + largest), same_action);
    }

    /// Adds an input with its largest error.
    pub fn add_error(&mut self, error: f32, same_action: bool) {
        self.max_judged_error = self.max_judged_error.max(error);
        self.note(error, same_action);
    }

    fn note(&mut self, error: f32, same_action: bool) {
        if error > self.max_rel_error {
            (self.max_rel_error, self.worst_input) = (error, self.inputs);
        }
        self.inputs += 1;
        self.action_mismatches += usize::from(!same_action);
    }
}

/// The largest magnitude of some values.
pub fn magnitude(values: &[f32]) -> f32 {
    values.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()))
}

/// Compares a policy with recorded answers, which agents with memory gave with an empty one.
pub fn compare_with_golden<'a>(
    name: &str,
    policy: &mut dyn Policy,
    cases: impl IntoIterator<Item = &'a GoldenCase>,
) -> Result<Comparison, CompileError> {
    let mut comparison = Comparison::new(name);
    let mut got = vec![0.0; policy.actions()];
    for case in cases {
        let view = case.observation.view();
        let mut memory = vec![0.0; policy.hidden()];
        policy.utilities_with(&view, &mut memory, &mut got).map_err(cannot_run)?;
        memory.fill(0.0);
        let action = policy.decide_with(&view, &mut memory).map_err(cannot_run)?.action;
        comparison.add(&got, &case.utilities, action == case.action);
    }
    Ok(comparison)
}

/// Why an engine gave no answer.
pub fn cannot_run(error: impl std::fmt::Display) -> CompileError {
    CompileError::Run { reason: error.to_string() }
}

/// Compares values with recorded ones, a state being one input.
///
/// Another allocation counts where its total differs from that of the recorded one by more than
/// [`TOLERANCE`] allows, since engines may break near ties differently; and only where all allocations are
/// searched, since the result of the ascent depends on its start.
pub fn compare_with_golden_allocations(
    name: &str,
    network: &mut dyn TeamValueNetwork,
    golden: &Golden,
    team_max: usize,
) -> Result<Comparison, CompileError> {
    let mut comparison = Comparison::new(name);
    for case in &golden.allocations {
        let state = case.state.view();
        let mut got = Vec::new();
        for value in &case.values {
            got.push(network.value(&case.query(&state, value)).map_err(cannot_run)?);
        }
        let want: Vec<f32> = case.values.iter().map(|value| value.value).collect();
        let same = case.state.agents > EXACT_AGENTS || {
            let found = allocate(network, case, team_max).map_err(cannot_run)?;
            let found = total(network, case, &found).map_err(cannot_run)?;
            let recorded = total(network, case, &case.allocation).map_err(cannot_run)?;
            (found - recorded).abs() <= f64::from(TOLERANCE) * (1.0 + recorded.abs())
        };
        comparison.add(&got, &want, same);
    }
    Ok(comparison)
}

fn allocate(
    network: &mut dyn TeamValueNetwork,
    case: &GoldenAllocation,
    team_max: usize,
) -> Result<Vec<u8>, AllocateError> {
    let cells = exact::cells(case.state.agents, case.state.open().count());
    let (mut values, mut cells) = (vec![0.0; cells], vec![exact::Cell::default(); cells]);
    let mut relation = vec![0.0; case.state.entities() * case.relations];
    let memory = SearchMemory { cells: &mut cells, values: &mut values, relation: &mut relation };
    let mut allocator = TeamValueAllocator {
        network,
        relation: Recorded(case),
        start: LastAllocation,
        team_max,
        exact_agents: EXACT_AGENTS,
        memory,
    };
    let mut allocation = vec![0; case.state.agents];
    allocator.allocate(&case.state.view(), &mut allocation).map(|()| allocation)
}

/// The sum of all teams' values; infinitely low for an agent at a closed subtask.
fn total(
    network: &mut dyn TeamValueNetwork,
    case: &GoldenAllocation,
    allocation: &[u8],
) -> Result<f64, AllocateError> {
    let state = case.state.view();
    let mut total = 0.0;
    for task in case.state.open() {
        let members = allocation.iter().enumerate();
        let members = members.filter(|(_, place)| usize::from(**place) == task);
        let team = members.fold(0, |team, (agent, _)| team | 1_u64 << agent);
        let query = case.query(&state, &GoldenValue { task, team, value: 0.0 });
        total += f64::from(network.value(&query)?);
    }
    Ok(total)
}

/// The relation that was recorded with a state.
struct Recorded<'a>(&'a GoldenAllocation);

impl TaskRelation for Recorded<'_> {
    fn columns(&self) -> usize {
        self.0.relations
    }

    fn observe(&mut self, _: &AllocationState<'_>) -> Result<(), AllocateError> {
        Ok(())
    }

    fn write(&mut self, _: &AllocationState<'_>, task: usize, relation: &mut [f32]) {
        for (to, from) in relation.iter_mut().zip(self.0.relation_to(task)) {
            *to = *from;
        }
    }
}
