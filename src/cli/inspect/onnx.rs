//! What an ONNX file holds, the policy that it is, and what its plan costs.

use serde::Serialize;
use sortie_plans::{CompileError, CompiledPolicy, OnnxFacts, PolicyFacts};

use crate::foreign::ENGINE;
use crate::output::{Table, say};

/// What is known of a file. A policy has more keys.
#[derive(Serialize)]
pub(super) struct Report<'a> {
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
    pub(super) fn of(
        facts: &'a OnnxFacts,
        policy: Option<&'a PolicyFacts>,
        plan: Plan<'_>,
    ) -> Self {
        let cost = |plan: &CompiledPolicy| {
            let report = &plan.compiled.report;
            PlanCost { flash_bytes: report.flash_bytes, arena_bytes: report.arena_bytes }
        };
        let engine = plan.map(|plan| if plan.is_ok() { "plan" } else { ENGINE });
        Self { facts, policy, engine, plan: plan.and_then(|plan| plan.as_ref().ok().map(cost)) }
    }
}

pub(super) fn print(facts: &OnnxFacts, policy: Option<&PolicyFacts>, plan: Plan<'_>) {
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
    let mut table = super::facts();
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
pub(super) fn print_roles(policy: &PolicyFacts) {
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
