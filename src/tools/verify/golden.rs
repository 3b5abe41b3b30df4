//! Every engine on what a bundle recorded.

use sortie_bundle::{Bundle, POLICY};
use sortie_cli::allocator::LearnedAllocator;
use sortie_cli::failure::Failure;
use sortie_cli::policy::DeployedPolicy;
use sortie_cli::tools::engines;
use sortie_core::plan::Profile;
use sortie_plans::{
    Answer, Comparison, CompileError, Family, GOLDEN_FAMILY, GraphEngine, NetworkFiles,
    NetworkInput, OnnxRuntimeEngine, Rows, True, TrueNumber, compare_pointing, compare_with_golden,
    compare_with_golden_allocations, compare_with_golden_episodes, compare_with_truth,
    golden_inputs, golden_teams,
};

use super::networks::known;
use super::team::TrueTeam;
use super::{Compared, VerifyArguments, unproved, within};

/// Plan, tract and onnxruntime beside recorded observations, episodes and allocations.
pub(super) fn judged(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    runtime: Option<&'static dyn OnnxRuntimeEngine>,
    profile: Profile,
) -> Result<Vec<Compared>, Failure> {
    let failed = within(bundle.folder());
    let graphs = graphs(runtime)?;
    let mut policies = policies(bundle, profile, &graphs).map_err(&failed)?;
    let mut allocators = Vec::new();
    if bundle.allocator_onnx().is_some() {
        allocators.push(("plan", LearnedAllocator::of_plan(bundle, &unproved(), Profile::Exact)?));
    }
    for engine in graphs {
        if bundle.allocator_onnx().is_some() {
            allocators.push((engine.name(), LearnedAllocator::of_graph(bundle, engine)?));
        }
    }
    let (golden, team_max) = (bundle.golden(), bundle.manifest().limits.team_max.into());
    let truths = true_utilities(bundle, &golden_inputs(&golden.cases), arguments.common.seed);
    let truths = truths.map_err(&failed)?;
    let mut found = Vec::new();
    for (engine, policy) in &mut policies {
        let cases = compare_with_golden(policy.policy()?.as_mut(), &golden.cases, &truths);
        found.push(named(format!("{engine} against golden"), cases));
        if bundle.options().is_some() {
            let episodes = compare_with_golden_episodes(policy.policy()?.as_mut(), bundle);
            found.push(named(format!("{engine} in golden episodes"), episodes.map_err(&failed)?));
        }
    }
    let values = true_values(bundle, arguments.common.seed).map_err(&failed)?;
    for (engine, allocator) in &mut allocators {
        let network = &mut allocator.network()?;
        let allocations = compare_with_golden_allocations(network, golden, team_max, &values);
        let name = format!("allocator {engine} against golden");
        found.push(named(name, allocations.map_err(&failed)?));
    }
    if let Some(mut memory) = unproved().pointing(bundle).map_err(&failed)? {
        let mut allocator = memory.bind().map_err(CompileError::from).map_err(&failed)?;
        let allocations = compare_pointing(&mut allocator, golden);
        found.push(named("allocator plan against golden allocations".to_owned(), allocations));
    }
    Ok(found)
}

fn named(name: String, found: Comparison) -> Compared {
    Compared::new(name, vec![found])
}

/// How far plan, tract and onnxruntime are from double precision on the same observations, each with its name; nothing where
/// the truth is not known.
pub(crate) fn distances(
    bundle: &Bundle,
    profile: Profile,
    inputs: Vec<NetworkInput>,
    (runtime, seed): (Option<&'static dyn OnnxRuntimeEngine>, u64),
) -> Result<Vec<(&'static str, Comparison)>, Failure> {
    let failed = within(bundle.folder());
    let truths = true_utilities(bundle, &inputs, seed).map_err(&failed)?;
    if truths.iter().all(Option::is_none) {
        return Ok(Vec::new());
    }
    let mut policies = policies(bundle, profile, &graphs(runtime)?).map_err(&failed)?;
    let family = Family::of(GOLDEN_FAMILY, inputs);
    let mut found = Vec::new();
    for (name, policy) in &mut policies {
        let mut policy = policy.policy()?;
        let answer = |input: &NetworkInput| match input {
            NetworkInput::Agent { seen, memory } => {
                Answer::of_policy(policy.as_mut(), &seen.view(), memory)
            }
            _ => None,
        };
        let got: Vec<Option<Answer>> = family.inputs.iter().map(answer).collect();
        found.push((*name, compare_with_truth(&family, &got, &truths)));
    }
    Ok(found)
}

/// tract, and onnxruntime where it is found.
fn graphs(
    runtime: Option<&'static dyn OnnxRuntimeEngine>,
) -> Result<Vec<&'static dyn GraphEngine>, Failure> {
    let tract = engines()?.tract();
    Ok(std::iter::once(tract).chain(runtime.map(|runtime| runtime as _)).collect())
}

/// What decides for a bundle's agents, by every engine, each with its name.
fn policies(
    bundle: &Bundle,
    profile: Profile,
    graphs: &[&'static dyn GraphEngine],
) -> Result<Vec<(&'static str, DeployedPolicy)>, CompileError> {
    let plan = unproved().agents(bundle, profile).and_then(DeployedPolicy::of_plans)?;
    let of_graph = |engine: &&'static dyn GraphEngine| {
        Ok((engine.name(), DeployedPolicy::of_graph(bundle, *engine)?))
    };
    std::iter::once(Ok(("plan", plan))).chain(graphs.iter().map(of_graph)).collect()
}

/// The true utilities of observations; none where they are not known.
fn true_utilities(
    bundle: &Bundle,
    inputs: &[NetworkInput],
    seed: u64,
) -> Result<Vec<Option<True>>, CompileError> {
    if bundle.options().is_some() || bundle.manifest().network.agent == POLICY {
        let team = TrueTeam::of(bundle)?;
        return Ok(team.map(|mut team| team.answers(inputs)).unwrap_or_default());
    }
    let files = NetworkFiles::One(bundle.agent_onnx());
    true_answers(&files, bundle.contract().features.into(), inputs, seed)
}

/// The true values of every recorded state's teams; none where they are not known.
fn true_values(bundle: &Bundle, seed: u64) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
    let Some(onnx) = bundle.allocator_onnx() else { return Ok(Vec::new()) };
    let (files, features) = (NetworkFiles::One(onnx), bundle.contract().features.into());
    let values = |case| {
        let found = true_answers(&files, features, &golden_teams(case), seed)?;
        Ok(found.into_iter().flatten().flatten().flatten().collect())
    };
    bundle.golden().allocations.iter().map(values).collect()
}

fn true_answers(
    files: &NetworkFiles<'_>,
    features: usize,
    inputs: &[NetworkInput],
    seed: u64,
) -> Result<Vec<Option<True>>, CompileError> {
    let engines = engines().map_err(|failure| CompileError::Run { reason: failure.message })?;
    let Some(mut truth) = known(engines.true_network(files, features, seed)) else {
        return Ok(Vec::new());
    };
    Ok(inputs.iter().map(|input| truth.answer(input, Rows::All).ok()).collect())
}
