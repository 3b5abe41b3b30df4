//! What a ring says of itself.

use alloc::string::String;
use alloc::vec::Vec;

use super::VERSION;
use super::bytes::state_bytes;
use super::features::feature_names;
use super::parameters::Parameters;
use super::rules::{ACTION_NAMES, ACTIONS, STAY};
use crate::spec::{Metric, Rewards, Shape, Spec, View};

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "group-matching";

const METRICS: &[Metric] =
    &[Metric { name: "matches", unit: "groups", about: "groups gathered", is_reported: true }];

/// Entries of a row beside the groups: its cell, itself.
const OWN_ENTRIES: usize = 2;

/// What a ring with these parameters says of itself.
pub(super) fn spec(parameters: &Parameters) -> Spec {
    let Parameters { agents, groups, episode_limit, .. } = *parameters;
    let features = parameters.features();
    Spec {
        name: NAME,
        version: VERSION,
        shape: Shape { agents, entities: agents, tasks: 0, actions: ACTIONS, features },
        view: View::Entities,
        features: feature_names(parameters),
        units: Vec::new(),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(STAY),
        causes: &[],
        metrics: METRICS,
        rewards: Rewards::default(),
        turns: 1,
        rules: &[],
        relations: 0,
        row_entries: OWN_ENTRIES + groups,
        state_bytes: state_bytes(parameters),
        episode_limit,
        ..Spec::default()
    }
}

/// The sizes of a ring by what it says of itself, with its most steps; all else is as usual.
pub fn sizes(spec: &Spec) -> Parameters {
    let Shape { agents, features, .. } = spec.shape;
    let groups = spec.row_entries - OWN_ENTRIES;
    let cells = features - groups - agents;
    Parameters { agents, cells, groups, episode_limit: spec.episode_limit, ..Parameters::default() }
}
