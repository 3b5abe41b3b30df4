//! A planner as yardstick: how much better could the allocation be with the same agents?
//!
//! At each decision the allocator's choice is played to the end in a copy of the world. Where that does
//! not solve the episode, randomly changed allocations are played as well and the best is taken. This
//! needs the exact simulator and reads what agents cannot see, so it bounds learned allocators and is
//! none. What is left to chance, who yields a cell and what a team draws, is drawn anew: the planner does
//! not know what will happen, only what may.

use rand_core::Rng;
use serde::Serialize;
use sortie_envs::random::{chance, generator, member};
use sortie_envs::{Environment, Random, Split};

use super::episodes::{WORLDS, finish};
use crate::act::{Act, Ask, Scene};
use crate::error::{LearnError, Result};
use crate::random::{Purpose, generator as stream};
use crate::subtasks::AllocatedTeam;

/// Share of the agents that a candidate sends elsewhere.
const MOVED: f64 = 0.3;

/// What a planner did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
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

/// A team whose allocations are improved by looking ahead with the simulator.
pub struct Planner<'a> {
    team: AllocatedTeam<'a>,
    /// Simulated episodes run in the instances from [`WORLDS`] on, since what the team remembers goes by their number.
    worlds: Box<dyn Environment>,
    random: Random,
    report: PlannerReport,
}

impl<'a> Planner<'a> {
    /// Improves the decisions of a team that plays in such an environment, by up to `candidates` others each.
    pub fn new(
        team: AllocatedTeam<'a>,
        environment: &dyn Environment,
        candidates: usize,
        seed: u64,
    ) -> Self {
        let report = PlannerReport { candidates, uses_simulator: true, ..PlannerReport::default() };
        let worlds = environment.open(WORLDS + candidates.max(1), Split::Test);
        Self { team, worlds, random: stream(seed, Purpose::Planning, 0), report }
    }

    /// What was done so far.
    pub fn report(&self) -> PlannerReport {
        self.report
    }

    /// Replaces the allocation that was just decided by a better one, if one is found.
    fn improve(&mut self, scene: &Scene<'_>) -> Result<()> {
        let allocation = self.team.allocation(scene.instance).to_vec();
        self.report.decisions += 1;
        let [own] = self.simulate(scene, std::slice::from_ref(&allocation))?[..] else {
            return Ok(());
        };
        if own.solved {
            return Ok(());
        }
        self.report.searched += 1;
        let candidates: Vec<Vec<u8>> = (0..self.report.candidates)
            .map(|_| self.changed(scene.instance, &allocation))
            .collect();
        let rests = self.simulate(scene, &candidates)?;
        if let Some(best) = best_of(&rests, own) {
            let place = self.team.places.of_mut(scene.instance);
            place.allocation.copy_from_slice(&candidates[best]);
            self.report.changed += 1;
        }
        Ok(())
    }

    /// Plays each allocation to the end; later decisions are the team's own.
    fn simulate(&mut self, scene: &Scene<'_>, allocations: &[Vec<u8>]) -> Result<Vec<Rest>> {
        let (mut starts, mut random) = (Vec::new(), vec![generator(0); WORLDS]);
        for (instance, allocation) in (WORLDS..).zip(allocations) {
            starts.push((instance, generator(self.random.next_u64())));
            random.push(generator(self.random.next_u64()));
            self.worlds.load(instance, scene.state).map_err(LearnError::environment)?;
            let place = self.team.places.copy(scene.instance, instance);
            place.allocation.copy_from_slice(allocation);
        }
        let earned = finish(&mut *self.worlds, &mut self.team, starts, &mut random)?;
        let solved = |instance| self.worlds.episode(instance).solved;
        let rest = |(instance, rewards)| Rest { solved: solved(instance), rewards };
        Ok((WORLDS..).zip(earned).map(rest).collect())
    }

    /// The allocation with some agents sent to other open subtasks.
    fn changed(&mut self, instance: usize, allocation: &[u8]) -> Vec<u8> {
        let seen = &self.team.places.of(instance).seen;
        let mut changed = allocation.to_vec();
        for task in &mut changed[..seen.agents()] {
            if chance(&mut self.random, MOVED)
                && let Some(open) = member(&mut self.random, seen.open_tasks)
            {
                *task = open as u8;
            }
        }
        changed
    }
}

/// The best of several rests, the first of equals, if it is better than one's own.
fn best_of(rests: &[Rest], own: Rest) -> Option<usize> {
    let mut best = (own, None);
    for (place, rest) in rests.iter().enumerate() {
        if *rest > best.0 {
            best = (*rest, Some(place));
        }
    }
    best.1
}

impl Act for Planner<'_> {
    fn act(&mut self, Ask { scenes, random, actions }: Ask<'_>) -> Result<()> {
        for scene in scenes.scenes {
            let random = &mut random[scene.instance];
            if self.team.decide(scenes.environment, scene, random)? {
                self.improve(scene)?;
            }
        }
        self.team.choose(scenes, actions)
    }

    fn allocation(&self, instance: usize) -> &[u8] {
        self.team.allocation(instance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::Evaluation;
    use crate::play::evaluate;
    use crate::subtasks::{RuleAllocator, ScriptedAgents};
    use sortie_envs::DecisionPoints;

    const EPISODES: usize = 100;

    fn city() -> Box<dyn Environment> {
        let opened =
            sortie_envs::open("save-the-city/2-5a_2-5b", Split::Test, 1, &Default::default());
        opened.unwrap()
    }

    fn scripted() -> AllocatedTeam<'static> {
        let agents = Box::new(ScriptedAgents::new(1));
        let rule = Box::new(RuleAllocator("heuristic"));
        AllocatedTeam::new(agents, rule, DecisionPoints::ACTION_LENGTH)
    }

    fn planned(candidates: usize) -> (Evaluation, PlannerReport) {
        let city = city();
        let mut planner = Planner::new(scripted(), &*city, candidates, 5);
        let evaluation = evaluate(&*city, &mut planner, EPISODES, 5).unwrap();
        (evaluation, planner.report())
    }

    #[test]
    fn looking_ahead_beats_the_allocator_on_the_same_episodes() {
        let base = evaluate(&*city(), &mut scripted(), EPISODES, 5).unwrap();
        let (planned, report) = planned(8);
        assert!(planned.success > base.success + 0.1, "{} {}", planned.success, base.success);
        assert!(planned.return_mean > base.return_mean);
        assert!(0 < report.changed && report.changed <= report.searched);
        assert!(report.searched < report.decisions && report.uses_simulator);
    }

    #[test]
    fn the_best_candidate_is_taken_where_it_is_better_than_what_was_decided() {
        let rest = |(solved, rewards)| Rest { solved, rewards };
        let best = |rests: &[(bool, f64)], own| {
            best_of(&rests.iter().copied().map(rest).collect::<Vec<_>>(), rest(own))
        };
        // Solved counts most; the best is not the last that is better, and of equals it is the first.
        let rests =
            [(false, 3.0), (true, 1.0), (true, 2.0), (true, 2.0), (false, 9.0), (true, 1.5)];
        assert_eq!(best(&rests, (false, 2.0)), Some(2));
        assert_eq!(best(&rests[..1], (false, 2.0)), Some(0));
        assert_eq!(best(&rests, (true, 2.0)), None);
        assert_eq!(best(&[], (false, 2.0)), None);
    }

    #[test]
    fn a_planner_repeats() {
        assert_eq!(planned(2), planned(2));
    }
}
