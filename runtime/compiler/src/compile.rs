//! From the bytes of an ONNX file to a plan that was checked against it.

use serde::{Deserialize, Serialize};
use sortie_bundle::{Bundle, PlanKey, cached_plan, plan_places, sha256};
use sortie_core::limits;
use sortie_core::ops::{Members, Op, OutputRows};
use sortie_core::plan::{AlignedBytes, Network, Plan, Profile, Program};

use crate::assemble::{Origin, assemble};
use crate::error::CompileError;
use crate::graph::{EntityRoles, Graph, Inputs, ProposalPart, TeamRoles};
use crate::lower::{AgentSizes, Choice, lower_agent, same_sizes};
use crate::lower_entities::{EntitySizes, lower_entities};
use crate::lower_int8::lower_agent_int8;
use crate::matching::{AgentLayers, match_agent, match_entities, match_team_value};
use crate::observations::{random_entities, random_observations, random_team_queries};
use crate::parity::{
    Comparison, TOLERANCE, entities_against_graph, plan_against_graph, team_values_against_graph,
};
use crate::proposals::{ProposalFiles, compile_proposals};

/// The compiler's version; a plan of another version is compiled again.
pub const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "-2");

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
    /// Random observations that plan and graph must agree on.
    pub inputs: usize,
    /// Seed of the observations.
    pub seed: u64,
}

impl Default for CompileOptions {
    fn default() -> Self {
        let n_max = 32.min(limits::ENTITIES);
        let profile = Profile::Exact;
        Self { n_max, profile, t_max: 0, features: None, contract: None, inputs: 256, seed: 0 }
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
    pub macs: usize,
    /// Largest measured error against the graph, |a - b| / (1 + max |b|).
    pub max_rel_error: f32,
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
    pub macs: usize,
}

/// Compiles an ONNX file, a network of an agent, of an allocator or over all entities, and proves the plan against it.
///
/// A damaged file can make the parser allocate without bound, loop or overflow the stack: files of strangers are
/// for a [`crate::CompilerProcess`].
pub fn compile(onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
    let graph = Graph::read(onnx)?;
    let Lowered { program, weights, sizes, network } = lower(&graph, options)?;
    let metadata = graph.metadata.get("sortie.contract");
    let known = metadata.and_then(|hash| u64::from_str_radix(hash, 16).ok());
    let mut origin = Origin {
        source: sha256(onnx),
        profile: options.profile,
        network,
        contract: options.contract.or(known).unwrap_or(0),
        t_max: match graph.inputs {
            Inputs::Entities(EntityRoles { group_count, .. }) => group_count as u16,
            _ => options.t_max,
        },
        max_error: 0.0,
        action_mismatch: 0.0,
    };
    let draft = assemble(&program, &weights, sizes, &origin);
    let comparison = prove(&draft, &graph, sizes, options)?;
    origin.max_error = comparison.max_rel_error;
    origin.action_mismatch = comparison.action_mismatches as f32 / comparison.inputs.max(1) as f32;
    let bytes = assemble(&program, &weights, sizes, &origin);
    let report = report(&program, sizes.n_max, bytes.len(), &comparison);
    Ok(Compiled { bytes, report })
}

/// What is known about a plan of this program.
pub(crate) fn report(
    program: &Program,
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
        max_rel_error: comparison.max_rel_error,
        action_mismatches: comparison.action_mismatches,
        inputs: comparison.inputs,
        operators,
    }
}

/// A network as a program.
struct Lowered {
    program: Program,
    weights: Vec<u8>,
    sizes: AgentSizes,
    network: Network,
}

