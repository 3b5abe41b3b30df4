//! Maps that are drawn: those of the reference, and our own by their seeds.

use std::collections::VecDeque;

use serde_json::Value;
use sortie_envs::gridworld::{Draw, Map, draw_map};
use sortie_envs::random::generator;
use sortie_envs::registry::Setting;

use super::{folder, opened, saved};

/// Numbers of a recorded map.
struct Recorded(VecDeque<Value>);

impl Recorded {
    fn next(&mut self) -> Value {
        self.0.pop_front().expect("the map takes no more numbers than were recorded")
    }
}

impl Draw for Recorded {
    fn below(&mut self, bound: usize) -> usize {
        let draw = self.next();
        assert_eq!(draw["n"].as_u64(), Some(bound as u64));
        draw["r"].as_u64().unwrap() as usize
    }

    fn unit(&mut self) -> f64 {
        self.next().as_f64().unwrap()
    }

    fn shuffle<T: Copy>(&mut self, list: &mut [T]) {
        let draw = self.next();
        let order = draw.as_array().unwrap();
        assert_eq!(order.len(), list.len());
        let old = list.to_vec();
        for (item, place) in list.iter_mut().zip(order) {
            *item = old[place.as_u64().unwrap() as usize];
        }
    }
}

#[test]
fn recorded_numbers_draw_the_recorded_maps() {
    let text = std::fs::read_to_string(folder().join("flip_maps.json")).unwrap();
    let maps: Value = serde_json::from_str(&text).unwrap();
    let maps = maps["maps"].as_array().unwrap();
    assert!(maps.len() >= 4);
    for map in maps {
        let agents = map["n_agents"].as_u64().unwrap() as usize;
        let draws = map["draws"].as_array().unwrap();
        let mut draws = Recorded(draws.iter().cloned().collect());
        let drawn = draw_map(agents, &mut draws);
        let want = map["map"].as_array().unwrap().iter().map(|row| row.as_str().unwrap());
        assert!(drawn.lines().eq(want), "{drawn}");
        assert!(draws.0.is_empty(), "{} numbers were not drawn", draws.0.len());
    }
}

#[test]
fn the_seed_of_a_map_makes_it() {
    let start = |set: &str, seed| {
        let mut world = opened(set, &[("map_seed", Setting::Whole(seed))]);
        world.reset(0, &mut generator(1));
        saved(&*world)
    };
    let mut starts = Vec::new();
    for set in ["flip-2", "flip-4"] {
        for seed in 1..6 {
            assert_eq!(start(set, seed), start(set, seed));
            starts.push(start(set, seed));
        }
    }
    starts.dedup();
    assert_eq!(starts.len(), 10);
}

#[test]
fn drawn_maps_have_eight_paths_of_like_length_and_doors_by_tiers() {
    for (agents, doors) in [(2, "$$%%&&"), (4, "$$$$")] {
        for seed in 0..4 {
            let text = draw_map(agents, &mut generator(seed));
            let map = Map::parse(&text, agents, 8).unwrap();
            assert_eq!((map.starts().len(), map.treasures()), (agents, 8));
            let mut found: Vec<char> = text.chars().filter(|it| "$%&'".contains(*it)).collect();
            found.sort_unstable();
            assert_eq!(found, doors.chars().collect::<Vec<_>>());
            assert!((10..60).contains(&map.pits().len()), "{}", map.pits().len());
        }
    }
}

#[test]
fn what_is_no_map_is_refused() {
    let good = draw_map(2, &mut generator(1));
    let refused = |text: &str| Map::parse(text, 2, 8).unwrap_err().to_string();
    assert_eq!(refused(&good[1..]), "a map has 20 rows of 20 characters");
    assert_eq!(refused(&good.replacen('#', " ", 1)), "a map has walls all around");
    assert_eq!(refused(&good.replace('1', " ")), "a map lacks the start of an agent");
    assert_eq!(refused(&good.replace('H', " ")), "a map lacks a treasure");
    assert_eq!(refused(&good.replace('H', "z")), "`z` means nothing");
}
