//! Recorded episodes of the public code, replayed with the items that got lost.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use sortie_envs::crafting::Crafting;
use sortie_envs::milestones::{Game, MilestoneSet, Milestones, Rules, World};
use sortie_envs::treasure_rooms::TreasureRooms;
use sortie_envs::{EntitySet, Environment, Observation, Split};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/milestones")
}

fn numbers(value: &Value) -> Vec<usize> {
    value.as_array().unwrap().iter().map(|item| item.as_u64().unwrap() as usize).collect()
}

fn digit(letter: char) -> u8 {
    letter.to_digit(36).unwrap() as u8
}

/// The first grid of a recorded episode.
fn first<G: Game>(init: &Value) -> World {
    let mut world = World::new(G::SIZE);
    let rows = init["grid"].as_array().unwrap().iter().map(|row| row.as_str().unwrap());
    for (cell, object) in rows.flat_map(str::chars).map(digit).enumerate() {
        world.cells[cell] = object;
        let homes = [7, 8, 10, 12, 9];
        if let Some(home) = homes.iter().position(|kind| *kind == object) {
            // Crafting has objects of the same numbers, and no homes.
            world.homes[home] = if G::STATES.is_empty() { 0 } else { cell as u8 };
        }
    }
    let agent = numbers(&init["agent"]);
    (world.position, world.direction) = ((agent[1] * G::SIZE + agent[0]) as u8, agent[2] as u8);
    let inventory = numbers(&init["inventory"]);
    world.inventory.iter_mut().zip(inventory).for_each(|(count, found)| *count = found as u16);
    let cases = ["both", "red", "yellow"];
    let case = cases.iter().position(|case| init["start_key"] == *case);
    world.case = case.unwrap_or(0) as u8;
    world
}

/// Objects and states of the window as the recordings have them, read back from the features.
fn seen<G: Game>(grids: &Milestones<G>) -> (String, String) {
    let mut state = Vec::new();
    grids.save(0, &mut state);
    let mut seen = Observation::new(&grids.spec().shape);
    grids.observe(&state, 0, EntitySet::MAX, &mut seen);
    let (objects, channels) = (G::OBJECTS.len() - 2, G::OBJECTS.len() - 2 + G::STATES.len());
    let mut window = vec![['0', '.']; 121];
    let mut inventory = vec![0; G::ITEMS.len()];
    for (column, value) in seen.rows.row(0) {
        if column >= 121 * channels {
            inventory[column - 121 * channels] = value as u16;
            continue;
        }
        assert_eq!(value, 1.0);
        let letter = |number: usize| char::from_digit(number as u32, 36).unwrap();
        match (column / channels, column % channels) {
            (cell, channel) if channel < objects => window[cell][0] = letter(channel + 2),
            (cell, channel) => window[cell][1] = letter(channel - objects),
        }
    }
    assert_eq!(inventory, grids.world(0).inventory[..G::ITEMS.len()]);
    (window.iter().map(|cell| cell[0]).collect(), window.iter().map(|cell| cell[1]).collect())
}

fn bits(text: &Value) -> u32 {
    let bits = text.as_str().unwrap().chars().enumerate();
    bits.fold(0, |set, (place, bit)| set | u32::from(bit == '1') << place)
}

fn check_state<G: Game>(grids: &Milestones<G>, [objects, states, afforded]: [&Value; 3], at: &str) {
    let (window, window_states) = seen(grids);
    assert_eq!(window, objects.as_str().unwrap(), "{at}");
    if !G::STATES.is_empty() {
        assert_eq!(window_states, states.as_str().unwrap(), "{at}");
    }
    let mut state = Vec::new();
    grids.save(0, &mut state);
    assert_eq!(grids.affordances(&state), Some(bits(afforded)), "{at}");
}

fn replay<G: Game>(path: &Path) -> usize {
    let episode: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let names: Vec<&str> = episode["milestones"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap())
        .collect();
    let milestones = MilestoneSet::named::<G>(names.iter().copied()).unwrap();
    assert_eq!(milestones.names::<G>(), names);
    let dense = episode["dense"].as_bool().unwrap();
    let rules = Rules { dense, ..Rules::usual::<G>(milestones) };
    let mut grids = Milestones::<G>::new(rules, 1, Split::Test);
    let init = &episode["init"];
    grids.start(0, first::<G>(init));
    let parts = ["view_objects", "view_attr", "afforded_distinct"].map(|name| &init[name]);
    check_state(&grids, parts, "start");
    let steps = episode["steps"].as_array().unwrap();
    let mut fired_ever = BTreeSet::new();
    for (index, want) in steps.iter().enumerate() {
        let at = format!("{}, step {index}", path.display());
        let lost = want["lost"].as_str().map(|name| G::ITEMS.iter().position(|it| *it == name));
        let action = want["a"].as_u64().unwrap() as u16;
        let step = grids.step_losing(0, action, |_| lost.map(Option::unwrap)).unwrap();
        let world = grids.world(0);
        let place = [world.position as usize % G::SIZE, world.position as usize / G::SIZE];
        assert_eq!([&place[..], &[world.direction.into()]].concat(), numbers(&want["p"]), "{at}");
        let inventory: Vec<usize> =
            world.inventory[..G::ITEMS.len()].iter().map(|count| (*count).into()).collect();
        assert_eq!(inventory, numbers(&want["inv"]), "{at}");
        assert_eq!(step.reward.to_bits(), want["r"].as_f64().unwrap().to_bits(), "{at}");
        let fired = grids.milestone(0).map(|milestone| names[milestone]);
        assert_eq!(fired, want["ms"].as_str(), "{at}");
        fired_ever.extend(fired);
        let flags = ["imp", "ok", "to", "d"].map(|name| want[name].as_u64() == Some(1));
        let reached = grids.episode(0);
        let impossible = reached.cause == Some("impossible");
        // The public code counts what became impossible as a time-out.
        let timed_out = step.timed_out || impossible;
        assert_eq!([impossible, reached.solved, timed_out, step.done()], flags, "{at}");
        if let Some(carried) = want["carry"].as_str() {
            assert_eq!(G::OBJECTS[usize::from(world.carried)], carried, "{at}");
        } else {
            assert_eq!(world.carried, 0, "{at}");
        }
        check_state(&grids, ["vo", "va", "aff1"].map(|name| &want[name]), &at);
    }
    for (metric, value) in grids.spec().metrics.iter().zip(grids.episode(0).metrics).skip(1) {
        let name = &*metric.name;
        let is = names.contains(&name).then(|| fired_ever.contains(name));
        assert_eq!(value, is.map(|is| f64::from(u8::from(is))), "{}", metric.name);
    }
    let rows = episode["final"]["grid"].as_array().unwrap().iter();
    let cells: Vec<u8> = rows.flat_map(|row| row.as_str().unwrap().chars()).map(digit).collect();
    assert_eq!(grids.world(0).cells[..cells.len()], cells, "{}", path.display());
    steps.len()
}

fn files(kind: &str) -> Vec<PathBuf> {
    let files = fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path());
    let is_meant = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with(kind);
    files.filter(is_meant).collect()
}

#[test]
fn recorded_episodes_of_crafting_replay_without_a_difference() {
    let steps: usize = files("craft_").iter().map(|path| replay::<Crafting>(path)).sum();
    assert_eq!(steps, 730);
}

#[test]
fn recorded_episodes_of_the_rooms_replay_without_a_difference() {
    let steps: usize = files("treasure_").iter().map(|path| replay::<TreasureRooms>(path)).sum();
    assert_eq!(steps, 695);
}
