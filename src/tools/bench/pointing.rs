//! Whole instances by an allocator that points: the encoder once, then a round of decisions after the other; and its two
//! networks beside their peers.

use sortie_bundle::{Bundle, OwnedAllocationState};
use sortie_cli::allocation::{Allocation, AllocatorChoice};
use sortie_cli::allocator::{DeployedAllocator, ProposalArguments};
use sortie_cli::environment::ScenarioSetName;
use sortie_cli::failure::Failure;
use sortie_cli::policy::{Backend, DeployedPolicy};
use sortie_learn::report::chart::{Line, growth};
use sortie_plans::{OnnxRuntimeEngine, pointing_policies};

use super::policies::{self, Contest};
use super::rounds::{Pace, alternate_long, our_engine};
use super::{Figures, Measuring, OURS, pin, scenes};

/// Instances before anybody else has a turn.
const CALLS_PER_TURN: usize = 4;
/// Whole instances, rounds, encoder and decoder share the time.
const PARTS: f64 = 4.0;

/// How instances are played.
#[derive(Clone, Copy)]
pub(super) struct Playing<'a> {
    pub(super) proposals: ProposalArguments,
    /// The rule that plays them, unless the allocator itself does.
    pub(super) played_by: Option<Allocation>,
    pub(super) runtime: Option<&'a dyn OnnxRuntimeEngine>,
    pub(super) measuring: &'a Measuring,
}

/// What instances of one size took, in microseconds at the median.
pub(super) struct Grown {
    agents: usize,
    subtasks: usize,
    instance_us: f64,
    round_us: f64,
}

/// Times instances of as many subtasks as the bundle's episodes have at most, and each of their rounds; encoder and decoder
/// on random inputs, beside their peers.
pub(super) fn measure(
    bundle: &Bundle,
    playing: Playing<'_>,
    figures: &mut Figures,
) -> Result<Grown, Failure> {
    let grown = measure_instances(bundle, playing, figures)?;
    let graphs = bundle.pointing_graphs().into_iter().flat_map(|(graphs, _)| graphs);
    for ((onnx, options), name) in graphs.zip(pointing_policies()).zip(["encoder", "decoder"]) {
        let contest = Contest {
            what: "allocation",
            name,
            onnx,
            options: &options,
            paces: &[Pace::Hot],
            seconds: playing.measuring.seconds / PARTS,
        };
        policies::measure_one(&contest, playing.runtime, playing.measuring, figures)?;
    }
    Ok(grown)
}

fn measure_instances(
    bundle: &Bundle,
    Playing { proposals, played_by, measuring, .. }: Playing<'_>,
    figures: &mut Figures,
) -> Result<Grown, Failure> {
    let open =
        |choice, proposals| DeployedAllocator::open(bundle, choice, Backend::Plan, 0, proposals);
    let mut ours = open(AllocatorChoice::Learned, proposals)?;
    let rule =
        played_by.map(|rule| open(AllocatorChoice::Rule(rule), ProposalArguments::default()));
    let instances = match rule {
        Some(rule) => instances(bundle, &mut rule?, measuring.common.seed)?,
        None => instances(bundle, &mut ours, measuring.common.seed)?,
    };
    let mut ours = ours.allocator()?;
    pin(measuring.pin)?;
    let rounds: Vec<&OwnedAllocationState> = instances.iter().flatten().collect();
    let (agents, subtasks) = rounds.first().map_or((0, 0), |state| (state.agents, subtasks(state)));
    let mean = rounds.len() as f64 / instances.len().max(1) as f64;
    let mut decide = |state: &OwnedAllocationState| {
        let mut allocation = vec![0; state.agents];
        let decided = ours.allocate(&state.view(), &mut allocation);
        decided.expect("states of episodes can be allocated");
        std::hint::black_box(allocation);
    };
    let of_them = format!("{subtasks} subtasks, {agents} agents, {mean:.1} rounds");
    let mut time = |case: String, play: &mut dyn FnMut(usize)| {
        let mut engines = vec![our_engine(OURS, play)];
        let measured = alternate_long(&mut engines, CALLS_PER_TURN, measuring.seconds / PARTS);
        figures.add("allocation", &case, &engines, &measured);
        measured.first().map_or(0.0, |measured| measured.latency.percentiles().p50)
    };
    let whole = &mut |call: usize| instances[call % instances.len()].iter().for_each(&mut decide);
    let instance_us = time(format!("an instance of {of_them}"), whole);
    let alone = &mut |call: usize| decide(rounds[call % rounds.len()]);
    let round_us = time(format!("a round of {of_them}"), alone);
    Ok(Grown { agents, subtasks, instance_us, round_us })
}

/// Instances and rounds by subtasks, a line for each number of agents.
pub(super) fn drawn(grown: &[Grown]) -> Result<String, Failure> {
    let mut teams: Vec<usize> = grown.iter().map(|grown| grown.agents).collect();
    teams.sort_unstable();
    teams.dedup();
    let line = |what: &str, agents: usize, time: fn(&Grown) -> f64| {
        let of_team = grown.iter().filter(|grown| grown.agents == agents);
        let mut points: Vec<_> =
            of_team.map(|grown| (grown.subtasks as f64, time(grown))).collect();
        points.sort_by(|one, other| one.0.total_cmp(&other.0));
        Line { label: format!("{what}, {agents} agents"), points }
    };
    let instances = teams.iter().map(|agents| line("an instance", *agents, |it| it.instance_us));
    let rounds = teams.iter().map(|agents| line("a round", *agents, |it| it.round_us));
    let lines: Vec<Line> = instances.chain(rounds).collect();
    let axes = ["subtasks", "microseconds, the median"];
    Ok(growth("Allocations by an allocator that points", axes, &lines)?)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn teams_have_their_lines_and_sizes_their_dots() {
        let grown = [(4, 16), (8, 32), (4, 11)];
        let grown = grown.map(|(agents, subtasks)| Grown {
            agents,
            subtasks,
            instance_us: 300.0,
            round_us: 50.0,
        });
        let svg = drawn(&grown).expect("a picture");
        for label in ["an instance, 4 agents", "an instance, 8 agents", "a round, 8 agents"] {
            assert_eq!(svg.matches(label).count(), 1, "{label}");
        }
        assert_eq!(svg.matches("<circle").count(), 6);
    }
}
