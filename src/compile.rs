//! `sortie compile`: an ONNX network becomes a plan, proved against its source.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_compiler::{CompileError, CompileOptions, Report};
use sortie_core::plan::Profile;

use crate::arguments::Common;
use crate::compiler::compiler;
use crate::failure::{Failure, Outcome};
use crate::output::{Table, print_json};

/// Compile an ONNX network to a plan for the runtime core
///
/// The plan is compared with the graph on random observations of all mask patterns and refused where
/// they differ by more than 1e-5 relative. Prints what the plan will cost: flash, arena, work.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  sortie compile models/save-the-city/agent.onnx -o agent.plan --n-max 11"
)]
pub(crate) struct CompileArguments {
    /// The network
    onnx: PathBuf,
    /// Where to write the plan
    #[arg(short, long, value_name = "PLAN")]
    output: PathBuf,
    /// Most visible entities, which sizes the arena
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u16).range(1..=128))]
    n_max: u16,
    /// How the plan computes
    #[arg(long, value_enum, default_value_t = PlanProfile::Exact)]
    profile: PlanProfile,
    #[command(flatten)]
    common: Common,
}

/// An arithmetic profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PlanProfile {
    /// The same bits on every target
    Exact,
    /// Fused multiply-add: faster for teams, the same bits on every target that has the instruction
    Fused,
}

impl PlanProfile {
    /// As the plan's header has it.
    pub(crate) fn profile(self) -> Profile {
        match self {
            Self::Exact => Profile::Exact,
            Self::Fused => Profile::Fused,
        }
    }
}

#[derive(Serialize)]
struct Written<'a> {
    plan: &'a Path,
    #[serde(flatten)]
    report: &'a Report,
}

#[derive(Serialize)]
struct Refused<'a> {
    error: Refusal<'a>,
}

#[derive(Serialize)]
struct Refusal<'a> {
    message: String,
    node: Option<&'a str>,
    operator: Option<&'a str>,
    shapes: Option<&'a str>,
    hint: Option<&'a str>,
}

pub(crate) fn run(arguments: &CompileArguments) -> Outcome {
    let path = &arguments.onnx;
    let onnx = fs::read(path).map_err(|error| Failure::file(path, &error))?;
    let options = CompileOptions {
        n_max: arguments.n_max.into(),
        profile: arguments.profile.profile(),
        seed: arguments.common.seed,
        ..CompileOptions::default()
    };
    let compiled = compiler().compile(&onnx, &options).map_err(|error| {
        if arguments.common.json {
            print_json(&Refused { error: refusal(&error) });
        }
        Failure::from(error).within(path.display())
    })?;
    let plan = &arguments.output;
    fs::write(plan, &compiled.bytes).map_err(|error| Failure::file(plan, &error))?;
    if arguments.common.json {
        print_json(&Written { plan, report: &compiled.report });
    } else if !arguments.common.quiet {
        print(plan, &compiled.report);
    }
    Ok(())
}

fn refusal(error: &CompileError) -> Refusal<'_> {
    let message = error.to_string();
    match error {
        CompileError::Unsupported { node, operator, shapes, hint } => Refusal {
            message,
            node: Some(node),
            operator: Some(operator),
            shapes: Some(shapes),
            hint: Some(hint),
        },
        _ => Refusal { message, node: None, operator: None, shapes: None, hint: None },
    }
}

fn print(plan: &Path, report: &Report) {
    println!(
        "{}: {} bytes of flash, {} bytes of arena, {} more for every further agent of a team",
        plan.display(),
        report.flash_bytes,
        report.arena_bytes,
        report.arena_bytes_per_agent
    );
    println!(
        "largest error against the graph {:.1e} on {} inputs, {} other actions",
        report.max_rel_error, report.inputs, report.action_mismatches
    );
    let mut table = Table::new(&["operator", "sizes", "multiply-adds"]);
    for operator in &report.operators {
        let row = [operator.name.clone(), operator.detail.clone(), operator.macs.to_string()];
        table.row(row);
    }
    table.row(["all".to_string(), String::new(), report.macs.to_string()]);
    table.print();
}
