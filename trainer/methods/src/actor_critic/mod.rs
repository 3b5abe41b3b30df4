//! What methods share whose agents have policies, and critics while they learn (dissertation chapters 3 and 4): groups of
//! agents that share networks, policies and how they act, losses, an update of policies and critic.

pub(crate) mod acting;
pub(crate) mod critic;
pub(crate) mod groups;
pub(crate) mod learner;
pub(crate) mod losses;
pub(crate) mod policies;

use sortie_learn::words;
use sortie_nn::optimise::AdamRules;

use groups::{Groups, Rows};

words! {
    /// How an agent's own action counts in targets and policies.
    OwnActions {
        /// All of them, by their chances.
        Expected = "expected",
        /// One that is drawn.
        Drawn = "drawn",
        /// One that the critic is shown, relaxed: the best in targets, drawn for policies (Gumbel-softmax).
        Relaxed = "relaxed",
    }
}

words! {
    /// Which values policies learn from.
    PolicyValues {
        /// Those that the critic's own update computed, for the others' actions of then.
        Kept = "kept",
        /// Those of the updated critic for actions that all draw now.
        Fresh = "fresh",
    }
}

/// How networks learn.
#[derive(Clone, Debug)]
pub struct Rules {
    /// How an agent's own action counts.
    pub own_actions: OwnActions,
    /// What policies learn from: policies of several heads from fresh values alone.
    pub policy_values: PolicyValues,
    /// What the target of the next decision counts beside its value: TD(lambda).
    pub lambda: f32,
    /// Discount of what heads are paid.
    pub paid_discount: f32,
    /// What that counts in what policies learn.
    pub paid_weight: f32,
    /// What the mean squared score of attention, and of an action, counts.
    pub penalties: [f32; 2],
    /// Step sizes of critic and policies.
    pub rates: [f32; 2],
    /// What Adam adds to what, for the critic; weights of policies do not decay.
    pub adam: AdamRules,
    /// Largest norms of the gradients of the critic and of a group's policy.
    pub clips: [f32; 2],
    /// Shares of the way that targets and averaged policies move in an update.
    pub follow: [f32; 2],
    /// Records of a shard.
    pub shard: usize,
}

impl Rules {
    /// `[rows, actions]`: ones for own actions, where the critic sees them.
    fn own_rows(&self, groups: &Groups, actions: &[Vec<u32>]) -> Rows {
        if self.own_actions != OwnActions::Relaxed {
            return Rows::new();
        }
        groups.0.iter().zip(actions).map(|(group, actions)| group.one_hot(actions)).collect()
    }
}
