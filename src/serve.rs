//! `sortie serve`: a policy decides for a robot's program, over shared memory.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_ipc::{
    Domain, Fallback, PolicySchema, PolicyServer, Port, RealTime, ServeCounters, ServeSettings,
    Served,
};
use sortie_plans::{Annex, CompileError, CompileOptions, read_onnx};

use crate::compiler::compiler;
use crate::engines::check_program;
use crate::failure::{Failure, Outcome};
use crate::foreign::PolicyArguments;
use crate::latency::{Latency, Percentiles};
use crate::options::Common;
use crate::output::{Table, print_json, say};
use crate::signals::stop_on_signals;

/// What plans begin with.
const PLAN: &[u8] = b"SORTIEPL";

/// Serve a policy in shared memory: a robot's program sends observations and gets actions
///
/// Keeps the recurrent state, and says of every answer whether it came in time. Robots connect with
/// `sortie_ipc::PolicyClient`. Ends with Ctrl-C and leaves nothing in shared memory.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie serve walking.plan
  sortie serve walking.plan --domain legs --deadline-ms 2 --fallback zero
  sortie serve walking.onnx --rt 50 --core 1 --json")]
pub(crate) struct ServeArguments {
    /// A policy's plan, or its ONNX file, which is compiled first
    #[arg(value_name = "PLAN|ONNX")]
    policy: PathBuf,
    /// Name by which robots find it; keeps it apart from all others on the host
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// Milliseconds that robots wait for an answer, unless they say otherwise
    #[arg(long, default_value_t = 20.0, value_name = "MS", value_parser = milliseconds)]
    deadline_ms: f64,
    /// What robots do without an answer: `hold` the last, `zero`, or the number of an action
    #[arg(long, default_value_t = Fallback::Hold, value_name = "hold|zero|ACTION")]
    fallback: Fallback,
    /// The core that it decides on
    #[arg(long, value_name = "CORE")]
    core: Option<usize>,
    /// Real-time priority: before all ordinary work, in memory that stays
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    rt: Option<u8>,
    /// Microseconds that it looks for an observation before it sleeps
    #[arg(long, default_value_t = 100, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    linger_us: u64,
    #[command(flatten)]
    foreign: PolicyArguments,
    #[command(flatten)]
    common: Common,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(ms) if ms > 0.0 && ms <= 3_600_000.0 => Ok(ms),
        _ => Err("expected milliseconds above 0 and up to 3600000".to_string()),
    }
}

#[derive(Serialize)]
struct Summary<'a> {
    policy: &'a Path,
    domain: &'a str,
    answered: u64,
    late: u64,
    fallbacks: u64,
    refused: u64,
    missed: u64,
    sessions: u64,
    resets: u64,
    failed_sends: u64,
    /// From the sending of an observation to the server running, in microseconds.
    wake_us: Option<Percentiles>,
    /// The decision alone.
    decide_us: Option<Percentiles>,
}

pub(crate) fn run(arguments: &ServeArguments) -> Outcome {
    let ServeArguments { policy, common, .. } = arguments;
    let stop = stop_on_signals()?;
    let domain = Domain::new(&arguments.domain)?;
    let bytes = open_plan(arguments)?;
    let within = |failure: Failure| failure.within(policy.display());
    let plan = Plan::load(bytes.as_slice())
        .map_err(|error| within(Failure::from(CompileError::from(error))))?;
    let schema = schema(&plan, bytes.as_slice()).map_err(within)?;
    let settings = ServeSettings {
        deadline: Duration::from_secs_f64(arguments.deadline_ms / 1000.0),
        fallback: arguments.fallback,
        linger: Some(Duration::from_micros(arguments.linger_us)),
        real_time: RealTime { priority: arguments.rt, core: arguments.core },
    };
    let taken = describe(&schema);
    let mut server = PolicyServer::open(&domain, schema, &settings)?;
    if !common.json && !common.quiet {
        say!("{}: {taken}", policy.display());
        say!("serving in domain `{}`; Ctrl-C ends it", domain.id());
    }
    let (mut wake, mut decide) = (Latency::new(), Latency::new());
    let mut observe = |served: &Served| {
        wake.record_ns(served.wake_ns);
        decide.record_ns(served.decide_ns);
    };
    let counters = server.serve(&plan, &mut observe, &stop)?;
    drop(server);
    let shown = |latency: &Latency| (latency.samples() > 0).then(|| latency.percentiles());
    report(arguments, &counters, [shown(&wake), shown(&decide)]);
    Ok(())
}

