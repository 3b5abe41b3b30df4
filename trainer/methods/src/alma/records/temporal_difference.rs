//! The loss of the low level: value decomposition per subtask, on records.
//!
//! A mixer makes the value of a team from the utilities of its agents' actions; the simplest is their sum
//! (dissertation section 7.3). Target: `reward + discount * mixed target utilities`, each of the action
//! that the online network likes best among the available ones (double Q-learning), with the team of the
//! record's own step. Loss: squared difference.
//!
//! Where subtasks are marked in the input, the marks of each record are exchanged at random, so that no
//! subtask is special by its number.

use rand_core::SeedableRng;
use sortie_envs::random::below;
use sortie_envs::{ActionSet, EntitySet, Environment, members};
use sortie_nn::random::Generator;

use super::learner::{Experience, Loss, Networks, Pick};
use super::mixed_network::MixedNetwork;
use super::mixer::MixerPass;
use super::replay::{Replay, Sample};
use super::side::{Look, Side};
use crate::alma::agents::{
    Columns, Conditioning, UtilityNetwork, UtilityPass, UtilityShape, best_action,
};

/// Space to compute the gradient of some records, and the result.
#[derive(Clone, Debug)]
pub struct Chunk {
    shape: UtilityShape,
    conditioning: Conditioning,
    reward_factor: f32,
    now: Side,
    next: Side,
    pass: UtilityPass,
    mixing: MixerPass,
    /// Available actions of each agent of `next`.
    next_available: Vec<ActionSet>,
    /// Reward, then target, and discount of each record.
    rewards: Vec<(f32, f32)>,
    /// The subtask that each subtask of a record is marked as.
    marks: Vec<u8>,
    d_values: Vec<f32>,
    d_chosen: Vec<f32>,
    d_utilities: Vec<f32>,
    gradient: Vec<f32>,
    squared_error: f64,
}

impl Chunk {
    /// Empty space for networks of the shapes of this one; rewards are multiplied by a factor.
    pub fn new(network: &MixedNetwork, conditioning: Conditioning, reward_factor: f32) -> Self {
        let shape = network.utility.shape();
        Self {
            shape,
            conditioning,
            reward_factor,
            now: Side::new(conditioning),
            next: Side::new(conditioning),
            pass: UtilityPass::new(shape),
            mixing: MixerPass::default(),
            next_available: Vec::new(),
            rewards: Vec::new(),
            marks: Vec::new(),
            d_values: Vec::new(),
            d_chosen: Vec::new(),
            d_utilities: Vec::new(),
            gradient: vec![0.0; shape.parameters() + network.mixer.shape().parameters()],
            squared_error: 0.0,
        }
    }

    /// Floating-point operations of the utility networks up to now, see [`UtilityPass::operations`].
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Rebuilds the features of the records, turned as they were picked.
    fn gather(&mut self, experience: Experience<'_, Replay>, picks: &[Pick]) {
        let Experience { environment, replay } = experience;
        let columns = Columns::of(&environment.spec().shape);
        self.now.clear(columns);
        self.next.clear(columns);
        self.next_available.clear();
        self.rewards.clear();
        replay.fetch(picks.iter().map(|pick| pick.sample as usize));
        for pick in picks {
            exchange(&mut self.marks, self.shape.input - columns.unmarked(), pick.draw);
            self.push(environment, replay.get(pick.sample as usize), pick.symmetry.into());
        }
        self.now.batch.finish();
        self.next.batch.finish();
    }

    /// Adds what the team of a record sees.
    fn push(&mut self, environment: &dyn Environment, sample: Sample<'_>, turn: usize) {
        let Self { now, next, marks, .. } = self;
        let (record, team) = (sample.record, sample.team());
        let sight = match self.conditioning {
            Conditioning::Mask => EntitySet::from(team) | record.things(),
            Conditioning::Input | Conditioning::None => EntitySet::MAX,
        };
        let allocation = sample.now.allocation;
        let look = Look { environment, turn, team, sight, allocation, marks };
        now.push(sample.now, look);
        let taken = members(team.into()).map(|agent| look.turned(sample.now.actions[agent]));
        now.actions.extend(taken);
        self.rewards.push((self.reward_factor * record.reward, record.discount));
        if record.discount > 0.0 {
            next.push(sample.next, look);
            let available = members(team.into()).map(|agent| next.seen.available[agent]);
            self.next_available.extend(available);
        }
    }

