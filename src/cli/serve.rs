//! `sortie serve`: a policy decides for a robot's program, over shared memory.

use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sortie_bundle::sha256;
use sortie_core::plan::{AlignedBytes, GuardError, GuardFacts, Guards, Plan, RobotFacts};
use sortie_core::wire::Reason;
use sortie_ipc::{
    Domain, Engine, Fallback, PolicySchema, PolicyServer, Port, RealTime, ServeCounters,
    ServeSettings, Served, Stop,
};
use sortie_plans::{
    Annex, CompileError, CompileOptions, FlatPolicy, OutputRole, PolicyAnswer, is_plan,
    read_plan_or_onnx,
};

use crate::bridge::{Relayed, Robot, RosArguments};
use crate::failure::{Exit, Failure, Outcome};
use crate::foreign::{ENGINE, PolicyArguments};
use crate::guards::{self, Tripped, Trips};
use crate::latency::{Latency, Percentiles};
use crate::output::{Common, Table, print_json, say};
use crate::policy::Backend;
use crate::terminal::stop_on_signals;
use crate::tools::{check_program, compiler, engines};
use crate::trust::TrustArguments;
use crate::zenoh;

/// Serve a policy in shared memory: a robot's program sends observations and gets actions
///
/// Keeps the recurrent state, and says of every answer whether it came in time. Robots connect with
/// `sortie_ipc::PolicyClient`. Ends with Ctrl-C and leaves nothing in shared memory.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie serve walking.plan
  sortie serve walking.plan --domain legs --deadline-ms 2 --fallback zero
  sortie serve walking.onnx --rt 50 --core 1 --json
  sortie serve hunting.onnx --draw --seed 7
  sortie serve walking.plan --ros2 --namespace /legs     # /legs/observation is answered on /legs/action
  sortie serve scatters.onnx --backend tract")]
pub(crate) struct ServeArguments {
    /// A policy's plan, or its ONNX file, which is compiled first
    #[arg(value_name = "PLAN|ONNX")]
    policy: PathBuf,
    /// What decides: the plan, or tract where a file cannot be compiled, which allocates and promises nothing about
    /// bits or time
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    /// Name by which robots find it; keeps it apart from all others on the host
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// Milliseconds that robots wait for an answer, unless they say otherwise
    #[arg(long, default_value_t = 20.0, value_name = "MS", value_parser = milliseconds)]
    deadline_ms: f64,
    /// What robots do without an answer: `hold` the last, `zero`, or the number of an action
    #[arg(long, default_value_t = Fallback::Hold, value_name = "hold|zero|ACTION")]
    fallback: Fallback,
    /// Draws actions from the softmax of their scores, by random numbers of `--seed`, instead of taking the best
    #[arg(long)]
    draw: bool,
    /// The core that it decides on
    #[arg(long, value_name = "CORE")]
    core: Option<usize>,
    /// Real-time priority: before all ordinary work, in memory that stays
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    rt: Option<u8>,
    /// Microseconds that it looks for an observation before it sleeps
    #[arg(long, default_value_t = 100, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    linger_us: u64,
    /// As a node of ROS 2 besides: it subscribes to observations and publishes actions; docs/guide/ros2.md says which
    #[arg(long)]
    ros2: bool,
    #[command(flatten)]
    ros: RosArguments,
    #[command(flatten)]
    trust: TrustArguments,
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
    /// `plan`, or what runs the graph.
    engine: &'static str,
    #[serde(flatten)]
    counters: &'a ServeCounters,
    /// Which guards tripped, how often.
    trips: Vec<Tripped>,
    /// What came over ROS, where it served a node.
    #[serde(skip_serializing_if = "Option::is_none")]
    ros2: Option<Relayed>,
    /// From the sending of an observation to the server running, in microseconds.
    wake_us: Option<Percentiles>,
    /// The decision alone.
    decide_us: Option<Percentiles>,
}

pub(crate) fn run(arguments: &ServeArguments) -> Outcome {
    arguments.backend.prepare()?;
    if arguments.ros2 {
        zenoh::linked()?;
    }
    let failed = |error| Failure::file(&arguments.policy, &error);
    let bytes = read_plan_or_onnx(&arguments.policy).map_err(failed)?;
    arguments.trust.check_plan(&arguments.policy, &bytes)?;
    let within = |failure: Failure| failure.within(arguments.policy.display());
    match arguments.backend {
        Backend::Plan => serve_plan(arguments, &bytes, &within),
        Backend::Tract => serve_graph(arguments, &bytes, &within),
    }
}

fn serve_plan(
    arguments: &ServeArguments,
    bytes: &[u8],
    within: &dyn Fn(Failure) -> Failure,
) -> Outcome {
    let bytes = plan_of(arguments, bytes).map_err(within)?;
    let plan = Plan::load(bytes.as_slice())
        .map_err(|error| within(Failure::from(CompileError::from(error))))?;
    let schema = schema(&plan, bytes.as_slice()).map_err(within)?;
    let damaged = |error: GuardError| within(Failure::new(Exit::BadData, error.to_string()));
    let guards = Guards::of_plan(bytes.as_slice()).map_err(damaged)?;
    serve(arguments, schema, guards, |server, observe, stop| {
        server.serve(&plan, guards, observe, stop)
    })
}

