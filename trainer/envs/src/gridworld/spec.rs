//! What a gridworld says of itself.

use alloc::string::String;

use super::bytes::state_bytes;
use super::episode::Rules;
use super::features::{columns, entries, names, units};
use super::{ACTION_NAMES, STAY, VERSION};
use crate::spec::{Metric, Shape, Spec, View};

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "gridworld";

const METRICS: &[Metric] = &[
    Metric {
        name: "treasures",
        unit: "treasures",
        about: "treasures found, one for each agent that found it",
        is_reported: true,
    },
    Metric {
        name: "tiers",
        unit: "tiers",
        about: "tiers of treasures finished",
        is_reported: true,
    },
];

/// What a gridworld with these rules says of itself.
pub(super) fn spec(rules: &Rules) -> Spec {
    let (agents, features) = (rules.agents(), columns(rules));
    let actions = ACTION_NAMES.len();
    Spec {
        name: NAME,
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions, features },
        view: View::Vectors,
        features: names(rules),
        units: units(rules),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(STAY.into()),
        metrics: METRICS,
        row_entries: entries(rules),
        map: rules.map.lines(),
        state_bytes: state_bytes(rules),
        episode_limit: rules.episode_limit,
        ..Spec::default()
    }
}
