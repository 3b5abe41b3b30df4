//! Situations by hand: what the recorded episodes do not show, or do not show alone.

use sortie_envs::particle::{
    DeadTreasures, Hand, Hoard, Mover, Navigated, Navigation, Particle, RoverTower, Scenario,
    Stage, Treasure, TreasureCollection,
};
use sortie_envs::random::generator;
use sortie_envs::registry::Setting;
use sortie_envs::{EntitySet, Environment, Observation, StepError};

use super::{opened, saved};

fn at(x: f64, y: f64) -> Mover {
    Mover { position: [x, y], velocity: [0.0; 2] }
}

fn treasure(x: f64, y: f64) -> Treasure {
    Treasure { position: [x, y], ..Treasure::default() }
}

/// Three collectors at the left, at x = 0, 1 and 2, and a bank far off; treasures at the top.
fn hoard() -> Hoard {
    Hoard {
        movers: vec![at(-0.5, 0.0), at(-0.5, 0.3), at(-0.5, 0.6), at(0.9, -0.9)],
        hands: vec![Hand::default(); 3],
        treasures: vec![treasure(-0.9, 0.9), treasure(0.0, 0.9), treasure(0.9, 0.9)],
        ..Hoard::default()
    }
}

fn hunt(world: Hoard, dead: DeadTreasures) -> Particle<TreasureCollection> {
    let mut hunt = Particle::new(TreasureCollection::new(1, dead, 100), 1);
    hunt.start(0, world);
    hunt
}

/// Steps where everybody drifts, and says what they earn.
fn drift<S: Scenario>(world: &mut Particle<S>) -> Vec<f64> {
    let actions = vec![0; world.spec().shape.agents];
    world.step(0, &actions, &mut generator(1)).unwrap();
    world.agent_rewards(0).to_vec()
}

fn row(world: &dyn Environment, agent: usize) -> Vec<f32> {
    let mut seen = Observation::new(&world.spec().shape);
    world.observe(&saved(world), 0, 1 << agent, &mut seen);
    assert_eq!(seen.entities, 1 << agent);
    let mut dense = vec![0.0; world.spec().shape.features];
    seen.rows.write_dense(0, &mut dense);
    dense
}

#[test]
fn agents_see_themselves_alone_and_may_do_everything() {
    for set in ["treasure-8", "rover-tower-8", "navigation-3"] {
        let mut world = opened(set, &[]);
        world.reset(0, &mut generator(1));
        let mut seen = Observation::new(&world.spec().shape);
        world.observe(&saved(&*world), 0, EntitySet::MAX, &mut seen);
        let alone = seen.observable.iter().enumerate().all(|(agent, set)| *set == 1 << agent);
        assert!(alone && seen.available.iter().all(|actions| *actions == 0b11111), "{set}");
    }
}

#[test]
fn steps_that_cannot_be_taken_leave_the_world_as_it_was() {
    let mut world = opened("navigation-3", &[]);
    world.reset(0, &mut generator(1));
    let before = saved(&*world);
    let refused = world.step(0, &[0, 5, 0], &mut generator(1));
    assert_eq!(refused, Err(StepError::Unavailable { agent: 1, action: 5 }));
    let refused = world.step(0, &[0, 0], &mut generator(1));
    assert_eq!(refused, Err(StepError::TooFewActions { agents: 3, actions: 2 }));
    assert_eq!(saved(&*world), before);
}

#[test]
fn episodes_end_by_their_time_alone() {
    let mut world = opened("rover-tower-8", &[]);
    world.reset(0, &mut generator(1));
    for steps in 1..=25 {
        let step = world.step(0, &[0; 8], &mut generator(1)).unwrap();
        assert_eq!((step.timed_out, step.terminated), (steps == 25, false));
        let episode = world.episode(0);
        assert_eq!((episode.done, episode.timed_out), (steps == 25, steps == 25));
        assert_eq!(episode.group, "4+4");
    }
    assert_eq!(world.step(0, &[0; 8], &mut generator(1)), Err(StepError::EpisodeOver));
}

