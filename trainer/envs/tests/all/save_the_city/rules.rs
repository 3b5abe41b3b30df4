//! One test for each consequence that the rule book names.

use sortie_envs::random::generator;
use sortie_envs::save_the_city::AgentKind::{Builder, Firefighter, Generalist};
use sortie_envs::save_the_city::{
    AgentKind, AgentState, BuildingKind, BuildingPlan, BuildingState, Constants, SaveTheCity,
    Scenario, ScenarioSet, Status, availability_codes,
};
use sortie_envs::{Environment, Step, StepError};

pub(crate) const STAY: u16 = 0;
const NORTH: u16 = 1;
const EAST: u16 = 2;
const WEST: u16 = 4;
const FIGHT: u16 = 9;
pub(crate) const BUILD: u16 = 10;
const FREEZE: u16 = 11;

/// Cells around the building at (7, 7).
pub(crate) const BESIDE: [(u8, u8); 4] = [(7, 8), (8, 7), (7, 6), (6, 7)];

pub(crate) fn building(
    kind: BuildingKind,
    (x, y): (u8, u8),
    health: f64,
    fire: f64,
) -> BuildingState {
    let period = kind.periods().1;
    BuildingState {
        health,
        fire,
        period,
        to_next_fire: period,
        since_last_fire: 0,
        kind,
        status: Status::of_health(health),
        x,
        y,
    }
}

pub(crate) fn fast(health: f64, fire: f64) -> BuildingState {
    building(BuildingKind::Fast, (7, 7), health, fire)
}

/// A city in exactly this state, for a set of at most 5 agents and 6 buildings.
pub(crate) fn city_of(
    constants: Constants,
    agents: &[AgentState],
    buildings: &[BuildingState],
) -> SaveTheCity {
    let mut city =
        SaveTheCity::new(ScenarioSet::named("2-5a_2-5b").unwrap(), constants, 1, 1).unwrap();
    city.restore(0, agents, buildings, 0).unwrap();
    city
}

/// Agents of these kinds around the building at (7, 7).
pub(crate) fn around(team: &[AgentKind], building: BuildingState) -> SaveTheCity {
    let place = |(&kind, (x, y)): (&AgentKind, (u8, u8))| AgentState::at(kind, x, y);
    let agents = team.iter().zip(BESIDE).map(place).collect::<Vec<_>>();
    city_of(Constants::default(), &agents, &[building])
}

pub(crate) fn first(city: &SaveTheCity) -> BuildingState {
    city.city(0).buildings[0]
}

pub(crate) fn step(city: &mut SaveTheCity, actions: &[u16]) -> Step {
    city.step(0, actions, &mut generator(1)).unwrap()
}

/// Steps until the fire is out, everybody fighting.
fn steps_to_extinguish(team: &[AgentKind]) -> usize {
    let mut city = around(team, fast(0.99, 1.0));
    let mut steps = 0;
    while first(&city).fire > 0.0 {
        step(&mut city, &[FIGHT; 4]);
        steps += 1;
    }
    steps
}

#[test]
fn teams_extinguish_a_full_fire_in_the_known_number_of_steps() {
    assert_eq!(steps_to_extinguish(&[Firefighter]), 4);
    assert_eq!(steps_to_extinguish(&[Firefighter, Builder]), 4);
    assert_eq!(steps_to_extinguish(&[Firefighter, Firefighter]), 2);
    assert_eq!(steps_to_extinguish(&[Firefighter, Builder, Generalist]), 3);
    assert_eq!(steps_to_extinguish(&[Builder, Generalist]), 8);
}

#[test]
fn a_single_builder_needs_81_steps_which_no_period_allows() {
    // A slow building survives that long, and a period of 200 keeps the fire from being restarted.
    let patient = BuildingState {
        period: 200,
        to_next_fire: 200,
        ..building(BuildingKind::Slow, (7, 7), 0.99, 1.0)
    };
    let mut city = around(&[Builder], patient);
    let mut steps = 0;
    while first(&city).fire > 0.0 {
        step(&mut city, &[FIGHT]);
        steps += 1;
    }
    assert_eq!(steps, 81);
    assert!(BuildingKind::ALL.iter().all(|kind| kind.periods().1 < 81));
}

#[test]
fn teams_build_at_the_known_rates() {
    for (team, rate) in [
        (&[Builder][..], 0.125),
        (&[Firefighter], 0.00625),
        (&[Firefighter, Generalist], 0.0625),
        (&[Firefighter, Builder, Generalist], 0.1875),
        (&[Builder, Generalist], 0.125),
        (&[Generalist], 0.0),
    ] {
        let mut city = around(team, fast(0.5, 0.0));
        step(&mut city, &[BUILD; 4]);
        assert!((first(&city).health - (0.5 + rate)).abs() < 1e-12, "{team:?}");
    }
}

