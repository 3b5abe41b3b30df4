//! Episodes of the reference, replayed with the draws that it recorded.

use sortie_envs::gridworld::{Chance, Gridworld, Map, Rules};
use sortie_envs::{EntitySet, Environment, Observation};

use super::recorded::{Episode, episodes};
use super::{places, saved};

/// The draws of one step of a recording, and those of all steps before for pits that nobody looked at.
struct Replayed<'a> {
    episode: &'a Episode,
    step: usize,
    contested: usize,
}

impl Chance for Replayed<'_> {
    fn taken(&mut self, agent: usize, action: u8) -> u8 {
        let taken = self.episode.bytes("eff_actions", self.step)[agent];
        let is_replaced = self.episode.floats("trans_u", self.step)[agent] <= 0.1;
        assert!(is_replaced || taken == action);
        taken
    }

    fn tick(&mut self, pit: usize, tick: u32, probability: f64, _: f64) -> Option<f64> {
        let (draws, step) = (self.episode, tick as usize);
        let opens = f64::from(draws.floats("pit_u", step)[pit]) < probability;
        assert_eq!(opens, draws.bytes("pit_open", step)[pit] == 1, "{} {step}", draws.name);
        (!opens).then(|| draws.floats("pit_n", step)[pit].into())
    }

    fn first_goes_back(&mut self) -> bool {
        self.contested += 1;
        self.episode.bytes("tie_break", self.step)[self.contested - 1] == 0
    }
}

fn assert_state(episode: &Episode, row: usize, world: &Gridworld) {
    let label = format!("{} state {row}", episode.name);
    let want = episode.bytes("pos", row).as_chunks::<2>().0;
    let got: Vec<[u8; 2]> = places(world).iter().map(|it| [it.0 as u8, it.1 as u8]).collect();
    assert_eq!(got, want, "{label}");
    let kinds = 0..episode.treasures;
    let flags = |own: &u8| kinds.clone().map(|kind| own >> kind & 1).collect::<Vec<u8>>();
    let found: Vec<u8> = world.found(0).iter().flat_map(flags).collect();
    assert_eq!(found, episode.bytes("found", row), "{label}");
    assert_eq!(world.tiers(0), episode.bytes("tiers_completed", row)[0], "{label}");

    let spec = world.spec();
    let mut seen = Observation::new(&spec.shape);
    world.observe(&saved(world), 0, EntitySet::MAX, &mut seen);
    let mut dense = Vec::new();
    seen.rows.write_all(spec.shape.features, &mut dense);
    assert_eq!(dense, episode.floats("obs", row), "{label}");
}

fn replay(episode: &Episode) {
    let map = Map::parse(&episode.map, episode.agents, episode.treasures).unwrap();
    let rules = Rules { map, tiers: episode.tiers.clone(), noise: 0.1, episode_limit: 500 };
    let mut world = Gridworld::new(rules, 1);
    world.start(0);
    let rewards = episode.doubles("rewards");
    for (step, reward) in rewards.iter().enumerate() {
        assert_state(episode, step, &world);
        let mut chance = Replayed { episode, step, contested: 0 };
        let actions: Vec<u16> =
            episode.bytes("actions", step).iter().map(|it| (*it).into()).collect();
        let taken = world.step_with(0, &actions, &mut chance).unwrap();
        let label = format!("{} step {step}", episode.name);
        assert!((taken.reward - reward).abs() < 1e-12, "{label}: {}", taken.reward);
        assert_eq!(taken.terminated, episode.bytes("done", step)[0] == 1, "{label}");
        let draws = episode.bytes("tie_break", step).iter().filter(|draw| **draw != 255).count();
        assert_eq!(chance.contested, draws, "{label}");
    }
    assert_state(episode, episode.steps(), &world);
    world.settle(0, &mut Replayed { episode, step: 0, contested: 0 });
    let pits: Vec<f64> = world.pits(0).iter().map(|pit| pit.probability).collect();
    assert_eq!(pits, episode.doubles("pit_prob_final"), "{}", episode.name);
}

#[test]
fn recorded_episodes_replay_exactly() {
    let tasks =
        [1, 2, 3].into_iter().flat_map(|task| [2, 3, 4].map(|n| format!("task{task}_n{n}")));
    let mut replayed = 0;
    for set in tasks.chain(["flip_n2".into(), "flip_n4".into()]) {
        for episode in episodes(&set) {
            replay(&episode);
            replayed += 1;
        }
    }
    assert_eq!(replayed, 13);
}