#[test]
fn a_contact_pushes_the_lighter_one_more_and_the_same_place_pushes_nobody() {
    let mut world = hoard();
    (world.movers[0], world.movers[3]) = (at(0.0, 0.0), at(0.1, 0.0));
    let mut hunt = hunt(world, DeadTreasures::Far);
    drift(&mut hunt);
    let [collector, bank] = [0, 3].map(|agent| hunt.world(0).movers[agent].velocity);
    // 100 times the depth of 0.025, times the other's mass over the own twice, for a tenth of a time unit.
    assert!((collector[0] + 0.25 * 2.25).abs() < 1e-9 && collector[1] == 0.0, "{collector:?}");
    assert!((bank[0] - 0.25 / 2.25 / 2.25).abs() < 1e-9 && bank[1] == 0.0, "{bank:?}");

    let mut pile = Particle::new(Navigation::new(2, 25), 1);
    let movers = vec![at(0.2, 0.1); 2];
    let landmarks = vec![[0.2, 0.1], [0.2, 0.5]];
    pile.start(0, Navigated { movers: movers.clone(), landmarks, collisions: 0, uncovered: 0.0 });
    let rewards = drift(&mut pile);
    assert_eq!(pile.world(0).movers, movers);
    assert!(rewards.iter().all(|reward| (reward + 0.4 + 2.0).abs() < 1e-12), "{rewards:?}");
    assert_eq!(pile.episode(0).metrics[1], Some(1.0), "the collision with oneself is none");
}

#[test]
fn nobody_gets_faster_than_allowed() {
    let mut world = hoard();
    (world.movers[0], world.movers[3]) = (at(0.0, 0.0), at(0.01, 0.0));
    let mut hunt = hunt(world, DeadTreasures::Far);
    drift(&mut hunt);
    let [x, y] = hunt.world(0).movers[0].velocity;
    assert!((x.hypot(y) - 1.0).abs() < 1e-12, "{x} {y}");
}

#[test]
fn what_two_find_counts_twice_and_one_takes() {
    let mut world = hoard();
    (world.movers[0], world.movers[1]) = (at(0.0, 0.84), at(0.0, 0.96));
    let mut hunt = hunt(world, DeadTreasures::Far);
    let rewards = drift(&mut hunt);
    let own = [0.06, 0.06, 0.5, 0.0].map(|way| 10.0 - 0.1 * way);
    for agent in 0..2 {
        assert!((rewards[agent] - own[agent]).abs() < 1e-9, "{rewards:?}");
    }
    let hands = &hunt.world(0).hands;
    assert_eq!([hands[0].now, hands[1].now], [Some(0), None]);
    assert_eq!(hunt.world(0).treasures[1].stage, Stage::Taken);
    assert_eq!(hunt.episode(0).metrics, [Some(1.0), Some(0.0), Some(0.0)]);

    // What is held and taken is seen one step later, when another treasure has followed.
    assert_eq!(row(&hunt, 0)[4], 0.0);
    drift(&mut hunt);
    assert_eq!(row(&hunt, 0)[4], 1.0);
    assert_eq!(hunt.world(0).treasures[1].stage, Stage::New(0));
    assert!(hunt.world(0).treasures[1].is_alive());
}

#[test]
fn what_is_taken_at_the_bank_is_brought_at_once_and_earns_nothing() {
    let mut world = hoard();
    (world.movers[0], world.movers[3]) = (at(0.0, 0.85), at(0.0, 0.728));
    world.movers[0].velocity = [0.0, -0.1];
    let mut hunt = hunt(world, DeadTreasures::Far);
    let rewards = drift(&mut hunt);
    assert!((4.9..5.0).contains(&rewards[0]), "one treasure is found, none brought: {rewards:?}");
    assert_eq!(hunt.world(0).hands[0].now, None);
    assert_eq!(hunt.episode(0).metrics[..2], [Some(1.0), Some(1.0)]);
}

