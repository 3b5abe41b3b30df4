//! Where an episode comes from: played now, or recorded before.

use std::path::Path;

use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_envs::save_the_city::golden::{self, Playback};
use sortie_envs::save_the_city::{AllocationRule, DecisionPoints, MAX_AGENTS, UNASSIGNED};
use sortie_learn::evaluate::{
    Allocate, EvaluationPlan, Onlooker, Scene, Team, Watched, watch_last_episode,
};
use sortie_learn::methods::alma::NO_ACTION;

use crate::failure::Failure;
use crate::replay;

/// An episode that a team goes through while somebody watches.
pub(super) trait Episode {
    /// Asks `team` in every state and tells `onlooker` what happens.
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure>;
}

/// An episode that the team itself plays: the last one of a plan.
pub(super) struct Played<'a> {
    pub(super) plan: &'a EvaluationPlan,
    pub(super) allocator: &'a mut dyn Allocate,
}

impl Episode for Played<'_> {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        Ok(watch_last_episode(self.plan, team, self.allocator, onlooker)?)
    }
}

/// A recorded episode: its actions stand, whatever the team that is asked would do.
pub(super) struct Recorded {
    playback: Playback,
    /// How the agents were assigned; recordings hold no allocation, but rules can be computed again.
    rule: Option<AllocationRule>,
}

impl Recorded {
    /// Reads a recording and checks that it replays bit for bit.
    pub(super) fn open(file: &Path) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(file).map_err(|error| Failure::file(file, &error))?;
        let name = file.display().to_string();
        let unreadable = |error| replay::unreadable(error).within(&name);
        let replayed = golden::replay(&name, &text).map_err(unreadable)?;
        if let Some(first) = replayed.mismatches.first() {
            return Err(replay::difference(first, replayed.mismatches.len()));
        }
        let playback = Playback::new(&text).map_err(unreadable)?;
        let rule = rule_of_label(&playback.labels().policy);
        Ok(Self { playback, rule })
    }

    /// The recording.
    pub(super) fn playback(&self) -> &Playback {
        &self.playback
    }

    /// The rule by which agents are assigned, if any.
    pub(super) fn rule(&self) -> Option<AllocationRule> {
        self.rule
    }

    /// Takes this rule, whatever the recording says.
    pub(super) fn set_rule(&mut self, rule: AllocationRule) {
        self.rule = Some(rule);
    }
}

/// The rule that `sortie eval --episodes-out` names in its recordings; random choices are lost.
fn rule_of_label(policy: &str) -> Option<AllocationRule> {
    let (_, allocation) = policy.rsplit_once(", ")?;
    match allocation.strip_suffix(" allocation")? {
        "coordinated" => Some(AllocationRule::Coordinated),
        "heuristic" => Some(AllocationRule::Heuristic),
        _ => None,
    }
}

fn watched(playback: &Playback) -> Watched<'_> {
    Watched { episode: 0, worlds: playback.world(), instance: 0 }
}

impl Episode for Recorded {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        onlooker.started(watched(&self.playback))?;
        let mut decisions = DecisionPoints::default();
        let mut tasks_changed = false;
        let mut allocation = [UNASSIGNED; MAX_AGENTS];
        let mut last_actions = [NO_ACTION; MAX_AGENTS];
        // No rule that can be computed again draws from it.
        let mut unused: Xoshiro256PlusPlus = sortie_envs::random::generator(0);
        while let Some(actions) = self.playback.next_actions().map(<[u16]>::to_vec) {
            let city = self.playback.world().city(0);
            let due = decisions.is_due(tasks_changed);
            if let Some(rule) = self.rule.filter(|_| due) {
                rule.allocate(city, &mut unused, &mut allocation);
            }
            let scene = Scene { city, allocation: &allocation, last_actions: &last_actions };
            team.act(&[scene], &mut [0; MAX_AGENTS], MAX_AGENTS)?;
            let Some(outcome) = self.playback.step().map_err(Failure::bug)? else { break };
            onlooker.stepped(watched(&self.playback), &actions, &outcome)?;
            for (last, action) in last_actions.iter_mut().zip(&actions) {
                *last = *action as u8;
            }
            tasks_changed = outcome.tasks_changed;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_own_recordings_name_their_rule() {
        let rule = |label| rule_of_label(label);
        assert_eq!(rule("runs/a, b, heuristic allocation"), Some(AllocationRule::Heuristic));
        assert_eq!(rule("scripted, coordinated allocation"), Some(AllocationRule::Coordinated));
        assert_eq!(rule("scripted, random allocation"), None);
        assert_eq!(rule("scripted"), None);
    }
}
