//! What a bundle says of the environment that its team is for.

use sortie_bundle::{
    ContractV1, Environment as Described, FallbackAllocation, GoldenCase, Limits,
    SubtaskConditioning, WIRE_ABI,
};
use sortie_envs::{Shape, Spec};

/// The contract of agents that know of no subtasks.
pub fn contract(spec: &Spec, append_last_action: bool) -> ContractV1 {
    ContractV1 {
        abi: WIRE_ABI,
        actions: spec.shape.actions as u16,
        features: spec.shape.features as u16,
        feature_names: spec.features.clone(),
        action_names: spec.actions.clone(),
        decision_interval: 1,
        append_last_action,
        subtask_conditioning: SubtaskConditioning::None,
        subtask_actions: false,
        safe_action: spec.safe_action,
        fallback_allocation: FallbackAllocation::Unallocated,
    }
}

/// The environment, with the ranges of features that golden observations have shown.
pub fn described(name: String, spec: &Spec, cases: &[GoldenCase]) -> Described {
    let columns = spec.shape.features;
    let mut ranges = vec![[0.0f32, 0.0]; columns];
    for row in cases.iter().flat_map(|case| case.observation.rows.chunks_exact(columns)) {
        for (range, value) in ranges.iter_mut().zip(row) {
            *range = [range[0].min(*value), range[1].max(*value)];
        }
    }
    let unit = |column| spec.units.get(column).map_or("1", |unit| *unit).to_owned();
    Described {
        name,
        version: spec.version.to_owned(),
        feature_units: (0..columns).map(unit).collect(),
        feature_ranges: ranges,
    }
}

/// The sizes of all environments that a bundle is to serve; a team may be as large as all agents.
pub fn limits(sizes: &[Shape]) -> Limits {
    let most = |size: fn(&Shape) -> usize| sizes.iter().map(size).max().unwrap_or(0) as u16;
    Limits {
        n_max: most(|shape| shape.entities),
        t_max: most(|shape| shape.tasks),
        team_max: most(|shape| shape.agents),
    }
}
