//! Agents that act by their policy: as it draws, or the best that they know.

use sortie_envs::{ActionSet, members};
use sortie_learn::networks::best;
use sortie_learn::{Act, Ask, LearnError, Scenes};
use sortie_nn::tape::Tape;

use super::networks::{Network, Shown};

/// Buffers for the decisions of any number of teams at once.
#[derive(Debug, Default)]
pub(super) struct Acting {
    shown: Shown,
    tape: Tape,
}

impl Acting {
    /// Writes `[scenes, A]` actions, each of them chosen by an agent's scores, what is available to it, and its instance.
    pub(super) fn act(
        &mut self,
        (actor, weights): (&Network, &[f32]),
        scenes: &Scenes<'_>,
        actions: &mut [u16],
        mut choose: impl FnMut(&[f32], ActionSet, usize) -> usize,
    ) {
        let Self { shown, tape } = self;
        let team = scenes.environment.spec().shape.agents;
        let mut due = Vec::new();
        shown.clear();
        for (place, scene) in scenes.scenes.iter().enumerate() {
            let acting = shown.push(scenes.environment, scene.state);
            let actions = &mut actions[place * team..][..team];
            // Who does not act has nothing to choose from.
            let open = shown.latest().iter().map(|open| open.trailing_zeros() as u16);
            actions.iter_mut().zip(open).for_each(|(action, open)| *action = open);
            let chooses = |agent| (place * team + agent, scene.instance);
            due.extend(members(acting.into()).map(chooses));
        }
        if due.is_empty() {
            return;
        }
        shown.finish(scenes.environment.spec());
        let mut pass = tape.begin(weights);
        let scores = actor.numbers(&mut pass, shown);
        let rows = pass.values(scores).chunks_exact(pass.size(scores)[1]);
        for ((scores, open), (place, instance)) in rows.zip(shown.available()).zip(due) {
            actions[place] = choose(scores, *open, instance) as u16;
        }
    }
}

/// Agents that take the best action that they know.
#[derive(Debug)]
pub(super) struct Greedy<'a> {
    /// The actor and its weights.
    pub(super) network: (&'a Network, &'a [f32]),
    pub(super) acting: Acting,
}

impl Act for Greedy<'_> {
    fn act(&mut self, Ask { scenes, actions, .. }: Ask<'_>) -> Result<(), LearnError> {
        self.acting.act(self.network, scenes, actions, |scores, open, _| best(scores, open));
        Ok(())
    }
}
