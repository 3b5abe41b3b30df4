//! MAAC's preset `paper`: CPU-seconds of a round of updates, and of the same round in PyTorch.

use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

use serde::Deserialize;
use sortie_envs::random::{below, unit};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::maac::{Batch, Config, Draw, Group, Groups, Learner, MAAC, Rows};
use sortie_nn::layers::products::Products;
use sortie_nn::random::Generator;
use sortie_nn::tape::Parameters;

use super::super::rounds::paired_ratio;
use super::super::{Figures, Measuring, Ratio, Row, pin, thread_cpu_s};
use super::program::{Comparison, Expected, Program};
use super::tensors::Tensors;
use super::{Arithmetic, TrainArguments, at, find, peak_gflops, peak_row};
use crate::failure::{Exit, Failure};
use crate::methods;

const PROGRAM: &str = include_str!("../../../benches/maac_round.py");
/// How the round is written for PyTorch: its name in the program, and as a peer.
const FORMULATIONS: [(&str, &str); 2] =
    [("published", "pytorch, as published"), ("lean", "pytorch, lean")];
/// The world whose sizes the networks have.
const SET: &str = "treasure-8";
/// Rounds that are measured however little time there is.
const LEAST_ROUNDS: usize = 3;
/// CPU-seconds for the machine's peak in every round.
const PEAK_S: f64 = 0.1;

/// What the program says once it is ready.
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

/// Networks, and what they learn from.
struct Round {
    config: Config,
    groups: Groups,
    learner: Learner,
    batch: Batch,
    random: Generator,
    /// With which instructions products are computed.
    products: Products,
}

/// Draws as agents do, and keeps what was drawn.
struct Kept<'a> {
    random: &'a mut Generator,
    drawn: Vec<Vec<Vec<u32>>>,
}

impl Draw for Kept<'_> {
    fn draw(&mut self, groups: &Groups, scores: &Rows) -> Vec<Vec<u32>> {
        let drawn = self.random.draw(groups, scores);
        self.drawn.push(drawn.clone());
        drawn
    }
}

