//! Agents that act by their policy: as it draws, or the best that they know.

use sortie_envs::random::unit;
use sortie_envs::{ActionSet, Environment, Random, members};
use sortie_learn::networks::best;
use sortie_learn::{Act, LearnError, Scenes};
use sortie_nn::layers::softmax;
use sortie_nn::tape::Tape;

use super::lesson::closed;
use super::networks::{Network, Shown};
use crate::actor_critic::groups::drawn;

/// Buffers for the decisions of any number of teams at once.
#[derive(Debug, Default)]
pub(super) struct Acting {
    shown: Shown,
    tape: Tape,
    /// The symmetry by which the agents of each instance see; the one that changes nothing where none is said.
    pub(super) turns: Vec<u8>,
}

impl Acting {
    /// Writes `[scenes, A]` actions: drawn by the policy and the generators of instances, or without these the best.
    pub(super) fn act(
        &mut self,
        (actor, weights): (&Network, &[f32]),
        scenes: &Scenes<'_>,
        mut random: Option<&mut [Random]>,
        actions: &mut [u16],
    ) {
        let agents = self.look(scenes, actions);
        if agents.is_empty() {
            return;
        }
        let Self { shown, tape, turns } = self;
        let mut pass = tape.begin(weights);
        let scores = actor.numbers(&mut pass, shown);
        let rows = pass.values(scores).chunks_exact(pass.size(scores)[1]);
        for ((scores, open), (place, instance)) in rows.zip(shown.available()).zip(agents) {
            let seen = match &mut random {
                Some(random) => draw(scores, *open, &mut random[instance]),
                None => best(scores, *open) as u32,
            };
            actions[place] = undone(scenes.environment, turn_of(turns, instance), seen);
        }
    }

    /// Looks at scenes, and has those do what they have to who cannot choose; returns whose decisions are due: where their
    /// actions stand, and their instances.
    fn look(&mut self, scenes: &Scenes<'_>, actions: &mut [u16]) -> Vec<(usize, usize)> {
        let Self { shown, turns, .. } = self;
        let environment = scenes.environment;
        let team = environment.spec().shape.agents;
        let mut due = Vec::new();
        shown.clear();
        for (place, scene) in scenes.scenes.iter().enumerate() {
            let turn = turn_of(turns, scene.instance);
            let acting = shown.push(environment, scene.state, turn);
            let agents = place * team..(place + 1) * team;
            for (action, open) in actions[agents.clone()].iter_mut().zip(shown.latest()) {
                *action = undone(environment, turn, open.trailing_zeros());
            }
            due.extend(members(acting.into()).map(|agent| (agents.start + agent, scene.instance)));
        }
        shown.finish(environment.spec());
        due
    }
}

fn turn_of(turns: &[u8], instance: usize) -> usize {
    turns.get(instance).map_or(0, |turn| usize::from(*turn))
}

/// The action that agents see as this one under a symmetry.
fn undone(environment: &dyn Environment, turn: usize, seen: u32) -> u16 {
    let actions = 0..environment.spec().shape.actions as u16;
    let is_it = |action: &u16| u32::from(environment.turned_action(turn, *action)) == seen;
    actions.into_iter().find(is_it).unwrap_or(seen as u16)
}

/// Draws one of the actions that are available by the softmax of their scores.
fn draw(scores: &[f32], open: ActionSet, random: &mut Random) -> u32 {
    let scores = scores.iter().enumerate();
    let mut chances: Vec<f32> =
        scores.map(|(action, score)| score + closed(open, action)).collect();
    softmax::forward(&mut chances);
    drawn(&chances, unit(random) as f32)
}

/// Agents that take the best action that they know.
#[derive(Debug)]
pub(super) struct Greedy<'a> {
    network: (&'a Network, &'a [f32]),
    acting: Acting,
}

impl<'a> Greedy<'a> {
    /// They act by these weights.
    pub(super) fn new(network: (&'a Network, &'a [f32])) -> Self {
        Self { network, acting: Acting::default() }
    }
}

impl Act for Greedy<'_> {
    fn act(
        &mut self,
        scenes: &Scenes<'_>,
        _: &mut [Random],
        actions: &mut [u16],
    ) -> Result<(), LearnError> {
        self.acting.act(self.network, scenes, None, actions);
        Ok(())
    }
}