#[test]
fn an_unattended_full_fire_takes_the_known_health() {
    for (kind, loss) in [(BuildingKind::Fast, 0.035), (BuildingKind::Slow, 0.0175)] {
        let mut city = around(&[Builder], building(kind, (7, 7), 0.5, 1.0));
        step(&mut city, &[STAY]);
        assert_eq!(first(&city).health, 0.5 - loss);
        assert_eq!(first(&city).fire, 1.0);
    }
}

#[test]
fn a_fire_that_is_fought_does_not_grow() {
    let mut city = around(&[Builder], fast(0.5, 0.5));
    step(&mut city, &[FIGHT]);
    assert_eq!(first(&city).fire, 0.5 - 0.05 * 0.25);
}

#[test]
fn a_generalist_alone_fights_in_vain() {
    let mut city = around(&[Generalist], fast(0.5, 0.5));
    step(&mut city, &[FIGHT]);
    assert_eq!(first(&city).fire, 1.1 * 0.5);
}

#[test]
fn the_bonus_is_given_once_whatever_the_number_of_agents() {
    let mut city = around(&[Builder, Generalist, Generalist], fast(0.5, 1.0));
    step(&mut city, &[FIGHT; 3]);
    assert_eq!(first(&city).fire, 1.0 - (0.05 * 0.25 + 0.45 * 0.25));
}

#[test]
fn a_generalist_does_not_help_firefighters_at_a_fire() {
    let mut city = around(&[Firefighter, Generalist], fast(0.5, 1.0));
    step(&mut city, &[FIGHT; 2]);
    assert_eq!(first(&city).fire, 0.75);
}

#[test]
fn freezing_blocks_damage_for_one_step_and_helps_nobody() {
    let mut city = around(&[Generalist, Builder], fast(0.5, 0.5));
    step(&mut city, &[FREEZE, FIGHT]);
    assert_eq!(first(&city).health, 0.5);
    assert_eq!(first(&city).fire, 0.5 - 0.05 * 0.25);
    step(&mut city, &[STAY, STAY]);
    assert!(first(&city).health < 0.5);
}

#[test]
fn a_frozen_fire_still_grows() {
    let mut city = around(&[Generalist], fast(0.5, 0.5));
    step(&mut city, &[FREEZE]);
    assert_eq!((first(&city).health, first(&city).fire), (0.5, 1.1 * 0.5));
}

#[test]
fn a_fire_put_out_does_no_damage_in_its_last_step() {
    let mut city = around(&[Firefighter], fast(0.5, 0.25));
    let outcome = step(&mut city, &[FIGHT]);
    assert_eq!((first(&city).health, first(&city).fire), (0.5, 0.0));
    assert_eq!(outcome.reward, 0.5 * 20.0 / 56.0);
}

#[test]
fn a_building_ignited_at_the_end_of_a_step_is_damaged_in_the_next() {
    let mut house = fast(0.5, 0.0);
    (house.to_next_fire, house.since_last_fire) = (1, 79);
    let mut city = around(&[Builder], house);
    step(&mut city, &[STAY]);
    let ignited = first(&city);
    assert_eq!((ignited.health, ignited.fire), (0.5, 1.0));
    assert_eq!((ignited.to_next_fire, ignited.since_last_fire), (80, 0));
    step(&mut city, &[STAY]);
    assert_eq!(first(&city).health, 0.5 - 0.035);
}

#[test]
fn the_clock_sets_a_weak_fire_to_full() {
    let mut house = fast(0.5, 0.01);
    house.to_next_fire = 1;
    let mut city = around(&[Builder], house);
    step(&mut city, &[STAY]);
    assert_eq!(first(&city).fire, 1.0);
}

#[test]
fn a_burned_building_has_no_fire_and_counts_as_lost_not_extinguished() {
    let mut city = around(&[Firefighter], fast(0.01, 1.0));
    let outcome = step(&mut city, &[STAY]);
    let lost = first(&city);
    assert_eq!((lost.status, lost.fire, lost.to_next_fire), (Status::BurnedDown, 0.0, 1000));
    assert!(outcome.terminated && !outcome.timed_out && outcome.tasks_changed);
    let metrics = city.metrics(0);
    assert_eq!((metrics.fires_extinguished, metrics.buildings_burned), (0, 1));
    assert!(!metrics.solved && !metrics.none_burned());
    let task_reward = (10.0 * -0.01 - 20.0) * 20.0 / 56.0;
    assert_eq!(city.task_rewards(0)[0], task_reward);
    assert_eq!(outcome.reward, task_reward);
}

