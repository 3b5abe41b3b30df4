//! Every engine on what a bundle recorded.

use sortie_bundle::{Bundle, POLICY};
use sortie_cli::allocator::LearnedAllocator;
use sortie_cli::failure::Failure;
use sortie_cli::policy::DeployedPolicy;
use sortie_cli::tools::engines;
use sortie_core::plan::Profile;
use sortie_plans::{
    Comparison, CompileError, GraphEngine, NetworkFiles, NetworkInput, OnnxRuntimeEngine, Rows,
    True, TrueNumber, compare_pointing, compare_with_golden, compare_with_golden_allocations,
    compare_with_golden_episodes, golden_inputs, golden_teams,
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
    let tract = engines()?.tract();
    let graphs: Vec<&dyn GraphEngine> =
        std::iter::once(tract).chain(runtime.map(|runtime| runtime as _)).collect();
    let plan = unproved().agents(bundle, profile).and_then(DeployedPolicy::of_plans);
    let mut policies = vec![("plan", plan.map_err(&failed)?)];
    let mut allocators = Vec::new();
    if bundle.allocator_onnx().is_some() {
        allocators.push(("plan", LearnedAllocator::of_plan(bundle, &unproved())?));
    }
    for engine in graphs {
        let policy = DeployedPolicy::of_graph(bundle, engine).map_err(&failed)?;
        policies.push((engine.name(), policy));
        if bundle.allocator_onnx().is_some() {
            allocators.push((engine.name(), LearnedAllocator::of_graph(bundle, engine)?));
        }
    }
    let (golden, team_max) = (bundle.golden(), bundle.manifest().limits.team_max.into());
    let truths = true_utilities(bundle, arguments.common.seed).map_err(&failed)?;
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

/// The true utilities of recorded observations; none where they are not known.
fn true_utilities(bundle: &Bundle, seed: u64) -> Result<Vec<Option<True>>, CompileError> {
    let inputs = golden_inputs(&bundle.golden().cases);
    if bundle.options().is_some() || bundle.manifest().network.agent == POLICY {
        let team = TrueTeam::of(bundle)?;
        return Ok(team.map(|mut team| team.answers(&inputs)).unwrap_or_default());
    }
    let files = NetworkFiles::One(bundle.agent_onnx());
    true_answers(&files, bundle.contract().features.into(), &inputs, seed)
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
