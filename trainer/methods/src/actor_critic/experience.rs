//! What agents see, do and earn while they learn.

use sortie_envs::{Observation, Random};
use sortie_learn::{LearnError, Scene, Scenes, State, Transition};

use super::acting::{Acting, Actors, observe, observed};
use super::decision::Decision;
use super::groups::Groups;
use super::replay::{Outcome, Place, Replay};

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