#[test]
fn completing_is_worth_more_to_the_task_than_to_the_team() {
    let other = building(BuildingKind::Slow, (13, 13), 0.5, 0.0);
    let agents = [AgentState::at(Builder, 7, 8)];
    let mut city = city_of(Constants::default(), &agents, &[fast(0.9375, 0.0), other]);
    let outcome = step(&mut city, &[BUILD]);
    assert_eq!(outcome.reward, (10.0 * 0.0625 + 1.0) * 20.0 / 56.0);
    assert_eq!(city.task_rewards(0)[..3], [(10.0 * 0.0625 + 20.0) * 20.0 / 56.0, 0.0, 0.0]);
    assert!(!outcome.done() && outcome.tasks_changed);
    assert_eq!(city.open_tasks(0), 0b10);
}

#[test]
fn solving_everything_gives_the_team_its_bonus() {
    let mut city = around(&[Builder], fast(0.9375, 0.0));
    let outcome = step(&mut city, &[BUILD]);
    assert_eq!(outcome.reward, (10.0 * 0.0625 + 1.0 + 20.0) * 20.0 / 56.0);
    assert!(outcome.terminated && city.metrics(0).solved);
    assert_eq!(city.step(0, &[STAY], &mut generator(1)), Err(StepError::EpisodeOver));
}

#[test]
fn resolving_the_last_building_on_the_last_step_is_no_timeout() {
    let constants = Constants { episode_limit: 1, ..Constants::default() };
    let agents = [AgentState::at(Builder, 7, 8)];
    let mut city = city_of(constants, &agents, &[fast(0.9375, 0.0)]);
    let outcome = step(&mut city, &[BUILD]);
    assert!(outcome.terminated && !outcome.timed_out);
    let mut city = city_of(constants, &agents, &[fast(0.5, 0.0)]);
    let outcome = step(&mut city, &[BUILD]);
    assert!(!outcome.terminated && outcome.timed_out && city.metrics(0).timed_out);
    assert!(!city.metrics(0).solved && city.metrics(0).none_burned());
}

#[test]
fn the_first_burned_building_ends_the_episode_where_asked() {
    let constants = Constants { end_on_any_burn: true, ..Constants::default() };
    let other = building(BuildingKind::Slow, (13, 13), 0.5, 0.0);
    let agents = [AgentState::at(Builder, 7, 8)];
    let mut city = city_of(constants, &agents, &[fast(0.01, 1.0), other]);
    let outcome = step(&mut city, &[STAY]);
    assert!(outcome.terminated);
}

