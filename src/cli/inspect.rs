//! `sortie inspect`: the facts of a bundle, a plan, an ONNX file or a training run.

mod run;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::{ALLOCATOR, AgentGraph, Bundle, MANIFEST, Manifest, TRAINING, hex};
use sortie_core::plan::{Normaliser, Profile, Proof, RobotFacts};
use sortie_plans::{
    CompileError, CompileOptions, CompiledPolicy, InspectedOnnx, OnnxFacts, PlanFacts, PolicyFacts,
    PolicyOptions, inspect_plan, is_plan, read_plan_or_onnx,
};

use crate::deployment::open_bundle;
use crate::failure::{Exit, Failure, Outcome};
use crate::foreign::{ENGINE, PolicyArguments};
use crate::guards;
use crate::output::{Common, Table, plural, print_json, say, tell};
use crate::tools::compiler;

/// The name of the graph by which all agents decide.
const OF_ALL: &str = "";

/// Show what a bundle, a plan, an ONNX file or a training run holds, after checking it
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie inspect models/save-the-city
  sortie inspect models/save-the-city/agent.onnx --json
  sortie inspect walking.onnx --output actions
  sortie inspect runs/first")]
pub(crate) struct InspectArguments {
    /// The folder of a bundle or of a training run, a plan, or an ONNX file
    file: PathBuf,
    #[command(flatten)]
    common: Common,
    // Last: what follows would stand under its heading.
    #[command(flatten)]
    policy: PolicyArguments,
}

#[derive(Serialize)]
struct BundleFacts<'a> {
    bundle: String,
    sha256: String,
    #[serde(flatten)]
    manifest: &'a Manifest,
    golden_cases: usize,
    golden_allocations: usize,
    /// The ranges in which features must lie, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    guards: BTreeMap<&'a str, [f32; 2]>,
    /// The graph of all agents.
    #[serde(skip_serializing_if = "Option::is_none")]
    agent: Option<OnnxFacts>,
    /// The graphs that agents decide by where there are several, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    agents: BTreeMap<String, OnnxFacts>,
    #[serde(skip_serializing_if = "Option::is_none")]
    allocator: Option<OnnxFacts>,
}

pub(crate) fn run(arguments: &InspectArguments) -> Outcome {
    let (path, json) = (&arguments.file, arguments.common.json);
    let is_run = path.join(TRAINING).exists() && !path.join(MANIFEST).exists();
    if is_run || path.is_dir() || !path.exists() {
        // What is not there is worse than flags that it has no use for.
        if path.exists() {
            arguments.refuse_policy()?;
        }
        return if is_run { run::inspect(path, json) } else { inspect_bundle(path, json) };
    }
    let bytes = read_plan_or_onnx(path).map_err(|error| Failure::file(path, &error))?;
    if is_plan(&bytes) {
        arguments.refuse_policy()?;
        let facts = inspect_plan(&bytes);
        let facts = facts.map_err(|error| Failure::from(error).within(path.display()))?;
        if json {
            print_json(&facts)
        } else {
            print_plan(&facts)
        }
        return Ok(());
    }
    inspect_onnx(arguments, &bytes)
}

impl InspectArguments {
    /// Refuses flags that only ONNX files have a use for.
    fn refuse_policy(&self) -> Outcome {
        if self.policy.options() == PolicyOptions::default() {
            return Ok(());
        }
        let message = "inputs and outputs are named for ONNX files only: leave these flags out";
        Err(Failure::new(Exit::Usage, message))
    }
}

/// Shows a file; what must be said about it before it is a policy comes last.
fn inspect_onnx(arguments: &InspectArguments, bytes: &[u8]) -> Outcome {
    let within = |error| Failure::from(error).within(arguments.file.display());
    let options = arguments.policy.options_for(&arguments.file)?;
    let inspected = compiler().inspect(bytes, &options).map_err(within)?;
    let InspectedOnnx { facts, policy, remarks } = inspected;
    let policy = policy.transpose();
    let known = policy.as_ref().ok().and_then(Option::as_ref);
    let plan =
        known.map(|_| compiler().compile_policy(bytes, &options, &CompileOptions::default()));
    if arguments.common.json {
        print_json(&Report { remarks: &remarks, ..Report::of(&facts, known, plan.as_ref()) });
    } else {
        print(&facts, known, plan.as_ref());
    }
    remarks.iter().for_each(|remark| tell!("note: {remark}"));
    policy.map(|_| ()).map_err(within)
}

