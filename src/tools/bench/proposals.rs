//! `bench proposals`: an allocator that draws proposals and values them, ours and onnxruntime's.

use clap::Args;
use sortie_cli::failure::Failure;
use sortie_cli::tools::{OnnxRuntimeArguments, compiler};
use sortie_core::allocate::ProposalAllocator;
use sortie_core::allocate::proposals::GumbelDraw;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{AllocationState, EntityMask};
use sortie_envs::random::generator;
use sortie_methods::proposals::{
    AllocationCritic, AllocationPolicy, AllocationShape, export_proposals,
};
use sortie_plans::{CompileError, CompileOptions, Compiler, DrawnProposals, ProposalFiles};

use super::rounds::{alternate_long, engine, our_engine};
use super::{FUSED, Figures, Measuring, OURS, if_runnable, pin};

/// Sizes of the networks and of the states.
const SHAPE: AllocationShape = AllocationShape { features: 58, columns: 8, width: 128, heads: 4 };
const AGENTS: usize = 8;
const ENTITIES: usize = 16;
const PROPOSALS: usize = 32;
/// States in rotation.
const STATES: usize = 16;
/// Allocations of one engine before the next has its turn.
const CALLS_PER_TURN: usize = 4;

/// Allocations of eight agents to eight subtasks by the best of 32 proposals, networks of random weights
///
/// onnxruntime runs the exported graphs: the trunk once, the step for every agent of every proposal, the critic for every
/// proposal. In processor time: peers take longer than the system's time slices.
#[derive(Debug, Args)]
pub(super) struct ProposalsArguments {
    #[command(flatten)]
    onnxruntime: OnnxRuntimeArguments,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &ProposalsArguments) -> Result<Figures, Failure> {
    let mut random = Numbers(arguments.measuring.common.seed as u32);
    let weights = &mut generator(arguments.measuring.common.seed);
    let policy = AllocationPolicy::initialise(SHAPE, weights);
    let critic = AllocationCritic::initialise(SHAPE, weights);
    let graphs = export_proposals(&policy, &critic, 0).map_err(Failure::bug)?;
    let files = ProposalFiles { trunk: &graphs.trunk, step: &graphs.step, critic: &graphs.critic };
    let mut plans = Vec::new();
    for (name, profile) in [(OURS, Profile::Exact), (FUSED, Profile::Fused)] {
        let options = CompileOptions { n_max: ENTITIES, profile, ..CompileOptions::default() };
        let plan = AlignedBytes::copy_of(&compiler().compile_proposals(&files, &options)?.bytes);
        let bytes = Plan::load(plan.as_slice()).map(|plan| plan.arena_bytes());
        if let Some(bytes) = if_runnable(name, bytes.map_err(CompileError::from))? {
            plans.push((name, plan, AlignedBytes::zeroed(bytes)));
        }
    }
    let runtime = arguments.onnxruntime.open_or_note("onnxruntime is not measured")?;
    let peer = runtime.map(|runtime| runtime.proposals(&files));
    let mut peer = peer.transpose()?;
    let rows: Vec<Vec<f32>> = (0..STATES).map(|_| features(&mut random)).collect();
    let seed = arguments.measuring.common.seed;
    let draw = |call: usize| GumbelDraw { seed: seed.wrapping_add((call % STATES) as u64) };
    let state = |call: usize| state(&rows[call % STATES]);
    let mut ours = Vec::new();
    for (name, plan, arena) in &mut plans {
        let plan = Plan::load(plan.as_slice()).map_err(CompileError::from)?;
        let allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), PROPOSALS, seed);
        ours.push((*name, allocator.map_err(CompileError::from)?));
    }
    if let (Some(peer), Some((_, ours))) = (&mut peer, ours.first_mut()) {
        check(ours, peer.as_mut(), &state, &draw)?;
    }
    pin(arguments.measuring.pin)?;
    let mut engines = Vec::new();
    for (name, allocator) in &mut ours {
        engines.push(our_engine(name, |call| {
            let proposals = allocator.propose(&state(call), &mut draw(call));
            std::hint::black_box(proposals.expect("finite values").best());
        }));
    }
    if let Some(peer) = &mut peer {
        let version = runtime.map_or(String::new(), |runtime| runtime.version().to_owned());
        engines.push(engine("onnxruntime", &version, |call| {
            let mut values = [0.0; PROPOSALS];
            let best = peer.propose(&state(call), &mut draw(call), &mut values);
            std::hint::black_box(best.expect("a state that fits"));
        }));
    }
    let measured = alternate_long(&mut engines, CALLS_PER_TURN, arguments.measuring.seconds);
    let mut figures = Figures::default();
    let case = format!("{AGENTS} agents, {} subtasks, {PROPOSALS} proposals", SHAPE.columns);
    figures.add("proposals", &case, &engines, &measured);
    Ok(figures)
}

/// Both must value the same proposals the same.
fn check<'a>(
    ours: &mut ProposalAllocator<'_>,
    peer: &mut dyn DrawnProposals,
    state: &dyn Fn(usize) -> AllocationState<'a>,
    draw: &dyn Fn(usize) -> GumbelDraw,
) -> Result<(), Failure> {
    let mut others = 0;
    for call in 0..STATES {
        let mut values = [0.0; PROPOSALS];
        let theirs = peer.propose(&state(call), &mut draw(call), &mut values);
        let theirs = theirs.map_err(|error| Failure::difference(error.to_string()))?;
        let proposals = ours.propose(&state(call), &mut draw(call));
        let proposals = proposals.map_err(|error| Failure::difference(error.to_string()))?;
        let best = proposals.best().unwrap_or(0);
        others += usize::from(!proposals.allocation(best).eq(theirs));
    }
    // Rounding may turn a near tie.
    if others * 8 > STATES {
        let message = format!("onnxruntime: another allocation in {others} of {STATES} states");
        return Err(Failure::difference(message));
    }
    Ok(())
}

fn state(rows: &[f32]) -> AllocationState<'_> {
    static ENTITY_TASK: [u32; ENTITIES] = [0, 0, 4, 8, 1, 1, 32, 64, 1, 2, 4, 8, 16, 32, 64, 128];
    AllocationState {
        agents: AGENTS,
        tasks: SHAPE.columns,
        rows,
        stride: SHAPE.features,
        present: EntityMask::first(ENTITIES),
        entity_task: &ENTITY_TASK,
        open_tasks: 0xff,
        available: &[],
    }
}

/// Any numbers in [-1, 1].
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 8_388_608.0 - 1.0
    }
}

/// Features of which a sixth is not zero, as in Save the City.
fn features(random: &mut Numbers) -> Vec<f32> {
    let feature = |index: usize| if index.is_multiple_of(6) { random.next() } else { 0.0 };
    (0..ENTITIES * SHAPE.features).map(feature).collect()
}
