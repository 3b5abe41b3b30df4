//! The same steps in PyTorch.

use std::collections::HashMap;
use std::path::Path;

use serde::Deserialize;
use sortie_cli::failure::{Exit, Failure};
use sortie_envs::random::unit;
use sortie_methods::learners::agents::{UtilityView, transpose};
use sortie_methods::learners::windows::allocation::{AllocationLevel, Noise, Rows, StepDraws};
use sortie_methods::learners::windows::low_level::LowLevel;
use sortie_methods::learners::windows::{PopArt, WindowShape, Windows};
use sortie_nn::tape::Parameters;

use super::super::program::{Comparison, Expected, Program, Tensors, unclipped};
use super::learning::Levels;

const PROGRAM: &str = include_str!("../../../../../benches/published_step.py");

/// A running program that waits for its turn.
pub(super) struct Torch {
    program: Program,
    pub(super) version: String,
}

/// How the steps are written for PyTorch.
#[derive(Clone, Copy)]
pub(super) enum Formulation {
    /// As the public code is structured: everything padded, then masked.
    Padded,
    /// Only what the loss depends on.
    Lean,
}

impl Formulation {
    pub(super) const ALL: [Self; 2] = [Self::Padded, Self::Lean];

    /// Its name as a peer.
    pub(super) fn engine(self) -> &'static str {
        match self {
            Self::Padded => "pytorch, padded",
            Self::Lean => "pytorch, lean",
        }
    }

    /// Its name in the program.
    fn name(self) -> &'static str {
        match self {
            Self::Padded => "padded",
            Self::Lean => "lean",
        }
    }
}

/// What the program says once it is ready.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    padded: Levelled,
    lean: Levelled,
}

/// The gradients of one formulation.
#[derive(Deserialize)]
struct Levelled {
    online: Comparison,
    critic: Comparison,
    policy: Comparison,
}

#[derive(Deserialize)]
struct Turn {
    cpu_s: f64,
}

impl Torch {
    /// Starts the program and compares both steps with ours.
    pub(super) fn start(
        python: &Path,
        levels: &mut Levels,
        quiet: bool,
    ) -> Result<(Self, Found), Failure> {
        let mut ours = None;
        let write = |path: &Path| {
            ours = Some(compute(levels, Some(path))?);
            Ok(())
        };
        let (program, ready) = Program::start::<Ready>(python, PROGRAM, &[], write)?;
        let ours =
            ours.ok_or_else(|| Failure::new(Exit::Bug, "the PyTorch program got no batch"))?;
        for (formulation, found) in Formulation::ALL.iter().zip([&ready.padded, &ready.lean]) {
            let engine = formulation.engine();
            found.online.check((engine, "agents and mixer"), ours.low_level, quiet)?;
            found.critic.check((engine, "the allocation critic"), ours.critic, quiet)?;
            found.policy.check((engine, "the proposal policy"), ours.policy, quiet)?;
        }
        Ok((Self { program, version: ready.torch }, ours))
    }

    /// CPU-seconds of one step of each level.
    pub(super) fn turn(&mut self, how: Formulation) -> Result<[f64; 2], Failure> {
        let mut step = |level: &str| -> Result<f64, Failure> {
            let turn: Turn = self.program.ask(&format!("{} {level}", how.name()))?;
            Ok(turn.cpu_s)
        };
        Ok([step("low_level")?, step("allocation")?])
    }
}

/// What our steps find for the batch.
pub(super) struct Found {
    pub(super) low_level: Expected,
    pub(super) critic: Expected,
    pub(super) policy: Expected,
    /// Values that the low level learns, and decisions that the allocator learns from.
    pub(super) terms: usize,
    pub(super) rows: usize,
}

