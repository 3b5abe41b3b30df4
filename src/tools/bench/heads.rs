//! `bench heads`: decisions of agents that point at what they aim at, beside those of agents with weights for every action.

use clap::Args;
use sortie_cli::failure::Failure;
use sortie_cli::tools::compiler;
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{EntityMask, PlanPolicy, Policy};
use sortie_learn::export::{AgentNetwork, agent_onnx};
use sortie_learn::networks::{AgentShape, EntityAgent, LookShape, Targets};
use sortie_nn::random::stream;
use sortie_nn::tape::Parameters;
use sortie_plans::{CompileError, CompileOptions, Compiler, random_observations_of};

use super::contestants::PROFILES;
use super::rounds::{Pace, alternate, engine, our_engine};
use super::{Figures, Measuring, if_runnable, pin};

/// Of the observations: agents' own columns and two of each pair, eight targets among eleven entities, six further actions.
const FEATURES: usize = 32;
const ENTITIES: usize = 11;
const ACTIONS: usize = 14;
const AIMED: Targets = Targets { first: 3, count: 8, first_pair: 0, pair_features: 0 };
const RELATED: Targets = Targets { first_pair: 16, pair_features: 2, ..AIMED };
/// Observations in rotation.
const OBSERVATIONS: usize = 64;
/// The heads, by what they are called in tables; the last is the peer.
const HEADS: [(&str, Targets); 3] = [
    ("pointing, pairs", RELATED),
    ("pointing", AIMED),
    ("numbered", Targets { count: 0, ..AIMED }),
];

/// Decisions of agents that point at entities beside those of agents with weights for every action, in alternation
///
/// Equal widths, random weights and observations: eleven entities, all of which are visible, fourteen actions, of which eight
/// aim at one each; the agent's own row has two features of each pair.
#[derive(Debug, Args)]
pub(super) struct HeadsArguments {
    /// Widths of the networks, several joined by commas
    #[arg(long, value_delimiter = ',', default_values_t = [64, 128], value_name = "W")]
    widths: Vec<usize>,
    #[command(flatten)]
    pub(super) measuring: Measuring,
}

pub(super) fn measure(arguments: &HeadsArguments) -> Result<Figures, Failure> {
    let seed = arguments.measuring.common.seed;
    let mut seen = random_observations_of(OBSERVATIONS, ENTITIES, FEATURES, ACTIONS, seed);
    seen.iter_mut().for_each(|seen| seen.visible = EntityMask::first(ENTITIES));
    let cases = arguments.widths.len() * PROFILES.len();
    let seconds = arguments.measuring.seconds / cases as f64;
    let mut figures = Figures::default();
    pin(arguments.measuring.pin)?;
    for width in &arguments.widths {
        for (name, profile) in PROFILES {
            let plans = HEADS.map(|(_, targets)| plan(*width, targets, profile));
            let mut policies = Vec::new();
            for plan in plans {
                let plan = plan?;
                let bytes = Plan::load(plan.as_slice()).map(|plan| plan.arena_bytes());
                let bytes = if_runnable(name, bytes.map_err(CompileError::from))?;
                let Some(bytes) = bytes else { break };
                policies.push((plan, AlignedBytes::zeroed(bytes)));
            }
            if policies.len() < HEADS.len() {
                continue;
            }
            let mut engines = Vec::new();
            for ((head, targets), (plan, arena)) in HEADS.into_iter().zip(&mut policies) {
                let plan = Plan::load(plan.as_slice()).map_err(CompileError::from)?;
                let policy = PlanPolicy::new(plan, arena.as_mut_slice());
                let mut policy = policy.map_err(CompileError::from)?;
                let seen = &seen;
                let work = move |call: usize| {
                    let decision = policy.decide(&seen[call % seen.len()].view());
                    std::hint::black_box(decision.expect("an action is available"));
                };
                engines.push(match targets.count {
                    0 => engine(head, "", work),
                    _ => our_engine(head, work),
                });
            }
            let measured = alternate(&mut engines, Pace::Hot, seconds);
            figures.add("heads", &format!("width {width}, {name}"), &engines, &measured);
        }
    }
    Ok(figures)
}

/// An agent of random weights in a profile.
fn plan(width: usize, targets: Targets, profile: Profile) -> Result<AlignedBytes, Failure> {
    let looking = LookShape { input: FEATURES, active_inputs: FEATURES, width, heads: 4 };
    let shape = AgentShape { looking, actions: ACTIONS, skip: true, memory: 0, targets };
    let mut parameters = Parameters::default();
    let agent = EntityAgent::new(&mut parameters, shape, &mut stream(1, 1, 0));
    let (layers, _) = agent.deployed(&parameters.values);
    let network =
        AgentNetwork { features: FEATURES, append_last_action: false, contract: 0, layers };
    let onnx = agent_onnx(&network).map_err(Failure::bug)?;
    let options = CompileOptions { n_max: ENTITIES, profile, ..CompileOptions::default() };
    Ok(AlignedBytes::copy_of(&compiler().compile(&onnx, &options)?.bytes))
}