/// Matches a graph and lowers what was found.
fn lower(graph: &Graph, options: &CompileOptions) -> Result<Lowered, CompileError> {
    let n_max = options.n_max;
    let drawn = graph.metadata.get("sortie.choice").is_some_and(|choice| choice == "sample");
    let choice = if drawn { Choice::Drawn } else { Choice::Greedy };
    let mut sizes = AgentSizes { n_max, features: graph.columns, actions: graph.actions, choice };
    let (layers, network) = match graph.inputs {
        Inputs::Agent(_) => {
            let features = options.features.or_else(|| graph.number("sortie.features"));
            sizes.features = features.unwrap_or(graph.columns);
            (match_agent(graph)?, Network::Agent)
        }
        Inputs::TeamValue(_) => (match_team_value(graph)?, Network::TeamValue),
        Inputs::Proposals(roles) => return Err(part_alone(roles.part)),
        Inputs::Entities(EntityRoles { group_count: groups, .. }) => {
            // No action is chosen, but a plan has one at least.
            sizes.actions = 1;
            let layers = match_entities(graph)?;
            let of_entities = EntitySizes { n_max, features: graph.columns, groups };
            let (program, weights) = lower_entities(&layers, of_entities)?;
            if options.profile == Profile::Int8 {
                return Err(CompileError::NoInt8 { what: "a network over all entities".into() });
            }
            return Ok(Lowered {
                program,
                weights: weights.to_bytes(),
                sizes,
                network: Network::Entities,
            });
        }
    };
    let (program, weights) = lower_layers(&layers, sizes, network, options.profile)?;
    Ok(Lowered { program, weights, sizes, network })
}

/// A part of an allocator that proposes is no plan by itself.
fn part_alone(part: ProposalPart) -> CompileError {
    CompileError::PartAlone { part: part.name().into() }
}

/// Lowers a network to operators of the profile, and their weights as the plan holds them.
fn lower_layers(
    layers: &AgentLayers,
    sizes: AgentSizes,
    network: Network,
    profile: Profile,
) -> Result<(Program, Vec<u8>), CompileError> {
    if profile != Profile::Int8 {
        return lower_agent(layers, sizes).map(|(program, weights)| (program, weights.to_bytes()));
    }
    if network != Network::Agent {
        return Err(CompileError::NoInt8 { what: "an allocator's network".into() });
    }
    lower_agent_int8(layers, sizes).map(|(program, weights)| (program, weights.bytes))
}

/// Compares a plan with its graph on random inputs, and refuses one that differs; of an int8 plan only the error is
/// measured, as its actions in the real environment decide about it.
fn prove(
    plan: &[u8],
    graph: &Graph,
    sizes: AgentSizes,
    options: &CompileOptions,
) -> Result<Comparison, CompileError> {
    let CompileOptions { inputs, n_max, seed, .. } = *options;
    let comparison = match graph.inputs {
        Inputs::Agent(_) => {
            let AgentSizes { features, actions, .. } = sizes;
            let observations = random_observations(inputs, n_max, features, actions, seed);
            plan_against_graph(plan, graph, &observations, seed)?
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let queries = random_team_queries(inputs, n_max, features, relations, seed);
            team_values_against_graph(plan, graph, &queries)?
        }
        Inputs::Proposals(roles) => return Err(part_alone(roles.part)),
        Inputs::Entities(EntityRoles { group_count, .. }) => {
            let steps = random_entities(inputs, n_max, sizes.features, group_count, seed);
            entities_against_graph(plan, graph, &steps)?
        }
    };
    let error = comparison.max_rel_error;
    if error.is_nan() || error > TOLERANCE && options.profile != Profile::Int8 {
        return Err(CompileError::Differs {
            error,
            limit: TOLERANCE,
            input: comparison.worst_input,
            seed,
        });
    }
    Ok(comparison)
}

/// The plan of a bundle's agent in the default profile, from the cache beside the bundle where it is still valid.
pub fn compile_bundle(bundle: &Bundle) -> Result<AlignedBytes, CompileError> {
    compile_bundle_as(bundle, Profile::Exact)
}

/// As [`compile_bundle`] in any profile.
pub fn compile_bundle_as(bundle: &Bundle, profile: Profile) -> Result<AlignedBytes, CompileError> {
    agent_plan(bundle, profile, &compile)
}

