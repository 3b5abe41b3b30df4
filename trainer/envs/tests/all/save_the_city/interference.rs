//! What somebody outside changes in a city.

use sortie_envs::save_the_city::AgentKind::{Builder, Firefighter};
use sortie_envs::save_the_city::{AgentState, BuildingKind, Constants};

use super::rules::{BESIDE, BUILD, STAY, around, building, city_of, fast, first, step};

#[test]
fn agents_can_be_put_elsewhere_while_the_episode_goes_on() {
    let mut city = around(&[Builder, Firefighter], fast(0.5, 0.0));
    step(&mut city, &[BUILD, STAY]);
    let (earned, steps) = (city.metrics(0).episode_return, city.metrics(0).steps);
    city.place_agent(0, 0, (2, 2)).unwrap();
    let moved = city.city(0).agents[0];
    assert_eq!((moved.x, moved.y, moved.kind), (2, 2, Builder));
    assert_eq!(moved.available >> BUILD & 1, 0, "it is beside no building any more");
    assert_eq!((city.metrics(0).episode_return, city.metrics(0).steps), (earned, steps));
    assert!(earned > 0.0 && steps == 1 && !city.is_done(0));
    // The other agent's cell, the building's, none of the map, nobody's.
    for (agent, place) in [(0, BESIDE[1]), (0, (7, 7)), (0, (16, 2)), (2, (3, 3))] {
        assert!(city.place_agent(0, agent, place).is_err(), "{agent} {place:?}");
    }
    assert_eq!(city.city(0).agents[0], moved);
    city.place_agent(0, 0, (2, 2)).unwrap();
}

#[test]
fn buildings_can_be_set_on_fire_while_they_are_open() {
    let buildings = [fast(0.5, 0.0), building(BuildingKind::Slow, (11, 11), 1.0, 0.0)];
    let mut city = city_of(Constants::default(), &[AgentState::at(Builder, 2, 2)], &buildings);
    step(&mut city, &[STAY]);
    city.set_fire(0, 0).unwrap();
    let burning = first(&city);
    assert_eq!((burning.fire, burning.since_last_fire), (1.0, 0));
    assert_eq!(burning.to_next_fire, burning.period);
    for (building, why) in [(1, "is complete or burned down"), (2, "no such building")] {
        let refused = city.set_fire(0, building).unwrap_err().to_string();
        assert!(refused.contains(why), "{refused}");
    }
    assert_eq!(city.metrics(0).steps, 1);
}