fn inspect_bundle(path: &Path, json: bool) -> Outcome {
    let bundle = open_bundle(path)?;
    let inspect = |name: &str, onnx: &[u8]| {
        let facts = compiler().inspect_onnx(onnx);
        facts.map_err(|error| Failure::from(error).within(path.join(name).display()))
    };
    let graphs = bundle.agent_graphs().into_iter().map(|graph| {
        let facts = inspect(&graph.onnx_part(), bundle.graph_onnx(&graph))?;
        Ok((graph.name, facts))
    });
    let mut agents = graphs.collect::<Result<BTreeMap<_, _>, Failure>>()?;
    let names = bundle.contract().feature_names.iter().map(String::as_str);
    let facts = BundleFacts {
        bundle: path.display().to_string(),
        sha256: hex(bundle.id()),
        manifest: bundle.manifest(),
        golden_cases: bundle.golden().cases.len(),
        golden_allocations: bundle.golden().allocations.len(),
        guards: names.zip(bundle.guards().iter().copied()).collect(),
        agent: agents.remove(OF_ALL),
        agents,
        allocator: bundle.allocator_onnx().map(|onnx| inspect(ALLOCATOR, onnx)).transpose()?,
    };
    if json {
        print_json(&facts);
    } else {
        print_bundle(&facts, &bundle);
    }
    Ok(())
}

/// Facts by name, one a line: a name is a word, so that `awk '$1 == "id" { print $2 }'` finds it.
fn table_of_facts() -> Table {
    Table::of_text(&["fact", "value"])
}

fn print_bundle(facts: &BundleFacts<'_>, bundle: &Bundle) {
    let (contract, limits) = (bundle.contract(), &facts.manifest.limits);
    let mut table = table_of_facts();
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("bundle", facts.bundle.clone());
    row("id", facts.sha256.clone());
    row("environment", facts.manifest.contract.environment.name.clone());
    row("contract", facts.manifest.contract.hash.clone());
    row("features", contract.features.to_string());
    row("actions", contract.actions.to_string());
    row("entities", format!("at most {}", limits.n_max));
    row("subtasks", format!("at most {}", limits.t_max));
    row("team", format!("at most {}", limits.team_max));
    row("network", facts.manifest.network.agent.clone());
    let allocator = facts.manifest.network.allocator.as_deref();
    for (index, graph) in facts.manifest.network.graphs.iter().enumerate() {
        row(&format!("graph_{}", graph.name), graph_fact(bundle, graph, index));
    }
    row("allocator", allocator.unwrap_or("none learned").to_string());
    row("golden", golden(facts));
    let is_limited = |range: &&[f32; 2]| range.iter().any(|limit| limit.is_finite());
    match facts.guards.values().filter(is_limited).count() {
        0 => {}
        guarded => row("guarded", format!("{guarded} of {} features", contract.features)),
    }
    table.print();
    say!();
    let mut parts = Table::of_text(&["part", "SHA-256, first half"]);
    for (name, hash) in &facts.manifest.parts {
        parts.row([name.clone(), hash.chars().take(32).collect()]);
    }
    parts.print();
}

/// Who decides by a graph, and on what.
fn graph_fact(bundle: &Bundle, graph: &AgentGraph, index: usize) -> String {
    let graph_of = bundle.manifest().network.graph_of.iter().enumerate();
    let agents = graph_of.filter(|(_, of)| usize::from(**of) == index);
    let agents: Vec<String> = agents.map(|(agent, _)| agent.to_string()).collect();
    let AgentGraph { features, actions, .. } = graph;
    format!("{features} features, {actions} actions, agents {}", agents.join(" "))
}