/// The plan of a bundle's learned allocator, if it has one, cached in the same way.
pub fn compile_allocator(bundle: &Bundle) -> Result<Option<AlignedBytes>, CompileError> {
    allocator_plan(bundle, &compile)
}

/// The plan of a bundle's proposing allocator, if it has one, cached in the same way.
pub fn compile_proposals_of(
    bundle: &Bundle,
    profile: Profile,
) -> Result<Option<AlignedBytes>, CompileError> {
    proposal_plan(bundle, profile, &|joined, options| {
        compile_proposals(&ProposalFiles::split(joined)?, options)
    })
}

/// What compiles: this process or another.
pub(crate) type Compile<'a> = &'a dyn Fn(&[u8], &CompileOptions) -> Result<Compiled, CompileError>;

/// As [`compile_bundle_as`] by any compiler.
pub(crate) fn agent_plan(
    bundle: &Bundle,
    profile: Profile,
    compile: Compile<'_>,
) -> Result<AlignedBytes, CompileError> {
    let n_max = bundle.manifest().limits.n_max.into();
    let plan = cached(bundle, bundle.agent_onnx(), profile, n_max, compile)?;
    let loaded = Plan::load(plan.as_slice())?;
    let (actions, hidden) = (loaded.actions(), loaded.hidden());
    if hidden != 0 {
        // Nobody who runs bundles keeps a state for an agent.
        return Err(CompileError::Size {
            what: "the recurrent state".into(),
            got: hidden,
            want: 0,
        });
    }
    if actions != usize::from(bundle.contract().actions) {
        let want = usize::from(bundle.contract().actions);
        let what = "the number of utilities".into();
        return Err(CompileError::Size { what, got: actions, want });
    }
    Ok(plan)
}

/// As [`compile_allocator`] by any compiler.
pub(crate) fn allocator_plan(
    bundle: &Bundle,
    compile: Compile<'_>,
) -> Result<Option<AlignedBytes>, CompileError> {
    let Some(onnx) = bundle.allocator_onnx() else { return Ok(None) };
    // Several teams are valued together, and every agent is a member of some and a stranger to others: two rows.
    let n_max = (2 * usize::from(bundle.manifest().limits.n_max)).min(limits::ENTITIES);
    let plan = cached(bundle, onnx, Profile::Exact, n_max, compile)?;
    Plan::load(plan.as_slice())?.check_network(Network::TeamValue)?;
    Ok(Some(plan))
}

/// The plan of a bundle's proposing allocator, if it has one, from the cache where it is still valid; `compile`
/// gets the joined files.
pub(crate) fn proposal_plan(
    bundle: &Bundle,
    profile: Profile,
    compile: Compile<'_>,
) -> Result<Option<AlignedBytes>, CompileError> {
    let Some([trunk, step, critic]) = bundle.proposal_graphs() else { return Ok(None) };
    let joined = ProposalFiles { trunk, step, critic }.joined();
    let limits = bundle.manifest().limits;
    let plan = cached(bundle, &joined, profile, limits.n_max.into(), compile)?;
    let loaded = Plan::load(plan.as_slice())?;
    loaded.check_network(Network::Proposals)?;
    let header = loaded.header();
    let features = usize::from(bundle.contract().features);
    same_sizes("the allocator's number of features", header.features as usize, features)?;
    let (what, got) = ("the allocator's number of subtasks", usize::from(header.t_max));
    if got < usize::from(limits.t_max) {
        return Err(CompileError::Size { what: what.into(), got, want: limits.t_max.into() });
    }
    Ok(Some(plan))
}

