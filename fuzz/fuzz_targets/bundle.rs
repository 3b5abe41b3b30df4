//! Text files of a bundle: read or refused, never a panic; what was read comes back as it was.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use sortie_bundle::{
    ContractV1, FallbackAllocation, Golden, Manifest, SubtaskConditioning, CONTRACT_ABI,
};

static CONTRACT: LazyLock<ContractV1> = LazyLock::new(|| ContractV1 {
    abi: CONTRACT_ABI,
    actions: 2,
    features: 3,
    feature_names: ["x", "y", "health"].map(str::to_owned).to_vec(),
    action_names: ["stay", "go"].map(str::to_owned).to_vec(),
    decision_interval: 5,
    append_last_action: true,
    subtask_conditioning: SubtaskConditioning::Mask,
    subtask_actions: false,
    safe_action: Some(0),
    fallback_allocation: FallbackAllocation::Unallocated,
});

fuzz_target!(|bytes: &[u8]| {
    // JSON starts with a brace, TOML never does.
    if bytes.first() != Some(&b'{') {
        let _ = Manifest::parse(Path::new("bundle.toml"), bytes);
        return;
    }
    let Ok(golden) = Golden::from_json(bytes, &CONTRACT) else { return };
    for case in &golden.cases {
        let observation = case.observation.view();
        assert!(observation.self_index < case.observation.entities());
    }
    for case in &golden.allocations {
        let state = case.state.view();
        assert_eq!(state.agents, case.allocation.len());
        for value in &case.values {
            let query = case.query(&state, value);
            assert!(query.own_row().is_none_or(|row| row < case.state.entities()));
        }
    }
    // Numbers that are not finite have no JSON.
    let Ok(json) = golden.to_json(&CONTRACT) else { return };
    if let Ok(again) = Golden::from_json(&json, &CONTRACT) {
        assert_eq!(format!("{again:?}"), format!("{golden:?}"));
    }
});
