//! `sortie verify`: do the plan, tract, onnxruntime and the recorded answers agree?

mod recorded;
mod verdict;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_bundle::{Bundle, POLICY, Recording};
use sortie_cli::allocator::LearnedAllocator;
use sortie_cli::deployment::open_bundle;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::read_recording;
use sortie_cli::foreign::PolicyArguments;
use sortie_cli::output::{Common, print_json};
use sortie_cli::policy::{DeployedPolicy, PlanProfile, graph_policy};
use sortie_cli::terminal;
use sortie_cli::tools::{OnnxRuntimeArguments, compiler, engines, plans};
use sortie_core::Observation;
use sortie_core::plan::{AlignedBytes, Network, PlanError, Profile};
use sortie_plans::{
    AgentPlans, Annex, BundlePlans, Comparison, CompileError, CompileOptions, Compiler,
    CompilerProcess, GraphEngine, ObservationSizes, OnnxRuntimeEngine, PolicyOptions,
    ProposalFiles, Standard, TeamQuerySizes, agreement, compare_agents, compare_with_golden,
    compare_with_golden_allocations, compare_with_golden_episodes, inspect_plan,
    observation_families, random_allocation_states, random_entities, read_onnx,
    team_query_families,
};

/// Compare plans with tract, with onnxruntime and with a bundle's golden observations and allocations
///
/// Inputs are random ones of all mask patterns, and families that tend to break engines: nothing or everything
/// visible, denormals, huge values, NaN and others. Exit code 1 if any utility or value differs by more than
/// 1e-5 relative, if only one engine answers, or if a golden action or allocation is not chosen. An int8 plan fails
/// where it takes another action in more than 0.5 % of the golden and of the recorded observations.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie verify models/save-the-city --inputs 10000
  sortie verify models/save-the-city --python venv/bin/python3
  sortie verify models/save-the-city --profile int8 --observations seen.bin
  sortie verify agent.onnx --against tract
  sortie verify walking.onnx
  sortie verify walking.onnx --npz recorded.npz")]