fn cached(
    bundle: &Bundle,
    onnx: &[u8],
    profile: Profile,
    n_max: usize,
    compile: Compile<'_>,
) -> Result<AlignedBytes, CompileError> {
    let (contract, limits) = (bundle.contract(), bundle.manifest().limits);
    let options = CompileOptions {
        n_max,
        profile,
        t_max: limits.t_max,
        features: Some(usize::from(contract.features)),
        contract: Some(contract.hash()),
        ..CompileOptions::default()
    };
    let key = PlanKey {
        onnx,
        profile: profile.name(),
        compiler: VERSION,
        contract: contract.hash(),
        n_max: options.n_max,
    };
    let places = plan_places(bundle.folder());
    cached_plan(&places, &key, || compile(onnx, &options).map(|compiled| compiled.bytes))
}

/// The operators of a program, for reports.
pub(crate) fn operators(program: &Program, n_max: usize) -> Vec<OperatorReport> {
    let describe = |op: &Op| OperatorReport {
        name: op.name().to_owned(),
        detail: detail(op),
        macs: op.multiply_adds(n_max),
    };
    program.ops.iter().map(describe).collect()
}

fn detail(op: &Op) -> String {
    let relu = |relu: bool| if relu { ", relu" } else { "" };
    match op {
        Op::EmbedEntities(op) => {
            format!("[N, {}] -> [N, {}]{}", op.layer.inputs, op.layer.outputs, relu(op.relu))
        }
        Op::AttendOwn(op) => {
            let heads = if op.heads == 1 { "head" } else { "heads" };
            let (width, outputs) = (op.width, op.output.outputs);
            format!("[N, {width}] -> [{outputs}], {} {heads}{}", op.heads, relu(op.relu))
        }
        Op::Dense(op) => {
            format!("[{}] -> [{}]{}", op.layer.inputs, op.layer.outputs, relu(op.relu))
        }
        Op::Gru(op) => format!("[{}], state [{}]", op.input.inputs, op.size),
        Op::AttendAll(op) => {
            let heads = if op.heads == 1 { "head" } else { "heads" };
            let (width, outputs) = (op.width, op.output.outputs);
            format!("[N, {width}] -> [N, {outputs}], {} {heads}{}", op.heads, relu(op.relu))
        }
        Op::MeanRows(op) => {
            let whose = if op.members == Members::Agents { "of agents" } else { "of all" };
            format!("[N, {}] -> [{}], {whose}", op.width, op.width)
        }
        Op::GroupSum(op) => format!("[N, {}] -> [{}, {}]", op.width, op.groups, op.width),
        Op::Output(op) => match op.rows {
            OutputRows::Entities => format!("[N, {}]", op.width),
            OutputRows::Groups(groups) => format!("[{groups}, {}]", op.width),
            _ => format!("[{}]", op.width),
        },
        Op::Int8EmbedEntities(op) => {
            format!("[N, {}] -> [N, {}]{}", op.layer.inputs, op.layer.outputs, relu(op.relu))
        }
        Op::Int8AttendOwn(op) => {
            let heads = if op.heads == 1 { "head" } else { "heads" };
            let (width, outputs) = (op.width, op.output.outputs);
            format!("[N, {width}] -> [{outputs}], {} {heads}{}", op.heads, relu(op.relu))
        }
        Op::Int8Dense(op) => {
            format!("[{}] -> [{}]{}", op.layer.inputs, op.layer.outputs, relu(op.relu))
        }
        Op::EmbedTasks(op) => {
            let (features, tasks) = (op.embed.inputs, op.tasks.count);
            format!("[N, {features}] -> [N, {0}], [{tasks}, {0}]", op.embed.outputs)
        }
        Op::PointerLogits(op) => format!("[{}] -> logits of subtasks", op.from_task.inputs),
        Op::ScoreAllocations(op) => {
            format!("[N, {}] -> [N, {}] -> value", op.embed.inputs, op.embed.outputs)
        }
        Op::MaskedArgmax(op) => format!("[{}] -> action", op.from.len),
        Op::MaskedSample(op) => format!("[{}] -> drawn action", op.from.len),
        _ => String::new(),
    }
}
