//! The same update in PyTorch.

use std::collections::HashMap;
use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde::Deserialize;
use sortie_cli::failure::{Exit, Failure};
use sortie_cli::output::tell;
use sortie_envs::{EntitySet, Environment, Observation, members};
use sortie_methods::learners::agents::{NO_ACTION, UtilityView, transpose};
use sortie_methods::learners::records::{Drawn, Experience, Moment};

use super::learning::Learning;
use super::program::{Comparison, Expected, Program, Tensors, unclipped};

const PROGRAM: &str = include_str!("../../../../benches/train_step.py");

/// A running program that waits for its turn.
pub(super) struct Torch {
    program: Program,
    pub(super) version: String,
}

/// How a batch of teams of different sizes becomes tensors.
#[derive(Clone, Copy)]
pub(super) enum Formulation {
    /// Every team as large as the largest.
    Padded,
    /// All agents in one list, attention by indices.
    Packed,
}

impl Formulation {
    pub(super) const ALL: [Self; 2] = [Self::Padded, Self::Packed];

    /// Its name as a peer.
    pub(super) fn engine(self) -> &'static str {
        match self {
            Self::Padded => "pytorch, padded",
            Self::Packed => "pytorch, packed",
        }
    }

    /// Its name in the program.
    fn name(self) -> &'static str {
        match self {
            Self::Padded => "padded",
            Self::Packed => "packed",
        }
    }
}

/// What the program says once it is ready: the first batch in PyTorch.
#[derive(Deserialize)]
struct Ready {
    torch: String,
    padded: Comparison,
    packed: Comparison,
}

#[derive(Deserialize)]
struct Turn {
    updates: f64,
    cpu_s: f64,
}

impl Torch {
    /// Starts the program and compares one update with ours.
    pub(super) fn start(
        python: &Path,
        learning: &mut Learning,
        quiet: bool,
    ) -> Result<Self, Failure> {
        let mut expected = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
        let write = |path: &Path| write(learning, path).map(|found| expected = found);
        let (program, ready) = Program::start::<Ready>(python, PROGRAM, &[], write)?;
        for (formulation, found) in Formulation::ALL.iter().zip([&ready.padded, &ready.packed]) {
            found.check((formulation.engine(), "the agents"), expected, quiet)?;
        }
        Ok(Self { program, version: ready.torch })
    }

    /// Updates for so many CPU-seconds; returns updates per CPU-second.
    pub(super) fn turn(&mut self, how: Formulation, seconds: f64) -> Result<f64, Failure> {
        let turn: Turn = self.program.ask(&format!("{} {seconds}", how.name()))?;
        Ok(turn.updates / turn.cpu_s)
    }
}

/// The Python that has torch, or a note that there is none.
pub(super) fn find(asked: Option<&Path>, quiet: bool) -> Result<Option<PathBuf>, Failure> {
    let python = asked.map_or_else(default_python, Path::to_path_buf);
    if has_torch(&python) {
        return Ok(Some(python));
    }
    let message = format!("`{}` has no torch", python.display());
    if asked.is_some() {
        return Err(Failure::new(Exit::NotRunning, message));
    }
    if !quiet {
        tell!("note: {message}; only our figures follow (name another with --python)");
    }
    Ok(None)
}

fn default_python() -> PathBuf {
    match env::var_os("VIRTUAL_ENV") {
        Some(folder) => Path::new(&folder).join("bin/python3"),
        None => PathBuf::from("python3"),
    }
}

