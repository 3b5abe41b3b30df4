//! The plan of a policy whoever exported it.

use sortie_bundle::sha256;
use sortie_core::plan::{AlignedBytes, Network, Profile, Program, Proof, RobotFacts};
use sortie_plans::{
    Annex, Comparison, CompileError, CompileOptions, Compiled, CompiledPolicy, Distances,
    FlatPolicy, PlanFlatPolicy, PolicyAnswer, PolicyOptions, ProofCase, TeamSizes, TrueNumber,
    random_policy_inputs, relative_error, report,
};

use super::blamed_on;
use crate::flat::{FlatGraph, normaliser, remarks, wild_constant};
use crate::graph::guarded;
use crate::lower::{AgentSizes, Choice, LoweredPolicy, Origin, assemble, lower_policy};
use crate::networks::TruePolicy;

/// Multiply-adds of all inputs of a proof together, which the reference evaluator does nine times over in a second.
const MOST_MULTIPLY_ADDS: u64 = 50_000_000;

/// Steps that a recurrent policy takes before it begins anew.
const STEPS: usize = 16;

/// Compiles a policy, and proves its plan against the graph on random inputs, states fed back.
///
/// # Errors
/// The file cannot be read, more must be said about it, a node has no step, or plan and graph differ.
pub fn compile_policy(
    onnx: &[u8],
    policy: &PolicyOptions,
    options: &CompileOptions,
) -> Result<CompiledPolicy, CompileError> {
    compile_recorded_policy(onnx, policy, options, &[])
}

/// The same; a quarter of the proof's inputs are recorded ones.
pub(crate) fn compile_recorded_policy(
    onnx: &[u8],
    policy: &PolicyOptions,
    options: &CompileOptions,
    recorded: &[ProofCase],
) -> Result<CompiledPolicy, CompileError> {
    let graph = FlatGraph::read(onnx, policy)?;
    let remarks = remarks(&graph);
    let facts = graph.interface.facts.clone();
    let entries = graph.file.metadata_props.iter();
    let metadata = entries.map(|entry| (entry.key.clone(), entry.value.clone()));
    let annex = Annex::new(facts.clone(), metadata);
    let robot = RobotFacts::of_metadata(&annex.metadata, normaliser(&graph));
    let team = options.team.or_else(|| TeamSizes::of_entities(&facts));
    let meanings = team.map(|team| team.meanings(&facts)).transpose()?;
    let meanings = meanings.unwrap_or_default();
    let lowered = guarded(|| Ok(lower_policy(&graph, &meanings, options.profile)));
    let lowered = lowered.map_err(|reason| CompileError::Unreadable { reason })??;
    let LoweredPolicy { program, weights, features, actions } = lowered;
    let weights = weights.to_bytes();
    let places = facts.entities().and_then(|input| input.shape.iter().rev().nth(1).copied());
    let (n_max, features) = match team {
        Some(team) => (places.unwrap_or(options.n_max), team.features),
        None => (1, features),
    };
    let sizes = AgentSizes { n_max, features, actions, choice: Choice::Greedy };
    let mut origin = Origin {
        source: sha256(onnx),
        profile: options.profile,
        network: Network::Policy,
        contract: options.contract.unwrap_or(0),
        t_max: 0,
        proof: Proof::NONE,
        action_mismatch: 0.0,
    };
    let draft = AlignedBytes::copy_of(&assemble(&program, &weights, sizes, &origin)?);
    let mut plan = PlanFlatPolicy::load(draft.as_slice(), facts.clone())?;
    let wild = wild_constant(&graph.file);
    let mut truth = TruePolicy::open(graph)?;
    let comparison = prove_policy(&mut plan, &mut truth, options, recorded);
    let comparison = comparison.map_err(|error| blamed_on(wild, error))?;
    origin.proof = comparison.proof();
    origin.action_mismatch = comparison.action_mismatches as f32 / comparison.inputs.max(1) as f32;
    let mut bytes = assemble(&program, &weights, sizes, &origin)?;
    annex.append_to(&mut bytes)?;
    robot.append_to(&mut bytes);
    let program = program.to_bytes();
    let report = report(&Program::read(program.as_slice())?, 1, bytes.len(), &comparison);
    Ok(CompiledPolicy { compiled: Compiled { bytes, report }, facts, remarks })
}

