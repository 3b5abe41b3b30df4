//! A run of any method becomes a bundle.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use sortie_bundle::{AGENT, CARD, CURVE, CURVE_DATA, Draft, Golden, Network, TRAINING};
use sortie_envs::{Environment, Shape};

use super::described::{contract, described, limits};
use super::measured::{Measured, measured_table, read_part};
use super::recorder::Recorder;
use crate::error::LearnError;
use crate::export::{
    AgentNetwork, DeployedAgents, RecurrentAgent, agent_onnx, recurrent_agent_onnx,
};
use crate::method::Method;
use crate::play::{PolicyTeam, evaluate};
use crate::run::{CurvePoint, RunDescription};

/// Episodes that golden observations are drawn from.
const GOLDEN_EPISODES: usize = 400;

/// A run of any method, as far as its bundle needs it.
pub struct MethodRun<'a> {
    /// How it learned.
    pub description: &'a RunDescription,
    /// Where it learned.
    pub environment: &'a dyn Environment,
    /// What has learned.
    pub method: &'a dyn Method,
    /// Its evaluations.
    pub curve: &'a [CurvePoint],
}

/// Makes a bundle of what the run in `folder` has learned; `sizes` are those of all environments that it is to serve.
///
/// # Errors
/// The agents cannot be deployed, files of the run cannot be read, or the network is not finite.
pub fn draft_method(
    run: &MethodRun<'_>,
    folder: &Path,
    sizes: &[Shape],
    measured: &[Measured],
    seed: u64,
) -> Result<Draft, LearnError> {
    let spec = run.environment.spec();
    let DeployedAgents { network, memory, mut policy } = run.method.deployed()?;
    let hidden = if memory.is_some() { network.base as u32 } else { 0 };
    let contract = contract(spec, network.inputs != spec.shape.features);
    let agent = AgentNetwork {
        features: spec.shape.features,
        append_last_action: contract.append_last_action,
        contract: contract.hash(),
        layers: network,
    };
    let agent = match memory {
        Some(gru) => recurrent_agent_onnx(&RecurrentAgent { agent, attention_relu: false, gru }),
        None => agent_onnx(&agent),
    };
    let agent = agent.map_err(|error| LearnError::format(folder, error))?;
    let mut team = PolicyTeam::new(Recorder::new(&mut *policy, spec.shape.features));
    evaluate(run.environment, &mut team, GOLDEN_EPISODES, seed)?;
    let golden = Golden { cases: team.into_policy().cases, allocations: Vec::new() };
    let parts = BTreeMap::from([
        (AGENT.to_owned(), agent),
        (CARD.to_owned(), card(run, measured, network.skip.is_some()).into_bytes()),
        (CURVE.to_owned(), read_part(folder, CURVE)?),
        (CURVE_DATA.to_owned(), read_part(folder, CURVE_DATA)?),
        (TRAINING.to_owned(), read_part(folder, TRAINING)?),
    ]);
    Ok(Draft {
        environment: described(run.description.config.environment.to_string(), spec, &golden.cases),
        limits: limits(sizes),
        network: Network { agent: "masked-attention".to_owned(), allocator: None, hidden },
        golden,
        contract,
        parts,
    })
}

/// The model card.
fn card(run: &MethodRun<'_>, measured: &[Measured], skip: bool) -> String {
    let RunDescription { seed, version, config, .. } = run.description;
    let method = &config.method;
    let mut card = format!(
        "# A team for {}\n\n\
         Every agent runs the same attention network over the entities that it observes. Trained by\n\
         `sortie train {method}`, seed {seed}, Sortie {version}; `train.toml` repeats the run.\n\n\
         ## How well it does\n\n\
         Greedy episodes that training never saw. The interval is that of the episodes, not of training again.\n\n",
        config.environment
    );
    card += &measured_table(measured);
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
    if skip {
        card += "\n## Where the training departs from the dissertation\n\n\
                 - An agent's own embedding reaches the layer before the head past the attention (`network.skip`).\n";
    }
    card
}
