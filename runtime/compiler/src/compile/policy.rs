//! The plan of a policy whoever exported it.

use sortie_bundle::sha256;
use sortie_core::plan::{AlignedBytes, Network, Profile, Program};
use sortie_plans::{
    Annex, Comparison, CompileError, CompileOptions, Compiled, CompiledPolicy, FlatPolicy,
    PlanFlatPolicy, PolicyAnswer, PolicyOptions, TOLERANCE, TeamSizes, magnitude,
    random_policy_inputs, report,
};

use crate::flat::FlatGraph;
use crate::graph::guarded;
use crate::lower::{AgentSizes, Choice, LoweredPolicy, Origin, assemble, lower_policy};
use crate::tract::TractFlatPolicy;

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
    let graph = FlatGraph::read(onnx, policy)?;
    let facts = graph.interface.facts.clone();
    let entries = graph.file.metadata_props.iter();
    let metadata = entries.map(|entry| (entry.key.clone(), entry.value.clone()));
    let annex = Annex::new(facts.clone(), metadata);
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
        max_error: 0.0,
        action_mismatch: 0.0,
    };
    let draft = AlignedBytes::copy_of(&assemble(&program, &weights, sizes, &origin)?);
    let mut plan = PlanFlatPolicy::load(draft.as_slice(), facts.clone())?;
    let mut reference = TractFlatPolicy::from_graph(graph)?;
    let comparison = prove(&mut plan, &mut reference, options)?;
    origin.max_error = comparison.max_rel_error;
    origin.action_mismatch = comparison.action_mismatches as f32 / comparison.inputs.max(1) as f32;
    let mut bytes = assemble(&program, &weights, sizes, &origin)?;
    annex.append_to(&mut bytes)?;
    let program = program.to_bytes();
    let report = report(&Program::read(program.as_slice())?, 1, bytes.len(), &comparison);
    Ok(CompiledPolicy { compiled: Compiled { bytes, report }, facts })
}

/// Compares a plan with its graph on random inputs, and refuses one that differs.
fn prove(
    plan: &mut dyn FlatPolicy,
    graph: &mut dyn FlatPolicy,
    options: &CompileOptions,
) -> Result<Comparison, CompileError> {
    let facts = plan.facts().clone();
    let mut comparison = Comparison::new("plan against tract");
    let mut states = vec![0.0; facts.state_length()];
    let inputs = random_policy_inputs(options.inputs, &facts, options.seed);
    for (index, given) in inputs.iter().enumerate() {
        if index % STEPS == 0 {
            states.fill(0.0);
        }
        let given: Vec<&[f32]> = given.iter().map(Vec::as_slice).collect();
        compare(plan, graph, &given, &mut states, &mut comparison)?;
    }
    let error = comparison.max_rel_error;
    // Plans of few bits are judged by whoever has recorded observations.
    let limit = if options.profile == Profile::Int8 { f32::INFINITY } else { TOLERANCE };
    if error.is_nan() || error > limit || comparison.refusals_differ > 0 {
        let (input, seed) = (comparison.worst_input, options.seed);
        return Err(CompileError::Differs { error, limit, input, seed });
    }
    Ok(comparison)
}

/// Adds what both make of an input; the graph's next states are the next.
fn compare(
    plan: &mut dyn FlatPolicy,
    graph: &mut dyn FlatPolicy,
    given: &[&[f32]],
    states: &mut [f32],
    comparison: &mut Comparison,
) -> Result<(), CompileError> {
    let mut own = states.to_vec();
    let got = plan.run(given, &mut own);
    let want = graph.run(given, states)?;
    let numbers = |answer: &PolicyAnswer| {
        let scores = if answer.scores.is_empty() { &answer.numbers } else { &answer.scores };
        scores.clone()
    };
    let mut expected: Vec<f32> = want.iter().flat_map(numbers).collect();
    expected.extend_from_slice(states);
    if !expected.iter().all(|number| number.is_finite()) {
        comparison.add_refusal(got.is_err());
        states.fill(0.0);
        return Ok(());
    }
    let got = got?;
    let mut answered: Vec<f32> = got.iter().flat_map(numbers).collect();
    answered.extend(own);
    // Beside the lowest score there is, that of actions which must not be chosen, all others are alike.
    let is_closed =
        |index: usize| [&answered, &expected].map(|n| n.get(index)) == [Some(&f32::MIN); 2];
    let open = |numbers: &[f32]| -> Vec<f32> {
        let open = numbers.iter().enumerate().filter(|(index, _)| !is_closed(*index));
        open.map(|(_, number)| *number).collect()
    };
    let (answered, expected) = (open(&answered), open(&expected));
    let same = got
        .iter()
        .zip(&want)
        .all(|(got, want)| want.scores.is_empty() || got.numbers == want.numbers);
    if answered.len() != expected.len() || answered.iter().any(|number| number.is_nan()) {
        comparison.add_refusal(false);
        return Ok(());
    }
    comparison.add_on_scale(magnitude(&expected), &answered, &expected, same);
    Ok(())
}
