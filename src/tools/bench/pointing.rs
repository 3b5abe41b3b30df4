//! Whole instances by an allocator that points: the encoder once, then a round of decisions after the other.

use sortie_bundle::{Bundle, OwnedAllocationState};
use sortie_cli::allocation::AllocatorChoice;
use sortie_cli::allocator::{DeployedAllocator, ProposalArguments};
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::Failure;
use sortie_cli::policy::{Backend, DeployedPolicy};

use super::rounds::{alternate_long, our_engine};
use super::{Figures, Measuring, OURS, pin, scenes};

/// Instances before anybody else has a turn.
const CALLS_PER_TURN: usize = 4;

/// Times instances of as many subtasks as the bundle's episodes have at most.
pub(super) fn measure(
    bundle: &Bundle,
    proposals: ProposalArguments,
    measuring: &Measuring,
) -> Result<Figures, Failure> {
    let choice = AllocatorChoice::Learned;
    let mut ours = DeployedAllocator::open(bundle, choice, Backend::Plan, 0, proposals)?;
    let instances = instances(bundle, &mut ours, measuring.common.seed)?;
    let mut ours = ours.allocator()?;
    pin(measuring.pin)?;
    let rounds: usize = instances.iter().map(Vec::len).sum();
    let subtasks = instances.first().and_then(|rounds| rounds.first()).map_or(0, subtasks);
    let mean = rounds as f64 / instances.len().max(1) as f64;
    let play = |call: usize| {
        for state in &instances[call % instances.len()] {
            let mut allocation = vec![0; state.agents];
            let decided = ours.allocate(&state.view(), &mut allocation);
            decided.expect("states of episodes can be allocated");
            std::hint::black_box(allocation);
        }
    };
    let mut engines = vec![our_engine(OURS, play)];
    let measured = alternate_long(&mut engines, CALLS_PER_TURN, measuring.seconds);
    let mut figures = Figures::default();
    let case = format!("an instance of {subtasks} subtasks, {mean:.1} rounds");
    figures.add("allocation", &case, &engines, &measured);
    Ok(figures)
}

/// The states of each of the largest instances, in their order.
fn instances(
    bundle: &Bundle,
    allocator: &mut DeployedAllocator,
    seed: u64,
) -> Result<Vec<Vec<OwnedAllocationState>>, Failure> {
    let mut policy = DeployedPolicy::open(bundle, Backend::Plan)?;
    let set = ScenarioSetName::parse_with_subtasks(&bundle.manifest().contract.environment.name)?;
    let interval = bundle.contract().decision_interval;
    let (mut policy, mut allocator) = (policy.policy()?, allocator.allocator()?);
    let mut instances = Vec::new();
    for episode in 0..scenes::EPISODES as u64 {
        let (asked, seed) = (allocator.as_mut(), seed.wrapping_add(episode));
        let states =
            scenes::allocation_states(policy.as_mut(), asked, (&set, interval), (1, seed))?;
        instances.push(states);
    }
    let size = |rounds: &Vec<OwnedAllocationState>| rounds.first().map_or(0, subtasks);
    let most = instances.iter().map(size).max().unwrap_or(0);
    instances.retain(|rounds| size(rounds) == most);
    Ok(instances)
}

/// Subtasks that there are at the beginning.
fn subtasks(state: &OwnedAllocationState) -> usize {
    state.open().count()
}
