//! What a scenario says of itself.

use alloc::vec::Vec;

use super::VERSION;
use super::physics::ACTIONS;
use super::scenario::Scenario;
use super::states::state_bytes;
use crate::spec::{Rewards, Shape, Spec, View};

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "particle";

/// What a scenario says of itself. Where all agents are alike there are no roles.
pub(super) fn spec<S: Scenario>(scenario: &S) -> Spec {
    let mut roles = scenario.roles();
    let agents = roles.iter().map(|role| role.agents.len()).sum();
    let widest = roles.iter().max_by_key(|role| role.features.len());
    let widest = widest.expect("somebody plays").clone();
    let features = widest.features.len();
    if roles.len() == 1 {
        roles = Vec::new();
    }
    Spec {
        name: NAME,
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions: ACTIONS, features },
        view: View::Vectors,
        features: widest.features,
        units: widest.units,
        actions: widest.actions,
        roles,
        safe_action: Some(0),
        has_success: false,
        metrics: S::METRICS,
        rewards: Rewards { tasks: false, agents: true },
        row_entries: features,
        state_bytes: state_bytes(scenario),
        episode_limit: scenario.episode_limit(),
        ..Spec::default()
    }
}