pub(super) fn measure(arguments: &TrainArguments) -> Result<Figures, Failure> {
    let Measuring { common, seconds, .. } = arguments.measuring;
    let python = find(arguments.python.as_deref(), common.quiet)?;
    pin(arguments.measuring.pin)?;
    let mut round = Round::new(&arguments.assignments, common.seed)?;
    let mut torch = python.map(|python| round.start(&python, common.quiet)).transpose()?;
    let (records, products) = (round.config.replay.batch, round.products);
    let name = format!("round of MAAC, {records} records of {SET}, {products}");
    let (mut ours, mut peaks) = (Vec::new(), Vec::new());
    let mut peers = FORMULATIONS.map(|_| Vec::new());
    let since = Instant::now();
    // The first round fills caches and buffers.
    let mut turns = 0;
    while turns <= LEAST_ROUNDS || since.elapsed().as_secs_f64() < seconds {
        peaks.push(peak_gflops(PEAK_S));
        ours.push(round.turn());
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
    figures.arithmetic.push(round.arithmetic(&name, at(&ours, 0.5), peak));
    if let Some((_, version)) = &torch {
        for ((_, peer), cpu_s) in FORMULATIONS.into_iter().zip(&peers) {
            figures.rows.push(times(&name, peer, version, cpu_s));
            let [ratio, low, high] = paired_ratio(&ours, cpu_s);
            let (what, case, engine) = ("train", name.clone(), "sortie");
            figures.ratios.push(Ratio { what, case, engine, peer, ratio, low, high });
        }
    }
    figures.rows.push(peak_row(&peaks));
    Ok(figures)
}

impl Round {
    fn new(assignments: &[String], seed: u64) -> Result<Self, Failure> {
        let set = |setup, assignment: &String| MAAC.set(&setup, assignment);
        let mut setup = assignments.iter().try_fold(MAAC.preset("paper")?, set)?;
        setup.environment.set = SET.to_string();
        methods::settle(&MAAC, &mut setup.environment)?;
        let environment = methods::open_environment(&setup.environment)?;
        let products = setup.run.settled_products()?;
        products.use_here();
        let mut config: Config = setup.own()?;
        // As the PyTorch of today has it; the work is the same.
        config.optimiser.early_epsilon = false;
        let groups = Groups::new(environment.spec(), false, false);
        let mut random = generator(seed, Purpose::Replay, 0);
        let batch = batch(&groups, &config, &mut random);
        let mut weights = generator(seed, Purpose::Weights, 0);
        let learner = Learner::new(config.clone(), groups.clone(), 1, &mut weights);
        Ok(Self { config, groups, learner, batch, random, products })
    }

    /// CPU-seconds of a round.
    fn turn(&mut self) -> f64 {
        let start = thread_cpu_s();
        self.learner.update(&mut self.batch, self.config.entropy.end, &mut self.random);
        thread_cpu_s() - start
    }

    /// Starts the PyTorch program and compares a round with ours; returns it with the version of torch.
    fn start(&mut self, python: &Path, quiet: bool) -> Result<(Program, String), Failure> {
        let mut ours = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
        let write = |path: &Path| self.write(path).map(|expected| ours = expected);
        let (program, ready) = Program::start::<Ready>(python, PROGRAM, write)?;
        for ((_, engine), found) in FORMULATIONS.iter().zip([&ready.published, &ready.lean]) {
            found.check((engine, "policies and critic"), ours, quiet)?;
        }
        Ok((program, ready.torch))
    }

    /// Writes networks and batch, does a round and writes its draws and gradients.
    fn write(&mut self, path: &Path) -> Result<Expected, Failure> {
        let mut tensors = Tensors::default();
        let Self { config, groups, learner, batch, random, .. } = self;
        let (critic, policies) = (&learner.critic.parameters, &learner.policies.parameters);
        tensors.parameters("critic", critic, &critic.values);
        tensors.parameters("policies", policies, &policies.values);
        for (index, group) in groups.0.iter().enumerate() {
            let rows = batch.records;
            let mut floats = |kind: &str, columns: &[usize], values: &[f32]| {
                let shape = [&[rows], columns].concat();
                tensors.floats(format!("{kind}.{index}"), &shape, values);
            };
            floats("observations", &[group.inputs()], &batch.observations[index]);
            floats("next", &[group.inputs()], &batch.next[index]);
            floats("rewards", &[], &batch.rewards[index]);
            floats("discounts", &[], &batch.discounts[index]);
        }
        tensors.actions("actions", &batch.actions);
        let mut kept = Kept { random, drawn: Vec::new() };
        let report = learner.update(batch, config.entropy.end, &mut kept);
        for (kind, drawn) in ["drawn_next", "drawn"].iter().zip(&kept.drawn) {
            tensors.actions(kind, drawn);
        }
        tensors.parameters("gradient.critic", &learner.critic.parameters, &learner.critic_gradient);
        let (policies, gradient) = (&learner.policies.parameters, &learner.policy_gradient);
        tensors.parameters("gradient.policies", policies, gradient);
        tensors
            .write(settings(config, groups), path)
            .map_err(|error| Failure::new(Exit::Bug, format!("{}: {error}", path.display())))?;
        Ok(Expected { loss: report.loss, gradient_norm: f64::from(report.gradient_norm) })
    }

    /// What the products of a round compute, by sizes alone.
    fn arithmetic(&self, name: &str, cpu_s: f64, peak: f64) -> Arithmetic {
        let operations: f64 =
            self.groups.0.iter().map(|group| operations(group, &self.groups, &self.config)).sum();
        let gflop_per_cpu_s = operations / cpu_s / 1e9;
        Arithmetic {
            case: name.to_string(),
            mflop: operations / 1e6,
            gflop_per_cpu_s,
            share_of_peak: gflop_per_cpu_s / peak,
        }
    }
}

/// Records of agents that saw noise, did anything and earned noise; one in fifty ended an episode.
fn batch(groups: &Groups, config: &Config, random: &mut Generator) -> Batch {
    let records = config.replay.batch;
    let mut batch = Batch::default();
    batch.clear(groups);
    batch.records = records;
    for (index, group) in groups.0.iter().enumerate() {
        let mut noise = |count: usize| -> Vec<f32> {
            (0..count).map(|_| 2.0 * unit(random) as f32 - 1.0).collect()
        };
        batch.observations[index] = noise(records * group.inputs());
        batch.next[index] = noise(records * group.inputs());
        batch.rewards[index] = noise(records);
        let actions = (0..records).map(|_| below(random, group.actions) as u32);
        batch.actions[index] = actions.collect();
        let goes_on = (0..records).map(|_| if below(random, 50) == 0 { 0.0 } else { 1.0 });
        let discounts = goes_on.map(|goes_on| config.returns.discount * goes_on);
        batch.discounts[index] = discounts.collect();
    }
    batch
}

fn settings(config: &Config, groups: &Groups) -> HashMap<String, String> {
    let (optimiser, update) = (&config.optimiser, &config.update);
    let of = |(name, number): (&str, f64)| (name.to_string(), number.to_string());
    let settings = [
        ("agents", groups.agents() as f64),
        ("heads", config.network.heads as f64),
        ("rate", f64::from(optimiser.critic_rate)),
        ("weight_decay", f64::from(optimiser.weight_decay)),
        ("critic_clip", f64::from(optimiser.critic_clip)),
        ("policy_clip", f64::from(optimiser.policy_clip)),
        ("target_rate", f64::from(optimiser.target_rate)),
        ("entropy", f64::from(config.entropy.end)),
        ("attention_penalty", f64::from(update.attention_penalty)),
        ("score_penalty", f64::from(update.score_penalty)),
    ];
    settings.into_iter().map(of).collect()
}

/// Operations of the products of a round for the agents of a group: of three passes through the critic one goes back, of
/// three through the policy too. A layer that goes back costs as much again for its weights, and as much for its input.
fn operations(group: &Group, groups: &Groups, config: &Config) -> f64 {
    let (inputs, actions) = (group.inputs(), group.actions);
    let (critic, policy) = (config.network.critic_width, config.network.policy_width);
    let others = groups.agents() - 1;
    // Layers that are shown the batch, whose slopes nobody asks for.
    let first = [(inputs + actions) * critic + inputs * critic, inputs * policy];
    let inner = [
        3 * critic * critic + 2 * others * critic + 2 * critic * critic + critic * actions,
        policy * policy + policy * actions,
    ];
    let passes: usize = first.iter().zip(inner).map(|(first, inner)| 4 * first + 5 * inner).sum();
    let rows = config.replay.batch * group.agents.len();
    2.0 * (rows * passes) as f64
}

impl Tensors {
    fn parameters(&mut self, of: &str, parameters: &Parameters, values: &[f32]) {
        for tensor in parameters.tensors() {
            let name = format!("{of}.{}", tensor.name);
            self.floats(name, &tensor.shape, &values[tensor.range.clone()]);
        }
    }

    fn actions(&mut self, kind: &str, actions: &[Vec<u32>]) {
        for (index, actions) in actions.iter().enumerate() {
            let values: Vec<i64> = actions.iter().map(|action| i64::from(*action)).collect();
            self.integers(format!("{kind}.{index}"), &[values.len()], &values);
        }
    }
}

/// A row of CPU-seconds of one round.
fn times(case: &str, engine: &'static str, version: &str, cpu_s: &[f64]) -> Row {
    Row {
        what: "train",
        case: case.to_string(),
        engine,
        version: version.to_string(),
        p50: at(cpu_s, 0.5),
        p99: at(cpu_s, 0.99),
        p999: None,
        max: at(cpu_s, 1.0),
        unit: "CPU-seconds",
    }
}
