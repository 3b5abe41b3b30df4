//! The loss of the low level: value decomposition per subtask, on records.
//!
//! The value of a team is the sum of its agents' utilities (VDN, the simplest mixer of dissertation
//! section 7.3). Target: `reward + discount * sum of target utilities`, each of the action that the
//! online network likes best among the available ones (double Q-learning), with the team of the
//! record's own step. Loss: squared difference.

use super::learner::{Loss, Networks, Pick};
use super::replay::Replay;
use super::team_batch::{TeamBatch, best_action};
use super::utility::{UtilityNetwork, UtilityShape};
use super::utility_pass::UtilityPass;
use sortie_envs::save_the_city::Symmetry;

/// Space to compute the gradient of some records, and the result.
#[derive(Clone, Debug)]
pub struct Chunk {
    shape: UtilityShape,
    now: TeamBatch,
    next: TeamBatch,
    pass: UtilityPass,
    /// Action taken by each agent of `now`.
    actions: Vec<u8>,
    /// Available actions of each agent of `next`, then its best action.
    next_available: Vec<u16>,
    next_actions: Vec<u8>,
    /// Reward, discount and team size of each record.
    rewards: Vec<(f32, f32, usize)>,
    d_utilities: Vec<f32>,
    gradient: Vec<f32>,
    squared_error: f64,
}

impl Chunk {
    /// Empty space for networks of a shape.
    pub fn new(shape: UtilityShape) -> Self {
        Self {
            shape,
            now: TeamBatch::default(),
            next: TeamBatch::default(),
            pass: UtilityPass::new(shape),
            actions: Vec::new(),
            next_available: Vec::new(),
            next_actions: Vec::new(),
            rewards: Vec::new(),
            d_utilities: Vec::new(),
            gradient: vec![0.0; shape.parameters()],
            squared_error: 0.0,
        }
    }

    /// Floating-point operations up to now, as [`UtilityPass::operations`] counts them.
    pub fn operations(&self) -> u64 {
        self.pass.operations()
    }

    /// Rebuilds the features of the records, turned as they were picked.
    fn gather(&mut self, replay: &Replay, picks: &[Pick]) {
        self.now.clear();
        self.next.clear();
        self.actions.clear();
        self.next_available.clear();
        self.rewards.clear();
        for pick in picks {
            let turn = Symmetry::ALL[usize::from(pick.symmetry)];
            let turned_last = |action: u8| turn.action(action.into()) as u8;
            let (record, team) = replay.get(pick.sample as usize);
            for member in team {
                self.now.push_agent(&turn.agent(&member.agent), turned_last(member.last_action));
                self.actions.push(turn.action(member.action.into()) as u8);
            }
            self.now.end_team(&turn.building(&record.building));
            if record.discount > 0.0 {
                for member in team {
                    let agent = turn.agent(&member.next);
                    self.next.push_agent(&agent, turned_last(member.next_last_action));
                    self.next_available.push(agent.available);
                }
                self.next.end_team(&turn.building(&record.next_building));
            }
            self.rewards.push((record.reward, record.discount, team.len()));
        }
        self.now.finish();
        self.next.finish();
    }

    fn choose_next(&mut self, online: &UtilityNetwork) {
        let utilities = self.pass.forward(online, self.next.input());
        let agents = utilities.chunks_exact(self.shape.actions).zip(&self.next_available);
        self.next_actions.clear();
        self.next_actions
            .extend(agents.map(|(utilities, available)| best_action(utilities, *available)));
    }

    fn descend(&mut self, networks: Networks<'_, UtilityNetwork>) {
        let actions = self.shape.actions;
        let utility =
            |all: &[f32], agent: usize, action: u8| all[agent * actions + usize::from(action)];

        let values = self.pass.forward(networks.target, self.next.input());
        let mut first = 0;
        for (target, discount, size) in &mut self.rewards {
            if *discount > 0.0 {
                let team = first..first + *size;
                first = team.end;
                let value: f32 = team.map(|a| utility(values, a, self.next_actions[a])).sum();
                *target += *discount * value;
            }
        }

        let utilities = self.pass.forward(networks.online, self.now.input());
        self.d_utilities.clear();
        self.d_utilities.resize(utilities.len(), 0.0);
        self.squared_error = 0.0;
        let mut first = 0;
        for (target, _, size) in &self.rewards {
            let team = first..first + size;
            first = team.end;
            let value: f32 = team.clone().map(|a| utility(utilities, a, self.actions[a])).sum();
            let error = value - target;
            self.squared_error += f64::from(error) * f64::from(error);
            for agent in team {
                let place = agent * actions + usize::from(self.actions[agent]);
                self.d_utilities[place] = 2.0 * error;
            }
        }
        self.gradient.fill(0.0);
        let input = self.now.input();
        self.pass.backward(networks.online, input, &self.d_utilities, &mut self.gradient);
    }
}