pub(crate) struct VerifyArguments {
    /// A bundle's folder or an ONNX file
    subject: PathBuf,
    /// Random inputs; every other family has a quarter of it
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    inputs: u32,
    /// What to compare with, several joined by commas [default: all that there is]
    #[arg(long, value_enum, value_delimiter = ',')]
    against: Vec<Peer>,
    /// How the agent's plan computes; int8 plans are judged by the actions that they take
    #[arg(long, value_enum, default_value_t = PlanProfile::Exact)]
    profile: PlanProfile,
    /// Observations of `sortie eval BUNDLE --dump FILE`, on which the plan is compared with the exact one
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// Recorded inputs `in__NAME` and answers `out__NAME` of a policy that is run by tract and onnxruntime: arrays that
    /// `numpy.savez` saved, one case behind the other
    #[arg(long, value_name = "FILE", conflicts_with = "observations")]
    npz: Option<PathBuf>,
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    common: Common,
    // Last: what follows would stand under its heading.
    #[command(flatten)]
    policy: PolicyArguments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Peer {
    /// The ONNX graph, run by tract
    Tract,
    /// The ONNX file, run by onnxruntime if that is found
    Onnxruntime,
    /// The bundle's golden observations and allocations
    Golden,
}

#[derive(Serialize)]
struct Report {
    engines: Vec<Compared>,
    /// Peers that were wanted but not found.
    not_compared: Vec<&'static str>,
    /// What runs a policy that has no plan.
    #[serde(skip_serializing_if = "Option::is_none")]
    engine: Option<&'static str>,
    /// Whether it is of a policy that somebody else exported.
    #[serde(skip)]
    is_policy: bool,
}

/// What one engine gave beside another, over all families and for each.
#[derive(Serialize)]
struct Compared {
    name: String,
    inputs: usize,
    max_rel_error: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    max_distance: Option<f64>,
    action_mismatches: usize,
    refused: usize,
    refusals_differ: usize,
    swallowed: usize,
    families: Vec<Comparison>,
}

pub(crate) fn run(arguments: &VerifyArguments) -> Outcome {
    engines()?;
    let report = compare(arguments)?;
    if arguments.common.json {
        print_json(&report);
    } else if report.is_policy {
        verdict::print_recorded(&report);
    } else {
        verdict::print(&report);
    }
    if report.is_policy {
        return verdict::judge_policy(&report);
    }
    match arguments.profile {
        PlanProfile::Int8 => verdict::judge_actions(&report),
        PlanProfile::Exact | PlanProfile::Fused => verdict::judge(&report.engines),
    }
}

fn compare(arguments: &VerifyArguments) -> Result<Report, Failure> {
    let subject = &arguments.subject;
    let (asked, wanted) = (|peer| arguments.asks_for(peer), |peer| arguments.wants(peer));
    let judges = Judges::open(arguments)?;
    if let Some(file) = &arguments.npz {
        if subject.is_dir() || asked(Peer::Golden) {
            let message = "`--npz` is for the ONNX file of a policy, which has no golden answers";
            return Err(Failure::new(Exit::Usage, message));
        }
        return recorded::compare(arguments, Some(file), &judges);
    }
    if is_policy(arguments)? {
        return recorded::compare(arguments, None, &judges);
    }
    let (not_compared, Judges { engines: judges, runtime, .. }) = (judges.missing(), judges);
    let mut engines = Vec::new();
    let spinner = terminal::spinner(arguments.common);
    spinner.set_message("comparing the plans with their graphs");
    if subject.is_dir() || !subject.exists() {
        let bundle = open_bundle(subject)?;
        let profile = arguments.profile.profile();
        engines.extend(judged_agents(arguments, &bundle, profile, &judges)?);
        if let Some(allocator) = Judged::allocator(&bundle)? {
            engines.extend(judged(arguments, &allocator, &judges)?);
        }
        if wanted(Peer::Tract) {
            engines.extend(judged_proposals(arguments, &bundle)?);
        }
        if wanted(Peer::Golden) {
            spinner.set_message("comparing with golden answers");
            // onnxruntime runs agents without memory, and policies of others.
            let sortie_bundle::Network { agent, hidden, .. } = &bundle.manifest().network;
            let runtime = runtime.filter(|_| *hidden == 0 || agent == POLICY);
            engines.extend(against_golden(&bundle, runtime, profile)?);
        }
        if let Some(file) = &arguments.observations {
            spinner.set_message("comparing on recorded observations");
            let recording = read_recording(file, &bundle)?;
            engines.push(against_exact(&bundle, profile, &recording)?);
        }
    } else if arguments.observations.is_some() {
        let message = "recorded observations belong to a bundle: name its folder";
        return Err(Failure::new(Exit::Usage, message));
    } else if asked(Peer::Golden) {
        let message = "golden observations belong to a bundle: name its folder";
        return Err(Failure::new(Exit::Usage, message));
    } else {
        let onnx = read_onnx(subject).map_err(|error| Failure::file(subject, &error))?;
        let network = Judged::file(arguments, &onnx)?;
        engines.extend(judged(arguments, &network, &judges)?);
    }
    spinner.finish_and_clear();
    Ok(Report { engines, not_compared, engine: None, is_policy: false })
}

/// Whether the subject is a policy that somebody else exported: what says something about one means one.
fn is_policy(arguments: &VerifyArguments) -> Result<bool, Failure> {
    let subject = &arguments.subject;
    let options = arguments.policy.options_for(subject)?;
    if subject.is_dir() || !subject.exists() {
        let message = "what is said about a policy's inputs and outputs goes with an ONNX file";
        let says = options != PolicyOptions::default();
        return if says { Err(Failure::new(Exit::Usage, message)) } else { Ok(false) };
    }
    if arguments.observations.is_some() || arguments.asks_for(Peer::Golden) {
        return Ok(false);
    }
    let onnx = read_onnx(subject).map_err(|error| Failure::file(subject, &error))?;
    let inspected = compiler().inspect(&onnx, &options).map_err(within(subject))?;
    inspected.policy.transpose().map(|policy| policy.is_some()).map_err(within(subject))
}

impl VerifyArguments {
    /// Whether this peer is named.
    fn asks_for(&self, peer: Peer) -> bool {
        self.against.contains(&peer)
    }

