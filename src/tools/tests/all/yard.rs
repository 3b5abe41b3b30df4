//! Agents that point, in the environment of `examples/own_environment`: learned, exported, compiled in both kinds of weights.

#[path = "../../../../examples/own_environment/src/yard.rs"]
mod environment;

use std::path::Path;
use std::sync::atomic::AtomicBool;

use sortie_bundle::{Bundle, Recording};
use sortie_compiler::{compile, compile_rounded};
use sortie_core::plan::{AlignedBytes, Plan, Profile};
use sortie_core::{PlanPolicy, Policy};
use sortie_envs::Environment;
use sortie_learn::draft::{DecoratedPolicy, MethodRun, draft_method};
use sortie_learn::play::{PolicyTeam, evaluate};
use sortie_learn::run::{RunConfig, RunDescription};
use sortie_learn::session::{EnvironmentChoice, Opening, Session};
use sortie_plans::{
    CompileOptions, LEAST_OBSERVATIONS, compare_with_golden, inspect_plan, quantise,
};

use environment::Yard;

/// A bundle of what VDN learned here.
fn learned(folder: &Path) -> Bundle {
    let (yard, entry) = (Yard::new(1), sortie_methods::find("vdn").unwrap());
    let mut setup = entry.preset("fast").unwrap();
    setup.environment = EnvironmentChoice::of(&yard, 16);
    let steps = 40_000;
    setup.run = RunConfig { steps, evaluate_every: steps, final_episodes: 0, ..setup.run };
    for assignment in ["network.width=32", "replay.batch=64", "exploration.steps=10_000"] {
        setup = entry.set(&setup, assignment).unwrap();
    }
    let description = RunDescription::new(setup, 1, 1);
    let opening = Opening { setup: &description.config, environment: &yard, seed: 1, threads: 1 };
    let method = entry.method(&opening).unwrap();
    let place = folder.join("run");
    let mut session =
        Session::begin(description.clone(), Box::new(Yard::new(1)), method, &place).unwrap();
    session.run(&mut (), &AtomicBool::new(false)).unwrap();
    let (method, curve) = (session.method(), session.curve());
    let run = MethodRun { description: &description, environment: &yard, method, curve };
    let draft = draft_method(&run, &place, &[yard.spec().shape], &[], 1).unwrap();
    draft.write(&folder.join("bundle")).unwrap()
}

#[test]
fn agents_that_point_keep_their_actions_as_plans() {
    let folder = tempfile::tempdir().unwrap();
    let bundle = learned(folder.path());
    let (onnx, yard) = (bundle.agent_onnx(), Yard::new(1));
    let options = |profile| CompileOptions { profile, ..CompileOptions::default() };
    let exact = compile(onnx, &options(Profile::Exact)).unwrap();
    let facts = inspect_plan(&exact.bytes).unwrap();
    let head = facts.operators.iter().find(|op| op.name == "PointAtEntities").unwrap();
    assert_eq!(head.detail, "[N, 32] and [3, 2] -> [3] of [6]");

    let plan = AlignedBytes::copy_of(&exact.bytes);
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    let mut policy = PlanPolicy::new(plan, arena.as_mut_slice()).unwrap();
    let found = compare_with_golden(&mut policy, &bundle.golden().cases, &[]);
    assert!(found.inputs > 200 && found.agrees() && found.action_mismatches == 0, "{found:?}");

    let shape = yard.spec().shape;
    let mut recording = Recording::new(bundle.contract().hash(), shape.features, shape.actions);
    let recorder = DecoratedPolicy::new(policy, |policy, observation, hidden| {
        recording.add(observation);
        policy.decide_with(observation, hidden)
    });
    let episodes = LEAST_OBSERVATIONS / shape.agents / 5;
    let found = evaluate(&yard, &mut PolicyTeam::new(recorder), episodes, 3).unwrap();
    assert!(found.return_mean > 0.7, "{found:?}");
    let quantised = quantise(
        |profile, examples| compile_rounded(onnx, &options(profile), examples),
        &recording,
    );
    let agreement = quantised.unwrap().agreement;
    assert!(agreement.observations > LEAST_OBSERVATIONS, "{agreement:?}");
    assert!(agreement.share() >= 0.995 && agreement.max_rel_error < 0.005, "{agreement:?}");
}
