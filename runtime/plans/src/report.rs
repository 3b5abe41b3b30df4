//! What a compiler is told, and what it tells of the plan that it made.

use serde::{Deserialize, Serialize};
use sortie_core::internal::ops::{Flag, Meaning, Members, OpRef, OutputRows, Targets};
use sortie_core::limits;
use sortie_core::plan::{Profile, Program};

use crate::comparison::Comparison;
use crate::error::CompileError;
use crate::team_policy::TeamSizes;

/// The compiler's version; a plan of another version is compiled again.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "-6");

/// What the file alone does not say.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct CompileOptions {
    /// Most visible entities.
    pub n_max: usize,
    /// How the plan computes.
    pub profile: Profile,
    /// Most subtasks, 0 if none. A network over all entities says itself how many groups it has.
    pub t_max: u16,
    /// Features d before the last action's one-hot; none: as the file's metadata says, else all columns.
    pub features: Option<usize>,
    /// Hash of the contract; none: as the file's metadata says, else 0.
    pub contract: Option<u64>,
    /// The team that a policy acts in; none: its plan is for a caller that knows what the inputs are.
    pub team: Option<TeamSizes>,
    /// Random observations that plan and graph must agree on.
    pub inputs: usize,
    /// Seed of the observations.
    pub seed: u64,
}

impl Default for CompileOptions {
    fn default() -> Self {
        let n_max = 32.min(limits::ENTITIES);
        let profile = Profile::Exact;
        Self {
            n_max,
            profile,
            t_max: 0,
            features: None,
            contract: None,
            team: None,
            inputs: 256,
            seed: 0,
        }
    }
}

/// A plan and what is known about it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Compiled {
    /// The plan.
    pub bytes: Vec<u8>,
    /// Sizes, work and measured error.
    pub report: Report,
}

/// What is known about a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Bytes of the plan.
    pub flash_bytes: usize,
    /// Bytes of arena for one decision.
    pub arena_bytes: usize,
    /// Bytes of arena for every further agent of a team that decides together, 0 where agents decide one by one.
    pub arena_bytes_per_agent: usize,
    /// Multiply-adds of one decision with all entities visible, zeros not left out.
    pub macs: u64,
    /// Largest distance of a number from the network in double precision, in what 32 bits make right engines err there.
    pub max_distance: f32,
    /// Observations for which plan and graph choose differently.
    pub action_mismatches: usize,
    /// Observations compared.
    pub inputs: usize,
    /// The operators in order.
    pub operators: Vec<OperatorReport>,
}

/// One operator of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatorReport {
    /// Its kind.
    pub name: String,
    /// Its sizes, for people.
    pub detail: String,
    /// Its multiply-adds with all entities visible.
    pub macs: u64,
}

/// What is known about a plan of this program.
pub fn report(
    program: &Program<'_>,
    n_max: usize,
    flash_bytes: usize,
    comparison: &Comparison,
) -> Report {
    let operators = operators(program, n_max);
    Report {
        flash_bytes,
        arena_bytes: program.arena_bytes() as usize,
        arena_bytes_per_agent: 4 * program.own_floats().unwrap_or(0) as usize,
        macs: operators.iter().map(|operator| operator.macs).sum(),
        max_distance: comparison.max_distance.unwrap_or(0.0) as f32,
        action_mismatches: comparison.action_mismatches,
        inputs: comparison.inputs,
        operators,
    }
}

/// The operators of a program, for reports.
pub(crate) fn operators(program: &Program<'_>, n_max: usize) -> Vec<OperatorReport> {
    let describe = |op: OpRef<'_>| OperatorReport {
        name: op.name().to_owned(),
        detail: detail(op),
        macs: op.multiply_adds(n_max),
    };
    program.ops().map(describe).collect()
}