/// Computes both steps, and writes all that a peer needs to do the same if there is a `path`.
pub(super) fn compute(levels: &mut Levels, path: Option<&Path>) -> Result<Found, Failure> {
    let WindowShape { tasks, agents, .. } = levels.windows.shape;
    let learning = levels.allocation.learning.clone();
    let mut draws = StepDraws::draw(tasks, learning.shape.columns, &mut levels.generator);
    let mut rows = Rows::default();
    rows.collect(&levels.windows, 0, &learning.config);
    let length = rows.len() * learning.config.proposals * agents * tasks;
    let mut gumbel = || {
        let drawn = unit(&mut levels.generator).max(f64::MIN_POSITIVE);
        -(-drawn.ln()).ln() as f32
    };
    let noise: Vec<f32> = (0..length).map(|_| gumbel()).collect();
    draws.noise = Noise::Gumbel(&noise);

    let mut low_level = levels.low_level.clone();
    let report = low_level.descend(&levels.windows, 1, &mut levels.generator);
    let mut allocation = levels.allocation.clone();
    let allocated = allocation
        .learn_with(&levels.windows, 0, &draws, 1)
        .ok_or_else(|| Failure::new(Exit::Bug, "the batch holds no decision to learn from"))?;
    let expected = |loss: f64, norm: f32| Expected { loss, gradient_norm: norm.into() };
    let found = Found {
        low_level: expected(report.loss, report.gradient_norm),
        critic: expected(allocated.critic_loss, allocated.critic_norm),
        policy: expected(
            allocated.policy_loss - f64::from(learning.config.entropy) * allocated.entropy,
            allocated.policy_norm,
        ),
        terms: report.terms,
        rows: allocated.rows,
    };
    let Some(path) = path else { return Ok(found) };

    let mut tensors = Tensors::default();
    tensors.windows(&levels.windows);
    tensors.rows(&levels.windows, &rows);
    tensors.floats("noise".into(), &[rows.len(), learning.config.proposals, agents, tasks], &noise);
    for (name, columns) in [
        ("policy", &draws.proposals.policy),
        ("critic", &draws.proposals.critic),
        ("stored", &draws.stored),
        ("target", &draws.target),
    ] {
        let columns: Vec<i64> = columns.iter().map(|column| i64::from(*column)).collect();
        tensors.integers(format!("columns.{name}"), &[tasks], &columns);
    }
    tensors.low_level("online", &low_level, &levels.low_level.online.values);
    tensors.low_level("target", &low_level, &levels.low_level.target);
    tensors.low_level("gradient.online", &low_level, &low_level.gradient);
    let AllocationLevel { critic, policy, target, .. } = &levels.allocation;
    tensors.allocation("critic", &critic.parameters, &critic.parameters.values);
    tensors.allocation("target_critic", &target.parameters, &target.parameters.values);
    tensors.allocation("policy", &policy.parameters, &policy.parameters.values);

    let last = &allocation.last;
    let of_critic = unclipped(&last.critic_gradient, allocated.critic_norm);
    let of_policy = unclipped(&last.policy_gradient, allocated.policy_norm);
    tensors.allocation("gradient.critic", &critic.parameters, &of_critic);
    tensors.allocation("gradient.policy", &policy.parameters, &of_policy);
    let statistics = [critic.popart, target.popart];
    tensors.write(settings(levels, statistics), path).map_err(Failure::bug)?;
    Ok(found)
}

/// The numbers of both steps, as the file's metadata.
fn settings(levels: &Levels, [critic, target_critic]: [PopArt; 2]) -> HashMap<String, String> {
    let Levels { config, low_level, allocation, windows, .. } = levels;
    let (online, target) = (low_level.popart, low_level.target_popart);
    let settings = [
        ("steps", windows.shape.steps as f64),
        ("heads", config.low_level.heads as f64),
        ("proposals", config.allocation.proposals as f64),
        ("discount", config.low_level.returns.discount.into()),
        ("clip", config.low_level.clip.into()),
        ("entropy", allocation.learning.config.entropy.into()),
        ("learning_rate", allocation.learning.learning_rate.into()),
        ("mean", online.mean),
        ("variance", online.variance),
        ("target_mean", target.mean),
        ("target_variance", target.variance),
        ("critic_mean", critic.mean),
        ("critic_variance", critic.variance),
        ("target_critic_mean", target_critic.mean),
        ("target_critic_variance", target_critic.variance),
    ];
    settings.map(|(name, value)| (name.to_string(), value.to_string())).into()
}

/// Numbers with -1 for none.
fn or_none(values: &[u8]) -> Vec<i64> {
    values.iter().map(|value| if *value == u8::MAX { -1 } else { i64::from(*value) }).collect()
}

