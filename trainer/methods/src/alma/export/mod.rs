//! Runs of ALMA become bundles: contract, network, golden observations and allocations, card and curve.

mod proposals;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use sortie_bundle::{
    AGENT, ALLOCATOR, CARD, CURVE, CURVE_DATA, ContractV1, Draft, Golden, GoldenAllocation,
    GoldenValue, Limits, Network, PROPOSAL_PARTS, PROPOSALS, SubtaskConditioning, TEAM_VALUE,
    TRAINING,
};
use sortie_core::Policy;
use sortie_envs::{EntitySet, Environment, Shape, SparseRows, Spec};
use sortie_learn::LearnError;
use sortie_learn::draft::{self, Measured, Recorder, described, read_part};
use sortie_learn::export::attention::{AttentionNetwork, ExportError, Layer, Layout, Matrix};
use sortie_learn::export::{AgentNetwork, TeamValueExport, agent_onnx, team_value_onnx};
use sortie_learn::run::RunDescription;
use sortie_nn::random::Generator;

use super::Config;
use super::agents::{Conditioning, NetworkPolicy, UtilityNetwork, UtilityPass, UtilityWeights};
use super::evaluate::{EvaluationPlan, evaluate};
use super::records::team_value::{TeamQuery, TeamValueAllocator, TeamValueInput};
use super::run::{Run, RunAllocator};
use super::teams::{Allocate, Allocation, NetworkTeam, PolicyTeam, allocation_state};

pub use proposals::{ProposalGraphs, export_proposals};

/// Episodes that golden observations are drawn from; they end sooner than all are needed.
const GOLDEN_EPISODES: usize = 100;

/// Refuses runs whose agents need more than what a deployed agent is shown.
///
/// # Errors
/// The agents are not conditioned on subtasks by masks, or have a memory.
pub fn check_exportable(run: &Run) -> Result<(), LearnError> {
    if let Some(coach) = &run.coach {
        let numbers = coach.shape().strategy;
        return Err(LearnError::Config(format!(
            "agents with a coach are evaluated only: deployed they would need the coach, which sees \
             everything, and a message of {numbers} numbers from it to each of them"
        )));
    }
    let conditioning = run.config.subtask();
    if !run.memory_unit.is_empty() {
        let reason =
            "agents with a memory are evaluated only: teams of processes keep no memories yet";
        return Err(LearnError::Config(reason.to_owned()));
    }
    if conditioning == Conditioning::Mask {
        return Ok(());
    }
    let conditioning = conditioning.name();
    Err(LearnError::Config(format!(
        "agents with `network.subtask = \"{conditioning}\"` are evaluated only: bundles hold agents that see their \
         own subtask (`network.subtask=mask`)"
    )))
}

