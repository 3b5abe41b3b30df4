//! Recorded episodes: replayed, refused where malformed, and written.

use std::fs;

use serde_json::{Value, json};
use sortie_envs::Environment;
use sortie_envs::golden::{GoldenError, replay, replay_file};
use sortie_envs::random::generator;
use sortie_envs::save_the_city::golden::{Labels, Recorder};
use sortie_envs::save_the_city::{
    AgentKind, AgentState, AllocationRule, BuildingKind, BuildingPlan, BuildingState, City,
    SET_NAMES, Scenario, ScenarioSet, ScriptedTeam, Status, heuristic_allocation,
};
use sortie_envs::{DecisionPoints, UNASSIGNED};

use super::{environment, golden_folder};

/// An episode in which a building burns down on the eleventh step.
const SHORT: &str = "043-3a-BFG-random-end-on-burn.json";

fn read(name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(golden_folder().join(name)).unwrap()).unwrap()
}

#[test]
fn recorded_episodes_replay_without_a_difference() {
    let mut files = 0;
    for entry in fs::read_dir(golden_folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.file_name().unwrap().to_string_lossy().starts_with('0') {
            let result = replay_file(&path).unwrap();
            assert_eq!(result.mismatches.first(), None);
            assert!(result.steps > 0);
            files += 1;
        }
    }
    assert_eq!(files, 13);
}

#[test]
fn heuristic_allocation_equals_the_recorded_one() {
    let states = read("heuristic.json");
    for (index, state) in states["states"].as_array().unwrap().iter().enumerate() {
        let list = |name: &str| state[name].as_array().unwrap().clone();
        let agents = list("agents").iter().map(agent).collect::<Vec<_>>();
        let buildings = list("buildings").iter().map(building).collect::<Vec<_>>();
        let mut allocation = vec![UNASSIGNED; agents.len()];
        heuristic_allocation(City { agents: &agents, buildings: &buildings }, &mut allocation);
        let got = allocation.iter().map(|&task| task as i8).collect::<Vec<_>>();
        assert_eq!(json!(got), state["alloc"], "state {index}");
    }
}

fn agent(value: &Value) -> AgentState {
    let letter = value[0].as_str().unwrap().chars().next().unwrap();
    let kind = AgentKind::from_letter(letter).unwrap();
    AgentState::at(kind, value[1].as_u64().unwrap() as u8, value[2].as_u64().unwrap() as u8)
}

fn building(value: &Value) -> BuildingState {
    let health = value[2].as_f64().unwrap();
    BuildingState {
        health,
        fire: value[3].as_f64().unwrap(),
        period: 60,
        to_next_fire: 60,
        since_last_fire: 0,
        kind: BuildingKind::Fast,
        status: Status::of_health(health),
        x: value[0].as_u64().unwrap() as u8,
        y: value[1].as_u64().unwrap() as u8,
    }
}

#[test]
fn named_sets_equal_the_recorded_lists() {
    let sets = read("scenario-sets.json");
    assert_eq!(sets["sets"].as_object().unwrap().len(), SET_NAMES.len());
    for name in SET_NAMES {
        let (want, got) = (&sets["sets"][name], ScenarioSet::named(name).unwrap());
        assert_eq!(got.check(), Ok(()));
        assert_eq!(want["max_n_agents"], got.max_agents);
        assert_eq!(want["max_n_buildings"], got.max_buildings);
        assert_eq!(want["bld_spacing"], got.spacing);
        let listed = |list: &[Scenario]| list.iter().map(scenario_json).collect::<Value>();
        assert_eq!(want["train"], listed(&got.train), "{name}");
        let test = if want["test"].is_string() { &want["train"] } else { &want["test"] };
        assert_eq!(*test, listed(&got.test), "{name}");
    }
}

fn scenario_json(scenario: &Scenario) -> Value {
    let team: String = scenario.team.iter().map(|kind| kind.letter()).collect();
    match &scenario.buildings {
        BuildingPlan::Count(count) => json!([team, count]),
        BuildingPlan::Kinds(kinds) => {
            json!([team, kinds.iter().map(|kind| kind.letter()).collect::<String>()])
        }
    }
}

/// Sets the value at a JSON pointer of the short episode; `None` removes the field.
fn changed(pointer: &str, value: Option<Value>) -> String {
    let mut episode = read(SHORT);
    match value {
        Some(value) => *episode.pointer_mut(pointer).unwrap() = value,
        None => {
            let (parent, name) = pointer.rsplit_once('/').unwrap();
            episode.pointer_mut(parent).unwrap().as_object_mut().unwrap().remove(name).unwrap();
        }
    }
    episode.to_string()
}