impl Tensors {
    fn windows(&mut self, windows: &Windows) {
        let WindowShape { agents, entities, tasks, actions, features, .. } = windows.shape;
        let states = windows.shape.states();
        let mut dense = vec![0.0; states * entities * features];
        for (row, values) in dense.chunks_exact_mut(features).enumerate() {
            windows.features.row(row).for_each(|(column, value)| values[column] = value);
        }
        let open =
            |set: &u128| (0..actions).map(|action| set >> action & 1 == 1).collect::<Vec<_>>();
        let available: Vec<bool> = windows.available.iter().flat_map(open).collect();
        let taken: Vec<i64> = windows.actions.iter().map(|action| i64::from(*action)).collect();
        let name = |part: &str| format!("batch.{part}");
        self.floats(name("features"), &[states, entities, features], &dense);
        self.flags(name("present"), &[states, entities], &windows.present);
        self.flags(name("observable"), &[states, agents, entities], &windows.observable);
        self.integers(name("entity_task"), &[states, entities], &or_none(&windows.entity_task));
        self.flags(name("available"), &[states, agents, actions], &available);
        self.integers(name("actions"), &[states, agents], &taken);
        self.integers(name("last_actions"), &[states, agents], &or_none(&windows.last_actions));
        self.floats(name("task_reward"), &[states, tasks], &windows.task_reward);
        self.flags(name("task_terminated"), &[states, tasks], &windows.task_terminated);
        self.flags(name("task_unfinished"), &[states, tasks], &windows.task_unfinished);
        self.flags(name("has_transition"), &[states], &windows.has_transition);
    }

    /// The decision points, in the order of the windows.
    fn rows(&mut self, windows: &Windows, rows: &Rows) {
        let WindowShape { agents, tasks, .. } = windows.shape;
        let decided = (0..windows.shape.states()).filter(|state| windows.decision[*state]);
        let (mut states, mut open, mut last) = (Vec::new(), Vec::new(), Vec::new());
        for state in decided.take(rows.len()) {
            states.push(state as i64);
            open.extend_from_slice(&windows.open[state * tasks..][..tasks]);
            last.extend_from_slice(&windows.last_allocation[state * agents..][..agents]);
        }
        let count = rows.len();
        self.integers("rows.state".into(), &[count], &states);
        self.flags("rows.open".into(), &[count, tasks], &open);
        self.integers("rows.last_allocation".into(), &[count, agents], &or_none(&last));
        self.floats("rows.reward".into(), &[count], &rows.reward);
        self.flags("rows.terminated".into(), &[count], &rows.terminated);
        self.flags("rows.mask".into(), &[count], &rows.mask);
        self.floats("rows.weight".into(), &[count], &rows.weight);
    }

    /// The tensors of agents and mixer in the layouts of PyTorch, of these numbers.
    fn low_level(&mut self, of: &str, level: &LowLevel, values: &[f32]) {
        let agents = UtilityView { shape: level.shape(), parameters: values };
        self.network(&format!("{of}.agents"), agents);
        for tensor in level.online.tensors() {
            let Some(name) = tensor.name.strip_prefix("mixer.") else { continue };
            let (name, own) = (format!("{of}.{name}"), &values[tensor.range.clone()]);
            match tensor.shape[..] {
                [rows, columns] if name.ends_with("fc1.weight") => {
                    self.floats(name, &[columns, rows], &transpose(own, rows, columns));
                }
                _ => self.floats(name, &tensor.shape, own),
            }
        }
    }

    /// The tensors of critic or policy in the layouts of PyTorch, of these numbers.
    fn allocation(&mut self, of: &str, parameters: &Parameters, values: &[f32]) {
        for tensor in parameters.tensors() {
            let own = &values[tensor.range.clone()];
            let name = format!("{of}.{}", tensor.name);
            match (&*tensor.name, &tensor.shape[..]) {
                ("entity.weight" | "task.weight" | "count.weight", [rows, columns]) => {
                    self.floats(name, &[*columns, *rows], &transpose(own, *rows, *columns));
                }
                ("update.task.weight", [width, _]) => {
                    // The agent's half stands behind it, there beside it.
                    let agent = &values[tensor.range.end..][..own.len()];
                    let rows = own.chunks(*width).zip(agent.chunks(*width));
                    let rows: Vec<f32> = rows.flat_map(|both| [both.0, both.1].concat()).collect();
                    self.floats(format!("{of}.update.weight"), &[*width, 2 * width], &rows);
                }
                ("update.agent.weight", _) => {}
                ("update.agent.bias", _) => {
                    self.floats(format!("{of}.update.bias"), &[own.len()], own);
                }
                (part, [1, columns]) if part.ends_with("bias") => {
                    self.floats(name, &[*columns], own);
                }
                (_, shape) => self.floats(name, shape, own),
            }
        }
    }
}