/// Makes a bundle of the averaged weights of the run in `folder`, with its allocator where it has one.
///
/// # Errors
/// The run is not [deployable](check_exportable), its files cannot be read, or its network is not finite.
pub fn draft_bundle(
    (run, environment): (&Run, &dyn Environment),
    folder: &Path,
    sizes: &[Shape],
    measured: &[Measured],
    seed: u64,
) -> Result<Draft, LearnError> {
    check_exportable(run)?;
    let allocator = LearnedAllocator::of(run);
    let spec = environment.spec();
    let contract = contract(spec, run.config.interval());
    let golden = golden(run, environment, allocator, seed)?;
    let diverged = |error: ExportError| LearnError::format(folder, error);
    let agent = agent(spec, &run.network.weights(), contract.hash()).map_err(diverged)?;
    let mut parts = BTreeMap::from([
        (AGENT.to_owned(), agent),
        (CARD.to_owned(), card(run, allocator, measured).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    let kind = match &run.allocator {
        Some(RunAllocator::TeamValue(network)) => {
            let onnx = team_value(spec, &network.weights(), contract.hash()).map_err(diverged)?;
            parts.insert(ALLOCATOR.to_owned(), onnx);
            Some(TEAM_VALUE)
        }
        Some(RunAllocator::Proposals { policy, critic }) => {
            let graphs = export_proposals(&policy.weights(), &critic.weights(), contract.hash());
            let ProposalGraphs { trunk, step, critic } = graphs.map_err(diverged)?;
            let names = PROPOSAL_PARTS.map(str::to_owned);
            parts.extend(names.into_iter().zip([trunk, step, critic]));
            Some(PROPOSALS)
        }
        None => None,
    };
    let name = run.description.config.environment.to_string();
    Ok(Draft {
        environment: described(name, spec, &golden.cases),
        limits: limits(allocator, sizes),
        network: Network {
            agent: "masked-attention".to_owned(),
            allocator: kind.map(str::to_owned),
            ..Network::default()
        },
        golden,
        contract,
        parts,
    })
}

/// The contract of agents that see their own subtask.
fn contract(spec: &Spec, decision_interval: u32) -> ContractV1 {
    let subtask_conditioning = SubtaskConditioning::Mask;
    ContractV1 { decision_interval, subtask_conditioning, ..draft::contract(spec, true) }
}

/// Sizes of all environments that the bundle is to serve.
fn limits(allocator: Option<LearnedAllocator<'_>>, sizes: &[Shape]) -> Limits {
    let limits = draft::limits(sizes);
    let team_max = allocator.map_or(usize::MAX, |learned| learned.team_max);
    Limits { team_max: limits.team_max.min(team_max.try_into().unwrap_or(u16::MAX)), ..limits }
}

/// The agents' network as ONNX.
fn agent(spec: &Spec, weights: &UtilityWeights, contract: u64) -> Result<Vec<u8>, ExportError> {
    let (features, layers) = (spec.shape.features, layers(weights));
    agent_onnx(&AgentNetwork { features, append_last_action: true, contract, layers })
}

/// The allocator's network as ONNX.
fn team_value(
    spec: &Spec,
    weights: &UtilityWeights,
    contract: u64,
) -> Result<Vec<u8>, ExportError> {
    let (features, relations, layers) = (spec.shape.features, spec.relations, layers(weights));
    team_value_onnx(&TeamValueExport { features, relations, contract, layers })
}

fn layers(weights: &UtilityWeights) -> AttentionNetwork<'_> {
    let matrix = |values| Matrix { values, layout: Layout::OutputsFirst };
    let shape = weights.shape;
    AttentionNetwork {
        inputs: shape.input,
        width: shape.width,
        heads: shape.heads,
        base: shape.base,
        outputs: shape.actions,
        fc1: Layer { weight: matrix(&weights.fc1_weight), bias: &weights.fc1_bias },
        attention_in: matrix(&weights.attention_in_weight),
        attention_out: Layer {
            weight: matrix(&weights.attention_out_weight),
            bias: &weights.attention_out_bias,
        },
        skip: shape.skip.then(|| matrix(&weights.skip_weight)),
        fc2: Some(Layer { weight: matrix(&weights.fc2_weight), bias: &weights.fc2_bias }),
        head: Layer { weight: matrix(&weights.head_weight), bias: &weights.head_bias },
        pointing: None,
    }
}

/// Observations and allocation states of greedy episodes, with the answers of the trainer's own passes.
fn golden(
    run: &Run,
    environment: &dyn Environment,
    allocator: Option<LearnedAllocator<'_>>,
    seed: u64,
) -> Result<Golden, LearnError> {
    let config = &run.config;
    let plan = EvaluationPlan {
        interval: config.interval(),
        ..EvaluationPlan::new(environment, GOLDEN_EPISODES, seed)
    };
    let allocations = match allocator {
        Some(allocator) => golden_allocations(&plan, &run.network, allocator)?,
        None => Vec::new(),
    };
    let mut recorder =
        Recorder::new(NetworkPolicy::new(&run.network), environment.spec().shape.features);
    let mut team = PolicyTeam::new(&mut recorder as &mut dyn Policy);
    evaluate(&plan, &mut team, &mut Allocation::Coordinated.allocator())?;
    Ok(Golden { cases: recorder.cases, allocations, ..Golden::default() })
}

fn card(run: &Run, allocator: Option<LearnedAllocator<'_>>, measured: &[Measured]) -> String {
    let RunDescription { version, seed, config, .. } = &run.description;
    let mut card = format!(
        "# A team for {}\n\n\
         Every agent runs the same masked-attention utility network (dissertation section 7.3): it sees the\n\
         entities of its own subtask, its team mates and one building, and nothing else. Trained by\n\
         `sortie train {}`, seed {}, Sortie {}; `train.toml` repeats the run.\n\n",
        config.environment, config.method, seed, version,
    );
    if let Some(LearnedAllocator { team_max, .. }) = allocator {
        let _ = writeln!(
            card,
            "The allocator values every team at every open building by a network of the same kind and takes the\n\
             best allocation; a team has at most {team_max} agents.\n"
        );
    }
    if let Some(RunAllocator::Proposals { .. }) = &run.allocator {
        card += "The allocator is a policy that proposes allocations, and a critic that values them and takes the best\n\
                 (dissertation section 7.2).\n\n";
    }
    card += "## How well it does\n\nGreedy episodes that training never saw. *Success*: all buildings are complete at the end. *No building burned* is what\n\
             the dissertation calls success. The interval is that of the episodes, not of training again.\n\n";
    card += "| scenarios | allocation | episodes | success (95 % interval) | no building burned | time-outs | return |\n";
    card += "| --- | --- | --- | --- | --- | --- | --- |\n";
    for Measured { set, allocation, evaluation } in measured {
        let [low, high] = evaluation.success_ci95;
        // Writing to a string cannot fail.
        let _ = writeln!(
            card,
            "| `{set}` | {allocation} | {} | {:.3} ({low:.3} to {high:.3}) | {:.3} | {:.3} | {:.2} |",
            evaluation.episodes,
            evaluation.success,
            evaluation.metrics.get("none_burned").copied().unwrap_or(f64::NAN),
            evaluation.timeouts,
            evaluation.return_mean,
        );
    }
    if !config.run.from.is_empty() {
        let _ = writeln!(card, "\nIt began with the networks of the run `{}`.", config.run.from);
    }
    if let Some(last) = run.curve.last() {
        let _ = writeln!(
            card,
            "\nTraining took {} environment steps, {:.0} seconds of processor time and {:.0} seconds.",
            last.env_steps, last.cpu_s, last.wall_s
        );
    }
    let _ = writeln!(
        card,
        "\nMatrix products were computed with `{}`: `--set run.products={0}` repeats the run byte for byte.",
        config.run.products
    );
    card += &departures(run);
    card += "\n## Limits\n\nIt serves teams and cities up to the largest of these scenarios; `bundle.toml` has the numbers.\n\
             Agents that do not share a subtask do not see each other and can block each other's way.\n";
    card
}

/// Whose own embedding reaches the layers behind the attention directly.
fn skips(run: &Run) -> String {
    let allocator = match &run.allocator {
        Some(RunAllocator::TeamValue(network)) => network.shape().skip,
        Some(RunAllocator::Proposals { .. }) | None => false,
    };
    let who = match (run.network.shape().skip, allocator) {
        (true, true) => "agents and of the allocator",
        (true, false) => "agents",
        (false, true) => "allocator",
        (false, false) => return String::new(),
    };
    format!(
        "- The own embedding skips the attention in the networks of the {who}: what the attention gives is\n  \
         `relu(W o + b + V x)` with the own embedding x, published without `V x`.\n"
    )
}

/// What is not in the dissertation.
fn departures(run: &Run) -> String {
    let mut text = "\n## Where the training departs from the dissertation\n\n".to_owned();
    let skips = skips(run);
    text += &skips;
    let config = match &run.config {
        Config::Records(config) => config,
        Config::Windows(_) => {
            text += if skips.is_empty() { "- Nowhere but in" } else { "- In" };
            text += " the sampled windows: none learns a step from one episode to the next.\n";
            return text;
        }
    };
    text += &format!(
        "- Utilities of a subtask's team are summed (VDN); there is no mixing network.\n\
         - It learns from records of one step and one subtask, with {}-step returns and discount {}.\n\
         - Adam with averaged weights; embedding width {}.\n",
        config.returns.steps, config.returns.discount, config.network.width,
    );
    if config.returns.shaping != 0.0 {
        text += &format!(
            "- Potential shaping of {} per cell between an agent and its building, which leaves the best policy\n  \
             as it is.\n",
            config.returns.shaping
        );
    }
    if config.replay.symmetries {
        text += "- Sampled records are turned and mirrored at random.\n";
    }
    text
}

/// Allocation states of a bundle.
const CASES: usize = 48;
/// One of so many allocations becomes golden, so that they come from many episodes.
const STRIDE: usize = 23;

/// Plays the episodes of a plan and keeps some of the allocations.
fn golden_allocations(
    plan: &EvaluationPlan<'_>,
    agents: &UtilityNetwork,
    learned: LearnedAllocator<'_>,
) -> Result<Vec<GoldenAllocation>, LearnError> {
    let mut recorder = AllocationRecorder {
        allocator: TeamValueAllocator::new(learned.network, learned.team_max),
        network: learned.network,
        pass: UtilityPass::new(learned.network.shape()),
        allocations: 0,
        cases: Vec::new(),
    };
    evaluate(plan, &mut NetworkTeam::new(agents), &mut recorder)?;
    Ok(recorder.cases)
}

/// Allocates, and keeps every so many-th allocation.
struct AllocationRecorder<'a> {
    allocator: TeamValueAllocator<'a>,
    network: &'a UtilityNetwork,
    pass: UtilityPass,
    allocations: usize,
    cases: Vec<GoldenAllocation>,
}

impl Allocate for AllocationRecorder<'_> {
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.allocator.allocate(environment, state, generator, allocation)?;
        self.allocations += 1;
        if self.allocations % STRIDE == 1 && self.cases.len() < CASES {
            let case = self.case(environment, state, allocation);
            self.cases.push(case);
        }
        Ok(())
    }
}

