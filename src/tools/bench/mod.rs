//! `sortie bench`: our figures beside the peers', measured in one run.

mod allocation;
mod contestants;
mod decision;
pub(crate) mod faults;
mod heads;
mod losses;
mod pointing;
mod policies;
mod proposals;
mod rounds;
mod scenes;
mod train;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use rustix::thread::{CpuSet, sched_setaffinity};
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::output::{Common, Table, print_json, say, tell};
use sortie_cli::tools::engines;
use sortie_core::plan::PlanError;
use sortie_envs::random::generator;
use sortie_envs::{ENVIRONMENTS, Split, observe_and_step, open, step_alone};
use sortie_plans::CompileError;

use rounds::{Engine, Measured, paired_ratio};

/// Our engine in tables: a compiled plan of the exact profile.
const OURS: &str = "sortie exact";
/// The same of the profile that adds products up fused.
const FUSED: &str = "sortie fused";
const VERSION: &str = env!("CARGO_PKG_VERSION");
const TRACT_VERSION: &str = "0.23.9";
/// What only reads the weights.
const FLOOR: &str = "floor";

/// Measure latency and throughput, ours and the peers' alternating in one run
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie bench decision --pin 1
  sortie bench decision models/save-the-city --python venv/bin/python3 --pace hot
  sortie bench allocation --seconds 5
  sortie bench allocation growth/10 growth/31x24 --picture growth.svg
  sortie bench policy walking.onnx --python venv/bin/python3
  sortie bench proposals --python venv/bin/python3
  sortie bench heads --seconds 30
  sortie bench env --seconds 10
  sortie bench faults --runner-kills 1000 --allocator-kills 200
  sortie bench losses models/save-the-city --lose 4 --at 10
  sortie bench train --python venv/bin/python3 --seconds 30")]
pub(crate) struct BenchArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Decision(decision::DecisionArguments),
    Allocation(allocation::AllocationArguments),
    Policy(policies::PolicyBenchArguments),
    Proposals(proposals::ProposalsArguments),
    Heads(heads::HeadsArguments),
    Env(EnvironmentArguments),
    Train(train::TrainArguments),
    Faults(faults::FaultsArguments),
    Losses(losses::LossesArguments),
}

/// What every measurement takes.
#[derive(Clone, Copy, Debug, Args)]
struct Measuring {
    /// Core to run on
    #[arg(long, default_value_t = 1, value_name = "CORE")]
    pin: usize,
    /// Seconds to measure for
    #[arg(long, default_value_t = 10.0, value_name = "S")]
    seconds: f64,
    #[command(flatten)]
    common: Common,
}

/// One measured distribution; `unit` says of what.
#[derive(Clone, Debug, Serialize)]
struct Row {
    what: &'static str,
    case: String,
    engine: &'static str,
    version: String,
    p50: f64,
    p99: f64,
    p999: Option<f64>,
    max: f64,
    unit: &'static str,
}

/// How many times as long as one of our engines a peer takes, paired round by round; less than 1 where it is faster.
#[derive(Clone, Debug, Serialize)]
struct Ratio {
    what: &'static str,
    case: String,
    engine: &'static str,
    peer: &'static str,
    ratio: f64,
    low: f64,
    high: f64,
}

/// All that one measurement found.
#[derive(Clone, Debug, Default, Serialize)]
struct Figures {
    rows: Vec<Row>,
    ratios: Vec<Ratio>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    arithmetic: Vec<train::Arithmetic>,
}

pub(crate) fn run(arguments: &BenchArguments) -> Outcome {
    if let What::Decision(_)
    | What::Allocation(_)
    | What::Policy(_)
    | What::Proposals(_)
    | What::Heads(_) = &arguments.what
    {
        // Before plans are compiled, which the other program would do once more.
        engines()?;
    }
    let (figures, common) = match &arguments.what {
        What::Decision(arguments) => (decision::measure(arguments)?, arguments.measuring.common),
        What::Allocation(arguments) => {
            (allocation::measure(arguments)?, arguments.measuring.common)
        }
        What::Policy(arguments) => (policies::measure(arguments)?, arguments.measuring.common),
        What::Proposals(arguments) => (proposals::measure(arguments)?, arguments.measuring.common),
        What::Heads(arguments) => (heads::measure(arguments)?, arguments.measuring.common),
        What::Env(arguments) => (measure_environment(arguments)?, arguments.measuring.common),
        What::Faults(arguments) => return faults::run(arguments),
        What::Losses(arguments) => return losses::run(arguments),
        What::Train(arguments) => (train::measure(arguments)?, arguments.measuring.common),
    };
    if common.json {
        print_json(&figures);
    } else {
        figures.print();
    }
    Ok(())
}

