//! Learning: updates, roll-out and search per CPU-second, and the update beside PyTorch's.

mod learning;
mod ma_exp;
mod maac;
mod paper;
mod program;
mod round;
mod torch;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_cli::failure::Failure;
use sortie_cli::methods;
use sortie_learn::run::Setup;
use sortie_methods::learners::ALMA;
use sortie_nn::layers::matrix::{Matrix, MatrixMut, Store, multiply};

use super::{Figures, Measuring, Row, pin};
use learning::{Learning, Work};
use torch::{Formulation, Torch, find};

/// Rounds in which everything has its turn.
const ROUNDS: usize = 11;
/// Rows and columns of the matrices whose product is taken for the machine's peak.
const PEAK_SIDE: usize = 512;

/// Updates and roll-out of a preset in processor time of one thread
///
/// Beside each figure stands the arithmetic that was done, and its share of what a large matrix product
/// reaches in the same run. Where Python has torch, the update alternates with a PyTorch program of ours
/// on the same records, in two formulations; loss and gradient are compared before. Preset `fast` counts
/// updates per CPU-second; `paper` CPU-seconds per step of each level, and how they are spent; `paper-maac`
/// and `paper-ma-exp` CPU-seconds per round of MAAC's and MA-Exp's updates.
#[derive(Debug, Args)]
pub(super) struct TrainArguments {
    /// How it is learned
    #[arg(long, value_enum, default_value_t = Preset::Fast)]
    preset: Preset,
    /// Python with torch; default: that of $VIRTUAL_ENV, else `python3`
    #[arg(long, value_name = "PATH")]
    python: Option<PathBuf>,
    /// Replace one value of the preset's configuration; may be given several times
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

/// Ways to learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Preset {
    /// From records of single steps
    Fast,
    /// As the dissertation does, from windows of whole episodes
    Paper,
    /// A round of MAAC as published
    PaperMaac,
    /// A round of MA-Exp as published
    PaperMaExp,
}

/// The arithmetic of one case, medians over the rounds.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Arithmetic {
    pub(super) case: String,
    /// Floating-point operations of one update, step or decision, in millions.
    pub(super) mflop: f64,
    pub(super) gflop_per_cpu_s: f64,
    /// Against the best large matrix product of this run.
    pub(super) share_of_peak: f64,
}

/// One thing that is timed.
struct Case {
    name: String,
    /// What one unit of work is; the figure is thousands of them per CPU-second.
    unit: &'static str,
    /// Units in one call.
    units: f64,
    rates: Vec<f64>,
    /// Operations and CPU-seconds of every turn.
    mflop: Vec<f64>,
    gflop_per_cpu_s: Vec<f64>,
}

pub(super) fn measure(arguments: &TrainArguments) -> Result<Figures, Failure> {
    match arguments.preset {
        Preset::Fast => measure_fast(arguments),
        Preset::Paper => paper::measure(arguments),
        Preset::PaperMaac => maac::measure(arguments),
        Preset::PaperMaExp => ma_exp::measure(arguments),
    }
}

/// A preset with some values replaced.
fn setup(preset: &str, assignments: &[String]) -> Result<Setup, Failure> {
    let set = |setup, assignment: &String| ALMA.set(&setup, assignment);
    let mut setup = assignments.iter().try_fold(ALMA.preset(preset)?, set)?;
    methods::settle(&ALMA, &mut setup.environment)?;
    Ok(setup)
}

fn measure_fast(arguments: &TrainArguments) -> Result<Figures, Failure> {
    let Measuring { common, seconds, .. } = arguments.measuring;
    let python = find(arguments.python.as_deref(), common.quiet)?;
    pin(arguments.measuring.pin)?;
    let mut learning = Learning::new(&arguments.assignments, common.seed)?;
    let start = |python: PathBuf| Torch::start(&python, &mut learning, common.quiet);
    let mut torch = python.map(start).transpose()?;
    let mut cases: Vec<Case> = Work::ALL.into_iter().map(|work| learning.case(work)).collect();
    let mut peers = Formulation::ALL.map(|_| Vec::new());
    let mut peaks = Vec::new();
    let turns = Work::ALL.len() + 1 + torch.iter().count() * peers.len();
    let turn_s = seconds / (ROUNDS * turns) as f64;
    for work in Work::ALL {
        learning.turn(work, turn_s)?;
    }
    for how in Formulation::ALL {
        torch.as_mut().map(|torch| torch.turn(how, turn_s)).transpose()?;
    }
    for _ in 0..ROUNDS {
        peaks.push(peak_gflops(turn_s));
        for (work, case) in Work::ALL.into_iter().zip(&mut cases) {
            case.add(learning.turn(work, turn_s)?);
            if let (Work::AgentsUpdate, Some(torch)) = (work, &mut torch) {
                for (how, rates) in Formulation::ALL.into_iter().zip(&mut peers) {
                    rates.push(torch.turn(how, turn_s)? * case.units / 1e3);
                }
            }
        }
    }
    let mut figures = figures(&cases, &peaks);
    if let Some(torch) = torch {
        for (how, rates) in Formulation::ALL.into_iter().zip(&peers) {
            figures.add_peer(&cases[0], how.engine(), &torch.version, rates);
        }
    }
    Ok(figures)
}

