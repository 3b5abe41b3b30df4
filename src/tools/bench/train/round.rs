//! Rounds of updates as published: CPU-seconds of ours, and of the same round in PyTorch.

use std::path::Path;
use std::time::Instant;

use serde::Deserialize;
use sortie_cli::failure::Failure;
use sortie_methods::maac::{ActorCritic, Draw, Groups, Rows};
use sortie_nn::random::Generator;
use sortie_nn::tape::Parameters;

use super::super::{Figures, Measuring, pin, thread_cpu_s};
use super::program::{Comparison, Expected, Program, Tensors};
use super::{Arithmetic, TrainArguments, at, find, peak_gflops, peak_row, times};

/// What the programs share, by the name that they import it by.
const SHARED: (&str, &str) = ("rounds.py", include_str!("../../../../benches/rounds.py"));
/// How a round is written for PyTorch: its name in the program, and as a peer.
const FORMULATIONS: [(&str, &str); 2] =
    [("published", "pytorch, as published"), ("lean", "pytorch, lean")];
/// Rounds that are measured however little time there is.
const LEAST_ROUNDS: usize = 3;
/// CPU-seconds for the machine's peak in every round.
const PEAK_S: f64 = 0.1;

/// What a program says once it is ready.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    published: Comparison,
    lean: Comparison,
}

#[derive(Deserialize)]
struct Turn {
    cpu_s: f64,
}

/// A round of updates.
pub(super) trait Round {
    /// The program that does the same.
    const PROGRAM: &'static str;

    /// What is computed.
    fn name(&self) -> String;

    /// Does a round, with actions that are drawn anew.
    fn update(&mut self);

    /// Writes networks and batch, does a round and writes its draws and gradients.
    fn write(&mut self, path: &Path) -> Result<Expected, Failure>;

    /// Operations of the products of a round, by sizes alone.
    fn operations(&self) -> f64;
}

/// Draws as agents do, and keeps what was drawn.
pub(super) struct Kept<'a> {
    pub(super) random: &'a mut Generator,
    pub(super) drawn: Vec<Vec<Vec<u32>>>,
}

impl Draw for Kept<'_> {
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
        let drawn = self.random.draw(groups, scores);
        self.drawn.push(drawn.clone());
        drawn
    }
}

/// Measures a round that `open` makes once this thread has its processor.
pub(super) fn measure<R: Round>(
    arguments: &TrainArguments,
    open: impl FnOnce(&[String], u64) -> Result<R, Failure>,
) -> Result<Figures, Failure> {
    let Measuring { common, seconds, .. } = arguments.measuring;
    let python = find(arguments.python.as_deref(), common.quiet)?;
    pin(arguments.measuring.pin)?;
    let mut round = open(&arguments.assignments, common.seed)?;
    let mut torch = python.map(|python| start(&mut round, &python, common.quiet)).transpose()?;
    let name = round.name();
    let (mut ours, mut peaks) = (Vec::new(), Vec::new());
    let mut peers = FORMULATIONS.map(|_| Vec::new());
    let since = Instant::now();
    // The first round fills caches and buffers.
    let mut turns = 0;
    while turns <= LEAST_ROUNDS || since.elapsed().as_secs_f64() < seconds {
        peaks.push(peak_gflops(PEAK_S));
        let start = thread_cpu_s();
        round.update();
        ours.push(thread_cpu_s() - start);
        if let Some((program, _)) = &mut torch {
            for ((formulation, _), cpu_s) in FORMULATIONS.iter().zip(&mut peers) {
                cpu_s.push(program.ask::<Turn>(formulation)?.cpu_s);
            }
        }
        if turns == 0 {
            ours.clear();
            peers.iter_mut().for_each(Vec::clear);
        }
        turns += 1;
    }
    let peak = peaks.iter().copied().fold(0.0, f64::max);
    let mut figures = Figures::default();
    figures.rows.push(times(&name, "sortie", env!("CARGO_PKG_VERSION"), &ours));
    let operations = round.operations();
    let gflop_per_cpu_s = operations / at(&ours, 0.5) / 1e9;
    figures.arithmetic.push(Arithmetic {
        case: name.clone(),
        mflop: operations / 1e6,
        gflop_per_cpu_s,
        share_of_peak: gflop_per_cpu_s / peak,
    });
    if let Some((_, version)) = &torch {
        for ((_, peer), cpu_s) in FORMULATIONS.into_iter().zip(&peers) {
            figures.rows.push(times(&name, peer, version, cpu_s));
            figures.add_ratio("train", &name, ["sortie", peer], [&ours, cpu_s]);
        }
    }
    figures.rows.push(peak_row(&peaks));
    Ok(figures)
}

/// Starts the PyTorch program and compares a round with ours; returns it with the version of torch.
fn start<R: Round>(
    round: &mut R,
    python: &Path,
    quiet: bool,
) -> Result<(Program, String), Failure> {
    let mut ours = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
    let write = |path: &Path| round.write(path).map(|expected| ours = expected);
    let (program, ready) = Program::start::<Ready>(python, R::PROGRAM, &[SHARED], write)?;
    for ((_, engine), found) in FORMULATIONS.iter().zip([&ready.published, &ready.lean]) {
        found.check((engine, "policies and critic"), ours, quiet)?;
    }
    Ok((program, ready.torch))
}

impl Tensors {
    fn parameters(&mut self, of: &str, parameters: &Parameters, values: &[f32]) {
        for tensor in parameters.tensors() {
            let name = format!("{of}.{}", tensor.name);
            self.floats(name, &tensor.shape, &values[tensor.range.clone()]);
        }
    }

    /// The weights of critic and policies.
    pub(super) fn weights(&mut self, learner: &ActorCritic) {
        for (name, learner) in
            [("critic", &learner.critic_learner), ("policies", &learner.policy_learner)]
        {
            self.parameters(name, &learner.online, &learner.online.values);
        }
    }

    /// Their gradients of the last update.
    pub(super) fn gradients(&mut self, learner: &ActorCritic) {
        for (name, learner) in [
            ("gradient.critic", &learner.critic_learner),
            ("gradient.policies", &learner.policy_learner),
        ] {
            self.parameters(name, &learner.online, learner.gradient());
        }
    }

    pub(super) fn actions(&mut self, kind: &str, actions: &[Vec<u32>]) {
        for (index, actions) in actions.iter().enumerate() {
            let values: Vec<i64> = actions.iter().map(|action| i64::from(*action)).collect();
            self.integers(format!("{kind}.{index}"), &[values.len()], &values);
        }
    }
}