/// What was opened; none, and a note, where this machine does not have its profile.
fn if_runnable<T>(name: &str, opened: Result<T, CompileError>) -> Result<Option<T>, CompileError> {
    match opened {
        Err(CompileError::Plan(PlanError::WrongProfile { .. })) => {
            tell!("note: this machine cannot run `{name}`");
            Ok(None)
        }
        opened => opened.map(Some),
    }
}

/// Keeps this thread on one core, so that figures do not mix cores.
fn pin(core: usize) -> Outcome {
    let mut cores = CpuSet::new();
    if core >= CpuSet::MAX_CPU {
        return Err(no_core(core));
    }
    cores.set(core);
    sched_setaffinity(None, &cores).map_err(|_| no_core(core))
}

/// Processor time of this thread in seconds: other work on the core does not count.
fn thread_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn no_core(core: usize) -> Failure {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let message = format!("core {core} cannot be used; this process has {cores}, counted from 0");
    Failure::new(Exit::Usage, message)
}

impl Row {
    /// Whether more is better: then the tails are the small figures.
    fn is_rate(&self) -> bool {
        self.unit.contains(" per ")
    }
}

/// Rows under their unit and the names of their median and their tails; nothing where there are none.
fn print_rows([median, one_percent, one_permille, last]: [&str; 4], rows: &[&Row]) {
    for unit in rows.chunk_by(|one, next| one.unit == next.unit) {
        say!("{}", unit[0].unit);
        let mut table = Table::new(&["case", "engine", median, one_percent, one_permille, last]);
        for row in unit {
            let figure = |value: f64| format!("{value:.2}");
            table.row([
                row.case.clone(),
                format!("{} {}", row.engine, row.version).trim_end().to_string(),
                figure(row.p50),
                figure(row.p99),
                row.p999.map_or("-".to_string(), figure),
                figure(row.max),
            ]);
        }
        table.print();
    }
}

