//! Episodes of the reference, replayed from their first states.

use sortie_envs::particle::{
    DeadTreasures, Hand, Hoard, Mover, Navigated, Navigation, Particle, Roved, RoverTower,
    Scenario, Stage, Tower, Treasure, TreasureCollection,
};
use sortie_envs::random::generator;
use sortie_envs::{EntitySet, Environment, Observation, Step};

use super::recorded::{Episode, episodes};
use super::saved;

/// Most that places and speeds differ.
const MOTION: f64 = 1e-7;
/// Most that rewards and what agents see differ.
const TOLD: f64 = 1e-6;

fn assert_near(what: &str, got: impl IntoIterator<Item = f64>, want: &[f64], tolerance: f64) {
    let got: Vec<f64> = got.into_iter().collect();
    assert_eq!(got.len(), want.len(), "{what}");
    for (index, (got, want)) in got.iter().zip(want).enumerate() {
        assert!((got - want).abs() < tolerance, "{what}[{index}]: {got} against {want}");
    }
}

fn assert_moved(episode: &Episode, row: usize, movers: &[Mover]) {
    let label = format!("{} state {row}", episode.name);
    for (agent, (got, want)) in movers.iter().zip(episode.movers(row, movers.len())).enumerate() {
        let (got, want) = ([got.position, got.velocity], [want.position, want.velocity]);
        let label = format!("{label}, agent {agent}");
        assert_near(&label, got.into_iter().flatten(), &want.concat(), MOTION);
    }
}

/// What the agents see, against the file where it has that state.
fn assert_seen(episode: &Episode, row: usize, world: &dyn Environment) -> bool {
    let Some(mut want) = episode.seen(row) else { return false };
    let spec = world.spec();
    let mut seen = Observation::new(&spec.shape);
    world.observe(&saved(world), 0, EntitySet::MAX, &mut seen);
    for (agent, width) in episode.widths.iter().enumerate() {
        assert_eq!(spec.features_of(agent).len(), *width, "{}", episode.name);
        let mut dense = vec![0.0; spec.shape.features];
        seen.rows.write_dense(agent, &mut dense);
        let label = format!("{} state {row}, agent {agent}", episode.name);
        let (own, rest) = want.split_at(*width);
        assert_near(&label, dense[..*width].iter().map(|it| f64::from(*it)), own, TOLD);
        want = rest;
    }
    true
}

/// Replays an episode whose world begins as given.
fn replay<S: Scenario>(
    scenario: S,
    episode: &Episode,
    start: S::World,
    mut play: impl FnMut(&mut Particle<S>, usize, &[u16]) -> Step,
    check: impl Fn(&S::World, usize),
) {
    let mut world = Particle::new(scenario, 1);
    world.start(0, start);
    let mut seen = 0;
    for row in 0..=episode.steps() {
        check(world.world(0), row);
        seen += usize::from(assert_seen(episode, row, &world));
        if row == episode.steps() {
            break;
        }
        let step = play(&mut world, row, &episode.actions(row));
        let (label, want) = (format!("{} step {row}", episode.name), episode.row("rewards", row));
        assert_near(&label, world.agent_rewards(0).iter().copied(), want, TOLD);
        let mean = want.iter().sum::<f64>() / want.len() as f64;
        assert_near(&label, [step.reward], &[mean], TOLD);
        assert_eq!((step.terminated, step.timed_out), (false, row + 1 == episode.steps()));
    }
    assert!(seen > 8, "{}: {seen} states were seen", episode.name);
}

fn step<S: Scenario>(world: &mut Particle<S>, _: usize, actions: &[u16]) -> Step {
    world.step(0, actions, &mut generator(0)).unwrap()
}

#[test]
fn recorded_navigation_replays() {
    for episode in episodes("navigation-3") {
        let start = Navigated {
            movers: episode.movers(0, 3),
            landmarks: episode.landmarks(),
            collisions: 0,
            uncovered: 0.0,
        };
        let check = |world: &Navigated, row| assert_moved(&episode, row, &world.movers);
        replay(Navigation::new(3, 25), &episode, start, step, check);
    }
}

#[test]
fn recorded_rovers_and_towers_replay() {
    for set in ["rover-tower-8", "rover-tower-14"] {
        for episode in episodes(set) {
            let towers =
                episode.all("speaker_listener").into_iter().zip(episode.all("speaker_goal"));
            let towers: Vec<_> =
                towers.map(|(rover, goal)| Tower { rover, goal, said: None }).collect();
            let pairs = towers.len();
            let start = Roved {
                movers: episode.movers(0, pairs),
                landmarks: episode.landmarks(),
                towers,
                near: 0,
            };
            let check = |world: &Roved, row: usize| {
                assert_moved(&episode, row, &world.movers);
                for (tower, said) in world.towers.iter().zip(episode.row("comm", row).chunks(5)) {
                    let message = said.iter().position(|word| *word == 1.0);
                    assert_eq!(tower.said.map(usize::from), message, "{} {row}", episode.name);
                }
            };
            replay(RoverTower::new(pairs, 25), &episode, start, step, check);
        }
    }
}

fn treasures_at(episode: &Episode, row: usize) -> impl Iterator<Item = ([f64; 2], u8, bool)> {
    let places = episode.points("treasure_pos", row).into_iter();
    let (kinds, alive) =
        (episode.whole("treasure_type", row), episode.whole("treasure_alive", row));
    places.zip(kinds).zip(alive).map(|((place, kind), alive)| (place, kind, alive == 1))
}

#[test]
fn recorded_treasure_hunts_replay() {
    let (mut taken, mut delivered) = (0, 0);
    for (set, banks) in [("treasure-4", 1), ("treasure-8", 2), ("treasure-12", 3)] {
        for episode in episodes(set) {
            let treasures = treasures_at(&episode, 0).map(|(position, kind, alive)| {
                assert!(alive);
                Treasure { position, kind, ..Treasure::default() }
            });
            let treasures: Vec<_> = treasures.collect();
            let start = Hoard {
                movers: episode.movers(0, 4 * banks),
                hands: vec![Hand::default(); 3 * banks],
                treasures,
                ..Hoard::default()
            };
            let check = |world: &Hoard, row: usize| {
                assert_moved(&episode, row, &world.movers);
                let holding = episode.row("holding", row);
                for (collector, hand) in world.hands.iter().enumerate() {
                    let holds = hand.now.map_or(-1.0, f64::from);
                    assert_eq!(holds, holding[collector], "{} {row} {collector}", episode.name);
                }
                for (treasure, (place, kind, alive)) in
                    world.treasures.iter().zip(treasures_at(&episode, row))
                {
                    let got = (treasure.place(), treasure.kind, treasure.stage != Stage::Taken);
                    assert_eq!(got, (place, kind, alive), "{} {row}", episode.name);
                }
            };
            let play = |world: &mut Particle<TreasureCollection>, row: usize, actions: &[u16]| {
                let next: Vec<_> = treasures_at(&episode, row + 1).collect();
                let draw = |treasure: usize| (next[treasure].0, next[treasure].1);
                let step = world.step_drawn(0, actions, draw).unwrap();
                if step.done() {
                    taken += world.world(0).taken;
                    delivered += world.world(0).delivered;
                }
                step
            };
            let scenario = TreasureCollection::new(banks, DeadTreasures::Far, 100);
            replay(scenario, &episode, start, play, check);
        }
    }
    assert!(taken >= 30 && delivered >= 25, "{taken} taken, {delivered} delivered");
}
