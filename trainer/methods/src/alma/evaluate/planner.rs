//! A planner as yardstick: how much better could the allocation be with the same team?
//!
//! At each decision the allocator's choice is played to the end in a copy of the world. Where that does
//! not solve the episode, randomly changed allocations are played as well and the best is taken. This
//! needs the exact simulator and reads what agents cannot see (the ignition clocks), so it bounds
//! learned allocators and is none. What is left to chance, who yields a cell and what a team draws, is
//! drawn anew: the planner does not know what will happen, only what may.

use rand_core::{Rng, SeedableRng};
use serde::Serialize;
use sortie_envs::random::{chance, member};
use sortie_envs::{Environment, Observation};
use sortie_learn::LearnError;
use sortie_learn::random::{Purpose, generator};
use sortie_nn::random::Generator;

use super::{EvaluationPlan, Worlds};
use crate::alma::teams::{Allocate, Situation, Team};

/// Share of the agents that a candidate sends elsewhere.
const MOVED: f64 = 0.3;

/// What a planner did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlannerReport {
    /// Changed allocations tried where the allocator's own is not solved in simulation.
    pub candidates: usize,
    /// Always true: results of a planner are not those of a learned policy.
    pub uses_simulator: bool,
    /// Decisions made.
    pub decisions: u64,
    /// Those for which candidates were tried.
    pub searched: u64,
    /// Those in which a candidate replaced the allocator's choice.
    pub changed: u64,
}

/// How a simulated rest of an episode ends; larger is better.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
struct Rest {
    solved: bool,
    rewards: f64,
}

/// An allocator that looks ahead with the simulator.
pub struct Planner<'a> {
    base: &'a mut dyn Allocate,
    worlds: Worlds,
    generator: Generator,
    report: PlannerReport,
}

impl<'a> Planner<'a> {
    /// Improves the decisions of `base`, in the worlds of a plan, by up to `candidates` others each.
    pub fn new(plan: &EvaluationPlan<'_>, base: &'a mut dyn Allocate, candidates: usize) -> Self {
        let report = PlannerReport {
            candidates,
            uses_simulator: true,
            decisions: 0,
            searched: 0,
            changed: 0,
        };
        Self {
            base,
            worlds: Worlds::new(plan, candidates.max(1)),
            generator: generator(plan.seed, Purpose::Planning, 0),
            report,
        }
    }

    /// What was done so far.
    pub fn report(&self) -> PlannerReport {
        self.report
    }

    /// Plays each allocation to the end; later decisions are the base's.
    fn simulate(
        &mut self,
        situation: Situation<'_>,
        allocations: &[Vec<u8>],
        team: &mut dyn Team,
    ) -> Result<Vec<Rest>, LearnError> {
        let Situation { state, last_actions, .. } = situation;
        self.worlds.clear();
        for (index, allocation) in allocations.iter().enumerate() {
            let random = sortie_envs::random::generator(self.generator.next_u64());
            self.worlds.environment.load(index, state).map_err(LearnError::environment)?;
            let own = Generator::seed_from_u64(self.generator.next_u64());
            self.worlds.begin(index, random, own);
            self.worlds.decided(index, last_actions, allocation, team)?;
        }
        while !self.worlds.active().is_empty() {
            self.worlds.choose(team, self.base)?;
            for place in 0..self.worlds.active().len() {
                self.worlds.advance(place)?;
            }
            self.worlds.retire();
        }
        let rest = |index| {
            let solved = self.worlds.environment.episode(index).solved;
            Rest { solved, rewards: self.worlds.earned(index) }
        };
        Ok((0..allocations.len()).map(rest).collect())
    }

    /// The allocation with some agents sent to other open subtasks.
    fn changed(&mut self, seen: &Observation, allocation: &[u8]) -> Vec<u8> {
        let mut changed = allocation.to_vec();
        for task in &mut changed[..seen.agents()] {
            if chance(&mut self.generator, MOVED)
                && let Some(open) = member(&mut self.generator, seen.open_tasks.into())
            {
                *task = open as u8;
            }
        }
        changed
    }
}

impl Allocate for Planner<'_> {
    /// The base's choice: without the simulator there is nothing to plan with.
    fn allocate(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        self.base.allocate(environment, state, generator, allocation)
    }

    fn decide(
        &mut self,
        situation: Situation<'_>,
        team: &mut dyn Team,
        generator: &mut Generator,
        allocation: &mut [u8],
    ) -> Result<(), LearnError> {
        let Situation { environment, state, .. } = situation;
        self.base.allocate(environment, state, generator, allocation)?;
        self.report.decisions += 1;
        let [own] = self.simulate(situation, &[allocation.to_vec()], team)?[..] else {
            return Ok(());
        };
        if own.solved {
            return Ok(());
        }
        self.report.searched += 1;
        let mut seen = Observation::default();
        environment.observe(state, 0, 0, &mut seen);
        let count = self.report.candidates;
        let candidates: Vec<_> = (0..count).map(|_| self.changed(&seen, allocation)).collect();
        let mut best = own;
        for (rest, candidate) in
            self.simulate(situation, &candidates, team)?.into_iter().zip(&candidates)
        {
            if rest > best {
                best = rest;
                allocation.copy_from_slice(candidate);
            }
        }
        self.report.changed += u64::from(best > own);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alma::evaluate::evaluate;
    use crate::alma::teams::{RuleAllocator, ScriptedActors};
    use sortie_envs::Split;
    use sortie_learn::evaluate::Evaluation;

    const EPISODES: usize = 100;

    fn with_plan<T>(measure: impl FnOnce(&EvaluationPlan<'_>) -> T) -> T {
        let environment =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        measure(&EvaluationPlan::new(&*environment.unwrap(), EPISODES, 5))
    }

    fn planned(candidates: usize) -> (Evaluation, PlannerReport) {
        with_plan(|plan| {
            let mut base = RuleAllocator("heuristic");
            let mut planner = Planner::new(plan, &mut base, candidates);
            let evaluation = evaluate(plan, &mut ScriptedActors::new(1), &mut planner).unwrap();
            (evaluation, planner.report())
        })
    }

    #[test]
    fn looking_ahead_beats_the_allocator_on_the_same_episodes() {
        let mut team = ScriptedActors::new(1);
        let base =
            with_plan(|plan| evaluate(plan, &mut team, &mut RuleAllocator("heuristic")).unwrap());
        let (planned, report) = planned(8);
        assert!(planned.success > base.success + 0.1, "{} {}", planned.success, base.success);
        assert!(planned.return_mean > base.return_mean);
        assert!(0 < report.changed && report.changed <= report.searched);
        assert!(report.searched < report.decisions && report.uses_simulator);
    }

    #[test]
    fn a_planner_repeats() {
        assert_eq!(planned(2), planned(2));
    }
}
