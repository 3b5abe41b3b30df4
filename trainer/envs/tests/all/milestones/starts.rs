//! Starts against what 3,000 of the public code were like.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use serde_json::Value;
use sortie_envs::crafting::Crafting;
use sortie_envs::milestones::{Game, World};
use sortie_envs::random::generator;
use sortie_envs::treasure_rooms::TreasureRooms;

const DRAWN: usize = 3_000;

fn statistics(game: &str) -> Value {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/milestones");
    let text = fs::read_to_string(folder.join("generator_stats.json")).unwrap();
    serde_json::from_str::<Value>(&text).unwrap()[game].clone()
}

fn drawn<G: Game>() -> Vec<World> {
    let mut random = generator(1);
    (0..DRAWN).map(|_| G::draw(&mut random)).collect()
}

/// Refuses counts that two samples of one distribution differ by in less than one of some 10,000 cases: two-sample
/// chi-square against its normal approximation (Wilson and Hilferty 1931).
fn assert_alike(found: &BTreeMap<String, u64>, recorded: &Value) {
    let recorded = recorded.as_object().unwrap();
    let unknown = found.keys().find(|key| !recorded.contains_key(*key));
    assert_eq!(unknown, None);
    let pairs = recorded.iter().map(|(key, count)| {
        (found.get(key).copied().unwrap_or(0) as f64, count.as_u64().unwrap() as f64)
    });
    let square: f64 = pairs.map(|(one, other)| (one - other).powi(2) / (one + other)).sum();
    let free = recorded.len() as f64 - 1.0;
    let scale = 2.0 / (9.0 * free);
    let normal = ((square / free).cbrt() - (1.0 - scale)) / scale.sqrt();
    assert!(normal < 3.7, "chi-square {square} with {free} degrees of freedom");
}

fn count(found: impl Iterator<Item = String>) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    found.for_each(|key| *counts.entry(key).or_default() += 1);
    counts
}

#[test]
fn maps_of_crafting_have_the_recorded_objects() {
    let (worlds, recorded) = (drawn::<Crafting>(), statistics("crafting"));
    for (object, name) in Crafting::OBJECTS.iter().enumerate() {
        let of =
            |world: &World| world.cells.iter().filter(|it| usize::from(**it) == object).count();
        let mean = worlds.iter().map(of).sum::<usize>() as f64 / DRAWN as f64;
        let want = ["mean", "sd"].map(|kind| recorded[kind][*name].as_f64().unwrap());
        let error = want[1] * (2.0 / DRAWN as f64).sqrt();
        assert!((mean - want[0]).abs() <= 4.0 * error, "{name}: {mean}, {} recorded", want[0]);
    }
    let column = |world: &World| world.cells.iter().position(|it| *it == 8).unwrap() % 12;
    let columns = count(worlds.iter().map(|world| column(world).to_string()));
    assert_alike(&columns, &recorded["diamond_column"]);
    assert!(worlds.iter().all(|world| world.cells[usize::from(world.position)] == 0));
}

#[test]
fn rooms_have_the_recorded_doors_keys_and_agents() {
    let (worlds, recorded) = (drawn::<TreasureRooms>(), statistics("treasure"));
    let cases = ["both", "red", "yellow"];
    let case = |world: &World| cases[usize::from(world.case)].to_owned();
    let at = |cell: usize| format!("{},{}", cell % 11, cell / 11);
    assert_alike(&count(worlds.iter().map(case)), &recorded["start_key"]);
    let agents = worlds.iter().map(|world| at(world.position.into()));
    assert_alike(&count(agents), &recorded["agent_cell"]);
    let of = |world: &World, kinds: &[u8]| -> Vec<(&str, usize)> {
        let cells = world.cells.iter().enumerate().filter(|(_, object)| kinds.contains(object));
        cells.map(|(cell, object)| (TreasureRooms::OBJECTS[usize::from(*object)], cell)).collect()
    };
    let doors = worlds
        .iter()
        .flat_map(|world| of(world, &[3, 4, 5, 6]))
        .map(|(door, cell)| format!("{}@{}", door.trim_end_matches("_door"), at(cell)));
    assert_alike(&count(doors), &recorded["door_position"]);
    let keys = worlds.iter().flat_map(|world| {
        let case = case(world);
        of(world, &[7, 8]).into_iter().map(move |(key, cell)| format!("{case}:{key}@{}", at(cell)))
    });
    assert_alike(&count(keys), &recorded["key_cell"]);
}