fn golden(facts: &BundleFacts<'_>) -> String {
    let observations = plural(facts.golden_cases, "observation");
    format!("{observations}, {}", plural(facts.golden_allocations, "allocation"))
}

fn print_plan(facts: &PlanFacts) {
    let mut table = table_of_facts();
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("network", facts.network.name().to_string());
    row("profile", facts.profile.to_string());
    row("flash", format!("{} bytes", facts.flash_bytes));
    row("arena", format!("{} bytes", facts.arena_bytes));
    row("arena_per_agent", format!("{} bytes more", facts.arena_bytes_per_agent));
    row("entities", format!("at most {}", facts.n_max));
    row("features", facts.features.to_string());
    row("actions", facts.actions.to_string());
    row("multiply-adds", facts.macs.to_string());
    match facts.proof {
        Proof::Distance { max_distance, inputs } => {
            let is_int8 = facts.profile == Profile::Int8.name();
            let limit = if is_int8 { "" } else { " of at most 16" };
            row("rounding", format!("{max_distance:.1}{limit}, on {inputs} inputs"));
        }
        Proof::Error { max_rel_error } => row("largest_error", format!("{max_rel_error:.1e}")),
    }
    row("contract", facts.contract.clone());
    row("source", facts.source.clone());
    if let Some(agreement) = facts.policy.as_ref().and_then(|policy| policy.agreement.as_ref()) {
        let same = format!("same actions on {:.3} %", 100.0 * agreement.share());
        let (deviation, observations) = (agreement.largest_deviation(), agreement.observations);
        let error = format!("largest error {deviation:.3} of what an action varies by");
        row("int8", format!("{same} of {observations} observations, {error}"));
    }
    for (name, value) in facts.policy.iter().flat_map(|policy| &policy.metadata) {
        row(name, value.clone());
    }
    if let Some(robot) = &facts.robot {
        row("normaliser", normaliser(robot).to_owned());
    }
    for (name, words) in facts.guards.iter().flat_map(guards::lines) {
        row(name, words);
    }
    table.print();
    say!();
    if let Some(policy) = &facts.policy {
        print_roles(&policy.facts);
        say!();
    }
    let mut operators = Table::of_text(&["operator", "sizes"]);
    for operator in &facts.operators {
        operators.row([operator.name.clone(), operator.detail.clone()]);
    }
    operators.print();
}

/// Whether whoever calls the policy has to normalise what it sees.
fn normaliser(robot: &RobotFacts) -> &'static str {
    match robot.normaliser {
        Normaliser::Unknown => "not known",
        Normaliser::None => "none",
        Normaliser::File => "in the file",
    }
}

/// What is known of a file. A policy has more keys.
#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    facts: &'a OnnxFacts,
    #[serde(skip_serializing_if = "Option::is_none")]
    policy: Option<&'a PolicyFacts>,
    /// What runs it.
    #[serde(skip_serializing_if = "Option::is_none")]
    engine: Option<&'static str>,
    /// What its plan costs.
    #[serde(skip_serializing_if = "Option::is_none")]
    plan: Option<PlanCost>,
    /// What a robot must know of it beside the numbers, as its plan has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<RobotFacts>,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    remarks: &'a [String],
}

/// What the plan of a policy costs.
#[derive(Serialize)]
struct PlanCost {
    flash_bytes: usize,
    arena_bytes: usize,
}

/// A file with a policy that has no plan is run by tract.
type Plan<'a> = Option<&'a Result<CompiledPolicy, CompileError>>;

impl<'a> Report<'a> {
    fn of(facts: &'a OnnxFacts, policy: Option<&'a PolicyFacts>, plan: Plan<'_>) -> Self {
        let cost = |plan: &CompiledPolicy| {
            let report = &plan.compiled.report;
            PlanCost { flash_bytes: report.flash_bytes, arena_bytes: report.arena_bytes }
        };
        let engine = plan.map(|plan| if plan.is_ok() { "plan" } else { ENGINE });
        let compiled = plan.and_then(|plan| plan.as_ref().ok());
        let robot = compiled.and_then(|plan| RobotFacts::of_plan(&plan.compiled.bytes));
        Self { facts, policy, engine, plan: compiled.map(cost), robot, remarks: &[] }
    }
}