/// A file that another process has read and run is run here, as by all verbs that run graphs.
fn serve_graph(
    arguments: &ServeArguments,
    bytes: &[u8],
    within: &dyn Fn(Failure) -> Failure,
) -> Outcome {
    if is_plan(bytes) {
        let message = "this is a plan; `--backend tract` runs the ONNX file that it was made of";
        return Err(within(Failure::new(Exit::Usage, message)));
    }
    let options = arguments.foreign.options_for(&arguments.policy)?;
    let failed = |error| within(Failure::from(error));
    compiler().rehearse_policy(bytes, &options).map_err(failed)?;
    let policy = engines()?.tract().flat_policy(bytes, &options).map_err(failed)?;
    let model = sha256(bytes).first_chunk().copied().unwrap_or_default();
    let mut graph = Graph::new(policy, model).map_err(failed)?;
    let schema = graph.schema();
    // Guards stand in plans alone.
    serve(arguments, schema, None, |server, observe, stop| {
        server.serve_with(&mut graph, None, observe, stop)
    })
}

/// Opens the services, and decides until Ctrl-C.
fn serve(
    arguments: &ServeArguments,
    schema: PolicySchema,
    guards: Option<Guards<'_>>,
    decide: impl FnOnce(
        &mut PolicyServer,
        &mut dyn FnMut(&Served),
        &Stop,
    ) -> Result<ServeCounters, sortie_ipc::Error>,
) -> Outcome {
    let ServeArguments { policy, common, .. } = arguments;
    let stop = stop_on_signals()?;
    let domain = Domain::new(&arguments.domain)?;
    let settings = ServeSettings {
        deadline: Duration::from_secs_f64(arguments.deadline_ms / 1000.0),
        fallback: arguments.fallback,
        draw: arguments.draw.then_some(common.seed),
        linger: Some(Duration::from_micros(arguments.linger_us)),
        real_time: RealTime { priority: arguments.rt, core: arguments.core },
    };
    let taken = describe(&schema);
    let robot =
        arguments.ros2.then(|| Robot::open(&arguments.ros, &schema, *common)).transpose()?;
    let mut server = PolicyServer::open(&domain, schema, &settings)?;
    if !common.json && !common.quiet {
        say!("{}: {taken}", policy.display());
        if arguments.backend == Backend::Tract {
            say!("by {ENGINE}");
        }
        if let Some(seed) = settings.draw {
            say!("actions are drawn, seed {seed}");
        }
        for (name, words) in guards.map(GuardFacts::from).iter().flat_map(guards::lines) {
            say!("{name}: {words}");
        }
        say!("serving in domain `{}`; Ctrl-C ends it", domain.id());
    }
    let (mut wake, mut decision) = (Latency::default(), Latency::default());
    let mut trips = Trips::default();
    let mut observe = |served: &Served| {
        wake.record_ns(served.wake_ns);
        decision.record_ns(served.decide_ns);
        if let Some(trip) = served.trip {
            trips.count(served.seq, trip, !common.quiet);
        }
    };
    let (counters, relayed) = thread::scope(|scope| {
        let relaying = robot.map(|robot| scope.spawn(|| robot.relay(&domain, &stop)));
        let counters = decide(&mut server, &mut observe, &stop);
        stop.stop();
        let relayed =
            relaying.map(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)));
        (counters, relayed)
    });
    let (counters, relayed) = (counters?, relayed.transpose()?);
    drop(server);
    let shown = |latency: &Latency| (latency.samples() > 0).then(|| latency.percentiles());
    report(arguments, &counters, (&trips, relayed), [shown(&wake), shown(&decision)]);
    Ok(())
}

/// The plan of a file: itself, or what the limited process compiles of it.
fn plan_of(arguments: &ServeArguments, bytes: &[u8]) -> Result<AlignedBytes, Failure> {
    if is_plan(bytes) {
        return Ok(AlignedBytes::copy_of(bytes));
    }
    check_program()?;
    let roles = arguments.foreign.options_for(&arguments.policy)?;
    let options = CompileOptions { seed: arguments.common.seed, ..CompileOptions::default() };
    let compiled = compiler().compile_policy(bytes, &roles, &options)?;
    Ok(AlignedBytes::copy_of(&compiled.compiled.bytes))
}