impl AllocationRecorder<'_> {
    fn case(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        allocation: &[u8],
    ) -> GoldenAllocation {
        let seen = allocation_state(environment, state);
        let allocation = allocation[..seen.agents].to_vec();
        let relations = environment.spec().relations;
        let mut relation = Vec::new();
        let mut values = Vec::new();
        for task in seen.open() {
            relation.extend(to_task(environment, state, task));
            let assigned = allocation.iter().enumerate();
            let team = assigned.filter(|(_, place)| usize::from(**place) == task);
            let team = team.map(|(agent, _)| 1_u64 << agent).sum();
            let everybody = (0..seen.agents).map(|agent| 1_u64 << agent).sum();
            values.extend(self.values((environment, state), task, [0, team, everybody]));
        }
        GoldenAllocation { state: seen, relations, relation, values, allocation }
    }

    fn values(
        &mut self,
        (environment, state): (&dyn Environment, &[u8]),
        task: usize,
        teams: [u64; 3],
    ) -> [GoldenValue; 3] {
        let mut input = TeamValueInput::default();
        let queries = teams.iter().map(|team| TeamQuery { state, task, team: *team, turn: 0 });
        let values = self.pass.forward(self.network, input.queries(environment, queries));
        std::array::from_fn(|index| GoldenValue { task, team: teams[index], value: values[index] })
    }
}

/// How every entity stands to a subtask, in full.
fn to_task(environment: &dyn Environment, state: &[u8], task: usize) -> Vec<f32> {
    let mut rows = SparseRows::default();
    environment.relate(state, 0, task, EntitySet::MAX, &mut rows);
    let mut dense = Vec::new();
    rows.write_all(environment.spec().relations, &mut dense);
    dense
}

/// A learned allocator.
#[derive(Clone, Copy, Debug)]
pub struct LearnedAllocator<'a> {
    /// Its team-value network.
    pub network: &'a UtilityNetwork,
    /// Largest team of one building.
    pub team_max: usize,
}

impl<'a> LearnedAllocator<'a> {
    /// The allocator of a run, if the run learns one.
    pub fn of(run: &'a Run) -> Option<Self> {
        let Config::Records(config) = &run.config else { return None };
        let team_max = config.allocation.team_max;
        match &run.allocator {
            Some(RunAllocator::TeamValue(network)) => Some(Self { network, team_max }),
            _ => None,
        }
    }
}
