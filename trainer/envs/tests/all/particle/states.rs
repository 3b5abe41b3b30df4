//! States as bytes, and starts as they are drawn.

use sortie_envs::particle::{Hoard, Navigation, Particle, Roved, RoverTower, TreasureCollection};
use sortie_envs::random::generator;
use sortie_envs::{Environment, StateError};

use super::{opened, saved};

#[test]
fn bytes_that_hold_no_state_are_refused_and_change_nothing() {
    let mut world = opened("rover-tower-4", &[]);
    world.reset(0, &mut generator(1));
    let good = saved(&*world);
    // The towers are behind the head.
    let towers = 13;
    let with = |at: usize, bytes: &[u8]| {
        let mut state = good.clone();
        state[at..at + bytes.len()].copy_from_slice(bytes);
        state
    };
    let length = |found| StateError::Length { found, wanted: good.len() };
    let impossible = |flaw: &str| StateError::Impossible(flaw.into());
    let other = good[towers];
    for (state, want) in [
        (Vec::new(), length(0)),
        (good[..9].to_vec(), length(9)),
        ([&*good, &[0]].concat(), length(good.len() + 1)),
        (with(0, &[2]), StateError::Version { found: 2, wanted: 1 }),
        (with(1, &26_u32.to_le_bytes()), impossible("it is 26 steps long")),
        (with(5, &f64::NAN.to_le_bytes()), impossible("one of its numbers is none")),
        (with(39, &f64::INFINITY.to_le_bytes()), impossible("one of its numbers is none")),
        (with(towers, &[2]), impossible("a tower leads rover 2")),
        (with(towers + 3, &[other]), impossible("two towers lead the same rover")),
        (with(towers + 1, &[6]), impossible("a goal is landmark 6")),
        (with(towers + 2, &[5]), impossible("a tower says 5")),
    ] {
        assert_eq!(world.load(0, &state), Err(want));
        assert_eq!(saved(&*world), good);
    }

    let mut hunt = opened("treasure-4", &[]);
    hunt.reset(0, &mut generator(1));
    let good = saved(&*hunt);
    let hands = 13 + 4 * 32;
    for (at, byte, flaw) in [
        (hands, 1, "a collector holds kind 1"),
        (hands + 1, 1, "a collector holds kind 1"),
        (hands + 6 + 16, 1, "a treasure is of kind 1"),
        (hands + 6 + 17, 3, "a treasure is in stage 3"),
        (hands + 6 + 18, 1, "a treasure was of kind 1"),
    ] {
        let mut state = good.clone();
        state[at] = byte;
        assert_eq!(hunt.load(0, &state), Err(StateError::Impossible(flaw.into())));
    }
}

#[test]
fn states_are_compact() {
    for (set, most) in [("treasure-8", 410), ("rover-tower-8", 260), ("navigation-3", 180)] {
        assert!(opened(set, &[]).spec().state_bytes < most, "{set}");
    }
}

/// Says whether the values cover the range from `-half` to `half` evenly, as far as mean and extremes show it.
fn assert_spread(values: &[f64], half: f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let most = values.iter().copied().fold(0.0, |most: f64, value| most.max(value.abs()));
    assert!(mean.abs() < 0.03 && most <= half && most > 0.999 * half, "{mean} {most}");
}

#[test]
fn starts_are_drawn_from_all_that_are_possible() {
    let mut random = generator(5);
    let mut hunt = Particle::new(TreasureCollection::new(2, Default::default(), 100), 1);
    let mut rove = Particle::new(RoverTower::new(4, 25), 1);
    let mut cover = Particle::new(Navigation::new(3, 25), 1);
    let [mut agents, mut treasures, mut landmarks] = [const { Vec::new() }; 3];
    let (mut kinds, mut goals, mut leads) = ([0; 2], [0; 6], [[0; 4]; 4]);
    for _ in 0..1000 {
        hunt.reset(0, &mut random);
        let Hoard { movers, treasures: found, hands, .. } = hunt.world(0);
        agents.extend(movers.iter().flat_map(|mover| mover.position));
        assert!(movers.iter().all(|mover| mover.velocity == [0.0; 2]));
        assert!(hands.iter().all(|hand| hand.now.is_none() && hand.seen.is_none()));
        treasures.extend(found.iter().flat_map(|treasure| treasure.position));
        found.iter().for_each(|treasure| kinds[usize::from(treasure.kind)] += 1);
        rove.reset(0, &mut random);
        let Roved { movers, landmarks: six, towers, near } = rove.world(0);
        agents.extend(movers.iter().flat_map(|mover| mover.position));
        landmarks.extend(six.iter().flatten());
        assert_eq!(*near, 0);
        for (tower, lead) in towers.iter().zip(&mut leads) {
            goals[usize::from(tower.goal)] += 1;
            lead[usize::from(tower.rover)] += 1;
            assert_eq!(tower.said, None);
        }
        cover.reset(0, &mut random);
        landmarks.extend(cover.world(0).landmarks.iter().flatten());
    }
    assert_spread(&agents, 1.0);
    assert_spread(&landmarks, 1.0);
    assert_spread(&treasures, 0.95);
    assert!(kinds.iter().all(|count| (2800..3200).contains(count)), "{kinds:?}");
    assert!(goals.iter().all(|count| (570..770).contains(count)), "{goals:?}");
    assert!(leads.iter().flatten().all(|count| (190..310).contains(count)), "{leads:?}");
}

#[test]
fn a_start_depends_on_nothing_but_the_generator() {
    for set in ["treasure-8", "rover-tower-8", "navigation-3"] {
        let (mut fresh, mut used) = (opened(set, &[]), opened(set, &[]));
        used.reset(0, &mut generator(1));
        let actions = vec![1; used.spec().shape.agents];
        used.step(0, &actions, &mut generator(2)).unwrap();
        for world in [&mut fresh, &mut used] {
            world.reset(0, &mut generator(3));
        }
        assert_eq!(saved(&*fresh), saved(&*used), "{set}");
    }
}
