//! Agents and allocators of ALMA as they are deployed, and what cards say of them.

use sortie_learn::LearnError;
use sortie_learn::configuration::require;
use sortie_learn::export::{DeployedAgents, DeployedNetworks, Words};

use super::agents::{Conditioning, NetworkPolicy, UtilityShape};
use super::teams::Agents;

/// The agents as they are deployed.
///
/// # Errors
/// They need more than what a deployed agent is shown: another conditioning than masks, a memory, a coach.
pub(super) fn deployed(
    agents: Agents<'_>,
    conditioning: Conditioning,
) -> Result<DeployedAgents<'_>, LearnError> {
    if let Some(coach) = agents.coach {
        let numbers = coach.layers.shape.strategy;
        return Err(LearnError::Config(format!(
            "agents with a coach are evaluated only: deployed they would need the coach, which sees \
             everything, and a message of {numbers} numbers from it to each of them"
        )));
    }
    require(
        agents.unit.is_none(),
        "agents with a memory are evaluated only: teams of processes keep no memories yet",
    )?;
    if conditioning != Conditioning::Mask {
        let conditioning = conditioning.name();
        return Err(LearnError::Config(format!(
            "agents with `network.subtask = \"{conditioning}\"` are evaluated only: bundles hold agents that see their \
             own subtask (`network.subtask=mask`)"
        )));
    }
    let policy = Box::new(NetworkPolicy::new(agents.network).deployed());
    let networks = DeployedNetworks::Attention { network: agents.network.layers(), memory: None };
    Ok(DeployedAgents { networks, policy })
}

/// What the cards of both presets say; `allocator` is what allocates, `departures` where the training departs from the
/// dissertation.
pub(super) fn words(allocator: String, departures: String) -> Words {
    let agents = "Every agent runs the same masked-attention utility network (dissertation section 7.3): it sees the\n\
                  entities of its own subtask and its team mates, and nothing else.";
    let figures = "*Success*: all subtasks are completed. ";
    let limits = "It serves teams up to the largest of these scenarios; `bundle.toml` has the numbers.\n\
                  Agents that do not share a subtask do not see each other and can block each other's way.\n";
    let [agents, figures, limits] = [agents, figures, limits].map(str::to_owned);
    Words { agents, allocator, figures, departures, limits }
}

/// Whose own embedding reaches the layers behind the attention directly.
pub(super) fn skips(agents: UtilityShape, allocator: Option<UtilityShape>) -> String {
    let allocator = allocator.is_some_and(|shape| shape.skip);
    let who = match (agents.skip, allocator) {
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

#[cfg(test)]
mod tests;