fn print(facts: &OnnxFacts, policy: Option<&PolicyFacts>, plan: Plan<'_>) {
    print_facts(facts, policy, plan);
    say!();
    print_values(facts, policy);
    say!();
    print_operators("operator", &facts.operators);
    if let Some(policy) = policy {
        say!();
        print_operators("simplified", &policy.operators);
    }
}

fn print_facts(facts: &OnnxFacts, policy: Option<&PolicyFacts>, plan: Plan<'_>) {
    let mut table = table_of_facts();
    let mut row = |name: &str, value: String| table.row([name.to_string(), value]);
    row("producer", facts.producer.clone());
    row("opset", facts.opset.to_string());
    row("ir_version", facts.ir_version.to_string());
    row("parameters", facts.parameters.to_string());
    if let Some(policy) = policy {
        row("parameters_needed", policy.parameters.to_string());
        let countable = policy.multiply_adds.map(|count| count.to_string());
        row("multiply-adds", countable.unwrap_or_else(|| "not countable".to_string()));
        for state in &policy.states {
            let names = format!("`{}` comes back as `{}`", state.input, state.output);
            row("state", format!("{names}, {} numbers", state.length));
        }
    }
    match plan {
        Some(Ok(plan)) => {
            let report = &plan.compiled.report;
            let (flash, arena) = (report.flash_bytes, report.arena_bytes);
            row("plan", format!("{flash} bytes of flash, {arena} bytes of arena"));
            if let Some(robot) = RobotFacts::of_plan(&plan.compiled.bytes) {
                row("normaliser", normaliser(&robot).to_owned());
            }
        }
        Some(Err(error)) => {
            row("plan", format!("none: {error}"));
            row("engine", ENGINE.to_string());
        }
        None => {}
    }
    for (name, value) in &facts.metadata {
        row(name, value.clone());
    }
    table.print();
}

fn print_values(facts: &OnnxFacts, policy: Option<&PolicyFacts>) {
    let mut header = vec!["tensor", "name", "shape"];
    header.extend(policy.map(|_| "role"));
    let mut tensors = Table::of_text(&header);
    for (kind, named) in [("input", &facts.inputs), ("output", &facts.outputs)] {
        for (name, shape) in named {
            let role = policy.map(|policy| role(policy, kind, name));
            let cells = [kind.to_owned(), name.clone(), shape.clone()];
            tensors.row(cells.into_iter().chain(role));
        }
    }
    tensors.print();
}

/// The inputs and outputs of a policy, as its plan has them.
fn print_roles(policy: &PolicyFacts) {
    let mut tensors = Table::of_text(&["tensor", "name", "shape", "role"]);
    for input in &policy.inputs {
        let shape = format!("{} {:?}", input.kind.name(), input.shape);
        tensors.row(["input".to_owned(), input.name.clone(), shape, input.role.name().to_owned()]);
    }
    for output in &policy.outputs {
        let shape = format!("{} {:?}", output.kind.name(), output.shape);
        tensors.row(["output".to_owned(), output.name.clone(), shape, output.role.to_string()]);
    }
    tensors.print();
}

/// What an input or output is for; those that are not needed have no role.
fn role(policy: &PolicyFacts, kind: &str, name: &str) -> String {
    let input = policy.inputs.iter().find(|input| kind == "input" && input.name == name);
    let output = policy.outputs.iter().find(|output| kind == "output" && output.name == name);
    let input = input.map(|input| input.role.name().to_owned());
    let role = input.or_else(|| output.map(|output| output.role.to_string()));
    role.unwrap_or_else(|| "not needed".to_owned())
}

fn print_operators(name: &str, operators: &std::collections::BTreeMap<String, usize>) {
    let mut table = Table::new(&[name, "count"]);
    for (operator, count) in operators {
        table.row([operator.clone(), count.to_string()]);
    }
    table.print();
}