fn detail(op: OpRef<'_>) -> String {
    let relu = |relu: Flag| if relu.is_set() { ", relu" } else { "" };
    let heads = |heads: u16| format!("{heads} {}", if heads == 1 { "head" } else { "heads" });
    let rows = |inputs: u16, outputs: u16, is_relu: Flag| {
        format!("[N, {inputs}] -> [N, {outputs}]{}", relu(is_relu))
    };
    let layer = |inputs: u16, outputs: u16, is_relu: Flag| {
        format!("[{inputs}] -> [{outputs}]{}", relu(is_relu))
    };
    let own = |[width, outputs, count]: [u16; 3], skips: bool, is_relu: Flag| {
        let (skip, relu) = (if skips { ", skip" } else { "" }, relu(is_relu));
        format!("[N, {width}] -> [{outputs}], {}{skip}{relu}", heads(count))
    };
    let point = |targets: &Targets| {
        let actions = targets.untargeted + targets.count;
        let pairs = match targets.pair_features {
            0 => String::new(),
            features => format!(" and [{}, {features}]", targets.count),
        };
        format!("[N, {}]{pairs} -> [{}] of [{actions}]", targets.width, targets.count)
    };
    match op {
        OpRef::EmbedEntities(op) => rows(op.layer.inputs, op.layer.outputs, op.relu),
        OpRef::AttendOwn(op) => own([op.width, op.output.outputs, op.heads], op.skips(), op.relu),
        OpRef::Dense(op) => layer(op.layer.inputs, op.layer.outputs, op.relu),
        OpRef::Gru(op) => format!("[{}], state [{}]", op.input.inputs, op.size),
        OpRef::AttendAll(op) => {
            let (width, outputs) = (op.width, op.output.outputs);
            format!("[N, {width}] -> [N, {outputs}], {}{}", heads(op.heads), relu(op.relu))
        }
        OpRef::MeanRows(op) => {
            let whose = if op.members == Members::Agents { "of agents" } else { "of all" };
            format!("[N, {}] -> [{}], {whose}", op.width, op.width)
        }
        OpRef::GroupSum(op) => format!("[N, {}] -> [{}, {}]", op.width, op.groups, op.width),
        OpRef::Output(op) => match op.rows {
            OutputRows::Entities => format!("[N, {}]", op.width),
            OutputRows::Groups => format!("[{}, {}]", op.groups, op.width),
            _ => format!("[{}]", op.width),
        },
        OpRef::Int8EmbedEntities(op) => rows(op.layer.inputs, op.layer.outputs, op.relu),
        OpRef::Int8AttendOwn(op) => {
            own([op.width, op.output.outputs, op.heads], op.skips(), op.relu)
        }
        OpRef::Int8Dense(op) => layer(op.layer.inputs, op.layer.outputs, op.relu),
        OpRef::PointAtEntities(op) => point(&op.targets),
        OpRef::Int8PointAtEntities(op) => point(&op.targets),
        OpRef::EmbedTasks(op) => {
            let (features, tasks) = (op.embed.inputs, op.tasks.count);
            format!("[N, {features}] -> [N, {0}], [{tasks}, {0}]", op.embed.outputs)
        }
        OpRef::PointerLogits(op) => format!("[{}] -> logits of subtasks", op.from_task.inputs),
        OpRef::ScoreAllocations(op) => {
            format!("[N, {}] -> [N, {}] -> value", op.embed.inputs, op.embed.outputs)
        }
        OpRef::Input(op) if op.meaning == Meaning::None => format!("[{}]", op.to.len),
        OpRef::Input(op) => format!("[{}], {:?}", op.to.len, op.meaning),
        OpRef::State(op) => format!("[{}]", op.from.len),
        OpRef::Constant(op) => format!("[{}]", op.to.len),
        OpRef::Map(op) => format!("{:?}, [{}]", op.function, op.to.len),
        OpRef::Combine(op) => {
            format!("{:?}, [{}] and [{}]", op.combination, op.left.len, op.right.len)
        }
        OpRef::Select(op) => format!("[{}]", op.to.len),
        OpRef::Arrange(op) => format!("{:?} of [{}]", op.sizes, op.from.len),
        OpRef::Reduce(op) => {
            format!("{:?}, [{}, {}]", op.reduction, op.to.len, op.columns)
        }
        OpRef::Softmax(op) => format!("[{}, {}]", op.from.len / op.columns.max(1), op.columns),
        OpRef::Normalise(op) => format!("[{}, {}]", op.from.len / op.columns.max(1), op.columns),
        OpRef::Multiply(op) => {
            format!("[{}, {}] by [{}, {}]", op.rows, op.inner, op.inner, op.columns)
        }
        OpRef::DenseRows(op) => {
            let (rows, layer, relu) = (op.rows, &op.layer, relu(op.relu));
            format!("[{rows}, {}] -> [{rows}, {}]{relu}", layer.inputs, layer.outputs)
        }
        OpRef::LookUp(op) => {
            format!("[{}] -> [{}] of [{}, {}]", op.indices.len, op.to.len, op.rows, op.columns)
        }
        OpRef::GruCell(op) => format!("[{}]", op.to.len),
        OpRef::LstmCell(op) => format!("[{}]", op.to.len),
        OpRef::Convolve(op) => {
            let ([height, width], [rows, columns]) = (op.size, op.kernel);
            let picture = format!("[{}, {height}, {width}]", op.channels);
            let ([height, width], outputs) = (op.result, op.layer.outputs);
            let relu = relu(op.relu);
            format!("{picture} by {rows} x {columns} -> [{outputs}, {height}, {width}]{relu}")
        }
        OpRef::ConvolvePatches(op) => {
            let ([height, width], inputs) = (op.patches.count, op.patches.inputs());
            let relu = relu(op.relu);
            format!("{height} x {width} patches of {inputs} -> [{}]{relu}", op.outputs)
        }
        OpRef::Int8ConvolvePatches(op) => {
            let ([height, width], inputs) = (op.patches.count, op.patches.inputs());
            let relu = relu(op.relu);
            format!("{height} x {width} patches of {inputs} -> [{}]{relu}", op.outputs)
        }
        OpRef::FoldPatches(op) => {
            let ([height, width], [rows, columns]) = (op.patches.count, op.patches.runs);
            let (channels, fold, relu) = (op.patches.run, op.fold, relu(op.relu));
            format!(
                "{fold:?}, {height} x {width} patches of {rows} x {columns} x [{channels}]{relu}"
            )
        }
        OpRef::MaskedArgmax(op) => format!("[{}] -> action", op.from.len),
        OpRef::MaskedSample(op) => format!("[{}] -> drawn action", op.from.len),
        _ => String::new(),
    }
}

/// The ONNX files of an allocator that proposes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ProposalFiles<'a> {
    /// `allocator_trunk.onnx`
    pub trunk: &'a [u8],
    /// `allocator_step.onnx`
    pub step: &'a [u8],
    /// `allocator_critic.onnx`
    pub critic: &'a [u8],
}

impl<'a> ProposalFiles<'a> {
    /// The files as one, by which a plan is known.
    pub fn joined(&self) -> Vec<u8> {
        // Writing plain bytes to memory has no way to fail.
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// The files of what [`Self::joined`] gave.
    pub fn split(joined: &'a [u8]) -> Result<Self, CompileError> {
        let unreadable =
            |error: postcard::Error| CompileError::Unreadable { reason: error.to_string() };
        postcard::from_bytes(joined).map_err(unreadable)
    }
}
