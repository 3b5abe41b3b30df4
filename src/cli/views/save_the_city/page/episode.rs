//! Where an episode comes from: played now, or recorded before.

use std::path::Path;

use sortie_envs::save_the_city::MAX_AGENTS;
use sortie_envs::save_the_city::golden::{self, Playback};
use sortie_envs::{DecisionPoints, EntitySet, Environment, Observation, UNASSIGNED};
use sortie_learn::play::{Onlooker, Watched};
use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::agents::NO_ACTION;
use sortie_methods::alma::evaluate::{EvaluationPlan, watch_last_episode};
use sortie_methods::alma::teams::{Allocate, Scene, Team};
use sortie_nn::random::Generator;

use crate::failure::Failure;
use crate::replay;

/// An episode that a team goes through while somebody watches.
pub(super) trait Episode {
    /// Asks `team` in every state and tells `onlooker` what happens.
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure>;
}

/// An episode that the team itself plays: the last one of a plan.
pub(super) struct Played<'a> {
    pub(super) plan: &'a EvaluationPlan<'a>,
    pub(super) allocator: &'a mut dyn Allocate,
}

impl Episode for Played<'_> {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        Ok(watch_last_episode(self.plan, team, self.allocator, onlooker)?)
    }
}

/// A recorded episode: its actions stand, whatever the team that is asked would do.
pub(super) struct Replayed<'a> {
    pub(super) playback: &'a mut Playback,
    /// Who assigned the agents, which recordings do not hold.
    pub(super) allocator: Option<&'a mut dyn Allocate>,
}

/// Reads a recording and checks that it replays bit for bit.
pub(super) fn open_recording(file: &Path, text: &str) -> Result<Playback, Failure> {
    let name = file.display().to_string();
    let unreadable = |error| replay::unreadable(error).within(&name);
    let replayed = golden::replay(&name, text).map_err(unreadable)?;
    match replayed.mismatches.first() {
        Some(first) => Err(replay::difference(first, replayed.mismatches.len())),
        None => Playback::new(text).map_err(unreadable),
    }
}

fn watched(playback: &Playback) -> Watched<'_> {
    Watched { episode: 0, worlds: playback.world(), instance: 0 }
}

impl Episode for Replayed<'_> {
    fn play(&mut self, team: &mut dyn Team, onlooker: &mut dyn Onlooker) -> Result<(), Failure> {
        onlooker.started(watched(self.playback))?;
        let mut decisions = DecisionPoints::default();
        let mut tasks_changed = false;
        let mut seen = Observation::default();
        let mut allocation = [UNASSIGNED; MAX_AGENTS];
        let mut last_actions = [NO_ACTION; MAX_AGENTS];
        // No allocator that can be asked again draws from it.
        let mut unused: Generator = generator(0, Purpose::Evaluation, 0);
        while let Some(actions) = self.playback.next_actions().map(<[u16]>::to_vec) {
            let environment: &dyn Environment = self.playback.world();
            let mut state = Vec::new();
            environment.save(0, &mut state);
            environment.observe(&state, 0, EntitySet::MAX, &mut seen);
            let due = decisions.is_due(tasks_changed);
            if let Some(allocator) = self.allocator.as_mut().filter(|_| due) {
                allocator.allocate(environment, &state, &mut unused, &mut allocation)?;
            }
            let scene = Scene {
                world: 0,
                environment,
                state: &state,
                seen: &seen,
                allocation: &allocation,
                last_actions: &last_actions,
                strategies: &[],
            };
            team.act(&[scene], &mut [0; MAX_AGENTS], MAX_AGENTS)?;
            let Some(outcome) = self.playback.step().map_err(Failure::bug)? else { break };
            onlooker.stepped(watched(self.playback), &actions, &outcome)?;
            for (last, action) in last_actions.iter_mut().zip(&actions) {
                *last = *action as u8;
            }
            tasks_changed = outcome.tasks_changed;
        }
        Ok(())
    }
}