impl Figures {
    /// Adds what engines took for a case, and the ratio of every peer to every engine of ours.
    fn add(
        &mut self,
        what: &'static str,
        case: &str,
        engines: &[Engine<'_>],
        measured: &[Measured],
    ) {
        for (engine, measured) in engines.iter().zip(measured) {
            let shown = measured.latency.percentiles();
            self.rows.push(Row {
                what,
                case: case.to_string(),
                engine: engine.name,
                version: engine.version.clone(),
                p50: shown.p50,
                p99: shown.p99,
                p999: shown.p999,
                max: shown.max,
                unit: "us",
            });
        }
        let (ours, peers): (Vec<_>, Vec<_>) =
            engines.iter().zip(measured).partition(|(engine, _)| engine.is_ours);
        for (our, our_times) in ours {
            for (peer, peer_times) in &peers {
                let engines = [our.name, peer.name];
                let times = [&*our_times.medians_ns, &*peer_times.medians_ns];
                self.add_ratio(what, case, engines, times);
            }
        }
    }

    /// Adds how many times as long as ours a peer takes.
    fn add_ratio(
        &mut self,
        what: &'static str,
        case: &str,
        [engine, peer]: [&'static str; 2],
        [ours, theirs]: [&[f64]; 2],
    ) {
        let [ratio, low, high] = paired_ratio(ours, theirs);
        self.ratios.push(Ratio { what, case: case.to_string(), engine, peer, ratio, low, high });
    }

    fn print(&self) {
        let (rates, times): (Vec<&Row>, Vec<&Row>) =
            self.rows.iter().partition(|row| row.is_rate());
        print_rows(["p50", "p99", "p99.9", "max"], &times);
        print_rows(["median", "slow 1 %", "slow 0.1 %", "slowest"], &rates);
        self.print_arithmetic();
        self.print_ratios();
    }

    fn print_ratios(&self) {
        if self.ratios.is_empty() {
            return;
        }
        say!();
        let mut table = Table::new(&["case", "engine", "", "peer", "rounds"]);
        for Ratio { case, engine, peer, ratio, low, high, .. } in &self.ratios {
            let (said, low, high) = if *peer == FLOOR {
                (format!("takes {:.2} times", 1.0 / ratio), 1.0 / high, 1.0 / low)
            } else {
                (format!("{ratio:.1} times as fast as"), *low, *high)
            };
            let rounds = format!("{low:.2} to {high:.2}");
            table.row([case.clone(), (*engine).to_owned(), said, (*peer).to_owned(), rounds]);
        }
        table.print();
    }

    fn print_arithmetic(&self) {
        if self.arithmetic.is_empty() {
            return;
        }
        say!();
        let mut table =
            Table::new(&["case", "MFLOP each", "GFLOP per CPU-second", "share of peak"]);
        for train::Arithmetic { case, mflop, gflop_per_cpu_s, share_of_peak } in &self.arithmetic {
            table.row([
                case.clone(),
                format!("{mflop:.2}"),
                format!("{gflop_per_cpu_s:.1}"),
                format!("{:.0} %", 100.0 * share_of_peak),
            ]);
        }
        table.print();
        say!();
    }
}

/// Instances that are stepped in turn.
const INSTANCES: usize = 16;
/// Rounds between two looks at the clock.
const ROUNDS: usize = 2_000;

/// Steps of an environment per core-second: random actions, features written at every step, and steps alone where any action is possible
#[derive(Debug, Args)]
struct EnvironmentArguments {
    /// Environment and set of starts; every environment is possible
    #[arg(long, default_value = ENVIRONMENTS[0].name, value_name = "ENV[/SET]")]
    env: String,
    #[command(flatten)]
    measuring: Measuring,
}

fn measure_environment(arguments: &EnvironmentArguments) -> Result<Figures, Failure> {
    let seed = arguments.measuring.common.seed;
    let mut environment = open(&arguments.env, Split::Train, INSTANCES, &BTreeMap::new())
        .map_err(|error| Failure::new(Exit::Usage, error.to_string()))?;
    let mut random = generator(seed);
    (0..INSTANCES).for_each(|instance| environment.reset(instance, &mut random));
    pin(arguments.measuring.pin)?;
    let (world, random) = (&mut *environment, &mut random);
    let seconds = arguments.measuring.seconds;
    let seen = rates(seconds, || Some(observe_and_step(world, random, ROUNDS)));
    let alone = rates(seconds, || step_alone(world, random, ROUNDS).ok());
    let named = |case: String, rates| Some(environment_row(case, rates?));
    let alone = named(format!("{}, steps alone", arguments.env), alone);
    let rows = named(arguments.env.clone(), seen).into_iter().chain(alone).collect();
    Ok(Figures { rows, ..Figures::default() })
}

/// Million steps per core-second, the fastest first: the tails are the bad ones, as for latencies.
fn rates(seconds: f64, mut play: impl FnMut() -> Option<f64>) -> Option<Vec<f64>> {
    let mut rates = Vec::new();
    let until = Instant::now() + Duration::from_secs_f64(seconds);
    while rates.is_empty() || Instant::now() < until {
        let start_s = thread_cpu_s();
        std::hint::black_box(play()?);
        rates.push((ROUNDS * INSTANCES) as f64 / (thread_cpu_s() - start_s) / 1e6);
    }
    rates.sort_by(|one, other| other.total_cmp(one));
    Some(rates)
}

fn environment_row(case: String, rates: Vec<f64>) -> Row {
    let at = |share: f64| rates[((rates.len() - 1) as f64 * share).round() as usize];
    Row {
        what: "env",
        case,
        engine: "sortie",
        version: env!("CARGO_PKG_VERSION").to_string(),
        p50: at(0.5),
        p99: at(0.99),
        p999: None,
        max: at(1.0),
        unit: "million steps per core-second",
    }
}