    /// Whether this peer is named, or all are wanted.
    fn wants(&self, peer: Peer) -> bool {
        self.against.is_empty() || self.asks_for(peer)
    }
}

/// The engines that are compared.
struct Judges {
    engines: Vec<&'static dyn GraphEngine>,
    runtime: Option<&'static dyn OnnxRuntimeEngine>,
    wants_runtime: bool,
}

impl Judges {
    fn open(arguments: &VerifyArguments) -> Result<Self, Failure> {
        let wants_runtime = arguments.wants(Peer::Onnxruntime);
        let runtime = match wants_runtime {
            false => None,
            true if arguments.asks_for(Peer::Onnxruntime) => Some(arguments.onnxruntime.open()?),
            true => arguments.onnxruntime.open_or_note("onnxruntime is not compared")?,
        };
        let tract = if arguments.wants(Peer::Tract) { Some(engines()?.tract()) } else { None };
        let engines = tract.into_iter().chain(runtime.map(|runtime| runtime as _)).collect();
        Ok(Self { engines, runtime, wants_runtime })
    }

    /// The engines that were wanted but not found.
    fn missing(&self) -> Vec<&'static str> {
        let missing = self.wants_runtime && self.runtime.is_none();
        missing.then_some("onnxruntime").into_iter().collect()
    }
}

/// A plan that is judged, and the network that it was made from.
struct Judged<'a> {
    onnx: &'a [u8],
    plan: AlignedBytes,
    n_max: usize,
}

impl<'a> Judged<'a> {
    /// The plan by which a bundle's allocator values teams, if it does.
    fn allocator(bundle: &'a Bundle) -> Result<Option<Self>, Failure> {
        let Some(onnx) = bundle.allocator_onnx() else { return Ok(None) };
        let plan = unproved().allocator(bundle).map_err(within(bundle.folder()))?;
        let n_max = bundle.manifest().limits.n_max.into();
        Ok(plan.map(|plan| Self { onnx, plan, n_max }))
    }

    /// The plan of a file.
    fn file(arguments: &VerifyArguments, onnx: &'a [u8]) -> Result<Self, Failure> {
        let (profile, seed) = (arguments.profile.profile(), arguments.common.seed);
        let options = CompileOptions { profile, seed, ..CompileOptions::default() };
        let compiled = compiler().compile(onnx, &options).map_err(within(&arguments.subject))?;
        let plan = AlignedBytes::copy_of(&compiled.bytes);
        Ok(Self { onnx, plan, n_max: options.n_max })
    }
}

/// Plans whatever they answer: how far they are from what was recorded is what this verb tells.
fn unproved() -> BundlePlans<CompilerProcess> {
    plans().without_proof()
}

fn within(subject: &Path) -> impl Fn(CompileError) -> Failure {
    move |error| Failure::from(error).within(subject.display())
}

