//! What agents see, do and earn while they learn; what an update sees of it, and what networks are shown of that.

use sortie_envs::{Observation, Random};
use sortie_learn::{LearnError, Scene, Scenes, State, Transition};

use super::acting::{Acting, Actors, Inputs, observe, observed, show};
use super::groups::Groups;
use super::replay::{Decision, Future, Outcome, Place, Replay};

/// How long decisions hold, and what they earn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rule {
    /// Steps that an action is held for.
    pub(crate) interval: usize,
    /// What a reward counts one step later.
    pub(crate) discount: f32,
    /// Scale of the environment's potential, whose rise is added to rewards.
    pub(crate) shaping: f32,
}

/// Decisions of all instances, those that hold and those that are kept.
#[derive(Debug)]
pub(crate) struct Experience {
    rule: Rule,
    pub(crate) replay: Replay,
    acting: Acting,
    running: Vec<Decision>,
    last: Vec<f32>,
    seen: Observation,
}

impl Experience {
    /// Nothing was decided yet in so many instances.
    pub(crate) fn new(rule: Rule, instances: usize, replay: Replay) -> Self {
        Self {
            rule,
            replay,
            acting: Acting::default(),
            running: vec![Decision::default(); instances],
            last: Vec::new(),
            seen: Observation::default(),
        }
    }

    /// Has agents choose where no decision holds, and writes `[scenes, agents]` what they do.
    pub(crate) fn act(
        &mut self,
        actors: Actors<'_>,
        scenes: &Scenes<'_>,
        random: &mut [Random],
        actions: &mut [u16],
    ) {
        let Self { rule, replay, acting, running, .. } = self;
        let groups = actors.groups;
        let decides = |scene: &&Scene<'_>| scene.begins || running[scene.instance].left == 0;
        let deciding: Vec<&Scene<'_>> = scenes.scenes.iter().filter(decides).collect();
        if !deciding.is_empty() {
            acting.look(actors, scenes.environment, deciding.iter().copied());
        }
        let width = observed(groups);
        for (place, scene) in deciding.into_iter().enumerate() {
            let instance = scene.instance;
            let decision = &mut running[instance];
            decision.begin(groups.agents(), rule.interval);
            acting.choose(groups, place, Some(&mut random[instance]), &mut decision.actions);
            if scene.begins {
                decision.look(scenes.environment, scene.state, rule.shaping);
            }
            let observation = &acting.observations[place * width..][..width];
            replay.decide(instance, observation, &decision.actions);
        }
        let chunks = actions.chunks_exact_mut(groups.agents());
        for (scene, actions) in scenes.scenes.iter().zip(chunks) {
            let decision = &mut running[scene.instance];
            actions.copy_from_slice(&decision.actions);
            decision.left -= 1;
        }
    }

    /// Adds what a step earned each agent. Returns the place of the decision that it ended.
    pub(crate) fn remember(
        &mut self,
        groups: &Groups,
        rewards: &[f64],
        transition: &Transition<'_>,
    ) -> Option<Place> {
        let Self { rule, replay, running, last, seen, .. } = self;
        let decision = &mut running[transition.instance];
        decision.earn(rewards, rule.discount);
        let is_last = transition.step.done();
        if decision.left > 0 && !is_last {
            return None;
        }
        decision.shape(transition.environment, transition.next, rule.shaping);
        let discount = if transition.step.terminated { 0.0 } else { decision.discount };
        let outcome = Outcome { rewards: &decision.rewards, discount, is_last };
        let place = replay.conclude(transition.instance, outcome);
        if is_last {
            last.clear();
            observe(transition.environment, groups, transition.next, seen, last);
            replay.end(transition.instance, last);
        }
        Some(place)
    }

    /// Names what the rest of a run depends on.
    pub(crate) fn state(&mut self, state: &mut State<'_>) -> Result<(), LearnError> {
        state.value("decisions", &mut self.running)?;
        state.value("replay", &mut self.replay)
    }
}

