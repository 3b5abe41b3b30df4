//! A bundle whose allocator proposes: verified, evaluated and run.

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use sortie_bundle::{AGENT, Bundle, Draft, PROPOSAL_PARTS, PROPOSALS};
use sortie_methods::alma::export::export_proposals;
use sortie_methods::alma::windows::allocation::{AllocationShape, CriticWeights, PolicyWeights};
use support::{BUNDLE, json};

/// The shipped team with an allocator of random weights, which proposes.
fn proposing(folder: &Path) {
    let team = Bundle::open(Path::new(BUNDLE)).expect("the shipped bundle");
    let (contract, limits) = (team.contract().clone(), team.manifest().limits);
    let shape = AllocationShape {
        features: contract.features.into(),
        columns: limits.t_max.into(),
        width: 16,
        heads: 2,
    };
    let (policy, critic) = networks(shape);
    let graphs = export_proposals(&policy, &critic, contract.hash()).expect("finite weights");
    let parts = [graphs.trunk, graphs.step, graphs.critic];
    let mut parts: BTreeMap<String, Vec<u8>> =
        PROPOSAL_PARTS.iter().map(|name| (*name).to_owned()).zip(parts).collect();
    parts.insert(AGENT.to_owned(), team.agent_onnx().to_vec());
    let mut network = team.manifest().network.clone();
    network.allocator = Some(PROPOSALS.to_owned());
    let environment = team.manifest().contract.environment.clone();
    let mut golden = team.golden().clone();
    golden.allocations.clear();
    let draft = Draft { contract, environment, limits, network, golden, parts };
    draft.write(folder).expect("a new folder");
}

fn networks(shape: AllocationShape) -> (PolicyWeights, CriticWeights) {
    let AllocationShape { features, columns, width, .. } = shape;
    let mut state = 11_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / 8_388_608.0 - 1.0) * 0.25
    };
    let mut tensor = |count: usize| (0..count).map(|_| next()).collect::<Vec<f32>>();
    let policy = PolicyWeights {
        shape,
        entity_weight: tensor(width * features),
        entity_bias: tensor(width),
        task_weight: tensor(width * columns),
        attention_in_weight: tensor(3 * width * width),
        attention_out_weight: tensor(width * width),
        attention_out_bias: tensor(width),
        count_weight: tensor(width * 2),
        count_bias: tensor(width),
        update_weight: tensor(2 * width * width),
        update_bias: tensor(width),
    };
    let critic = CriticWeights {
        shape,
        entity_weight: tensor(width * features),
        entity_bias: tensor(width),
        task_weight: tensor(width * columns),
        count_weight: tensor(width * 2),
        count_bias: tensor(width),
        attention_in_weight: tensor(3 * width * width),
        attention_out_weight: tensor(width * width),
        attention_out_bias: tensor(width),
        value_weight: tensor(width),
        value_bias: tensor(1),
        popart_weight: 1.0,
        popart_bias: 0.0,
        mean: 0.0,
        deviation: 1.0,
    };
    (policy, critic)
}

#[test]
fn a_bundle_that_proposes_is_verified_evaluated_and_run() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let folder = place.path().join("proposing");
    proposing(&folder);
    let bundle = folder.display().to_string();
    let verified = json(&["verify", &bundle, "--inputs", "32", "--against", "tract", "--json"]);
    let named = |engine: &&serde_json::Value| engine["name"] == "allocator plan against tract";
    let engines = verified["engines"].as_array().expect("engines");
    assert!(engines.iter().any(|engine| named(&engine)), "{verified}");

    let eval = |proposals: &str| {
        let arguments = ["eval", &bundle, "--episodes", "4", "--proposals", proposals, "--json"];
        json(&arguments)
    };
    let (several, greedy) = (eval("8"), eval("1"));
    assert_eq!(several, eval("8"), "the same seed allocates the same");
    assert_ne!(several["return_mean"], greedy["return_mean"], "proposals matter");

    let run = ["run", &bundle, "--episodes", "2", "--in-process", "--proposals", "4", "--json"];
    let run = json(&run);
    assert_eq!(run["episodes"], 2, "{run}");
}
