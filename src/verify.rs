//! `sortie verify`: do the plan, tract and the recorded answers agree?

use std::fs;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_compiler::{
    Comparison, CompileError, CompileOptions, TOLERANCE, TractTeamValue,
    compare_team_values_with_graph, compare_with_golden, compare_with_golden_allocations,
    compare_with_graph, compile, inspect_plan, random_observations, random_team_queries,
};
use sortie_core::plan::Network;

use crate::allocator::LearnedAllocator;
use crate::arguments::Common;
use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Table, print_json};
use crate::policy::{Backend, DeployedPolicy};

/// Compare plans with tract and with a bundle's golden observations and allocations
///
/// Exit code 1 if any utility or value differs by more than 1e-5 relative, or a golden action or allocation
/// is not chosen.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie verify models/save-the-city --inputs 10000
  sortie verify agent.onnx --against tract")]
pub(crate) struct VerifyArguments {
    /// A bundle's folder or an ONNX file
    subject: PathBuf,
    /// Random observations, of all mask patterns
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..))]
    inputs: u32,
    /// What to compare with; default: all that there is
    #[arg(long, value_enum)]
    against: Option<Peer>,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Peer {
    /// The ONNX graph, run by tract, on random observations
    Tract,
    /// The bundle's golden observations
    Golden,
}

#[derive(Serialize)]
struct Report {
    engines: Vec<Comparison>,
}

pub(crate) fn run(arguments: &VerifyArguments) -> Outcome {
    let wanted = |peer| arguments.against.is_none_or(|against| against == peer);
    let mut engines = Vec::new();
    if arguments.subject.is_dir() || !arguments.subject.exists() {
        let bundle = open_bundle(&arguments.subject)?;
        if wanted(Peer::Tract) {
            let entities = bundle.manifest().limits.n_max.into();
            let features = bundle.contract().features.into();
            engines.push(against_tract(arguments, bundle.agent_onnx(), entities, Some(features))?);
            if let Some(onnx) = bundle.allocator_onnx() {
                engines.push(against_tract(arguments, onnx, entities, None)?);
            }
        }
        if wanted(Peer::Golden) {
            engines.push(against_golden(&bundle, Backend::Plan)?);
            engines.push(against_golden(&bundle, Backend::Tract)?);
            if bundle.allocator_onnx().is_some() {
                engines.push(against_golden_allocations(&bundle, Backend::Plan)?);
                engines.push(against_golden_allocations(&bundle, Backend::Tract)?);
            }
        }
    } else if arguments.against == Some(Peer::Golden) {
        let message = "golden observations belong to a bundle: name its folder";
        return Err(Failure::new(Exit::Usage, message));
    } else {
        let path = &arguments.subject;
        let onnx = fs::read(path).map_err(|error| Failure::file(path, &error))?;
        let entities = CompileOptions::default().n_max;
        engines.push(against_tract(arguments, &onnx, entities, None)?);
    }
    let report = Report { engines };
    if arguments.common.json {
        print_json(&report);
    } else if !arguments.common.quiet {
        print(&report);
    }
    judge(&report)
}

fn against_tract(
    arguments: &VerifyArguments,
    onnx: &[u8],
    n_max: usize,
    features: Option<usize>,
) -> Result<Comparison, Failure> {
    let seed = arguments.common.seed;
    let compare = || -> Result<Comparison, CompileError> {
        let options = CompileOptions { n_max, features, seed, ..CompileOptions::default() };
        let plan = compile(onnx, &options)?.bytes;
        let facts = inspect_plan(&plan)?;
        let inputs = arguments.inputs as usize;
        if facts.network == Network::TeamValue {
            let (features, relations) = TractTeamValue::new(onnx)?.columns();
            let queries = random_team_queries(inputs, n_max, features, relations, seed);
            return compare_team_values_with_graph(&plan, onnx, &queries);
        }
        let observations = random_observations(inputs, n_max, facts.features, facts.actions, seed);
        compare_with_graph(&plan, onnx, &observations)
    };
    compare().map_err(|error| Failure::from(error).within(arguments.subject.display()))
}

fn against_golden(bundle: &Bundle, backend: Backend) -> Result<Comparison, Failure> {
    let name = format!("{} against golden", backend.name());
    let mut policy = DeployedPolicy::open(bundle, backend)?;
    let mut policy = policy.policy()?;
    compare_with_golden(&name, policy.as_mut(), bundle.golden())
        .map_err(|error| Failure::from(error).within(bundle.folder().display()))
}

fn against_golden_allocations(bundle: &Bundle, backend: Backend) -> Result<Comparison, Failure> {
    let name = format!("allocator {} against golden", backend.name());
    let mut allocator = LearnedAllocator::open(bundle, backend)?;
    let mut network = allocator.network()?;
    let team_max = bundle.manifest().limits.team_max.into();
    compare_with_golden_allocations(&name, &mut network, bundle.golden(), team_max)
        .map_err(|error| Failure::from(error).within(bundle.folder().display()))
}

fn print(report: &Report) {
    let mut table = Table::new(&["compared", "inputs", "largest error", "other choices"]);
    for engine in &report.engines {
        table.row([
            engine.name.clone(),
            engine.inputs.to_string(),
            format!("{:.1e}", engine.max_rel_error),
            engine.action_mismatches.to_string(),
        ]);
    }
    table.print();
}

fn judge(report: &Report) -> Outcome {
    let differs = |engine: &&Comparison| {
        let other_action = engine.action_mismatches > 0 && engine.name.ends_with("golden");
        engine.max_rel_error > TOLERANCE || other_action
    };
    match report.engines.iter().find(differs) {
        None => Ok(()),
        Some(engine) => Err(Failure::difference(format!(
            "{}: largest error {:.1e} (limit {TOLERANCE:.0e}), {} other choices",
            engine.name, engine.max_rel_error, engine.action_mismatches
        ))),
    }
}
