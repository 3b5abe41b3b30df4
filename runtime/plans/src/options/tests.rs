//! An agent that runs options, by the plans that its bundle ships: it plays the episodes that the trainer's own passes
//! played, tick by tick.

use std::path::Path;

use sortie_bundle::Bundle;
use sortie_core::options::Pursuit;
use sortie_core::plan::AlignedBytes;
use sortie_core::{DecideError, EntityMask, Observation};

use crate::{AgentPlans, compare_with_golden, compare_with_golden_episodes};

fn bundle() -> Bundle {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    Bundle::open(&root.join("models/crafting-iron")).expect("the shipped bundle")
}

fn plans(bundle: &Bundle) -> AgentPlans {
    let plans = bundle.agent_graphs().into_iter().map(|graph| {
        AlignedBytes::copy_of(bundle.part(&graph.plan_part()).expect("the bundle ships its plans"))
    });
    AgentPlans::new(bundle, plans.collect())
}

#[test]
fn the_shipped_agent_plays_whole_episodes_as_the_trainer_did() {
    let bundle = bundle();
    let plans = plans(&bundle);
    let mut arenas = plans.arenas(1).unwrap();
    let mut policy = plans.policy(&mut arenas).unwrap();
    let found = compare_with_golden_episodes(policy.as_mut(), &bundle).unwrap();
    let ticks: Vec<_> = bundle.golden().episodes.iter().flat_map(|it| &it.ticks).collect();
    assert!(bundle.golden().episodes.len() == 3 && ticks.len() > 300, "{}", ticks.len());
    assert!(ticks.iter().filter(|tick| tick.chose).count() > 60);
    assert_eq!((found.inputs, found.action_mismatches), (ticks.len(), 0));
    let cases = compare_with_golden(policy.as_mut(), &bundle.golden().cases, &[]);
    assert!(cases.agrees() && cases.action_mismatches == 0, "{cases:?}");
}

#[test]
fn another_goal_boundary_or_action_is_told() {
    let bundle = bundle();
    let plans = plans(&bundle);
    let mut arenas = plans.arenas(1).unwrap();
    let mut policy = plans.policy(&mut arenas).unwrap();
    let changes: [fn(&mut sortie_bundle::GoldenTick); 3] =
        [|tick| tick.goal ^= 1, |tick| tick.chose = !tick.chose, |tick| tick.action ^= 1];
    for change in changes {
        let mut draft = bundle.draft();
        change(&mut draft.golden.episodes[1].ticks[7]);
        let other = draft.unwritten(bundle.folder()).unwrap();
        let found = compare_with_golden_episodes(policy.as_mut(), &other).unwrap();
        assert_eq!(found.action_mismatches, 1);
    }
}

#[test]
fn bundles_of_options_need_their_rules_and_episodes() {
    let refused = |change: fn(&mut sortie_bundle::Draft)| {
        let mut draft = bundle().draft();
        change(&mut draft);
        draft.unwritten(Path::new("new")).unwrap_err().to_string()
    };
    let said = refused(|draft| draft.network.options = None);
    assert!(said.contains("needs its rules"), "{said}");
    let said = refused(|draft| draft.golden.episodes.clear());
    assert!(said.contains("golden episodes"), "{said}");
    let said = refused(|draft| draft.network.options.as_mut().unwrap().picture.counts = 11);
    assert!(said.contains("shows in no count") || said.contains("1100 numbers"), "{said}");
    let said = refused(|draft| draft.network.options.as_mut().unwrap().threshold = 2.0);
    assert!(said.contains("from 0 to 1"), "{said}");
    let said = refused(|draft| drop(draft.parts.remove("agent-meta.onnx")));
    assert!(said.contains("agent-meta.onnx"), "{said}");
}

#[test]
fn an_agent_without_its_memory_does_not_decide() {
    let bundle = bundle();
    let plans = plans(&bundle);
    let mut arenas = plans.arenas(1).unwrap();
    let mut policy = plans.policy(&mut arenas).unwrap();
    let row = bundle.golden().episodes[0].ticks[0].row(1101).unwrap();
    let seen = Observation {
        rows: &row,
        stride: 1101,
        last_actions: &[],
        visible: EntityMask::first(1),
        self_index: 0,
        available: &[1; 11],
    };
    let want = policy.hidden();
    assert_eq!(policy.decide(&seen), Err(DecideError::HiddenState { want, got: 0 }));
    let mut memory = vec![0.0; want];
    assert_eq!(Pursuit::of(&memory), None);
    policy.decide_with(&seen, &mut memory).unwrap();
    assert_eq!(Pursuit::of(&memory).map(|pursuit| pursuit.steps), Some(1));
}