/// Calls, CPU-seconds and floating-point operations of one turn.
struct Turn {
    calls: f64,
    cpu_s: f64,
    operations: f64,
}

impl Case {
    fn add(&mut self, turn: Turn) {
        let Turn { calls, cpu_s, operations } = turn;
        self.rates.push(calls * self.units / cpu_s / 1e3);
        self.mflop.push(operations / calls / 1e6);
        self.gflop_per_cpu_s.push(operations / cpu_s / 1e9);
    }
}

fn figures(cases: &[Case], peaks: &[f64]) -> Figures {
    let version = env!("CARGO_PKG_VERSION");
    let mut figures = Figures::default();
    let peak = peaks.iter().copied().fold(0.0, f64::max);
    for case in cases {
        figures.rows.push(row(&case.name, "sortie", version, &case.rates, case.unit));
        let gflop_per_cpu_s = at(&case.gflop_per_cpu_s, 0.5);
        figures.arithmetic.push(Arithmetic {
            case: case.name.clone(),
            mflop: at(&case.mflop, 0.5),
            gflop_per_cpu_s,
            share_of_peak: gflop_per_cpu_s / peak,
        });
    }
    figures.rows.push(peak_row(peaks));
    figures
}

fn peak_row(peaks: &[f64]) -> Row {
    let name = format!("product of {PEAK_SIDE} x {PEAK_SIDE} matrices");
    row(&name, "gemm", env!("CARGO_PKG_VERSION"), peaks, "GFLOP per CPU-second")
}

impl Figures {
    /// Adds the same work done by a peer.
    fn add_peer(&mut self, ours: &Case, peer: &'static str, version: &str, rates: &[f64]) {
        self.rows.push(row(&ours.name, peer, version, rates, ours.unit));
        // Rates, not times: the ratio is ours over the peer's.
        self.add_ratio("train", &ours.name, ["sortie", peer], [rates, &ours.rates]);
    }
}

fn row(case: &str, engine: &'static str, version: &str, rates: &[f64], unit: &'static str) -> Row {
    // Slowest last, as for latencies: the tails are the bad ones.
    Row {
        what: "train",
        case: case.to_string(),
        engine,
        version: version.to_string(),
        p50: at(rates, 0.5),
        p99: at(rates, 0.01),
        p999: None,
        max: at(rates, 0.0),
        unit,
    }
}

/// A row of CPU-seconds of one call.
fn times(case: &str, engine: &'static str, version: &str, cpu_s: &[f64]) -> Row {
    Row {
        p99: at(cpu_s, 0.99),
        max: at(cpu_s, 1.0),
        ..row(case, engine, version, cpu_s, "CPU-seconds")
    }
}

/// The value below which a share of all values lies.
fn at(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = (sorted.len().saturating_sub(1) as f64 * share).round() as usize;
    sorted.get(place).copied().unwrap_or(f64::NAN)
}

/// GFLOP per CPU-second of large matrix products.
fn peak_gflops(seconds: f64) -> f64 {
    let side = PEAK_SIDE;
    let (left, right) = (vec![0.5; side * side], vec![0.25; side * side]);
    let mut out = vec![0.0; side * side];
    let turn = learning::timed(seconds, || {
        multiply(
            MatrixMut::new(&mut out, side, side),
            Store::Replace,
            Matrix::new(&left, side, side),
            Matrix::new(&right, side, side),
        );
        std::hint::black_box(&mut out);
        Ok(())
    });
    turn.map_or(0.0, |turn| turn.calls * 2.0 * (side as f64).powi(3) / turn.cpu_s / 1e9)
}