impl Loss for Chunk {
    type Network = UtilityNetwork;
    type Replay = Replay;
    const CHUNK: usize = 64;

    fn learn(&mut self, networks: Networks<'_, UtilityNetwork>, replay: &Replay, picks: &[Pick]) {
        self.gather(replay, picks);
        self.choose_next(networks.online);
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
    use crate::layers::gradient_check::assert_gradient;
    use crate::methods::alma::{Behaviour, Config, EpisodeCounts, Memory, Parameters, Rollout};
    use crate::random::{Purpose, generator};
    use sortie_envs::save_the_city::ACTIONS;

    const BATCH: usize = 40;

    fn network(seed: u64) -> UtilityNetwork {
        let shape = UtilityShape { width: 8, base: 6, ..Config::default().network.shape(ACTIONS) };
        UtilityNetwork::initialise(shape, 8.0, &mut generator(seed, Purpose::Weights, 0))
    }

    fn replay() -> Replay {
        let mut config = Config::default();
        config.set("allocation.heuristic=1").unwrap();
        let mut rollout = Rollout::new(&config, network(1).shape(), 7).unwrap();
        let mut replay = Replay::new(10_000, 5);
        for _ in 0..60 {
            let behaviour = Behaviour { agents: &network(1), epsilon: 1.0, allocator: None };
            let memory = Memory { records: &mut replay, segments: None };
            rollout.step(behaviour, memory, &mut EpisodeCounts::default()).unwrap();
        }
        replay
    }

    fn picks(replay: &Replay, symmetry: impl Fn(usize) -> u8) -> Vec<Pick> {
        let record = |i| (i * (replay.len() / BATCH)) as u32;
        (0..BATCH).map(|i| Pick { sample: record(i), symmetry: symmetry(i), lot: 0 }).collect()
    }

    #[test]
    fn the_gradient_of_the_whole_loss_agrees_with_finite_differences() {
        let (replay, online, target) = (replay(), network(1), network(2));
        let picks = picks(&replay, |i| (i % 8) as u8);
        let bootstraps = |pick: &Pick| replay.get(pick.sample as usize).0.discount > 0.0;
        assert!(picks.iter().any(bootstraps) && !picks.iter().all(bootstraps));

        let loss = |parameters: &[f32]| {
            let online = UtilityNetwork::from_parameters(online.shape(), parameters.to_vec());
            let networks = Networks { online: &online.unwrap(), target: &target };
            let mut chunk = Chunk::new(target.shape());
            chunk.learn(networks, &replay, &picks);
            chunk.squared_error()
        };
        let mut chunk = Chunk::new(online.shape());
        chunk.learn(Networks { online: &online, target: &target }, &replay, &picks);
        for tensor in online.shape().tensors() {
            let at = &online.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &chunk.gradient()[tensor.range.clone()], |moved| {
                let mut parameters = online.parameters().to_vec();
                parameters[tensor.range.clone()].copy_from_slice(moved);
                loss(&parameters)
            });
        }
    }

    #[test]
    fn chunks_of_a_batch_add_up() {
        let (replay, online, target) = (replay(), network(1), network(2));
        let networks = || Networks { online: &online, target: &target };
        let picks = picks(&replay, |_| 0);
        let mut whole = Chunk::new(online.shape());
        whole.learn(networks(), &replay, &picks);
        let mut sum = vec![0.0; online.shape().parameters()];
        let mut chunk = Chunk::new(online.shape());
        for part in picks.chunks(7) {
            chunk.learn(networks(), &replay, part);
            sum.iter_mut().zip(chunk.gradient()).for_each(|(sum, part)| *sum += part);
        }
        for (sum, whole) in sum.iter().zip(whole.gradient()) {
            assert!((sum - whole).abs() < 1e-2, "{sum} against {whole}");
        }
    }

    #[test]
    fn a_record_without_discount_learns_its_reward_alone() {
        let (mut replay, online) = (replay(), network(1));
        let (record, team) = replay.get(0);
        let (record, team) = (super::super::Record { discount: 0.0, ..*record }, team.to_vec());
        replay.push(record, team);
        let last = Pick { sample: replay.len() as u32 - 1, symmetry: 0, lot: 0 };
        let error = |target: &UtilityNetwork| {
            let mut chunk = Chunk::new(online.shape());
            chunk.learn(Networks { online: &online, target }, &replay, &[last]);
            chunk.squared_error()
        };
        assert_eq!(error(&network(2)), error(&network(3)));
    }
}
