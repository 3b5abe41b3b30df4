//! `sortie export`: a training run becomes a bundle.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sortie_bundle::hex;
use sortie_learn::evaluate::{EvaluationPlan, evaluate};
use sortie_learn::export::{Measured, check_deployable, draft_bundle};
use sortie_learn::run::Run;

use crate::arguments::{Allocation, Common};
use crate::failure::Outcome;
use crate::output::{print_json, warn_of_refused};

/// Export a training run as a bundle: network as ONNX, contract, golden observations, card and curve
///
/// The averaged weights are evaluated first, over fresh greedy episodes; the card tells the result.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  sortie export runs/first --out models/first")]
pub(crate) struct ExportArguments {
    /// Folder of the run
    run: PathBuf,
    /// Folder of the new bundle
    #[arg(long, value_name = "BUNDLE")]
    out: PathBuf,
    /// Episodes to evaluate for the card
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    bundle: PathBuf,
    sha256: String,
}

pub(crate) fn run(arguments: &ExportArguments) -> Outcome {
    let run = Run::open(&arguments.run)?;
    warn_of_refused(&run.refused);
    check_deployable(&run)?;
    let (set, seed) = (&run.description.config.environment.set, arguments.common.seed);
    let plan = EvaluationPlan::new(set, arguments.episodes as usize, seed)?;
    let mut measured = Vec::new();
    for allocation in [Allocation::Coordinated, Allocation::Heuristic] {
        let mut team = run.team();
        let evaluation = evaluate(&plan, &mut team, &mut allocation.rule())?;
        measured.push(Measured { allocation: allocation.name().to_string(), evaluation });
    }
    let draft = draft_bundle(&run, &arguments.run, &measured, seed)?;
    let bundle = draft.write(&arguments.out)?;
    let report = Report { bundle: arguments.out.clone(), sha256: hex(bundle.id()) };
    if arguments.common.json {
        print_json(&report);
    } else if !arguments.common.quiet {
        println!("{}: {}", report.bundle.display(), report.sha256);
    }
    Ok(())
}
