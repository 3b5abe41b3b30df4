//! The rules look the same from every side of the square.

use sortie_envs::random::generator;
use sortie_envs::save_the_city::{
    AgentState, BuildingState, City, SaveTheCity, Symmetry, coordinated_allocation,
    heuristic_allocation, random_actions,
};
use sortie_envs::{EntitySet, Environment, Observation};

use super::environment;

fn turned(city: City<'_>, symmetry: Symmetry) -> (Vec<AgentState>, Vec<BuildingState>) {
    let agents = city.agents.iter().map(|agent| symmetry.agent(agent)).collect();
    (agents, city.buildings.iter().map(|building| symmetry.building(building)).collect())
}

fn allocations(city: City<'_>) -> [[u8; 8]; 2] {
    let mut allocations = [[0; 8]; 2];
    heuristic_allocation(city, &mut allocations[0]);
    coordinated_allocation(city, &mut allocations[1]);
    allocations
}

/// Steps both cities with corresponding actions and losers.
fn step_both(city: &mut SaveTheCity, mirror: &mut SaveTheCity, symmetry: Symmetry, seed: u64) {
    let mut actions = [0; 8];
    random_actions(city.city(0), &mut generator(seed), &mut actions);
    let outcome = city.step_with_losers(0, &actions, |first, _| first).unwrap();
    let turned = actions.map(|action| symmetry.action(action));
    assert_eq!(mirror.step_with_losers(0, &turned, |first, _| first), Ok(outcome));
}

#[test]
fn turned_cities_step_to_turned_cities() {
    for seed in 0..16 {
        let mut city = environment("2-8a_2-8b", seed);
        let mut mirror = city.clone();
        for symmetry in Symmetry::ALL {
            city.reset(0, &mut generator(seed));
            let (agents, buildings) = turned(city.city(0), symmetry);
            mirror.restore(0, &agents, &buildings, 0).unwrap();
            let (mut state, mut direct, mut rebuilt) =
                (Vec::new(), Observation::default(), Observation::default());
            let turn = Symmetry::ALL.iter().position(|known| *known == symmetry).unwrap();
            let mut step = 0;
            while !city.is_done(0) {
                let (agents, buildings) = turned(city.city(0), symmetry);
                let seen = mirror.city(0);
                assert_eq!(seen.agents, agents, "seed {seed}, {symmetry:?}, step {step}");
                assert_eq!(seen.buildings, buildings, "seed {seed}, {symmetry:?}, step {step}");
                assert_eq!(allocations(seen), allocations(city.city(0)), "seed {seed}");
                state.clear();
                mirror.save(0, &mut state);
                mirror.observe(&state, 0, EntitySet::MAX, &mut direct);
                state.clear();
                city.save(0, &mut state);
                city.observe(&state, turn, EntitySet::MAX, &mut rebuilt);
                assert_eq!(rebuilt, direct, "seed {seed}, {symmetry:?}, step {step}");
                step_both(&mut city, &mut mirror, symmetry, seed * 1000 + step);
                step += 1;
            }
        }
    }
}

#[test]
fn symmetries_are_undone_by_their_inverses() {
    for symmetry in Symmetry::ALL {
        for action in 0..12 {
            assert_eq!(symmetry.inverse().action(symmetry.action(action)), action);
        }
        for mask in 0..1 << 12 {
            assert_eq!(symmetry.inverse().available(symmetry.available(mask)), mask);
        }
        for (x, y) in (0..16).flat_map(|x| (0..16).map(move |y| (x, y))) {
            let (turned_x, turned_y) = symmetry.cell(x, y);
            assert_eq!(symmetry.inverse().cell(turned_x, turned_y), (x, y));
        }
    }
    let distinct = Symmetry::ALL.map(|symmetry| symmetry.cell(1, 3));
    assert!((1..8).all(|index| !distinct[..index].contains(&distinct[index])));
}