/// The plan of a network before its judges.
fn judged(
    arguments: &VerifyArguments,
    network: &Judged<'_>,
    judges: &[&dyn GraphEngine],
) -> Result<Vec<Compared>, Failure> {
    let Judged { onnx, plan, n_max } = network;
    let (inputs, seed, n_max) = (arguments.inputs as usize, arguments.common.seed, *n_max);
    let engines = engines()?;
    let compare = || -> Result<Vec<Compared>, CompileError> {
        let (plan, facts) = (plan.as_slice(), inspect_plan(plan.as_slice())?);
        // The graph that this process reads for its judges has then been read and run elsewhere.
        let features = (facts.network == Network::Agent).then_some(facts.features);
        compiler().rehearse(onnx, n_max, features)?;
        let mut compared = Vec::new();
        for judge in judges {
            let needs_tract = facts.network == Network::Entities || facts.hidden > 0;
            if needs_tract && judge.name() != engines.tract().name() {
                continue;
            }
            if facts.network == Network::Entities {
                let groups = facts.t_max.into();
                let steps = random_entities(inputs, n_max, facts.features, groups, seed);
                let found = engines.compare_entities(plan, onnx, &steps)?;
                let found = Comparison { name: "random".to_owned(), ..found };
                compared.push(Compared::new(format!("plan against {}", judge.name()), vec![found]));
            } else if facts.network == Network::TeamValue {
                let (features, relations) = engines.team_value_columns(onnx)?;
                let sizes = TeamQuerySizes { n_max, features, relations };
                let families = team_query_families(inputs, sizes, seed);
                let families = judge.judge_team_values(plan, onnx, &families)?;
                compared.push(Compared::new(
                    format!("allocator plan against {}", judge.name()),
                    families,
                ));
            } else {
                let sizes =
                    ObservationSizes { n_max, features: facts.features, actions: facts.actions };
                let families = observation_families(inputs, sizes, seed);
                let families = judge.judge_agent(plan, onnx, &families)?;
                compared.push(Compared::new(format!("plan against {}", judge.name()), families));
            }
        }
        Ok(compared)
    };
    compare().map_err(within(&arguments.subject))
}

/// The plans that act for a bundle's agents before their judges.
fn judged_agents(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    profile: Profile,
    judges: &[&dyn GraphEngine],
) -> Result<Vec<Compared>, Failure> {
    let within = within(bundle.folder());
    let plans = unproved().agents(bundle, profile).map_err(&within)?;
    if bundle.manifest().network.agent == POLICY || bundle.options().is_some() {
        return judged_policies(arguments, bundle, &plans, judges).map_err(within);
    }
    let (onnx, n_max) = (bundle.agent_onnx(), bundle.manifest().limits.n_max.into());
    let mut compared = Vec::new();
    for plan in plans.into_plans() {
        compared.extend(judged(arguments, &Judged { onnx, plan, n_max }, judges)?);
    }
    Ok(compared)
}

/// The plans of policies over inputs of fixed sizes, acting for a team's agents.
fn judged_policies(
    arguments: &VerifyArguments,
    bundle: &Bundle,
    plans: &AgentPlans,
    judges: &[&dyn GraphEngine],
) -> Result<Vec<Compared>, CompileError> {
    let (contract, manifest) = (bundle.contract(), bundle.manifest());
    let sizes = ObservationSizes {
        n_max: manifest.limits.n_max.into(),
        features: contract.features.into(),
        actions: contract.actions.into(),
    };
    let (inputs, seed) = (arguments.inputs as usize, arguments.common.seed);
    let mut families = observation_families(inputs, sizes, seed);
    // What is no number stands in any row that is visible; many policies observe only their own.
    let mut observes_all = false;
    for plan in plans.plans() {
        let annex = Annex::of_plan(plan.as_slice())?;
        observes_all |= annex.is_some_and(|annex| annex.facts.entities().is_some());
    }
    families.retain(|family| observes_all || family.standard != Standard::Refusal);
    // Others than these agents are refused by all.
    let agents = manifest.network.graph_of.len();
    let observations = families.iter_mut().flat_map(|family| &mut family.inputs);
    for seen in observations.filter(|_| agents > 0) {
        seen.self_index %= agents;
    }
    let mut arenas = plans.arenas(1)?;
    let mut policy = plans.policy(&mut arenas)?;
    let mut compared = Vec::new();
    for judge in judges {
        let mut graph = graph_policy(bundle, *judge)?;
        let mut answers = |seen: &Observation<'_>, _, utilities: &mut [f32]| {
            let mut memory = vec![0.0; graph.hidden()];
            graph.utilities_with(seen, &mut memory, utilities).is_ok()
        };
        let compare = |family| compare_agents(policy.as_mut(), &mut answers, family);
        let found = families.iter().map(compare).collect();
        compared.push(Compared::new(format!("plan against {}", judge.name()), found));
    }
    Ok(compared)
}