    fn choose_next(&mut self, online: &UtilityNetwork) {
        let utilities = self.pass.forward(online, self.next.batch.input());
        let agents = utilities.chunks_exact(self.shape.actions).zip(&self.next_available);
        self.next.actions.clear();
        self.next
            .actions
            .extend(agents.map(|(utilities, available)| best_action(utilities, *available)));
    }

    fn descend(&mut self, networks: Networks<'_, MixedNetwork>) {
        let values = self.next.values(networks.target, &mut self.pass, &mut self.mixing);
        let bootstrapped = self.rewards.iter_mut().filter(|(_, discount)| *discount > 0.0);
        for ((target, discount), value) in bootstrapped.zip(values) {
            *target += *discount * value;
        }

        let online = networks.online;
        let values = self.now.values(online, &mut self.pass, &mut self.mixing);
        self.squared_error = 0.0;
        self.d_values.clear();
        for (value, (target, _)) in values.iter().zip(&self.rewards) {
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            self.d_values.push(2.0 * error);
        }

        self.gradient.fill(0.0);
        let (to_utility, to_mixer) = self.gradient.split_at_mut(self.shape.parameters());
        self.d_chosen.clear();
        self.d_chosen.resize(self.now.chosen.len(), 0.0);
        let (d_values, d_chosen) = (&self.d_values, &mut self.d_chosen);
        self.mixing.backward(&online.mixer, self.now.teams(), d_values, d_chosen, to_mixer);

        let actions = self.shape.actions;
        self.d_utilities.clear();
        self.d_utilities.resize(self.d_chosen.len() * actions, 0.0);
        let agents = self.d_utilities.chunks_exact_mut(actions).zip(&self.now.actions);
        for ((slopes, action), slope) in agents.zip(&self.d_chosen) {
            slopes[usize::from(*action)] = *slope;
        }
        let input = self.now.batch.input();
        self.pass.backward(&online.utility, input, &self.d_utilities, to_utility);
    }
}

/// Draws which mark each of so many subtasks gets; a draw of 0 leaves each its own.
fn exchange(marks: &mut Vec<u8>, tasks: usize, draw: u64) {
    marks.clear();
    marks.extend(0..tasks as u8);
    if draw != 0 && tasks > 1 {
        let mut generator = Generator::seed_from_u64(draw);
        for last in (1..tasks).rev() {
            marks.swap(last, below(&mut generator, last + 1));
        }
    }
}

impl Loss for Chunk {
    type Network = MixedNetwork;
    type Replay = Replay;
    const CHUNK: usize = 128;

    fn learn(
        &mut self,
        networks: Networks<'_, MixedNetwork>,
        experience: Experience<'_, Replay>,
        picks: &[Pick],
    ) {
        self.gather(experience, picks);
        self.choose_next(&networks.online.utility);
        self.descend(networks);
    }

    fn squared_error(&self) -> f64 {
        self.squared_error
    }

    fn terms(&self) -> usize {
        self.rewards.len()
    }

    fn gradient(&self) -> &[f32] {
        &self.gradient
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::agents::TeamBatch;
    use crate::alma::agents::UtilityNetwork;
    use crate::alma::records::fixed::{Fixed, begin, fixed, observer, play, usual};
    use crate::alma::records::mixer::Teams;
    use crate::alma::records::{Config, Mixer, MixerKind, Parameters};
    use sortie_envs::Observation;
    use sortie_learn::random::{Purpose, generator};
    use sortie_nn::gradient_check::assert_gradient;

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
        for ((subtask, kind), skip) in cases.iter().flat_map(|case| [(*case, false), (*case, true)])
        {
            let mut config = config(subtask, kind);
            config.network.skip = skip;
            let (replay, online, target) =
                (replay(&config), network(&config, 1), network(&config, 2));
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
            let (to_utility, to_mixer) =
                chunk.gradient().split_at(online.utility.shape().parameters());
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
        let largest =
            whole.gradient().iter().fold(0.0_f32, |largest, slope| largest.max(slope.abs()));
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
        let error =
            |seed| squared_error(&config, &online, &network(&config, seed), (&replay, &[last]));
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
}
