use sortie_envs::Observation;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::gradient_check::assert_gradient;

use super::*;
use crate::alma::agents::{TeamBatch, UtilityNetwork};
use crate::alma::records::mixer::Teams;
use crate::alma::records::toy::{Fixed, begin, fixed, observer, play, usual};
use crate::alma::records::{Config, Mixer, MixerKind, Parameters};

/// Few records, so that finite differences cross few kinks.
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

fn masked() -> Config {
    config(Conditioning::Mask, MixerKind::Sum)
}

fn network(config: &Config, seed: u64) -> MixedNetwork {
    let mut weights = generator(seed, Purpose::Weights, 0);
    let shape = config.network.shape(observer(config).spec());
    MixedNetwork {
        utility: UtilityNetwork::initialise(shape, 8.0, &mut weights),
        mixer: Mixer::initialise(config.mixer.shape(shape.input), 8.0, &mut weights),
    }
}

fn chunk(config: &Config) -> Chunk {
    Chunk::new(&network(config, 1), config.network.subtask, config.mixer.reward_factor())
}

fn replay(config: &Config) -> Replay {
    let mut method =
        Fixed { epsilon: 1.0, decides_from: u64::MAX, segments: None, ..fixed(config, 1) };
    play(&mut begin(config, 4, &mut method), &mut method, 60);
    method.records
}

fn picks(replay: &Replay, symmetry: impl Fn(usize) -> u8) -> Vec<Pick> {
    let record = |i| (i * (replay.len() / BATCH)) as u32;
    let pick = |i| Pick { sample: record(i), symmetry: symmetry(i), draw: i as u64 };
    (0..BATCH).map(pick).collect()
}

fn squared_error(
    config: &Config,
    online: &MixedNetwork,
    target: &MixedNetwork,
    of: (&Replay, &[Pick]),
) -> f64 {
    let mut chunk = chunk(config);
    let environment = observer(config);
    let experience = Experience { environment: &*environment, replay: of.0 };
    chunk.learn(Networks { online, target }, experience, of.1);
    chunk.squared_error()
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
        let (replay, online, target) = (replay(&config), network(&config, 1), network(&config, 2));
        let mut picks = picks(&replay, |i| (i % 8) as u8);
        let discount = |pick: &Pick| replay.get(pick.sample as usize).record.discount;
        // Few records end without subtasks, so that one of them is taken on purpose.
        let ended = (0..replay.len() as u32)
            .find(|index| replay.get(*index as usize).record.discount == 0.0);
        if let (Some(sample), true) = (ended, picks.iter().all(|pick| discount(pick) > 0.0)) {
            picks[0].sample = sample;
        }
        assert!(picks.iter().any(|pick| discount(pick) > 0.0), "{subtask:?}");

        let (mut chunk, environment) = (chunk(&config), observer(&config));
        let experience = Experience { environment: &*environment, replay: &replay };
        chunk.learn(Networks { online: &online, target: &target }, experience, &picks);
        let (to_utility, to_mixer) = chunk.gradient().split_at(online.utility.shape().parameters());
        let loss =
            |online: &MixedNetwork| squared_error(&config, online, &target, (&replay, &picks));
        for tensor in online.utility.shape().tensors() {
            let at = &online.utility.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &to_utility[tensor.range.clone()], |moved| {
                let mut online = online.clone();
                online.utility.parameters_mut()[tensor.range.clone()].copy_from_slice(moved);
                loss(&online)
            });
        }
        for tensor in online.mixer.shape().tensors() {
            let at = &online.mixer.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &to_mixer[tensor.range.clone()], |moved| {
                let mut online = online.clone();
                online.mixer.parameters_mut()[tensor.range.clone()].copy_from_slice(moved);
                loss(&online)
            });
        }
    }
}

#[test]
fn chunks_of_a_batch_add_up() {
    let config = masked();
    let (replay, online, target) = (replay(&config), network(&config, 1), network(&config, 2));
    let networks = || Networks { online: &online, target: &target };
    let picks = picks(&replay, |_| 0);
    let environment = observer(&config);
    let experience = Experience { environment: &*environment, replay: &replay };
    let mut whole = chunk(&config);
    whole.learn(networks(), experience, &picks);
    let mut sum = vec![0.0; online.count()];
    let mut chunk = chunk(&config);
    for part in picks.chunks(7) {
        chunk.learn(networks(), experience, part);
        sum.iter_mut().zip(chunk.gradient()).for_each(|(sum, part)| *sum += part);
    }
    let largest = whole.gradient().iter().fold(0.0_f32, |largest, slope| largest.max(slope.abs()));
    assert!(largest > 0.0);
    for (sum, whole) in sum.iter().zip(whole.gradient()) {
        assert!((sum - whole).abs() < 1e-5 * largest, "{sum} against {whole}");
    }
}

#[test]
fn a_record_without_discount_learns_its_reward_alone() {
    let config = masked();
    let (mut replay, online) = (replay(&config), network(&config, 1));
    let mut newest = *replay.get(replay.len() - 1).record;
    newest.discount = 0.0;
    replay.push(newest);
    let last = Pick { sample: replay.len() as u32 - 1, symmetry: 0, draw: 0 };
    let error = |seed| squared_error(&config, &online, &network(&config, seed), (&replay, &[last]));
    assert_eq!(error(2), error(3));
}

#[test]
fn the_target_is_the_reward_and_the_discounted_mix_of_next_utilities() {
    for kind in [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix] {
        let config = config(Conditioning::None, kind);
        let (replay, network) = (replay(&config), network(&config, 1));
        let (sample, environment) = (replay.get(3), observer(&config));
        let mut seen = Observation::default();
        environment.observe(sample.next.state, 0, 0, &mut seen);
        let available = seen.available.clone();
        let mut value = |next: bool, actions: Option<&[u8]>| {
            let moment = if next { sample.next } else { sample.now };
            environment.observe(moment.state, 0, EntitySet::MAX, &mut seen);
            let mut batch = TeamBatch::new(Conditioning::None);
            batch.clear(Columns::of(&environment.spec().shape));
            batch.push_teams(&seen, sample.now.allocation, moment.last_actions, |_| ());
            let input = batch.finish();
            let mut pass = UtilityPass::new(network.utility.shape());
            let utilities = pass.forward(&network.utility, input);
            let chosen = utilities.chunks_exact(12).enumerate();
            let chosen: Vec<f32> = chosen
                .map(|(agent, utilities)| {
                    let best = best_action(utilities, available[agent]);
                    utilities[usize::from(actions.map_or(best, |taken| taken[agent]))]
                })
                .collect();
            let teams = Teams { input, sizes: &[seen.agents()], utilities: &chosen };
            MixerPass::default().forward(&network.mixer, teams)[0]
        };
        let taken = sample.now.actions;
        assert!(sample.record.discount > 0.0);
        let target = config.mixer.reward_factor() * sample.record.reward
            + sample.record.discount * value(true, None);
        let error = f64::from(value(false, Some(taken)) - target);
        let pick = Pick { sample: 3, symmetry: 0, draw: 0 };
        let got = squared_error(&config, &network, &network, (&replay, &[pick]));
        assert!((got - error * error).abs() < 1e-4 * (1.0 + got), "{kind:?}: {got} {error}");
    }
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
    let (replay, online, target) = (replay(&config), network(&config, 1), network(&config, 2));
    let error = |draw| {
        let pick = Pick { sample: 5, symmetry: 0, draw };
        squared_error(&config, &online, &target, (&replay, &[pick]))
    };
    assert_ne!(error(0), error(1), "an untrained network tells marks apart");
}
