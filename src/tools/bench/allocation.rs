//! One allocation by the values of all teams: our plan, tract and onnxruntime in alternation.

use std::path::PathBuf;

use clap::Args;
use sortie_bundle::{Bundle, OwnedAllocationState};
use sortie_cli::allocation::Allocation;
use sortie_cli::allocator::{LearnedAllocator, ProposalArguments, ProposalMemory, none_learned};
use sortie_cli::deployment::open_bundle;
use sortie_cli::environment::{ScenarioSetName, entry_of};
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::files::write_output;
use sortie_cli::policy::{Backend, DeployedPolicy};
use sortie_cli::tools::{OnnxRuntimeArguments, plans};
use sortie_cli::worlds::{FrameRelation, relation};
use sortie_core::allocate::{TaskRelation, TeamQuery, Teams, exact};
use sortie_core::plan::Profile;
use sortie_core::{AllocateError, AllocationState, Allocator};
use sortie_plans::{BatchedValues, OnnxRuntimeEngine};

use super::pointing::{self, Playing};
use super::rounds::{alternate_long, engine, our_engine};
use super::scenes::{self, some};
use super::{FUSED, Figures, Measuring, OURS, TRACT_VERSION, if_runnable, pin};

/// Agents and open subtasks of the states that are measured.
const SIZE: (usize, usize) = (5, 6);
/// Allocations of one engine before the next has its turn.
const CALLS_PER_TURN: usize = 4;

/// Allocations of a bundle's learned allocator, five agents to six subtasks: the values of all teams, then
/// the best allocation; of an allocator that points, whole instances and single rounds, and its encoder and decoder
///
/// Of team values onnxruntime computes the same values with the exported graph, a call for each team, and with a graph that
/// takes all teams in one call. In processor time: peers take longer than the system's time slices.
#[derive(Debug, Args)]
pub(super) struct AllocationArguments {
    /// Folders of bundles
    #[arg(default_value = "models/save-the-city", value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Draw how whole instances of bundles whose allocators point grow with subtasks, as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Rule that plays the instances of an allocator that points [default: the allocator itself]
    #[arg(long, value_enum, value_name = "RULE")]
    played_by: Option<Allocation>,
    /// Bundle with an allocator that proposes, which takes turns on the same states
    #[arg(long, value_name = "BUNDLE")]
    beside: Option<PathBuf>,
    #[command(flatten)]
    proposals: ProposalArguments,
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

impl AllocationArguments {
    fn playing<'a>(&'a self, runtime: Option<&'a dyn OnnxRuntimeEngine>) -> Playing<'a> {
        let Self { proposals, played_by, measuring, .. } = self;
        Playing { proposals: *proposals, played_by: *played_by, runtime, measuring }
    }

