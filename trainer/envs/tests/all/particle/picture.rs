//! What is drawn of a state is what stands in it.

use sortie_envs::particle::{
    Hand, Hoard, Mover, Navigated, Navigation, Particle, Roved, RoverTower, Stage, Tower, Treasure,
    TreasureCollection,
};
use sortie_envs::{Environment, Picture};

use super::saved;

fn at(x: f64, y: f64) -> Mover {
    Mover { position: [x, y], velocity: [0.0; 2] }
}

fn picture(world: &dyn Environment) -> Picture {
    world.picture(&saved(world))
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
    let Picture { agents, things, .. } = picture(&world);
    let kinds: Vec<_> = agents.iter().map(|agent| agent.kind).collect();
    assert_eq!(kinds, ["collector", "collector", "collector", "bank"]);
    let told: Vec<_> =
        agents.iter().map(|agent| [&agent.status[..], &agent.about].concat()).collect();
    assert_eq!(told, ["holds nothing", "holds a", "holds nothing", "takes a"]);
    let labels: Vec<_> = agents.iter().map(|agent| &agent.label[..]).collect();
    assert_eq!(labels, ["", "1a", "", "3A"]);
    let radii: Vec<f64> = agents.iter().map(|agent| agent.radius.expect("a radius")).collect();
    assert_eq!(radii, [0.05, 0.05, 0.05, 0.075]);
    assert_eq!(agents[3].place, Some([0.0, -0.5]));
    let places = things.iter().map(|thing| thing.place);
    assert_eq!(places.collect::<Vec<_>>(), [Some([0.1, 0.5]), None, Some([0.3, 0.5])]);
    // A treasure has the colour of whoever holds it, and of its bank.
    assert!(things.iter().chain([&agents[1], &agents[3]]).all(|disc| disc.colour == Some(0)));
}

#[test]
fn rovers_and_towers_know_each_other() {
    let mut world = Particle::new(RoverTower::new(2, 25), 1);
    let towers =
        vec![Tower { rover: 1, goal: 4, said: Some(3) }, Tower { rover: 0, goal: 2, said: None }];
    let landmarks = (0..6).map(|place| [f64::from(place) / 10.0, 0.0]).collect();
    let movers = vec![at(0.1, 0.2), at(0.9, 0.4)];
    world.start(0, Roved { movers, landmarks, towers, near: 0 });
    let Picture { agents, things, links, .. } = picture(&world);
    let told: Vec<_> = agents.iter().map(|agent| &agent.about[..]).collect();
    let [first, second] = ["led by 3 to C; heard nothing", "led by 2 to E; heard 3"];
    assert_eq!(told, [first, second, "leads 1 to E; said 3", "leads 0 to C; said nothing"]);
    assert_eq!((&agents[0].status[..], &agents[1].status[..]), ("near C", "away from E"));
    let linked: Vec<_> = links.iter().map(|link| (link.name, link.from, link.to)).collect();
    let of_first = [("pair", 0, 3), ("goal", 0, 6), ("goal", 3, 6)];
    assert_eq!(linked, [of_first, [("pair", 1, 2), ("goal", 1, 8), ("goal", 2, 8)]].concat());
    assert!(agents[2].place.is_none() && agents[1].place == Some([0.9, 0.4]));
    assert_eq!(things[5].place, Some([0.5, 0.0]));
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
    let Picture { agents, things, links, .. } = picture(&world);
    let places: Vec<_> = agents.iter().map(|agent| agent.place).collect();
    assert_eq!(places, [Some([0.1, 0.2]), Some([0.3, 0.4])]);
    assert_eq!((things[1].place, &things[1].name[..]), (Some([-0.5, -0.5]), "B"));
    assert!(links.is_empty() && !world.companions(&saved(&world), &mut [0; 2]));
}