#[test]
fn dead_treasures_are_far_away_or_zeros() {
    let mut world = hoard();
    world.movers[0] = at(0.0, 0.84);
    let [far, zeros] = [DeadTreasures::Far, DeadTreasures::Zeros].map(|dead| {
        let mut hunt = hunt(world.clone(), dead);
        drift(&mut hunt);
        assert!(row(&hunt, 1).iter().all(|value| value.abs() < 2.0), "it is seen one step later");
        drift(&mut hunt);
        [row(&hunt, 1), row(&hunt, 3)]
    });
    for (far, (zeros, last)) in far.iter().zip(zeros.iter().zip([32, 31])) {
        let (dead, rest) = (last - 3..last, ..last - 3);
        assert_eq!(far[rest], zeros[rest]);
        assert!(far[dead.clone()].iter().take(2).all(|way| *way < -990.0), "{far:?}");
        assert_eq!((far[last - 1], &zeros[dead]), (1.0, &[0.0; 3][..]));
    }
}

#[test]
fn the_setting_says_which() {
    let farthest = |settings: &[(&str, Setting)]| {
        let (mut world, mut random) = (opened("treasure-4", settings), generator(4));
        world.reset(0, &mut random);
        let (mut actions, mut farthest) = ([0; 4], 0.0_f32);
        while !world.episode(0).done {
            world.scripted(&saved(&*world), &[], &mut random, &mut actions);
            world.step(0, &actions, &mut random).unwrap();
            farthest = row(&*world, 0).iter().fold(farthest, |most, seen| most.max(seen.abs()));
        }
        farthest
    };
    assert!(farthest(&[]) < 4.0);
    assert!(farthest(&[("dead_treasures", Setting::Text("far".into()))]) > 990.0);
    assert!(farthest(&[("dead_treasures", Setting::Text("zeros".into()))]) < 4.0);
}

#[test]
fn what_is_equally_near_is_seen_in_the_order_of_its_numbers() {
    let scenario = TreasureCollection::new(2, DeadTreasures::Far, 100);
    let mut world = scenario.world();
    world.treasures[1].kind = 1;
    world.treasures[3].kind = 1;
    let mut hunt = Particle::new(scenario, 1);
    hunt.start(0, world);
    let kinds: Vec<f32> = row(&hunt, 0)[6 + 7 * 8..].chunks(4).map(|seen| seen[3]).collect();
    assert_eq!(kinds, [0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
}

#[test]
fn messages_are_seen_in_the_step_that_they_are_said_in() {
    let mut world = Particle::new(RoverTower::new(2, 25), 1);
    world.reset(0, &mut generator(3));
    let towers = world.world(0).towers.clone();
    assert_eq!(row(&world, 0)[2..7], [0.0; 5]);
    world.step(0, &[0, 0, 2, 4], &mut generator(1)).unwrap();
    for (tower, message) in towers.iter().zip([2, 4]) {
        let mut said = [0.0; 5];
        said[message] = 1.0;
        assert_eq!(row(&world, tower.rover.into())[2..7], said);
    }
}

#[test]
fn potentials_tell_how_far_everybody_has_to_go() {
    let mut world = hoard();
    world.hands[1].now = Some(0);
    world.hands[2].now = Some(0);
    world.movers[0] = at(-0.9, 0.6);
    world.movers[2] = at(0.9, -0.5);
    let hunt = |world: Hoard| {
        let hunt = hunt(world, DeadTreasures::Far);
        let state = saved(&hunt);
        move |team| hunt.potential(&state, 10.0, team, None)
    };
    let potential = hunt(world.clone());
    let near = |got: f32, want: f32| assert!((got - want).abs() < 1e-5, "{got} {want}");
    near(potential(0b1), -3.0);
    near(potential(0b10), -10.0 * 1.4_f32.hypot(1.2));
    near(potential(0b1000), -4.0);
    near(potential(0b1001), -7.0);
    world.hands[2].now = None;
    near(hunt(world.clone())(0b1000), -10.0);
    // The treasure beside is dead, all others are far away, and nobody holds anything any more.
    world.hands.fill(Hand::default());
    world.treasures[0].stage = Stage::Taken;
    world.treasures[1].position = [8.0, 8.0];
    world.treasures[2].position = [8.0, 8.0];
    let potential = hunt(world);
    near(potential(0b1), -20.0);
    near(potential(0b1000), -10.0);
    let mut rover = opened("rover-tower-8", &[]);
    rover.reset(0, &mut generator(1));
    near(rover.potential(&saved(&*rover), 10.0, 0b1, None), 0.0);
}