/// The plan of a proposing allocator before its graphs.
fn judged_proposals(
    arguments: &VerifyArguments,
    bundle: &Bundle,
) -> Result<Option<Compared>, Failure> {
    let Some([trunk, step, critic]) = bundle.proposal_graphs() else { return Ok(None) };
    let engines = engines()?;
    let compare = || -> Result<Comparison, CompileError> {
        let plan = unproved().proposals(bundle, Profile::Exact)?;
        let plan = plan.ok_or(PlanError::WrongNetwork)?;
        // The graphs that this process reads have then been read and run elsewhere.
        for onnx in [trunk, step, critic] {
            compiler().rehearse(onnx, bundle.manifest().limits.n_max.into(), None)?;
        }
        let (inputs, seed) = (arguments.inputs as usize, arguments.common.seed);
        let facts = inspect_plan(plan.as_slice())?;
        let (features, tasks) = (facts.features, facts.t_max.into());
        let states = random_allocation_states(inputs, facts.n_max, features, tasks, seed);
        let files = ProposalFiles { trunk, step, critic };
        engines.compare_proposals(plan.as_slice(), &files, &states, seed)
    };
    let found = compare().map_err(within(bundle.folder()))?;
    let found = Comparison { name: "random".to_owned(), ..found };
    Ok(Some(Compared::new("allocator plan against tract".to_owned(), vec![found])))
}

/// Every engine on what the bundle recorded.
fn against_golden(
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
    let mut found = Vec::new();
    for (engine, policy) in &mut policies {
        let name = format!("{engine} against golden");
        found.push(compare_with_golden(&name, policy.policy()?.as_mut(), &golden.cases));
        if bundle.options().is_some() {
            let name = format!("{engine} in golden episodes");
            found.push(compare_with_golden_episodes(&name, policy.policy()?.as_mut(), bundle));
        }
    }
    for (engine, allocator) in &mut allocators {
        let (name, network) =
            (format!("allocator {engine} against golden"), &mut allocator.network()?);
        found.push(compare_with_golden_allocations(&name, network, golden, team_max));
    }
    let compared = |found: Comparison| {
        let name = found.name.clone();
        Compared::new(name, vec![Comparison { name: "golden".to_owned(), ..found }])
    };
    found.into_iter().map(|found| found.map(compared).map_err(&failed)).collect()
}

/// A bundle's plan beside its exact plan, on recorded observations.
fn against_exact(
    bundle: &Bundle,
    profile: Profile,
    recording: &Recording,
) -> Result<Compared, Failure> {
    let failed = within(bundle.folder());
    let plans = |profile| {
        let plans = unproved().agents(bundle, profile);
        plans.and_then(DeployedPolicy::of_plans).map_err(&failed)
    };
    let (mut plans, mut exact) = (plans(profile)?, plans(Profile::Exact)?);
    let (mut plans, mut exact) = (plans.policy()?, exact.policy()?);
    let found = agreement(plans.as_mut(), exact.as_mut(), recording).map_err(failed)?;
    Ok(Compared::new(format!("{} plan against exact plan", profile.name()), vec![found.into()]))
}

impl Compared {
    fn new(name: String, families: Vec<Comparison>) -> Self {
        let judged = || families.iter().filter(|family| family.judged);
        let sum = |count: fn(&Comparison) -> usize| judged().map(count).sum();
        Self {
            name,
            inputs: sum(|family| family.inputs),
            max_rel_error: judged().map(|family| family.max_rel_error).fold(0.0, f32::max),
            max_distance: judged().filter_map(|family| family.max_distance).reduce(f64::max),
            action_mismatches: sum(|family| family.action_mismatches),
            refused: sum(|family| family.refused),
            refusals_differ: sum(|family| family.refusals_differ),
            swallowed: sum(|family| family.swallowed),
            families,
        }
    }
}