/// What the plan takes and gives, with the names that stand behind its weights.
fn schema(plan: &Plan<'_>, bytes: &[u8]) -> Result<PolicySchema, Failure> {
    let schema = PolicySchema::of_plan(plan)?;
    let Some(Annex { facts, .. }) = Annex::of_plan(bytes)? else { return Ok(schema) };
    let inputs: Vec<&str> = facts.given().map(|input| input.name.as_str()).collect();
    let outputs: Vec<&str> = facts.wanted().map(|output| output.name.as_str()).collect();
    let states: Vec<&str> = facts.states.iter().map(|state| state.input.as_str()).collect();
    let robot = RobotFacts::of_plan(bytes);
    Ok(PolicySchema { robot, ..schema.named(inputs, outputs, states) })
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
    (trips, relayed): (&Trips, Option<Relayed>),
    [wake_us, decide_us]: [Option<Percentiles>; 2],
) {
    let ServeArguments { policy, domain, common, .. } = arguments;
    if common.json {
        print_json(&Summary {
            policy,
            domain,
            engine: match arguments.backend {
                Backend::Plan => Backend::Plan.name(),
                Backend::Tract => ENGINE,
            },
            counters,
            trips: trips.tripped(),
            ros2: relayed,
            wake_us,
            decide_us,
        });
        return;
    }
    let by = match arguments.backend {
        Backend::Plan => String::new(),
        Backend::Tract => format!(" (by {ENGINE})"),
    };
    let ServeCounters { answered, late, fallbacks, refused, missed, sessions, resets, .. } =
        counters;
    say!(
        "{answered} answered{by}, {late} of them late, {fallbacks} fallbacks, {missed} missed, {refused} refused; \
         {sessions} robots, {resets} episodes"
    );
    if let Some(relayed) = relayed {
        say!("{relayed}");
    }
    trips.print();
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

/// A graph that decides as a plan does: what is not finite is refused, and then no state has changed.
struct Graph {
    policy: Box<dyn FlatPolicy>,
    /// First 16 bytes of the file's SHA-256.
    model: [u8; 16],
    /// Numbers of every output.
    widths: Vec<usize>,
    /// The states that an answer would leave.
    next: Vec<f32>,
}

impl Graph {
    /// A policy that has run on zeros in another process, and does so here.
    ///
    /// # Errors
    /// It does not.
    fn new(mut policy: Box<dyn FlatPolicy>, model: [u8; 16]) -> Result<Self, CompileError> {
        let mut next = vec![0.0; policy.facts().state_length()];
        let zeros: Vec<Vec<f32>> =
            policy.facts().given().map(|input| vec![0.0; input.length()]).collect();
        let zeros: Vec<&[f32]> = zeros.iter().map(Vec::as_slice).collect();
        let answers = policy.run(&zeros, &mut next)?;
        let widths = answers.iter().map(|answer| numbers(answer).len()).collect();
        Ok(Self { policy, model, widths, next })
    }

    /// What it takes and gives: the same as the file's plan, if there were one.
    fn schema(&self) -> PolicySchema {
        let facts = self.policy.facts();
        let port = |name: &str, length: usize| Port { name: name.to_owned(), length };
        let states = facts.states.iter().map(|state| port(&state.input, state.length));
        let outputs: Vec<_> = facts.wanted().zip(&self.widths).collect();
        // Several choices side by side are left to the caller.
        let actions = match outputs.first() {
            Some((output, width)) if output.role == OutputRole::Discrete(**width) => **width,
            _ => 0,
        };
        PolicySchema {
            actions,
            inputs: facts.given().map(|input| port(&input.name, input.length())).collect(),
            outputs: outputs.iter().map(|(output, width)| port(&output.name, **width)).collect(),
            states: states.collect(),
            robot: None,
        }
    }
}

impl Engine for Graph {
    fn respond(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
        outputs: &mut [&mut [f32]],
    ) -> Result<(), Reason> {
        check(inputs.iter().copied().flatten())?;
        check(states.iter())?;
        self.next.copy_from_slice(states);
        // What the engine says of it would be said at every step.
        let answers = self.policy.run(inputs, &mut self.next);
        let answers = answers.map_err(|_| Reason::Policy)?;
        let answers = answers.iter().map(numbers);
        check(self.next.iter().chain(answers.clone().flatten()))?;
        for (to, from) in outputs.iter_mut().zip(answers) {
            let fits = to.len() == from.len();
            fits.then(|| to.copy_from_slice(from)).ok_or(Reason::Length)?;
        }
        states.copy_from_slice(&self.next);
        Ok(())
    }

    fn model(&self) -> [u8; 16] {
        self.model
    }

    fn is_graph(&self) -> bool {
        true
    }
}

fn check<'a>(mut numbers: impl Iterator<Item = &'a f32>) -> Result<(), Reason> {
    match numbers.all(|number| number.is_finite()) {
        true => Ok(()),
        false => Err(Reason::NonFinite),
    }
}

/// An output's numbers: of a choice that is made inside, its scores, which the caller chooses from.
fn numbers(answer: &PolicyAnswer) -> &[f32] {
    if answer.scores.is_empty() { &answer.numbers } else { &answer.scores }
}
