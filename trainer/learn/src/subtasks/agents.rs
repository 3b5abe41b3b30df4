//! Agents under an allocation that do not learn: a deployed policy, and an environment's script.

use sortie_core::policy::{NO_ACTION as NO_ACTION_YET, Observation, Policy, visible};
use sortie_core::{DecideError, EntityMask};
use sortie_envs::{Random, UNASSIGNED, deployed_tasks};

use super::allocators::tell_allocation;
use super::{Agents, AllocatedScene, NO_ACTION};
use crate::act::{Shown, mask, write_actions};
use crate::error::{LearnError, Result};
use crate::random::{Purpose, generator};

/// What the agents of a scene are shown under the subtask mask: a row for every entity, as in frames, of which each sees those
/// that are there and of its own subtask (dissertation section 7.3).
#[derive(Clone, Debug, Default)]
pub struct MaskedViews {
    shown: Shown,
    present: EntityMask,
    last_actions: Vec<u16>,
    entity_task: Vec<u32>,
    subtasks: Vec<Option<u8>>,
}

impl MaskedViews {
    /// Lays out what a scene shows.
    pub fn look(&mut self, scene: &AllocatedScene<'_>) {
        let (seen, agents) = (scene.seen, scene.seen.agents());
        self.shown.look(seen, scene.environment.spec().shape);
        self.present = mask(seen.present);
        let widen =
            |action: &u8| if *action == NO_ACTION { NO_ACTION_YET } else { (*action).into() };
        self.last_actions.clear();
        self.last_actions.extend(scene.last_actions[..agents].iter().map(widen));
        self.entity_task.clear();
        self.entity_task.extend(seen.entity_task.iter().copied().map(deployed_tasks));
        tell_allocation(&mut self.entity_task, &scene.allocation[..agents]);
        let subtask = |task: &u8| (*task != UNASSIGNED).then_some(*task);
        self.subtasks.clear();
        self.subtasks.extend(scene.allocation[..agents].iter().map(subtask));
    }

    /// What each agent sees, in their order.
    pub fn observations(&self) -> impl Iterator<Item = Observation<'_>> {
        self.subtasks.iter().enumerate().map(|(agent, subtask)| {
            let visible = visible(self.present, self.present, &self.entity_task, *subtask);
            self.shown.to(agent, visible, &self.last_actions)
        })
    }
}

/// A deployed policy under the subtask mask, agent by agent, on what each of them would see.
#[derive(Debug)]
pub struct PolicyAgents<P> {
    policy: P,
    views: MaskedViews,
}

impl<P: Policy> PolicyAgents<P> {
    /// Acts by a policy.
    pub fn new(policy: P) -> Self {
        Self { policy, views: MaskedViews::default() }
    }
}

impl<P: Policy> Agents for PolicyAgents<P> {
    fn act(
        &mut self,
        scenes: &[AllocatedScene<'_>],
        actions: &mut [u16],
        slots: usize,
    ) -> Result<()> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(slots)) {
            self.views.look(scene);
            let observations: Vec<Observation<'_>> = self.views.observations().collect();
            let mut decisions = vec![Err(DecideError::BadLength); observations.len()];
            self.policy.decide_batch(&observations, &mut decisions);
            write_actions(actions, decisions)?;
        }
        Ok(())
    }
}

/// The script of an environment.
#[derive(Debug)]
pub struct ScriptedAgents {
    random: Random,
}

impl ScriptedAgents {
    /// A script that breaks ties by a seed.
    pub fn new(seed: u64) -> Self {
        Self { random: generator(seed, Purpose::Evaluation, u64::MAX) }
    }
}

impl Agents for ScriptedAgents {
    fn act(
        &mut self,
        scenes: &[AllocatedScene<'_>],
        actions: &mut [u16],
        slots: usize,
    ) -> Result<()> {
        for (scene, actions) in scenes.iter().zip(actions.chunks_exact_mut(slots)) {
            let AllocatedScene { environment, state, allocation, .. } = *scene;
            if !environment.scripted(state, allocation, &mut self.random, actions) {
                let name = &environment.spec().name;
                let reason =
                    format!("`{name}` has no scripted team: name a bundle or a training run");
                return Err(LearnError::Misfit(reason));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::evaluate::Evaluation;
    use crate::play::evaluate;
    use crate::subtasks::{AllocatedTeam, RuleAllocator};
    use sortie_envs::save_the_city::{Scenario, ScenarioSet};
    use sortie_envs::{DecisionPoints, Split};

    /// What the script of a city comes to under a rule.
    fn measured(set: &str, split: Split, episodes: usize, rule: &'static str) -> Evaluation {
        let name = format!("save-the-city/{set}");
        let city = sortie_envs::open(&name, split, 1, &Default::default()).unwrap();
        let agents = Box::new(ScriptedAgents::new(1));
        let interval = DecisionPoints::ACTION_LENGTH;
        let mut team = AllocatedTeam::new(agents, Box::new(RuleAllocator(rule)), interval);
        evaluate(&*city, &mut team, episodes, 11).unwrap()
    }

    #[test]
    fn the_scripted_team_reaches_its_known_level() {
        let coordinated = measured("2-5a_2-5b", Split::Test, 1000, "coordinated");
        assert!((0.68..0.82).contains(&coordinated.success), "{coordinated:?}");
        let heuristic = measured("2-5a_2-5b", Split::Test, 1000, "heuristic");
        assert!((0.44..0.56).contains(&heuristic.success), "{heuristic:?}");
        assert_eq!(coordinated.by_team.len(), 13);
        assert_eq!(coordinated.by_team.values().map(|team| team.episodes).sum::<usize>(), 1000);
        let failed: usize = heuristic.failures.values().sum();
        assert_eq!(
            failed,
            heuristic.by_team.values().map(|t| t.episodes - t.solved).sum::<usize>()
        );
        let burned = heuristic.failures.iter().filter(|(cause, _)| cause.starts_with("burned"));
        let burned: usize = burned.map(|(_, count)| count).sum();
        assert_eq!(burned as f64, (1000.0 * (1.0 - heuristic.metrics["none_burned"])).round());
        let [low, high] = coordinated.success_ci95;
        assert!(low < coordinated.success && coordinated.success < high);
    }

    /// Whatever list the environment was opened for.
    #[test]
    fn a_team_is_measured_on_the_test_list_of_scenarios() {
        let measured = measured("2-8a_2-8b_sim_Q1", Split::Train, 100, "heuristic");
        let letters =
            |scenario: &Scenario| scenario.team.iter().map(|kind| kind.letter()).collect();
        let set = ScenarioSet::named("2-8a_2-8b_sim_Q1").unwrap();
        let teams: BTreeSet<String> = set.test.iter().map(letters).collect();
        assert_eq!(measured.by_team.into_keys().collect::<BTreeSet<_>>(), teams);
    }

    #[test]
    fn an_evaluation_repeats() {
        let run = || measured("2-5a_2-5b", Split::Test, 100, "random");
        assert_eq!(run(), run());
    }

    #[test]
    fn rules_that_there_are_not_are_named() {
        let city = sortie_envs::open("save-the-city", Split::Test, 1, &Default::default()).unwrap();
        let agents = Box::new(ScriptedAgents::new(1));
        let mut team = AllocatedTeam::new(agents, Box::new(RuleAllocator("nearest")), 5);
        let error = evaluate(&*city, &mut team, 1, 1).unwrap_err().to_string();
        assert!(error.contains("no rule `nearest`") && error.contains("`coordinated`"), "{error}");
    }
}
