//! What is drawn of a state is what stands in it.

use sortie_envs::Environment;
use sortie_envs::particle::{
    Hand, Hoard, Mover, Navigated, Navigation, Particle, Picture, Roved, RoverTower, Stage, Tower,
    Treasure, TreasureCollection, picture_of,
};

use super::{opened, saved};

fn at(x: f64, y: f64) -> Mover {
    Mover { position: [x, y], velocity: [0.0; 2] }
}

fn picture(world: &dyn Environment) -> Picture {
    picture_of(world.spec(), &saved(world)).expect("a state")
}

#[test]
fn collectors_banks_and_treasures_are_told_apart() {
    let mut world = Particle::new(TreasureCollection::new(1, Default::default(), 100), 1);
    let mut hands = vec![Hand::default(); 3];
    // Taken in the last step: nobody sees it yet, but it is so.
    hands[1].now = Some(0);
    let treasure = |x, stage| Treasure { position: [x, 0.5], kind: 0, stage };
    let treasures =
        vec![treasure(0.1, Stage::Lies), treasure(0.2, Stage::Taken), treasure(0.3, Stage::New(0))];
    let movers = vec![at(0.0, 0.0), at(0.5, 0.0), at(-0.5, 0.0), at(0.0, -0.5)];
    world.start(0, Hoard { movers, hands, treasures, ..Hoard::default() });
    let Picture { agents, things } = picture(&world);
    assert_eq!(
        agents.iter().map(|agent| agent.takes).collect::<Vec<_>>(),
        [None, None, None, Some(0)]
    );
    let holds: Vec<_> = agents.iter().map(|agent| agent.holds).collect();
    assert_eq!(holds, [None, Some(0), None, None]);
    let radii: Vec<f64> = agents.iter().map(|agent| agent.disc.expect("a place").radius).collect();
    assert_eq!(radii, [0.05, 0.05, 0.05, 0.075]);
    assert_eq!(agents[3].disc.expect("a place").place, [0.0, -0.5]);
    let places = things.iter().map(|thing| thing.disc.map(|disc| disc.place));
    assert_eq!(places.collect::<Vec<_>>(), [Some([0.1, 0.5]), None, Some([0.3, 0.5])]);
    assert!(things.iter().all(|thing| thing.kind == Some(0)));
}

#[test]
fn rovers_and_towers_know_each_other() {
    let mut world = Particle::new(RoverTower::new(2, 25), 1);
    let towers =
        vec![Tower { rover: 1, goal: 4, said: Some(3) }, Tower { rover: 0, goal: 2, said: None }];
    let landmarks = (0..6).map(|place| [f64::from(place) / 10.0, 0.0]).collect();
    let movers = vec![at(0.1, 0.2), at(0.3, 0.4)];
    world.start(0, Roved { movers, landmarks, towers, near: 0 });
    let Picture { agents, things } = picture(&world);
    let partners: Vec<_> = agents.iter().map(|agent| agent.partner).collect();
    assert_eq!(partners, [Some(3), Some(2), Some(1), Some(0)]);
    let goals: Vec<_> = agents.iter().map(|agent| agent.goal).collect();
    assert_eq!(goals, [Some(2), Some(4), Some(4), Some(2)]);
    assert_eq!((agents[2].says, agents[3].says), (Some(3), None));
    assert!(agents[2].disc.is_none() && agents[1].disc.expect("a place").place == [0.3, 0.4]);
    assert_eq!(things[5].disc.expect("a place").place, [0.5, 0.0]);
    // Who belongs together is told to whoever measures attention.
    let mut companions = [0; 4];
    assert!(world.companions(&saved(&world), &mut companions));
    assert_eq!(companions, [0b1001, 0b0110, 0b0110, 0b1001]);
}

#[test]
fn agents_that_are_all_alike_have_places_alone() {
    let mut world = Particle::new(Navigation::new(2, 25), 1);
    let movers = vec![at(0.1, 0.2), at(0.3, 0.4)];
    let landmarks = vec![[0.5, 0.5], [-0.5, -0.5]];
    world.start(0, Navigated { movers, landmarks, collisions: 0, uncovered: 0.0 });
    let Picture { agents, things } = picture(&world);
    let places: Vec<_> = agents.iter().map(|agent| agent.disc.expect("a place").place).collect();
    assert_eq!(places, [[0.1, 0.2], [0.3, 0.4]]);
    assert_eq!(things[1].disc.expect("a place").place, [-0.5, -0.5]);
    assert!(!world.companions(&saved(&world), &mut [0; 2]));
}

#[test]
fn other_bytes_are_no_picture() {
    for set in ["treasure-8", "rover-tower-8", "navigation-3"] {
        let world = opened(set, &[]);
        let state = saved(&*world);
        assert_eq!(picture_of(world.spec(), &state).expect("a state").agents.len(), {
            world.spec().shape.agents
        });
        assert!(picture_of(world.spec(), &state[1..]).is_err(), "{set}");
    }
}
