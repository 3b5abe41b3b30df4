//! A run that learns the allocator.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::ScenarioSet;

use super::config::TeamValueConfig;
use super::learner::TeamValueLearner;
use super::rollout::{Behaviour, TeamValueRollout};
use super::search::TeamValueAllocator;
use super::segments::Segments;
use crate::error::LearnError;
use crate::evaluate::{Evaluation, EvaluationPlan, NetworkTeam, evaluate};
use crate::methods::alma::UtilityNetwork;
use crate::random::{Generator, Purpose, generator};

/// Tells the streams of the allocator from those of the agents.
const STREAM: u64 = 1;

/// What one evaluation during training found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TeamValuePoint {
    /// Decisions made.
    pub decisions: u64,
    /// Environment steps taken.
    pub env_steps: u64,
    /// Optimiser steps taken.
    pub updates: u64,
    /// Share of greedy episodes with all buildings complete, allocated by the averaged weights.
    pub success: f64,
    /// 95 % Wilson interval of the success.
    pub success_ci95: [f64; 2],
    /// Share of those episodes that ran out of time.
    pub timeouts: f64,
    /// Mean loss of the updates since the last point.
    pub loss: f64,
}

/// Learns a team-value network for agents that learn no more and act greedily.
#[derive(Debug)]
pub struct TeamValueTrainer<'a> {
    config: TeamValueConfig,
    seed: u64,
    agents: &'a UtilityNetwork,
    learner: TeamValueLearner,
    rollout: TeamValueRollout<'a>,
    replay: Segments,
    picks: Generator,
    decisions: u64,
    env_steps: u64,
    updates: u64,
    /// Sum and number of the losses since the last point.
    losses: (f64, u64),
}

impl<'a> TeamValueTrainer<'a> {
    /// Begins a run with the agents' network, which stays as it is.
    pub fn new(
        config: TeamValueConfig,
        seed: u64,
        agents: &'a UtilityNetwork,
    ) -> Result<Self, LearnError> {
        config.check()?;
        let mut weights = generator(seed, Purpose::Weights, STREAM);
        let inputs = config.network.active_inputs;
        let online = UtilityNetwork::initialise(config.shape(), inputs, &mut weights);
        Ok(Self {
            learner: TeamValueLearner::new(&config, online),
            rollout: TeamValueRollout::new(&config, agents, seed)?,
            replay: Segments::new(config.replay.capacity),
            picks: generator(seed, Purpose::Replay, STREAM),
            config,
            seed,
            agents,
            decisions: 0,
            env_steps: 0,
            updates: 0,
            losses: (0.0, 0),
        })
    }

    /// The averaged weights: what is measured and shipped.
    pub fn network(&self) -> &UtilityNetwork {
        &self.learner.average
    }

    /// Learns until all decisions are made; `evaluated` is told every point of the curve.
    pub fn run(&mut self, mut evaluated: impl FnMut(&TeamValuePoint)) -> Result<(), LearnError> {
        let mut next_evaluation = self.config.run.evaluate_every;
        while self.decisions < self.config.run.decisions {
            self.step()?;
            if self.decisions >= next_evaluation {
                next_evaluation += self.config.run.evaluate_every;
                evaluated(&self.point()?);
            }
        }
        Ok(())
    }

    /// One step in every instance, and the updates that are due.
    pub fn step(&mut self) -> Result<(), LearnError> {
        let behaviour = if self.decisions < self.config.behaviour.rule_decisions {
            Behaviour::Rules
        } else {
            Behaviour::Network(&self.learner.online)
        };
        let before = self.decisions;
        self.decisions += self.rollout.step(behaviour, &mut self.replay)?;
        self.env_steps += self.rollout.instances() as u64;
        if self.replay.len() < self.config.replay.warm_up {
            return Ok(());
        }
        let pause = self.config.replay.decisions_per_update;
        for _ in before / pause..self.decisions / pause {
            let report = self.learner.update(&self.replay, &mut self.picks, self.decisions);
            self.updates += 1;
            self.losses = (self.losses.0 + report.loss, self.losses.1 + 1);
        }
        Ok(())
    }

    /// So many episodes of a seed in the world of this run.
    pub fn plan(&self, episodes: usize, seed: u64) -> Result<EvaluationPlan, LearnError> {
        Ok(EvaluationPlan {
            set: ScenarioSet::named(&self.config.environment.set)?,
            constants: self.config.environment.constants,
            interval: self.config.decisions.interval,
            episodes,
            seed,
        })
    }

    /// Measures the averaged weights.
    pub fn evaluate(&self, plan: &EvaluationPlan) -> Result<Evaluation, LearnError> {
        let mut allocator = TeamValueAllocator::new(self.network(), self.config.decisions.team_max);
        evaluate(plan, &mut NetworkTeam::new(self.agents), &mut allocator)
    }

    fn point(&mut self) -> Result<TeamValuePoint, LearnError> {
        // Counted from the top, so that ordinary seeds remain fresh for later evaluations.
        let plan = self.plan(self.config.run.evaluate_episodes, u64::MAX - self.seed)?;
        let result = self.evaluate(&plan)?;
        let (sum, count) = std::mem::take(&mut self.losses);
        Ok(TeamValuePoint {
            decisions: self.decisions,
            env_steps: self.env_steps,
            updates: self.updates,
            success: result.success,
            success_ci95: result.success_ci95,
            timeouts: result.timeouts,
            loss: sum / count.max(1) as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::alma::Config;
    use sortie_envs::save_the_city::ACTIONS;

    #[test]
    fn a_run_repeats_and_reports_its_curve() {
        let mut weights = generator(1, Purpose::Weights, 0);
        let shape = Config::default().network.shape(ACTIONS);
        let agents = UtilityNetwork::initialise(shape, 8.0, &mut weights);
        let config = TeamValueConfig::from_toml(
            "[network]\nwidth = 8\nbase = 8\n[behaviour]\nrule_decisions = 60\n\
             [replay]\nbatch = 8\nwarm_up = 20\n\
             [run]\ndecisions = 200\nevaluate_every = 100\nevaluate_episodes = 4\n",
        )
        .unwrap();
        let run = |seed| {
            let mut trainer = TeamValueTrainer::new(config.clone(), seed, &agents).unwrap();
            let mut curve = Vec::new();
            trainer.run(|point| curve.push(point.clone())).unwrap();
            (trainer.network().clone(), curve)
        };
        let (network, curve) = run(1);
        assert_eq!(curve.len(), 2);
        assert!(curve[1].decisions >= 200 && curve[1].updates > 30, "{curve:?}");
        assert!(curve[1].loss > 0.0 && curve[1].loss.is_finite());
        assert_eq!((network.clone(), curve), run(1));
        assert_ne!(network, run(2).0);
    }
}
