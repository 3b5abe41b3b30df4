//! How episodes start, over many of them.

use std::collections::BTreeMap;

use sortie_envs::random::generator;
use sortie_envs::save_the_city::{BuildingKind, SaveTheCity, ScenarioSet};
use sortie_envs::{Environment, Split};

use super::{environment, letters};

const EPISODES: usize = 13_000;

fn for_resets(set: &str, episodes: usize, mut visit: impl FnMut(&SaveTheCity)) {
    let mut city = environment(set, 17);
    let mut random = generator(18);
    for _ in 0..episodes {
        city.reset(0, &mut random);
        visit(&city);
    }
}

/// Whether a count fits its expectation within about five standard deviations.
fn fits(count: usize, of: usize, probability: f64) -> bool {
    let expected = of as f64 * probability;
    let deviation = (expected * (1.0 - probability)).sqrt();
    (count as f64 - expected).abs() < 5.0 * deviation
}

#[test]
fn every_team_is_equally_likely() {
    let mut teams = BTreeMap::new();
    for_resets("2-5a_2-5b", EPISODES, |city| *teams.entry(letters(city.city(0))).or_insert(0) += 1);
    assert_eq!(teams.len(), 13);
    for (team, count) in teams {
        assert!(fits(count, EPISODES, 1.0 / 13.0), "{team}: {count}");
    }
}

#[test]
fn buildings_are_drawn_as_the_rules_say() {
    let (mut all, mut fast, mut burning, mut low) = (0, 0, 0, 0);
    let mut health = 0.0;
    let mut periods = BTreeMap::new();
    let mut sites = BTreeMap::new();
    for_resets("2-5a_2-5b", EPISODES, |city| {
        assert_eq!(city.city(0).buildings.len(), city.city(0).agents.len() + 1);
        for building in city.city(0).buildings {
            all += 1;
            fast += usize::from(building.kind == BuildingKind::Fast);
            burning += usize::from(building.fire == 1.0);
            assert!(building.fire == 0.0 || building.fire == 1.0);
            let is_low = (0.25..=0.4).contains(&building.health);
            assert!(is_low || (0.6..=0.75).contains(&building.health));
            low += usize::from(is_low);
            health += building.health;
            assert_eq!(building.to_next_fire, building.period);
            *periods.entry(building.period).or_insert(0) += 1;
            *sites.entry((building.x, building.y)).or_insert(0) += 1;
        }
    });
    assert!(fits(fast, all, 0.5) && fits(burning, all, 0.4) && fits(low, all, 0.5));
    assert!((health / all as f64 - 0.5).abs() < 0.005);
    assert_eq!(
        periods.keys().copied().collect::<Vec<_>>(),
        (10..=30).chain(60..=80).collect::<Vec<_>>()
    );
    assert!(periods.values().all(|&count| fits(count, all, 1.0 / 42.0)), "{periods:?}");
    assert_eq!(sites.len(), 25);
    assert!(sites.values().all(|&count| fits(count, all, 1.0 / 25.0)), "{sites:?}");
    assert!(sites.keys().all(|(x, y)| x % 3 == 1 && y % 3 == 1));
}

/// The cells that agents of teams of one size start on.
fn start_cells(set: &str, agents: usize) -> Vec<(u8, u8)> {
    let mut cells = BTreeMap::new();
    for_resets(set, 3000, |city| {
        if city.city(0).agents.len() == agents {
            for agent in city.city(0).agents {
                *cells.entry((agent.x, agent.y)).or_insert(0) += 1;
            }
        }
    });
    cells.into_keys().collect()
}

fn square(low: u8, high: u8, without: &[(u8, u8)]) -> Vec<(u8, u8)> {
    let cells = (low..=high).flat_map(|x| (low..=high).map(move |y| (x, y)));
    cells.filter(|cell| !without.contains(cell)).collect()
}

#[test]
fn agents_start_in_the_smallest_centred_square_off_the_sites() {
    assert_eq!(start_cells("2-5a_2-5b", 2), [(7, 8), (8, 7), (8, 8)]);
    assert_eq!(start_cells("2-5a_2-5b", 5), square(6, 9, &[(7, 7)]));
    let six = square(5, 10, &[(7, 7), (7, 10), (10, 7), (10, 10)]);
    assert_eq!(start_cells("24a_24b", 24), six);
    assert_eq!(start_cells("2-8a_2-8b_sim_Q1", 7), square(6, 9, &[(8, 8)]));
}

#[test]
fn given_building_kinds_are_kept() {
    let city = environment("single_scen", 1);
    let kinds: String = city.city(0).buildings.iter().map(|it| it.kind.letter()).collect();
    assert_eq!((letters(city.city(0)).as_str(), kinds.as_str()), ("FFFBBBGG", "FFFFSSSS"));
}

#[test]
fn scenarios_are_chosen_by_index_by_size_and_by_list() {
    let mut city = environment("2-8a_2-8b_sim_Q1", 1);
    let mut random = generator(2);
    let set = ScenarioSet::named("2-8a_2-8b_sim_Q1").unwrap();
    let team = |scenario: &sortie_envs::save_the_city::Scenario| {
        scenario.team.iter().map(|kind| kind.letter()).collect::<String>()
    };
    city.reset_to(0, 3, &mut random).unwrap();
    assert_eq!((letters(city.city(0)), city.scenario(0)), (team(&set.train[3]), 3));
    assert!(city.reset_to(0, 12, &mut random).is_err());
    city.use_split(Split::Test);
    city.reset_to(0, 3, &mut random).unwrap();
    assert_eq!(letters(city.city(0)), team(&set.test[3]));
    for _ in 0..20 {
        city.reset_with_tasks(0, 6, &mut random).unwrap();
        assert_eq!(city.city(0).buildings.len(), 6);
    }
    assert!(city.reset_with_tasks(0, 2, &mut random).is_err());
}

#[test]
fn a_union_of_sets_has_the_scenarios_of_both_and_the_larger_sizes() {
    let [small, large] = ["2-5a_2-5b", "12a_12b"].map(|name| ScenarioSet::named(name).unwrap());
    let union = ScenarioSet::named("2-5a_2-5b+12a_12b").unwrap();
    union.check().unwrap();
    assert_eq!(union.name, "2-5a_2-5b+12a_12b");
    assert_eq!((union.max_agents, union.max_buildings), (12, 13));
    assert_eq!(union.train.len(), small.train.len() + large.train.len());
    assert_eq!(union.test[..13], small.test);
    assert!(ScenarioSet::named("2-5a_2-5b+single_scen").is_err(), "sites differ");
    assert!(ScenarioSet::named("2-5a_2-5b+nothing").is_err());
}
