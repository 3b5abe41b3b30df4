//! Recorded episodes: replayed, and refused where malformed.

use std::fs;
use std::path::PathBuf;

use serde_json::{Value, json};
use sortie_envs::Environment;
use sortie_envs::golden::{GoldenError, replay, replay_file};
use sortie_envs::group_matching::{GroupMatching, Parameters, walk};

/// An episode in which a group gathers, parts and gathers again.
const SHORT: &str = "078-5x6x2-noisy-gather.json";

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/group-matching")
}

fn files() -> Vec<PathBuf> {
    let entries = fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path());
    entries.filter(|path| path.extension().is_some_and(|end| end == "json")).collect()
}

fn read(path: &std::path::Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn recorded_episodes_replay_without_a_difference() {
    let files = files();
    assert_eq!(files.len(), 24);
    for path in files {
        let result = replay_file(&path).unwrap();
        assert_eq!(result.mismatches.first(), None);
        assert!(result.steps > 0);
    }
}

/// The bytes of the recorded state: no step and no return, then cells and groups.
fn state(parameters: &Parameters, groups: &Value, cells: &Value) -> Vec<u8> {
    let mut bytes = vec![1];
    bytes.extend([0; 12]);
    bytes.extend(cells.as_array().unwrap().iter().map(|cell| cell.as_u64().unwrap() as u8));
    for group in groups.as_array().unwrap() {
        let mut members = 0_u128;
        group.as_array().unwrap().iter().for_each(|it| members |= 1 << it.as_u64().unwrap());
        bytes.extend(&members.to_le_bytes()[..parameters.agents.div_ceil(8)]);
    }
    bytes
}

#[test]
fn the_walking_team_repeats_the_recorded_one() {
    let mut compared = 0;
    for path in files() {
        let episode = read(&path);
        if episode["policy"] != "gather" {
            continue;
        }
        let size = |name: &str| episode["config"][name].as_u64().unwrap() as usize;
        let parameters = Parameters {
            agents: size("n_agents"),
            cells: size("n_states"),
            groups: size("n_groups"),
            ..Parameters::default()
        };
        let mut world = GroupMatching::new(parameters, 1).unwrap();
        let mut actions = vec![u16::MAX; parameters.agents];
        let frames = episode["frames"].as_array().unwrap();
        for (frame, step) in frames.iter().zip(episode["steps"].as_array().unwrap()) {
            let state = state(&parameters, &episode["initial"]["groups"], &frame["loc"]);
            world.load(0, &state).unwrap();
            walk(&parameters, world.ring(0), &mut actions);
            assert_eq!(json!(actions), step["actions"], "{}", path.display());
            compared += 1;
        }
    }
    assert!(compared > 20, "{compared}");
}

/// Sets the value at a JSON pointer of the short episode.
fn changed(pointer: &str, value: &Value) -> String {
    let mut episode = read(&folder().join(SHORT));
    *episode.pointer_mut(pointer).unwrap() = value.clone();
    episode.to_string()
}

#[test]
fn every_changed_value_is_found_where_it_is() {
    for (pointer, value, step, field) in [
        ("/static_masks/gt_mask/0/2", json!(0), 0, "static_masks.gt_mask[0][2]"),
        ("/static_masks/obs_mask/1/0", json!(1), 0, "static_masks.obs_mask[1][0]"),
        ("/static_masks/entity_mask/4", json!(1), 0, "static_masks.entity_mask[4]"),
        ("/initial_features/0/6", json!(0), 0, "initial_features[0][6]"),
        ("/frames/0/feat_crc", json!(1), 0, "frames[0].feat_crc"),
        ("/frames/2/loc/3", json!(1), 2, "frames[2].loc[3]"),
        ("/frames/4/matches", json!(1), 4, "frames[4].matches"),
        ("/steps/1/reward", json!(2.4000000000000004), 1, "steps[1].reward"),
        ("/steps/2/done", json!(true), 2, "steps[2].done"),
        ("/steps/3/info/solved", json!(false), 3, "steps[3].info"),
    ] {
        let result = replay(SHORT, &changed(pointer, &value)).unwrap();
        assert_eq!(result.mismatches.len(), 1, "{pointer}: {:?}", result.mismatches);
        let mismatch = &result.mismatches[0];
        assert_eq!((mismatch.step, mismatch.field.as_str()), (step, field));
    }
}

#[test]
fn a_step_that_says_the_limit_was_reached_is_a_difference_where_it_was_not() {
    let result = replay(SHORT, &changed("/config/episode_limit", &json!(4))).unwrap();
    assert_eq!(result.mismatches.len(), 1);
    assert_eq!(result.mismatches[0].field, "steps[3].info");
    let result = replay(SHORT, &changed("/config/episode_limit", &json!(3))).unwrap();
    assert_eq!(result.steps, 3);
    assert_eq!(result.mismatches.last().unwrap().field, "steps[3]");
}

#[test]
fn malformed_files_are_refused_with_the_name_of_the_field() {
    for (pointer, value, field) in [
        ("/schema", json!("sortie-golden/group-matching/2"), "schema"),
        ("/config/n_agents", json!(0), "config.n_agents"),
        ("/config/n_states", json!(257), "config.n_states"),
        ("/config/rand_trans", json!("little"), "config.rand_trans"),
        ("/initial/loc/0", json!(6), "initial.loc[0]"),
        ("/initial/groups/0/0", json!(5), "initial.groups[0][0]"),
        ("/initial/groups/0", json!([]), "initial"),
        ("/length", json!(5), "steps"),
        ("/steps/0/executed", json!([0]), "steps[0].executed"),
        ("/steps/0/actions/1", json!(3), "steps[0].actions[1]"),
    ] {
        match replay(SHORT, &changed(pointer, &value)) {
            Err(GoldenError::Field { field: named, .. }) => assert_eq!(named, field),
            other => panic!("{pointer}: {other:?}"),
        }
    }
}
