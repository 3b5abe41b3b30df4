//! What tests of several files need, and both losses against what the rules say.

mod naive;
pub(super) mod toy;

use sortie_envs::{Environment, Split};
use sortie_learn::learner::{Learner, Loss, Rules, Shard};
use sortie_learn::play::Play;
use sortie_learn::random::{Purpose, generator};
use sortie_learn::run::EpisodeCounts;
use sortie_learn::trajectory::Place;
use sortie_learn::{Method, Now};
use sortie_nn::gradient_check::assert_gradient;
use sortie_nn::tape::Parameters;

use super::{Config, Records};
use crate::alma::ALMA;

/// The preset `fast`.
pub(super) fn usual() -> Config {
    Config::of(&ALMA.preset("fast").unwrap()).unwrap()
}

/// Where a run learns.
pub(super) fn city(config: &Config) -> Box<dyn Environment> {
    let settings = &config.environment.settings;
    sortie_envs::open("save-the-city/2-5a_2-5b", Split::Train, 1, settings).unwrap()
}

/// A method with the first weights of seed 1, and its instances with an episode begun in each.
pub(super) fn begin(config: &Config) -> (Play, Records) {
    let city = city(config);
    let mut method = Records::new(config, &*city, 1, 1);
    let stream = |index| generator(4, Purpose::Rollout, index as u64);
    let random = (0..config.environment.instances).map(stream).collect();
    (Play::new(&*city, &mut method, random), method)
}

/// Steps all instances so many times, without an update; what ended.
pub(super) fn play(
    (play, method): &mut (Play, impl Method),
    steps: std::ops::Range<u64>,
) -> EpisodeCounts {
    let mut counts = EpisodeCounts::default();
    for env_steps in steps {
        play.round(method, Now { env_steps, of: u64::MAX }, &mut counts).unwrap();
    }
    counts
}

/// What a method has seen of which agents acted at random for so many steps, while rules allocated.
pub(super) fn played(mut config: Config, steps: u64) -> Records {
    (config.exploration.start, config.exploration.end) = (1.0, 1.0);
    config.exploration.spread = vec![1.0];
    (config.allocator.learns_from, config.allocator.decides_from) = (0, u64::MAX);
    let mut begun = begin(&config);
    play(&mut begun, 0..steps);
    begun.1
}

/// Some samples of what a method has seen.
pub(super) fn samples(method: &Records, count: usize) -> Vec<(Place, u8)> {
    let mut drawn = Vec::new();
    method.replay.draw(count, &mut sortie_envs::random::generator(2), &mut drawn);
    assert_eq!(drawn.len(), count);
    drawn
}

/// A loss by these weights, and its gradient.
pub(super) fn gradient<S: Default + Send>(
    [online, target]: [&[f32]; 2],
    loss: impl Fn(&mut Shard<'_, S>) -> Loss + Sync,
) -> (f64, Vec<f32>) {
    let mut parameters = Parameters::default();
    parameters.values = online.to_vec();
    let rules = Rules { clip: f32::INFINITY, ..Rules::default() };
    let mut learner: Learner<S> = Learner::new(parameters, rules, 1);
    learner.target = target.to_vec();
    let found = learner.update(1, 0.0, loss);
    (found.loss, learner.gradient().to_vec())
}

/// Asserts that a loss's gradient by every tensor of a network is its slope, where `target` is the other network.
pub(super) fn assert_gradients<S: Default + Send>(
    online: &Parameters,
    target: &[f32],
    loss: impl Fn(&mut Shard<'_, S>) -> Loss + Sync,
) {
    let (_, slopes) = gradient([&online.values, target], &loss);
    for tensor in online.tensors() {
        let range = tensor.range.clone();
        assert_gradient(&tensor.name, &online.values[range.clone()], &slopes[range], |moved| {
            let mut online = online.values.clone();
            online[tensor.range.clone()].copy_from_slice(moved);
            gradient([&online, target], &loss).0
        });
    }
}