fn has_torch(python: &Path) -> bool {
    let mut command = Command::new(python);
    command.args(["-c", "import torch"]).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Batches that the peer learns from in turn.
const BATCHES: usize = 8;

impl Tensors {
    /// All weights in PyTorch's layout.
    pub(super) fn network(&mut self, of: &str, network: UtilityView<'_>) {
        for tensor in network.shape.tensors() {
            let values = &network.parameters[tensor.range];
            let name = format!("{of}.{}", tensor.name);
            match (&*tensor.name, &tensor.shape[..]) {
                ("fc1.weight", [rows, columns]) => {
                    let turned = transpose(values, *rows, *columns);
                    self.floats(name, &[*columns, *rows], &turned);
                }
                (_, [1, columns]) if tensor.name.ends_with("bias") => {
                    self.floats(name, &[*columns], values);
                }
                (_, shape) => self.floats(name, shape, values),
            }
        }
    }

    /// A batch, its teams padded to its largest.
    fn batch(&mut self, number: usize, experience: Experience<'_>, drawn: &[Drawn], team: usize) {
        let mut dense = Dense::default();
        for drawn in drawn {
            dense.push(experience, *drawn, team);
        }
        let count = drawn.len();
        let name = |part: &str| format!("batch{number}.{part}");
        let shape = experience.environment.spec().shape;
        let rows = [count, team + 1, shape.features + shape.actions];
        self.floats(name("rows"), &rows, &dense.rows);
        self.floats(name("next_rows"), &rows, &dense.next_rows);
        self.flags(name("present"), &[count, team], &dense.present);
        self.integers(name("actions"), &[count, team], &dense.actions);
        self.flags(name("next_available"), &[count, team, shape.actions], &dense.next_available);
        self.floats(name("reward"), &[count], &dense.reward);
        self.floats(name("discount"), &[count], &dense.discount);
    }
}

/// Rows `[records, team + 1, columns]` of agents and their thing, and what belongs to them.
#[derive(Default)]
struct Dense {
    rows: Vec<f32>,
    next_rows: Vec<f32>,
    present: Vec<bool>,
    actions: Vec<i64>,
    next_available: Vec<bool>,
    reward: Vec<f32>,
    discount: Vec<f32>,
}

impl Dense {
    /// Adds a record, turned as it was drawn.
    fn push(&mut self, experience: Experience<'_>, drawn: Drawn, team: usize) {
        let Experience { environment, replay } = experience;
        let (sample, turn) = (replay.sample(drawn.sample), drawn.turn);
        let own = sample.now.team(sample.task);
        let agents: Vec<usize> = members(own.into()).collect();
        let things = sample.things;
        let sight = EntitySet::from(own) | things;
        let now = Seen::new(environment, sample.now, turn, sight);
        let next = Seen::new(environment, sample.next, turn, sight);
        for place in 0..team {
            let member = agents.get(place).copied();
            let action = member.map_or(0, |agent| now.turned(sample.now.actions[agent].into()));
            self.present.push(member.is_some());
            self.actions.push(action.into());
            let available = member.map_or(0, |agent| next.seen.available[agent]);
            let actions = environment.spec().shape.actions;
            self.next_available.extend((0..actions).map(|action| available >> action & 1 == 1));
            self.rows.extend(now.row(member));
            self.next_rows.extend(next.row(member));
        }
        let thing = members(things).next();
        self.rows.extend(now.row(thing));
        self.next_rows.extend(next.row(thing));
        self.reward.push(sample.reward);
        self.discount.push(sample.discount);
    }
}

/// What a team sees in a moment, turned.
struct Seen<'a> {
    environment: &'a dyn Environment,
    moment: Moment<'a>,
    turn: usize,
    seen: Observation,
}

impl<'a> Seen<'a> {
    fn new(
        environment: &'a dyn Environment,
        moment: Moment<'a>,
        turn: usize,
        sight: EntitySet,
    ) -> Self {
        let mut seen = Observation::default();
        environment.observe(moment.state, turn, sight, &mut seen);
        Self { environment, moment, turn, seen }
    }

    fn turned(&self, action: u16) -> u16 {
        self.environment.turned_action(self.turn, action)
    }

    /// The row of an entity, an agent's with its last action, or of none.
    fn row(&self, entity: Option<usize>) -> Vec<f32> {
        let shape = self.environment.spec().shape;
        let mut row = vec![0.0; shape.features + shape.actions];
        let Some(entity) = entity else { return row };
        self.seen.rows.write_dense(self.seen.row_of(entity), &mut row[..shape.features]);
        let last_action = self.moment.last_actions.get(entity).copied().unwrap_or(NO_ACTION);
        if last_action != NO_ACTION {
            row[shape.features + usize::from(self.turned(last_action.into()))] = 1.0;
        }
        row
    }
}

/// Writes networks, batches and, for the first batch, our gradient.
pub(super) fn write(learning: &mut Learning, path: &Path) -> Result<Expected, Failure> {
    let mut tensors = Tensors::default();
    let mut expected = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
    for number in 0..BATCHES {
        let Learning { config, method, environment, .. } = &mut *learning;
        let before = [method.agents.online.values.clone(), method.agents.target.clone()];
        // A step of no length moves nothing but targets and means, a little; the gradient stands there.
        let found = method
            .update_agents(&**environment, 0.0)
            .ok_or_else(|| Failure::new(Exit::Bug, "there is too little to learn from"))?;
        let experience = Experience { environment: &**environment, replay: &method.replay };
        let size = |drawn: &Drawn| {
            let sample = experience.replay.sample(drawn.sample);
            sample.now.team(sample.task).count_ones() as usize
        };
        let team = method.drawn().iter().map(size).max().unwrap_or(1);
        tensors.batch(number, experience, method.drawn(), team);
        if number == 0 {
            let norm = f64::from(found.gradient_norm);
            expected = Expected { loss: found.loss, gradient_norm: norm };
            let shape = config.network.shape(environment.spec());
            let slopes = unclipped(method.agents.gradient(), found.gradient_norm);
            let networks = [("online", &before[0]), ("target", &before[1]), ("gradient", &slopes)];
            for (of, parameters) in networks {
                tensors.network(of, UtilityView { shape, parameters });
            }
        }
    }
    tensors.write(settings(learning), path).map_err(Failure::bug)?;
    Ok(expected)
}

/// The numbers of the update, as the file's metadata.
fn settings(learning: &Learning) -> HashMap<String, String> {
    let optimiser = &learning.config.optimiser;
    let settings = [
        ("batches", BATCHES as f64),
        ("heads", learning.config.network.heads as f64),
        ("learning_rate", optimiser.learning_rate.into()),
        ("epsilon", optimiser.epsilon.into()),
        ("clip", optimiser.clip.into()),
        ("target_rate", optimiser.target_rate.into()),
        ("average_rate", optimiser.average_rate.into()),
    ];
    settings.map(|(name, value)| (name.to_string(), value.to_string())).into()
}
