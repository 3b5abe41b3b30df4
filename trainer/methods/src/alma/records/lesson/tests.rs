use sortie_envs::random::generator;
use sortie_learn::networks::MixerKind;

use super::*;
use crate::alma::records::Records;
use crate::alma::records::tests::{assert_gradients, city, gradient, played, samples, usual};

/// Few samples, so that finite differences cross few kinks.
const BATCH: usize = 16;

fn config(subtask: Conditioning, kind: MixerKind) -> Config {
    let mut config = usual();
    config.allocation.heuristic = 1.0;
    (config.network.subtask, config.mixer.kind) = (subtask, kind);
    // Small rewards, beside whose rounding the slopes of a mixer are large.
    config.environment.settings.insert("reward_scale".into(), 2.into());
    config.returns.shaping = 0.05;
    (config.network.width, config.network.base) = (8, 6);
    (config.mixer.width, config.mixer.heads, config.mixer.mixing) = (8, 2, 4);
    config
}

/// A method that has seen something, with samples of it, one of which ends.
fn seen(config: &Config) -> (Records, Vec<Drawn>) {
    let method = played(config.clone(), 60);
    let draw = |(number, sample)| Drawn { sample, turn: number % 8, marks: number as u64 };
    let many = samples(&method, 3000).into_iter().enumerate().map(draw);
    let mut drawn: Vec<Drawn> = many.clone().take(BATCH).collect();
    let ends = |drawn: &Drawn| method.replay.sample(drawn.sample).discount == 0.0;
    // Few end without subtasks.
    let ended = many.clone().find(ends);
    drawn[0] = ended.unwrap_or(drawn[0]);
    assert!(!drawn.iter().all(ends));
    (method, drawn)
}

#[test]
fn the_gradient_of_the_whole_loss_agrees_with_finite_differences() {
    let cases = [
        (Conditioning::Mask, MixerKind::Sum),
        (Conditioning::Mask, MixerKind::Linear),
        (Conditioning::Input, MixerKind::Qmix),
        (Conditioning::None, MixerKind::Qmix),
    ];
    for ((subtask, kind), skip) in cases.iter().flat_map(|case| [(*case, false), (*case, true)]) {
        let mut config = config(subtask, kind);
        config.network.skip = skip;
        let ((method, drawn), city) = (seen(&config), city(&config));
        let network = |seed| Networks::new(&config, city.spec(), &mut generator(seed));
        let ((networks, online), (_, target)) = (network(1), network(2));
        let experience = Experience { environment: &*city, replay: &method.replay };
        assert_gradients(&online, &target.values, |shard: &mut Shard<'_, Lesson>| {
            networks.loss(shard, experience, &drawn, BATCH)
        });
    }
}

#[test]
fn shards_of_a_batch_add_up() {
    let config = config(Conditioning::Mask, MixerKind::Sum);
    let ((method, drawn), city) = (seen(&config), city(&config));
    let (networks, online) = Networks::new(&config, city.spec(), &mut generator(1));
    let experience = Experience { environment: &*city, replay: &method.replay };
    let of = |drawn: &[Drawn]| {
        let weights = [&online.values[..]; 2];
        gradient(weights, |shard| networks.loss(shard, experience, drawn, BATCH))
    };
    let (whole, parts) = (of(&drawn), [&drawn[..7], &drawn[7..]].map(of));
    assert!((whole.0 - parts[0].0 - parts[1].0).abs() < 1e-5 * whole.0);
    let largest = whole.1.iter().fold(0.0_f32, |largest, slope| largest.max(slope.abs()));
    for (place, whole) in whole.1.iter().enumerate() {
        let sum = parts[0].1[place] + parts[1].1[place];
        assert!((sum - whole).abs() < 1e-5 * largest, "{sum} against {whole}");
    }
}

#[test]
fn rewards_count_a_factor_under_qmix() {
    let config = config(Conditioning::Mask, MixerKind::Qmix);
    let ((method, drawn), city) = (seen(&config), city(&config));
    let (networks, online) = Networks::new(&config, city.spec(), &mut generator(1));
    let experience = Experience { environment: &*city, replay: &method.replay };
    gradient([&online.values, &online.values], |shard: &mut Shard<'_, Lesson>| {
        let loss = networks.loss(shard, experience, &drawn, BATCH);
        for (drawn, reward) in drawn.iter().zip(&shard.space.rewards) {
            let full = method.replay.sample(drawn.sample).reward;
            assert_eq!(*reward, config.mixer.reward_scale * full);
        }
        loss
    });
}

#[test]
fn marks_are_exchanged_by_their_draw() {
    let marks = |draw| {
        let mut marks = Vec::new();
        exchange(&mut marks, 6, draw);
        marks
    };
    assert_eq!(marks(0), [0, 1, 2, 3, 4, 5]);
    let mut seen = [[false; 6]; 6];
    for draw in 1..200 {
        let mut sorted = marks(draw);
        for (task, mark) in sorted.iter().enumerate() {
            seen[task][usize::from(*mark)] = true;
        }
        sorted.sort();
        assert_eq!(sorted, [0, 1, 2, 3, 4, 5]);
    }
    assert_eq!(seen, [[true; 6]; 6]);

    let config = config(Conditioning::Input, MixerKind::Sum);
    let ((method, drawn), city) = (self::seen(&config), city(&config));
    let (networks, online) = Networks::new(&config, city.spec(), &mut generator(1));
    let experience = Experience { environment: &*city, replay: &method.replay };
    let error = |marks| {
        let drawn = [Drawn { marks, ..drawn[1] }];
        let weights = [&online.values[..]; 2];
        gradient(weights, |shard| networks.loss(shard, experience, &drawn, 1)).0
    };
    assert_ne!(error(0), error(1), "an untrained network tells marks apart");
}
