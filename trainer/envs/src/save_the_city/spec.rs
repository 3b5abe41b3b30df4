//! What SaveTheCity says of itself.

use alloc::string::String;

use super::allocation::RULES;
use super::bytes::state_bytes;
use super::causes::Cause;
use super::features::{FEATURE_NAMES, FEATURES, ROW_ENTRIES};
use super::relation::RELATIONS;
use super::rules::{ACTION_NAMES, ACTIONS};
use super::scenarios::ScenarioSet;
use super::symmetry::Symmetry;
use super::{Constants, VERSION};
use crate::spec::{Metric, Rewards, Rule, Shape, Spec, View};

/// Its name, as `--env` takes it.
pub(super) const NAME: &str = "save-the-city";

/// The metric that tells how many buildings there were.
pub(super) const BUILDINGS: &str = "buildings";

/// What a command line may name, see [`RULES`].
pub(super) const RULE_NAMES: &[Rule] = &[RULES[0].0, RULES[1].0, RULES[2].0];

pub(super) const METRICS: &[Metric] = &[
    Metric { name: "none_burned", unit: "share", about: "no building burned", is_reported: true },
    Metric {
        name: "prop_buildings_completed",
        unit: "share",
        about: "of the buildings that are complete",
        is_reported: false,
    },
    Metric { name: "fires_extinguished", unit: "fires", about: "put out", is_reported: false },
    Metric {
        name: "buildings_completed",
        unit: "buildings",
        about: "completed",
        is_reported: false,
    },
    Metric { name: "buildings_burned", unit: "buildings", about: "lost", is_reported: false },
    Metric { name: BUILDINGS, unit: "buildings", about: "of the episode", is_reported: false },
    Metric {
        name: "buildings_health_delta",
        unit: "health",
        about: "sum of all changes",
        is_reported: false,
    },
    Metric {
        name: "types_per_firefight",
        unit: "kinds",
        about: "at a fire that anyone fought",
        is_reported: false,
    },
    Metric {
        name: "types_per_build",
        unit: "kinds",
        about: "at a building that anyone built",
        is_reported: false,
    },
];

/// The unit of a feature.
fn unit(feature: &str) -> &'static str {
    match feature {
        "x-scaled" | "y-scaled" => "sides of the map",
        "health" | "fire" => "share of full",
        "since-last-fire" => "ignition periods",
        "ignition-rate" => "share of the fastest",
        _ => "flag",
    }
}

/// What a set of scenarios says of itself.
pub(super) fn spec(set: &ScenarioSet, constants: &Constants) -> Spec {
    let shape = Shape {
        agents: set.max_agents,
        entities: set.max_agents + set.max_buildings,
        tasks: set.max_buildings,
        actions: ACTIONS,
        features: FEATURES,
    };
    Spec {
        name: NAME,
        version: VERSION,
        shape,
        view: View::Entities,
        features: FEATURE_NAMES.map(String::from).to_vec(),
        units: FEATURE_NAMES.map(unit).to_vec(),
        actions: ACTION_NAMES.map(String::from).to_vec(),
        safe_action: Some(0),
        metrics: METRICS,
        causes: &Cause::NAMES,
        rewards: Rewards { tasks: true, agents: false },
        turns: Symmetry::ALL.len(),
        rules: RULE_NAMES,
        relations: RELATIONS,
        row_entries: ROW_ENTRIES,
        state_bytes: state_bytes(set.max_agents, set.max_buildings),
        episode_limit: constants.episode_limit,
        ..Spec::default()
    }
}
