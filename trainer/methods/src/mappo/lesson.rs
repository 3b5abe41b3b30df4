//! Decisions in some states of a rollout, what came of them, and what actor and critic lose there.

use sortie_envs::{Environment, members};
use sortie_learn::Trajectories;
use sortie_learn::learner::Loss;
use sortie_learn::trajectory::{End, Place};
use sortie_nn::tape::{Pass, Var};

use super::networks::{Network, Shown, closed};

/// States, and by agents that act in them what they decided. The place of an agent is that among `[states, A]` of the rollout.
#[derive(Debug, Default)]
pub(super) struct Lesson {
    pub(super) shown: Shown,
    pub(super) places: Vec<usize>,
    pub(super) actions: Vec<u32>,
    /// The logarithms of the actions' chances at that time.
    pub(super) logarithms: Vec<f32>,
    /// How much better than expected they were, and what the states were worth then.
    pub(super) advantages: Vec<f32>,
    pub(super) targets: Vec<f32>,
}

/// How a batch is learned from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    pub(super) decisions: usize,
    /// How far chances may move.
    pub(super) clip: f32,
    /// What the entropy of chances counts.
    pub(super) entropy: f32,
}

impl Lesson {
    /// Looks at states of a rollout by their numbers. Where an episode was over, actions say nothing.
    pub(super) fn of(
        environment: &dyn Environment,
        rollout: &Trajectories,
        states: &[(usize, Place)],
    ) -> Self {
        let mut lesson = Self::default();
        let spec = environment.spec();
        for (number, place) in states {
            let acting = lesson.shown.push(environment, rollout.state(*place));
            for agent in members(acting.into()) {
                lesson.places.push(number * spec.shape.agents + agent);
                lesson.actions.push(rollout.actions(*place)[agent].into());
            }
        }
        lesson.shown.finish(spec);
        lesson
    }

    /// Takes over how good the decisions were: `[states, A]` advantages and values.
    pub(super) fn judge(&mut self, advantages: &[f32], values: &[f32]) {
        self.advantages = self.places.iter().map(|place| advantages[*place]).collect();
        self.targets =
            self.places.iter().map(|place| advantages[*place] + values[*place]).collect();
    }

    /// The actor's scores `[decisions, U]`, those of actions that are not available far below all others.
    fn scores(&self, pass: &mut Pass<'_>, actor: &Network) -> Var {
        let scores = actor.numbers(pass, &self.shown);
        let actions = pass.size(scores)[1];
        let open = self.shown.available().iter();
        let closed: Vec<f32> = open.flat_map(|open| closed(*open).take(actions)).collect();
        let closed = pass.input(actions, &closed);
        pass.add(scores, closed)
    }

    /// The logarithms of the chances of what was decided.
    pub(super) fn chances(&self, pass: &mut Pass<'_>, actor: &Network) -> Var {
        let scores = self.scores(pass, actor);
        let logarithms = pass.log_softmax(scores);
        pass.pick(logarithms, &self.actions)
    }

    /// The part that the lesson has in the actor's loss: the clipped objective (Schulman et al. 2017), and entropy.
    pub(super) fn actor_loss(&self, pass: &mut Pass<'_>, actor: &Network, rules: Rules) -> Loss {
        let scores = self.scores(pass, actor);
        let [chances, logarithms] = [pass.softmax(scores), pass.log_softmax(scores)];
        let taken = pass.pick(logarithms, &self.actions);
        let before = pass.input(1, &self.logarithms);
        let before = pass.scale(before, -1.0);
        let ratios = pass.add(taken, before);
        let ratios = pass.exp(ratios);
        let share = 1.0 / rules.decisions as f32;
        // Beyond the bound that the advantage draws the ratio to, more of it counts for nothing.
        let weights = pass.values(ratios).iter().zip(&self.advantages).map(|(ratio, advantage)| {
            let is_beyond = (ratio - 1.0) * advantage.signum() > rules.clip;
            if is_beyond { 0.0 } else { -share * advantage }
        });
        let weights: Vec<f32> = weights.collect();
        let objective = pass.weighted_sum(ratios, &weights);
        let disorder = pass.multiply(chances, logarithms);
        let weights = vec![share * rules.entropy; pass.values(disorder).len()];
        let disorder = pass.weighted_sum(disorder, &weights);
        Loss::of(pass, |pass| pass.add(objective, disorder))
    }

    /// The part that it has in the critic's: the mean squared error of values.
    pub(super) fn critic_loss(&self, pass: &mut Pass<'_>, critic: &Network, rules: Rules) -> Loss {
        let values = critic.numbers(pass, &self.shown);
        Loss::mean_square(pass, values, &self.targets, rules.decisions)
    }
}

/// `[states, A]`: how much better than expected decisions were, `sum of (discount lambda)^k d_k` with
/// `d = r + discount V' - V` (generalised advantages, Schulman et al. 2016), by what states one behind the other earned and
/// how they were left. Behind the last step of every episode stands the state that it led to.
pub(super) fn advantages(
    states: &[(f32, End)],
    values: &[f32],
    [discount, lambda]: [f32; 2],
) -> Vec<f32> {
    let agents = values.len() / states.len();
    let mut advantages = vec![0.0; values.len()];
    for (state, (reward, end)) in states.iter().enumerate().rev() {
        for at in (state * agents..).take(agents) {
            let next = match end {
                End::Nothing => continue,
                End::Over => 0.0,
                // Of a state that time ran out in the value counts alone: no decision there has an advantage.
                End::Open | End::TimedOut => {
                    discount * (values[at + agents] + lambda * advantages[at + agents])
                }
            };
            advantages[at] = reward + next - values[at];
        }
    }
    advantages
}