    /// The allocator that proposes, if one was named.
    fn proposing(&self) -> Result<Option<ProposalMemory>, Failure> {
        let Some(folder) = &self.beside else { return Ok(None) };
        let (bundle, seed) = (open_bundle(folder)?, self.measuring.common.seed);
        let memory = ProposalMemory::open(&bundle, Backend::Plan, self.proposals.count(), seed)?;
        let message = format!("`{}` has no allocator that proposes", folder.display());
        memory.map(Some).ok_or_else(|| Failure::new(Exit::Usage, message))
    }
}

pub(super) fn measure(arguments: &AllocationArguments) -> Result<Figures, Failure> {
    let (mut figures, mut grown) = (Figures::default(), Vec::new());
    let runtime = arguments.onnxruntime.open_or_note("onnxruntime is not measured")?;
    for folder in &arguments.bundles {
        let bundle = open_bundle(folder)?;
        if bundle.pointing_graphs().is_some() {
            grown.push(pointing::measure(&bundle, arguments.playing(runtime), &mut figures)?);
        } else {
            measure_team_values(&bundle, arguments, runtime, &mut figures)?;
        }
    }
    if let Some(file) = &arguments.picture {
        if grown.is_empty() {
            let message = "`--picture` is for bundles whose allocators point";
            return Err(Failure::new(Exit::Usage, message));
        }
        write_output(file, pointing::drawn(&grown)?.as_bytes())?;
    }
    Ok(figures)
}

/// The values of all teams, then the best allocation.
fn measure_team_values(
    bundle: &Bundle,
    arguments: &AllocationArguments,
    runtime: Option<&dyn OnnxRuntimeEngine>,
    figures: &mut Figures,
) -> Outcome {
    let name = bundle.folder().display().to_string();
    let onnx = bundle.allocator_onnx().ok_or_else(|| none_learned(&name))?;
    let mut ours = ours_of(bundle)?;
    let mut tract = LearnedAllocator::open(bundle, Backend::Tract)?;
    let mut single =
        runtime.map(|runtime| LearnedAllocator::of_graph(bundle, runtime)).transpose()?;
    let mut batched = runtime.map(|runtime| Batched::new(bundle, runtime, onnx)).transpose()?;
    let (_, first) = ours.first_mut().expect("every machine runs the exact profile");
    let states = states(bundle, first, arguments.measuring.common.seed)?;
    let mut proposing = arguments.proposing()?;
    let mut proposing = proposing.as_mut().map(ProposalMemory::allocator).transpose()?;
    let ours = ours.iter_mut().map(|(name, ours)| Ok((*name, ours.allocator()?)));
    let mut ours = ours.collect::<Result<Vec<_>, Failure>>()?;
    let mut tract = tract.allocator()?;
    let mut single = single.as_mut().map(LearnedAllocator::allocator).transpose()?;
    for (_, ours) in &mut ours {
        let single = single.as_mut().map(|single| single as &mut dyn Allocator);
        check(&states, ours, single, &mut batched)?;
    }
    pin(arguments.measuring.pin)?;
    let state = |call: usize| states[call % states.len()].view();
    let version = runtime.map_or(String::new(), |runtime| runtime.version().to_owned());
    let mut engines = Vec::new();
    for (name, ours) in &mut ours {
        engines.push(our_engine(name, |call| decide(&state(call), ours)));
    }
    engines.push(engine("tract", TRACT_VERSION, |call| decide(&state(call), &mut tract)));
    if let Some(single) = &mut single {
        let work = |call| decide(&state(call), single);
        engines.push(engine("onnxruntime, a call a team", &version, work));
    }
    if let Some(batched) = &mut batched {
        let work = |call| decide(&state(call), batched);
        engines.push(engine("onnxruntime, one call", &version, work));
    }
    if let Some(proposing) = &mut proposing {
        let count = arguments.proposals.count().to_string();
        let work = |call| decide(&state(call), proposing);
        engines.push(engine("critic's best of proposals", &count, work));
    }
    let seconds = arguments.measuring.seconds;
    let measured = alternate_long(&mut engines, CALLS_PER_TURN, seconds);
    let (agents, tasks) = SIZE;
    let case = format!("{agents} agents, {tasks} subtasks");
    figures.add("allocation", &case, &engines, &measured);
    Ok(())
}

/// The bundle's allocator in every profile that this machine has and that such plans know, `exact` first.
fn ours_of(bundle: &Bundle) -> Result<Vec<(&'static str, LearnedAllocator)>, Failure> {
    let mut ours = vec![(OURS, LearnedAllocator::open(bundle, Backend::Plan)?)];
    if if_runnable(FUSED, plans().allocator(bundle, Profile::Fused))?.is_some() {
        ours.push((FUSED, LearnedAllocator::of_plan(bundle, &plans(), Profile::Fused)?));
    }
    Ok(ours)
}

fn decide(state: &AllocationState<'_>, allocator: &mut dyn Allocator) {
    let mut allocation = [0; SIZE.0];
    let decided = allocator.allocate(state, &mut allocation);
    decided.expect("states of episodes can be allocated");
    std::hint::black_box(allocation);
}

/// States of the bundle's own episodes that have the size.
fn states(
    bundle: &Bundle,
    allocator: &mut LearnedAllocator,
    seed: u64,
) -> Result<Vec<OwnedAllocationState>, Failure> {
    let mut policy = DeployedPolicy::open(bundle, Backend::Plan)?;
    let set = ScenarioSetName::parse_with_subtasks(&bundle.manifest().contract.environment.name)?;
    let mut policy = policy.policy()?;
    let states = scenes::allocation_states(
        policy.as_mut(),
        allocator.allocator()?,
        (&set, bundle.contract().decision_interval),
        (scenes::EPISODES, seed),
    )?;
    let fits = |state: &OwnedAllocationState| (state.agents, state.open().count()) == SIZE;
    let states: Vec<_> = states.into_iter().filter(fits).collect();
    if states.is_empty() {
        let (agents, tasks) = SIZE;
        let message = format!("no state with {agents} agents and {tasks} open subtasks was met");
        return Err(Failure::difference(message).within(bundle.folder().display()));
    }
    Ok(some(states))
}

/// Peers must take the same allocations: they compute the same values.
fn check(
    states: &[OwnedAllocationState],
    ours: &mut dyn Allocator,
    single: Option<&mut dyn Allocator>,
    batched: &mut Option<Batched>,
) -> Outcome {
    let peers = single.into_iter().chain(batched.as_mut().map(|b| b as &mut dyn Allocator));
    for (number, peer) in peers.enumerate() {
        let mut others = 0;
        for state in states {
            let (mut want, mut got) = ([0; SIZE.0], [0; SIZE.0]);
            let failed = |error: AllocateError| Failure::difference(error.to_string());
            ours.allocate(&state.view(), &mut want).map_err(failed)?;
            peer.allocate(&state.view(), &mut got).map_err(failed)?;
            others += usize::from(want != got);
        }
        // Rounding may turn a near tie, in a few states at most.
        if others * 50 > states.len() {
            let which = if number == 0 { "a call a team" } else { "one call" };
            let message = format!(
                "onnxruntime, {which}: another allocation in {others} of {} states",
                states.len()
            );
            return Err(Failure::difference(message));
        }
    }
    Ok(())
}

/// All teams of all open subtasks in one call of onnxruntime, then our search.
struct Batched {
    network: Box<dyn BatchedValues>,
    relation: FrameRelation,
    team_max: usize,
    /// The relations of all open subtasks.
    relations: Vec<Vec<f32>>,
    values: Vec<f32>,
    cells: Vec<exact::Cell>,
}

impl Batched {
    fn new(bundle: &Bundle, runtime: &dyn OnnxRuntimeEngine, onnx: &[u8]) -> Result<Self, Failure> {
        let network = runtime
            .batched_team_values(onnx)
            .map_err(|error| Failure::from(error).within(bundle.folder().display()))?;
        let cells = exact::cells(SIZE.0, SIZE.1);
        Ok(Self {
            network,
            relation: relation(entry_of(bundle)?)?,
            team_max: bundle.manifest().limits.team_max.into(),
            relations: vec![Vec::new(); SIZE.1],
            values: vec![0.0; cells],
            cells: vec![exact::Cell::default(); cells],
        })
    }
}

impl Allocator for Batched {
    fn allocate(
        &mut self,
        state: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        let Self { network, relation, relations, values, cells, team_max } = self;
        relation.observe(state)?;
        let open = state.open_tasks;
        let tasks = (0..state.tasks).filter(|task| open >> task & 1 == 1);
        let mut queries = Vec::with_capacity(values.len());
        for (task, buffer) in tasks.zip(relations.iter_mut()) {
            buffer.resize(state.entity_task.len() * relation.columns(), 0.0);
            relation.write(state, task, buffer);
            let teams = 0..1 << state.agents;
            queries.extend(teams.map(|team| TeamQuery { state, task, team, relation: buffer }));
        }
        network.values(&queries, values)?;
        let teams = Teams { agents: state.agents, open_tasks: open, team_max: *team_max };
        exact::search(teams, values, cells, allocation).map(drop)
    }
}