/// Compares a plan with the truth, and refuses one that is further from it than rounding accounts for, on random inputs and
/// on recorded ones.
pub(crate) fn prove_policy(
    plan: &mut dyn FlatPolicy,
    truth: &mut TruePolicy,
    options: &CompileOptions,
    recorded: &[ProofCase],
) -> Result<Comparison, CompileError> {
    let CompileOptions { inputs, seed, .. } = *options;
    let facts = plan.facts().clone();
    let mut proof = Proving {
        comparison: Comparison::new("plan against double precision"),
        distances: Distances::default(),
        seed,
    };
    let mut states = vec![0.0; facts.state_length()];
    let inputs = facts.affordable(inputs, MOST_MULTIPLY_ADDS);
    let inputs_in_all = inputs;
    let random = random_policy_inputs(inputs, &facts, seed);
    for (index, inputs) in random.into_iter().enumerate() {
        if index % STEPS == 0 {
            states.fill(0.0);
        }
        let case = recorded_at(index, inputs_in_all, recorded);
        let case = case.cloned().unwrap_or(ProofCase { inputs, states: None });
        if let Some(known) = &case.states {
            states.clone_from(known);
        }
        let given: Vec<&[f32]> = case.inputs.iter().map(Vec::as_slice).collect();
        proof.add(plan, truth, &given, &mut states)?;
    }
    // What both refuse proves nothing either.
    if inputs > 0 && proof.comparison.refused == inputs {
        let reason = "on no random input does double precision tell whether the plan is right";
        return Err(CompileError::Run { reason: reason.to_owned() });
    }
    // Plans of few bits are judged by whoever has recorded observations.
    if options.profile != Profile::Int8 && !proof.distances.is_right() {
        return Err(proof.distances.error(seed));
    }
    Ok(proof.comparison)
}

/// What was recorded instead of every fourth input, evenly from the first case to the last.
fn recorded_at(index: usize, inputs: usize, recorded: &[ProofCase]) -> Option<&ProofCase> {
    let is_fourth = index % 4 == 3;
    let place = (index / 4 * recorded.len()).checked_div(inputs / 4)?;
    recorded.get(place).filter(|_| is_fourth)
}

/// What a plan's answers are beside the truth.
struct Proving {
    comparison: Comparison,
    distances: Distances,
    seed: u64,
}

impl Proving {
    /// Adds what both make of an input; the true next states are the next.
    fn add(
        &mut self,
        plan: &mut dyn FlatPolicy,
        truth: &mut TruePolicy,
        given: &[&[f32]],
        states: &mut [f32],
    ) -> Result<(), CompileError> {
        let input = self.comparison.inputs;
        let mut own = states.to_vec();
        let got = plan.run(given, &mut own);
        let outputs = truth.outputs(given, states, self.seed)?;
        let want = truth.answers(&outputs, states)?;
        let truths = truth.compared(&outputs);
        let mut expected: Vec<f32> = want.iter().flat_map(numbers).copied().collect();
        expected.extend_from_slice(states);
        // What must not be chosen has the lowest score there is.
        let is_closed = |number: f32| number == f32::MIN;
        let is_sure = |(number, truth): (&f32, &TrueNumber)| is_closed(*number) || truth.is_sure();
        if !expected.iter().zip(&truths).all(is_sure) {
            // Right engines answer or not, as their rounding falls.
            self.comparison.add_refusal(true);
            states.fill(0.0);
            return Ok(());
        }
        let has_answer = expected.iter().all(|number| number.is_finite());
        let is_number = |answers: &Vec<PolicyAnswer>| {
            answers.iter().flat_map(numbers).chain(&own).all(|number| !number.is_nan())
        };
        let got = got.ok().filter(is_number);
        let (Some(got), true) = (&got, has_answer) else {
            if got.is_some() != has_answer {
                let (answers, seed) = (got.is_some(), self.seed);
                return Err(CompileError::AnswersOtherwise { answers, input, seed });
            }
            self.comparison.add_refusal(true);
            states.fill(0.0);
            return Ok(());
        };
        let mut answered: Vec<f32> = got.iter().flat_map(numbers).copied().collect();
        answered.extend(&own);
        self.distances.add(input, &answered, &truths, |at| at);
        let distance = furthest(&answered, &truths);
        // Beside the lowest score all others would be alike.
        let both = answered.iter().zip(&expected);
        let open = both.filter(|(got, want)| !(is_closed(**got) && is_closed(**want)));
        let (answered, expected): (Vec<f32>, Vec<f32>) = open.unzip();
        let same = got
            .iter()
            .zip(&want)
            .all(|(got, want)| want.scores.is_empty() || got.numbers == want.numbers);
        self.comparison.add_distance(distance, relative_error(&answered, &expected), same);
        Ok(())
    }
}

/// How far the furthest number is from the truth.
fn furthest(numbers: &[f32], truths: &[TrueNumber]) -> f64 {
    let known = numbers.iter().zip(truths).filter(|(_, truth)| truth.is_finite());
    known.map(|(number, truth)| truth.distance(*number)).fold(0.0, f64::max)
}

/// What an answer is judged by: scores, where it chooses among them.
fn numbers(answer: &PolicyAnswer) -> &[f32] {
    if answer.scores.is_empty() { &answer.numbers } else { &answer.scores }
}