/// Records, by groups: rows of agents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Joint records.
    pub records: usize,
    /// `[rows, inputs]`: what they saw.
    pub observations: Vec<Vec<f32>>,
    /// `[rows]`: what they did.
    pub actions: Vec<Vec<u32>>,
    /// `[rows]`: what they earned until the next observation.
    pub rewards: Vec<Vec<f32>>,
    /// `[rows]`: what the value of the next observation counts, 0 behind an end.
    pub discounts: Vec<Vec<f32>>,
    /// `[rows, inputs]`: what they saw next.
    pub next: Vec<Vec<f32>>,
    /// `[records]`: whether the next record is the next decision of the same episode; empty where none is.
    pub follows: Vec<bool>,
}

impl Batch {
    /// Forgets all records, keeps the memory.
    pub fn clear(&mut self, groups: &Groups) {
        fn emptied<T>(all: &mut Vec<Vec<T>>, groups: usize) {
            all.resize_with(groups, Vec::new);
            all.iter_mut().for_each(Vec::clear);
        }
        self.records = 0;
        self.follows.clear();
        emptied(&mut self.actions, groups.0.len());
        let Self { observations, rewards, discounts, next, .. } = self;
        for all in [observations, rewards, discounts, next] {
            emptied(all, groups.0.len());
        }
    }

    /// Adds a decision and what followed it within so many.
    pub(crate) fn add(
        &mut self,
        groups: &Groups,
        inputs: Inputs,
        replay: &Replay,
        place: Place,
        future: &Future,
    ) {
        self.records += 1;
        show(groups, inputs, replay.observation(place), &mut self.observations);
        if let Some(next) = future.next {
            show(groups, inputs, replay.observation(next), &mut self.next);
        }
        let actions = replay.actions(place);
        for (index, group) in groups.0.iter().enumerate() {
            let own = group.agents.clone();
            self.actions[index].extend(actions[own.clone()].iter().map(|a| u32::from(*a)));
            self.rewards[index].extend_from_slice(&future.rewards[own.clone()]);
            self.discounts[index].extend(own.map(|_| future.discount));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actor_critic::groups::Group;

    #[test]
    fn a_decision_is_shown_with_what_followed_by_groups() {
        let group = |agents, observed, identity| Group { agents, observed, identity, actions: 9 };
        let groups = Groups(vec![group(0..2, 1, true), group(2..3, 2, false)]);
        let mut replay = Replay::new(1, 8, 3, 4);
        // What agents earn is kept in deviations, so that it takes two decisions to tell rewards apart.
        let mut places = Vec::new();
        for (number, is_last) in [(0.0, false), (4.0, true)] {
            replay.decide(0, &[number, number + 1.0, number + 2.0, number + 3.0], &[3, 5, 8]);
            let rewards = &[number, -number, 2.0 * number];
            places.push(replay.conclude(0, Outcome { rewards, discount: 0.5, is_last }));
        }
        replay.end(0, &[8.0, 9.0, 10.0, 11.0]);
        let (mut batch, mut future) = (Batch::default(), Future::default());
        batch.clear(&groups);
        for (place, steps) in [(places[0], 2), (places[1], 2)] {
            replay.future(place, steps, true, &mut future);
            let inputs = Inputs { normalised: false, scale: 2.0 };
            batch.add(&groups, inputs, &replay, place, &future);
        }
        assert_eq!(batch.records, 2);
        let first = [0.0, 1.0, 0.0, 2.0, 0.0, 1.0, 8.0, 1.0, 0.0, 10.0, 0.0, 1.0];
        assert_eq!(batch.observations, [first.to_vec(), vec![4.0, 6.0, 12.0, 14.0]]);
        let next = [16.0, 1.0, 0.0, 18.0, 0.0, 1.0];
        assert_eq!(batch.next, [next.repeat(2), [20.0, 22.0].repeat(2)]);
        assert_eq!(batch.actions, [vec![3, 5, 3, 5], vec![8, 8]]);
        // Rewards of -1 and 1 in deviations, the sign of the second agent's turned.
        assert_eq!(batch.rewards, [vec![-0.5, 0.5, 1.0, -1.0], vec![-0.5, 1.0]]);
        assert_eq!(batch.discounts, [vec![0.25, 0.25, 0.5, 0.5], vec![0.25, 0.5]]);
    }
}