/// The plan of a file: itself, or what the limited process compiles of it.
fn open_plan(arguments: &ServeArguments) -> Result<AlignedBytes, Failure> {
    let path = &arguments.policy;
    let bytes = read_onnx(path).map_err(|error| Failure::file(path, &error))?;
    if bytes.starts_with(PLAN) {
        return Ok(AlignedBytes::copy_of(&bytes));
    }
    check_program()?;
    let options = CompileOptions { seed: arguments.common.seed, ..CompileOptions::default() };
    let compiled = compiler().compile_policy(&bytes, &arguments.foreign.options(), &options);
    let compiled = compiled.map_err(|error| Failure::from(error).within(path.display()))?;
    Ok(AlignedBytes::copy_of(&compiled.compiled.bytes))
}

/// What the plan takes and gives, with the names that stand behind its weights.
fn schema(plan: &Plan<'_>, bytes: &[u8]) -> Result<PolicySchema, Failure> {
    let schema = PolicySchema::of_plan(plan)?;
    let Some(Annex { facts, .. }) = Annex::of_plan(bytes)? else { return Ok(schema) };
    let inputs: Vec<&str> = facts.given().map(|input| input.name.as_str()).collect();
    let outputs: Vec<&str> = facts.wanted().map(|output| output.name.as_str()).collect();
    let states: Vec<&str> = facts.states.iter().map(|state| state.input.as_str()).collect();
    Ok(schema.named(inputs, outputs, states))
}

/// `obs [40], state of 64 -> actions [12]`.
fn describe(schema: &PolicySchema) -> String {
    let list = |ports: &[Port]| {
        let one = |port: &Port| format!("{} [{}]", port.name, port.length).trim_start().to_owned();
        ports.iter().map(one).collect::<Vec<_>>().join(", ")
    };
    let state = match schema.states.iter().map(|state| state.length).sum::<usize>() {
        0 => String::new(),
        numbers => format!(", state of {numbers}"),
    };
    let choice = match schema.actions {
        0 => String::new(),
        actions => format!(", one of {actions} actions"),
    };
    format!("{}{state} -> {}{choice}", list(&schema.inputs), list(&schema.outputs))
}

fn report(
    arguments: &ServeArguments,
    counters: &ServeCounters,
    [wake_us, decide_us]: [Option<Percentiles>; 2],
) {
    let ServeArguments { policy, domain, common, .. } = arguments;
    let ServeCounters {
        answered,
        late,
        fallbacks,
        refused,
        missed,
        sessions,
        resets,
        failed_sends,
    } = *counters;
    if common.json {
        print_json(&Summary {
            policy,
            domain,
            answered,
            late,
            fallbacks,
            refused,
            missed,
            sessions,
            resets,
            failed_sends,
            wake_us,
            decide_us,
        });
        return;
    }
    say!(
        "{answered} answered, {late} of them late, {fallbacks} fallbacks, {missed} missed, {refused} refused; \
         {sessions} robots, {resets} episodes"
    );
    let mut table = Table::new(&["microseconds", "p50", "p99", "max"]);
    for (name, of) in [("until it runs", wake_us), ("decision", decide_us)] {
        if let Some(Percentiles { p50, p99, max, .. }) = of {
            table.row(
                [name.to_owned()].into_iter().chain([p50, p99, max].map(|us| format!("{us:.1}"))),
            );
        }
    }
    table.print();
}
