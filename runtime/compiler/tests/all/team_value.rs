//! An allocator's network becomes a plan that values teams as the graph does.

use sortie_compiler::{GraphPolicy, GraphTeamValue, compile};
use sortie_core::allocate::{PlanTeamValue, TeamValueNetwork};
use sortie_core::plan::{AlignedBytes, Network, Plan, PlanError, Profile};
use sortie_core::{AllocateError, PlanPolicy};
use sortie_plans::{
    CompileError, CompileOptions, OwnedTeamQuery, inspect_plan, random_team_queries,
};

use crate::support::beside_truth;

fn golden(name: &str) -> Vec<u8> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/onnx/");
    std::fs::read(format!("{root}{name}.onnx")).unwrap()
}

fn plan() -> AlignedBytes {
    plan_of(Profile::Exact)
}

fn plan_of(profile: Profile) -> AlignedBytes {
    let options = CompileOptions { n_max: 9, profile, ..CompileOptions::default() };
    AlignedBytes::copy_of(&compile(&golden("team_value_small"), &options).unwrap().bytes)
}

/// Every second one is about a subtask that the last thing belongs to as well.
fn queries(count: usize) -> Vec<OwnedTeamQuery> {
    let mut queries = random_team_queries(count, 9, 6, 3, 17);
    for query in queries.iter_mut().step_by(2) {
        let (agents, tasks) = (query.state.agents, &mut query.state.entity_task);
        if let Some(last) = tasks.get_mut(agents..).and_then(<[u32]>::last_mut) {
            *last |= 1 << query.task;
        }
    }
    queries
}

/// What a plan answers; the memory is not clean.
fn ask(plan: &AlignedBytes, query: &OwnedTeamQuery) -> Result<f32, AllocateError> {
    let plan = Plan::load(plan.as_slice()).unwrap();
    let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
    arena.as_mut_slice().fill(0xff);
    let mut rows = vec![f32::NAN; PlanTeamValue::memory_floats(&plan, query.state.entities())];
    let mut network = PlanTeamValue::new(plan, arena.as_mut_slice(), &mut rows).unwrap();
    let state = query.state.view();
    network.value(&query.view(&state))
}

#[test]
fn the_plan_agrees_with_the_graph() {
    let (onnx, plan) = (golden("team_value_small"), plan());
    let facts = inspect_plan(plan.as_slice()).unwrap();
    assert_eq!((facts.network, facts.features, facts.actions), (Network::TeamValue, 11, 1));
    assert_eq!(facts.contract, "0123456789abcdef");
    for plan in [&plan, &plan_of(Profile::Fused)] {
        let comparison = beside_truth(plan.as_slice(), &onnx, queries(150));
        assert!(comparison.agrees() && comparison.max_rel_error < 1e-6, "{comparison:?}");
        assert_eq!(comparison.inputs, 150);
    }
    let mut tract = GraphTeamValue::by_tract(&onnx).unwrap();
    assert_eq!(tract.columns(), (6, 3));
    for query in queries(60) {
        let state = query.state.view();
        let want = tract.value(&query.view(&state)).unwrap();
        let got = ask(&plan, &query).unwrap();
        assert!((got - want).abs() < 1e-5 * (1.0 + want.abs()), "{got}, want {want}");
    }
}

#[test]
fn what_is_absent_or_closed_never_matters() {
    let plan = plan();
    let mut changed = 0;
    for query in queries(100) {
        let state = query.state.view();
        let view = query.view(&state);
        let (visible, own) = (view.visible(), view.own_row());
        let value = ask(&plan, &query).unwrap();
        let mut other = query.clone();
        for row in (0..query.state.entities()).filter(|row| !visible.contains(*row)) {
            if own != Some(row) {
                other.state.rows[row * 6..][..6].fill(f32::NAN);
                other.relation[row * 3..][..3].fill(f32::INFINITY);
                changed += 1;
            }
        }
        assert_eq!(ask(&plan, &other).unwrap().to_bits(), value.to_bits());
    }
    assert!(changed > 50, "{changed}");
}

#[test]
fn strange_queries_are_refused_alike() {
    let plan = plan();
    let mut tract = GraphTeamValue::by_tract(&golden("team_value_small")).unwrap();
    let all = queries(40);
    let query = all.iter().find(|query| {
        let (state, own) = (&query.state, query.state.agents + query.task);
        state.present.contains(own) && state.agents > 0
    });
    let query = query.unwrap().clone();
    let mut refused = |change: &dyn Fn(&mut OwnedTeamQuery)| {
        let mut query = query.clone();
        change(&mut query);
        let state = query.state.view();
        let errors = [tract.value(&query.view(&state)), ask(&plan, &query)].map(Result::unwrap_err);
        assert_eq!(errors[0], errors[1]);
        errors[0]
    };
    let own = query.state.agents + query.task;
    let nan = refused(&|query| query.state.rows[own * 6] = f32::NAN);
    assert_eq!(nan, AllocateError::NonFinite);
    let nobody = refused(&|query| query.state.entity_task.fill(0));
    assert_eq!(nobody, AllocateError::BadLength);
    let short = refused(&|query| query.state.rows.truncate(own * 6 + 3));
    assert_eq!(short, AllocateError::BadLength);
    let narrow = refused(&|query| query.state.features = 5);
    assert_eq!(narrow, AllocateError::BadLength);
}

#[test]
fn agents_and_allocators_do_not_run_each_other() {
    let small = golden("agent_small");
    assert!(matches!(GraphTeamValue::by_tract(&small), Err(CompileError::OtherNetwork { .. })));
    let policy = GraphPolicy::by_tract(&golden("team_value_small"), 6).map(|_| ());
    assert!(matches!(policy, Err(CompileError::OtherNetwork { .. })));
    let agent = compile(&small, &CompileOptions::default()).unwrap().bytes;
    for (plan, is_agent) in [(AlignedBytes::copy_of(&agent), true), (plan(), false)] {
        let plan = Plan::load(plan.as_slice()).unwrap();
        let mut arena = AlignedBytes::zeroed(plan.arena_bytes());
        let mut memory = vec![0.0; PlanTeamValue::memory_floats(&plan, 1)];
        let value = PlanTeamValue::new(plan.clone(), arena.as_mut_slice(), &mut memory).map(drop);
        let act = PlanPolicy::new(plan, arena.as_mut_slice()).map(drop);
        let (right, wrong) = if is_agent { (act, value) } else { (value, act) };
        assert_eq!((right, wrong), (Ok(()), Err(PlanError::WrongNetwork)));
    }
}

#[test]
fn damaged_files_are_errors_never_panics() {
    let onnx = golden("team_value_small");
    for len in (0..onnx.len()).step_by(389) {
        assert!(compile(&onnx[..len], &CompileOptions::default()).is_err(), "cut at {len}");
    }
    for at in (0..onnx.len()).step_by(211) {
        let mut damaged = onnx.clone();
        damaged[at] ^= 0x55;
        // A changed weight compiles; whatever happens, it is an answer.
        let _ = compile(&damaged, &CompileOptions { inputs: 8, ..CompileOptions::default() });
    }
}
