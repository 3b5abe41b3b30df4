//! The gradient by which policies follow what a critic values.

use std::ops::Range;

use sortie_nn::tape::{Chunks, Pass, Var};

use super::batch::Batch;
use super::groups::Groups;
use super::losses::{added, sum};
use super::policies::Policies;

/// Policies, and how their gradient is computed.
pub(crate) struct Following<'a> {
    pub(crate) policies: &'a Policies,
    pub(crate) groups: &'a Groups,
    /// What the mean squared score of an action counts.
    pub(crate) score_penalty: f32,
    pub(crate) threads: usize,
    pub(crate) chunks: &'a mut Chunks,
}

impl Following<'_> {
    /// Writes the gradient of the mean, over records, of what `loss` says of the scores of each group and head, by their
    /// number, in some of the group's rows.
    pub(crate) fn gradient(
        self,
        batch: &Batch,
        gradient: &mut Vec<f32>,
        loss: impl Fn(&mut Pass<'_>, usize, Var, Range<usize>) -> Var + Sync,
    ) {
        let Self { policies, groups, score_penalty, threads, chunks } = self;
        let share = 1.0 / batch.records as f32;
        let weights = &policies.parameters.values;
        gradient.clear();
        gradient.resize(weights.len(), 0.0);
        chunks.gradient(threads, weights, batch.records, gradient, |pass, range| {
            let all = policies.scores(pass, groups, &batch.observations, range.clone());
            let mut whole = None;
            for (index, scores) in all.into_iter().enumerate() {
                let group = &groups.0[index / policies.heads()];
                let rows = range.start * group.agents.len()..range.end * group.agents.len();
                let gain = loss(pass, index, scores, rows);
                let gain = pass.scale(gain, share);
                whole = Some(added(pass, whole, gain));
                let squares = pass.multiply(scores, scores);
                let squares = sum(pass, squares);
                let penalty = score_penalty * share / group.actions as f32;
                let squares = pass.scale(squares, penalty);
                whole = Some(added(pass, whole, squares));
            }
            whole.expect("there are agents")
        });
    }
}