#[test]
fn every_changed_value_is_found_where_it_is() {
    for (pointer, value, step, field) in [
        ("/frames/0/agents/2", json!(6), 0, "frames[0].agents[2]"),
        ("/frames/3/health/1", json!(0.2635888727036321), 3, "frames[3].health[1]"),
        ("/frames/4/fire/3", json!(1e-9), 4, "frames[4].fire[3]"),
        ("/frames/5/ttnf/0", json!(1), 5, "frames[5].ttnf[0]"),
        ("/frames/5/tslf/0", json!(1), 5, "frames[5].tslf[0]"),
        ("/frames/11/status/1", json!(0), 11, "frames[11].status[1]"),
        ("/frames/6/avail/0/3", json!(2), 6, "frames[6].avail[0][3]"),
        ("/frames/7/task_mask/5", json!(0), 7, "frames[7].task_mask[5]"),
        ("/frames/8/heur/0", json!(-1), 8, "frames[8].heur[0]"),
        ("/frames/9/feat_crc", json!(1), 9, "frames[9].feat_crc"),
        ("/frames/10/feat/0/2/0", json!(0.5), 10, "frames[10].feat"),
        ("/steps/2/reward", json!(-0.3125), 2, "steps[2].reward"),
        ("/steps/2/task_rewards/0", json!(0), 2, "steps[2].task_rewards[0]"),
        ("/steps/3/tasks_terminated/0", json!(1), 3, "steps[3].tasks_terminated[0]"),
        ("/steps/4/tasks_changed", json!(true), 4, "steps[4].tasks_changed"),
        ("/steps/10/done", json!(false), 10, "steps[10].done"),
        ("/steps/10/info/solved", json!(1), 10, "steps[10].info"),
        ("/static_masks/obs_mask/0/3", json!(0), 0, "static_masks.obs_mask[0][3]"),
        ("/static_masks/entity_mask/3", json!(0), 0, "static_masks.entity_mask[3]"),
        ("/events/burned", json!(2), 11, "events"),
    ] {
        let result = replay(SHORT, &changed(pointer, Some(value.clone()))).unwrap();
        assert_eq!(result.mismatches.len(), 1, "{pointer}");
        let mismatch = &result.mismatches[0];
        assert_eq!((mismatch.step, mismatch.field.as_str()), (step, field));
        assert_eq!(mismatch.file, SHORT);
        if !matches!(field, "events" | "frames[10].feat" | "steps[10].info") {
            assert_eq!(mismatch.want, value);
        }
        assert_ne!(mismatch.want, mismatch.got);
    }
}

/// The JSON pointers of all values inside a value.
fn pointers(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            members
                .iter()
                .for_each(|(name, value)| pointers(value, &format!("{at}/{name}"), found));
        }
        Value::Array(items) => {
            let items = items.iter().enumerate();
            items.for_each(|(index, value)| pointers(value, &format!("{at}/{index}"), found));
        }
        _ => {}
    }
    found.push(at.into());
}

#[test]
fn no_value_can_be_changed_unnoticed() {
    let free = ["/name", "/seed", "/policy", "/scenario_set", "/config"];
    let mut found = Vec::new();
    pointers(&read(SHORT), "", &mut found);
    for (index, pointer) in found.iter().enumerate() {
        let mut episode = read(SHORT);
        let value = episode.pointer_mut(pointer).unwrap();
        let others = [
            json!(3),
            json!(-1),
            json!(0.1),
            json!([]),
            json!({}),
            json!("F"),
            json!(null),
            json!(1e300),
        ];
        let other = others.into_iter().cycle().skip(index).find(|other| other != value).unwrap();
        *value = other.clone();
        let noticed = match replay(SHORT, &episode.to_string()) {
            Ok(result) => !result.mismatches.is_empty(),
            Err(_) => true,
        };
        let may_pass = free.iter().any(|name| pointer.starts_with(name));
        assert!(noticed || may_pass, "{pointer} = {other}");
    }
}

#[test]
fn an_unavailable_action_ends_the_replay_as_a_difference() {
    let result = replay(SHORT, &changed("/steps/4/actions/0", Some(json!(9)))).unwrap();
    assert_eq!(result.steps, 4);
    assert_eq!(result.mismatches.len(), 1);
    assert_eq!(result.mismatches[0].step, 4);
    assert_eq!(result.mismatches[0].field, "steps[4].actions[0]");
}

#[test]
fn another_action_gives_differences_in_the_order_of_the_episode() {
    let result = replay(SHORT, &changed("/steps/0/actions/2", Some(json!(0)))).unwrap();
    assert!(result.mismatches.len() > 1);
    assert!(result.mismatches.is_sorted_by_key(|mismatch| mismatch.step));
}

