//! `sortie inspect`: the facts of a bundle, a plan, an ONNX file or a training run.

mod run;

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::{AGENT, ALLOCATOR, Bundle, MANIFEST, Manifest, TRAINING, hex};
use sortie_plans::{OnnxFacts, PlanFacts, inspect_plan};

use crate::arguments::Common;
use crate::compiler::compiler;
use crate::deployment::open_bundle;
use crate::failure::{Failure, Outcome};
use crate::output::{Table, print_json};

/// First bytes of every plan.
const PLAN_MAGIC: &[u8] = b"SORTIEPL";

/// Show what a bundle, a plan, an ONNX file or a training run holds, after checking it
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie inspect models/save-the-city
  sortie inspect models/save-the-city/agent.onnx --json
  sortie inspect runs/first")]
pub(crate) struct InspectArguments {
    /// The folder of a bundle or of a training run, a plan, or an ONNX file
    file: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct BundleFacts<'a> {
    bundle: String,
    sha256: String,
    #[serde(flatten)]
    manifest: &'a Manifest,
    golden_cases: usize,
    golden_allocations: usize,
    agent: OnnxFacts,
    #[serde(skip_serializing_if = "Option::is_none")]
    allocator: Option<OnnxFacts>,
}

pub(crate) fn run(arguments: &InspectArguments) -> Outcome {
    let path = &arguments.file;
    if path.join(TRAINING).exists() && !path.join(MANIFEST).exists() {
        return run::inspect(path, arguments.common.json);
    }
    if path.is_dir() || !path.exists() {
        return inspect_bundle(path, arguments.common.json);
    }
    let bytes = fs::read(path).map_err(|error| Failure::file(path, &error))?;
    let within = |error| Failure::from(error).within(path.display());
    if bytes.starts_with(PLAN_MAGIC) {
        let facts = inspect_plan(&bytes).map_err(within)?;
        show(arguments.common.json, &facts, print_plan);
    } else {
        let facts = compiler().inspect_onnx(&bytes).map_err(within)?;
        show(arguments.common.json, &facts, print_onnx);
    }
    Ok(())
}

fn show<F: Serialize>(json: bool, facts: &F, print: fn(&F)) {
    if json { print_json(facts) } else { print(facts) }
}

fn inspect_bundle(path: &Path, json: bool) -> Outcome {
    let bundle = open_bundle(path)?;
    let inspect = |name: &str, onnx: &[u8]| {
        let facts = compiler().inspect_onnx(onnx);
        facts.map_err(|error| Failure::from(error).within(path.join(name).display()))
    };
    let facts = BundleFacts {
        bundle: path.display().to_string(),
        sha256: hex(bundle.id()),
        manifest: bundle.manifest(),
        golden_cases: bundle.golden().cases.len(),
        golden_allocations: bundle.golden().allocations.len(),
        agent: inspect(AGENT, bundle.agent_onnx())?,
        allocator: bundle.allocator_onnx().map(|onnx| inspect(ALLOCATOR, onnx)).transpose()?,
    };
    if json {
        print_json(&facts);
    } else {
        print_bundle(&facts, &bundle);
    }
    Ok(())
}

fn print_bundle(facts: &BundleFacts<'_>, bundle: &Bundle) {
    let (contract, limits) = (bundle.contract(), &facts.manifest.limits);
    let mut table = Table::new(&["fact", ""]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("bundle", facts.bundle.clone());
    row("id", facts.sha256.clone());
    row("environment", facts.manifest.contract.environment.name.clone());
    row("contract", facts.manifest.contract.hash.clone());
    row("features, actions", format!("{}, {}", contract.features, contract.actions));
    row("most entities, subtasks", format!("{}, {}", limits.n_max, limits.t_max));
    row("network", facts.manifest.network.agent.clone());
    let allocator = facts.manifest.network.allocator.as_deref();
    row("allocator", allocator.unwrap_or("none learned").to_string());
    row("largest team", limits.team_max.to_string());
    row("golden observations", facts.golden_cases.to_string());
    row("golden allocations", facts.golden_allocations.to_string());
    for (name, hash) in &facts.manifest.parts {
        row(name, hash.clone());
    }
    table.print();
}

fn print_plan(facts: &PlanFacts) {
    let mut table = Table::new(&["fact", ""]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("network", facts.network.name().to_string());
    row("profile", facts.profile.to_string());
    row("flash bytes", facts.flash_bytes.to_string());
    row("arena bytes", facts.arena_bytes.to_string());
    row("arena bytes per further agent", facts.arena_bytes_per_agent.to_string());
    row("most visible entities", facts.n_max.to_string());
    row("features, actions", format!("{}, {}", facts.features, facts.actions));
    row("multiply-adds", facts.macs.to_string());
    row("largest error", format!("{:.1e}", facts.max_rel_error));
    row("contract", facts.contract.clone());
    row("made from", facts.source.clone());
    for operator in &facts.operators {
        row(&operator.name, operator.detail.clone());
    }
    table.print();
}

fn print_onnx(facts: &OnnxFacts) {
    let mut table = Table::new(&["fact", ""]);
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("producer", facts.producer.clone());
    row("opset, IR", format!("{}, {}", facts.opset, facts.ir_version));
    row("parameters", facts.parameters.to_string());
    for (name, shape) in &facts.inputs {
        row(&format!("input {name}"), shape.clone());
    }
    for (name, shape) in &facts.outputs {
        row(&format!("output {name}"), shape.clone());
    }
    for (name, value) in &facts.metadata {
        row(name, value.clone());
    }
    for (operator, count) in &facts.operators {
        row(operator, count.to_string());
    }
    table.print();
}
