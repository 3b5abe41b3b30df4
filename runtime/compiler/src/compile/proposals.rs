//! The three graphs of an allocator that proposes become one plan.

use sortie_bundle::{OwnedAllocationState, sha256};
use sortie_core::allocate::ProposalAllocator;
use sortie_core::allocate::proposals::{Draw, GumbelDraw};
use sortie_core::limits;
use sortie_core::plan::{AlignedBytes, Network, Plan, Profile, Program};
use sortie_plans::{
    Comparison, CompileError, CompileOptions, Compiled, ProposalFiles, TOLERANCE, cannot_run,
    magnitude, random_allocation_states, report,
};

use crate::graph::Graph;
use crate::lower::{AgentSizes, Choice, Origin, assemble, lower_proposals};
use crate::matching::match_proposals;
use crate::tract::TractProposals;

/// Proposals by which a plan is compared with its graphs.
const COMPARED: usize = 4;

/// Compiles trunk, step and critic to one plan, and proves it against the graphs.
///
/// # Errors
/// As [`crate::compile`].
pub fn compile_proposals(
    files: &ProposalFiles<'_>,
    options: &CompileOptions,
) -> Result<Compiled, CompileError> {
    let graphs = read(files)?;
    if options.profile == Profile::Int8 {
        return Err(CompileError::NoInt8 { what: "an allocator's network".into() });
    }
    let layers = match_proposals(graphs.each_ref())?;
    let (features, tasks) = (layers.trunk.embed.matrix.inputs, layers.trunk.tasks.inputs);
    let (program, weights) = lower_proposals(&layers, options.n_max)?;
    let weights = weights.to_bytes();
    let [trunk, ..] = &graphs;
    let known = trunk.metadata.get("sortie.contract");
    let known = known.and_then(|hash| u64::from_str_radix(hash, 16).ok());
    let sizes = AgentSizes { n_max: options.n_max, features, actions: 1, choice: Choice::Greedy };
    let mut origin = Origin {
        source: sha256(&files.joined()),
        profile: options.profile,
        network: Network::Proposals,
        contract: options.contract.or(known).unwrap_or(0),
        t_max: tasks as u16,
        max_error: 0.0,
        action_mismatch: 0.0,
    };
    let draft = assemble(&program, &weights, sizes, &origin)?;
    let CompileOptions { inputs, n_max, seed, .. } = *options;
    let states = random_allocation_states(inputs, n_max, features, tasks, seed);
    let comparison = proposals_against_graphs(&draft, graphs.each_ref(), &states, seed)?;
    let error = comparison.max_rel_error;
    if error.is_nan() || error > TOLERANCE {
        let (limit, input) = (TOLERANCE, comparison.worst_input);
        return Err(CompileError::Differs { error, limit, input, seed });
    }
    origin.max_error = error;
    let bytes = assemble(&program, &weights, sizes, &origin)?;
    let program = program.to_bytes();
    let program = Program::read(program.as_slice())?;
    Ok(Compiled { report: report(&program, n_max, bytes.len(), &comparison), bytes })
}

fn read(files: &ProposalFiles<'_>) -> Result<[Graph; 3], CompileError> {
    Ok([Graph::read(files.trunk)?, Graph::read(files.step)?, Graph::read(files.critic)?])
}

/// Compares an allocator's plan with the graphs that it was made from: the logarithms of the probabilities that every
/// agent of some proposals had, and the values of these.
///
/// # Errors
/// Plan or graphs cannot be run.
pub fn compare_proposals_with_graphs(
    plan: &[u8],
    files: &ProposalFiles<'_>,
    states: &[OwnedAllocationState],
    seed: u64,
) -> Result<Comparison, CompileError> {
    proposals_against_graphs(plan, read(files)?.each_ref(), states, seed)
}

fn proposals_against_graphs(
    plan: &[u8],
    graphs: [&Graph; 3],
    states: &[OwnedAllocationState],
    seed: u64,
) -> Result<Comparison, CompileError> {
    let plan = AlignedBytes::copy_of(plan);
    let plan = Plan::load(plan.as_slice())?;
    let mut reference = TractProposals::from_graphs(graphs)?;
    let tasks = usize::from(plan.header().t_max).max(1);
    let mut arena = AlignedBytes::zeroed(ProposalAllocator::arena_bytes(&plan, COMPARED));
    let mut allocator = ProposalAllocator::new(plan, arena.as_mut_slice(), COMPARED, 0)?;
    let mut comparison = Comparison::new("allocator plan against tract");
    for state in states {
        let view = state.view();
        let mut draw = Witness { draw: GumbelDraw { seed }, log_pi: Default::default() };
        let got = allocator.propose(&view, &mut draw).map_err(cannot_run)?;
        if got.best().is_none() {
            comparison.add_refusal(true);
            continue;
        }
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for (proposal, log_pi) in draw.log_pi.into_iter().enumerate() {
            let allocation: Vec<u8> = got.allocation(proposal).collect();
            let judged = reference.judge(&view, &allocation)?;
            let open = judged.log_pi.chunks(tasks);
            let is_open = |(task, _): &(usize, &f32)| state.open_tasks >> task & 1 == 1;
            theirs.extend(
                open.flat_map(|row| row.iter().enumerate().filter(is_open)).map(|(_, v)| *v),
            );
            ours.extend(log_pi.into_iter().filter(|value| value.is_finite()));
            theirs.push(judged.value);
            ours.extend(got.values().get(proposal));
        }
        if ours.len() != theirs.len() {
            return Err(cannot_run("the outputs of plan and graphs have other sizes"));
        }
        comparison.add_on_scale(magnitude(&theirs), &ours, &theirs, true);
    }
    Ok(comparison)
}

/// Draws, and keeps what was drawn from.
struct Witness {
    draw: GumbelDraw,
    /// The logarithms of all probabilities of every proposal, minus infinity for closed subtasks.
    log_pi: [Vec<f32>; COMPARED],
}

impl Draw for Witness {
    fn draw(&mut self, proposal: usize, agent: usize, logits: &[f32], open_tasks: u32) -> usize {
        let is_open = |task: usize| task < limits::TASKS && open_tasks >> task & 1 == 1;
        let largest = logits.iter().fold(f32::MIN, |largest, logit| largest.max(*logit));
        let powers = logits.iter().enumerate().filter(|(task, _)| is_open(*task));
        let total: f64 = powers.map(|(_, logit)| f64::from(logit - largest).exp()).sum();
        let log_pi = logits.iter().enumerate().map(|(task, logit)| {
            let log_pi = f64::from(logit - largest) - total.ln();
            if is_open(task) { log_pi as f32 } else { f32::NEG_INFINITY }
        });
        if let Some(of_proposal) = self.log_pi.get_mut(proposal) {
            of_proposal.extend(log_pi);
        }
        self.draw.draw(proposal, agent, logits, open_tasks)
    }
}