#[test]
fn malformed_files_are_refused_with_the_name_of_the_field() {
    for (pointer, value, field) in [
        ("/schema", Some(json!("sortie-golden/save-the-city/2")), "schema"),
        ("/schema", None, "schema"),
        ("/name", None, "name"),
        ("/config/max_n_agents", Some(json!(0)), "config.max_n_agents"),
        ("/config/max_n_buildings", Some(json!(1_000_000_000)), "config.max_n_buildings"),
        ("/config/game_config/fire_burn_rate", None, "config.game_config.fire_burn_rate"),
        ("/config/reward_config/solved", Some(json!("20")), "config.reward_config.solved"),
        ("/config/end_on_any_burn", Some(json!(1)), "config.end_on_any_burn"),
        ("/config/episode_limit", Some(json!(-1)), "config.episode_limit"),
        ("/initial/agents", Some(json!([])), "initial"),
        ("/initial/agents/1/type", Some(json!("X")), "initial.agents[1].type"),
        ("/initial/agents/1/x", Some(json!(16)), "initial.agents[1].x"),
        ("/initial/buildings/0/health", Some(json!(null)), "initial.buildings[0].health"),
        ("/initial/buildings/0/health", Some(json!(1.5)), "initial"),
        ("/initial/buildings/1/y", Some(json!(8)), "initial"),
        ("/initial/buildings/2/rate", Some(json!(0)), "initial"),
        ("/length", Some(json!(12)), "steps"),
        ("/frames", Some(json!([])), "frames"),
        ("/frames/2/health", Some(json!([1, 2])), "frames[2].health"),
        ("/frames/2/health", None, "frames[2].health"),
        ("/frames/2/health/0", Some(json!("0.5")), "frames[2].health[0]"),
        ("/frames/2/feat_crc", None, "frames[2].feat_crc"),
        ("/frames/10/feat", None, "frames[10].feat"),
        ("/frames/3", Some(json!(7)), "frames[3]"),
        ("/steps/1/actions", Some(json!([0, 0])), "steps[1].actions"),
        ("/steps/1/actions/2", Some(json!(12)), "steps[1].actions[2]"),
        ("/steps/1/actions/2", Some(json!(1.5)), "steps[1].actions[2]"),
        ("/steps/1/bounces", Some(json!([[0, 1]])), "steps[1].bounces[0]"),
        ("/steps/1/bounces", Some(json!([[0, 1, 2]])), "steps[1].bounces[0]"),
        ("/steps/1/bounces", Some(json!([[0, 3, 3]])), "steps[1].bounces[0][1]"),
        ("/steps/1/reward", None, "steps[1].reward"),
        ("/steps/1/done", Some(json!(0)), "steps[1].done"),
        ("/steps/10/info", None, "steps[10].info"),
        ("/static_masks/entity_mask", Some(json!([])), "static_masks.entity_mask"),
        ("/events", None, "events"),
    ] {
        let text = changed(pointer, value);
        match replay(SHORT, &text) {
            Err(GoldenError::Field { field: named, reason }) => {
                assert_eq!(named, field, "{pointer}: {reason}");
            }
            other => panic!("{pointer}: {other:?}"),
        }
    }
}

#[test]
fn what_is_no_episode_is_refused() {
    assert!(matches!(replay("x", "{"), Err(GoldenError::Json(_))));
    assert!(matches!(replay("x", "[]"), Err(GoldenError::Field { .. })));
    let missing = golden_folder().join("missing.json");
    assert!(matches!(replay_file(&missing), Err(GoldenError::Read(_))));
}

#[test]
fn recorded_files_replay_without_a_difference() {
    for (seed, set) in SET_NAMES.into_iter().enumerate() {
        let mut city = environment(set, seed as u64);
        let labels = Labels { name: set.into(), policy: "scripted".into(), seed: seed as u64 };
        let mut recorder = Recorder::new(&city, 0, labels);
        let (rng, mut random) = (generator(seed as u64), generator(7));
        let mut team = ScriptedTeam::new(AllocationRule::Random, DecisionPoints::default(), rng);
        let mut actions = [0; 64];
        let mut tasks_changed = false;
        while !city.is_done(0) {
            team.act(city.city(0), tasks_changed, &mut actions);
            let outcome = city.step(0, &actions, &mut random).unwrap();
            recorder.record(&city, &actions, &outcome);
            tasks_changed = outcome.tasks_changed;
        }
        let text = recorder.finish(&city);
        let result = replay(set, &text).unwrap();
        assert_eq!(result.mismatches.first(), None, "set {set}, seed {seed}");
        assert_eq!(result.steps as u32, city.metrics(0).steps);
    }
}
