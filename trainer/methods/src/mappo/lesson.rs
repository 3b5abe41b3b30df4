//! Some states of a rollout, what was done in them and what came of it, and what actor and critic lose there.

use sortie_envs::{Environment, members};
use sortie_learn::Trajectories;
use sortie_learn::learner::Loss;
use sortie_learn::trajectory::{End, Place};
use sortie_nn::tape::{Pass, Var};

use super::networks::{Network, Shown};

/// Numbers of each decision are of one agent in one state. Its place is that of the agent among `[states, A]` of the whole
/// rollout.
#[derive(Debug, Default)]
pub(super) struct Lesson {
    pub(super) shown: Shown,
    /// The places of all agents that act, and those of them that decided: all but where an episode was over.
    pub(super) places: Vec<usize>,
    decided: Vec<u32>,
    /// What they decided.
    actions: Vec<u32>,
    /// The logarithms of its chances at that time.
    logarithms: Vec<f32>,
    /// How much better than expected it was, and what the state was worth then.
    pub(super) advantages: Vec<f32>,
    targets: Vec<f32>,
}

/// How actors learn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    /// Decisions of the batch.
    pub(super) decisions: usize,
    /// How far chances may move.
    pub(super) clip: f32,
    /// What the entropy of the chances counts.
    pub(super) entropy: f32,
}

impl Lesson {
    /// Looks at states of a rollout by their numbers.
    pub(super) fn fill<'a>(
        &mut self,
        environment: &dyn Environment,
        rollout: &Trajectories<u8>,
        states: impl Iterator<Item = &'a (usize, Place)>,
    ) {
        let spec = environment.spec();
        self.shown.clear();
        self.places.clear();
        self.decided.clear();
        self.actions.clear();
        for (number, place) in states {
            let turn = usize::from(*rollout.note(*place));
            let acting = self.shown.push(environment, rollout.state(*place), turn);
            let (actions, is_end) = (rollout.actions(*place), rollout.end(*place) == End::Nothing);
            for agent in members(acting.into()) {
                if !is_end {
                    self.decided.push(self.places.len() as u32);
                    self.actions.push(environment.turned_action(turn, actions[agent]).into());
                }
                self.places.push(number * spec.shape.agents + agent);
            }
        }
        self.shown.finish(spec);
    }

    /// How many decisions there are.
    pub(super) fn decisions(&self) -> usize {
        self.actions.len()
    }

    /// Keeps the logarithms of chances as they are before anything is learned.
    pub(super) fn keep(&mut self, logarithms: &[f32]) {
        self.logarithms.clear();
        self.logarithms.extend_from_slice(logarithms);
    }

    /// Takes over how good decisions were: `[states, A]` advantages and values.
    pub(super) fn judge(&mut self, advantages: &[f32], values: &[f32]) {
        let of = |row: &u32| self.places[*row as usize];
        self.advantages.clear();
        self.advantages.extend(self.decided.iter().map(|row| advantages[of(row)]));
        self.targets.clear();
        self.targets.extend(self.decided.iter().map(|row| advantages[of(row)] + values[of(row)]));
    }

    /// The logarithms `[decisions, U]` of the chances of all actions by the actor's weights.
    fn logarithms(&self, pass: &mut Pass<'_>, actor: &Network) -> [Var; 2] {
        let scores = actor.numbers(pass, &self.shown);
        let scores = pass.gather(scores, &self.decided);
        let actions = pass.size(scores)[1];
        let open = self.decided.iter().map(|row| self.shown.available()[*row as usize]);
        let closed = open.flat_map(|open| (0..actions).map(move |action| closed(open, action)));
        let closed: Vec<f32> = closed.collect();
        let closed = pass.input(actions, &closed);
        let scores = pass.add(scores, closed);
        [pass.softmax(scores), pass.log_softmax(scores)]
    }

    /// The logarithms of the chances of what was decided.
    pub(super) fn chances(&self, pass: &mut Pass<'_>, actor: &Network) -> Var {
        let [_, logarithms] = self.logarithms(pass, actor);
        pass.pick(logarithms, &self.actions)
    }

    /// The part that the lesson has in the actor's loss: the clipped objective (Schulman et al. 2017) and entropy.
    pub(super) fn actor_loss(&self, pass: &mut Pass<'_>, actor: &Network, rules: Rules) -> Loss {
        let [chances, logarithms] = self.logarithms(pass, actor);
        let taken = pass.pick(logarithms, &self.actions);
        let before: Vec<f32> = self.logarithms.iter().map(|logarithm| -logarithm).collect();
        let before = pass.input(1, &before);
        let ratios = pass.add(taken, before);
        let ratios = pass.exp(ratios);
        let share = 1.0 / rules.decisions as f32;
        // The lesser of two products counts. Where it is the clipped one, there is nothing to descend.
        let weights = pass.values(ratios).iter().zip(&self.advantages).map(|(ratio, advantage)| {
            let excess = (ratio - 1.0) * advantage.signum();
            if excess > rules.clip { 0.0 } else { -share * advantage }
        });
        let weights: Vec<f32> = weights.collect();
        let objective = pass.weighted_sum(ratios, &weights);
        let entropies = pass.multiply(chances, logarithms);
        let weights = vec![share * rules.entropy; pass.values(entropies).len()];
        let entropies = pass.weighted_sum(entropies, &weights);
        Loss::of(pass, |pass| pass.add(objective, entropies))
    }

    /// The part that the lesson has in the critic's: the mean squared error of values.
    pub(super) fn critic_loss(&self, pass: &mut Pass<'_>, critic: &Network, count: usize) -> Loss {
        let values = critic.numbers(pass, &self.shown);
        let values = pass.gather(values, &self.decided);
        Loss::mean_square(pass, values, &self.targets, count)
    }
}

/// What makes chances of actions that are not available nothing.
pub(super) fn closed(available: u64, action: usize) -> f32 {
    if available >> action & 1 == 1 { 0.0 } else { -1e9 }
}

/// Rewards of states one behind the other, and how each was left.
pub(super) type Left = (f32, End);

/// `[states, A]`: how much better than expected decisions were, `sum of (discount lambda)^k d_k` with
/// `d = r + discount V' - V` (generalised advantages, Schulman et al. 2016). The last state needs to be one in which an
/// episode was over.
pub(super) fn advantages(
    states: &[Left],
    values: &[f32],
    [discount, lambda]: [f32; 2],
) -> Vec<f32> {
    let agents = values.len() / states.len();
    let mut advantages = vec![0.0; values.len()];
    for (state, (reward, end)) in states.iter().enumerate().rev() {
        for at in (state * agents..).take(agents) {
            let next = match end {
                // Of the state that follows a time-out nothing but its value counts: its own advantage is none.
                End::Nothing => continue,
                End::Over => 0.0,
                End::Open | End::TimedOut => {
                    discount * (values[at + agents] + lambda * advantages[at + agents])
                }
            };
            advantages[at] = reward + next - values[at];
        }
    }
    advantages
}
