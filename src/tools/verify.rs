//! `sortie verify`: do the plan, tract, onnxruntime and the recorded answers agree?

mod golden;
mod networks;
mod recorded;
mod team;
mod verdict;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_bundle::{Bundle, POLICY, Recording};
use sortie_cli::deployment::open_bundle;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::foreign::PolicyArguments;
use sortie_cli::output::{Common, print_json, tell};
use sortie_cli::policy::{DeployedPolicy, PlanProfile};
use sortie_cli::remake::read_observations;
use sortie_cli::terminal;
use sortie_cli::tools::{OnnxRuntimeArguments, compiler, engines, plans};
use sortie_cli::trust::TrustArguments;
use sortie_core::plan::Profile;
use sortie_plans::{
    BundlePlans, Comparison, CompileError, CompilerProcess, GraphEngine, OnnxRuntimeEngine,
    PolicyOptions, agreement, read_onnx,
};

pub(crate) use self::golden::distances;

/// What the reference evaluator is called in reports.
const DOUBLE: &str = "double precision";

/// Compare plans with tract, with onnxruntime and with a bundle's golden observations and allocations
///
/// Inputs are random ones of all mask patterns, and families that tend to break engines: nothing or everything
/// visible, denormals, huge values, NaN and others. Exit code 1 if the plan is further from its network in double
/// precision than the rounding of 32 bits accounts for, if only one of both answers, or if a golden action or allocation
/// is not chosen; that another engine is off is a note. An int8 plan fails where it takes another action in more than
/// 0.5 % of the golden and of the recorded observations.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie verify models/save-the-city --inputs 10000
  sortie verify models/save-the-city --python venv/bin/python3
  sortie verify models/better --trust keys/
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
    trust: TrustArguments,
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
    } else {
        verdict::print(&report);
    }
    match arguments.profile {
        PlanProfile::Int8 if !report.is_policy => verdict::judge_actions(&report),
        _ => verdict::judge(&report.engines),
    }
}

fn compare(arguments: &VerifyArguments) -> Result<Report, Failure> {
    let subject = &arguments.subject;
    arguments.trust.wants_bundle(subject)?;
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
    let mut engines = Vec::new();
    let spinner = terminal::spinner(arguments.common);
    spinner.set_message("comparing the plans with their graphs");
    if subject.is_dir() || !subject.exists() {
        let bundle = open_bundle(subject)?;
        if let Some(signer) = arguments.trust.signer(&bundle)?
            && !arguments.common.quiet
        {
            tell!("note: signed by {signer}");
        }
        let profile = arguments.profile.profile();
        if wanted(Peer::Tract) || wanted(Peer::Onnxruntime) {
            if bundle.options().is_some() || bundle.manifest().network.agent == POLICY {
                engines.extend(team::judged(arguments, &bundle, profile, &judges)?);
            } else {
                engines.extend(networks::agents(arguments, &bundle, profile, &judges)?);
            }
            engines.extend(networks::allocators(arguments, &bundle, &judges)?);
            engines.extend(team::pointing(arguments, &bundle, &judges)?);
        }
        if wanted(Peer::Golden) {
            spinner.set_message("comparing with golden answers");
            engines.extend(golden::judged(arguments, &bundle, judges.runtime, profile)?);
        }
        if let Some(file) = &arguments.observations {
            spinner.set_message("comparing on recorded observations");
            let recording = read_observations(file, &bundle)?;
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
        engines.extend(networks::file(arguments, &onnx, &judges)?);
    }
    spinner.finish_and_clear();
    Ok(Report { engines, not_compared: judges.missing(), engine: None, is_policy: false })
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

/// Plans whatever they answer: how far they are from what was recorded is what this verb tells.
fn unproved() -> BundlePlans<CompilerProcess> {
    plans().without_proof()
}

fn within(subject: &Path) -> impl Fn(CompileError) -> Failure {
    move |error| Failure::from(error).within(subject.display())
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
