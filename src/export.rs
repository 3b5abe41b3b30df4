//! `sortie export`: a training run becomes a bundle.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use sortie_bundle::hex;
use sortie_learn::evaluate::{Allocate, EvaluationPlan, evaluate};
use sortie_learn::export::{LearnedAllocator, Measured, check_exportable, draft_bundle};
use sortie_learn::methods::alma::team_value::TeamValueAllocator;
use sortie_learn::run::Run;

use crate::arguments::{Allocation, Common};
use crate::failure::Outcome;
use crate::output::{print_json, warn_of_refused};

/// Export a training run as a bundle: networks as ONNX, contract, golden observations, card and curve
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
    check_exportable(&run)?;
    let (set, seed) = (&run.description.config.environment.set, arguments.common.seed);
    let plan = EvaluationPlan::new(set, arguments.episodes as usize, seed)?;
    let mut measured = Vec::new();
    let mut measure = |name: &str, allocator: &mut dyn Allocate| -> Outcome {
        let evaluation = evaluate(&plan, &mut run.team(), allocator)?;
        measured.push(Measured { allocation: name.to_string(), evaluation });
        Ok(())
    };
    if let Some(LearnedAllocator { network, team_max }) = LearnedAllocator::of(&run) {
        measure("learned", &mut TeamValueAllocator::new(network, team_max))?;
    }
    for allocation in [Allocation::Coordinated, Allocation::Heuristic] {
        measure(allocation.name(), &mut allocation.rule())?;
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