#[test]
fn the_step_penalty_counts_once_for_the_team_and_for_every_task() {
    let constants = Constants { ts_pen: -0.7, ..Constants::default() };
    let other = building(BuildingKind::Slow, (13, 13), 0.5, 0.0);
    let agents = [AgentState::at(Builder, 7, 8)];
    let mut city = city_of(constants, &agents, &[fast(0.5, 0.0), other]);
    let outcome = step(&mut city, &[STAY]);
    let penalty = -0.7 * 20.0 / 56.0;
    assert_eq!(outcome.reward, penalty);
    assert_eq!(city.task_rewards(0), [penalty, penalty, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn a_generalist_jumps_over_what_is_between() {
    let agents = [AgentState::at(Generalist, 7, 8), AgentState::at(Builder, 8, 8)];
    let mut city = city_of(Constants::default(), &agents, &[fast(0.5, 0.0)]);
    // North and west are free; two to the east lies beyond the builder, two to the south beyond
    // the building.
    let codes = availability_codes(&city.city(0).agents[0]);
    assert_eq!(codes, [1, 1, 0, 0, 1, 1, 1, 1, 1, 0, 2, 0]);
    step(&mut city, &[7, STAY]);
    assert_eq!((city.city(0).agents[0].x, city.city(0).agents[0].y), (7, 6));
}

#[test]
fn walls_and_corners_leave_only_the_moves_that_stay_on_the_map() {
    let agents = [AgentState::at(Generalist, 0, 0), AgentState::at(Firefighter, 15, 15)];
    let city = city_of(Constants::default(), &agents, &[fast(0.5, 0.0)]);
    assert_eq!(availability_codes(&city.city(0).agents[0])[..9], [1, 1, 1, 0, 0, 1, 1, 0, 0]);
    assert_eq!(availability_codes(&city.city(0).agents[1])[..9], [1, 0, 0, 1, 1, 0, 0, 0, 0]);
}

#[test]
fn an_unavailable_action_is_refused_and_changes_nothing() {
    let mut city = around(&[Firefighter, Generalist], fast(0.5, 1.0));
    let before = city.city(0).agents.to_vec();
    for action in [BUILD, FREEZE, 5, 12, u16::MAX] {
        let refusal = StepError::Unavailable { agent: 0, action };
        assert_eq!(city.step(0, &[action, NORTH], &mut generator(1)), Err(refusal));
    }
    let refusal = StepError::TooFewActions { agents: 2, actions: 1 };
    assert_eq!(city.step(0, &[FIGHT], &mut generator(1)), Err(refusal));
    assert_eq!(city.city(0).agents, before);
    assert_eq!(city.metrics(0).steps, 0);
}

#[test]
fn the_loser_of_a_collision_goes_back() {
    let agents = [AgentState::at(Firefighter, 2, 2), AgentState::at(Builder, 4, 2)];
    for loser in [0, 1] {
        let mut city = city_of(Constants::default(), &agents, &[fast(0.5, 0.0)]);
        city.step_with_losers(0, &[EAST, WEST], |_, _| loser).unwrap();
        let places = city.city(0).agents.iter().map(|agent| agent.x).collect::<Vec<_>>();
        assert_eq!(places, if loser == 0 { [2, 3] } else { [3, 4] });
        assert_eq!(usize::from(city.bounces(0)[0].loser), loser);
    }
}

#[test]
fn either_agent_of_a_collision_loses_half_of_the_time() {
    let agents = [AgentState::at(Firefighter, 2, 2), AgentState::at(Builder, 4, 2)];
    let mut city = city_of(Constants::default(), &agents, &[fast(0.5, 0.0)]);
    let (mut first_loses, mut random) = (0, generator(1));
    for _ in 0..4000 {
        city.restore(0, &agents, &[fast(0.5, 0.0)], 0).unwrap();
        city.step(0, &[EAST, WEST], &mut random).unwrap();
        first_loses += u32::from(city.bounces(0)[0].loser == 0);
    }
    assert!((1850..2150).contains(&first_loses), "{first_loses} of 4000");
}

#[test]
fn kinds_at_work_are_averaged_over_buildings_and_steps() {
    let mut city = around(&[Firefighter, Builder, Generalist], fast(0.9, 1.0));
    assert_eq!(city.metrics(0).types_per_firefight(), None);
    step(&mut city, &[FIGHT, FIGHT, FIGHT]);
    step(&mut city, &[FIGHT, STAY, FREEZE]);
    step(&mut city, &[STAY, STAY, STAY]);
    assert_eq!(city.metrics(0).types_per_firefight(), Some(2.0));
    assert_eq!(city.metrics(0).types_per_build(), None);
}

#[test]
fn states_that_break_the_rules_are_refused() {
    let mut city = around(&[Builder], fast(0.5, 0.0));
    let builder = AgentState::at(Builder, 1, 1);
    for (agents, buildings) in [
        (vec![], vec![fast(0.5, 0.0)]),
        (vec![builder; 6], vec![fast(0.5, 0.0)]),
        (vec![builder, builder], vec![fast(0.5, 0.0)]),
        (vec![AgentState::at(Builder, 7, 7)], vec![fast(0.5, 0.0)]),
        (vec![AgentState::at(Builder, 16, 7)], vec![fast(0.5, 0.0)]),
        (vec![builder], vec![]),
        (vec![builder], vec![fast(f64::NAN, 0.0)]),
        (vec![builder], vec![fast(0.5, 1.5)]),
        (vec![builder], vec![fast(1.0, 0.5)]),
        (vec![builder], vec![fast(0.5, 0.0), building(BuildingKind::Slow, (9, 9), 0.5, 0.0)]),
    ] {
        assert!(city.restore(0, &agents, &buildings, 0).is_err(), "{agents:?} {buildings:?}");
    }
    assert_eq!(first(&city).health, 0.5);
}

#[test]
fn impossible_sets_are_refused() {
    let good = ScenarioSet::named("2-5a_2-5b").unwrap();
    let with = |change: fn(&mut ScenarioSet)| {
        let mut set = good.clone();
        change(&mut set);
        SaveTheCity::new(set, Constants::default(), 1, 1).is_err()
    };
    assert!(with(|set| set.spacing = 2));
    assert!(with(|set| set.max_agents = 4));
    assert!(with(|set| set.max_agents = 65));
    assert!(with(|set| set.max_buildings = 5));
    assert!(with(|set| set.train.clear()));
    assert!(with(|set| set.spacing = 15));
    assert!(with(|set| {
        set.train = vec![Scenario { team: vec![], buildings: BuildingPlan::Count(3) }];
    }));
    let unknown = ScenarioSet::named("2-5a").unwrap_err().to_string();
    assert!(unknown.contains("`2-5a`") && unknown.contains("`2-5a_2-5b`"), "{unknown}");
}
