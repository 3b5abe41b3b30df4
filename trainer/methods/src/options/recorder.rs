//! Agents at work that are learned from: what they do is kept, option by option.

use sortie_learn::{LearnError, Scene, State, Transition};

use super::play::{Player, Running};
use super::replay::{End, Finished, Moment, NONE, Place, Replay};
use crate::pictures::Shown;

/// Agents at work, and what is kept of what they did.
#[derive(Debug)]
pub(crate) struct Recorder {
    pub(crate) player: Player,
    pub(crate) replay: Replay,
    /// The first step of the running option of each instance.
    started: Vec<Option<Place>>,
}

impl Recorder {
    pub(crate) fn new(instances: usize, replay: Replay) -> Self {
        Self { player: Player::default(), replay, started: vec![None; instances] }
    }

    /// Keeps a step, and the option that is over behind it, if one is.
    pub(crate) fn record(
        &mut self,
        transition: &Transition<'_>,
        shown: &Shown,
        option_steps: u8,
    ) -> Option<Finished> {
        let Transition { environment, instance, step, .. } = *transition;
        let reached = environment.milestone(instance).map_or(NONE, |milestone| milestone as u8);
        let running = self.player.running[instance].clone();
        let before = self.player.seen[instance].rows.clone();
        let state = std::mem::take(&mut self.player.shown[instance]);
        let scene = Scene { instance, state: transition.next, begins: false, tasks_changed: false };
        self.player.look(shown, environment, &scene);
        let over = running.steps >= option_steps;
        let ends_option = reached != NONE || over || step.done();
        let moment = Moment {
            action: transition.actions[0] as u8,
            goal: running.goal,
            reached,
            option_reached: NONE,
            changed_nothing: reached == NONE && before == self.player.seen[instance].rows,
            ends_option,
            terminated: step.terminated,
            is_last: false,
        };
        let place = self.replay.push(instance, &state, moment);
        let start = *self.started[instance].get_or_insert(place);
        if !ends_option {
            return None;
        }
        self.started[instance] = None;
        self.player.running[instance].is_over = true;
        let end = match step {
            _ if step.terminated => End::Terminated,
            _ if step.timed_out => End::TimedOut,
            _ => End::GoesOn,
        };
        if step.done() {
            let last = Moment { is_last: true, ..moment };
            self.replay.push(instance, &self.player.shown[instance], last);
        }
        let Running { goal, steps, mask, .. } = running;
        let option = Finished { start, steps, goal, reached, mask, end };
        self.replay.finish(option);
        Some(option)
    }

    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        self.replay.state(state)?;
        state.value("running", &mut self.player.running)?;
        state.value("started", &mut self.started)
    }
}
