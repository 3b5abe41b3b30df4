//! The loss of the low level: value decomposition per subtask, on records.
//!
//! The value of a team is the sum of its agents' utilities (VDN, the simplest mixer of dissertation
//! section 7.3). Target: `reward + discount * sum of target utilities`, each of the action that the
//! online network likes best among the available ones (double Q-learning), with the team of the
//! record's own step. Loss: mean squared difference over the batch.

use super::replay::Replay;
use super::team_batch::{TeamBatch, best_action};
use super::utility::{UtilityNetwork, UtilityShape};
use super::utility_pass::UtilityPass;
use sortie_envs::save_the_city::Symmetry;

/// A record to learn from and how its map is turned, as an index of [`Symmetry::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pick {
    /// Index in the replay.
    pub record: u32,
    /// Index of the symmetry; 0 changes nothing.
    pub symmetry: u8,
}

/// What the loss is computed with.
#[derive(Clone, Copy, Debug)]
pub struct Networks<'a> {
    /// The network that learns.
    pub online: &'a UtilityNetwork,
    /// The slowly moving network that values the next state.
    pub target: &'a UtilityNetwork,
}

/// Space to compute the gradient of some records, and the result.
#[derive(Debug)]
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

    /// The gradient of the last [`learn`](Self::learn).
    pub fn gradient(&self) -> &[f32] {
        &self.gradient
    }

    /// The sum of squared errors of the last [`learn`](Self::learn).
    pub fn squared_error(&self) -> f64 {
        self.squared_error
    }

    /// Computes the gradient of `sum of squared errors / batch` over the picked records.
    pub fn learn(&mut self, networks: Networks<'_>, replay: &Replay, picks: &[Pick], batch: usize) {
        self.gather(replay, picks);
        self.choose_next(networks.online);
        self.descend(networks, batch);
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
            let sample = replay.get(pick.record as usize);
            let record = sample.record;
            let (team, others) = sample.split_team();
            for step in team {
                let agent = turn.agent(&step.agent);
                self.now.push_agent(&agent, turned_last(step.last_action), step.task);
                self.actions.push(turn.action(step.action.into()) as u8);
            }
            for step in others {
                let agent = turn.agent(&step.agent);
                self.now.push_other(&agent, turned_last(step.last_action), step.task);
            }
            for (task, step) in (0..).zip(sample.buildings) {
                self.now.push_building(&turn.building(&step.building), task);
            }
            self.now.end_team();
            if record.discount > 0.0 {
                for step in team {
                    let agent = turn.agent(&step.next);
                    self.next.push_agent(&agent, turned_last(step.next_last_action), step.task);
                    self.next_available.push(agent.available);
                }
                for step in others {
                    let agent = turn.agent(&step.next);
                    self.next.push_other(&agent, turned_last(step.next_last_action), step.task);
                }
                for (task, step) in (0..).zip(sample.buildings) {
                    self.next.push_building(&turn.building(&step.next), task);
                }
                self.next.end_team();
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

    fn descend(&mut self, networks: Networks<'_>, batch: usize) {
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
                self.d_utilities[place] = 2.0 * error / batch as f32;
            }
        }
        self.gradient.fill(0.0);
        let input = self.now.input();
        self.pass.backward(networks.online, input, &self.d_utilities, &mut self.gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::gradient_check::assert_gradient;
    use crate::methods::alma::{Config, EpisodeCounts, Record, RecordLayout, Rollout};
    use crate::random::{Purpose, generator};
    use sortie_envs::save_the_city::ACTIONS;

    const BATCH: usize = 40;

    fn network(seed: u64) -> UtilityNetwork {
        let shape = UtilityShape { width: 8, base: 6, ..Config::default().network.shape(ACTIONS) };
        UtilityNetwork::initialise(shape, 8.0, &mut generator(seed, Purpose::Weights, 0))
    }

    fn replay() -> Replay {
        let mut config = Config::default();
        config.allocation.heuristic = 1.0;
        let mut rollout = Rollout::new(&config, network(1).shape(), 3).unwrap();
        let mut replay = Replay::new(10_000, RecordLayout { agents: 5, buildings: 1 });
        for _ in 0..60 {
            rollout.step(&network(1), 1.0, &mut replay, &mut EpisodeCounts::default()).unwrap();
        }
        replay
    }

    fn picks(replay: &Replay, symmetry: impl Fn(usize) -> u8) -> Vec<Pick> {
        let record = |i| (i * (replay.len() / BATCH)) as u32;
        (0..BATCH).map(|i| Pick { record: record(i), symmetry: symmetry(i) }).collect()
    }

    #[test]
    fn the_gradient_of_the_whole_loss_agrees_with_finite_differences() {
        let (replay, online, target) = (replay(), network(1), network(2));
        let picks = picks(&replay, |i| (i % 8) as u8);
        let bootstraps = |pick: &Pick| replay.get(pick.record as usize).record.discount > 0.0;
        assert!(picks.iter().any(bootstraps) && !picks.iter().all(bootstraps));

        let loss = |parameters: &[f32]| {
            let online = UtilityNetwork::from_parameters(online.shape(), parameters.to_vec());
            let networks = Networks { online: &online.unwrap(), target: &target };
            let mut chunk = Chunk::new(target.shape());
            chunk.learn(networks, &replay, &picks, BATCH);
            chunk.squared_error() / BATCH as f64
        };
        let mut chunk = Chunk::new(online.shape());
        chunk.learn(Networks { online: &online, target: &target }, &replay, &picks, BATCH);
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
        let networks = Networks { online: &online, target: &target };
        let picks = picks(&replay, |_| 0);
        let mut whole = Chunk::new(online.shape());
        whole.learn(networks, &replay, &picks, BATCH);
        let mut sum = vec![0.0; online.shape().parameters()];
        let mut chunk = Chunk::new(online.shape());
        for part in picks.chunks(7) {
            chunk.learn(networks, &replay, part, BATCH);
            sum.iter_mut().zip(chunk.gradient()).for_each(|(sum, part)| *sum += part);
        }
        for (sum, whole) in sum.iter().zip(whole.gradient()) {
            assert!((sum - whole).abs() < 1e-4, "{sum} against {whole}");
        }
    }

    #[test]
    fn a_record_without_discount_learns_its_reward_alone() {
        let (mut replay, online) = (replay(), network(1));
        let first = replay.get(0);
        let record = Record::new(first.record.reward, 0.0, first.record.size.into());
        let (agents, buildings) = (first.agents.to_vec(), first.buildings.to_vec());
        replay.push(record, agents, buildings);
        let last = Pick { record: replay.len() as u32 - 1, symmetry: 0 };
        let error = |target: &UtilityNetwork| {
            let mut chunk = Chunk::new(online.shape());
            chunk.learn(Networks { online: &online, target }, &replay, &[last], 1);
            chunk.squared_error()
        };
        assert_eq!(error(&network(2)), error(&network(3)));
    }
}
